"""Annotations of the fields of records: what a file may contain for them.

:mod:`hamsym.support.records` reads and writes by them. A type alone is an annotation, too: floats
are finite, and whole numbers have 64 bits.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import math
import sys
import types
import typing
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np

from hamsym.errors import InputError

#: Metadata of a field that is not part of files.
UNSAVED = {"saved": False}


class NotDataError(InputError):
    """A part of a record that is code."""


@dataclass(frozen=True)
class Array:
    """Contents of an array."""

    #: Lengths: numbers, names, names with a sum ("windows + 1"), or "*name" for several axes. A
    #: name means the same length in a whole record; forms and the entries of tuples and mappings
    #: share the names that are known before them, and have others of their own. A Hamiltonian
    #: defines "dim".
    shape: tuple[str | int, ...]
    #: Admitted types.
    dtypes: tuple[Any, ...] = (np.float64,)
    #: Whether its numbers must be finite.
    finite: bool = True
    #: least, most: Range of its numbers; with one of them NaN is out of range.
    least: float = -math.inf
    most: float = math.inf
    #: Type in the file, if it is another one.
    stored: Any = None

    def check(self, name: str, array: Any, lengths: dict[str, Any]) -> None:
        """Raise ValueError unless an array has this type, shape and range."""
        if not isinstance(array, np.ndarray) or array.dtype not in self.dtypes:
            types = " or ".join(np.dtype(kind).name for kind in self.dtypes)
            raise ValueError(f"'{name}' is not of type {types}")
        expected = self._expected(array.shape, lengths)
        if array.shape != expected:
            shape = ", ".join(map(str, expected)) + "," * (len(expected) == 1)
            raise ValueError(f"'{name}' has shape {array.shape}, not ({shape})")
        if self.finite and not np.isfinite(array).all():
            raise ValueError(f"'{name}' is not finite")
        bounded = (self.least, self.most) != (-math.inf, math.inf)
        if bounded and not ((array >= self.least) & (array <= self.most)).all():
            raise ValueError(f"'{name}' has numbers out of range")

    def _expected(self, found: tuple[int, ...], lengths: dict[str, Any]) -> tuple[Any, ...]:
        """Return the shape, in which unknown lengths get the values found."""
        spec: list[Any] = []
        for entry in self.shape:
            if isinstance(entry, str) and entry.startswith("*"):
                count = max(0, len(found) - len(self.shape) + 1)
                axes = found[len(spec) : len(spec) + count]
                spec += lengths.setdefault(entry[1:], axes)
            else:
                spec.append(entry)
        if len(spec) != len(found):
            return tuple(spec)
        for place, size in enumerate(found):
            if isinstance(spec[place], str):
                name, _, more = spec[place].partition(" + ")
                extra = int(more or 0)
                if size >= extra:
                    spec[place] = lengths.setdefault(name, size - extra) + extra
        return tuple(spec)


def floats(*shape: str | int, finite: bool = True, least: float = -math.inf) -> Array:
    """Make the contents of an array of float64."""
    return Array(shape, finite=finite, least=least)


def counts(*shape: str | int) -> Array:
    """Make the contents of an array of whole numbers from 0 on."""
    return Array(shape, (np.int64,), least=0)


def flags(*shape: str | int) -> Array:
    """Make the contents of an array of bool."""
    return Array(shape, (np.bool_,), stored=np.uint8)


TEXT = Array(("bytes",), (np.uint8,))


@dataclass(frozen=True)
class Limit:
    """Range of a number, or of the number of entries of a tuple."""

    least: float = -math.inf
    most: float = math.inf
    finite: bool = True


Count = Annotated[int, Limit(0)]
Size = Annotated[float, Limit(0)]
#: A float that may be infinite or not a number.
AnyFloat = Annotated[float, Limit(finite=False)]


@dataclass(frozen=True)
class Written:
    """A float that is written as a text, and read only if it is exactly that text."""

    text: Callable[[float], str]


@dataclass(frozen=True)
class As:
    """Another annotation for files than for readers, with functions from the one to the other."""

    kind: Any
    to_data: Callable[[Any], Any] = lambda value: value
    from_data: Callable[[Any], Any] = lambda value: value


class AsText:
    """Values that are stored as an array with their JSON text, because there may be many."""


class OneOf:
    """Classes of which a field has one, by the form that is written with it.

    A class is given as "module:Class", unless the annotation can import it.
    """

    def __init__(self, **kinds: Any) -> None:
        self._kinds = kinds

    def form_of(self, kind: type) -> str | None:
        """Return the form of a class, None if it is not one of these."""
        own = f"{kind.__module__}:{kind.__qualname__}"
        return next((form for form, each in self._kinds.items() if each in (kind, own)), None)

    def kind_of(self, form: Any) -> Any:
        """Return the class of a form."""
        kind = self._kinds.get(form) if isinstance(form, str) else None
        if kind is None:
            raise ValueError(f"it has the unknown form {str(form)[:40]}")
        if isinstance(kind, str):
            module, _, name = kind.partition(":")
            return getattr(importlib.import_module(module), name)
        return kind


# -- classes that are not their own data -----------------------------------------------------------


@dataclass(frozen=True)
class Conversion:
    """Data in place of a class."""

    kind: Any
    to_data: Callable[[Any], Any]
    from_data: Callable[[Any], Any]
    lengths: Callable[[Any], dict[str, int]]


CONVERSIONS: dict[type, Conversion] = {}
FIELDS: dict[type, dict[str, Any]] = {}
CHECKS: dict[type, Callable[[Any], None]] = {}


def convert(
    own: type,
    kind: Any,
    to_data: Callable[[Any], Any],
    from_data: Callable[[Any], Any],
    lengths: Callable[[Any], dict[str, int]] = lambda value: {},
) -> None:
    """Pack a class as data of another kind.

    - kind: Annotation of the data, for example a dataclass.
    - to_data, from_data: Functions from the one to the other.
    - lengths: Names of lengths that a value defines.
    """
    CONVERSIONS[own] = Conversion(kind, to_data, from_data, lengths)


def declare(own: type, **annotations: Any) -> None:
    """Annotate the attributes of a class that is no dataclass; they are its arguments too."""
    FIELDS[own] = annotations


def check_also(own: type, check: Callable[[Any], None]) -> None:
    """Add a check that needs what the module of a class must not import."""
    CHECKS[own] = check


@functools.cache
def fields_of(own: type) -> dict[str, Any]:
    """Return the annotations of the fields of a class that are part of files."""
    if own in FIELDS:
        return FIELDS[own]
    saved = [f.name for f in fields(own) if f.metadata.get("saved", True)]
    found: dict[str, Any] = {}
    for name in saved:
        base = next(k for k in own.__mro__ if name in inspect.get_annotations(k))
        one = types.SimpleNamespace(__annotations__={name: inspect.get_annotations(base)[name]})
        names = vars(sys.modules[base.__module__])
        found |= typing.get_type_hints(one, names, include_extras=True)
    return found
