"""Growth of tangent vectors that are made orthonormal at intervals.

Input:  tangent vectors after a number of steps, of one or of many trajectories.
Output: orthonormal vectors of the same flags, and the logarithms of their growth.
"""

from __future__ import annotations

import numpy as np
import scipy

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

#: Ratio of the scales of components up to which lengths of tangent vectors are those of z itself.
_ALIKE = 1e3

# Largest number of e-folds of the fastest linear motion between two renormalisations: float64
# overflows at 700, and several vectors become parallel to round-off before.
_GROWTH_OF_ONE, _GROWTH_OF_SEVERAL = 200.0, 5.0


def growth_limit(count: int) -> float:
    """Return how many e-folds may pass between renormalisations of this number of vectors."""
    return _GROWTH_OF_ONE if count == 1 else _GROWTH_OF_SEVERAL


def first_vectors(dim: int, count: int, seed: int) -> np.ndarray:
    """Return random orthonormal vectors, shape (dim, count)."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(dim, count)))[0]


def tangent_scales(jacobians: np.ndarray) -> np.ndarray:
    """Return the units in which the components of tangent vectors are of one size, shape (dim,).

    Exponents do not depend on units, but float64 cannot keep vectors orthonormal whose components
    differ by many powers of ten, as metres and kg m/s of an electron do. The units are powers of
    two that balance the sum of matrices along a trajectory (Parlett & Reinsch 1969, by LAPACK);
    they are 1 where they would differ by less than a factor of 1,000.

    - jacobians: J Hess, shape (..., dim, dim); those that are not finite are left out.

    Examples
    --------
    >>> units = tangent_scales(np.array([[0.0, 2.0**60], [-(2.0**-60), 0.0]]))
    >>> float(units[0] / units[1]) == 2.0**60
    True
    >>> tangent_scales(np.array([[0.0, 1.0], [-4.0, 0.0]]))
    array([1., 1.])
    """
    dim = jacobians.shape[-1]
    matrices = np.abs(jacobians.reshape(-1, dim, dim))
    total = matrices[np.isfinite(matrices).all(axis=(-1, -2))].sum(axis=0)
    if not np.isfinite(total).all():
        return np.ones(dim)
    with np.errstate(invalid="ignore"):  # scipy casts large scales to integers it does not use
        _, (scales, _) = scipy.linalg.matrix_balance(total, permute=False, separate=True)
    usable = np.isfinite(scales).all() and (scales > 0).all()
    if not usable or scales.max() < _ALIKE * scales.min():
        return np.ones(dim)
    return np.asarray(scales)


def orthonormal(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal vectors of the same flags, and the logarithm of the growth of each.

    - vectors: Shape (..., dim, count), in the units of :func:`tangent_scales`.

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
