"""Marching to a tolerance: it is met, or the message gives time and cause of the failure."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.special
import torch

import hamsym
from hamsym import Hamiltonian, InputError, systems
from hamsym.integrators.adaptive import reference
from hamsym.kernel import loops
from hamsym.random_features import method
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import march, newton
from hamsym.random_features.windows import March
from hamsym.systems import CATALOGUE, Problem
from tests.kernel.row_functions import RowProgram

# Systems whose exact solution has 13 digits.
EXACT = [
    *("calogero_moser", "charged_particle", "coupled_oscillators", "driven_oscillator"),
    *("harmonic_oscillator", "kepler", "lagrange_top", "morse_oscillator", "nonlinear_oscillator"),
    *("paul_trap", "pendulum", "penning_trap", "toda_chain"),
]


def true_error(solution: hamsym.Solution, truth, samples: int = 4_001) -> np.ndarray:
    """max_t of the error of each component, over its scale."""
    t = np.linspace(*solution.span, samples)
    return np.abs(solution(t) - truth(t)).max(axis=0) / solution.scale


@pytest.mark.parametrize("tol", [1e-3, 1e-6, 1e-9])
def test_tolerance_is_met_on_the_catalogue(problem: Problem, tol: float) -> None:
    truth = problem.exact or reference(problem.H, np.array(problem.z0), problem.span)
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=tol)
    assert solution.success, solution.message
    assert solution.message.startswith(f"tol {tol:.1e} met: ")
    assert true_error(solution, truth).max() <= tol
    assert solution(problem.span[0]).tolist() == list(problem.z0)


def test_three_bodies_return_after_a_period() -> None:
    problem = systems.three_bodies()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-10)
    assert solution.success
    assert np.abs(solution(problem.period) - problem.z0).max() <= 1e-9


@pytest.mark.parametrize("name", EXACT)
def test_eleven_digits_or_refusal(name: str) -> None:
    problem = CATALOGUE[name]()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-11)
    if solution.success:
        assert true_error(solution, problem.exact).max() <= 1e-11
    else:
        assert "round-off" in solution.message


@pytest.mark.slow_cases("calogero_moser-1e-11")
@pytest.mark.parametrize("tol", [1e-5, 1e-11])
@pytest.mark.parametrize("name", EXACT)
def test_estimate_is_the_error_up_to_round_off(name: str, tol: float) -> None:
    problem = CATALOGUE[name]()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=tol)
    t = np.linspace(*problem.span, 1_001)
    error, estimate = problem.exact(t) - solution(t), solution.error_estimate(t)
    floor = solution.error.floor(t)
    # The exact solutions carry round-off of their own.
    own = 1e-13 * solution.scale
    assert np.all(np.abs(error - estimate) <= 0.01 * np.abs(error).max(axis=0) + floor + own)
    assert np.all(solution.largest_error >= np.abs(estimate).max(axis=0))


@pytest.mark.slow
def test_estimate_holds_on_long_spans() -> None:
    """Thousands of windows: neither the error nor the estimate may drift away unnoticed."""
    problem = systems.pendulum()
    solution = hamsym.solve(problem.H, problem.z0, (0, 2_000.0), tol=1e-8)
    assert solution.success
    t = np.linspace(0, 2_000, 2_001)
    error, estimate = problem.exact(t) - solution(t), solution.error_estimate(t)
    assert np.abs(error).max() <= 1e-8 * solution.scale.min()
    assert np.abs(error - estimate).max() < 0.3 * np.abs(error).max()
    assert len(solution.history.edges) < 4_000


@pytest.mark.parametrize(
    ("mass", "stiffness"), [(1e-27, 1e3), (1e30, 1e12), (1.0, 1.0), (1e-27, 1e-45)]
)
def test_result_independent_of_units(mass: float, stiffness: float) -> None:
    omega = math.sqrt(stiffness / mass)
    H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": mass, "k": stiffness})
    solution = hamsym.solve(H, [1e-9, 0.0], (0, 40 / omega), tol=1e-9)
    assert solution.success, solution.message

    def truth(t: np.ndarray) -> np.ndarray:
        phase = omega * t
        return 1e-9 * np.stack((np.cos(phase), -mass * omega * np.sin(phase)), axis=-1)

    assert true_error(solution, truth).max() <= 1e-9


def test_backward_time_and_other_starts() -> None:
    problem = systems.nonlinear_oscillator()
    forward = hamsym.solve(problem.H, problem.z0, (0, 10), tol=1e-9)
    back = hamsym.solve(problem.H, forward(10.0), (10.0, 0.0), tol=1e-9)
    assert back.success
    t = np.linspace(0, 10, 101)
    np.testing.assert_allclose(back(t), forward(t), atol=1e-8)
    shifted = hamsym.solve(problem.H, problem.z0, (100.0, 110.0), tol=1e-9)
    np.testing.assert_allclose(shifted(t + 100), forward(t), atol=1e-8)


def test_time_dependent_hamiltonian() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*cos(2*t)")
    solution = hamsym.solve(H, [0.0, 0.0], (0, 30), tol=1e-9)
    assert solution.success

    def truth(t: np.ndarray) -> np.ndarray:
        x, p = np.cos(t) - np.cos(2 * t), 2 * np.sin(2 * t) - np.sin(t)
        return np.stack((x, p), axis=-1) / 3

    assert true_error(solution, truth).max() <= 1e-9


def test_components_that_stay_zero_are_exactly_zero() -> None:
    solution = hamsym.solve(Hamiltonian("p**2/2 + x**2/2", q=["x"], p=["p"]), [0, 0], (0, 5))
    assert solution.success
    assert not solution(np.linspace(0, 5, 11)).any()
    at_rest = hamsym.solve(Hamiltonian("p**2/2", q=["x"], p=["p"]), [2.0, 0.0], (0, 5))
    assert at_rest.success
    assert at_rest(3.3).tolist() == [2.0, 0.0]


def test_absolute_tolerance_loosens() -> None:
    problem = systems.henon_heiles()
    tight = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-12, atol=0.0)
    loose = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-12, atol=[1e-3] * 4)
    assert loose.success
    assert np.all(loose.error.largest <= 1e-3 + 1e-12 * loose.scale)
    assert tight.message != loose.message


def _ring(count: int, angle: float) -> tuple[Hamiltonian, dict[str, float]]:
    """Equal masses that circle one in the middle, whose forces cancel."""
    bodies = range(count + 1)
    distances = (
        f"sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i in bodies for j in bodies if i < j
    )
    kinetic = " + ".join(f"(px{i}**2 + py{i}**2)/2" for i in bodies)
    H = Hamiltonian(" - ".join([kinetic, *(f"1/{distance}" for distance in distances)]))
    z0 = {f"{name}0": 0.0 for name in ("x", "y", "px", "py")}
    rate = math.sqrt(1 + sum(1 / math.sin(math.pi * k / count) for k in range(1, count)) / 4)
    for k in range(count):
        turn = angle + 2 * math.pi * k / count
        z0 |= {f"x{k + 1}": math.cos(turn), f"y{k + 1}": math.sin(turn)}
        z0 |= {f"px{k + 1}": -rate * math.sin(turn), f"py{k + 1}": rate * math.cos(turn)}
    return H, z0


@pytest.mark.parametrize(("count", "angle"), [(2, 0.3), (4, 0.1), (3, 1.0)])
def test_components_that_are_round_off_leave_windows_long(count: int, angle: float) -> None:
    H, z0 = _ring(count, angle)
    solution = hamsym.solve(H, z0, (0, 2), atol=1e-10)
    assert solution.success
    assert len(solution.trial.readouts) < 50
    assert abs(solution(2.0)[H.names.index("x0")]) < 1e-12
    turn = angle + 2 * abs(complex(z0["px1"], z0["py1"]))
    assert abs(solution(2.0)[H.names.index("x1")] - math.cos(turn)) < 1e-9
    refused = hamsym.solve(H, z0, (0, 2), tol=1e-10)
    assert not refused.success
    assert "round-off of x0, y0, px0, py0, whose terms cancel: give atol" in refused.message
    assert len(refused.trial.readouts) < 2_000


def test_components_at_rest_leave_the_others_their_bounds() -> None:
    """Bounds on what places leave out of the residual are zero relative to a size of zero."""
    H = Hamiltonian("(px**2 + py**2)/2 + y + 10*(sqrt(x**2 + y**2) - 1)**2")
    solution = hamsym.solve(H, {"x": 0, "y": -1.3, "px": 0, "py": 0}, (0, 20))
    assert solution.success, solution.message
    t = np.linspace(0, 20, 33)
    # A spring along its axis: a harmonic oscillator about y = -1.05.
    exact = -1.05 - 0.25 * np.cos(math.sqrt(20) * t)
    np.testing.assert_allclose(solution(t)[:, 1], exact, rtol=0, atol=1e-9)
    assert not solution(t)[:, [0, 2]].any()


def test_windows_join_exactly() -> None:
    problem = systems.kepler()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
    edges = solution.history.edges
    np.testing.assert_array_equal(solution(edges[:-1]), solution.history.states[:-1])
    before = edges[1:-1] - 1e-12
    jump = solution(edges[1:-1]) - solution(before) - 1e-12 * solution.derivative(edges[1:-1])
    assert np.abs(jump).max() < 1e-13


def test_derivative_is_that_of_the_solution() -> None:
    problem = systems.henon_heiles()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
    t = torch.linspace(0.1, 18, 50, dtype=torch.float64, requires_grad=True)
    z = solution(t)
    for i in range(4):
        (slope,) = torch.autograd.grad(z[:, i].sum(), t, retain_graph=True)
        torch.testing.assert_close(slope, solution.derivative(t.detach())[:, i])
    assert solution.ell_max < 1e-7


def test_same_seed_same_solution_other_features_agree() -> None:
    problem = systems.henon_heiles()
    first, again, other = (
        hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9, seed=seed) for seed in (0, 0, 1)
    )
    t = np.linspace(*problem.span, 101)
    assert np.array_equal(first(t), again(t))
    assert not np.array_equal(first(t), other(t))
    np.testing.assert_allclose(first(t), other(t), atol=2e-9)


def test_newton_and_fixed_point_solve_the_same_equation() -> None:
    problem = systems.nonlinear_oscillator()
    flow, basis, z0 = flow_of(problem.H), feature_basis(0), np.array(problem.z0)
    marched = march(flow, z0, (0.0, 0.5), 1e-12, basis)
    assert marched.newton_windows == 0
    end = marched.edges[1]
    rates, _ = newton(flow, basis, z0, 0.0, end, 1e-13, np.ones(2))
    np.testing.assert_allclose(end * basis.fit @ rates, marched.readouts[0], atol=1e-13)


def test_newton_replaces_failing_fixed_point(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = systems.nonlinear_oscillator()
    usual = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
    usual_march = loops.march

    def march_by_newton(*arguments: Any) -> int:
        """Ask for the rates of every window, as where the iteration does not converge."""
        *_, progress, windows, given = arguments
        windows.room = progress["counts"][0] + given
        outcome = usual_march(*arguments)
        return loops.NEWTON if outcome == loops.FULL and not given else outcome

    monkeypatch.setattr(loops, "march", march_by_newton)
    stop = sum(problem.span) / 2  # members have no breakpoints
    newton = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9, breakpoints=[stop])
    assert usual.history.newton_windows == 0
    assert newton.history.newton_windows >= len(newton.history.readouts) > 10
    assert newton.success
    assert true_error(newton, problem.exact).max() <= 1e-9


def test_a_stiff_system() -> None:
    """Two masses on a stiff spring that move as one."""
    stiffness = np.array([[1 + 1e6, -1e6], [-1e6, 1e6]])
    squares, modes = np.linalg.eigh(stiffness)
    H = Hamiltonian("(p**2 + r**2)/2 + x**2/2 + 500000*(y - x)**2", q=["x", "y"], p=["p", "r"])
    start = modes[:, 0] / modes[0, 0]
    solution = hamsym.solve(H, [*start, 0.0, 0.0], (0, 2), tol=1e-6)
    assert solution.success, solution.message
    t = np.linspace(0, 2, 301)
    np.testing.assert_allclose(solution(t)[:, 0], np.cos(np.sqrt(squares[0]) * t), atol=1e-6)


@pytest.mark.parametrize("tol", [1e-7, 1e-9])
def test_a_bounce_off_a_hard_core(tol: float) -> None:
    """The period is the integral of dx/p between the turning points, with 40 digits by mpmath."""
    period = 3.14161905712642697017
    solution = hamsym.solve("p**2/2 + 1e-6/x + x**2/2", [1.0, 0.0], (0, 3.7), tol=tol)
    assert solution.success, solution.message
    s = np.array([0.0, 0.1, 0.3, 0.5])
    np.testing.assert_allclose(solution(period + s), solution(s), atol=2 * tol)
    np.testing.assert_allclose(solution(period - s), solution(s) * [1, -1], atol=2 * tol)


@pytest.mark.parametrize(
    ("resolved", "tried"), [(1e-9, [1e-8, 1e-12]), (0.0, [1e-8, 1e-12, 4e-12])]
)
def test_a_march_in_doubt_is_tried_again(
    monkeypatch: pytest.MonkeyPatch, resolved: float, tried: list[float]
) -> None:
    """Shorter windows resolve what long ones do not, or those less near round-off, or none do."""
    tolerances = []

    def doubtful(*arguments: Any, **keywords: Any) -> March:
        tolerances.append(arguments[3])
        windows = march(*arguments, **keywords)
        return windows if arguments[3] <= resolved else replace(windows, doubt="in doubt")

    monkeypatch.setattr(method, "march", doubtful)
    # Members have no breakpoints.
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-3, breakpoints=[2])
    assert solution.success == (resolved > 0)
    assert tolerances == tried


@pytest.mark.parametrize(
    ("damping", "end", "tol", "windows"),
    [(1e4, 20.0, 1e-6, 400), (1e6, 1.0, 1e-6, 400), (1e6, 1.0, 1e-9, 1500)],
)
def test_strong_damping_needs_few_windows(
    damping: float, end: float, tol: float, windows: int
) -> None:
    """Fixed-point iteration contracts only in windows of some 10 / damping."""
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": f"-{damping!r}*p"})
    solution = hamsym.solve(H, [1, 0], (0, end), tol=tol)
    assert solution.success, solution.message
    assert len(solution.history.readouts) < windows
    fast = -damping / 2 - math.sqrt(damping**2 / 4 - 1)
    rates = np.array([1 / fast, fast])
    shares = np.array([fast, -1 / fast]) / (fast - 1 / fast)
    t = np.concatenate((np.geomspace(1e-3 / damping, end, 501), solution.history.edges))
    parts = shares * np.exp(np.outer(t, rates))
    error = np.abs(solution(t) - np.stack((parts.sum(axis=1), parts @ rates), axis=1)).max(axis=0)
    assert (error <= tol * solution.scale).all()
    assert (error <= 1.1 * solution.error.largest + 1e-15 * solution.scale).all()


def test_equal_windows_reach_the_end_of_any_span() -> None:
    """An eighth of the span, eight times added to the start, may fall short of its end."""
    H = Hamiltonian("p**2/2 + x**2/2")
    rng = np.random.default_rng(7)
    for start, length in zip([0.0, 1.7, -1e3] * 10, rng.uniform(0.01, 9, 30), strict=True):
        for end in (start + length, start - length):
            solution = hamsym.solve(H, [0.3, 0.1], (start, end))
            assert solution.success, solution.message
            edges = solution.history.edges
            assert solution.history.origin + edges[-1] == end
            assert np.abs(np.diff(edges)).max() <= (1 + 2e-6) * length / 8
            assert np.abs(np.diff(edges)).min() > 1e-7 * length


def test_breakpoints_end_windows() -> None:
    H = Hamiltonian("p**2/2 - x*sign(t - 1)")
    solution = hamsym.solve(H, [0.0, 0.0], (0, 3), tol=1e-11, breakpoints=[2.0, 1.0, 2.0])
    assert solution.success, solution.message
    assert {1.0, 2.0} < set(solution.history.edges)
    t = np.linspace(0, 3, 301)
    exact = np.where(t < 1, -t, t - 2)
    np.testing.assert_allclose(solution(t)[:, 1], exact, atol=2e-11)
    back = hamsym.solve(H, solution(3.0), (3, 0), tol=1e-11, breakpoints=[1.0, 2.0])
    np.testing.assert_allclose(back(0.0), [0, 0], atol=1e-10)


@pytest.mark.parametrize("breakpoints", [[5.0], [0.0], [math.nan], ["soon"], 3.0])
def test_unusable_breakpoints_are_rejected(breakpoints: object) -> None:
    with pytest.raises(InputError, match="breakpoint"):
        hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1), breakpoints=breakpoints)


# -- Henon-Heiles against a Taylor series in extended precision -----------------------------------


def _taylor_henon_heiles(z0: list[float], end: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Times and states, from power series of degree 30 in the 64-bit mantissa of longdouble."""
    degree, h = 30, np.longdouble(end) / steps
    powers = h ** np.arange(degree + 1)
    states = [np.array(z0, dtype=np.longdouble)]
    for _ in range(steps):
        x, y, px, py = (np.zeros(degree + 1, np.longdouble) for _ in range(4))
        x[0], y[0], px[0], py[0] = states[-1]
        for k in range(degree):
            forward, back = slice(0, k + 1), slice(k, None, -1)
            x[k + 1], y[k + 1] = px[k] / (k + 1), py[k] / (k + 1)
            px[k + 1] = -(x[k] + 2 * (x[forward] @ y[back])) / (k + 1)
            force = y[k] + x[forward] @ x[back] - y[forward] @ y[back]
            py[k + 1] = -force / (k + 1)
        states.append(np.array([series @ powers for series in (x, y, px, py)]))
    return np.linspace(0, end, steps + 1), np.array(states)


