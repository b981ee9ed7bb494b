"""H, its forces, its equations of motion and its Hessian as lines of MathML."""

from __future__ import annotations

from typing import Any

import sympy
from markupsafe import Markup

from hamsym.formula.notation import Notation
from hamsym.hamiltonian import Hamiltonian
from hamsym.workbench.mathml import derivative, equation, mathml, second_derivative

_MATRIX = 8  # components of a Hessian that is shown as a matrix
_LONG = 2_000  # operations of a formula beyond which it is shown as text
_LONGEST = 4_000  # characters of it that are shown
_MOST_ENTRIES = 60  # of a Hessian that are shown


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
        short = text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
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
