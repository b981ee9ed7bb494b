"""Bodies of the generated functions: expressions as text, common subexpressions taken out."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from hamsym.codegen.names import Names
from hamsym.codegen.printers import PRINTERS, TorchPrinter
from hamsym.formula.printer import Printer
from hamsym.symbolic import derivatives
from hamsym.symbolic.equations import Equations

# Common subexpressions are taken out of a function with more operations than this, if that saves
# at least a third of them; smaller functions read better without temporaries.
_CSE_OPERATIONS = 30


_CSE_SAVING = 0.67


@dataclass(frozen=True)
class Body:
    """Text of a function's computation: temporaries in order, then the results."""

    temporaries: list[tuple[str, str]]
    results: list[str]


class Bodies:
    """The computation of every generated function, as text."""

    def __init__(self, form: Equations, names: Names, backend: str) -> None:
        self._names, self._backend = names, backend
        self._state = frozenset(form.z)
        d, gradient = form.dof, form.gradient
        self.energy = self._body([form.expr])
        self.gradient = self._body(gradient)
        self.vector_field = self._body(form.vector_field)
        self.hessian = self._body(list(form.hessian.values()))
        self.residual = self._residual_rows(form.vector_field)
        if backend != "numba":
            return
        # The step loops: dH/dp and dH/dq, by themselves and with what their derivatives need.
        kinetic = {
            (i - d, j - d): entry for (i, j), entry in form.hessian.items() if min(i, j) >= d
        }
        potential = {index: entry for index, entry in form.hessian.items() if max(index) < d}
        mixed = {(i - d, j): entry for (i, j), entry in form.hessian.items() if j < d <= i}
        self.kinetic_indices, self.potential_indices = list(kinetic), list(potential)
        self.mixed_indices = list(mixed)
        self.velocity = self._body(gradient[d:])
        self.force = self._body(gradient[:d])
        if form.is_separable:
            self.velocity_curvature = self._body([*gradient[d:], *kinetic.values()])
            self.force_curvature = self._body([*gradient[:d], *potential.values()])
        else:
            self.velocity_jacobian = self._body([*gradient[d:], *mixed.values()])
            self.force_jacobian = self._body([*gradient[:d], *mixed.values()])

    def by_name(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    def _printer(self, state: Iterable[sympy.Symbol], names: dict[sympy.Symbol, str]) -> Printer:
        if self._backend == "torch":
            return TorchPrinter(names, frozenset(state), self._names.state[0])
        return PRINTERS[self._backend](names)

    def _body(self, exprs: Sequence[sympy.Expr]) -> Body:
        names, state = dict(self._names.of), set(self._state)
        printer = self._printer(state, names)
        exprs = [printer.lower(expr) for expr in exprs]
        replacements, exprs = _common_subexpressions(exprs, self._names.temporaries())
        temporaries = []
        for symbol, expr in replacements:
            temporaries.append((symbol.name, printer(expr)))
            names[symbol] = symbol.name
            if expr.free_symbols & state:
                state.add(symbol)
            printer = self._printer(state, names)
        text = printer.spread if isinstance(printer, TorchPrinter) else printer
        return Body(temporaries, [text(expr) for expr in exprs])

    def _residual_rows(self, vector_field: Sequence[sympy.Expr]) -> list[str]:
        """Rows of the residual with the derivative first, such as ``"dp + x + x**3"``."""
        printer = self._printer(self._state, self._names.of)
        rows = []
        for name, rate in zip(self._names.derivatives, vector_field, strict=True):
            text = printer(-rate)
            if rate == 0:
                text = ""
            elif text.startswith("-"):
                text = f" - {text[1:]}"
            else:
                text = f" + {text}"
            rows.append(name + text)
        return rows


def _common_subexpressions(
    exprs: list[sympy.Expr], symbols: Iterator[sympy.Symbol]
) -> tuple[list[tuple[sympy.Symbol, sympy.Expr]], list[sympy.Expr]]:
    if not _has_operations(exprs, _CSE_OPERATIONS + 1):
        return [], exprs
    replacements, shorter = derivatives.common_subexpressions(exprs, symbols)
    after = sum(int(sympy.count_ops(expr)) for _, expr in replacements)
    after += sum(int(sympy.count_ops(expr)) for expr in shorter)
    saved = _has_operations(exprs, after / _CSE_SAVING)
    return (replacements, shorter) if saved else ([], exprs)


def _has_operations(exprs: Sequence[sympy.Expr], count: float) -> bool:
    """Whether expressions have so many operations; counting further would cost as much again."""
    total = 0
    for expr in exprs:
        total += int(sympy.count_ops(expr))
        if total >= count:
            return True
    return False
