"""Nonlinear least squares: many problems of one form at once, by the Levenberg-Marquardt method.

Each row is a problem of its own: it minimises |r(x)|^2 over a box. A step solves

    min |r + J s|^2 + damping |D s|^2,

with D the largest lengths that the columns of J have had (More 1978, Lecture Notes in Mathematics
630), so that units of the unknowns do not matter, by the singular values of J/D, so that their
squares are not formed. Steps are clipped to the box; an unknown at a bound that would leave it is
kept fixed for the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

__all__ = ["Minima", "are_minima", "minimize_squares", "projections"]

_ENOUGH = 1e-8  # of the variance of the residuals: iterations end
_CLOSE = 1e-6  # of it: a minimum, if no step improves it further
_FIRST_DAMPING = 1e-2
_LARGEST_DAMPING = 1e12
_SMALLEST_DAMPING = 1e-14
_USEFUL = 1e-4  # part of the predicted decrease that a step has to achieve
_SINGULAR = 1e-7  # of the largest singular value: the residuals do not depend on this direction

#: (unknowns (n, k), rows (n,)) -> residuals (n, m) and their derivatives (n, m, k).
Residuals = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Minima:
    """Results of all rows.

    Attributes
    ----------
    unknowns : numpy.ndarray
        Shape (n, k).
    residuals, jacobian : numpy.ndarray
        At the unknowns, shapes (n, m) and (n, m, k); not finite in rows without values at the
        start.
    converged : numpy.ndarray
        Whether the projected residuals vanish, shape (n,).
    iterations : numpy.ndarray
        Steps that were tried, shape (n,).
    """

    unknowns: np.ndarray
    residuals: np.ndarray
    jacobian: np.ndarray
    converged: np.ndarray
    iterations: np.ndarray


def minimize_squares(
    function: Residuals,
    starts: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    variance: Callable[[np.ndarray, np.ndarray], np.ndarray],
    iterations: int = 200,
) -> Minima:
    """Minimise the sums of squares of all rows.

    Parameters
    ----------
    function : callable
        Residuals and their derivatives for some rows; not finite where they have no values.
    starts : numpy.ndarray
        First unknowns, shape (n, k).
    low, high : numpy.ndarray
        Bounds, shape (k,); infinite where there are none.
    variance : callable
        (sums of squares, rows) -> variance of one residual, shape (n,), the unit in which the
        convergence is judged: the projection of the residuals on the columns of J, which is the
        distance to the minimum in standard errors of the unknowns.
    iterations : int

    Examples
    --------
    >>> t = np.array([0.0, 1.0, 2.0])
    >>> def line(x, rows):
    ...     jacobian = np.broadcast_to(np.column_stack((np.ones(3), t)), (len(x), 3, 2))
    ...     return x[:, :1] + x[:, 1:] * t - np.array([1.0, 3.0, 5.0]), jacobian
    >>> none = np.full(2, np.inf)
    >>> found = minimize_squares(line, np.zeros((1, 2)), -none, none, lambda s, rows: 1 + 0 * s)
    >>> found.unknowns.round(3), found.converged
    (array([[1., 2.]]), array([ True]))
    """
    x = np.clip(np.array(starts, dtype=float), low, high)
    count = len(x)
    everything = np.arange(count)
    residuals, jacobian = (np.array(part) for part in function(x, everything))
    squares = _squares(residuals, jacobian)
    damping, scale = np.full(count, _FIRST_DAMPING), np.zeros(x.shape)
    steps, open_ = np.zeros(count, dtype=int), np.isfinite(squares)
    for _ in range(iterations):
        rows = np.flatnonzero(open_)
        if not len(rows):
            break
        here, r, J = x[rows], residuals[rows], _inside(x, residuals, jacobian, low, high, rows)
        scale[rows] = largest = np.maximum(scale[rows], _lengths(jacobian[rows]))
        unit = np.where(largest > 0, largest, 1.0)
        left, values, right = np.linalg.svd(J / unit[:, None], full_matrices=False)
        parts = np.einsum("nmk,nm->nk", left, r)
        distance = _counted(values, parts)
        scatter = variance(squares[rows], rows)
        done = distance <= _ENOUGH * scatter
        step = np.einsum("nkj,nk->nj", right, values / (values**2 + damping[rows, None]) * parts)
        there = np.clip(here - step / unit, low, high)
        still = (np.abs(there - here) <= 4 * np.finfo(float).eps * np.abs(here)).all(axis=1)
        open_[rows[done | still]] = False
        going = ~(done | still)
        if not going.any():
            continue
        rows, here, there, r, J = (part[going] for part in (rows, here, there, r, J))
        predicted = squares[rows] - ((r + np.einsum("nmk,nk->nm", J, there - here)) ** 2).sum(1)
        tried, slopes = function(there, rows)
        found = _squares(tried, slopes)
        steps[rows] += 1
        with np.errstate(all="ignore"):
            gain = np.where(predicted > 0, (squares[rows] - found) / predicted, -1.0)
        useful = gain > _USEFUL  # not for nan
        factor = np.where(gain > 0.75, 0.1, np.where(gain > 0.25, 1.0, 4.0))
        damping[rows] = np.maximum(
            damping[rows] * np.where(useful, factor, 10.0), _SMALLEST_DAMPING
        )
        better = rows[useful]
        x[better], squares[better] = there[useful], found[useful]
        residuals[better], jacobian[better] = tried[useful], slopes[useful]
        # A step that fails so near to the minimum fails by the errors of the residuals.
        near = ~useful & (distance[going] <= _CLOSE * scatter[going])
        open_[rows[near | ~(damping[rows] <= _LARGEST_DAMPING)]] = False
    converged = np.zeros(count, dtype=bool)
    rows = np.flatnonzero(np.isfinite(squares))
    if len(rows):
        parts = x[rows], residuals[rows], jacobian[rows]
        converged[rows] = are_minima(*parts, low, high, variance(squares[rows], rows))
    return Minima(x, residuals, jacobian, converged, steps)


def are_minima(
    x: np.ndarray,
    residuals: np.ndarray,
    jacobian: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    variance: np.ndarray,
) -> np.ndarray:
    """Return whether the projected residuals vanish, up to steps out of the box, shape (n,)."""
    J = _inside(x, residuals, jacobian, low, high, np.arange(len(x)))
    return projections(residuals, J) <= _CLOSE * variance


def projections(residuals: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the squared lengths of the residuals' projections on the columns of J, shape (n,)."""
    lengths = _lengths(jacobian)
    unit = np.where(lengths > 0, lengths, 1.0)
    left, values, _ = np.linalg.svd(jacobian / unit[:, None], full_matrices=False)
    return _counted(values, np.einsum("nmk,nm->nk", left, residuals))


