"""Derivatives of the state along a solution with respect to the initial state or to parameters.

Phi = dz/dz0 is the tangent map, Phi' = J Hess(z^(t)) Phi with Phi = 1 at the start of the span. The
derivative w = dz/dk with respect to a parameter solves the same equation with a forcing,
w' = J Hess(z^(t)) w + J d(grad H)/dk, w = 0 at the start. Each window is solved by collocation
(:mod:`hamsym.numerics.tangent_maps`), in units of the components' scales.

The windows of z^ need not suit these equations: the coefficients may oscillate where z^ does not,
for example about an equilibrium, or if the parameter is the amplitude, now zero, of a force. The
equations are therefore also evaluated between the nodes, and windows are halved until they hold.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from hamsym.numerics.tangent_maps import TangentMaps
from hamsym.numerics.windows import located_basis
from hamsym.solution.parameters import ParameterForcing

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

_BATCH = 2_000_000  # numbers in the tangent maps that are computed together
_MOST_TIMES = 4_096  # in one batch
_MOST_WINDOWS = 100_000
_MOST_NUMBERS = 50_000_000  # at the ends of all windows
_DEFECT = 1e-12  # of the equations between the nodes, relative
_NEGLIGIBLE = 1e-20  # of the largest force of a parameter: the tail of a pulse
_NOISE = 8  # times the measured effect of round-off is still round-off
_SHORTEST = 1e-10  # of the span: windows that may keep a defect, as at a jump of the Hessian


class Sensitivity:
    """The tangent map Phi(t) along a path, or the derivatives dz/dk with respect to parameters.

    Both are NaN from the first window on that has no solution, or needs too many windows.

    - units: Size of each component, positive, shape (dim,).
    - edges: Ends of windows, counted from ``origin``; with None windows short enough for
      polynomials are chosen by the size of J Hess.
    - forcing: That of the parameters; None for derivatives in the initial state.
    """

    def __init__(
        self,
        path: Solution,
        units: np.ndarray,
        edges: np.ndarray | None,
        origin: float,
        forcing: ParameterForcing | None,
    ) -> None:
        self._path, self._units, self._origin, self._forcing = path, units, origin, forcing
        self._dim = len(units)
        self._columns = self._dim + (0 if forcing is None else len(forcing))
        self._step = max(1, _BATCH // (len(TangentMaps.nodes) * self._dim * self._columns))
        self._edges = self._own_edges() if edges is None else edges
        self._largest_force = np.zeros(self._columns - self._dim)  # of all windows so far, in units
        self._starts = self._joined(self._solved_ends())

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Evaluate at times t of shape (K,), shape (K, dim, dim) or (K, dim, parameters)."""
        step = min(self._step, _MOST_TIMES)
        parts = [self._values(t[k : k + step]) for k in range(0, len(t), step)]
        columns = self._units if self._forcing is None else np.ones(len(self._forcing))
        return np.concatenate(parts) * (self._units[:, None] / columns)

    def _values(self, t: np.ndarray) -> np.ndarray:
        window, basis = located_basis(self._edges, t - self._origin, len(TangentMaps.nodes))
        values = np.empty((len(t), *self._starts.shape[1:]))
        for some in self._batches(np.unique(window)):
            here = np.isin(window, some)
            maps = self._maps(some)
            series = np.einsum("ln,inaw->wlia", maps.rule.to_series, maps.inside)
            place = np.searchsorted(some, window[here])
            inside = np.einsum("kl,klia->kia", basis[here], series[place])
            values[here] = self._moved(inside, self._starts[window[here]])
        return values

    def _moved(self, maps: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Return the derivatives behind maps with their forced columns, from those before them."""
        moved = maps[..., : self._dim] @ starts
        return moved if self._forcing is None else moved + maps[..., self._dim :]

    def _joined(self, ends: np.ndarray) -> np.ndarray:
        """Return the derivatives at all edges, shape (windows + 1, dim, columns), in units."""
        columns = self._dim if self._forcing is None else len(self._forcing)
        starts = np.empty((len(ends) + 1, self._dim, columns))
        starts[0] = np.eye(self._dim) if self._forcing is None else 0.0
        for k, end in enumerate(ends):
            starts[k + 1] = self._moved(end, starts[k])
        return starts

    # -- windows -------------------------------------------------------------------------------

    def _solved_ends(self) -> np.ndarray:
        """Solve all windows, halve those that need it, and return the solutions at their ends.

        Shape (windows, dim, dim + parameters); NaN where a window has no solution.
        """
        count = len(self._edges) - 1
        shortest = _SHORTEST * abs(self._edges[-1] - self._edges[0])
        most = count + min(_MOST_WINDOWS, _MOST_NUMBERS // (self._dim * self._columns))
        ends = np.full((count, self._dim, self._columns), np.nan)
        wanted = np.arange(count)
        while True:
            unresolved = []
            for some in self._batches(wanted):
                maps = self._maps(some)
                ends[some] = maps.ends
                unresolved.append(some[~self._is_resolved(some, maps)])
            split = np.concatenate(unresolved)
            split = split[np.abs(np.diff(self._edges)[split]) > shortest]
            if len(ends) + len(split) > most:
                ends[split] = np.nan
                return ends
            if not len(split):
                return ends
            middles = (self._edges[split] + self._edges[split + 1]) / 2
            self._edges = np.insert(self._edges, split + 1, middles)
            ends = np.insert(ends, split + 1, np.nan, axis=0)
            halves = split + np.arange(len(split))
            wanted = np.sort(np.concatenate((halves, halves + 1)))

    def _is_resolved(self, windows: np.ndarray, maps: TangentMaps) -> np.ndarray:
        """Return whether halving each window is useless: it is accurate, or has no solution."""
        between = self._coefficients(windows, TangentMaps.between)
        finite = np.isfinite(between).all(axis=(1, 2, 3))
        with np.errstate(all="ignore"):
            forces = np.abs(between[..., self._dim :]).max(axis=1) / self._units[:, None]
            np.fmax(self._largest_force, forces.max(axis=(0, 1)), out=self._largest_force)
            defects = maps.defects(between, _NEGLIGIBLE * self._largest_force)
            good = defects <= _DEFECT
            if (good | ~finite).all():
                return good | ~finite
            changes = self._coefficients(windows, TangentMaps.between, disturbed=True) - between
            return good | ~finite | (defects <= _NOISE * maps.effects(changes))

    def _maps(self, windows: np.ndarray) -> TangentMaps:
        coefficients = self._coefficients(windows, TangentMaps.nodes)
        return TangentMaps(coefficients, np.diff(self._edges)[windows], self._units)

    def _coefficients(
        self, windows: np.ndarray, positions: np.ndarray, *, disturbed: bool = False
    ) -> np.ndarray:
        """Evaluate J Hess and the forcing in windows, shape (windows, positions, dim, columns).

        ``disturbed`` changes states and times by round-off.
        """
        lengths = np.diff(self._edges)[windows]
        times = self._edges[windows, None] + lengths[:, None] * positions + self._origin
        t = times.ravel()
        z = self._path(t, extrapolate=True)
        if disturbed:
            generator, eps = np.random.default_rng(0), np.finfo(z.dtype).eps
            t = t * (1 + eps * generator.choice((-1.0, 1.0), t.shape))
            z = self._path(t, extrapolate=True) * (1 + eps * generator.choice((-1.0, 1.0), z.shape))
        with np.errstate(all="ignore"):
            parts = [self._path.H.compile("numpy").at("jacobian", z, t)]
            if self._forcing is not None:
                parts.append(self._forcing(z, t))
        return np.concatenate(parts, axis=-1).reshape(*times.shape, self._dim, self._columns)

    def _batches(self, windows: np.ndarray) -> Iterator[np.ndarray]:
        for first in range(0, len(windows), self._step):
            yield windows[first : first + self._step]

    def _own_edges(self) -> np.ndarray:
        start, end = self._path.span
        jacobians = self._path.jacobians(self._path.scan_times)
        # J Hess in units of the scales has the size of the rates at which nearby states separate.
        sizes = np.abs(jacobians * self._units / self._units[:, None])
        needed = float(sizes.sum(axis=-1).max()) * abs(end - start) / 2
        return np.linspace(start, end, 2 + int(min(np.nan_to_num(needed), _MOST_WINDOWS)))
