"""Sign changes of sampled functions, and zeros between samples, vectorised.

Input:  values of a function, and the signs of its slope, at a row of nodes.
Output: its zeros between them. An interval is searched if the sign changes from one end to the
        other, or if both ends have one sign and the slopes show a turning point towards zero in
        between: then the turning point is located first, and if the sign changes at it, both
        crossings are.

Two kinds of zeros are missed: a pair in an interval with more than one turning point, and a third
zero between two nodes.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# Of an interval: distance from its ends at which the search for a turning point begins.
_ASIDE = 1e-3
_BLOCK, _ROWS = 100, 500  # points and functions of one evaluation in a search for first zeros
_SAME_SIGNS = -1  # status of scipy for a bracket whose ends have one sign

#: (places, numbers of the intervals or functions) -> values.
Functions = Callable[[np.ndarray, np.ndarray], np.ndarray]


def sign_changes(values: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return indices (..., i) where values, shape (..., n), change their sign from i to i + 1."""
    return np.nonzero(changes(values[..., :-1], values[..., 1:]))


def changes(before: np.ndarray, after: np.ndarray, direction: float = 0.0) -> np.ndarray:
    """Whether a sign changes from before to after.

    A zero belongs to the interval that ends there, and is therefore counted once. A direction above
    zero selects rising values, below zero falling ones.
    """
    rising, falling = (before < 0) & (after >= 0), (before > 0) & (after <= 0)
    if direction > 0:
        return rising
    return falling if direction < 0 else rising | falling


