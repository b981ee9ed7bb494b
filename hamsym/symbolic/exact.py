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

__all__ = ["ExactDerivatives", "fraction"]


class ExactDerivatives:
    """H, its gradient and its Hessian, with a symbol for each floating-point number.

    Parameters
    ----------
    expr : sympy.Expr
        H.
    z : sequence of sympy.Symbol
        The state.
    effort : Effort
        Limit on the size of the derivatives.

    Attributes
    ----------
    expr : sympy.Expr
        H with the symbols.
    gradient : list of sympy.Expr
    hessian : dict of (int, int) to sympy.Expr

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
        self, expr: sympy.Expr, z: Sequence[sympy.Symbol], effort: derivatives.Effort
    ) -> None:
        self._z, self._effort = z, effort
        self._numbers: dict[sympy.Symbol, sympy.Float] = {
            sympy.Dummy(f"number{k}", real=True, positive=bool(number > 0)): number
            for k, number in enumerate(sorted(expr.atoms(sympy.Float), key=str))
        }
        marks = {number: symbol for symbol, number in self._numbers.items()}
        self.expr: sympy.Expr = expr.xreplace(marks) if marks else expr

    @cached_property
    def gradient(self) -> list[sympy.Expr]:
        return derivatives.gradient(self.expr, self._z, self._effort)

    @cached_property
    def hessian(self) -> dict[tuple[int, int], sympy.Expr]:
        return derivatives.hessian(self.gradient, self._z, self._effort)

    @cached_property
    def third_derivatives(self) -> dict[tuple[int, int, int], sympy.Expr]:
        """Third derivatives by (i, j, k), i <= j <= k, that do not vanish."""
        effort = derivatives.Effort(self.expr)
        found = {}
        for (i, j), entry in self.hessian.items():
            slopes = derivatives.gradient(entry, self._z, effort) if i <= j else []
            for k, slope in enumerate(slopes):
                if k >= j and slope != 0:
                    found[i, j, k] = slope
        return found

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
        values = {symbol: _rational(value) for symbol, value in parameters.items()}
        known = values | self._fractions
        found: set[sympy.Symbol] = set()
        refused: set[sympy.Symbol] = set()
        for power in self.expr.atoms(sympy.Pow):
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


def _rational(value: float) -> sympy.Rational:
    return sympy.Rational(*Fraction(value).as_integer_ratio())
