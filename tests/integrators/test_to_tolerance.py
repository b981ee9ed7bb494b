"""Integration to a tolerance: true errors, verdicts of members, and what steps could jump over."""

from __future__ import annotations

import math
import pickle
import signal
from fractions import Fraction
from typing import Any

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.special

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.integrators import to_tolerance
from hamsym.integrators.adaptive import reference
from hamsym.integrators.compared_runs import ComparedRuns
from hamsym.integrators.richardson import extrapolate
from hamsym.systems import kepler as kepler_problem
from hamsym.systems import nonlinear_oscillator

# Compiling a loop takes seconds, so the tests share these.
HENON_HEILES = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
KEPLER = Hamiltonian("(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)", parameters={"k": 1.0})
PENDULUM = Hamiltonian("p**2/2 - cos(theta)")
FORCED = Hamiltonian("p**2/2 + x**2/2 - x*exp(-((t - c)/w)**2)", parameters={"c": 3.1, "w": 0.1})
NONSEPARABLE = Hamiltonian("p**2*(1 + x**2)/2 + x**2/2 + x**4/4")
TIMED = Hamiltonian("p**2*(1 + sin(t)/2)/2 + x**2*(1 + cos(2*t)/3)/2 - x**4/20")


def henon_heiles_starts(count: int, seed: int = 0) -> np.ndarray:
    """Random starts of energies from 0.02 to 1/6."""
    random, found = np.random.default_rng(seed), []
    while len(found) < count:
        energy, (x, y) = random.uniform(0.02, 1 / 6), random.uniform(-0.5, 0.5, 2)
        kinetic = energy - (x**2 + y**2) / 2 - x**2 * y + y**3 / 3
        if kinetic > 0:
            angle = random.uniform(0, 2 * np.pi)
            speed = np.sqrt(2 * kinetic)
            found.append([x, y, speed * np.cos(angle), speed * np.sin(angle)])
    return np.array(found)


def ellipse(eccentricity: float) -> list[float]:
    """State at the pericentre of an orbit of period 2 pi."""
    e = eccentricity
    return [1 - e, 0.0, 0.0, np.sqrt((1 + e) / (1 - e))]


def relative_errors(found: hamsym.Trajectory, truths: np.ndarray) -> np.ndarray:
    """Largest error of each member relative to the size of the component, at the saved times."""
    sizes = np.abs(truths).max(axis=1, keepdims=True)
    return (np.abs(found.z - truths) / sizes).max(axis=(1, 2))


# -- true errors ---------------------------------------------------------------------------------


