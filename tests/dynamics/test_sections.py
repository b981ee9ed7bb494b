"""Poincare sections and events: accuracy, completeness and errors."""

from __future__ import annotations

import importlib.util
import warnings

import numpy as np
import pytest
import scipy.integrate

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.dynamics import crossings
from hamsym.errors import EventWarning, StepSizeWarning
from hamsym.integrators import stepper
from hamsym.numerics.roots import changes, refine, sign_changes
from hamsym.problems.surface import parse_surface
from hamsym.systems import driven_oscillator, harmonic_oscillator, henon_heiles, kepler

CHAOTIC = {"x": 0, "y": -0.15, "p_y": 0}


@pytest.fixture(scope="module")
def start() -> np.ndarray:
    return henon_heiles().H.state_at_energy(1 / 6, CHAOTIC)


# -- surfaces ----------------------------------------------------------------------------------


def test_surface_of_several_parts() -> None:
    H = henon_heiles().H
    surface = parse_surface(H, " max(x, -y) = 2*y , p_x > 0,p_y < x")
    z = np.array([[1.0, 0.5, 0.1, 0.5], [0.0, 0.0, -0.1, 0.0], [1.0, 1.0, 0.1, 2.0]])
    np.testing.assert_allclose(surface.value(z, 0.0), [0.0, 0.0, -1.0])
    assert surface.holds(z, np.zeros(3)).tolist() == [True, False, False]
    assert surface.names == {"x", "y"}


