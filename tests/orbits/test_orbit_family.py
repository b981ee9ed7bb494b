"""Families of periodic orbits against exact families and published bifurcations."""

import math

import mpmath
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import hamsym
from hamsym.errors import InputError
from tests.orbits.test_periodic_orbit import DUFFING, HENON_HEILES, RESTRICTED, duffing_period


def amplitude_of(energy):
    return math.sqrt(math.sqrt(1 + 4 * energy) - 1)


@pytest.mark.slow
def test_family_of_an_oscillator_has_the_exact_periods():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    family = orbit.family(energy=4.0)
    assert family.success
    assert family[0] is orbit
    assert family.energies[-1] == pytest.approx(4.0, abs=1e-14)
    assert np.all(np.diff(family.energies) > 0)
    exact = [float(duffing_period(amplitude_of(energy))) for energy in family.energies]
    assert family.periods == pytest.approx(exact, rel=1e-12)
    assert not [found for found in family.bifurcations if "period" not in found.kind]


@pytest.mark.slow
def test_family_goes_down_too_and_to_a_period():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    assert orbit.family(energy=0.2).energies[-1] == pytest.approx(0.2, abs=1e-15)
    target = float(duffing_period(0.5))
    family = orbit.family(period=target)
    assert family.success
    assert family.energies[-1] == pytest.approx(0.5**2 / 2 + 0.5**4 / 4, rel=1e-10)


@pytest.mark.slow
def test_bifurcations_of_the_straight_orbit_of_henon_heiles():
    # Brack, Bifurcation cascades and self-similarity of periodic orbits with analytical scaling
    # constants in Henon-Heiles type potentials (2001): 0.969309 and 0.986709 of 1/6
    start = HENON_HEILES.state_at_energy(0.159, {"x": 0, "y": 0, "p_x": 0})
    orbit = hamsym.periodic_orbit(HENON_HEILES, start, energy=0.159)
    family = orbit.family(energy=0.1646, max_step=0.1)
    assert family.success
    branchings = [b.orbit.energy * 6 for b in family.bifurcations if b.kind == "branching"]
    assert branchings == pytest.approx([0.969309, 0.986709], abs=1e-6)


@pytest.mark.slow
def test_period_doubling_is_where_the_trace_says():
    start = HENON_HEILES.state_at_energy(0.13, {"x": 0, "y": 0, "p_x": 0})
    orbit = hamsym.periodic_orbit(HENON_HEILES, start, energy=0.13)
    (found,) = orbit.family(energy=0.14).bifurcations
    assert found.kind == "period doubling"
    assert np.trace(found.orbit.monodromy) == pytest.approx(0.0, abs=1e-6)
    # the doubled multiplier by an independent computation
    other = hamsym.monodromy(HENON_HEILES, found.orbit.z0, found.orbit.period)
    assert np.trace(other.matrix) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.slow
def test_family_in_a_parameter_has_the_exact_periods():
    H = hamsym.Hamiltonian("p**2/2 + k*x**2/2 + x**4/4", parameters={"k": 1.0})
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0], energy=0.75)
    family = orbit.family(parameter=("k", 2.0))
    assert family.success
    assert family.parameter == "k"
    assert family.values[-1] == 2.0
    assert family.energies == pytest.approx(np.full(len(family), 0.75), abs=1e-12)
    # k x^2/2 + x^4/4 = E with amplitude a: scaled to k = 1
    a = math.sqrt(math.sqrt(4 + 4 * 0.75) - 2) / math.sqrt(2.0)
    expected = float(duffing_period(a)) / math.sqrt(2.0)
    assert family.periods[-1] == pytest.approx(expected, rel=1e-11)


@pytest.mark.slow
def test_fold_of_a_driven_oscillator_is_passed():
    # harmonic balance for the branch out of phase: F = (w^2 - 1) A - 3 A^3/4
    H = hamsym.Hamiltonian("p**2/2 + x**2/2 + x**4/4 - F*x*cos(1.6*t)", parameters={"F": 0.5})
    orbit = hamsym.periodic_orbit(H, [-0.35, 0.0], period="2*pi/1.6")
    family = orbit.family(parameter=("F", 1.0), max_orbits=30)
    assert not family.success  # there is no orbit out of phase with so large a force
    fold = family.bifurcations[0]
    assert fold.kind == "fold of F"
    value = fold.orbit.H.parameters["F"]
    amplitude = math.sqrt(4 * (1.6**2 - 1) / 9)
    expected = (1.6**2 - 1) * amplitude - 0.75 * amplitude**3
    assert value == pytest.approx(expected, rel=0.01)
    assert family.values.max() <= value + 1e-9
    assert family.values[-1] < 0.5 * value  # beyond the fold
    assert np.abs(fold.orbit.multipliers - 1).max() < 0.1
    assert fold.uncertainty < 0.02


