"""Checks of marched windows at places that the march did not use."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian
from hamsym.bounds import residual
from hamsym.bounds.residual import largest_ratios
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import march
from hamsym.random_features.window_checks import WindowChecks, Windows

KICK = "p**2/2 + x*exp(-1e6*(t - 3.37)**2)"


def test_kick_from_the_formula_has_its_impulse() -> None:
    solution = hamsym.solve(KICK, [1.0, 0.5], (0, 20), tol=1e-9)
    assert solution.success, solution.message
    impulse = -math.sqrt(math.pi) / 1e3
    assert solution(20.0)[1] == pytest.approx(0.5 + impulse, abs=1e-9)
    assert solution(20.0)[0] == pytest.approx(1.0 + 10.0 + impulse * (20 - 3.37), abs=1e-8)


def test_kick_is_missed_without_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shows that the previous test depends on the check."""
    monkeypatch.setattr(WindowChecks, "_unbounded", lambda *_: np.empty(0, int))
    flow = flow_of(Hamiltonian(KICK))
    windows = march(flow, np.array([1.0, 0.5]), (0.0, 20.0), 1e-10, feature_basis(0), longest=2.5)
    assert windows.states[-1, 1] == pytest.approx(0.5, abs=1e-12)


@pytest.mark.parametrize("away", [1e-4, 1e-8, 1e-10])
def test_round_off_of_the_force_is_not_hidden_between_places(away: float) -> None:
    # sin(x) has the round-off of x, which is large beside a motion near the saddle.
    flow, basis = flow_of(Hamiltonian("p**2/2 - cos(x)")), feature_basis(0)
    windows = march(flow, np.array([math.pi - away, 0.0]), (0.0, 2.0), 1e-13, basis, longest=0.25)
    rows = Windows(windows.edges, windows.states, windows.readouts)
    sizes = np.array([math.pi, 4 * away])
    assert WindowChecks(flow, basis, 1e-13).kicks(rows, sizes, 24) is None


