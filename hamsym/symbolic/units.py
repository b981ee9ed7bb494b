"""Units of variables and parameters: their consistency, and the unit of the time.

Input:  H and units as text, for example ``{"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}``.
Output: the same units with that of the time, after a check of every term of H.

Numbers are not converted: units that differ by a factor, as m and cm, do not add.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import Any

import sympy

from hamsym.errors import InputError, VariableError
from hamsym.formula.parser import canonical_name, parse_expression
from hamsym.support.validation import checked_mapping
from hamsym.symbolic.checks import name_of

#: Units by the names in texts; the values are names in sympy.physics.units.
_NAMES = {
    name: name
    for name in (
        *("m km cm mm um nm pm angstrom au ly kg g mg s ms us ns ps minute hour day year".split()),
        *("N J eV W Pa bar Hz A C V F S T Wb ohm K mol cd rad deg".split()),
    )
} | {"H": "henry", "u": "amu", "Ω": "ohm", "h": "hour", "d": "day"}
_BASE = {
    "mass": "kg",
    "length": "m",
    "time": "s",
    "current": "A",
    "temperature": "K",
    "amount_of_substance": "mol",
    "luminous_intensity": "cd",
}
_REMEDY = "give units in which all terms agree; numbers are not converted"


#: A unit is a factor times powers of these symbols.
_SYMBOLS = {dimension: sympy.Symbol(name, positive=True) for dimension, name in _BASE.items()}


def _equal(unit: sympy.Expr, other: sympy.Expr) -> bool:
    ratio = unit / other
    return bool(ratio.is_number and abs(sympy.N(ratio, 15) - 1) < 1e-9)


def _text(unit: sympy.Expr) -> str:
    """The unit in base units of SI."""
    factor, powers = unit.as_independent(*_SYMBOLS.values(), as_Add=False)
    above: list[str] = []
    below: list[str] = []
    known = powers.as_powers_dict()
    for symbol in _SYMBOLS.values():
        if power := known.get(symbol, 0):
            size = abs(power)
            shown = str(size) if size.is_Integer else f"({size})"
            (above if power > 0 else below).append(
                symbol.name + ("" if size == 1 else f"**{shown}")
            )
    text = "*".join(above) or "1"
    if below:
        text += "/" + (below[0] if len(below) == 1 else f"({'*'.join(below)})")
    number = float(factor)
    if abs(number - 1) < 1e-9:
        return text
    return f"{number:.12g}" if text == "1" else f"{number:.12g}*{text}"


@functools.lru_cache(maxsize=256)
def _unit_named(name: str) -> sympy.Expr:
    from sympy.physics import units  # slow to import
    from sympy.physics.units.systems.si import SI, dimsys_SI

    quantity = getattr(units, _NAMES[name])
    dimension = dimsys_SI.get_dimensional_dependencies(SI.get_quantity_dimension(quantity))
    powers = {str(getattr(d, "name", d)): power for d, power in dimension.items()}
    # sympy measures masses in grams.
    factor = SI.get_quantity_scale_factor(quantity) / 1000 ** powers.get("mass", 0)
    return sympy.Mul(factor, *(_SYMBOLS[own] ** power for own, power in powers.items()))


def _parsed(name: str, text: object) -> sympy.Expr:
    if not isinstance(text, str):
        raise InputError(f"the unit of '{name}' is a text such as 'kg*m/s', not {text!r}")
    try:
        expr = parse_expression(text)
    except InputError as error:
        raise InputError(f"'{text}' is not a unit of '{name}': {error}") from None
    unknown = sorted(s.name for s in expr.free_symbols if s.name not in _NAMES)
    if unknown:
        raise InputError(
            f"'{unknown[0]}' in the unit of '{name}' is not known; use {', '.join(_NAMES)} or 1"
        )
    unit = sympy.S.One
    for factor in sympy.Mul.make_args(expr):
        base, exponent = factor.as_base_exp()
        if base.is_Symbol and exponent.is_Rational:
            unit *= _unit_named(base.name) ** exponent
        elif factor.is_number and factor.is_positive:
            unit *= factor
        else:
            raise InputError(
                f"'{text}' is not a unit of '{name}'; write products and powers such as kg*m**2/s"
            )
    return unit


def checked_units(
    units: Mapping[Any, str],
    expr: sympy.Expr,
    q: Sequence[sympy.Symbol],
    p: Sequence[sympy.Symbol],
    time: str,
) -> dict[str, str]:
    """Check the units of H by dimension and return them, with that of the time.

    Raise VariableError if a name does not occur in H, or a component has no unit. Raise InputError
    if a unit is not known, terms of different units are added, a function has an argument with a
    unit, or pairs have different units of action.

    - units: Of all components, and of parameters; parameters without one are plain numbers. That of
      the time follows from the others.
    - expr: H.
    - time: Name of the time.

    Examples
    --------
    >>> x, p, m, k = sympy.symbols("x p m k", real=True)
    >>> units = {"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"}
    >>> checked_units(units, p**2/(2*m) + k*x**2/2, [x], [p], "t")
    {'x': 'm', 'p': 'kg*m/s', 'm': 'kg', 'k': 'N/m', 't': 's'}
    """
    symbols = {*expr.free_symbols, *q, *p}
    spelled = {canonical_name(symbol.name): symbol.name for symbol in symbols} | {time: time}
    given: dict[str, str] = {}
    known: dict[str, sympy.Expr] = {}
    for key, text in checked_mapping("units", units, '{"x": "m"}').items():
        name = spelled.get(canonical_name(name_of(key)))
        if name is None:
            listed = ", ".join(sorted(spelled.values()))
            raise VariableError(f"'{name_of(key)}' has a unit, but H has {listed} only")
        known[name] = _parsed(name, text)
        given[name] = text
    missing = [symbol.name for symbol in (*q, *p) if symbol.name not in known]
    if missing:
        raise VariableError(f"'{missing[0]}' has no unit; give those of all components, or 1")
    actions = [known[a.name] * known[b.name] for a, b in zip(q, p, strict=True)]
    for a, b, action in zip(q, p, actions, strict=True):
        if not _equal(action, actions[0]):
            raise InputError(
                f"{a.name}*{b.name} has the unit {_text(action)}, but {q[0].name}*{p[0].name} has "
                f"{_text(actions[0])}; all pairs need one unit of action"
            )
    if time not in known:
        # Terms without the time give the unit of H, and that of the time follows.
        terms = [
            t for t in sympy.Add.make_args(expr) if time not in {s.name for s in t.free_symbols}
        ]
        if not terms:
            raise InputError(f"every term of H contains {time}; give the unit of '{time}' too")
        known[time] = actions[0] * _unit_of(terms[0], known) ** -1
    energy = _unit_of(expr, known)
    follows = actions[0] * energy**-1
    if not _equal(follows, known[time]):
        raise InputError(
            f"'{time}' has the unit {_text(known[time])}, but {q[0].name}*{p[0].name}/H has "
            f"{_text(follows)}; {_REMEDY}"
        )
    return given | {time: given.get(time) or _short(follows)}


def unit_of(expr: sympy.Expr, units: Mapping[str, str]) -> str:
    """Return the unit of a formula, from those of its names; "1" if its terms have different ones.

    Examples
    --------
    >>> x, p, m = sympy.symbols("x p m")
    >>> units = {"x": "m", "p": "kg*m/s", "m": "kg"}
    >>> unit_of(p**2/(2*m), units), unit_of(x + p, units)
    ('kg*m**2/s**2', '1')
    """
    try:
        return _short(_unit_of(expr, {name: _parsed(name, text) for name, text in units.items()}))
    except InputError:
        return "1"


def _short(unit: sympy.Expr) -> str:
    """A unit by its own name if it has one."""
    for name in ("s", "ms", "us", "ns", "ps", "minute", "hour", "day", "year", "m"):
        if _equal(unit, _unit_named(name)):
            return name
    return _text(unit)


def _unit_of(expr: sympy.Expr, known: Mapping[str, sympy.Expr]) -> sympy.Expr:
    if expr.is_Symbol:
        return known.get(expr.name, sympy.S.One)
    if expr.is_number:
        return sympy.S.One
    if expr.is_Mul:
        return sympy.Mul(*(_unit_of(factor, known) for factor in expr.args))
    if expr.is_Pow and expr.exp.is_Rational:
        return _unit_of(expr.base, known) ** expr.exp
    units = [_unit_of(part, known) for part in expr.args]
    if expr.is_Add or isinstance(expr, (sympy.Min, sympy.Max, sympy.atan2)):
        for part, unit in zip(expr.args, units, strict=True):
            if not _equal(unit, units[0]):
                raise InputError(
                    f"'{expr.args[0]}' has the unit {_text(units[0])}, but '{part}' has "
                    f"{_text(unit)}; {_REMEDY}, and parameters without a unit are plain numbers"
                )
        return sympy.S.One if isinstance(expr, sympy.atan2) else units[0]
    if isinstance(expr, sympy.Abs):
        return units[0]
    if isinstance(expr, (sympy.sign, sympy.Heaviside)):
        return sympy.S.One
    for part, unit in zip(expr.args, units, strict=True):
        if not _equal(unit, sympy.S.One):
            raise InputError(
                f"'{part}' in '{expr}' has the unit {_text(unit)}; arguments of functions and "
                "exponents are plain numbers"
            )
    return sympy.S.One
