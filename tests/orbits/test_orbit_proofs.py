"""Proofs of periodic orbits against exact orbits; what is false or undecidable is refused."""

import dataclasses
import json
import math

import mpmath
import numpy as np
import pytest
import sympy

import hamsym
from hamsym.errors import CertificationError, FileError
from hamsym.numerics.collocation import collocation
from hamsym.orbits.proven_stability import WEAKER, proven_stability
from hamsym.orbits.symmetry import SignedPermutation, closing_of
from hamsym.proof.limits import Deadline
from hamsym.support.sealed_text import sealed
from hamsym.symbolic.exact import fraction
from tests.orbits.test_periodic_orbit import (
    ACROSS,
    DUFFING,
    EIGHT,
    HENON_HEILES,
    RESTRICTED,
    eight_symmetries,
    three_bodies,
)

flint = pytest.importorskip("flint")

from hamsym.orbits import proof  # noqa: E402
from hamsym.orbits.period import in_units_of_the_arc  # noqa: E402
from hamsym.orbits.square_system import SquareSystem  # noqa: E402


def contains(ball, value):
    """Whether a ball of one number contains an mpmath number."""
    with mpmath.workdps(60):
        return abs(value - mpmath.mpf(ball.mid)) <= mpmath.mpf(ball.radius)


def exact_period(amplitude):
    with mpmath.workdps(60):
        a = mpmath.mpf(amplitude) ** 2
        return 4 * mpmath.ellipk(a / (2 * (1 + a))) / mpmath.sqrt(1 + a)


@pytest.mark.slow_cases("plain-0.0625", "plain-3.5", "reversing-1.0", "reversing-40.0")
@pytest.mark.parametrize("amplitude", [0.0625, 1.0, 3.5, 40.0])
@pytest.mark.parametrize("symmetry", [None, {"p": "-p"}], ids=["plain", "reversing"])
def test_exact_orbit_is_in_the_proven_balls(amplitude, symmetry):
    # these amplitudes have an energy that is a float64 number
    energy = amplitude**2 / 2 + amplitude**4 / 4
    orbit = hamsym.periodic_orbit(DUFFING, [amplitude, 0.0], energy=energy, symmetry=symmetry)
    certificate = orbit.certify()
    assert contains(certificate.period, exact_period(amplitude))
    assert certificate.period.radius < 1e-13 * orbit.period
    if symmetry is not None:
        assert certificate.z0.contains([amplitude, 0.0])
    assert certificate.bound < 1e-13 < certificate.unique_within
    assert f"energy {energy!r}" in certificate.statement


@pytest.mark.slow_cases("-0.3", "0.3")
@pytest.mark.parametrize("square", [0.3, -0.3, 2.0])
def test_exact_multipliers_are_in_the_proven_matrix(square):
    # along y = 0 the second oscillator is linear
    H = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2)/2 + x**2/2 + x**4/4 + w*y**2/2", parameters={"w": square}
    )
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0], energy=0.75)
    certificate = orbit.certify()
    assert certificate.stability == ("elliptic" if square > 0 else "hyperbolic")
    assert certificate.stability in certificate.statement
    with mpmath.workdps(60):
        phase = mpmath.sqrt(mpmath.mpf(square)) * exact_period(1.0)
        expected = mpmath.re(mpmath.cos(phase))
    entry = hamsym.Ball(certificate.monodromy.mid[1, 1], certificate.monodromy.radius[1, 1])
    assert contains(entry, expected)


def test_stability_is_not_claimed_at_a_resonance():
    # y oscillates exactly twice as fast as the linear x: a multiplier 1 besides the trivial ones
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + x**2/2 + 2*y**2")
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0], symmetry={"y": "-y", "p_y": "-p_y"})
    assert not orbit.is_isolated or orbit.certify().stability == "undecided"


