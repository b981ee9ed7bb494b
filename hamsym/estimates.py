"""The error of a marched solution, estimated to where float64 ends.

The error delta = z - z^ obeys delta' = J Hess(z^) delta - r(t) with r the residual (the paper's
eq. ell), up to terms of second order. Inside a window r oscillates about as often as there are
columns in the basis, so the equation is solved by collocation on more nodes than the solution
itself used. Round-off is not in r: random perturbations of its size are sent along the same
tangent map, one batch at every joint.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.features import FeatureBasis, March

__all__ = ["MarchError"]

_NODES = 56  # more than twice those of the march
_PERTURBATIONS = 4  # random vectors that stand for round-off
_ROUND_OFF = 2 * np.finfo(float).eps  # of a window, relative to the state and its change there
_ACCURACY = 1e-9  # of each window's tangent map, since thousands of them may follow each other
_CHUNK = 2_000_000  # numbers in the Jacobians held at once


class MarchError:
    """Estimated error of a march: z - z^ and the round-off floor, as functions of time.

    Parameters
    ----------
    windows : March
    basis : FeatureBasis
        The one that was marched with.
    vector_field, jacobian : callable
        (z, t) -> shapes (n, dim) and (n, dim, dim).
    """

    def __init__(
        self,
        windows: March,
        basis: FeatureBasis,
        vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray],
        jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> None:
        nodes, integration, self._to_series = _chebyshev_collocation()
        values, rates = basis.columns(nodes)
        dense = chebyshev.chebvander(np.linspace(-1, 1, 4 * _NODES), _NODES - 1)
        count, _, dim = windows.readouts.shape
        self._edges = windows.edges
        lengths = np.diff(windows.edges)
        # What rounding did to the state at each joint, the same way every time, is known.
        jumps = windows.states[:-1] + np.einsum("m,wmd->wd", basis.end, windows.readouts)
        jumps = np.asarray(jumps - windows.states[1:], dtype=float)
        generator = np.random.default_rng(0)
        # Column 0 is the error, the others are perturbations of the size of round-off.
        joint = np.zeros((dim, 1 + _PERTURBATIONS))
        self._series = np.empty((count, _NODES, dim))
        self._floors = np.empty((count, dim))
        self.largest = np.zeros(dim)
        step = max(1, _CHUNK // (_NODES * dim * dim))
        for first in range(0, count, step):
            part = slice(first, min(first + step, count))
            z = windows.states[part][:, None] + np.einsum(
                "lm,wmd->wld", values, windows.readouts[part]
            )
            dz = np.einsum("lm,wmd->wld", rates, windows.readouts[part])
            dz /= lengths[part, None, None]
            times = windows.edges[part][:, None] + lengths[part, None] * nodes
            flat = z.reshape(-1, dim)
            residual = dz - vector_field(flat, times.ravel()).reshape(z.shape)
            jacobians = jacobian(flat, times.ravel()).reshape(*z.shape, dim)
            for k, w in enumerate(range(part.start, part.stop)):
                signs = generator.choice((-1.0, 1.0), size=(dim, _PERTURBATIONS))
                size = np.abs(z[k]).max(axis=0) + abs(lengths[w]) * np.abs(dz[k]).max(axis=0)
                joint[:, 1:] += _ROUND_OFF * size[:, None] * signs
                inside, joint = _across(jacobians[k], residual[k], joint, lengths[w] * integration)
                joint[:, 0] += jumps[w]
                self._series[w] = self._to_series @ inside[:, :, 0]
                self._floors[w] = _spread(inside[:, :, 1:])
                # A scan this fine misses a few percent of a peak at most.
                between = 1.05 * np.abs(dense @ self._series[w]).max(axis=0)
                self.largest = np.maximum(self.largest, between + self._floors[w])

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Estimated z - z^ at times t, shape (*t.shape, dim)."""
        window, s = self._place(t)
        basis = np.cos(np.multiply.outer(np.arccos(np.clip(2 * s - 1, -1, 1)), np.arange(_NODES)))
        return np.einsum("...l,...ld->...d", basis, self._series[window])

    def floor(self, t: np.ndarray) -> np.ndarray:
        """Estimated size of the accumulated round-off at times t, shape (*t.shape, dim)."""
        return self._floors[self._place(t)[0]]

    def until(self, allowed: np.ndarray) -> float:
        """The end of the last window before estimate and floor exceed what is allowed."""
        sizes = np.abs(self(self._edges[1:] - 1e-9 * np.diff(self._edges))) + self._floors
        bad = (sizes > allowed).any(axis=1)
        return float(self._edges[int(np.argmax(bad))] if bad.any() else self._edges[-1])

    def _place(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        direction = math.copysign(1.0, self._edges[-1] - self._edges[0])
        window = np.searchsorted(direction * self._edges, direction * t, side="right") - 1
        window = np.clip(window, 0, len(self._series) - 1)
        return window, (t - self._edges[window]) / np.diff(self._edges)[window]


def _across(
    jacobians: np.ndarray, residual: np.ndarray, start: np.ndarray, integration: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """delta at the nodes of a window, shape (nodes, dim, columns), and at its end.

    The last row of the integration matrix belongs to the end of the window.
    """
    nodes, dim = residual.shape
    delta = np.broadcast_to(start, (nodes, *start.shape))
    last = math.inf
    for count in range(60):
        rates = jacobians @ delta
        rates[:, :, 0] -= residual
        sums = (integration @ rates.reshape(nodes, -1)).reshape(nodes + 1, *start.shape)
        moved = start + sums[:-1]
        change = np.abs(moved - delta).max(axis=(0, 1))
        delta = moved
        ratio = float((change / np.maximum(np.abs(delta).max(axis=(0, 1)), 1e-300)).max())
        if ratio <= _ACCURACY:
            return delta, start + sums[-1]
        if not ratio < 1e12 or (count > 10 and ratio > last):
            break
        last = ratio
    # The iteration does not contract: solve the collocation equations as they stand.
    matrix = np.eye(nodes * dim) - np.einsum("kl,lij->kilj", integration[:-1], jacobians).reshape(
        nodes * dim, nodes * dim
    )
    right = np.broadcast_to(start, (nodes, *start.shape)).copy()
    right[:, :, 0] -= integration[:-1] @ residual
    delta = np.linalg.solve(matrix, right.reshape(nodes * dim, -1)).reshape(nodes, *start.shape)
    rates = jacobians @ delta
    rates[:, :, 0] -= residual
    return delta, start + (integration[-1] @ rates.reshape(nodes, -1)).reshape(start.shape)


def _spread(perturbed: np.ndarray) -> np.ndarray:
    """Three standard deviations of the perturbed components, at worst in the window."""
    deviations = np.sqrt((perturbed**2).mean(axis=2)).max(axis=0)
    return np.asarray(3 * deviations)


@functools.cache
def _chebyshev_collocation() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes in (0, 1), integrals from 0 to each node and to 1, values to a Chebyshev series."""
    nodes = (1 - np.cos((2 * np.arange(_NODES) + 1) * math.pi / (2 * _NODES))) / 2
    to_series = np.linalg.inv(chebyshev.chebvander(2 * nodes - 1, _NODES - 1))
    ends = np.append(nodes, 1.0)
    integrals = chebyshev.chebint(np.eye(_NODES), lbnd=-1, scl=0.5)
    integration = chebyshev.chebval(2 * ends - 1, integrals).T @ to_series
    return nodes, integration, to_series
