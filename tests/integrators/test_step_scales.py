"""Rates of the linear motion."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym import Hamiltonian
from hamsym.integrators.step_scales import fastest_rates


def test_rates_are_spectral_radii() -> None:
    """0 for a shear, infinite where the Hessian is; of the pendulum as the formula has them."""
    H = Hamiltonian("p**2/2 - cos(x)")
    path = np.random.default_rng(0).uniform(-1, 1, (50, 3, 2))
    found = fastest_rates(H, path, 0.0)
    np.testing.assert_allclose(found, np.sqrt(np.cos(path[..., 0])), rtol=1e-12)
    falling = Hamiltonian("p**2/2 + x")
    assert fastest_rates(falling, np.ones((1, 3, 2)), 0.0).tolist() == [[0.0, 0.0, 0.0]]
    centre = Hamiltonian("p**2/2 + 1/x")
    path = np.array([[1.0, 0.0], [0.0, 0.0], [np.nan, 0.0]])
    np.testing.assert_allclose(fastest_rates(centre, path, 0.0), [np.sqrt(2), np.inf, np.inf])


@pytest.mark.parametrize(("length", "momentum"), [(1e-10, 1e-24), (1.0, 1e-24)])
def test_rates_do_not_depend_on_units(length: float, momentum: float) -> None:
    """An oscillator with a magnetic field that turns, and a cyclic angle phi."""
    H = Hamiltonian(
        "e*((p_x/P - y/L/2)**2 + (p_y/P + x/L/2)**2 + (x/L)**4 + (p_phi/(L*P) - x*y/L**2)**2)",
        parameters={"e": length * momentum, "L": length, "P": momentum},
        q=["x", "y", "phi"],
        p=["p_x", "p_y", "p_phi"],
    )
    units = np.array([length, length, 1.0, momentum, momentum, length * momentum])
    states = np.random.default_rng(1).uniform(0.2, 1, (20, 3, 6)) * units
    found = fastest_rates(H, states, 0.0)
    plain = H.with_parameters(e=1.0, L=1.0, P=1.0)
    right = fastest_rates(plain, states / units, 0.0)
    np.testing.assert_allclose(found, right, rtol=1e-6)