def test_surfaces_take_parameters_and_time() -> None:
    H = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 4.0})
    assert parse_surface(H, "k*x = t").value(np.array([[1.0, 0.0]]), np.array([3.0])) == [1.0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x", "'x' is not an equation or inequality; write for example x = 0, p_x > 0"),
        ("p_x > 0", "has no equation"),
        ("x = 0, y = 0", "has two equations"),
        ("x == 0", "'x == 0' is not an equation"),
        ("x >= 0", "'x >= 0' is not an equation"),
        ("x = 0 = y", "is not an equation"),
        ("x = 0,", "'' is not an equation"),
        ("1 = 0", "does not depend on the state; use a component"),
        ("a = 0", "'a' does not occur in H"),
        ("x^2 = 0", "write \\*\\* for powers"),
        ("x = 0, __import__('os') > 0", "__import__"),
        (3, "a surface is a str"),
    ],
)
def test_unusable_surfaces_are_rejected(text: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_surface(henon_heiles().H, text)  # type: ignore[arg-type]


def test_sign_changes_count_a_zero_once() -> None:
    values = np.array([0.0, 1.0, 0.0, -1.0, 0.0, 1.0, 2.0, -1.0])
    assert sign_changes(values)[0].tolist() == [1, 3, 6]
    for direction, expected in ((0, [1, 3, 6]), (1, [3]), (-1, [1, 6])):
        found = changes(values[:-1], values[1:], direction)
        assert np.flatnonzero(found).tolist() == expected


def test_no_zero_across_nan() -> None:
    """The sign changes across a gap: its ends are not zeros."""

    def gap(x: np.ndarray, _: np.ndarray) -> np.ndarray:
        return np.where(np.abs(x) < 0.5, np.nan, np.sign(x))

    assert np.isnan(refine(gap, np.array([-1.0]), np.array([0.9]))).all()


# -- sections ----------------------------------------------------------------------------------


def test_section_of_a_circle_is_exact() -> None:
    problem = harmonic_oscillator()
    found = hamsym.section(problem.H, problem.z0, (0, 100), "x = 0, p > 0", method="yoshida8",
                           dt=0.05)  # fmt: skip
    expected = 1.5 * np.pi + 2 * np.pi * np.arange(16)
    np.testing.assert_allclose(found.t, expected[expected <= 100], atol=1e-11)
    np.testing.assert_allclose(found.z[:, 1], 1, atol=1e-12)
    assert np.abs(found.z[:, 0]).max() < 1e-15  # to round-off
    assert found.success


def test_henon_heiles_section_against_dop853(start: np.ndarray) -> None:
    H = henon_heiles().H
    found = hamsym.section(H, start, (0, 60), "x = 0, p_x > 0", dt=0.02)

    def crossing(t: float, z: np.ndarray) -> float:
        return z[0]

    crossing.direction = 1.0  # type: ignore[attr-defined]
    field = H.compile("numpy").vector_field
    right = scipy.integrate.solve_ivp(
        lambda t, z: field(z), (0, 60), start, "DOP853", events=crossing, rtol=1e-13, atol=1e-13
    )
    times = right.t_events[0][right.t_events[0] > 1e-6]
    np.testing.assert_allclose(found.t, times, atol=1e-8)
    np.testing.assert_allclose(found.z, right.y_events[0][-len(times) :], atol=1e-8)


def test_ensembles_are_sections_of_each(start: np.ndarray) -> None:
    H = henon_heiles().H
    starts = np.array([start, henon_heiles().z0, 0.5 * start])
    together = hamsym.section(H, starts, (0, 100), "x = 0, p_x > 0", dt=0.1)
    for number, one in enumerate(starts):
        alone = hamsym.section(H, one, (0, 100), "x = 0, p_x > 0", dt=0.1)
        mine = together.trajectory == number
        np.testing.assert_allclose(together.t[mine], alone.t, atol=1e-12)
        np.testing.assert_allclose(together.z[mine], alone.z, atol=1e-12)
        assert np.all(np.diff(together.t[mine]) > 0)
    assert np.all(np.diff(together.trajectory) >= 0)
    assert together.energy_error < 1e-10
    np.testing.assert_array_equal(together.z0, starts)


@pytest.mark.slow_cases("options2")
@pytest.mark.parametrize("options", [{"dt": 0.05}, {}, {"method": "gauss4", "dt": 0.05}])
def test_sections_for_several_parameters(options: dict[str, object]) -> None:
    """As for each by itself, also where the surface contains the parameter."""
    H = Hamiltonian("p**2/2 + k*x**2/2 + x**4/4", parameters={"k": 1.0})
    k, surface = np.array([0.5, 1.0, 4.0]), "x = k/10, p > -k"
    together = hamsym.section(H, [1.0, 0.3], (0, 20), surface, parameters={"k": k}, **options)
    assert together.success
    for number, value in enumerate(k.tolist()):
        own = H.with_parameters(k=value)
        alone = hamsym.section(own, [1.0, 0.3], (0, 20), surface, **options)
        mine = together.trajectory == number
        assert mine.sum() == len(alone.t) > 2
        np.testing.assert_allclose(together.t[mine], alone.t, atol=1e-8)
        np.testing.assert_allclose(together.z[mine], alone.z, atol=1e-8)
        if options:
            np.testing.assert_array_equal(together.z[mine], alone.z)
    assert together.energy_error < 1e-6


def test_section_over_a_plane_of_parameters() -> None:
    """Half periods pi/sqrt(k) of oscillators, counted along the last axis first."""
    H = Hamiltonian("p**2/2 + k*x**2/2")
    starts, k = {"x": [[1.0], [2.0]], "p": 0.0}, [1.0, 4.0, 9.0]
    found = hamsym.section(H, starts, (0, 3.2), "x = 0", dt=0.01, parameters={"k": k})
    start, parameter = np.unravel_index(found.trajectory, (2, 3))
    assert np.bincount(found.trajectory).tolist() == [1, 2, 3, 1, 2, 3]
    period = 2 * np.pi / np.sqrt(k)[parameter]
    np.testing.assert_allclose(found.t / period % 0.5, 0.25, atol=1e-9)
    speed = np.array([1.0, 2.0])[start] * np.sqrt(k)[parameter]
    np.testing.assert_allclose(np.abs(found.z[:, 1]), speed, rtol=1e-9)
    if importlib.util.find_spec("pandas"):
        table = found.to_dataframe()
        np.testing.assert_array_equal(table["k"], np.array(k)[parameter])
        np.testing.assert_array_equal(table["z0_x"], np.array([1.0, 2.0])[start])


@pytest.mark.slow
def test_direction_and_number_of_crossings(start: np.ndarray) -> None:
    H = henon_heiles().H
    both = hamsym.section(H, start, (0, 100), "x = 0", dt=0.1)
    rising = hamsym.section(H, start, (0, 100), "x = 0", dt=0.1, direction=1)
    falling = hamsym.section(H, start, (0, 100), "x = 0", dt=0.1, direction=-1)
    assert np.array_equal(np.sort(np.concatenate((rising.t, falling.t))), both.t)
    assert np.all(rising.z[:, 2] > 0)
    assert np.all(falling.z[:, 2] < 0)
    few = hamsym.section(H, [start, 0.9 * start], (0, 1e7), "x = 0", dt=0.1, crossings=5)
    assert np.bincount(few.trajectory).tolist() == [5, 5]
    np.testing.assert_array_equal(few.t[:5], both.t[:5])


@pytest.mark.slow
def test_other_methods_backward_time_and_explicit_time() -> None:
    H = Hamiltonian("p**2*(1 + x**2)/2 + x**3/3 - 2*x + x*p/3")
    for method in (None, "gauss4", "symplectic_euler"):
        found = hamsym.section(H, [1.3, 0.1], (0, -20), "x = p + 7/5", method=method, dt=0.01)
        assert len(found.t) > 10
        assert np.abs(found.z[:, 0] - found.z[:, 1] - 1.4).max() < 1e-14
        assert np.all(np.diff(found.t) < 0)
    driven = driven_oscillator()
    found = hamsym.section(driven.H, driven.z0, (0, 50), "sin(Omega*t/2) = 0", dt=0.05)
    period = 2 * np.pi / driven.H.parameters["Omega"]
    np.testing.assert_allclose(found.t, period * np.arange(1, len(found.t) + 1), atol=1e-9)
    np.testing.assert_allclose(found.z, driven.exact(found.t), atol=1e-7)
    assert np.isnan(found.energy_error)


def test_missing_crossings_are_reported() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    found = hamsym.section(H, [[1.0, 1.0], [0.1, 0.0]], (0, 10), "x = 2", dt=0.01)
    assert not found.success
    assert "1 of 2 trajectories overflowed" in found.message
    assert found.trajectory.tolist()[0] == 0
    oscillator = harmonic_oscillator()
    few = hamsym.section(oscillator.H, [1.0, 0.0], (0, 10), "x = 0", crossings=50)
    assert not few.success
    assert "has only 3 of 50 crossings by t = 10" in few.message
    none = hamsym.section(oscillator.H, [1.0, 0.0], (0, 10), "x = 5")
    assert none.success
    assert none.z.shape == (0, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "tao2"}, "tao2 cannot take part of a step"),
        ({"method": "dop853"}, "dop853 is adaptive; give a method with fixed steps: "),
        ({"crossings": 0}, "crossings=0"),
        ({"steps": 10, "dt": 1.0}, "exclude each other"),
    ],
)
def test_unusable_section_options_are_rejected(options: dict[str, object], message: str) -> None:
    problem = harmonic_oscillator()
    with pytest.raises(InputError, match=message):
        hamsym.section(problem.H, problem.z0, (0, 1), "x = 0", **options)


