"""Arithmetic of Chebyshev models on many intervals at once.

A model of a function on an interval is a polynomial of degree at most :data:`DEGREE` with a bound
on the distance to the function, and a range. A feature of any width inside the interval, for
example a pulse between all sampled places, is part of that distance. Roundings are not counted.

The polynomial is stored by its values at :data:`PLACES` Chebyshev points, enough for a product of
two polynomials: what a product has beyond the degree is truncated, and the truncated coefficients
are added to the distance. A function f(g) is guessed at the points and bounded afterwards, by an
equation that f satisfies: 1 - q p for a reciprocal, p - q^2 for a root, the differential equations
of the others. Where a guess is worse than the range of f(g), a constant takes its place, so that
an unresolved function costs its range and nothing more (Makino & Berz 2003 for Taylor models;
Brisebarre & Joldes 2010 for Chebyshev models).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.polynomial import chebyshev
from scipy import special

DEGREE = 31  # of the polynomials: the columns of the march have 1e-14 beyond it
PLACES = 2 * DEGREE + 2  # enough for products
#: Places in [-1, 1], ascending.
NODES = -np.cos((2 * np.arange(PLACES) + 1) * math.pi / (2 * PLACES))

_ANGLES = np.outer(2 * np.arange(PLACES) + 1, np.arange(PLACES)) % (4 * PLACES)
# Coefficients -> values; the table of the recurrence would be off by tens of roundings.
_VALUES = np.cos(_ANGLES * (math.pi / (2 * PLACES))) * (-1.0) ** np.arange(PLACES)
_WEIGHTS = np.full(PLACES, 2.0 / PLACES)
_WEIGHTS[0] = 1.0 / PLACES
_COEFFICIENTS = np.ascontiguousarray(_VALUES * _WEIGHTS)  # values -> coefficients, from the right
_HIGH = np.ascontiguousarray(_VALUES[:, DEGREE + 1 :].T)  # high coefficients -> values
_SLOPES = chebyshev.chebder(np.eye(DEGREE + 1)).T @ _VALUES[:, :DEGREE].T  # low coefficients ->
_INTEGRALS = (
    _COEFFICIENTS @ chebyshev.chebint(np.eye(PLACES), lbnd=NODES[PLACES // 2]).T
)  # values -> coefficients of the integral from the place in the middle
# A polynomial of this degree exceeds its largest value at the points by this factor at most
# (Ehlich & Zeller 1964).
_BETWEEN = 1 / math.cos(math.pi * DEGREE / (2 * PLACES))
_MIDDLE = PLACES // 2
_UNIT = 4 * 2.0**-52  # rounding of values by one operation, relative to their size
_TINY = 5e-324  # what underflows to zero

Number: TypeAlias = "float | np.ndarray"


@dataclass(frozen=True, eq=False)
class Models:
    """Functions on intervals, each mapped to [-1, 1].

    Attributes
    ----------
    values : numpy.ndarray
        Of the polynomials at the places, shape (n, PLACES).
    error : numpy.ndarray
        Bound on the distance of function and polynomial, shape (n,).
    rounding : numpy.ndarray
        Rounding errors of the values, which the distance leaves out, shape (n,).
    low, high : numpy.ndarray
        Bounds on the function, shape (n,).
    """

    values: np.ndarray
    error: np.ndarray
    rounding: np.ndarray
    low: np.ndarray
    high: np.ndarray

    __array_ufunc__ = None  # so that an array of numbers times models is a model

    @classmethod
    def of_values(
        cls,
        values: np.ndarray,
        low: Any = -math.inf,
        high: Any = math.inf,
        rounding: Any = 0.0,
    ) -> Models:
        """Make models of polynomials from their values, with a range if it is known.

        What smooth functions have beyond the degree is part of the distance.
        """
        rounding = np.broadcast_to(rounding, len(values))
        kept, lost = _truncated(values, rounding)
        return _tightened(kept, lost, rounding, low, high)

    def __neg__(self) -> Models:
        return Models(-self.values, self.error, self.rounding, -self.high, -self.low)

    def __add__(self, other: Models | Number) -> Models:
        if not isinstance(other, Models):
            number = _column(other)
            values, shift = self.values + number, number[..., 0]
            rounding = self.rounding + _UNIT * _size(values)
            return Models(values, self.error, rounding, self.low + shift, self.high + shift)
        return _tightened(
            self.values + other.values,
            self.error + other.error,
            self.rounding + other.rounding,
            self.low + other.low,
            self.high + other.high,
        )

    __radd__ = __add__

    def __sub__(self, other: Models | Number) -> Models:
        return self + (-other)

    def __rsub__(self, other: Number) -> Models:
        return (-self) + other

    def __mul__(self, other: Models | Number) -> Models:
        if not isinstance(other, Models):
            number = _column(other)
            ends = self.low * number[..., 0], self.high * number[..., 0]
            return Models(
                self.values * number,
                self.error * np.abs(number[..., 0]),
                self.rounding * np.abs(number[..., 0]),
                np.minimum(*ends),
                np.maximum(*ends),
            )
        rounding = _no_nan(self.rounding * _size(other.values))
        rounding = rounding + _no_nan(other.rounding * _size(self.values))
        values, lost = _truncated(self.values * other.values, rounding)
        error = (
            lost
            + _no_nan(self.error * _largest(other.values))
            + _no_nan(other.error * (_largest(self.values) + self.error))
        )
        if other is self:
            largest = np.maximum(self.high, -self.low)
            smallest = np.maximum(np.maximum(self.low, -self.high), 0.0)
            return _tightened(values, error, rounding, smallest**2, largest**2)
        products = [
            _no_nan(one * two) for one in (self.low, self.high) for two in (other.low, other.high)
        ]
        low, high = np.minimum.reduce(products), np.maximum.reduce(products)
        return _tightened(values, error, rounding, low, high)

    __rmul__ = __mul__

    @property
    def magnitude(self) -> np.ndarray:
        """Bound on the size of the functions, shape (n,)."""
        return np.asarray(np.maximum(np.abs(self.low), np.abs(self.high)))


def _column(number: Number) -> np.ndarray:
    """Return a number, or one for each interval, with an axis for the places."""
    return np.asarray(number, dtype=float)[..., None]


def _no_nan(products: np.ndarray) -> np.ndarray:
    """Replace 0 times infinity, of bounds, by 0."""
    return np.where(np.isnan(products), 0.0, products)


def _largest(values: np.ndarray) -> np.ndarray:
    """Bound polynomials of degree DEGREE."""
    return np.asarray(_BETWEEN * np.abs(values).max(axis=1))


def _size(values: np.ndarray) -> np.ndarray:
    """Return the largest magnitude of values, shape (n,)."""
    return np.asarray(np.abs(values).max(axis=1))


def _sum(coefficients: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """Add magnitudes of coefficients that are not roundings."""
    return np.asarray(np.maximum(np.abs(coefficients) - rounding[:, None], 0.0).sum(axis=1))


def _total(values: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """Bound polynomials by the sum of their coefficients."""
    return _sum(values @ _COEFFICIENTS, rounding)


def _truncated(values: np.ndarray, rounding: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Truncate polynomials to DEGREE; return their values and the bound on what is lost."""
    # Without the constant, which has no high coefficients but those of its roundings.
    high = (values - values[:, _MIDDLE, None]) @ _COEFFICIENTS[:, DEGREE + 1 :]
    return values - high @ _HIGH, _sum(high, rounding + _UNIT * _size(values))


