"""Families that leave at bifurcations, against published ones and other integrators."""

import functools
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import mathieu_a as mathieu

import hamsym
from hamsym.orbits.branching import is_new

HENON_HEILES = hamsym.Hamiltonian(
    "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3", q=["x", "y"], p=["p_x", "p_y"]
)
REVERSED = {"y": "-y", "p_x": "-p_x", "p_z": "-p_z"}


def closure(orbit):
    """Distance of the end from the start, by Dormand and Prince's method of order 8."""
    system = orbit.H.compile("numpy")

    def rates(t, z):
        return system.vector_field(*system.arguments(z, t))

    path = solve_ivp(rates, (0, orbit.period), orbit.z0, method="DOP853", rtol=1e-13, atol=1e-14)
    return np.abs(path.y[:, -1] - orbit.z0).max()


def distance(orbit, other):
    """The largest distance of the points of an orbit from another one."""
    points = orbit(np.linspace(0, orbit.period, 50))
    path = other(np.linspace(0, other.period, 40_000))
    return max(np.linalg.norm(point - path, axis=-1).min() for point in points)


@pytest.fixture(scope="module")
def along_y():
    z0 = HENON_HEILES.state_at_energy(0.13, {"x": 0, "y": 0, "p_x": 0})
    return hamsym.periodic_orbit(HENON_HEILES, z0).family(energy=0.165)


@pytest.fixture(scope="module")
def on_branch(along_y):
    """The orbit on a side of a branch that has 0.0005 more energy than the bifurcation."""

    @functools.cache
    def found(k, side=1):
        energy = along_y.branches[k].orbit.energy + 0.0005
        return along_y.branch(k, side=side, energy=energy)[-1]

    return found


def lyapunov_orbit(kind):
    """A small planar orbit about a Lagrange point of the earth and the moon."""
    H = hamsym.systems.halo_orbits().H
    mu = H.parameters["mu"]
    guess = {"L1": 0.83691513, "L2": 1.15568217}[kind]
    c = (1 - mu) / (guess + mu) ** 3 + mu / abs(guess - 1 + mu) ** 3
    rate = np.sqrt((2 - c + np.sqrt(9 * c * c - 8 * c)) / 2)
    x, velocity = guess - 0.005, 0.005 * (rate**2 + 1 + 2 * c) / 2
    start = ([x, 0, 0, 0, x + velocity, 0], 2 * np.pi / rate)
    return hamsym.periodic_orbit(H, start, symmetry=REVERSED)


@pytest.mark.parametrize("k", range(4))
def test_families_leave_the_orbit_along_y(along_y, on_branch, k):
    # Brack 2001: period doublings, and pairs of loops that leave with the same period
    found, orbit = along_y.branches[k], on_branch(k)
    turns = 2 if found.kind == "period doubling" else 1
    assert orbit.success
    assert orbit.repetitions == 1
    assert orbit.energy == pytest.approx(found.orbit.energy + 0.0005, abs=1e-12)
    assert orbit.period == pytest.approx(turns * found.orbit.period, rel=1e-2)
    assert closure(orbit) < 1e-9
    same = along_y[found.after].family(energy=orbit.energy)[-1]
    assert distance(orbit, same) > 1e-3


def test_orbits_of_the_family_are_those_of_no_branch(along_y, on_branch):
    found, branch = along_y.branches[2], on_branch(2)
    later = hamsym.periodic_orbit(HENON_HEILES, (along_y[-1](1.0), along_y[-1].period))
    assert is_new(branch, found.orbit, None, 0.02, 1e-10)
    assert not is_new(along_y[found.after], found.orbit, None, 0.02, 1e-10)
    assert not is_new(later, found.orbit, None, 0.02, 1e-10)


def test_sides_of_a_branch_are_images_of_each_other(on_branch):
    one, other = on_branch(2), on_branch(2, -1)
    assert distance(one, other) > 1e-3  # the same curve of states in another sense
    mirrored = hamsym.periodic_orbit(
        HENON_HEILES, (one.z0 * np.array([-1, 1, -1, 1]), one.period), energy=one.energy
    )
    assert distance(mirrored, other) < 2e-4


@pytest.fixture(scope="module")
def planar():
    return lyapunov_orbit("L1").family(energy=-1.58)