@pytest.mark.slow
def test_section_is_drawn_in_the_free_plane(start: np.ndarray) -> None:
    found = hamsym.section(henon_heiles().H, start, (0, 100), "x = 0, p_x > 0", dt=0.1)
    axis = found.plot().axes[0]
    assert (axis.get_xlabel(), axis.get_ylabel()) == ("$y$", "$p_{y}$")
    assert found.plot("p_x", "y").axes[0].get_xlabel() == "$p_{x}$"
    with pytest.raises(InputError, match="'q' does not occur in H; use only x"):
        found.plot("q", "y")
    with pytest.raises(InputError, match="in the plane of two components, not of 1"):
        found.plot("y")


def both_sides(level: float, end: float) -> np.ndarray:
    """When cos(t) passes a level, up to an end."""
    turns = 2 * np.pi * np.arange(end // (2 * np.pi) + 2)
    away = 2 * np.arcsin(np.sqrt((1 - level) / 2))  # arccos, without cancellation
    times = np.sort(np.concatenate((turns + away, turns - away)))
    return times[(times > 0) & (times < end)]


@pytest.mark.parametrize("level", [0.99, 0.9999, 0.999999])
@pytest.mark.parametrize("options", [{}, {"dt": 0.1}, {"dt": 0.4, "method": "yoshida8"}])
def test_pairs_of_crossings_within_a_step(level: float, options: dict[str, object]) -> None:
    H, expected = harmonic_oscillator().H, both_sides(level, 300.0)
    found = hamsym.section(H, [1.0, 0.0], (0, 300), f"x = {level}", **options)
    np.testing.assert_allclose(found.t, expected, atol=2e-3)
    assert np.abs(found.z[:, 0] - level).max() < 1e-15
    rising = hamsym.section(H, [1.0, 0.0], (0, 300), f"x = {level}", direction=1, **options)
    np.testing.assert_array_equal(rising.t, found.t[found.z[:, 1] > 0])
    half = hamsym.section(H, [1.0, 0.0], (0, 300), f"x = {level}, p < 0", **options)
    np.testing.assert_array_equal(half.t, found.t[found.z[:, 1] < 0])
    back = hamsym.section(H, [1.0, 0.0], (0, -300), f"x = {level}", **options)
    np.testing.assert_allclose(back.t, -expected, atol=2e-3)


def test_a_return_within_the_first_step() -> None:
    """From the surface across it and back, x = t - 5 t^2, before the first step ends."""
    H = Hamiltonian("p**2/2 + 10*x")
    found = hamsym.section(H, [0.0, 1.0], (0, 1), "x = 0", dt=0.25)
    np.testing.assert_allclose(found.t, [0.2], atol=1e-12)


@pytest.mark.slow
def test_steps_of_a_section_are_chosen() -> None:
    problem = kepler(0.9)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = hamsym.section(problem.H, problem.z0, (0, 100), "y = 0, x < 0")
    assert found.drift < 1e-8
    np.testing.assert_allclose(found.t, np.pi * np.arange(1, 32, 2), atol=1e-5)
    assert "of its scale" in found.message
    driven = driven_oscillator()
    found = hamsym.section(driven.H, driven.z0, (0, 50), "x = 0")
    assert np.abs(driven.exact(found.t)[:, 0]).max() < 1e-8
    assert np.isnan(found.drift)


@pytest.mark.slow
def test_energy_drift_fails_and_warns() -> None:
    problem = kepler(0.9)
    with pytest.warns(StepSizeWarning, match="of its scale: take smaller steps"):
        found = hamsym.section(problem.H, problem.z0, (0, 100), "y = 0", dt=0.1)
    assert found.drift > 0.01
    assert found.success is False
    assert found.message.endswith("take smaller steps")
    with pytest.warns(StepSizeWarning, match="steps were chosen for 1e-09"):
        hamsym.section("p**2/2 + abs(x)", [1.0, 0.0], (0, 30), "x = 1/2")


def test_section_beyond_a_close_encounter_fails() -> None:
    two_centres = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2)/2 - 1/sqrt((x + 1)**2 + y**2) - 1/sqrt((x - 1)**2 + y**2)"
    )
    with pytest.warns(StepSizeWarning, match="take smaller steps"):
        found = hamsym.section(two_centres, [0, 1.5, 0.3, 0.2], (0, 40), "x = 0", dt=0.02)
    assert found.success is False


