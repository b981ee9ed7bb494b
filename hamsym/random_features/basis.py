"""Basis of random sine features: networks whose readout alone is solved for.

On each window [t_a, t_a + h] the trial solution is z^ = z_a + f(s) N(s), s = (t - t_a)/h,
f(s) = 1 - exp(-s), where N is one hidden layer of sine neurons whose inner weights are random and
fixed (an extreme learning machine: Dong & Li 2021, Fabiani et al. 2023). Windows join exactly,
because the trial solution reproduces z_a for any readout.

Stage 1  The basis f(s) sin(a s + b), independent of H, is orthonormalised once
         (:class:`FeatureBasis`).
Stage 2  Windows are marched over a span (:mod:`hamsym.random_features.march`) into a
         :class:`~hamsym.random_features.windows.March`.
Stage 3  As a function of time the march is a :class:`~hamsym.random_features.trial.FeatureTrial`.
"""

from __future__ import annotations

import functools
import importlib.resources
import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import NamedTuple

import mpmath
import numpy as np
from numpy.polynomial import chebyshev

from hamsym.kernel.loops import LANES, Tables
from hamsym.numerics.collocation import chebyshev_points, chebyshev_values, collocation

_NEURONS = 60
_TRUNCATION = 1e-14  # of singular values, relative
DEGREE = 47  # of the Chebyshev series of the columns, which are entire functions
_BITS = 200  # of the sums that its coefficients are
_TERMS = 16  # of the series by which rates are extrapolated


class Size(NamedTuple):
    """Size of a basis: collocation points, the largest number of columns, points in between.

    Inner weights a are uniform within +- ``inner_range``.
    """

    nodes: int
    columns: int
    between: int
    inner_range: float


#: The small basis needs shorter windows, each at less than half the cost; its residual reaches
#: round-off at lower accuracy.
SIZES = {16: Size(16, 16, 16, 5.5), 24: Size(24, 19, 32, 10.0)}


