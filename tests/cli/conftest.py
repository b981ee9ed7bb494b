"""A folder with a saved solution and data, in which every example of a command runs."""

from __future__ import annotations

from pathlib import Path

import pytest

import hamsym


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with orbit.hamsym and its certificate."""
    path = tmp_path_factory.mktemp("examples")
    solution = hamsym.solve("p**2/2 - cos(x)", [1.0, 0.0], (0, 3))
    solution.save(path / "orbit.hamsym")
    (path / "orbit.hamsym.certificate").write_text(solution.certify(bound=1e-6).to_json())
    return path
