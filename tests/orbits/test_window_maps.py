"""The equations inside windows, of full and of half the size."""

import numpy as np
import pytest

from hamsym.numerics.collocation import collocation
from hamsym.orbits import window_maps

INSIDE = collocation(9).integration[:-1]


def jacobians(kind: str, dof: int = 3) -> np.ndarray:
    """Return J Hess at the nodes of four windows: half are symmetric blocks, of which some vary."""
    random = np.random.default_rng(dof)
    found = np.zeros((4, 9, 2 * dof, 2 * dof))
    drift, force = random.uniform(-1, 1, (2, 4, 9, dof, dof))
    if kind != "drift varies":
        drift[:] = drift[:, :1]
    found[..., :dof, dof:], found[..., dof:, :dof] = drift, force
    if kind == "friction":
        found[..., dof:, dof:] = -np.eye(dof) / 3
    if kind == "mixed":
        found[..., :dof, :dof] = random.uniform(-1, 1, (4, 9, dof, dof))
    return found


@pytest.mark.parametrize(
    ("kind", "unknowns"), [("quadratic", 27), ("drift varies", 54), ("friction", 54), ("mixed", 54)]
)
def test_equations_of_windows_are_solved(monkeypatch, kind, unknowns):
    sizes = []

    def counted(matrices, right, solved=window_maps.solved):
        sizes.append(matrices.shape[-1])
        return solved(matrices, right)

    monkeypatch.setattr(window_maps, "solved", counted)
    matrices = jacobians(kind)
    columns = np.random.default_rng(1).uniform(-1, 1, (4, 9, 6, 5))
    found = window_maps._solved(INSIDE, matrices, columns)
    expected = columns + np.einsum("ij,kjab,kjbc->kiac", INSIDE, matrices, found)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert sizes == [unknowns]
