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

from hamsym.errors import InputError
from hamsym.formula.parser import canonical_name, parse_expression
from hamsym.hamiltonian import Hamiltonian

__all__ = ["Surface", "parse_surface"]


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
