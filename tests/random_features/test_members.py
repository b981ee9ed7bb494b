"""Checks of compiled members, in plain text."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym.random_features.member_loop import keeps_energy
from hamsym.random_features.window_loop import Windows


def _zeros(z: np.ndarray, times: np.ndarray, parameters: np.ndarray, out: np.ndarray) -> None:
    out[:] = 0.0


def _coordinate(z: np.ndarray, times: np.ndarray, parameters: np.ndarray, out: np.ndarray) -> None:
    out[0] = z[0]


@pytest.mark.parametrize(
    ("slope", "change", "kept"),
    [
        (1.0, 1e-9, True),
        (1.0, 1e-6, False),
        (np.inf, 1e-9, False),
        (np.inf, 0.0, False),
        (np.nan, 0.0, False),
    ],
)
def test_energy_is_kept_only_within_a_finite_limit(slope: float, change: float, kept: bool) -> None:
    def force(z: np.ndarray, times: np.ndarray, parameters: np.ndarray, out: np.ndarray) -> None:
        out[:] = slope

    windows = Windows(
        np.array([0.0, 1.0]), np.array([[1.0, 0.5], [1.0 + change, 0.5]]), np.zeros((1, 4, 2))
    )
    # H is the coordinate.
    rows = _zeros, force, _coordinate
    assert keeps_energy(*rows, windows, np.empty(0), 1e-9, np.array([1.0, 0.5])) is kept
