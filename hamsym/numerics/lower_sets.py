"""Interpolation by polynomials in several variables, with lower sets of degrees.

A set of multi-indices nu is lower if it contains every mu <= nu with each of its nu: no degree
without the smaller ones. With one Leja point x_0, x_1, ... for each degree, the tensor products of
these points, (x_nu1, ..., x_nud), determine a polynomial with these degrees, for any lower set
(Chkifa, Cohen, Schwab, Found. Comput. Math. 14, 2014). A larger set keeps all points of a smaller
one. The matrix of the Chebyshev polynomials at the points factors into triangular ones, L U, which
act along one variable after the other; that is the cost of an interpolation.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable

import numpy as np
from numpy.polynomial import chebyshev

#: Largest degree in one variable.
MOST_DEGREE = 127

_GRID = 40_001  # points among which the Leja points are chosen


@functools.cache
def leja_points() -> np.ndarray:
    """Return Leja points of [-1, 1]: 0, and always the point furthest from those before it.

    The distance is the product of all distances. Shape (MOST_DEGREE + 1,).

    Examples
    --------
    >>> leja_points()[:4].round(3)
    array([ 0.   ,  1.   , -1.   ,  0.577])
    """
    grid = np.cos(np.linspace(0, np.pi, _GRID))
    grid[_GRID // 2] = 0.0
    found, distance = [0.0], np.abs(grid)
    with np.errstate(divide="ignore"):
        logarithm = np.log(distance)
        while len(found) <= MOST_DEGREE:
            # Of points that differ by round-off, the first: the same ones on every machine.
            nearly = logarithm >= logarithm.max() - 1e-9
            found.append(float(grid[np.argmax(nearly)]))
            logarithm += np.log(np.abs(grid - found[-1]))
    return np.array(found)


@functools.cache
def _factors() -> tuple[np.ndarray, np.ndarray]:
    """Inverses of the lower and the upper triangular factor of the matrix at the Leja points."""
    matrix = chebyshev.chebvander(leja_points(), MOST_DEGREE)
    size = len(matrix)
    lower, upper = np.eye(size), matrix.copy()
    # Without pivots: the order of the Leja points is the order of the pivots.
    for k in range(size - 1):
        lower[k + 1 :, k] = upper[k + 1 :, k] / upper[k, k]
        upper[k + 1 :] -= np.outer(lower[k + 1 :, k], upper[k])
    return np.linalg.inv(lower), np.linalg.inv(np.triu(upper))


def surpluses(degrees: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return by how much each value differs from the interpolation of those of smaller degrees.

    - degrees: A lower set of multi-indices, shape (n, d), each once.
    - values: Values at the points ``leja_points()[degrees]``, shape (n, ...).
    - returns: Shape (n, ...). They remain when the set is enlarged.

    Examples
    --------
    >>> degrees = np.array([[0], [1], [2], [3]])
    >>> surpluses(degrees, leja_points()[degrees[:, 0]] ** 2).round(3)
    array([0., 1., 2., 0.])
    """
    lower, _ = _factors()
    return _applied(lower, degrees, values)


