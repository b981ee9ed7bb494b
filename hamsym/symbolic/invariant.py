"""Invariants that were found: a function that is conserved, and a list of them.

Input:  the functions that :func:`hamsym.symbolic.invariants.find_invariants` has proven.
Output: their formulas, texts and tables.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import sympy

from hamsym.formula.printer import FormulaPrinter
from hamsym.support.shown import Shown
from hamsym.support.suggestions import suggest_attributes


@dataclass(frozen=True)
class Invariant(Shown):
    """A first integral of a Hamiltonian, from :meth:`hamsym.Hamiltonian.invariants`.

    Attributes
    ----------
    expr : sympy.Expr
        The function, in the symbols of H.
    degree : int
        Its degree in the state and the basis functions together.
    independent : bool
        Whether its gradient is independent of those of H and of the invariants before it, at a
        random point.
    holds_for : mapping of str to float
        Values of parameters for which alone it was found to be invariant; empty if it is for all.

    Examples
    --------
    >>> import hamsym
    >>> found = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)**2").invariants()
    >>> print(found[0])
    p_x*y - p_y*x
    """

    expr: sympy.Expr
    degree: int
    independent: bool = True
    holds_for: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def formula(self) -> str:
        """The function as text that is parsed to it again."""
        return FormulaPrinter()(self.expr)

    def __repr__(self) -> str:
        return f"Invariant({str(self)!r}, degree {self.degree})"

    def __str__(self) -> str:
        values = ", ".join(f"{name} = {value!r}" for name, value in self.holds_for.items())
        return self.formula + (f"   (for {values})" if values else "")

    def _repr_latex_(self) -> str:
        return rf"$\displaystyle {sympy.latex(self.expr)}$"

    def __hash__(self) -> int:
        return hash((self.expr, tuple(sorted(self.holds_for.items()))))

    def __reduce__(self) -> tuple[Any, ...]:
        return _invariant, (self.expr, self.degree, self.independent, dict(self.holds_for))


def _invariant(
    expr: sympy.Expr, degree: int, independent: bool, values: dict[str, float]
) -> Invariant:
    return Invariant(expr, degree, independent, MappingProxyType(values))


@suggest_attributes
class Invariants(Shown, list[Invariant]):
    """The invariants of a Hamiltonian, a list; printed, it is a table.

    Each is proven: {f, H} + (partial f)/(partial t) = 0 by exact arithmetic.

    Attributes
    ----------
    degree : int
        Largest degree of the search.
    conserves_energy : bool
        Whether H itself is an invariant, which the list leaves out.

    Examples
    --------
    >>> import hamsym
    >>> H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2")
    >>> print(H.invariants())
         degree  independent  formula
    I_1       2          yes  p_x**2 + x**2
    I_2       2          yes  p_x*p_y + x*y
    I_3       2           no  p_x*y - p_y*x
    <BLANKLINE>
    each is proven in exact arithmetic, {f, H} = 0; others may exist beyond degree 2
    """

    def __init__(
        self, found: Iterable[Invariant] = (), degree: int = 0, conserves_energy: bool = True
    ) -> None:
        super().__init__(found)
        self.degree, self.conserves_energy = degree, conserves_energy

    @property
    def message(self) -> str:
        """What was found, and what that says about others."""
        if self:
            law = "{f, H} = 0" if self.conserves_energy else "{f, H} + df/dt = 0"
            return (
                f"each is proven in exact arithmetic, {law}; others may exist beyond degree "
                f"{self.degree}"
            )
        beside = " beside H" if self.conserves_energy else ""
        return (
            f"no invariant of degree at most {self.degree} was found{beside}; others may exist, "
            "and this is no proof of chaos"
        )

    def __str__(self) -> str:
        return self.summary()
