"""Legendre transform: from a Lagrangian to its Hamiltonian.

Input:  L(v), a Lagrangian in its velocities.
Output: H(p) = p v - L(v), where p = dL/dv.

L is quadratic in v: the matrix of second derivatives falls into connected blocks, each of which is
inverted exactly.
"""

from __future__ import annotations

import random
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import sympy

from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.symbolic import derivatives
from hamsym.symbolic.rational_matrices import inverse_matrix

MAX_EFFORT = 20_000_000  # function calls, most of them sympy's; ten seconds
MAX_SECONDS = 15.0  # of processor time
_DENSE = 3  # size up to which a block is inverted as a whole, without elimination
_LARGEST = 20_000  # operations of a matrix during its elimination
_POINTS = 20  # at which a matrix is positive definite
_INFINITE = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo)

Matrix = dict[tuple[sympy.Symbol, sympy.Symbol], sympy.Expr]


def legendre_transform(
    expr: sympy.Expr,
    slots: Sequence[sympy.Symbol],
    duals: Sequence[sympy.Symbol],
    state: Collection[sympy.Symbol] = (),
    parameters: Mapping[sympy.Symbol, float] | None = None,
) -> sympy.Expr:
    """Compute the Legendre transform H(p) = p v - L(v), where p = dL/dv.

    Raise InputError if L is not quadratic in v, or p does not determine v; the message names
    variables.

    - expr: L, in real symbols.
    - slots, duals: v and p.
    - state: Coordinates and the time; other symbols are constants.
    - parameters: Values, for the comparison at random points.

    Examples
    --------
    >>> v, w, p, r, m = sympy.symbols("v w p r m", real=True)
    >>> legendre_transform(m*v**2/2 + v*w + w**2, [v, w], [p, r])
    (m*r**2 + 2*p**2 - 2*p*r)/(4*m - 2)
    """
    steps = expr.atoms(sympy.Abs, sympy.sign, sympy.Heaviside, sympy.Min, sympy.Max)
    for step in sorted(steps, key=str):
        if step.free_symbols & {*slots}:
            raise InputError(
                f"'{step}' in L has no regular derivatives in velocities; use a smooth function"
            )
    try:
        with call_limit(MAX_EFFORT, MAX_SECONDS):
            pairs = dict(zip(slots, duals, strict=True))
            found = _Transform(pairs, {*state}, parameters or {}).of(expr)
            _check_finite(expr, found, parameters or {})
            return found
    except CallLimitExceededError:
        listed = ", ".join(symbol.name for symbol in slots)
        raise InputError(
            f"the equations for {listed} take too long to solve symbolically; use coordinates in "
            "which fewer of them are coupled in the kinetic energy, or give numbers for parameters "
            "inside L, or give H itself"
        ) from None
    except CodeGenerationError:
        raise InputError(
            "the derivatives of L in velocities are too large; write it as a sum of terms in fewer "
            "variables each"
        ) from None


def _check_finite(
    expr: sympy.Expr, found: sympy.Expr, parameters: Mapping[sympy.Symbol, float]
) -> None:
    """Refuse values of parameters at which a transform for all values is infinite."""
    values = {symbol: sympy.Rational(str(v)) for symbol, v in parameters.items()}
    if found.xreplace(values).has(*_INFINITE) and not expr.xreplace(values).has(*_INFINITE):
        listed = ", ".join(f"{s.name} = {v!r}" for s, v in parameters.items() if found.has(s))
        raise InputError(
            f"the mass matrix is singular for {listed}: velocities have no terms of their own "
            "there; give other values, or insert them in L and remove the coordinate"
        )


