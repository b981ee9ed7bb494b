"""Order in which the terms of sums are displayed: as the user wrote them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import sympy
from sympy.printing.latex import LatexPrinter

from hamsym.formula.printer import FormulaPrinter, ordered_terms


class Notation:
    """Order of the terms of sums in all that is displayed of a formula and its derivatives.

    The texts that identify a formula, in files and digests, do not depend on it; they are those of
    :class:`~hamsym.formula.printer.FormulaPrinter`.

    - written: Terms of sums in the order in which they were written, by the sum.

    Examples
    --------
    >>> r, l = sympy.symbols("r l")
    >>> Notation({r - l: (r, -l)}).text(-3 * (r - l) ** 3 * r)
    '-3*r*(r - l)**3'
    >>> Notation().latex(r**2 - l)
    'r^{2} - l'
    """

    def __init__(self, written: Mapping[sympy.Expr, Sequence[sympy.Expr]] | None = None) -> None:
        self.written = dict(written or {})

    def terms(self, expr: sympy.Expr) -> list[sympy.Expr]:
        """Terms of a sum in order; another expression is one term."""
        if not expr.is_Add:
            return [expr]
        if expr in self.written:
            return list(self.written[expr])
        negated = [-term for term in self.written.get(-expr, ())]
        if negated and not negated[0].could_extract_minus_sign():
            return negated
        return ordered_terms(expr)

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
    """Text for reading: k/(2*(x - 1)), not 1/2*k/(x - 1)."""

    def __init__(self, notation: Notation) -> None:
        super().__init__()
        self._notation = notation

    def terms(self, expr: sympy.Expr) -> list[sympy.Expr]:
        return self._notation.terms(expr)

    @staticmethod
    def _splits(factor: sympy.Expr) -> bool:
        return False


class _TypesetPrinter(LatexPrinter):  # type: ignore[misc]
    def __init__(self, notation: Notation, settings: Mapping[str, Any]) -> None:
        super().__init__(dict(settings))
        self._notation = notation

    def _as_ordered_terms(self, expr: sympy.Expr, order: Any = None) -> list[sympy.Expr]:
        return self._notation.terms(expr)
