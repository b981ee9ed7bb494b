"""Order, symplecticity, tangent maps and agreement with known figures, for every integrator."""

from __future__ import annotations

import functools
import itertools
import math
import signal
import warnings
from collections.abc import Iterator

import numpy as np
import pytest
import scipy.optimize

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import SeparabilityError, StepSizeWarning
from hamsym.integrators import adaptive, stepper
from hamsym.integrators.adaptive import reference
from hamsym.integrators.coefficients import Doubled, Splitting
from hamsym.integrators.energy_drift import EnergyDrift
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import ALIASES, INTEGRATORS, listing
from hamsym.systems import (
    CATALOGUE,
    Problem,
    charged_particle,
    double_pendulum,
    nonlinear_oscillator,
)

# Many of these tests take steps that are too long.
pytestmark = pytest.mark.filterwarnings("ignore::hamsym.errors.StepSizeWarning")

FIXED = [name for name, row in INTEGRATORS.items() if not row.adaptive]
ADAPTIVE = [name for name, row in INTEGRATORS.items() if row.adaptive]
SYMPLECTIC = [name for name, row in INTEGRATORS.items() if row.symplectic]
ANY_H = [
    name
    for name in FIXED
    if name.startswith("symplectic_euler") or not isinstance(INTEGRATORS[name].scheme, Splitting)
]
# Compiling a loop for a Hamiltonian takes seconds, so the tests share these two.
#
# Explicit time in both halves. From (1, 0.3) the motion is bounded, from (2, 4) it escapes to
# infinity.
TIMED = Hamiltonian("p**2*(1 + sin(t)/2)/2 + x**2*(1 + cos(2*t)/3)/2 - x**4/20")
# An equilibrium near (1.4, 0, -0.16, 0) and, beyond a barrier near t_ = -1.4, escape to infinity.
# The names are also names of the kernels and loops. a, b and d are the units of t_, its momentum
# and y.
NONSEPARABLE = Hamiltonian(
    "a*b*((momenta/b)**2*(1 + (t_/a)**2)/2 + (t_/a)**3/3 - 2*(t_/a) + (t_/a)*(momenta/b)/3"
    "+ (h*d/a/b)**2*(2 + cos(t_/a - y/d))/4 + k*(y/d)**2/2)",
    q=["t_", "y"],
    p=["momenta", "h"],
    parameters={"a": 1.0, "b": 1.0, "d": 1.0, "k": 1.0},
)
BOUNDED, ESCAPING = (1.0, -0.5, 0.5, 0.3), (-1.6, 0.1, -0.2, 0.1)


# An equilibrium at x = sqrt(2), y = 1/2^(1/3), and a pole at y = 0, attracting from below.
POLE = Hamiltonian("(p_x**2 + p_y**2)/2 + x**3/3 - 2*x + 1/y + y**2")


def timed() -> Problem:
    return Problem("timed", TIMED, (1.0, 0.3), (0.0, 3.0), "")


def nonseparable() -> Problem:
    return Problem("nonseparable", NONSEPARABLE, BOUNDED, (0.0, 10.0), "")


PROBLEMS = {**CATALOGUE, "timed": timed, "nonseparable": nonseparable}
# Every loop on separable, time-dependent and non-separable systems (the last with a linear and with
# a nonlinear implicit half).
LOOPS = [
    ("henon_heiles", "symplectic_euler"),
    ("henon_heiles", "blanes_moan6"),
    ("timed", "ruth3"),
    ("timed", "gauss4"),
    ("timed", "tao2"),
    ("charged_particle", "symplectic_euler"),
    ("nonseparable", "symplectic_euler"),
    ("nonseparable", "symplectic_euler_p"),
    ("nonseparable", "gauss6"),
    ("nonseparable", "tao4"),
]


@functools.cache
def truth(system: str):
    problem = PROBLEMS[system]()
    return problem.exact or reference(problem.H, np.array(problem.z0), problem.span)


