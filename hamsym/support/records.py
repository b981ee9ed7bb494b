"""Results as data: dataclasses to JSON values with named arrays and back, by their annotations.

The annotation of a field says what a file may contain for it: numbers, texts, tuples and mappings,
arrays, other dataclasses (:mod:`hamsym.support.record_fields`). :func:`packed` and :func:`unpacked`
check the same, and call the method ``check`` of a dataclass, if it has one, for what types cannot
say. Everything that differs from what ``packed`` writes raises ValueError. Fields with the metadata
``UNSAVED``, which need defaults, are left out.
"""

from __future__ import annotations

import hashlib
import json
import math
import reprlib
import sys
import types
from collections.abc import Callable, Mapping
from dataclasses import is_dataclass
from enum import StrEnum
from fractions import Fraction
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin

import numpy as np

from hamsym.errors import HamsymError
from hamsym.support.record_fields import (
    CHECKS,
    CONVERSIONS,
    FIELDS,
    TEXT,
    Array,
    As,
    AsText,
    Limit,
    OneOf,
    Written,
    convert,
    fields_of,
)

R = TypeVar("R")
Arrays = dict[str, np.ndarray]

#: Errors that parts of the package raise for values that are not those of a solution.
MALFORMED = (
    *(ArithmeticError, AssertionError, AttributeError, HamsymError, LookupError, RuntimeError),
    *(TypeError, ValueError),
)

_MOST_ENTRIES = 10_000  # of a tuple, unless a Limit says otherwise
_DEEPEST = 200  # parts inside each other
_FORM = "form"
_NONE: dict[str, Any] = {}


def packed(value: Any, kind: Any = None) -> tuple[Arrays, Any]:
    """Return a record as arrays by name and values that JSON can store.

    Raise ValueError, TypeError, HamsymError unless it is valid.

    - kind: Its annotation, by default its class.

    Examples
    --------
    >>> from hamsym.support.record_fields import floats
    >>> kind = tuple[Annotated[np.ndarray, floats("times")], tuple[str, ...]]
    >>> packed((np.array([0.0, 1.0]), ("x", "p")), kind)
    ({'0': array([0., 1.])}, [None, ['x', 'p']])
    >>> unpacked(kind, {"0": np.array(["0"])}, [None, ["x"]])
    Traceback (most recent call last):
    ...
    ValueError: '0' is not of type float64
    """
    arrays: Arrays = {}
    return arrays, _Way(arrays).write(type(value) if kind is None else kind, value, "")


def unpacked(kind: type[R], arrays: Mapping[str, np.ndarray], values: Any) -> R:
    """Return the record of its arrays and values.

    Raise ValueError, TypeError, HamsymError unless they are what :func:`packed` writes.
    """
    left = dict(arrays)
    found: R = _Way(left).read(kind, values, "")
    if left:
        raise ValueError(f"'{min(left)[:40]}' of its arrays is unknown")
    return found


def as_json(value: Any) -> Any:
    """Return a record as values of JSON, with its arrays as lists."""
    return _Way(None).write(type(value), value, "")


def from_json(kind: type[R], values: Any) -> R:
    """Return the record of :func:`as_json`."""
    found: R = _Way(None).read(kind, values, "")
    return found


def digest_of(value: Any, kind: Any = None) -> str:
    """Compute SHA-256 of a record, with types, shapes and bytes of its arrays."""
    return digest_of_parts(*packed(value, kind))


def digest_of_parts(arrays: Mapping[str, np.ndarray], values: Any) -> str:
    """Compute SHA-256 of arrays and values."""
    found = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for name, array in sorted(arrays.items()):
        found.update(f"{name} {array.dtype.name} {list(array.shape)} ".encode())
        found.update((array if sys.byteorder == "little" else array.byteswap()).tobytes())
    return found.hexdigest()


