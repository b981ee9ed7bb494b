"""Checks of data from files: JSON values, arrays, fields of dataclasses.

Each raises ValueError with the name of the part; readers of files convert it to FileError.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

_MOST_ENTRIES = 10_000  # of a list; a formula has no more parts
_TYPES: dict[str, tuple[type, ...]] = {
    "bool": (bool,),
    "int": (int,),
    "float": (int, float),
    "str": (str,),
    "None": (type(None),),
}


def require_names(part: str, found: Mapping[str, Any], expected: set[str]) -> None:
    """Raise ValueError unless a mapping has exactly these keys."""
    different = sorted({*found} ^ expected)
    if different:
        problem = "missing" if different[0] in expected else "unknown"
        raise ValueError(f"'{different[0][:40]}' of its {part} is {problem}")


def require_array(
    name: str,
    array: Any,
    shape: tuple[int, ...],
    dtype: Any = np.float64,
    *,
    finite: bool = True,
) -> None:
    """Raise ValueError unless an array has this shape and type, and finite values."""
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        raise ValueError(f"'{name}' is not of type {np.dtype(dtype)}")
    if array.shape != shape:
        raise ValueError(f"'{name}' has shape {array.shape}, not {shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"'{name}' is not finite")


def require_counts(record: Any) -> None:
    """Raise ValueError if a whole number of a dataclass is negative or exceeds 64 bits."""
    for name, value in numbers_of(record).items():
        if isinstance(value, int) and not 0 <= value < 2**63:
            raise ValueError(f"'{name}' is out of range")


def checked_type(name: str, value: Any, expected: str) -> Any:
    """Return a JSON value that has one of the types of an annotation, e.g. ``int | None``."""
    for kind in expected.split(" | "):
        if isinstance(value, _TYPES.get(kind, ())) and isinstance(value, bool) == (kind == "bool"):
            if kind == "float" and isinstance(value, int) and abs(value) >= 2**1_023:
                raise ValueError(f"'{name}' is too large")
            return float(value) if kind == "float" else value  # type: ignore[arg-type]
    raise ValueError(f"'{name}' is not of type {expected}")


def checked_number(name: str, value: Any) -> float:
    """Return a finite JSON number as a float."""
    number: float = checked_type(name, value, "float")
    if not math.isfinite(number):
        raise ValueError(f"'{name}' is not finite")
    return number


def checked_list(
    name: str, value: Any, count: int | None = None, *, most: int = _MOST_ENTRIES
) -> list[Any]:
    """Return a JSON list of at most this many entries, or of this length if one is given."""
    if not isinstance(value, (list, tuple)) or len(value) > most:
        raise ValueError(f"'{name}' is not a list of at most {most:,} entries")
    if count is not None and len(value) != count:
        raise ValueError(f"'{name}' has {len(value)} entries, not {count}")
    return list(value)


def checked_mapping(name: str, value: Any) -> dict[str, Any]:
    """Return a JSON object."""
    if not isinstance(value, dict):
        raise ValueError(f"'{name}' is not a mapping")
    return value


def checked_values(
    part: str, values: Mapping[str, Any], types: Mapping[str, str]
) -> dict[str, Any]:
    """Return values that have exactly these names, each of the type of an annotation.

    Beside the types of :func:`checked_type` there are tuples and mappings, with finite numbers.

    Examples
    --------
    >>> checked_values("part", {"span": [0, 2]}, {"span": "tuple[float, float]"})
    {'span': (0.0, 2.0)}
    >>> checked_values("part", {"masses": {"m": 1}}, {"masses": "Mapping[str, float]"})
    {'masses': {'m': 1.0}}
    """
    require_names(part, values, {*types})
    return {name: _checked_value(name, values[name], kind) for name, kind in types.items()}


def _checked_value(name: str, value: Any, kind: str) -> Any:
    outer, _, inner = kind.removesuffix("]").partition("[")
    if outer == "tuple":
        first, rest = inner.split(", ")
        entries = checked_list(name, value, None if rest == "..." else 2)
        return tuple(_checked_entry(name, entry, first) for entry in entries)
    if outer == "Mapping":
        last = inner.split(", ")[-1]
        return {
            key: _checked_entry(key[:40], entry, last)
            for key, entry in checked_mapping(name, value).items()
        }
    return checked_type(name, value, kind)


def _checked_entry(name: str, value: Any, kind: str) -> Any:
    if kind == "Any":
        return value
    return checked_number(name, value) if kind == "float" else checked_type(name, value, kind)


def checked_record(kind: type, numbers: Any, arrays: Mapping[str, Any]) -> Any:
    """Build a dataclass from its JSON values, each of the type of its field, and its arrays."""
    types = {field.name: str(field.type) for field in fields(kind)}
    checked_mapping(kind.__name__, numbers)
    require_names(kind.__name__, {**numbers, **arrays}, {*types})
    own = {name: types[name] for name in numbers}
    return kind(**checked_values(kind.__name__, numbers, own), **arrays)


def numbers_of(record: Any) -> dict[str, Any]:
    """Return the fields of a dataclass that are JSON values."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in values.items()}
    return {n: v for n, v in plain.items() if isinstance(v, (bool, int, float, str, type(None)))}


def taken(arrays: dict[str, Any], prefix: str) -> dict[str, Any]:
    """Remove and return the arrays with names ``prefix.name``, by ``name``.

    Examples
    --------
    >>> arrays = {"trial.edges": 1, "trial.0.bias": 2, "z0": 3}
    >>> taken(arrays, "trial"), arrays
    ({'edges': 1, '0.bias': 2}, {'z0': 3})
    """
    start = prefix + "."
    names = [name for name in arrays if name.startswith(start)]
    return {name.removeprefix(start): arrays.pop(name) for name in names}


def arrays_of(prefix: str, record: Any) -> dict[str, np.ndarray]:
    """Return the fields of a dataclass that are arrays, their names with a prefix."""
    values = {field.name: getattr(record, field.name) for field in fields(record)}
    return {f"{prefix}.{name}": v for name, v in values.items() if isinstance(v, np.ndarray)}