def test_long_henon_heiles_against_taylor_series() -> None:
    problem = systems.henon_heiles()
    t, truth = _taylor_henon_heiles(list(problem.z0), 300.0, 1_000)
    solution = hamsym.solve(problem.H, problem.z0, (0, 300), tol=1e-11)
    assert np.abs(solution(t) - truth).max() <= 1e-10
    assert np.abs(truth.astype(float) - solution(t) - solution.error_estimate(t)).max() <= 1e-12


def test_estimate_holds_on_chaotic_orbit() -> None:
    z0 = [0.0, -0.1, math.sqrt(2 * (0.125 - 0.005 - 0.001 / 3)), 0.0]
    t, truth = _taylor_henon_heiles(z0, 150.0, 500)
    _, check = _taylor_henon_heiles(z0, 150.0, 1_000)
    assert np.abs(truth - check[::2]).max() < 1e-13
    solution = hamsym.solve(systems.henon_heiles().H, z0, (0, 150), tol=1e-9)
    assert solution.success
    error = np.abs(solution(t) - truth).max(axis=0)
    assert error.max() <= 1e-8
    estimate = np.abs(solution.error_estimate(t)).max(axis=0)
    assert np.all((estimate < 10 * error) & (error < 10 * estimate))


# -- failures ------------------------------------------------------------------------------------


