"""Legendre transform: from a Lagrangian to its Hamiltonian, and back.

Input:  F(s), a Lagrangian in its velocities or a Hamiltonian in its momenta.
Output: G(w) = w s - F(s), where w = dF/ds.

Where F is quadratic in s, the matrix of second derivatives falls into connected blocks, each of
which is inverted exactly. Elsewhere one scalar equation is solved, and its solution is accepted
after comparisons with w s - F at random points, in many digits and in float64.
"""

from __future__ import annotations

import random
from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any

import numpy as np
import sympy

from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.symbolic import derivatives
from hamsym.symbolic.rational_matrices import inverse_matrix
from hamsym.symbolic.transform_checks import TransformChecks

MAX_EFFORT = 20_000_000  # function calls, most of them sympy's; ten seconds
MAX_SECONDS = 15.0  # of processor time
# Inverting a matrix ends, so that waiting for it pays; a search for roots may have no end.
MAX_SEARCH_EFFORT = 5_000_000  # relativistic Lagrangians take two million
_DENSE = 3  # size up to which a block is inverted as a whole, without elimination
_LARGEST = 20_000  # operations of a matrix during its elimination
_POINTS = 20  # at which a matrix is positive definite
_INVERTIBLE = (sympy.exp, sympy.log, sympy.sinh, sympy.tan, sympy.asinh, sympy.atan, sympy.atanh)
_INFINITE = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo)

Matrix = dict[tuple[sympy.Symbol, sympy.Symbol], sympy.Expr]


