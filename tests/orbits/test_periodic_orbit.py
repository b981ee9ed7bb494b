"""Periodic orbits against exact periods, published orbits and other methods."""

import dataclasses
import math
from fractions import Fraction

import mpmath
import numpy as np
import pytest
from scipy.optimize import brentq

import hamsym
from hamsym.errors import InputError
from hamsym.numerics.collocation import collocation
from hamsym.orbits.force_between import missed_feature

HENON_HEILES = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
DUFFING = "p**2/2 + x**2/2 + x**4/4"
FORCED = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "(1 - x**2)*p"})
ACROSS = {"x": "-x", "p_y": "-p_y"}
RESTRICTED = (
    "(p_x**2 + p_y**2)/2 + y*p_x - x*p_y - (1 - mu)/sqrt((x + mu)**2 + y**2) "
    "- mu/sqrt((x + mu - 1)**2 + y**2)"
)


def three_bodies():
    names = "123"
    q = [f"{c}{i}" for i in names for c in "xy"]
    kinetic = " + ".join(f"(p_x{i}**2 + p_y{i}**2)/2" for i in names)
    potential = " - ".join(
        f"1/sqrt((x{i} - x{j})**2 + (y{i} - y{j})**2)" for i, j in ("12", "13", "23")
    )
    return hamsym.Hamiltonian(f"{kinetic} - {potential}", q=q, p=[f"p_{name}" for name in q])


#: Chenciner & Montgomery (2000): positions and velocities with eight digits, by C. Simo.
EIGHT = [
    *(0.97000436, -0.24308753, -0.97000436, 0.24308753, 0, 0),
    *(0.466203685, 0.43236573, 0.466203685, 0.43236573, -0.93240737, -0.86473146),
]


def eight_symmetries():
    """At its start the eight is reversed by a point reflection, a twelfth later by a mirror."""
    first, last = {}, {}
    for c, sign in (("x", ""), ("y", "-")):
        first |= {f"{c}1": f"-{c}2", f"{c}2": f"-{c}1", f"{c}3": f"-{c}3"}
        first |= {f"p_{c}1": f"p_{c}2", f"p_{c}2": f"p_{c}1"}
        turned = "-" if not sign else ""
        last |= {f"{c}1": f"{sign}{c}1", f"{c}2": f"{sign}{c}3", f"{c}3": f"{sign}{c}2"}
        last |= {f"p_{c}1": f"{turned}p_{c}1"}
        last |= {f"p_{c}2": f"{turned}p_{c}3", f"p_{c}3": f"{turned}p_{c}2"}
    return first, last


def duffing_period(amplitude):
    """Period of p^2/2 + x^2/2 + x^4/4 (by elliptic integrals)."""
    a = mpmath.mpf(amplitude) ** 2
    return 4 * mpmath.ellipk(a / (2 * (1 + a))) / mpmath.sqrt(1 + a)


# -- exact and published orbits --------------------------------------------------------------------


@pytest.mark.parametrize("amplitude", [1e-3, 0.1, 1.0, 7.0, 300.0])
def test_period_is_that_of_elliptic_integrals(amplitude):
    orbit = hamsym.periodic_orbit(DUFFING, [amplitude, 0.0])
    assert orbit.success
    assert orbit.period == pytest.approx(float(duffing_period(amplitude)), rel=1e-13)


@pytest.mark.parametrize("unit", [1e-24, 1e18])
def test_units_do_not_matter(unit):
    H = hamsym.Hamiltonian("p**2/(2*m) + k*x**4/4", parameters={"m": unit, "k": 1 / unit})
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0])
    assert orbit.success
    # m x'' = -k x^3: in units of sqrt(m/k) = unit
    expected = hamsym.periodic_orbit("p**2/2 + x**4/4", [1.0, 0.0]).period * unit
    assert orbit.period == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("lengths", [(-33, 3), (0, -60)])