@pytest.mark.slow_cases(
    "start2-symmetry2-0.08333333333333333",
    "start1-symmetry1-0.08333333333333333",
    "start1-symmetry1-0.12",
    "start0-symmetry0-0.08333333333333333",
    "start2-symmetry2-0.12",
)
@pytest.mark.parametrize("energy", [1 / 12, 0.12])
@pytest.mark.parametrize(
    ("start", "symmetry"),
    [([0, -0.4, 0.25, 0], ACROSS), ([0, -0.15, 0.35, 0], ACROSS), ([0, 0.25, 0.34, 0], ACROSS)],
)
def test_orbits_of_henon_heiles_are_proven(energy, start, symmetry):
    orbit = hamsym.periodic_orbit(HENON_HEILES, start, energy=energy, symmetry=symmetry)
    certificate = orbit.certify()
    assert certificate.bound < 1e-13
    assert certificate.stability == orbit.stability
    # The same orbit by the other system of equations, without the symmetry.
    whole = hamsym.periodic_orbit(HENON_HEILES, (orbit.z0, orbit.period), energy=energy).certify()
    assert np.all(np.abs(whole.z0.mid - certificate.z0.mid) <= 1e-12)
    gap = abs(whole.period.mid - certificate.period.mid)
    assert gap <= whole.period.radius + certificate.period.radius
    other = hamsym.enclose(HENON_HEILES, certificate.z0, (0.0, certificate.period.mid))
    assert np.abs(other(certificate.period.mid).mid - orbit.z0).max() < 1e-11
    difference = np.abs(other.derivative(certificate.period.mid).mid - certificate.monodromy.mid)
    assert difference.max() < 1e-9


def test_driven_orbit_is_proven_for_its_exact_period():
    H = hamsym.Hamiltonian(
        "p**2/2 - x**2/2 + x**4/4 - F*x*cos(omega*t)", parameters={"F": 0.1, "omega": 1.1}
    )
    certificate = hamsym.periodic_orbit(H, [1.1, 0.0], period="2*pi/omega").certify()
    assert certificate.stability == "elliptic"
    with mpmath.workdps(40):
        assert contains(certificate.period, 2 * mpmath.pi / mpmath.mpf(1.1))
    forced = hamsym.periodic_orbit(H, [1.1, 0.0], period=2 * math.pi / 1.1)
    assert forced.success
    with pytest.raises(CertificationError, match="exact period"):
        forced.certify()


def test_a_statement_has_the_floats_that_are_proven():
    # exp(0.3*x - 3000) at x = 10^4: 3/10 in place of the binary 0.3 moves the period by 3e-13.
    x, p = sympy.symbols("x p", real=True)
    H = p**2 / 2 + sympy.exp(0.3 * x - 3000) + sympy.exp(10_000 - x)
    first, again = (
        hamsym.periodic_orbit(
            hamsym.Hamiltonian(formula, q=["x"], p=["p"]), [10_001.0, 0.0], energy=3.0
        ).certify()
        for formula in (H, hamsym.Hamiltonian(H, q=["x"], p=["p"]).formula)
    )
    assert abs(again.period.mid - first.period.mid) <= again.period.radius + first.period.radius


@pytest.mark.parametrize("start", [0.7, -123.456, 1e5])
def test_driven_orbit_from_another_time_has_its_exact_state(start):
    # x'' = -x + cos(2 t): x = -cos(2 t)/3
    H = "p**2/2 + x**2/2 - x*cos(2*t)"
    guess = [-math.cos(2 * start) / 3 + 0.1, 0.3]
    certificate = hamsym.periodic_orbit(H, guess, period="pi", start=start).certify()
    with mpmath.workdps(40):
        phase = 2 * mpmath.mpf(start)
        exact = [-mpmath.cos(phase) / 3, 2 * mpmath.sin(phase) / 3]
    for middle, radius, value in zip(certificate.z0.mid, certificate.z0.radius, exact, strict=True):
        assert contains(hamsym.Ball(float(middle), float(radius)), value)


