"""Bounds on the error of a march by its own windows, and what each part of them is for."""

from __future__ import annotations

import dataclasses
import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import systems
from hamsym.kernel.enclosures import enclosures
from hamsym.numerics.collocation import chebyshev_values
from hamsym.proof.windows.equation import equation_of
from hamsym.proof.windows.followed_march import follow, march_proof
from tests.proof.test_mutations import changed

PENDULUM = "p**2/2 - cos(x)"
SPAN = (0.0, 12.0)
TERMS = 24


def starts(radius: float) -> list[tuple[float, float]]:
    """The corners of a box of starts."""
    return [(1.5 + a * radius, 0.25 + b * radius) for a in (-1, 1) for b in (-1, 1)]


def misses(L: Any, solution: Any, radius: float) -> list[Any]:
    """Windows in which a solution from a box of starts is further from y than the bound."""
    proof = march_proof(equation_of(solution.H), solution.trial)
    count, dim = len(solution.trial.readouts), solution.H.dim
    apart, rest = np.empty((count, dim, TERMS)), np.empty((count, dim))
    proof["sizes"][:] = 1.0
    if radius:
        proof["G"].ravel()[: dim * dim] = np.eye(dim).ravel()
        proof["R"][:dim] = radius * (1 + 1e-9)
        proof.columns = dim
    assert L.follow(proof, 0, count, apart, rest) == count
    edges, x = solution.trial.edges, np.linspace(-0.98, 0.98, 21)
    times = (edges[:-1, None] + np.diff(edges)[:, None] * (1 + x) / 2).ravel()
    near = np.einsum("xk,wik->wxi", chebyshev_values(x, TERMS), apart)
    missed = []
    for start in starts(radius) if radius else [tuple(solution.z0)]:
        exact = hamsym.solve(PENDULUM, start, SPAN, tol=1e-12)
        errors = (solution(times) - exact(times)).reshape(near.shape)
        beyond = (np.abs(errors - near) > rest[:, None] + 1e-11).any(axis=(1, 2))
        missed += np.flatnonzero(beyond).tolist()
    return missed


@pytest.fixture(scope="module")
def solution():
    return hamsym.solve(PENDULUM, (1.5, 0.25), SPAN, tol=1e-9)


@pytest.fixture(scope="module")
def rippled(solution):
    """A march with a ripple of high degree on each window."""
    trial = solution.trial
    series, readouts = trial.series.copy(), trial.readouts.copy()
    series[:, -1] = 0.0
    series[40, -1] = 1.0
    readouts[:, -1] = 1e-6
    return dataclasses.replace(
        solution, trial=dataclasses.replace(trial, series=series, readouts=readouts)
    )


@pytest.mark.parametrize("radius", [0.0, 1e-6, 1e-3])
def test_bounds_hold_for_every_start_of_a_set(solution, radius):
    assert misses(enclosures(), solution, radius) == []


def test_bounds_hold_for_a_march_with_ripples(rippled):
    assert misses(enclosures(), rippled, 0.0) == []


