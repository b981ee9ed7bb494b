"""Conversion of a Hamiltonian to JSON values and back, and to attributes of tables."""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import sympy

import hamsym
from hamsym.errors import FileError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.formula.parser import MAX_BITS, MAX_EFFORT, MAX_SECONDS, parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.record_fields import convert
from hamsym.support.records import MALFORMED, as_json, from_json
from hamsym.support.validation import plain

_TAKEN = {"H", "confidence", "dt", "hamsym", "method", "reference_error", "span", "steps", "tol"}
_LARGEST_POWER = 1_100  # of two, in a number of the formula; float64 ends at 1,024


@dataclass(frozen=True)
class Formula:
    """A formula as text.

    Its binary fractions are listed separately, since numbers in text are parsed as decimals.
    """

    formula: str
    #: Sign, mantissa, exponent and precision, by name.
    floats: Mapping[str, tuple[int, str, int, int]]


@dataclass(frozen=True)
class HamiltonianData:
    """A Hamiltonian as data."""

    formula: Formula
    q: tuple[str, ...]
    p: tuple[str, ...]
    parameters: Mapping[str, float]
    units: Mapping[str, str]
    forces: Mapping[str, Formula]


def described(H: Hamiltonian) -> dict[str, Any]:
    """Return a Hamiltonian as JSON values.

    Raise FileError if it has a constant that is written as a rounded decimal.
    """
    found: dict[str, Any] = as_json(H)
    return found


def described_formula(expr: sympy.Expr, names_of_state: Collection[str]) -> dict[str, Any]:
    """Return a formula as JSON values, with its binary fractions."""
    found: dict[str, Any] = as_json(_marked(expr, names_of_state))
    return found


def hamiltonian_from(values: dict[str, Any]) -> Hamiltonian:
    """Return the Hamiltonian of the values of :func:`described`.

    Raise ValueError, HamsymError if the values are invalid.
    """
    return from_json(Hamiltonian, values)


def _data_of(H: Hamiltonian) -> HamiltonianData:
    return HamiltonianData(
        _marked(H.expr, H.names),
        tuple(symbol.name for symbol in H.q),
        tuple(symbol.name for symbol in H.p),
        dict(H.parameters),
        dict(H.units),
        {name: _marked(force, H.names) for name, force in H.forces.items()},
    )


def _from_data(data: HamiltonianData) -> Hamiltonian:
    forces = {name: _expression(force) for name, force in data.forces.items()}
    return Hamiltonian(
        _expression(data.formula),
        q=data.q,
        p=data.p,
        parameters=data.parameters,
        units=data.units,
        forces=forces,
    )


def _marked(expr: sympy.Expr, names_of_state: Collection[str] = ()) -> Formula:
    """A formula as text, with its binary fractions beside it."""
    constants = expr.atoms(sympy.NumberSymbol) - {sympy.pi, sympy.E}
    if constants:
        raise FileError(
            f"the constant {min(map(str, constants))} has no text; give its value as a parameter"
        )
    taken = {symbol.name for symbol in expr.free_symbols} | set(names_of_state)
    floats, names = sorted(expr.atoms(sympy.Float), key=str), []
    for position in range(len(floats)):
        name = f"number{position}"
        while name in taken:
            name += "_"
        names.append(name)
    marked = expr.xreplace(dict(zip(floats, map(sympy.Symbol, names), strict=True)))
    return Formula(
        FormulaPrinter()(marked),
        {
            name: (int(number._mpf_[0]), str(number._mpf_[1]), int(number._mpf_[2]), number._prec)
            for name, number in zip(names, floats, strict=True)
        },
    )


def require_formula(path: str | os.PathLike[str], H: Hamiltonian) -> None:
    """Raise FileError unless the formula of H is read back as it is."""
    values = described(H)
    try:
        same = hamiltonian_from(values) == H
    except MALFORMED:
        same = False
    if not same:
        raise FileError(f"'{path}' is not written: H has no formula that is read back as it is")


