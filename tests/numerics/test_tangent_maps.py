"""Tangent maps and forced solutions of an oscillator, against exact ones."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym.numerics.tangent_maps import TangentMaps

LENGTHS = np.array([0.5, -1.0, 2.0])


def driven(w: float, drive: float, positions: np.ndarray, size: float) -> np.ndarray:
    """Coefficients of x'' = -w**2 x + size cos(drive t), from t = 0 in every window."""
    t = LENGTHS[:, None] * positions
    found = np.zeros((*t.shape, 2, 3))
    found[..., 0, 1], found[..., 1, 0] = 1.0, -(w**2)
    found[..., 1, 2] = size * np.cos(drive * t)
    return found


def maps(w: float, drive: float, size: float = 1.0) -> tuple[TangentMaps, np.ndarray]:
    """The maps, and their defects."""
    found = TangentMaps(driven(w, drive, TangentMaps.nodes, size), LENGTHS, np.array([1.0, w]))
    return found, found.defects(driven(w, drive, TangentMaps.between, size))


@pytest.mark.parametrize("w", [1.3, 12.0])  # the larger one needs the direct solution
@pytest.mark.parametrize("size", [1.0, 1e-200, 1e200])
def test_maps_and_forced_solutions_are_exact(w: float, size: float) -> None:
    found, defects = maps(w, 3.0, size)
    c, s, size_x = np.cos(w * LENGTHS), np.sin(w * LENGTHS), 1 / (w**2 - 9)
    x = size_x * (np.cos(3 * LENGTHS) - c)
    p = size_x * (w * s - 3 * np.sin(3 * LENGTHS))
    expected = np.array([[c, s, x], [-s, c, p / w]]).transpose(2, 0, 1)
    ends = found.ends / [1, 1, size]
    np.testing.assert_allclose(ends[:2], expected[:2], atol=1e-11)
    np.testing.assert_allclose(ends[2], expected[2], atol=1e-11 if w < 2 else 1e-6)
    assert (defects[:2] < 1e-10).all()


@pytest.mark.parametrize(("w", "drive"), [(400.0, 3.0), (1.3, 400.0)])
def test_defects_show_unresolved_windows(w: float, drive: float) -> None:
    assert (maps(w, drive)[1] > 1e-3).all()


def test_defects_ignore_negligible_forcing() -> None:
    found = maps(1.3, 400.0, 1e-30)[0]
    between = driven(1.3, 400.0, TangentMaps.between, 1e-30)
    assert (found.defects(between, np.array([1e-10])) < 1e-12).all()


def test_forcing_between_the_nodes_is_noticed() -> None:
    found = TangentMaps(driven(1.3, 0.0, TangentMaps.nodes, 0.0), LENGTHS, np.ones(2))
    assert (found.ends[:, :, 2] == 0).all()
    assert (found.defects(driven(1.3, 0.0, TangentMaps.between, 1e-9)) > 0.1).all()


def test_effects_of_round_off_are_small() -> None:
    found, _ = maps(1.3, 3.0)
    changes = 1e-16 * driven(1.3, 3.0, TangentMaps.between, 1.0)
    effects = found.effects(changes)
    assert ((effects > 1e-17) & (effects < 1e-15)).all()