@dataclass(frozen=True, eq=False)  # one object per seed, so that its tables can be cached
class FeatureBasis:
    """Orthonormal combinations Q = f(s) sin(a s + b) W of the features, for s in [0, 1]."""

    #: Seed of a and b.
    seed: int
    #: nodes, between: Chebyshev points of the first kind in (0, 1), and points in between, almost
    #: to both ends.
    nodes: np.ndarray
    between: np.ndarray
    #: Values dz/ds at the nodes -> coefficients, shape (m, nodes).
    fit: np.ndarray
    #: Values dz/ds at the nodes -> z - z_a there, shape (nodes, nodes).
    integration: np.ndarray
    #: to_between, rates_between: Q and dQ/ds at the points in between.
    to_between: np.ndarray
    rates_between: np.ndarray
    #: Q at s = 1 in extended precision, shape (m,).
    end: np.ndarray
    #: Chebyshev series of N = sin(a s + b) W in 2 s - 1, shape (degree + 1, m): the same function
    #: to one or two bits, without the cancellation in that product.
    series: np.ndarray

    @cached_property
    def tables(self) -> Tables:
        """Tables of :func:`hamsym.kernel.loops.march`.

        They multiply rows from the right: a table from n values to k has the shape (n, k).
        ``extrapolation`` fits a Chebyshev series to the rates at the nodes, which is continued into
        the next window; ``order`` is that at which the residual falls with the length.
        """
        end = self.end.astype(float)
        columns = self.series.shape[1]
        more = -columns % LANES  # columns of zeros
        return Tables(
            nodes=len(self.nodes),
            columns=columns + more,
            between=len(self.between),
            terms=_TERMS,
            order=columns - 1.0,
            node=self.nodes,
            integration=self.integration.T,
            twice=squared(self.integration).T,
            fit=np.pad(self.fit.T, ((0, 0), (0, more))),
            place=self.between,
            to_between=np.pad(self.to_between.T, ((0, more), (0, 0))),
            rates_between=np.pad(self.rates_between.T, ((0, more), (0, 0))),
            end=np.pad(end, (0, more)),
            end_low=np.pad((self.end - end).astype(float), (0, more)),
            # The points are orthogonal for polynomials: their coefficients are the best fit.
            extrapolation=collocation(len(self.nodes)).to_series[:_TERMS].T,
        )

    def columns(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate Q and dQ/ds at s of shape (n,), in the precision of s; each of shape (n, m).

        The values come from the stored series, as those of the solution do.
        """
        return _columns(self.series, self.rate_series, s)

    @cached_property
    def rate_series(self) -> np.ndarray:
        """Chebyshev series of dN/ds, the derivative of that of N."""
        return rate_series(self.series)


@functools.lru_cache(maxsize=16)
def feature_basis(seed: int = 0, nodes: int = 24) -> FeatureBasis:
    """Make the basis of a seed and of a size in :data:`SIZES`, once."""
    size = SIZES[nodes]
    if seed == 0:
        return basis_of_series(seed, stored_series(nodes))
    return basis_of_series(seed, made_series(seed, size))


@functools.cache
def stored_series(nodes: int) -> np.ndarray:
    """Return the series of seed 0, which are stored: LAPACK has one result for each processor."""
    with (
        importlib.resources.files("hamsym.random_features")
        .joinpath("series.npz")
        .open("rb") as file,
        np.load(file) as stored,
    ):
        return np.asarray(stored[str(nodes)])


def made_series(seed: int, size: Size) -> np.ndarray:
    """Make the series of a seed, shape (degree + 1, m)."""
    generator = np.random.default_rng(seed)
    inner = generator.uniform(-size.inner_range, size.inner_range, _NEURONS)
    shift = generator.uniform(-math.pi, math.pi, _NEURONS)
    dense = chebyshev_points(160)
    values, rates = _raw_columns(inner, shift, dense)
    _, sizes, right = np.linalg.svd(np.vstack((values, rates)), full_matrices=False)
    kept = np.flatnonzero(sizes > _TRUNCATION * sizes[0])[: size.columns]
    mixing = right[kept].T / sizes[kept]
    return _series(inner, shift, mixing)


def size_of(columns: int) -> Size:
    """Return the size of a basis with this number of columns."""
    return next((size for size in SIZES.values() if columns <= size.columns), SIZES[24])


def basis_of_series(seed: int, series: np.ndarray) -> FeatureBasis:
    """Make the basis of which the columns are f N for given series of N."""
    size = size_of(series.shape[1])
    nodes = chebyshev_points(size.nodes)
    # Just inside the window: at a breakpoint the equations of the next window may hold.
    between = np.clip(np.linspace(0.0, 1.0, size.between), 1e-9, 1 - 1e-9)

    def columns(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        # The rounding error of a table enters every window with the same sign.
        values, rates = _columns(series, rate_series(series), s.astype(np.longdouble))
        return values.astype(float), rates.astype(float)

    at_nodes, rates_at_nodes = columns(nodes)
    fit = _left_inverse(rates_at_nodes)
    to_between, rates_between = columns(between)
    return FeatureBasis(
        seed=seed,
        nodes=nodes,
        between=between,
        fit=fit.astype(float),
        integration=(at_nodes.astype(np.longdouble) @ fit).astype(float),
        to_between=to_between,
        rates_between=rates_between,
        end=_columns(series, rate_series(series), np.ones(1, dtype=np.longdouble))[0][0],
        series=series,
    )


def squared(table: np.ndarray) -> np.ndarray:
    """Return the square of a table, multiplied in one order."""
    exact = table.astype(np.longdouble)
    return np.asarray((exact @ exact).astype(float))


def _left_inverse(matrix: np.ndarray) -> np.ndarray:
    """Return (A^T A)^-1 A^T in extended precision, by orthonormal columns.

    Its operations have one order, and so the same bits on every processor that has this precision.
    """
    columns = matrix.astype(np.longdouble)
    count = columns.shape[1]
    orthonormal, triangle = columns.copy(), np.zeros((count, count), np.longdouble)
    for k in range(count):
        for _ in range(2):  # again, for the round-off of the first time
            for j in range(k):
                share = _dot(orthonormal[:, j], orthonormal[:, k])
                triangle[j, k] += share
                orthonormal[:, k] -= share * orthonormal[:, j]
        triangle[k, k] = np.sqrt(_dot(orthonormal[:, k], orthonormal[:, k]))
        orthonormal[:, k] /= triangle[k, k]
    inverse = orthonormal.T.copy()
    for k in reversed(range(count)):
        for j in range(k + 1, count):
            inverse[k] -= triangle[k, j] * inverse[j]
        inverse[k] /= triangle[k, k]
    return inverse


def _dot(one: np.ndarray, other: np.ndarray) -> np.longdouble:
    total = np.longdouble(0)
    for product in one * other:
        total += product
    return total


def _series(inner: np.ndarray, shift: np.ndarray, mixing: np.ndarray) -> np.ndarray:
    """Return Chebyshev coefficients of sin(a s + b) W in x = 2 s - 1, shape (degree + 1, m).

    sin(a s + b) = sin(c) cos(w x) + cos(c) sin(w x) with w = a/2, c = a/2 + b, and the coefficients
    of cos(w x) and sin(w x) are Bessel functions of w (Jacobi and Anger). The features are nearly
    dependent and W is large, so the sums are exact, in integers, and only the result is rounded:
    noise of high degree would be small in z^ and large in its derivative.
    """
    count, unit = DEGREE + 1, 1 << _BITS
    rows = np.empty((count, len(inner)), dtype=object)
    with mpmath.workprec(_BITS):
        for j, (a, b) in enumerate(zip(inner.tolist(), shift.tolist(), strict=True)):
            w = mpmath.mpf(a) / 2
            phases = mpmath.cos_sin(w + mpmath.mpf(b))
            for degree, bessel in enumerate(_bessel(w, count)):
                # sin(c) with cos(w x), of even degrees; cos(c) with sin(w x), of odd ones.
                sign = (1, 1, -1, -1)[degree % 4] * (2 if degree else 1)
                rows[degree, j] = int(mpmath.nint(sign * bessel * phases[1 - degree % 2] * unit))
    weights = np.array([[int(Fraction(w) * unit) for w in row] for row in mixing.tolist()], object)
    return np.array([[float(Fraction(n, unit**2)) for n in row] for row in rows @ weights])


def _bessel(w: mpmath.mpf, count: int) -> list[mpmath.mpf]:
    """Evaluate J_0(w) .. J_(count-1)(w) by Miller's backward recurrence."""
    values = [mpmath.mpf(0), mpmath.mpf(1)]  # from a degree where they are negligible
    for k in range(count + 20, 0, -1):
        values.append(2 * k / w * values[-1] - values[-2])
    values.reverse()
    norm = values[0] + 2 * mpmath.fsum(values[2::2])
    return [value / norm for value in values[:count]]


def _columns(series: np.ndarray, rates: np.ndarray, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Evaluate f N and its derivative at s from the series of N and dN/ds, in s's precision."""
    if s.dtype != series.dtype:  # more digits of the derivative of exactly this series
        series = series.astype(s.dtype)
        rates = rate_series(series)
    polynomials = chebyshev_values(2 * s - 1, len(series))
    f = (-np.expm1(-s) if s.dtype == np.float64 else _envelope(s))[:, None]
    network = polynomials @ series
    slopes = polynomials @ rates
    return f * network, (1 - f) * network + f * slopes


def _envelope(s: np.ndarray) -> np.ndarray:
    """Return 1 - exp(-s) for s in [0, 1], by its Taylor series: libraries round it differently."""
    total = np.zeros_like(s)
    for k in range(26, 0, -1):
        total = s * (1 - total) / k
    return total


def rate_series(series: np.ndarray) -> np.ndarray:
    """Differentiate Chebyshev series in x = 2 s - 1 with respect to s; the length is kept."""
    rates = np.zeros_like(series)
    rates[:-1] = 2 * chebyshev.chebder(series)
    return rates


def _raw_columns(
    inner: np.ndarray, shift: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    phase = np.multiply.outer(s, inner) + shift
    features, slopes = np.sin(phase), np.cos(phase) * inner
    f = -np.expm1(-s)[:, None]
    return f * features, (1 - f) * features + f * slopes
