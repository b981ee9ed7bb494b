"""Checks of data that come from files: values of JSON, arrays, the fields of a dataclass.

Each raises a ValueError that names the part; readers of files turn it into a FileError.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

__all__ = [
    "arrays_of",
    "checked_list",
    "checked_mapping",
    "checked_number",
    "checked_record",
    "checked_type",
    "numbers_of",
    "require_array",
    "require_counts",
    "require_names",
]

_MOST_ENTRIES = 10_000  # of a list; a formula has no more parts
_TYPES: dict[str, tuple[type, ...]] = {
    "bool": (bool,),
    "int": (int,),
    "float": (int, float),
    "str": (str,),
    "None": (type(None),),
}


def require_names(what: str, found: Mapping[str, Any], wanted: set[str]) -> None:
    """Raise ValueError unless a mapping has exactly these keys."""
    different = sorted({*found} ^ wanted)
    if different:
        problem = "missing" if different[0] in wanted else "unknown"
        raise ValueError(f"'{different[0][:40]}' of its {what} is {problem}")


def require_array(
    name: str,
    array: Any,
    shape: tuple[int, ...],
    dtype: Any = np.float64,
    *,
    finite: bool = True,
) -> None:
    """Raise ValueError unless an array has this shape and type, and finite numbers."""
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        raise ValueError(f"'{name}' is not of type {np.dtype(dtype)}")
    if array.shape != shape:
        raise ValueError(f"'{name}' has shape {array.shape}, not {shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"'{name}' is not finite")


def require_counts(record: Any) -> None:
    """Raise ValueError if a whole number of a dataclass is negative or beyond 64 bits."""
    for name, value in numbers_of(record).items():
        if isinstance(value, int) and not 0 <= value < 2**63:
            raise ValueError(f"'{name}' is out of range")


def checked_type(name: str, value: Any, wanted: str) -> Any:
    """A value of JSON, if it has one of the types of an annotation such as ``int | None``."""
    for kind in wanted.split(" | "):
        if isinstance(value, _TYPES.get(kind, ())) and isinstance(value, bool) == (kind == "bool"):
            if kind == "float" and isinstance(value, int) and abs(value) >= 2**1_023:
                raise ValueError(f"'{name}' is too large")
            return float(value) if kind == "float" else value  # type: ignore[arg-type]
    raise ValueError(f"'{name}' is not of type {wanted}")


def checked_number(name: str, value: Any) -> float:
    """A finite number of JSON, as a float."""
    number: float = checked_type(name, value, "float")
    if not math.isfinite(number):
        raise ValueError(f"'{name}' is not finite")
    return number


def checked_list(name: str, value: Any, count: int | None = None) -> list[Any]:
    """A list of JSON, of this length if one is given."""
    if not isinstance(value, (list, tuple)) or len(value) > _MOST_ENTRIES:
        raise ValueError(f"'{name}' is not a list of at most {_MOST_ENTRIES:,} entries")
    if count is not None and len(value) != count:
        raise ValueError(f"'{name}' has {len(value)} entries, not {count}")
    return list(value)


def checked_mapping(name: str, value: Any) -> dict[str, Any]:
    """An object of JSON."""
    if not isinstance(value, dict):
        raise ValueError(f"'{name}' is not a mapping")
    return value


def checked_record(kind: type, numbers: Any, arrays: Mapping[str, Any]) -> Any:
    """A dataclass from its numbers, each of the type of its field, and its arrays."""
    types = {field.name: field.type for field in fields(kind)}
    checked_mapping(kind.__name__, numbers)
    require_names(kind.__name__, {**numbers, **arrays}, {*types})
    typed = {name: checked_type(name, value, str(types[name])) for name, value in numbers.items()}
    return kind(**typed, **arrays)


def numbers_of(record: Any) -> dict[str, Any]:
    """Fields of a dataclass that JSON can hold."""
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in known.items()}
    return {n: v for n, v in plain.items() if isinstance(v, (bool, int, float, str, type(None)))}


def arrays_of(prefix: str, record: Any) -> dict[str, np.ndarray]:
    """Fields of a dataclass that are arrays, their names with a prefix."""
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    return {f"{prefix}.{name}": v for name, v in known.items() if isinstance(v, np.ndarray)}
