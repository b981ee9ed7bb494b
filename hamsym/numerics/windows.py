"""Consecutive windows: the location of times in them, series on them, and times in each."""

from __future__ import annotations

import math

import numpy as np

from hamsym.numerics.collocation import chebyshev_values


def locate(edges: np.ndarray, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the window of each time and the position s in it.

    - edges: Ends of the windows, ascending or descending, shape (n + 1,).
    - t: Times, any shape. Times outside the windows belong to the first or last one.
    - returns window, s: Indices from 0 to n - 1, and positions in [0, 1] within the window, shaped
      as t.

    Examples
    --------
    >>> locate(np.array([0.0, 1.0, 3.0]), np.array([0.5, 1.0, 2.5, 3.5]))
    (array([0, 1, 1, 1]), array([0.5 , 0.  , 0.75, 1.25]))
    """
    direction = math.copysign(1.0, float(edges[-1] - edges[0]))
    window = np.searchsorted(direction * edges, direction * t, side="right") - 1
    window = np.clip(window, 0, len(edges) - 2)
    start = edges[window]
    return window, (t - start) / (edges[window + 1] - start)


def located_basis(edges: np.ndarray, t: np.ndarray, terms: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the window of each time, and the Chebyshev polynomials there, (*t.shape, terms).

    Times outside the windows count as their first or last one.
    """
    window, s = locate(edges, t)
    return window, chebyshev_values(np.clip(2 * s - 1, -1, 1), terms)


def times_in_windows(edges: np.ndarray, per_window: int) -> np.ndarray:
    """Return equally spaced times in each window, with its start, and the end.

    Examples
    --------
    >>> times_in_windows(np.array([0.0, 1.0, 3.0]), 2)
    array([0. , 0.5, 1. , 2. , 3. ])
    """
    inside = np.linspace(0, 1, per_window, endpoint=False)
    within = edges[:-1, None] + np.diff(edges)[:, None] * inside
    return np.append(within.ravel(), edges[-1])
