"""Derivatives are exact in the floating-point numbers of a formula."""

from __future__ import annotations

import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.symbolic.exact import fraction

x, p = sympy.symbols("x p", real=True)
TENTH, THIRD = sympy.Float("0.1", 3), sympy.Float(1 / 3)


@pytest.mark.parametrize(
    "potential",
    [TENTH * x**3, sympy.exp(-TENTH * (x - THIRD) ** 2), x**2.5 * THIRD, (x**2 + TENTH) ** -1.5],
)
def test_derivatives_equal_those_with_fractions(potential: sympy.Expr) -> None:
    equations = Hamiltonian(p**2 / 2 + potential, q=[x], p=[p]).real_equations
    exact = equations.exact
    twin = equations.expr.xreplace({n: fraction(n) for n in equations.expr.atoms(sympy.Float)})
    found = [exact.with_fractions(entry, {}) for entry in (exact.gradient[0], exact.hessian[0, 0])]
    point = {x: sympy.Rational(7, 11)}
    for order, derivative in enumerate(found, 1):
        difference = (derivative - sympy.diff(twin, x, order)).xreplace(point)
        assert abs(difference.evalf(40)) < 1e-35


def test_floats_stay_in_the_source() -> None:
    H = Hamiltonian(p**2 / 2 + 0.1 * x**2 + 0.3 * x**3, q=[x], p=[p])
    assert "0.1*x**2" in H.source("numpy", part="energy")
    assert list(H.gradient) == [sympy.diff(H.expr, x), p]


@pytest.mark.parametrize("n", [1, 2])
def test_exponents_take_parameter_values(n: int) -> None:
    k = sympy.Symbol("n", real=True)
    exact = Hamiltonian(p**2 / 2 + x**k, q=[x], p=[p]).real_equations.exact
    second = exact.with_fractions(exact.hessian[0, 0], {k: n})
    assert second == n * (n - 1)  # also at x = 0


def test_large_exponents_stay_symbolic() -> None:
    k = sympy.Symbol("n", real=True)
    exact = Hamiltonian(p**2 / 2 + 2**k * x, q=[x], p=[p]).real_equations.exact
    assert exact.with_fractions(exact.gradient[0], {k: 1e9}) == 2**k