def error(system: str, method: str, steps: int) -> float:
    problem = PROBLEMS[system]()
    every = max(1, steps // 1000)
    steps = -(-steps // every) * every
    found = hamsym.integrate(
        problem.H, problem.z0, problem.span, method, steps=steps, save_every=every
    )
    return float(np.abs(found.z - truth(system)(found.t)).max()) if found.success else np.inf


# -- order -------------------------------------------------------------------------------------


def slope_of_errors(system: str, method: str) -> float:
    """Observed order, from halving the step where errors are small but above round-off."""
    order = INTEGRATORS[method].order
    coarse, steps = np.inf, 4_000 if order == 1 else 400 if order < 8 else 20
    while coarse > (1e-4 if order < 8 else 1e-6) and steps < 40_000:
        coarse, steps = error(system, method, steps), 2 * steps
    return float(np.log2(coarse / error(system, method, steps)))


@pytest.mark.parametrize("method", FIXED)
def test_halving_the_step_shows_the_order(method: str) -> None:
    order = INTEGRATORS[method].order
    found = slope_of_errors("nonlinear_oscillator", method)
    # Beyond order 8 round-off is near; that the order is not higher follows from coefficients.
    assert order - 0.3 <= found <= order + (0.3 if order <= 8 else 2.0)


@pytest.mark.slow_cases("symplectic_euler", "tao4")
@pytest.mark.parametrize("method", ["symplectic_euler", "symplectic_euler_p", "gauss4", "tao4"])
def test_order_without_separability(method: str) -> None:
    assert slope_of_errors("nonseparable", method) > INTEGRATORS[method].order - 0.3


@pytest.mark.slow
def test_explicit_time_in_both_halves_keeps_the_order() -> None:
    """Kicks take the time of the drifts, and drifts that of the kicks."""
    exact = reference(TIMED, np.array([1.0, 0.3]), (0.0, 3.0))(np.array([3.0]))[0]
    for method in FIXED:
        order = INTEGRATORS[method].order
        steps = 1000 if order < 3 else 60 if order < 8 else 30
        errors = [
            np.abs(hamsym.integrate(TIMED, [1.0, 0.3], (0, 3), method, steps=n).z[-1] - exact).max()
            for n in (steps, 2 * steps)
        ]
        assert errors[1] < 1e-11 or np.log2(errors[0] / errors[1]) > order - 0.4, method


@pytest.mark.parametrize("method", ADAPTIVE)
@pytest.mark.parametrize("system", ["driven_oscillator", "kepler", "double_pendulum"])
def test_adaptive_methods_are_accurate(system: str, method: str) -> None:
    problem = CATALOGUE[system]()
    trajectory = hamsym.integrate(problem.H, problem.z0, (0, 5), method, steps=100)
    assert trajectory.success
    assert trajectory.evaluations > 100
    right = problem.exact or reference(problem.H, problem.z0, (0.0, 5.0))
    assert np.abs(trajectory.z - right(trajectory.t)).max() < 1e-8


# -- geometry ----------------------------------------------------------------------------------


def step_map(problem: Problem, method: str, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Start of one generated step and its derivative, in the method's phase space."""
    dim = problem.H.dim
    width = 2 * dim if isinstance(INTEGRATORS[method].scheme, Doubled) else dim
    z0 = np.array(problem.z0) + 0.05 * np.arange(dim)
    stepper = Stepper(
        problem.H,
        method,
        z0[None],
        np.array([0.2]),
        np.array([h]),
        omega=3.0 if width > dim else None,
        tangents=np.eye(width)[None],
    )
    stepper.advance(1)
    return z0, stepper.tangents[0]


@pytest.mark.slow_cases("timed-gauss4", "timed-tao2", "nonseparable-tao4")
@pytest.mark.parametrize(("system", "method"), LOOPS)
def test_tangent_map_is_symplectic_and_the_derivative(system: str, method: str) -> None:
    problem = PROBLEMS[system]()
    z0, M = step_map(problem, method, 0.1)
    J = np.array(problem.H.poisson_matrix, dtype=float)
    copies = len(M) // len(J)  # the doubled phase space has two pairs of coordinates and momenta
    J = np.kron(np.eye(copies), J)
    assert np.abs(M.T @ J @ M - J).max() <= 1e-12 * max(1, np.linalg.norm(M, 2) ** 2)
    # A first-order tangent map (explicit Euler) is far from symplectic.
    hessian = problem.H.compile("numpy").hessian
    time = (0.2,) if problem.H.time is not None else ()
    explicit = np.eye(len(J)) + 0.1 * J @ np.kron(np.eye(copies), hessian(problem.z0, *time))
    assert np.abs(explicit.T @ J @ explicit - J).max() > 1e-4
    dim = problem.H.dim
    options = {}
    if len(M) > dim:  # a perturbed start is copied
        M, options = M[:dim] @ np.tile(np.eye(dim), (2, 1)), {"omega": 3.0}

    def step(z: np.ndarray) -> np.ndarray:
        return hamsym.integrate(problem.H, z, (0.2, 0.3), method, steps=1, **options).z[-1]

    h = 1e-3
    columns = [
        8 * (step(z0 + h * d) - step(z0 - h * d)) - step(z0 + 2 * h * d) + step(z0 - 2 * h * d)
        for d in np.eye(dim)
    ]
    np.testing.assert_allclose(M, np.array(columns).T / (12 * h), rtol=0, atol=1e-8)


@pytest.mark.parametrize(("system", "method"), LOOPS)
def test_symmetric_methods_return_to_the_start(system: str, method: str) -> None:
    problem = PROBLEMS[system]()
    start = np.array([problem.z0])
    stepper = Stepper(problem.H, method, start, np.array([0.0]), np.array([0.05]))
    stepper.advance(1, 100)
    moved = np.abs(stepper.states - start).max()
    # Back in time, also with the second copy of a doubled phase space.
    stepper._starts, stepper._sizes = stepper._starts + 100 * stepper._sizes, -stepper._sizes
    stepper._first = 0
    stepper.advance(1, 100)
    back = np.abs(stepper.states - start).max()
    assert moved > 0.1
    if INTEGRATORS[method].scheme.is_symmetric:
        assert back < 1e-12
    elif system != "charged_particle":  # there symplectic Euler is of second order
        assert back > 1e-8


@pytest.mark.slow_cases("implicit_midpoint")
@pytest.mark.parametrize(
    "method", ["symplectic_euler", "stormer_verlet", "blanes_moan6", "implicit_midpoint"]
)
def test_energy_does_not_drift_in_a_million_steps(method: str) -> None:
    problem = nonlinear_oscillator()
    trajectory = hamsym.integrate(
        problem.H, problem.z0, (0, 1e5), method, dt=0.1, save_every=50, compensated=True
    )
    assert trajectory.steps == 1_000_000
    change = trajectory.energy - trajectory.energy[0]
    first, last = change[: len(change) // 10], change[-len(change) // 10 :]
    size = np.abs(first).max()
    assert abs(last.mean() - first.mean()) < 0.02 * size + 1e-14
    assert np.abs(last).max() < 1.2 * size + 1e-14


@pytest.mark.slow
def test_dop853_energy_drifts() -> None:
    """DOP853 fails the criterion of the test above."""
    problem = nonlinear_oscillator()
    trajectory = hamsym.integrate(
        problem.H, problem.z0, (0, 2e3), "dop853", steps=2000, rtol=1e-5, atol=1e-5
    )
    change = trajectory.energy - trajectory.energy[0]
    first, last = change[:200], change[-200:]
    assert abs(last.mean() - first.mean()) > 0.5 * np.abs(first).max()


def test_compensated_summation_keeps_round_off_small() -> None:
    problem = nonlinear_oscillator()
    spread = []
    for compensated in (False, True):
        trajectory = hamsym.integrate(
            problem.H,
            problem.z0,
            (0, 1e4),
            "blanes_moan6",
            dt=0.01,
            save_every=1000,
            compensated=compensated,
        )
        spread.append(np.abs(trajectory.energy - trajectory.energy[0]).max())
    assert spread[1] < 6e-15
    assert spread[1] < 0.05 * spread[0]


# -- single methods ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("steps", "within"), [(2_000, 0.02), (4_000, 0.02), (5_000, 0.01), (20_000, 0.01)]
)
def test_symplectic_euler_on_the_papers_oscillator(steps: int, within: float) -> None:
    """max |delta z| times steps is 119.4, by independent computation."""
    problem = nonlinear_oscillator()
    trajectory = hamsym.integrate(
        problem.H, problem.z0, problem.span, "symplectic_euler", steps=steps
    )
    distance = np.linalg.norm(trajectory.z - problem.exact(trajectory.t), axis=1).max()
    assert distance * steps == pytest.approx(119.4, rel=within)


def test_symplectic_euler_matches_the_papers_formula() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    h, (x, p) = 0.1, (1.3, 1.0)
    first = hamsym.integrate(H, (x, p), (0, h), "symplectic_euler", steps=1).z[-1]
    x1 = x + h * p
    np.testing.assert_allclose(first, [x1, p - h * (x1 + x1**3)], rtol=1e-15)
    other = hamsym.integrate(H, (x, p), (0, h), "symplectic_euler_p", steps=1).z[-1]
    p1 = p - h * (x + x**3)
    np.testing.assert_allclose(other, [x + h * p1, p1], rtol=1e-15)


@pytest.mark.slow_cases("charged_particle")
@pytest.mark.parametrize("make", [charged_particle, nonseparable])
def test_implicit_steps_satisfy_their_equations(make: object) -> None:
    problem = make()  # type: ignore[operator]
    H, d, h = problem.H, problem.H.dof, 0.05
    gradient = H.compile("numpy").gradient
    z0 = np.array(problem.z0) + 0.1
    for method, q_first in (("symplectic_euler", True), ("symplectic_euler_p", False)):
        z1 = hamsym.integrate(H, z0, (0, h), method, steps=1).z[-1]
        mixed = np.concatenate((z1[:d], z0[d:]) if q_first else (z0[:d], z1[d:]))
        slope = gradient(mixed)
        np.testing.assert_allclose(z1[:d], z0[:d] + h * slope[d:], atol=1e-15)
        np.testing.assert_allclose(z1[d:], z0[d:] - h * slope[:d], atol=1e-15)
    middle = hamsym.integrate(H, z0, (0, h), "implicit_midpoint", steps=1).z[-1]
    slope = H.compile("numpy").vector_field((z0 + middle) / 2)
    np.testing.assert_allclose(middle, z0 + h * slope, atol=1e-15)


@pytest.mark.slow_cases("implicit_midpoint")
@pytest.mark.parametrize("method", ["implicit_midpoint", "gauss4", "gauss6"])
def test_gauss_methods_work_in_any_units(method: str) -> None:
    """Coordinates of 1e12 and momenta of 1e-9, which one absolute tolerance cannot resolve."""
    a, b = 1e12, 1e-9
    H = NONSEPARABLE.with_parameters(a=a, b=b, d=a)
    units = np.array([a, a, b, b])
    plain = hamsym.integrate(NONSEPARABLE, BOUNDED, (0, 10), method, steps=100).z
    scaled = hamsym.integrate(H, BOUNDED * units, (0, 10), method, steps=100).z
    np.testing.assert_allclose(scaled / units, plain, atol=1e-12)


@pytest.mark.parametrize("units", [(1.0, 2.0**10, 2.0**-60), (2.0**-60, 2.0**-60, 2.0**60)])
@pytest.mark.parametrize("method", ["gauss4", "gauss6", "symplectic_euler"])
def test_coordinates_of_implicit_methods_have_units_of_their_own(
    method: str, units: tuple[float, float, float]
) -> None:
    """Of fast motion along y, whose stages Newton's method finds."""
    plain, scaled = (
        hamsym.integrate(
            NONSEPARABLE.with_parameters(a=a, b=b, d=d, k=400.0),
            np.array([1.0, -0.05, 0.5, 0.3]) * [a, d, b, a * b / d],
            (0, 5),
            method,
            steps=100,
        ).z
        / [a, d, b, a * b / d]
        for a, b, d in ((1.0, 1.0, 1.0), units)
    )
    np.testing.assert_allclose(scaled, plain, atol=1e-12)


def test_unsolvable_step_keeps_earlier_states() -> None:
    # Towards the escape to infinity the equations of a step have no real solution.
    for method in ("symplectic_euler", "gauss4"):
        trajectory = hamsym.integrate(NONSEPARABLE, ESCAPING, (0, 2), method, steps=20)
        assert not trajectory.success
        assert "could not be solved; take more steps" in trajectory.message
        assert 1 < len(trajectory.t) < 21
        assert np.all(np.isfinite(trajectory.z))


@pytest.mark.slow_cases("odeint")
@pytest.mark.parametrize("method", ["yoshida8", "gauss6", "tao2", *ADAPTIVE])
def test_escape_to_infinity_is_reported(method: str) -> None:
    trajectory = hamsym.integrate(TIMED, [2.0, 4.0], (0, 5), method, steps=1000)
    assert not trajectory.success
    assert "stopped after t = " in trajectory.message
    assert np.all(np.isfinite(trajectory.z))
    assert len(trajectory.t) == len(trajectory.z) == len(trajectory.energy) < 1001


@pytest.mark.parametrize("method", [*FIXED, *ADAPTIVE])
def test_time_runs_backward(method: str) -> None:
    exact = truth("timed")
    z = hamsym.integrate(TIMED, exact(np.array([3.0]))[0], (3, 0), method, steps=3_000).z
    right = exact(np.linspace(3, 0, 3_001))
    assert np.abs(z - right).max() < 5e-3


def test_potential_is_evaluated_at_drift_times() -> None:
    H = Hamiltonian("p**2/2 + x*t")
    z = hamsym.integrate(H, [0, 0], (1.0, 1.5), "symplectic_euler", steps=1).z[-1]
    assert z.tolist() == [0.0, -0.5 * 1.5]
    z = hamsym.integrate(H, [0, 0], (1.0, 1.5), "symplectic_euler_p", steps=1).z[-1]
    assert z.tolist() == [-0.25, -0.5]


# -- arguments ---------------------------------------------------------------------------------


@pytest.mark.parametrize("method", FIXED)
def test_save_every_keeps_the_same_states(method: str) -> None:
    problem = nonlinear_oscillator()
    every = hamsym.integrate(problem.H, problem.z0, (0, 1), method, steps=100)
    some = hamsym.integrate(problem.H, problem.z0, (0, 1), method, steps=100, save_every=20)
    np.testing.assert_array_equal(some.z, every.z[::20])
    np.testing.assert_allclose(some.t, every.t[::20], rtol=1e-15)
    assert some.steps == 100
    assert some.dt == 0.01


ENSEMBLES = [(*case, {}) for case in LOOPS if not case[1].startswith("tao")]
ENSEMBLES += [(system, m, {"omega": 2.0}) for system, m in LOOPS if m.startswith("tao")]
ENSEMBLES += [(system, m, {"compensated": True}) for system, m in LOOPS[:4]]


@pytest.mark.slow_cases("henon_heiles-symplectic_euler-options10", "timed-ruth3-options12")
@pytest.mark.parametrize(("system", "method", "options"), ENSEMBLES)
def test_ensembles_are_many_trajectories(
    system: str, method: str, options: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Bit-identical for every division into pieces and threads."""
    problem = PROBLEMS[system]()
    starts = np.array(problem.z0) + 0.01 * np.random.default_rng(0).normal(size=(70, problem.H.dim))
    many = hamsym.integrate(problem.H, starts, (0, 3), method, steps=60, save_every=20, **options)
    assert many.z.shape == (70, 4, problem.H.dim)
    assert many.energy.shape == (70, 4)
    monkeypatch.setattr(stepper, "_PIECE_WORK", 1_000)
    monkeypatch.setattr(stepper, "_MIN_THREADED_WORK", 0)
    pieces = hamsym.integrate(problem.H, starts, (0, 3), method, steps=60, save_every=20, **options)
    np.testing.assert_array_equal(pieces.z, many.z)
    for i in (0, 64, 69):
        one = hamsym.integrate(
            problem.H, starts[i], (0, 3), method, steps=60, save_every=20, **options
        )
        np.testing.assert_array_equal(many.z[i], one.z)


@pytest.mark.parametrize(
    ("system", "method"),
    [("henon_heiles", "blanes_moan6"), ("timed", "ruth3"), ("pendulum", "symplectic_euler_p")],
)
def test_tangents_of_ensembles_are_those_of_each(system: str, method: str) -> None:
    """To the last bit, for every division; for one vector there is a loop of its own."""
    problem = PROBLEMS[system]()
    random = np.random.default_rng(0)
    states = np.array(problem.z0) + 0.01 * random.normal(size=(70, problem.H.dim))
    vectors = random.normal(size=(70, problem.H.dim, 2))

    def run(rows: slice, columns: slice) -> tuple[np.ndarray, np.ndarray]:
        start, size = np.full(len(states[rows]), 0.2), np.full(len(states[rows]), 0.05)
        tangents = np.array(vectors[rows, :, columns], order="C")
        stepper = Stepper(problem.H, method, states[rows], start, size, tangents=tangents)
        return stepper.advance(5, 4).states, tangents

    both, one = run(slice(None), slice(None)), run(slice(None), slice(1))
    np.testing.assert_array_equal(one[0], both[0])
    np.testing.assert_array_equal(one[1], both[1][..., :1])
    for i in (0, 64, 69):
        alone = run(slice(i, i + 1), slice(1))
        np.testing.assert_array_equal(one[0][i], alone[0][0])
        np.testing.assert_array_equal(one[1][i], alone[1][0])


OSCILLATORS = Hamiltonian("p**2/(2*m) + k*(1 + sin(t)/2)*x**2/2", parameters={"m": 1.0, "k": 1.0})
PARAMETERS = {
    "splitting": (OSCILLATORS, "blanes_moan6", False),
    "tangents": (OSCILLATORS, "blanes_moan6", True),
    "euler": (NONSEPARABLE, "symplectic_euler", False),
    "implicit": (NONSEPARABLE, "gauss4", False),
    "doubled": (NONSEPARABLE, "tao4", False),
}


@pytest.mark.slow_cases("70-splitting")
@pytest.mark.parametrize(("H", "method", "tangent"), PARAMETERS.values(), ids=list(PARAMETERS))
@pytest.mark.parametrize("count", [3, 70])
def test_each_trajectory_has_its_parameters(
    H: Hamiltonian, method: str, tangent: bool, count: int
) -> None:
    """To the last bit those of a Hamiltonian with these values."""
    random = np.random.default_rng(3)
    start = [0.0, 0.0] if H is OSCILLATORS else BOUNDED
    states = start + 0.3 * random.normal(size=(count, H.dim))
    values = random.uniform(0.5, 2.0, (count, len(H.parameter_names)))

    def run(H: Hamiltonian, rows: slice, parameters: np.ndarray | None) -> np.ndarray:
        number = len(states[rows])
        stepper = Stepper(
            H,
            method,
            states[rows],
            np.zeros(number),
            np.full(number, 0.1),
            omega=2.0 if method == "tao4" else None,
            tangents=np.tile(np.eye(2), (number, 1, 1)) if tangent else None,
            parameters=parameters,
        )
        found = stepper.advance(3, 5).states
        return np.concatenate((found, stepper.tangents), axis=1) if tangent else found

    many = run(H, slice(None), values)
    for i in (0, count - 1):
        bound = H.with_parameters(**dict(zip(H.parameter_names, values[i].tolist(), strict=True)))
        np.testing.assert_array_equal(many[i], run(bound, slice(i, i + 1), None)[0])
    assert not np.allclose(many[0], run(H, slice(0, 1), None)[0])


def test_other_values_need_no_compilation() -> None:
    H = Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})
    other = H.with_parameters(k=2.0)
    assert H.kernels is other.kernels
    assert "2.0" not in other.kernels.source


def test_ensembles_by_name() -> None:
    H = nonlinear_oscillator().H
    found = hamsym.integrate(H, {"p": 0.0, "x": np.array([0.5, 1.0, 1.5])}, (0, 1), steps=10)
    assert found.z.shape == (3, 11, 2)
    assert found.z[:, 0].tolist() == [[0.5, 0], [1, 0], [1.5, 0]]


def test_one_escape_does_not_hide_the_others() -> None:
    for method in ("yoshida8", "gauss6", "dop853"):
        found = hamsym.integrate(TIMED, [[0.1, 0.0], [2.0, 4.0]], (0, 5), method, steps=1000)
        assert not found.success
        assert found.message.startswith("1 of 2 trajectories stopped, number 1 first, stopped af")
        assert np.isfinite(found.z[0]).all()
        gone = np.isnan(found.z[1]).all(axis=-1)
        assert gone[-1]
        assert not gone[0]
        assert np.array_equal(np.sort(gone), gone)


def test_dt_divides_the_span() -> None:
    problem = nonlinear_oscillator()
    assert hamsym.integrate(problem.H, problem.z0, (0, 1), dt=0.1).steps == 10
    assert hamsym.integrate(problem.H, problem.z0, (0, 1), dt=0.3).steps == 4
    assert hamsym.integrate(problem.H, problem.z0, (0, -1), dt=0.3).dt == -0.25
    assert hamsym.integrate(problem.H, problem.z0, (0, 1), dt=1.0).steps == 1
    assert hamsym.integrate(problem.H, problem.z0, (0, 0.3), dt=0.1 * 3).steps == 1
    assert hamsym.integrate(problem.H, problem.z0, (0, 0.1 * 3), dt=0.1).steps == 3


def test_evaluations_are_counted() -> None:
    problem = nonlinear_oscillator()

    def count(method: str) -> int:
        return hamsym.integrate(problem.H, problem.z0, (0, 1), method, steps=100).evaluations

    assert count("stormer_verlet") == count("symplectic_euler") == 100
    assert count("forest_ruth") == 300
    assert count("blanes_moan6") == 1000
    assert count("yoshida8") == 1500
    assert count("tao4") == 900
    assert 400 <= count("gauss4") <= 2000


def test_aliases_have_the_same_coefficients() -> None:
    problem = nonlinear_oscillator()
    for alias, method in ALIASES.items():
        a, b = (hamsym.integrate(problem.H, problem.z0, (0, 1), m) for m in (alias, method))
        np.testing.assert_array_equal(a.z, b.z)


def test_listing_has_a_line_for_each_row() -> None:
    lines = listing().splitlines()
    assert [line.split()[0] for line in lines[1:]] == list(INTEGRATORS)
    for line, row in zip(lines[1:], INTEGRATORS.values(), strict=True):
        assert row.source in line
        assert str(row.order) in line.split()


@pytest.mark.parametrize("method", [m for m in FIXED if m not in ANY_H])
def test_splitting_needs_a_separable_h(method: str) -> None:
    problem = double_pendulum()
    with pytest.raises(
        SeparabilityError, match=f"{method} needs H = T.p. . V.q., and this H is not sep"
    ):
        hamsym.integrate(problem.H, problem.z0, (0, 1), method)


@pytest.fixture
def sigint_handled() -> Iterator[None]:
    """Handle Ctrl-C, also in a process that was started with SIGINT ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("sigint_handled")
def test_ctrl_c_keeps_earlier_states(monkeypatch: pytest.MonkeyPatch) -> None:
    problem = nonlinear_oscillator()
    hamsym.integrate(problem.H, problem.z0, (0, 1), "symplectic_euler")  # compiled
    monkeypatch.setattr(stepper, "_PIECE_WORK", 100_000)
    original = stepper.Stepper._run

    def with_a_signal(self: stepper.Stepper, *arguments: object) -> np.ndarray:
        out = original(self, *arguments)  # type: ignore[arg-type]
        if self._first >= 300_000:
            signal.raise_signal(signal.SIGINT)
        return out

    monkeypatch.setattr(stepper.Stepper, "_run", with_a_signal)
    found = hamsym.integrate(
        problem.H, problem.z0, (0, 1e6), "symplectic_euler", steps=10**7, save_every=10**5
    )
    assert not found.success
    assert found.message == "stopped after t = 20000: interrupted"
    assert found.t.tolist() == [0.0, 10_000.0, 20_000.0]
    assert np.isfinite(found.z).all()


@pytest.mark.slow
def test_progress_is_drawn_on_request(capsys: pytest.CaptureFixture[str]) -> None:
    problem = nonlinear_oscillator()
    hamsym.integrate(problem.H, problem.z0, (0, 1e6), "symplectic_euler", steps=200_000_000,
                     save_every=10**7, progress=True)  # fmt: skip
    assert "stepping" in capsys.readouterr().err
    hamsym.integrate(problem.H, problem.z0, (0, 1), progress=False)
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"method": "rk4"}, "'rk4' is not a method; choose one of symplectic_euler"),
        ({"steps": 0}, "steps=0"),
        ({"steps": 1.5}, "steps=1.5"),
        ({"dt": 0}, "dt=0 cannot be used; give a number above 0"),
        ({"dt": -0.1}, "dt=-0.1"),
        ({"dt": float("nan")}, "dt=nan"),
        ({"dt": "x"}, "dt='x'"),
        ({"dt": 0.1, "steps": 10}, "exclude each other; give one"),
        ({"save_every": 0}, "save_every=0"),
        ({"steps": 10, "save_every": 3}, "does not divide"),
        ({"rtol": 1e-9}, "rtol applies to adaptive methods, not to blanes_moan6; give steps or"),
        ({"omega": 1.0}, "omega applies to tao2 and tao4, not to blanes_moan6; leave it out"),
        ({"dt": 100.0}, "dt=100.0 is longer than the span, 12.5664; give a shorter one"),
        (
            {"span": (0, 1e9)},
            "needs .* steps, above the limit of automatic steps; give steps or dt",
        ),
        ({"method": "tao2", "omega": -1.0}, "omega=-1.0"),
        ({"method": "tao2", "omega": "2"}, "omega='2'"),
        ({"method": "dop853", "rtol": "a"}, "rtol='a'"),
        ({"method": ["yoshida4"]}, "is not a method"),
        ({"dt": 1e-30}, "dt=1e-30 would take .* steps; give a larger one"),
        ({"steps": 10**20}, "steps=100000000000000000000 cannot be used; give a whole number"),
        ({"method": "tao2", "compensated": True}, "compensated applies to .*, not to tao2"),
        ({"method": "dop853", "rtol": -1.0}, "rtol=-1.0"),
        ({"steps": 10**13}, "GiB; save fewer with a larger save_every"),
        ({"z0": np.zeros((10**6, 2)), "steps": 10**6}, "of 1,000,000 trajectories need"),
        ({"z0": np.zeros((2, 3))}, "z0 has shape"),
        ({"z0": np.zeros((2, 2, 3))}, "z0 has shape"),
        ({"z0": {"x": [1.0, 2.0], "p": [1.0, 2.0, 3.0]}}, "z0 has arrays of shapes"),
    ],
)
def test_unusable_settings(arguments: dict[str, object], message: str) -> None:
    problem = nonlinear_oscillator()
    settings = {"z0": problem.z0, "span": problem.span, **arguments}
    with pytest.raises(InputError, match=message):
        hamsym.integrate(problem.H, **settings)


