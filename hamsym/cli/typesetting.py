"""Equations as LaTeX, for papers."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING

import sympy

from hamsym.formula.notation import Notation
from hamsym.formula.parser import canonical_name
from hamsym.symbolic.equations import free_symbols

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian
    from hamsym.symbolic.lagrangian import Lagrangian

_LINE = 150  # characters of LaTeX in one line of a sum, which print as some 80
_FEW = 8  # components of a state that is written out, and of a Hessian that is a matrix

Names = dict[sympy.Symbol, str]


def aligned(H: Hamiltonian, lagrangian: Lagrangian | None = None) -> str:
    """Print H, Hamilton's equations and the Hessian as an ``align`` environment.

    It needs the package amsmath. Of a Lagrangian, L and the momenta come first. Long sums continue
    on further lines.
    """
    rows: list[list[str]] = []
    own = Notation() if lagrangian is None else lagrangian.notation
    # Greek letters as commands, which every engine of LaTeX reads.
    names = {
        symbol: sympy.latex(sympy.Symbol(canonical_name(symbol.name)))
        for symbol in {
            *H.z,
            *free_symbols((H.expr, *H.forces.values())),
            *(lagrangian.expr.free_symbols if lagrangian else ()),
        }
    }
    if lagrangian is not None:
        pairs = zip(lagrangian.q, lagrangian.velocities, strict=True)
        names |= {rate: _dotted(q, names) for q, rate in pairs}
        left = _of("L", [*lagrangian.q, *lagrangian.velocities], H.time, names)
        rows.append(_equation(left, lagrangian.expr, names, own))
        for p, momentum in zip(lagrangian.p, lagrangian.momenta, strict=True):
            rows.append(_equation(names[p], momentum, names, own))
    rows.append(_equation(_of("H", H.z, H.time, names), H.expr, names, H.notation))
    for symbol in H.p:
        if symbol.name in H.forces:
            force = H.forces[symbol.name]
            rows.append(_equation(f"F_{{{names[symbol]}}}", force, names, H.notation))
    for component, rate in zip(H.z, H.vector_field, strict=True):
        rows.append(_equation(_dotted(component, names), rate, names, H.notation))
    if H.dim <= _FEW:
        lines = (
            " & ".join(H.notation.latex(entry, symbol_names=names) for entry in row)
            for row in H.hessian.tolist()
        )
        matrix = r"\begin{pmatrix} " + r" \\ ".join(lines) + r" \end{pmatrix}"
        rows.append([rf"\nabla^{{2}} H &= {matrix}"])
    else:
        rows += _entries(H, names)
    body = ", \\\\\n".join(" \\\\\n".join(row) for row in rows)
    return f"\\begin{{align}}\n{body}.\n\\end{{align}}"


def _of(name: str, symbols: Sequence[sympy.Symbol], time: sympy.Symbol | None, names: Names) -> str:
    """A function with its arguments, unless they are many."""
    if len(symbols) > _FEW:
        return name
    return f"{name}({', '.join(names[symbol] for symbol in [*symbols, *([time] if time else [])])})"


def _dotted(symbol: sympy.Symbol, names: Names) -> str:
    letter, index, rest = names[symbol].partition("_{")
    return rf"\dot{{{letter}}}{index}{rest}"


def _equation(left: str, right: sympy.Expr, names: Names, notation: Notation) -> list[str]:
    """Lines of an equation; a long sum is broken between its terms."""
    lines, line = [], f"{left} &= "
    start = True
    for term in notation.terms(right):
        text = notation.latex(term, symbol_names=names)
        if not start and len(line) + len(text) > _LINE:
            lines.append(line.rstrip())
            line = r"&\quad " if text.startswith("-") else r"&\quad {}+ "
            start = True
        elif not start:
            line += " " if text.startswith("-") else " + "
        line += f"- {text[1:].lstrip()}" if text.startswith("-") and not start else text
        start = False
    return [*lines, line]


def _entries(H: Hamiltonian, names: Names) -> Iterator[list[str]]:
    """The nonzero second derivatives, one equation each."""
    for (i, j), entry in sorted(H.hessian.todok().items()):
        if i <= j:
            one, other = names[H.z[i]], names[H.z[j]]
            last = rf"{{{one}}}^{{2}}" if i == j else rf"{one}\, \partial {other}"
            yield _equation(
                rf"\frac{{\partial^{{2}} H}}{{\partial {last}}}", entry, names, H.notation
            )
