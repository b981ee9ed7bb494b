"""Components and formulas as functions of states and times, with what they are called.

Input:  H, and a name or a formula in its names: text or a sympy expression.
Output: an :class:`Observable`, for figures, tables, events, sections and sweeps.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_observable
from hamsym.errors import InputError
from hamsym.formula.notation import Notation
from hamsym.formula.parser import Written, canonical_name
from hamsym.support.validation import shown
from hamsym.symbolic import brackets
from hamsym.symbolic.symbolic_hamiltonian import SymbolicHamiltonian
from hamsym.symbolic.units import unit_of
from hamsym.symbolic.variables import TIME

_ENERGY = "H"


class Observable:
    """A component of z, or a formula, as a function (z, t=0.0, parameters=None) -> values.

    - place: Number of the component in z; None for a formula.
    - expr: The formula in the symbols of H.
    - function: The same in real symbols, without H.
    """

    def __init__(
        self,
        H: SymbolicHamiltonian,
        expr: sympy.Expr,
        function: sympy.Expr,
        *,
        given: str,
        place: int | None = None,
        written: Written | None = None,
    ) -> None:
        self.expr, self.function, self.place = expr, function, place
        self._H, self._given, self._written = H, given, written or {}

    def __repr__(self) -> str:
        return f"Observable({self.text!r})"

    @cached_property
    def _value(self) -> Callable[..., np.ndarray]:
        if self.place is not None:
            return _component(self.place, self._H.dim)
        return compile_observable(self.function, self._H.real_equations)

    def __call__(self, z: Any, t: Any = 0.0, parameters: np.ndarray | None = None) -> np.ndarray:
        try:
            return self._value(z, t, parameters)
        except ValueError as error:  # of generated functions, which know no errors of hamsym
            raise InputError(str(error)) from None

    def values(self, z: Any, t: Any = 0.0, parameters: np.ndarray | None = None) -> np.ndarray:
        """Values for pictures and tables; of a formula nan where it is no finite number."""
        if self.place is not None:
            return self(z, t, parameters)
        with np.errstate(all="ignore"):
            found = self(z, t, parameters)
        return np.where(np.isfinite(found), found, np.nan)

    @cached_property
    def text(self) -> str:
        """The name of a component, or the formula as given, that of sympy in the order of H."""
        return self._given or self.notation.text(self.expr)

    @cached_property
    def notation(self) -> Notation:
        """The order of the terms: as they were given, others as those of H."""
        own = self._H.notation
        return Notation({**own.written, **self._written}, own.derived)

    @property
    def latex(self) -> str:
        """The formula as LaTeX."""
        return self.notation.latex(self.expr)

    @cached_property
    def unit(self) -> str:
        """The unit; "1" for plain numbers, and where terms of different units are added."""
        if self.place is not None:
            return self._H.units.get(self.text, "1")
        return unit_of(self.function, self._H.units) if self._H.units else "1"


def observable_of(H: SymbolicHamiltonian, f: Any) -> Observable:
    """Return a component, or a formula in the names of H, as a function.

    Raise the errors of :meth:`hamsym.Hamiltonian.observable`, but none where a value is missing.

    Examples
    --------
    >>> from hamsym import Hamiltonian
    >>> H = Hamiltonian("p**2/(2*m) + k*(x - l)**2/2", parameters={"m": 1, "k": 2, "l": 1})
    >>> work = observable_of(H, "H - k*(x - l)**2/2")
    >>> work.text, work.latex, float(work([3.0, 4.0]))
    ('H - k*(x - l)**2/2', 'H - \\\\frac{k \\\\left(x - l\\\\right)^{2}}{2}', 8.0)
    """
    if not isinstance(f, (str, sympy.Expr)):
        raise InputError(
            f"{shown(f)} is neither a component nor a formula; give text in the names of H, for "
            f"example '{H.names[0]}' or '{H.names[H.dof]}**2/2', or a sympy expression"
        )
    name = f.name if isinstance(f, sympy.Symbol) else f.strip() if isinstance(f, str) else ""
    spelled = {canonical_name(own): k for k, own in enumerate(H.names)}
    place = spelled.get(canonical_name(name))
    if place is not None:
        real = H.real_equations.z[place]
        return Observable(H, H.z[place], real, place=place, given=H.names[place])
    known = (*H.names, *H.parameter_names, TIME)
    extra = () if _ENERGY in known else (_ENERGY,)
    expr, written = brackets.written_function(f, known, extra)
    energy = {sympy.Symbol(_ENERGY, real=True): H.real_equations.expr} if extra else {}
    function = expr.xreplace(energy)
    expr, written = brackets.renamed(expr, written, H.real_equations.back)
    given = " ".join(f.split()) if isinstance(f, str) else ""
    return Observable(H, expr, function, given=given, written=written)


def _component(place: int, dim: int) -> Callable[..., np.ndarray]:
    def value(z: Any, t: Any = 0.0, parameters: np.ndarray | None = None) -> np.ndarray:
        z = np.asarray(z)
        if z.shape[-1:] != (dim,):
            raise ValueError(f"z has shape {z.shape}; its last axis must have length {dim}")
        found: np.ndarray = (z if z.dtype.kind == "f" else z.astype(float))[..., place]
        return found

    return value
