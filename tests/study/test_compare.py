"""The comparison table: measured errors, searched steps and extrapolated ones."""

from __future__ import annotations

import functools
import math
import warnings
from collections.abc import Callable

import numpy as np
import pytest

import hamsym
from hamsym import Comparison, Solution
from hamsym.errors import InputError
from hamsym.integrators import stepper
from hamsym.study.compare import chosen_methods
from hamsym.study.matching import Match, ReferenceSolution, run
from hamsym.systems import (
    Problem,
    charged_particle,
    harmonic_oscillator,
    kepler,
    nonlinear_oscillator,
)


@functools.cache
def quick(make: Callable[[], Problem], epochs: int = 600) -> Solution:
    problem = make()
    return hamsym.solve(
        problem.H,
        problem.z0,
        (0, 1.5),
        method=hamsym.Adam(
            hidden=(20, 20),
            points=30,
            noise=0.0,
            tau=0.25,
            schedule="cosine",
            learning_rate=0.02,
            epochs=epochs,
        ),
    )


EULER = "symplectic_euler"


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    problem = harmonic_oscillator()
    return hamsym.compare(quick(harmonic_oscillator), EULER, exact=problem.exact)


def test_rows_are_network_and_euler_at_k_10k_100k(comparison: Comparison) -> None:
    assert [row.label for row in comparison.rows] == ["network"] + 3 * [EULER]
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
    steps, target = comparison.matches[EULER].steps, comparison.rows[0].error
    assert steps is not None
    problem = harmonic_oscillator()

    def error(n: int) -> float:
        trajectory = hamsym.integrate(problem.H, problem.z0, (0, 1.5), EULER, steps=n)
        return float(np.linalg.norm(trajectory.z - problem.exact(trajectory.t), axis=1).max())

    assert error(steps) <= target * (1 + 1e-6)
    assert error(int(steps / 1.03) - 1) > target
    assert comparison.matches[EULER].error <= target


def test_steps_beyond_the_limit_are_extrapolated() -> None:
    problem = harmonic_oscillator()
    solution = quick(harmonic_oscillator)
    full = hamsym.compare(solution, EULER, exact=problem.exact).matches[EULER].steps
    assert full is not None
    limited = hamsym.compare(solution, EULER, exact=problem.exact, max_steps=full // 10).matches[
        EULER
    ]
    assert limited.steps is None
    assert limited.extrapolated == pytest.approx(full, rel=0.05)
    assert "extrapolated" in str(limited)
    assert str(limited).startswith("> ")


def test_long_search_is_extrapolated(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = harmonic_oscillator()
    solution = quick(harmonic_oscillator)
    full = hamsym.compare(solution, EULER, exact=problem.exact).matches[EULER].steps
    assert full is not None
    assert full > 300
    monkeypatch.setattr("hamsym.study.matching._SEARCH_SECONDS", 1e-9)
    found = hamsym.compare(solution, EULER, points=3, exact=problem.exact)
    match = found.matches[EULER]
    assert match.reason == "> 300 steps"
    assert match.extrapolated == pytest.approx(full, rel=0.1)


# One of each kind.
METHODS = ["yoshida4", "gauss4", "tao2", "dop853"]


@pytest.fixture(scope="module")
def several() -> Comparison:
    problem = nonlinear_oscillator()
    solution = hamsym.solve(
        problem.H, problem.z0, (0, 5), tol=1e-4, method=hamsym.LevenbergMarquardt()
    )
    return hamsym.compare(solution, METHODS, points=50, exact=problem.exact)


def test_any_integrators_are_compared(several: Comparison) -> None:
    names = [name if name != "yoshida4" else "forest_ruth" for name in METHODS]
    assert list(several.matches) == names
    assert [row.label for row in several.rows[1:]] == [name for name in names for _ in range(3)]
    for row in several.rows:
        assert row.evaluations > 0
        assert row.error > 0
    tolerances = [row.tolerance for row in several.rows if row.label == "dop853"]
    assert tolerances == [1e-3, 1e-6, 1e-9]


def test_every_match_is_just_enough(several: Comparison) -> None:
    problem, target = nonlinear_oscillator(), several.rows[0].error

    def error(**options: object) -> float:
        found = hamsym.integrate(problem.H, problem.z0, (0, 5), **options)
        return float(np.linalg.norm(found.z - problem.exact(found.t), axis=1).max())

    for name, match in several.matches.items():
        assert match.error <= target
        if name == "dop853":
            assert match.tolerance is not None
            wider = 2 * match.tolerance
            assert error(method=name, steps=4000, rtol=wider, atol=wider) > target
        else:
            assert match.steps is not None
            assert error(method=name, steps=match.steps) <= target * 1.05
            assert error(method=name, steps=int(0.95 * match.steps)) > target


def test_round_off_limit_is_named() -> None:
    """The error of the network against itself is 0, which no integrator reaches."""
    problem = nonlinear_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 2), tol=1e-11)
    methods = ["yoshida8", "dop853", EULER]
    comparison = hamsym.compare(solution, methods, points=50, exact=solution, max_steps=10**6)
    reasons = [match.reason for match in comparison.matches.values()]
    assert reasons[0].startswith("not reached: round-off leaves")
    assert reasons[1].startswith("not reached, ")
    assert reasons[2] == "> 1e6 steps"
    assert "not reached: round-off leaves" in str(comparison)


