"""Conversions between balls, floats, fractions and decimals with outward rounding.

``float(ball)`` and ``repr`` round to nearest, which does not give a bound. These functions compare
exact fractions and take the next number if rounding went the wrong way.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from decimal import ROUND_CEILING, Context, Decimal
from fractions import Fraction
from typing import TYPE_CHECKING

from flint import arb, ctx, fmpq

if TYPE_CHECKING:
    from hamsym.proof.arithmetic.ball import Ball

from hamsym.proof.arithmetic.directed import LARGEST, float_above

_LOCK = threading.RLock()
_BITS = 240  # of distances from two floats
_DIGITS = 9  # of the decimals in certificates
SMALLEST = 1e-300  # positive bound; below 1e-307 floats are coarser than nine digits
_MOST_BITS = 2_000  # before or behind the point of a number near the range of floats
_UPWARD = Context(prec=_DIGITS, rounding=ROUND_CEILING)


@contextmanager
def working(bits: int, terms: int = 2) -> Iterator[None]:
    """Set precision and series length of Arb temporarily.

    Both are global to the process, so that other threads wait until they are restored.

    - bits: Precision.
    - terms: Coefficients that a series keeps.
    """
    with _LOCK:
        before = ctx.prec, ctx.cap
        try:
            ctx.prec, ctx.cap = bits, terms
            yield
        finally:
            ctx.prec, ctx.cap = before


def ball(value: Fraction | float | int) -> arb:
    """A ball that contains a number; exact if the number is binary and fits the precision."""
    fraction = Fraction(value)
    return arb(fmpq(fraction.numerator, fraction.denominator))


def interval(low: Fraction, high: Fraction) -> arb:
    """A ball that contains all numbers from low to high."""
    return ball(low).union(ball(high))


def exact(number: arb) -> Fraction:
    """The midpoint of a ball."""
    mantissa, exponent = (int(part) for part in number.mid().man_exp())
    return Fraction(mantissa << exponent) if exponent >= 0 else Fraction(mantissa, 1 << -exponent)


def above(number: arb) -> float:
    """The smallest float64 that is not below any number in the ball.

    Infinite where the ball is not finite or beyond float64.
    """
    if not number.is_finite():
        return math.inf
    upper = number.upper()
    mantissa, exponent = (int(part) for part in upper.man_exp())
    size = mantissa.bit_length() + exponent  # 2**size is above the magnitude
    if mantissa and abs(size) > _MOST_BITS:  # such a fraction may be too long for the memory
        low = size < 0
        return (math.ulp(0.0) if low else math.inf) if mantissa > 0 else (0.0 if low else -LARGEST)
    return float_above(exact(upper))


def below(number: arb) -> float:
    """The largest float64 that is not above any number in the ball."""
    return -above(-number)


def number_of(value: arb | Fraction) -> tuple[float, float, float]:
    """The ball (high, low, radius) of two floats around a ball of Arb or a fraction."""
    if not isinstance(value, Fraction) and not value.is_finite():
        return math.nan, math.nan, math.inf
    middle = value if isinstance(value, Fraction) else exact(value)
    try:
        high = float(middle)
        rest = middle - Fraction(high)
        low = float(rest)
    except OverflowError:
        return math.nan, math.nan, math.inf
    if not isinstance(value, Fraction):
        with working(_BITS):
            return high, low, above(abs(value - arb(high) - arb(low)))
    return high, low, float_above(abs(rest - Fraction(low)))


def vector_of(ball: Ball) -> list[arb]:
    """The entries of a ball of shape (n,) as balls of Arb."""
    return [arb(m, r) for m, r in zip(ball.mid.tolist(), ball.radius.tolist(), strict=True)]


def matrix_of(ball: Ball) -> list[list[arb]]:
    """The rows of a ball of shape (n, m) as balls of Arb."""
    rows = zip(ball.mid.tolist(), ball.radius.tolist(), strict=True)
    return [[arb(m, r) for m, r in zip(*row, strict=True)] for row in rows]


def float_balls(values: Sequence[arb]) -> tuple[list[float], list[float]]:
    """Mid-points in float64 of balls, and radii around them that contain the balls."""
    middle = [float(value.mid()) for value in values]
    return middle, [above(abs(v - arb(m))) for v, m in zip(values, middle, strict=True)]


def decimal_above(value: float) -> str:
    """The shortest decimal of nine digits that is not below a float64; tiny ones become 1e-300.

    Examples
    --------
    >>> decimal_above(0.1), decimal_above(1 / 3)
    ('0.100000001', '0.333333334')
    """
    if not math.isfinite(value):
        return repr(value)
    if -SMALLEST < value <= 0:
        return "0"
    value = max(value, SMALLEST) if value > 0 else value
    return decimal(float(_UPWARD.plus(Decimal(value))))


def decimal_below(value: float) -> str:
    """The largest decimal of nine digits that is not above a float64."""
    text = decimal_above(-value)
    return text[1:] if text.startswith("-") else "-" + text if text != "0" else "0"


def decimal(value: float) -> str:
    """The nearest decimal of nine digits; a float64 read from such a decimal gives it again.

    Examples
    --------
    >>> decimal(0.1), decimal(float("2.68374571e-12"))
    ('0.1', '2.68374571e-12')
    """
    return f"{value:.{_DIGITS}g}"


def at_most(value: float) -> float:
    """The largest float64 that is not above the decimal of another."""
    if not math.isfinite(value):
        return value
    return -float_above(-Fraction(decimal(value)))


def at_least(value: float) -> float:
    """The smallest float64 that is not below the decimal of another."""
    return -at_most(-value)
