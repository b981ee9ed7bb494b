"""Arithmetic of Chebyshev models: each function is inside its bounds on the whole interval."""

from __future__ import annotations

import ctypes
import math
from typing import NamedTuple

import numpy as np
import pytest
import sympy
from numpy.polynomial import chebyshev
from scipy import special

from hamsym.bounds.models import NODES, PLACES, model_tables
from hamsym.codegen.programs import program_of
from hamsym.kernel.loops import Program, library

DENSE = np.linspace(-1, 1, 4001)
INTERVALS = 40
COEFFICIENTS = np.linalg.inv(chebyshev.chebvander(NODES, PLACES - 1)).T
F, G = sympy.symbols("f g", real=True)


class Models(NamedTuple):
    """Models of results on intervals."""

    #: Of the polynomials at the places, shape (n, results, PLACES).
    values: np.ndarray
    #: error, rounding: Bound on the distance of function and polynomial, and the rounding errors of
    #: the values, which it leaves out, shape (n, results).
    error: np.ndarray
    rounding: np.ndarray
    #: low, high: Bounds on the functions, shape (n, results).
    low: np.ndarray
    high: np.ndarray


def models_of(
    program: Program, values: np.ndarray, ranges: np.ndarray, parameters: np.ndarray
) -> Models:
    """Compute models of the results of a program.

    - values: Of polynomials that the state and the time are, shape (n, dim + 1, PLACES).
    - ranges: Bounds on them, which may be infinite, shape (n, dim + 1, 2).
    - parameters: Shape (k,) or (n, k).
    """
    count = len(values)
    found = np.empty((count, program.results, PLACES))
    bounds = np.empty((count, program.results, 4))
    given = [np.ascontiguousarray(array, dtype=float) for array in (values, ranges, parameters)]
    done = library().hamsym_models(
        *(ctypes.byref(program), ctypes.byref(model_tables()), count),
        *(array.ctypes.data for array in given),
        *(0, found.ctypes.data, bounds.ctypes.data),
    )
    assert done
    return Models(found, *np.moveaxis(bounds, -1, 0))