class _Way:
    """One record on its way to data and from data.

    - arrays: By name; those that are read are removed. None: they are lists in the values.
    """

    def __init__(self, arrays: Arrays | None, lengths: Mapping[str, Any] = _NONE) -> None:
        self.arrays = arrays
        self._lengths = dict(lengths)

    def write(self, kind: Any, value: Any, name: str) -> Any:
        kind, note = _unwrapped(kind)
        if isinstance(note, As):
            return self.write(note.kind, note.to_data(value), name)
        if isinstance(note, Array):
            return self._write_array(note, value, name)
        if isinstance(note, OneOf):
            form, found = note.form_of(type(value)), self._apart.write(type(value), value, name)
            if form is None:
                raise ValueError(f"'{name}' cannot be a {type(value).__name__}")
            return {_FORM: form, **found}
        if note is AsText and self.arrays is not None:
            text = json.dumps(_Way(None, self._lengths).write(kind, value, name))
            return self._apart._write_array(
                TEXT, np.frombuffer(text.encode(), dtype=np.uint8), name
            )
        if _is_union(kind):
            if value is None and type(None) in get_args(kind):
                return None
            return self.write(_member(kind, type(value)), value, name)
        if kind in CONVERSIONS:
            way = CONVERSIONS[kind]
            if not isinstance(value, kind):
                raise ValueError(f"'{name}' is not of type {kind.__name__}")
            self._learn(way.lengths(value))
            return self.write(way.kind, way.to_data(value), name)
        if kind in FIELDS or is_dataclass(kind):
            _require_type(kind, value, name)
            own = fields_of(kind).items()
            found = {n: self.write(k, getattr(value, n), _inside(name, n)) for n, k in own}
            _verify(value)
            return found
        if get_origin(kind) is tuple:
            _require_type(tuple, value, name)
            kinds = _kinds_of_entries(kind, note, value, name)
            return [self._apart.write(*pair, _inside(name, str(k))) for k, pair in enumerate(kinds)]
        if get_origin(kind) in (dict, Mapping):
            keys, inner = get_args(kind)
            entries = {_key(keys, key, name): entry for key, entry in value.items()}
            return {k: self._apart.write(inner, v, _inside(name, k)) for k, v in entries.items()}
        if isinstance(note, Written):
            return note.text(_scalar(float, value, name, Limit(finite=False)))
        value = value.item() if isinstance(value, np.generic) else value
        value = str(value) if isinstance(value, StrEnum) else value
        if kind is float and type(value) is int and abs(value) < 2**1_023:
            value = float(value)
        return _scalar(kind, value, name, note)

    def read(self, kind: Any, value: Any, name: str) -> Any:
        if name.count(".") > _DEEPEST:
            raise ValueError("it has too many parts inside each other")
        kind, note = _unwrapped(kind)
        if isinstance(note, As):
            return note.from_data(self.read(note.kind, value, name))
        if isinstance(note, Array):
            return self._read_array(note, value, name)
        if isinstance(note, OneOf):
            given = _mapping(value, name)
            rest = {key: entry for key, entry in given.items() if key != _FORM}
            return self._apart.read(note.kind_of(given.get(_FORM)), rest, name)
        if note is AsText and self.arrays is not None:
            text = self._apart._read_array(TEXT, value, name).tobytes()
            return _Way(None, self._lengths).read(kind, json.loads(text), name)
        if _is_union(kind):
            inline = type(value) is list if self.arrays is None else value is None
            is_array = inline and (self.arrays is None or name in self.arrays)
            if value is None and type(None) in get_args(kind) and not is_array:
                return None
            return self.read(_member(kind, np.ndarray if is_array else type(value)), value, name)
        if kind in CONVERSIONS:
            way = CONVERSIONS[kind]
            found = way.from_data(self.read(way.kind, value, name))
            self._learn(way.lengths(found))
            return found
        if kind in FIELDS or is_dataclass(kind):
            own = fields_of(kind)
            given = _mapping(value, name, {*own})
            found = kind(**{n: self.read(k, given[n], _inside(name, n)) for n, k in own.items()})
            _verify(found)
            return found
        if get_origin(kind) is tuple:
            if not isinstance(value, list):
                raise ValueError(f"'{name}' is not a list")
            kinds = _kinds_of_entries(kind, note, value, name)
            return tuple(
                self._apart.read(*pair, _inside(name, str(k))) for k, pair in enumerate(kinds)
            )
        if get_origin(kind) in (dict, Mapping):
            keys, inner = get_args(kind)
            given = _mapping(value, name)
            if any(_key(keys, key, name) != key for key in given):
                raise ValueError(f"'{name}' has keys that are not numbers")
            read = {k: self._apart.read(inner, v, _inside(name, k)) for k, v in given.items()}
            return {keys(key): entry for key, entry in read.items()}
        if isinstance(note, Written):
            return _number(value, note.text, name)
        return _scalar(kind, value, name, note)

    @property
    def _apart(self) -> _Way:
        """The way of a form or an entry, with lengths of its own."""
        return _Way(self.arrays, self._lengths)

    def _learn(self, lengths: Mapping[str, int]) -> None:
        for name, length in lengths.items():
            if self._lengths.setdefault(name, length) != length:
                raise ValueError(f"its {name} is {length} and {self._lengths[name]}")

    def _write_array(self, spec: Array, value: Any, name: str) -> Any:
        spec.check(name, value, self._lengths)
        stored = value if spec.stored is None else value.astype(spec.stored)
        if not np.array_equal(stored.astype(value.dtype), value, equal_nan=not spec.finite):
            raise ValueError(f"'{name}' has numbers out of range")
        if self.arrays is None:
            return stored.tolist()
        if name in self.arrays:
            raise ValueError(f"two arrays have the name '{name}'")
        self.arrays[name] = stored
        return None

    def _read_array(self, spec: Array, value: Any, name: str) -> np.ndarray:
        if self.arrays is None:
            array = np.array(_lists(value, name), dtype=float)
        elif name not in self.arrays or value is not None:
            raise ValueError(f"'{name}' of its arrays is missing")
        else:
            array = self.arrays.pop(name)
        if spec.stored is not None:
            if array.dtype != spec.stored:
                raise ValueError(f"'{name}' is not of type {np.dtype(spec.stored)}")
            stored, array = array, array.astype(spec.dtypes[0])
            if not np.array_equal(array.astype(spec.stored), stored):
                raise ValueError(f"'{name}' has numbers out of range")
        spec.check(name, array, self._lengths)
        return array


