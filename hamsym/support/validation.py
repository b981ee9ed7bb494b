"""Argument checks that raise InputError."""

from __future__ import annotations

import math
import sys
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.errors import InputError


def require(valid: bool, name: str, value: object, expected: str) -> None:
    """Raise InputError unless an argument is valid."""
    if not valid:
        raise InputError(f"{name}={shown(value)} cannot be used; give {expected}")


def shown(value: object) -> str:
    """Return a value as text of at most 60 characters for a message."""
    try:
        text = repr(value)
    except Exception:  # Python refuses to write integers of more than 4,300 digits
        return f"<{type(value).__name__}>"
    return text if len(text) <= 60 else text[:57] + "..."


def require_whole(name: str, value: object, least: int = 1, most: int = 2**63 - 1) -> None:
    """Raise InputError unless a value is a whole number from ``least`` to ``most``."""
    number = isinstance(value, (int, np.integer)) and not isinstance(value, bool)
    whole = number and least <= value <= most  # type: ignore[operator]
    limit = "" if most == 2**63 - 1 else f" to {most}"
    require(whole, name, value, f"a whole number from {least}{limit}")


def require_number(name: str, value: object, least: float = -math.inf) -> None:
    """Raise InputError unless a value is a finite number from ``least``."""
    number = _is_finite(value) and value >= least  # type: ignore[operator]
    require(number, name, value, "a number" if least == -math.inf else f"a number from {least:g}")


def checked_mapping(name: str, value: Any, example: str) -> Mapping[Any, Any]:
    """Return a mapping, an empty one for None; raise InputError if a value is something else."""
    if not isinstance(value, Mapping | None):
        raise InputError(f"{name}={shown(value)} is not a mapping; give for example {example}")
    return {} if value is None else value


def checked_numbers(name: str, values: Any) -> np.ndarray:
    """Return real numbers as an array of floats; raise InputError if an entry is none."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biuf":
            array = np.asarray(values, dtype=object)
            if any(isinstance(entry, (complex, np.complexfloating, str)) for entry in array.flat):
                raise TypeError
        return array.astype(float, copy=False)
    except (TypeError, ValueError, OverflowError, RuntimeError):  # the last from a tensor of torch
        raise InputError(f"{name} has an entry that is not a real number; give numbers") from None


def outside_span(times: np.ndarray, span: Sequence[float], round_off: float = 4e-16) -> np.ndarray:
    """Return whether times are outside a span by more than relative round-off, or nan."""
    low, high = min(span), max(span)
    slack = round_off * max(abs(low), abs(high))
    return ~((times >= low - slack) & (times <= high + slack))


def require_widths(hidden: object) -> None:
    """Raise InputError unless a value is a list of the widths of hidden layers."""
    widths = tuple(hidden) if isinstance(hidden, Sequence) else ()
    if not widths or any(
        not isinstance(n, int) or isinstance(n, bool) or not 1 <= n <= 100_000 for n in widths
    ):
        raise InputError(f"hidden={hidden!r} is not a list of layer widths; give e.g. (50, 50)")


def require_positive(name: str, value: object) -> None:
    """Raise InputError unless a value is a finite number above 0."""
    require(is_positive(value), name, value, "a number above 0")


def is_positive(value: object) -> bool:
    """Return whether a value is a finite number above 0."""
    return _is_finite(value) and value > 0  # type: ignore[operator]


def _is_finite(value: object) -> bool:
    number = isinstance(value, (int, float, np.integer, np.floating))
    return number and abs(value) <= sys.float_info.max  # type: ignore[arg-type]


def plain(value: Any) -> Any:
    """Return arrays and tuples as lists, whose ``repr`` has all digits."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [plain(part) for part in value] if isinstance(value, (tuple, list)) else value
