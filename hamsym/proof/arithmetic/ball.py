"""Ball: a number, or an array of numbers, known up to a radius."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from decimal import Decimal
from fractions import Fraction
from numbers import Rational
from typing import Annotated, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.proof.arithmetic.directed import float_above, next_down, next_up
from hamsym.support.record_fields import convert, floats

_BEYOND = "a ball beyond the range of float64; give smaller numbers"
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
        floats = type(self.mid) is type(self.radius) is float
        if floats and math.isfinite(self.mid) and self.radius >= 0:
            return
        if _is_scalar(self.mid) and _is_scalar(self.radius):
            exact, radius = _exact(self.mid), _radius(self.radius)
            nearest, bound = _nearest(exact, Fraction(radius) if math.isfinite(radius) else None)
            object.__setattr__(self, "mid", nearest)
            object.__setattr__(self, "radius", bound)
            return
        try:
            middle, radii = np.asarray(self.mid, dtype=float), np.asarray(self.radius, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise InputError("a Ball needs numbers: Ball(mid, radius)") from None
        if middle.shape != radii.shape:
            raise InputError(
                f"mid has the shape {middle.shape} and radius {radii.shape}; give equal shapes"
            )
        if not (np.isfinite(middle).all() and (radii >= 0).all()):
            raise InputError("a Ball needs a finite mid and a radius from 0 on")
        object.__setattr__(self, "mid", middle)
        object.__setattr__(self, "radius", radii)

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
        if type(value) is float and math.isfinite(value):
            return Ball(value, 0.0)
        if isinstance(value, str):
            return _of_text(value)
        if isinstance(value, (tuple, list)) and len(value) == 2:
            low, high = (_exact(part) for part in value)
            if not low <= high:
                raise InputError(f"the interval {tuple(value)!r} is empty; give (low, high)")
            return _around((low + high) / 2, (high - low) / 2)
        return _around(_exact(value), Fraction(0))

    @property
    def lower(self) -> Any:
        """A lower bound on the numbers, rounded down."""
        with np.errstate(over="ignore"):
            return next_down(np.subtract(self.mid, self.radius))

    @property
    def upper(self) -> Any:
        """An upper bound on the numbers, rounded up."""
        with np.errstate(over="ignore"):
            return next_up(np.add(self.mid, self.radius))

    @property
    def width(self) -> float:
        """The largest of the differences upper - lower."""
        return float(np.max(np.subtract(self.upper, self.lower)))

    def contains(self, values: Any) -> bool:
        """Whether all of the values, float64 numbers, are in the ball, decided exactly.

        Raises
        ------
        InputError
            If the values are not numbers, or have another shape.
        """
        try:
            numbers = np.asarray(values, dtype=float)
            triples = np.broadcast_arrays(numbers, self.mid, self.radius)
        except (TypeError, ValueError, OverflowError):
            raise InputError(
                f"values must be numbers of the shape {np.shape(self.mid)} of the ball"
            ) from None
        return all(
            math.isfinite(value)
            and (
                not math.isfinite(radius)
                or abs(Fraction(value) - Fraction(mid)) <= Fraction(radius)
            )
            for value, mid, radius in zip(*(part.ravel().tolist() for part in triples), strict=True)
        )


def _is_scalar(value: Any) -> bool:
    return not isinstance(value, (list, tuple)) and np.ndim(value) == 0


def _of_text(text: str) -> Ball:
    if found := _TEXT.fullmatch(text):
        middle, radius = _exact(found["middle"]), _exact(found["radius"])
        if not radius >= 0:
            raise InputError(f"the radius in '{text}' is negative; give 'mid +- radius'")
        return _around(middle, radius)
    return _around(_exact(text), Fraction(0))


def _exact(value: Any) -> Fraction:
    """A number as it is: text, int, float, Fraction, Decimal or a rational number of sympy."""
    try:
        if isinstance(value, str):
            if len(value) > 100 or len(value.lower().partition("e")[2]) > 5:
                raise ValueError
            return Fraction(value.strip())
        if isinstance(value, (float, Decimal)):
            return Fraction(value)
        if isinstance(value, Rational):
            return Fraction(int(value.numerator), int(value.denominator))
        if isinstance(value, np.floating):  # of any precision
            return Fraction(*map(int, value.as_integer_ratio()))
        if hasattr(value, "p") and hasattr(value, "q"):
            return Fraction(int(value.p), int(value.q))
        return Fraction(float(value))
    except (TypeError, ValueError, OverflowError, ZeroDivisionError):
        raise InputError(
            f"{value!r} is not a finite number; give a number, (low, high) or 'mid +- radius'"
        ) from None


def _radius(value: Any) -> float | Fraction:
    if value == math.inf:
        return math.inf
    found = _exact(value)
    if not found >= 0:
        raise InputError("a Ball needs a finite mid and a radius from 0 on")
    return found


def _nearest(middle: Fraction, radius: Fraction | None) -> tuple[float, float]:
    """The nearest float64, and the radius around it, None being infinite, rounded up."""
    try:
        nearest = float(middle)
        if radius is None:
            return nearest, math.inf
    except OverflowError:
        raise InputError(_BEYOND) from None
    bound = float_above(radius + abs(middle - Fraction(nearest)))
    if not bound < math.inf:
        raise InputError(_BEYOND)
    return nearest, bound


def _around(middle: Fraction, radius: Fraction) -> Ball:
    return Ball(*_nearest(middle, radius))


_MID = Annotated[np.ndarray, floats("*axes")]
_RADIUS = Annotated[np.ndarray, floats("*axes", finite=False, least=0)]
convert(
    Ball,
    tuple[_MID, _RADIUS],
    lambda ball: tuple(np.asarray(part, dtype=float) for part in (ball.mid, ball.radius)),
    lambda numbers: Ball(*(part if part.ndim else part.item() for part in numbers)),
)
