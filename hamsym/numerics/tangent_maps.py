"""Tangent maps of many windows at once.

On a window of length h the matrix Phi(t) = dz(t)/dz(t_a) obeys Phi' = J Hess(z^(t)) Phi, Phi = 1 at
the start. It is computed by collocation at Chebyshev nodes, for all windows of a march in one
batch, since the windows are independent. A forced equation W' = J Hess W + f, W = 0 at the start,
is solved with it: its solutions are further columns.

Inside this module arrays are (component, node, column, window): the long axis is the innermost one.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.numerics.collocation import collocation
from hamsym.numerics.linear_systems import solved

_NODES = 28
_ITERATIONS = 60
# Of each row of each map, relative to its largest entry: every component converges by itself.
_ACCURACY = 1e-12


class TangentMaps:
    """Tangent maps Phi of windows, at nodes and at the ends, with solutions of forced equations.

    - jacobians: J Hess at the nodes of ``collocation(nodes)`` in every window, shape (windows,
      nodes, dim, dim + forced); by default at ``TangentMaps.nodes``. Columns beyond the first
      ``dim`` are the right-hand sides f of forced equations.
    - lengths: Of the windows, shape (windows,); negative backwards in time.
    - scale: Units of the components, shape (dim,). The maps are those of z / scale, the forced
      solutions are W / scale.
    - inside: Shape (dim, nodes, dim + forced, windows).
    - ends: Shape (windows, dim, dim + forced). Not finite where J Hess is not finite or there is no
      solution.
    """

    nodes = collocation(_NODES).nodes
    #: Positions between ``nodes``, for :meth:`defects`.
    between = (nodes[1:] + nodes[:-1]) / 2

    def __init__(self, jacobians: np.ndarray, lengths: np.ndarray, scale: np.ndarray) -> None:
        self._lengths, self._scale = lengths, scale
        dim, windows, nodes = len(scale), len(lengths), jacobians.shape[1]
        self.rule = collocation(nodes)
        scaled = self._in_units(jacobians)
        self._forcing = _largest(scaled[..., dim:])
        # A forced solution converges as if the largest entry of h f / scale in the window were one.
        unit_forcing = np.where(self._forcing > 0, self._forcing, 1.0)
        scaled[..., dim:] /= unit_forcing[:, None, None]
        entries = _entries(scaled)
        unit = np.eye(dim, scaled.shape[3])[:, None, :, None]
        integration = self.rule.integration
        maps = np.broadcast_to(unit, (dim, nodes, scaled.shape[3], windows))
        open_ = np.ones(windows, dtype=bool)
        for count in range(_ITERATIONS):
            moved = _integrated(integration[:-1], _rates(entries, maps))
            moved += unit
            if count % 4 != 3:  # the test costs as much as an iteration
                maps = moved
                continue
            change = np.abs(moved - maps).max(axis=(1, 2))
            size = np.abs(moved).max(axis=(1, 2))
            maps = moved
            open_ = ~(change <= _ACCURACY * size).all(axis=0)
            if not open_.any() or not np.all(size < 1e100):
                break
        for w in np.flatnonzero(open_):
            maps[:, :, :, w] = _solved_directly(scaled[w], integration[:-1])
        rates = _rates(entries, maps)
        ends = unit + _integrated(integration[-1:], rates)
        for whole in (maps, rates, ends):
            whole[:, :, dim:] *= unit_forcing.T
        self.inside, self._node_rates = maps, rates
        self.ends = np.ascontiguousarray(ends[:, 0].transpose(2, 0, 1))

    def defects(self, between: np.ndarray, smallest: np.ndarray | float = 0.0) -> np.ndarray:
        """Compute how far the polynomials are from solutions between the nodes, shape (windows,).

        - between: As ``jacobians``, at ``TangentMaps.between``.
        - smallest: Size of f / scale that counts as zero, shape (forced,).
        - returns: The largest defect of the equation in s = (t - t_a)/h, relative to the entries of
          its row of Phi and of dPhi/ds; that of a forced solution is first divided by the largest
          entry of h f / scale. NaN or infinite where one of them is.
        """
        interpolated = _integrated(self.rule.interpolation(self.between), self._node_rates)
        scaled = self._in_units(between)
        # A forcing may be zero at all nodes, and not between them.
        forcing = np.maximum(self._forcing, _largest(scaled[..., len(self._scale) :]))
        forcing = np.maximum(forcing, np.abs(self._lengths)[:, None] * smallest)
        return self._relative(self._rates_between(scaled) - interpolated, forcing)

    def effects(self, changes: np.ndarray) -> np.ndarray:
        """Compute what changes of ``between`` add to :meth:`defects`, shape (windows,)."""
        return self._relative(self._rates_between(self._in_units(changes)), self._forcing)

    def _in_units(self, jacobians: np.ndarray) -> np.ndarray:
        """Return h J Hess and h f in units of the scales."""
        columns = np.append(self._scale, np.ones(jacobians.shape[3] - len(self._scale)))
        units = columns / self._scale[:, None]
        return np.asarray(jacobians * (self._lengths[:, None, None, None] * units))

    def _rates_between(self, scaled: np.ndarray) -> np.ndarray:
        # Of the polynomials that solve the equation at the nodes. Those through the values at the
        # nodes, one degree lower, would solve an equation with constant coefficients everywhere.
        degrees = np.eye(len(self.nodes))
        integrals = chebyshev.chebint(degrees, lbnd=-1, scl=0.5)
        matrix = chebyshev.chebval(2 * self.between - 1, integrals).T @ self.rule.to_series
        maps = _integrated(matrix, self._node_rates)
        diagonal = np.arange(len(self._scale))
        maps[diagonal, :, diagonal] += 1.0
        return _rates(_entries(scaled), maps)

    def _relative(self, rates: np.ndarray, forcing: np.ndarray) -> np.ndarray:
        """Return the largest of some rates relative to those at the nodes, shape (windows,)."""
        columns = np.ones((self.inside.shape[2], len(self._lengths)))
        columns[len(self._scale) :] = np.where(forcing > 0, forcing, 1.0).T
        solved = np.maximum(np.abs(self.inside), np.abs(self._node_rates)) / columns
        rows = np.abs(rates / columns).max(axis=(1, 2)) / solved.max(axis=(1, 2))
        return np.asarray(rows.max(axis=0))

    def at(self, s: np.ndarray) -> np.ndarray:
        """Evaluate Phi at positions s in [0, 1] of all windows: (dim, len(s), columns, windows)."""
        return _integrated(self.rule.interpolation(s), self.inside)


def _largest(scaled: np.ndarray) -> np.ndarray:
    """Return the largest magnitudes (windows, columns) of (windows, nodes, dim, columns)."""
    return np.asarray(np.abs(scaled).max(axis=(1, 2)))


def _entries(scaled: np.ndarray) -> dict[tuple[int, int], np.ndarray]:
    # H couples few components: products with the entries that are not zero, one by one.
    return {
        (i, j): np.ascontiguousarray(scaled[:, :, i, j].T)
        for i, j in np.argwhere(scaled.any(axis=(0, 1)))
    }


def _rates(entries: dict[tuple[int, int], np.ndarray], maps: np.ndarray) -> np.ndarray:
    rates = np.zeros(maps.shape)
    for (i, j), entry in entries.items():
        if j < len(maps):
            rates[i] += entry[:, None, :] * maps[j]
        else:
            rates[i][:, j] += entry
    return rates


def _integrated(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Apply a matrix over the nodes to an array (component, node, column, window)."""
    dim, nodes, columns, windows = values.shape
    product = matrix @ values.reshape(dim, nodes, columns * windows)
    return product.reshape(dim, len(matrix), columns, windows)


def _solved_directly(generator: np.ndarray, integration: np.ndarray) -> np.ndarray:
    """Solve the collocation equations of one window directly, where the iteration fails."""
    nodes, dim, columns = generator.shape
    size = nodes * dim
    matrix = np.einsum("kl,lij->kilj", integration, generator[..., :dim]).reshape(size, size)
    driven = np.tile(np.eye(dim, columns), (nodes, 1, 1))
    driven[..., dim:] = np.einsum("kl,lij->kij", integration, generator[..., dim:])
    maps = solved(np.eye(size) - matrix, driven.reshape(size, columns))
    return maps.reshape(nodes, dim, columns).transpose(1, 0, 2)
