"""The catalogue: exact solutions solve the equations, periods are periods."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hamsym import InputError, systems
from hamsym.integrators import reference
from hamsym.systems import CATALOGUE, Problem


def test_starts_fit(problem: Problem) -> None:
    assert problem.H.unbound_parameters == ()
    assert problem.H.state_from(problem.z0).shape == (problem.H.dim,)
    assert problem.span[1] > problem.span[0]
    assert problem.source


def test_exact_solution_starts_right_and_solves_the_equations(problem: Problem) -> None:
    if problem.exact is None:
        truth = reference(problem.H, problem.z0, problem.span)
    else:
        truth = problem.exact
        assert problem.exact(np.linspace(*problem.span, 7)).shape == (7, problem.H.dim)
    np.testing.assert_allclose(truth(np.array([0.0]))[0], problem.z0, atol=1e-14)
    t = np.linspace(*problem.span, 41)[1:-1]
    h = 1e-3
    slope = (8 * (truth(t + h) - truth(t - h)) - (truth(t + 2 * h) - truth(t - 2 * h))) / (12 * h)
    flow = problem.H.compile("numpy").vector_field(truth(t))
    np.testing.assert_allclose(slope, flow, atol=1e-8)


def test_period(problem: Problem) -> None:
    if problem.period is None:
        return
    truth = reference(problem.H, problem.z0, (0.0, problem.period))
    np.testing.assert_allclose(truth(np.array([problem.period]))[0], problem.z0, atol=1e-9)
    halfway = truth(np.array([problem.period / 2]))[0]
    assert np.abs(halfway - problem.z0).max() > 0.1


@pytest.mark.parametrize(
    ("x", "p"), [(1.3, 1.0), (1.3, -1.0), (-1.3, 1.0), (-1.3, -1.0), (1.0, 0.0), (0.0, 1.0)]
)
def test_oscillator_from_every_quadrant(x: float, p: float) -> None:
    problem = systems.nonlinear_oscillator(x, p)
    t = np.linspace(0, 20, 201)
    truth = reference(problem.H, np.array([x, p]), (0.0, 20.0))
    np.testing.assert_allclose(problem.exact(t), truth(t), atol=1e-10)


@pytest.mark.parametrize("n", [1, 2, 12])
def test_chains_of_any_length_are_in_natural_order(n: int) -> None:
    problem = systems.coupled_oscillators(n)
    assert problem.H.names[:n] == tuple(f"q{i}" for i in range(1, n + 1))
    truth = reference(problem.H, problem.z0, problem.span)
    t = np.linspace(*problem.span, 50)
    np.testing.assert_allclose(problem.exact(t), truth(t), atol=1e-10)


@pytest.mark.parametrize("eccentricity", [0.0, 0.6, 0.99])
def test_kepler_for_every_ellipse(eccentricity: float) -> None:
    problem = systems.kepler(eccentricity)
    t = np.linspace(-7, 7, 101)
    z = problem.exact(t)
    energy = problem.H.compile("numpy").energy(z)
    np.testing.assert_allclose(energy, -0.5, atol=1e-10)


def test_kepler_as_usual() -> None:
    problem = systems.kepler()
    np.testing.assert_allclose(problem.z0, (0.4, 0, 0, 2))
    assert problem.period == pytest.approx(2 * math.pi)


@pytest.mark.parametrize(
    "make",
    [
        lambda: systems.pendulum(4.0),
        lambda: systems.pendulum(0.0),
        lambda: systems.kepler(1.0),
        lambda: systems.kepler(-0.1),
        lambda: systems.coupled_oscillators(0),
    ],
)
def test_unusable_arguments(make: object) -> None:
    with pytest.raises(InputError, match="cannot be used; give"):
        make()  # type: ignore[operator]


def test_catalogue_lists_every_public_function() -> None:
    public = {name for name in systems.__all__ if name[0].islower()}
    assert public == set(CATALOGUE)
