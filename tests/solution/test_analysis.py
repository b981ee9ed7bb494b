"""The paper's error analysis, and the two ways in which its bound fails."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian, Solution
from hamsym.errors import VacuousBoundWarning
from hamsym.kernel.loops import ErrorTables
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.error_estimate import error_tables
from hamsym.solution.analysis import Analysis
from hamsym.systems import harmonic_oscillator, henon_heiles, nonlinear_oscillator


class Resonant:
    """z^ = (1 + eps t) (cos t, -sin t), whose residual is in resonance with the motion."""

    def __init__(self, eps: float) -> None:
        self._eps = eps

    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        right = np.stack((np.cos(t), -np.sin(t)), axis=-1)
        rate = np.stack((-np.sin(t), -np.cos(t)), axis=-1)
        grown = (1 + self._eps * t)[:, None]
        return grown * right, grown * rate + self._eps * right

    def states_at(self, t: np.ndarray) -> np.ndarray:
        return self.states_and_rates(t)[0]


@cache
def trained(name: str) -> Solution:
    problem = {"oscillator": nonlinear_oscillator, "henon_heiles": henon_heiles}[name]()
    span = (0, 2) if name == "oscillator" else (0, 6)
    return hamsym.solve(problem.H, problem.z0, span, method="levenberg-marquardt", tol=1e-3)


@pytest.fixture(scope="module")
def oscillator() -> Solution:
    return trained("oscillator")


def resonant(eps: float, end: float) -> Solution:
    problem = harmonic_oscillator()
    like = hamsym.solve(problem.H, problem.z0, (0, end), method=hamsym.Adam(epochs=1, points=2))
    return Solution(
        problem.H,
        like.z0,
        (0.0, end),
        Resonant(eps),  # type: ignore[arg-type]
        method="adam",
        record=like.record,
        settings=like.settings,
    )


@pytest.mark.slow
def test_resonant_residual_violates_the_bound() -> None:
    """ell = eps (cos t, -sin t) has size eps all along, and the error grows to eps T."""
    solution = resonant(1e-3, 4 * math.pi)
    analysis = solution.analysis
    assert analysis.sigma_min == pytest.approx(1.0)
    assert analysis.ell_max == pytest.approx(1e-3, rel=1e-12)
    t = np.linspace(0, 4 * math.pi, 2001)
    error = np.abs(solution(t) - harmonic_oscillator().exact(t)).max()
    assert error > 12 * analysis.bound
    # The equation of the error and the whole inequality account for the resonance.
    assert np.abs(solution.error_estimate(t)).max() == pytest.approx(error, rel=1e-4)
    sizes = np.linalg.norm(analysis.linearized_error(t), axis=1)
    assert np.all(sizes <= analysis.inequality(t) * (1 + 1e-6) + 1e-12)


def test_bound_vacuous_where_hessian_is_singular() -> None:
    problem = henon_heiles()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
    analysis = solution.analysis
    x, y = solution(analysis.singular_times).T[:2]
    assert len(x) == 6
    np.testing.assert_allclose(x**2 + y**2, 0.25, atol=1e-13)
    assert not analysis.is_always_singular
    assert analysis.sigma_min == 0
    assert analysis.bound == math.inf
    assert np.all(np.isinf(analysis.inequality(np.array([1.0, 2.0]))))
    with pytest.warns(VacuousBoundWarning):
        assert solution.error_bound == math.inf
    # The number that a grid gives depends on the grid.
    sampled = [np.abs(analysis.eigenvalues(np.linspace(0, 18, n))).min() for n in (100, 10_000)]
    assert sampled[0] > 3 * sampled[1] > 0


@pytest.mark.parametrize(
    ("H", "z0"),
    [
        ("p_r**2/2 + p_phi**2/(2*r**2) - 1/r", [0.0, 1.0, 1.1, 0.1]),
        ("p1**2/2 + p2**2/2 + exp(q1 - q2)", [0.0, 1.0, 0.5, 0.0]),
    ],
    ids=["cyclic", "translation"],
)
def test_bound_vacuous_with_a_symmetry(H: str, z0: list[float]) -> None:
    analysis = hamsym.solve(Hamiltonian(H), z0, (0, 3), tol=1e-8).analysis
    assert analysis.is_always_singular
    assert analysis.sigma_min == 0
    assert len(analysis.singular_times) == 0
    assert analysis.bound == math.inf


@pytest.mark.slow_cases("henon_heiles")
@pytest.mark.parametrize("name", ["oscillator", "henon_heiles"])
def test_linearised_error_is_the_error_to_first_order(oscillator: Solution, name: str) -> None:
    solution = oscillator if name == "oscillator" else trained(name)
    t = np.linspace(*solution.span, 301)
    full, linear = solution.error_estimate(t), solution.analysis.linearized_error(t)
    size = np.abs(full).max()
    assert 1e-7 < size < 1e-2
    assert np.abs(full - linear).max() < 10 * size**2 + 1e-5 * size
    assert np.abs(full - linear).max() > 0


def test_inequality_holds_for_the_linearised_error(oscillator: Solution) -> None:
    solution = oscillator
    t = np.linspace(*solution.span, 601)
    sizes = np.linalg.norm(solution.analysis.linearized_error(t), axis=1)
    right = solution.analysis.inequality(t)
    assert np.all(sizes <= right * (1 + 1e-9))
    # With the rate of the error it is wider than ell_max/sigma_min, which it contains.
    assert np.all(right >= solution.ell_max / solution.sigma_min * (1 - 1e-9))


def test_extrema_are_over_continuous_time(oscillator: Solution) -> None:
    analysis = oscillator.analysis
    t = np.linspace(*oscillator.span, 100_001)
    assert analysis.ell_max >= analysis.ell(t).max() * (1 - 1e-9)
    assert analysis.ell(np.array([analysis.ell_max_time]))[0] == analysis.ell_max
    smallest = np.abs(analysis.eigenvalues(t)).min()
    assert analysis.sigma_min == pytest.approx(smallest, rel=1e-6)
    assert analysis.sigma_min <= smallest * (1 + 1e-12)


@pytest.mark.slow
def test_estimate_check_agrees_with_estimate(oscillator: Solution) -> None:
    """Of both kinds of estimate, far below the error; and it is another computation."""
    problem = nonlinear_oscillator()
    marched = hamsym.solve(problem.H, problem.z0, (0, 6), tol=1e-6)
    for solution, share in ((oscillator, 1e-4), (marched, 1e-2)):
        t = np.linspace(*solution.span, 301)
        estimate, check = solution.error_estimate(t), solution.error_estimate_check(t)
        assert check.shape == estimate.shape
        assert 0 < check.max() < share * np.abs(estimate).max()


@pytest.mark.slow
def test_estimate_check_survives_a_file(tmp_path: Path) -> None:
    problem = henon_heiles()
    solution = hamsym.solve(problem.H, problem.z0, (0, 6), tol=1e-7, seed=3)
    solution.save(tmp_path / "orbit.hamsym")
    again = hamsym.load(tmp_path / "orbit.hamsym")
    t = np.linspace(0, 6, 50)
    np.testing.assert_array_equal(again.error_estimate_check(t), solution.error_estimate_check(t))


def test_estimate_check_flags_unresolved_estimate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """With the Hessian at the start of each window the check equals the error of the estimate."""

    def coarse(basis: FeatureBasis, resolution: int = 0) -> ErrorTables:
        tables = error_tables.__wrapped__(basis, resolution)
        if resolution < 2:
            for rule in ("coarse", "fine"):
                tables[rule]["at_nodes"][:] = 0
        return tables

    monkeypatch.setattr("hamsym.random_features.error_estimate.error_tables", coarse)
    problem = nonlinear_oscillator()
    # Members, which have no breakpoints, have tables of their own.
    solution = hamsym.solve(problem.H, problem.z0, (0, 6), tol=1e-4, breakpoints=[5.9])
    t = np.linspace(0, 6, 301)
    estimate, check = solution.error_estimate(t), solution.error_estimate_check(t)
    wrong = np.abs(problem.exact(t) - solution(t) - estimate).max()
    assert wrong > 0.05 * np.abs(estimate).max()
    assert check.max() == pytest.approx(wrong, rel=1e-3)


@pytest.mark.parametrize(("formula", "stops"), [("sign(t - 1)*x", [1.0]), ("sign(t)*x", [])])
def test_ell_max_ignores_window_boundaries(formula: str, stops: list[float]) -> None:
    """At t = 1 itself sign is 0, a force that acts at no other time."""
    solution = hamsym.solve(f"p**2/2 + x**2/2 + {formula}", [1, 0], (0, 5), breakpoints=stops)
    assert solution.success
    t = np.linspace(0, 5, 5_000)[1:-1]
    beside = np.linalg.norm(solution.residual(t), axis=-1).max()
    assert 0.9 * beside <= solution.ell_max < 1e-8


def test_nan_is_never_small(monkeypatch: pytest.MonkeyPatch) -> None:
    """With a Hessian or residual that is NaN from t = 3 on there is no bound."""
    solution = hamsym.solve("p**2/2 + x**2/2", [1.0, 0.0], (0, 6))
    hessians, residual = solution.hessians, solution.residual

    def lost(values: np.ndarray, t: np.ndarray) -> np.ndarray:
        late = np.reshape(np.asarray(t) > 3, np.shape(t) + (1,) * (values.ndim - np.ndim(t)))
        return np.where(late, np.nan, values)

    monkeypatch.setattr(Solution, "hessians", lambda self, t: lost(hessians(t), t))
    found = Analysis(solution)
    assert (found.sigma_min, found.bound) == (0.0, np.inf)
    assert found.sigma_min_time == pytest.approx(3, abs=0.01)
    assert np.isnan(found.eigenvalues(np.array([1.0, 4.0]))).tolist() == [[False] * 2, [True] * 2]
    monkeypatch.setattr(Solution, "residual", lambda self, t: lost(residual(t), t))
    assert Analysis(solution).ell_max == np.inf