def test_reference_refuses_a_span_without_solution() -> None:
    with pytest.raises(InputError, match="no solution beyond t = "):
        reference(Hamiltonian("p**2/2 - x**4/4"), np.array([1.0, 1.0]), (0.0, 5.0))


# -- number of steps ---------------------------------------------------------------------------

PLANE_KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"


@pytest.mark.slow_cases("charged_particle-1e-08")
@pytest.mark.parametrize(
    ("system", "within"),
    [
        ("nonlinear_oscillator", 1e-8),
        ("morse_oscillator", 1e-8),
        ("kepler", 1e-8),
        ("driven_oscillator", 1e-8),
        ("charged_particle", 1e-8),
    ],
)
def test_default_steps_are_accurate(system: str, within: float) -> None:
    """The charged particle has a quadratic H, which Gauss steps of any length conserve."""
    problem = CATALOGUE[system]()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = hamsym.integrate(problem.H, problem.z0, problem.span)
    assert found.success
    assert found.method == ("blanes_moan6" if problem.H.is_separable else "gauss6")
    assert np.abs(found.z - problem.exact(found.t)).max() < within
    assert found.steps % 1_000 == 0
    assert f"{found.steps:,} steps to t = " in found.message


def test_chosen_steps_keep_the_energy() -> None:
    """The smallest number is chosen: half the steps fail. H is evaluated independently."""
    problem = CATALOGUE["kepler"](0.9)
    found = hamsym.integrate(problem.H, problem.z0, (0, 300))
    x, y, p_x, p_y = found.z.T
    energy = (p_x**2 + p_y**2) / 2 - 1 / np.hypot(x, y)
    assert found.drift <= 1e-9
    assert np.abs(energy - energy[0]).max() < 1e-8
    assert f"H kept to {found.drift:.1e} of its scale" in found.message
    assert len(found.t) <= 16_001
    assert np.all(np.diff(found.t) > 0)
    half = hamsym.integrate(
        problem.H, problem.z0, (0, 300), "blanes_moan6", steps=found.steps // 2,
        save_every=found.steps // 2 // (len(found.t) - 1) or 1,
    )  # fmt: skip
    assert half.drift > 1e-9


