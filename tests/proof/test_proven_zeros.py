"""Proven zeros of gradients near points: against closed forms, and refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
import sympy
from flint import arb

from hamsym import Hamiltonian
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import enclosed_root, polynomial_roots


def potential_of_slope(zeros: list[float]) -> str:
    """H = p^2/2 + V(x) with V' the monic polynomial of these zeros, as text."""
    x = sympy.Symbol("x")
    slope = sympy.prod([x - sympy.Rational(*float(z).as_integer_ratio()) for z in zeros])
    return f"p**2/2 + {sympy.integrate(sympy.expand(slope), x)}"


def test_enclosure_contains_the_zero_in_its_units() -> None:
    """sqrt(k/g) of the double well, in units from 1e-24 to 1e24."""
    for unit in (1e-24, 1.0, 1e24):
        H = Hamiltonian("p**2/2 - k*x**2/2 + g*x**4/4", parameters={"k": 3.0, "g": unit**-2})
        root = enclosed_root(DerivativeBalls(H), [1.7 * unit, 0.0], [unit, unit])
        assert root is not None
        with working(256):
            exact = (arb(3) / arb(H.parameters["g"])).sqrt()
            assert root.enclosure[0].overlaps(exact)
        assert root.enclosure[0].rad() < 1e-40 * unit


@pytest.mark.parametrize(
    "potential", ["x**4", "x**3", "x", "exp(x)", "(x**2 + y**2 - 1)**2", "1/x"]
)
def test_singular_or_absent_zeros_are_not_proven(potential: str) -> None:
    both = "y" in potential
    H = Hamiltonian(f"({'p_x**2 + p_y**2' if both else 'p**2'})/2 + {potential}")
    assert (
        enclosed_root(DerivativeBalls(H), [0.0, 1.0, 0, 0] if both else [0.0, 0.0], [1.0] * H.dim)
        is None
    )


def test_zeros_very_close_to_each_other_are_told_apart() -> None:
    balls = DerivativeBalls(Hamiltonian(potential_of_slope([1.0, 1.0 + 1e-6, -2.0])))
    found = [enclosed_root(balls, [x, 0.0], [1.0, 1.0]) for x in (1.0, 1.0 + 1e-6)]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].enclosure[0].contains(1)
    assert not found[0].unique[0].contains(1 + 1e-6)
    assert not found[1].unique[0].contains(1)


def test_polynomial_zeros_of_any_multiplicity_are_isolated() -> None:
    x = sympy.Symbol("x", real=True)
    slope = (x - 1) ** 4 * (x**2 - 3) ** 3 * (x**2 + 1) * (x - 7)
    found = polynomial_roots(slope, x, -2.0, 2.0)
    np.testing.assert_allclose(
        [float(root.enclosure[0].mid()) for root in found],
        [-math.sqrt(3), 1, math.sqrt(3)],
        rtol=1e-15,
    )
    assert polynomial_roots(sympy.Integer(2) + 0 * x, x, -1.0, 1.0) == []
