"""Growth of tangent vectors that are made orthonormal at intervals.

Input:  tangent vectors after a number of steps, of one or of many trajectories.
Output: orthonormal vectors of the same flags, and the logarithms of their growth.
"""

from __future__ import annotations

import numpy as np

#: Default steps in a radian of the fastest linear motion.
STEPS_PER_RADIAN = 5
#: Times the rate for which the steps were chosen at which they no longer resolve the motion.
UNRESOLVED = 3.0
#: E-folds by which one vector may outgrow another until both are parallel.
PARALLEL = 30.0
#: Outcome where they did.
APART = (
    f"tangent vectors grew apart by more than exp({PARALLEL:g}) between renormalisations; reduce dt"
)

# Largest number of e-folds of the fastest linear motion between two renormalisations: float64
# overflows at 700, and several vectors become parallel to round-off before.
_GROWTH_OF_ONE, _GROWTH_OF_SEVERAL = 200.0, 5.0


def growth_limit(count: int) -> float:
    """Return how many e-folds may pass between renormalisations of this number of vectors."""
    return _GROWTH_OF_ONE if count == 1 else _GROWTH_OF_SEVERAL


def first_vectors(dim: int, count: int, seed: int) -> np.ndarray:
    """Return random orthonormal vectors, shape (dim, count)."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(dim, count)))[0]


def orthonormal(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal vectors of the same flags, and the logarithm of the growth of each.

    - vectors: Shape (..., dim, count), in units of ``tangent_scales``.

    Examples
    --------
    >>> q, growth = orthonormal(np.array([[2.0, 2.0], [0.0, 3.0]]))
    >>> q + 0.0, np.exp(growth).round(9)
    (array([[1., 0.],
           [0., 1.]]), array([2., 3.]))
    """
    if vectors.shape[-1] == 1:
        length = np.linalg.norm(vectors, axis=-2, keepdims=True)
        return vectors / length, np.log(length[..., 0, :])
    q, r = np.linalg.qr(vectors)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    return q * np.sign(diagonal)[..., None, :], np.log(np.abs(diagonal))
