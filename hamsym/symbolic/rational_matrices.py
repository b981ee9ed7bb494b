"""Inverses of symbolic matrices, in the polynomials of what their entries contain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import sympy
from sympy.polys.matrices import DomainMatrix

from hamsym.symbolic import derivatives

_MANY = 300  # terms of a polynomial beyond which common factors take long to find

Rows = list[list[sympy.Expr]]


def inverse_matrix(rows: Sequence[Sequence[sympy.Expr]]) -> tuple[Rows, sympy.Expr | None]:
    """Entries and common denominator of an inverse; of a singular matrix, a null vector and None.

    The null vector is empty if none is found.

    Examples
    --------
    >>> m, x = sympy.symbols("m x", real=True)
    >>> inverse_matrix([[m, sympy.cos(x)], [sympy.cos(x), sympy.S(1)]])
    ([[1, -cos(x)], [-cos(x), m]], m - cos(x)**2)
    >>> inverse_matrix([[m, m], [m, m]])
    ([[1, -1]], None)
    """
    ring = _Polynomials([entry for row in rows for entry in row])
    size = len(rows)
    matrix = DomainMatrix(
        [[ring.element(e) for e in row] for row in rows], (size, size), ring.field
    )
    if ring.is_number:
        if matrix.rank() < size:
            return _null_vector(matrix, ring), None
        entries = matrix.inv().to_list()
        return [[ring.expression(entry) for entry in row] for row in entries], sympy.S.One
    # Free of fractions, so that no common factors are searched on the way.
    factor = ring.ring.one
    for row in matrix.to_list():
        for entry in row:
            factor = factor.lcm(entry.denom)
    domain = ring.ring.to_domain()
    cleared = [[entry * factor for entry in row] for row in matrix.to_list()]
    # A denominator may still be a number.
    whole = [[entry.numer.quo_ground(entry.denom.LC) for entry in row] for row in cleared]
    adjugate, determinant = _adjugate(DomainMatrix(whole, (size, size), domain))
    determinant = ring.reduced(determinant)
    found = [[ring.reduced(entry) for entry in row] for row in adjugate.to_list()]
    if derivatives.vanishes(ring.expression(determinant)):
        columns = (list(column) for column in zip(*found, strict=True) if any(column))
        column = next(columns, None)  # the matrix times its adjugate is zero
        if column is None:
            return _null_vector(matrix, ring), None
        first = ring.expression(next(entry for entry in column if entry))
        return [[sympy.cancel(ring.expression(entry) / first) for entry in column]], None
    if sum(len(entry) for row in found for entry in row) <= _MANY:
        common = determinant
        for entry in (entry for row in found for entry in row):
            common = common.gcd(entry)
        found = [[entry.exquo(common) for entry in row] for row in found]
        determinant = determinant.exquo(common)
    # The inverse is factor*adjugate/determinant.
    shared = factor.gcd(determinant)
    factor, determinant = factor.exquo(shared), determinant.exquo(shared)
    scaled = [[ring.expression(entry * factor) for entry in row] for row in found]
    if ring.relations:  # factors of 1 - cos**2 would hide sin**2
        return scaled, ring.expression(determinant)
    return scaled, sympy.factor(ring.plain(determinant)).xreplace(ring.back)


def _adjugate(matrix: DomainMatrix) -> tuple[DomainMatrix, Any]:
    """Adjugate and determinant, by the characteristic polynomial.

    Sympy's own ``adj_det`` fails where a coefficient is the zero of a ring of polynomials.
    """
    size = len(matrix.rep.to_list())
    one = DomainMatrix.eye(size, matrix.domain).to_dense()
    _, *inner, last = matrix.charpoly()
    found = one
    for coefficient in inner:
        found = matrix * found + one.scalarmul(coefficient)
    return (-found, last) if size % 2 == 0 else (found, -last)


def _null_vector(matrix: DomainMatrix, ring: _Polynomials) -> Rows:
    null = matrix.nullspace().to_list()
    if not null:
        return [[]]
    first = next(entry for entry in null[0] if entry)
    return [[ring.expression(entry / first) for entry in null[0]]]


class _Polynomials:
    """Polynomials and rational functions of the symbols and functions in some expressions.

    - back: What the generators are.
    - relations: sin**2 + cos**2 - 1 for each argument of both functions.
    """

    def __init__(self, entries: Sequence[sympy.Expr]) -> None:
        marks: dict[sympy.Expr, sympy.Dummy] = {}
        for entry in entries:
            for part in _generators(entry):
                marks.setdefault(part, sympy.Dummy(f"g{len(marks)}"))
        # The sines come first, so that the remainder by sin**2 + cos**2 - 1 contains no sin**2.
        parts = sorted(marks, key=lambda part: (not isinstance(part, sympy.sin), str(part)))
        self.is_number = not parts
        self.back = {mark: part for part, mark in marks.items()}
        self.relations: list[Any] = []
        self._marks = marks
        self._shorter: dict[sympy.Expr, sympy.Expr] = {}
        if not parts:
            self.field = sympy.QQ
            return
        self.field = sympy.QQ.frac_field(*(marks[part] for part in parts))
        self.ring = self.field.field.ring
        generator = dict(zip(parts, self.ring.gens, strict=True))
        for part in parts:
            if isinstance(part, sympy.sin) and sympy.cos(part.args[0]) in generator:
                other = generator[sympy.cos(part.args[0])]
                self.relations.append(generator[part] ** 2 + other**2 - 1)
                short = 1 - sympy.cos(part.args[0]) ** 2
                self._shorter |= {short: part**2, -short: -(part**2)}

    def element(self, expr: sympy.Expr) -> Any:
        """Convert an expression to a rational function."""
        found = self.field.from_sympy(expr.xreplace(self._marks))
        if not self.relations:
            return found
        return self.field.field.new(self.reduced(found.numer), self.reduced(found.denom))

    def reduced(self, polynomial: Any) -> Any:
        return polynomial.rem(self.relations) if self.relations else polynomial

    def plain(self, element: Any) -> sympy.Expr:
        """Convert an element to an expression in the generators."""
        return self.field.to_sympy(element) if self.is_number else element.as_expr()

    def expression(self, element: Any) -> sympy.Expr:
        expr = sympy.factor_terms(self.plain(element).xreplace(self.back))
        return expr.xreplace(self._shorter)


def _generators(expr: sympy.Expr) -> Iterator[sympy.Expr]:
    """Largest parts of an expression that are not made by rational operations."""
    if expr.is_Rational:
        return
    if expr.is_Add or expr.is_Mul:
        for part in expr.args:
            yield from _generators(part)
    elif expr.is_Pow and expr.exp.is_Integer:
        yield from _generators(expr.base)
    else:
        yield expr
