"""Work along a trajectory: the integral of the power, dH/dt, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hamsym.numerics.collocation import collocation
from hamsym.numerics.windows import located_basis

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

_NODES = 48  # in a window; the power has products of components, which vary twice as fast as they
_WINDOWS = 400  # of a trajectory that has none of its own


class Work:
    """The integral of ``H.power`` along a path, by Chebyshev series on windows.

    - edges: Ends of windows, counted from ``origin``; with None equal windows.
    """

    def __init__(self, path: Solution, edges: np.ndarray | None, origin: float) -> None:
        if edges is None:
            edges, origin = np.linspace(*path.span, _WINDOWS + 1), 0.0
        self._edges, self._origin = edges, origin
        power = path.H.observable(path.H.power)
        rule = collocation(_NODES)
        lengths = np.diff(edges)
        times = (edges[:-1, None] + lengths[:, None] * rule.nodes).ravel() + origin
        rates = power(path(times, extrapolate=True), times).reshape(len(lengths), _NODES)
        inside = lengths[:, None] * (rates @ rule.integration[:_NODES].T)
        self._series = inside @ rule.to_series.T
        ends = lengths * (rates @ rule.integration[-1])
        self._starts = np.concatenate(([0.0], np.cumsum(ends)))

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Evaluate at times of shape (n,)."""
        window, basis = located_basis(self._edges, t - self._origin, _NODES)
        return np.asarray(self._starts[window] + (basis * self._series[window]).sum(axis=1))