@pytest.mark.slow
def test_error_of_the_size_of_the_motion_is_not_round_off() -> None:
    """An error of the size of the motion is bounded, and does not fall with the steps."""
    H = hamsym.Hamiltonian("p**2/2 - cos(x) - cos(x - t)")
    solution = hamsym.solve(H, [1.0, 0.5], (0, 60), tol=1e-6)
    comparison = hamsym.compare(solution, "implicit_midpoint", points=3, max_steps=20_000)
    match = comparison.matches["implicit_midpoint"]
    assert "round-off" not in match.reason


@pytest.mark.slow
def test_comparison_independent_of_units() -> None:
    m, w = 9.1e-31, 1e15
    H = hamsym.Hamiltonian("p**2/(2*m) + m*w**2*x**2/2", parameters={"m": m, "w": w})
    solution = hamsym.solve(H, [1e-10, 0.0], (0, 6e-15), tol=1e-9)
    comparison = hamsym.compare(solution, ["yoshida8", "dop853"])

    def exact(t: np.ndarray) -> np.ndarray:
        return 1e-10 * np.stack((np.cos(w * t), -m * w * np.sin(w * t)), axis=-1)

    right = hamsym.compare(solution, ["yoshida8", "dop853"], exact=exact)
    for found, wanted in zip(comparison.rows[:4], right.rows[:4], strict=True):
        assert found.error == pytest.approx(wanted.error, rel=0.5, abs=1e-22)


def test_ctrl_c_ends_a_comparison(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 5), tol=1e-6)
    original, calls = stepper.Stepper._run, []

    def interrupted(self: stepper.Stepper, *arguments: object) -> np.ndarray:
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return original(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(stepper.Stepper, "_run", interrupted)
    with pytest.raises(KeyboardInterrupt):
        hamsym.compare(solution, "yoshida4")
    assert len(calls) == 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_steps": 0}, "max_steps=0"),
        ({"points": 0}, "points=0"),
        ({"points": -3}, "points=-3"),
        ({"max_steps": "a"}, "max_steps='a'"),
        ({"methods": None}, "methods=None cannot be used; give a name or a list"),
        ({"exact": 3}, "exact=3 cannot be used; give a function"),
        ({"exact": lambda t: "a"}, "the exact solution has an entry that is not a real number"),
        ({"exact": lambda t: np.zeros((2, len(t)))}, r"the exact solution has shape \(2, "),
    ],
)
def test_unusable_options_are_rejected(
    comparison: Comparison, options: dict[str, object], message: str
) -> None:
    with pytest.raises(hamsym.InputError, match=message):
        hamsym.compare(comparison.solution, **options)  # type: ignore[arg-type]


def test_unusable_integrators_are_rejected() -> None:
    problem = charged_particle()
    solution = hamsym.solve(problem.H, problem.z0, (0, 1), tol=1e-6)
    with pytest.raises(hamsym.InputError, match="stormer_verlet needs H = "):
        hamsym.compare(solution, "stormer_verlet")
    with pytest.raises(hamsym.InputError, match="'rk4' is not a method"):
        hamsym.compare(solution, ["gauss4", "rk4"])
    with pytest.raises(hamsym.InputError, match="methods is empty"):
        hamsym.compare(solution, [])


def test_steps_without_a_divisor_are_a_few_more() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 1), tol=1e-6)
    assert run(solution, EULER, 8_009).steps == 8_010  # 8,009 is a prime
    assert run(solution, EULER, 9_000).steps == 9_000


