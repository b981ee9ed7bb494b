"""Chebyshev points, collocation with them, and values of Chebyshev polynomials."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import mpmath
import numpy as np
from numpy.polynomial import chebyshev

from hamsym.numerics.pairs import Pair, fraction

# Terms of a Taylor series between two Chebyshev points: polynomials through the values make half a
# turn there at most, so that the last of them are round-off.
_ORDERS = 24


@dataclass(frozen=True)
class Collocation:
    """Polynomial collocation on [0, 1]."""

    #: Chebyshev points of the first kind, shape (n,).
    nodes: np.ndarray
    #: Values at the nodes -> integrals from 0 to each node and, last, to 1, shape (n + 1, n).
    integration: np.ndarray
    #: Values at the nodes -> Chebyshev series in 2 s - 1, shape (n, n).
    to_series: np.ndarray

    def interpolation(self, s: np.ndarray) -> np.ndarray:
        """Return the matrix from values at the nodes to values at s, shape (len(s), n)."""
        return self.interpolated(np.eye(len(self.nodes)), s)

    def interpolated(self, values: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Return polynomials through values at the nodes, at places s.

        Shapes (..., n, dim) and (..., k) -> (..., k, dim).
        """
        # Extended precision is multiplied in one order; BLAS has one for each processor.
        series = self.to_series.astype(np.longdouble) @ values.astype(np.longdouble)
        basis = chebyshev.chebvander((2 * s - 1).astype(np.longdouble), len(self.nodes) - 1)
        return np.asarray((basis @ series).astype(float))


@functools.cache
def turns(count: int) -> np.ndarray:
    """Return cos(pi k/(2 count)) for k below 4 count, in extended precision.

    Cosines of libraries differ between processors; these are rounded from more digits.
    """
    found = _turns(count)
    return np.asarray(found.high.astype(np.longdouble) + found.low)


@functools.cache
def _turns(count: int) -> Pair:
    with mpmath.workdps(40):
        found = [mpmath.cospi(mpmath.mpf(k) / (2 * count)) for k in range(4 * count)]
        high = [float(value) for value in found]
        low = [float(value - part) for value, part in zip(found, high, strict=True)]
    return Pair(np.array(high), np.array(low))


def chebyshev_points(count: int) -> np.ndarray:
    """Return the Chebyshev points of the first kind in (0, 1), in ascending order."""
    return np.asarray(((1 - turns(count)[1 : 2 * count : 2]) / 2).astype(float))


@functools.cache
def collocation(count: int) -> Collocation:
    """Make the collocation tables for ``count`` nodes."""
    exact = np.longdouble
    odd, degrees = 2 * np.arange(count) + 1, np.arange(count)[:, None]
    to_series = turns(count)[degrees * odd % (4 * count)] * np.where(degrees % 2, -2, 2)
    to_series /= exact(count)
    to_series[0] /= 2
    integrals = chebyshev.chebint(np.eye(count, dtype=exact), lbnd=-1, scl=exact(0.5))
    places = np.append(-turns(count)[odd], exact(1))
    integration = chebyshev.chebval(places, integrals).T @ to_series
    return Collocation(chebyshev_points(count), integration.astype(float), to_series.astype(float))