def _unwrapped(kind: Any) -> tuple[Any, Any]:
    """Return an annotation and what :class:`Annotated` adds to it."""
    return get_args(kind)[:2] if get_origin(kind) is Annotated else (kind, None)


def _is_union(kind: Any) -> bool:
    return get_origin(kind) in (Union, types.UnionType)


def _member(kind: Any, found: type) -> Any:
    """Return the member of a union that a value of a type belongs to."""
    members = [each for each in get_args(kind) if each is not type(None)]
    arrays = [each for each in members if isinstance(_unwrapped(each)[1], Array)]
    others = [each for each in members if each not in arrays]
    if arrays and (found is np.ndarray or not others):
        return arrays[0]
    found = tuple if found is list else found
    kinds = {each: get_origin(_unwrapped(each)[0]) or _unwrapped(each)[0] for each in others}
    return next((each for each, kind in kinds.items() if kind is found), others[0])


def _kinds_of_entries(kind: Any, note: Any, value: Any, name: str) -> list[tuple[Any, Any]]:
    """Return the entries of a tuple, each behind its annotation."""
    kinds = get_args(kind)
    if kinds[-1] is Ellipsis:
        most = note.most if isinstance(note, Limit) else _MOST_ENTRIES
        if not len(value) <= most:
            raise ValueError(f"'{name}' is not a list of at most {most:,} entries")
        kinds = kinds[:1] * len(value)
    if len(value) != len(kinds):
        raise ValueError(f"'{name}' has {len(value)} entries, not {len(kinds)}")
    return list(zip(kinds, value, strict=True))


def _scalar(kind: Any, value: Any, name: str, limit: Limit | None) -> Any:
    """Return a bool, an int, a float or a text, of exactly this type and in its range."""
    if kind is Any:
        return value
    _require_type(kind, value, name)
    if kind is float and not math.isfinite(value) and (limit is None or limit.finite):
        raise ValueError(f"'{name}' is not finite")
    if kind is int and abs(value) >= 2**63:
        raise ValueError(f"'{name}' is out of range")
    bounded = limit is not None and (limit.least, limit.most) != (-math.inf, math.inf)
    if bounded and not limit.least <= value <= limit.most:  # type: ignore[union-attr]
        raise ValueError(f"'{name}' is out of range")
    return value


def _require_type(kind: type, value: Any, name: str) -> None:
    if type(value) is not kind:
        raise ValueError(f"'{name}' is not of type {kind.__name__}")


def _mapping(value: Any, name: str, names: set[str] | None = None) -> dict[str, Any]:
    """Return a JSON object, with exactly these names if they are given."""
    if not isinstance(value, dict):
        raise ValueError(f"'{name}' is not a mapping")
    different = sorted(value.keys() ^ names) if names is not None else []
    if different:
        problem = "unknown" if different[0] in value else "missing"
        raise ValueError(f"'{different[0][:40]}' of its {name or 'values'} is {problem}")
    return value


def _key(kind: type, key: Any, name: str) -> str:
    """Return a key as JSON has it."""
    if kind is int and not isinstance(key, bool) and str(key).isdecimal():
        return str(int(key))
    _require_type(str, key, name)
    if kind is int:
        raise ValueError(f"'{name}' has keys that are not numbers")
    return str(key)


def _inside(name: str, part: str) -> str:
    return f"{name}.{part}" if name else part


def _verify(value: Any) -> None:
    """Call the checks of a record."""
    if (check := getattr(value, "check", None)) is not None:
        check()
    if (further := CHECKS.get(type(value))) is not None:
        further(value)


def _lists(value: Any, name: str) -> Any:
    """Return a float, or nested lists of floats."""
    if isinstance(value, list):
        return [_lists(entry, name) for entry in value]
    _require_type(float, value, name)
    return value


def _number(text: Any, written: Callable[[float], str], name: str) -> float:
    """Return the number of a text, which is exactly as it is written."""
    try:
        value = float(text) if isinstance(text, str) else math.nan
    except ValueError:
        value = math.nan
    if written(value) != text:
        raise ValueError(f"'{name}' is {reprlib.repr(text)}, not a number as it is written")
    return value


def _fraction(text: str) -> Fraction:
    found = Fraction(text)
    if str(found) != text:
        raise ValueError(f"{reprlib.repr(text)} is not a fraction in lowest terms")
    return found


convert(Fraction, str, str, _fraction)
