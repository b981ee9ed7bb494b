"""Choice of the degrees of an expansion, by direction and adaptively.

Input:  a function of the box, and the accuracy wanted.
Output: a lower set of degrees with the values of the function at its points.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from hamsym.numerics.lower_sets import MOST_DEGREE, leja_points, surpluses

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
