"""Homoclinic and heteroclinic connections, against exact and published ones."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import hamsym
from hamsym import InputError
from tests.invariant_manifolds.test_manifolds import HENON, _lyapunov

DUFFING = "p**2/2 - x**2/2 + x**4/4"


def _manifolds(formula: str, **options: object) -> hamsym.Manifolds:
    saddle = next(one for one in hamsym.equilibria(formula) if one.stable is False)
    return saddle.manifolds(**options)


def test_duffing_has_two_homoclinic_loops() -> None:
    found = _manifolds(DUFFING, duration=6)
    loops = hamsym.connections(found.unstable, found.stable, "p = 0")
    assert loops.success
    assert len(loops) == 2
    for loop in loops:
        assert abs(abs(loop.z[0]) - math.sqrt(2)) < 1e-12
        assert loop.mismatch < 1e-12
        t = np.linspace(*loop.span, 101)
        assert np.abs(np.abs(loop(t)[:, 0]) - math.sqrt(2) / np.cosh(t)).max() < 1e-11
    assert loops[0](0.0).shape == (2,)
    with pytest.raises(InputError, match="span"):
        loops[0](1e3)


def test_henon_heiles_saddle_has_a_homoclinic_loop() -> None:
    saddle = next(one for one in hamsym.equilibria(HENON) if abs(one.z[1] - 1) < 1e-9)
    found = saddle.manifolds(duration=5)
    [loop] = hamsym.connections(found.unstable, found.stable, "p_y = 0")
    np.testing.assert_allclose(loop.z, [0, -0.5, 0, 0], atol=1e-12)


def test_manifolds_that_do_not_meet_have_no_connection() -> None:
    saddles = [one for one in hamsym.equilibria(HENON) if one.stable is False]
    first, second = (one.manifolds(length=3) for one in saddles[:2])
    found = hamsym.connections(first.unstable, second.stable, "p_x + 2*p_y = 0.3")
    assert not found.success
    assert len(found) == 0
    assert "0 connections" in found.message


def test_family_in_a_parameter() -> None:
    H = hamsym.Hamiltonian("p**2/2 - k*x**2/2 + x**4/4", parameters={"k": 1.0})
    saddle = next(one for one in hamsym.equilibria(H) if one.stable is False)
    found = saddle.manifolds(duration=6)
    loop = hamsym.connections(found.unstable, found.stable, "p = 0")[0]
    family = loop.family(parameter=("k", 4.0), steps=3)
    assert family[-1].H.parameters["k"] == 4.0
    for one in family:
        k = one.H.parameters["k"]
        assert one.success
        assert abs(abs(one.z[0]) - math.sqrt(2 * k)) < 1e-11
    with pytest.raises(InputError, match="one energy"):
        loop.family(energy=1.0)
    with pytest.raises(InputError, match="no parameter"):
        loop.family(parameter=("q", 1.0))
    with pytest.raises(InputError, match="one of"):
        loop.family()


def test_orbit_has_symmetric_homoclinic_connections() -> None:
    H, orbit = _lyapunov(0.18)
    parts = orbit.manifolds(count=6, spacing=0.3, duration=8)
    found = hamsym.connections(parts.unstable, parts.stable, "y = -0.3, p_y < 0", crossings=1)
    assert found.success
    assert not parts.unstable.success  # some trajectories run to infinity
    assert f"; unstable manifold: {parts.unstable.message}" in found.message
    assert len(found) == 4
    assert all(one.mismatch < 1e-10 and one.transversality > 1e-2 for one in found)
    mirrored = sorted(one.z[0] for one in found)  # H does not change under x -> -x
    np.testing.assert_allclose(mirrored, -np.array(mirrored)[::-1], atol=1e-9)
    one = found[0]
    assert abs(H.compile("numpy").energy(one.z) - 0.18) < 1e-11
    # An independent integrator stays with it, to both local manifolds.
    for end, side in zip(one.span, one.met.sides, strict=True):
        path = solve_ivp(_field(H), (0, end), one.z, method="DOP853", rtol=1e-13, atol=1e-15)
        assert np.abs(path.y[:, -1] - side.start()).max() < 1e-9


def _field(H: hamsym.Hamiltonian) -> Callable[..., np.ndarray]:
    gradient = H.compile("numpy").gradient
    J = np.kron([[0, 1], [-1, 0]], np.eye(H.dof))
    return lambda t, z: J @ np.asarray(gradient(z))


def test_arguments_that_do_not_fit_are_refused() -> None:
    found = _manifolds(DUFFING, duration=4)
    other = _manifolds("p**2/2 - x**2/2 + x**4/2", duration=4)
    cases = [
        ((found.stable, found.stable, "p = 0"), "give the unstable one"),
        ((found, found.stable, "p = 0"), "not a manifold"),
        ((found.unstable, other.stable, "p = 0"), "two Hamiltonians"),
        ((found.unstable, found.stable, "q = 0"), "q"),
    ]
    for arguments, what in cases:
        with pytest.raises(InputError, match=what):
            hamsym.connections(*arguments)
    with pytest.raises(InputError, match="connection=3 cannot be used; give a Connection"):
        hamsym.connection_family(3)  # type: ignore[arg-type]
    tilted = "p**2/2 - x**2/2 + x**4/4 + x**3/10 - x**6/1000"
    saddles = [one for one in hamsym.equilibria(tilted) if one.stable is False]
    parts = [one.manifolds(duration=3) for one in saddles[:2]]
    with pytest.raises(InputError, match="keeps its energy"):
        hamsym.connections(parts[0].unstable, parts[1].stable, "p = 0")


def test_driven_oscillator_has_its_homoclinic_points() -> None:
    """Melnikov: the force changes the energy on the loop by a multiple of sin t at p = 0."""
    H = hamsym.Hamiltonian("p**2/2 - x**2/2 + x**4/4 - 0.1*x*cos(t)")
    orbit = hamsym.periodic_orbit(H, [-0.05, 0], period="2*pi")
    parts = orbit.manifolds(count=16, duration=9.5, spacing=0.2)
    found = hamsym.connections(parts.unstable, parts.stable, "p = 0, x > 1", crossings=1)
    assert found.success
    assert len(found) == 2
    for one in found:
        turns = one.clock / np.pi
        assert abs(turns - round(turns)) < 1e-9
        assert one.mismatch < 1e-10
        end = solve_ivp(
            lambda t, z: [z[1], z[0] - z[0] ** 3 + 0.1 * math.cos(t)],
            (one.clock, one.clock + one.span[1]), one.z,
            method="DOP853", rtol=1e-13, atol=1e-15,
        )  # fmt: skip
        # Differences grow by the multiplier, 529, in each turn.
        assert np.abs(end.y[:, -1] - one.met.sides[1].start()).max() < 1e-8
    assert len({round(one.clock / np.pi) % 2 for one in found}) == 2


# -- the connection of Oterma's energy -------------------------------------------------------------

#: Sun and Jupiter; Koon, Lo, Marsden & Ross 2000; Wilczak & Zgliczynski 2003.
MU, JACOBI = 9.537e-4, 3.03
ORBITS = {"L1": (0.9208034913207400196, 1), "L2": (1.081929486841799903, -1)}


def _oterma(name: str) -> hamsym.PeriodicOrbit:
    H = hamsym.systems.restricted_three_bodies(MU).H
    x, sign = ORBITS[name]
    potential = 2 * ((1 - MU) / abs(x + MU) + MU / abs(x - 1 + MU)) + MU * (1 - MU)
    state = [x, 0.0, 0.0, sign * math.sqrt(x**2 + potential - JACOBI) + x]
    energy = -(JACOBI - MU * (1 - MU)) / 2
    symmetry = {"y": "-y", "p_x": "-p_x"}
    return hamsym.periodic_orbit(H, (state, 3.1), energy=energy, symmetry=symmetry)


@pytest.mark.parametrize("name", ORBITS)
def test_lyapunov_orbits_are_those_of_the_proof(name: str) -> None:
    orbit = _oterma(name)
    assert orbit.success
    assert abs(orbit.z0[0] - ORBITS[name][0]) < 1e-13


#: Crossings (x, x') of y = 0 about which the proof has its sets, in the middle of the connection.
PUBLISHED = [
    (0.957916338594066441, 0.02191497366476494527),
    (1.030069865952822683, 0.00330658676251664686),
    (0.967306682018305608, 0.003703230165036550462),
    (1.040628850444842879, 0.02317063455298806404),
]


@pytest.mark.slow
def test_heteroclinic_connection_is_that_of_the_proof() -> None:
    first, second = (_oterma(name).manifolds(duration=4) for name in ORBITS)
    found = hamsym.connections(first.unstable, second.stable, "y = 0")
    assert found.success
    assert len(found) >= 2
    assert all(one.mismatch < 1e-10 and one.transversality > 1e-2 for one in found)
    nearest = [min(_differences(one, *place) for one in found) for place in PUBLISHED]
    assert max(nearest) < 1e-8
    assert max(nearest[1:]) < 2e-9


def _differences(one: hamsym.Connection, x: float, velocity: float) -> float:
    """The least difference of a crossing of y = 0 from a published one."""
    t = np.linspace(*one.span, 4_001)
    y = one(t)[:, 1]
    best = math.inf
    for k in np.flatnonzero(np.sign(y[1:]) != np.sign(y[:-1])):
        z = one(brentq(lambda s: one(s)[1], t[k], t[k + 1], xtol=1e-15))
        best = min(best, max(abs(z[0] - x), abs(z[2] + z[1] - velocity)))
    return best


@pytest.mark.slow
def test_homoclinic_connection_in_the_exterior_is_that_of_the_proof() -> None:
    parts = _oterma("L2").manifolds(duration=9)
    found = hamsym.connections(parts.unstable, parts.stable, "y = 0, x < 0", crossings=2)
    nearest = min(found, key=lambda one: abs(one.z[0] + 2.08509704964865536))
    assert abs(nearest.z[0] + 2.08509704964865536) < 1e-10
    assert abs(nearest.z[2]) < 1e-10


@pytest.mark.slow
def test_family_in_the_energy() -> None:
    """The connection that passes Jupiter once, found with few trajectories."""
    first, second = (_oterma(name).manifolds(duration=1.4, count=8, spacing=10) for name in ORBITS)
    found = hamsym.connections(first.unstable, second.stable, "x = 1 - mu, y < 0", crossings=1)
    one = found[0]
    assert one.success
    assert one.mismatch < 1e-10
    assert abs(one.z[1] + 0.05087632689437) < 1e-10
    energy = one.energy - 5e-4  # Jacobi constant 3.031
    family = one.family(energy=energy, steps=2)
    assert abs(family[-1].energy - energy) < 1e-12
    assert all(each.success and each.mismatch < 1e-10 for each in family)
    assert len({round(each.z[1], 6) for each in family}) == len(family)


@pytest.mark.slow
def test_foci_have_doubly_asymptotic_orbits() -> None:
    """From L4 to L5 with two equal masses, through the line of both at a right angle."""
    H = hamsym.systems.restricted_three_bodies(0.5).H
    height = math.sqrt(3) / 2
    first, second = (
        hamsym.equilibria(H, [0, sign * height, -sign * height, 0])[0].manifolds(duration=9)
        for sign in (1, -1)
    )
    assert first.unstable.dimension == 2
    found = hamsym.connections(first.unstable, second.stable, "y = 0", crossings=2)
    symmetric = [one for one in found if abs(one.z[2]) < 1e-9]
    assert symmetric
    for one in symmetric:
        path = solve_ivp(
            _field(H), (0, one.span[1]), one.z, method="DOP853", rtol=1e-13, atol=1e-15
        )
        assert np.abs(path.y[:, -1] - one.met.sides[1].start()).max() < 1e-8