def test_energy_check_finds_hidden_step(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(WindowChecks, "_unbounded", lambda *_: np.empty(0, int))
    H = Hamiltonian("p**2/2 + x**2/2 + tanh(100000*(x - 1/3))/20")
    flow = flow_of(H)
    windows = march(flow, np.array([1.0, 0.0]), (0.0, 6.0), 1e-9, feature_basis(0), longest=0.75)
    energies = flow.energy(windows.states, windows.edges)
    assert not windows.doubt
    np.testing.assert_allclose(energies, energies[0], atol=1e-8)
    unseeing = dataclasses.replace(flow, energy=None)
    windows = march(
        unseeing, np.array([1.0, 0.0]), (0.0, 6.0), 1e-9, feature_basis(0), longest=0.75
    )
    energies = flow.energy(windows.states, windows.edges)
    assert np.ptp(energies) > 0.05
    checks = WindowChecks(flow, feature_basis(0), 1e-9)
    crossed = int(np.argmax(np.abs(np.diff(energies)) > 0.05))
    parts = Windows(windows.edges, windows.states, windows.readouts)
    assert checks._energy_jump(parts, crossed) == pytest.approx(math.acos(1 / 3), abs=1e-3)


def test_round_off_of_a_rest_energy_is_no_jump() -> None:
    """Of an electron in a trap: H rounds to 2e-8 of the energy of the motion."""
    values = {"c": 299792458.0, "m": 9.1e-31, "k": 1e-9}
    H = Hamiltonian("c*sqrt(m**2*c**2 + p**2) - m*c**2 + k*x**2/2", parameters=values)
    solution = hamsym.solve(H, [1e-6, 0.0], (0, 1e-9))
    assert solution.success, solution.message
    period = 2 * math.pi * math.sqrt(values["m"] / values["k"])
    assert solution(period)[0] == pytest.approx(1e-6, rel=1e-9)


@pytest.mark.parametrize("sign", [1, -1])
def test_step_far_along_a_free_flight(sign: int) -> None:
    """A scatterer of size 1 after a flight of 5,000, forwards and backwards in time."""
    H = Hamiltonian("p**2/2 + tanh(3*(x - 5000))/4")
    solution = hamsym.solve(H, [0.0, sign * 1.0], (0, sign * 5010), tol=1e-9)
    assert solution.success, solution.message
    # The energy 1/2 - 1/4 is kept; behind the step the potential is 1/4.
    assert solution(sign * 5010.0)[1] == pytest.approx(0.0, abs=0.1)
    assert abs(solution.energy(sign * 5010.0) - 0.25) < 1e-8


@pytest.mark.parametrize(
    ("pulse", "impulse"),
    [
        ("exp(-(10000*(t - 3.37))**4)", 2 * math.gamma(1.25) / 1e4),
        ("sech(1000000*(t - 3.37)**3 + 1000*(t - 3.37))", None),
        ("exp(-1e10*sin(5*t)**2)", 6 * math.sqrt(math.pi) / 5e5),
    ],
)
def test_pulses_of_any_shape_are_found(pulse: str, impulse: float | None) -> None:
    """With a multiple zero in the argument, two scales in one, and many in a window."""
    solution = hamsym.solve(f"p**2/2 + x*{pulse}", [0.0, 1.0], (0.3, 4.0), tol=1e-9)
    assert solution.success, solution.message
    if impulse is None:
        t = np.linspace(-0.1, 0.1, 2_000_001)
        impulse = float(np.trapezoid(1 / np.cosh(np.clip(1e6 * t**3 + 1e3 * t, -300, 300)), t))
    assert solution(4.0)[1] == pytest.approx(1 - impulse, abs=1e-8)


def test_turning_point_on_a_bump_is_resolved() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + exp(-1e16*(x - 1)**2)/1e9")
    solution = hamsym.solve(H, [0.0, 1.0], (0, 6), tol=1e-9)
    finer = hamsym.solve(H, [0.0, 1.0], (0, 6), tol=1e-11, method=hamsym.Features(max_window=0.01))
    assert solution.success, solution.message
    t = np.linspace(0, 6, 601)
    np.testing.assert_allclose(solution(t), finer(t), atol=2e-9)
    assert abs(finer(6.0)[0] - math.sin(6.0)) > 1e-7


def test_checks_find_shifted_windows_only() -> None:
    H = Hamiltonian("p**2/2 - cos(x)")
    flow, basis = flow_of(H), feature_basis(0)
    marched = march(flow, np.array([1.0, 0.5]), (0.0, 30.0), 1e-10, basis, longest=3.0)
    windows = Windows(marched.edges, marched.states, marched.readouts)
    checks = WindowChecks(flow, basis, 1e-10)
    assert checks.first_failure(windows, marched.scale) is None
    windows.readouts[4] *= 1 + 1e-6
    failure = checks.first_failure(windows, marched.scale)
    assert failure is not None
    assert failure.window == 4
    assert all(marched.edges[4] <= t <= marched.edges[5] for t in failure.times)
    windows.readouts[4] = np.nan
    failure = checks.first_failure(windows, marched.scale)
    assert failure is not None
    assert failure.window == 4


def test_limit_of_the_energy_is_independent_of_units() -> None:
    flow, basis, length = flow_of(Hamiltonian("p**2/2 - cos(x)")), feature_basis(0), 2.0**20
    marched = march(flow, np.array([1.0, 0.5]), (0.0, 10.0), 1e-10, basis, longest=3.0)
    scaled = flow_of(Hamiltonian("(l*p)**2/2 - cos(x/l)", parameters={"l": length}))
    found = []
    for field, units in ((flow, np.ones(2)), (scaled, np.array([length, 1 / length]))):
        windows = Windows(marched.edges, marched.states * units, marched.readouts * units)
        windows.states[3] *= 1 + 1e-6
        checks = WindowChecks(field, basis, 1e-10)
        found.append(checks._energy_changes(windows, marched.scale * units)[2:4])
    assert (found[0] > 1).all()
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


def test_nan_exceeds_every_bound() -> None:
    values = np.array([[0.0, 0.0], [np.nan, 0.0], [np.inf, 0.0], [1.0, 1.0]])
    excess = largest_ratios(values, np.array([[1.0, 0.0], [1.0, 1.0], [1.0, 1.0], [2.0, np.nan]]))
    assert excess[0] == 0
    assert np.isinf(excess[1:]).sum() == 0 or (excess[1:3] > 1e300).all()
    assert not excess[3] <= 1


@pytest.mark.slow_cases(
    "(px**2 + py**2)/2 + sqrt((x**2 + y**2 - 1)**2) + x/3-z02",
    "sqrt(x**4 - 2*x**2 + 1) + p**2/2-z00",
)
@pytest.mark.parametrize(
    ("formula", "z0"),
    [
        ("sqrt(x**4 - 2*x**2 + 1) + p**2/2", [0.3, 1.2]),
        ("sqrt((x - 1)**2) + p**2/2", [0.3, 1.2]),
        ("(px**2 + py**2)/2 + sqrt((x**2 + y**2 - 1)**2) + x/3", [0.3, 1.2, 0.1, 0.0]),
    ],
)
def test_hidden_kinks_fail(formula: str, z0: list[float]) -> None:
    solution = hamsym.solve(formula, z0, (0, 10), tol=1e-5)
    assert not solution.success
    assert "t = " in solution.message


def test_windows_end_where_a_force_is_switched() -> None:
    H = Hamiltonian("p**2/2 + x*sign(sin(3*t))")
    solution = hamsym.solve(H, [1.0, 0.0], (0.5, 6), tol=1e-6)
    assert solution.success
    stops = [k * math.pi / 3 for k in range(1, 6)]
    edges = solution.record.edges
    assert edges is not None
    assert max(np.abs(edges - stop).min() for stop in stops) < 1e-15
    given = hamsym.solve(H, [1.0, 0.0], (0.5, 6), tol=1e-6, breakpoints=stops)
    assert np.abs(given(6.0) - solution(6.0)).max() < 1e-12


@pytest.mark.parametrize(
    ("pulse", "impulse"),
    [
        ("max(0, 1 - 1e5*abs(t - 3.37))", 1e-5),
        ("max(0, 1 - 1e10*(t - 3.37)**2)", 4e-5 / 3),
        ("(sign(t - 3.37) - sign(t - 3.3701))/2", 1e-4),
    ],
)
def test_pulses_with_kinks_are_found(pulse: str, impulse: float) -> None:
    solution = hamsym.solve(f"p**2/2 + x*{pulse}", [0.0, 1.0], (0, 20), tol=1e-7)
    assert not solution.success or solution(20.0)[1] == pytest.approx(1 - impulse, abs=1e-7)
    assert solution.success or "jumps" in solution.message


def test_small_step_of_a_large_potential_is_a_jump() -> None:
    H = Hamiltonian("p**2/2 + 1000 + sign(x - 0.3)/10000 + x*sin(t)/10")
    solution = hamsym.solve(H, [1.0, -1.0], (0, 5), tol=1e-6)
    assert not solution.success
    assert "H jumps at t = 0.69" in solution.message


@pytest.mark.slow_cases("1e-20/(x - 1)**2-z00", "1e-20/sin(x)**2-z06", "1e-20*tan(x)**2-z01")
@pytest.mark.parametrize(
    ("wall", "z0"),
    [
        ("1e-20/(x - 1)**2", [0.0, 1.0]),
        ("1e-20*tan(x)**2", [0.0, 1.0]),
        ("1e-14*sec(x)", [0.0, 1.0]),
        ("-1e-9*log((x - 1)**2)", [0.0, 1.0]),
        ("1e-20/x", [1.0, -1.0]),
        ("-1e-20/x", [1.0, -1.0]),
        ("1e-20/sin(x)**2", [1.0, -1.0]),
    ],
)
def test_poles_are_not_tunnelled_through(wall: str, z0: list[float]) -> None:
    solution = hamsym.solve(f"p**2/2 + {wall}", z0, (0, 3), tol=1e-6)
    # A wall reflects: the momentum changes its sign and keeps its size.
    assert not solution.success or solution(3.0)[1] == pytest.approx(-z0[1], abs=1e-5)


@pytest.mark.slow_cases("(cos(t - 3.37)**2)**m-0.0001772453850905516")
@pytest.mark.parametrize(
    ("pulse", "impulse"),
    [
        ("2**(-1e8*(t - 3.37)**2)", math.sqrt(math.pi / math.log(2)) / 1e4),
        ("(1 + w*(t - 3.37)**2)**(-n)", 0.396 / 1e4),
        ("(cos(t - 3.37)**2)**m", math.sqrt(math.pi) / 1e4),
    ],
)
def test_powers_that_are_pulses_are_found(pulse: str, impulse: float) -> None:
    values = {"w": 1e8, "n": 20.0, "m": 1e8}
    used = {name: value for name, value in values.items() if name in pulse.replace("cos", "")}
    H = Hamiltonian(f"p**2/2 + x*{pulse}", parameters=used)
    solution = hamsym.solve(H, [0.0, 1.0], (0.5, 5.0), tol=1e-8)
    if "m" in used and not solution.success:
        # A power of 2e8 has round-off of 1e-8 of its size, near the tolerance: it may be refused.
        assert "t = 3.36" in solution.message or "t = 3.37" in solution.message
        return
    assert solution.success, solution.message
    if "w" in used:
        t = np.linspace(-3e-3, 3e-3, 400_001)
        impulse = float(np.trapezoid((1 + 1e8 * t**2) ** -20.0, t))
    assert solution(5.0)[1] == pytest.approx(1 - impulse, abs=2e-8)


@pytest.mark.parametrize(("place", "stops"), [(1e-5, []), (3.37001, [3.37]), (9.999995, [])])
def test_pulses_beside_the_ends_of_windows_are_found(place: float, stops: list[float]) -> None:
    H = Hamiltonian(f"p**2/2 + 100*x*exp(-1e14*(t - {place})**2)")
    solution = hamsym.solve(H, [0.0, 1.0], (0, 10), tol=1e-8, breakpoints=stops)
    assert solution.success, solution.message
    assert solution(10.0)[1] == pytest.approx(1 - math.sqrt(math.pi) / 1e5, abs=2e-8)


@pytest.mark.slow_cases("5307-0.0299-places1")
@pytest.mark.parametrize(
    ("steepness", "push", "places"),
    [
        (338, 0.00191, [1.35, 3.2, 6.72, 8.32, 9.35, 13.14]),
        (5307, 0.0299, [1.7, 1.83, 4.38, 6.45, 15.14, 15.2]),
    ],
)
def test_small_pulses_do_not_add_up(steepness: float, push: float, places: list[float]) -> None:
    """Each changes the momentum by a third of the tolerance, and the coordinate for long."""
    tol = 1e-4
    pulses = "+".join(f"exp(-({steepness}*(t - {place}))**2)" for place in places)
    solution = hamsym.solve(f"p**2/2 + {push}*x*({pulses})", [0.0, 0.3], (0, 20), tol=tol)
    assert solution.success, solution.message
    impulse = push * math.sqrt(math.pi) / steepness
    exact = [6 - impulse * sum(20 - place for place in places), 0.3 - 6 * impulse]
    assert (np.abs(solution(20.0) - exact) <= tol * np.array([6.0, 0.3])).all()


def test_infinite_limit_allows_nothing() -> None:
    values, allowed = np.array([[1.0, 0.0], [1.0, 1.0]]), np.array([[np.inf, 1.0], [2.0, 4.0]])
    np.testing.assert_array_equal(largest_ratios(values, allowed), [np.inf, 0.5])


def test_infinite_round_off_hides_no_residual(monkeypatch: pytest.MonkeyPatch) -> None:
    flow, basis = flow_of(Hamiltonian("p**2/2 - cos(x)")), feature_basis(0)
    windows = march(flow, np.array([1.0, 0.0]), (0.0, 3.0), 1e-9, basis, longest=1.0)
    checks = WindowChecks(flow, basis, 1e-9)
    # Readouts that do not fit the equations.
    wrong = Windows(windows.edges, windows.states, 1.01 * windows.readouts)
    monkeypatch.setattr(residual, "_round_off", lambda *given: np.full((len(given[2]), 2), np.inf))
    assert checks.first_failure(wrong, windows.scale) is not None


@pytest.mark.parametrize("width", [1e-4, 1e-6])
def test_pulse_within_the_local_tolerance_counts_as_much_as_it_grows(width: float) -> None:
    # beside the upper equilibrium of a pendulum, where what is small grows a thousand times
    tol, at, end = 1e-9, 1.0345678, 10.0
    push = 0.3 * tol
    pulse = f"x*{push / (width * math.sqrt(math.pi))!r}*exp(-((t - {at})/{width})**2)"
    start = [math.pi - 1e-4, 0.0]
    solution = hamsym.solve(f"p**2/2 - cos(x) + {pulse}", start, (0, end), tol=tol)
    free = Hamiltonian("p**2/2 - cos(x)")
    before = hamsym.solve(free, start, (0, at), tol=1e-12)(at)
    truth = hamsym.solve(free, before - np.array([0, push]), (at, end), tol=1e-12)(end)
    assert solution.success
    assert (np.abs(solution(end) - truth) <= 0.2 * solution.allowed_error).all()
    many = hamsym.solve_many(solution.H, [start], (0, end), tol=tol)
    assert (np.abs(many[0](end) - truth) <= 0.2 * solution.allowed_error).all()


def test_sizes_behind_a_barrier_that_was_passed_are_forgotten() -> None:
    barrier = "exp(-((x - 1)/0.0001)**2)"
    fall = "100*(sqrt((x - 1.3)**2 + 0.000001) + x - 1.3)/2"
    solution = hamsym.solve(f"p**2/2 + {barrier} + 0.1*x**2 - {fall}", [0.2, 0.9], (0, 4), tol=1e-7)
    assert solution.success
    assert (solution.error.scale < [2.1, 1.0]).all()