def test_period_is_the_given_formula():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], period="3*pi/2")
    certificate = orbit.certify()
    with mpmath.workdps(40):
        assert contains(certificate.period, 3 * mpmath.pi / 2)
    assert certificate.period.radius > 0
    exact = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], period=4.75).certify()
    assert (exact.period.mid, exact.period.radius) == (4.75, 0)
    # another period in the result alone changes nothing
    driven = hamsym.periodic_orbit("p**2/2 + x**2/2 - x*cos(2*t)", [-0.3, 0.1], period="pi")
    twice = dataclasses.replace(driven.arc, period=2 * driven.period)
    period = dataclasses.replace(driven, arc=twice).certify().period
    with mpmath.workdps(40):
        assert contains(period, mpmath.pi)


def test_floating_point_coefficients_are_exact_in_fractions_of_the_period():
    # sympy rounds 0.1*x**4/3 to the nearest product
    names = ["x", "y", "z"]
    x, y, z, a, b, c = sympy.symbols("x y z p_x p_y p_z", real=True)
    V = 0.1 * (x**4 + y**4 + z**4) + 0.35 * ((x - y) ** 2 + (y - z) ** 2 + (z - x) ** 2)
    H = hamsym.Hamiltonian((a**2 + b**2 + c**2) / 2 + V + 0.3 * (x**2 + y**2 + z**2))
    turn = dict(zip(names, "zxy", strict=True)) | {"p_x": "p_z", "p_y": "p_x", "p_z": "p_y"}
    problem = dataclasses.replace(
        hamsym.periodic_orbit(DUFFING, [1.0, 0.0]).problem, H=H, closing=closing_of(H, turn)
    )
    scaled, name = in_units_of_the_arc(problem, 3)
    exact = {number: fraction(number) for number in H.expr.atoms(sympy.Float)}
    expected = sympy.Symbol(name, real=True) * H.expr.xreplace(exact) / 3
    found = {number: fraction(number) for number in scaled.expr.atoms(sympy.Float)}
    assert sympy.expand(scaled.expr.xreplace(found) - expected) == 0


def test_statement_has_the_parameters_and_the_conditions_of_uniqueness():
    H = hamsym.Hamiltonian("p**2/2 + k*x**2/2 + x**4/4", parameters={"k": 1.5})
    whole = hamsym.periodic_orbit(H, [1.0, 0.0]).certify().statement
    assert "with k = 1.5, has" in whole
    only = "no other one with a period as near and the same energy"
    assert f"{only} that starts in the plane across the flow is within" in whole
    half = hamsym.periodic_orbit(H, [1.0, 0.0], symmetry={"p": "-p"}).certify().statement
    assert "energy and symmetry that starts in the fixed set of the symmetry is within" in half
    forced = "p**2/2 - x**2/2 + 0.1*x*cos(t)"
    driven = hamsym.periodic_orbit(forced, [0.05, 0.0], period="2*pi").certify().statement
    assert "no other one with the same period is within" in driven


@pytest.mark.parametrize(
    ("mass", "force"), [(1.0, 0.3), (1e-24, 1e-20), (1e20, 1e20)], ids=["1", "1e-24", "1e20"]
)
def test_forced_oscillator_is_proven_in_any_units(mass, force):
    H = hamsym.Hamiltonian(
        "p**2/(2*m) + m*x**2/2 - F*x*cos(W*t)", parameters={"m": mass, "F": force, "W": 1.7}
    )
    with mpmath.workdps(40):
        exact = mpmath.mpf(force) / mpmath.mpf(mass) / (1 - mpmath.mpf(1.7) ** 2)
    certificate = hamsym.periodic_orbit(H, [1.1 * float(exact), 0.0], period="2*pi/W").certify()
    x = hamsym.Ball(float(certificate.z0.mid[0]), float(certificate.z0.radius[0]))
    assert contains(x, exact)
    assert certificate.bound < 1e-14


@pytest.mark.parametrize("unit", [2.0**-60, 2.0**60])
def test_units_of_actions_do_not_leave_stability_undecided(unit):
    H = hamsym.Hamiltonian("p**2/(2*c) - c*cos(x)", parameters={"c": unit})
    certificate = hamsym.periodic_orbit(H, ([1.0, 0.0], 6.7)).certify()
    assert certificate.stability == "parabolic"