def test_units_of_a_length_and_of_an_angle_do_not_matter(lengths):
    a, b = (2.0**power for power in lengths)
    action = 2.0**-50
    H = hamsym.Hamiltonian(
        "c*(((p_x*a)**2 + (p_y*b)**2)/(2*c**2) + ((x/a)**2 + (y/b)**2)/2 + (x/a)**2*y/b"
        " - (y/b)**3/3)",
        parameters={"a": a, "b": b, "c": action},
    )
    orbit = hamsym.periodic_orbit(H, ([0.0, 0.02 * b, 0.4 * action / a, 0.0], 6.3))
    own = hamsym.periodic_orbit(HENON_HEILES, ([0.0, 0.02, 0.4, 0.0], 6.3))
    assert orbit.success
    assert orbit.stability == own.stability == "elliptic"
    guess = np.array([0.0, -0.1, 0.45, 0.0])  # far from an orbit
    far = hamsym.periodic_orbit(H, guess * [a, b, action / a, action / b])
    assert far.period == pytest.approx(hamsym.periodic_orbit(HENON_HEILES, guess).period, rel=1e-9)
    assert np.sort(orbit.multipliers.real) == pytest.approx(np.sort(own.multipliers.real), abs=1e-9)
    family = orbit.family(energy=0.1 * action)
    assert len(family) == len(own.family(energy=0.1))


def test_given_period_determines_the_energy():
    amplitude = 2.5
    orbit = hamsym.periodic_orbit(DUFFING, [2.0, 0.0], period=float(duffing_period(amplitude)))
    assert orbit.success
    assert orbit.energy == pytest.approx(amplitude**2 / 2 + amplitude**4 / 4, rel=1e-11)


def test_given_energy_determines_the_amplitude():
    orbit = hamsym.periodic_orbit("p**2/2 - cos(x)", {"x": 1.2, "p": 0}, energy=-math.cos(2.0))
    assert orbit.success
    assert orbit.period == pytest.approx(float(4 * mpmath.ellipk(math.sin(1.0) ** 2)), rel=1e-13)


def test_arenstorf_orbit():
    # Hairer, Norsett & Wanner, Solving Ordinary Differential Equations I, section II.0
    H = hamsym.Hamiltonian(RESTRICTED, parameters={"mu": 0.012277471})
    speed, period = -2.00158510637908252, 17.0652165601579625589
    guess = [0.994, 0.0, 0.0, 0.994 + speed * (1 + 1e-7)]
    orbit = hamsym.periodic_orbit(H, guess, period=period, symmetry={"y": "-y", "p_x": "-p_x"})
    assert orbit.success
    assert orbit.z0[0] == pytest.approx(0.994, abs=1e-11)
    assert orbit.z0[3] - orbit.z0[0] == pytest.approx(speed, abs=1e-9)


@pytest.mark.slow
def test_figure_eight_has_the_published_multipliers():
    # Simo, Dynamical properties of the figure eight solution of the three-body problem (2002)
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259), symmetry=eight_symmetries())
    assert orbit.success
    assert orbit.is_isolated
    assert orbit.problem.closing.parts == 12
    assert orbit.period == pytest.approx(6.32591398, abs=1e-7)
    for expected in (0.998599982092 + 0.052896826792j, -0.297596667517 + 0.954691690528j):
        assert np.abs(orbit.multipliers - expected).min() < 2e-6


def test_figure_eight_without_symmetry_is_isolated_up_to_motions_of_its_integrals():
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259))
    assert orbit.success
    assert orbit.is_isolated
    certificate = orbit.certify()
    assert certificate.stability == "elliptic"
    assert certificate.bound < 1e-14
    assert "planes across the flow and the motions that its integrals" in certificate.statement


def test_orbit_of_more_integrals_than_are_found_is_not_isolated():
    orbit = hamsym.periodic_orbit("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)", [1, 0, 0, 0.8])
    assert orbit.success
    assert not orbit.is_isolated
    assert "not isolated" in orbit.message
    with pytest.raises(hamsym.CertificationError, match="give a symmetry"):
        orbit.certify()


