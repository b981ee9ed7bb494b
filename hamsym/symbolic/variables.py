"""Roles of the symbols in a Hamiltonian: coordinates, momenta, parameters and time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import sympy

from hamsym.errors import VariableError
from hamsym.formula.parser import parse_expression
from hamsym.symbolic.checks import (
    as_list,
    by_name,
    check_state,
    check_steps,
    checked_expression,
    checked_values,
    state_symbol,
)
from hamsym.symbolic.pairing import find_pairs

__all__ = ["TIME", "Variables", "assign_variables"]

#: Name of the time variable.
TIME = "t"


class Variables(NamedTuple):
    """An expression and the roles of its symbols.

    Attributes
    ----------
    expr : sympy.Expr
    q, p, z : tuple of sympy.Symbol
        Coordinates, momenta, and the state (q, p).
    parameters : mapping of str to float
        Values of the parameters that have a value.
    time : sympy.Symbol or None
        The time, if the expression depends on it.
    """

    expr: sympy.Expr
    q: tuple[sympy.Symbol, ...]
    p: tuple[sympy.Symbol, ...]
    z: tuple[sympy.Symbol, ...]
    parameters: Mapping[str, float]
    time: sympy.Symbol | None


def assign_variables(
    expression: str | sympy.Expr,
    q: Sequence[str | sympy.Symbol] | None,
    p: Sequence[str | sympy.Symbol] | None,
    parameters: Mapping[Any, float] | None,
) -> Variables:
    """Check the arguments of a Hamiltonian and assign a role to each symbol.

    Raises
    ------
    ParseError, InputError
        If the expression is not a formula.
    VariableError
        If the pairs are ambiguous, missing, or do not fit the expression.
    ParameterError
        If a value is not a finite real number or belongs to no symbol.
    """
    text = isinstance(expression, str)
    expr = parse_expression(expression) if text else checked_expression(expression)
    symbols = by_name(expr.free_symbols)
    values = checked_values(parameters or {}, symbols)
    if (q is None) != (p is None):
        given, missing = ("q", "p") if p is None else ("p", "q")
        raise VariableError(f"{given} is given without {missing}; give both or neither")
    if q is None or p is None:
        pairs = find_pairs(symbols.keys() - values.keys() - {TIME})
        q, p = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    coordinates, momenta = as_list(q), as_list(p)
    state = tuple(state_symbol(item, symbols, text) for item in (*coordinates, *momenta))
    half = len(coordinates)
    check_state(state, half, values)
    check_steps(expr, state)
    depends_on_time = TIME in symbols.keys() - {symbol.name for symbol in state} - values.keys()
    return Variables(
        expr=expr,
        q=state[:half],
        p=state[half:],
        z=state,
        parameters=MappingProxyType(values),
        time=symbols[TIME] if depends_on_time else None,
    )