def test_linear_forced_oscillator_has_its_exact_orbit():
    # x'' = -x + cos(2 t): x = -cos(2 t)/3
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 - x*cos(2*t)", [-0.3, 0.1], period="pi")
    certificate = orbit.certify()
    assert abs(certificate.z0.mid[0] + 1 / 3) <= certificate.z0.radius[0] + 1e-16
    assert abs(certificate.z0.mid[1]) <= certificate.z0.radius[1]


@pytest.mark.slow
def test_figure_eight_is_proven():
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259), symmetry=eight_symmetries())
    certificate = orbit.certify()
    assert certificate.bound < 1e-13
    assert certificate.unique_within > 1e-6


def test_lyapunov_orbit_is_proven_unstable():
    H = hamsym.Hamiltonian(RESTRICTED, parameters={"mu": 0.0121505856})
    guess = ([0.8269, 0.0, 0.0, 0.9161], 2.7)
    orbit = hamsym.periodic_orbit(H, guess, symmetry={"y": "-y", "p_x": "-p_x"})
    certificate = orbit.certify()
    assert certificate.stability == "hyperbolic"
    assert certificate.bound < 1e-11


def test_halo_orbit_of_the_earth_and_moon_is_the_published_one():
    # JPL, three-body periodic orbits: a halo orbit about L1, velocities in the turning frame
    mu, period, index = 1.215058560962404e-2, 3.1233143922761588, 243.40572681337468
    x, z, v = -0.41456184803140111, 0.90753120433295065, 1.4076145460136695
    H = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2 + p_z**2)/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + y**2 + z**2) "
        "- mu/sqrt((x - 1 + mu)**2 + y**2 + z**2)",
        parameters={"mu": mu},
    )
    start = [x, 0, z, 0, v + x, 0]
    symmetry = {"y": "-y", "p_x": "-p_x", "p_z": "-p_z"}
    orbit = hamsym.periodic_orbit(H, (start, period), symmetry=symmetry, tol=1e-12)
    assert orbit.success
    assert np.abs(orbit.z0 - start).max() < 2e-12
    assert abs(orbit.period - period) < 2e-13
    largest = abs(orbit.multipliers[0])
    assert (largest + 1 / largest) / 2 == pytest.approx(index, rel=1e-10)
    certificate = orbit.certify()
    assert certificate.stability == orbit.stability == "complex unstable"
    assert certificate.bound < 1e-14


@pytest.mark.slow
def test_limit_cycle_is_proven_to_attract():
    # van der Pol with mu = 1; the period by Andersen & Geer, SIAM J. Appl. Math. 42 (1982)
    H = hamsym.Hamiltonian(
        "p**2/2 + x**2/2", forces={"p": "mu*(1 - x**2)*p"}, parameters={"mu": 1.0}
    )
    certificate = hamsym.periodic_orbit(H, [2.0, 0.1]).certify()
    assert certificate.stability == "attracting"
    assert certificate.period.mid == pytest.approx(6.66328686, abs=2e-8)
    assert "the force" in certificate.statement
    backward = H.with_parameters(mu=-1.0)
    assert hamsym.periodic_orbit(backward, ([2.0, 0.1], 6.7)).certify().stability == "repelling"


def test_damped_driven_oscillator_has_its_exact_orbit_and_multipliers():
    # x'' = -x - c x' + cos(2 t): x = Re(exp(2 i t)/(1 - 4 + 2 i c))
    c = 0.5
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-c*p + cos(2*t)"}, parameters={"c": c})
    orbit = hamsym.periodic_orbit(H, [0.0, 0.0], period="pi")
    certificate = orbit.certify()
    response = 1 / (-3 + 2j * c)
    expected = np.array([response.real, (2j * response).real])
    assert (np.abs(certificate.z0.mid - expected) <= certificate.z0.radius + 1e-16).all()
    assert certificate.stability == "attracting"
    # det M = exp(-c T)
    product = np.prod(orbit.multipliers).real
    assert product == pytest.approx(math.exp(-c * math.pi), rel=1e-12)