@pytest.mark.slow_cases(
    "H3-starts3-span3-0.0001",
    "H1-starts1-span1-1e-09",
    "H3-starts3-span3-1e-09",
    "H4-starts4-span4-1e-09",
    "H0-starts0-span0-1e-09",
    "H0-starts0-span0-0.0001",
    "H4-starts4-span4-0.0001",
)
@pytest.mark.parametrize("tol", [1e-4, 1e-9])
@pytest.mark.parametrize(
    ("H", "starts", "span"),
    [
        (HENON_HEILES, henon_heiles_starts(6), (0.0, 6 * np.pi)),
        (HENON_HEILES, henon_heiles_starts(3), (2.0, -9.0)),
        (KEPLER, np.array([ellipse(e) for e in (0.0, 0.4, 0.9)]), (0.0, 5.0)),
        (PENDULUM, np.array([[0.01, 0], [2, 0], [3.0, 0], [0, 2.1]]), (0.0, 15.0)),
        (NONSEPARABLE, np.array([[1, 0.5], [2, 0]]), (0.0, 9.0)),
        (TIMED, np.array([[1, 0.3], [0.1, 0]]), (0.0, 9.0)),
        (TIMED, np.array([[1, 0.3], [0.1, 0]]), (1.0, -6.0)),
    ],
)
def test_true_errors_are_within_the_tolerance(
    H: Hamiltonian, starts: np.ndarray, span: tuple[float, float], tol: float
) -> None:
    for saves in (1, 20):
        found = hamsym.integrate(H, starts, span, tol=tol, saves=saves)
        assert found.success.all(), found.message
        truths = np.array([reference(H, start, span)(np.linspace(*span, 201)) for start in starts])
        errors = np.abs(found.z - truths[:, :: 200 // saves])
        sizes = np.abs(truths).max(axis=1)[:, None]
        assert (errors <= tol * sizes).all()
        assert (errors <= found.errors + 3e-12 * sizes).all()
        assert (found.errors <= 1.001 * tol * sizes).all()


def test_kepler_orbits_are_closed() -> None:
    eccentricities = np.linspace(0, 0.8, 9)
    starts = np.array([ellipse(e) for e in eccentricities])
    found = hamsym.integrate(KEPLER, starts, (0, 4 * np.pi), tol=1e-9, saves=2)
    assert found.success.all()
    # Components that return to zero have errors relative to their size along the orbit.
    sizes = np.stack((1 + eccentricities, np.sqrt(1 - eccentricities**2), starts[:, 3]), axis=-1)
    sizes = np.column_stack((sizes[:, 0], sizes[:, 1], starts[:, 3], starts[:, 3]))
    assert (np.abs(found.z - starts[:, None]) <= 1e-9 * sizes[:, None]).all()
    # One number of steps would be that of the hardest.
    steps = found.verdicts.steps
    assert (np.diff(steps) >= 0).all()
    assert steps[-1] > 10 * steps[0]


@pytest.mark.parametrize("method", ["stormer_verlet", "ruth3", "yoshida8", "gauss4"])
def test_methods_of_any_order_meet_the_tolerance(method: str) -> None:
    H, start, span = nonlinear_oscillator().H, [1.0, 0.0], (0.0, 6.0)
    found = hamsym.integrate(H, start, span, method, tol=1e-7)
    assert found.success is True
    assert found.method == method
    truth = reference(H, np.array(start), span)(found.t)
    assert (np.abs(found.z - truth) <= 1e-7 * np.abs(truth).max(axis=0)).all()


def test_saved_times_do_not_set_the_sizes() -> None:
    """At multiples of the period the momentum is zero, at all saved and compared times."""
    H = Hamiltonian("p**2/2 + x**2/2")
    found = hamsym.integrate(H, [1.0, 0.0], (0, 40 * np.pi), tol=1e-9, saves=20)
    assert found.success
    np.testing.assert_allclose(found.z, [[1.0, 0.0]] * 21, atol=1e-9)


def test_tolerance_holds_in_any_units() -> None:
    a, b = 1e27, 1e-20
    H = Hamiltonian("a*b*((p/b)**2/2 + (x/a)**2/2 + (x/a)**4/4)", parameters={"a": 1.0, "b": 1.0})
    plain = hamsym.integrate(H, [1.3, 1.0], (0, 12), tol=1e-9)
    scaled = hamsym.integrate(H, [1.3 * a, b], (0, 12), tol=1e-9, parameters={"a": a, "b": b})
    assert plain.success
    assert scaled.success
    np.testing.assert_allclose(scaled.z / [a, b], plain.z, atol=2e-9)


@pytest.mark.slow_cases("p**2/2*(1 + x**4) + x**2-start1-1.8e-09-100")
@pytest.mark.parametrize(
    ("formula", "start", "tol", "saves"),
    [
        ("p**2/2 + x**4/4 + 0.3*x*cos(t)", [0.050474921817075934, -7.92282402802898], 5.9e-5, 3),
        ("p**2/2*(1 + x**4) + x**2", [0.1571213875598874, 3.4537133675297516], 1.8e-9, 100),
    ],
)
def test_sizes_of_runs_that_diverged_are_not_kept(
    formula: str, start: list[float], tol: float, saves: int
) -> None:
    """In the first rounds the steps are so long that the states reach 1e30 and come back."""
    H, span = Hamiltonian(formula), (0.0, 40.0)
    found = hamsym.integrate(H, start, span, tol=tol, saves=saves)
    solution = reference(H, np.array(start), span)
    sizes = np.abs(solution(np.linspace(*span, 2001))).max(axis=0)
    errors = np.abs(found.z - solution(found.t))
    assert found.success is True
    assert (errors <= found.errors + 1e-11 * sizes).all()
    assert (errors <= tol * sizes).all()


def test_round_off_limits_success() -> None:
    """Beside the unstable equilibrium round-off grows by the period of the libration."""
    for amplitude, possible in ((3.0, True), (3.1415926, False)):
        found = hamsym.integrate(PENDULUM, [amplitude, 0.0], (0, 60), tol=1e-10)
        assert found.success is possible
        if not possible:
            assert "limited by float64 round-off" in found.message


@pytest.mark.parametrize(
    ("formula", "parameters", "stiffness", "start", "end", "tol"),
    [
        # Of exp(x) - 1 few digits are left, or none, although x has sixteen.
        ("p**2/2 + exp(x) - x", {}, 1, 1e-17, 3, 1e-4),
        ("p**2/2 + exp(x) - x", {}, 1, 1e-12, 3, 1e-6),
        # Roundings of w**2 push all steps the same way.
        (
            "p**2/2 + (k - w**2)*x**2/2",
            {"k": 1.0, "w": 0.9999999},
            1 - Fraction(0.9999999) ** 2,
            *(1.0, 1e6, 1e-9),
        ),
    ],
)
def test_roundings_of_terms_that_cancel_are_in_the_error(
    formula: str, parameters: dict[str, float], stiffness: Any, start: float, end: float, tol: float
) -> None:
    found = hamsym.integrate(formula, [start, 0.0], (0, end), parameters=parameters, tol=tol)
    w = math.sqrt(stiffness)
    true = [start * math.cos(w * end), -start * w * math.sin(w * end)]
    assert (np.abs(found.z[-1] - true) <= found.errors[-1]).all()


def test_a_changed_energy_is_no_success(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        ComparedRuns, "_energy_changes", lambda self, rows, *_: np.full(len(rows), 2.0)
    )
    found = hamsym.integrate("p**2/2 + x**2/2", [1.0, 0.0], (0, 5), tol=1e-4)
    assert found.success is False


def test_rest_and_zero_components_succeed() -> None:
    found = hamsym.integrate(HENON_HEILES, [[0, 0, 0, 0], [0, 0.5, 0, 0.1]], (0, 30), tol=1e-9)
    assert found.success.all()
    assert (found.z[0] == 0).all()
    assert (found.z[1, :, [0, 2]] == 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("tol", [1e-5, 1e-9, 1e-12])
def test_no_success_is_false_in_a_survey(tol: float) -> None:
    """Random members against runs with very many compensated steps of another method."""
    random = np.random.default_rng(1)
    orbits = np.array([ellipse(e) for e in random.uniform(0, 0.9, 200)])
    pendulums = np.stack((random.uniform(-3.1, 3.1, 300), random.uniform(-2, 2, 300)), axis=-1)
    cases = [
        (HENON_HEILES, henon_heiles_starts(2_000), (0.0, 6 * np.pi), 4_000),
        (HENON_HEILES, henon_heiles_starts(60, 2), (0.0, 150.0), 40_000),
        (KEPLER, orbits, (0.0, 10.0), 100_000),
        (PENDULUM, pendulums, (0.0, 30.0), 8_000),
    ]
    for H, starts, span, steps in cases:
        found = hamsym.integrate(H, starts, span, tol=tol, saves=4)
        assert found.success.mean() > 0.5 * (tol > 1e-11)
        truth = hamsym.integrate(
            H, starts, span, "yoshida8", steps=steps, save_every=steps // 100, compensated=True
        ).z
        sizes = np.abs(truth).max(axis=1, keepdims=True)
        errors = (np.abs(found.z - truth[:, ::25]) / sizes).max(axis=(1, 2))
        assert (errors[found.success] <= tol).all()


# -- members -------------------------------------------------------------------------------------


def test_bad_members_leave_the_others_unchanged() -> None:
    good = np.array([ellipse(e) for e in (0.1, 0.3, 0.5, 0.7)] * 20)
    alone = hamsym.integrate(KEPLER, good, (0, 6), tol=1e-9, saves=2)
    bad = [[np.nan, 0, 0, 1], [np.inf, 0, 0, 1], [0, 0, 0, 0], [1, 0, 0, 0]]
    mixed = np.insert(good, [0, 7, 40, 80], bad, axis=0)
    found = hamsym.integrate(KEPLER, mixed, (0, 6), tol=1e-9, saves=2)
    failed = np.flatnonzero(~found.success)
    assert failed.tolist() == [0, 8, 42, 83]
    np.testing.assert_array_equal(np.delete(found.z, failed, axis=0), alone.z)
    np.testing.assert_array_equal(np.delete(found.errors, failed, axis=0), alone.errors)
    messages = found.messages
    assert "the start is not finite" in messages[0]
    assert "the start is not finite" in messages[8]
    assert "not finite at the start" in messages[42]
    assert "pole" in messages[83]
    assert "estimated error" in messages[1]
    assert found.message.startswith("4 of 84 trajectories failed, number 0 first: the start is no")
    single = hamsym.integrate(KEPLER, good[3], (0, 6), tol=1e-9, saves=2)
    np.testing.assert_array_equal(single.z, alone.z[3])


def test_division_of_members_changes_no_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    starts = henon_heiles_starts(300)
    one = hamsym.integrate(HENON_HEILES, starts, (0, 12), tol=1e-9, saves=3)
    monkeypatch.setattr(to_tolerance, "_BLOCK", 1_000)
    monkeypatch.setattr(to_tolerance, "available_cores", lambda: 3)
    monkeypatch.setattr("hamsym.parallel.threads.available_cores", lambda: 3)
    other = hamsym.integrate(HENON_HEILES, starts, (0, 12), tol=1e-9, saves=3)
    np.testing.assert_array_equal(one.z, other.z)
    np.testing.assert_array_equal(one.errors, other.errors)


def test_each_member_has_its_parameters() -> None:
    strengths = np.array([[0.5], [2.0]])
    starts = np.array([ellipse(0.0), ellipse(0.2), ellipse(0.5)])
    found = hamsym.integrate(KEPLER, starts, (0, 5), tol=1e-9, saves=4, parameters={"k": strengths})
    assert found.z.shape == found.errors.shape == (2, 3, 5, 4)
    assert found.success.shape == found.messages.shape == (2, 3)
    assert found.success.all()
    x, y, p_x, p_y = np.moveaxis(found.z, -1, 0)
    energy = (p_x**2 + p_y**2) / 2 - strengths[:, None] / np.hypot(x, y)
    np.testing.assert_allclose(found.energy, energy, rtol=1e-14)
    np.testing.assert_allclose(found.energy, found.energy[..., :1] * np.ones(5), atol=1e-8)
    for i, k in enumerate(strengths[:, 0]):
        one = hamsym.integrate(KEPLER.with_parameters(k=k), starts[1], (0, 5), tol=1e-9, saves=4)
        np.testing.assert_array_equal(found.z[i, 1], one.z)


def test_escape_of_one_member_is_reported() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    found = hamsym.integrate(H, [[0.1, 0.0], [1.0, 1.0]], (0, 5), tol=1e-8, saves=50)
    assert found.success.tolist() == [True, False]
    assert "no longer finite" in found.messages[1]
    assert np.isinf(found.errors[1, -1]).all()
    one = hamsym.integrate(H, [1.0, 1.0], (0, 5), tol=1e-8, saves=50)
    assert one.success is False
    assert np.isfinite(one.z).all()
    assert len(one.t) == len(one.z) == len(one.errors) < 51


@pytest.fixture
def _sigint_handled() -> object:
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("_sigint_handled")
def test_ctrl_c_keeps_finished_members(monkeypatch: pytest.MonkeyPatch) -> None:
    original = to_tolerance.ToleranceSearch._judged

    def interrupted(self: to_tolerance.ToleranceSearch, result: object) -> np.ndarray:
        if self._found.success.any():
            raise KeyboardInterrupt
        return original(self, result)  # type: ignore[arg-type]

    monkeypatch.setattr(to_tolerance.ToleranceSearch, "_judged", interrupted)
    starts = np.array([ellipse(0.0), ellipse(0.7)])
    found = hamsym.integrate(KEPLER, starts, (0, 6), tol=1e-6, saves=1)
    assert found.interrupted
    assert found.success.tolist() == [True, False]
    assert found.messages[1] == "interrupted"


# -- what steps could jump over ------------------------------------------------------------------


@pytest.mark.slow_cases("gauss4")
@pytest.mark.parametrize("method", ["blanes_moan6", "gauss4"])
def test_collision_is_refused(method: str) -> None:
    for start in ([1.0, 0, 0, 0], [0.6, 0.8, 0, 0], [1.0, 0, -0.3, 0], [1.0, 0, 0, 1e-5]):
        found = hamsym.integrate(KEPLER, start, (0, 3), method, tol=1e-6, saves=1)
        assert found.success is False


def test_weak_pole_is_refused() -> None:
    """The pole is too weak to be felt at any step."""
    H = Hamiltonian("p**2/2 + x**2/2 - 1e-12/abs(x)")
    found = hamsym.integrate(H, [1.0, 0.0], (0, 5), tol=1e-6)
    assert found.success is False
    assert "pole" in found.message


@pytest.mark.parametrize(
    "pulse",
    [
        "1e5*Heaviside(1e-10 - (t - 5.00013)**2)",
        "1e7*Heaviside(1e-7 - abs(t - 5.00013))",
        "1e21*max(0, 1e-14 - (t - 5.00013)**2)",
    ],
)
def test_pulse_between_two_zeros_of_a_switch_is_seen(pulse: str) -> None:
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": pulse})
    found = hamsym.integrate(H, [1.0, 0.0], (0, 10), tol=1e-8)
    assert found.success is False
    assert "feature narrower than a step near t = " in found.message


def test_switch_that_stays_away_from_zero_is_resolved() -> None:
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": "sign(2 + sin(3*t))/10"})
    found = hamsym.integrate(H, [1.0, 0.0], (0, 10), tol=1e-8)
    assert found.success
    assert found.z[-1, 0] == pytest.approx(0.1 + 0.9 * np.cos(10), abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize(("friction", "tol"), [(1e-4, 1e-7), (1e-5, 1e-8)])
def test_small_jumps_of_the_force_keep_the_tolerance(friction: float, tol: float) -> None:
    H = Hamiltonian("p**2/2 + x**2/2", forces={"p": f"-{friction!r}*sign(p)"})
    # Steps that are too long for these jumps differ by less than their errors.
    starts = np.array([[0.538, 0.502], [0.527, 0.686], [0.582, 0.558], [0.636, 0.91]])
    found = hamsym.integrate(H, starts, (0, 3), tol=tol)
    # Circles about -c until p = 0, then about c.
    size = np.hypot(starts[:, 0] + friction, starts[:, 1])
    rest = 3 - np.arctan2(starts[:, 1], starts[:, 0] + friction)
    exact = np.stack([friction, 0.0]) + (size - 2 * friction)[:, None] * np.column_stack(
        [np.cos(rest), -np.sin(rest)]
    )
    errors = np.abs(found.z[:, -1] - exact) / np.abs(found.z).max(axis=1)
    assert found.success.all()
    assert (errors <= tol).all()


@pytest.mark.parametrize("width", [0.1, 1e-2, 1e-3])
@pytest.mark.parametrize("tol", [1e-3, 1e-8])
def test_pulses_are_resolved(width: float, tol: float) -> None:
    """Compared with the integral of the pulse and the free motion."""
    found = hamsym.integrate(FORCED, [1.0, 0.0], (0, 10), tol=tol, saves=1, parameters={"w": width})
    assert found.success
    s = np.linspace(-8, 8, 4_001) * width
    pulse = np.exp(-((s / width) ** 2))
    x = np.cos(10) + scipy.integrate.trapezoid(np.sin(10 - 3.1 - s) * pulse, s)
    p = -np.sin(10) + scipy.integrate.trapezoid(np.cos(10 - 3.1 - s) * pulse, s)
    assert np.abs(found.z[-1] - [x, p]).max() <= tol


def test_pulse_too_narrow_is_refused_where_it_matters() -> None:
    for tol in (1e-3, 1e-9):
        found = hamsym.integrate(FORCED, [1.0, 0.0], (0, 10), tol=tol, parameters={"w": 1e-9})
        assert found.success is (tol > 1e-9)
    assert "feature narrower than a step near t = 3.1" in found.message


def parabolas(t: float) -> tuple[float, float]:
    """Motion of p**2/2 + abs(x) from (1, 0), half a period before it repeats with other signs."""
    quarter = np.sqrt(2)
    half, rest = divmod(t + quarter, 2 * quarter)
    sign = 1 - 2 * (half % 2)
    return sign * rest * (quarter - rest / 2), sign * (quarter - rest)


@pytest.mark.parametrize(
    ("formula", "exact"),
    [
        ("p**2/2 + abs(x)", parabolas(5.0)),
        (
            "p**2/2 + x**2/2 - x*(1 + sign(t - 1))*(1 + sign(1.0001 - t))",
            (np.cos(5) + 4e-4 * np.sin(3.99995), -np.sin(5) + 4e-4 * np.cos(3.99995)),
        ),
    ],
)
def test_jumps_of_the_force_are_resolved_or_refused(
    formula: str, exact: tuple[float, float]
) -> None:
    found = hamsym.integrate(formula, [1.0, 0.0], (0, 5), tol=1e-3)
    assert found.success is True
    assert (np.abs(found.z[-1] - exact) <= 1e-3 * np.abs(found.z).max(axis=0)).all()
    found = hamsym.integrate(formula, [1.0, 0.0], (0, 5), "stormer_verlet", tol=1e-10)
    assert found.success is False
    assert "a jump" in found.message


@pytest.mark.parametrize(
    "formula",
    [
        "p**2/2 + x**2/2 + sign(x - 0.3)/10",
        "p**2/2 + x**2/2 + cos(t)*sign(x - 0.3)/10",
        "p**2/2 + x**2/2 + cos(t)*(sign(x - 0.3) - sign(x - 0.3001))",
        "p**2/2 + x**2/2 + cos(t)*sign(x - 1.00000000000001)/10",
    ],
)
def test_jumps_of_H_are_refused(formula: str) -> None:
    """Of which the force has no trace, crossed, crossed twice in a step, or nearly touched."""
    start = [-1.0, 0.0]
    found = hamsym.integrate(formula, start, (0, 5), "stormer_verlet", tol=1e-3)
    assert found.success is False
    assert "a jump" in found.message
    assert hamsym.integrate(formula, start, (0, 1), "stormer_verlet", tol=1e-3).success is True


@pytest.mark.parametrize("distance", [0.0, 1e-12, -1e-12, 1e-4])
def test_switch_that_is_touched_is_crossed_or_not(distance: float) -> None:
    """Success needs an error that is less than the distance at which the switch is passed."""
    H = Hamiltonian("p**2/2 + x**2/2 + abs(x - c)/10", parameters={"c": 0.8 + distance})
    found = hamsym.integrate(H, [-0.6, 0.0], (0, 10), tol=1e-6)
    assert found.success is (distance == 1e-4)
    exact = 0.1 - 0.7 * np.cos(found.t)
    assert not found.success or np.abs(found.z[:, 0] - exact).max() <= 0.6e-6


@pytest.mark.parametrize("formula", ["p**2/2 + abs(x)**3", "p**2/2 + x**2/2 + max(x, 0)**2"])
def test_kinks_of_the_force_are_resolved(formula: str) -> None:
    found = hamsym.integrate(formula, [1.0, 0.0], (0, 5), tol=1e-7, saves=5)
    truth = hamsym.integrate(formula, [1.0, 0.0], (0, 5), "dop853", steps=5, rtol=1e-12)
    assert found.success is True
    assert (np.abs(found.z - truth.z) <= 1e-7 * np.abs(found.z).max(axis=0)).all()


@pytest.mark.slow
def test_stiff_oscillation_is_resolved() -> None:
    """The fast oscillation has an amplitude that every run could ignore."""
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + x**2/2 + 1e4*y**2/2 + x**2*y")
    start, span = np.array([1.0, 0.0, 0.0, 0.0]), (0.0, 10.0)
    found = hamsym.integrate(H, start, span, tol=1e-8)
    truth = reference(H, start, span)(found.t)
    assert found.success
    assert (np.abs(found.z - truth) <= 1e-8 * np.abs(truth).max(axis=0)).all()


def test_given_steps_over_a_pole_are_refused() -> None:
    """Of a time-dependent H, where no change of H shows the jump."""
    H = Hamiltonian("(p_x**2 + p_y**2)/2 - (1 + sin(t)/10)/sqrt(x**2 + y**2)")
    found = hamsym.integrate(H, [1.0, 0, 0, 0], (0, 2), "stormer_verlet", steps=100)
    assert found.success is False
    assert "the force has a feature, for example a pulse or a pole" in found.message
    found = hamsym.integrate(H, ellipse(0.6), (0, 6), "stormer_verlet", steps=2_000)
    assert found.success is True


# -- late times ----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["blanes_moan6", "stormer_verlet"])
@pytest.mark.parametrize("length", [0.02, -0.02])
def test_states_belong_to_the_rounded_times(method: str, length: float) -> None:
    """Seconds since 1970 are rounded by up to 1e-7, in which the phase changes by 1e-4."""
    start, tol = 1.7e9, 1e-7
    H = Hamiltonian("p**2/2 + w**2*x**2/2", parameters={"w": 1e3})
    starts = [[1.0, 0.0], [0.0, 1e3], [np.nan, 0.0]]
    found = hamsym.integrate(H, starts, (start, start + length), method, tol=tol, saves=30)
    assert np.ptp(np.diff(found.t)) > 1e-7
    assert found.success.tolist() == [True, True, False]
    for member, first in enumerate((0.0, np.pi / 2)):
        phase = 1e3 * (found.t - start) - first
        exact = np.column_stack((np.cos(phase), -1e3 * np.sin(phase)))
        assert (np.abs(found.z[member] - exact) <= [tol, 1e3 * tol]).all()


def test_saved_times_that_rounding_makes_equal_are_refused() -> None:
    for span in ((1e6, 1e6 + 1e-9), (1e6 + 1e-9, 1e6), (1.0, 1.0 + 2.3e-16)):
        with pytest.raises(InputError, match="saves=20 gives equal saved times"):
            hamsym.integrate(PENDULUM, [1.0, 0.0], span, tol=1e-6, saves=20)
    assert hamsym.integrate(PENDULUM, [1.0, 0.0], (1e6, 1e6 + 1e-9), tol=1e-6, saves=2).success


@pytest.mark.parametrize(("force", "frequency", "success"), [(1e6, 1e3, False), (1.0, 3.0, True)])
def test_rounding_of_late_times_is_part_of_the_error(
    force: float, frequency: float, success: bool
) -> None:
    """The time is rounded to 1e-10 wherever the force is evaluated; it turns 1e9 times as fast."""
    given = {"F": force, "w": frequency}
    H = Hamiltonian("p**2/2 + x**2/2 + F*x*cos(w*t)", parameters=given)
    start, tol = 1e6, 1e-9 if not success else 1e-7
    found = hamsym.integrate(H, [1.0, 0.0], (start, start + 1), tol=tol, saves=8)
    with mpmath.workdps(40):
        F, w, begin = mpmath.mpf(force), mpmath.mpf(frequency), mpmath.mpf(start)
        A, exact = -F / (1 - w**2), []
        a, b = 1 - A * mpmath.cos(w * begin), A * w * mpmath.sin(w * begin)
        for t in found.t.tolist():
            c, s = mpmath.cos(t - begin), mpmath.sin(t - begin)
            x = a * c + b * s + A * mpmath.cos(w * t)
            exact.append([float(x), float(b * c - a * s - A * w * mpmath.sin(w * t))])
    assert found.success is success
    assert (np.abs(found.z - np.array(exact)) <= found.errors).all()


# -- extrapolation -------------------------------------------------------------------------------


def runs_of_order(order: int, powers: tuple[float, ...]) -> list[np.ndarray]:
    """States 1 with errors of the given powers of the step, at three times, the first the start."""
    return [
        np.array([[[1.0], *([[1 + sum(h**p for p in powers)]] * 2)]])
        for h in (0.05 / 1, 0.05 / 2, 0.05 / 4)
    ]


def test_extrapolation_removes_two_powers() -> None:
    coarse, middle, fine = runs_of_order(2, (2, 4))
    found = extrapolate(coarse, middle, fine, coarse.copy(), 2, 2, 4, 100, 1.0)
    np.testing.assert_allclose(found.states, 1.0, atol=1e-15)
    assert (np.abs(found.states[0, 1:] - 1) <= found.errors[0, 1:, None]).all()
    assert found.errors[0, 0] < 1e-13


def test_slow_convergence_is_not_extrapolated_away() -> None:
    """Errors of first order in a method of the sixth: the estimate is that of the first."""
    coarse, middle, fine = runs_of_order(6, (1,))
    error = 0.05 / 4
    found = extrapolate(coarse, middle, fine, coarse.copy(), 2, 6, 8, 100, 1.0)
    assert (found.errors[0, 1:] > 0.9 * error).all()


def test_runs_that_differ_by_the_size_of_a_component_have_no_order() -> None:
    """A double well with a tolerance of 9 %: the first differences fall as the order says."""
    H, start, span = (
        Hamiltonian("p**2/2 + x**4/4 - x**2/2"),
        [0.29843597, -0.98269071],
        (0.0, -40.0),
    )
    found = hamsym.integrate(H, start, span, "implicit_midpoint", tol=0.086, saves=1)
    truth = reference(H, np.array(start), span)(np.linspace(*span, 2001))
    assert (np.abs(found.z[-1] - truth[-1]) <= 0.086 * np.abs(truth).max(axis=0)).all()


def test_estimate_holds_where_halved_steps_help_little() -> None:
    coarse, middle, fine = runs_of_order(6, (0.5,))
    error = np.abs(fine - 1).max()
    found = extrapolate(coarse, middle, fine, coarse.copy(), 2, 6, 8, 100, 1.0)
    assert found.errors[0, -1] > 0.9 * error


def test_values_that_are_not_finite_give_infinite_errors() -> None:
    for place in range(3):
        runs = runs_of_order(2, (2, 4))
        runs[place][0, 2, 0] = np.nan
        found = extrapolate(*runs, runs[0].copy(), 2, 2, 4, 100, 1.0)
        assert np.isfinite(found.errors[0, :2]).all()
        assert found.errors[0, 2] == np.inf


# -- results and arguments -----------------------------------------------------------------------


def test_one_start_gives_plain_results() -> None:
    problem = kepler_problem(0.3)
    found = hamsym.integrate(problem.H, problem.z0, (0, 5), tol=1e-9)
    assert found.success is True
    assert found.z.shape == found.errors.shape == (101, 4)
    assert (found.errors[0] == 0).all()
    assert (np.diff(found.errors, axis=0) >= 0).all()
    assert found.messages.shape == ()
    assert found.messages[()] == found.message
    assert f"{found.steps:,} steps to t = 5, estimated error" in found.message
    copy = pickle.loads(pickle.dumps(found))
    np.testing.assert_array_equal(copy.z, found.z)
    np.testing.assert_array_equal(copy.energy, found.energy)
    assert copy.message == found.message


def test_energy_is_computed_when_read() -> None:
    found = hamsym.integrate(PENDULUM, [1.0, 0.0], (0, 1), steps=10)
    assert "energy" not in vars(found)
    np.testing.assert_allclose(
        found.energy, found.z[:, 1] ** 2 / 2 - np.cos(found.z[:, 0]), rtol=1e-15
    )
    assert found.energy is found.energy


def test_parameters_vary_with_given_steps() -> None:
    found = hamsym.integrate(
        KEPLER, ellipse(0.0), (0, 1), steps=100, parameters={"k": np.array([[1.0, 2.0]])}
    )
    assert found.z.shape == (1, 2, 101, 4)
    assert found.success is True
    for i, k in enumerate((1.0, 2.0)):
        one = hamsym.integrate(KEPLER.with_parameters(k=k), ellipse(0.0), (0, 1), steps=100)
        np.testing.assert_array_equal(found.z[0, i], one.z)
        np.testing.assert_array_equal(found.energy[0, i], one.energy)
    chosen = hamsym.integrate(KEPLER, ellipse(0.5), (0, 6), parameters={"k": [1.0, 2.0]})
    assert chosen.drift <= 1e-9
    adaptive = hamsym.integrate(
        KEPLER, ellipse(0.5), (0, 6), "dop853", steps=10, parameters={"k": [1.0, 2.0]}
    )
    np.testing.assert_allclose(adaptive.z, chosen.z[:, :: (len(chosen.t) - 1) // 10], atol=1e-6)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"tol": 0}, "tol=0 cannot be used; give a number above 0"),
        ({"tol": float("nan")}, "tol=nan"),
        ({"tol": "1"}, "tol='1'"),
        ({"saves": 0}, "saves=0"),
        ({"saves": 10**12}, "GiB"),
        ({"steps": 100}, "steps and tol exclude each other"),
        ({"save_every": 1}, "save_every and tol exclude each other"),
        ({"rtol": 1e-9}, "rtol and tol exclude each other"),
        ({"method": "tao4"}, "tol applies to splitting and implicit Runge-Kutta methods"),
        ({"method": "dop853"}, "not to dop853; leave method out"),
        ({"z0": [np.nan, 0.0]}, "'theta' is not finite in z0"),
        ({"tol": None, "saves": 2}, "saves applies with tol"),
        ({"parameters": {"k": 1.0}}, "'k' is not a parameter of H; it has none"),
    ],
)
def test_unusable_arguments(arguments: dict[str, object], message: str) -> None:
    settings = {"z0": [1.0, 0.0], "span": (0, 1), "tol": 1e-6, **arguments}
    with pytest.raises(InputError, match=message):
        hamsym.integrate(PENDULUM, **settings)
