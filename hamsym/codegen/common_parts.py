"""Templates that terms of a sum have in common."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import sympy


@dataclass(frozen=True)
class Alike:
    """Terms of a sum that are one expression, the template, in different variables."""

    #: The common expression, in the symbols ``places``.
    template: sympy.Expr
    places: list[sympy.Symbol]
    #: Variables of each term, in the order of ``places``.
    rows: list[tuple[sympy.Symbol, ...]]
    #: Factor of the template in each term.
    factors: list[sympy.Expr]


def alike_terms(
    expr: sympy.Expr, variables: Iterable[sympy.Symbol], fewest: int = 4
) -> tuple[list[Alike], sympy.Expr]:
    """Group terms that differ only in variables and factors; return groups and the rest.

    Examples
    --------
    >>> x, y, z = sympy.symbols("x y z")
    >>> groups, rest = alike_terms(sympy.exp(x) + 2*sympy.exp(y) + z, (x, y, z), fewest=2)
    >>> sorted(zip(groups[0].rows, groups[0].factors), key=str), rest
    ([((x,), 1), ((y,), 2)], z)
    """
    known = frozenset(variables)
    groups: dict[sympy.Expr, Alike] = {}
    for term in sympy.Add.make_args(expr):
        factor, body = term.as_coeff_Mul()
        row = _in_order_of_shape(body, known)
        places = [sympy.Dummy(f"a{k}", real=True, dummy_index=k + 1) for k in range(len(row))]
        template = body.xreplace(dict(zip(row, places, strict=True)))
        group = groups.setdefault(template, Alike(template, places, [], []))
        group.rows.append(tuple(row))
        group.factors.append(factor)
    found = [group for group in groups.values() if group.places and len(group.rows) >= fewest]
    few = [group for group in groups.values() if group not in found]
    rest = [
        factor * group.template.xreplace(dict(zip(group.places, row, strict=True)))
        for group in few
        for row, factor in zip(group.rows, group.factors, strict=True)
    ]
    return found, sympy.Add(*rest)


def _in_order_of_shape(expr: sympy.Expr, variables: frozenset[sympy.Symbol]) -> list[sympy.Symbol]:
    """Variables of an expression, in an order that does not depend on their names.

    The parts of a sum or a product are sorted by shape, the expression without variable names;
    parts of equal shape keep sympy's order.
    """
    shapes: dict[sympy.Basic, str] = {}

    def shape(node: sympy.Basic) -> str:
        if node not in shapes:
            inner = ",".join(sorted(map(shape, node.args)))
            shapes[node] = "_" if node in variables else f"{node.func.__name__}({inner or node})"
        return shapes[node]

    order: dict[sympy.Symbol, None] = {}

    def visit(node: sympy.Basic) -> None:
        if node in variables:
            order.setdefault(node)
        commutes = node.is_Add or node.is_Mul
        for part in sorted(node.args, key=shape) if commutes else node.args:
            visit(part)

    visit(expr)
    return list(order)
