"""Exact zeros of the gradient of H, where sympy finds them with limited effort.

Input:  :class:`~hamsym.symbolic.equations.Equations`; parameters with a value are inserted as the
        exact binary fractions that they are, the others remain symbols.
Output: solutions, each verified by substitution; and directions in which H does not change.

The components of z fall into blocks: the gradient in the components of one block depends on these
only, so that each block is solved by itself.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence

import sympy

from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.symbolic import derivatives
from hamsym.symbolic.equations import Equations

_CALLS, _SECONDS = 1_000_000, 3.0  # of all blocks
_LONGEST = 80  # operations of a solution that is still readable
_MOST = 1_000  # combinations of the solutions of blocks
_IMAGINARY = 1e-20
_LONGEST_NUMBER = 1_000_000  # bits

Solution = dict[sympy.Symbol, sympy.Expr]


def blocks(form: Equations) -> list[list[int]]:
    """Places in z of the components that are coupled with each other only.

    Examples
    --------
    >>> x, y, p, q = sympy.symbols("x y p q", real=True)
    >>> blocks(Equations(p**2/2 + q**2/2 + x**2*y, [x, y, p, q], None, {}))
    [[0, 1], [2], [3]]
    """
    return derivatives.connected_blocks(list(form.exact.hessian), len(form.z))


def exact_gradient(form: Equations) -> list[sympy.Expr]:
    """The gradient without floating-point numbers, with the values of the parameters.

    Entries with powers too long for fractions have the symbols of the parameters.
    """
    inserted = form.fractions
    found = [form.exact.with_fractions(entry, form.values) for entry in form.exact.gradient]
    return [e if _has_long_power(e, inserted) else e.xreplace(inserted) for e in found]


def _has_long_power(expr: sympy.Expr, values: Mapping[sympy.Symbol, sympy.Expr]) -> bool:
    """Whether a power becomes a number of too many bits with values of symbols."""
    for power in sorted(expr.atoms(sympy.Pow), key=sympy.count_ops):  # inner ones first
        base, exponent = power.base.xreplace(values), power.exp.xreplace(values)
        if base.is_Rational and exponent.is_Rational and abs(base) != 1:
            bits = max(abs(base.p).bit_length(), base.q.bit_length())
            if not abs(exponent) * bits <= _LONGEST_NUMBER:
                return True
    return False


def stationary_points(form: Equations) -> list[Solution] | None:
    """Real zeros of the gradient, in closed form.

    - returns: Values by component of z; components that are free in a continuum of zeros are left
      out. None if no closed form was found within the limit, or some were too long to be read. Of
      transcendental equations some zeros may be missing.

    Examples
    --------
    >>> x, p = sympy.symbols("x p", real=True)
    >>> stationary_points(Equations(p**2/2 - x**2 + x**4/4, [x, p], None, {}))
    [{x: 0, p: 0}, {x: -sqrt(2), p: 0}, {x: sqrt(2), p: 0}]
    """
    try:
        with call_limit(_CALLS, _SECONDS):
            gradient = exact_gradient(form)
            bound = {symbol for symbol, value in form.parameters.values() if value is not None}
            if any(entry.free_symbols & bound for entry in gradient):
                return None
            parts = []
            for block in blocks(form):
                found = _solved([gradient[i] for i in block], [form.z[i] for i in block])
                if not found:
                    return found
                parts.append(found)
            if math.prod(map(len, parts)) > _MOST:
                return None
            return [
                {symbol: value for piece in pieces for symbol, value in piece.items()}
                for pieces in itertools.product(*parts)
            ]
    except CallLimitExceededError:
        return None


def _solved(
    gradient: Sequence[sympy.Expr], symbols: Sequence[sympy.Symbol]
) -> list[Solution] | None:
    """Verified real zeros of one block; None if sympy has no method or they are too long."""
    if all(derivatives.vanishes(entry) for entry in gradient):
        return [{}]
    try:
        if (
            len(symbols) == 1
            and gradient[0].is_polynomial(*symbols)
            and not (gradient[0].free_symbols - {*symbols})
        ):
            roots = sympy.Poly(gradient[0], *symbols).real_roots(multiple=False)
            found = [{symbols[0]: root} for root, _ in roots]
        else:
            found = sympy.solve(list(gradient), list(symbols), dict=True)
    # Sympy raises errors of many types where it has no method.
    except Exception:
        return None
    kept = []
    for solution in found:
        if any(value.count_ops() > _LONGEST for value in solution.values()):
            return None
        if not _is_real(solution):
            continue
        if not all(derivatives.vanishes(entry.subs(solution)) for entry in gradient):
            return None
        kept.append(solution)
    return sorted(kept, key=_order)


def _is_real(solution: Mapping[sympy.Symbol, sympy.Expr]) -> bool:
    """Whether values are real numbers, or may be for some values of the symbols in them."""
    for value in solution.values():
        if value.is_real is False or value.has(sympy.zoo, sympy.nan, sympy.oo):
            return False
        if not value.free_symbols:
            number = complex(value.evalf(30))
            if not abs(number.imag) <= _IMAGINARY * (1 + abs(number.real)):
                return False
    return True


def _order(solution: Solution) -> list[tuple[float, str]]:
    """The sum of the squares, then the values."""
    values = [
        complex(value.evalf(15)).real if not value.free_symbols else 0.0
        for value in solution.values()
    ]
    key = [(round(sum(value**2 for value in values), 9), "")]
    return [*key, *zip(values, map(str, solution.values()), strict=True)]


def periods(form: Equations) -> dict[int, sympy.Expr]:
    """Places of coordinates in which H has the period 2 pi, or a multiple of it.

    Examples
    --------
    >>> x, p = sympy.symbols("x p", real=True)
    >>> periods(Equations(p**2/2 - sympy.cos(x/2), [x, p], None, {}))
    {0: 4*pi}
    """
    found = {}
    for i, symbol in enumerate(form.z[: form.dof]):
        if not form.expr.atoms(sympy.sin, sympy.cos, sympy.tan) or not form.expr.has(symbol):
            continue
        for turns in (1, 2):
            period = 2 * turns * sympy.pi
            moved = form.expr.xreplace({symbol: symbol + period})
            if moved == form.expr or sympy.expand(moved - form.expr) == 0:
                found[i] = period
                break
    return found
