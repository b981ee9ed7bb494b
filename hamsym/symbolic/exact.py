"""Exact derivatives of formulas that contain floating-point numbers.

Sympy rounds products of floating-point numbers when it differentiates. Here every such number is
replaced by a symbol before differentiation. Code generation then inserts the numbers, proofs insert
their exact values as fractions, and both use the same derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cached_property

import sympy

from hamsym.formula.parser import MAX_EXPONENT
from hamsym.symbolic import derivatives


class ExactDerivatives:
    """H, forces, and their derivatives, with a symbol for each floating-point number.

    - expr: H.
    - z: The state.
    - effort: Limit on the size of the derivatives.
    - forces: A force for each momentum, or none.
    - expr: H with the symbols.
    - forces: With the symbols.

    Examples
    --------
    >>> x, p = sympy.symbols("x p", real=True)
    >>> expr = sympy.Float(0.1) * x**3 + p**2 / 2
    >>> found = ExactDerivatives(expr, (x, p), derivatives.Effort(expr))
    >>> found.rounded(found.gradient[0])
    0.3*x**2
    >>> found.with_fractions(found.gradient[0], {}) == 3 * fraction(sympy.Float(0.1)) * x**2
    True
    """

    def __init__(
        self,
        expr: sympy.Expr,
        z: Sequence[sympy.Symbol],
        effort: derivatives.Effort,
        forces: Sequence[sympy.Expr] = (),
    ) -> None:
        self._z, self._effort = z, effort
        floats = sympy.Tuple(expr, *forces).atoms(sympy.Float)
        self._numbers: dict[sympy.Symbol, sympy.Float] = {
            sympy.Dummy(f"number{k}", real=True, positive=bool(number > 0)): number
            for k, number in enumerate(sorted(floats, key=str))
        }
        marks = {number: symbol for symbol, number in self._numbers.items()}
        self.expr: sympy.Expr = expr.xreplace(marks) if marks else expr
        self.forces = [force.xreplace(marks) if marks else force for force in forces]

    @cached_property
    def gradient(self) -> list[sympy.Expr]:
        return derivatives.gradient(self.expr, self._z, self._effort)

    @cached_property
    def hessian(self) -> dict[tuple[int, int], sympy.Expr]:
        return derivatives.hessian(self.gradient, self._z, self._effort)

    @cached_property
    def slopes(self) -> list[sympy.Expr]:
        """g = -J dz/dt: (dH/dq - F, dH/dp), the gradient without forces."""
        forces = [*self.forces, *[sympy.Integer(0)] * (len(self.gradient) - len(self.forces))]
        return [slope - force for slope, force in zip(self.gradient, forces, strict=True)]

    @cached_property
    def vector_field(self) -> list[sympy.Expr]:
        """dz/dt."""
        half = len(self.slopes) // 2
        return [*self.slopes[half:], *(-slope for slope in self.slopes[:half])]

    @cached_property
    def curvature(self) -> dict[tuple[int, int], sympy.Expr]:
        """Nonzero derivatives of ``slopes`` by (i, j)."""
        entries = dict(self.hessian)
        acting = ((i, force) for i, force in enumerate(self.forces) if force != 0)
        for i, force in acting:
            for j, slope in enumerate(derivatives.gradient(force, self._z, self._effort)):
                if slope != 0:
                    entries[i, j] = entries.get((i, j), sympy.Integer(0)) - slope
        return {index: entries[index] for index in sorted(entries) if entries[index] != 0}

    @cached_property
    def jacobian(self) -> dict[tuple[int, int], sympy.Expr]:
        """Nonzero derivatives of the rates by the state, by (i, j)."""
        return derivatives.poisson_rows(self.curvature, len(self.gradient) // 2)

    @cached_property
    def third_derivatives(self) -> dict[tuple[int, int, int], sympy.Expr]:
        """Derivatives of ``curvature`` by (i, j, k), j <= k, that do not vanish.

        Without forces they are the third derivatives of H, i <= j <= k.
        """
        entries, effort = self.curvature, self._effort
        if not self.forces:
            entries = {(i, j): entry for (i, j), entry in self.hessian.items() if i <= j}
            effort = derivatives.Effort(self.expr)
        return {
            (i, j, k): slope
            for (i, j), entry in entries.items()
            for k, slope in enumerate(derivatives.gradient(entry, self._z, effort))
            if k >= j and slope != 0
        }

    def rounded(self, expr: sympy.Expr) -> sympy.Expr:
        """Insert the floating-point numbers into an expression, with sympy's rounding."""
        return expr.xreplace(self._numbers) if self._numbers else expr

    def with_fractions(
        self, expr: sympy.Expr, parameters: Mapping[sympy.Symbol, float]
    ) -> sympy.Expr:
        """Insert the exact values of floating-point numbers, and of parameters in exponents.

        Parameters with a value are replaced where they occur in exponents of H, because smoothness
        may depend on them: with n = 1 inserted, n*(n - 1)*x**(n - 2) is smooth at x = 0.
        """
        values = self._exponents(parameters) | self._fractions
        return expr.xreplace(values) if values else expr

    @cached_property
    def _fractions(self) -> dict[sympy.Symbol, sympy.Rational]:
        return {symbol: fraction(number) for symbol, number in self._numbers.items()}

    def _exponents(
        self, parameters: Mapping[sympy.Symbol, float]
    ) -> dict[sympy.Symbol, sympy.Rational]:
        """Values of the parameters that occur in exponents, if no exponent becomes large."""
        values = {symbol: rational(value) for symbol, value in parameters.items()}
        known = values | self._fractions
        found: set[sympy.Symbol] = set()
        refused: set[sympy.Symbol] = set()
        formulas = (self.expr, *self.forces)
        for power in {power for formula in formulas for power in formula.atoms(sympy.Pow)}:
            symbols = power.exp.free_symbols & values.keys()
            if symbols:
                exponent = power.exp.xreplace(known)
                small = exponent.is_number and abs(exponent) <= MAX_EXPONENT
                (found if small else refused).update(symbols)
        return {symbol: values[symbol] for symbol in found - refused}


def fraction(number: sympy.Float) -> sympy.Rational:
    """Convert a floating-point number to the equal binary fraction."""
    sign, mantissa, exponent, _ = number._mpf_
    value = sympy.Rational(int(mantissa)) * sympy.Integer(2) ** int(exponent)
    return -value if sign else value


def rational(value: float) -> sympy.Rational:
    """Convert a number of Python to the equal fraction."""
    return sympy.Rational(*Fraction(value).as_integer_ratio())


def without_floats(expr: sympy.Expr) -> sympy.Expr:
    """Replace floating-point numbers by the equal fractions.

    Sympy rounds products of floating-point and rational numbers.

    Examples
    --------
    >>> without_floats(sympy.Float(0.5) * sympy.Symbol("x"))
    x/2
    """
    return expr.xreplace({number: fraction(number) for number in expr.atoms(sympy.Float)})