# -- what is not proven ----------------------------------------------------------------------------


def displaced(orbit, change):
    """The orbit with wrong states, still claimed as a success."""
    arc = orbit.arc
    return dataclasses.replace(
        orbit,
        arc=dataclasses.replace(
            arc, ends=arc.ends * (1 + change), values=arc.values * (1 + change)
        ),
    )


@pytest.mark.parametrize("change", [1e-9, 1e-5])
def test_displaced_orbit_has_a_bound_above_its_error(change):
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    certificate = displaced(orbit, change).certify()
    assert certificate.bound >= 0.99 * change
    assert contains(certificate.period, exact_period(1.0))


def test_bound_counts_components_that_the_symmetry_makes_zero():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], symmetry={"p": "-p"})
    arc = orbit.arc
    ends, values = arc.ends.copy(), arc.values.copy()
    ends[0, 1] += 1e-7
    values[0, :, 1] += 1e-7 * (1 - collocation(values.shape[1]).nodes)
    moved = dataclasses.replace(orbit, arc=dataclasses.replace(arc, ends=ends, values=values))
    assert moved.certify().bound > 0.99e-7 / orbit.problem.scale_of(arc)[1]


def test_plane_stays_at_the_numerical_start_when_this_is_corrected():
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"})
    orbit = hamsym.periodic_orbit(H, ([2.0, 0.1], 6.66))
    system = SquareSystem(orbit.problem, orbit.arc, Deadline.after(None), 1.0)
    nothing = np.zeros(len(system.units))
    assert system.values(system.enclosed(nothing, False))[-1] == 0
    system.correct(1e-6 * system.units)
    # of the corrected start from the plane, relative to the components
    assert 1e-7 < abs(system.values(system.enclosed(nothing, False))[-1]) < 1e-5


def test_certificate_of_an_older_version_has_to_be_made_again():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    values = json.loads(orbit.certify().to_json())
    del values["sha256"]
    hamsym.verify(sealed(values), orbit)
    with pytest.raises(FileError, match="of an orbit .* version is not 5; make it again by certi"):
        hamsym.verify(sealed(values | {"version": 4}), orbit)


def test_harmonic_motion_with_a_symmetry_across_it_is_not_claimed_parabolic():
    # the derivative over a period is the identity, that over one shift is the symmetry
    orbit = hamsym.periodic_orbit(
        "(p_x**2 + p_y**2 + x**2 + y**2)/2", [1, 0, 0, 0], symmetry={"y": "-y", "p_y": "-p_y"}
    )
    assert orbit.certify().stability == "undecided"
    assert orbit.stability == "elliptic"


@pytest.mark.slow_cases("0.2")
@pytest.mark.parametrize("change", [0.2, -0.5])
def test_wrong_orbit_is_refused(change):
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    with pytest.raises(CertificationError):
        displaced(orbit, change).certify()


@pytest.mark.slow
def test_trajectory_that_does_not_close_is_refused():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    arc = dataclasses.replace(orbit.arc, period=orbit.period * 1.3)
    with pytest.raises(CertificationError):
        dataclasses.replace(orbit, arc=arc).certify()


def test_failed_orbit_is_refused():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], tol=1e-17)
    with pytest.raises(CertificationError, match="did not succeed"):
        orbit.certify()


def test_orbit_of_the_kepler_problem_is_refused():
    orbit = hamsym.periodic_orbit("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)", [1, 0, 0, 0.8])
    assert orbit.success
    with pytest.raises(CertificationError, match="not isolated"):
        orbit.certify()


def test_balls_that_are_never_mapped_into_themselves_are_refused(monkeypatch):
    # each try comes closer, and none succeeds: the radii after the last one were not tried
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    shares = iter([1.9, 1.8, 1.7, 1.6, 1.5, 1.4] * 2)
    monkeypatch.setattr(proof._Proof, "_image", lambda *given: next(shares) * given[-1])
    with pytest.raises(CertificationError, match="mapped into itself"):
        orbit.certify()


