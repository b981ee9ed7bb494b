"""The Poisson matrix J, by itself and applied to vectors and Hessians."""

from __future__ import annotations

import numpy as np


def generators(hessians: np.ndarray) -> np.ndarray:
    """Return J Hess, which moves tangent vectors, from Hessians of shape (..., dim, dim)."""
    half = hessians.shape[-1] // 2
    return np.concatenate((hessians[..., half:, :], -hessians[..., :half, :]), axis=-2)


def poisson_product(vectors: np.ndarray) -> np.ndarray:
    """Return J v for v with the components along the first axis."""
    half = len(vectors) // 2
    return np.concatenate((vectors[half:], -vectors[:half]))


def poisson_matrix(dof: int) -> np.ndarray:
    """Return J for coordinates first, shape (2 dof, 2 dof)."""
    return np.kron([[0.0, 1.0], [-1.0, 0.0]], np.eye(dof))


def symplectic_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return the inverse -J M^T J of a symplectic matrix.

    Examples
    --------
    >>> symplectic_inverse(np.array([[2.0, 1.0], [1.0, 1.0]])) + 0.0
    array([[ 1., -1.],
           [-1.,  2.]])
    """
    J = poisson_matrix(len(matrix) // 2)
    return np.asarray(-J @ matrix.T @ J)