def test_surface_without_value_fails() -> None:
    problem = harmonic_oscillator()
    found = hamsym.section(problem.H, problem.z0, (0, 10), "sqrt(x) = 1/2", dt=0.01)
    assert not found.success
    assert "sqrt(x) = 1/2 is not a number at t = 1.58" in found.message
    assert len(found.t) == 3


# -- events on solutions -----------------------------------------------------------------------


@pytest.fixture(scope="module")
def orbit() -> hamsym.Solution:
    problem = kepler()
    return hamsym.solve(problem.H, problem.z0, (0, 20), tol=1e-10)


def test_events_agree_with_scipy(orbit: hamsym.Solution) -> None:
    def far(t: float, z: np.ndarray) -> float:
        return np.hypot(z[0], z[1]) - 1.2

    def inward(t: float, z: np.ndarray) -> float:
        return far(t, z)

    inward.direction = -1  # type: ignore[attr-defined]
    found = orbit.events([far, inward, "y = 0, x < 0"])
    field = orbit.H.compile("numpy").vector_field
    right = scipy.integrate.solve_ivp(
        lambda t, z: field(z), (0, 20), orbit.z0, "DOP853", events=[far, inward], rtol=1e-13,
        atol=1e-13,
    )  # fmt: skip
    for mine, scipys in zip(found.t_events, right.t_events, strict=False):
        np.testing.assert_allclose(mine, scipys, atol=1e-8)
    np.testing.assert_allclose(found.y_events[1], right.y_events[1], atol=1e-7)
    np.testing.assert_allclose(found.t_events[2], np.pi * np.array([1, 3, 5]), atol=1e-8)
    radius = np.hypot(found.y_events[0][:, 0], found.y_events[0][:, 1])
    assert np.abs(radius - 1.2).max() < 1e-14