def test_small_lyapunov_orbit_has_the_linear_period_and_multiplier():
    mu = mpmath.mpf("0.0121505856")
    L1 = mpmath.findroot(
        lambda x: x - (1 - mu) / (x + mu) ** 2 + mu / (x + mu - 1) ** 2, mpmath.mpf("0.837")
    )
    c = (1 - mu) / (L1 + mu) ** 3 + mu / (1 - mu - L1) ** 3
    # s^4 + (2 - c) s^2 + (1 + 2 c)(1 - c) = 0
    root = mpmath.sqrt(9 * c**2 - 8 * c)
    frequency, rate = mpmath.sqrt((2 - c + root) / 2), mpmath.sqrt((c - 2 + root) / 2)
    ratio = float((frequency**2 + 1 + 2 * c) / 2)  # of y' to x
    H = hamsym.Hamiltonian(RESTRICTED, parameters={"mu": float(mu)})
    small = 1e-4
    guess = [float(L1) - small, 0.0, 0.0, float(L1) - small + ratio * small]
    period = float(2 * mpmath.pi / frequency)
    orbit = hamsym.periodic_orbit(H, (guess, period), symmetry={"y": "-y", "p_x": "-p_x"}, tol=1e-8)
    assert orbit.success
    assert orbit.period == pytest.approx(period, rel=2e-6)
    assert orbit.stability == "hyperbolic"
    growth = float(mpmath.exp(2 * mpmath.pi * rate / frequency))
    assert abs(orbit.multipliers[0]) == pytest.approx(growth, rel=1e-4)


def test_driven_orbit_closes_and_has_multipliers_of_a_unit_product():
    H = hamsym.Hamiltonian(
        "p**2/2 - x**2/2 + x**4/4 - F*x*cos(omega*t)", parameters={"F": 0.1, "omega": 1.1}
    )
    orbit = hamsym.periodic_orbit(H, [1.1, 0.0], period="2*pi/omega")
    assert orbit.success
    other = hamsym.monodromy(H, orbit.z0, orbit.period)
    assert other.closure < 1e-9
    assert np.prod(orbit.multipliers) == pytest.approx(1.0, abs=1e-10)
    assert np.sort_complex(orbit.multipliers) == pytest.approx(
        np.sort_complex(other.multipliers), abs=1e-7
    )


@pytest.mark.parametrize("symmetry", [None, ACROSS], ids=["none", "one"])
def test_orbit_is_a_solution_with_its_monodromy_matrix(symmetry):
    start = [0.0, 0.25, 0.336, 0.0]
    orbit = hamsym.periodic_orbit(HENON_HEILES, start, energy=1 / 12, symmetry=symmetry)
    assert orbit.success
    assert orbit.energy == pytest.approx(1 / 12, abs=1e-15)
    solution = hamsym.solve(HENON_HEILES, orbit.z0, (0, 1.5 * orbit.period), tol=1e-12)
    t = np.linspace(0, 1.5 * orbit.period, 97)
    assert np.abs(orbit(t) - solution(t)).max() < 1e-11
    other = solution.sensitivity(orbit.period)
    assert np.abs(orbit.monodromy - other).max() < 1e-8


def test_symmetries_lead_to_the_same_orbit():
    start = [0.0, 0.25, 0.336, 0.0]
    periods = [
        hamsym.periodic_orbit(HENON_HEILES, start, energy=1 / 12, symmetry=symmetry).period
        for symmetry in (None, ACROSS)
    ]
    assert max(periods) - min(periods) < 1e-12


@pytest.mark.slow
def test_orbit_of_a_symplectic_symmetry():
    # two uncoupled equal oscillators, run through half a period apart
    H = hamsym.Hamiltonian("(p1**2 + p2**2)/2 + (q1**4 + q2**4)/4 + q1**2*q2**2")
    swap = {"q1": "q2", "q2": "q1", "p1": "p2", "p2": "p1"}
    orbit = hamsym.periodic_orbit(H, [1.0, 1.0, 0.1, 0.1], symmetry=swap)
    assert orbit.problem.closing.parts == 2
    assert orbit.success
    assert np.abs(orbit(orbit.period / 2)[[1, 0, 3, 2]] - orbit.z0).max() < 1e-12