def test_text_of_matches() -> None:
    assert str(Match(1234, 1, 1e-3, 0.1)) == "1,234"
    assert str(Match(None, 1, 1e-3, 0.1, tolerance=1e-9)) == "rtol 1e-09"
    beyond = Match(None, 0, 1e-7, 0.0, extrapolated=2.5e9, reason="> 1e8 steps")
    assert str(beyond) == "> 1e8 steps (extrapolated: 2.5e+09)"


# DOP853 has an error of 2e-12 for it, and enclosures need smooth formulas: abs(x)**5 is not.
ROUGH = "p**2/2 - x**2/2 + x**4/4 + abs(x)**5/1000"
METHODS_OF_BOUNDS = [EULER, "blanes_moan6", "dop853"]


@pytest.mark.slow
def test_errors_below_that_of_the_reference_have_only_bounds() -> None:
    solution = hamsym.solve(ROUGH, [0.1, 0.0], (0, 30), tol=1e-10)
    comparison = hamsym.compare(solution, METHODS_OF_BOUNDS)
    u, network = comparison.reference_error, comparison.rows[0].error
    assert 10 * u > network
    assert comparison.reference.text == f"DOP853, whose error is about {u:.0e}"
    euler, blanes, dop853 = comparison.matches.values()
    assert euler.reason.startswith("> ")
    assert euler.extrapolated is None
    assert dop853.reason.startswith("rtol below ")
    fewest = int(blanes.reason.removeprefix("at least ").removesuffix(" steps").replace(",", ""))
    path = hamsym.integrate(ROUGH, [0.1, 0.0], (0, 30), "blanes_moan6", steps=int(0.97 * fewest))
    errors = np.linalg.norm(path.z - comparison.reference(path.t), axis=1)
    assert errors.max() > network + 2 * u
    assert "have only bounds" in comparison.summary().replace("\n", " ")


def test_reference_judges_errors_ten_times_its_own() -> None:
    found = ReferenceSolution(np.cos, 1e-9, "")
    assert found.judges(1.1e-8)
    assert not found.judges(0.9e-8)
    assert not found.judges(np.nan)


@pytest.mark.slow
def test_errors_below_that_of_dop853_are_against_an_enclosure() -> None:
    problem = kepler(eccentricity=0.6)
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-10)
    comparison = hamsym.compare(solution, "gauss6")
    assert comparison.reference_error < 1e-14
    assert comparison.reference.text.startswith("the exact solution, enclosed to ")
    assert comparison.reference.text in comparison.summary().replace("\n", " ")
    assert problem.reference is not None
    exact = np.array(problem.reference.z, dtype=float)
    end = np.array([problem.reference.t])
    np.testing.assert_allclose(comparison.reference(end)[0], exact, atol=1e-15)
    assert comparison.matches["gauss6"].steps is not None


def test_references_that_miss_a_pulse_have_no_error() -> None:
    width, late = 1e-5, 0.7655  # since a kick of p by -1/2 at t = 1.2345
    H = f"p**2/2 + x**2/2 + {0.5 / (width * math.sqrt(math.pi))}*x*exp(-((t - 1.2345)/{width})**2)"
    solution = hamsym.solve(H, [1, 0], (0, 2), tol=1e-8)
    x, p = np.cos(1.2345), -np.sin(1.2345) - 0.5
    true = [x * np.cos(late) + p * np.sin(late), p * np.cos(late) - x * np.sin(late)]
    np.testing.assert_allclose(solution(2.0), true, atol=1e-4)
    comparison = hamsym.compare(solution, "blanes_moan6", max_steps=1_000)
    wrong = np.abs(comparison.reference(np.array([2.0]))[0] - true).max()
    assert wrong < comparison.reference_error
    assert not comparison.reference.judges(comparison.rows[0].error)
    assert "whose error is not known" in comparison.summary().replace("\n", " ")


@pytest.mark.parametrize("end", [7, pytest.param(100, marks=pytest.mark.slow)])
def test_references_that_miss_a_spike_match_nothing(end: float) -> None:
    """The second solution ends early, without success, and is accurate before."""
    solution = hamsym.solve("p**2/2 + x**2/2 + 0.01*exp(-((x - 0.5)/1e-5)**2)", [1, 0], (0, end))
    assert solution.success == (end == 7)
    assert (solution.largest_error < 1e-8).all()
    comparison = hamsym.compare(solution, ["blanes_moan6", "dop853"], points=100, max_steps=1_000)
    assert comparison.reference_error == math.inf
    for match in comparison.matches.values():
        assert match.reason.startswith("unknown")


