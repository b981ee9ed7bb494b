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

_CLOSE = 1e-6  # of the variance of the residuals: a minimum, if no step improves it further
_ENOUGH = 0.01  # of that: iterations end
_FIRST_DAMPING = 1e-2
_LARGEST_DAMPING = 1e12
_SMALLEST_DAMPING = 1e-14
_USEFUL = 1e-4  # part of the predicted decrease that a step has to achieve
_SINGULAR = 1e-7  # of the largest singular value: the residuals do not depend on this direction
_STALLED = 3  # successful steps in turn with no decrease worth another one
_DIFFERENCE = 1e-4  # of the size of an unknown: step of the differences for second derivatives
_FLAT = 1e-5  # of a curvature: what differences cannot tell from zero

#: (unknowns (n, k), rows (n,)) -> residuals (n, m) and their derivatives (n, m, k).
Residuals = Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


@dataclass(frozen=True)
class Minima:
    """Results of all rows."""

    #: Shape (n, k).
    unknowns: np.ndarray
    #: residuals, jacobian: At the unknowns, shapes (n, m) and (n, m, k); not finite in rows without
    #: values at the start.
    residuals: np.ndarray
    jacobian: np.ndarray
    #: Whether no step of first or second order improves the row, shape (n,).
    converged: np.ndarray
    #: Steps that were tried, shape (n,).
    iterations: np.ndarray


def minimize_squares(
    function: Residuals,
    starts: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    variance: Callable[[np.ndarray, np.ndarray], np.ndarray],
    iterations: int = 200,
    close: float = _CLOSE,
    sizes: np.ndarray | None = None,
) -> Minima:
    """Minimise the sums of squares of all rows.

    - function: Residuals and their derivatives for some rows; not finite where they have no values.
    - starts: First unknowns, shape (n, k).
    - low, high: Bounds, shape (k,) or (n, k); infinite where there are none.
    - variance: (sums of squares, rows) -> variance of one residual, shape (n,), the unit in which
      the convergence is judged: the projection of the residuals on the columns of J, which is the
      distance to the minimum in standard errors of the unknowns.
    - close: Part of the variance by which a converged row may be above the minimum.
    - sizes: Sizes of the unknowns, shape (n, k); by default those of the starts, 1 where one is
      zero.

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
    low, high = np.broadcast_to(low, x.shape), np.broadcast_to(high, x.shape)
    count = len(x)
    everything = np.arange(count)
    sizes = np.where(x == 0, 1.0, np.abs(x)) if sizes is None else sizes
    residuals, jacobian = (np.array(part) for part in function(x, everything))
    squares = _squares(residuals, jacobian)
    damping, scale = np.full(count, _FIRST_DAMPING), np.zeros(x.shape)
    steps, open_ = np.zeros(count, dtype=int), np.isfinite(squares)
    stalled = np.zeros(count, dtype=int)
    for _ in range(iterations):
        rows = np.flatnonzero(open_)
        if not len(rows):
            break
        here, r = x[rows], residuals[rows]
        J = _inside(here, r, jacobian[rows], low[rows], high[rows])
        scale[rows] = largest = np.maximum(scale[rows], _lengths(jacobian[rows]))
        unit = np.where(largest > 0, largest, 1.0)
        left, values, right = np.linalg.svd(J / unit[:, None], full_matrices=False)
        parts = np.einsum("nmk,nm->nk", left, r)
        distance = _counted(values, parts)
        scatter = variance(squares[rows], rows)
        done = distance <= _ENOUGH * close * scatter
        step = np.einsum("nkj,nk->nj", right, values / (values**2 + damping[rows, None]) * parts)
        there = np.clip(here - step / unit, low[rows], high[rows])
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
        near = ~useful & (distance[going] <= close * scatter[going])
        # Where a column of J vanishes, the projection on it does not; the decrease does.
        little = useful & (predicted <= _ENOUGH * close * scatter[going])
        stalled[rows] = np.where(little, stalled[rows] + 1, np.where(useful, 0, stalled[rows]))
        ended = near | (stalled[rows] >= _STALLED) | ~(damping[rows] <= _LARGEST_DAMPING)
        open_[rows[ended]] = False
    converged = np.zeros(count, dtype=bool)
    rows = np.flatnonzero(np.isfinite(squares))
    if len(rows):
        converged[rows] = are_minima(
            lambda values, some: function(values, rows[some]),
            *(x[rows], residuals[rows], jacobian[rows], low[rows], high[rows]),
            variance(squares[rows], rows),
            sizes[rows],
            close,
        )
    return Minima(x, residuals, jacobian, converged, steps)


def are_minima(
    function: Residuals,
    x: np.ndarray,
    residuals: np.ndarray,
    jacobian: np.ndarray,
    low: np.ndarray,
    high: np.ndarray,
    variance: np.ndarray,
    sizes: np.ndarray,
    close: float = _CLOSE,
) -> np.ndarray:
    """Return whether no step inside the box improves the rows, shape (n,).

    The projected residuals vanish; or, where a column of J vanishes with its unknown, the decrease
    that Newton's method predicts does, with second derivatives from differences of J by a small
    part of ``sizes`` (n, k), and no curvature is negative.
    """
    low, high = np.broadcast_to(low, x.shape), np.broadcast_to(high, x.shape)
    J = _inside(x, residuals, jacobian, low, high)
    found = projections(residuals, J) <= close * variance
    rows = np.flatnonzero(~found)
    if not len(rows):
        return found
    with np.errstate(all="ignore"):
        most = 0.1 * np.sqrt(variance[rows, None]) / _lengths(J[rows])
    steps = np.fmin(_DIFFERENCE * np.maximum(np.abs(x[rows]), sizes[rows]), most)
    count = x.shape[1]
    shifts = np.einsum("s,nk,kj->nskj", [1.0, -1.0], steps, np.eye(count))
    near = (x[rows, None, None] + shifts).reshape(-1, count)
    r, slopes = function(near, np.repeat(rows, 2 * count))
    with np.errstate(all="ignore"):
        gradients = np.einsum("nmk,nm->nk", slopes, r).reshape(-1, 2, count, count)
        curvatures = (gradients[:, 0] - gradients[:, 1]) / 2 * steps[:, None]
    for row, step, curvature in zip(rows, steps, curvatures, strict=True):
        inside = (J[row] != 0).any(axis=0)
        gradient = (J[row].T @ residuals[row] * step)[inside]
        curvature = (curvature + curvature.T)[np.ix_(inside, inside)] / 2
        found[row] = _newton_decrease(gradient, curvature) <= close * variance[row]
    return found


def _newton_decrease(gradient: np.ndarray, curvature: np.ndarray) -> float:
    """Return the decrease to the minimum of a quadratic form, infinite if it has none."""
    diagonal = np.diag(curvature)
    if not (np.isfinite(curvature).all() and (diagonal > 0).all()):
        return np.inf
    unit = np.sqrt(diagonal)
    values, vectors = np.linalg.eigh(curvature / unit / unit[:, None])
    if not values[0] >= -_FLAT:
        return np.inf
    along = values > _FLAT
    parts = vectors.T @ (gradient / unit)
    return float((parts[along] ** 2 / values[along]).sum())


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
    x: np.ndarray, residuals: np.ndarray, jacobian: np.ndarray, low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Return J, zero for unknowns at a bound that they would leave."""
    slope = np.einsum("nmk,nm->nk", jacobian, residuals)
    kept = ((x <= low) & (slope > 0)) | ((x >= high) & (slope < 0))
    return np.where(kept[:, None], 0.0, jacobian)


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
