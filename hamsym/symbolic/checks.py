"""The symbols of a Hamiltonian: checked before anything is derived, and matched by name.

Sympy's symbols differ by their assumptions, and their names may be anything, code included. What
passes here has plain names, each once in every spelling, and can stand for real numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy
from sympy.core.function import AppliedUndef

from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.formula.parser import canonical_name, check_name
from hamsym.symbolic.pairing import natural_order

__all__ = [
    "as_list",
    "by_name",
    "check_state",
    "checked_expression",
    "checked_values",
    "name_of",
    "real_symbols",
    "state_symbol",
]


def as_list(symbols: Sequence[str | sympy.Symbol]) -> list[str | sympy.Symbol]:
    if isinstance(symbols, (str, sympy.Symbol)):
        return [symbols]
    return list(symbols)


def _quoted(name: str) -> str:
    """A name for a one-line message, whatever is in it."""
    return f"'{name}'" if name.isprintable() else ascii(name)


def name_of(key: object) -> str:
    return key.name if isinstance(key, sympy.Symbol) else str(key)


def real_symbols(symbols: Iterable[sympy.Symbol]) -> dict[sympy.Symbol, sympy.Symbol]:
    pairs = ((symbol, sympy.Symbol(symbol.name, real=True)) for symbol in symbols)
    return {own: real for own, real in pairs if own != real}


def by_name(symbols: Iterable[sympy.Symbol]) -> dict[str, sympy.Symbol]:
    """Symbols by name, each name checked and unique in every spelling."""
    found: dict[str, sympy.Symbol] = {}
    spelled: dict[str, str] = {}
    for symbol in sorted(symbols, key=str):
        check_name(symbol.name)
        if symbol.name in found:
            raise VariableError(
                f"'{symbol.name}' occurs twice with different assumptions; use one symbol"
            )
        other = spelled.setdefault(canonical_name(symbol.name), symbol.name)
        if other != symbol.name:
            raise VariableError(f"'{symbol.name}' is '{other}' in another spelling; use one")
        if symbol.is_extended_real is False or symbol.is_finite is False:
            raise VariableError(f"'{symbol.name}' is declared not to be real; use a real symbol")
        found[symbol.name] = symbol
    return found


def checked_expression(expression: object) -> sympy.Expr:
    if isinstance(expression, (int, float)) and not isinstance(expression, bool):
        expression = sympy.Number(expression)
    if not isinstance(expression, sympy.Expr) or getattr(expression, "is_Matrix", False):
        raise InputError(
            f"a Hamiltonian is a str or a sympy expression, not {type(expression).__name__}"
        )
    undefined = expression.atoms(AppliedUndef, sympy.Derivative, sympy.Integral, sympy.Indexed)
    if undefined:
        shown = min(str(node) for node in undefined)
        raise VariableError(f"'{shown}' is not a plain symbol; use Symbol('x') for a variable")
    bound = expression.atoms(sympy.Symbol) - expression.free_symbols
    if bound:
        raise VariableError(
            f"{min(symbol.name for symbol in bound)!a} is bound inside the expression; "
            "do sums, products and substitutions first, with .doit()"
        )
    if expression.has(sympy.I, sympy.zoo, sympy.nan, sympy.oo, -sympy.oo):
        raise InputError(f"'{str(expression)[:40]}' is not real and finite; a Hamiltonian is real")
    return expression


def checked_values(
    parameters: Mapping[Any, float], symbols: Mapping[str, sympy.Symbol]
) -> dict[str, float]:
    spelled = {canonical_name(name): name for name in symbols}
    values = {}
    for key, value in parameters.items():
        name = spelled.get(canonical_name(name_of(key)))
        if name is None:
            listed = ", ".join(sorted(symbols)) or "no symbols"
            raise ParameterError(f"{_quoted(name_of(key))} does not occur in H; it has {listed}")
        try:
            number = float(value)
        except (TypeError, ValueError):
            number = math.nan
        if not math.isfinite(number):
            raise ParameterError(f"'{name}' has the value {value!r}; give a finite real number")
        values[name] = number
    return dict(sorted(values.items(), key=lambda item: natural_order(item[0])))


def state_symbol(
    item: str | sympy.Symbol, symbols: Mapping[str, sympy.Symbol], real: bool
) -> sympy.Symbol:
    """The symbol of H that is meant, or a new one for a coordinate that H does not contain."""
    if not isinstance(item, (str, sympy.Symbol)):
        raise VariableError(f"'{item}' is not a name or a symbol; give q and p as names")
    name = name_of(item)
    check_name(name)
    spelled = {canonical_name(known): symbol for known, symbol in symbols.items()}
    if canonical_name(name) in spelled:
        return spelled[canonical_name(name)]
    if isinstance(item, sympy.Symbol) and not real:
        return item
    return sympy.Symbol(name, real=True)


def check_state(state: Sequence[sympy.Symbol], half: int, values: Mapping[str, float]) -> None:
    if 2 * half != len(state) or not half:
        raise VariableError(
            f"{half} coordinates and {len(state) - half} momenta do not pair; give one p for each q"
        )
    names = [canonical_name(symbol.name) for symbol in state]
    for i, symbol in enumerate(state):
        if names[i] in names[:i]:
            raise VariableError(f"'{symbol.name}' occurs twice in q and p; name each once")
        if symbol.name in values:
            raise VariableError(
                f"'{symbol.name}' is a variable and a parameter; leave it out of one of them"
            )


def check_steps(expr: sympy.Expr, state: Sequence[sympy.Symbol]) -> None:
    """Refuse steps of the state that sympy differentiates to infinite peaks."""
    for step in sorted(expr.atoms(sympy.DiracDelta, sympy.Heaviside), key=str):
        if isinstance(step, sympy.DiracDelta) or step.free_symbols & set(state):
            raise InputError(
                f"'{step}' has no force that numbers could show; write a smooth step or peak, such "
                "as tanh(x/0.01) or exp(-(x/0.01)**2)"
            )
