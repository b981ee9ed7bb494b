"""Checks of the symbols in a Hamiltonian, and their lookup by name.

Symbols of sympy differ by their assumptions, and their names may be any text, including code. After
these checks the names are plain identifiers, each occurs once in any spelling, and every symbol can
be a real number.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.matrices.expressions.matexpr import MatrixElement

from hamsym.errors import InputError, ParameterError, VariableError
from hamsym.formula.parser import canonical_name, check_name
from hamsym.support.suggestions import did_you_mean
from hamsym.support.validation import checked_mapping, require, shown
from hamsym.symbolic.pairing import natural_order


def as_list(symbols: Any, name: str) -> list[Any]:
    """Names or symbols of an argument as a list; a single one becomes a list of one."""
    if isinstance(symbols, (str, sympy.Expr)):
        symbols = [symbols]
    require(isinstance(symbols, Iterable), name, symbols, "a name or a list of names")
    return list(symbols)


def quoted(name: str) -> str:
    """A name in quotes, with escapes for characters that cannot be printed."""
    return f"'{name}'" if name.isprintable() else ascii(name)


def name_of(key: object) -> str:
    """The name of a symbol; other keys as text."""
    return key.name if isinstance(key, sympy.Symbol) else str(key)


def real_symbols(symbols: Iterable[sympy.Symbol]) -> dict[sympy.Symbol, sympy.Symbol]:
    """Real symbols of the same names, for the symbols with other assumptions."""
    pairs = ((symbol, sympy.Symbol(symbol.name, real=True)) for symbol in symbols)
    return {own: real for own, real in pairs if own != real}


def by_name(symbols: Iterable[sympy.Symbol]) -> dict[str, sympy.Symbol]:
    """Index symbols by name; each name is checked and occurs in one spelling only."""
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


def checked_expression(expression: object, kind: str = "a Hamiltonian") -> sympy.Expr:
    """Return a sympy expression that can be a Hamiltonian or a force, or a number as one.

    ``kind`` names the function in messages.

    Raise InputError if it is something else, or is not real and finite. Raise VariableError if it
    contains a variable that is not a plain symbol.
    """
    if isinstance(expression, (int, float)) and not isinstance(expression, bool):
        expression = sympy.Number(expression)
    if not isinstance(expression, sympy.Expr) or getattr(expression, "is_Matrix", False):
        raise InputError(
            f"{kind} must be a str or a sympy expression, not {type(expression).__name__}"
        )
    undefined = expression.atoms(
        AppliedUndef, sympy.Derivative, sympy.Integral, sympy.Indexed, MatrixElement
    )
    if undefined:
        shown = min(str(node) for node in undefined)
        raise VariableError(f"'{shown}' is not a plain symbol; use Symbol('x') for a variable")
    # Without an import of sympy.physics.units, which is slow.
    for node in expression.atoms(sympy.AtomicExpr):
        if type(node).__module__.startswith("sympy.physics.units"):
            raise InputError(
                f"'{node}' is a unit of sympy; write plain numbers and symbols, all in one system "
                'of units, and name the units by units={"x": "m"}'
            )
    bound = expression.atoms(sympy.Symbol) - expression.free_symbols
    if bound:
        raise VariableError(
            f"{min(symbol.name for symbol in bound)!a} is bound inside the expression; "
            "evaluate sums, products and substitutions first with .doit()"
        )
    if expression.has(sympy.I, sympy.zoo, sympy.nan, sympy.oo, -sympy.oo):
        raise InputError(f"'{str(expression)[:40]}' is not real and finite; {kind} is real")
    return expression


def checked_values(
    parameters: Mapping[Any, float] | None, symbols: Mapping[str, sympy.Symbol], of: str = "H"
) -> dict[str, float]:
    """Return parameter values by the names in H (or ``of``), in natural order.

    Raise ParameterError if a name does not occur in H, or a value is not a finite real number.
    """
    spelled = {canonical_name(name): name for name in symbols}
    values = {}
    for key, value in checked_mapping("parameters", parameters, '{"k": 2.0}').items():
        name = spelled.get(canonical_name(name_of(key)))
        if name is None:
            listed = ", ".join(sorted(symbols)) or "no symbols"
            hint = did_you_mean(name_of(key), symbols)
            raise ParameterError(
                f"{quoted(name_of(key))} does not occur in {of}{hint}; it has {listed}"
            )
        try:
            number = float(value)
        except (TypeError, ValueError, OverflowError):
            number = math.nan
        if not math.isfinite(number):
            raise ParameterError(
                f"'{name}' has the value {shown(value)}; give a finite real number"
            )
        values[name] = number
    return dict(sorted(values.items(), key=lambda item: natural_order(item[0])))


def state_symbol(
    item: str | sympy.Symbol, symbols: Mapping[str, sympy.Symbol], real: bool
) -> sympy.Symbol:
    """The symbol of H with a name, or a new symbol if H does not contain it."""
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
    """Raise VariableError of a state with unpaired or repeated components, or with a parameter."""
    if 2 * half != len(state) or not half:
        raise VariableError(
            f"{half} coordinates and {len(state) - half} momenta do not pair; give one p for each q"
        )
    check_roles(state, values, "in q and p")


def check_roles(symbols: Iterable[sympy.Symbol], values: Mapping[str, float], where: str) -> None:
    """Raise VariableError of a symbol that occurs twice, or is a parameter as well."""
    seen: set[str] = set()
    for symbol in symbols:
        name = canonical_name(symbol.name)
        if name in seen:
            raise VariableError(f"'{symbol.name}' occurs twice {where}; name each once")
        if symbol.name in values:
            raise VariableError(
                f"'{symbol.name}' is a variable and a parameter; leave it out of one of them"
            )
        seen.add(name)


def check_steps(expr: sympy.Expr, state: Sequence[sympy.Symbol]) -> None:
    """Refuse functions of the state whose derivatives contain delta distributions."""
    for step in sorted(expr.atoms(sympy.DiracDelta, sympy.Heaviside), key=str):
        if isinstance(step, sympy.DiracDelta) or step.free_symbols & set(state):
            raise InputError(
                f"the derivative of '{step}' is not a regular function; use a smooth "
                "approximation, for example tanh(x/0.01) or exp(-(x/0.01)**2)"
            )
