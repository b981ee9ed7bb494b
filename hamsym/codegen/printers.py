"""Printers of expressions for torch, numpy and numba."""

from __future__ import annotations

import math
from collections.abc import Mapping

import sympy

from hamsym.formula.printer import _ATOM, _COMMON, _MUL, _POW, Printer, _table

_HALF_INTEGERS = tuple(kind(k) / 2 for k in (3, 5, 7) for kind in (sympy.Integer, sympy.Float))

__all__ = ["NUMPY_DEFINITIONS", "PRINTERS", "NumbaPrinter", "NumpyPrinter", "TorchPrinter"]


class TorchPrinter(Printer):
    """Printer of torch code for tensors ``z`` of shape (..., dim).

    Torch functions reject Python numbers, and some reject a mixture of numbers and tensors. An
    argument that does not depend on the state is therefore expanded to the shape of the batch.
    """

    backend = "torch"
    functions = _table("torch.{}", abs="torch.abs", min="torch.minimum", max="torch.maximum")
    sqrt = "torch.sqrt"

    def __init__(
        self, names: Mapping[sympy.Symbol, str], state: frozenset[sympy.Symbol], like: str
    ) -> None:
        super().__init__(names)
        self.state, self.like = state, like

    def argument(self, expr: sympy.Expr) -> str:
        return self.spread(expr)

    def spread(self, expr: sympy.Expr) -> str:
        """Print an expression, expanded to the batch's shape, dtype and device."""
        expr = self.lower(expr)
        if expr == 0:
            return f"torch.zeros_like({self.like})"
        if expr == 1:
            return f"torch.ones_like({self.like})"
        if not expr.free_symbols & self.state:
            return f"{self._wrapped(expr, _MUL)}*torch.ones_like({self.like})"
        return self._render(expr)[0]


class NumpyPrinter(Printer):
    """Printer of numpy code for arrays that broadcast."""

    backend = "numpy"
    functions = _table(
        "np.{}",
        **{name: f"np.arc{name[1:]}" for name in _COMMON if name[0] == "a"},
        abs="np.abs",
        min="np.minimum",
        max="np.maximum",
        erf="_erf",
    )
    sqrt = "np.sqrt"

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        # numpy computes squares fast and every other integer power slowly.
        if base.is_Symbol and exponent in (3, 4):
            name = self.names[base]
            return (f"{name}*{name}**2", _MUL) if exponent == 3 else (f"({name}**2)**2", _POW)
        return super().power(base, exponent)


class NumbaPrinter(Printer):
    """Printer of scalar code for numba's compiled loops."""

    backend = "numba"
    functions = _table("math.{}", sign="np.sign", abs="abs", min="np.minimum", max="np.maximum")
    sqrt = "math.sqrt"

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        # A square root is ten times faster than a general power.
        if exponent in _HALF_INTEGERS:
            factor = self._wrapped(base, _ATOM)
            factor = factor if exponent < 2 else f"{factor}**{math.floor(exponent)}"
            return f"{factor}*{self.sqrt}({self.argument(base)})", _MUL
        return super().power(base, exponent)


#: Functions that numpy lacks, with the name and the definition that its modules give them.
NUMPY_DEFINITIONS: dict[type, tuple[str, str]] = {
    sympy.erf: ("_erf", "np.vectorize(math.erf, otypes=[float])"),
}

#: Printer class of each backend.
PRINTERS: dict[str, type[Printer]] = {
    "torch": TorchPrinter,
    "numpy": NumpyPrinter,
    "numba": NumbaPrinter,
}
