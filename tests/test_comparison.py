"""The comparison table: what it measures, what it searches for, and what it only extrapolates."""

from __future__ import annotations

import math

import numpy as np
import pytest

import hamsym
from hamsym import Comparison, Solution
from hamsym.comparison import StepsToMatch
from hamsym.systems import Problem, charged_particle, harmonic_oscillator


def quick(problem: Problem, epochs: int = 1500) -> Solution:
    return hamsym.solve(
        problem.H,
        problem.z0,
        (0, 1.5),
        method="adam",
        hidden=(20, 20),
        points=30,
        noise=0.0,
        tau=0.25,
        schedule="cosine",
        epochs=epochs,
    )


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    problem = harmonic_oscillator()
    return hamsym.compare(quick(problem), exact=problem.exact)


def test_rows_are_network_and_euler_at_k_10k_100k(comparison: Comparison) -> None:
    assert [row.label for row in comparison.rows] == ["network"] + 3 * ["symplectic Euler"]
    assert [row.points for row in comparison.rows] == [30, 30, 300, 3000]


def test_errors_are_those_of_the_trajectories(comparison: Comparison) -> None:
    exact = harmonic_oscillator().exact
    for row, trajectory in zip(comparison.rows[1:], comparison.trajectories, strict=True):
        error = trajectory.z - exact(trajectory.t)
        assert row.error == pytest.approx(np.linalg.norm(error, axis=1).max(), rel=1e-12)
        np.testing.assert_allclose(row.component_errors, np.abs(error).max(axis=0), rtol=1e-12)
        assert row.energy_error == pytest.approx(np.abs(trajectory.energy - 0.5).max(), rel=1e-6)
    t = np.linspace(0, 1.5, 4001)
    network = np.linalg.norm(comparison.solution(t) - exact(t), axis=1).max()
    assert comparison.rows[0].error == pytest.approx(network, rel=1e-9)


def test_steps_to_match_are_just_enough(comparison: Comparison) -> None:
    steps, target = comparison.steps_to_match.steps, comparison.rows[0].error
    assert steps is not None
    problem = harmonic_oscillator()

    def error(n: int) -> float:
        trajectory = hamsym.integrate(problem.H, problem.z0, (0, 1.5), steps=n)
        return float(np.linalg.norm(trajectory.z - problem.exact(trajectory.t), axis=1).max())

    assert error(steps) <= target * (1 + 1e-6)
    assert error(int(steps / 1.03) - 1) > target
    assert comparison.steps_to_match.error <= target


def test_beyond_the_limit_is_an_extrapolation_and_says_so() -> None:
    problem = harmonic_oscillator()
    solution = quick(problem)
    full = hamsym.compare(solution, exact=problem.exact).steps_to_match.steps
    assert full is not None
    limited = hamsym.compare(solution, exact=problem.exact, max_steps=full // 10).steps_to_match
    assert limited.steps is None
    assert limited.extrapolated == pytest.approx(full, rel=0.05)
    assert "extrapolated" in str(limited)
    assert str(limited).startswith("> ")


def test_how_steps_to_match_are_written() -> None:
    assert str(StepsToMatch(1234, 1e-3, None)) == "1,234"
    beyond = StepsToMatch(None, 1e-7, 2.5e9)
    assert str(beyond) == "> 1e8 (extrapolated: 2.5e+09)"
    assert str(StepsToMatch(None, 1e-7, 2.5e9, limit=10**6)).startswith("> 1e6 (extrap")


def test_where_the_reference_dominates_it_is_said() -> None:
    H = hamsym.Hamiltonian("p**2/2 - x**2/2 + x**4/4")
    solution = hamsym.solve(H, [0.1, 0.0], (0, 30), tol=1e-11)
    comparison = hamsym.compare(solution, max_steps=10**6)
    assert comparison.reference_error > 0.01 * comparison.rows[0].error
    assert "reference: DOP853, itself good to about" in str(comparison)


def test_only_solutions_are_compared() -> None:
    with pytest.raises(hamsym.InputError, match="takes a Solution, not Hamiltonian"):
        hamsym.compare(harmonic_oscillator().H)  # type: ignore[arg-type]


def test_table_fits_eighty_columns(comparison: Comparison) -> None:
    lines = str(comparison).splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[0].split() == ["method", "points", "max", "|dz|", "max", "|dE|", "time", "s"]
    assert lines[-1].startswith("Euler steps for the network's error: ")


def test_non_separable_systems_are_compared_too() -> None:
    problem = charged_particle()
    comparison = hamsym.compare(quick(problem, epochs=300))
    assert all(math.isfinite(row.error) for row in comparison.rows)
    assert comparison.steps_to_match.steps is not None


def test_coarse_euler_that_breaks_off_counts_as_infinitely_wrong() -> None:
    # H = p q^2 blows up at t = 1/q(0), and its implicit step has no solution for h q > 1/4.
    H = hamsym.Hamiltonian("p*q**2", q=["q"], p=["p"])
    solution = hamsym.solve(H, [1.0, 1.0], (0, 0.7), method="adam", epochs=200, points=3, noise=0)
    rows = hamsym.compare(solution).rows
    assert rows[1].error == math.inf
    assert math.isfinite(rows[3].error)


def test_reference_without_an_exact_solution() -> None:
    problem = harmonic_oscillator()
    solution = quick(problem, epochs=200)
    with_exact = hamsym.compare(solution, exact=problem.exact).rows[0].error
    assert hamsym.compare(solution).rows[0].error == pytest.approx(with_exact, rel=1e-8)


def test_figure(comparison: Comparison) -> None:
    figure = comparison.plot()
    assert len(figure.axes) == 4
    assert all(axis.lines for axis in figure.axes)
