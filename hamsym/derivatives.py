"""Derivatives of sparse sums, at a cost in proportion to what is there.

A Hamiltonian of many bodies is a sum of terms in two or three variables each. Each term is
differentiated with respect to its own variables only, so that n coupled oscillators cost
O(n), not O(n**2) for the gradient and O(n**3) for the Hessian.
"""

from __future__ import annotations

import random
from collections import defaultdict
from collections.abc import Sequence

import sympy

__all__ = ["connected_blocks", "gradient", "hessian", "vanishes"]


def gradient(expr: sympy.Expr, variables: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """First derivatives, in the order of the variables.

    Examples
    --------
    >>> x, y = sympy.symbols("x y")
    >>> gradient(x**2 + x*y, (x, y))
    [2*x + y, x]
    """
    position = {variable: i for i, variable in enumerate(variables)}
    parts: list[list[sympy.Expr]] = [[] for _ in variables]
    for term in sympy.Add.make_args(expr):
        for symbol in term.free_symbols & position.keys():
            parts[position[symbol]].append(term.diff(symbol))
    return [sympy.Add(*part) for part in parts]


def hessian(
    first: Sequence[sympy.Expr], variables: Sequence[sympy.Symbol]
) -> dict[tuple[int, int], sympy.Expr]:
    """Nonzero second derivatives (i, j), both triangles, from the first derivatives."""
    position = {variable: i for i, variable in enumerate(variables)}
    parts: dict[tuple[int, int], list[sympy.Expr]] = defaultdict(list)
    for i, derivative in enumerate(first):
        for term in sympy.Add.make_args(derivative):
            for symbol in term.free_symbols & position.keys():
                if (j := position[symbol]) >= i:
                    parts[i, j].append(term.diff(symbol))
    entries: dict[tuple[int, int], sympy.Expr] = {}
    for (i, j), part in sorted(parts.items()):
        entry = sympy.Add(*part)
        if entry != 0:
            entries[i, j] = entries[j, i] = entry
    return entries


def connected_blocks(pairs: Sequence[tuple[int, int]], size: int) -> list[list[int]]:
    """Index sets that a symmetric sparsity pattern does not couple with each other.

    Examples
    --------
    >>> connected_blocks([(0, 2), (2, 0)], 3)
    [[0, 2], [1]]
    """
    block = {i: [i] for i in range(size)}
    for i, j in pairs:
        if block[i] is not block[j]:
            block[i].extend(block[j])
            for k in block[j]:
                block[k] = block[i]
    return sorted({id(members): sorted(members) for members in block.values()}.values())


def vanishes(expr: sympy.Expr) -> bool:
    """Whether an expression is identically zero.

    Values at random points refute it cheaply; only what they do not refute is simplified.
    """
    if expr.is_zero is not None:
        return bool(expr.is_zero)
    generator = random.Random(0)
    symbols = sorted(expr.free_symbols, key=str)
    for _ in range(3):
        point = {symbol: sympy.Rational(generator.randint(1, 999), 500) for symbol in symbols}
        value = expr.xreplace(point).evalf(30)
        if value.is_Float and abs(value) > 1e-20:
            return False
    return bool(sympy.simplify(expr) == 0)
