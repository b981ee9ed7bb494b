"""Fits: estimates with honest intervals, and refusals that name what data do not determine."""

from __future__ import annotations

import pickle
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
import scipy.optimize
import sympy

import hamsym
from hamsym import Fit, Hamiltonian, InputError

PENDULUM = "p**2/(2*m*l**2) - m*g*l*cos(theta)"
TRUTH = {"g": 1.6, "theta": 0.9, "p": 0.1}
FREE = {"g": 1.4, "theta": 0.8, "p": 0.0}
T = np.linspace(0, 20, 120)
OSCILLATOR = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 1.0, "k": 1.0})


@pytest.fixture(scope="module")
def swing() -> np.ndarray:
    """States of the pendulum at T, shape (120, 2)."""
    H = Hamiltonian(PENDULUM, parameters={"m": 1, "l": 1, "g": 1.6})
    return hamsym.solve(H, [0.9, 0.1], (0, 20))(T)


def noise(sigma: float, shape: Any = T.shape, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(0, sigma, shape)


def fit_pendulum(observations: Any, t: Any = T, **options: Any) -> Fit:
    arguments: dict[str, Any] = {
        "free": FREE,
        "sigma": 0.02,
        "span": (0, 20),
        "parameters": {"m": 1, "l": 1},
    }
    return hamsym.fit(PENDULUM, t, observations, **arguments | options)


@dataclass(frozen=True)
class Oscillation:
    """The exact flow of p^2/(2 m) + k x^2/2 with m = 1, as a flow map."""

    inputs: tuple[str, ...] = ("x", "k")
    box: Mapping[str, tuple[float, float]] = field(
        default_factory=lambda: {"x": (0.1, 3.0), "k": (0.2, 9.0)}
    )
    fixed: Mapping[str, float] = field(default_factory=lambda: {"p": 0.0, "m": 1.0})
    span: tuple[float, float] = (0.0, 10.0)
    success: bool = True
    tol: float = 1e-10
    largest_error: np.ndarray = field(default_factory=lambda: np.full(2, 1e-10))
    H: Hamiltonian = OSCILLATOR

    def __call__(self, t: Any, z0: Any, parameters: Any) -> np.ndarray:
        assert set(parameters) <= set(self.inputs)
        w = np.sqrt(parameters["k"])
        return np.stack((z0[:, 0] * np.cos(w * t), -w * z0[:, 0] * np.sin(w * t)), axis=-1)

    def jacobian(self, t: Any, z0: Any, parameters: Any) -> np.ndarray:
        w, x = np.sqrt(parameters["k"]), z0[:, 0]
        in_x = np.stack((np.cos(w * t), -w * np.sin(w * t)), axis=-1)
        in_w = (-x * t * np.sin(w * t), -x * np.sin(w * t) - w * x * t * np.cos(w * t))
        return np.stack((in_x, np.stack(in_w, axis=-1) / (2 * w)[:, None]), axis=-1)


def tracks(sets: int, sigma: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    t = np.linspace(0, 10, 40)
    return t, 1.2 * np.cos(2 * t) + noise(sigma, (sets, 40), seed)


# -- estimates -------------------------------------------------------------------------------------


def test_pendulum_from_a_noisy_track(swing: np.ndarray) -> None:
    found = fit_pendulum({"theta": swing[:, 0] + noise(0.02)})
    assert found.success
    assert found.message.startswith("converged in ")
    assert found.names == ("g", "theta", "p")
    for name, truth in TRUTH.items():
        low, high = found.confidence_intervals[name]
        assert low < found.parameters[name] < high
        assert abs(found.parameters[name] - truth) < 3 * found.standard_errors[name]
        assert found.standard_errors[name] < 0.02
    assert found.degrees_of_freedom == 117
    assert 0.001 < found.p_value < 0.999
    assert found.H.parameters == {"g": found.parameters["g"], "l": 1.0, "m": 1.0}
    np.testing.assert_array_equal(found.z0, found.solution.z0)
    np.testing.assert_allclose(np.diag(found.correlation), 1.0)


@pytest.mark.slow
def test_minimum_and_covariance_are_those_of_scipy(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02)
    H = Hamiltonian(PENDULUM, parameters={"m": 1, "l": 1, "g": 1.6})

    def residuals(x: np.ndarray) -> np.ndarray:
        there = hamsym.solve(H.with_parameters(g=x[0]), x[1:], (0, 20), tol=1e-11)
        return (there(T)[:, 0] - data) / 0.02

    expected = scipy.optimize.least_squares(residuals, [1.6, 0.9, 0.1], "3-point", method="lm")
    found = fit_pendulum({"theta": data})
    errors = np.sqrt(np.diag(found.covariance))
    estimates = np.array(list(found.parameters.values()))
    np.testing.assert_array_less(np.abs(estimates - expected.x), 1e-3 * errors)
    inverse = np.linalg.inv(expected.jac.T @ expected.jac)
    np.testing.assert_allclose(found.covariance, inverse, rtol=1e-5, atol=1e-5 * errors.min() ** 2)
    np.testing.assert_allclose(found.chi_square, 2 * expected.cost, rtol=1e-8)


@pytest.mark.slow
def test_observables_are_expressions_with_their_own_sigma(swing: np.ndarray) -> None:
    theta, p = swing.T
    x, g, momentum = sympy.symbols("theta g p")
    observed = {
        "l*sin(theta)": np.sin(theta) + noise(0.01, seed=1),
        momentum**2 / 2 + g * sympy.cos(x): p**2 / 2 + 1.6 * np.cos(theta) + noise(0.1, seed=2),
        "t*p": T * p + noise(0.5, seed=3),
    }
    keys = [str(key) for key in observed]
    sigma = dict(zip(keys, (0.01, np.full(len(T), 0.1), 0.5), strict=True))
    found = fit_pendulum(observed, sigma=sigma)
    assert found.success
    assert list(found.residuals) == keys
    assert found.degrees_of_freedom == 357
    for name, truth in TRUTH.items():
        assert abs(found.parameters[name] - truth) < 4 * found.standard_errors[name]
    model = found(T)
    for key, data in zip(keys, observed.values(), strict=True):
        np.testing.assert_allclose(found.residuals[key], data - model[key], atol=1e-12)
        expected = found.residuals[key] / sigma[key]
        np.testing.assert_array_equal(found.weighted_residuals[key], expected)
    squares = sum((r**2).sum() for r in found.weighted_residuals.values())
    assert squares == pytest.approx(found.chi_square)


@pytest.mark.slow
def test_missing_data_are_left_out(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02)
    gaps = np.where(np.arange(len(T)) % 3 == 0, np.nan, data)
    found, shorter = (
        fit_pendulum({"theta": gaps}),
        fit_pendulum({"theta": data[np.isfinite(gaps)]}, T[np.isfinite(gaps)]),
    )
    assert found.degrees_of_freedom == shorter.degrees_of_freedom == 77
    for name in FREE:
        assert found.parameters[name] == pytest.approx(shorter.parameters[name], rel=1e-7)
    np.testing.assert_array_equal(np.isnan(found.residuals["theta"]), np.isnan(gaps))


@pytest.mark.slow
def test_times_in_any_order_and_repeated(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02)
    order = np.random.default_rng(0).permutation(np.tile(np.arange(len(T)), 2))
    found, sorted_ = fit_pendulum({"theta": data[order]}, T[order]), fit_pendulum({"theta": data})
    assert found.parameters["g"] == pytest.approx(sorted_.parameters["g"], rel=1e-8)
    np.testing.assert_allclose(found.covariance, sorted_.covariance / 2, rtol=1e-5)


def test_sigma_is_estimated_if_it_is_not_given(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02)
    found, given = fit_pendulum({"theta": data}, sigma=None), fit_pendulum({"theta": data})
    assert found.success
    assert np.isnan(found.p_value)
    factor = given.chi_square / 117
    np.testing.assert_allclose(found.covariance, given.covariance * factor, rtol=1e-6)
    low, high = found.confidence_intervals["g"]
    from scipy.stats import t

    width = 2 * t.ppf(0.975, 117) * found.standard_errors["g"]
    assert high - low == pytest.approx(width, rel=1e-9)
    np.testing.assert_allclose(found.sigma["theta"], 0.02 * np.sqrt(factor), rtol=1e-6)


def test_explicit_time_in_the_hamiltonian() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - A*x*cos(w*t)", parameters={"A": 0.5, "w": 0.7})
    x = hamsym.solve(H, [1, 0], (3, 20))(t := np.linspace(3, 20, 80))[:, 0]
    found = hamsym.fit(
        H,
        t,
        {"x": x + noise(0.02, 80)},
        free={"A": 0.4, "w": 0.72},
        bounds={"w": (0, None)},
        z0={"x": 1, "p": 0},
        sigma=0.02,
        span=(3, 20),
    )
    assert found.success
    assert abs(found.parameters["w"] - 0.7) < 3 * found.standard_errors["w"]


@pytest.mark.slow
def test_backward_spans_fit_the_later_state(swing: np.ndarray) -> None:
    data = {"theta": swing[:, 0] + noise(0.02)}
    end = {"theta": swing[-1, 0] + 0.1, "p": swing[-1, 1]}
    found, forward = fit_pendulum(data, free={"g": 1.5, **end}, span=(20, 0)), fit_pendulum(data)
    assert found.success
    assert found.parameters["g"] == pytest.approx(forward.parameters["g"], rel=1e-6)
    np.testing.assert_allclose(found.z0, forward.solution(20.0), rtol=1e-5)


@pytest.mark.slow_cases("1e-09")
@pytest.mark.parametrize("unit", [1e-9, 1e9])
def test_units_change_nothing_but_the_unit(swing: np.ndarray, unit: float) -> None:
    data = {"theta": swing[:, 0] + noise(0.02)}
    free = {"g": 1.4 / unit**2, "theta": 0.8, "p": 0.0}
    found = fit_pendulum(data, T * unit, free=free, span=(0, 20 * unit))
    plain = fit_pendulum(data)
    assert found.success
    for name, power in (("g", -2), ("theta", 0), ("p", -1)):
        expected = plain.parameters[name] * unit**power
        assert found.parameters[name] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("action", [2.0**-40, 2.0**60])
def test_starts_and_sets_in_units_of_momenta(action: float) -> None:
    """A first guess 0 of the momentum is of the size that the coordinate gives it."""
    t, rng = np.linspace(0, 10, 40), np.random.default_rng(2)
    data = np.cos(t) + rng.normal(0, 0.01, (2, 40))
    found, other = (
        hamsym.fit(
            "c*((p/s)**2 + x**2)/2",
            *(t, {"x": data}),
            free={"x": 0.9, "p": 0.0, "c": 0.9 * unit},
            parameters={"s": unit},
            sigma=0.01,
            span=(0, 10),
            starts=9,
        )
        for unit in (1.0, action)
    )
    for name, unit in (("x", 1.0), ("p", action), ("c", action)):
        np.testing.assert_allclose(other.parameters[name] / unit, found.parameters[name], rtol=1e-9)
    np.testing.assert_array_equal(found.starts_reached, other.starts_reached)


# -- refusals --------------------------------------------------------------------------------------


def test_quantities_that_data_do_not_determine_are_named() -> None:
    t = np.linspace(0, 10, 50)
    found = hamsym.fit(
        OSCILLATOR,
        t,
        {"x": np.cos(2 * t) + noise(0.02, 50)},
        free={"m": 1.0, "k": 3.9, "x": 0.9},
        z0={"p": 0},
        sigma=0.02,
        span=(0, 10),
    )
    assert not found.success
    assert "the data do not determine m and k separately" in found.message
    assert "together have no effect" in found.message
    assert np.isnan(found.covariance).all()
    assert np.isnan(found.standard_errors["m"])
    assert found.parameters["k"] / found.parameters["m"] == pytest.approx(4.0, rel=0.01)


@pytest.mark.slow
def test_quantities_without_effect_are_named() -> None:
    t = np.linspace(0, 10, 50)
    found = hamsym.fit(
        "p_x**2/2 + k*x**2/2 + p_y**2/2 + y**2/2",
        t,
        {"x": np.cos(2 * t)},
        free={"k": 3.9, "y": 0.9},
        z0={"x": 1, "p_x": 0, "p_y": 0},
        sigma=0.02,
        span=(0, 10),
    )
    assert not found.success
    assert "the data do not depend on y" in found.message


def test_estimates_at_a_bound_are_refused(swing: np.ndarray) -> None:
    data = {"theta": swing[:, 0] + noise(0.02)}
    found = fit_pendulum(data, bounds={"g": (0, 1.5)})
    assert not found.success
    assert found.parameters["g"] == 1.5
    assert "g is at its bound 1.5" in found.message
    inside = fit_pendulum(data, bounds={"g": (0, None), "p": (-np.inf, 1)})
    assert inside.success
    assert inside.parameters["g"] == pytest.approx(fit_pendulum(data).parameters["g"], rel=1e-8)


def test_models_that_do_not_fit_are_refused(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02)
    data[::20] += 1.0
    found = fit_pendulum({"theta": data})
    assert not found.success
    assert found.p_value < 1e-6
    assert "the model does not fit the data with this sigma" in found.message


@pytest.mark.slow
def test_sigma_near_the_errors_of_the_motion_is_refused(swing: np.ndarray) -> None:
    H = Hamiltonian(PENDULUM, parameters={"m": 1, "l": 1, "g": 1.6})
    angles = hamsym.solve(H, [0.9, 0.1], (0, 20), tol=1e-12)(T)[:, 0] + noise(1e-10)
    found = fit_pendulum({"theta": angles}, sigma=1e-10, tol=1e-3)
    assert not found.success
    assert "give a smaller tol" in found.message
    assert fit_pendulum({"theta": angles}, sigma=1e-10, tol=1e-11).success
    exact = fit_pendulum({"theta": swing[:, 0]}, sigma=None)
    assert not exact.success
    assert "sigma cannot be estimated" in exact.message


@pytest.mark.slow_cases("stiff")
@pytest.mark.parametrize(
    ("formula", "free", "message"),
    [
        ("p**2/2 + x**2/2 + a*x**3", {"a": -50.0, "x": 3.0}, "singular"),
        ("p**2/2 + a*x**2/2", {"a": 1e12, "x": 3.0}, "windows"),
        ("p**2/2 - a/x", {"a": 1.0, "x": 0.0}, "not finite"),
    ],
    ids=["escape", "stiff", "pole"],
)
def test_first_guesses_without_a_motion_are_refused(
    formula: str, free: dict[str, float], message: str
) -> None:
    with pytest.raises(InputError, match=f"from the first guess, a = .*{message}"):
        hamsym.fit(formula, T, {"x": T}, free=free, z0={"p": 0}, sigma=0.1, span=(0, 20))


BAD: list[tuple[dict[str, Any], str]] = [
    ({"free": {}}, "names no quantity"),
    ({"free": ["g"]}, "not a mapping"),
    ({"free": {**FREE, "q": 1.0}}, "'q' in free is unknown"),
    ({"free": {**FREE, "g": np.nan}}, "g in free is nan"),
    ({"free": {**FREE, "g": "1"}}, "g in free is '1'"),
    ({"free": {**FREE, "m": 1.0}}, "in free and in parameters"),
    ({"z0": {"p": 1.0}}, "in free and in z0"),
    ({"free": {"g": 1.0, "theta": 1.0}}, "'p' is in neither free nor z0"),
    ({"parameters": {"m": 1}}, "'l' is in neither free nor parameters"),
    ({"parameters": {"m": 1, "l": 1, "k": 1}}, "'k' in parameters is unknown"),
    ({"sigma": 0.0}, "not above 0"),
    ({"sigma": -1.0}, "not above 0"),
    ({"sigma": np.nan}, "not above 0"),
    ({"sigma": np.ones(3)}, r"sigma has shape \(3,\)"),
    ({"sigma": {"p": 0.1}}, "'p', which is not observed"),
    ({"sigma": {}}, "'theta' is missing in sigma"),
    ({"sigma": "a"}, "not a real number"),
    ({"span": None}, "span is missing"),
    ({"span": (0, 19)}, r"t\[114\] = 19.15966386554622 is outside the span"),
    ({"bounds": {"m": (0, 1)}}, "'m' in bounds is not free"),
    ({"bounds": {"g": (2, 1)}}, "give the lower one first"),
    ({"bounds": {"g": (2, 3)}}, "outside its bounds"),
    ({"bounds": {"g": 1}}, "give .low, high."),
    ({"bounds": {"g": (np.inf, None)}}, "a bound of 'g' is inf"),
    ({"bounds": [1]}, "not a mapping"),
    ({"starts": 0}, "starts=0"),
    ({"seed": -1}, "seed=-1"),
    ({"confidence": 1.0}, "confidence=1.0"),
    ({"confidence": np.nan}, "confidence=nan"),
    ({"tol": -1.0}, "tol"),
]


@pytest.mark.parametrize(("options", "message"), BAD, ids=[message for _, message in BAD])
def test_unusable_arguments_are_refused(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_pendulum({"theta": np.cos(T)}, **options)


@pytest.mark.parametrize(
    ("observations", "message"),
    [
        ({}, "not a mapping"),
        ([1.0], "not a mapping"),
        ({"x": T}, "'x' does not occur in H"),
        ({3: T}, "not a formula"),
        ({"theta": T[1:]}, r"have shape \(119,\)"),
        ({"theta": np.zeros((2, 2, len(T)))}, "have shape"),
        ({"theta": T + 1j}, "not a real number"),
        ({"theta": [None] * len(T)}, "all data are nan"),
        ({"theta": np.where(T > 5, np.inf, T)}, "infinite"),
        ({"theta": ["a"] * len(T)}, "not a real number"),
        ({"theta": np.full(len(T), np.nan)}, "all data are nan"),
        ({"theta": np.zeros((2, len(T))), "p": np.zeros((3, len(T)))}, "same number of sets"),
        ({"theta": T, sympy.Symbol("theta"): T}, "occurs twice"),
    ],
)
def test_unusable_data_are_refused(observations: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_pendulum(observations)


@pytest.mark.parametrize(
    ("t", "message"),
    [
        (np.where(T > 5, np.nan, T), r"t\[30\] is not finite"),
        (T + 0j, "t has an entry that is not a real number"),
        (T[:, None], "t has shape"),
        ([], "t has shape"),
    ],
)
def test_unusable_times_are_refused(t: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        fit_pendulum({"theta": T}, t)


def test_fewer_data_than_unknowns_are_refused() -> None:
    with pytest.raises(InputError, match="1 data cannot determine g, theta, p; give 3"):
        fit_pendulum({"theta": [1.0]}, [1.0])
    with pytest.raises(InputError, match="give 4 or more, since sigma is estimated"):
        fit_pendulum({"theta": [1.0, 1.0, 1.0]}, [1.0, 2.0, 3.0], sigma=None)


def test_other_things_than_a_hamiltonian_are_refused() -> None:
    with pytest.raises(InputError, match="H must be"):
        hamsym.fit(3, T, {"x": T}, free={"x": 1.0}, span=(0, 1))  # type: ignore[arg-type]


# -- starts ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_starts_find_the_frequency_of_many_periods() -> None:
    t = np.linspace(0, 50, 120)
    arguments: dict[str, Any] = {
        "free": {"w": 1.0, "x": 1.0, "p": 0.0},
        "bounds": {"w": (0.5, 2.5)},
        "sigma": 0.1,
        "span": (0, 50),
    }
    H, data = "p**2/2 + w**2*x**2/2", {"x": np.cos(1.37 * t) + noise(0.1, 120)}
    lost = hamsym.fit(H, t, data, **arguments)
    assert not lost.success
    found = hamsym.fit(H, t, data, starts=60, seed=1, **arguments)
    assert found.success
    assert abs(found.parameters["w"] - 1.37) < 4 * found.standard_errors["w"]
    assert found.starts_reached >= 1
    assert f"reached from {found.starts_reached} of the 15 best starts" in found.message
    first, *others = found.minima
    assert first.parameters == pytest.approx(found.parameters, rel=1e-3)
    assert others
    assert all(other.chi_square > 10 * found.chi_square for other in others)
    again = hamsym.fit(H, t, data, starts=60, seed=1, **arguments)
    assert again.parameters == found.parameters


@pytest.mark.slow
def test_minima_that_fit_as_well_are_refused() -> None:
    t, data = tracks(1, 0.05)
    found = hamsym.fit(
        OSCILLATOR,
        t,
        {"x**2": data[0] ** 2},
        free={"x": 1.0},
        bounds={"x": (-2, 2)},
        z0={"p": 0},
        parameters={"k": 4},
        span=(0, 10),
        starts=8,
    )
    assert not found.success
    assert "another minimum fits as well, x = " in found.message
    assert found.minima[0].parameters["x"] == pytest.approx(-found.minima[1].parameters["x"])


# -- sets of data ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_sets_are_fits_of_their_own(swing: np.ndarray) -> None:
    data = swing[:, 0] + noise(0.02, (3, len(T)))
    data[1, ::2] = np.nan
    data[2] = np.nan
    found = fit_pendulum({"theta": data})
    assert isinstance(found.solution, hamsym.Solutions)
    assert (found.covariance.shape, found.z0.shape) == ((3, 3, 3), (3, 2))
    np.testing.assert_array_equal(found.success, [True, True, False])
    assert "0 data are too few for 3 free quantities" in found.message[2]
    for k in range(2):
        alone = fit_pendulum({"theta": data[k]})
        for name in FREE:
            error = alone.standard_errors[name]
            assert abs(found.parameters[name][k] - alone.parameters[name]) < 1e-3 * error
            expected = alone.confidence_intervals[name]
            np.testing.assert_allclose(
                [end[k] for end in found.confidence_intervals[name]], expected, atol=1e-3 * error
            )
        np.testing.assert_allclose(found.covariance[k], alone.covariance, rtol=1e-4, atol=1e-12)
        np.testing.assert_allclose(found(T)["theta"][k], alone(T)["theta"], atol=1e-5)
        assert found.degrees_of_freedom[k] == alone.degrees_of_freedom


def test_parameters_alone_are_fitted_to_sets() -> None:
    t, data = tracks(3, 0.02)
    for k in (4.0 * 1e-12, 4.0 * 1e12):  # responses to a parameter far from those to the start
        found = hamsym.fit(
            OSCILLATOR,
            t,
            {"x": data},
            free={"k": 0.95 * k},
            z0={"x": 1.2, "p": 0},
            parameters={"m": k / 4},
            sigma=0.02,
            span=(0, 10),
        )
        assert found.success.all()
        np.testing.assert_allclose(found.parameters["k"], k, rtol=0.01)


@pytest.mark.slow
def test_switches_that_are_not_crossed_do_not_matter() -> None:
    t = np.linspace(0, 1.2, 20)
    data, free = {"x": 1 - t**2 / 2 + noise(0.01, (2, 20))}, {"x": 0.9}
    H, arguments = "p**2/2 + abs(x)", {"free": free, "z0": {"p": 0}, "sigma": 0.01}
    found = hamsym.fit(H, t, data, span=(0, 1.2), **arguments)  # type: ignore[arg-type]
    assert found.success.all()
    np.testing.assert_allclose(found.parameters["x"], 1.0, atol=0.01)
    crossed = hamsym.fit(H, t, data, span=(0, 2), **arguments)  # type: ignore[arg-type]
    assert not crossed.success.any()
    assert "the motion is not accurate" in crossed.message[0]


def coverage(found: Fit, truth: Mapping[str, float]) -> dict[str, float]:
    inside = {}
    for name, value in truth.items():
        low, high = found.confidence_intervals[name]
        inside[name] = float(np.mean((low <= value) & (value <= high)))
    return inside


@pytest.mark.slow_cases("None")
@pytest.mark.parametrize("sigma", [0.1, None])
def test_intervals_of_a_flow_map_cover_the_truth(sigma: float | None) -> None:
    t, data = tracks(1000, 0.1)
    found = hamsym.fit(
        OSCILLATOR, t, {"x": data}, free={"k": 3.8, "x": 1.0}, sigma=sigma, flow=Oscillation()
    )
    assert found.success.all()
    assert found.solution is None
    for share in coverage(found, {"k": 4.0, "x": 1.2}).values():
        assert 0.93 <= share <= 0.97
    if sigma is not None:  # p values are uniform
        assert np.mean(found.p_value) == pytest.approx(0.5, abs=0.04)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.02, None])
def test_intervals_of_solutions_cover_the_truth(swing: np.ndarray, sigma: float | None) -> None:
    data = swing[:, 0] + noise(0.02, (1000, len(T)))
    found = fit_pendulum({"theta": data}, sigma=sigma)
    assert found.success.all()
    for share in coverage(found, TRUTH).values():
        assert 0.93 <= share <= 0.97


# -- flow maps -------------------------------------------------------------------------------------


@pytest.mark.slow
def test_flow_map_gives_the_fit_of_solutions() -> None:
    t, data = tracks(1, 0.05)
    options: dict[str, Any] = {"free": {"k": 3.8, "x": 1.0}, "sigma": 0.05}
    found = hamsym.fit(OSCILLATOR, t, {"x": data[0]}, flow=Oscillation(), **options)
    solved = hamsym.fit(OSCILLATOR, t, {"x": data[0]}, z0={"p": 0}, span=(0, 10), **options)
    assert found.success
    assert found.parameters == pytest.approx(solved.parameters, rel=1e-6)
    np.testing.assert_allclose(found.covariance, solved.covariance, rtol=1e-5)
    np.testing.assert_allclose(found(t)["x"], solved(t)["x"], atol=1e-6)
    assert found.H.parameters["k"] == found.parameters["k"]


@pytest.mark.parametrize(
    ("flow", "message"),
    [
        (Oscillation(success=False), "the flow map has success=False"),
        (Oscillation(largest_error=np.array([0.006, 0.0])), "reach 1.2e-01 sigma; give a smaller"),
        (Oscillation(largest_error=np.array([np.nan, 0.0])), "errors of the motion reach"),
        (Oscillation(box={"x": (0.1, 3.0), "k": (0.2, 3.9)}), "k is at its bound 3.9"),
    ],
    ids=["failed", "inaccurate", "unknown", "narrow"],
)
def test_flow_maps_that_cannot_be_trusted_are_refused(flow: Oscillation, message: str) -> None:
    t, data = tracks(2, 0.05)
    free = {"k": 3.8, "x": 1.0}
    found = hamsym.fit(OSCILLATOR, t, {"x": data}, free=free, sigma=0.05, flow=flow)
    assert not found.success.any()
    assert message in found.message[0]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"free": {"p": 1.0, "x": 1.0}}, "'p' does not vary in the flow map"),
        ({"free": {"k": 4.0}}, "'x' is in neither free nor z0"),
        ({"z0": {"p": 1.0}}, "'p' is 1.0, but 0.0 in the flow map"),
        ({"span": (0, 5)}, "not that of the flow map"),
        ({"free": {"k": 10.0, "x": 1.0}}, "outside its bounds"),
        ({"bounds": 3}, "bounds=3 is not a mapping"),
        ({"bounds": {"k": 3}}, "bounds of 'k' are 3; give .low, high."),
        ({"bounds": {"k": ("a", 4)}}, "a bound of 'k' is 'a'"),
        ({"z0": {"p": [0.0, 0.0]}}, r"'p' is \[0.0, 0.0\], but 0.0 in the flow map"),
        ({"flow": 3}, "flow=3 cannot be used; give a FlowMap"),
    ],
)
def test_arguments_that_contradict_a_flow_map_are_refused(
    options: dict[str, Any], message: str
) -> None:
    t, data = tracks(1, 0.05)
    arguments: dict[str, Any] = {"free": {"k": 3.8, "x": 1.0}, "sigma": 0.05, "flow": Oscillation()}
    with pytest.raises(InputError, match=message):
        hamsym.fit(OSCILLATOR, t, {"x": data[0]}, **arguments | options)
    with pytest.raises(InputError, match="H is not that of the flow map"):
        hamsym.fit("p**2/2 + x**2/2", t, {"x": data}, free={"x": 1.0}, flow=Oscillation())