def test_halo_family_leaves_the_planar_one_where_published(planar):
    # Farquhar & Kamel 1973, Howell 1984: near C = 3.1743 at L1 of the earth and the moon
    (found,) = planar.branches
    assert found.kind == "branching"
    assert -2 * found.orbit.energy == pytest.approx(3.17435, abs=5e-6)
    energy = found.orbit.energy + 0.002
    sides = [planar.branch(0, side=side, energy=energy)[-1] for side in (1, -1)]
    assert sides[0].z0[2] == pytest.approx(-sides[1].z0[2], rel=1e-6)
    assert abs(sides[0].z0[2]) > 0.01
    assert all(closure(orbit) < 1e-9 for orbit in sides)


@pytest.mark.slow
def test_branches_lead_to_published_halo_orbits():
    for point, start, below in (("L1", "L1", -1.58), ("L2", "L2, near the moon", -1.55)):
        problem = hamsym.systems.halo_orbits(start=start)
        energy = float(problem.H.compile("numpy").energy(np.array(problem.z0)))
        target = {"energy": energy} if point == "L1" else {"period": problem.period}
        family = lyapunov_orbit(point).family(energy=below)
        for side in (1, -1):
            orbit = family.branch(0, side=side, max_orbits=400, **target)[-1]
            if orbit.z0[2] * problem.z0[2] < 0:
                continue
            assert orbit.period == pytest.approx(problem.period, rel=1e-12)
            np.testing.assert_allclose(orbit.z0, problem.z0, atol=2e-12)
            break
        else:
            pytest.fail("no side leads to the published orbit")


def test_halo_orbit_is_found_without_its_symmetry(planar):
    orbit = planar.branches[0].orbit
    plain = hamsym.periodic_orbit(orbit.H, (orbit.z0, orbit.period), energy=orbit.energy - 1e-4)
    family = plain.family(energy=-1.586)
    assert [found.kind for found in family.branches] == ["branching"]
    halo = family.branch(0, energy=-1.5865)[-1]
    assert np.ptp(halo(np.linspace(0, halo.period, 100))[:, 2]) > 0.01
    assert closure(halo) < 1e-9


@pytest.fixture(scope="module")
def along_x():
    """Orbits on the x axis, which the parameter does not change; y obeys Lame's equation."""
    H = hamsym.Hamiltonian(
        "(p_x**2 + p_y**2)/2 + x**4/4 + y**4/4 + e*x**2*y**2/2",
        q=["x", "y"],
        p=["p_x", "p_y"],
        parameters={"e": 4.0},
    )
    turned = {"x": "-x", "y": "-y", "p_x": "-p_x", "p_y": "-p_y"}
    return hamsym.periodic_orbit(H, [1, 0, 0, 0], symmetry=turned).family(parameter=("e", 12.0))


def test_symmetry_breaks_where_the_equation_of_lame_says(along_x):
    # bands end at e = n (n + 1)/2
    assert along_x.success
    assert [found.kind for found in along_x.branches] == ["symmetry breaking"] * 2
    ends = [found.orbit.H.parameters["e"] for found in along_x.branches]
    assert ends == pytest.approx([6, 10], abs=1e-7)


@pytest.mark.parametrize("k", [0, 1])
def test_orbits_beyond_a_break_of_symmetry_have_none(along_x, k):
    e = (6.1, 10.1)[k]
    family = along_x.branch(k, parameter=("e", e))
    orbit = family[-1]
    assert family.success
    assert orbit.H.parameters["e"] == e
    assert orbit.energy == pytest.approx(0.25, abs=1e-12)
    assert np.abs(orbit(orbit.period / 2) + orbit.z0).max() > 0.01
    assert closure(orbit) < 1e-9


@pytest.mark.parametrize(
    ("k", "options", "message"),
    [
        (4, {}, "k must be a number from 0 to 3"),
        (-1, {}, "k must be a number from 0 to 3"),
        (1.0, {}, "k must be a number from 0 to 3"),
        (0, {"side": 2}, "side must be 1 or -1"),
        (0, {}, "give one of energy, period and parameter"),
    ],
)
def test_arguments_that_name_no_branch_are_refused(along_y, k, options, message):
    with pytest.raises(hamsym.InputError, match=message):
        along_y.branch(k, **options)