def _counted(values: np.ndarray, parts: np.ndarray) -> np.ndarray:
    """Sum the squares of parts along directions on which the residuals depend."""
    along = values > _SINGULAR * values[:, :1]
    return np.where(along, parts**2, 0.0).sum(axis=1)


def _inside(
    x: np.ndarray,
    residuals: np.ndarray,
    jacobian: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    rows: np.ndarray,
) -> np.ndarray:
    """Return J of some rows, zero for unknowns at a bound that they would leave."""
    J, at = jacobian[rows], x[rows]
    slope = np.einsum("nmk,nm->nk", J, residuals[rows])
    kept = ((at <= low) & (slope > 0)) | ((at >= high) & (slope < 0))
    return np.where(kept[:, None], 0.0, J)


def _lengths(jacobian: np.ndarray) -> np.ndarray:
    largest = np.abs(jacobian).max(axis=1)  # squares of some units overflow
    scaled = jacobian / np.where(largest > 0, largest, 1.0)[:, None]
    return largest * np.sqrt(np.einsum("nmk,nmk->nk", scaled, scaled))


def _squares(residuals: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the sums of squares, infinite where a residual or a derivative is not finite."""
    with np.errstate(all="ignore"):
        squares = np.einsum("nm,nm->n", residuals, residuals)
    finite = np.isfinite(squares) & np.isfinite(jacobian).all(axis=(1, 2))
    return np.where(finite, squares, np.inf)
