"""Chebyshev points and collocation with them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev


@dataclass(frozen=True)
class Collocation:
    """Polynomial collocation on [0, 1].

    Attributes
    ----------
    nodes : numpy.ndarray
        Chebyshev points of the first kind, shape (n,).
    integration : numpy.ndarray
        Values at the nodes -> integrals from 0 to each node and, last, to 1, shape (n + 1, n).
    to_series : numpy.ndarray
        Values at the nodes -> Chebyshev series in 2 s - 1, shape (n, n).
    extended_integration : numpy.ndarray
        ``integration`` in extended precision (numpy.longdouble).
    """

    nodes: np.ndarray
    integration: np.ndarray
    to_series: np.ndarray
    extended_integration: np.ndarray

    def interpolation(self, s: np.ndarray) -> np.ndarray:
        """Return the matrix from values at the nodes to values at s, shape (len(s), n)."""
        return chebyshev.chebvander(2 * s - 1, len(self.nodes) - 1) @ self.to_series


def chebyshev_points(count: int) -> np.ndarray:
    """Return the Chebyshev points of the first kind in (0, 1), in ascending order."""
    return (1 - np.cos((2 * np.arange(count) + 1) * math.pi / (2 * count))) / 2


@functools.cache
def collocation(count: int) -> Collocation:
    """Make the collocation tables for ``count`` nodes."""
    exact = np.longdouble
    angles = (2 * np.arange(count) + 1) * np.arccos(exact(-1)) / (2 * count)
    degrees = np.arange(count)[:, None]
    to_series = np.cos(degrees * angles) * np.where(degrees % 2, -2, 2) / exact(count)
    to_series[0] /= 2
    integrals = chebyshev.chebint(np.eye(count, dtype=exact), lbnd=-1, scl=exact(0.5))
    places = np.append(-np.cos(angles), exact(1))
    integration = chebyshev.chebval(places, integrals).T @ to_series
    return Collocation(
        chebyshev_points(count), integration.astype(float), to_series.astype(float), integration
    )