@pytest.mark.parametrize("n", [4, pytest.param(30, marks=pytest.mark.slow)])
def test_nonlinear_normal_mode_of_a_chain(n):
    # of a periodic Fermi-Pasta-Ulam chain
    terms = [f"p{i}**2/2 + (q{i % n + 1} - q{i})**2/2 + (q{i % n + 1} - q{i})**4/4"
             for i in range(1, n + 1)]  # fmt: skip
    H = hamsym.Hamiltonian(" + ".join(terms))
    start = [0.1 * (-1) ** i for i in range(n)] + [0.0] * n
    orbit = hamsym.periodic_orbit(H, start)
    assert orbit.success
    # alternating: u'' = -4 u - 16 u^3 with amplitude 0.1
    a = mpmath.mpf("0.01")
    k = 16 * a / (2 * (4 + 16 * a))
    assert orbit.period == pytest.approx(float(4 * mpmath.ellipk(k) / mpmath.sqrt(4 + 16 * a)))


# -- judgement -------------------------------------------------------------------------------------


def test_multiple_of_the_shortest_period_is_reduced_or_said():
    period = float(duffing_period(1.0))
    orbit = hamsym.periodic_orbit(DUFFING, ([1.0, 0.0], 3 * period))
    assert orbit.period == pytest.approx(period)
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], period=3 * period)
    assert orbit.repetitions == 3
    assert "3 times the shortest" in orbit.message


@pytest.mark.parametrize("times", [1, 3, 11])
def test_multiple_of_the_period_of_a_driven_orbit_is_said(times):
    orbit = hamsym.periodic_orbit(
        "p**2/2 + x**2/4 - x*cos(2*t)", [-0.3, 0.1], period=f"{times}*pi", start=0.3
    )
    assert orbit.success
    assert orbit.repetitions == times
    assert (f"the period is {times} times the shortest one" in orbit.message) == (times > 1)


def test_collapse_to_an_equilibrium_is_no_success():
    orbit = hamsym.periodic_orbit(DUFFING, ([0.3, 0.0], 6.0), energy=0.0)
    assert not orbit.success


@pytest.mark.parametrize(
    ("H", "guess"),
    [
        ("p**2/2 + x**2/2 - cos(t)*x", [1.0, 0.0]),  # the guess has no force at t = 0
        ("p**2/2 + x**2/2 + x**4 - t*x", [1.0, 0.0]),
        ("p**2/2 + (1 + cos(t)/5)*x**2/2", [0.0, 0.0]),  # at rest, with other multipliers
    ],
)
def test_period_that_H_does_not_have_is_no_success(H, guess):
    orbit = hamsym.periodic_orbit(H, guess, period=3.0)
    assert not orbit.success
    assert "not shown to have the period 3 in time" in orbit.message


@pytest.mark.parametrize(
    "rest",
    [
        " - 5*x*exp(-((t - 8.7)/0.004)**2)",  # between the points of the next period
        " - x*(1 + tanh(5*(t - 30)))/2",  # in the fifth period
        " - 0.3*x*cos(1.00000000001*t)",
    ],
)
def test_force_without_the_period_is_no_success_whenever_it_acts(rest):
    H = "p**2/2 + x**2 + x**4/4 - 0.3*x*cos(t)" + rest
    orbit = hamsym.periodic_orbit(H, [0.3, 0.0], period="2*pi")
    assert not orbit.success
    assert "not shown to have the period" in orbit.message


