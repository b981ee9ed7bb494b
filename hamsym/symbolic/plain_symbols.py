"""Plain symbols in place of elements of arrays and functions of time.

Input:  an expression in ``x[0]`` of an IndexedBase or a MatrixSymbol, or in ``x(t)``.
Output: the expression in symbols x0, or x.
"""

from __future__ import annotations

from typing import Any

import sympy
from sympy.core.function import AppliedUndef
from sympy.matrices.expressions.matexpr import MatrixElement

from hamsym.errors import InputError, VariableError

_TIME = "t"


def plain_name(symbol: object) -> str | None:
    """The name of the plain symbol for an element or a function of time; None for other things.

    Elements are counted as sympy counts them: ``x[0]`` is ``x0``, and ``X[1, 2]`` is ``X1_2``;
    those of a matrix with one column or row are counted by the other index.

    Examples
    --------
    >>> plain_name(sympy.IndexedBase("x")[3]), plain_name(sympy.MatrixSymbol("p", 3, 1)[2, 0])
    ('x3', 'p2')
    >>> plain_name(sympy.Function("theta")(sympy.Symbol("t")))
    'theta'
    """
    if isinstance(symbol, AppliedUndef):
        return str(symbol.func.__name__)
    if isinstance(symbol, sympy.Indexed):
        name, indices = symbol.base.label, symbol.indices
    elif isinstance(symbol, MatrixElement):
        name, indices = symbol.parent, symbol.indices
        rows, columns = symbol.parent.shape
        if columns == 1:
            indices = indices[:1]
        elif rows == 1:
            indices = indices[1:]
    else:
        return None
    if not isinstance(name, (sympy.Symbol, sympy.MatrixSymbol)):
        raise VariableError(
            f"'{symbol}' is an element of an expression; evaluate it with .as_explicit() or .doit()"
        )
    for index in indices:
        if not (index.is_Integer and index >= 0):
            raise VariableError(
                f"'{symbol}' has the index {index}, which is not a number from 0; evaluate sums "
                "with .doit(), and substitute numbers"
            )
    return f"{name.name}{'_'.join(map(str, indices))}"


def with_plain_symbols(expression: Any) -> Any:
    """Replace elements and functions of time by symbols; other things are returned unchanged.

    Raise VariableError if an index is not a number, a function depends on something else than one
    time, or a name is taken. Raise InputError if the expression contains a unit.

    Examples
    --------
    >>> x, p = sympy.IndexedBase("x"), sympy.IndexedBase("p")
    >>> with_plain_symbols(p[0]**2/2 + x[0]**4)
    p0**2/2 + x0**4
    """
    if not isinstance(expression, sympy.Expr):
        return expression
    _refuse_units(expression)
    slopes = expression.atoms(sympy.Derivative)
    if slopes:
        raise VariableError(
            f"'{min(map(str, slopes))}' is a velocity; write H in momenta, or make it of a "
            "Lagrangian by Hamiltonian.from_lagrangian(L)"
        )
    if expression.atoms(sympy.Sum, sympy.Product, sympy.Integral):
        return expression  # refused later, with the remedy .doit()
    functions = expression.atoms(AppliedUndef)
    parts = functions | expression.atoms(sympy.Indexed, MatrixElement)
    if not parts:
        return expression
    times = {argument for function in functions for argument in function.args}
    if any(len(function.args) != 1 for function in functions) or len(times) > 1:
        shown = ", ".join(sorted(map(str, functions)))
        raise VariableError(f"{shown} are not functions of one time; use Symbol('x') for variables")
    new: dict[sympy.Basic, sympy.Symbol] = {}
    for time in times:
        if not time.is_Symbol:
            raise VariableError(
                f"'{min(map(str, functions))}' is not a plain symbol or a function of time; use "
                "Symbol('x') for a variable"
            )
        if time.name != _TIME:
            new[time] = sympy.Symbol(_TIME, real=True)
    arrays = {part.base.label for part in parts if isinstance(part, sympy.Indexed)}
    arrays |= {part.base for part in parts if isinstance(part, sympy.Indexed)}
    used = {symbol.name for symbol in expression.free_symbols - arrays if symbol.is_Symbol}
    for part in sorted(parts, key=str):
        name = plain_name(part)
        assert name is not None
        if name in used:
            raise VariableError(f"'{part}' becomes '{name}', which is in H too; rename one of them")
        used.add(name)
        new[part] = sympy.Symbol(name, real=True)
    for part in parts:  # before the time inside them
        expression = expression.xreplace({part: new[part]})
    return expression.xreplace(new)


def _refuse_units(expression: sympy.Expr) -> None:
    # Without an import of sympy.physics.units, which is slow.
    for node in sympy.preorder_traversal(expression):
        if (type(node).__module__ or "").startswith("sympy.physics.units"):
            raise InputError(
                f"'{node}' is a unit of sympy; write plain numbers and symbols, all in one system "
                'of units, and name the units by units={"x": "m"}'
            )