def test_planar_orbit_in_space_is_proven_unstable():
    """Errors across the plane, of tiny balls around zero, leave those within it as they are."""
    guess = {"x": 0.8319, "y": 0, "z": 0, "p_x": 0, "p_y": 0.8738, "p_z": 0}
    mirror = {"y": "-y", "p_x": "-p_x", "p_z": "-p_z"}
    H = hamsym.systems.halo_orbits().H
    orbit = hamsym.periodic_orbit(H, (guess, 2.7), symmetry=mirror)
    certificate = orbit.certify()
    assert certificate.bound < 1e-13 < certificate.unique_within
    assert certificate.stability == "unstable"


def test_equilibrium_claimed_as_an_orbit_is_refused():
    # every state at rest closes, with any period
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    still = dataclasses.replace(
        orbit.arc, ends=np.zeros_like(orbit.arc.ends), values=np.zeros_like(orbit.arc.values)
    )
    with pytest.raises(CertificationError):
        dataclasses.replace(orbit, arc=still).certify()


def test_equilibrium_with_a_symmetry_and_a_given_period_is_refused():
    # it meets all conditions of the boundary-value problem, and is the only solution nearby
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], period=4.7, symmetry={"p": "-p"})
    values = orbit.arc.values * 1e-12
    still = dataclasses.replace(orbit.arc, ends=orbit.arc.ends * 1e-12, values=values)
    with pytest.raises(CertificationError, match="equilibrium"):
        dataclasses.replace(orbit, arc=still).certify()


def test_period_below_zero_is_refused():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0])
    back = dataclasses.replace(
        orbit.arc,
        ends=orbit.arc.ends * [1, -1],
        values=orbit.arc.values * [1, -1],
        period=-orbit.period,
    )
    with pytest.raises(CertificationError, match="not positive"):
        dataclasses.replace(orbit, arc=back).certify()


def test_states_that_are_not_finite_are_refused():
    orbit = displaced(hamsym.periodic_orbit(DUFFING, [1.0, 0.0]), math.nan)
    with pytest.raises(CertificationError, match="not finite"):
        orbit.certify()


def test_map_that_changes_H_closes_no_orbit():
    # from p = 0 to x = 0 takes a quarter of the period only if V is even
    formula = "p**2/2 + x**2/2 + x**3/10"
    even = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], symmetry=({"p": "-p"}, {"x": "-x"}))
    H = hamsym.Hamiltonian(formula)
    problem = dataclasses.replace(even.problem, H=H, energy=0.6)
    with pytest.raises(CertificationError, match="H changes under the symmetry"):
        dataclasses.replace(even, problem=problem).certify()
    shift = dataclasses.replace(even.problem.closing, shift=SignedPermutation.identity(2))
    problem = dataclasses.replace(even.problem, closing=shift)
    with pytest.raises(CertificationError, match="does not close"):
        dataclasses.replace(even, problem=problem).certify()


def test_function_without_enclosure_is_refused():
    orbit = hamsym.periodic_orbit("p**2/2 + abs(x)**3", [1.0, 0.0], tol=1e-3)
    with pytest.raises(CertificationError):
        orbit.certify()


def test_time_limit_ends_the_proof():
    orbit = hamsym.periodic_orbit(HENON_HEILES, [0, -0.15, 0.35, 0], energy=1 / 12, symmetry=ACROSS)
    with pytest.raises(CertificationError, match="time limit"):
        orbit.certify(time_limit=1e-4)


def with_multipliers(multipliers):
    companion = np.diag(np.ones(len(multipliers) - 1), -1)
    companion[0] = -np.poly(multipliers).real[1:]
    return flint.arb_mat([[flint.arb(v, 1e-12) for v in row] for row in companion.tolist()])


