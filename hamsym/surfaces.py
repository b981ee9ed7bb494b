"""Surfaces in phase space, from text such as "x = 0, p_x > 0", and the zeros of what defines them.

Input:  values of a function, and the signs of its slope, at a row of nodes.
Output: its zeros between them. An interval is searched if the sign changes from one end to the
        other, or if both ends have one sign and the slopes say that the function turns around on
        the way towards zero: there the turning point is located first, and if the sign changes
        at it, both crossings are.

What remains undetectable is a pair of crossings in an interval where the function turns around
more than once, and a third crossing between two nodes.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import elementwise

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.parsing import canonical_name, parse_expression

__all__ = ["Surface", "parse_surface", "refine", "sign_changes", "suspects", "zeros"]

_ASIDE = 1e-3  # of an interval: how far from its ends the search for a turning point begins
_SAME_SIGNS = -1  # the status of scipy for a bracket whose ends have one sign


@dataclass(frozen=True)
class Surface:
    """Where a function of the state and the time is zero, and others are positive.

    Attributes
    ----------
    text : str
    names : frozenset of str
        Components of z that occur in the equation.
    value : callable
        (z, t) -> what is zero on the surface, shape (...).
    conditions : tuple of callable
        (z, t) -> what is positive, shape (...).
    """

    text: str
    names: frozenset[str]
    value: Callable[..., np.ndarray] = field(repr=False)
    conditions: tuple[Callable[..., np.ndarray], ...] = field(repr=False)

    def holds(self, z: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Which states, shape (n, dim), satisfy the conditions."""
        found = np.ones(len(z), dtype=bool)
        for condition in self.conditions:
            found &= condition(z, t) > 0
        return found


def parse_surface(H: Hamiltonian, text: str) -> Surface:
    """An equation, and any number of inequalities, separated by commas.

    Raises
    ------
    InputError
        If there is not one equation, or a comparison is none of ``=``, ``<`` and ``>``.
    ParseError, VariableError
        If a side of it cannot be read, or has a symbol that H does not have.

    Examples
    --------
    >>> surface = parse_surface(Hamiltonian("p_x**2 + p_y**2 + x*y"), "x = 1, p_x > p_y")
    >>> surface.value([[1.5, 0, 0, 0]], 0.0)
    array([0.5])
    """
    if not isinstance(text, str):
        raise InputError(f"a surface is a str such as 'x = 0, p_x > 0', not {type(text).__name__}")
    equations, conditions = [], []
    for part in _parts(text):
        left, sign, right = _comparison(part)
        if sign == "=":
            equations.append(parse_expression(left) - parse_expression(right))
        else:
            larger, smaller = (left, right) if sign == ">" else (right, left)
            conditions.append(parse_expression(larger) - parse_expression(smaller))
    if len(equations) != 1:
        number = "no equation" if not equations else "two equations"
        raise InputError(f"'{text}' has {number}; write one such as x = 0, and others as p_x > 0")
    expr = equations[0]
    symbols = {canonical_name(symbol.name) for symbol in expr.free_symbols}
    value = H.observable(expr)  # refuses what H does not have
    names = frozenset(name for name in H.names if canonical_name(name) in symbols)
    if not names and "t" not in symbols:
        raise InputError(f"'{text}' holds everywhere or nowhere; name a component of z in it")
    return Surface(text, names, value, tuple(H.observable(condition) for condition in conditions))


def _parts(text: str) -> list[str]:
    """Pieces between the commas that are not inside parentheses."""
    depth, start, parts = 0, 0, []
    for i, character in enumerate(text):
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append(text[start:i])
            start = i + 1
    return [*parts, text[start:]]


def _comparison(part: str) -> tuple[str, str, str]:
    pieces = re.split("([<>=!]+)", part)
    if len(pieces) != 3 or pieces[1] not in ("=", "<", ">"):
        raise InputError(
            f"'{part.strip()}' is no equation and no inequality; write such as x = 0, p_x > 0"
        )
    return pieces[0].strip(), pieces[1], pieces[2].strip()


def sign_changes(values: np.ndarray, direction: float = 0.0) -> tuple[np.ndarray, ...]:
    """Indices (..., i) where values, shape (..., n), change their sign from i to i + 1.

    A zero belongs to the interval that ends there, so that none is counted twice. A direction above
    zero asks for those that rise, below zero for those that fall.
    """
    return np.nonzero(_changes(values[..., :-1], values[..., 1:], direction))