@pytest.mark.parametrize(
    ("drive", "period"),
    [
        ("cos(0.7*t)", 2 * np.pi / 0.7),
        ("cos(w*t + 1)", 2 * np.pi / 1.3),
        ("cos(w*t + 1)", "2*pi/w"),
        ("cos(0.1*t)*sin(0.3*t + 1)", 2 * np.pi / 0.2),  # the signs of both change
        ("exp(cos(3*w*(t - 1)) + x*sin(w*t)**2/10)", 10.0 * np.pi / (5 * 1.3)),
        ("(cos(2*t)**4 + sin(2*t)**4)", "pi/4"),
        ("cos(t + sin(2*t)/3 - x/10)", "2*pi"),
    ],
)
def test_driven_orbit_has_the_period_of_its_rounded_frequencies(drive, period):
    # the last term is the same at all states
    H = hamsym.Hamiltonian(f"p**2/2 + x**2 + x**4/4 + x*{drive}/50 + w*t", parameters={"w": 1.3})
    orbit = hamsym.periodic_orbit(H, [0.0, 0.0], period=period)
    assert orbit.success, orbit.message


def test_period_of_H_is_accepted_at_late_times():
    H = "p**2/2 + x**2/2 - x*cos(2*t)"
    assert hamsym.periodic_orbit(H, [-0.3, 0.1], period="pi", start=1e6).success


def test_orbit_across_a_jump_of_H_is_no_success():
    # the derivative of sign lacks the pulse
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + sign(x)/10", [1.0, 0.0])
    assert not orbit.success
    assert "H jumps at t = 1.57" in orbit.message
    smooth = hamsym.periodic_orbit("p**2/2 + x**2/2 + sign(x - 3)/10", [1.0, 0.0])
    assert smooth.success


#: A barrier of width 1e-4 and height 0.1 at 1.05, whose top has the energy 0.65.
BARRIER = "p**2/2 + x**2/2 + 0.1*exp(-((x - 1.05)/0.0001)**2)"


def test_orbit_through_a_barrier_between_the_points_is_no_success():
    # Newton's method comes from an orbit inside the barrier to one that passes through it.
    orbit = hamsym.periodic_orbit(BARRIER, [1.0, 0.0], energy=0.605)
    assert not orbit.success
    assert "the force has a feature" in orbit.message


@pytest.mark.slow
def test_family_turns_at_a_barrier_that_its_points_miss():
    energy = hamsym.Hamiltonian(BARRIER).compile("numpy").energy
    place = brentq(lambda x: float(energy(np.array([x, 0.0]))) - 0.605, 1, 1.05)
    inside = hamsym.periodic_orbit(BARRIER, [0.9, 0.0])
    family = inside.family(energy=0.605)
    assert family.success
    assert family[-1].arc.values[..., 0].max() == pytest.approx(place, abs=1e-6)


def test_force_that_the_points_of_a_driven_orbit_miss_is_met_by_its_bound():
    # x = -4/3 cos(t) without the pulse, of width 1e-9 in sin(t)
    H = hamsym.Hamiltonian(
        "p**2/2 + x**2/8 - x*(cos(t) + 1000*k*exp(-((sin(t) - 0.7)/1e-9)**2))",
        parameters={"k": 0.0},
    )
    orbit = hamsym.periodic_orbit(H, [-1.3, 0.0], period="2*pi")
    assert orbit.success
    with_pulse = dataclasses.replace(orbit.problem, H=H.with_parameters(k=1.0))
    assert missed_feature(orbit.problem, orbit.arc, 1e-10) == ""
    assert "near t = 0.7753" in missed_feature(with_pulse, orbit.arc, 1e-10)


@pytest.mark.slow
def test_many_bounces_do_not_stop_the_search():
    # period of a fall from 1: 2 sqrt(2), with a hard floor
    orbit = hamsym.periodic_orbit("p**2/2 + x + 1e-6/x**2", [1.0, 0.0])
    assert orbit.success
    assert abs(orbit.period - 2 * math.sqrt(2)) < 1e-2


def test_failed_orbit_has_a_text():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2", [1.0, 0.0], tol=1e-17)
    assert not orbit.success
    assert orbit.stability in repr(orbit)


