"""Ranges of functions of one variable and of their slopes on intervals, vectorised.

Input:  a function at both ends of each interval, and bounds of it and of its slope in between.
Output: the same of formulas of such functions, for the texts of
        :mod:`hamsym.codegen.straight_line`.

A range is intersected with that between its ends: a function with slopes from a to b lies within
(b - a) w/4 of its chord on an interval of length w. So ranges are too wide by the order of w**2,
also where operands depend on each other. Rounding errors are not bounded.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np


class Intervals(NamedTuple):
    """Intervals [low, high] of equal shape; infinite where nothing is known."""

    low: np.ndarray
    high: np.ndarray

    def __add__(self, other: Intervals) -> Intervals:  # type: ignore[override]
        return Intervals(self.low + other.low, self.high + other.high)

    def __mul__(self, other: Intervals) -> Intervals:  # type: ignore[override]
        corners = [a * b for a in self for b in other]
        low = np.minimum(np.minimum(corners[0], corners[1]), np.minimum(corners[2], corners[3]))
        high = np.maximum(np.maximum(corners[0], corners[1]), np.maximum(corners[2], corners[3]))
        return _known(low, high)  # zero times infinity is unknown

    def __neg__(self) -> Intervals:
        return Intervals(-self.high, -self.low)

    def square(self) -> Intervals:
        """The squares of the numbers in each interval."""
        near = np.where((self.low <= 0) & (self.high >= 0), 0.0, np.minimum(*np.abs(self)))
        return _known(near**2, np.maximum(*np.abs(self)) ** 2)

    def reciprocal(self) -> Intervals:
        """1/x, unknown where an interval contains zero."""
        return _known(1 / self.high, 1 / self.low, (self.low > 0) | (self.high < 0))


def _known(low: np.ndarray, high: np.ndarray, where: Any = True) -> Intervals:
    """Intervals that are infinite where a condition fails or an end is not a number."""
    known = where & (low <= high)
    return Intervals(np.where(known, low, -np.inf), np.where(known, high, np.inf))


class Ranges:
    """A function on intervals: its values at both ends, its range, and that of its slope.

    - ends: Shape (2, n).
    - within, slope: Shape (n,).
    - width: Lengths of the intervals, shape (n,).
    """

    __slots__ = ("ends", "slope", "width", "within")

    def __init__(
        self, ends: np.ndarray, within: Intervals, slope: Intervals, width: np.ndarray
    ) -> None:
        bend = (slope.high - slope.low) * width / 4
        # fmax and fmin pass over NaN, as that of infinite slopes.
        low = np.fmax(within.low, np.fmin(ends[0], ends[1]) - bend)
        high = np.fmin(within.high, np.fmax(ends[0], ends[1]) + bend)
        self.ends, self.width, self.slope = ends, width, slope
        self.within = Intervals(low, high)

    @classmethod
    def of_slopes(cls, ends: np.ndarray, slope: Intervals, width: np.ndarray) -> Ranges:
        """A function of which only the slope is bounded."""
        unknown = np.full(ends.shape[1:], np.inf)
        return cls(ends, Intervals(-unknown, unknown), slope, width)

    @classmethod
    def constant(cls, value: Any) -> Ranges:
        """A number, or one for each interval."""
        value = np.atleast_1d(np.asarray(value, dtype=float))
        none = np.zeros(value.shape)
        return cls(np.stack([value, value]), Intervals(value, value), Intervals(none, none), none)

    def __add__(self, other: Ranges | int) -> Ranges:
        other = _ranges(other)
        return Ranges(
            self.ends + other.ends,
            self.within + other.within,
            self.slope + other.slope,
            np.maximum(self.width, other.width),
        )

    __radd__ = __add__

    def __neg__(self) -> Ranges:
        return Ranges(-self.ends, -self.within, -self.slope, self.width)

    def __sub__(self, other: Ranges | int) -> Ranges:
        return self + -_ranges(other)

    def __rsub__(self, other: int) -> Ranges:
        return -self + other

    def __mul__(self, other: Ranges | int) -> Ranges:
        if other is self:
            twice = Ranges.constant(2.0).within * self.within
            return Ranges(self.ends**2, self.within.square(), twice * self.slope, self.width)
        other = _ranges(other)
        return Ranges(
            self.ends * other.ends,
            self.within * other.within,
            self.within * other.slope + self.slope * other.within,
            np.maximum(self.width, other.width),
        )

    __rmul__ = __mul__


def _ranges(value: Ranges | int) -> Ranges:
    return value if isinstance(value, Ranges) else Ranges.constant(value)


def _increasing(
    function: Callable[[Any], Any],
    derivative: Callable[[Intervals], Intervals],
    lowest: float = -math.inf,
    highest: float = math.inf,
) -> Any:
    """A method that increases between two numbers and is unknown beyond."""

    def apply(x: Ranges) -> Ranges:
        low, high = x.within
        within = _known(function(low), function(high), (low >= lowest) & (high <= highest))
        return Ranges(function(x.ends), within, derivative(x.within) * x.slope, x.width)

    return staticmethod(apply)


def _root(x: Intervals) -> Intervals:
    return _known(np.sqrt(x.low), np.sqrt(x.high), x.low >= 0)


def _shifted(sign: int, square: Intervals) -> Intervals:
    """1 + sign x**2 of the squares."""
    low, high = (sign * square.low, sign * square.high)[::sign]
    return Intervals(1 + low, 1 + high)


def _even(x: Intervals, function: Callable[[Any], Any]) -> Intervals:
    """An even function that grows with the magnitude."""
    square = x.square()
    return _known(function(np.sqrt(square.low)), function(np.sqrt(square.high)))


def _wave(x: Intervals, crest: float, function: Callable[[Any], Any]) -> Intervals:
    """A sine or cosine, with maxima at ``crest`` and its multiples of 2 pi."""
    ends = function(x.low), function(x.high)

    def reaches(phase: float) -> np.ndarray:
        turns = 2 * np.pi
        return np.floor((x.high - phase) / turns) >= np.ceil((x.low - phase) / turns)

    found = np.isfinite(x.low) & np.isfinite(x.high)
    low = np.where(~found | reaches(crest + np.pi), -1.0, np.minimum(*ends))
    high = np.where(~found | reaches(crest), 1.0, np.maximum(*ends))
    return Intervals(low, high)


def _sine(x: Intervals) -> Intervals:
    return _wave(x, np.pi / 2, np.sin)


def _cosine(x: Intervals) -> Intervals:
    return _wave(x, 0.0, np.cos)


def _error_function(x: Any) -> Any:
    from scipy.special import erf  # slow to import

    return erf(x)


def _bell(x: Intervals) -> Intervals:
    """The slope of the error function."""
    size = 2 / math.sqrt(math.pi)
    high, low = (size * np.exp(-square) for square in x.square())
    return Intervals(low, high)


class RangeArithmetic:
    """Functions of ranges, by the names of :data:`hamsym.codegen.straight_line.FUNCTIONS`.

    Examples
    --------
    >>> one = np.ones(1)
    >>> x = Ranges.of_slopes(np.array([[0.0], [1.0]]), Intervals(one, one), one)
    >>> found = RangeArithmetic().cos(x)
    >>> found.within.low.round(3), found.slope.low.round(3)
    (array([0.54]), array([-0.841]))
    """

    pi, e = Ranges.constant(math.pi), Ranges.constant(math.e)

    exp = _increasing(np.exp, lambda x: _known(np.exp(x.low), np.exp(x.high)))
    log = _increasing(np.log, Intervals.reciprocal, 0.0)
    sinh = _increasing(np.sinh, lambda x: _even(x, np.cosh))
    tanh = _increasing(np.tanh, lambda x: _even(x, np.cosh).square().reciprocal())
    asinh = _increasing(np.arcsinh, lambda x: _root(_shifted(1, x.square())).reciprocal())
    atan = _increasing(np.arctan, lambda x: _shifted(1, x.square()).reciprocal())
    asin = _increasing(np.arcsin, lambda x: _root(_shifted(-1, x.square())).reciprocal(), -1, 1)
    atanh = _increasing(np.arctanh, lambda x: _shifted(-1, x.square()).reciprocal(), -1, 1)
    erf = _increasing(_error_function, _bell)
    root = _increasing(np.sqrt, lambda x: Ranges.constant(0.5).within * _root(x).reciprocal(), 0)

    @staticmethod
    def number(numerator: int, denominator: int = 1) -> Ranges:
        return Ranges.constant(numerator / denominator)

    @staticmethod
    def reciprocal(x: Ranges) -> Ranges:
        within = x.within.reciprocal()
        return Ranges(1 / x.ends, within, -within.square() * x.slope, x.width)

    def reciprocal_root(self, x: Ranges) -> Ranges:
        return self.reciprocal(self.root(x))

    def sin(self, x: Ranges) -> Ranges:
        return Ranges(np.sin(x.ends), _sine(x.within), _cosine(x.within) * x.slope, x.width)

    def cos(self, x: Ranges) -> Ranges:
        return Ranges(np.cos(x.ends), _cosine(x.within), -_sine(x.within) * x.slope, x.width)

    def tan(self, x: Ranges) -> Ranges:
        return self.sin(x) * self.reciprocal(self.cos(x))

    def cosh(self, x: Ranges) -> Ranges:
        slope = _known(np.sinh(x.within.low), np.sinh(x.within.high)) * x.slope
        return Ranges(np.cosh(x.ends), _even(x.within, np.cosh), slope, x.width)

    def acos(self, x: Ranges) -> Ranges:
        return Ranges.constant(math.pi / 2) - self.asin(x)

    def acosh(self, x: Ranges) -> Ranges:
        square = x.within.square()
        below = _root(Intervals(square.low - 1, square.high - 1))
        within = _known(np.arccosh(x.within.low), np.arccosh(x.within.high), x.within.low >= 1)
        return Ranges(np.arccosh(x.ends), within, below.reciprocal() * x.slope, x.width)

    def general_power(self, x: Ranges, exponent: Ranges) -> Ranges:
        return self.exp(exponent * self.log(x))

    @staticmethod
    def atan2(y: Ranges, x: Ranges) -> Ranges:
        """The angle, unknown where a box contains points of the cut or the origin."""
        corners = [np.arctan2(b, a) for b in y.within for a in x.within]
        clear = (x.within.low > 0) | (y.within.low > 0) | (y.within.high < 0)
        radius = (x.within.square() + y.within.square()).reciprocal()
        slope = (x.within * y.slope + -(y.within * x.slope)) * radius
        # The angle of a box that does not contain the origin is extremal at its corners.
        within = _known(np.minimum.reduce(corners), np.maximum.reduce(corners), clear)
        unknown = np.where(clear, 0.0, np.inf)
        return Ranges(
            np.arctan2(y.ends, x.ends),
            within,
            Intervals(slope.low - unknown, slope.high + unknown),
            np.maximum(x.width, y.width),
        )