def test_terminal_event_ends_all_searches(orbit: hamsym.Solution) -> None:
    def third(t: float, z: np.ndarray) -> float:
        return z[1]

    third.terminal = 3  # type: ignore[attr-defined]
    times = orbit.events([third, "x = 0"]).t_events
    np.testing.assert_allclose(times[0], np.pi * np.array([1, 2, 3]), atol=1e-8)
    assert times[1].max() < 3 * np.pi
    assert len(orbit.events("x = 0").t_events[0]) > len(times[1])


def test_terminal_event_ends_a_backward_span() -> None:
    problem = harmonic_oscillator()

    def first(t: float, z: np.ndarray) -> float:
        return z[0]

    first.terminal = 1  # type: ignore[attr-defined]
    back = hamsym.solve(problem.H, problem.z0, (0, -6), tol=1e-9)
    times = back.events([first, "p = 0"]).t_events
    np.testing.assert_allclose(times[0], [-np.pi / 2], atol=1e-8)
    assert not len(times[1])


def test_events_on_a_trained_network_and_backward() -> None:
    problem = harmonic_oscillator()
    trained = hamsym.solve(
        problem.H,
        problem.z0,
        (0, 2),
        method=hamsym.Adam(
            hidden=(20, 20),
            points=30,
            noise=0.0,
            tau=0.25,
            schedule="cosine",
            learning_rate=0.02,
            epochs=200,
        ),
    )
    found = trained.events("x = 0")
    np.testing.assert_allclose(found.t_events[0], [np.pi / 2], atol=0.05)
    assert abs(trained(found.t_events[0][0])[0]) < 1e-13
    np.testing.assert_array_equal(found.y_events[0], trained(found.t_events[0]))
    back = hamsym.solve(problem.H, problem.z0, (0, -6), tol=1e-9)
    times = back.events("x = 0").t_events[0]
    np.testing.assert_allclose(times, [-np.pi / 2, -1.5 * np.pi], atol=1e-9)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        (3.0, "3.0 is not an event; give a text"),
        (lambda t, z: "no", "an event returned 'no'; it must return a number"),
        ("x", "is not an equation"),
    ],
)
def test_unusable_events_are_rejected(orbit: hamsym.Solution, event: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        orbit.events([event])  # type: ignore[list-item]


def test_unusable_terminal_is_rejected(orbit: hamsym.Solution) -> None:
    def event(t: float, z: np.ndarray) -> float:
        return z[0]

    event.terminal = 0.5  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="terminal=0.5 cannot be used"):
        orbit.events(event)


