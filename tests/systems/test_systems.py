"""The catalogue: exact solutions solve the equations, periods are periods."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Collection, Iterable

import numpy as np
import pytest
import sympy

import hamsym
from hamsym import InputError, systems
from hamsym.formula.parser import parse_expression
from hamsym.integrators.adaptive import reference
from hamsym.systems import CATALOGUE, Problem, fermi_pasta_ulam_tsingou

Make = Callable[[], Problem]

#: Arguments other than the usual ones; those that exist are tested like the catalogue itself.
VARIANTS: dict[str, Make] = {
    **{f"toda_chain {n}": lambda n=n: systems.toda_chain(n) for n in (2, 5)},
    **{
        f"calogero_moser {n}, {omega}": lambda n=n, omega=omega: systems.calogero_moser(n, 1, omega)
        for n, omega in ((2, 0.0), (2, 0.3), (3, 0.0), (5, 0.3))
    },
    "calogero_moser, weak": lambda: systems.calogero_moser(g=0.05),
    "calogero_moser, strong": lambda: systems.calogero_moser(g=10.0, omega=3.0),
    **{
        f"driven_oscillator {drive}": lambda drive=drive: systems.driven_oscillator(drive=drive)
        for drive in (0.0, 0.99, 1 - 1e-10, 1.0, 1 + 1e-8, 7.0)
    },
    "driven_oscillator, fast": lambda: systems.driven_oscillator(2.5, 2.5, force=-3.0),
    **{
        f"morse_oscillator from {x}, {p}": lambda x=x, p=p: systems.morse_oscillator(x=x, p=p)
        for x, p in ((-0.6, 0.0), (0.0, 1.0), (0.0, -1.0), (0.0, 0.0), (3.0, 0.0), (6.0, 0.001))
    },
    "morse_oscillator, deep": lambda: systems.morse_oscillator(8.0, 0.5, 1.0, -2.0),
    **{
        f"fermi_pasta_ulam_tsingou {n}, linear": lambda n=n: fermi_pasta_ulam_tsingou(n, 0.0, 0.0)
        for n in (2, 5)
    },
    "coupled_oscillators 5": lambda: systems.coupled_oscillators(5, coupling=2.0),
    "coupled_oscillators 2, unstable": lambda: systems.coupled_oscillators(2, coupling=-0.4),
    "kepler, circle": lambda: systems.kepler(0.0),
    "charged_particle, left": lambda: systems.charged_particle(-2.5),
    **{
        f"lagrange_top {spin}, {tilt}": lambda spin=spin, tilt=tilt: systems.lagrange_top(
            0.3, 0.7, spin, tilt
        )
        for spin, tilt in ((0.1, 0.3), (1.0, 3.0), (6.0, 1.5))
    },
    **{
        f"paul_trap {a}, {q}": lambda a=a, q=q: systems.paul_trap(a, q)
        for a, q in ((0.0, 0.1), (-0.05, 0.6), (0.0, -0.8))
    },
    **{f"point_vortices {n}": lambda n=n: systems.point_vortices(n) for n in (2, 7)},
    "penning_trap, weak": lambda: systems.penning_trap(3.0, 2.0),
}
ALL = CATALOGUE | VARIANTS
# Lists of names: each process that collects the tests would take seconds to build all systems.
_INEXACT = {
    *("arenstorf", "argon_crystal"),
    *("double_pendulum", "driven_duffing", "fermi_pasta_ulam_tsingou", "henon_heiles"),
    *("halo_orbits", "kovalevskaya_top", "lennard_jones", "pleiades", "restricted_three_bodies"),
    *("spring_pendulum", "stormer", "swinging_atwood", "three_bodies"),
}
_LARGE = {"argon_crystal", "pleiades"}
_HARD = {"kovalevskaya_top", "lennard_jones", *_LARGE}  # to prove
EXACT = [name for name in ALL if name not in _INEXACT]
CONSERVING = [name for name in EXACT if not name.startswith((
    "driven_oscillator 0.0", "harmonic", "morse", "nonlinear", "paul", "pendulum"
))] + [
    *("argon_crystal", "kovalevskaya_top", "lennard_jones", "pleiades"),
    *("swinging_atwood", "three_bodies"),
]  # fmt: skip
PERIODIC = [
    *("calogero_moser", "charged_particle", "harmonic_oscillator", "kepler", "morse_oscillator"),
    *("nonlinear_oscillator", "pendulum", "point_vortices"),
    pytest.param("three_bodies", marks=pytest.mark.slow),
]


def marked(names: Iterable[str], slow: Collection[str] = _LARGE) -> list[object]:
    """Parameters of a test, marked where it is slow."""
    return [pytest.param(name, marks=pytest.mark.slow if name in slow else ()) for name in names]


@functools.cache
def made(name: str) -> Problem:
    return ALL[name]()


@pytest.mark.slow
def test_lists_of_names_are_complete() -> None:
    assert {name for name in ALL if made(name).exact} == set(EXACT)
    assert {name for name in ALL if made(name).conserved} == set(CONSERVING)
    periodic = {name for name in CATALOGUE if made(name).period is not None}
    assert periodic == {*PERIODIC[:-1], "three_bodies", "arenstorf", "halo_orbits"}


@pytest.mark.parametrize("name", CATALOGUE)
def test_start_and_span_are_valid(name: str) -> None:
    problem = made(name)
    assert problem.H.unbound_parameters == ()
    assert problem.H.state_from(problem.z0).shape == (problem.H.dim,)
    assert problem.span[1] > problem.span[0]
    assert problem.source


@pytest.mark.parametrize("e", [0.0, 0.3, 0.6, 0.9, 0.95, 0.99, 0.9999])
def test_kepler_equation_solved_at_any_time(e: float) -> None:
    mean = np.linspace(-math.pi, math.pi, 4_001)[1:-1]
    low, high = mean - 1.0, mean + 1.0
    for _ in range(80):
        middle = (low + high) / 2
        below = middle - e * np.sin(middle) < mean
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    position = np.stack((np.cos(low) - e, math.sqrt(1 - e * e) * np.sin(low)), axis=-1)
    found = systems.kepler(e).exact(mean + 2 * math.pi)[:, :2]
    np.testing.assert_allclose(found, position, atol=3e-14 / (1 - e))


@pytest.mark.parametrize("name", [name for name in CATALOGUE if name not in _INEXACT])
def test_exact_solution_solves_the_equations(name: str) -> None:
    problem = made(name)
    truth = problem.exact
    assert truth(np.linspace(*problem.span, 7)).shape == (7, problem.H.dim)
    np.testing.assert_allclose(truth(np.array([0.0]))[0], problem.z0, atol=1e-14)
    t = np.linspace(*problem.span, 41)[1:-1]
    h = 1e-3
    slope = (8 * (truth(t + h) - truth(t - h)) - (truth(t + 2 * h) - truth(t - 2 * h))) / (12 * h)
    system = problem.H.compile("numpy")
    flow = system.vector_field(*system.arguments(truth(t), t))
    np.testing.assert_allclose(slope, flow, atol=1e-8)


@pytest.mark.parametrize("end", [1, -1], ids=["forwards", "backwards"])
@pytest.mark.parametrize("name", EXACT)
def test_exact_solution_agrees_with_integration(name: str, end: int) -> None:
    problem = made(name)
    span = (0.0, end * problem.span[1])
    t = np.linspace(*span, 201)
    truth = hamsym.solve(problem.H, problem.z0, span, tol=1e-11)
    with np.errstate(all="raise", under="ignore"):
        z = problem.exact(t)
    np.testing.assert_allclose(z, truth(t), rtol=0, atol=1e-10)
    if name != "morse_oscillator from 0.0, 0.0":
        assert np.abs(z - problem.z0).max() > 0.1


@pytest.mark.parametrize("name", EXACT)
def test_exact_solution_of_any_number_of_times(name: str) -> None:
    problem = made(name)
    z = problem.exact(np.array([1.0, 2.0]))
    assert problem.exact(np.array([])).shape == (0, problem.H.dim)
    np.testing.assert_allclose(problem.exact(np.array([2.0])), z[1:], rtol=0, atol=1e-14)
    np.testing.assert_allclose(problem.exact(np.array(2)), z[1], rtol=0, atol=1e-14)


# -- first integrals -----------------------------------------------------------------------------


def random_point(problem: Problem) -> dict[sympy.Symbol, sympy.Float]:
    """A state near the start, a time, and the values of the parameters, in 50 digits."""
    H = problem.H
    state = np.array(problem.z0) + 0.2 * np.random.default_rng(3).normal(size=H.dim)
    values = dict(zip(H.names, state.tolist(), strict=True)) | dict(H.parameters) | {"t": 1.7}
    return {sympy.Symbol(name, real=True): sympy.Float(v, 50) for name, v in values.items()}


def rate(problem: Problem, formula: str, point: dict[sympy.Symbol, sympy.Float]) -> float:
    """How fast a function of the state and the time changes along the trajectory there."""
    f = parse_expression(formula)
    change = problem.H.poisson_bracket(f, problem.H.expr) + f.diff(sympy.Symbol("t", real=True))
    return abs(float(change.xreplace(point)))


def slopes(problem: Problem, f: sympy.Expr, point: dict[sympy.Symbol, sympy.Float]) -> list[float]:
    return [float(f.diff(symbol).xreplace(point)) for symbol in problem.H.z]


@pytest.mark.slow_cases(
    "coupled_oscillators 5",
    "calogero_moser 5, 0.3",
    "fermi_pasta_ulam_tsingou 5, linear",
    "point_vortices 7",
    "toda_chain 5",
)
@pytest.mark.sampled(12)
@pytest.mark.parametrize("name", marked(CONSERVING))
def test_conserved_quantities_are_independent_integrals(name: str) -> None:
    problem = made(name)
    point = random_point(problem)
    of_H = slopes(problem, problem.H.expr, point)
    for formula in problem.conserved:
        assert rate(problem, formula, point) < 1e-25
        assert rate(problem, f"{formula} + {problem.H.names[0]}/1000", point) > 1e-6
        # Neither a number nor a function of H.
        of_f = slopes(problem, parse_expression(formula), point)
        assert np.linalg.matrix_rank(np.array([of_f, of_H]), tol=1e-6) == 2


@pytest.mark.parametrize("name", marked([n for n in CONSERVING if n in CATALOGUE], _HARD))
def test_conserved_quantities_are_proved(name: str) -> None:
    """Symbolically, with the parameters as exact numbers."""
    problem = made(name)
    values = {
        sympy.Symbol(parameter, real=True): sympy.Rational(str(value))
        for parameter, value in problem.H.parameters.items()
    }
    half = problem.H.dof
    H = hamsym.Hamiltonian(
        parse_expression(problem.H.formula).subs(values),
        q=problem.H.names[:half],
        p=problem.H.names[half:],
    )
    for formula in problem.conserved:
        assert H.is_conserved(parse_expression(formula).subs(values))


@pytest.mark.parametrize("name", ["kepler", "charged_particle", "toda_chain"])
def test_conserved_for_all_parameters(name: str) -> None:
    problem = made(name)
    assert problem.conserved
    assert all(problem.H.is_conserved(formula) for formula in problem.conserved)


@pytest.mark.slow_cases("toda_chain-4", "coupled_oscillators-4")
@pytest.mark.parametrize("n", [2, 3, 4])
@pytest.mark.parametrize("make", [systems.toda_chain, systems.coupled_oscillators])
def test_chains_are_integrable(make: Callable[[int], Problem], n: int) -> None:
    """As many first integrals as pairs, independent and in involution."""
    problem = make(n)
    assert len(problem.conserved) == n - 1
    point = random_point(problem)
    integrals = [problem.H.expr, *map(parse_expression, problem.conserved)]
    gradients = np.array([slopes(problem, f, point) for f in integrals])
    assert np.linalg.matrix_rank(gradients, tol=1e-6) == n
    for f in integrals:
        for g in integrals:
            assert abs(float(problem.H.poisson_bracket(f, g).xreplace(point))) < 1e-25


@pytest.mark.slow
def test_long_chains_are_not_written_out() -> None:
    assert systems.toda_chain(13).exact is None
    assert len(systems.toda_chain(13).conserved) == 5
    assert systems.coupled_oscillators(13).conserved == ()
    assert len(systems.coupled_oscillators(12).conserved) == 11


# -- periods, parameters -------------------------------------------------------------------------


@pytest.mark.parametrize("name", PERIODIC)
def test_orbit_closes_after_its_period(name: str) -> None:
    problem = made(name)
    truth = reference(problem.H, problem.z0, (0.0, problem.period))
    np.testing.assert_allclose(truth(np.array([problem.period]))[0], problem.z0, atol=1e-9)
    halfway = truth(np.array([problem.period / 2]))[0]
    assert np.abs(halfway - problem.z0).max() > 0.1


@pytest.mark.parametrize(
    ("x", "p"), [(1.3, 1.0), (1.3, -1.0), (-1.3, 1.0), (-1.3, -1.0), (1.0, 0.0), (0.0, 1.0)]
)
def test_oscillator_from_every_quadrant(x: float, p: float) -> None:
    problem = systems.nonlinear_oscillator(x, p)
    t = np.linspace(0, 20, 201)
    truth = reference(problem.H, np.array([x, p]), (0.0, 20.0))
    np.testing.assert_allclose(problem.exact(t), truth(t), atol=1e-10)


@pytest.mark.parametrize("n", [1, 2, 12])
def test_chains_of_any_length_are_in_natural_order(n: int) -> None:
    problem = systems.coupled_oscillators(n)
    assert problem.H.names[:n] == tuple(f"q{i}" for i in range(1, n + 1))
    truth = reference(problem.H, problem.z0, problem.span)
    t = np.linspace(*problem.span, 50)
    np.testing.assert_allclose(problem.exact(t), truth(t), atol=1e-10)


@pytest.mark.parametrize("eccentricity", [0.0, 0.6, 0.99])
def test_kepler_for_every_ellipse(eccentricity: float) -> None:
    problem = systems.kepler(eccentricity)
    t = np.linspace(-7, 7, 101)
    z = problem.exact(t)
    energy = problem.H.compile("numpy").energy(z)
    np.testing.assert_allclose(energy, -0.5, atol=1e-10)


def test_kepler_default_orbit() -> None:
    problem = systems.kepler()
    np.testing.assert_allclose(problem.z0, (0.4, 0, 0, 2))
    assert problem.period == pytest.approx(2 * math.pi)


@pytest.mark.parametrize("x", [1e-3, 1.5, 6.0, 16.0])
def test_morse_oscillator_at_extreme_energies(x: float) -> None:
    problem = systems.morse_oscillator(x=x)
    t = np.linspace(0, problem.period, 1001)
    z = problem.exact(t)
    energy = (1 - math.exp(-x)) ** 2
    np.testing.assert_allclose(problem.H.compile("numpy").energy(z), energy, rtol=1e-11)
    np.testing.assert_allclose(z[-1], problem.z0, atol=1e-10)
    assert z[:, 0].min() == pytest.approx(-math.log(1 + math.sqrt(energy)), rel=1e-9)


@pytest.mark.parametrize("drive", [1 - 1e-9, 1 + 1e-9, 1 - 1e-15, 1 + 1e-13])
def test_driven_oscillator_continuous_at_resonance(drive: float) -> None:
    t = np.linspace(-30, 30, 601)
    resonance = systems.driven_oscillator(drive=1.0).exact(t)
    near = systems.driven_oscillator(drive=drive).exact(t)
    # The phases of the drives differ by (drive - 1) t at time t.
    assert np.abs(near - resonance).max() < 30**2 * abs(drive - 1) + 1e-13
    assert np.abs(resonance[:, 0]).max() > 6


@pytest.mark.parametrize("which", ["alpha", "beta"])
def test_weakly_nonlinear_chain_tends_to_harmonic_one(which: str) -> None:
    linear = fermi_pasta_ulam_tsingou(alpha=0.0, beta=0.0)
    t = np.linspace(*linear.span, 101)
    distances = []
    for value in (1e-4, 2e-4):
        problem = fermi_pasta_ulam_tsingou(**{"alpha": 0.0, "beta": 0.0, which: value})
        assert (problem.exact, problem.period, problem.conserved) == (None, None, ())
        z = reference(problem.H, problem.z0, problem.span)(t)
        distances.append(np.abs(z - linear.exact(t)).max())
    assert distances[0] > 1e-5
    assert distances[1] / distances[0] == pytest.approx(2, rel=0.01)


def test_spring_pendulum_is_in_resonance() -> None:
    hessian = systems.spring_pendulum().H.compile("numpy").hessian([0.0, -1.0, 0.0, 0.0])
    np.testing.assert_allclose(hessian[:2, :2], np.diag([1.0, 4.0]), atol=1e-14)
    rates = systems.spring_pendulum().H.compile("numpy").vector_field([0.0, -1.0, 0.0, 0.0])
    np.testing.assert_allclose(rates, 0, atol=1e-14)


@pytest.mark.parametrize(
    "make",
    [
        lambda: systems.pendulum(4.0),
        lambda: systems.pendulum(0.0),
        lambda: systems.kepler(1.0),
        lambda: systems.kepler(-0.1),
        lambda: systems.coupled_oscillators(0),
        lambda: systems.coupled_oscillators(2.0),  # type: ignore[arg-type]
        lambda: fermi_pasta_ulam_tsingou(1),
        lambda: fermi_pasta_ulam_tsingou(True),
        lambda: systems.toda_chain(1),
        lambda: systems.toda_chain(3.0),  # type: ignore[arg-type]
        lambda: systems.calogero_moser(1),
        lambda: systems.calogero_moser(g=0.0),
        lambda: systems.calogero_moser(omega=-1.0),
        lambda: systems.calogero_moser(omega=math.inf),
        lambda: systems.morse_oscillator(depth=0.0),
        lambda: systems.morse_oscillator(a=-1.0),
        lambda: systems.morse_oscillator(depth=1.0, x=0.0, p=math.sqrt(2)),  # energy D
        lambda: systems.morse_oscillator(x=-0.7),
        lambda: systems.morse_oscillator(x=-1e6),
        lambda: systems.morse_oscillator(x=1e6),
        lambda: systems.morse_oscillator(p=1e200),
        lambda: systems.morse_oscillator(x=math.nan),
        lambda: systems.driven_oscillator(omega=0.0),
        lambda: systems.driven_oscillator(drive=-1.0),
        lambda: systems.driven_oscillator(drive=math.nan),
        lambda: systems.spring_pendulum(stiffness=0.0),
        lambda: systems.spring_pendulum(length=-1.0),
        lambda: systems.spring_pendulum(gravity=math.inf),
        lambda: systems.harmonic_oscillator(omega=0.0),
        lambda: systems.harmonic_oscillator(omega=math.inf),
        lambda: systems.nonlinear_oscillator(x=0.0, p=0.0),
        lambda: systems.nonlinear_oscillator(x=1e200),
        lambda: systems.nonlinear_oscillator(p=math.nan),
        lambda: systems.charged_particle(field=0.0),
        lambda: systems.charged_particle(field=math.nan),
        lambda: systems.henon_heiles("E = 1"),
        lambda: systems.driven_duffing(force=math.inf),
        lambda: systems.driven_duffing(drive=0.0),
        lambda: systems.swinging_atwood(1.0),
        lambda: systems.swinging_atwood(math.nan),
        lambda: systems.restricted_three_bodies(0.0),
        lambda: systems.restricted_three_bodies(0.51),
        lambda: systems.restricted_three_bodies(math.nan),
        lambda: systems.arenstorf("four loops"),
        lambda: systems.halo_orbits("L6"),
        lambda: systems.penning_trap(2.0, 1.5),
        lambda: systems.penning_trap(-5.0, 2.0),
        lambda: systems.penning_trap(math.nan),
        lambda: systems.paul_trap(0.0, 0.91),
        lambda: systems.paul_trap(-0.1, 0.4),
        lambda: systems.paul_trap(0.0, 0.0),
        lambda: systems.paul_trap(math.nan),
        lambda: systems.lennard_jones(1),
        lambda: systems.lennard_jones(21),
        lambda: systems.point_vortices(1),
        lambda: systems.point_vortices(start="square"),
        lambda: systems.lagrange_top(axial=0.0),
        lambda: systems.lagrange_top(spin=0.0),
        lambda: systems.lagrange_top(weight=-1.0),
        lambda: systems.lagrange_top(tilt=0.0),
        lambda: systems.lagrange_top(tilt=3.2),
        lambda: systems.kepler("a"),  # type: ignore[arg-type]
        lambda: systems.pendulum(amplitude=None),  # type: ignore[arg-type]
        lambda: systems.morse_oscillator(x=10**400),
        lambda: systems.driven_oscillator(drive=10**400),
    ],
)
def test_unusable_arguments_are_rejected(make: object) -> None:
    with pytest.raises(InputError, match="cannot be used; give"):
        make()  # type: ignore[operator]


def test_catalogue_lists_every_public_function() -> None:
    public = {name for name in systems.__all__ if name[0].islower()}
    assert public == set(CATALOGUE)
