"""Elementary functions of balls and of Taylor series of balls."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import sympy
from flint import arb, arb_series

__all__ = ["SingularityError", "hyperbolic_tangent"]


#: A ball or a series of them.
Enclosed = Any


class SingularityError(ArithmeticError):
    """Balls reach a point where an expression is not smooth; the message names it."""


def _head(x: Enclosed) -> arb:
    """The ball in which the value itself is, of a ball or a series."""
    return x if isinstance(x, arb) else x[0]


def _require(condition: bool) -> None:
    # Comparisons of balls are True only if they hold for all numbers, and False for NaN.
    if not condition:
        raise SingularityError


def _negative(x: Enclosed, _: Enclosed) -> Enclosed:
    return -x


def _reciprocal(x: Enclosed, _: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > 0 or head < 0)
    return 1 / x


def _logarithm(x: Enclosed, _: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.log()


def _root(x: Enclosed, _: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.sqrt()


def _reciprocal_root(x: Enclosed, _: Enclosed) -> Enclosed:
    _require(_head(x) > 0)
    return x.rsqrt()


def _tangent(x: Enclosed, _: Enclosed) -> Enclosed:
    cosine = _head(x).cos()
    _require(cosine > 0 or cosine < 0)
    return x.tan()


def _arcsine(x: Enclosed, _: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    return x.asin()


def _arccosine(x: Enclosed, _: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    return x.acos()


def _integrated(x: arb_series, value: arb, slope: arb_series) -> arb_series:
    """g(x) as a series from g at its head and g'(x)."""
    return (x.derivative() * slope).integral() + value


def _inverse_hyperbolic_sine(x: Enclosed, _: Enclosed) -> Enclosed:
    if isinstance(x, arb):
        return x.asinh()
    return _integrated(x, x[0].asinh(), (1 + x * x).rsqrt())


def _inverse_hyperbolic_cosine(x: Enclosed, _: Enclosed) -> Enclosed:
    _require(_head(x) > 1)
    if isinstance(x, arb):
        return x.acosh()
    # Each factor is above zero wherever the ball is; x*x - 1 of a wide ball need not be.
    return _integrated(x, x[0].acosh(), (x - 1).rsqrt() * (x + 1).rsqrt())


def _inverse_hyperbolic_tangent(x: Enclosed, _: Enclosed) -> Enclosed:
    head = _head(x)
    _require(head > -1 and head < 1)
    # Both terms grow with x, so that their difference is finite wherever the ball is; arb.atanh
    # takes the logarithm of a quotient, which of a wide ball need not be.
    value = (head.log1p() - (-head).log1p()) / 2
    return value if isinstance(x, arb) else _integrated(x, value, 1 / ((1 - x) * (1 + x)))


def _hyperbolic_sine(x: Enclosed, _: Enclosed) -> Enclosed:
    if isinstance(x, arb):
        return x.sinh()
    # sinh(x0 + u) by its addition theorem: both parts of x0 alone are sharp on wide balls.
    head, even, odd = _hyperbolic_parts(x)
    return head.sinh() * even + head.cosh() * odd


def _hyperbolic_cosine(x: Enclosed, _: Enclosed) -> Enclosed:
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


def hyperbolic_tangent(x: Enclosed, _: Enclosed = None) -> Enclosed:
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


def _angle(y: Enclosed, x: Enclosed) -> Enclosed:
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


def _general_power(base: Enclosed, exponent: Enclosed) -> Enclosed:
    _require(_head(base) > 0)
    return (exponent * base.log()).exp()


_FUNCTIONS: dict[type, Callable[[Enclosed, Enclosed], Enclosed]] = {
    sympy.exp: lambda x, _: x.exp(),
    sympy.sin: lambda x, _: x.sin(),
    sympy.cos: lambda x, _: x.cos(),
    sympy.atan: lambda x, _: x.atan(),
    sympy.erf: lambda x, _: x.erf(),
    sympy.log: _logarithm,
    sympy.tan: _tangent,
    sympy.asin: _arcsine,
    sympy.acos: _arccosine,
    sympy.sinh: _hyperbolic_sine,
    sympy.cosh: _hyperbolic_cosine,
    sympy.tanh: hyperbolic_tangent,
    sympy.asinh: _inverse_hyperbolic_sine,
    sympy.acosh: _inverse_hyperbolic_cosine,
    sympy.atanh: _inverse_hyperbolic_tangent,
    sympy.atan2: _angle,
}