def _slopes(g: Models) -> np.ndarray:
    """Differentiate the polynomials, without coefficients that are roundings."""
    coefficients = (g.values - g.values[:, _MIDDLE, None]) @ _COEFFICIENTS[:, : DEGREE + 1]
    kept = np.abs(coefficients) > (g.rounding + _UNIT * _size(g.values))[:, None]
    return np.asarray(np.where(kept, coefficients, 0.0) @ _SLOPES)


def _defect(values: np.ndarray, slopes: np.ndarray, rounding: np.ndarray) -> np.ndarray:
    """Bound the difference of a polynomial and the integral of its supposed slopes.

    Both are compared with their values in the middle of the interval.
    """
    integral = slopes @ _INTEGRALS
    integral[:, :PLACES] -= (values - values[:, _MIDDLE, None]) @ _COEFFICIENTS
    return _sum(integral, rounding + _UNIT * (_size(values) + _size(slopes)))


def _tightened(values: np.ndarray, error: np.ndarray, rounding: Any, low: Any, high: Any) -> Models:
    """Make models whose range is that of the polynomial, or the given one where it is smaller.

    A polynomial that is further from the function than the middle of the range is replaced by it.
    """
    top, bottom = values.max(axis=1), values.min(axis=1)
    middle, half = (top + bottom) / 2, _BETWEEN * (top - bottom) / 2 + error
    # Where the polynomial is NaN, the given range stays.
    low, high = np.fmax(low, middle - half), np.fmin(high, middle + half)
    half = (high - low) / 2
    with np.errstate(invalid="ignore"):
        worse = ~(error <= half)
    if worse.any():
        middle = np.where(np.isfinite(half), low + half, 0.0)
        half = np.where(np.isfinite(half), np.maximum(half, 0.0), math.inf)
        values = np.where(worse[:, None], middle[:, None], values)
        error = np.where(worse, half, error)
        rounding = np.where(worse, 0.0, rounding)
    rounding = rounding + _UNIT * np.maximum(np.abs(top), np.abs(bottom))
    return Models(values, error, np.where(np.isnan(rounding), 0.0, rounding), low, high)


