"""Identifiers of the generated code, without collisions with other names in it."""

from __future__ import annotations

import builtins
import keyword
from collections.abc import Iterator

import sympy

from hamsym.codegen.printers import NUMPY_DEFINITIONS
from hamsym.symbolic.equations import Equations

FUNCTIONS = ("energy", "gradient", "vector_field", "hessian", "residual", "loss")

# Names in generated functions other than those of the state and the parameters.
RESERVED = frozenset(
    """
    torch np math z dz t out zero rows matrix entries positions value energy_0 energy_weight
    energy_error point times parameters coordinates momenta slopes mixed DIM _ _floating
    row weight terms weights _evaluate _energy _gradient _vector_field _hessian
    """.split()
) | frozenset((*FUNCTIONS, *(name for name, _ in NUMPY_DEFINITIONS.values())))


class Names:
    """Identifiers: the user's names, with an underscore appended to reserved ones."""

    def __init__(self, form: Equations) -> None:
        self._taken = RESERVED | set(dir(builtins)) | set(keyword.kwlist)
        self.of: dict[sympy.Symbol, str] = {}
        if form.time is not None:
            self.of[form.time] = "t"  # reserved for the time, which this symbol is
        self.time = form.time is not None
        self.state = [self._claim(symbol) for symbol in form.z]
        self.parameters = [
            (self._claim(symbol), value) for symbol, value in form.parameters.values()
        ]
        self.derivatives = [self._unused("d" + name) for name in self.state]
        self.arithmetic = self._unused("a")  # the first argument of functions of balls

    def _claim(self, symbol: sympy.Symbol) -> str:
        self.of[symbol] = self._unused(symbol.name)
        return self.of[symbol]

    def _unused(self, name: str) -> str:
        while name in self._taken:
            name += "_"
        self._taken |= {name}
        return name

    def temporaries(self, letter: str = "u") -> Iterator[sympy.Symbol]:
        """Yield symbols u0, u1, ... that differ from all names of the user."""
        for number in range(10**9):
            if f"{letter}{number}" not in self._taken:
                yield sympy.Symbol(f"{letter}{number}", real=True)
        raise AssertionError("unreachable")