def test_longer_spans_get_more_steps() -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    found = hamsym.integrate(H, [1.0, 0.0], (0, 1e4))
    assert found.dt <= 0.2
    assert np.abs(found.z[:, 0] - np.cos(found.t)).max() < 1e-4
    some = hamsym.integrate(H, [1.0, 0.0], (0, 1e4), save_every=3_000)
    assert some.steps % 3_000 == 0
    assert len(some.t) == 1 + some.steps // 3_000


def test_steps_suit_the_hardest_trajectory() -> None:
    starts = np.array([[1.0, 0, 0, 1], [0.1, 0, 0, 4.3]])  # a circle, and e = 0.85
    alone = [hamsym.integrate(PLANE_KEPLER, start, (0, 20)).steps for start in starts]
    together = hamsym.integrate(PLANE_KEPLER, starts, (0, 20))
    assert alone[0] < alone[1] <= together.steps
    assert together.drift <= 1e-9


def test_accuracy_does_not_depend_on_start_time() -> None:
    for H, start in (("p**2/2 + x**2/2", [1.0, 0.0]), (NONSEPARABLE, BOUNDED)):
        early = hamsym.integrate(H, start, (0, 10))
        late = hamsym.integrate(H, start, (1e7, 1e7 + 10))
        assert late.success
        assert late.steps == early.steps
        np.testing.assert_allclose(late.z, early.z, atol=1e-13)
    forced = hamsym.integrate("p**2/2 + x**2/2 - x*cos(2*t)", [0, 0], (1e7, 1e7 + 10))
    s = forced.t - 1e7
    a, b = np.cos(2e7), -np.sin(2e7)  # the force is a cos(2 s) + b sin(2 s)
    x = a * (np.cos(s) - np.cos(2 * s)) / 3 + b * (2 * np.sin(s) - np.sin(2 * s)) / 3
    assert np.abs(forced.z[:, 0] - x).max() < 1e-7


