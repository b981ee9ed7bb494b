"""Equations as MathML, which browsers and readers of HTML show without a script or a font."""

from __future__ import annotations

import html
import re
from typing import Any

import sympy
from sympy.printing.mathml import MathMLPresentationPrinter

from hamsym.formula.notation import Notation
from hamsym.formula.printer import exact_decimal

_LONGEST = 10**7  # fractions up to here stay fractions if no decimal equals them
_MARKUP = "lt|gt|amp|quot"


class _Printer(MathMLPresentationPrinter):  # type: ignore[misc]
    """Presentation MathML with sums in the order of a notation and decimals as decimals."""

    def __init__(self, notation: Notation) -> None:
        super().__init__({"mat_delim": ""})
        self._notation = notation

    def _as_ordered_terms(self, expr: sympy.Expr, order: Any = None) -> list[sympy.Expr]:
        return self._notation.terms(expr)

    def _print_Symbol(self, symbol: sympy.Symbol, style: str = "plain") -> Any:
        # sympy writes names as they are.
        return super()._print_Symbol(sympy.Symbol(html.escape(symbol.name)), style)

    def _print_Float(self, number: sympy.Float) -> Any:
        return self._decimal(float(number))

    def _print_Exp1(self, _: Any) -> Any:
        return self._text("mi", "e")

    def _print_Pow(self, expr: sympy.Expr) -> Any:
        power = super()._print_Pow(expr)
        base = power.firstChild
        if power.tagName != "msup" or base.tagName != "msub":
            return power
        # The exponent above the index, not behind it.
        parts = (*base.childNodes, power.lastChild)
        return self._element("msubsup", *(part.cloneNode(True) for part in parts))

    def _print_Derivative(self, expr: sympy.Derivative) -> Any:
        if len(expr.variables) > 1 or not expr.expr.is_Symbol:
            return super()._print_Derivative(expr)
        parts = (expr.expr, expr.variables[0])
        rows = (self._element("mrow", self._text("mi", "d"), self._print(p)) for p in parts)
        return self._element("mfrac", *rows)

    def _print_Heaviside(self, expr: sympy.Expr) -> Any:
        return self._called("Θ", expr.args[0])

    def _print_atan2(self, expr: sympy.Expr) -> Any:
        return self._called("atan2", *expr.args)

    def _called(self, name: str, *arguments: sympy.Expr) -> Any:
        within = self._paren_comma_separated(*arguments)
        return self._element("mrow", self._text("mi", name), within)

    def _decimal(self, value: float) -> Any:
        mantissa, _, exponent = repr(abs(value)).partition("e")
        parts = [self._text("mo", "−")] if value < 0 else []
        parts.append(self._text("mn", mantissa.removesuffix(".0")))
        if exponent:
            exponent = exponent.lstrip("+0").replace("-0", "-").replace("-", "−")
            ten, raised = self._text("mn", "10"), self._text("mn", exponent)
            parts += [self._text("mo", "·"), self._element("msup", ten, raised)]
        return self._element("mrow", *parts)

    def _text(self, tag: str, text: str) -> Any:
        return self._element(tag, self.dom.createTextNode(text))

    def _element(self, tag: str, *parts: Any) -> Any:
        element = self.dom.createElement(tag)
        for part in parts:
            element.appendChild(part)
        return element


def mathml(expr: sympy.Basic, notation: Notation | None = None) -> str:
    """Return an expression as presentation MathML, without the element ``math`` around it.

    Brackets of matrices are left to the style sheet, since they need a font for mathematics.

    Examples
    --------
    >>> mathml(sympy.Symbol("p_theta") / 2)
    '<mrow><mfrac><msub><mi>p</mi><mi>&#952;</mi></msub><mn>2</mn></mfrac></mrow>'
    """
    text = _Printer(notation or Notation()).doprint(_with_decimals(expr))
    # Entities of HTML are not those of XML, and a hyphen is no minus.
    pattern = rf"&(?!(?:{_MARKUP});)[A-Za-z]+;"
    text = re.sub(pattern, lambda found: html.unescape(found[0]), text)
    return text.replace("<mo>-</mo>", "<mo>−</mo>")


def equation(left: str, right: sympy.Expr, notation: Notation) -> list[str]:
    """Return an equation as pieces of MathML, between which a line may end.

    - left: MathML of the left-hand side.
    - right: A sum becomes a piece for each of its terms.

    Examples
    --------
    >>> x, p = sympy.symbols("x p")
    >>> len(equation("<mi>H</mi>", p**2 / 2 + x**2 / 2 - x, Notation()))
    3
    """
    pieces = []
    for position, term in enumerate(notation.terms(right)):
        minus = bool(position) and term.could_extract_minus_sign()
        start = (
            f"{left}<mo>=</mo>"
            if not position
            else f'<mo form="infix">{"−" if minus else "+"}</mo>'
        )
        pieces.append(f"<mrow>{start}{mathml(-term if minus else term, notation)}</mrow>")
    return pieces


def derivative(symbol: sympy.Symbol) -> str:
    """Return MathML of the time derivative of a component."""
    return (
        f"<mfrac><mrow><mi>d</mi>{mathml(symbol)}</mrow><mrow><mi>d</mi><mi>t</mi></mrow></mfrac>"
    )


def second_derivative(one: sympy.Symbol, other: sympy.Symbol) -> str:
    """Return MathML of a second derivative of H."""
    above = "<mrow><msup><mo>∂</mo><mn>2</mn></msup><mi>H</mi></mrow>"
    below = f"<mo>∂</mo>{mathml(one)}<mo>∂</mo>{mathml(other)}"
    if one == other:
        below = f"<mo>∂</mo><msup>{mathml(one)}<mn>2</mn></msup>"
    return f"<mfrac>{above}<mrow>{below}</mrow></mfrac>"


def _with_decimals(expr: Any) -> Any:
    """Write long fractions as decimals, those without an exact one rounded to ten digits."""
    decimals = {}
    for number in expr.atoms(sympy.Rational):
        if exact := exact_decimal(number):
            decimals[number] = sympy.Float(exact, 17)
        elif number.q != 1 and max(abs(number.p), number.q) > _LONGEST:
            decimals[number] = sympy.Float(f"{float(number):.10g}", 17)
    return expr.xreplace(decimals) if decimals else expr
