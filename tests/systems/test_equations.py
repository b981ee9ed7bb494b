"""Hamiltonians of the catalogue against the equations of motion as the literature writes them."""

from __future__ import annotations

import math

import numpy as np
import pytest
import scipy.integrate
import scipy.special

import hamsym
from hamsym import systems
from hamsym.integrators.adaptive import reference
from hamsym.systems import Problem

RANDOM = np.random.default_rng(5)


def rates(problem: Problem, z: np.ndarray, t: float = 0.0) -> np.ndarray:
    system = problem.H.compile("numpy")
    return system.vector_field(*system.arguments(np.asarray(z), t))


def energy(problem: Problem, z: np.ndarray) -> float:
    return float(problem.H.compile("numpy").energy(np.asarray(z)))


# -- celestial mechanics ---------------------------------------------------------------------------


def test_restricted_problem_has_the_coriolis_force() -> None:
    """x'' = x + 2 y' - ..., y'' = y - 2 x' - ... (Hairer, Norsett & Wanner, II.0)."""
    mu = 0.012277471
    x, y, p_x, p_y = z = RANDOM.normal(size=4)
    vx, vy, ax, ay = rates(systems.arenstorf(), z)
    assert (vx, vy) == pytest.approx((p_x + y, p_y - x))
    # The momenta are x' - y and y' + x.
    ax, ay = ax + vy, ay - vx
    first, second = ((x + mu) ** 2 + y**2) ** 1.5, ((x - 1 + mu) ** 2 + y**2) ** 1.5
    pull = (1 - mu) * (x + mu) / first + mu * (x - 1 + mu) / second
    assert ax == pytest.approx(x + 2 * vy - pull)
    assert ay == pytest.approx(y - 2 * vx - (1 - mu) * y / first - mu * y / second)


def test_restricted_problem_in_space_is_the_planar_one_with_a_pull_to_the_plane() -> None:
    problem, mu = systems.halo_orbits(), 0.01215058560962404
    x, y, z, p_x, p_y, p_z = state = RANDOM.normal(size=6)
    found = rates(problem, state)
    planar = rates(systems.restricted_three_bodies(mu), [x, y, p_x, p_y])
    assert found[:2] == pytest.approx(planar[:2])
    first, second = ((x + mu) ** 2 + y**2, (x - 1 + mu) ** 2 + y**2)
    pulls = (1 - mu) / (first + z**2) ** 1.5, mu / (second + z**2) ** 1.5
    assert found[2] == p_z
    assert found[5] == pytest.approx(-sum(pulls) * z)
    assert found[4] == pytest.approx(-p_x - sum(pulls) * y)
    assert found[3] == pytest.approx(p_y - pulls[0] * (x + mu) - pulls[1] * (x - 1 + mu))


@pytest.mark.parametrize("mu", [0.01, 0.3])
def test_triangular_point_is_at_rest(mu: float) -> None:
    problem = systems.restricted_three_bodies(mu)
    x, y = 0.5 - mu, math.sqrt(3) / 2
    assert problem.z0 == pytest.approx((x + 0.01, y, -y, x + 0.01))
    np.testing.assert_allclose(rates(problem, [x, y, -y, x]), 0, atol=1e-15)


@pytest.mark.slow
def test_small_body_stays_near_a_triangular_point() -> None:
    problem = systems.restricted_three_bodies()
    z = reference(problem.H, problem.z0, (0, 400))(np.linspace(0, 400, 401))
    assert np.hypot(z[:, 0] - 0.49, z[:, 1] - math.sqrt(3) / 2).max() < 0.2


@pytest.mark.slow
def test_stars_attract_each_other_by_their_masses() -> None:
    mass = np.arange(1, 8)
    x, y, px, py = z = RANDOM.normal(size=(4, 7))
    dx, dy = x - x[:, None], y - y[:, None]
    cubes = np.hypot(dx, dy) ** 3 + np.eye(7)
    forces = [mass * ((d / cubes) @ mass) for d in (dx, dy)]
    found = rates(systems.pleiades(), z.ravel()).reshape(4, 7)
    np.testing.assert_allclose(found, [px / mass, py / mass, *forces], rtol=1e-12)


# -- charges ---------------------------------------------------------------------------------------


def test_stormer_problem_is_motion_in_a_dipole_field() -> None:
    """The Lorentz force in space, v' = v x B, projected on the meridian plane."""
    problem = systems.stormer()
    rho, z, p_rho, p_z = problem.z0

    def lorentz(_: float, state: np.ndarray) -> np.ndarray:
        r, v = state[:3], state[3:]
        length = np.linalg.norm(r)
        field = 3 * r[2] * r / length**5 - np.array([0, 0, 1]) / length**3
        return np.concatenate((v, np.cross(v, field)))

    start = (rho, 0, z, p_rho, 1 / rho - rho / math.hypot(rho, z) ** 3, p_z)
    found = scipy.integrate.solve_ivp(
        lorentz, (0, 20), start, "DOP853", rtol=1e-12, atol=1e-12, t_eval=[5, 20]
    ).y
    truth = reference(problem.H, problem.z0, (0, 20))(np.array([5.0, 20.0]))
    np.testing.assert_allclose(np.hypot(found[0], found[1]), truth[:, 0], atol=1e-9)
    np.testing.assert_allclose(found[2], truth[:, 1], atol=1e-9)
    assert energy(problem, problem.z0) < 1 / 32


