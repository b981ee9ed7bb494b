"""Arithmetic of Chebyshev models: each function is inside its bounds on the whole interval."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.polynomial import chebyshev
from scipy import special

from hamsym.bounds import models
from hamsym.bounds.models import ARITHMETIC, NODES, PLACES, Models

DENSE = np.linspace(-1, 1, 4001)
INTERVALS = 40


def polynomials(seed: int, spread: float = 1.0) -> tuple[Models, np.ndarray]:
    """Random polynomials of degree 6 as models, and their values at dense places."""
    generator = np.random.default_rng(seed)
    series = spread * generator.normal(size=(7, INTERVALS)) / (1 + np.arange(7))[:, None] ** 2
    return (
        Models.of_values(chebyshev.chebval(NODES, series)),
        chebyshev.chebval(DENSE, series),
    )


def assert_bounds(found: Models, truth: np.ndarray) -> None:
    polynomial = chebyshev.chebval(DENSE, (found.values @ models._COEFFICIENTS).T)
    slack = 1e-12 * (np.abs(truth).max(axis=1) + np.nan_to_num(found.error, posinf=0)) + 1e-14
    distance = np.abs(polynomial - truth).max(axis=1)
    assert (distance <= found.error + slack).all()
    assert (truth.min(axis=1) >= found.low - slack).all()
    assert (truth.max(axis=1) <= found.high + slack).all()


ENTIRE = {
    "exp": np.exp,
    "sin": np.sin,
    "cos": np.cos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "asinh": np.arcsinh,
    "erf": special.erf,
    "abs": np.abs,
    "sign": np.sign,
}


@pytest.mark.parametrize("spread", [0.1, 1.0, 8.0, 60.0])
@pytest.mark.parametrize("name", ENTIRE)
def test_functions_are_inside_their_bounds(name: str, spread: float) -> None:
    with np.errstate(all="ignore"):
        g, dense = polynomials(sum(map(ord, name)), spread)
        assert_bounds(getattr(ARITHMETIC, name)(g), ENTIRE[name](dense))


@pytest.mark.parametrize(
    ("name", "function", "offset", "spread"),
    [
        ("log", np.log, 3.0, 0.5),
        ("root", np.sqrt, 3.0, 0.5),
        ("reciprocal", lambda y: 1 / y, -3.0, 0.5),
        ("reciprocal_root", lambda y: y**-0.5, 3.0, 0.5),
        ("asin", np.arcsin, 0.1, 0.15),
        ("acos", np.arccos, -0.1, 0.15),
        ("atanh", np.arctanh, 0.1, 0.15),
        ("acosh", np.arccosh, 5.0, 0.5),
        ("tan", np.tan, 0.1, 0.2),
    ],
)
def test_functions_are_resolved_inside_their_domain(name, function, offset, spread) -> None:
    with np.errstate(all="ignore"):
        g, dense = polynomials(3, spread)
        found = getattr(ARITHMETIC, name)(g + offset)
        truth = function(dense + offset)
    assert_bounds(found, truth)
    assert np.median(found.error) < 1e-11


@pytest.mark.parametrize("spread", [0.3, 3.0])
def test_operations_of_two_models_are_inside_their_bounds(spread: float) -> None:
    with np.errstate(all="ignore"):
        (f, at_f), (g, at_g) = polynomials(1, spread), polynomials(2, spread)
        assert_bounds(f + g, at_f + at_g)
        assert_bounds(f - 2.5 * g, at_f - 2.5 * at_g)
        assert_bounds(f * g, at_f * at_g)
        assert_bounds(f * f * f, at_f**3)
        assert_bounds(ARITHMETIC.min(f, g, 0.2), np.minimum(np.minimum(at_f, at_g), 0.2))
        assert_bounds(ARITHMETIC.max(f, g), np.maximum(at_f, at_g))
        assert_bounds(ARITHMETIC.atan2(f, g), np.arctan2(at_f, at_g))
        power = ARITHMETIC.general_power(f * f + 1.0, 1.7)
        assert_bounds(power, (at_f**2 + 1) ** 1.7)


@pytest.mark.parametrize("width", [1e-3, 1e-9, 1e-15, 1e-150])
def test_pulse_between_all_places_is_in_the_bounds(width: float) -> None:
    """Its place is between two of the places at which functions are evaluated."""
    middle = (NODES[PLACES // 2] + NODES[PLACES // 2 + 1]) / 2
    x = Models.of_values(NODES[None])
    with np.errstate(all="ignore"):
        argument = (x - middle) * (1 / width)
        for pulse in (
            ARITHMETIC.exp(-(argument * argument)),
            ARITHMETIC.reciprocal(argument * argument + 1.0),
            1.0 - ARITHMETIC.tanh(argument) * ARITHMETIC.tanh(argument),
        ):
            polynomial = float(chebyshev.chebval(middle, (pulse.values @ models._COEFFICIENTS)[0]))
            assert pulse.high[0] >= 1.0
            assert abs(polynomial - 1.0) <= pulse.error[0] + 1e-9


def test_unbounded_arguments_leave_nan_out_of_bounds() -> None:
    x = Models.of_values(NODES[None])
    with np.errstate(all="ignore"):
        pole = ARITHMETIC.reciprocal(x)
        assert pole.error[0] == math.inf
        assert pole.low[0] == -math.inf
        step = ARITHMETIC.reciprocal(ARITHMETIC.exp(1e6 * x) + 1.0)
    assert (step.low[0], step.high[0]) == (0.0, 1.0)
    assert step.error[0] <= 0.5