@dataclass(frozen=True)
class _Transform:
    """The Legendre transform, block by block."""

    #: Momenta by velocity.
    duals: Mapping[sympy.Symbol, sympy.Symbol]
    state: set[sympy.Symbol]
    parameters: Mapping[sympy.Symbol, float]

    def _derived(
        self, expr: sympy.Expr
    ) -> tuple[sympy.Expr, list[sympy.Expr], dict[tuple[int, int], sympy.Expr]]:
        """F and its derivatives in s, expanded if F becomes quadratic by that."""
        slots = list(self.duals)
        for form in (expr, sympy.expand(expr)):
            effort = derivatives.Effort(form)
            first = derivatives.gradient(form, slots, effort)
            second = derivatives.hessian(first, slots, effort)
            if not any(entry.has(*slots) for entry in second.values()):
                break
        # Expanded, its terms belong to one block each wherever that is possible.
        return form, first, second

    def of(self, expr: sympy.Expr) -> sympy.Expr:
        """The transform, of each block by itself, less the terms without velocities."""
        slots = list(self.duals)
        expr, first, second = self._derived(expr)
        origin = dict.fromkeys(slots, sympy.S.Zero)
        rest = expr.xreplace(origin)
        if any(e.has(*slots) for e in second.values()) or rest.has(*_INFINITE):
            listed = ", ".join(symbol.name for symbol in slots)
            raise InputError(f"L is not quadratic in the velocities {listed}; give H itself")
        parts = []
        for members in derivatives.connected_blocks(list(second), len(slots)):
            block = [slots[i] for i in members]
            matrix = {
                (slots[i], slots[j]): second[i, j]
                for i in members
                for j in members
                if (i, j) in second
            }
            shifted = {slots[i]: self.duals[slots[i]] - first[i].xreplace(origin) for i in members}
            parts.append(self._of_block(block, matrix, shifted))
        return sympy.Add(*parts) - rest

    def _of_block(
        self, block: list[sympy.Symbol], matrix: Matrix, shifted: dict[sympy.Symbol, sympy.Expr]
    ) -> sympy.Expr:
        """(w - b) M**-1 (w - b)/2 for F = s M s/2 + b s.

        Small blocks and those of numbers are inverted as a whole. Of others the variables with the
        fewest neighbours are eliminated first, which keeps a sparse matrix sparse: the result is a
        sum of squares. Where M is indefinite, a pivot that depends on the state may vanish while M
        is regular; such pivots are not used.
        """
        numbers = all(entry.is_Rational for entry in matrix.values())
        if len(block) <= _DENSE or numbers:
            return self._inverted(block, matrix, shifted)
        definite = self._is_positive(block, matrix)
        left, waiting, parts = dict(matrix), list(block), []
        while waiting:
            degree = {i: sum((i, j) in left for j in waiting) for i in waiting}
            pivots = [
                i
                for i in waiting
                if (i, i) in left and (definite or not left[i, i].free_symbols & self.state)
            ]
            if not pivots:
                break
            k = min(pivots, key=lambda i: (degree[i], left[i, i].count_ops(), block.index(i)))
            pivot = left.pop((k, k))
            waiting.remove(k)
            column = {i: left.pop((i, k)) for i in waiting if (i, k) in left}
            parts.append(shifted[k] ** 2 / (2 * pivot))
            for i, entry in column.items():
                left.pop((k, i))
                shifted[i] -= entry / pivot * shifted[k]
                for j, other in column.items():
                    value = left.pop((i, j), sympy.S.Zero) - entry * other / pivot
                    if not derivatives.vanishes(value):
                        left[i, j] = value
            if sum(entry.count_ops() for entry in left.values()) > _LARGEST:
                raise CallLimitExceededError
        place = {slot: i for i, slot in enumerate(waiting)}
        pairs = [(place[i], place[j]) for i, j in left]
        for members in derivatives.connected_blocks(pairs, len(waiting)):
            parts.append(self._inverted([waiting[i] for i in members], left, shifted))
        return sympy.Add(*parts)

    def _is_positive(self, block: list[sympy.Symbol], matrix: Matrix) -> bool:
        """Whether a matrix is positive definite at random points, with positive parameters."""
        generator = random.Random(2)
        rows = [[matrix.get((i, j), sympy.S.Zero) for j in block] for i in block]
        symbols = sorted({s for entry in matrix.values() for s in entry.free_symbols}, key=str)
        for _ in range(_POINTS):
            at = {
                symbol: sympy.Float(
                    generator.uniform(-3, 3)
                    if symbol in self.state
                    else self.parameters.get(symbol, generator.uniform(0.3, 3))
                )
                for symbol in symbols
            }
            values = [[complex(entry.xreplace(at).evalf()) for entry in row] for row in rows]
            try:
                np.linalg.cholesky(np.array(values))
            except (np.linalg.LinAlgError, ValueError):
                return False
            if not np.isfinite(values).all():
                return False
        return True

    def _inverted(
        self, block: list[sympy.Symbol], matrix: Matrix, shifted: Mapping[sympy.Symbol, sympy.Expr]
    ) -> sympy.Expr:
        """Half the inverse quadratic form of a whole block, over one denominator."""
        rows = [[matrix.get((i, j), sympy.S.Zero) for j in block] for i in block]
        inverse, denominator = inverse_matrix(rows)
        if denominator is None:
            raise self._singular(inverse[0], block)
        products = []
        for i, one in enumerate(block):
            for j in range(i, len(block)):
                entry = inverse[i][j] * (1 if i == j else 2)
                products.append(entry * shifted[one] * shifted[block[j]])
        return sympy.Add(*products) / (2 * denominator)

    def _singular(self, null: list[sympy.Expr], block: Sequence[sympy.Symbol]) -> InputError:
        combination = f"a combination of {', '.join(slot.name for slot in block)}"
        if null:
            pairs = zip(null, block, strict=True)
            combination = str(sympy.Add(*(factor * slot for factor, slot in pairs)))
        return InputError(
            f"the mass matrix of L is singular: no term is quadratic in {combination}, so that "
            "momenta do not determine velocities; add its kinetic energy, or remove a coordinate "
            "that has none"
        )
