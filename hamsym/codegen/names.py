"""Identifiers of the generated code, without collisions with other names in it."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import sympy

from hamsym.codegen.backends import BACKENDS
from hamsym.formula.parser import canonical_name
from hamsym.symbolic.equations import Equations


class Names:
    """Identifiers: the user's names, with an underscore appended to reserved ones."""

    def __init__(self, form: Equations, backend: str = "numpy") -> None:
        self._backend = BACKENDS[backend]
        self._taken: set[str] = set(self._backend.reserved)
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

    @property
    def keywords(self) -> str:
        """The parameters in a signature, with their values."""
        given = [name if value is None else f"{name}={value!r}" for name, value in self.parameters]
        return ", *, " + ", ".join(given) if given else ""

    def _claim(self, symbol: sympy.Symbol) -> str:
        name = canonical_name(symbol.name) if self._backend.spells_greek else symbol.name
        self.of[symbol] = self._unused(name)
        return self.of[symbol]

    def _unused(self, name: str) -> str:
        while name in self._taken:
            name += "_"
        self._taken |= {name}
        return name

    def temporaries(self, letter: str = "u") -> Iterator[sympy.Symbol]:
        """Yield symbols u0, u1, ... that differ from all names of the user."""
        for number in itertools.count():
            if f"{letter}{number}" not in self._taken:
                yield sympy.Symbol(f"{letter}{number}", real=True)
