"""Chebyshev points and collocation with them."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

__all__ = ["Collocation", "chebyshev_points", "collocation"]


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
    """

    nodes: np.ndarray
    integration: np.ndarray
    to_series: np.ndarray

    def interpolation(self, s: np.ndarray) -> np.ndarray:
        """Return the matrix from values at the nodes to values at s, shape (len(s), n)."""
        return chebyshev.chebvander(2 * s - 1, len(self.nodes) - 1) @ self.to_series


def chebyshev_points(count: int) -> np.ndarray:
    """Return the Chebyshev points of the first kind in (0, 1), in ascending order."""
    return (1 - np.cos((2 * np.arange(count) + 1) * math.pi / (2 * count))) / 2


@functools.cache
def collocation(count: int) -> Collocation:
    """Make the collocation tables for ``count`` nodes."""
    nodes = chebyshev_points(count)
    to_series = np.linalg.inv(chebyshev.chebvander(2 * nodes - 1, count - 1))
    integrals = chebyshev.chebint(np.eye(count), lbnd=-1, scl=0.5)
    integration = chebyshev.chebval(2 * np.append(nodes, 1.0) - 1, integrals).T @ to_series
    return Collocation(nodes, integration, to_series)
