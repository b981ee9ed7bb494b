"""Frequencies: known motions, random sums, estimated errors, drift, what is refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.special import ellipk

import hamsym
from hamsym import Hamiltonian, InputError

OSCILLATOR = "p**2/2 + x**2/2"
OSCILLATORS = "1.7*(p_1**2 + q_1**2)/2 + 0.6*(p_2**2 + q_2**2)/2"


def _sum(random: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Frequencies that are 12 pi over the span or more apart, amplitudes, phases, and the span."""
    span = random.uniform(200, 1000)
    while True:
        omega = np.sort(random.uniform(-2.5, 2.5, random.integers(1, 6)))
        if len(omega) == 1 or np.diff(omega).min() * span > 12 * np.pi:
            break
    return omega, 10 ** random.uniform(-3, 0, len(omega)), random.uniform(-3, 3, len(omega)), span


@pytest.mark.parametrize("seed", range(12))
def test_random_sums_are_found_within_their_errors(seed: int) -> None:
    omega, size, phase, span = _sum(np.random.default_rng(seed))
    # Harmonic oscillators have one term each, so that a sum of signals is any sum.
    formula = " + ".join(f"{w!r}*(p_{k}**2 + q_{k}**2)/2" for k, w in enumerate(omega.tolist()))
    H = Hamiltonian(formula, q=[f"q_{k}" for k in range(len(omega))],
                    p=[f"p_{k}" for k in range(len(omega))])  # fmt: skip
    z0 = np.concatenate([size * np.cos(phase), -size * np.sin(phase)])
    solution = hamsym.solve(H, z0, (0, span), tol=1e-10)
    real = " + ".join(f"q_{k}" for k in range(len(omega)))
    imaginary = " + ".join(f"p_{k}" for k in range(len(omega)))
    found = solution.frequencies((real, imaginary))
    for w, a, f in zip(omega, size, phase, strict=True):
        k = int(np.nanargmin(np.abs(found.frequency[0] - w)))
        assert abs(found.frequency[0, k] - w) <= found.error[0, k] < 1e-4
        assert abs(found.amplitude[0, k] / a - 1) < 1e-3
        turn = found.phase[0, k] - f
        assert abs((turn + np.pi) % (2 * np.pi) - np.pi) < 0.05
    assert found.rest[0] < 1e-4


def test_pendulum_has_the_odd_multiples_of_its_frequency() -> None:
    swing = hamsym.solve("p**2/2 - cos(x)", [1.0, 0.0], (0, 400))
    found = swing.frequencies("x")
    exact = np.pi / (2 * ellipk(np.sin(0.5) ** 2))
    assert abs(found.frequency[0, 0] - exact) <= found.error[0, 0] < 1e-9
    np.testing.assert_allclose(found.frequency[0, :4] / exact, [1, 3, 5, 7], rtol=1e-6)
    t = np.linspace(0, 400, 700)
    assert np.abs(found(t)[:, 0].real - swing(t)[:, 0]).max() < 1e-8


def test_pairs_of_oscillators_have_one_term_each() -> None:
    trajectory = hamsym.integrate(OSCILLATORS, [1, 0.5, 0, 0.3], (0, 300), tol=1e-9, saves=2000)
    found = trajectory.frequencies()
    assert found.success
    assert (np.abs(found.frequency[:, 0] - [1.7, 0.6]) <= found.error[:, 0]).all()
    np.testing.assert_allclose(found.frequency[:, 0], [1.7, 0.6], atol=1e-8)
    assert found.signals == ("q_1 - i c p_1", "q_2 - i c p_2")
    assert (found.rest < 1e-7).all()


def test_backward_time_and_a_mean_value() -> None:
    H = Hamiltonian("p**2/2 + 2*(x - 3)**2")
    forward = hamsym.solve(H, [3.5, 0.2], (0, 200)).frequencies("x")
    backward = hamsym.solve(H, [3.5, 0.2], (0, -200)).frequencies("x")
    for found in (forward, backward):
        assert found.frequency[0, :2].round(8).tolist() == [0.0, 2.0]
        assert found.amplitude[0, 0] == pytest.approx(3.0, abs=1e-7)
        t = np.linspace(*found.span, 50)
        exact = 3 + 0.5 * np.cos(2 * t) + 0.1 * np.sin(2 * t)
        assert np.abs(found(t)[:, 0].real - exact).max() < 1e-6


