"""Arrays of pairs of float64 numbers, whose sum has 106 bits, and functions of them.

Output: :class:`Pair`, and :data:`PAIRS`, the first argument of functions that
        :mod:`hamsym.codegen.straight_line` generates.

Sums and products are those of Dekker (1971), with relative errors of a few 2^-104 of the operands;
roots and quotients have one step of Newton's method. Other functions are evaluated in extended
precision (numpy.longdouble), where the processor has it.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import scipy

_SPLIT = 2.0**27 + 1  # divides 53 bits into halves (Veltkamp 1968)


class Pair:
    """An array high + low, with abs(low) below the last bit of high."""

    __slots__ = ("high", "low")
    __array_ufunc__ = None  # arrays leave operations to pairs

    def __init__(self, high: Any, low: Any = 0.0) -> None:
        self.high, self.low = high, low

    def __add__(self, other: Any) -> Pair:
        other = as_pair(other)
        high, rest = _sum(self.high, other.high)
        return _renormalised(high, rest + (self.low + other.low))

    __radd__ = __add__

    def __neg__(self) -> Pair:
        return Pair(-self.high, -self.low)

    def __sub__(self, other: Any) -> Pair:
        return self + -as_pair(other)

    def __rsub__(self, other: Any) -> Pair:
        return as_pair(other) - self

    def __mul__(self, other: Any) -> Pair:
        other = as_pair(other)
        high, rest = _product(self.high, other.high)
        return _renormalised(high, rest + (self.high * other.low + self.low * other.high))

    __rmul__ = __mul__

    def __getitem__(self, place: Any) -> Pair:
        return Pair(self.high[place], self.low[place])

    def broadcast(self, shape: tuple[int, ...]) -> Pair:
        """Return the pair in arrays of a shape."""
        return Pair(*(np.broadcast_to(part, shape) for part in (self.high, self.low)))


def as_pair(value: Any) -> Pair:
    """Return a pair, or numbers of float64, as a pair."""
    return value if isinstance(value, Pair) else Pair(value)


def stacked(parts: list[Any], shape: tuple[int, ...]) -> Pair:
    """Stack pairs and numbers of one shape along a last axis."""
    pairs = [as_pair(part).broadcast(shape) for part in parts]
    return Pair(*(np.stack([getattr(p, name) for p in pairs], axis=-1) for name in Pair.__slots__))


def _sum(a: Any, b: Any) -> tuple[Any, Any]:
    high = a + b
    share = high - a
    return high, (a - (high - share)) + (b - share)


def _product(a: Any, b: Any) -> tuple[Any, Any]:
    high = a * b
    (a1, a2), (b1, b2) = _halves(a), _halves(b)
    return high, ((a1 * b1 - high) + a1 * b2 + a2 * b1) + a2 * b2


def _halves(a: Any) -> tuple[Any, Any]:
    large = _SPLIT * a
    high = large - (large - a)
    return high, a - high


def _renormalised(high: Any, low: Any) -> Pair:
    total = high + low
    return Pair(total, low - (total - high))


# -- products of matrices --------------------------------------------------------------------------

# Numbers in three slices, of so many bits: products of two have 2 (_BITS + 1), and sums of 64 of
# them six more, which float64 has.
_BITS, _SLICES = 22, 3


def product(matrix: Pair, columns: Pair) -> Pair:
    """Multiply a matrix by columns, shapes (m, n) and (..., n, d), for n up to 64.

    Errors are about 2^-66 of the largest numbers of a column. Products of slices by BLAS are exact
    (Ozaki, Ogita, Oishi & Rump 2012).
    """
    found = Pair(matrix.high @ columns.low + matrix.low @ columns.high)
    left, right = _slices(matrix.high, None), _slices(columns.high, -2)
    for i in reversed(range(_SLICES)):
        for part in reversed(right):
            found = found + left[i] @ part
    return found


def _slices(numbers: np.ndarray, axis: int | None) -> list[np.ndarray]:
    """Write numbers as sums of multiples of powers of two that are common along an axis."""
    largest = np.abs(numbers).max(axis=axis, keepdims=True)
    unit, rest, found = np.ldexp(1.0, np.frexp(largest)[1] - _BITS), numbers, []
    for _ in range(_SLICES):
        part = np.rint(rest / unit) * unit
        found.append(part)
        rest, unit = rest - part, unit * 2.0**-_BITS
    return found


# -- functions -------------------------------------------------------------------------------------


def fraction(numerator: int, denominator: int = 1) -> Pair:
    """Return the pair nearest to a fraction.

    Examples
    --------
    >>> third = fraction(1, 3)
    >>> one = 3 * third
    >>> float(one.high), abs(float(one.low)) < 1e-31
    (1.0, True)
    """
    exact = Fraction(numerator, denominator)
    high = float(exact)
    return Pair(high, float(exact - Fraction(high)))


def reciprocal(x: Any) -> Pair:
    x = as_pair(x)
    first = 1 / np.asarray(x.high)
    return first + first * (1 - x * first)


def reciprocal_root(x: Any) -> Pair:
    x = as_pair(x)
    first = 1 / np.sqrt(np.asarray(x.high))
    return first + 0.5 * first * (1 - x * Pair(first) * first)


def root(x: Any) -> Pair:
    x = as_pair(x)
    first = np.sqrt(np.asarray(x.high))
    rest = x - Pair(first) * first
    return Pair(first) + np.where(first > 0, rest.high / np.where(first > 0, 2 * first, 1.0), 0.0)


def rounded(numbers: Any) -> Pair:
    """Return numbers of any precision as pairs."""
    high = np.asarray(numbers).astype(float)
    return Pair(high, np.asarray(numbers - high).astype(float))


def _in_extended_precision(function: Callable[..., Any]) -> Callable[..., Pair]:
    def evaluated(*arguments: Any) -> Pair:
        return rounded(function(*(np.longdouble(x.high) + x.low for x in map(as_pair, arguments))))

    return evaluated


def _error_function(x: Any) -> Any:
    return scipy.special.erf(np.asarray(x).astype(float))


class Pairs:
    """The arithmetic of pairs for generated functions."""

    number = staticmethod(fraction)
    reciprocal = staticmethod(reciprocal)
    reciprocal_root = staticmethod(reciprocal_root)
    root = staticmethod(root)

    def __init__(self) -> None:
        with mpmath.workdps(40):
            for name, value in (("pi", +mpmath.pi), ("e", +mpmath.e)):
                setattr(self, name, Pair(float(value), float(value - float(value))))
        own: dict[str, Callable[..., Any]] = {"erf": _error_function, "general_power": np.power}
        for name in ("exp", "sin", "cos", "log", "tan", "sinh", "cosh", "tanh"):
            own[name] = getattr(np, name)
        for name in ("sin", "cos", "tan", "sinh", "cosh", "tanh", "tan2"):
            own[f"a{name}"] = getattr(np, f"arc{name}")
        for name, function in own.items():
            setattr(self, name, _in_extended_precision(function))


PAIRS: Any = Pairs()