def test_escape_returns_solution_before_it() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    solution = hamsym.solve(H, [1.0, 1.0], (0, 5), tol=1e-9)
    assert not solution.success
    assert solution.message.startswith("stopped at t = 1.311")
    assert solution.span[1] == pytest.approx(1.31103, abs=1e-4)
    truth = reference(H, np.array([1.0, 1.0]), (0.0, 1.2))
    t = np.linspace(0, 1.2, 101)
    np.testing.assert_allclose(solution(t), truth(t), rtol=1e-7)


def test_round_off_scales_with_the_local_state() -> None:
    """From a tiny start near an unstable point, a scale of the whole run would be too large."""
    H = Hamiltonian("p**2/2 - x**2/2 + x**4/4")
    assert hamsym.solve(H, [1e-7, 0.0], (0, 17), tol=1e-9).success
    escaping = hamsym.solve(Hamiltonian("p**2/2 - x**4/4"), [1.0, 0.0], (0, 4), tol=1e-6)
    assert re.search(r"stopped at t = 1.85.*held until \d\.\de-\d+ before that", escaping.message)


@pytest.mark.parametrize(
    ("formula", "z0", "jump"),
    [
        ("p**2/2 + abs(x)", [1.0, 0.0], math.sqrt(2)),
        ("p**2/2 + max(x, k*x)", [1.0, 0.0], math.sqrt(2)),
        ("p**2/2 + x**2/2 + abs(p)/10", [1.0, 0.0], None),
    ],
)
def test_jumping_force_fails(formula: str, z0: list, jump: float | None) -> None:
    parameters = {"k": -1.0} if "k" in formula else {}
    H = Hamiltonian(formula, parameters=parameters)
    solution = hamsym.solve(H, z0, (0, 6), tol=1e-6)
    assert not solution.success
    assert "the force jumps at t = " in solution.message
    if jump is not None:
        assert f"t = {jump:.6g}, beyond which" in solution.message
        assert hamsym.solve(H, z0, (0, jump - 1e-9), tol=1e-6).success


