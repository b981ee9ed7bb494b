"""A folder with a saved solution and data, in which every example of a command runs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import hamsym


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with orbit.hamsym, its certificate, and the data swing.csv of a pendulum."""
    path = tmp_path_factory.mktemp("examples")
    solution = hamsym.solve("p**2/2 - cos(x)", [1.0, 0.0], (0, 3))
    solution.save(path / "orbit.hamsym")
    (path / "orbit.hamsym.certificate").write_text(solution.certify(bound=1e-6).to_json())
    H = hamsym.Hamiltonian("p**2/2 - g*cos(theta)", parameters={"g": 1.6})
    t = np.linspace(0, 3, 50)
    theta = hamsym.solve(H, [0.9, 0.0], (0, 3))(t)[:, 0]
    theta += 0.02 * np.random.default_rng(0).normal(size=len(t))
    table = np.column_stack((t, theta))
    np.savetxt(path / "swing.csv", table, delimiter=",", header="t,theta", comments="")
    return path
