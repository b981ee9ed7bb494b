"""Discs around a window: formulas are inside their bounds, polynomials within their share."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest
import sympy
from numpy.polynomial import chebyshev

from hamsym.bounds.discs import DISCS, disc_tables
from hamsym.bounds.models import NODES, PLACES
from hamsym.codegen.programs import program_of
from hamsym.kernel.loops import library

F, G = sympy.symbols("f g", real=True)
CIRCLE = np.exp(1j * np.linspace(0, 2 * np.pi, 257))
MIDDLES = np.array([0.3, 0.7, 1.1, 1.4, 1.9, 2.3, 2.8, 3.3])
FORMULAS = [
    *(F + 2 * G, F * G - F, 1 / F, F**-3, sympy.sqrt(F), F ** sympy.Rational(-3, 2)),
    *(F ** sympy.Rational(7, 3), F**-1.7, sympy.sin(F), sympy.cos(F * G), sympy.exp(-F * G)),
    *(sympy.log(F), sympy.sinh(F), sympy.cosh(F), sympy.atan(F), sympy.Abs(F), sympy.Max(F, G)),
    *(sympy.sign(F) * G, sympy.Min(F, G) ** 2, 1 / (1 + sympy.sin(F - G) ** 2)),
]


def bounds_in_discs(expression: sympy.Expr, radius: float) -> float:
    """Bound an expression of f and g, in discs around given numbers and 0.2 above these."""
    program = program_of([expression], [F, G], None, [])
    rows = [(MIDDLES, radius), (MIDDLES + 0.2, radius / 2), (0 * MIDDLES, 0.0)]
    inputs = np.array([[middle, np.full(DISCS, r)] for middle, r in rows])
    parameters, found = np.empty(0), np.empty(1)
    given = (inputs.ctypes.data, parameters.ctypes.data, found.ctypes.data)
    assert library().hamsym_discs(ctypes.byref(program), *given)
    return float(found[0])


@pytest.mark.parametrize("formula", FORMULAS, ids=str)
def test_formula_is_within_its_bound_in_all_discs(formula: sympy.Expr) -> None:
    modules = [{"Max": lambda x, y: y, "Min": lambda x, y: x, "Abs": lambda x: x}, "numpy"]
    modules[0]["sign"] = np.ones_like
    function = sympy.lambdify([F, G], formula, modules)
    for radius in (1e-3, 0.05, 0.12):
        f = MIDDLES[:, None, None] + radius * CIRCLE[:, None]
        g = MIDDLES[:, None, None] + 0.2 + radius / 2 * CIRCLE
        largest = np.abs(function(f, g)).max()
        assert largest <= (1 + 1e-12) * bounds_in_discs(formula, radius)
        # Logarithms of bounds matter: they are not too large where discs are small.
        assert radius > 0.1 or bounds_in_discs(formula, radius) <= 2 * largest


@pytest.mark.parametrize(
    "formula",
    [1 / F, sympy.sqrt(F), sympy.log(F), F**2.3, sympy.Abs(F), sympy.sign(F), sympy.Max(F, G)],
    ids=str,
)
def test_discs_with_a_singularity_have_no_bound(formula: sympy.Expr) -> None:
    assert not bounds_in_discs(formula, 0.31) < np.inf
    assert not bounds_in_discs(sympy.erf(F), 0.01) < np.inf  # this arithmetic lacks it


@pytest.mark.parametrize("decade", [-13, -10, -4])
def test_polynomials_leave_out_no_more_than_their_share(decade: int) -> None:
    """Of functions with a pole just outside the discs, which are bounded in them."""
    tables = disc_tables(32, decade)
    assert tables.share <= 1e-3 * 10.0**decade
    middles, radius = 2 * tables["place"] - 1, 2 * tables.radius
    dense = np.linspace(-1, 1, 2_001)
    fit = chebyshev.chebvander(NODES, PLACES - 1)
    for middle in middles:
        pole = middle + 1.02j * radius
        if np.abs(pole - middles).min() < 1.01 * radius:
            continue
        series = np.linalg.solve(fit, (1 / (NODES - pole)).real)
        missed = np.abs(chebyshev.chebval(dense, series) - (1 / (dense - pole)).real).max()
        largest = 1 / (0.02 * radius)  # in the discs
        assert missed <= tables.share * largest + 1e-13 / radius


def test_series_in_discs_are_bounded() -> None:
    tables = disc_tables(32, -10)
    middles, radius = 2 * tables["place"] - 1, 2 * tables.radius
    places = middles[:, None] + radius * CIRCLE
    for k in range(32):
        values = np.cos(k * np.arccos(places.astype(complex)))
        at = np.cos(k * np.arccos(middles.astype(complex))).real
        np.testing.assert_allclose(tables["middle"][k], at, atol=1e-6 * 1.7**k)
        distance = np.abs(values - at[:, None]).max(axis=1)
        assert (distance <= (1 + 1e-9) * tables["extent"][k] + 1e-9).all()