@pytest.mark.slow_cases("span1", "span0")
@pytest.mark.parametrize("span", [(0, 4), (0, 3.3), (0, 0.6)])  # the first has 0.5 as a joint
def test_potential_step_fails(span: tuple[float, float]) -> None:
    """The derivative of sign shows no force, and the energy changes."""
    H = Hamiltonian("p**2/2 + sign(x)/2")
    solution = hamsym.solve(H, [1.0, -2.0], span)
    assert not solution.success
    assert "H jumps at t = 0.5, beyond which" in solution.message
    assert hamsym.solve(H, [1.0, -2.0], (0, 0.49)).success


def test_kink_of_the_force_succeeds() -> None:
    H = Hamiltonian("p**2/2 + abs(x)**3")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 6), tol=1e-6)
    assert solution.success, solution.message
    truth = hamsym.solve(H, [1.0, 0.0], (0, 6), tol=1e-9, seed=1)
    assert true_error(solution, truth).max() <= 1e-6


@pytest.mark.slow_cases(
    "atan2(y, x) + sin(2*atan2(y, x))-True", "atan2(y, x)-True", "x*atan2(y, x)-False"
)
@pytest.mark.parametrize(
    ("potential", "smooth"),
    [
        ("atan2(y, x)", True),
        ("atan2(y, x) + sin(2*atan2(y, x))", True),
        ("cos(atan2(y, x))", True),
        ("atan2(y, x)**2", False),
        ("x*atan2(y, x)", False),
    ],
)
def test_angle_crosses_its_cut_where_forces_are_smooth(potential: str, smooth: bool) -> None:
    H = Hamiltonian(f"(px**2 + py**2)/2 + (x**2 + y**2)/2 + ({potential})/10")
    solution = hamsym.solve(H, [-1.0, 0.5, 0.0, -1.0], (0, 3), tol=1e-9)
    assert solution.success == smooth, solution.message
    assert smooth or "jumps at t = " in solution.message


