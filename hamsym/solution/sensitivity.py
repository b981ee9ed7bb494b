"""The sensitivity dz(t)/dz0 along a solution: the tangent map as a function of time.

Phi' = J Hess(z^(t)) Phi with Phi = 1 at the start of the span. Each window is solved by collocation
(:mod:`hamsym.numerics.tangent_maps`), in units of the components' scales.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from hamsym.numerics.chebyshev import chebyshev_values
from hamsym.numerics.symplectic import generators
from hamsym.numerics.tangent_maps import TangentMaps
from hamsym.numerics.windows import locate
from hamsym.solution.path import Path

__all__ = ["Sensitivity"]

_CHUNK = 4_096  # times in one batch
_WINDOWS = 1_024  # windows whose tangent maps are computed together
_MOST_WINDOWS = 100_000


class Sensitivity:
    """The tangent map Phi(t) along a path.

    Parameters
    ----------
    path : Path
    units : numpy.ndarray
        Size of each component, positive, shape (dim,).
    edges : numpy.ndarray, optional
        Ends of windows, counted from ``origin``; by default windows short enough for polynomials
        are chosen by the size of J Hess.
    origin : float
    """

    def __init__(
        self, path: Path, units: np.ndarray, edges: np.ndarray | None = None, origin: float = 0.0
    ) -> None:
        self._path, self._units = path, units
        self._edges = self._own_edges() if edges is None else edges
        self._origin = origin

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Evaluate Phi at times t of shape (K,), shape (K, dim, dim)."""
        parts = [self._values(t[k : k + _CHUNK]) for k in range(0, len(t), _CHUNK)]
        return np.concatenate(parts) * (self._units[:, None] / self._units)

    def _values(self, t: np.ndarray) -> np.ndarray:
        window, s = locate(self._edges, t - self._origin)
        values = np.empty((len(t), len(self._units), len(self._units)))
        used = np.unique(window)
        for first in range(0, len(used), _WINDOWS):
            some = used[first : first + _WINDOWS]
            here = np.isin(window, some)
            maps = self._maps(some)
            series = np.einsum("ln,inaw->wlia", maps.rule.to_series, maps.inside)
            basis = chebyshev_values(np.clip(2 * s[here] - 1, -1, 1), len(maps.nodes))
            place = np.searchsorted(some, window[here])
            inside = np.einsum("kl,klia->kia", basis, series[place])
            values[here] = inside @ self._starts[window[here]]
        return values

    @cached_property
    def _starts(self) -> np.ndarray:
        """Phi at the start of each window, shape (windows + 1, dim, dim), in units."""
        count, dim = len(self._edges) - 1, len(self._units)
        starts = np.empty((count + 1, dim, dim))
        starts[0] = np.eye(dim)
        for first in range(0, count, _WINDOWS):
            windows = np.arange(first, min(first + _WINDOWS, count))
            for k, end in zip(windows, self._maps(windows).ends, strict=True):
                starts[k + 1] = end @ starts[k]
        return starts

    def _maps(self, windows: np.ndarray) -> TangentMaps:
        edges, dim = self._edges, len(self._units)
        lengths = np.diff(edges)[windows]
        times = edges[windows, None] + lengths[:, None] * TangentMaps.nodes + self._origin
        hessians = self._path.hessians(times.ravel()).reshape(*times.shape, dim, dim)
        return TangentMaps(generators(hessians), lengths, self._units)

    def _own_edges(self) -> np.ndarray:
        start, end = self._path.span
        hessians = self._path.hessians(self._path.scan_times)
        # J Hess in units of the scales has the size of the rates at which nearby states separate.
        sizes = np.abs(generators(hessians) * self._units / self._units[:, None])
        needed = float(sizes.sum(axis=-1).max()) * abs(end - start) / 2
        return np.linspace(start, end, 2 + int(min(np.nan_to_num(needed), _MOST_WINDOWS)))
