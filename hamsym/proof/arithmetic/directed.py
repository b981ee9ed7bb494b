"""Directed operations: bounds in float64, whose operations round to nearest.

Numbers >= 0 are added and multiplied as they come, and the result is then moved by more than all
its roundings. Infinity and NaN remain what they are, and pass no test ``value <= bound``. The
kernel has the same operations under the same names (``balls.h``, ``series.h``).
"""

from __future__ import annotations

import math
import sys
from fractions import Fraction
from typing import Any

import numpy as np

#: u, the relative rounding of an operation.
UNIT = 2.0**-53
#: Of the mid-point of a ball that is a sum or a product, relative to its operands.
MIDDLE = 32 * UNIT * UNIT
#: Above all errors of operations that underflow, where factors are moderate.
TINY = 1e-290
#: 2^-1060, above the errors of 2^14 products that underflow; by its bits, which no setting of the
#: processor falsifies.
UNDERFLOW = np.array(1 << 14, dtype=np.uint64).view(np.float64).item()
#: The largest float64.
LARGEST = sys.float_info.max
# Above the relative error of 8 million roundings.
_ROOM = 1e-9
# Roundings beside those of the sum itself: of its terms, and of the bound.
_BESIDE = 32


def up(values: Any) -> Any:
    """An upper bound on what was computed as ``values`` by sums and products of numbers >= 0.

    It covers 8 million roundings, 2^23 u < 10^-9, but no underflow, for which TINY or UNDERFLOW is
    added.
    """
    return values * (1 + _ROOM)


def down(values: Any) -> Any:
    """A lower bound on what was computed as ``values`` by sums and products of numbers >= 0."""
    return values * (1 - _ROOM)


def sum_up(values: Any, terms: int = 1) -> Any:
    """An upper bound on sums of so many products >= 0 that were computed in float64.

    Each of n terms takes at most two roundings, and what is done beside the sum fewer than 32.
    """
    return values * (1 + 2 * (terms + _BESIDE) * UNIT) + TINY


def sum_down(values: Any, terms: int = 1) -> Any:
    """A lower bound on sums of so many products >= 0 that were computed in float64.

    Zero where underflow may count beside the result.
    """
    return np.where(values > TINY, values * (1 - 2 * (terms + _BESIDE) * UNIT), 0.0)


def nearest_up(value: float) -> float:
    """An upper bound on a number above TINY whose nearest float64 is given."""
    return value * (1 + 4 * UNIT)


def float_above(value: Fraction) -> float:
    """The smallest float64 that is not below a fraction; infinite beyond float64."""
    try:
        nearest = float(value)
    except OverflowError:
        return math.inf if value > 0 else -LARGEST
    return nearest if Fraction(nearest) >= value else math.nextafter(nearest, math.inf)


def next_up(values: Any) -> Any:
    """The next float64: an upper bound on what was rounded to nearest once."""
    return np.nextafter(values, math.inf)


def next_down(values: Any) -> Any:
    """The float64 before: a lower bound on what was rounded to nearest once."""
    return np.nextafter(values, -math.inf)


def two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """a + b rounded, and its error exactly: a low part within half an ulp (Knuth 1998)."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)
