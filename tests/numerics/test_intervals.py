"""Ranges of formulas over intervals against samples in between."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.codegen.straight_line import FUNCTIONS
from hamsym.formula.parser import parse_expression
from hamsym.numerics.intervals import Intervals, RangeArithmetic, Ranges

T = sympy.Symbol("t", real=True)

FORMULAS = [
    "t**2 - 3*t*(t - 1)",
    "t**5 - t**4/7 + 1/t",
    "1/(t**2 - 2) - pi",
    "exp(-((t - 1)/0.01)**2)",
    "sqrt(t)*log(t) + t**(-3/2)",
    "t**t + t**(1/3)",
    "sin(7*t)*cos(t**2) + tan(t/3)",
    "atan(3*t) + asinh(t) + erf(t - 1)",
    "asin(t/9) + acos(t/9) + atanh(t/9) + acosh(1 + t)",
    "sinh(t/3) - cosh(t - 1) + tanh(2*t - 2)",
    "atan2(t - 1, t - 2) + atan2(2 - t, 1)",
]


def over(edges: np.ndarray, expression: sympy.Expr) -> Ranges:
    ends, one = np.stack([edges[:-1], edges[1:]]), np.ones(len(edges) - 1)
    t = Ranges.of_slopes(ends, Intervals(one, one), np.diff(edges))
    with np.errstate(all="ignore"):
        return compile_straight_line([expression], [T])(RangeArithmetic(), t)[0]


@pytest.mark.parametrize("text", FORMULAS)
def test_ranges_hold_values_and_slopes(text: str) -> None:
    expression = parse_expression(text).xreplace({sympy.Symbol("t"): T})
    edges = np.linspace(0.1, 4.3, 61)
    found = over(edges, expression)
    inside = edges[:-1] + np.diff(edges) * np.linspace(0.01, 0.99, 41)[:, None]
    for form, bounds in ((expression, found.within), (expression.diff(T), found.slope)):
        values = np.asarray(sympy.lambdify(T, form, ["scipy", "numpy"])(inside), dtype=float)
        slack = 1e-12 * (1 + np.abs(values))
        assert (bounds.low - slack <= values).all()
        assert (values <= bounds.high + slack).all()


@pytest.mark.parametrize("text", FORMULAS)
def test_excess_of_ranges_is_of_second_order(text: str) -> None:
    expression = parse_expression(text).xreplace({sympy.Symbol("t"): T})
    excess = []
    for count in (2000, 4000):
        found = over(np.linspace(1.7, 1.9, count + 1), expression)
        size = np.abs(found.ends[1] - found.ends[0])
        excess.append(np.max(found.within.high - found.within.low - size))
    assert excess[1] <= 0.3 * excess[0] + 1e-12


def test_every_function_of_formulas_has_ranges() -> None:
    assert all(hasattr(RangeArithmetic, name) for name in FUNCTIONS.values())


def test_unknown_ranges_are_infinite() -> None:
    found = over(np.array([-1.0, 0.5, 2.0]), 1 / T)
    assert np.isinf(found.within.low[0])
    assert found.within.low[1] == 0.5


def test_ranges_hold_the_peak_of_a_triangle() -> None:
    """No function with these slopes goes further from its chord than this one."""
    zero, two = np.zeros(1), np.full(1, 2.0)
    found = Ranges.of_slopes(np.zeros((2, 1)), Intervals(zero - 1, zero + 1), two).within
    assert found.low[0] <= -1
    assert found.high[0] >= 1