def test_orbit_whose_squares_underflow_is_found():
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2", [1e-200, 0.0])
    assert orbit.success
    assert orbit.period == pytest.approx(2 * math.pi, rel=1e-14)
    assert orbit.stability == "elliptic"


@pytest.mark.parametrize("height", [0.0, 1e-12])
def test_integral_at_rest_has_no_direction(height):
    # a pendulum at rest, or nearly, beside an oscillator: its gradient is zero, or round-off
    H = hamsym.Hamiltonian("p_a**2/2 - cos(a) + p_x**2/2 + 2*x**2")
    orbit = hamsym.periodic_orbit(H, [height, 1.0, 0, 0])
    assert orbit.success
    assert np.abs(np.sort_complex(orbit.shift_multipliers) + 1).max() < 1e-6  # exp(+-i pi)


def test_small_multiplier_is_the_inverse_of_the_large_one():
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + x**2/2 + x**4/4 - 20*y**2")
    orbit = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0])
    exact = float(mpmath.exp(mpmath.sqrt(40) * duffing_period(1.0)))
    assert orbit.stability == "hyperbolic"
    assert abs(orbit.multipliers[0] / exact - 1) < 1e-9
    assert abs(orbit.multipliers[-1] * exact - 1) < 1e-9


def test_estimated_error_above_the_tolerance_is_no_success():
    orbit = hamsym.periodic_orbit(DUFFING, [1.0, 0.0], tol=1e-17)
    assert not orbit.success
    assert "estimated error" in orbit.message


def test_energy_without_an_orbit_is_no_success():
    # beyond the separatrix the pendulum rotates
    orbit = hamsym.periodic_orbit("p**2/2 - cos(x)", ([1.0, 0.0], 7.0), energy=1.5)
    assert not orbit.success


def test_stability_of_a_saddle_and_of_a_centre():
    # the second oscillator is linear along y = 0: multipliers exp(+-i w T), exp(+-w T)
    for sign, kind in ((1, "elliptic"), (-1, "hyperbolic")):
        H = hamsym.Hamiltonian(f"(p_x**2 + p_y**2)/2 + x**2/2 + x**4/4 + {sign}*0.3*y**2/2")
        orbit = hamsym.periodic_orbit(H, [1.0, 0.0, 0.0, 0.0])
        assert orbit.stability == kind
        phase = math.sqrt(0.3) * float(duffing_period(1.0))
        expected = 2 * (math.cos(phase) if sign > 0 else math.cosh(phase))
        assert np.trace(orbit.monodromy) - 2 == pytest.approx(expected, rel=1e-11)


@pytest.mark.parametrize(
    ("H", "guess", "word"),
    [
        ("p**2/2 - cos(x)", [2.0, 0.0], "parabolic"),
        ("p**2/2 + 2*x**2", [1.0, 0.0], "elliptic"),
        # two integrals of two degrees of freedom
        ("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2/4", ([1.0, 0, 0, 0], 7.4), "parabolic"),
        ("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2", ([1.0, 0, 0.2, 0.7], 6.28), "elliptic"),
    ],
)
def test_orbit_without_other_multipliers_is_judged_by_its_shear(H, guess, word):
    orbit = hamsym.periodic_orbit(H, guess)
    assert orbit.success
    assert len(orbit.shift_multipliers) == 0
    assert (orbit.multipliers == 1).all()
    assert orbit.stability == word


@pytest.mark.slow_cases("False")
@pytest.mark.parametrize("symmetric", [False, True])
def test_figure_eight_is_elliptic_without_its_eight_integrals(symmetric):
    symmetry = eight_symmetries() if symmetric else None
    orbit = hamsym.periodic_orbit(three_bodies(), (EIGHT, 6.3259), symmetry=symmetry)
    # 12 components, less 2 and 2 of the centre of mass, 1 and 1 of rotations, 2 of the flow
    assert len(orbit.shift_multipliers) == 4
    assert orbit.stability == "elliptic"
    for expected in (0.998599982092 + 0.052896826792j, -0.297596667517 + 0.954691690528j):
        assert np.abs(orbit.multipliers - expected).min() < 1e-7


