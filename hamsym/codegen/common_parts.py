"""Parts that the terms of a sum, or several expressions, have in common."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from graphlib import TopologicalSorter
from itertools import pairwise

import sympy

_LONG_PRODUCT = 8  # number of factors from which parts of products are shared


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


#: Temporaries in order of evaluation.
Temporaries = list[tuple[sympy.Symbol, sympy.Expr]]


def common_subexpressions(
    exprs: Sequence[sympy.Expr], symbols: Iterator[sympy.Symbol]
) -> tuple[Temporaries, list[sympy.Expr]]:
    """Extract common subexpressions as temporaries; return them and the reduced expressions.

    :func:`sympy.cse` shares only whole sums and products; here parts of long products are shared
    too. The gradient of a product of n factors costs O(n) multiplications, its Hessian O(1) for
    each entry.

    Examples
    --------
    >>> x, y = sympy.symbols("x y")
    >>> common_subexpressions([sympy.sin(x) + y, sympy.sin(x)*y], iter(sympy.symbols("u0 u1")))
    ([(u0, sin(x))], [u0 + y, u0*y])
    """
    inner = (sympy.Dummy(f"shared{k}", real=True) for k in itertools.count())
    products, exprs = _shared_products(exprs, inner)
    # order="none" skips a canonical sort that is slow on large expressions.
    if not products:
        return sympy.cse(exprs, symbols=symbols, order="none")
    replaced, reduced = sympy.cse([*(v for _, v in products), *exprs], symbols=inner, order="none")
    values = dict(replaced)
    values |= dict(zip((symbol for symbol, _ in products), reduced, strict=False))
    earlier = {s: sorted(v.free_symbols & values.keys(), key=str) for s, v in values.items()}
    # Numbered in order of evaluation.
    order = {symbol: next(symbols) for symbol in TopologicalSorter(earlier).static_order()}
    return (
        [(name, values[symbol].xreplace(order)) for symbol, name in order.items()],
        [expr.xreplace(order) for expr in reduced[len(products) :]],
    )


def _shared_products(
    exprs: Sequence[sympy.Expr], symbols: Iterator[sympy.Symbol]
) -> tuple[Temporaries, list[sympy.Expr]]:
    """Extract products of adjacent factors as temporaries; return them and the expressions.

    The factors of all long products are arranged in a row. Each product then consists of a few runs
    of the row: a prefix and a suffix for an entry of a gradient, and also a middle run for one of a
    Hessian. Each run is computed from a run that is shorter by one factor.
    """
    found = {node for expr in exprs for node in expr.atoms(sympy.Mul)}
    long = [node for node in found if len(node.args) >= _LONG_PRODUCT]
    uses = Counter(factor for node in long for factor in node.args if not factor.is_Number)
    # Factors of few products are at the end, where they interrupt no runs.
    row = sorted(uses, key=lambda factor: (-uses[factor], str(factor)))
    place = {factor: k for k, factor in enumerate(row)}
    runs = {node: _runs(sorted(place[f] for f in node.args if f in place)) for node in long}
    lengths = {run: run[1] - run[0] for parts in runs.values() for run in parts}
    wanted = sorted(lengths, key=lambda run: (lengths[run], run))  # from short to long
    known: dict[tuple[int, int], sympy.Expr] = {(k, k + 1): row[k] for k in range(len(row))}
    temporaries: Temporaries = []
    for first, last in wanted:
        if (first, last) in known:
            continue
        if (first + 1, last) in known:
            steps = [((first, last), row[first], (first + 1, last))]
        else:
            start = next(end for end in range(last - 1, first, -1) if (first, end) in known)
            steps = [((first, k + 1), row[k], (first, k)) for k in range(start, last)]
        for run, factor, rest in steps:
            known[run] = next(symbols)
            temporaries.append((known[run], factor * known[rest]))
    if 2 * (len(temporaries) + sum(map(len, runs.values()))) > sum(len(n.args) for n in long):
        return [], list(exprs)
    shorter = {
        node: sympy.Mul(*(f for f in node.args if f not in place), *(known[run] for run in parts))
        for node, parts in runs.items()
    }
    return temporaries, [expr.xreplace(shorter) for expr in exprs]


def _runs(places: Sequence[int]) -> list[tuple[int, int]]:
    """Group sorted integers into intervals [first, last) without gaps."""
    breaks = [k for k in range(1, len(places)) if places[k] != places[k - 1] + 1]
    bounds = [0, *breaks, len(places)]
    return [(places[a], places[b - 1] + 1) for a, b in pairwise(bounds)]