def _selected(condition: np.ndarray, one: Models, other: Models) -> Models:
    """Choose for each interval the model of one function or of another."""
    return Models(
        np.where(condition[:, None], one.values, other.values),
        np.where(condition, one.error, other.error),
        np.where(condition, one.rounding, other.rounding),
        np.where(condition, one.low, other.low),
        np.where(condition, one.high, other.high),
    )


def _ranged(low: np.ndarray, high: np.ndarray) -> Models:
    """Make models of functions of which only the range is known."""
    values = np.full((len(low), PLACES), math.nan)
    return _tightened(values, np.full(len(low), math.inf), 0.0, low, high)


def _integrated(guess: np.ndarray, slope: Models, g: Models, low: Any, high: Any) -> Models:
    """Make models of f(g) from values at the places and a model of f'(g).

    With p the polynomial of g, f(p) differs from its value in the middle by the integral of
    f'(p) p'.
    """
    rounding = _no_nan(g.rounding * _size(slope.values))
    values, _ = _truncated(guess, rounding)
    rate = _slopes(g)
    defect = _defect(values, slope.values * rate, rounding)
    defect = defect + 2 * _no_nan(slope.error * _largest(rate))
    error = np.abs(guess[:, _MIDDLE] - values[:, _MIDDLE]) + defect
    return _tightened(values, error + _no_nan(g.error * slope.magnitude), rounding, low, high)


def _leaves(g: Models, lowest: float, highest: float) -> np.ndarray:
    """Whether functions leave a domain; ranges may do so although the functions do not."""
    slack = (g.error + g.rounding)[:, None]
    beyond = (g.values < lowest - slack) | (g.values > highest + slack)
    return np.asarray(beyond.any(axis=1) | (g.high < lowest) | (g.low > highest))


def reciprocal(g: Models) -> Models:
    """1/g; unbounded where the range of g has a zero inside."""
    positive, negative = g.low >= 0, g.high <= 0
    exact = 1 / g.values
    share = _no_nan(g.rounding * _size(exact))  # relative
    guess, _ = _truncated(exact, share * _size(exact))
    smallest = np.where(positive, g.low, -g.high)
    size = 1 + (np.abs(g.values) * np.abs(guess)).max(axis=1)
    defect = _total(1 - g.values * guess, share + _UNIT * size)
    defect = defect + _no_nan(g.error * _largest(guess))
    error = np.where(smallest > 0, defect / smallest, math.inf)
    low = np.where(positive | negative, np.where(g.high == 0, -math.inf, 1 / g.high), -math.inf)
    high = np.where(positive | negative, np.where(g.low == 0, math.inf, 1 / g.low), math.inf)
    return _tightened(guess, error, share * _size(exact), low, high)


