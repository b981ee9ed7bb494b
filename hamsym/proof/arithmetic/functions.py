"""Arithmetic of balls (``arb``) and of Taylor series of balls (``arb_series``).

Output: :class:`Arithmetic`, the first argument of the functions that
        :mod:`hamsym.codegen.straight_line` generates.

Each result contains the value, or each Taylor coefficient, for every choice of numbers in the
arguments. Where an argument reaches a point at which the function is not smooth (a zero of a
divisor, the branch point of a root), the function raises :class:`SingularityError`.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable
from functools import partial
from typing import Any

from flint import arb, arb_series, ctx, fmpq

#: A ball or a Taylor series of balls.
Enclosed = Any


class SingularityError(ArithmeticError):
    """Balls contain a point where an expression is not smooth; the message names the expression."""


def _head(x: Enclosed) -> arb:
    """The ball itself, or the constant term of a series."""
    return x if isinstance(x, arb) else x[0]


def _require(condition: bool) -> None:
    # Comparisons of balls are True only if they hold for all numbers, and False for NaN.
    if not condition:
        raise SingularityError


def reciprocal(x: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > 0 or head < 0)
    return 1 / x


def logarithm(x: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.log()


def root(x: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.sqrt()


def reciprocal_root(x: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.rsqrt()


def tangent(x: Enclosed) -> Enclosed:
    cosine = _head(x).cos()
    _require(cosine > 0 or cosine < 0)
    return x.tan()


def arcsine(x: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    return x.asin()


def arccosine(x: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    return x.acos()


def _integrated(x: arb_series, value: arb, slope: arb_series) -> arb_series:
    """g(x) as a series from g at its head and g'(x)."""
    return (x.derivative() * slope).integral() + value


def inverse_hyperbolic_sine(x: Enclosed) -> Enclosed:
    if isinstance(x, arb):
        return x.asinh()
    return _integrated(x, x[0].asinh(), (1 + x * x).rsqrt())


def inverse_hyperbolic_cosine(x: Enclosed) -> Enclosed:
    _require(_head(x) > 1)
    if isinstance(x, arb):
        return x.acosh()
    # Each factor is above zero wherever the ball is; x*x - 1 of a wide ball need not be.
    return _integrated(x, x[0].acosh(), (x - 1).rsqrt() * (x + 1).rsqrt())


def inverse_hyperbolic_tangent(x: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    # Both terms grow with x, so that their difference is finite wherever the ball is; arb.atanh
    # takes the logarithm of a quotient, which of a wide ball need not be.
    value = (head.log1p() - (-head).log1p()) / 2
    return value if isinstance(x, arb) else _integrated(x, value, 1 / ((1 - x) * (1 + x)))


def hyperbolic_sine(x: Enclosed) -> Enclosed:
    if isinstance(x, arb):
        return x.sinh()
    # sinh(x0 + u) by its addition theorem: both parts of x0 alone are sharp on wide balls.
    head, even, odd = _hyperbolic_parts(x)
    return head.sinh() * even + head.cosh() * odd


def hyperbolic_cosine(x: Enclosed) -> Enclosed:
    if isinstance(x, arb):
        return x.cosh()
    head, even, odd = _hyperbolic_parts(x)
    return head.cosh() * even + head.sinh() * odd


def _hyperbolic_parts(x: arb_series) -> tuple[arb, arb_series, arb_series]:
    """x0, cosh(u) and sinh(u) for x = x0 + u, where u has no constant term."""
    head = x[0]
    growth = _without_head(x).exp()
    decay = 1 / growth
    return head, (growth + decay) / 2, (growth - decay) / 2


def _without_head(x: arb_series) -> arb_series:
    # Its integral begins with an exact zero, which a difference of balls would not.
    return x.derivative().integral()


def hyperbolic_tangent(x: Enclosed) -> Enclosed:
    """tanh of a ball or a series; within [-1, 1] however wide the ball.

    With x = x0 + u, tanh(x) = (T + tau) / (1 + T tau) for T = tanh(x0) and tau = tanh(u), a series
    without constant term: no divisor can come near zero.
    """
    if isinstance(x, arb):
        return x.tanh()
    value = x[0].tanh()
    growth = (2 * _without_head(x)).exp()
    rest = (growth - 1) / (growth + 1)
    return (value + rest) / (1 + value * rest)


def angle(y: Enclosed, x: Enclosed) -> Enclosed:
    """atan2(y, x) away from its cut, the negative half of the x axis."""
    below, beside = _head(y), _head(x)
    _require(beside > 0 or below > 0 or below < 0)
    value = arb.atan2(below, beside)
    if isinstance(y, arb) and isinstance(x, arb):
        return value
    y, x = (part if isinstance(part, arb_series) else arb_series([part]) for part in (y, x))
    squares = x * x + y * y
    # Where one ball is wide its product with itself may reach below zero; then there is no result.
    _require(squares[0] > 0)
    slope = (x * y.derivative() - y * x.derivative()) / squares
    return slope.integral() + value


def general_power(base: Enclosed, exponent: Enclosed) -> Enclosed:
    _require(_head(base) > 0)
    return (exponent * base.log()).exp()


#: Enclosures of the functions in generated code; atan2 and general_power take two arguments.
FUNCTIONS: dict[str, Callable[..., Enclosed]] = {
    **{name: operator.methodcaller(name) for name in ("exp", "sin", "cos", "atan", "erf")},
    "log": logarithm,
    "tan": tangent,
    "asin": arcsine,
    "acos": arccosine,
    "sinh": hyperbolic_sine,
    "cosh": hyperbolic_cosine,
    "tanh": hyperbolic_tangent,
    "asinh": inverse_hyperbolic_sine,
    "acosh": inverse_hyperbolic_cosine,
    "atanh": inverse_hyperbolic_tangent,
    "atan2": angle,
    "reciprocal": reciprocal,
    "root": root,
    "reciprocal_root": reciprocal_root,
    "general_power": general_power,
}


class Arithmetic:
    """Numbers and functions of balls, at the present precision.

    Each function of :data:`FUNCTIONS` is an attribute.

    - apply: (function, *arguments) -> result, in place of ``function(*arguments)``: functions of
      other objects than balls and series.

    Examples
    --------
    >>> BALLS.root(BALLS.number(9, 4)).str(5)
    '1.5000'
    """

    def __init__(self, apply: Callable[..., Enclosed] | None = None) -> None:
        for name, function in FUNCTIONS.items():
            setattr(self, name, function if apply is None else partial(apply, function))

    @staticmethod
    def number(numerator: int, denominator: int = 1) -> arb:
        """A ball of a fraction; exact if the fraction is binary and fits the precision."""
        return _fraction(numerator, denominator, ctx.prec)

    @property
    def pi(self) -> arb:
        return _constant(arb.pi, ctx.prec)

    @property
    def e(self) -> arb:
        return _constant(arb.const_e, ctx.prec)


@functools.lru_cache(maxsize=4096)
def _fraction(numerator: int, denominator: int, bits: int) -> arb:
    return arb(fmpq(numerator, denominator))


@functools.lru_cache(maxsize=64)
def _constant(make: Callable[[], arb], bits: int) -> arb:
    return make()


#: The arithmetic of balls and of their Taylor series.
BALLS = Arithmetic()
