"""Linear stability that holds for every matrix in a matrix of balls."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb

__all__ = ["proven_attraction", "proven_stability"]


def proven_stability(matrix: Any, order: int, autonomous: bool) -> str:
    """Return the kind of stability that holds for every symplectic matrix in a matrix of balls.

    The multipliers of a shift come in pairs m, 1/m. With the trivial pair divided out, the
    characteristic polynomial is one of m + 1/m, whose signs between its roots are tested.

    Parameters
    ----------
    matrix : arb_mat
        The derivative over one shift.
    order : int
        Shifts in a period.
    autonomous : bool
        Whether there is a trivial pair.
    """
    polynomial = matrix.charpoly()
    coefficients = [polynomial[i] for i in range(matrix.nrows() + 1)]
    for _ in range(2 if autonomous else 0):
        coefficients = _divided(coefficients)
    n = (len(coefficients) - 1) // 2
    if n == 0:
        return "elliptic"

    def value(rho: float) -> Any:
        before, last, found = arb(2), arb(rho), coefficients[n]
        for j in range(1, n + 1):
            found = found + coefficients[n + j] * last
            before, last = last, arb(rho) * last - before
        return found

    middles = np.array([float(entry.mid()) for entry in coefficients])
    if not np.isfinite(middles).all():
        return "undecided"
    roots = np.roots(middles[::-1])
    sums = roots + 1 / np.where(roots == 0, np.inf, roots)
    real = np.unique(np.round(sums.real[np.abs(sums.imag) < 1e-6 * (1 + np.abs(sums))], 9))
    inside = real[np.abs(real) < 2]
    if len(inside) == n:
        marks = [-2.0, *((inside[1:] + inside[:-1]) / 2).tolist(), 2.0]
        signs = [_sign(value(mark)) for mark in marks]
        if all(a * b == -1 for a, b in pairwise(signs)):
            return "elliptic"
    above, below = _sign(value(2.0)), _sign(value(-2.0)) * (-1) ** n
    if above == -1:  # a pair of positive real multipliers
        return "hyperbolic" if n == 1 else "unstable"
    if below == -1:
        if n > 1:
            return "unstable"
        return "inverse hyperbolic" if order % 2 else "hyperbolic"
    # The sign far out is that of 1 and of (-1)^n; another one has a real pair beyond it.
    for mark in ((real[1:] + real[:-1]) / 2).tolist():
        sign = _sign(value(mark))
        if (mark > 2 and sign == -1) or (mark < -2 and sign * (-1) ** n == -1):
            return "unstable"
    return "undecided"


def proven_attraction(matrix: Any, autonomous: bool) -> str:
    """Return the stability of a periodic orbit with forces, for every matrix in one of balls.

    The zeros of the characteristic polynomial, without the multiplier 1 of the flow, are located by
    the recursion of Schur and Cohn: all are inside the unit circle if and only if at each step the
    last coefficient is larger than the first.
    """
    polynomial = matrix.charpoly()
    coefficients = [polynomial[i] for i in range(matrix.nrows() + 1)]
    if autonomous:
        coefficients = _divided(coefficients)
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


def _divided(coefficients: list[Any]) -> list[Any]:
    """Divide a polynomial by m - 1, which is a factor of it."""
    found, carried = [], arb(0)
    for entry in reversed(coefficients[1:]):
        carried = carried + entry
        found.append(carried)
    return found[::-1]


def _sign(value: Any) -> int:
    """1 or -1 if a ball has one sign, else 0."""
    return 1 if value > 0 else -1 if value < 0 else 0
