"""Tangent maps, monodromy matrices and Lyapunov exponents."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
import scipy.integrate
import sympy

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.dynamics.lyapunov import LyapunovExponents
from hamsym.dynamics.monodromy import TangentMap, tangent_stepper
from hamsym.integrators.table import usual_method
from hamsym.systems import (
    CATALOGUE,
    Problem,
    charged_particle,
    double_pendulum,
    driven_oscillator,
    harmonic_oscillator,
    henon_heiles,
    kepler,
    nonlinear_oscillator,
    pendulum,
)

from .linear_systems import linear, saddle

# -- equations ---------------------------------------------------------------------------------


def test_variational_equations_are_j_hess_delta() -> None:
    H = henon_heiles().H
    equations = H.variational_equations
    delta = [equation.lhs.args[0] for equation in equations]
    assert [str(symbol) for symbol in delta] == ["delta_x", "delta_y", "delta_p_x", "delta_p_y"]
    rates = sympy.Matrix([equation.rhs for equation in equations])
    assert sympy.expand(rates - H.poisson_matrix * H.hessian * sympy.Matrix(delta)) == sympy.zeros(
        4, 1
    )


def test_variational_equations_do_not_reuse_a_name() -> None:
    H = Hamiltonian("p**2/2 + delta_x*x**2/2")
    names = [str(equation.lhs.args[0]) for equation in H.variational_equations]
    assert names == ["ddelta_x", "ddelta_p"]


# -- tangent maps ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "make", [henon_heiles, pytest.param(double_pendulum, marks=pytest.mark.slow), driven_oscillator]
)
def test_tangent_map_solves_the_variational_equations(make: object) -> None:
    problem = make()  # type: ignore[operator]
    H, dim = problem.H, problem.H.dim
    system = H.compile("numpy")
    J = np.array(H.poisson_matrix, dtype=float)

    def rates(t: float, both: np.ndarray) -> np.ndarray:
        z, M = both[:dim], both[dim:].reshape(dim, dim)
        arguments = system.arguments(z, t)
        return np.append(system.vector_field(*arguments), J @ system.hessian(*arguments) @ M)

    start = np.append(problem.z0, np.eye(dim))
    right = scipy.integrate.solve_ivp(rates, (0, 5), start, "DOP853", rtol=1e-12, atol=1e-12)
    method = usual_method(H)
    stepper = tangent_stepper(H, method, H.state_from(problem.z0), 0.0, 0.01, np.eye(dim))
    found = TangentMap(np.array(problem.z0), stepper.step(500)[0], stepper.tangents[0], method)
    np.testing.assert_allclose(found.z, right.y[:dim, -1], atol=1e-9)
    np.testing.assert_allclose(found.matrix.ravel(), right.y[dim:, -1], atol=1e-8)
    assert found.symplecticity_error < 1e-11


def test_doubled_phase_space_has_no_tangent_map() -> None:
    problem = henon_heiles()
    with pytest.raises(InputError, match="tao4 steps in a doubled phase space; choose another"):
        tangent_stepper(problem.H, "tao4", np.array(problem.z0), 0.0, 0.01, np.eye(4))


# -- monodromy ---------------------------------------------------------------------------------


def test_monodromy_of_linear_systems_is_known() -> None:
    """A harmonic oscillator returns after any time; in a magnetic field all orbits close."""
    problem = harmonic_oscillator(2.0)
    found = hamsym.monodromy(problem.H, problem.z0, problem.period)
    np.testing.assert_allclose(found.matrix, np.eye(2), atol=1e-9)
    found = hamsym.monodromy(problem.H, problem.z0, problem.period / 4)
    np.testing.assert_allclose(found.multipliers, [1j, -1j], atol=1e-9)
    assert found.closure > 0.5
    particle = charged_particle()
    found = hamsym.monodromy(particle.H, particle.z0, particle.period)
    assert found.closure < 1e-9
    np.testing.assert_allclose(found.multipliers, 1, atol=1e-4)  # a double eigenvalue splits


@pytest.mark.parametrize("make", [nonlinear_oscillator, pendulum, kepler])
def test_two_multipliers_of_a_closed_orbit_are_one(make: object) -> None:
    problem = make()  # type: ignore[operator]
    found = hamsym.monodromy(problem.H, problem.z0, problem.period)
    assert found.closure < 1e-8
    assert found.symplecticity_error < 1e-8
    # The flow itself is carried into itself.
    field = problem.H.compile("numpy").vector_field(problem.z0)
    np.testing.assert_allclose(found.matrix @ field, field, atol=1e-7)


def test_unstable_orbit_has_a_multiplier_outside_the_circle() -> None:
    """x = 0 in a saddle: e^T and e^-T."""
    H = Hamiltonian("p_x**2/2 - x**2/2 + p_y**2/2 + y**2/2")
    found = hamsym.monodromy(H, {"x": 0, "y": 1, "p_x": 0, "p_y": 0}, 2 * math.pi)
    np.testing.assert_allclose(abs(found.multipliers[0]), math.exp(2 * math.pi), rtol=1e-9)
    np.testing.assert_allclose(abs(found.multipliers[-1]), math.exp(-2 * math.pi), atol=1e-6)


def test_unusable_periods_are_rejected() -> None:
    problem = harmonic_oscillator()
    with pytest.raises(InputError, match="span="):
        hamsym.monodromy(problem.H, problem.z0, 0.0)
    with pytest.raises(InputError, match="does not reach tol=1e-10"):
        hamsym.monodromy(Hamiltonian("p**2/2 - x**4/4"), [1.0, 1.0], 5.0)


@pytest.mark.parametrize("period", ["x", float("nan"), None])
def test_periods_other_than_numbers_are_rejected(period: object) -> None:
    problem = harmonic_oscillator()
    with pytest.raises(InputError, match="period=.* cannot be used; give a number"):
        hamsym.monodromy(problem.H, problem.z0, period)  # type: ignore[arg-type]


# -- Lyapunov exponents ------------------------------------------------------------------------


def test_exponents_of_a_saddle_are_its_rates() -> None:
    """Motions e^{at} and e^{bt}: exponents a, b, -b, -a, to (log of a constant)/t."""
    found = hamsym.lyapunov(saddle(3.0, 1.0), [1e-200, 1e-200, 0, 0], (0, 100), count=4)
    np.testing.assert_allclose(found.exponents[-1], [3, 1, -1, -3], atol=0.03)
    assert found.exponents.shape[1] == 4
    assert abs(found.trend) < 0.2
    assert "if the motion is bounded and recurs" in found.statement


@pytest.mark.parametrize(
    ("make", "count"),
    [(henon_heiles, 3), pytest.param(double_pendulum, 4, marks=pytest.mark.slow)],
)
def test_largest_exponent_comes_first(make: Callable[[], Problem], count: int) -> None:
    """At every time, also while the vectors have not yet turned into their order."""
    problem = make()
    found = hamsym.lyapunov(problem.H, problem.z0, (0, 100), count=count)
    assert np.all(np.diff(found.exponents, axis=1) <= 0)
    assert found.maximal == found.exponents[-1].max()
    assert f"the largest exponent is {found.maximal:.3g}" in found.statement
    drawn = found.plot().axes[0].lines[0].get_ydata()
    assert drawn[-1] == found.maximal


MASS, RATE, LENGTH = 9.1e-31, 6.3e8, 1e-4  # of an electron in a trap, in SI units


def test_exponents_of_a_saddle_in_SI_units_are_its_rates() -> None:
    H = Hamiltonian("p**2/(2*m) - k*x**2/2", parameters={"m": MASS, "k": MASS * RATE**2})
    found = hamsym.lyapunov(H, [1e-14, 0.0], (0, 20 / RATE), count=2)
    assert found.success
    np.testing.assert_allclose(found.exponents[-1] / RATE, [1, -1], rtol=0.05)


@pytest.fixture(scope="module")
def henon_heiles_in_SI_units() -> Hamiltonian:
    quadratic = "(p_x**2 + p_y**2)/(2*m) + m*w**2*(x**2 + y**2)/2"
    values = {"m": MASS, "w": RATE, "L": LENGTH}
    return Hamiltonian(f"{quadratic} + m*w**2*(x**2*y - y**3/3)/L", parameters=values)


@pytest.mark.slow_cases("1")
@pytest.mark.parametrize("count", [1, 4])
def test_exponents_do_not_depend_on_units(
    henon_heiles_in_SI_units: Hamiltonian, count: int
) -> None:
    starts = np.array([[0.0, -0.15, 0.5555, 0.0], [0.3, -0.3, 0.3, 0.15]])  # chaotic, regular
    sizes = np.array([LENGTH, LENGTH, MASS * RATE * LENGTH, MASS * RATE * LENGTH])
    known = hamsym.lyapunov(henon_heiles().H, starts, (0, 2_000), count=count)
    H = henon_heiles_in_SI_units
    found = hamsym.lyapunov(H, starts * sizes, (0, 2_000 / RATE), count=count)
    one = hamsym.lyapunov(H, starts[0] * sizes, (0, 2_000 / RATE), count=count)
    assert found.success.all()
    assert one.success
    np.testing.assert_allclose(found.exponents / RATE, known.exponents, rtol=0.15, atol=1.5e-3)
    np.testing.assert_allclose(one.exponents[-1] / RATE, known.exponents[0], rtol=0.15, atol=1.5e-3)


def test_indicators_do_not_depend_on_units(henon_heiles_in_SI_units: Hamiltonian) -> None:
    z0 = np.array([0.3, -0.3, 0.3, 0.15])  # regular: MEGNO tends to 2, SALI stays away from 0
    sizes = np.array([LENGTH, LENGTH, MASS * RATE * LENGTH, MASS * RATE * LENGTH])
    found = hamsym.chaos_indicators(henon_heiles_in_SI_units, z0 * sizes, (0, 2_000 / RATE))
    assert found.success
    assert abs(found.mean_megno[-1] - 2) < 0.3
    assert found.sali[-1] > 0.1


def test_exponents_without_energy_fail() -> None:
    """log(x) has a force where x is negative, but no value."""
    found = hamsym.lyapunov(Hamiltonian("p**2/2 + log(x)"), [-1.0, 1.0], (0, 0.5), dt=1e-3)
    assert not found.success
    assert "H changed by inf" in found.message
    assert "However, the run failed" in found.statement


def test_one_degree_of_freedom_is_never_called_chaotic() -> None:
    leaving = hamsym.lyapunov(linear(-1.0), [1e-200, 0], (0, 100))
    assert leaving.maximal == pytest.approx(1, abs=0.05)
    assert "this is not chaos" in leaving.statement
    # Leaving the pendulum's unstable equilibrium the exponent rises.
    rising = hamsym.lyapunov(pendulum().H, [math.pi, 0.0], (0, 30))
    assert "chaos over" not in rising.statement


def test_default_step_not_set_by_slow_start() -> None:
    """The Hessian at the start is far smaller than on the way, also with explicit time."""
    driven = Hamiltonian("p**2/2 - (1 + sin(t)/2)*cos(x)")
    assert hamsym.lyapunov(driven, [math.pi / 2, 0.0], (0, 1e4)).dt < 0.3
    # So early the tangent vector is the same on every processor; steps of 1 are wrong by 1e-3.
    found = hamsym.lyapunov(driven, [math.pi / 2, 0.0], (0, 100))
    fine = hamsym.lyapunov(driven, [math.pi / 2, 0.0], (0, 100), dt=0.01)
    assert found.maximal == pytest.approx(fine.maximal, rel=1e-6)


@pytest.mark.slow
def test_exponents_of_quartic_oscillator() -> None:
    quartic = Hamiltonian("(p_x**2 + p_y**2)/2 + x**2*y**2/2 + (x**4 + y**4)/400")
    found = hamsym.lyapunov(quartic, [0.0, 0.0, 1.0, 0.5], (0, 1e5), count=4)
    assert found.success
    assert abs(found.exponents[-1].sum()) < 1e-3
    assert found.maximal == pytest.approx(0.34, abs=0.02)


@pytest.mark.parametrize(
    "method", [None, pytest.param("gauss4", marks=pytest.mark.slow), "stormer_verlet"]
)
def test_start_of_the_paper_is_not_chaotic(method: str | None) -> None:
    """The paper has 0.069; here the exponent falls like log(t)/t, as on a torus."""
    problem = henon_heiles()
    found = hamsym.lyapunov(problem.H, problem.z0, (0, 2e4), method=method, dt=0.05)
    assert found.maximal < 6e-4
    at_300 = np.interp(300, found.t, found.exponents[:, 0])
    assert 5e-3 < at_300 < 2e-2
    assert found.trend < -0.7
    assert "falling like log(t)/t" in found.statement
    assert found.success


@pytest.mark.slow
def test_chaotic_orbit_of_henon_heiles() -> None:
    problem = henon_heiles()
    start = problem.H.state_at_energy(1 / 6, {"x": 0, "y": -0.15, "p_y": 0})
    assert start[2] == pytest.approx(0.5555, abs=1e-4)
    found = hamsym.lyapunov(problem.H, start, (0, 3e4), count=4)
    assert found.maximal == pytest.approx(0.13, abs=0.015)
    assert abs(found.trend) < 0.2
    assert "chaos over this time" in found.statement
    # In pairs, and two of them zero, since H is conserved.
    assert np.abs(found.exponents[-1] + found.exponents[-1][::-1]).max() < 1e-3
    assert np.abs(found.exponents[-1][1:3]).max() < 1e-3
    assert found.energy_error < 1e-9


def test_undecided_trend_is_stated() -> None:
    t, problem = np.geomspace(1, 1e4, 200), henon_heiles()
    made = LyapunovExponents(
        t, t[:, None] ** -0.35, problem.H, problem.z0, (0.0, 1e4), 0.0, "gauss4", 0.1, 1.0,
        success=True, message="",
    )  # fmt: skip
    assert "This is inconclusive; use a longer span" in made.statement
    short = dataclasses.replace(made, t=t[:3], exponents=t[:3, None])
    assert math.isnan(short.trend)
    assert "inconclusive" in short.statement


def test_same_seed_same_result_and_seeds_agree_late() -> None:
    problem = henon_heiles()
    start = problem.H.state_at_energy(1 / 6, {"x": 0, "y": -0.15, "p_y": 0})
    first, again, other = (
        hamsym.lyapunov(problem.H, start, (0, 5e3), seed=seed) for seed in (0, 0, 1)
    )
    np.testing.assert_array_equal(first.exponents, again.exponents)
    assert other.maximal == pytest.approx(first.maximal, abs=2e-3)
    assert other.maximal != first.maximal


def test_backward_time_and_explicit_time_have_exponents() -> None:
    problem = driven_oscillator()
    found = hamsym.lyapunov(problem.H, problem.z0, (10, -990))
    assert found.t[-1] == -990
    assert abs(found.maximal) < 1e-2
    assert math.isnan(found.energy_error)


def test_too_long_steps_fail() -> None:
    problem = henon_heiles()
    found = hamsym.lyapunov(problem.H, problem.z0, (0, 1e3), method="symplectic_euler", dt=0.3)
    assert not found.success
    assert "of its scale: take a smaller dt" in found.message


def test_escape_keeps_exponents_before_it() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    found = hamsym.lyapunov(H, [0.5, 0.5], (0, 20), dt=1e-3)
    assert not found.success
    assert "stopped after t = " in found.message
    assert np.isfinite(found.exponents).all()
    assert found.t[-1] < 20


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"count": 0}, "count=0 cannot be used; give a whole number from 1 to 4"),
        ({"count": 5}, "count=5"),
        ({"method": "dop853"}, "dop853 is adaptive"),
        ({"method": "tao2"}, "doubled phase space"),
        ({"dt": -1}, "dt=-1"),
        ({"dt": 1e-30}, "dt=1e-30 would take"),
        ({"seed": -1}, "seed=-1 cannot be used; give a whole number from 0"),
        ({"count": True}, "count=True"),
    ],
)
def test_unusable_options_are_rejected(options: dict[str, object], message: str) -> None:
    problem = henon_heiles()
    with pytest.raises(InputError, match=message):
        hamsym.lyapunov(problem.H, problem.z0, (0, 10), **options)


def test_exponents_are_drawn() -> None:
    problem = henon_heiles()
    figure = hamsym.lyapunov(problem.H, problem.z0, (0, 1e3)).plot()
    labels = [line.get_label() for line in figure.axes[0].lines]
    assert labels[0].startswith(r"$\lambda_{1}$ = ")
    assert labels[1] == "~ log(t)/t"


@pytest.mark.parametrize(
    "name",
    [
        "morse_oscillator",
        pytest.param("toda_chain", marks=pytest.mark.slow),
        pytest.param("calogero_moser", marks=pytest.mark.slow),
        pytest.param("spring_pendulum", marks=pytest.mark.slow),
    ],
)
def test_exponents_of_other_systems_are_finite(name: str) -> None:
    problem = CATALOGUE[name]()
    found = hamsym.lyapunov(problem.H, problem.z0, (0, 200))
    assert found.success
    assert np.isfinite(found.exponents).all()


def test_given_steps_resolve_a_driven_motion() -> None:
    H = hamsym.Hamiltonian("p**2/2 + (4 + 30*cos(2*t))*x**2/2")  # rates up to sqrt(34)
    for starts, dt in itertools.product(([1.0, 0.0], [[1.0, 0.0]]), (0.1, 0.3)):
        coarse = hamsym.lyapunov(H, starts, (0, 100), method="stormer_verlet", dt=dt)
        fine = hamsym.lyapunov(H, starts, (0, 100), method="stormer_verlet", dt=0.01)
        assert not np.all(coarse.success)
        assert np.all(fine.success)
