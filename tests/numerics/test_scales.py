"""Sizes of components, each in its own units."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym import Hamiltonian
from hamsym.numerics.scales import coupled_sizes, tangent_scales


def test_coupled_sizes_follow_the_units() -> None:
    rng = np.random.default_rng(1)
    coupling, sizes = rng.uniform(size=(6, 6)), rng.uniform(size=6)
    sizes[2] = 0.0
    units = 10.0 ** rng.integers(-20, 20, 6)
    scaled = coupled_sizes(sizes * units, coupling * units[:, None] / units, 3.0)
    np.testing.assert_allclose(scaled, coupled_sizes(sizes, coupling, 3.0) * units, rtol=1e-12)


def test_decoupled_zero_keeps_the_size_zero() -> None:
    coupling = np.zeros((4, 4))
    coupling[0, 2] = coupling[2, 0] = 1.0
    np.testing.assert_array_equal(coupled_sizes(np.array([1.0, 0, 1, 0]), coupling, 9.0)[1::2], 0)


def test_coupling_acts_no_longer_than_the_span() -> None:
    found = coupled_sizes(np.array([2.0, 0.0]), np.array([[0.0, 1.0], [9.0, 0.0]]), 0.1)
    np.testing.assert_allclose(found, [2.0, 1.8], rtol=1e-12)


def test_coupling_that_is_not_finite_changes_nothing() -> None:
    sizes = np.array([1.0, 2.0])
    np.testing.assert_array_equal(coupled_sizes(sizes, np.full((2, 2), np.nan), 1.0), sizes)


def test_weak_coupling_does_not_enlarge_a_scale() -> None:
    solution = hamsym.solve("p**2/2 + p*sin(50*t) + 1e-40*x**2/2", [0.0, 1.0], (0, 10), tol=1e-9)
    assert solution.success
    # x' = p + sin(50 t), with p constant but for 1e-39.
    t = np.linspace(0, 10, 501)
    np.testing.assert_allclose(solution(t)[:, 0], t + (1 - np.cos(50 * t)) / 50, atol=1e-8)


@pytest.mark.parametrize("tol", [1e-5, 1e-9])
def test_units_of_a_component_change_nothing(tol: float) -> None:
    """Kepler's angle and radius in units 1e11 apart: errors in each, relative to its own size."""
    text = "p_r**2/(2*m) + p_phi**2/(2*m*r**2) - k*m/r"
    plain = Hamiltonian(text, parameters={"m": 1.0, "k": 1.0})
    metres, seconds, mass = 2.0**37, 2.0**22, 2.0**82
    large = Hamiltonian(text, parameters={"m": mass, "k": metres**3 / seconds**2})
    names, z0 = plain.names, {"r": 1.0, "phi": 0.0, "p_r": 0.1, "p_phi": 0.9}
    action = mass * metres**2 / seconds
    units = {"r": metres, "phi": 1.0, "p_r": action / metres, "p_phi": action}
    small = hamsym.solve(plain, z0, (0, 50), tol=tol)
    big = hamsym.solve(large, {n: z0[n] * units[n] for n in names}, (0, 50 * seconds), tol=tol)
    assert small.success, small.message
    assert big.success, big.message
    t = np.linspace(0, 50, 201)
    factors = np.array([units[name] for name in names])
    assert (
        np.abs(big(t * seconds) / factors - small(t)).max(axis=0) <= 2 * tol * small.scale
    ).all()
    relative = big.error.largest / big.scale
    np.testing.assert_allclose(relative, small.error.largest / small.scale, rtol=1.0)


def test_tangent_vectors_of_an_angle_that_moves_nothing() -> None:
    """Of a central force, for (r, phi, p_r, p_phi): its column is zero, and the row of p_phi."""
    jacobian = np.array([[0, 0, 1.0, 0], [2, 0, 0, 1], [3, 0, 0, 2], [0, 0, 0, 0]])
    length, momentum, time = 2.0**-33, 2.0**-79, 2.0**-53
    units = np.array([length, 1.0, momentum, momentum * length])
    found = tangent_scales(jacobian * units[:, None] / units / time) / units
    assert found.max() < 4 * found.min()


def test_tangent_vectors_of_a_free_particle_have_one_unit() -> None:
    np.testing.assert_array_equal(tangent_scales(np.array([[0.0, 1.0], [0.0, 0.0]])), 1)