def test_errors_of_a_flow_map_are_not_relative_to_small_motions() -> None:
    t, data = tracks(1, 0.05)
    box = {"x": (0.0, 3.0), "k": (0.2, 9.0)}
    flow = Oscillation(box=box, tol=1e-3, largest_error=np.array([3e-3, 3e-3]))
    options: dict[str, Any] = {"free": {"k": 3.8, "x": 1e-3}, "sigma": 5e-5, "flow": flow}
    found = hamsym.fit(OSCILLATOR, t, {"x": 1e-3 * data[0]}, **options)
    assert not found.success
    assert "errors of the motion reach 6.0e+01 sigma" in found.message


def test_values_fixed_by_the_user_are_inputs_of_a_flow_map() -> None:
    t, data = tracks(1, 0.05)
    found = hamsym.fit(
        OSCILLATOR,
        t,
        {"x": data[0]},
        free={"k": 3.8},
        z0={"x": 1.2},
        sigma=0.05,
        flow=Oscillation(),
    )
    assert found.success
    assert found.names == ("k",)


# -- results ---------------------------------------------------------------------------------------


@pytest.mark.slow
def test_figures_show_data_and_residuals(swing: np.ndarray) -> None:
    found = fit_pendulum({"theta": swing[:, 0] + noise(0.02), "p": swing[:, 1] + noise(0.02)})
    figure = found.plot()
    assert [axis.get_title(loc="left") for axis in figure.axes[::2]] == [r"$\theta$", "$p$"]
    assert "$g$ = 1.6" in figure.caption or "$g$ = 1.5" in figure.caption
    with pytest.raises(InputError, match="no set"):
        found.plot(number=1)
    t, data = tracks(3, 0.05)
    free = {"k": 3.8, "x": 1.0}
    sets = hamsym.fit(OSCILLATOR, t, {"x": data}, free=free, sigma=0.05, flow=Oscillation())
    assert "Set 2. Fitted: $k$ = " in hamsym.plot(sets, number=2).caption


