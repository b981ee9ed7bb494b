"""Formulas: a list of equations that notebooks typeset."""

from __future__ import annotations

from collections.abc import Iterable

import sympy

from hamsym.support.shown import Shown


class Formulas(Shown, list[sympy.Eq]):
    """A list of equations, one below the other in notebooks.

    Examples
    --------
    >>> x, p = sympy.symbols("x p")
    >>> print(Formulas([sympy.Eq(x, p)])._repr_latex_())
    $\\displaystyle \\begin{aligned}x &= p\\end{aligned}$
    """

    def _repr_latex_(self) -> str:
        return aligned((sympy.latex(each.lhs), each.rhs) for each in self)


def aligned(equations: Iterable[tuple[str, sympy.Expr]]) -> str:
    """Return pairs of a left side in LaTeX and an expression as lines in MathJax."""
    lines = r" \\ ".join(f"{left} &= {sympy.latex(right)}" for left, right in equations)
    return rf"$\displaystyle \begin{{aligned}}{lines}\end{{aligned}}$"
