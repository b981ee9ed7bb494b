"""Intervals of curved models, and solutions that fit as well: by symmetry or at other speeds."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from scipy.special import bdtr

import hamsym
from hamsym import Fit, Hamiltonian

T = np.linspace(0, 10, 12)
TRUTH = {"k": 1.0, "x": 1.0, "p": 0.0}


@dataclass(frozen=True)
class Swing:
    """The exact flow of p^2/2 + k^power x^2/2, as a flow map."""

    power: int = 1
    span: tuple[float, float] = (0.0, 10.0)
    inputs: tuple[str, ...] = ("x", "p", "k")
    fixed: dict[str, float] = field(default_factory=dict)
    success: bool = True
    tol: float = 1e-12
    largest_error: tuple[float, float] = (1e-12, 1e-12)

    @property
    def H(self) -> Hamiltonian:
        return Hamiltonian(f"p**2/2 + k**{self.power}*x**2/2", parameters={"k": 1.0})

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        return dict.fromkeys(self.inputs, (-np.inf, np.inf))

    def __call__(self, t: Any, z0: Any, parameters: Any) -> np.ndarray:
        return self.parts(t, z0, parameters)[0]

    def jacobian(self, t: Any, z0: Any, parameters: Any) -> np.ndarray:
        return self.parts(t, z0, parameters)[1]

    def parts(self, t: Any, z0: Any, parameters: Any) -> tuple[np.ndarray, np.ndarray]:
        """States, and their derivatives in x, p and k."""
        k, (x, p) = parameters["k"] ** self.power, z0.T
        w = np.sqrt(k + 1e-300 + 0j)
        with np.errstate(all="ignore"):
            c, s = np.cos(w * t).real, (np.sin(w * t) / w).real
            series = -(t**3) / 6 + k * t**5 / 60
            ds = np.where(np.abs(k) * t**2 > 1e-3, (t * c - s) / (2 * k), series)
            dk = np.stack((-x * t * s / 2 + p * ds, -x * (s + k * ds) - p * t * s / 2), axis=-1)
            dk *= (self.power * parameters["k"] ** (self.power - 1))[:, None]
            states = np.stack((x * c + p * s, -k * x * s + p * c), axis=-1)
        in_x, in_p = np.stack((c, -k * s), axis=-1), np.stack((s, c), axis=-1)
        return states, np.stack((in_x, in_p, dk), axis=-1)


def fit_swing(
    data: np.ndarray, sigma: float | None, flow: Swing | None = None, **options: Any
) -> Fit:
    flow = flow or Swing()
    t = np.linspace(*flow.span, data.shape[-1])
    arguments = {"free": dict(TRUTH), "sigma": sigma, "flow": flow}
    return hamsym.fit(flow.H, t, {"x": data}, **arguments | options)


def noisy(sets: int, sigma: float = 0.8, seed: int = 0) -> np.ndarray:
    return np.cos(T) + np.random.default_rng(seed).normal(0, sigma, (sets, len(T)))


def inside(found: Fit, name: str, truth: float) -> np.ndarray:
    low, high = found.confidence_intervals[name]
    return np.asarray((low <= truth) & (truth <= high))


def assert_covered(found: Fit, truth: dict[str, float], share: float, sets: np.ndarray) -> None:
    """Refuse a share of intervals with the truth that has a probability below 1e-7."""
    for name, value in truth.items():
        hits = int(inside(found, name, value)[sets].sum())
        assert bdtr(hits, int(sets.sum()), share) > 1e-7, (name, hits, sets.sum())


# -- curvature -------------------------------------------------------------------------------------


@pytest.mark.slow_cases("None")
@pytest.mark.parametrize("sigma", [0.8, None])
def test_intervals_of_curved_models_cover(sigma: float | None) -> None:
    found = fit_swing(noisy(600), sigma)
    assert found.success.mean() > 0.8
    assert_covered(found, TRUTH, 0.92, np.ones(600, dtype=bool))
    assert_covered(found, TRUTH, 0.91, found.success)
    for name, value in TRUTH.items():
        assert inside(found, name, value).mean() < 0.985
    assert all("intervals by profile likelihood" in m for m in found.message[found.success])


def test_profile_ends_have_the_rise_of_their_level() -> None:
    data = noisy(1)[0]
    found = fit_swing(data, 0.8)
    assert "intervals by profile likelihood" in found.summary().replace("\n", " ")
    for end in found.confidence_intervals["k"]:
        w = np.sqrt(end)
        columns = np.stack((np.cos(w * T), np.sin(w * T)), axis=1)
        rest = data - columns @ np.linalg.lstsq(columns, data, rcond=None)[0]
        rise = (rest**2).sum() / 0.64 - found.chi_square
        assert rise == pytest.approx(3.8415, rel=0.05)
    low, high = found.confidence_intervals["k"]
    estimate = found.parameters["k"]
    assert abs(high - estimate) != pytest.approx(abs(estimate - low), rel=1e-3)


def test_linear_models_keep_linear_intervals() -> None:
    found = fit_swing(np.cos(T) + np.random.default_rng(0).normal(0, 0.01, (20, 12)), 0.01)
    assert found.success.all()
    assert not any("profile" in message for message in found.message)
    low, high = found.confidence_intervals["k"]
    np.testing.assert_allclose(high - low, 2 * 1.959964 * found.standard_errors["k"], rtol=1e-6)


@pytest.mark.slow
def test_profiles_that_do_not_close_are_named() -> None:
    data = np.random.default_rng(1).normal(0, 0.8, (40, 12))  # no oscillation at all
    found = fit_swing(data, 0.8)
    low, high = found.confidence_intervals["k"]
    open_ = np.isinf(low) | np.isinf(high)
    assert open_.any()
    assert not found.success[open_].any()
    assert all("the data do not bound k from" in message for message in found.message[open_])


@pytest.mark.slow
def test_solutions_have_the_intervals_of_a_flow_map() -> None:
    data = noisy(1)[0]
    found = fit_swing(data, 0.8)
    solved = hamsym.fit(Swing().H, T, {"x": data}, free=TRUTH, sigma=0.8, span=(0, 10))
    assert solved.message == found.message
    for name in TRUTH:
        expected = found.confidence_intervals[name]
        np.testing.assert_allclose(solved.confidence_intervals[name], expected, rtol=1e-3)


def test_ends_of_intervals_stay_in_bounds() -> None:
    found = fit_swing(noisy(40), 0.8, bounds={"k": (0.7, 1.5)})
    low, high = found.confidence_intervals["k"]
    assert (low >= 0.7).all()
    assert (high <= 1.5).all()


@pytest.mark.slow
def test_intervals_of_noisy_pendulums_cover() -> None:
    t, truth = np.linspace(0, 12, 25), {"g": 1.6, "theta": 0.9, "p": 0.1}
    H = Hamiltonian("p**2/2 - g*cos(theta)", parameters={"g": 1.6})
    swing = hamsym.solve(H, [0.9, 0.1], (0, 12))(t)[:, 0]
    data = swing + np.random.default_rng(0).normal(0, 0.5, (200, 25))
    found = hamsym.fit(H, t, {"theta": data}, free=truth, span=(0, 12))
    assert_covered(found, truth, 0.92, np.ones(200, dtype=bool))
    assert sum("profile" in message for message in found.message) > 100


# -- signs -----------------------------------------------------------------------------------------


@pytest.mark.slow_cases("0.1-0.0", "0.0-0.3", "0.1-0.3")
@pytest.mark.parametrize("start", [0.3, 0.0])
@pytest.mark.parametrize("truth", [0.0, 0.1])
def test_squares_near_zero_have_a_verdict(truth: float, start: float) -> None:
    t = np.linspace(0, 6, 30)
    data = np.cos(truth * t) + np.random.default_rng(0).normal(0, 0.1, (60, 30))
    flow = Swing(2, (0.0, 6.0))
    found = fit_swing(data, 0.1, flow, free={"k": start, "x": 1.0, "p": 0.0})
    assert not found.success.any()
    assert not any("no convergence" in message for message in found.message)
    around = inside(found, "k", 0.0)
    assert around.mean() > 0.8
    for message in found.message[around]:
        assert "k is determined only up to sign, and its interval includes 0" in message
    known = {"k": truth, "x": 1.0, "p": 0.0}
    assert_covered(found, known, 0.92, np.ones(60, dtype=bool))


@pytest.mark.slow
def test_reflected_solutions_are_named() -> None:
    t = np.linspace(0, 10, 60)
    data = np.cos(2 * t) ** 2 + np.random.default_rng(0).normal(0, 0.02, 60)
    free = {"k": 2.0, "x": 1.0, "p": 0.0}
    arguments: dict[str, Any] = {"free": free, "span": (0, 10), "sigma": 0.02}
    H = "p**2/2 + k**2*x**2/2"
    found = hamsym.fit(H, t, {"x**2": data}, **arguments)
    assert not found.success
    assert "give bounds of k that exclude it" in found.message
    assert found.message.count("another solution fits as well, by symmetry") == 2
    other = f"k = {found.parameters['k']:.6g}, x = {-found.parameters['x']:.6g}"
    assert other in found.message
    bounds = {"k": (0, None), "x": (0, None)}
    assert hamsym.fit(H, t, {"x**2": data}, bounds=bounds, **arguments).success
    cubed = hamsym.fit(H, t, {"x**3": np.cos(2 * t) ** 3}, bounds={"k": (0, None)}, **arguments)
    assert cubed.success


# -- speeds ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("guess", "other"), [(1.0, 6.0), (6.0, 1.0)])
def test_aliased_frequencies_are_named(guess: float, other: float) -> None:
    t = np.linspace(0, 20, 12)
    data = np.cos(t) + np.random.default_rng(3).normal(0, 0.05, 12)
    flow = Swing(span=(0.0, 20.0))
    free = {"k": guess, "x": 1.0, "p": 0.0}
    found = fit_swing(data, 0.05, flow, free=free)
    assert not found.success
    assert "data at steps of 1.81818 do not tell this motion from one" in found.message
    k = float(found.message.split("k = ")[1].split(",")[0])
    assert k == pytest.approx(other, rel=0.05)
    np.testing.assert_allclose(np.sqrt([k, found.parameters["k"]]).sum(), 2 * np.pi * 11 / 20)
    bounds = {"k": (0, 3)} if guess < 3 else {"k": (3, 9)}
    assert fit_swing(data, 0.05, flow, free=free, bounds=bounds).success


def test_irregular_times_have_no_aliases() -> None:
    t = np.sort(np.random.default_rng(0).uniform(0, 20, 12))
    data = {"x": np.cos(t) + np.random.default_rng(1).normal(0, 0.05, 12)}
    flow = Swing(span=(0.0, 20.0))
    assert hamsym.fit(flow.H, t, data, free=TRUTH, sigma=0.05, flow=flow).success