def test_family_without_bifurcations_has_no_branches():
    family = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0]).family(energy=1.0)
    assert family.branches == ()
    with pytest.raises(hamsym.InputError, match=r"family\.branches is empty"):
        family.branch(0, energy=2.0)


def test_pendulum_on_a_shaken_support_doubles_its_period():
    # McLachlan 1947: the first band of Mathieu's equation, x'' + (1 + a cos w t) x = 0
    H = hamsym.Hamiltonian(
        "p**2/2 - (1 + a*cos(w*t))*cos(x)", q=["x"], p=["p"], parameters={"a": 0.05, "w": 1.8}
    )
    rest = hamsym.periodic_orbit(H, [0.0, 0.0], period=2 * np.pi / 1.8)
    family = rest.family(parameter=("a", 0.6))
    assert family.success
    (found,) = family.branches
    assert found.kind == "period doubling"
    delta, q = 4 / 1.8**2, 2 * found.orbit.H.parameters["a"] / 1.8**2
    ends = [mathieu(1, q), mathieu(1, -q)]  # a_1(q) and b_1(q) = a_1(-q)
    assert min(abs(delta - end) for end in ends) < 1e-8
    orbit = family.branch(0, parameter=("a", 0.385))[-1]
    assert orbit.success
    assert orbit.repetitions == 1
    assert orbit.period == pytest.approx(2 * rest.period, rel=1e-15)
    assert np.ptp(orbit(np.linspace(0, orbit.period, 50))[:, 0]) > 0.1
    assert closure(orbit) < 1e-9


@pytest.mark.parametrize(
    ("stiffness", "kinds"), [("4", ["Neimark-Sacker"]), ("-4", [])], ids=["focus", "saddle"]
)
def test_complex_pairs_cross_the_circle_where_damping_ends(stiffness, kinds):
    # van der Pol's oscillator beside a damped one, whose multipliers are exp(-c T/2 +- i ...)
    H = hamsym.Hamiltonian(
        f"p_x**2/2 + x**2/2 + p_y**2/2 + ({stiffness})*y**2/2",
        q=["x", "y"],
        p=["p_x", "p_y"],
        forces={"p_x": "(1 - x**2)*p_x", "p_y": "-c*p_y"},
        parameters={"c": 0.1},
    )
    orbit = hamsym.periodic_orbit(H, ([2.0, 0, 0, 0], 6.66))
    family = orbit.family(parameter=("c", -0.12))
    assert family.success
    assert [found.kind for found in family.bifurcations] == kinds
    assert all(abs(found.orbit.H.parameters["c"]) < 1e-7 for found in family.bifurcations)
    assert family.branches == ()


_SHAKEN = "p**2/2 + (13/10 + mu)*x**2/2 + x**4/4 - 3*x*cos(2*t)/10"


@pytest.mark.slow
@pytest.mark.parametrize("width", [1e-3, 0.03])
def test_pairs_of_neimark_sacker_bifurcations_between_neighbours(width: float) -> None:
    """By Liouville's theorem the product of the multipliers is exp of the mean divergence."""
    forces = {"p": f"-((mu - 1/2)**2 - {width**2})*p"}
    H = hamsym.Hamiltonian(_SHAKEN, forces=forces, parameters={"mu": 0.0})
    orbit = hamsym.periodic_orbit(H, [-0.1, 0.0], period=math.pi)
    family = orbit.family(parameter=("mu", 1.0))
    assert family.success
    assert [found.kind for found in family.bifurcations] == ["Neimark-Sacker"] * 2
    places = [found.orbit.H.parameters["mu"] for found in family.bifurcations]
    np.testing.assert_allclose(places, [0.5 - width, 0.5 + width], atol=1e-8)


@pytest.mark.parametrize("force", ["-x**3", "-sin(2*t)*p/5"])
def test_forces_that_keep_areas_have_no_neimark_sacker_bifurcation(force: str) -> None:
    H = hamsym.Hamiltonian(_SHAKEN, forces={"p": force}, parameters={"mu": 0.0})
    orbit = hamsym.periodic_orbit(H, [-0.1, 0.0], period=math.pi)
    assert orbit.family(parameter=("mu", 1.0)).bifurcations == ()