@pytest.mark.slow
def test_results_can_be_pickled_and_printed(swing: np.ndarray) -> None:
    found = fit_pendulum({"theta": swing[:, 0] + noise(0.02)})
    again = pickle.loads(pickle.dumps(found))
    assert again.parameters == found.parameters
    np.testing.assert_array_equal(again(T)["theta"], found(T)["theta"])
    assert repr(found).startswith("Fit(g = 1.")
    assert repr(found).endswith("success=True)")
    with pytest.raises(InputError, match="outside the span"):
        found(21.0)


@pytest.mark.parametrize(
    ("spacing", "reason"),
    [
        (0.1, "residuals are correlated"),
        pytest.param(2.3, "no better than the mean", marks=pytest.mark.slow),
    ],
)
def test_minimum_that_explains_nothing_needs_sigma(spacing: float, reason: str) -> None:
    random = np.random.default_rng(1)
    t = np.cumsum(random.uniform(0.5, 1.5, 101)) * spacing
    data = np.cos(2 * t) + random.normal(0, 0.02, len(t))
    given = {"free": {"k": 1.0, "x": 0.8}, "z0": {"p": 0}, "span": (0, t[-1])}
    found = hamsym.fit("p**2/2 + k*x**2/2", t, {"x": data}, **given)
    assert abs(found.parameters["k"] - 4) > 1
    assert not found.success
    assert reason in found.message
    given["free"] = {"k": 4.0, "x": 0.8}
    right = hamsym.fit("p**2/2 + k*x**2/2", t, {"x": data}, **given)
    assert right.success, right.message
