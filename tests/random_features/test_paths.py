"""The evaluation of a march: its window at a time, its states and its rates."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym.random_features.basis import rate_series

H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + x**2*y + (x**2 + y**2)/2 - y**3/3")
START = [0.0, 0.1, 0.4, 0.1]


@pytest.fixture(params=[(0.0, 30.0), (2.0, -28.0)], ids=["forwards", "backwards"])
def solution(request: pytest.FixtureRequest) -> hamsym.Solution:
    return hamsym.solve(H, START, request.param)


@pytest.fixture
def times(solution: hamsym.Solution) -> np.ndarray:
    """Times in no order, most windows with several of them and some with one."""
    return np.random.default_rng(0).permutation(np.linspace(*solution.span, 157))


def test_states_and_rates_are_those_of_the_network(
    solution: hamsym.Solution, times: np.ndarray
) -> None:
    trial = solution.trial
    direction = np.sign(trial.edges[-1])
    for t in times:
        late = t - trial.origin
        window = np.searchsorted(direction * trial.edges[1:-1], direction * late, side="right")
        length = trial.edges[window + 1] - trial.edges[window]
        s = (late - trial.edges[window]) / length
        f = 1 - np.exp(-s)
        network, slopes = (
            np.polynomial.chebyshev.chebval(2 * s - 1, series) @ trial.readouts[window]
            for series in (trial.series, rate_series(trial.series))
        )
        z, dz = solution.evaluate(t)
        np.testing.assert_allclose(z, trial.states[window] + f * network, rtol=0, atol=1e-15)
        rates = ((1 - f) * network + f * slopes) / length
        np.testing.assert_allclose(dz, rates, rtol=0, atol=2e-14)


def test_a_value_does_not_depend_on_other_times(
    solution: hamsym.Solution, times: np.ndarray
) -> None:
    alone = np.array([solution(t) for t in times])
    for order in (np.arange(len(times)), np.argsort(times), np.argsort(-times)):
        np.testing.assert_array_equal(solution(times[order]), alone[order])
        np.testing.assert_array_equal(solution.evaluate(times[order])[0], alone[order])


def test_windows_begin_at_their_states(solution: hamsym.Solution) -> None:
    trial = solution.trial
    inside = trial.origin + trial.edges[:-1]
    for order in (slice(None), slice(None, None, -1)):
        np.testing.assert_array_equal(solution(inside[order]), trial.states[:-1][order])


def test_times_beyond_the_span_continue_the_outer_windows(solution: hamsym.Solution) -> None:
    start, end = solution.span
    step = 1e-3 * (end - start)
    t = np.array([start - step, end + step])
    z, dz = solution.evaluate(t, extrapolate=True)
    np.testing.assert_allclose(dz, H.compile("numpy").vector_field(z), rtol=0, atol=1e-7)
    assert (np.abs(z - solution([start, end])) > 1e-3).any(axis=1).all()
