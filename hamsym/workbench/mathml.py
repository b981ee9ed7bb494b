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
_MARKUP = {"lt", "gt", "amp", "quot"}


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
        both = self.dom.createElement("msubsup")
        for part in (*base.childNodes, power.lastChild):
            both.appendChild(part.cloneNode(True))
        return both

    def _print_Derivative(self, expr: sympy.Derivative) -> Any:
        if len(expr.variables) > 1 or not expr.expr.is_Symbol:
            return super()._print_Derivative(expr)
        fraction = self.dom.createElement("mfrac")
        for part in (expr.expr, expr.variables[0]):
            row = self.dom.createElement("mrow")
            row.appendChild(self._text("mi", "d"))
            row.appendChild(self._print(part))
            fraction.appendChild(row)
        return fraction

    def _print_Heaviside(self, expr: sympy.Expr) -> Any:
        row = self.dom.createElement("mrow")
        row.appendChild(self._text("mi", "Θ"))
        row.appendChild(self._paren_comma_separated(expr.args[0]))
        return row

    def _print_atan2(self, expr: sympy.Expr) -> Any:
        row = self.dom.createElement("mrow")
        row.appendChild(self._text("mi", "atan2"))
        row.appendChild(self._paren_comma_separated(*expr.args))
        return row

    def _decimal(self, value: float) -> Any:
        mantissa, _, exponent = repr(abs(value)).partition("e")
        row = self.dom.createElement("mrow")
        if value < 0:
            row.appendChild(self._text("mo", "−"))
        row.appendChild(self._text("mn", mantissa.removesuffix(".0")))
        if exponent:
            row.appendChild(self._text("mo", "·"))
            power = self.dom.createElement("msup")
            power.appendChild(self._text("mn", "10"))
            power.appendChild(
                self._text("mn", exponent.lstrip("+0").replace("-0", "-").replace("-", "−"))
            )
            row.appendChild(power)
        return row

    def _text(self, tag: str, text: str) -> Any:
        element = self.dom.createElement(tag)
        element.appendChild(self.dom.createTextNode(text))
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
    return re.sub(r"&([A-Za-z]+);", _character, text).replace("<mo>-</mo>", "<mo>−</mo>")


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


def _character(entity: re.Match[str]) -> str:
    return entity[0] if entity[1] in _MARKUP else html.unescape(entity[0])
