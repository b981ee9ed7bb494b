"""Features of the force between the steps: what is found, and what is not mistaken for one."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian
from hamsym.integrators import hidden_features as hidden_features_module
from hamsym.integrators.hidden_features import Path, _hermite_fit, hidden_features

OSCILLATOR = "p**2/2 + x**2/2 - x*"
#: Pulses that change the motion by 0.05 or more.
PULSES = {
    "narrow": "1e4*exp(-((t - 3.37)/1e-5)**2)",
    "one of few floats": "1e12*exp(-((t - 3.37)/1e-12)**2)",
    "away from the zeros of its formula": (
        "1e6*(1/(1 + 1e-17*exp(1e6*(t - 3.37))) - 1/(1 + 2e-17*exp(1e6*(t - 3.37))))"
    ),
    "one tooth of a comb": "4e4*exp(-1e4*(1 - cos(2000*pi*t)) - ((t - 3.37)/3e-4)**2)",
}


@pytest.mark.parametrize("pulse", PULSES.values(), ids=list(PULSES))
def test_pulse_between_chosen_steps_is_found(pulse: str) -> None:
    found = hamsym.integrate(OSCILLATOR + pulse, [1.0, 0.0], (0, 10))
    assert found.success is False
    assert "near t = 3.37" in found.message
    assert "that the steps pass over" in found.message


@pytest.mark.parametrize(
    "options",
    [
        {"steps": 1_000},
        {"steps": 1_000, "save_every": 100},
        {"dt": 0.05},
    ],
)
def test_pulse_between_given_steps_is_found(options: dict[str, object]) -> None:
    H = OSCILLATOR + PULSES["narrow"]
    found = hamsym.integrate(H, [1.0, 0.0], (0, 10), **options)
    assert found.success is False
    assert "near t = 3.37" in found.message
    assert "the force has a feature" in found.message
    before = hamsym.integrate(H, [1.0, 0.0], (0, 3), **options)
    assert before.success is True


def test_pulse_between_states_far_apart_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Steps are repeated in parts, because all of them may not fit into memory."""
    monkeypatch.setattr(hidden_features_module, "_REPEATED", 1_000)
    H = OSCILLATOR + PULSES["narrow"]
    found = hamsym.integrate(H, [1.0, 0.0], (0, 10), steps=2_001, save_every=2_001)
    assert found.success is False
    assert "near t = 3.37" in found.message
    assert hamsym.integrate(H, [1.0, 0.0], (0, 3), steps=2_001, save_every=2_001).success


def test_pulse_that_looks_like_a_pole_is_no_success() -> None:
    H = OSCILLATOR + PULSES["away from the zeros of its formula"]
    found = hamsym.integrate(H, [1.0, 0.0], (0, 10), steps=20_000)
    assert found.success is False
    assert "near t = 3.37" in found.message


def test_pulse_that_one_step_meets_is_found() -> None:
    """At its centre, so that the step goes too far by a factor of 1,000."""
    H = OSCILLATOR + PULSES["narrow"]
    for first in (0.0, 0.01):
        found = hamsym.integrate(H, [1.0, 0.0], (first, 10 + first), "stormer_verlet", dt=0.02)
        assert found.success is False
        assert "the force has a feature" in found.message


def test_pulse_along_the_orbit_is_found() -> None:
    """Without a trace in H at the steps, which conserve it."""
    H = Hamiltonian("p**2/2 + x**2/2 + 0.1*exp(-((x - 0.51234)/w)**2)", parameters={"w": 1e-7})
    found = hamsym.integrate(H, [1.0, 0.0], (0, 5))
    assert found.success is False
    assert "near t = 1.032" in found.message
    wide = hamsym.integrate(H, [1.0, 0.0], (0, 5), parameters={"w": 0.1})
    assert wide.success is True


def test_first_trajectory_with_a_pulse_is_named() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*exp(-((t - c)/w)**2)/w", parameters={"c": 3.1, "w": 0.5})
    parameters = {"c": [3.1, 4.2, 2.3], "w": [0.5, 1e-6, 1e-6]}
    found = hamsym.integrate(H, [1.0, 0.0], (0, -9), parameters=parameters)
    assert found.success is True  # the pulses are at positive times
    found = hamsym.integrate(H, [1.0, 0.0], (0, 9), parameters=parameters)
    assert found.success is False
    assert found.message.startswith("trajectory 2: near t = 2.3 ")


