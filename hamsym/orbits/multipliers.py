"""Floquet multipliers of periodic orbits and the words for their stability.

Along a periodic orbit each integral I of H has trivial multipliers 1: its gradient is a left
eigenvector of the monodromy matrix, and the direction J grad I of its symmetry a right one. Each
such pair is, in general, a Jordan block, so that round-off moves the computed eigenvalues by its
square root. They are therefore left out by their directions, not by their distance from 1
(:func:`reduced_map`). What is left has the words of :func:`stability_of`, which
:mod:`hamsym.orbits.proven_stability` proves.
"""

from __future__ import annotations

import math

import numpy as np
import scipy

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.symplectic import poisson_product
from hamsym.orbits.integrals import directions, gradients_from, integrals_of, natural_sizes
from hamsym.orbits.symmetry import SignedPermutation

_PARABOLIC = 1e-5  # distance of a multiplier from 1 or -1 that round-off may cause
_ON_CIRCLE = 1e-6  # distance of |multiplier| from 1 that round-off may cause
_SHEAR = 1e-9  # entries of a monodromy matrix without the identity that are no round-off
_RANK = 1e-8  # singular values relative to the largest that count as zero


def reduced_map(
    matrix: np.ndarray, gradients: np.ndarray, rate: np.ndarray | None, scale: np.ndarray
) -> np.ndarray:
    """Return the map of states within the level of all integrals, across their symmetries.

    The matrix maps the tangent space V of the level to itself, and those directions J grad I, with
    integrals I, that lie in V: the symmetries that keep the values of all integrals, among them the
    flow. The reduced map acts on V modulo these, in an orthonormal basis. Of integrals that do not
    commute, as the angular momenta of a motion in space, fewer directions lie in V.

    - matrix: Of a symplectic map if there are integrals, shape (dim, dim).
    - gradients: Of the integrals, shape (n, dim); they may depend on each other.
    - rate: A vector field that the matrix maps to itself, beside those of the integrals.
    - scale: Units of the components.

    Examples
    --------
    A shear and a rotation by 0.3; the first momentum is an integral:

    >>> shear = np.array([[1.0, 7.0], [0.0, 1.0]])
    >>> c, s = np.cos(0.3), np.sin(0.3)
    >>> matrix = np.zeros((4, 4))
    >>> matrix[::2, ::2], matrix[1::2, 1::2] = shear, [[c, s], [-s, c]]
    >>> reduced = reduced_map(matrix, np.array([[0, 0, 1.0, 0]]), None, np.ones(4))
    >>> np.round(np.abs(np.angle(np.linalg.eigvals(reduced))), 12)
    array([0.3, 0.3])
    """
    units = _canonical(scale)
    scaled = matrix * units / units[:, None]
    slopes = gradients * units
    if not all(np.isfinite(part).all() for part in (scaled, slopes)):
        return np.full(matrix.shape, math.nan)
    slopes = _basis(slopes)
    # J grad I, and those combinations whose brackets with all integrals vanish
    fields = poisson_product(slopes.T)
    trivial = slopes
    if len(slopes):
        _, singular, right = scipy.linalg.svd(slopes @ fields)
        trivial = np.concatenate([slopes, (fields @ right[singular <= _RANK].T).T])
    if rate is not None:
        trivial = np.concatenate([trivial, _basis(rate[None] / units)])
    across = scipy.linalg.null_space(trivial, rcond=_RANK) if len(trivial) else np.eye(len(scale))
    return np.asarray(across.T @ scaled @ across)


def _canonical(scale: np.ndarray) -> np.ndarray:
    """Units of the same ratios of coordinates to momenta, with products 1: a canonical change."""
    q, p = np.split(scale, 2)
    ratio = np.sqrt(q / p)
    return np.concatenate([ratio, 1 / ratio])