def test_steps_without_a_known_error_give_no_frequency_with_an_error() -> None:
    steps = hamsym.integrate(OSCILLATOR, [1, 0], (0, 200), "stormer_verlet", dt=0.1)
    found = steps.frequencies("x")  # 1.000417, not 1
    assert not found.success
    assert "1 of 1 trajectories have no frequency" in found.message
    assert "integrate with tol" in found.message
    assert np.isinf(found.error[0, 0])
    assert hamsym.time_average(steps, "x**2").error == np.inf
    loose = hamsym.integrate(OSCILLATOR, [1, 0], (0, 200), tol=1e-3, saves=1000)
    assert loose.largest_error is not None
    found = loose.frequencies("x")
    assert found.success
    assert found.error[0, 0] > 1e-3 * loose.largest_error[0]
    average = hamsym.time_average(loose, "x**2")
    assert abs(average.value - 0.5) <= average.error


@pytest.mark.parametrize("saves", [1000, 1592, 796])  # 5 rad from one to the next, 2 pi / 2, 2 pi
def test_saved_states_too_far_apart_have_no_frequencies(saves: int) -> None:
    fast = hamsym.integrate("p**2/2 + 1250*x**2", [1, 0], (0, 100), tol=1e-9, saves=saves)
    for compute in (hamsym.frequencies, hamsym.time_average):
        with pytest.raises(InputError, match="too far apart"):
            compute(fast, "x")


def test_terms_too_fast_for_the_saved_states_have_no_error() -> None:
    fast = hamsym.integrate("p**2/2 + 1250*x**2", [1, 0], (0, 100), tol=1e-9, saves=5400)
    assert fast.frequencies("x").success  # 0.93 rad from one to the next; of x**8 7.4
    found = fast.frequencies("x**8", count=8)
    wrong = np.abs(found.frequency[0, :, None] - 100 * np.arange(5)).min(axis=1) > 1e-6
    assert wrong.any()
    assert np.isinf(found.error[0, wrong]).all()
    average = hamsym.time_average(fast, "x**8")
    assert abs(average.value - 35 / 128) <= average.error


def test_solutions_are_sampled_until_no_term_is_aliased() -> None:
    rate = 2047 * 2 * np.pi / 40  # one turn between 2,048 equal times
    solution = hamsym.solve(f"{rate!r}*(p**2 + x**2)/2", [1, 0], (0, 40), tol=1e-6)
    found = solution.frequencies("x")
    assert found.success
    assert abs(found.frequency[0, 0] - rate) <= found.error[0, 0] < 1e-3


@pytest.mark.parametrize("span", [40, 60, 80, 100, 125])
def test_two_terms_in_one_peak_are_within_its_error(span: float) -> None:
    t = -span / 2  # both phases are zero in the middle, so that no drift shows
    z0 = [np.cos(t), np.cos(1.05 * t), -np.sin(t), -1.05 * np.sin(1.05 * t)]
    H = "(p_x**2 + x**2)/2 + (p_y**2 + 1.1025*y**2)/2"
    found = hamsym.solve(H, z0, (t, -t)).frequencies("x + y")
    for frequency, error in zip(found.frequency[0], found.error[0], strict=True):
        if np.isfinite(frequency):
            assert np.abs(frequency - [1.0, 1.05]).min() <= error


def test_drift_separates_chaos_from_order() -> None:
    H = hamsym.systems.henon_heiles().H
    starts = H.state_at_energy(1 / 8, {"x": 0, "y": np.array([0.55, -0.016]), "p_y": 0})
    many = hamsym.solve_many(H, starts, (0, 500), tol=1e-6)
    found = hamsym.frequencies(many, ("x", "p_x"), count=4)
    assert found.frequency.shape == (2, 1, 4)
    ordered, chaotic = np.abs(found.drift[:, 0, 0])
    assert chaotic > 10 * ordered
    assert found.plot().axes
    alone = hamsym.frequencies(many[0], ("x", "p_x"), count=4)
    np.testing.assert_array_equal(alone.frequency, found.frequency[0])


def test_weighted_average_of_a_rotation() -> None:
    turns = hamsym.solve("p**2/2 - cos(x)", [0.0, 2.5], (0, 300))
    k = 2 / 2.5
    exact = np.pi * 1.25 / ellipk(k * k)
    found = hamsym.time_average(turns, "p")
    assert abs(found.value - exact) <= found.error + 1e-10
    assert found.error < 1e-8


