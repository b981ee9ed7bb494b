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
from hamsym.orbits.symmetry import Closing, SignedPermutation
from hamsym.random_features.flow import flow_of

_PARABOLIC = 1e-5  # distance of a multiplier from 1 or -1 that round-off may cause
_ON_CIRCLE = 1e-6  # distance of |multiplier| from 1 that round-off may cause
_SAFETY = 3  # times the estimated error of multipliers
_NEAR = 1e-2  # relative distance of multipliers that may move together
_UNIT = 2.0**-53
_COARSE = 1e-2  # error of multipliers beyond which nothing is said about them
_SHEAR = 1e-9  # entries of a monodromy matrix without the identity that are no round-off
_EXACT = 2.0**-46  # round-off that two computations may share
_RANK = 1e-8  # singular values relative to the largest that count as zero


def reduced_map(
    closing: Closing,
    maps: np.ndarray,
    gradients: np.ndarray,
    rates: np.ndarray | None,
    scale: np.ndarray,
) -> np.ndarray:
    """Return the shift map within the level of all integrals, across their symmetries.

    The flow of each window maps the tangent space V of the level at its start to that at its end,
    and those directions J grad I, with integrals I, that lie in V: the symmetries that keep the
    values of all integrals, among them the flow. The reduced map acts on V modulo these, in an
    orthonormal basis. Of integrals that do not commute, as the angular momenta of a motion in
    space, fewer directions lie in V.

    Each window is reduced by itself: in a close encounter round-off of the other directions would
    grow, and come back into V.

    - maps: Derivatives of the windows' flows, symplectic if there are integrals, (k, dim, dim).
    - gradients: Of the integrals at the ends of windows, which may depend on each other, shape
      (k + 1, n, dim).
    - rates: A vector field that the maps carry along, beside those of the integrals, (k + 1, dim).
    - scale: Units of the components.

    Examples
    --------
    A shear and a rotation by 0.3; the first momentum is an integral:

    >>> shear = np.array([[1.0, 7.0], [0.0, 1.0]])
    >>> c, s = np.cos(0.3), np.sin(0.3)
    >>> matrix = np.zeros((4, 4))
    >>> matrix[::2, ::2], matrix[1::2, 1::2] = shear, [[c, s], [-s, c]]
    >>> closing = Closing(SignedPermutation.identity(4))
    >>> gradient = np.array([[[0, 0, 1.0, 0]]] * 2)
    >>> reduced = reduced_map(closing, matrix[None], gradient, None, np.ones(4))
    >>> np.round(np.abs(np.angle(np.linalg.eigvals(reduced))), 12)
    array([0.3, 0.3])
    """
    units = _canonical(scale)
    scaled = maps * units / units[:, None]
    slopes = gradients * units
    if not all(np.isfinite(part).all() for part in (scaled, slopes)):
        return np.full(maps.shape[1:], math.nan)
    # independent combinations at the start, which are so everywhere
    slopes = _combinations(slopes[0]) @ slopes
    fields = poisson_product(slopes[0].T)
    trivial = slopes
    if slopes.shape[1]:
        # J grad I of those combinations whose brackets with all integrals vanish
        _, singular, right = scipy.linalg.svd(slopes[0] @ fields)
        neutral = right[singular <= _RANK] @ slopes
        moves = np.moveaxis(poisson_product(np.moveaxis(neutral, 2, 0)), 0, 2)
        trivial = np.concatenate([slopes, moves], axis=1)
    if rates is not None:
        trivial = np.concatenate([trivial, (rates / units)[:, None]], axis=1)
    across = _complements(trivial)
    through = np.eye(across.shape[2])
    for before, window, after in zip(across[:-1], scaled, across[1:], strict=True):
        through = after.T @ (window @ before) @ through

    def between(symmetry: SignedPermutation, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        return np.asarray(after.T @ ((symmetry.matrix * units / units[:, None]) @ before))

    start, end = across[0], across[-1]
    if closing.first is None or closing.last is None:
        return between(closing.shift.power(closing.order - 1), end, start) @ through
    last = between(closing.last, end, end) @ through
    return between(closing.first, start, start) @ np.linalg.solve(through, last)


def _canonical(scale: np.ndarray) -> np.ndarray:
    """Units of the same ratios of coordinates to momenta, with products 1: a canonical change."""
    q, p = np.split(scale, 2)
    ratio = np.sqrt(q / p)
    return np.concatenate([ratio, 1 / ratio])


def _combinations(rows: np.ndarray) -> np.ndarray:
    """Combinations of rows of any sizes that are an orthonormal basis of their span."""
    largest = np.abs(rows).max(axis=1, initial=0.0)  # squares of small numbers may underflow
    sizes = np.where(largest > 0, largest, 1.0)
    sizes = sizes * np.maximum(np.linalg.norm(rows / sizes[:, None], axis=1), _UNIT)
    left, singular, _ = scipy.linalg.svd(rows / sizes[:, None], full_matrices=False)
    kept = singular > _RANK * singular.max(initial=0.0)
    return np.asarray((left[:, kept] / singular[kept]).T / sizes)


def _complements(rows: np.ndarray) -> np.ndarray:
    """Orthonormal bases across rows, shape (k, n, dim) -> (k, dim, dim - n)."""
    rows = rows / np.abs(rows).max(axis=2, keepdims=True)
    rows = rows / np.linalg.norm(rows, axis=2, keepdims=True)
    return np.linalg.qr(rows.swapaxes(1, 2), mode="complete")[0][:, :, rows.shape[1] :]


def shear_of(monodromy: np.ndarray, other: np.ndarray, scale: np.ndarray) -> float:
    """Return the largest entry of the difference of two maps, in canonical units of a scale."""
    units = _canonical(scale)
    return float(np.abs((monodromy - other) * units / units[:, None]).max())


def multiplier_error(matrix: np.ndarray, other: np.ndarray, *, conservative: bool = True) -> float:
    """Return the estimated error of the eigenvalues of a map, from another computation of it.

    The difference of the two is restricted to the invariant subspace of an eigenvalue, its inverse,
    their conjugates and those near them. Its norm there, times the condition number of the
    eigenvalue, is the error; a pair that nearly coincides moves by a square root at most (Elsner
    1985). The others count to second order. Relative to the eigenvalue where it is larger than 1;
    infinite if a map is not finite.

    - matrix, other: Reduced maps, shape (n, n).
    - conservative: Whether the smaller eigenvalues are the inverses of the larger ones, which alone
      are judged then.

    Examples
    --------
    >>> round(multiplier_error(np.diag([2.0, 0.1]), np.diag([2.002, 0.1])), 9)
    0.001
    """
    if matrix.shape != other.shape or not (np.isfinite(matrix).all() and np.isfinite(other).all()):
        return math.inf
    values, right = np.linalg.eig(matrix)
    sizes, found = np.abs(values), 0.0
    judged = np.argsort(-sizes)[: len(sizes) // 2 if conservative else None]
    # The inverse of a large eigenvalue is round-off in the matrix, and may be zero there.
    if conservative and not sizes[judged].all():
        return math.inf
    round_off = _UNIT * np.linalg.norm(matrix)
    try:
        left = np.linalg.inv(right)
        change = left @ (other - matrix) @ right
        for k, size in zip(judged, sizes[judged], strict=True):
            ends = np.array([values[k], *([1 / values[k]] if conservative else [])])
            related = np.append(ends, np.conj(ends))
            distances = np.abs(values[:, None] - related)
            near = (distances <= _NEAR * np.abs(related)).any(axis=1)
            triangle = np.linalg.qr(right[:, near])[1]  # to an orthonormal basis, and back
            dual = np.linalg.inv(triangle)
            among = np.ix_(near, near)
            norm = np.linalg.norm(triangle @ change[among] @ dual)
            norm += round_off * np.linalg.norm(triangle @ left[near])
            place = int(near[:k].sum())
            within = np.linalg.norm(triangle @ np.diag(values[near]) @ dual)
            condition = np.linalg.norm(dual[place]) * np.linalg.norm(triangle[:, place])
            error = min(condition * norm, math.sqrt(2 * within * norm))
            across = np.abs(change[k, ~near] * change[~near, k] / (values[k] - values[~near]))
            found = max(found, float((error + across.sum()) / max(1.0, size)))
    except np.linalg.LinAlgError:
        return math.inf
    return found


def differ_from_one(multipliers: np.ndarray, error: float, *, least: float = _PARABOLIC) -> bool:
    """Whether no multiplier is 1, in spite of their estimated error.

    - least: Smallest radius that is left about 1.
    """
    with np.errstate(all="ignore"):
        radii = np.maximum(least, _SAFETY * error * np.maximum(1.0, np.abs(multipliers)))
        return bool((np.abs(multipliers - 1) > radii).all())


def stability_of(
    multipliers: np.ndarray,
    *,
    order: int = 1,
    error: float = 0.0,
    conservative: bool = True,
    shear: float = 0.0,
) -> str:
    """Return the word for the linear stability that nontrivial multipliers imply.

    - "elliptic": all are on the unit circle, and none is 1 or -1;
    - "hyperbolic": all are real, in pairs m, 1/m off the unit circle;
    - "complex unstable": all are in quadruplets m, 1/m and their conjugates off the unit circle;
    - "parabolic": all are 1 or -1, up to round-off;
    - "mixed": of different kinds;
    - "unknown": their estimated error leaves more than one of these.

    Where none is left: "parabolic" with a shear, by which neighbours drift apart linearly, as those
    of an orbit of a pendulum with other periods do; "elliptic" without one, where all neighbours
    are periodic as well, as those of a harmonic oscillator.

    A multiplier of a symplectic map that is farther from all others than their errors is on the
    unit circle if its error leaves that open, because it would have a partner 1/conj(m) beside it
    otherwise; and it is real if its conjugate is no other one.

    With forces multipliers have no pairs: "attracting" if all are inside the unit circle,
    "repelling" if all are outside, else "mixed".

    - multipliers: Of one shift of the symmetry, without the trivial ones.
    - order: Number of shifts in the period.
    - error: Estimated error of the multipliers, relative where they are larger than 1.
    - conservative: Whether there are no forces.
    - shear: Difference of the monodromy matrix from the identity, whose error is that of
      multipliers where none is left.

    Examples
    --------
    >>> stability_of(np.exp([0.3j, -0.3j])), stability_of(np.array([-2.0, -0.5]))
    ('elliptic', 'hyperbolic')
    >>> stability_of(1.0001 * np.exp([0.3j, -0.3j]), error=1e-4)
    'elliptic'
    >>> stability_of(np.array([0.9999, 1.0001]), error=1e-4)
    'unknown'
    >>> stability_of(np.array([]), shear=1.0)
    'parabolic'
    """
    radius = _SAFETY * error
    if not (np.isfinite(multipliers).all() and radius <= _COARSE):
        return "unknown"
    if not conservative:
        sizes, width = np.abs(multipliers), max(_ON_CIRCLE, radius)
        if (sizes < 1 - width).all():
            return "attracting"
        if (sizes > 1 + width).all():
            return "repelling"
        open_ = radius > _ON_CIRCLE and (np.abs(sizes - 1) <= width).any()
        return "unknown" if open_ else "mixed"
    kinds = {_kind(multipliers, k, order, radius) for k in range(len(multipliers))}
    if not kinds:
        if shear > max(_SHEAR, radius):
            return "parabolic"
        return "elliptic" if shear <= radius + _EXACT and radius <= _SHEAR else "unknown"
    if "unknown" in kinds:
        return "unknown"
    return kinds.pop() if len(kinds) == 1 else "mixed"


def _kind(multipliers: np.ndarray, k: int, order: int, radius: float) -> str:
    """The kind of one of the multipliers of a symplectic map, within discs about all of them."""
    value = multipliers[k]
    if 0 < abs(value) < 1:  # the kind of its partner, which is the more accurate one
        k = int(np.argmin(np.abs(multipliers - 1 / np.conj(value))))
        value = multipliers[k]
    radius = radius * max(1.0, abs(value))

    def judged(word: str, distance: float, threshold: float) -> str:
        """The word for a multiplier on a curve, if its distance from it is no more than its error.

        Otherwise it is on the curve if no other one is where its partner across the curve would be.
        """
        room = 2 * max(radius, 1.5 * distance)
        if (np.abs(np.delete(multipliers, k) - value) > room).all():
            return word
        return (
            word if distance <= radius + _EXACT * abs(value) and radius <= threshold else "unknown"
        )

    with np.errstate(all="ignore"):
        turned = value**order
    near = min(abs(turned - 1), abs(turned + 1))
    if near < max(_PARABOLIC, 2 * order * radius):
        small = near <= order * radius + _EXACT and radius <= _PARABOLIC
        return "parabolic" if small and near < _PARABOLIC else "unknown"
    away = abs(abs(value) - 1)
    if away < max(_ON_CIRCLE, radius):
        return judged("elliptic", away, _ON_CIRCLE)
    real = _PARABOLIC * abs(value)
    if abs(value.imag) <= max(real, radius):
        return judged("hyperbolic", abs(value.imag), real)
    return "complex unstable"


# -- integrals -------------------------------------------------------------------------------------

_ROUND_OFF = 1e-7  # of a gradient, relative to its natural size


def gradients_of_integrals(
    H: Hamiltonian, states: np.ndarray, scale: np.ndarray, shift: SignedPermutation
) -> np.ndarray:
    """Return gradients of the integrals of H at states, shape (k, dim) -> (k, n, dim).

    Beside the integrals there are their images under a symmetry, so that it maps the span of the
    gradients to itself. Those that are round-off at the first state are left out.

    - scale: Sizes of the components, shape (dim,).
    - shift: A symplectic symmetry of H.
    """
    integrals = integrals_of(H)
    found = [np.zeros((len(states), 0, H.dim))]
    for k in range(shift.order if integrals else 0):
        power = shift.power(k)
        moved, units = power(states), np.abs(power(scale))
        least = _ROUND_OFF * natural_sizes(integrals, moved[0], units)
        least[[each == H for each in integrals]] = 0.0  # H moves along every orbit
        kept = np.abs(directions(integrals, moved[0]) / units).max(axis=1) > least
        times = np.zeros(len(states))
        fields = [
            flow_of(each).vector_field(moved, times)
            for each, is_kept in zip(integrals, kept, strict=True)
            if is_kept
        ]
        if fields:
            found.append(gradients_from(np.stack(fields, axis=1)) @ power.matrix)
    return np.concatenate(found, axis=1)