def suspects(values: np.ndarray, slopes: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Find intervals between nodes that may contain zeros.

    - values, slopes: Values of the function at the nodes, and slopes in the direction from node to
      node, of which only the signs are used; shape (..., n).
    - returns where: Indices (..., i) of intervals from i to i + 1.
    - returns dips: Whether an interval begins and ends on one side of zero, shape (k,).
    """
    before, after = np.sign(values[..., :-1]), np.sign(values[..., 1:])
    side = np.where(after == 0, before, after)
    towards, away = np.sign(slopes[..., :-1]) * side < 0, np.sign(slopes[..., 1:]) * side > 0
    dips = (before * side >= 0) & towards & away
    where = np.nonzero(changes(before, after) | dips)
    return where, dips[where]


def zeros(
    function: Functions,
    before: np.ndarray,
    after: np.ndarray,
    dips: np.ndarray,
    direction: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Locate zeros in the intervals from :func:`suspects`.

    - function: (share, index) -> values, where share runs from 0 to 1 in the interval of that
      index.
    - before, after: Values at the ends of the intervals, shape (k,).
    - dips: Whether an interval begins and ends on one side of zero, shape (k,).
    - direction: As in :func:`changes`.
    - returns share, index: Shape (n,), in the order of the intervals and within them.
    """
    whole, dip = np.flatnonzero(~dips), np.flatnonzero(dips)
    side = np.where(after == 0, np.sign(before), np.sign(after))[dip]
    turn, value = _turning_points(function, side, dip)
    low = np.concatenate((np.zeros(len(whole) + len(dip)), turn))
    high = np.concatenate((np.ones(len(whole)), turn, np.ones(len(dip))))
    at_low = np.concatenate((before[whole], before[dip], value))
    at_high = np.concatenate((after[whole], value, after[dip]))
    index = np.concatenate((whole, dip, dip))
    crossed = np.flatnonzero(changes(at_low, at_high, direction))
    index = index[crossed]
    share = refine(lambda x, k: function(x, index[k]), low[crossed], high[crossed])
    order = np.lexsort((share, index))
    order = order[np.isfinite(share[order])]
    return share[order], index[order]


def _turning_points(
    function: Functions, side: np.ndarray, index: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Locate the points closest to zero, or furthest beyond it, and the values there."""
    if not len(index):
        return np.empty(0), np.empty(0)

    def height(share: np.ndarray, k: np.ndarray) -> np.ndarray:
        return side[k] * function(share, index[k])

    from scipy.optimize import elementwise  # slow to import

    number, share = np.arange(len(index)), np.full(len(index), _ASIDE)
    with np.errstate(all="ignore"):
        left, right = height(share, number), height(1 - share, number)
        middle = np.where(left <= right, share, 1 - share)
        ends = np.zeros(len(index)), middle, np.ones(len(index))
        found = elementwise.find_minimum(height, ends, args=(number,))
        # A turning point next to an end has no bracket; the end is as good.
        better = found.success & (found.f_x <= np.minimum(left, right))
    return (
        np.where(better, found.x, middle),
        side * np.where(better, found.f_x, np.minimum(left, right)),
    )


def refine(function: Functions, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Locate zeros of function(x, index) between low and high, shape (n,), to round-off.

    By scipy's Chandrupatla method, for all intervals at once; NaN where the sign changes at a pole
    or the function is NaN in between.
    """
    if not len(low):
        return np.empty(0)
    index = np.arange(len(low))
    from scipy.optimize import elementwise  # slow to import

    with np.errstate(all="ignore"):
        result = elementwise.find_root(function, (low, high), args=(index,))
        ends = np.abs([function(low, index), function(high, index)])
        # Round-off may change the sign of a zero at an end when it is evaluated again.
        nearer = np.where(ends[0] < ends[1], low, high)
        found = np.where(result.status == _SAME_SIGNS, nearer, result.x)
        return np.where(np.abs(function(found, index)) <= ends.max(axis=0), found, np.nan)


def first_zeros(functions: Functions, count: int) -> np.ndarray:
    """Find the smallest zero from 0 on of each of several functions of one variable.

    Each function is sampled at 0 and at 4,600 points between 1e-300 and 1e300, most of them between
    1e-9 and 1e9. Intervals where it is not finite are skipped, and so are sign changes at poles.

    - functions: For arrays that broadcast.
    - count: Number of functions.
    - returns: Shape (count,); NaN for a function without a sign change.

    Examples
    --------
    >>> first_zeros(lambda x, index: x / 4 - np.array([3.0, -1.0])[index], 2)
    array([12., nan])
    """
    scales = (1e-300, 1e-9, 300), (1e-9, 1e9, 4_001), (1e9, 1e300, 300)
    ranges = [np.geomspace(low, high, points) for low, high, points in scales]
    scan = np.concatenate(([0.0], ranges[0], ranges[1][1:], ranges[2][1:]))
    found = np.full(count, np.nan)
    for first in range(0, len(scan) - 1, _BLOCK):
        points = scan[first : first + _BLOCK + 1]
        left = np.flatnonzero(np.isnan(found))
        if not len(left):
            break
        for index in np.split(left, range(_ROWS, len(left), _ROWS)):
            found[index] = _first_in_block(functions, points, index)
    return found


def _first_in_block(functions: Functions, points: np.ndarray, index: np.ndarray) -> np.ndarray:
    """Find the first zero of each function between these points; NaN where there is none."""
    found = np.full(len(index), np.nan)
    values = functions(points, index[:, None])
    sign = np.sign(np.where(np.isfinite(values), values, np.nan))
    changes = sign[:, :-1] * sign[:, 1:] <= 0  # False for NaN
    while (rows := np.flatnonzero(changes.any(axis=1))).size:
        at, of = np.argmax(changes[rows], axis=1), index[rows]

        def at_interval(x: np.ndarray, k: np.ndarray, of: np.ndarray = of) -> np.ndarray:
            return functions(x, of[k])

        between = refine(at_interval, points[at], points[at + 1])
        found[rows] = np.where(sign[rows, at] == 0, points[at], between)
        changes[rows, at] = False  # a pole, if it is not found
        changes[rows[np.isfinite(found[rows])]] = False
    return found