def test_brief_pulse_in_long_rest_is_resolved() -> None:
    H = Hamiltonian("p**2/2 - x*exp(-(t - 51.3)**2)")
    truth = hamsym.solve(H, [0.0, 0.0], (0, 100), tol=1e-9, method=hamsym.Features(max_window=0.5))
    solution = hamsym.solve(H, [0.0, 0.0], (0, 100), tol=1e-6)
    assert truth(100.0)[1] == pytest.approx(math.sqrt(math.pi), rel=1e-9)
    assert true_error(solution, truth).max() <= 1e-6
    assert np.diff(truth.history.edges).max() <= 0.5 * (1 + 1e-12)


@pytest.mark.parametrize("force", [1.0, 1e8])
def test_switch_at_the_start_is_resolved(force: float) -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + F*x*sign(sin(t))", parameters={"F": force})
    solution = hamsym.solve(H, [1.0, 0.0], (0, 5), tol=1e-9)
    assert solution.success, solution.message
    t = np.linspace(0, 5, 101)
    # Around -F until pi, then around F.
    x = np.where(t <= math.pi, (1 + force) * np.cos(t) - force, (1 + 3 * force) * np.cos(t) + force)
    assert np.abs(solution(t)[:, 0] - x).max() <= 1e-9 * solution.scale[0]