def polynomials(seed: int, spread: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """Random polynomials of degree 6: values at the places and at dense ones."""
    generator = np.random.default_rng(seed)
    series = spread * generator.normal(size=(7, INTERVALS)) / (1 + np.arange(7))[:, None] ** 2
    return chebyshev.chebval(NODES, series), chebyshev.chebval(DENSE, series)


def modelled(expression: sympy.Expr, f: np.ndarray, g: np.ndarray | None = None) -> Models:
    """Models of an expression of one or two polynomials."""
    program = program_of([expression], [F, G], None, [])
    given = np.stack((f, f if g is None else g, np.broadcast_to(NODES, f.shape)), axis=1)
    unknown = np.broadcast_to([-np.inf, np.inf], (*given.shape[:2], 2))
    found = models_of(program, given, unknown, np.empty(0))
    return Models(*(array[:, 0] for array in found))


def assert_bounds(found: Models, truth: np.ndarray) -> None:
    polynomial = chebyshev.chebval(DENSE, (found.values @ COEFFICIENTS).T)
    slack = 1e-12 * (np.abs(truth).max(axis=1) + np.nan_to_num(found.error, posinf=0)) + 1e-14
    distance = np.abs(polynomial - truth).max(axis=1)
    assert (distance <= found.error + slack).all()
    assert (truth.min(axis=1) >= found.low - slack).all()
    assert (truth.max(axis=1) <= found.high + slack).all()


ENTIRE = {
    sympy.exp: np.exp,
    sympy.sin: np.sin,
    sympy.cos: np.cos,
    sympy.atan: np.arctan,
    sympy.sinh: np.sinh,
    sympy.cosh: np.cosh,
    sympy.tanh: np.tanh,
    sympy.asinh: np.arcsinh,
    sympy.erf: special.erf,
    sympy.Abs: np.abs,
    sympy.sign: np.sign,
}


@pytest.mark.parametrize("spread", [0.1, 1.0, 8.0, 60.0])
@pytest.mark.parametrize("function", ENTIRE, ids=str)
def test_functions_are_inside_their_bounds(function: type, spread: float) -> None:
    with np.errstate(all="ignore"):
        g, dense = polynomials(sum(map(ord, function.__name__)), spread)
        assert_bounds(modelled(function(G), g), ENTIRE[function](dense))


@pytest.mark.parametrize(
    ("formula", "function", "offset", "spread"),
    [
        (sympy.log(G), np.log, 3.0, 0.5),
        (sympy.sqrt(G), np.sqrt, 3.0, 0.5),
        (1 / G, lambda y: 1 / y, -3.0, 0.5),
        (1 / sympy.sqrt(G), lambda y: y**-0.5, 3.0, 0.5),
        (G ** sympy.Rational(-7, 3), lambda y: y ** (-7 / 3), 3.0, 0.5),
        (sympy.asin(G), np.arcsin, 0.1, 0.15),
        (sympy.acos(G), np.arccos, -0.1, 0.15),
        (sympy.atanh(G), np.arctanh, 0.1, 0.15),
        (sympy.acosh(G), np.arccosh, 5.0, 0.5),
        (sympy.tan(G), np.tan, 0.1, 0.2),
    ],
    ids=lambda value: str(value) if isinstance(value, sympy.Basic) else "",
)
def test_functions_are_resolved_inside_their_domain(formula, function, offset, spread) -> None:
    with np.errstate(all="ignore"):
        g, dense = polynomials(3, spread)
        found = modelled(formula.subs(G, G + offset), g)
        truth = function(dense + offset)
    assert_bounds(found, truth)
    assert np.median(found.error) < 1e-11


@pytest.mark.parametrize(
    ("formula", "function"),
    [
        (F + G, lambda f, g: f + g),
        (F - 2.5 * G, lambda f, g: f - 2.5 * g),
        (F * G, lambda f, g: f * g),
        (F**3, lambda f, g: f**3),
        (sympy.Min(F, G, 0.2), lambda f, g: np.minimum(np.minimum(f, g), 0.2)),
        (sympy.Max(F, G), np.maximum),
        (sympy.atan2(F, G), np.arctan2),
        ((F**2 + 1) ** 1.7, lambda f, g: (f**2 + 1) ** 1.7),
        ((F**2 + 1) ** G, lambda f, g: (f**2 + 1) ** g),
    ],
    ids=lambda value: str(value) if isinstance(value, sympy.Basic) else "",
)
@pytest.mark.parametrize("spread", [0.3, 3.0])
def test_operations_of_two_models_are_inside_their_bounds(spread, formula, function) -> None:
    (f, at_f), (g, at_g) = polynomials(1, spread), polynomials(2, spread)
    assert_bounds(modelled(formula, f, g), function(at_f, at_g))


@pytest.mark.parametrize("exponent", [0.0, 1.0, 2.0, -3.0, 2.5, -0.5, 0.3])
def test_parameters_in_exponents_are_numbers(exponent: float) -> None:
    """Integer and half-integer powers are those of fixed exponents."""
    n = sympy.Symbol("n", real=True)
    values, dense = polynomials(4, 0.5)
    given = np.stack((values + 3, np.broadcast_to(NODES, values.shape)), axis=1)
    unknown = np.broadcast_to([-np.inf, np.inf], (*given.shape[:2], 2))
    found = models_of(program_of([F**n], [F], None, [n]), given, unknown, np.array([exponent]))
    assert_bounds(Models(*(array[:, 0] for array in found)), (dense + 3) ** exponent)


@pytest.mark.parametrize("width", [1e-3, 1e-9, 1e-15, 1e-150])
def test_pulse_between_all_places_is_in_the_bounds(width: float) -> None:
    """Its place is between two of the places at which functions are evaluated."""
    middle = (NODES[PLACES // 2] + NODES[PLACES // 2 + 1]) / 2
    argument = (F - sympy.Float(middle)) * sympy.Float(1 / width)
    for formula in (
        sympy.exp(-(argument**2)),
        1 / (argument**2 + 1),
        1 - sympy.tanh(argument) * sympy.tanh(argument),
    ):
        pulse = modelled(formula, NODES[None])
        coefficients = (pulse.values @ COEFFICIENTS)[0]
        assert pulse.high[0] >= 1.0
        assert abs(chebyshev.chebval(middle, coefficients) - 1.0) <= pulse.error[0] + 1e-9


def test_unbounded_arguments_leave_nan_out_of_bounds() -> None:
    pole = modelled(1 / F, NODES[None])
    assert pole.error[0] == math.inf
    assert pole.low[0] == -math.inf
    step = modelled(1 / (sympy.exp(10**6 * F) + 1), NODES[None])
    assert (step.low[0], step.high[0]) == (0.0, 1.0)
    assert step.error[0] <= 0.5