@functools.cache
def precise_integration(count: int) -> Pair:
    """Make ``integration`` of the collocation tables with 106 bits, shape (count + 1, count)."""
    cosines, degrees = _turns(count), np.arange(count + 2)
    odd = 2 * np.arange(count) + 1
    # T_k at the nodes, in ascending order, which are minus these cosines, and at the end
    inside = cosines[degrees[:, None] * odd % (4 * count)]
    inside = np.where(degrees % 2, -1.0, 1.0)[:, None] * inside
    ones = np.ones((count + 2, 1))
    values = Pair(
        np.concatenate([inside.high, ones], axis=1), np.concatenate([inside.low, 0 * ones], axis=1)
    )
    total = Pair(np.zeros((count + 1, count)), np.zeros((count + 1, count)))
    for k in range(count):
        # The integral of T_k over a half, as s = (x + 1)/2, from -1 on
        if k == 0:
            integral = 0.5 * (values[1] + 1.0)
        elif k == 1:
            integral = fraction(1, 8) * (values[2] - 1.0)
        else:
            integral = fraction(1, 4 * (k + 1)) * values[k + 1]
            integral = integral - fraction(1, 4 * (k - 1)) * values[k - 1]
            integral = integral + fraction((-1) ** (k + 1), 2 * (k * k - 1))
        weight = fraction(1 if k == 0 else 2, count)
        total = total + integral[:, None] * (weight * inside[k])
    return total


@dataclass(frozen=True)
class ChebyshevTables:
    """Matrices between values at Chebyshev points x_j = cos(pi (j + 1/2)/n) and series in x."""

    points: np.ndarray
    #: values[k, j] = T_k(x_j), and series[j, k], its inverse.
    values: np.ndarray
    series: np.ndarray
    #: integral[j, i]: Weight of the value at x_j in the integral from -1 to x_i.
    integral: np.ndarray
    #: steps[i, j, m]: Weight of the value at x_j in term m of h f(a + h t), as a Taylor series, on
    #: the step from the point a before x_i, or -1, to a + h = x_i.
    steps: np.ndarray


@functools.cache
def chebyshev_tables(terms: int) -> ChebyshevTables:
    """Make the tables for ``terms`` points, rounded from products in extended precision."""
    places, degrees = 2 * np.arange(terms) + 1, np.arange(terms + 1)[:, None]
    longer = turns(terms)[degrees * places % (4 * terms)]
    series = longer[:terms].T * np.where(np.arange(terms), 2, 1) / np.longdouble(terms)
    integrals = chebyshev.chebint(np.eye(terms, dtype=np.longdouble), lbnd=-1).T
    tables = (
        longer[1],
        longer[:terms],
        series,
        series @ integrals @ longer,
        _steps(longer[1], series),
    )
    return ChebyshevTables(*(np.ascontiguousarray(each.astype(float)) for each in tables))


def _steps(points: np.ndarray, series: np.ndarray) -> np.ndarray:
    """Tables between values at points, in descending order, and Taylor series between them."""
    starts = np.append(points[1:], np.longdouble(-1))[:, None]
    lengths, shape = points[:, None] - starts, (len(points), len(points), _ORDERS)
    found = np.zeros(shape, np.longdouble)  # of T_k for each step
    found[0, :, 0] = 1
    found[1, :, :1], found[1, :, 1:2] = starts, lengths
    for k in range(2, len(points)):
        found[k] = 2 * starts * found[k - 1] - found[k - 2]
        found[k, :, 1:] += 2 * lengths * found[k - 1, :, :-1]
    return lengths[:, :, None] * (series @ found.reshape(len(points), -1)).reshape(shape).swapaxes(
        0, 1
    )


# -- values ----------------------------------------------------------------------------------------


def chebyshev_values(x: np.ndarray, count: int) -> np.ndarray:
    """Evaluate T_0 .. T_(count-1) at x of any shape, shape (*x.shape, count).

    Examples
    --------
    >>> chebyshev_values(np.array([0.5, 1.0]), 4)
    array([[ 1. ,  0.5, -0.5, -1. ],
           [ 1. ,  1. ,  1. ,  1. ]])
    """
    # The recurrence is as accurate as cosines of multiples of an angle, and 20 times faster.
    values, twice = np.empty((count, *x.shape), x.dtype), 2 * x
    values[0] = 1.0
    values[1:2] = x
    for k in range(2, count):
        np.multiply(twice, values[k - 1], out=values[k, ...])
        values[k] -= values[k - 2]
    return np.moveaxis(values, 0, -1)
