"""A Hamiltonian in real symbols, which is what is differentiated and generated from."""

from __future__ import annotations

from functools import cached_property
from typing import TYPE_CHECKING

import sympy

from hamsym import derivatives
from hamsym.symbols import real_symbols

if TYPE_CHECKING:
    from hamsym.hamiltonian import Hamiltonian

__all__ = ["RealForm"]


class RealForm:
    """H and its derivatives in symbols that are real, whatever the caller's symbols assume.

    Without that, sympy differentiates abs(x) into derivatives of re(x) and im(x).
    """

    def __init__(self, H: Hamiltonian) -> None:
        forward = real_symbols({*H.expr.free_symbols, *H.z})
        self.expr: sympy.Expr = H.expr.xreplace(forward) if forward else H.expr
        self.z = tuple(forward.get(symbol, symbol) for symbol in H.z)
        self.time = None if H.time is None else forward.get(H.time, H.time)
        self.dof = H.dof
        self.parameters = {
            name: (sympy.Symbol(name, real=True), H.parameters.get(name))
            for name in H.parameter_names
        }
        self.back = {real: own for own, real in forward.items()}
        self._effort = derivatives.Effort(self.expr)

    @cached_property
    def gradient(self) -> list[sympy.Expr]:
        return derivatives.gradient(self.expr, self.z, self._effort)

    @cached_property
    def hessian(self) -> dict[tuple[int, int], sympy.Expr]:
        return derivatives.hessian(self.gradient, self.z, self._effort)

    @cached_property
    def vector_field(self) -> list[sympy.Expr]:
        return [*self.gradient[self.dof :], *(-slope for slope in self.gradient[: self.dof])]

    @cached_property
    def is_separable(self) -> bool:
        mixed = [entry for (i, j), entry in self.hessian.items() if i < self.dof <= j]
        return all(derivatives.vanishes(entry) for entry in mixed)
