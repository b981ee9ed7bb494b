"""Ends of intervals by profile likelihood: chi-square, least over the other free quantities.

The signed root tau of the rise of that least chi-square over the minimum is proportional to the
distance where the model is linear, and takes its place where it is not. See Bates and Watts,
*Nonlinear Regression Analysis and Its Applications* (1988), section 6.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hamsym.fitting.search import Model
from hamsym.numerics.least_squares import minimize_squares

_STEPS = 40
_ITERATIONS = 25  # of each search for the other quantities
_CLOSE = 0.01  # relative error of an end
_FAR = 1e3  # sizes of the estimate or the first guess: there the data give no end
_BETTER = 1e-3  # of the variance: decrease that shows a better minimum


@dataclass(frozen=True)
class Profiles:
    """Ends of the intervals of some quantities."""

    #: Shape (n,); infinite where the rise stays below its level.
    ends: np.ndarray
    #: Values of the free quantities with a smaller chi-square than the minimum, by set.
    better: dict[int, np.ndarray]


@dataclass
class _Points:
    """Places on lines: distances, roots of the rise (nan without a motion), values."""

    distance: np.ndarray
    tau: np.ndarray
    values: np.ndarray

    def put(self, rows: np.ndarray, other: _Points, among: np.ndarray) -> None:
        self.distance[rows] = other.distance[among]
        self.tau[rows] = other.tau[among]
        self.values[rows] = other.values[among]


def profiled(
    model: Model,
    sets: np.ndarray,
    columns: np.ndarray,
    signs: np.ndarray,
    minima: np.ndarray,
    squares: np.ndarray,
    level: np.ndarray,
    first: np.ndarray,
    trace: np.ndarray,
) -> Profiles:
    """Follow the least chi-square along each line until it has risen by level^2.

    - sets, columns, signs: Set, place of the quantity and direction of each line, shape (n,).
    - minima, squares, level: Free quantities (n, k) and chi-square (n,) at the minimum, root of the
      rise (n,).
    - first: First distances, shape (n,).
    - trace: Changes of the free quantities for a unit distance, where the model is linear, (n, k).
    """
    count, unknowns = len(sets), model.unknowns
    every = np.arange(count)
    limit = np.where(signs > 0, unknowns.high[columns], unknowns.low[columns])
    room = np.abs(limit - minima[every, columns])
    # Where a column of J nearly vanishes, the linear model changes its quantity by far too much.
    reach = np.maximum(np.abs(minima), model.sizes)
    sizes = reach[every, columns]
    trace = np.where(np.abs(trace) * first[:, None] <= reach, trace, 0.0)
    inner = _Points(np.zeros(count), np.zeros(count), minima.copy())
    before = _Points(-np.ones(count), np.full(count, np.nan), minima - trace)
    outer = _Points(np.full(count, np.inf), np.full(count, np.nan), minima.copy())
    distance = np.minimum(first, room)
    open_, better, lowest = room > 0, {}, squares - _BETTER * (level / 2) ** 2
    last = np.zeros(count, dtype=bool)
    for _ in range(_STEPS):
        rows = np.flatnonzero(open_)
        if not len(rows):
            break
        start = _predicted(before, inner, outer, distance, rows)
        start[np.arange(len(rows)), columns[rows]] = (
            minima[rows, columns[rows]] + signs[rows] * distance[rows]
        )
        start = np.clip(start, unknowns.low, unknowns.high)
        values, least, known = _least(model, sets[rows], columns[rows], start)
        for place in np.flatnonzero(least < lowest[rows]):
            row = rows[place]
            better[int(sets[row])] = values[place]
            lowest[sets == sets[row]] = least[place]
        with np.errstate(all="ignore"):
            tau = np.sqrt(np.maximum(least - squares[rows], 0.0))
        below = tau <= level[rows]
        # Without a minimum the least chi-square is smaller than what was found.
        tried = _Points(
            distance[rows], np.where(below | known & np.isfinite(tau), tau, np.nan), values
        )
        again = below == last[rows]
        last[rows] = below
        before.put(rows[below], inner, rows[below])
        inner.put(rows[below], tried, below)
        outer.put(rows[~below], tried, ~below)
        distance[rows] = _next(before, inner, outer, level, room, rows, again)
        narrow = inner.distance[rows] >= (1 - _CLOSE) * outer.distance[rows]
        near = np.fmin(np.abs(inner.tau[rows] - level[rows]), np.abs(outer.tau[rows] - level[rows]))
        done = (near <= _CLOSE * level[rows]) | narrow
        done |= inner.distance[rows] >= np.minimum(room[rows], _FAR * sizes[rows])
        open_[rows[done]] = False
    closed = np.isfinite(outer.tau) | (np.abs(inner.tau - level) <= _CLOSE * level)
    ends = minima[every, columns] + signs * _crossing(before, inner, outer, level)
    ends = np.where(closed, ends, signs * np.inf)
    return Profiles(np.where(signs > 0, np.minimum(ends, limit), np.maximum(ends, limit)), better)


def _predicted(
    before: _Points, inner: _Points, outer: _Points, distance: np.ndarray, rows: np.ndarray
) -> np.ndarray:
    """Return values at distances on the straight line through the two nearest points."""
    bracketed = np.isfinite(outer.tau[rows])
    far = np.where(bracketed, outer.distance[rows], before.distance[rows])
    values = np.where(bracketed[:, None], outer.values[rows], before.values[rows])
    share = (distance[rows] - inner.distance[rows]) / (far - inner.distance[rows])
    return inner.values[rows] + share[:, None] * (values - inner.values[rows])


def _crossing(before: _Points, inner: _Points, outer: _Points, level: np.ndarray) -> np.ndarray:
    """Return the distances at which tau reaches the level, linear between points."""
    with np.errstate(all="ignore"):
        between = np.isfinite(outer.tau)
        width = np.where(between, outer.distance, before.distance) - inner.distance
        slope = (np.where(between, outer.tau, before.tau) - inner.tau) / width
        return np.asarray(inner.distance + (level - inner.tau) / slope)


def _next(
    before: _Points,
    inner: _Points,
    outer: _Points,
    level: np.ndarray,
    room: np.ndarray,
    rows: np.ndarray,
    again: np.ndarray,
) -> np.ndarray:
    """Return the next distances of some lines, the middle if the same end moved again."""
    crossing = _crossing(before, inner, outer, level)[rows]
    near, far = inner.distance[rows], outer.distance[rows]
    with np.errstate(invalid="ignore"):
        ahead = np.where(crossing > near, 1.05 * crossing - 0.05 * near, np.inf)
        ahead = np.fmin(ahead, 2 * near)
        middle = np.where(near > 0, (near + far) / 2, far / 10)
        between = np.where(np.isfinite(crossing) & ~again, crossing, middle)
        between = np.clip(between, near + 0.1 * (far - near), far - 0.1 * (far - near))
    return np.minimum(np.where(np.isfinite(far), between, ahead), room[rows])


def _least(
    model: Model, sets: np.ndarray, columns: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimise chi-square over all free quantities but one, which is given, for each row.

    - returns values, squares, converged: Shapes (n, k), (n,) and (n,); squares are not finite where
      there is no motion.
    """
    count = start.shape[1]
    if count == 1:
        return start, model.squares(start, sets), np.ones(len(sets), dtype=bool)
    others = np.array([[i for i in range(count) if i != column] for column in columns])

    def full(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
        complete = start[rows].copy()
        np.put_along_axis(complete, others[rows], values, axis=1)
        return complete

    def residuals(values: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, slopes = model.residuals(full(values, rows), sets[rows])
        return found, np.take_along_axis(slopes, others[rows][:, None], axis=2)

    found = minimize_squares(
        residuals,
        np.take_along_axis(start, others, axis=1),
        model.unknowns.low[others],
        model.unknowns.high[others],
        lambda squares, rows: model.variance(squares, sets[rows]),
        _ITERATIONS,
        _BETTER,
        model.sizes[others],
    )
    with np.errstate(all="ignore"):
        squares = (found.residuals**2).sum(axis=1)
    return full(found.unknowns, np.arange(len(sets))), squares, found.converged
