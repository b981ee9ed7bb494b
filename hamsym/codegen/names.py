"""Identifiers of the generated code, clear of everything else that has a name there."""

from __future__ import annotations

import builtins
import keyword
from collections.abc import Iterator

import sympy

from hamsym.symbolic.equations import Equations

FUNCTIONS = ("energy", "gradient", "vector_field", "hessian", "residual", "loss")


# Every name that a template assigns, imports or takes as an argument.
_TEMPLATE_NAMES = frozenset(
    """
    torch np math njit z dz t z0 out value matrix entries positions rows zero point points times
    energy_0 energy_weight energy_error rates states
    low columns done starts sizes first saves save_every stages terms trajectory save step step_size
    elapsed stage drift kick kicks change moved lanes low_lanes base count lane component curvature
    column row size pivot pivots old correction attempt previous scale converged between second
    right left entry factor block tangents coefficients weights weight nodes continued increments
    slopes state stale half largest at over point others fresh coupling other vectors angle
    cosine sine splitting splitting_compensated splitting_ensemble
    splitting_ensemble_compensated
    splitting_tangent symplectic_euler symplectic_euler_p implicit doubled
    """.split()
) | frozenset(FUNCTIONS)


class Names:
    """Identifiers: the user's names, with an underscore where they mean something in the code."""

    def __init__(self, form: Equations) -> None:
        self._taken = set(_TEMPLATE_NAMES) | set(dir(builtins)) | set(keyword.kwlist)
        self.of: dict[sympy.Symbol, str] = {}
        if form.time is not None:
            self.of[form.time] = "t"  # reserved for the time, which is what this symbol is
        self.time = form.time is not None
        self.state = [self._claim(symbol) for symbol in form.z]
        self.parameters = [
            (self._claim(symbol), value) for symbol, value in form.parameters.values()
        ]
        self.derivatives = [self.unused("d" + name) for name in self.state]
        self.low_parts = [self.unused(name + "_low") for name in self.state]

    def _claim(self, symbol: sympy.Symbol) -> str:
        self.of[symbol] = self.unused(symbol.name)
        return self.of[symbol]

    def unused(self, name: str) -> str:
        while name in self._taken:
            name += "_"
        self._taken.add(name)
        return name

    def temporaries(self) -> Iterator[sympy.Symbol]:
        """Endless symbols u0, u1, ... that no name of the user's collides with."""
        for number in range(10**9):
            if f"u{number}" not in self._taken:
                yield sympy.Symbol(f"u{number}", real=True)
        raise AssertionError("unreachable")