def legendre_transform(
    expr: sympy.Expr,
    slots: Sequence[sympy.Symbol],
    duals: Sequence[sympy.Symbol],
    state: Collection[sympy.Symbol] = (),
    parameters: Mapping[sympy.Symbol, float] | None = None,
    name: str = "L",
) -> sympy.Expr:
    """Compute the Legendre transform G(w) = w s - F(s), where w = dF/ds.

    It takes L to H, with velocities s and momenta w, and H to L, with momenta s and velocities w.

    Raise InputError if w does not determine s, or s is not found; the message names variables.

    - expr: F, in real symbols.
    - slots, duals: s and w.
    - state: Coordinates and the time; other symbols are constants.
    - parameters: Values, for the comparison at random points.
    - name: {"L", "H"}. What F is, for messages.

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
                f"'{step}' in {name} has no regular derivatives in {_kind(name)}; use a smooth "
                "function"
            )
    try:
        with call_limit(MAX_EFFORT, MAX_SECONDS):
            transform = _Transform(expr, slots, duals, state, parameters or {}, name)
            found, others, rest = transform.quadratic()
        with call_limit(MAX_SEARCH_EFFORT, MAX_SECONDS):
            found += transform.others(others, rest)
            _check_finite(expr, found, parameters or {}, name)
            return found
    except CallLimitExceededError:
        listed = ", ".join(symbol.name for symbol in slots)
        raise InputError(
            f"the equations for {listed} take too long to solve symbolically; use coordinates in "
            "which fewer of them are coupled in the kinetic energy, or give numbers for parameters "
            f"inside {name}, or give {'H' if name == 'L' else 'L'} itself"
        ) from None
    except CodeGenerationError:
        raise InputError(
            f"the derivatives of {name} in {_kind(name)} are too large; write it as a sum of terms "
            "in fewer variables each"
        ) from None


def _check_finite(
    expr: sympy.Expr, found: sympy.Expr, parameters: Mapping[sympy.Symbol, float], name: str
) -> None:
    """Refuse values of parameters at which a transform for all values is infinite."""
    values = {symbol: sympy.Rational(str(v)) for symbol, v in parameters.items()}
    if found.xreplace(values).has(*_INFINITE) and not expr.xreplace(values).has(*_INFINITE):
        listed = ", ".join(f"{s.name} = {v!r}" for s, v in parameters.items() if found.has(s))
        singular = "the mass matrix is singular" if name == "L" else "H has no Lagrangian"
        raise InputError(
            f"{singular} for {listed}: {_kind(name)} have no terms of their own there; give other "
            f"values, or insert them in {name} and remove the coordinate"
        )


def _kind(name: str) -> str:
    return "velocities" if name == "L" else "momenta"


class _Transform:
    """The Legendre transform of one expression, block by block."""

    def __init__(
        self,
        expr: sympy.Expr,
        slots: Sequence[sympy.Symbol],
        duals: Sequence[sympy.Symbol],
        state: Collection[sympy.Symbol],
        parameters: Mapping[sympy.Symbol, float],
        name: str,
    ) -> None:
        self.slots, self.state, self.parameters = list(slots), {*state}, parameters
        self.name = name
        self.duals = dict(zip(slots, duals, strict=True))
        self.expr, self.first, self.second = self._derived(expr)

    def _derived(
        self, expr: sympy.Expr
    ) -> tuple[sympy.Expr, list[sympy.Expr], dict[tuple[int, int], sympy.Expr]]:
        """F and its derivatives in s, expanded if F becomes quadratic by that."""
        forms: list[Any] = []
        for form in (expr, sympy.expand(expr)):
            effort = derivatives.Effort(form)
            first = derivatives.gradient(form, self.slots, effort)
            second = derivatives.hessian(first, self.slots, effort)
            forms.append((form, first, second))
            if not any(entry.has(*self.slots) for entry in second.values()):
                return forms[-1]
        # Expanded, its terms belong to one block each wherever that is possible.
        return forms[1]

    def quadratic(self) -> tuple[sympy.Expr, list[list[sympy.Symbol]], sympy.Expr]:
        """The transform of all quadratic blocks, the other blocks, and what is left of F."""
        second = {index: entry for index, entry in self.second.items() if entry != 0}
        blocks = [
            [self.slots[i] for i in block]
            for block in derivatives.connected_blocks(list(second), len(self.slots))
        ]
        position = {slot: i for i, slot in enumerate(self.slots)}
        quadratic: list[tuple[list[sympy.Symbol], Matrix]] = []
        others: list[list[sympy.Symbol]] = []
        for block in blocks:
            entries = {
                (i, j): second[position[i], position[j]]
                for i in block
                for j in block
                if (position[i], position[j]) in second
            }
            whole = not any(entry.has(*self.slots) for entry in entries.values())
            if whole:
                quadratic.append((block, entries))
            else:
                others.append(block)
        origin = dict.fromkeys((slot for block, _ in quadratic for slot in block), sympy.S.Zero)
        rest = self.expr.xreplace(origin)
        if rest.has(sympy.nan, sympy.zoo, sympy.oo):
            raise self._unsolved(self.slots)
        parts = []
        for block, entries in quadratic:
            shifted = {}
            for slot in block:
                offset = self.first[position[slot]].xreplace(origin)
                if offset.has(*self.slots):
                    raise self._unsolved(block)
                shifted[slot] = self.duals[slot] - offset
            parts.append(self._quadratic(block, entries, shifted))
        return sympy.Add(*parts), others, rest

    def others(self, blocks: list[list[sympy.Symbol]], rest: sympy.Expr) -> sympy.Expr:
        """The transform of blocks that are not quadratic, less the terms without velocities."""
        parts = []
        for block in blocks:
            terms = [term for term in sympy.Add.make_args(rest) if term.has(*block)]
            rest = sympy.Add(*(t for t in sympy.Add.make_args(rest) if t not in set(terms)))
            part = sympy.Add(*terms)
            if part.free_symbols & {*self.slots} - {*block}:
                raise self._unsolved(self.slots)
            parts.append(self._general(block, part))
        return sympy.Add(*parts) - rest

    # -- quadratic blocks ----------------------------------------------------------------------

    def _quadratic(
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
        if self.name == "L":
            return InputError(
                f"the mass matrix of L is singular: no term is quadratic in {combination}, so that "
                "momenta do not determine velocities; add its kinetic energy, or remove a "
                "coordinate that has none"
            )
        return InputError(
            f"H has no Lagrangian: no term is quadratic in {combination}, so that velocities do "
            "not determine momenta"
        )

    # -- other blocks --------------------------------------------------------------------------

    def _general(self, block: list[sympy.Symbol], part: sympy.Expr) -> sympy.Expr:
        """The transform of a function of a quadratic form, or of a single variable."""
        linear = [
            term
            for term in sympy.Add.make_args(part)
            if not any(sympy.diff(term, slot).has(*block) for slot in block)
        ]
        slopes = derivatives.gradient(sympy.Add(*linear), block)
        duals = [self.duals[slot] for slot in block]
        curved = part - sympy.Add(*linear)
        checks = TransformChecks(curved, block, duals, self.parameters)
        inaccurate = False
        # Before the search, which takes long where there are branches.
        for solved in _candidates(block, duals, curved) if checks.is_unique() else ():
            if checks.agrees(solved):
                if checks.is_accurate(solved):
                    return solved.xreplace(
                        {dual: dual - slope for dual, slope in zip(duals, slopes, strict=True)}
                    )
                inaccurate = True
        raise self._unsolved(block, inaccurate)

    def _unsolved(self, block: Sequence[sympy.Symbol], inaccurate: bool = False) -> InputError:
        listed = ", ".join(symbol.name for symbol in block)
        found, given = ("velocities", "momenta") if self.name == "L" else ("momenta", "velocities")
        if inaccurate:
            failure = (
                f"the {found} were found only in a form that loses digits or is not a number at "
                "rest or near it"
            )
        else:
            failure = f"the {found} were not found as unique functions of the {given}"
        remedy = "; give parameters their values, or give H itself" if self.name == "L" else ""
        return InputError(f"{self.name} is not quadratic in {listed}, and {failure}{remedy}")


def _candidates(
    block: Sequence[sympy.Symbol], duals: Sequence[sympy.Symbol], curved: sympy.Expr
) -> Iterator[sympy.Expr]:
    """Functions of the duals that may be the transform, those without cancellation first."""
    if len(block) == 1:
        slot, dual = block[0], duals[0]
        slope = sympy.diff(curved, slot)
        powers = sympy.Poly(slope, slot) if slope.is_polynomial(slot) else None
        if powers is None:
            root = _peeled(slope, slot, dual)
            if root is not None:
                found = dual * root - curved.xreplace({slot: root})
                yield min(found, sympy.simplify(found), key=sympy.count_ops)
        elif len(powers.terms()) > 1:
            root = _cubic_root(powers, dual)
            if root is not None:
                # In powers of the root nothing cancels that would in w s - F(s).
                yield sympy.expand(slot * slope - curved).xreplace({slot: root})
            return  # the radicals of Cardano and Ferrari cancel near rest
    size = sympy.Dummy("size", positive=True)
    for form, function in _quadratic_forms(curved, block, size):
        matrix = sympy.hessian(form, block) / 2
        square = sympy.Dummy("square", nonnegative=True)
        if len(block) == 1:
            value = duals[0] ** 2 / matrix[0]
        else:
            inverse, denominator = inverse_matrix(matrix.tolist())
            if denominator is None:
                return
            column = sympy.Matrix(duals)
            value = (column.T * sympy.Matrix(inverse) * column)[0] / denominator
        slope = sympy.diff(function, size)
        # w = 2 F'(u) G s for F(u), u = s G s; so that w G**-1 w = 4 F'(u)**2 u.
        for root in _roots(4 * slope**2 * size - square, size):
            found = _compact((2 * size * slope - function).xreplace({size: root}), square)
            yield found.xreplace({square: value})
    if len(block) == 1:
        for root in _roots(sympy.diff(curved, slot) - dual, slot):
            found = dual * root - curved.xreplace({slot: root})
            forms = (sympy.simplify(found), sympy.simplify(found.rewrite(sympy.exp)))
            yield min(forms, key=sympy.count_ops)


def _peeled(slope: sympy.Expr, slot: sympy.Symbol, dual: sympy.Expr) -> sympy.Expr | None:
    """s where the slope is a function with an inverse, of s times a constant and the like."""
    while slope != slot:
        constant, rest = slope.as_independent(slot)
        if slope.is_Add and constant != 0:
            slope, dual = rest, dual - constant
        elif slope.is_Mul and constant != 1:
            slope, dual = rest, dual / constant
        elif isinstance(slope, _INVERTIBLE):
            slope, dual = slope.args[0], slope.inverse()(dual)
        else:
            return None
    return dual


def _cubic_root(powers: sympy.Poly, dual: sympy.Expr) -> sympy.Expr | None:
    """The root of a s**3 + c s = w that is real for a/c > 0, by a hyperbolic sine.

    With s = 2 sqrt(c/(3 a)) sinh(y) it is sinh(3 y) = 3 sqrt(3 a/c) w/(2 c).
    """
    if {degree for (degree,), _ in powers.terms()} != {1, 3}:
        return None
    a, c = powers.coeff_monomial((3,)), powers.coeff_monomial((1,))
    third = sympy.asinh(3 * sympy.sqrt(3 * a / c) * dual / (2 * c)) / 3
    return 2 * sympy.sqrt(c / (3 * a)) * sympy.sinh(third)


def _quadratic_forms(
    curved: sympy.Expr, block: Sequence[sympy.Symbol], size: sympy.Dummy
) -> Iterator[tuple[sympy.Expr, sympy.Expr]]:
    """Quadratic forms u of the block, and F(u), for an F that depends on the block by u alone."""
    if len(block) == 1 and not curved.atoms(sympy.Function):
        function = curved.xreplace({block[0]: sympy.sqrt(size)})
        if function == curved.xreplace({block[0]: -sympy.sqrt(size)}):
            yield block[0] ** 2, function
            return
    origin = dict.fromkeys(block, sympy.S.Zero)
    inner = {node for top in sympy.preorder_traversal(curved) for node in (top, *top.args)}
    for node in sorted((n for n in inner if n.is_Add and n.has(*block)), key=sympy.count_ops):
        matrix = sympy.hessian(node, block)
        slopes = [sympy.diff(node, slot).xreplace(origin) for slot in block]
        if matrix.has(*block) or any(slope != 0 for slope in slopes):
            continue
        unit = next(entry for entry in matrix if entry != 0) / 2
        function = curved.xreplace({node: node.xreplace(origin) + unit * size})
        if not function.has(*block):
            yield sympy.expand((node - node.xreplace(origin)) / unit), function


def _roots(equation: sympy.Expr, unknown: sympy.Symbol) -> list[sympy.Expr]:
    try:
        found = sympy.solve(equation, unknown)
    except (ArithmeticError, AttributeError, NotImplementedError, TypeError, ValueError):
        return []
    plain = [root for root in found if isinstance(root, sympy.Expr)]
    return [r for r in plain if not r.has(sympy.I, sympy.Piecewise, sympy.LambertW, sympy.RootOf)]


def _compact(expr: sympy.Expr, square: sympy.Symbol) -> sympy.Expr:
    """The shortest of some forms of a function of a square.

    sqrt(a/(b + s)) with constants a and b becomes 1/sqrt((b + s)/a), of which s is a rational
    function; then the other occurrences of s are replaced too.
    """
    forms = [sympy.simplify(expr)]

    def turned(base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
        above, below = sympy.fraction(sympy.cancel(sympy.together(base)))
        if above.has(square) or not below.has(square):
            return base**exponent
        return sympy.expand(below / above) ** -exponent

    rooted = expr.replace(
        lambda node: node.is_Pow and node.exp.is_Rational and not node.exp.is_Integer,
        lambda node: turned(node.base, node.exp),
    )
    bases = {node.base for node in rooted.atoms(sympy.Pow) if node.exp.q == 2 and node.has(square)}
    if len(bases) == 1:
        base, root = bases.pop(), sympy.Dummy("root", positive=True)
        solutions = _roots(base - root**2, square)
        if len(solutions) == 1:
            plain = sympy.cancel(rooted.xreplace({base: root**2, square: solutions[0]}))
            forms.append(plain.xreplace({root: sympy.sqrt(base)}))
    return min(forms, key=sympy.count_ops)
