"""Sizes of the components of a state, each in its own units."""

from __future__ import annotations

import numpy as np
import scipy.linalg

#: Smallest size of a component, as a share of its coupled size: smaller values cannot be
#: distinguished from the round-off of the terms in its own equation.
SMALLEST = 1e-8
#: Ratio of the units of tangent vectors up to which all of them are 1.
_ALIKE = 1e3
_ROUNDS = 12  # in each of which the logarithms of units come twice as near to their limits
_AT_ONCE = 8  # steps between couplings before it is asked whether sizes still change


def ratios(errors: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the ratios of errors to limits: 0 without an error, infinite where one is unknown.

    Examples
    --------
    >>> ratios(np.array([0.0, 1.0, np.nan]), np.array([0.0, 4.0, 1.0]))
    array([0.  , 0.25,  inf])
    """
    with np.errstate(all="ignore"):
        found = np.where(errors == 0, 0.0, errors / limits)
    return np.where(np.isnan(found), np.inf, found)


def coupled_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float) -> np.ndarray:
    """Compute the size that the terms of its own equation give each component, at least its own.

    Small changes obey delta' = A delta with A = J Hess. In the time tau = 1/rho, with rho the
    spectral radius of |A|, other components of sizes s move component i by up to
    tau sum_j |A_ij| s_j. This is repeated dim times, to reach components that are coupled through
    others. Components of different units are never compared.

    - sizes: Largest |z_i|, shape (dim,).
    - coupling: |A|, its mean along the trajectory, shape (dim, dim).
    - time: The longest tau: the span, beyond which no weak coupling acts.

    Examples
    --------
    >>> coupled_sizes(np.array([2.0, 0.0]), np.array([[0.0, 1.0], [9.0, 0.0]]), 100.0)
    array([2., 6.])
    """
    return shared_sizes(sizes, coupling_shares(coupling, time))


def coupling_shares(coupling: np.ndarray, time: float) -> np.ndarray:
    """Compute tau |A| of :func:`coupled_sizes`, zero where a coupling is not finite.

    - coupling, time: As of :func:`coupled_sizes`.
    """
    if not np.isfinite(coupling).all():
        return np.zeros_like(coupling)
    radius = float(np.abs(np.linalg.eigvals(coupling)).max(initial=0.0))
    tau = min(time, 1 / radius) if radius > 0 else time
    return np.asarray(tau * coupling)


def shared_sizes(sizes: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Compute the sizes of :func:`coupled_sizes` from its tau |A|."""
    found, rest = sizes, len(sizes) if shares.any() else 0
    while rest > 0:
        before = found
        for _ in range(min(rest, _AT_ONCE)):
            found = np.maximum(found, shares @ found)
        if (found == before).all():
            break
        rest -= _AT_ONCE
    return found


def smallest_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float) -> np.ndarray:
    """Compute the sizes below which no component is counted: 1e-8 of the coupled ones.

    Eigenvalues and products differ between processors in the last bits, which are left out.

    - sizes, coupling, time: As of :func:`coupled_sizes`.
    """
    mantissa, exponent = np.frexp(SMALLEST * coupled_sizes(sizes, coupling, time))
    return np.asarray(np.ldexp(np.round(mantissa * 2**24) / 2**24, exponent))


def resolved_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float) -> np.ndarray:
    """Compute the sizes to which tolerances are relative: at least 1e-8 of the coupled ones.

    - sizes, coupling, time: As of :func:`coupled_sizes`.

    Examples
    --------
    >>> resolved_sizes(np.array([2.0, 0.0]), np.array([[0, 1.0], [9, 0]]), 100.0).round(12)
    array([2.e+00, 6.e-08])
    """
    return np.asarray(np.maximum(sizes, smallest_sizes(sizes, coupling, time)))