_POOR = (("+= rest[k];", "+= rest[k] + (k == 1 ? 1e-6 : 0.0);"),)
_DISPLACED = (("low[0] += (m->centre[i]", "low[0] += 1e-6 + (m->centre[i]"),)
#: Text, its weaker form, radius of the set, the march, and what makes the guess poor before.
MUTATIONS = {
    "set": ("fabs(m->G[i * m->columns + c]) * m->R[c]", "0.0", 1e-6, "solution", ()),
    "errors of windows": ("up(rest[i] + added[i])", "up(rest[i])", 0.0, "solution", _POOR),
    "rest of a window": ("d[i] + w->D[i] + end.radius", "end.radius", 0.0, "solution", _POOR),
    "distance of the start": ("fabs(gap) + MIDDLE", "MIDDLE", 0.0, "solution", _DISPLACED),
    "tube beside the polynomial": (
        "trial->radius[i] + w->tube[i]",
        "trial->radius[i]",
        1e-6,
        "solution",
        (),
    ),
    "terms of the march beyond": (
        "total + norm_of(high + terms, low + terms, trial->length[i] - terms)",
        "total",
        0.0,
        "rippled",
        (),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", MUTATIONS)
def test_weakened_bound_has_a_miss(name, request):
    old, new, radius, march, before = MUTATIONS[name]
    given = request.getfixturevalue(march)
    assert misses(changed(before), given, radius) == []
    assert misses(changed((*before, (old, new))), given, radius)


@pytest.mark.parametrize(
    ("name", "span"),
    [("harmonic_oscillator", (0.0, 20.0)), ("kepler", (0.0, 9.0)), ("pendulum", (3.0, -9.0))],
)
def test_bound_that_was_asked_for_is_above_the_true_error(name, span):
    problem = systems.CATALOGUE[name]()
    solution = hamsym.solve(problem.H, problem.z0, span, tol=1e-8)
    found = solution.certify(bound=1e-5)
    assert found.edges == tuple((solution.trial.origin + solution.trial.edges).tolist())
    t = np.linspace(*span, 3_001)
    if problem.exact and span[0] == 0:
        truth = problem.exact(t)
    else:
        truth = hamsym.solve(problem.H, problem.z0, span, tol=1e-12)(t)
    error = np.abs(solution(t) - truth).max(axis=0)
    assert (error <= np.array(found.component_bounds) + 1e-13).all()
    assert (error >= 0.9 * np.array(found.component_lowers) - 1e-13).all()
    hamsym.verify(found, solution)


def test_bounds_below_the_round_off_of_the_march_take_windows_of_their_own():
    """The errors of a march whose tolerance is near round-off are still decided."""
    solution = hamsym.solve(PENDULUM, (1.5, 0.25), (0.0, 60.0), tol=1e-12)
    (*_, last) = follow(equation_of(solution.H), solution.trial, len(solution.trial.readouts))
    assert last.end == len(solution.trial.readouts)
    exact = solution.certify()
    asked = 1.3 * np.array(exact.component_bounds)
    assert (np.array(solution.certify(bound=asked).component_bounds) <= asked).all()


def test_components_at_rest_have_units_of_their_own():
    H = "(p_x**2 + p_y**2 + p_z**2)/2 - 1/sqrt(x**2 + y**2 + z**2)"
    solution = hamsym.solve(H, (1.0, 0.0, 0.0, 0.0, 1.1, 0.0), (0.0, 5.0))
    found = solution.certify(bound=1e-7)
    assert found.component_bounds[2] == found.component_bounds[5] == 0
    assert len(found.edges) == len(solution.trial.edges)


def test_march_through_a_collision_is_not_followed():
    solution = hamsym.solve("p**2/2 + x**2/2", (1.0, 0.0), (0.0, 3.0))
    other = hamsym.Hamiltonian("p**2/2 - 1/x")
    parts = [*follow(equation_of(other), solution.trial, len(solution.trial.readouts))]
    assert parts[-1].end < len(solution.trial.readouts)


def test_time_is_exact_far_from_the_origin():
    """cos(x - t) at t = 1e8 needs the time to more digits than float64 has."""
    span = (1e8, 1e8 + 4.0)
    solution = hamsym.solve("p**2/2 - cos(x - t)", (1.0, 0.0), span, tol=1e-9)
    found = solution.certify(bound=1e-6)
    exact = solution.certify()
    assert found.lower <= exact.bound
    assert exact.lower <= found.bound
    assert Fraction(found.edges[-1]) == Fraction(span[1])
    assert math.isclose(found.bound, exact.bound, rel_tol=2)


def test_march_of_a_long_chain_is_followed():
    """Of 72 components, of which half are at rest in the beginning."""
    problem = systems.fermi_pasta_ulam_tsingou(36)
    solution = hamsym.solve(problem.H, problem.z0, (0.0, 4.0), tol=1e-9)
    found = solution.certify(bound=1e-8)
    assert len(found.edges) == len(solution.trial.edges)
