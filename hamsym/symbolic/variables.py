"""Roles of the symbols in a Hamiltonian and its forces: coordinates, momenta, parameters, time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import sympy

from hamsym.errors import VariableError
from hamsym.formula.parser import Written, canonical_name, parse_expression, parse_written
from hamsym.support.validation import checked_mapping
from hamsym.symbolic.checks import (
    as_list,
    by_name,
    check_state,
    check_steps,
    checked_expression,
    checked_values,
    name_of,
    quoted,
    state_symbol,
)
from hamsym.symbolic.equations import free_symbols
from hamsym.symbolic.pairing import find_pairs
from hamsym.symbolic.switching import with_steps

#: Name of the time variable.
TIME = "t"

_TWICE = "the force of '{}' is given twice; give their sum once"


class Variables(NamedTuple):
    """An expression and the roles of its symbols."""

    expr: sympy.Expr
    #: q, p, z: Coordinates, momenta, and the state (q, p).
    q: tuple[sympy.Symbol, ...]
    p: tuple[sympy.Symbol, ...]
    z: tuple[sympy.Symbol, ...]
    #: Values of the parameters that have a value.
    parameters: Mapping[str, float]
    #: The time, if the expression or a force depends on it.
    time: sympy.Symbol | None
    #: Forces that do not vanish, by the names of their momenta.
    forces: Mapping[str, sympy.Expr]
    #: Terms of sums in H in the order of its text, by the sum.
    written: Written


def assign_variables(
    expression: str | sympy.Expr,
    q: Sequence[str | sympy.Symbol] | None,
    p: Sequence[str | sympy.Symbol] | None,
    parameters: Mapping[Any, float] | None,
    forces: Mapping[Any, str | sympy.Expr] | None = None,
) -> Variables:
    """Check the arguments of a Hamiltonian and assign a role to each symbol.

    Raise the errors of :class:`hamsym.Hamiltonian`.
    """
    text = isinstance(expression, str)
    expr, written = parse_written(expression) if text else (checked_expression(expression), {})
    expr = with_steps(expr)
    symbols = by_name(expr.free_symbols)
    named = _named_forces(forces, symbols)
    own = {*symbols, *named}
    symbols = by_name({*symbols.values(), *free_symbols(named.values())})
    values = checked_values(parameters, symbols)
    if (q is None) != (p is None):
        given, missing = ("q", "p") if p is None else ("p", "q")
        raise VariableError(f"{given} is given without {missing}; give both or neither")
    if q is None or p is None:
        pairs = _pairs(own - values.keys() - {TIME}, symbols.keys() - values.keys() - {TIME})
        q, p = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    coordinates, momenta = as_list(q, "q"), as_list(p, "p")
    state = tuple(state_symbol(item, symbols, text) for item in (*coordinates, *momenta))
    half = len(coordinates)
    check_state(state, half, values)
    acting = _by_momentum(named, state, half)
    for formula in (expr, *acting.values()):
        check_steps(formula, state)
    depends_on_time = TIME in symbols.keys() - {symbol.name for symbol in state} - values.keys()
    return Variables(
        expr=expr,
        q=state[:half],
        p=state[half:],
        z=state,
        parameters=MappingProxyType(values),
        time=symbols[TIME] if depends_on_time else None,
        forces=MappingProxyType(acting),
        written=written,
    )


def _named_forces(
    forces: Mapping[Any, Any] | None, symbols: Mapping[str, sympy.Symbol]
) -> dict[str, sympy.Expr]:
    """Forces as expressions by the given names, in the symbols of H where H has their names."""
    known = {canonical_name(name): symbol for name, symbol in symbols.items()}
    found: dict[str, sympy.Expr] = {}
    for key, given in checked_mapping("forces", forces, '{"p": "-c*p"}').items():
        if name_of(key) in found:
            raise VariableError(_TWICE.format(name_of(key)))
        if isinstance(given, str):
            force = parse_expression(given)
        else:
            force = checked_expression(given, "a force")
        replaced = {}
        for name, symbol in by_name(force.free_symbols).items():
            replaced[symbol] = known.setdefault(canonical_name(name), symbol)
        found[name_of(key)] = force.xreplace(replaced)
    return found


def _pairs(names: set[str], every: set[str]) -> list[tuple[str, str]]:
    """Pairs among the names in H; a coordinate without a pair there may occur in the forces."""
    try:
        return find_pairs(names)
    except VariableError:
        if names == every:
            raise
    return find_pairs(every | names)


def _by_momentum(
    named: Mapping[str, sympy.Expr], state: Sequence[sympy.Symbol], half: int
) -> dict[str, sympy.Expr]:
    """Forces that do not vanish, by the names of their momenta and in the order of the state.

    Raise VariableError if a name is not that of a momentum, or occurs twice.
    """
    momenta = {canonical_name(symbol.name): symbol.name for symbol in state[half:]}
    coordinates = {canonical_name(symbol.name) for symbol in state[:half]}
    found: dict[str, sympy.Expr] = {}
    for given, force in named.items():
        name = momenta.get(canonical_name(given))
        if name is None:
            is_coordinate = canonical_name(given) in coordinates
            kind = "a coordinate" if is_coordinate else "no momentum of H"
            raise VariableError(
                f"{quoted(given)} is {kind}, and a force changes a momentum; give forces of "
                f"{', '.join(momenta.values())}"
            )
        if name in found:
            raise VariableError(_TWICE.format(name))
        found[name] = force
    return {name: found[name] for name in momenta.values() if found.get(name, 0) != 0}