@pytest.mark.parametrize(
    ("multipliers", "expected"),
    [
        ([0.3j, 1.0j], "elliptic"),
        ([0.5, 1.0j], "mixed"),
        ([0.5 + math.pi * 1j, 1.0j], "mixed"),
        ([0.3 + 0.2j, 0.3 - 0.2j], "complex unstable"),
        ([1.0j, 1.0j], "undecided"),
        ([0.5, 0.5], "undecided"),
        ([1e-9, 1.0j], "undecided"),
        ([1e-9, 0.5], "unstable"),
        ([0.5, 1.5], "hyperbolic"),
        ([0.5, 1.5 + math.pi * 1j], "hyperbolic"),
        ([0.5 + math.pi * 1j, 1.5 + math.pi * 1j], "hyperbolic"),
    ],
)
def test_stability_of_matrices_with_known_multipliers(multipliers, expected):
    # exponents of a block matrix: exp(+-e)
    matrix = with_multipliers(np.exp([*multipliers, *(-np.array(multipliers))]))
    assert proven_stability(matrix, matrix, forced=False) == expected
    assert expected in WEAKER


@pytest.mark.parametrize(
    ("shear", "radius", "expected"),
    [(0.5, 1e-12, "parabolic"), (0.0, 1e-12, "undecided"), (1e-6, 1e-5, "undecided")],
)
def test_shear_is_proven_parabolic(shear, radius, expected):
    matrix = flint.arb_mat(
        [[flint.arb(v, radius) for v in row] for row in ((1.0, shear), (0.0, 1.0))]
    )
    assert proven_stability(flint.arb_mat(0, 0), matrix, forced=False) == expected
    assert expected in WEAKER


@pytest.mark.parametrize(
    ("multipliers", "expected"),
    [
        ([0.5, -0.9, 0.2], "attracting"),
        ([0.6 + 0.7j, 0.6 - 0.7j, 0.99], "attracting"),
        ([2.0, -1.5, 1.1], "repelling"),
        ([0.6 + 0.9j, 0.6 - 0.9j, 3.0], "repelling"),
        ([0.1, 0.2, 60.0], "unstable"),
        ([0.1, 0.2, 2.0], "undecided"),
        ([1.0, 0.5, 0.5], "undecided"),
    ],
)
def test_attraction_of_matrices_with_known_multipliers(multipliers, expected):
    matrix = with_multipliers(multipliers)
    assert proven_stability(matrix, matrix, forced=True) == expected
    assert expected in WEAKER


@pytest.mark.parametrize("word", ["3", "-3"])
def test_direction_without_a_partner_leaves_stability_undecided(word):
    # multipliers 1, m, 1/m
    rows = [[1, 0, 0], [0, 0, -1], [0, 1, float(word)]]
    matrix = flint.arb_mat([[flint.arb(a) for a in row] for row in rows])
    assert proven_stability(matrix, matrix, forced=False) == "undecided"


def test_orbit_that_starts_beside_an_equilibrium_has_the_stability_of_its_integrals():
    """A start 4e-8 from a saddle has a gradient of H of that size; beside it many states repeat."""
    H = "(p_x**2 + p_y**2)/2 - x**2/2 + x**4/4 + 0.04*y**2/2 + 0.5*x**2*y**2/2"
    mirror = {"p_x": "-p_x", "p_y": "-p_y"}
    orbit = hamsym.periodic_orbit(H, [4e-8, 0, 0, 0], symmetry=mirror, tol=1e-6)
    # the trace of the pair across the plane, with 40 digits
    assert orbit.shift_multipliers.real.sum() == pytest.approx(-3.13157, abs=1e-5)
    assert (orbit.stability, orbit.repetitions) == ("hyperbolic", 1)
    assert orbit.certify().stability == "hyperbolic"


def test_energy_that_is_not_conserved_is_refused():
    H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"})
    orbit = hamsym.periodic_orbit(H, ([2.0, 0.0], 6.66))
    problem = dataclasses.replace(orbit.problem, energy=123.0)
    with pytest.raises(ValueError, match="not conserve"):
        problem.check()
