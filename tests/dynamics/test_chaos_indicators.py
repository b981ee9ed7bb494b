"""MEGNO, SALI and GALI against exact values, an independent integration and published orbits."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
import scipy.integrate
import scipy.linalg

import hamsym
from hamsym import ChaosIndicators, Hamiltonian, InputError
from hamsym.dynamics import lyapunov_map
from hamsym.dynamics.tangent_steps import first_vectors
from hamsym.integrators.stepper import Stepper
from hamsym.systems import henon_heiles, pendulum

from .linear_systems import linear, saddle

# Starts of Skokos, Antonopoulos, Bountis & Vrahatis (2004), J. Phys. A 37, 6269, at E = 1/8.
ORDERED = {"x": 0.0, "y": 0.55, "p_y": 0.0}
CHAOTIC = {"x": 0.0, "y": -0.016, "p_y": 0.0}


def start_of(plane: dict[str, float]) -> np.ndarray:
    return henon_heiles().H.state_at_energy(1 / 8, plane)


# -- exact values ------------------------------------------------------------------------------


def exact(H: Hamiltonian, t: float, seed: int) -> tuple[float, float, float]:
    """Y, its mean and SALI of a linear system from its matrix exponential.

    By parts, Y = 2 (g - G/t), and its mean is 2/t times the integral of g(u) (1 - log(t/u)).
    """
    values = {symbol: H.parameters[str(symbol)] for symbol in H.hessian.free_symbols}
    matrix = np.array((H.poisson_matrix * H.hessian).subs(values), dtype=float)
    first, second = first_vectors(H.dim, 2, seed).T

    def growth(u: np.ndarray) -> np.ndarray:
        flows = scipy.linalg.expm(math.copysign(1, t) * u[:, None, None] * matrix)
        return np.log(np.linalg.norm(flows @ first, axis=1))

    size = abs(t)
    nodes, weights = np.polynomial.legendre.leggauss(20)
    edges = np.concatenate(([0.0], np.geomspace(1e-6, 1.0, 60) * size))
    halves, middles = np.diff(edges) / 2, (edges[1:] + edges[:-1]) / 2
    u = (middles[:, None] + halves[:, None] * nodes).ravel()
    values = growth(u) * (halves[:, None] * weights).ravel()
    megno = 2 * (growth(np.array([size]))[0] - values.sum() / size)
    mean = 2 / size * (values * (1 - np.log(size / u))).sum()
    with mpmath.workdps(60):  # the vectors differ by far less than 1e-16
        flow = mpmath.expm(mpmath.matrix(matrix.tolist()) * mpmath.mpf(t))
        v, w = flow * mpmath.matrix(first.tolist()), flow * mpmath.matrix(second.tolist())
        v, w = v / mpmath.norm(v), w / mpmath.norm(w)
        sali = min(mpmath.norm(v + w), mpmath.norm(v - w))
    return float(megno), float(mean), float(sali)


@pytest.mark.parametrize(
    ("H", "end"),
    [
        (linear(4.0), 7.0),
        (linear(-1.0), 20.0),
        (linear(-1.0), -20.0),
        (linear(0.0), 50.0),
        (saddle(2.0, 1.0), 30.0),
    ],
)
@pytest.mark.parametrize("seed", [0, 5])
def test_linear_systems_have_their_exact_indicators(H: Hamiltonian, end: float, seed: int) -> None:
    found = hamsym.chaos_indicators(H, np.full(H.dim, 1e-9), (0, end), seed=seed)
    assert found.success, found.message
    megno, mean, sali = exact(H, end, seed)
    assert found.megno[-1] == pytest.approx(megno, abs=2e-4)
    assert found.mean_megno[-1] == pytest.approx(mean, abs=2e-4)
    assert found.sali[-1] == pytest.approx(sali, rel=1e-5)


def test_quadrature_has_fourth_order() -> None:
    """Of a saddle, whose steps by themselves are exact to the sixth order."""
    H = linear(-1.0)
    megno, mean, _ = exact(H, 3.0, 0)
    errors = []
    for steps in (16, 32):
        found = hamsym.chaos_indicators(H, [1e-9, 0.0], (0, 3), steps=steps)
        errors.append((abs(found.megno[-1] - megno), abs(found.mean_megno[-1] - mean)))
    for coarse, fine in zip(*errors, strict=True):
        assert fine < coarse / 10
        assert fine < 1e-5


def test_harmonic_oscillator_has_no_growth() -> None:
    """In its own units |v| is constant: Y = 0 and SALI keeps its first value."""
    found = hamsym.chaos_indicators(linear(1.0), [1.0, 0.0], (0, 1e3))
    assert np.abs(found.megno).max() < 1e-4  # |v| varies by the error of a step
    np.testing.assert_allclose(found.sali, math.sqrt(2), atol=1e-5)
    found = hamsym.chaos_indicators(linear(9.0), [1.0, 0.0], (0, 1e3))
    assert abs(found.mean_megno[-1]) < 0.01
    assert "MEGNO tends to 0 on a stable trajectory" in found.statement


def test_saddle_grows_by_its_exponent() -> None:
    """Y = t without the bounded part of log|v|, so that its mean is t/2."""
    found = hamsym.chaos_indicators(linear(-1.0), [1e-200, 0], (0, 100))
    assert found.slope == pytest.approx(1, abs=0.05)
    assert found.megno[-1] == pytest.approx(100, abs=2)
    assert found.mean_megno[-1] == pytest.approx(50, abs=4)
    assert "this is not chaos" in found.statement


def test_sali_of_a_saddle_is_followed_below_round_off() -> None:
    """exp(-(3 - 1) t), until it leaves the range of float64."""
    found = hamsym.chaos_indicators(saddle(3.0, 1.0), [1e-300, 1e-300, 0, 0], (0, 400), dt=0.05)
    late = (found.t > 10) & (found.t < 340)
    slope, _ = np.polyfit(found.t[late], np.log(found.sali[late]), 1)
    assert slope == pytest.approx(-2, abs=1e-3)
    assert found.sali[-1] == 0.0
    assert np.isfinite(found.megno).all()


@pytest.mark.slow
def test_sali_of_one_degree_of_freedom_falls_like_a_power() -> None:
    """Vectors turn into the only tangent direction of the torus: 1/t^2."""
    found = hamsym.chaos_indicators(pendulum().H, [2.5, 0.0], (0, 1e4))
    late = found.t > 100
    slope, _ = np.polyfit(np.log(found.t[late]), np.log(found.sali[late]), 1)
    assert slope == pytest.approx(-2, abs=0.1)
    means = np.interp([1e2, 1e3, 1e4], found.t, found.mean_megno)
    assert np.all(np.diff(np.abs(means - 2)) < 0)
    assert means[-1] == pytest.approx(2, abs=0.1)


# -- generalized alignment indices --


def test_gali_of_a_linear_system_is_a_volume() -> None:
    """By singular values of unit vectors in 60 digits."""
    H, end = saddle(2.0, 1.0), 30.0
    found = hamsym.chaos_indicators(H, np.full(4, 1e-9), (0, end), vectors=4, dt=0.02)
    values = {symbol: H.parameters[str(symbol)] for symbol in H.hessian.free_symbols}
    matrix = np.array((H.poisson_matrix * H.hessian).subs(values), dtype=float)
    with mpmath.workdps(120):
        flow = mpmath.expm(mpmath.matrix(matrix.tolist()) * mpmath.mpf(end))
        moved = flow * mpmath.matrix(first_vectors(4, 4, 0).tolist())
        unit = [moved[:, k] / mpmath.norm(moved[:, k]) for k in range(4)]
        for k in (2, 3, 4):
            A = mpmath.matrix(4, k)
            for j in range(k):
                A[:, j] = unit[j]
            volume = mpmath.sqrt(mpmath.det(A.T * A))
            assert found.gali[-1, k - 2] == pytest.approx(float(volume), rel=1e-4)


def test_sali_and_gali_2_are_of_one_angle() -> None:
    found = hamsym.chaos_indicators(henon_heiles().H, start_of(ORDERED), (0, 200), vectors=3)
    angle = 2 * np.arcsin(found.sali / 2)
    np.testing.assert_allclose(np.sin(angle), found.gali[:, 0], rtol=1e-7)


def _slopes(found: ChaosIndicators, after: float, *, power: bool) -> list[float]:
    """Slopes of the logarithms of GALI over those of time, or over time."""
    slopes = []
    for column in found.gali.T:
        late = (found.t > after) & (column > 0)
        t = np.log(found.t[late]) if power else found.t[late]
        slopes.append(float(np.polyfit(t, np.log(column[late]), 1)[0]))
    return slopes


def test_gali_of_regular_motion_falls_like_published_powers() -> None:
    """On a torus of two dimensions GALI_3 falls like t^-2, GALI_4 like t^-4."""
    found = hamsym.chaos_indicators(henon_heiles().H, [0, 0, 0.5, 0], (0, 3e3), vectors=4)
    assert _slopes(found, 100, power=True) == pytest.approx([0, -2, -4], abs=0.3)


@pytest.mark.slow
def test_gali_of_chaotic_motion_falls_like_published_exponentials() -> None:
    """Skokos, Bountis & Antonopoulos 2007: sigma_1 = 0.047; GALI_k by 1, 2 and 4 times it."""
    H, start = henon_heiles().H, [0, -0.25, 0.42, 0]
    found = hamsym.chaos_indicators(H, start, (0, 3e3), vectors=4)
    exponent = hamsym.lyapunov(H, start, (0, 3e3)).maximal
    assert exponent == pytest.approx(0.047, rel=0.25)
    rates = [-math.log(value) / found.t[-1] for value in found.gali[-1]]
    assert rates == pytest.approx([exponent, 2 * exponent, 4 * exponent], rel=0.1)


_THREE = (
    "(p_x**2 + x**2)/2 + sqrt(2)*(p_y**2 + y**2)/2 + sqrt(3)*(p_z**2 + z**2)/2 + x**2*y + x**2*z"
)


def _of_energies(energies: tuple[float, float, float]) -> list[float]:
    """At the origin, with the energies of the three oscillators."""
    momenta = [
        math.sqrt(2 * own / math.sqrt(k)) for own, k in zip(energies, (1, 2, 3), strict=True)
    ]
    return [0.0, 0.0, 0.0, *momenta]


@pytest.mark.slow
def test_gali_of_three_degrees_of_freedom() -> None:
    """The published orbits at E = 0.09: powers 0, 0, -2, -4, -6; exponents 0.03 and 0.008."""
    regular = hamsym.chaos_indicators(
        _THREE, _of_energies((0.005, 0.085, 0.0)), (0, 3e4), vectors=6
    )
    assert _slopes(regular, 1e3, power=True) == pytest.approx([0, 0, -2, -4, -6], abs=0.5)
    start = _of_energies((0.03, 0.03, 0.03))
    chaotic = hamsym.chaos_indicators(_THREE, start, (0, 2e3), vectors=6)
    one, two, *_ = hamsym.lyapunov(_THREE, start, (0, 2e3), count=3).exponents[-1]
    rates = [-math.log(v) / 2e3 for v in chaotic.gali[-1]]
    assert rates[:3] == pytest.approx([one - two, 2 * one - two, 3 * one - two], rel=0.15)


# -- independent computation -------------------------------------------------------------------


@pytest.mark.parametrize(
    ("H", "z0", "end"),
    [
        (henon_heiles().H, start_of(ORDERED), 30.0),
        (henon_heiles().H, start_of(CHAOTIC), 30.0),
        (Hamiltonian("p**2/2 - (1 + sin(t)/2)*cos(x)"), np.array([1.0, 0.0]), -25.0),
        pytest.param(
            Hamiltonian("p**2/2*(1 + x**2) + x**4/4 - x**2"),
            np.array([0.5, 0.4]),
            20.0,
            marks=pytest.mark.slow,
        ),
    ],
)
def test_indicators_are_those_of_the_variational_equations(
    H: Hamiltonian, z0: np.ndarray, end: float
) -> None:
    """Definitions as differential equations, with another method."""
    system, dim, J = H.compile("numpy"), H.dim, np.array(H.poisson_matrix, dtype=float)

    def rates(t: float, u: np.ndarray) -> np.ndarray:
        z, v, w = u[: 3 * dim].reshape(3, dim)
        arguments = system.arguments(z, t)
        matrix = J @ system.hessian(*arguments)
        weighted = t * (v @ matrix @ v) / (v @ v)
        megno = 2 * u[-2] / t if t else 0.0
        return np.concatenate(
            (system.vector_field(*arguments), matrix @ v, matrix @ w, [weighted, megno])
        )

    found = hamsym.chaos_indicators(H, z0, (0, end), dt=0.05)
    rows = np.linspace(20, len(found.t) - 1, 10).astype(int)
    v, w = first_vectors(dim, 2, 0).T
    right = scipy.integrate.solve_ivp(
        rates, (0, end * 1.01), np.concatenate((z0, v, w, [0, 0])), "DOP853", found.t[rows],
        rtol=1e-12, atol=1e-12,
    ).y  # fmt: skip
    t = found.t[rows]
    np.testing.assert_allclose(found.megno[rows], 2 * right[-2] / t, atol=1e-5)
    np.testing.assert_allclose(found.mean_megno[rows], right[-1] / t, atol=1e-5)
    v, w = right[dim : 2 * dim], right[2 * dim : 3 * dim]
    v, w = v / np.linalg.norm(v, axis=0), w / np.linalg.norm(w, axis=0)
    sali = np.minimum(np.linalg.norm(v + w, axis=0), np.linalg.norm(v - w, axis=0))
    np.testing.assert_allclose(found.sali[rows], sali, rtol=1e-5)


# -- published orbits --------------------------------------------------------------------------


@pytest.mark.slow
def test_ordered_orbit_has_mean_two_and_vectors_apart() -> None:
    found = hamsym.chaos_indicators(henon_heiles().H, start_of(ORDERED), (0, 1e4))
    assert found.success
    assert found.mean_megno[-1] == pytest.approx(2, abs=0.2)
    assert abs(found.slope) < 1e-3
    assert found.sali.min() > 1e-2
    assert "indistinguishable from a regular one" in found.statement
    assert found.energy_error < 1e-9


@pytest.mark.slow
def test_chaotic_orbit_grows_and_aligns_by_its_exponent() -> None:
    """SALI falls by the difference of the two largest exponents, of which the second is 0."""
    H, start = henon_heiles().H, start_of(CHAOTIC)
    assert start[2] == pytest.approx(0.49974, abs=1e-5)
    found = hamsym.chaos_indicators(H, start, (0, 4e3))
    exponent = hamsym.lyapunov(H, start, (0, 4e3)).maximal
    assert found.slope == pytest.approx(exponent, rel=0.25)
    assert 0.03 < found.slope < 0.08
    assert -np.log(found.sali[-1]) / 4e3 == pytest.approx(exponent, rel=0.05)
    assert "Both indicate chaos over this time" in found.statement
    assert "nothing is proved" in found.statement


@pytest.mark.slow_cases("1", "2")
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_verdict_does_not_depend_on_the_seed(seed: int) -> None:
    H = henon_heiles().H
    ordered = hamsym.chaos_indicators(H, start_of(ORDERED), (0, 2e3), seed=seed)
    chaotic = hamsym.chaos_indicators(H, start_of(CHAOTIC), (0, 2e3), seed=seed)
    assert "indistinguishable from a regular one" in ordered.statement
    assert "Both indicate chaos" in chaotic.statement


def test_same_seed_same_indicators() -> None:
    problem = henon_heiles()
    first, again, other = (
        hamsym.chaos_indicators(problem.H, problem.z0, (0, 100), seed=seed) for seed in (0, 0, 1)
    )
    for name in ("megno", "mean_megno", "sali"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
        assert getattr(first, name)[-1] != getattr(other, name)[-1]


# -- statements --------------------------------------------------------------------------------


def made(mean: np.ndarray, sali: float, H: Hamiltonian | None = None) -> ChaosIndicators:
    t = np.geomspace(1, 1e3, 200)
    H = H or henon_heiles().H
    gali = np.full((200, 1), math.sin(2 * math.asin(sali / 2)))
    return ChaosIndicators(
        t, mean, mean, gali, H, np.zeros(H.dim), (0.0, 1e3), 0.0, "gauss4", 0.1, 1.0,
        success=True, message="",
    )  # fmt: skip


def test_statement_needs_growth_in_proportion_to_time_and_alignment() -> None:
    t = np.geomspace(1, 1e3, 200)
    assert "by an exponent of 0.1, and" in made(0.05 * t, 1e-40).statement
    assert "This is inconclusive" in made(0.05 * t, 0.1).statement
    assert "This is inconclusive" in made(3 + 0 * t, 1e-40).statement
    assert "This is inconclusive" in made(np.full(200, 40.0), 1e-40).statement
    assert "not chaos" in made(0.05 * t, 1e-40, Hamiltonian("p**2/2 - cos(x)")).statement
    assert "This is inconclusive" in made(np.full(200, np.nan), np.nan).statement


# -- failures ----------------------------------------------------------------------------------


def test_too_long_steps_fail() -> None:
    problem = henon_heiles()
    options = {"method": "symplectic_euler", "dt": 0.3}
    found = hamsym.chaos_indicators(problem.H, problem.z0, (0, 1e3), **options)
    assert not found.success
    assert "of its scale: take a smaller dt" in found.message
    assert "However, the run failed" in found.statement


def test_escape_keeps_indicators_before_it() -> None:
    H = Hamiltonian("p**2/2 - x**4/4")
    found = hamsym.chaos_indicators(H, [0.5, 0.5], (0, 20), dt=1e-3)
    assert not found.success
    assert "stopped after t = " in found.message
    assert len(found.t) == len(found.megno) == len(found.mean_megno) == len(found.sali)
    assert all(np.isfinite(v).all() for v in (found.megno, found.mean_megno, found.sali))
    assert found.t[-1] < 20


def test_interruption_keeps_what_was_done(monkeypatch: pytest.MonkeyPatch) -> None:
    calls, original = [], Stepper.step

    def interrupted(self: Stepper, count: int) -> np.ndarray:
        calls.append(1)
        if len(calls) > 200:
            raise KeyboardInterrupt
        return original(self, count)

    problem = henon_heiles()
    monkeypatch.setattr(Stepper, "step", interrupted)
    found = hamsym.chaos_indicators(problem.H, problem.z0, (0, 1e3))
    assert not found.success
    assert found.message.endswith(": interrupted")
    assert 0 < found.t[-1] < 1e3
    assert np.isfinite(found.sali).all()


def test_failure_at_once_is_an_error() -> None:
    with pytest.raises(InputError, match="integration failed at the first steps: the states ov"):
        hamsym.chaos_indicators("p**2/2 - x**4/4", [1e60, 1e60], (0, 1), steps=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"method": "dop853"}, "dop853 is adaptive"),
        ({"method": "tao2"}, "doubled phase space"),
        ({"method": "rk"}, "'rk' is not a method"),
        ({"dt": -1}, "dt=-1"),
        ({"dt": 1e-30}, "dt=1e-30 would take"),
        ({"dt": 0.1, "steps": 9}, "dt"),
        ({"vectors": 1}, "vectors=1"),
        ({"vectors": 5}, "vectors=5 cannot be used; z has 4 components"),
        ({"seed": -1}, "seed=-1 cannot be used; give a whole number from 0"),
        ({"seed": 0.5}, "seed=0.5"),
        ({"z0": [0.3, -0.3, 0.3]}, "4"),
        ({"z0": [np.nan, 0.0, 0.0, 0.0]}, "'x' is not finite in z0"),
        ({"z0": np.zeros((3, 4))}, r"z0 has the shape \(3, 4\); give one start"),
        ({"span": (0, 0)}, "span="),
    ],
)
def test_unusable_options_are_rejected(options: dict[str, object], message: str) -> None:
    problem = henon_heiles()
    given = {"z0": problem.z0, "span": (0, 10), **options}
    with pytest.raises(InputError, match=message):
        hamsym.chaos_indicators(problem.H, **given)


def test_hessian_must_exist_at_the_start() -> None:
    with pytest.raises(InputError, match="the Hessian of H is not finite at z0"):
        hamsym.chaos_indicators("p**2/2 + 1/x", [0.0, 1.0], (0, 1))


# -- figures -----------------------------------------------------------------------------------


@pytest.mark.slow
def test_indicators_are_drawn() -> None:
    problem = henon_heiles()
    found = hamsym.chaos_indicators(problem.H, problem.z0, (0, 500))
    above, below = found.plot().axes
    labels = [line.get_label() for line in above.lines]
    assert labels == ["MEGNO", "its mean", "2, regular motion"]
    np.testing.assert_array_equal(above.lines[1].get_ydata(), found.mean_megno)
    drawn = np.asarray(below.lines[0].get_ydata())
    assert drawn[-1] == found.sali[-1]
    assert drawn.min() == found.sali.min()
    assert len(drawn) < 100 < len(found.sali)


@pytest.mark.parametrize("function", [hamsym.lyapunov, hamsym.chaos_indicators])
def test_steps_over_a_barrier_are_no_success(function):
    barrier = "p**2/2 + x**2/2 + 0.9*exp(-((x - 0.0123456)/1e-7)**2)"
    found = function(barrier, [1, 0], (0, 20))
    assert not found.success
    assert "near t = 1.55845 the force has a feature" in found.message
    assert function(barrier, [1, 0], (0, 1.5)).success


def test_exponents_of_many_starts_are_refused_behind_a_barrier():
    barrier = "p**2/2 + x**2/2 + 0.9*exp(-((x - 0.0123456)/w)**2)"
    found = hamsym.lyapunov(
        barrier, [[1, 0], [0.005, 0], [1, 0]], (0, 20), parameters={"w": [1e-7, 1e-7, 0.3]}
    )
    assert found.success.tolist() == [False, True, True]
    assert "near t = 1.55845 the force has a feature" in found.message[0]
    assert np.isnan(found.exponents[0]).all()


def test_members_that_would_need_another_repetition_are_searched(monkeypatch):
    # The motion reaches 2.3 times the rate for which its steps are chosen, which is good enough.
    monkeypatch.setattr(lyapunov_map, "_REPETITIONS", 0)
    free, starts = "p**2/2 + x**4/4", [[0.3, 1.2], [0.3, 1.2]]
    assert hamsym.lyapunov(free, starts, (0, 1000)).success.all()
    found = hamsym.lyapunov(f"{free} + exp(-((x - 0.5123456)/1e-7)**2)", starts, (0, 1000))
    assert not found.success.any()
    assert "the force has a feature" in found.message[0]


def test_monodromy_does_not_round_the_period_at_a_late_start():
    H = "p**2/2 + x**2/2"
    assert hamsym.monodromy(H, [1, 0], 2 * np.pi, start=1e13).closure < 1e-9