@pytest.mark.slow
def test_lyapunov_family_grows_from_the_libration_point():
    H = hamsym.Hamiltonian(RESTRICTED, parameters={"mu": 0.0121505856})
    guess = ([0.8319, 0.0, 0.0, 0.8738], 2.7)
    orbit = hamsym.periodic_orbit(H, guess, symmetry={"y": "-y", "p_x": "-p_x"})
    family = orbit.family(energy=-1.56)
    assert family.success
    assert set(family.stabilities) == {"hyperbolic"}
    assert np.all(np.diff(family.periods) > 0)
    end = family[-1]
    assert hamsym.monodromy(H, end.z0, end.period, tol=1e-10).closure < 1e-6


@pytest.mark.slow
def test_family_that_does_not_reach_its_target_says_so():
    orbit = hamsym.periodic_orbit("p**2/2 - cos(x)", [1.0, 0.0])
    family = orbit.family(energy=1.5, max_orbits=60)  # beyond the separatrix
    assert not family.success
    assert "not reached" in family.message or "ends" in family.message
    assert family.energies.max() < 1.0
    assert all(member.success for member in family)


@pytest.mark.slow
def test_family_ends_at_an_equilibrium_without_bifurcations():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    family = orbit.family(energy=-1.0)
    assert not family.success
    assert family.message == "the family ends at an equilibrium"
    assert family.bifurcations == ()
    assert abs(family[-1].period - 2 * math.pi) < 1e-9


@pytest.mark.slow
def test_fold_of_the_period_is_where_the_exact_period_is_extremal():
    def period(a):
        # V(a) - V(a s) = (1 - s^2) g(s^2), with s = sin(phase)
        def rate(phase):
            s = mpmath.sin(phase) ** 2
            return 1 - a**2 * 6 * (1 + s) / 10 + a**4 * (1 + s + s**2) / 5

        return 4 * mpmath.quad(lambda phase: 1 / mpmath.sqrt(rate(phase)), [0, mpmath.pi / 2])

    exact = mpmath.findroot(lambda a: mpmath.diff(period, a), (1.0, 1.2))
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 - 3*x**4/10 + x**6/10", [0.5, 0.0])
    family = orbit.family(energy=3.0)
    assert [found.kind for found in family.bifurcations] == ["fold of the period"]
    energy = exact**2 / 2 - 3 * exact**4 / 10 + exact**6 / 10
    assert abs(family.bifurcations[0].orbit.energy - energy) < 1e-6
    assert abs(family.bifurcations[0].orbit.period - period(exact)) < 1e-9


@pytest.mark.slow
def test_driven_orbit_is_not_continued_beyond_its_period():
    H = hamsym.Hamiltonian(
        "p**2/2 + x**2/2 + x**4/4 - F*x*cos(w*t)", parameters={"F": 0.1, "w": 1.1}
    )
    orbit = hamsym.periodic_orbit(H, [0.3, 0.0], period=2 * math.pi / 1.1)
    assert orbit.family(parameter=("F", 0.2)).success
    assert not orbit.family(parameter=("w", 1.2)).success


@pytest.mark.slow
def test_family_is_a_sequence():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    family = orbit.family(energy=0.9)
    assert len(list(family)) == len(family) == len(family.periods)
    assert family[1:3] == family.orbits[1:3]
    assert "bifurcations" in repr(family)
    with pytest.raises(InputError, match="no parameter"):
        _ = family.values


