"""Equations of motion and Hessian of an H, as lines of MathML."""

from __future__ import annotations

from hamsym.hamiltonian import Hamiltonian
from hamsym.workbench.mathml import derivative, mathml, second_derivative

_WIDEST = 8  # columns of a Hessian that is shown as a matrix
_MOST = 150  # entries of a list


def _math(content: str) -> str:
    return f'<div class="line"><math displaystyle="true">{content}</math></div>'


def equations(H: Hamiltonian) -> str:
    """Return H and its equations of motion, one below the other."""
    arguments = "<mo>,</mo>".join(mathml(symbol) for symbol in H.z)
    first = f"<mi>H</mi><mo>(</mo>{arguments}<mo>)</mo>" if H.dof <= 3 else "<mi>H</mi>"
    rows = [(first, mathml(H.expr, H.notation))]
    for symbol, rate in zip(H.z, H.vector_field, strict=True):
        rows.append((derivative(symbol), mathml(rate, H.notation)))
    return "".join(_math(f"<mrow>{left}<mo>=</mo>{right}</mrow>") for left, right in rows)


def hessian(H: Hamiltonian) -> str:
    """Return the Hessian: a matrix, or for many variables the entries that do not vanish."""
    if H.dim <= _WIDEST:
        name = "<msup><mo>&#8711;</mo><mn>2</mn></msup><mi>H</mi><mo>=</mo>"
        # Brackets of fonts without mathematics do not stretch; the style sheet draws them.
        rows = "".join(
            "<mtr>"
            + "".join(f"<mtd>{mathml(H.hessian[i, j], H.notation)}</mtd>" for j in range(H.dim))
            + "</mtr>"
            for i in range(H.dim)
        )
        return _math(f"<mrow>{name}<mtable>{rows}</mtable></mrow>")
    entries = [
        (H.z[i], H.z[j], H.hessian[i, j])
        for i in range(H.dim)
        for j in range(i, H.dim)
        if H.hessian[i, j] != 0
    ]
    shown = "".join(
        _math(
            f"<mrow>{second_derivative(first, second)}<mo>=</mo>{mathml(value, H.notation)}</mrow>"
        )
        for first, second, value in entries[:_MOST]
    )
    rest = len(entries) - _MOST
    return shown + (f"<p>{rest} more entries do not vanish.</p>" if rest > 0 else "")