@pytest.mark.slow
def test_collision_raises_a_warning() -> None:
    """Radial fall, and a fall to a pole: steps jump over the centre, every state is finite."""
    with pytest.warns(
        StepSizeWarning, match="target of 1e-09 is not met.* before a close encounter"
    ):
        found = hamsym.integrate(PLANE_KEPLER, [1.0, 0, 0, 0], (0, 3))
    assert found.drift > 0.01
    with pytest.warns(StepSizeWarning, match="of its scale: take more steps"):
        jumped = hamsym.integrate(POLE, [2**0.5, -1, 0, 0], (0, 3), "gauss4", steps=19)
    assert jumped.success
    assert "take more steps" in jumped.message
    assert np.isfinite(jumped.z).all()


def test_long_steps_of_a_driven_motion_raise_a_warning() -> None:
    H, start = "p**2/2 - (1 + sin(t)/2)*cos(x)", [1.0, 0.2]
    with pytest.warns(StepSizeWarning, match="rates up to 1.2: give stormer_verlet a dt of at"):
        hamsym.integrate(H, start, (0, 20), "stormer_verlet", dt=0.3)


@pytest.mark.slow_cases("p**2/2 - (1 + sin(t)/2)*cos(x)-start6-span6-options6")
@pytest.mark.parametrize(
    ("formula", "start", "span", "options"),
    [
        ("p**2/2 + x**2/2", [1, 0], (0, 100), {"method": "yoshida8", "steps": 50}),
        ("p**2/2 + x**2/2", [1, 0], (0, 1e4), {"method": "symplectic_euler"}),
        ("p**2/2 + x**2/2", [1, 0], (0, 100), {"steps": 25}),
        ("p**2/2 + x**2/2", [1, 0], (0, 10), {"method": "dop853", "rtol": 0.1, "atol": 0.1}),
        ("p**2/2 + log(x)", [-1, 1], (0, 0.5), {}),  # a force, but no energy
        ("p**2/2 + log(x)", [-1, 1], (0, 0.5), {"method": "yoshida8", "steps": 100}),
        ("p**2/2 - (1 + sin(t)/2)*cos(x)", [1.5, 0], (0, 3_000), {}),  # chaos
    ],
)
def test_too_long_steps_raise_a_warning(
    formula: str, start: list[float], span: tuple[float, float], options: dict[str, object]
) -> None:
    with pytest.warns(StepSizeWarning) as caught:
        found = hamsym.integrate(formula, start, span, **options)
    assert found.success == ("log" not in formula)
    assert str(caught[0].message) == found.message
    assert caught[0].filename == __file__
    assert not found.drift <= 0.01