def test_places_of_short_windows_are_inside_them() -> None:
    met: list[np.ndarray] = []

    def record(z: np.ndarray, times: np.ndarray, values: np.ndarray, out: np.ndarray) -> None:
        met.append(times.copy())
        out[:] = 0.0

    basis, start = feature_basis(0), 3.0
    still = RowProgram(2, 0, 1, record)
    for h in (1e-8, -1e-8):
        flow = replace(flow_of(Hamiltonian("p**2/2 + x*t")), programs=_equations(still))
        march(flow, np.array([1.0, 0.0]), (start, start + h), 1e-9, basis)
        times = np.concatenate(met)
        assert min(start, start + h) < times.min()
        assert times.max() < max(start, start + h)
        met.clear()


def _equations(rows: loops.Program) -> loops.Equations:
    """One degree of freedom with one function for every row."""
    return loops.Equations(dim=2, separable=1, linear=0, velocity=rows, force=rows, hessian=rows)


def test_stable_equilibrium_stays_exactly() -> None:
    H = Hamiltonian("p**2/2 + (x**2 - 1)**2/4")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 10), tol=1e-11)
    assert solution.success, solution.message
    assert (solution(np.linspace(0, 10, 11)) == [1.0, 0.0]).all()


def test_rounded_equilibrium_is_not_exact() -> None:
    # In float64 sqrt(2) is beside the equilibrium: p is 1e-16, not zero.
    H = Hamiltonian("p**2/2 + (x**2 - 2)**2/4")
    assert not hamsym.solve(H, [math.sqrt(2), 0.0], (0, 10), tol=1e-11).success


def test_driven_motion_at_large_times() -> None:
    H, start, tau = Hamiltonian("p**2/2 + x**2/2 - x*cos(t)"), 1e8, np.linspace(0, 10, 41)
    solution = hamsym.solve(H, [1.0, 0.0], (start, start + 10), tol=1e-8)
    assert solution.success, solution.message
    # x = cos(s) + (s sin(t) - sin(s) sin(t0))/2, with s = t - t0.
    sine = math.sin(start)
    x = np.cos(tau) + (tau * np.sin(start + tau) - np.sin(tau) * sine) / 2
    assert np.abs(solution(start + tau)[:, 0] - x).max() <= 1e-8 * solution.scale[0] + 1e-8
    refused = hamsym.solve(H, [1.0, 0.0], (start, start + 10), tol=1e-11)
    assert not refused.success
    assert "t = 1000000" in refused.message
    assert "hamsym.enclose" in refused.message


@pytest.mark.parametrize("tol", [1e-4, 1e-7, 1e-9])
def test_steep_force_is_resolved_at_any_tolerance(tol: float) -> None:
    # |x| to 1e-18: parabolas, with sqrt(2) from the start to the zero.
    H, t = Hamiltonian("p**2/2 + sqrt(x**2 + 1e-20)"), np.linspace(0, 4, 81)
    solution = hamsym.solve(H, [1.0, 0.0], (0, 4), tol=tol)
    assert solution.success, solution.message
    past = np.abs(t - 2 * math.sqrt(2))
    x = np.where(t < math.sqrt(2), 1 - t**2 / 2, past**2 / 2 - 1)
    assert np.abs(solution(t)[:, 0] - x).max() <= tol


@pytest.mark.parametrize("tol", [1e-4, 1e-7])
def test_root_of_the_force_is_resolved_at_any_tolerance(tol: float) -> None:
    # Half a period is sqrt(2) B(2/3, 1/2) * 2/3.
    half = 2 * math.sqrt(2) / 3 * float(scipy.special.beta(2 / 3, 1 / 2))
    solution = hamsym.solve("p**2/2 + (x**2)**0.75", [1.0, 0.0], (0, half), tol=tol)
    assert solution.success, solution.message
    assert np.abs(solution(half) - [-1.0, 0.0]).max() <= tol


