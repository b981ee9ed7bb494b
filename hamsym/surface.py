"""Surfaces in phase space, from text like "x = 0, p_x > 0".

Input:  a Hamiltonian and the text of an equation with inequalities.
Output: a :class:`Surface`, whose functions vanish on it or are positive.
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
    """A hypersurface g(z, t) = 0 with inequality constraints c_k(z, t) > 0.

    Attributes
    ----------
    text : str
    names : frozenset of str
        Components of z that occur in the equation.
    value : callable
        (z, t, parameters=None) -> g, shape (...); see :meth:`hamsym.Hamiltonian.observable`.
    conditions : tuple of callable
        (z, t, parameters=None) -> c_k, shape (...).
    """

    text: str
    names: frozenset[str]
    value: Callable[..., np.ndarray] = field(repr=False)
    conditions: tuple[Callable[..., np.ndarray], ...] = field(repr=False)

    def holds(
        self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None = None
    ) -> np.ndarray:
        """Return whether states, shape (n, dim), satisfy the constraints; shape (n,)."""
        found = np.ones(len(z), dtype=bool)
        for condition in self.conditions:
            found &= condition(z, t, parameters) > 0
        return found


def parse_surface(H: Hamiltonian, text: str) -> Surface:
    """Parse an equation and any number of inequalities, separated by commas.

    Raises
    ------
    InputError
        If there is not exactly one equation, or a comparison other than ``=``, ``<`` and ``>``.
    ParseError, VariableError
        If a side is not a formula, or has a symbol that H does not have.

    Examples
    --------
    >>> surface = parse_surface(Hamiltonian("p_x**2 + p_y**2 + x*y"), "x = 1, p_x > p_y")
    >>> surface.value([[1.5, 0, 0, 0]], 0.0)
    array([0.5])
    """
    if not isinstance(text, str):
        raise InputError(
            f"a surface is a str, not {type(text).__name__}; write for example 'x = 0, p_x > 0'"
        )
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
        raise InputError(
            f"'{text}' has {number}; give one equation, x = 0, and inequalities, p_x > 0"
        )
    expr = equations[0]
    symbols = {canonical_name(symbol.name) for symbol in expr.free_symbols}
    value = H.observable(expr)  # raises for symbols that H does not have
    names = frozenset(name for name in H.names if canonical_name(name) in symbols)
    if not names and "t" not in symbols:
        raise InputError(
            f"'{text}' does not depend on the state; use a component of z in the equation"
        )
    return Surface(text, names, value, tuple(H.observable(condition) for condition in conditions))


def _parts(text: str) -> list[str]:
    """Split at the commas that are not inside parentheses."""
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
            f"'{part.strip()}' is not an equation or inequality; write for example x = 0, p_x > 0"
        )
    return pieces[0].strip(), pieces[1], pieces[2].strip()