def _changes(before: np.ndarray, after: np.ndarray, direction: float = 0.0) -> np.ndarray:
    rising, falling = (before < 0) & (after >= 0), (before > 0) & (after <= 0)
    if direction > 0:
        return rising
    return falling if direction < 0 else rising | falling


def suspects(values: np.ndarray, slopes: np.ndarray) -> tuple[tuple[np.ndarray, ...], np.ndarray]:
    """Intervals between nodes in which there may be zeros.

    Parameters
    ----------
    values, slopes : numpy.ndarray
        Of the function at the nodes, shape (..., n); of the slopes the sign counts, in the
        direction from node to node.

    Returns
    -------
    where : tuple of numpy.ndarray
        Indices (..., i) of intervals from i to i + 1.
    dips : numpy.ndarray
        Which of them begin and end on one side of zero, shape (k,).
    """
    before, after = np.sign(values[..., :-1]), np.sign(values[..., 1:])
    side = np.where(after == 0, before, after)
    towards, away = np.sign(slopes[..., :-1]) * side < 0, np.sign(slopes[..., 1:]) * side > 0
    dips = (before * side >= 0) & towards & away
    where = np.nonzero(_changes(before, after) | dips)
    return where, dips[where]


def zeros(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray],
    before: np.ndarray,
    after: np.ndarray,
    dips: np.ndarray,
    direction: float = 0.0,
) -> tuple[np.ndarray, np.ndarray]:
    """Zeros in the intervals that :func:`suspects` found.

    Parameters
    ----------
    function : callable
        (share, index) -> values, where share runs from 0 to 1 in the interval of that index.
    before, after : numpy.ndarray
        Values at the ends of the intervals, shape (k,).
    dips : numpy.ndarray
        Which of the intervals begin and end on one side of zero, shape (k,).
    direction : float
        As in :func:`sign_changes`.

    Returns
    -------
    share, index : numpy.ndarray
        Shape (n,), in the order of the intervals and within them.
    """
    whole, dip = np.flatnonzero(~dips), np.flatnonzero(dips)
    side = np.where(after == 0, np.sign(before), np.sign(after))[dip]
    turn, value = _turning_points(function, side, dip)
    low = np.concatenate((np.zeros(len(whole) + len(dip)), turn))
    high = np.concatenate((np.ones(len(whole)), turn, np.ones(len(dip))))
    at_low = np.concatenate((before[whole], before[dip], value))
    at_high = np.concatenate((after[whole], value, after[dip]))
    index = np.concatenate((whole, dip, dip))
    crossed = np.flatnonzero(_changes(at_low, at_high, direction))
    index = index[crossed]
    share = refine(lambda x, k: function(x, index[k]), low[crossed], high[crossed])
    order = np.lexsort((share, index))
    order = order[np.isfinite(share[order])]
    return share[order], index[order]


def _turning_points(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray], side: np.ndarray, index: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Where the function comes closest to zero, or furthest beyond, and its values there."""
    if not len(index):
        return np.empty(0), np.empty(0)

    def height(share: np.ndarray, k: np.ndarray) -> np.ndarray:
        return side[k] * function(share, index[k])

    number, share = np.arange(len(index)), np.full(len(index), _ASIDE)
    with np.errstate(all="ignore"):
        left, right = height(share, number), height(1 - share, number)
        middle = np.where(left <= right, share, 1 - share)
        ends = np.zeros(len(index)), middle, np.ones(len(index))
        found = elementwise.find_minimum(height, ends, args=(number,))
        # Where the turning point is beside an end there is no bracket, and nothing to gain.
        better = found.success & (found.f_x <= np.minimum(left, right))
    return (
        np.where(better, found.x, middle),
        side * np.where(better, found.f_x, np.minimum(left, right)),
    )


def refine(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray
) -> np.ndarray:
    """Zeros to round-off, all at once, of function(x, index) between low and high, shape (n,).

    By Chandrupatla's method, as scipy has it; nan where the sign changes at a pole, or the
    function is not a number on the way.
    """
    if not len(low):
        return np.empty(0)
    index = np.arange(len(low))
    with np.errstate(all="ignore"):
        result = elementwise.find_root(function, (low, high), args=(index,))
        ends = np.abs([function(low, index), function(high, index)])
        # A zero at an end may have the other sign by round-off when it is computed again.
        nearer = np.where(ends[0] < ends[1], low, high)
        found = np.where(result.status == _SAME_SIGNS, nearer, result.x)
        return np.where(np.abs(function(found, index)) <= ends.max(axis=0), found, np.nan)