# -- bad input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("H", "guess", "options", "message"),
    [
        (DUFFING, [0.0, 0.0], {}, "equilibrium"),
        ("p**2/2 - x**2/2", [1.0, 0.0], {}, "does not come back"),
        ("p**2/2 + x", [1.0, 1.0], {}, "does not come back"),
        (DUFFING, [1.0, 0.0], {"energy": 1.0, "period": 2.0}, "not both"),
        (DUFFING, [1.0, 0.0], {"energy": math.nan}, "energy"),
        (DUFFING, [1.0, 0.0], {"tol": 0}, "tol"),
        (DUFFING, [1.0, 0.0], {"period": -1.0}, "period"),
        (DUFFING, [1.0, 0.0], {"period": "2*pi/omega"}, "omega"),
        (DUFFING, [1.0, 0.0], {"period": "1/0*x"}, "formula|zero|finite"),
        (DUFFING, ([1.0, 0.0], -3.0), {}, "period of the guess"),
        (DUFFING, [1.0], {}, "z0|state|components"),
        (DUFFING, [1.0, math.inf], {}, "finite"),
        (DUFFING + " - x*cos(t)", [1.0, 0.0], {}, "give period="),
        (DUFFING + " - x*cos(t)", [1.0, 0.0], {"energy": 1.0}, "does not conserve"),
        (FORCED, [2.0, 0.0], {"period": 6.6}, "period of its own"),
        (FORCED, [2.0, 0.0], {"energy": 1.0}, "does not conserve"),
        (DUFFING, [1.0, 0.0], {"symmetry": "x"}, "mapping"),
        (DUFFING, [1.0, 0.0], {"symmetry": {"x": "-y"}}, "not a component"),
        (DUFFING, [1.0, 0.0], {"symmetry": {"x": "p"}}, "once"),
        (DUFFING, [1.0, 0.0], {"symmetry": {"x": "p", "p": "x"}}, "H changes"),
        (DUFFING + " + x**3", [1.0, 0.0], {"symmetry": {"x": "-x", "p": "-p"}}, "H changes"),
        (HENON_HEILES, [0, 0.1, 0.5, 0], {"symmetry": {"x": "-x"}}, "neither symplectic"),
        (HENON_HEILES, [0, 0.1, 0.5, 0], {"symmetry": ({}, ACROSS)}, "both must reverse"),
    ],
)
def test_bad_input_is_refused(H, guess, options, message):
    with pytest.raises(InputError, match=message) as refused:
        hamsym.periodic_orbit(H, guess, **options)
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize("t", ["x", math.nan, [[1.0]], None, 10**400])
def test_times_that_are_no_numbers_are_refused(t):
    with pytest.raises(InputError, match="t must be|t has an entry"):
        hamsym.periodic_orbit(DUFFING, [1.0, 0.0])(t)


def test_close_encounter_is_evaluated_to_the_rounding_of_its_time():
    # Kepler's problem from the apoapsis: near the other end the state moves by its size in 1e-9
    start = [-1.999999, 0.0, 0.0, -math.sqrt(1e-6 / 1.999999)]
    orbit = hamsym.periodic_orbit("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)", (start, 2 * math.pi))
    arc = orbit.arc
    fastest = int(np.diff(arc.edges).argmin())
    low, high = (Fraction(edge) for edge in arc.edges[fastest : fastest + 2])
    times = np.array([float((low + (high - low) * k / 8) * Fraction(arc.period)) for k in (2, 5)])
    exact = [float((Fraction(t) / Fraction(arc.period) - low) / (high - low)) for t in times]
    expected = collocation(arc.values.shape[1]).interpolation(np.array(exact)) @ arc.values[fastest]
    assert np.abs((orbit(times) - expected) / orbit.problem.scale_of(arc)).max() < 1e-13
    # Even the rounding of the period moves the state by more than the tolerance.
    assert not orbit.success
    assert orbit.relative_error > 1e-8
