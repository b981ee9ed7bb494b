"""Conversion of a Hamiltonian to JSON values and back, and files of results of one."""

from __future__ import annotations

import os
from collections.abc import Callable, Collection, Mapping
from dataclasses import fields
from typing import Any, TypeVar

import numpy as np
import sympy

import hamsym
from hamsym.errors import FileError, HamsymError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.formula.parser import MAX_BITS, MAX_EFFORT, MAX_SECONDS, parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.checked_data import checked_list, checked_mapping, checked_type, checked_values
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors
from hamsym.support.validation import plain

R = TypeVar("R")

_TAKEN = {"H", "confidence", "dt", "hamsym", "method", "reference_error", "span", "steps", "tol"}
_LARGEST_POWER = 1_100  # of two, in a number of the formula; float64 ends at 1,024
_FORMULA = {"formula": "str", "floats": "Mapping[str, Any]"}
_TYPES = _FORMULA | {
    **dict.fromkeys(("q", "p"), "tuple[str, ...]"),
    "parameters": "Mapping[str, float]",
}
#: Errors that parts of the package raise for values that are not those of a solution.
MALFORMED = (
    *(ArithmeticError, AssertionError, AttributeError, HamsymError, LookupError, RuntimeError),
    *(TypeError, ValueError),
)


def described(H: Hamiltonian) -> dict[str, Any]:
    """Return a Hamiltonian as JSON values.

    The formula is text; its binary fractions are listed separately, since numbers in text
    are parsed as decimals.

    Raise FileError if it has a constant that is written as a rounded decimal.
    """
    values = {
        **_marked(H.expr, H.names),
        "q": [symbol.name for symbol in H.q],
        "p": [symbol.name for symbol in H.p],
        "parameters": dict(H.parameters),
    }
    if H.units:
        values["units"] = dict(H.units)
    if H.forces:
        values["forces"] = {name: _marked(force, H.names) for name, force in H.forces.items()}
    return values


def _marked(expr: sympy.Expr, names_of_state: Collection[str]) -> dict[str, Any]:
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
    return {
        "formula": FormulaPrinter()(marked),
        "floats": {
            name: [int(number._mpf_[0]), str(number._mpf_[1]), int(number._mpf_[2]), number._prec]
            for name, number in zip(names, floats, strict=True)
        },
    }


def write_result(
    path: str | os.PathLike[str],
    kind: str,
    H: Hamiltonian,
    check: Callable[[], None],
    parts: Callable[[], tuple[Mapping[str, np.ndarray], dict[str, Any]]],
) -> None:
    """Write the arrays and values of a result to a file of its kind, if it passes its check.

    Raise FileError if it does not, H has no formula that is read back as it is, or the file cannot
    be written.
    """
    try:
        check()
    except MALFORMED as error:
        verb = "are" if kind.endswith("s") else "is"
        raise FileError(
            f"'{path}' was not written, because the {kind} {verb} not valid: {one_line(error)}"
        ) from None
    require_formula(path, H)
    write_tensors(path, kind, *parts())


def read_result(
    path: str | os.PathLike[str], kind: str, assembled: Callable[[dict[str, Any], Any], R]
) -> R:
    """Return what a function makes of the arrays and values of a file of this kind.

    Raise FileError if the file cannot be read, is damaged or not valid.
    """
    arrays, values = read_tensors(path, kind)
    try:
        return assembled(arrays, values)
    except MALFORMED as error:
        noun = kind if kind.endswith("s") else f"a {kind}"
        raise FileError(f"'{path}' is not a valid file of {noun}: {one_line(error)}") from None


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


def hamiltonian_from(values: dict[str, Any]) -> Hamiltonian:
    """Return the Hamiltonian of the values of :func:`described`.

    Raise ValueError, HamsymError if the values are invalid.
    """
    optional = {"forces", "units"} & values.keys()  # absent without any
    types = _TYPES | dict.fromkeys(optional, "Mapping[str, Any]")
    given = {"forces": {}, "units": {}} | checked_values("H", values, types)
    forces = {
        name: _expression(checked_values("force", checked_mapping("force", force), _FORMULA))
        for name, force in given["forces"].items()
    }
    about = {name: given[name] for name in ("q", "p", "parameters", "units")}
    return Hamiltonian(_expression(given), forces=forces, **about)


def _expression(values: Mapping[str, Any]) -> sympy.Expr:
    """The expression of a formula and its binary fractions."""
    floats = values["floats"]
    expr = parse_expression(values["formula"])
    symbols = {symbol.name: symbol for symbol in expr.free_symbols}
    if not floats.keys() <= symbols.keys():
        raise ValueError("a number is listed that does not occur in its formula")
    numbers = {
        symbols[name]: _float(*checked_list(name, number, 4)) for name, number in floats.items()
    }
    try:
        with call_limit(MAX_EFFORT, MAX_SECONDS):
            return _with_numbers(expr, numbers)
    except CallLimitExceededError:
        raise ValueError("its formula takes too long to evaluate") from None


def _float(sign: Any, mantissa: Any, exponent: Any, precision: Any) -> sympy.Float:
    """Return a binary fraction from its parts, whose sizes are limited."""
    plain = isinstance(mantissa, str) and mantissa.isascii() and mantissa.isdigit()
    if checked_type("sign", sign, "int") not in (0, 1) or not plain or len(mantissa) > MAX_BITS:
        raise ValueError("a number of its formula is invalid")
    digits = int(mantissa)
    size = digits.bit_length()
    if not (
        0 < checked_type("precision", precision, "int") <= MAX_BITS
        and size <= MAX_BITS
        and abs(checked_type("exponent", exponent, "int") + size) <= _LARGEST_POWER
    ):
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