def attributes_of(H: Hamiltonian, without: Collection[str] = ()) -> dict[str, Any]:
    """Return H, its parameters and units as flat attributes of a table, with the version of hamsym.

    - without: Parameters that are left out, because they vary.

    Examples
    --------
    >>> found = attributes_of(Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 2.0}))
    >>> found["H"], found["k"]
    ('p**2/2 + k*x**2/2', 2.0)
    """
    kept = {name: value for name, value in H.parameters.items() if name not in without}
    return {
        "H": H.formulas,
        "hamsym": hamsym.__version__,
        # Names that a table takes for itself are spelt out.
        **{f"parameter {n}" if n in _TAKEN else n: value for n, value in kept.items()},
        **{f"unit of {name}": unit for name, unit in H.units.items()},
    }


def settings_text(
    H: Hamiltonian,
    z0: np.ndarray,
    span: tuple[float, float],
    seed: int,
    options: Any,
    without: Collection[str],
) -> dict[str, str]:
    """Return all settings that determine a solution, as text with all digits.

    - H, z0, span, seed: Arguments of :func:`hamsym.solve`.
    - options: The dataclass of the method's options.
    - without: Options that are left out.
    """
    values = {
        field.name: repr(plain(getattr(options, field.name)))
        for field in fields(options)
        if field.name not in without
    }
    return values | {
        "H": repr((H.formulas, H.names, sorted(H.parameters.items()))),
        "z0": repr(z0.tolist()),
        "span": repr(span),
        "seed": repr(seed),
    }


def _expression(data: Formula) -> sympy.Expr:
    """The expression of a formula and its binary fractions."""
    expr = parse_expression(data.formula)
    symbols = {symbol.name: symbol for symbol in expr.free_symbols}
    if not data.floats.keys() <= symbols.keys():
        raise ValueError("a number is listed that does not occur in its formula")
    numbers = {symbols[name]: _float(*number) for name, number in data.floats.items()}
    try:
        with call_limit(MAX_EFFORT, MAX_SECONDS):
            return _with_numbers(expr, numbers)
    except CallLimitExceededError:
        raise ValueError("its formula takes too long to evaluate") from None


def _float(sign: int, mantissa: str, exponent: int, precision: int) -> sympy.Float:
    """Return a binary fraction from its parts, whose sizes are limited."""
    plain = mantissa.isascii() and mantissa.isdigit()
    if sign not in (0, 1) or not plain or len(mantissa) > MAX_BITS:
        raise ValueError("a number of its formula is invalid")
    digits = int(mantissa)
    size = digits.bit_length()
    limited = 0 < precision <= MAX_BITS and size <= MAX_BITS
    if not (limited and abs(exponent + size) <= _LARGEST_POWER):
        raise ValueError("a number of its formula is out of range")
    return sympy.Float((sign, digits, exponent, size), precision=precision)


def _with_numbers(expr: sympy.Expr, numbers: Mapping[sympy.Symbol, sympy.Float]) -> sympy.Expr:
    """Return ``expr.xreplace(numbers)``; each constant is checked before it is used further.

    Otherwise a tower as exp(exp(exp(9.5))) would be evaluated, as in the parser.
    """
    if expr in numbers:
        return numbers[expr]
    replaced = [_with_numbers(argument, numbers) for argument in expr.args]
    if all(new is old for new, old in zip(replaced, expr.args, strict=True)):
        return expr
    expr = expr.func(*replaced)
    for part in (expr, *expr.args):
        if not part.free_symbols:
            value = part.evalf(17)
            if (not value.is_Float and not value.is_Rational) or abs(value) > 1e308:
                raise ValueError("a number of its formula is not finite")
    return expr


convert(sympy.Expr, Formula, _marked, _expression)
convert(Hamiltonian, HamiltonianData, _data_of, _from_data, lambda H: {"dim": H.dim})
