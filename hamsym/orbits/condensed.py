"""Linear systems of an arc in windows: elimination of the states between its two ends.

The unknowns are the states z_0 ... z_K at the ends of the windows and a few numbers g, such as the
period. Each window has the equations A_k z_k - z_(k+1) + B_k g = r_k; all others are equations of
z_0, z_K and g. The states between are eliminated one after the other by orthogonal transformations
(Wright 1992), which are stable however much the motion stretches, with effort proportional to the
number of windows. What is left is a small dense system.
"""

from __future__ import annotations

import math

import numpy as np
import scipy
from scipy.linalg import lapack

#: Reciprocal condition number of a system without a unique solution, up to round-off.
SINGULAR = 1e-11
_RANK = 1e-8  # singular values relative to the largest that count as zero


class CondensedWindows:
    """The equations of windows without the states between the ends of the arc.

    - maps: A_k, shape (windows, dim, dim).
    - numbers: B_k, shape (windows, dim, n).
    - right: r_k, shape (windows, dim).
    - matrix, right: What is left, dim equations of (z_0, z_K, g), shapes (dim, 2 dim + n) and
      (dim,).
    """

    def __init__(self, maps: np.ndarray, numbers: np.ndarray, right: np.ndarray) -> None:
        dim = maps.shape[1]
        self._dim = dim
        #: Of each state between: R, and the rest of R z_k = r - F z_0 - N z_(k+1) - B g.
        self._eliminated: list[tuple[np.ndarray, ...]] = []
        first, last, free, rest = maps[0], -np.eye(dim), numbers[0], right[0]
        if not (np.isfinite(maps).all() and np.isfinite(numbers).all()):
            first = np.full((dim, dim), math.nan)
            maps = maps[:1]
        for k in range(1, len(maps)):
            columns = np.zeros((2 * dim, 2 * dim + free.shape[1] + 1))
            columns[:dim, :dim], columns[dim:, dim : 2 * dim] = first, -np.eye(dim)
            columns[:dim, 2 * dim : -1], columns[dim:, 2 * dim : -1] = free, numbers[k]
            columns[:dim, -1], columns[dim:, -1] = rest, right[k]
            q, triangle = np.linalg.qr(np.concatenate([last, maps[k]]), mode="complete")
            columns = q.T @ columns
            parts = np.split(columns, [dim, 2 * dim, columns.shape[1] - 1], axis=1)
            self._eliminated.append((triangle[:dim], *(part[:dim] for part in parts)))
            first, last, free = (part[dim:] for part in parts[:3])
            rest = parts[3][dim:, 0]
        self.matrix, self.right = np.hstack([first, last, free]), rest

    def states(self, solution: np.ndarray, *, homogeneous: bool = False) -> np.ndarray:
        """Return all states z_0 ... z_K, shape (windows + 1, dim), from (z_0, z_K, g).

        With ``homogeneous``, of the equations with r_k = 0.
        """
        dim = self._dim
        first, last, numbers = np.split(solution, [dim, 2 * dim])
        found = [last]
        for triangle, by_first, by_next, by_numbers, constant in reversed(self._eliminated):
            right = -by_first @ first - by_next @ found[-1] - by_numbers @ numbers
            if not homogeneous:
                right = right + constant[:, 0]
            found.append(scipy.linalg.solve_triangular(triangle, right, check_finite=False))
        found.append(first)
        return np.array(found[::-1])


def solved(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, float]:
    """Solve a system, by least squares of least norm where it is singular.

    - returns: The solution, and the reciprocal condition number of the matrix; of one with an
      equation less than unknowns 1, or 0 if its equations are dependent.
    """
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(matrix.shape[1], math.nan), 0.0
    rows, columns = matrix.shape
    condition = 0.0
    if rows == columns:
        factor, pivots, info = lapack.dgetrf(matrix)
        if info == 0:
            condition = float(lapack.dgecon(factor, np.abs(matrix).sum(axis=0).max())[0])
        if condition > SINGULAR:
            return np.asarray(lapack.dgetrs(factor, pivots, right)[0]), condition
    solution, _, rank, _ = scipy.linalg.lstsq(matrix, right, cond=_RANK, lapack_driver="gelsy")
    return solution, float(rank == rows) if rows < columns else condition