def chebyshev_coefficients(degrees: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return the coefficients of the interpolating polynomial, shape (n, ...).

    The polynomial is the sum of coefficients times prod_k T_{nu_k}(y_k).

    - degrees, values: As of :func:`surpluses`.

    Examples
    --------
    >>> degrees = np.array([[0, 0], [1, 0], [2, 0], [0, 1]])
    >>> x, y = leja_points()[degrees].T
    >>> bool(np.allclose(chebyshev_coefficients(degrees, 2 * x**2 - y), [1, 0, 1, -1]))
    True
    """
    _, upper = _factors()
    return _applied(upper, degrees, surpluses(degrees, values))


def _applied(matrix: np.ndarray, degrees: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Apply a triangular matrix along one variable after the other."""
    found = np.array(values, dtype=float)
    for k in range(degrees.shape[1]):
        others = np.delete(degrees, k, axis=1)
        order = np.lexsort((degrees[:, k], *others.T))
        sorted_others = others[order]
        first = np.ones(len(order), dtype=bool)
        first[1:] = (sorted_others[1:] != sorted_others[:-1]).any(axis=1)
        starts = np.flatnonzero(first)
        lengths = np.diff(np.append(starts, len(order)))
        # In a lower set a line of length n has the degrees 0 to n - 1.
        for n in np.unique(lengths).tolist():
            lines = order[starts[lengths == n][:, None] + np.arange(n)]
            found[lines] = np.einsum("ij,lj...->li...", matrix[:n, :n], found[lines], optimize=True)
    return found


# -- choice of degrees -----------------------------------------------------------------------------

_AHEAD = 2  # degrees beyond one that counts, since symmetric functions lack every second one


def points(degrees: np.ndarray) -> np.ndarray:
    """Return the points of multi-indices in [-1, 1]^d, shape (n, d)."""
    return leja_points()[degrees]


def axis_degrees(d: int, most: int) -> np.ndarray:
    """Return the multi-indices of degree up to ``most`` in one variable, and up to 2 in all.

    Examples
    --------
    >>> axis_degrees(2, 3).tolist()
    [[0, 0], [0, 1], [0, 2], [0, 3], [1, 0], [1, 1], [2, 0], [3, 0]]
    """
    found = {(0,) * d}
    for k in range(d):
        found |= {(0,) * k + (n,) + (0,) * (d - k - 1) for n in range(1, most + 1)}
    for i, j in itertools.combinations(range(d), 2):
        found.add(tuple(int(k in (i, j)) for k in range(d)))
    return np.array(sorted(found))


def further_degrees(degrees: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Return multi-indices to add to a lower set, shape (m, d): those next to what is not small.

    - degrees: Shape (n, d).
    - sizes: Sizes of the surpluses relative to what counts, shape (n,); nan counts.

    Examples
    --------
    >>> further_degrees(np.array([[0, 0], [0, 1], [1, 0]]), np.array([9.0, 9.0, 0.1])).tolist()
    [[0, 2], [0, 3], [1, 1], [2, 0], [2, 1]]
    """
    known = set(map(tuple, degrees.tolist()))
    wanted = set()
    for nu in degrees[~(sizes <= 1)].tolist():
        for k in range(len(nu)):
            for step in range(1, _AHEAD + 1):
                if nu[k] + step <= MOST_DEGREE:
                    wanted.add((*nu[:k], nu[k] + step, *nu[k + 1 :]))
    return _completing(known, wanted - known, degrees.shape[1])


def margin(degrees: np.ndarray) -> np.ndarray:
    """Return all multi-indices that can be added to a lower set one by one."""
    return further_degrees(degrees, np.full(len(degrees), np.inf))


def _completing(known: set[tuple[int, ...]], wanted: set[tuple[int, ...]], d: int) -> np.ndarray:
    """Return those of the wanted multi-indices with which the set remains lower, in order."""
    added: list[tuple[int, ...]] = []
    for nu in sorted(wanted, key=lambda nu: (sum(nu), nu)):
        below = ((*nu[:k], nu[k] - 1, *nu[k + 1 :]) for k in range(len(nu)) if nu[k])
        if all(mu in known for mu in below):
            known.add(nu)
            added.append(nu)
    return np.array(sorted(added), dtype=int).reshape(len(added), d)


def interpolated(
    function: Callable[[np.ndarray], np.ndarray], d: int, accuracy: np.ndarray, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return degrees and values with which a function of [-1, 1]^d is interpolated.

    Raise ValueError if the function is not finite or needs more points.

    - function: y of shape (n, d) -> values, shape (n, m).
    - accuracy: Size of surpluses that are negligible, shape (m,).
    - most: Largest number of points.
    """
    degrees = axis_degrees(d, 4)
    values = function(points(degrees))
    while True:
        sizes = np.abs(surpluses(degrees, values) / accuracy).max(axis=1)
        added = further_degrees(degrees, sizes)
        if not np.isfinite(sizes).all() or len(degrees) + len(added) > most:
            raise ValueError("the function is not smooth enough for an expansion")
        if not len(added):
            return degrees, values
        degrees = np.concatenate((degrees, added))
        values = np.concatenate((values, function(points(added))))
