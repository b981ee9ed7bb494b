"""Derivatives, relations and identities of functions written in generators."""

from __future__ import annotations

import random

import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.symbolic.brackets import evolution
from hamsym.symbolic.differential_ring import PRIME, DifferentialRing
from hamsym.symbolic.generators import UnsupportedFunctionError

PLANE = Hamiltonian("p_x**2/2 + p_y**2*x/3 + a*x*y", q=["x", "y"], p=["p_x", "p_y"])
TIME = sympy.Symbol("t", real=True)

FUNCTIONS = (
    "x**3*p_y - 2*y/5",
    "1/(x**2 + 3*y)",
    "sqrt(x**2 + y**2)",
    "(x**2 + y**2)**(-3/2)",
    "(1 + x**2)**(2/3)*p_x",
    "(1 + x)**(1/4)",
    "x**0.5",
    "abs(x - 3*y)",
    "exp(x - y/2)*p_y",
    "exp(-sqrt(x**2 + y**2))",
    "exp(a*x)",
    "sin(x)*cos(2*y)",
    "cos(x/2 - 3*y)",
    "tan(x/3)",
    "sinh(x)*tanh(y)",
    "log(x + y**2)*p_x",
    "log(sqrt(x))",
    "x**a",
    "x**(a - 1/2)",
    "atan(x*y)",
    "erf(x)",
    "asin(x/9)",
    "p_x*cos(2*t) + t*x",
    "sqrt(a)*x",
    "pi*x + sqrt(2)*y",
)

IDENTITIES = (
    "sin(x)**2 + cos(x)**2 - 1",
    "sin(x + y) - sin(x)*cos(y) - cos(x)*sin(y)",
    "cos(3*x) - 4*cos(x)**3 + 3*cos(x)",
    "sin(x) - 2*sin(x/2)*cos(x/2)",
    "exp(x)*exp(y/2) - exp(x + y/2)",
    "cosh(x)**2 - sinh(x)**2 - 1",
    "tan(x)*cos(x) - sin(x)",
    "(x**2 + y**2)**(3/2) - x**2*sqrt(x**2 + y**2) - y**2*sqrt(x**2 + y**2)",
    "1/(x + y) - 1/(x - y) + 2*y/((x + y)*(x - y))",
    "sqrt(x**2 + 1) - x**2/sqrt(x**2 + 1) - 1/sqrt(x**2 + 1)",
    "(x + 1)**(5/3) - x*(x + 1)**(2/3) - (x + 1)**(2/3)",
    "(x + 1)**(a + 1) - x*(x + 1)**a - (x + 1)**a",
    "(x + y)**(5/4) - x*(x + y)**(1/4) - y*(x + y)**(1/4)",
)


def ring_of(*texts: str) -> tuple[DifferentialRing, list[sympy.Expr]]:
    formulas = [PLANE.function(text) for text in texts]
    real = PLANE.real_equations
    return DifferentialRing(real.expr, real.z, TIME, formulas), formulas


@pytest.mark.parametrize("text", FUNCTIONS)
def test_rates_are_those_of_sympy(text: str) -> None:
    ring, (f,) = ring_of(text)
    real = PLANE.real_equations
    exact = evolution(f, real.expr, real.z, TIME)
    found = ring.generators.formula(ring.rate(ring[f]).as_expr())
    generator = random.Random(1)
    for _ in range(3):
        point = {
            symbol: sympy.Rational(generator.randint(600, 1600), 1000)
            for symbol in sorted(exact.free_symbols | found.free_symbols, key=str)
        }
        value, other = (expr.xreplace(point).evalf(30) for expr in (exact, found))
        assert abs(value - other) < 1e-15 * (1 + abs(value))


@pytest.mark.slow_cases("(x**2 + y**2)**(3/2) - x**2*sqrt(x**2 + y**2) - y**2*sqrt(x**2 + y**2)")
@pytest.mark.parametrize("text", IDENTITIES)
def test_identities_vanish_and_changed_ones_do_not(text: str) -> None:
    ring, (f,) = ring_of(text)
    assert f != 0
    assert ring.vanishes(ring[f])
    terms = sympy.Add.make_args(f)
    for k, term in enumerate(terms):
        changed = f + term * sympy.Rational(1, 10**20)
        other = DifferentialRing(PLANE.real_equations.expr, PLANE.real_equations.z, TIME, [changed])
        assert not other.vanishes(other[changed]), k


@pytest.mark.parametrize(
    "text", ["sqrt(x**2 + y**2)", "cos(x/2 - 3*y)", "exp(x)/(1 + x)", "x**(1/3)"]
)
def test_points_satisfy_the_relations(text: str) -> None:
    ring, (f,) = ring_of(
        text,
    )
    points = ring.points(50, np.random.default_rng(0))
    assert points.shape == (50, len(ring.symbols))
    constants = ring.constants
    assert (points[:, constants] == points[0, constants]).all()
    # A polynomial and its normal form, without a denominator, have the same values.
    square = ring[f] ** 4
    if "inverse" not in {own.kind for own in ring.generators.of.values()}:
        (reduced,) = ring.normal_forms([square])
        assert (ring.values(square, points) == ring.values(reduced, points)).all()
    assert (ring.values(square, points) < PRIME).all()


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("max(x, y)", "no exact rules"),
        ("sign(x)", "no exact rules"),
        ("atan2(x, y)", "no exact rules"),
        ("x**(1/97)", "too large for an exact search"),
        ("cos(100*x)", "too large for an exact search"),
        ("(x + y + p_x + p_y + 1)**40/(1 + (x + y + p_x + p_y + 1)**40)", "too large|more than"),
    ],
)
def test_functions_without_rules_are_refused(text: str, sentence: str) -> None:
    with pytest.raises(UnsupportedFunctionError, match=sentence):
        ring_of(text)