@pytest.mark.slow_cases("narrow", *list(PULSES)[2:])
@pytest.mark.parametrize("name", list(PULSES))
def test_pulse_is_resolved_or_refused_with_a_tolerance(name: str) -> None:
    found = hamsym.integrate(OSCILLATOR + PULSES[name], [1.0, 0.0], (0, 10), tol=1e-4, saves=1)
    ends = np.cos(10) + np.sqrt(np.pi) / 10 * np.sin(6.63), -0.236608, -0.603493, -0.784830
    end = dict(zip(PULSES, ends, strict=True))[name]
    # The others need more steps of equal size than are taken, or numbers than there are.
    assert found.success is (name not in ("one tooth of a comb", "one of few floats"))
    assert found.success or "feature narrower than a step near t = 3.37" in found.message
    assert not found.success or abs(found.z[-1, 0] - end) <= 1e-4


def test_round_off_of_a_pulse_is_part_of_the_error() -> None:
    """The runs agree in it, since each evaluates the same rounded cosine."""
    H = OSCILLATOR + "1e4*exp({})"
    exact = hamsym.integrate(H.format("-2e10*sin(t/16 - 0.2)**2"), [1.0, 0.0], (0, 10), tol=1e-6)
    assert exact.success is True
    found = hamsym.integrate(H.format("1e10*(cos(t/8 - 0.4) - 1)"), [1.0, 0.0], (0, 10), tol=1e-6)
    assert found.success is False
    assert "limited by float64 round-off" in found.message
    assert (np.abs(found.z - exact.z) <= found.errors + exact.errors).all()


def test_section_does_not_pass_over_a_pulse() -> None:
    for options in ({}, {"steps": 1_000}):
        H = OSCILLATOR + PULSES["away from the zeros of its formula"]
        found = hamsym.section(H, [1.0, 0.0], (0, 10), "x = 0", **options)
        assert found.success is False
        assert "near t = 3.370" in found.message
        assert hamsym.section(H, [1.0, 0.0], (0, 3), "x = 0", **options).success


@pytest.mark.parametrize(
    ("formula", "start"),
    [
        ("p**2/2 - cos(theta)", [2.0, 0.0]),
        ("p**2/2 - cos(theta) + tan(theta/4)/1000", [2.0, 0.0]),  # bounded everywhere
        ("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)", [0.3, 0.0, 0.0, 2.38]),
        ("p**2/2 + 4*(1/x**12 - 1/x**6)", [1.1, 0.1]),
        ("p**2/2 - cos(theta)*(1 + cos(t)/10) + exp(sin(3*t))*theta/20", [1.0, 0.0]),
        ("p**2/2 + x**2/2 - x*exp(-((t - 3.1)/0.1)**2)", [1.0, 0.0]),
        ("p**2/2 + x**2/2 - x*tanh(20*(t - 3.1))", [1.0, 0.0]),
    ],
)
def test_features_as_wide_as_steps_are_no_doubt(formula: str, start: list[float]) -> None:
    for options in ({}, {"steps": 1_000}, {"tol": 1e-8}):
        assert hamsym.integrate(formula, start, (0, 10), **options).success is True


def test_polynomial_force_hides_nothing() -> None:
    assert hidden_features(Hamiltonian("p**2/2 + x**4/4 - x*t")) is None


def test_switch_that_steps_see_is_no_doubt() -> None:
    found = hamsym.integrate("p**2/2 + abs(x)", [1.0, 0.0], (0, 10), "stormer_verlet", dt=1e-3)
    assert found.success is True
    assert "pass over" not in found.message


def test_what_may_change_is_that_of_all_features_together() -> None:
    """Each of 38 pulses changes p by 0.02, which alone would be allowed."""
    H = Hamiltonian(
        "p**2/2 + x**2/2 - x*a*exp((cos(20*t) - 1)/w**2)", parameters={"a": 1.0, "w": 1e-3}
    )
    height = 0.02 * 20 / (np.sqrt(2 * np.pi) * 1e-3)
    t = np.linspace(0, 12, 1_001)[:-1] + 0.0061
    z = np.stack((np.cos(t), -np.sin(t)), axis=-1)
    for factor, seen in ((1.0, True), (1e-3, False)):
        features = hidden_features(H.with_parameters(a=factor * height))
        found = features.search(Path(z[None], t), None, lambda _: np.full(2, 0.1))
        assert bool(np.isfinite(found.times[0])) is seen


@pytest.mark.parametrize("length", [1, 3, 4, 16, 64, 256])
def test_curve_of_a_window_is_that_of_its_states(length: int) -> None:
    s = np.linspace(-1, 1, length + 1)
    curve = _hermite_fit(length) @ np.concatenate((1 + s - s**3 / 2, 1 - 1.5 * s**2))
    expected = np.zeros(len(curve))
    expected[[0, 1, 3]] = 1, 1 - 0.375, -0.125
    np.testing.assert_allclose(curve, expected, atol=1e-13)
