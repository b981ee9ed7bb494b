"""Linear stability that holds for every matrix in a matrix of balls."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb

#: Words that a proof gives, each with the weaker ones that follow from it.
WEAKER: dict[str, tuple[str, ...]] = {
    "elliptic": ("undecided",),
    "hyperbolic": ("unstable", "undecided"),
    "complex unstable": ("unstable", "undecided"),
    "parabolic": ("undecided",),
    "mixed": ("unstable", "undecided"),
    "attracting": ("undecided",),
    "repelling": ("unstable", "undecided"),
    "unstable": ("undecided",),
    "undecided": (),
}


def proven_stability(matrix: Any, whole: Any, *, forced: bool) -> str:
    """Return the word for the stability of every derivative over one shift in a matrix of balls.

    - matrix: The derivative without trivial directions (:mod:`hamsym.orbits.quotients`).
    - whole: The derivative over the period, with them.
    - forced: Whether there are forces, so that the derivative is not symplectic.
    """
    return _attraction(matrix) if forced else _symplectic(matrix, whole)


def _symplectic(matrix: Any, whole: Any) -> str:
    """The word for the stability of every symplectic matrix in a matrix of balls.

    Words are those of :func:`hamsym.orbits.multipliers.stability_of`, without "mixed" where none
    is proven for all pairs: then "unstable" if one of them is proven to be off the unit circle.

    The multipliers of a shift come in pairs m, 1/m, so that the characteristic polynomial is one of
    m + 1/m, whose signs between its roots are tested. Where no pair is left, the derivative over
    the period decides: over one shift it is not the identity where the shift is not.
    """
    polynomial = matrix.charpoly()
    coefficients = [polynomial[i] for i in range(matrix.nrows() + 1)]
    if matrix.nrows() % 2:  # a direction is left that has no partner
        return "undecided"
    n = (len(coefficients) - 1) // 2
    if n == 0:
        size = whole.nrows()
        excess = [whole[i, j] - (i == j) for i in range(size) for j in range(size)]
        return "parabolic" if any(entry != 0 for entry in excess) else "undecided"
    middles = np.array([float(entry.mid()) for entry in coefficients])
    if not np.isfinite(middles).all():
        return "undecided"
    roots = np.roots(middles[::-1])
    sums = roots + 1 / np.where(roots == 0, np.inf, roots)
    real = np.sort(sums.real[np.abs(sums.imag) < 1e-6 * (1 + np.abs(sums))])
    apart = np.diff(real) > 1e-6 * (1 + np.abs(real[1:]))  # m and 1/m have the same sum
    marks = np.unique([-2.0, *((real[1:] + real[:-1])[apart] / 2).tolist(), 2.0]).tolist()
    # Far out the polynomial, whose first coefficient is 1, has the signs of (-1)^n and 1.
    signs = [(-1) ** n, *(_sign(_of_sums(coefficients, mark)) for mark in marks), 1]
    changes = [a * b == -1 for a, b in pairwise(signs)]
    if 0 not in signs and sum(changes) == n:
        low, high = marks.index(-2.0) + 1, marks.index(2.0) + 1
        inside = sum(changes[low:high])
        return "elliptic" if inside == n else "mixed" if inside else "hyperbolic"
    if n == 2 and coefficients[3] ** 2 < 4 * (coefficients[2] - 2):
        return "complex unstable"
    # Another sign at a mark than farther out has a real pair beyond it.
    for mark, sign in zip(marks, signs[1:-1], strict=True):
        if (mark >= 2 and sign == -1) or (mark <= -2 and sign * (-1) ** n == -1):
            return "unstable"
    return "undecided"


def _of_sums(coefficients: list[Any], rho: float) -> Any:
    """A characteristic polynomial of pairs m, 1/m, as one of rho = m + 1/m."""
    n = (len(coefficients) - 1) // 2
    before, last, found = arb(2), arb(rho), coefficients[n]
    for j in range(1, n + 1):
        found = found + coefficients[n + j] * last
        before, last = last, arb(rho) * last - before
    return found


def _attraction(matrix: Any) -> str:
    """The stability of a periodic orbit with forces, for every matrix in one of balls.

    The zeros of the characteristic polynomial are located by the recursion of Schur and Cohn: all
    are inside the unit circle if and only if at each step the last coefficient is larger than the
    first.
    """
    polynomial = matrix.charpoly()
    coefficients = [polynomial[i] for i in range(matrix.nrows() + 1)]
    if _inside(coefficients):
        return "attracting"
    if _inside(coefficients[::-1]):
        return "repelling"
    # The first coefficient is the product of all zeros, up to the sign.
    return "unstable" if abs(coefficients[0]) > abs(coefficients[-1]) else "undecided"


def _inside(coefficients: list[Any]) -> bool:
    """Whether all zeros of a real polynomial are proven to be inside the unit circle."""
    while len(coefficients) > 1:
        first, last = coefficients[0], coefficients[-1]
        if not abs(first) < abs(last):
            return False
        pairs = zip(coefficients, reversed(coefficients), strict=True)
        coefficients = [last * a - first * b for a, b in pairs][1:]
    return True


def _sign(value: Any) -> int:
    """1 or -1 if a ball has one sign, else 0."""
    return 1 if value > 0 else -1 if value < 0 else 0