@pytest.fixture(scope="module")
def circle() -> hamsym.Solution:
    return hamsym.solve(harmonic_oscillator().H, [1.0, 0.0], (0, 300), tol=1e-11)


@pytest.mark.slow_cases("0.999999", "0.99")
@pytest.mark.parametrize("level", [0.99, 0.9999, 0.999999])
def test_pairs_of_events_between_scan_times(circle: hamsym.Solution, level: float) -> None:
    expected = both_sides(level, 300.0)

    def above(t: float, z: np.ndarray) -> float:
        return z[0] - level

    def rising(t: float, z: np.ndarray) -> float:
        return above(t, z)

    rising.direction = 1.0  # type: ignore[attr-defined]
    texts = [f"x = {level}", f"x = {level}, p < 0"]
    found = circle.events([*texts, above, rising]).t_events
    np.testing.assert_allclose(found[0], expected, atol=1e-6)
    np.testing.assert_allclose(found[2], found[0], atol=1e-9)
    after = np.sin(found[0]) > 0  # x falls
    np.testing.assert_allclose(found[1], found[0][after], atol=1e-9)
    np.testing.assert_allclose(found[3], found[0][~after], atol=1e-9)
    back = hamsym.solve(circle.H, [1.0, 0.0], (0, -300), tol=1e-11)
    np.testing.assert_allclose(back.events(texts[0]).t_events[0], -expected, atol=1e-6)


def test_tangency_is_two_events_at_most(circle: hamsym.Solution) -> None:
    """x = 1 is touched 47 times, each to round-off: no event, one or two."""
    touched = circle.events("x = 1").t_events[0]
    turns = touched / (2 * np.pi)
    assert np.abs(turns - turns.round()).max(initial=0.0) < 1e-6
    assert np.unique(turns.round(), return_counts=True)[1].max(initial=0) <= 2
    assert len(circle.events("x = 1.001").t_events[0]) == 0
    found = hamsym.section(circle.H, [1.0, 0.0], (0, 300), "x = 1", dt=0.1)
    turns = found.t / (2 * np.pi)
    assert np.abs(turns - turns.round()).max(initial=0.0) < 1e-6


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-7])
@pytest.mark.parametrize("end", [40.0, -40.0])
def test_events_on_a_narrow_surface_are_found(width: float, end: float) -> None:
    """exp(-((x - 1/2)/w)**2) = 1/2 at two values of x next to 1/2."""
    H = harmonic_oscillator().H
    solution = hamsym.solve(H, [1.0, 0.0], (0, end), tol=1e-11)
    text = f"exp(-((x - 0.5)/{width})**2) = 0.5"
    beside = width * np.sqrt(np.log(2))
    levels = [np.arccos(0.5 + side) for side in (-beside, beside)]
    turns = 2 * np.pi * np.arange(8)
    expected = np.sort([t for a in levels for t in (*(turns + a), *(turns - a)) if 0 < t < 40])
    for found in (solution.events(text).t_events[0], hamsym.section(H, [1, 0], (0, end), text).t):
        np.testing.assert_allclose(np.abs(found), expected, atol=1e-7)


def test_every_zero_of_a_fast_formula_is_found(circle: hamsym.Solution) -> None:
    """sin(1000 x) = 0 where 1000 x is a multiple of pi: 637 times in a half turn."""
    found = circle.events("sin(1000*x) = 0").t_events[0]
    zeros = np.arccos(np.pi * np.arange(-318, 319) / 1000)
    expected = np.concatenate([zeros, 2 * np.pi - zeros])
    first = found[found < 2 * np.pi]
    np.testing.assert_allclose(first, np.sort(expected), atol=1e-8)


