"""Ball: a number, or an array of numbers, known up to a radius."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.errors import InputError

__all__ = ["Ball"]

_TEXT = re.compile(r"\s*(?P<middle>\S+)\s*(\+-|\+/-|±)\s*(?P<radius>\S+)\s*")


@dataclass(frozen=True, eq=False)
class Ball:
    """All numbers x with \\|x - mid\\| <= radius; for arrays entry by entry.

    Attributes
    ----------
    mid, radius : float or numpy.ndarray
        Of the same shape; radius >= 0.

    Examples
    --------
    >>> g = Ball.of("9.81 +- 0.01")
    >>> g.contains(9.8), g.contains(9.83)
    (True, False)
    """

    mid: Any
    radius: Any

    def __post_init__(self) -> None:
        try:
            middle, radius = np.asarray(self.mid, dtype=float), np.asarray(self.radius, dtype=float)
        except (TypeError, ValueError):
            raise InputError("a Ball needs numbers: Ball(mid, radius)") from None
        if middle.shape != radius.shape:
            raise InputError(
                f"mid has the shape {middle.shape} and radius {radius.shape}; give equal shapes"
            )
        if not (np.isfinite(middle).all() and (radius >= 0).all()):
            raise InputError("a Ball needs a finite mid and a radius from 0 on")

    @classmethod
    def of(cls, value: Any) -> Ball:
        """Make the ball of a number, a pair (low, high), or a text such as "9.81 +- 0.01".

        The decimals of a text are exact: the radius covers that mid is their nearest float64.

        Raises
        ------
        InputError
            If the value is none of these.
        """
        if isinstance(value, Ball):
            if np.ndim(value.mid):
                raise InputError("a Ball of one number is expected here, not of an array")
            return value
        if isinstance(value, str):
            return _of_text(value)
        if isinstance(value, (tuple, list)) and len(value) == 2:
            low, high = (_exact(part) for part in value)
            if not low <= high:
                raise InputError(f"the interval {tuple(value)!r} is empty; give (low, high)")
            return _around((low + high) / 2, (high - low) / 2)
        exact = _exact(value)
        return _around(exact, Fraction(0))

    @property
    def lower(self) -> Any:
        """A lower bound on the numbers, rounded down."""
        return np.nextafter(np.subtract(self.mid, self.radius), -math.inf)

    @property
    def upper(self) -> Any:
        """An upper bound on the numbers, rounded up."""
        return np.nextafter(np.add(self.mid, self.radius), math.inf)

    @property
    def width(self) -> float:
        """The largest of the differences upper - lower."""
        return float(np.max(np.subtract(self.upper, self.lower)))

    def contains(self, values: Any) -> bool:
        """Whether all of the values, float64 numbers, are in the ball, decided exactly."""
        triples = np.broadcast_arrays(values, self.mid, self.radius)
        return all(
            math.isfinite(value) and abs(Fraction(value) - Fraction(mid)) <= Fraction(radius)
            if math.isfinite(radius)
            else math.isfinite(value)
            for value, mid, radius in zip(*(part.ravel().tolist() for part in triples), strict=True)
        )


def _of_text(text: str) -> Ball:
    if found := _TEXT.fullmatch(text):
        middle, radius = _exact(found["middle"]), _exact(found["radius"])
        if not radius >= 0:
            raise InputError(f"the radius in '{text}' is negative; give 'mid +- radius'")
        return _around(middle, radius)
    return _around(_exact(text), Fraction(0))


def _exact(value: Any) -> Fraction:
    try:
        if isinstance(value, str):
            if len(value) > 100 or len(value.lower().partition("e")[2]) > 5:
                raise ValueError
            return Fraction(value.strip())
        return Fraction(float(value))
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise InputError(
            f"{value!r} is not a finite number; give a number, (low, high) or 'mid +- radius'"
        ) from None


def _around(middle: Fraction, radius: Fraction) -> Ball:
    try:
        nearest = float(middle)
        size = radius + abs(middle - Fraction(nearest))
        bound = float(size)
    except OverflowError:
        raise InputError("a ball beyond the range of float64; give smaller numbers") from None
    return Ball(nearest, bound if Fraction(bound) >= size else math.nextafter(bound, math.inf))