#: A tongue of width 0.01 in a, in which orbits along x are unstable across.
TONGUE = "(p_x**2 + p_y**2)/2 + x**2/2 + x**4/4 + a*y**2/2 + x**2*y**2/100 + y**4/4"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "last", "max_step"),
    [(1.6, 1.9, 0.3), (1.6, 1.9, 0.01), (1.72, 1.734, 0.3), (1.7, 1.725, 0.3)],
)
def test_two_bifurcations_between_neighbours_are_not_skipped(first, last, max_step):
    period = float(duffing_period(1.0))

    def trace(a):
        def rates(_, z):
            x, p, *across = z
            y = np.reshape(across, (2, 2))
            return [p, -x - x**3, *y[1], *(-(a + 0.02 * x**2) * y[0])]

        start = [1.0, 0.0, 1.0, 0.0, 0.0, 1.0]
        found = solve_ivp(rates, (0, period), start, method="DOP853", rtol=1e-12, atol=1e-14)
        return found.y[2, -1] + found.y[5, -1]

    edges = [brentq(lambda a: trace(a) - 2, *pair) for pair in ((1.715, 1.727), (1.727, 1.74))]
    H = hamsym.Hamiltonian(TONGUE, parameters={"a": first})
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0])
    family = orbit.family(parameter=("a", last), max_step=max_step)
    assert family.success
    assert {found.kind for found in family.bifurcations} == {"branching"}
    # none beyond the target
    expected = [edge for edge in edges if edge < last]
    places = [found.orbit.H.parameters["a"] for found in family.bifurcations]
    assert places == pytest.approx(expected, abs=1e-7)


@pytest.mark.slow
def test_multipliers_that_touch_one_are_no_bifurcations():
    H = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2)/2 + x**2/2 + x**4/4 + a*y**2/2", parameters={"a": 1.6}
    )
    family = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0]).family(parameter=("a", 1.9))
    assert family.success
    assert not family.bifurcations


def test_family_ends_where_a_step_meets_the_target():
    H = hamsym.Hamiltonian("p**2/2 + a*x**2/2 + x**4/4", parameters={"a": 1.0})
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0])
    met = orbit.family(parameter=("a", 1.2), max_orbits=3).values[-1]
    family = orbit.family(parameter=("a", met))
    assert family.success
    assert family.values[-1] == met
    assert len(family) == 3


@pytest.mark.parametrize(
    ("target", "message"),
    [
        ({}, "one of energy"),
        ({"energy": 1.0, "period": 2.0}, "one of energy"),
        ({"energy": math.nan}, "energy"),
        ({"period": -1.0}, "period"),
        ({"parameter": "mu"}, "pair"),
        ({"parameter": ("mu", 1.0)}, "no parameter 'mu'"),
        ({"energy": 1.0, "max_orbits": 0}, "max_orbits"),
        ({"energy": 1.0, "max_step": 0}, "max_step"),
    ],
)
def test_bad_input_is_refused(target, message):
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    with pytest.raises(InputError, match=message):
        orbit.family(**target)


def test_families_need_orbits():
    with pytest.raises(InputError, match="PeriodicOrbit"):
        hamsym.orbit_family("orbit", energy=1.0)
    failed = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], tol=1e-17)
    with pytest.raises(InputError, match="did not succeed"):
        failed.family(energy=1.0)


def test_exact_period_by_elliptic_integrals_is_that_of_quadrature():
    # the reference itself, by another formula
    with mpmath.workdps(20):
        a = mpmath.mpf(2)
        energy = a**2 / 2 + a**4 / 4
        # x = a sin(s) removes the singularity
        quarter = mpmath.quad(
            lambda s: (
                a
                * mpmath.cos(s)
                / mpmath.sqrt(2 * energy - (a * mpmath.sin(s)) ** 2 - (a * mpmath.sin(s)) ** 4 / 2)
            ),
            [0, mpmath.pi / 2 - mpmath.mpf(10) ** -12],
        )
    assert float(4 * quarter) == pytest.approx(float(duffing_period(2.0)), rel=1e-9)


@pytest.mark.parametrize("unit", [2.0**-70, 2.0**60])
@pytest.mark.parametrize("term", ["e*x**4", "e*y**2*(1 + x)"])
def test_a_parameter_has_a_unit(term: str, unit: float) -> None:
    """Its effect begins at zero, or is none on the orbits, and on their stability alone."""
    formula = f"c*((p_x**2 + p_y**2)/c**2 + x**2 + 2*y**2)/2 + {term}"
    families = []
    for c in (1.0, unit):
        H = hamsym.Hamiltonian(formula, parameters={"c": c, "e": 0.0})
        orbit = hamsym.periodic_orbit(H, ([1.0, 0.0, 0.0, 0.0], 6.28))
        families.append(orbit.family(parameter=("e", 0.05 * c), max_orbits=12, max_step=0.1))
    np.testing.assert_allclose(families[1].values / unit, families[0].values, rtol=1e-6)
