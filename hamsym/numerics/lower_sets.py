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
from typing import NamedTuple

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


class _Factors(NamedTuple):
    """Inverses of the triangular factors of the Chebyshev polynomials at the Leja points."""

    lower: np.ndarray
    upper: np.ndarray


@functools.cache
def _factors() -> _Factors:
    matrix = chebyshev.chebvander(leja_points(), MOST_DEGREE)
    size = len(matrix)
    lower, upper = np.eye(size), matrix.copy()
    # Without pivots: the order of the Leja points is the order of the pivots.
    for k in range(size - 1):
        lower[k + 1 :, k] = upper[k + 1 :, k] / upper[k, k]
        upper[k + 1 :] -= np.outer(lower[k + 1 :, k], upper[k])
    return _Factors(np.linalg.inv(lower), np.linalg.inv(np.triu(upper)))


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
    return _applied(_factors().lower, degrees, values)


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
    return _applied(_factors().upper, degrees, surpluses(degrees, values))


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