def test_enclosures_are_references_of_motions_that_run_backwards() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, -5), tol=1e-10)
    truth = hamsym.compare(solution, "usual", max_steps=1_000).reference
    t = np.linspace(0, -5, 301)
    np.testing.assert_allclose(truth(t), problem.exact(t), atol=2e-15)


def test_usual_methods_suit_the_equations() -> None:
    forced = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p"})
    split = ["stormer_verlet", "blanes_moan6", "dop853"]
    implicit = ["implicit_midpoint", "gauss6", "dop853"]
    assert chosen_methods(hamsym.Hamiltonian("p**2/2 + x**4/4 - x*cos(t)"), "usual") == split
    for H in (hamsym.Hamiltonian("x**2*p**2/2 + p**2/2"), forced):
        assert chosen_methods(H, "usual") == implicit


def test_only_solutions_are_compared() -> None:
    with pytest.raises(hamsym.InputError, match="expected a Solution, not Hamiltonian"):
        hamsym.compare(harmonic_oscillator().H)  # type: ignore[arg-type]


def test_table_fits_eighty_columns(comparison: Comparison) -> None:
    lines = str(comparison).splitlines()
    assert max(map(len, lines)) <= 80
    table = lines.index("") + 1
    assert lines[table].split()[:3] == ["method", "points", "evaluations"]
    assert any(line.startswith("for the network's error, ") for line in lines[table:])
    assert lines[-1].startswith(EULER)


def test_table_of_many_fits_eighty_columns(several: Comparison) -> None:
    assert max(map(len, str(several).splitlines())) <= 80


@pytest.mark.slow
def test_non_separable_systems_are_compared() -> None:
    comparison = hamsym.compare(quick(charged_particle, epochs=300), EULER)
    assert all(math.isfinite(row.error) for row in comparison.rows)
    assert comparison.matches[EULER].steps is not None


@pytest.mark.slow
def test_failed_euler_has_infinite_error() -> None:
    # H = p q^2 blows up at t = 1/q(0), and its implicit step has no solution for h q > 1/4.
    H = hamsym.Hamiltonian("p*q**2", q=["q"], p=["p"])
    solution = hamsym.solve(
        H, [1.0, 1.0], (0, 0.7), method=hamsym.Adam(epochs=200, points=3, noise=0)
    )
    rows = hamsym.compare(solution, EULER).rows
    assert rows[1].error == math.inf
    assert math.isfinite(rows[3].error)


@pytest.mark.slow
def test_reference_without_an_exact_solution() -> None:
    problem = harmonic_oscillator()
    solution = quick(harmonic_oscillator, epochs=200)
    with_exact = hamsym.compare(solution, exact=problem.exact).rows[0].error
    assert hamsym.compare(solution).rows[0].error == pytest.approx(with_exact, rel=1e-8)


@pytest.mark.slow
def test_figure(comparison: Comparison) -> None:
    figure = comparison.plot()
    *panels, legend = figure.axes
    assert [len(axis.lines) for axis in panels] == [4, 4, 2, 3]
    assert len(legend.get_legend().get_texts()) == 4
    assert len(comparison.plot("work").axes[0].lines) == 3
    with pytest.raises(InputError, match="'werk' is not a panel of a comparison .did you mean"):
        comparison.plot("werk")


@pytest.mark.slow
def test_figure_of_many(several: Comparison) -> None:
    axes = several.plot().axes
    assert len(axes[0].lines) == 1 + len(METHODS)


def test_nan_reference_gives_infinite_error() -> None:
    problem = harmonic_oscillator()
    solution = quick(harmonic_oscillator)

    def gap(t: np.ndarray) -> np.ndarray:
        return np.where(np.abs(t[:, None] - 1) < 0.1, np.nan, problem.exact(t))

    found = hamsym.compare(solution, EULER, points=3, exact=gap, max_steps=1_000)
    for row in found.rows:
        assert row.error == row.energy_error == np.inf
        assert np.all(row.component_errors == np.inf)
    assert found.matches[EULER].reason.startswith("unknown: ")


def test_comparing_coarse_steps_does_not_warn() -> None:
    problem = nonlinear_oscillator()
    solution = hamsym.solve(problem.H, problem.z0, (0, 20), tol=1e-6)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        hamsym.compare(solution, points=20, exact=problem.exact, max_steps=1_000)