def root(g: Models) -> Models:
    """sqrt(g), where g is not negative."""
    low, high = np.sqrt(np.maximum(g.low, 0.0)), np.sqrt(np.maximum(g.high, 0.0))
    high = np.where(_leaves(g, 0.0, math.inf), math.inf, high)
    exact = np.sqrt(np.maximum(g.values, 0.0))
    least = exact.min(axis=1)
    rounding = np.where(least > 0, g.rounding / (2 * least), 0.0)
    guess, _ = _truncated(exact, rounding)
    defect = _total(g.values - guess * guess, g.rounding + _UNIT * _size(g.values)) + g.error
    error = np.where(low > 0, defect / low, math.inf)
    return _tightened(guess, error, rounding, low, high)


def reciprocal_root(g: Models) -> Models:
    """1/sqrt(g)."""
    return reciprocal(root(g))


def exponential(g: Models) -> Models:
    """exp(g), from the equation f' = g' f."""
    exact = np.exp(g.values)
    rounding = _no_nan(g.rounding * _size(exact))
    guess, _ = _truncated(exact, rounding)
    low, high = np.exp(g.low), np.exp(g.high)
    # With w = f(p) - q the defect is that of w = w_0 + integral of p' w (Gronwall).
    rate = _slopes(g)
    defect = _defect(guess, rate * guess, rounding)
    start = np.abs(exact[:, _MIDDLE] - guess[:, _MIDDLE]) + _TINY
    growth = np.exp(g.high - g.low + 2 * g.error)
    error = growth * start + defect * (1 + 2 * _largest(rate) * growth)
    error = error + _no_nan(high * np.expm1(g.error))
    return _tightened(guess, error, rounding, low, high)


def _circular(g: Models) -> tuple[Models, Models]:
    """sin(g) and cos(g), from the rotation (sin, cos)' = g' (cos, -sin)."""
    rate = _slopes(g)
    sine, _ = _truncated(np.sin(g.values), g.rounding)
    cosine, _ = _truncated(np.cos(g.values), g.rounding)
    defect = np.hypot(
        _defect(sine, rate * cosine, g.rounding), _defect(cosine, -rate * sine, g.rounding)
    )
    middle = g.values[:, _MIDDLE]
    start = np.hypot(np.sin(middle) - sine[:, _MIDDLE], np.cos(middle) - cosine[:, _MIDDLE])
    error = start + defect * (1 + 2 * _largest(rate)) + g.error
    ranges = (
        _periodic_range(np.sin, math.pi / 2, g.low, g.high),
        _periodic_range(np.cos, 0.0, g.low, g.high),
    )
    return (
        _tightened(sine, error, g.rounding, *ranges[0]),
        _tightened(cosine, error, g.rounding, *ranges[1]),
    )