def test_ion_at_the_edge_of_stability_follows_mathieus_function() -> None:
    q = 0.4
    a = float(scipy.special.mathieu_a(0, q))
    t = np.linspace(0, 6, 61)
    problem = systems.paul_trap(a + 1e-9, q)
    even = scipy.special.mathieu_cem(0, q, np.degrees(t))[0]
    np.testing.assert_allclose(problem.exact(t)[:, 0], even / even[0], atol=1e-7)


# -- vortices --------------------------------------------------------------------------------------


def test_vortices_move_by_biot_and_savart() -> None:
    x, y = RANDOM.normal(size=(2, 5))
    z = x + 1j * y
    distance = z[:, None] - z + np.eye(5)
    # The conjugate velocity of strength 2 pi at z_k is 1/(i (z - z_k)).
    velocity = np.conj(((1 - np.eye(5)) / (1j * distance)).sum(axis=1))
    found = rates(systems.point_vortices(5), np.concatenate((x, y)))
    np.testing.assert_allclose(found, [*velocity.real, *velocity.imag], rtol=1e-12)


# -- atoms -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_argon_crystal_has_the_published_energy() -> None:
    """-1260.2 K in Hairer, Lubich & Wanner, section I.4."""
    problem = systems.argon_crystal()
    assert energy(problem, problem.z0) * 66.34e-27 / 1.380658e-23 == pytest.approx(
        -1260.2, abs=0.05
    )


@pytest.mark.parametrize(("n", "bonds"), [(2, 1), (3, 3)])
def test_atoms_start_at_the_lowest_energy_of_pairs(n: int, bonds: int) -> None:
    problem = systems.lennard_jones(n)
    at_rest = [*problem.z0[: 2 * n], *[0.0] * (2 * n)]
    assert energy(problem, at_rest) == pytest.approx(-bonds, abs=1e-6)
    assert energy(problem, problem.z0) == pytest.approx(-bonds + 0.045 * n, abs=1e-3)


def test_seven_atoms_are_a_hexagon() -> None:
    x, y = np.array(systems.lennard_jones(7).z0[:14]).reshape(2, 7)
    np.testing.assert_allclose(np.hypot(x, y), [0.0] + [2 ** (1 / 6)] * 6, atol=1e-4)


# -- tops ------------------------------------------------------------------------------------------


def body_vectors(z: np.ndarray) -> np.ndarray:
    """Angular momentum and the vertical in the frame of the body, from Euler angles."""
    _, psi, theta, p_phi, p_psi, p_theta = z
    across = (p_phi - p_psi * math.cos(theta)) / math.sin(theta)
    sine, cosine = math.sin(psi), math.cos(psi)
    M = (across * sine + p_theta * cosine, across * cosine - p_theta * sine, p_psi)
    up = (math.sin(theta) * sine, math.sin(theta) * cosine, math.cos(theta))
    return np.array([M, up])


@pytest.mark.parametrize(
    ("problem", "inertia", "centre"),
    [
        (systems.kovalevskaya_top(), (1, 1, 0.5), (1, 0, 0)),
        (systems.lagrange_top(axial=0.3, weight=1.7), (1, 1, 0.3), (0, 0, 1.7)),
    ],
    ids=["Kovalevskaya", "Lagrange"],
)
def test_tops_obey_the_equations_of_euler_and_poisson(problem, inertia, centre) -> None:
    """M' = M x Omega + up x centre (weight times centre of mass), up' = up x Omega."""
    z, h = np.array([0.4, 0.9, 1.1, 0.7, -0.5, 0.3]), 1e-5
    flow = rates(problem, z)
    change = (body_vectors(z + h * flow) - body_vectors(z - h * flow)) / (2 * h)
    M, up = body_vectors(z)
    omega = M / np.array(inertia)
    expected = [np.cross(M, omega) + np.cross(up, centre), np.cross(up, omega)]
    np.testing.assert_allclose(change, expected, atol=1e-8)


# -- named starts ----------------------------------------------------------------------------------


def test_henon_heiles_starts_have_their_energies() -> None:
    for start in systems.henon_heiles().starts[1:]:
        problem = systems.henon_heiles(start)
        numerator, denominator = start.removeprefix("E = ").split(",")[0].split("/")
        expected = int(numerator) / int(denominator)
        assert energy(problem, problem.z0) == pytest.approx(expected, rel=1e-14)


@pytest.mark.slow
def test_henon_heiles_starts_are_as_chaotic_as_named() -> None:
    starts = systems.henon_heiles().starts
    z0 = np.array([systems.henon_heiles(start).z0 for start in starts])
    found = hamsym.lyapunov(systems.henon_heiles().H, z0, (0, 4000), dt=0.1)
    for start, exponent in zip(starts, found.maximal, strict=True):
        assert (exponent > 0.02) == ("chaotic" in start)
        assert exponent > 0.02 or exponent < 0.004


@pytest.mark.parametrize("make", [systems.henon_heiles, systems.arenstorf, systems.point_vortices])
def test_starts_are_named_and_differ(make) -> None:
    usual = make()
    assert usual.start == usual.starts[0]
    made = [make(start=start) for start in usual.starts]
    assert [problem.start for problem in made] == list(usual.starts)
    assert len({problem.z0 for problem in made}) == len(made) > 1
    with pytest.raises(hamsym.InputError, match="cannot be used; give one of "):
        make(start="elsewhere")