@pytest.mark.slow_cases("x**2 + p**2 = 1-more often than")
@pytest.mark.parametrize(
    ("text", "message"),
    [("x**2 = 0", "round-off at t = 1.57"), ("x**2 + p**2 = 1", "more often than")],
)
def test_undecided_events_are_named(circle: hamsym.Solution, text: str, message: str) -> None:
    with pytest.warns(EventWarning, match=message):
        circle.events(text)


@pytest.mark.slow
def test_undecided_crossings_of_a_section_are_named() -> None:
    H = harmonic_oscillator().H
    found = hamsym.section(H, [1.0, 0.0], (0, 20), "x**2 = 0")
    assert len(found.t) == 0
    assert "touched 6 times" in found.message
    found = hamsym.section(H, [1.0, 0.0], (0, 20), "(x**2 + p**2)*10**9 = 10**9")
    assert not found.success
    assert "more often" in found.message


def test_jumps_of_an_angle_are_not_events(circle: hamsym.Solution) -> None:
    """atan2(p, x) falls through 1 once in a turn, and jumps from -pi to pi."""
    found = circle.events("atan2(p, x) = 1").t_events[0]
    np.testing.assert_allclose(found, 2 * np.pi * np.arange(1, 48) - 1, atol=1e-7)


def test_events_far_from_the_origin_of_time() -> None:
    solution = hamsym.solve(harmonic_oscillator().H, [1.0, 0.0], (1e4, 1e4 + 60), tol=1e-9)
    found = solution.events("x = 0.9999").t_events[0]
    np.testing.assert_allclose(found, 1e4 + both_sides(0.9999, 60.0), atol=1e-6)


@pytest.mark.parametrize(
    ("event", "message"),
    [
        ("sqrt(x) = 1/2", "'sqrt.x. = 1/2' is not a number at t = 1.5"),
        (lambda t, z: np.nan, "an event is not a number at t = 0; give an event with a value"),
    ],
)
def test_nan_events_are_rejected(circle: hamsym.Solution, event: object, message: str) -> None:
    with pytest.raises(InputError, match=message):
        circle.events([event])  # type: ignore[list-item]


@pytest.mark.parametrize("direction", ["up", float("nan")])
def test_unusable_directions_are_rejected(circle: hamsym.Solution, direction: object) -> None:
    def event(t: float, z: np.ndarray) -> float:
        return z[0]

    event.direction = direction  # type: ignore[attr-defined]
    with pytest.raises(InputError, match="direction=.* cannot be used; give a number"):
        circle.events(event)


# -- where it could go wrong -------------------------------------------------------------------


def test_crossings_at_steps_are_found() -> None:
    """A stroboscopic section whose period is a whole number of steps."""
    H = driven_oscillator().H
    period = 2 * np.pi / H.parameters["Omega"]
    found = hamsym.section(H, [0.5, 0], (0, 200 * period), "sin(Omega*t/2) = 0", steps=200 * 64)
    assert len(found.t) >= 199
    np.testing.assert_allclose(found.t, period * np.arange(1, len(found.t) + 1), rtol=1e-12)
    assert np.isfinite(found.z).all()
    kept = hamsym.section(
        H, [0.5, 0], (0, 200 * period), "sin(Omega*t/2) = 0, p > -100", steps=200 * 64
    )
    np.testing.assert_array_equal(kept.t, found.t)


def test_poles_are_not_crossings(orbit: hamsym.Solution) -> None:
    problem = harmonic_oscillator()
    found = hamsym.section(problem.H, problem.z0, (0, 20), "tan(2*x) = 1", dt=0.01)
    assert len(found.t) == 19 - 13
    np.testing.assert_allclose(np.tan(2 * found.z[:, 0]), 1, atol=1e-12)
    assert len(hamsym.section(problem.H, problem.z0, (0, 20), "1/x = 0", dt=0.01).t) == 0
    assert len(orbit.events("1/y = 0").t_events[0]) == 0


