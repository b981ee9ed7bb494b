"""Tangent maps of many windows at once.

On a window of length h the matrix Phi(t) = dz(t)/dz(t_a) obeys Phi' = J Hess(z^(t)) Phi, Phi = 1 at
the start. It is computed by collocation at Chebyshev nodes, for all windows of a march in one
batch, since the windows are independent.

Inside this module arrays are (component, node, column, window): the long axis is the innermost one.
"""

from __future__ import annotations

import numpy as np

from hamsym.numerics.collocation import collocation
from hamsym.numerics.symplectic import poisson_product

__all__ = ["TangentMaps"]

_NODES = 28
_ITERATIONS = 60


class TangentMaps:
    """Tangent maps Phi of windows, at nodes and at the ends.

    Parameters
    ----------
    jacobians : numpy.ndarray
        J Hess at the nodes of ``collocation(nodes)`` in every window, shape (windows, nodes, dim,
        dim); by default at ``TangentMaps.nodes``.
    lengths : numpy.ndarray
        Of the windows, shape (windows,); negative backwards in time.
    scale : numpy.ndarray
        Units of the components, shape (dim,). The maps are those of z / scale.
    accuracy : float
        Of each row of each map, relative to its largest entry: every component converges by itself.

    Attributes
    ----------
    inside : numpy.ndarray
        Shape (dim, nodes, dim, windows).
    ends : numpy.ndarray
        Shape (windows, dim, dim). Not finite where J Hess is not finite or there is no solution.
    """

    nodes = collocation(_NODES).nodes

    def __init__(
        self,
        jacobians: np.ndarray,
        lengths: np.ndarray,
        scale: np.ndarray,
        accuracy: float = 1e-12,
    ) -> None:
        scaled = jacobians * (lengths[:, None, None, None] * (scale / scale[:, None]))
        dim, windows, nodes = len(scale), len(lengths), jacobians.shape[1]
        self.rule = collocation(nodes)
        half = dim // 2
        self._actions = np.tile(scale[:half] * scale[half:], 2)
        # H couples few components: products with the entries that are not zero, one by one.
        entries = {
            (i, j): np.ascontiguousarray(scaled[:, :, i, j].T)
            for i, j in np.argwhere(scaled.any(axis=(0, 1)))
        }
        unit = np.eye(dim)[:, None, :, None]
        integration = self.rule.integration
        maps = np.broadcast_to(unit, (dim, nodes, dim, windows))
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
            open_ = ~(change <= accuracy * size).all(axis=0)
            if not open_.any() or not np.all(size < 1e100):
                break
        for w in np.flatnonzero(open_):
            maps[:, :, :, w] = _solved(scaled[w], integration[:-1])
        self.inside = maps
        ends = unit + _integrated(integration[-1:], _rates(entries, maps))
        self.ends = np.ascontiguousarray(ends[:, 0].transpose(2, 0, 1))

    def inverse_applied(self, maps: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Compute Phi^-1 v for maps (component, node, column, window), v (component, node, window).

        In the units of H maps are symplectic, Phi^-1 = -J Phi^T J. In units s of the components
        that becomes K^-1 Phi^T K with K = S J S, S = diag(s).
        """
        turned = np.einsum("inaw,inw->anw", maps, poisson_product(self._weighted(vectors)))
        return -poisson_product(self._weighted(turned, -1.0))

    def _weighted(self, vectors: np.ndarray, power: float = 1.0) -> np.ndarray:
        # The largest action is the unit, so that no product overflows.
        weights = (self._actions / self._actions.max()) ** power
        return weights[:, None, None] * vectors

    def at(self, s: np.ndarray) -> np.ndarray:
        """Evaluate Phi at positions s in [0, 1] of all windows: (dim, len(s), dim, windows)."""
        return _integrated(self.rule.interpolation(s), self.inside)


def _rates(entries: dict[tuple[int, int], np.ndarray], maps: np.ndarray) -> np.ndarray:
    rates = np.zeros(maps.shape)
    for (i, j), entry in entries.items():
        rates[i] += entry[:, None, :] * maps[j]
    return rates


def _integrated(matrix: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Apply a matrix over the nodes to an array (component, node, column, window)."""
    dim, nodes, columns, windows = values.shape
    product = matrix @ values.reshape(dim, nodes, columns * windows)
    return product.reshape(dim, len(matrix), columns, windows)


def _solved(generator: np.ndarray, integration: np.ndarray) -> np.ndarray:
    """Solve the collocation equations of one window directly, where the iteration fails."""
    nodes, dim, _ = generator.shape
    size = nodes * dim
    matrix = np.eye(size) - np.einsum("kl,lij->kilj", integration, generator).reshape(size, size)
    try:
        maps = np.linalg.solve(matrix, np.tile(np.eye(dim), (nodes, 1)))
    except np.linalg.LinAlgError:
        maps = np.full((size, dim), np.nan)
    return maps.reshape(nodes, dim, dim).transpose(1, 0, 2)
