"""Order in which the terms of sums are displayed: as the user wrote them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy
from sympy.printing.latex import LatexPrinter

from hamsym.formula.printer import FormulaPrinter, ordered_terms

Orders = Mapping[sympy.Expr, Sequence[sympy.Expr]]


class Notation:
    """Order of the terms of sums in all that is displayed of a formula and its derivatives.

    The texts that identify a formula, in files and digests, do not depend on it; they are those of
    :class:`~hamsym.formula.printer.FormulaPrinter`.

    - written: Terms of sums in the order in which they were written, by the sum.
    - derived: The same of sums in derivatives, whose sign may be that of the product around them.

    Examples
    --------
    >>> r, l = sympy.symbols("r l")
    >>> Notation({r - l: (r, -l)}).text(-3 * (r - l) ** 3 * r)
    '-3*r*(r - l)**3'
    >>> Notation().latex(r**2 - l), Notation().latex(r / (2 * l), fold_short_frac=True)
    ('r^{2} - l', '\\\\frac{r}{2 l}')
    """

    def __init__(self, written: Orders | None = None, derived: Orders | None = None) -> None:
        self.written, self.derived = dict(written or {}), dict(derived or {})

    def terms(self, expr: sympy.Expr) -> list[sympy.Expr]:
        """Terms of a sum in order; another expression is one term."""
        if not expr.is_Add:
            return [expr]
        if expr in self.written:
            return list(self.written[expr])
        negated = [-term for term in self.written.get(-expr, ())]
        if negated and not negated[0].could_extract_minus_sign():
            return negated
        if expr in self.derived:
            return list(self.derived[expr])
        if negated := [-term for term in self.derived.get(-expr, ())]:
            return negated
        for whole in self.written.values():  # of which this may be a part, as V of H
            if set(expr.args) <= set(whole):
                return [term for term in whole if term in expr.args]
        return ordered_terms(expr)

    def with_fewer_signs(self, product: sympy.Expr) -> sympy.Expr:
        """Return a product with its minus signs in front of sums taken together, if fewer remain.

        Sums that were written keep their sign.

        Examples
        --------
        >>> a, b, c = sympy.symbols("a b c")
        >>> Notation().text(c * (-a - b)), Notation().text(-c / (-a - b + c**2))
        ('-c*(a + b)', 'c/(a + b - c**2)')
        """
        coefficient, rest = product.as_coeff_Mul()
        factors, signs, turned, mostly = [], 0, False, False
        for factor in sympy.Mul.make_args(rest):
            base, exponent = factor.as_base_exp()
            if base.is_Add and exponent.is_Integer and self._turns(base):
                below = sum(term.could_extract_minus_sign() for term in base.args)
                mostly, turned = mostly or 2 * below > len(base.args), True
                signs += int(exponent) % 2
                factor = (-base) ** exponent
            factors.append(factor)
        fewer = signs != 1 or coefficient < 0 or mostly
        if not turned or not fewer or len(factors) < 2:
            return product
        coefficient *= (-1) ** signs
        return sympy.Mul(*([] if coefficient == 1 else [coefficient]), *factors, evaluate=False)

    def _turns(self, total: sympy.Expr) -> bool:
        """Whether a sum begins with a minus sign that nobody wrote."""
        if total in self.written or -total in self.written:
            return False
        return bool(self.terms(total)[0].could_extract_minus_sign()) and not (
            self.terms(-total)[0].could_extract_minus_sign()
        )

    def text(self, expr: sympy.Expr) -> str:
        """Return a formula as text."""
        return _TextPrinter(self)(expr)

    def latex(self, expr: sympy.Basic, **settings: Any) -> str:
        """Return an expression, matrix or equation as LaTeX.

        - settings: Those of :func:`sympy.latex`.
        """
        text: str = _TypesetPrinter(self, settings).doprint(expr)
        return text


class _TextPrinter(FormulaPrinter):
    """Text for reading: k/(2*(x - 1)), not 1/2*k/(x - 1); floats as short decimals."""

    exact = False

    def __init__(self, notation: Notation) -> None:
        super().__init__()
        self._notation = notation

    def terms(self, expr: sympy.Expr) -> list[sympy.Expr]:
        return self._notation.terms(expr)

    def _product(self, expr: sympy.Expr) -> tuple[str, int]:
        return super()._product(self._notation.with_fewer_signs(expr))

    @staticmethod
    def _splits(factor: sympy.Expr) -> bool:
        return False


class _TypesetPrinter(LatexPrinter):  # type: ignore[misc]
    def __init__(self, notation: Notation, settings: Mapping[str, Any]) -> None:
        super().__init__(dict(settings))
        self._notation = notation

    def _print_Mul(self, expr: sympy.Expr) -> str:
        product, short = self._notation.with_fewer_signs(expr), self._settings["fold_short_frac"]
        if short and sympy.fraction(product)[1].is_Mul:
            self._settings["fold_short_frac"] = False  # x / 2 m could be meant either way
        text: str = super()._print_Mul(product)
        self._settings["fold_short_frac"] = short
        return text

    def _print_Derivative(self, expr: sympy.Derivative) -> str:
        if len(expr.variables) > 1 or not expr.expr.is_Symbol:
            text: str = super()._print_Derivative(expr)
            return text
        return rf"\frac{{d {self._print(expr.expr)}}}{{d {self._print(expr.variables[0])}}}"

    def _as_ordered_terms(self, expr: sympy.Expr, order: Any = None) -> list[sympy.Expr]:
        return self._notation.terms(expr)
