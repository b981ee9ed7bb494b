"""Lagrangians: coordinates and velocities among the symbols, momenta and the Hamiltonian.

Input:  a Lagrangian L(q, v, t), as text or as a sympy expression.
Output: its momenta and H(q, p, t).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import sympy
from sympy.core.function import AppliedUndef

from hamsym.errors import VariableError
from hamsym.formula.notation import Notation
from hamsym.formula.parser import canonical_name, parse_written
from hamsym.symbolic import derivatives
from hamsym.symbolic.checks import (
    as_list,
    by_name,
    check_roles,
    checked_expression,
    checked_values,
    real_symbols,
    state_symbol,
)
from hamsym.symbolic.exact import fraction
from hamsym.symbolic.legendre import legendre_transform
from hamsym.symbolic.pairing import conventional, natural_order
from hamsym.symbolic.variables import TIME

_TIME = sympy.Symbol(TIME, real=True)
_REMEDY = "name them with q=[...] and velocities=[...], or give parameters their values"


class Lagrangian(NamedTuple):
    """A Lagrangian with the roles of its symbols, and its Legendre transform."""

    #: L, in coordinates, velocities, parameters and the time.
    expr: sympy.Expr
    #: q, velocities, p: Of one length, in one order.
    q: tuple[sympy.Symbol, ...]
    velocities: tuple[sympy.Symbol, ...]
    p: tuple[sympy.Symbol, ...]
    #: p_i = dL/dv_i.
    momenta: tuple[sympy.Expr, ...]
    #: H in q and p.
    hamiltonian: sympy.Expr
    #: Values of the parameters that H contains.
    parameters: dict[str, float]
    #: Order of the terms of sums.
    notation: Notation


# -- names -----------------------------------------------------------------------------------------


def find_velocities(names: Sequence[str]) -> list[tuple[str, str]]:
    """Pair every velocity with its coordinate by name.

    ``xdot`` and ``x_dot`` belong to ``x``, also where ``x`` itself does not occur; ``xdot1``,
    ``x1dot`` and ``x_dot_1`` belong to ``x1``. ``dx`` and ``d_x`` belong to ``x`` if ``x`` occurs
    or is a usual name of a coordinate, with or without an index. Greek letters and their names are
    equivalent.

    Raise VariableError if there is no velocity, or a coordinate has two.

    - names: The symbols of a Lagrangian without its parameters and without the time.
    - returns: Pairs (coordinate, velocity) in natural order of the coordinate.

    Examples
    --------
    >>> find_velocities(["m", "xdot", "dtheta", "theta", "delta"])
    [('theta', 'dtheta'), ('x', 'xdot')]
    """
    spelled = {canonical_name(name): name for name in names}
    plain: dict[str, list[str]] = {}
    for name in spelled:
        plain.setdefault(_joined(name), []).append(name)
    found: dict[str, str] = {}  # coordinate -> velocity, as spelled
    for name in sorted(spelled.values(), key=natural_order):
        dotted = re.fullmatch(r"(.+?)_?dot(_?\d+)?", name)
        prefixed = re.fullmatch(r"d_?(.+)", name)
        if dotted:
            coordinate = dotted[1] + (dotted[2] or "")
        elif prefixed and prefixed[1] != TIME:
            coordinate = prefixed[1]
        else:
            continue
        if dotted and coordinate.endswith("d") and coordinate not in spelled.values():
            raise VariableError(
                f"'{name}' looks like a second derivative; a Lagrangian contains coordinates and "
                f"velocities (if it is the velocity of {coordinate}, {_REMEDY})"
            )
        candidates = plain.get(_joined(coordinate), [])
        if len(candidates) > 1:
            listed = " or ".join(sorted(spelled[other] for other in candidates))
            raise VariableError(f"'{name}' could be the velocity of {listed}; {_REMEDY}")
        if candidates:
            coordinate = spelled[candidates[0]]
        elif not dotted and not conventional(coordinate):
            continue
        for other, velocity in found.items():
            if _joined(other) == _joined(coordinate):
                raise VariableError(
                    f"'{velocity}' and '{name}' both look like the velocity of {other}; {_REMEDY}"
                )
        found[coordinate] = name
    if not found:
        listed = ", ".join(sorted(spelled.values(), key=natural_order)) or "no names"
        raise VariableError(
            f"no velocity such as xdot, x_dot or dx among {listed}; write the time derivative of x "
            "as xdot, or name q=[...] and velocities=[...]"
        )
    return sorted(found.items(), key=lambda pair: natural_order(pair[0]))


def _joined(name: str) -> str:
    """A name in its canonical spelling, without underscores."""
    return canonical_name(name).replace("_", "")


def _plain_symbols(expression: Any) -> tuple[Any, list[str]]:
    """Replace x(t) and its derivative by the symbols x and xdot; return the names x too."""
    if not isinstance(expression, sympy.Expr):
        return expression, []
    slopes, functions = expression.atoms(sympy.Derivative), expression.atoms(AppliedUndef)
    if not functions:
        return expression, []
    times = {function.args for function in functions}
    if len(times) > 1 or len(times := set(*times)) > 1 or not min(times, key=str).is_Symbol:
        shown = ", ".join(sorted(map(str, functions)))
        raise VariableError(f"{shown} are not functions of one time; write x(t) for coordinates")
    time = times.pop()
    for slope in sorted(slopes, key=str):
        if slope.expr not in functions or slope.variable_count != ((time, 1),):
            raise VariableError(
                f"'{slope}' is not a velocity; a Lagrangian contains coordinates and their first "
                f"derivatives in {time}"
            )
    names = sorted((function.func.__name__ for function in functions), key=natural_order)
    used = {symbol.name for symbol in expression.free_symbols - {time}}
    new: dict[sympy.Basic, sympy.Symbol] = {}
    for function in functions:
        name = function.func.__name__
        symbols = {function: name, sympy.Derivative(function, time): f"{name}dot"}
        for node, text in symbols.items():
            if text in used:
                raise VariableError(f"'{text}' and '{node}' are both in L; rename one of them")
            new[node] = sympy.Symbol(text, real=True)
    new |= {} if time.name == TIME else {time: sympy.Symbol(TIME, real=True)}
    # Velocities first: they contain the coordinates.
    for node in (*sorted(slopes, key=str), *functions, time):
        expression = expression.xreplace({node: new.get(node, node)})
    return expression, names


def read_lagrangian(
    expression: str | sympy.Expr,
    q: Sequence[str | sympy.Symbol] | None = None,
    velocities: Sequence[str | sympy.Symbol] | None = None,
    p: Sequence[str | sympy.Symbol] | None = None,
    parameters: Mapping[Any, float] | None = None,
) -> Lagrangian:
    """Assign a role to each symbol of a Lagrangian and compute its Legendre transform.

    Raise the errors of :meth:`hamsym.Hamiltonian.from_lagrangian`.

    Examples
    --------
    >>> L = read_lagrangian("m*xdot**2/2 - k*x**2/2")
    >>> L.p, L.momenta, L.hamiltonian
    ((p_x,), (m*xdot,), k*x**2/2 + p_x**2/(2*m))
    """
    text = isinstance(expression, str)
    own, functions = _plain_symbols(expression)
    expr, written = parse_written(own) if text else (checked_expression(own, "a Lagrangian"), {})
    symbols = by_name(expr.free_symbols)
    values = checked_values(parameters, symbols, "L")
    if (q is None) != (velocities is None) and not functions:
        given, missing = ("q", "velocities") if velocities is None else ("velocities", "q")
        raise VariableError(f"{given} is given without {missing}; give both or neither")
    if functions:
        if q is not None:
            functions = _ordered_as(as_list(q, "q"), functions)
        q, velocities = functions, [f"{name}dot" for name in functions]
    elif q is None or velocities is None:
        pairs = find_velocities(sorted(symbols.keys() - values.keys() - {TIME}))
        q, velocities = [pair[0] for pair in pairs], [pair[1] for pair in pairs]
    real = text or bool(functions)
    coordinates = [state_symbol(item, symbols, real) for item in as_list(q, "q")]
    rates = [state_symbol(item, symbols, real) for item in as_list(velocities, "velocities")]
    if p is None:
        momenta = [state_symbol(f"p_{symbol.name}", {}, True) for symbol in coordinates]
    else:
        momenta = [state_symbol(item, {}, real) for item in as_list(p, "p")]
    _check_roles(coordinates, rates, momenta, symbols, values)
    absent = [symbol.name for symbol in rates if symbol not in expr.free_symbols]
    if absent:
        where = coordinates[[symbol.name for symbol in rates].index(absent[0])].name
        raise VariableError(
            f"the velocity '{absent[0]}' does not occur in L; leave {where} out of the "
            "coordinates, or add its kinetic energy"
        )
    forward = real_symbols({*expr.free_symbols, *coordinates, *rates, *momenta})
    exact = _with_fractions(expr.xreplace(forward))
    slots = [forward.get(symbol, symbol) for symbol in rates]
    duals = [forward.get(symbol, symbol) for symbol in momenta]
    numbers = {sympy.Symbol(name, real=True): value for name, value in values.items()}
    state = {forward.get(symbol, symbol) for symbol in coordinates} | {_TIME}
    found = legendre_transform(exact, slots, duals, state, numbers)
    back = {new: old for old, new in forward.items()}
    first = derivatives.gradient(exact, slots, derivatives.Effort(exact))
    kept = {symbol.name for symbol in found.free_symbols}
    return Lagrangian(
        expr,
        tuple(coordinates),
        tuple(rates),
        tuple(momenta),
        tuple(slope.xreplace(back) for slope in first),
        found.xreplace(back),
        {name: value for name, value in values.items() if name in kept},
        Notation(written),
    )


def _ordered_as(given: Sequence[str | sympy.Symbol], names: Sequence[str]) -> list[str]:
    """The names of the functions in the order of q."""
    wanted = [getattr(item, "name", None) or str(getattr(item, "func", item)) for item in given]
    if sorted(wanted) != sorted(names):
        raise VariableError(
            f"q={list(map(str, given))} does not list the functions of time in L, "
            f"{', '.join(names)}; name each once"
        )
    return wanted


def _check_roles(
    coordinates: Sequence[sympy.Symbol],
    rates: Sequence[sympy.Symbol],
    momenta: Sequence[sympy.Symbol],
    symbols: Mapping[str, sympy.Symbol],
    values: Mapping[str, float],
) -> None:
    counts = (len(coordinates), len(rates), len(momenta))
    if len(set(counts)) > 1 or not coordinates:
        raise VariableError(
            "{} coordinates, {} velocities and {} momenta do not pair; give one of each kind for "
            "each degree of freedom".format(*counts)
        )
    every = (*coordinates, *rates, *momenta)
    check_roles(every, values, "among coordinates, velocities and momenta")
    taken = {canonical_name(name): name for name in symbols}
    for symbol in momenta:
        if canonical_name(symbol.name) in taken:
            raise VariableError(
                f"'{symbol.name}' occurs in L and would be a momentum; rename it, or name the "
                "momenta with p=[...]"
            )


def _with_fractions(expr: sympy.Expr) -> sympy.Expr:
    """Replace floating-point numbers by the decimals that they print as: 0.1 is 1/10."""

    def decimal(number: sympy.Float) -> sympy.Rational:
        value = float(number)
        return sympy.Rational(repr(value)) if value == number else fraction(number)

    numbers = {number: decimal(number) for number in expr.atoms(sympy.Float)}
    return expr.xreplace(numbers) if numbers else expr