def test_short_steps_raise_no_warning() -> None:
    problem = nonlinear_oscillator()
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for method in FIXED:
            hamsym.integrate(problem.H, problem.z0, (0, 10), method)
        hamsym.integrate(problem.H, [0.0, 0.0], (0, 10))
        hamsym.integrate(problem.H, problem.z0, (0, -10))
        hamsym.integrate("p**2/2 - cos(x)", [1e-9, 0], (0, 10))  # H is -1 and round-off
        hamsym.integrate("p**2/2 - cos(x)", [0, 100], (0, 100))  # x grows without bound, H does not
        hamsym.integrate("p**2/2 + (x - 1e6)**2/2", [1e6 + 1, 0], (0, 10))


def test_escape_ends_the_choice_of_steps() -> None:
    found = hamsym.integrate("p**2/2 - x**4/4", [1.0, 1.0], (0, 5))
    assert not found.success
    assert found.t[-1] == pytest.approx(1.31103, abs=0.01)
    assert found.steps <= 10_000
    assert "no longer finite" in found.message


@pytest.mark.usefixtures("sigint_handled")
def test_ctrl_c_ends_the_choice_of_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    original, calls = stepper.Stepper._run, []

    def with_a_signal(self: stepper.Stepper, *arguments: object) -> np.ndarray:
        calls.append(1)
        if len(calls) == 2:
            signal.raise_signal(signal.SIGINT)
        return original(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(stepper.Stepper, "_run", with_a_signal)
    # From the apocentre, where the motion is slow.
    found = hamsym.integrate(PLANE_KEPLER, [1.9, 0, 0, 0.23], (0, 30))
    assert found.interrupted
    assert not found.success
    assert found.message.endswith("interrupted")
    assert len(calls) == 2


def test_drift_is_independent_of_units_and_origin() -> None:
    """The same motion with a constant added to H, a distant origin and other units."""
    plain = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    moved = Hamiltonian("a*(p**2/2 + (x - 64)**2/2 + (x - 64)**4/4 + 5)", parameters={"a": 1e-20})
    t = np.linspace(0, 12, 5_000)
    path = np.stack((1.3 * np.cos(t), -1.3 * np.sin(t)), axis=-1)  # no solution: H changes
    drifts = []
    for H, origin in ((plain, 0), (moved, 64)):
        drift = EnergyDrift(H, 1)
        for first in range(0, 4_999, 500):  # piece by piece
            drift.add(path[None, first : first + 501] + [origin, 0])
        drifts.append(drift.relative(5_000)[0])
        assert drift.scale[0] > 0
    assert drifts[0] > 0.1
    assert drifts[1] == pytest.approx(drifts[0], rel=1e-9)


def test_nan_energy_gives_infinite_drift() -> None:
    H = Hamiltonian("p**2/2 + log(x)")
    drift = EnergyDrift(H, 2)
    drift.add(np.array([[[1.0, 0.0], [1.0, 0.0]], [[1.0, 0.0], [-1.0, 0.0]]]))
    assert drift.relative(1).tolist() == [0.0, math.inf]


# -- special cases -----------------------------------------------------------------------------


@pytest.mark.parametrize("unit", [1e-27, 1e27])
@pytest.mark.parametrize("method", ADAPTIVE)
def test_adaptive_methods_work_in_any_units(method: str, unit: float) -> None:
    """Also from a start at rest, where the momentum is zero."""
    plain = Hamiltonian("p**2/2 + x**2/2 + x**4/4")
    H = Hamiltonian(
        "a*b*((p/b)**2/2 + (x/a)**2/2 + (x/a)**4/4)", parameters={"a": unit, "b": 1e3 * unit}
    )
    for start in ([1.3, 1.0], [1.3, 0.0]):
        right = hamsym.integrate(plain, start, (0, 12), "yoshida8", steps=12_000, save_every=120).z
        scaled = np.array(start) * [unit, 1e3 * unit]
        found = hamsym.integrate(H, scaled, (0, 12), method, steps=100)
        assert found.success
        np.testing.assert_allclose(found.z / [unit, 1e3 * unit], right, atol=1e-9)


@pytest.mark.parametrize(
    ("method", "options", "least"),
    [("tao4", {"steps": 500}, 2e-5), ("dop853", {"steps": 10, "rtol": 1e-8}, 1e-10)],
)
def test_unequal_units_of_pairs_keep_errors(method: str, options: dict, least: float) -> None:
    """As of a length and an angle in SI units; the errors of tao4 are as large."""
    H = Hamiltonian(
        "c*(((p_x*a)**2 + (p_y*b)**2)/(2*c**2) + (x/a)**2/2 + (x/a)**4/4 + 2*(y/b)**2)",
        parameters={"a": 1.0, "b": 1.0, "c": 1.0},
    )
    own = hamsym.integrate(H, [1.0, 0.5, 0, 0], (0, 10), method, **options)
    a, b, c = 2.0**-33, 2.0**40, 2.0**-50
    scaled = H.with_parameters(a=a, b=b, c=c)
    found = hamsym.integrate(scaled, [a, 0.5 * b, 0, 0], (0, 10), method, **options)
    np.testing.assert_allclose(found.z / [a, b, c / a, c / b], own.z, rtol=0, atol=least)


@pytest.mark.slow_cases("implicit_midpoint")
@pytest.mark.parametrize("method", ["implicit_midpoint", "gauss4", "gauss6"])
def test_implicit_methods_rest_at_an_equilibrium(method: str) -> None:
    """At the equilibrium the momenta are round-off of a cancelling force."""
    start = [2**0.5, 0.5 ** (1 / 3), 0.0, 0.0]
    found = hamsym.integrate(POLE, start, (0, 1000), method, dt=0.1)
    assert found.success
    assert np.abs(found.z - start).max() < 1e-11


def test_implicit_euler_rests_at_an_equilibrium() -> None:
    gradient = NONSEPARABLE.compile("numpy").gradient
    root = scipy.optimize.fsolve(gradient, [1.4, 0.0, -0.1, 0.0], xtol=1e-14)
    for method in ("symplectic_euler", "symplectic_euler_p"):
        found = hamsym.integrate(NONSEPARABLE, root, (0, 1000), method, dt=0.1)
        assert found.success
        assert np.abs(found.z - root).max() < 1e-10


def test_start_without_a_possible_step() -> None:
    H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
    for method in ADAPTIVE:
        found = hamsym.integrate(H, [0.0, 0, 0, 0], (0, 1), method)
        assert not found.success
        assert found.z.tolist() == [[0.0, 0, 0, 0]]


def test_ctrl_c_in_adaptive_method_keeps_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hamsym.integrators.adaptive.scipy.integrate.solve_ivp", interrupted)
    problem = nonlinear_oscillator()
    found = hamsym.integrate(problem.H, problem.z0, problem.span, "dop853")
    assert found.interrupted
    assert found.message == "stopped after t = 0: interrupted"
    assert found.z.tolist() == [[1.3, 1.0]]


@pytest.mark.slow
def test_states_fit_into_the_memory_of_the_process(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a container, which has less than its machine."""
    monkeypatch.setattr(stepper, "memory_size", lambda: 1e5)
    with pytest.raises(InputError, match="more than half of the memory of"):
        hamsym.integrate("p**2/2 + x**2/2", [1.0, 0.0], (0, 1), "gauss4", steps=10_000)


def test_non_finite_hessian_requires_omega() -> None:
    H = Hamiltonian("p**2/2 + abs(x)**1.5")
    with pytest.raises(InputError, match="the Hessian of H is not finite at z0; give omega"):
        hamsym.integrate(H, [0.0, 1.0], (0, 1), "tao2")
    assert hamsym.integrate(H, [0.0, 1.0], (0, 1), "tao2", omega=5.0).success


def test_parameters_and_coordinates_may_have_any_name() -> None:
    """Names that the kernels and loops use."""
    H = Hamiltonian(
        "p**2/2 + (parameters + h/2)*stages*x**2/2",
        parameters={"parameters": 1.0, "h": 2.0, "stages": 2.0},
    )
    z = hamsym.integrate(H, [1.0, 0.0], (0, np.pi), "forest_ruth", steps=300).z[-1]
    np.testing.assert_allclose(z, [1.0, 0.0], atol=1e-3)
    exact = reference(NONSEPARABLE, np.array(BOUNDED), (0.0, 6.0))(np.array([6.0]))[0]
    for method in ("symplectic_euler", "gauss4"):
        z = hamsym.integrate(NONSEPARABLE, BOUNDED, (0, 6), method, steps=6_000).z[-1]
        np.testing.assert_allclose(z, exact, atol=2e-3)


@pytest.mark.slow
def test_loops_over_terms_match_written_out_steps() -> None:
    """Six pairs of bodies on a line with five forces each, a loop for each force.

    They are compared with the numpy gradient term by term.
    """
    pairs = itertools.product(itertools.combinations(range(4), 2), range(5))
    H = Hamiltonian(
        " + ".join(f"p{i}**2/{2 + i}" for i in range(4))
        + "".join(f" - {1 + i + j}/sqrt((x{i} - x{j})**2 + 1/{100 + k})" for (i, j), k in pairs)
        + " + x3**2/2 + cos(x1)"
    )
    assert H.source("numba", part="slope").count("for row in range(6):") == 5
    gradient, h = H.compile("numpy").gradient, 0.01
    starts = np.random.default_rng(4).normal(size=(5, 8))
    q, p = starts[:, :4], starts[:, 4:]
    q = q + h * gradient(starts)[:, 4:]
    p = p - h * gradient(np.concatenate((q, p), axis=1))[:, :4]
    for compensated in (False, True):
        found = hamsym.integrate(
            H, starts, (0, h), "symplectic_euler", steps=1, compensated=compensated
        )
        np.testing.assert_allclose(found.z[:, -1], np.concatenate((q, p), axis=1), rtol=1e-12)
    _, M = step_map(Problem("bodies", H, tuple(starts[0]), (0.0, 1.0), ""), "forest_ruth", h)
    J = np.array(H.poisson_matrix, dtype=float)
    assert np.abs(M.T @ J @ M - J).max() < 1e-10 * np.linalg.norm(M, 2) ** 2


def test_dop853_ends_after_too_many_evaluations(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(adaptive, "_MOST", 3_000)
    monkeypatch.setattr(adaptive, "_MOST_ROUGH", 3_000)
    found = hamsym.integrate("p**2/2 + x**2/2", [1.0, 0.0], (0, 1e12), "dop853", steps=10)
    assert not found.success
    assert "more than 3,000 evaluations; give a shorter span" in found.message
    with pytest.raises(InputError, match="3,000 evaluations; use a shorter span"):
        reference("p**2/2 + x**2/2", np.array([1.0, 0.0]), (0, 1e12))