@pytest.mark.parametrize("max_window", [0.0, -1.0, math.nan, "long"])
def test_unusable_max_window_is_rejected(max_window: object) -> None:
    with pytest.raises(InputError, match="max_window=.* cannot be used; give a number above 0"):
        hamsym.solve(
            Hamiltonian("p**2 + x**2"),
            [1, 0],
            (0, 1),
            method=hamsym.Features(max_window=max_window),
        )


def test_too_many_windows_are_rejected_beforehand() -> None:
    with pytest.raises(InputError, match="needs more than 200,000 windows; give 5e-05 or more"):
        hamsym.solve("p**2 + x**2", [1, 0], (0, 10), method=hamsym.Features(max_window=1e-6))


def test_collision_is_reported() -> None:
    H = Hamiltonian("p**2/2 - 1/x")
    solution = hamsym.solve(H, [1.0, 0.0], (0, 3), tol=1e-6)
    assert not solution.success
    assert "stopped at t = 1.11" in solution.message  # pi / (2 sqrt 2)


def test_leaving_the_domain_is_reported() -> None:
    solution = hamsym.solve(Hamiltonian("p**2/2 + log(x)"), [1.0, -3.0], (0, 5))
    assert not solution.success
    assert "leave the domain of H" in solution.message


def test_chaos_beyond_double_precision_is_reported() -> None:
    problem = systems.double_pendulum()
    solution = hamsym.solve(problem.H, (3.0, 3.0, 0.0, 0.0), (0, 150), tol=1e-9)
    assert not solution.success
    assert "met only until t = " in solution.message
    held = float(solution.message.split("met only until t = ")[1].split()[0].rstrip(":"))
    assert 5 < held < 150
    tighter = hamsym.solve(problem.H, (3.0, 3.0, 0.0, 0.0), (0, held / 2), tol=1e-11, seed=1)
    t = np.linspace(0, held / 2, 201)
    assert (np.abs(solution(t) - tighter(t)).max(axis=0) <= 2e-9 * solution.scale).all()


def test_too_many_windows_is_reported() -> None:
    flow = flow_of(systems.harmonic_oscillator().H)
    z0, span = np.array([1.0, 0.0]), (0.0, 1_000.0)
    windows = march(flow, z0, span, 1e-9, feature_basis(0), max_windows=20)
    assert re.fullmatch(r"the span needs about \de\+02 windows, more than 20", windows.reason)
    assert 0 < windows.reached < 1_000
    assert len(windows.readouts) == 20


def test_span_needing_too_many_windows_ends_early(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hamsym.random_features.march._SURE", 50)
    solution = hamsym.solve("p**2/2 + x**2/2", [1.0, 0.0], (0, 1e9))
    assert not solution.success
    assert "the span needs about " in solution.message
    assert "windows, more than 200,000" in solution.message
    assert len(solution.history.readouts) < 200


@pytest.mark.parametrize("seed", range(2))
def test_round_off_limit_for_every_seed(seed: int) -> None:
    problem = systems.double_pendulum()
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-12, seed=seed)
    best = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-11, seed=seed + 1)
    assert solution.success or "round-off" in solution.message
    t = np.linspace(*problem.span, 501)
    np.testing.assert_allclose(solution(t), best(t), atol=1e-10)


@pytest.mark.parametrize(
    "tol", [0.0, -1e-3, 1e-13, 1.0, math.nan, math.inf, "small", pytest.param(10**5000, id="huge")]
)
def test_unusable_tolerances_are_rejected(tol: object) -> None:
    with pytest.raises(InputError, match="tol=.* cannot be used; give a number from 1e-12"):
        hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1), tol=tol)


@pytest.mark.parametrize("atol", [-1.0, math.nan, [0.0] * 3, "none", 10**400])
def test_unusable_absolute_tolerances_are_rejected(atol: object) -> None:
    with pytest.raises(InputError, match="atol=.* cannot be used; give"):
        hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1), atol=atol)


# -- no false success ------------------------------------------------------------------------------


def _random_start(name: str, generator: np.random.Generator) -> tuple[Hamiltonian, np.ndarray]:
    if name == "henon_heiles":
        return systems.henon_heiles().H, generator.uniform(-0.35, 0.35, 4)
    if name == "kepler":
        z = generator.normal(size=4)
        return systems.kepler().H, np.array([1.0, 0.0, 0.0, 0.9]) + 0.2 * z
    if name == "double_pendulum":
        return systems.double_pendulum().H, generator.uniform(-1.5, 1.5, 4)
    quartic = Hamiltonian("p_x**2/2 + p_y**4/4 + x**4/4 + y**2/2 + x**2*y**2/2 + p_x*y/5")
    return quartic, generator.uniform(-1, 1, 4)