def _periodic_range(
    function: Callable[[np.ndarray], np.ndarray], peak: float, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Range on intervals of the sine or the cosine, which is 1 at ``peak``."""
    ends, turn = (function(low), function(high)), 2 * math.pi
    # A hair wider, since the turning points are rounded.
    hair = 1e-9

    def holds(place: float) -> np.ndarray:
        first = np.ceil((low - hair - place) / turn)
        return np.asarray(np.floor((high + hair - place) / turn) >= first)

    unknown = ~(np.isfinite(low) & np.isfinite(high))
    return (
        np.where(holds(peak + math.pi) | unknown, -1.0, np.fmin(*ends)),
        np.where(holds(peak) | unknown, 1.0, np.fmax(*ends)),
    )


def sine(g: Models) -> Models:
    """sin(g)."""
    return _circular(g)[0]


def cosine(g: Models) -> Models:
    """cos(g)."""
    return _circular(g)[1]


def tangent(g: Models) -> Models:
    """tan(g)."""
    sin, cos = _circular(g)
    return sin * reciprocal(cos)


def _monotonic(
    function: Callable[[np.ndarray], np.ndarray],
    slope: Callable[[Models], Models],
    lowest: float = -math.inf,
    highest: float = math.inf,
) -> Callable[[Models], Models]:
    """Make f(g) for a function that grows between two numbers, and its derivative."""

    def composed(g: Models) -> Models:
        guess = function(g.values)
        inside = ~_leaves(g, lowest, highest)
        low = np.where(inside, function(np.maximum(g.low, lowest)), -math.inf)
        high = np.where(inside, function(np.minimum(g.high, highest)), math.inf)
        return _integrated(guess, slope(g), g, low, high)

    return composed


logarithm = _monotonic(np.log, reciprocal, lowest=0.0)
arctangent = _monotonic(np.arctan, lambda g: reciprocal(g * g + 1.0))
inverse_sine_hyperbolic = _monotonic(np.arcsinh, lambda g: reciprocal_root(g * g + 1.0))
inverse_cosine_hyperbolic = _monotonic(
    np.arccosh, lambda g: reciprocal_root(g * g - 1.0), lowest=1.0
)
inverse_tangent_hyperbolic = _monotonic(
    np.arctanh, lambda g: reciprocal(1.0 - g * g), lowest=-1.0, highest=1.0
)
arcsine = _monotonic(np.arcsin, lambda g: reciprocal_root(1.0 - g * g), lowest=-1.0, highest=1.0)
error_function = _monotonic(special.erf, lambda g: exponential(-(g * g)) * (2 / math.sqrt(math.pi)))


def arccosine(g: Models) -> Models:
    """acos(g)."""
    return math.pi / 2 - arcsine(g)


def hyperbolic_tangent(g: Models) -> Models:
    """tanh(g) = 1 - 2/(1 + exp(2 g))."""
    found = 1.0 - 2.0 * reciprocal(exponential(2.0 * g) + 1.0)
    return _tightened(found.values, found.error, found.rounding, np.tanh(g.low), np.tanh(g.high))


def hyperbolic_sine(g: Models) -> Models:
    """sinh(g)."""
    found = 0.5 * (exponential(g) - exponential(-g))
    return _tightened(found.values, found.error, found.rounding, np.sinh(g.low), np.sinh(g.high))


def hyperbolic_cosine(g: Models) -> Models:
    """cosh(g)."""
    return 0.5 * (exponential(g) + exponential(-g))


def general_power(base: Models, exponent: Models | Number) -> Models:
    """Base to the power of an exponent, of which one may be a number; exp(exponent log(base))."""
    if not isinstance(base, Models):
        return exponential(exponent * np.log(base))
    if not isinstance(exponent, Models) and np.ndim(exponent) == 0:
        return _number_power(base, float(exponent))
    return exponential(logarithm(base) * exponent)


def _number_power(g: Models, exponent: float) -> Models:
    """g**exponent, from the equation f' = exponent g'/g f: the logarithm would lose digits."""
    size = abs(exponent)
    exact = np.maximum(g.values, 0.0) ** exponent
    rounding = _no_nan(size * g.rounding / g.values.min(axis=1) * _size(exact))
    guess, _ = _truncated(exact, rounding)
    inverse, slopes = reciprocal(g), _slopes(g)
    rate, lost = _truncated(exponent * slopes * inverse.values, np.zeros(len(guess)))
    lost = lost + _no_nan(size * inverse.error * _largest(slopes))
    defect = _defect(guess, rate * guess, rounding) + 2 * _no_nan(lost * _largest(guess))
    start = np.abs(exact[:, _MIDDLE] - guess[:, _MIDDLE]) + _TINY
    ends = [np.maximum(end, 0.0) ** exponent for end in (g.low, g.high)]
    low, high = np.minimum(*ends), np.maximum(*ends)
    growth = (g.high / g.low) ** size
    error = growth * start + defect * (1 + 2 * _largest(rate) * growth)
    error = error + _no_nan(high * np.expm1(size * g.error / g.low))
    error = np.where(g.low > 0, error, math.inf)
    high = np.where(_leaves(g, 0.0, math.inf), math.inf, high)
    return _tightened(guess, error, rounding, low, high)


def arctangent2(y: Models, x: Models) -> Models:
    """atan2(y, x): the angle, with its jump where y = 0 and x < 0."""
    if not isinstance(y, Models):
        y = x * 0.0 + y
    if not isinstance(x, Models):
        x = y * 0.0 + x
    guess = np.arctan2(y.values, x.values)
    cut = ~((x.low > 0) | (y.low > 0) | (y.high < 0))
    square = x * x + y * y
    distance = reciprocal(root(square))
    rounding = _no_nan((x.rounding + y.rounding) * _size(distance.values))
    values, _ = _truncated(guess, rounding)
    inverse = reciprocal(square)
    one, other = x.values * _slopes(y), y.values * _slopes(x)
    short, lost = _truncated(one - other, _UNIT * (_size(one) + _size(other)))
    defect = _defect(values, inverse.values * short, rounding)
    missed = _no_nan(inverse.error * _largest(short)) + _no_nan(inverse.magnitude * lost)
    error = np.abs(guess[:, _MIDDLE] - values[:, _MIDDLE]) + defect + 2 * missed
    error = error + _no_nan((x.error + y.error) * distance.magnitude)
    error = np.where(cut, math.inf, error)
    half_turn = np.full(len(error), math.pi)
    return _tightened(values, error, rounding, -half_turn, half_turn)


def absolute(g: Models) -> Models:
    """abs(g)."""
    kinked = _ranged(np.zeros(len(g.low)), g.magnitude)
    return _selected(g.low >= 0, g, _selected(g.high <= 0, -g, kinked))


def signum(g: Models) -> Models:
    """sign(g); a zero at an end of the range is passed over."""
    nothing = (g.low == 0) & (g.high == 0)
    low = np.where(nothing, 0.0, np.where(g.low >= 0, 1.0, -1.0))
    high = np.where(nothing, 0.0, np.where(g.high <= 0, -1.0, 1.0))
    return _ranged(low, high)


def minimum(*arguments: Models | Number) -> Models:
    """Smallest of the arguments."""
    return -maximum(*(-g for g in arguments))


def maximum(*arguments: Models | Number) -> Models:
    """Largest of the arguments, of which one at least is a model."""
    like = next(g for g in arguments if isinstance(g, Models))
    models = [g if isinstance(g, Models) else like * 0.0 + g for g in arguments]
    return functools.reduce(_larger, models)


def _larger(one: Models, other: Models) -> Models:
    kinked = _ranged(np.maximum(one.low, other.low), np.maximum(one.high, other.high))
    return _selected(one.low >= other.high, one, _selected(other.low >= one.high, other, kinked))


def _or_number(name: Callable[..., Models], plain: Callable[..., Any]) -> Callable[..., Any]:
    """Accept numbers also, which constant subexpressions are."""

    def function(*arguments: Any) -> Any:
        if any(isinstance(g, Models) for g in arguments):
            return name(*arguments)
        return plain(*arguments)

    return function


@dataclass(frozen=True)
class Arithmetic:
    """The arithmetic of models, for straight-line code of H."""

    functions: dict[str, Callable[..., Any]]
    pi: float = math.pi
    e: float = math.e

    def __getattr__(self, name: str) -> Callable[..., Any]:
        try:
            return self.functions[name]
        except KeyError:
            raise AttributeError(name) from None

    @staticmethod
    def number(numerator: int, denominator: int = 1) -> float:
        """Return the float64 number next to a fraction."""
        return numerator / denominator


def _arithmetic() -> Arithmetic:
    rows: Sequence[tuple[str, Callable[..., Models], Callable[..., Any]]] = [
        ("exp", exponential, np.exp),
        ("sin", sine, np.sin),
        ("cos", cosine, np.cos),
        ("tan", tangent, np.tan),
        ("log", logarithm, np.log),
        ("atan", arctangent, np.arctan),
        ("asin", arcsine, np.arcsin),
        ("acos", arccosine, np.arccos),
        ("atan2", arctangent2, np.arctan2),
        ("sinh", hyperbolic_sine, np.sinh),
        ("cosh", hyperbolic_cosine, np.cosh),
        ("tanh", hyperbolic_tangent, np.tanh),
        ("asinh", inverse_sine_hyperbolic, np.arcsinh),
        ("acosh", inverse_cosine_hyperbolic, np.arccosh),
        ("atanh", inverse_tangent_hyperbolic, np.arctanh),
        ("erf", error_function, special.erf),
        ("root", root, np.sqrt),
        ("reciprocal", reciprocal, lambda y: 1 / y),
        ("reciprocal_root", reciprocal_root, lambda y: 1 / np.sqrt(y)),
        ("general_power", general_power, np.power),
        ("abs", absolute, np.abs),
        ("sign", signum, np.sign),
        ("min", minimum, lambda *values: functools.reduce(np.minimum, values)),
        ("max", maximum, lambda *values: functools.reduce(np.maximum, values)),
    ]
    return Arithmetic({name: _or_number(model, plain) for name, model, plain in rows})


#: The arithmetic of models.
ARITHMETIC = _arithmetic()