def test_zero_at_start_is_not_an_event() -> None:
    problem = harmonic_oscillator()
    solution = hamsym.solve(problem.H, [0.0, 1.0], (0, 10), tol=1e-9)
    np.testing.assert_allclose(solution.events("x = 0").t_events[0], np.pi * np.arange(1, 4))
    found = hamsym.section(problem.H, [0.0, 1.0], (0, 10), "x = 0")
    np.testing.assert_allclose(found.t, np.pi * np.arange(1, 4), atol=1e-9)


def test_ctrl_c_keeps_earlier_crossings(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = harmonic_oscillator()
    full = hamsym.section(problem.H, problem.z0, (0, 100), "x = 0", dt=0.1)
    monkeypatch.setattr(crossings, "_HELD", 400)
    calls = []
    original = stepper.Stepper.step

    def interrupted(self: stepper.Stepper, count: int) -> np.ndarray:
        calls.append(1)
        if len(calls) > 30:  # in the midst of locating a crossing
            raise KeyboardInterrupt
        return original(self, count)

    monkeypatch.setattr(stepper.Stepper, "step", interrupted)
    found = hamsym.section(problem.H, problem.z0, (0, 100), "x = 0", dt=0.1)
    assert not found.success
    assert found.message.endswith("interrupted")
    assert 0 < len(found.t) < len(full.t)
    np.testing.assert_array_equal(found.t, full.t[: len(found.t)])


def test_numpy_numbers_are_accepted() -> None:
    problem = harmonic_oscillator()
    found = hamsym.section(problem.H, problem.z0, (0, 50), "x = 0", crossings=np.int64(2))
    assert len(found.t) == 2
    solution = hamsym.solve(problem.H, problem.z0, (0, 20), tol=1e-6)

    def event(t: float, z: np.ndarray) -> float:
        return z[0]

    event.terminal = np.int64(2)  # type: ignore[attr-defined]
    assert len(solution.events(event).t_events[0]) == 2
    event.terminal = np.True_  # type: ignore[attr-defined]
    assert len(solution.events(event).t_events[0]) == 1
    with pytest.raises(InputError, match="direction='up'"):
        hamsym.section(problem.H, problem.z0, (0, 50), "x = 0", direction="up")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="would take .* steps; give a larger one"):
        hamsym.section(problem.H, problem.z0, (0, 50), "x = 0", dt=1e-300)


@pytest.mark.parametrize(("method", "steps"), [("blanes_moan6", None), (None, 2_000)])
def test_given_steps_do_not_pass_over_crossings_inside_a_spike(
    method: str | None, steps: int | None
) -> None:
    """Four crossings are inside the spike, which changes the motion after it by 1e-10."""
    H = "p**2/2 + x**2/2 + 1e-4*exp(-((x - 0.3)/1e-6)**2)"
    surface = "p**2 + x**2 = 0.9999"
    found = hamsym.section(H, [1, 0], (0, 6), surface, method=method, steps=steps)
    assert not found.success
    assert "feature" in found.message


def test_given_steps_resolve_a_driven_motion() -> None:
    H = Hamiltonian("p**2/2 - (1 + sin(t)/2)*cos(x)")
    exact = hamsym.solve(H, [1.0, 0.2], (0, 20)).events("x = 0").t_events[0]
    for method, coarse, fine, error in (
        ("stormer_verlet", 0.3, 0.1, 0.02),  # errors of 0.1 and 0.011
        ("symplectic_euler", 0.1, 0.005, 0.01),
        ("blanes_moan6", 0.9, 0.3, 1e-6),
    ):
        found = hamsym.section(H, [1.0, 0.2], (0, 20), "x = 0", method=method, dt=coarse)
        assert not found.success
        assert "the motion has rates up to" in found.message
        found = hamsym.section(H, [1.0, 0.2], (0, 20), "x = 0", method=method, dt=fine)
        assert found.success
        assert np.abs(found.t - exact).max() < error