def _check_random_starts(name: str, count: int) -> None:
    generator = np.random.default_rng(7)
    successes = 0
    for _ in range(count):
        H, z0 = _random_start(name, generator)
        tol = 10.0 ** generator.uniform(-9, -3)
        solution = hamsym.solve(H, z0, (0.0, 15.0), tol=tol)
        if not solution.success:
            continue
        successes += 1
        error = true_error(solution, reference(H, z0, (0.0, 15.0)), samples=301)
        halves = solution.scale.reshape(2, -1)
        floors = np.maximum(halves, 1e-8 * halves.max(axis=1, keepdims=True)).ravel()
        assert (error * solution.scale <= tol * floors + 1e-11).all(), (name, z0, tol)
    assert successes > 0.8 * count


@pytest.mark.slow_cases("quartic", "double_pendulum", "kepler")
@pytest.mark.parametrize("name", ["henon_heiles", "kepler", "double_pendulum", "quartic"])
def test_success_is_never_false(name: str) -> None:
    _check_random_starts(name, 6)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["henon_heiles", "kepler", "double_pendulum", "quartic"])
def test_success_is_never_false_on_many_starts(name: str) -> None:
    _check_random_starts(name, 400)


@pytest.mark.parametrize(
    ("formula", "z0", "span"),
    [
        ("p**2/2 + x**2/2 - x*sin(t)", [0, 0], (0, 10)),
        ("p**2/2 - x*t**8", [0, 0], (0, 2)),
        ("p**2/2 - cos(x) - x*sin(2*t)/2", [0, 0], (0, 10)),
        ("p**2/2 - 1e-20*x*sin(t)", [0, 0], (math.pi, 9)),
        ("(p_x**2 + p_y**2)/2 + x**2/2 + y**2/2 - y*sin(t)", [1, 0, 0, 0], (0, 10)),
        ("p**2*(1 + x**2)/2 + x**2/2 - x*sin(t)", [0, 0], (0, 10)),
        ("p**2/2 + x**2/2 - x*abs(t - 1)", [1, 0], (0, 5)),
    ],
)
def test_motion_begins_at_rest_without_force(
    formula: str, z0: list[float], span: tuple[float, float]
) -> None:
    H = Hamiltonian(formula)
    solution = hamsym.solve(H, z0, span)
    assert solution.success, solution.message
    truth = reference(H, np.array(z0, dtype=float), span)
    limit = 1e-9 if "abs" not in formula else 1e-8  # the reference does not stop at switches
    assert true_error(solution, truth).max() <= limit
    (member,) = hamsym.solve_many(H, [z0], span)
    assert (member(span[1]) == solution(span[1])).all()


def test_middle_of_quartic_chain_begins_with_high_powers() -> None:
    terms = [f"p{i}**2/2 + q{i}**2/2" for i in range(1, 7)]
    terms += [f"(q{i + 1} - q{i})**4/4" for i in range(1, 6)]
    H, z0 = Hamiltonian(" + ".join(terms)), np.array([1.0, *10 * [0.0], 1.0])
    solution = hamsym.solve(H, z0, (0, 10))
    assert solution.success, solution.message
    assert true_error(solution, reference(H, z0, (0, 10))).max() <= 1e-9


@pytest.mark.parametrize("unit", [1.0, 2.0**-73, 2.0**40])
def test_units_of_momenta_do_not_count_the_windows_of_a_quartic_chain_at_rest(unit: float) -> None:
    """One of 621 windows, or 12,607, crept through the first 1e-3 s before."""
    terms = [f"(p{i}/u)**2/2" for i in range(1, 9)] + ["q1**4/4 + q8**4/4"]
    terms += [f"(q{i + 1} - q{i})**4/4" for i in range(1, 8)]
    H = Hamiltonian(f"u*({' + '.join(terms)})", parameters={"u": unit})
    solution = hamsym.solve(H, [1.0, -0.3, *14 * [0.0]], (0, 20))
    assert solution.success
    assert len(solution.record.edges) == 34


def test_rest_under_dry_friction_is_refused_at_once() -> None:
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": "-sign(p)/10"})
    solution = hamsym.solve(H, [1, 0], (0, 20))
    assert not solution.success
    # The amplitude falls by 0.2 in each half period, until the force cannot move the body.
    assert solution.span[1] == pytest.approx(5 * np.pi, abs=1e-6)
    assert "comes to rest where a force jumps" in solution.message
    assert "the force jumps at t = 3.14159" in solution.message
    assert len(solution.record.edges) < 1_000
