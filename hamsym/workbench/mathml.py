"""Equations as MathML, which browsers and readers of HTML show without a script or a font.

H, its forces, its equations of motion and its Hessian are lines of it.
"""

from __future__ import annotations

import html
import re
from typing import Any

import sympy
from markupsafe import Markup
from sympy.printing.mathml import MathMLPresentationPrinter

from hamsym.formula.notation import Notation
from hamsym.formula.printer import exact_decimal
from hamsym.hamiltonian import Hamiltonian

_LONGEST = 10**7  # fractions up to here stay fractions if no decimal equals them
_MARKUP = "lt|gt|amp|quot"
_MATRIX = 8  # components of a Hessian that is shown as a matrix
_LONG = 2_000  # operations of a formula beyond which it is shown as text
_MOST_TEXT = 4_000  # characters of it that are shown
_MOST_ENTRIES = 60  # of a Hessian that are shown


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


# -- lines of a page -------------------------------------------------------------------------------


def _math(pieces: list[str] | str) -> Markup:
    """Return elements ``math``; lines may end between them."""
    pieces = [pieces] if isinstance(pieces, str) else pieces
    return Markup(" ".join(f'<math displaystyle="true">{piece}</math>' for piece in pieces))


def equations(H: Hamiltonian) -> dict[str, Any]:
    """Return H, the forces, the equations of motion and the Hessian as MathML, or as text."""
    left = "<mi>H</mi>"
    return {
        "H": _shown(left, H.expr, H.notation),
        "forces": [
            _shown(f"<msub><mi>F</mi>{mathml(p)}</msub>", H.forces[p.name], H.notation)
            for p in H.p
            if p.name in H.forces
        ],
        "rates": [
            _shown(derivative(symbol), rate, H.notation)
            for symbol, rate in zip(H.z, H.vector_field, strict=True)
        ],
        **_hessian(H),
    }


def _shown(left: str, right: sympy.Expr, notation: Notation) -> Markup:
    """An equation; its right-hand side as text if it is long."""
    if right.count_ops() > _LONG:
        text = notation.text(right)
        short = text if len(text) <= _MOST_TEXT else f"{text[:_MOST_TEXT]} ..."
        return Markup(
            f"{_math(f'<mrow>{left}<mo>=</mo></mrow>')} <code>{Markup.escape(short)}</code>"
        )
    return _math(equation(left, right, notation))


def _hessian(H: Hamiltonian) -> dict[str, Any]:
    matrix = H.hessian
    entries = {(i, j): entry for (i, j), entry in matrix.todok().items() if i <= j and entry != 0}
    ops = sum(int(entry.count_ops()) for entry in entries.values())
    if H.dim <= _MATRIX and ops <= _LONG / 8:
        left = "<mrow><msup><mo>∇</mo><mn>2</mn></msup><mi>H</mi><mo>=</mo></mrow>"
        return {
            "matrix": _math(f"<mrow>{left}{mathml(matrix, H.notation)}</mrow>"),
            "entries": [],
            "more": 0,
        }
    chosen = sorted(entries.items())[:_MOST_ENTRIES]
    rows = [
        _shown(second_derivative(H.z[i], H.z[j]), entry, H.notation) for (i, j), entry in chosen
    ]
    return {"matrix": "", "entries": rows, "more": len(entries) - len(rows)}