def tangent_scales(jacobians: np.ndarray, time: float = 1.0) -> np.ndarray:
    """Return the units in which the components of tangent vectors are of one size, shape (dim,).

    In others, float64 can neither keep vectors orthonormal nor choose pivots, if components differ
    by many powers of ten, as metres and kg m/s of an electron do. The units are powers of two that
    balance the mean of matrices along a trajectory (Parlett & Reinsch 1969, by LAPACK), from those
    of :func:`paired_sizes` on, because balancing leaves out what moves nothing, as the angle of a
    central force. They are 1 where they would differ by less than a factor of 1,000.

    - jacobians: J Hess, shape (..., dim, dim); those that are not finite are left out.
    - time: Of the motion, where the mean has no rate.

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
    known = matrices[np.isfinite(matrices).all(axis=(-1, -2))]
    mean = known.sum(axis=0) / max(len(known), 1)
    if not np.isfinite(mean).all():
        return np.ones(dim)
    rate = float(np.abs(np.linalg.eigvals(mean)).max())
    with np.errstate(all="ignore"):  # scipy casts large scales to integers it does not use
        paired = paired_sizes(np.ones(dim), mean, 1 / rate if rate > 0 else time)
        first = np.ldexp(1.0, np.round(np.log2(paired)).astype(int))
        total = mean * first / first[:, None]
        if not np.isfinite(total).all():
            return np.ones(dim)
        _, (scales, _) = scipy.linalg.matrix_balance(total, permute=False, separate=True)
        scales = first * scales
    usable = np.isfinite(scales).all() and (scales > 0).all()
    if not usable or scales.max() < _ALIKE * scales.min():
        return np.ones(dim)
    return np.asarray(scales)


def floored_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float, share: float) -> np.ndarray:
    """Raise sizes to a share of the coupled ones, and to 1e-8 of the paired ones.

    The latter are for what is not coupled to the motion, as that across a plane. Without any motion
    sizes are 1.

    - sizes, coupling, time: As of :func:`coupled_sizes` and :func:`paired_sizes`.

    Examples
    --------
    >>> coupling = np.array([[0, 0, 1.0, 0], [0, 0, 0, 1], [4, 0, 0, 0], [0, 1, 0, 0]])
    >>> floored_sizes(np.array([3.0, 0.0, 0.0, 0.0]), coupling, 10.0, 0.1).round(10)
    array([3.00e+00, 4.24e-08, 6.00e-01, 4.24e-08])
    """
    coupled = coupled_sizes(sizes, coupling, time)
    paired = paired_sizes(sizes, coupling, time)
    found = np.maximum(sizes, np.maximum(share * coupled, SMALLEST * paired))
    return np.where(found > 0, found, 1.0)


def paired_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float) -> np.ndarray:
    """Compute the sizes that all pairs (q_i, p_i) have where they move as far as the largest.

    The product of a coordinate and its momentum is an action, which pairs of different units, as a
    length and an angle, have in common. The ratio of q_i to p_i is that of their own oscillation,
    or of a motion over a shorter time. Without any coupling it is that of their sizes.

    - sizes, coupling: As of :func:`coupled_sizes`; entries that are not finite count as zero.
    - time: Of the motion.

    Examples
    --------
    >>> paired_sizes(np.array([2.0, 0.0]), np.array([[0.0, 1.0], [9.0, 0.0]]), 100.0)
    array([2., 6.])
    """
    q, p = np.split(sizes, 2)
    coupling = np.where(np.isfinite(coupling), coupling, 0.0)
    drift = time * np.diagonal(coupling[: len(q), len(q) :])
    force = time * np.diagonal(coupling[len(q) :, : len(q)])
    with np.errstate(all="ignore"):
        own = np.where((q > 0) & (p > 0), q / p, 1.0)
        driven = np.where(force > 0, 1 / force, own)
        turns = np.sqrt(drift) * np.sqrt(force)
        root = np.sqrt(np.where(drift > 0, drift / np.maximum(turns, 1.0), driven))
        largest = float(np.maximum(q / root, p * root).max())
        return np.concatenate([largest * root, largest / root])


def equilibrating(matrices: np.ndarray) -> np.ndarray:
    """Return factors s with entries of s_i H_ij s_j near 1 in the largest entry of each row.

    By the iteration of Ruiz (2001), for symmetric matrices H of shape (..., n, n). Of a Hessian
    they are sizes of the variables that change its form alike; 1 where a row is zero.

    Examples
    --------
    >>> equilibrating(np.array([[0.0, 4.0], [4.0, 16.0]])).round(2)
    array([1.  , 0.25])
    """
    scale = np.ones(matrices.shape[:-1])
    with np.errstate(all="ignore"):
        for _ in range(_ROUNDS):
            rows = np.abs(matrices * scale[..., :, None] * scale[..., None, :]).max(axis=-1)
            scale = scale / np.sqrt(np.where(rows > 0, rows, 1.0))
    return scale


def equilibrium_sizes(hessian: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Return sizes of components that change H alike, the largest that of a point z.

    - hessian: Of H at z, shape (dim, dim).
    """
    if not np.isfinite(hessian).all():
        return np.where(z == 0, 1.0, np.abs(z))
    units = equilibrating(hessian)
    largest = (np.abs(z) / units).max() or 1 / units.max()
    return np.asarray(np.maximum(units * largest, np.abs(z)))