def _basis(rows: np.ndarray) -> np.ndarray:
    """An orthonormal basis of the span of rows of any sizes."""
    largest = np.abs(rows).max(axis=1)  # squares of small numbers may underflow
    rows = rows[largest > 0] / largest[largest > 0, None]
    rows = rows / np.linalg.norm(rows, axis=1, keepdims=True)
    if not len(rows):
        return rows
    _, singular, right = scipy.linalg.svd(rows, full_matrices=False)
    return np.asarray(right[singular > _RANK * singular[0]])


def has_shear(monodromy: np.ndarray, scale: np.ndarray) -> bool:
    """Whether a monodromy matrix differs from the identity by more than round-off."""
    units = _canonical(scale)
    excess = (monodromy - np.eye(len(units))) * units / units[:, None]
    return bool(np.abs(excess).max() > _SHEAR)


def stability_of(multipliers: np.ndarray, *, conservative: bool = True, shear: bool = False) -> str:
    """Return the word for the linear stability that nontrivial multipliers imply.

    - "elliptic": all are on the unit circle, and none is 1 or -1;
    - "hyperbolic": all are real, in pairs m, 1/m off the unit circle;
    - "complex unstable": all are in quadruplets m, 1/m and their conjugates off the unit circle;
    - "parabolic": all are 1 or -1, up to round-off;
    - "mixed": of different kinds;
    - "unknown": not finite.

    Where none is left: "parabolic" with a shear, by which neighbours drift apart linearly, as those
    of an orbit of a pendulum with other periods do; "elliptic" without one, where all neighbours
    are periodic as well, as those of a harmonic oscillator.

    With forces multipliers have no pairs: "attracting" if all are inside the unit circle,
    "repelling" if all are outside, else "mixed".

    - multipliers: Of the period, without the trivial ones.
    - conservative: Whether there are no forces.
    - shear: Whether the monodromy matrix is not the identity.

    Examples
    --------
    >>> stability_of(np.exp([0.3j, -0.3j])), stability_of(np.array([-2.0, -0.5]))
    ('elliptic', 'hyperbolic')
    >>> stability_of(np.array([]), shear=True)
    'parabolic'
    """
    sizes = np.abs(multipliers)
    if not np.isfinite(sizes).all():
        return "unknown"
    if not conservative:
        if (sizes < 1 - _ON_CIRCLE).all():
            return "attracting"
        return "repelling" if (sizes > 1 + _ON_CIRCLE).all() else "mixed"
    kinds = {_kind(complex(value)) for value in multipliers}
    if not kinds:
        return "parabolic" if shear else "elliptic"
    return kinds.pop() if len(kinds) == 1 else "mixed"


def _kind(value: complex) -> str:
    if min(abs(value - 1), abs(value + 1)) < _PARABOLIC:
        return "parabolic"
    if abs(abs(value) - 1) < _ON_CIRCLE:
        return "elliptic"
    return "complex unstable" if abs(value.imag) > _PARABOLIC * abs(value) else "hyperbolic"


# -- integrals -------------------------------------------------------------------------------------

_ROUND_OFF = 1e-7  # of a gradient, relative to its natural size


def gradients_of_integrals(
    H: Hamiltonian, state: np.ndarray, scale: np.ndarray, shift: SignedPermutation
) -> np.ndarray:
    """Return gradients of the integrals of H at a state, shape (n, dim).

    Beside the integrals there are their images under a symmetry, so that it maps the span of the
    gradients to itself. Gradients that are round-off are left out.

    - state, scale: A state and the sizes of its components, shape (dim,).
    - shift: A symplectic symmetry of H.
    """
    integrals = integrals_of(H)
    found = [np.zeros((0, H.dim))]
    for k in range(shift.order if integrals else 0):
        power = shift.power(k)
        moved, units = power(state), np.abs(power(scale))
        fields = directions(integrals, moved)
        least = _ROUND_OFF * natural_sizes(integrals, moved, units)
        fields = fields[np.abs(fields / units).max(axis=1) > least]
        found.append(gradients_from(fields) @ power.matrix)
    return np.concatenate(found)
