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

__all__ = [
    "connected_blocks",
    "gradient",
    "hessian",
    "narrow_arguments",
    "smallest_singular_value",
    "split",
    "switches",
    "vanishes",
]

# Functions that change between two limits, or have a peak, within a unit of their argument.
_BRIEF = (
    sympy.exp,
    sympy.tanh,
    sympy.sech,
    sympy.csch,
    sympy.cosh,
    sympy.sinh,
    sympy.coth,
    sympy.erf,
    sympy.erfc,
    sympy.atan,
    sympy.acot,
    sympy.asinh,
)


class _Magnitude(sympy.Function):  # type: ignore[misc]
    """abs of a real expression; sympy differentiates its own into derivatives of re and im."""

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return _Direction(self.args[0])


class _Direction(sympy.Function):  # type: ignore[misc]
    """sign of a real expression, whose derivative is zero almost everywhere."""

    def fdiff(self, argindex: int = 1) -> sympy.Expr:
        return sympy.Integer(0)


def _diff(term: sympy.Expr, symbol: sympy.Symbol) -> sympy.Expr:
    if not term.has(sympy.Abs, sympy.sign):
        return term.diff(symbol)
    own = term.replace(sympy.Abs, _Magnitude).replace(sympy.sign, _Direction)
    return own.diff(symbol).replace(_Magnitude, sympy.Abs).replace(_Direction, sympy.sign)


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
            parts[position[symbol]].append(_diff(term, symbol))
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
                    parts[i, j].append(_diff(term, symbol))
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


def smallest_singular_value(
    entries: dict[tuple[int, int], sympy.Expr], size: int
) -> sympy.Expr | None:
    """Smallest singular value of a symmetric matrix, if it falls into blocks of at most 2 x 2.

    Examples
    --------
    >>> x = sympy.Symbol("x", real=True)
    >>> smallest_singular_value({(0, 1): x, (1, 0): x, (2, 2): 1 + x**2}, 3)
    Min(x**2 + 1, Abs(x))
    """
    zero = sympy.Integer(0)
    magnitudes = set()
    for block in connected_blocks(list(entries), size):
        if len(block) > 2:
            return None
        if len(block) == 1:
            magnitudes.add(sympy.Abs(entries.get((block[0], block[0]), zero)))
            continue
        i, j = block
        a, b, c = (entries.get(index, zero) for index in ((i, i), (i, j), (j, j)))
        # The eigenvalues are middle +- radius.
        middle = (a + c) / 2
        radius = sympy.sqrt(sympy.factor_terms(((a - c) / 2) ** 2 + b**2))
        magnitudes.add(sympy.Abs(sympy.Abs(middle) - radius) if middle else radius)
    return sympy.Min(*magnitudes)


def split(
    expr: sympy.Expr, q: Sequence[sympy.Symbol], p: Sequence[sympy.Symbol]
) -> tuple[sympy.Expr, sympy.Expr]:
    """T(p) and V(q) of a sum T + V; terms in neither belong to V."""
    for form in (lambda e: e, sympy.expand, sympy.simplify):
        terms = sympy.Add.make_args(form(expr))
        with_p = [term for term in terms if term.free_symbols & set(p)]
        if not any(term.free_symbols & set(q) for term in with_p):
            return sympy.Add(*with_p), sympy.Add(*(t for t in terms if t not in with_p))
    infinite = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo, sympy.I)
    for numerator in (2, 1, 3, 5, 7, 11):
        potential = expr.xreplace(dict.fromkeys(p, sympy.Rational(numerator, 2)))
        if not potential.has(*infinite):
            break
    return sympy.simplify(expr - potential), potential


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


def switches(
    expr: sympy.Expr, gradient: Sequence[sympy.Expr], z: Sequence[sympy.Symbol]
) -> list[tuple[sympy.Expr, list[sympy.Expr]]]:
    """Where H or its gradient may jump: functions of the state, and the jumps where each is zero.

    The jumps of the gradient, then that of H.
    """
    jumping = [*gradient, expr]
    steps = {
        step
        for term in jumping
        for step in term.atoms(sympy.sign, sympy.Heaviside)
        if step.args[0].free_symbols & set(z)
    }
    found = []
    for step in sorted(steps, key=str):
        low = -1 if isinstance(step, sympy.sign) else 0
        jumps = [term.xreplace({step: 1}) - term.xreplace({step: low}) for term in jumping]
        found.append((step.args[0], jumps))
    return found


def narrow_arguments(
    expr: sympy.Expr, variables: Sequence[sympy.Symbol]
) -> list[tuple[sympy.Expr, bool]]:
    """Arguments of functions that may act in a small part of phase space or of time only.

    Those of exp, tanh, erf and the like, False, and the bases of negative and of broken powers,
    True: near where an argument is zero or extreme, pulses, steps and poles have their place.

    Examples
    --------
    >>> x, t = sympy.symbols("x t", real=True)
    >>> narrow_arguments(x**2 + sympy.exp(-100 * t**2) / sympy.sqrt(x**2 + 1), [x, t])
    [(-100*t**2, False), (x**2 + 1, True)]
    """
    known = set(variables)
    found = {(function.args[0], False) for function in expr.atoms(*_BRIEF)}
    for power in expr.atoms(sympy.Pow):
        exponent = power.exp
        if exponent.is_number and (exponent.is_negative or not exponent.is_integer):
            found.add((power.base, True))
    return sorted((entry for entry in found if entry[0].free_symbols & known), key=str)