@pytest.mark.parametrize(
    ("result", "signals", "message"),
    [
        (3, (), "not of a int"),
        ("solution", (("x", "p", "x"),), "is no pair"),
        ("solution", ("y",), "'y' does not occur in H"),
        ("short", (), "not at equal steps, or fewer than 64"),
    ],
)
def test_what_has_no_frequencies(result: Any, signals: tuple[Any, ...], message: str) -> None:
    if result == "solution":
        result = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 9))
    if result == "short":
        result = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 1), steps=20)
    with pytest.raises(InputError, match=message):
        hamsym.frequencies(result, *signals)


def test_more_terms_than_samples_and_other_times_are_refused() -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 99))
    with pytest.raises(InputError, match="count=1000000000 cannot be used"):
        solution.frequencies(count=10**9)
    for t in ("a", 10**400):
        with pytest.raises(InputError, match="not a real number"):
            solution.frequencies()(t)


def test_a_fixed_point_has_no_frequency_and_a_figure_says_so() -> None:
    found = hamsym.solve("p**2/2 + x**2/2", [0, 0], (0, 9)).frequencies()
    assert not found.success
    with pytest.raises(InputError, match="nothing to draw"):
        found.plot()


def test_components_at_rest_beside_others_have_no_frequency() -> None:
    H = "(px**2 + py**2)/2 + x**2/2 + 2*y**2 + x**2*y"
    found = hamsym.solve(H, {"x": 0, "y": 1, "px": 0, "py": 0}, (0, 60)).frequencies(count=1)
    assert found.success
    assert np.isnan(found.frequency[0, 0])
    assert abs(found.frequency[1, 0]) == pytest.approx(2, abs=1e-6)


def test_facts_list_the_terms() -> None:
    found = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 90)).frequencies()
    assert "x - i c p" in found.summary()
    assert "angular frequency" in found.plot().axes[0].get_xlabel()


@pytest.mark.parametrize("formula", ["exp(-((x - 0.3)/1e-6)**2)", "Heaviside(x - 0.3)"])
def test_features_between_the_samples_leave_the_error_unknown(formula: str) -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 200), tol=1e-10)
    assert hamsym.time_average(solution, formula).error == np.inf


def test_frequencies_of_what_no_sample_shows_are_not_known() -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 200), tol=1e-10)
    assert not hamsym.frequencies(solution, "exp(-((x - 0.3)/1e-6)**2)", count=1).success


def test_features_that_the_samples_show_are_averaged() -> None:
    solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 200), tol=1e-10)
    found = hamsym.time_average(solution, "exp(-((x - 0.3)/0.1)**2)")
    phases = np.linspace(0, 2 * np.pi, 4096, endpoint=False)
    exact = np.exp(-(((np.cos(phases) - 0.3) / 0.1) ** 2)).mean()
    assert abs(found.value - exact) <= found.error < 1e-4


def test_members_with_other_parameters_have_frequencies() -> None:
    H = hamsym.Hamiltonian("p**2/2 - k*cos(x)", parameters={"k": 1.0})
    given = {"parameters": {"k": np.array([1.0, 4.0])}}
    for many in (
        hamsym.solve_many(H, [0.1, 0.0], (0, 100), **given),
        hamsym.integrate(H, [0.1, 0.0], (0, 100), saves=2000, tol=1e-9, **given),
    ):
        found = hamsym.frequencies(many, "x", count=1)
        assert found.success, found.message
        np.testing.assert_allclose(found.frequency[:, 0, 0], [1, 2], rtol=1e-3)


def test_signals_of_members_have_their_own_parameters() -> None:
    many = hamsym.solve_many(
        "p**2/2 + k*x**2/2", [1, 0], (0, 60), tol=1e-10, parameters={"k": [1.0, 4.0]}
    )
    found = hamsym.frequencies(many, "k*x", ("p", "k*x"), count=2)
    assert found.success
    assert found.amplitude[:, 0, 0] == pytest.approx([1, 4], rel=1e-8)
    assert np.nanmax(found.amplitude[:, 1], axis=1) == pytest.approx([1, 3], rel=1e-8)


@pytest.mark.parametrize("start", [1e9, -1e12])
def test_times_far_from_zero_need_no_more_samples(start: float) -> None:
    """Rounded by 1e-7 or 1e-4, which no number of samples resolves."""
    H, z0 = hamsym.systems.henon_heiles().H, [0.1, 0.15, 0.2, 0.0]
    near, far = (hamsym.frequencies(hamsym.solve(H, z0, (t, t - 50))) for t in (0.0, start))
    np.testing.assert_allclose(far.frequency[:, 0], near.frequency[:, 0], atol=1e-6)
    assert far.seconds < 5
