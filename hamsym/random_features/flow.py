"""Hamilton's equations as functions of arrays, for the march of random features."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import sympy

from hamsym.bounds.residual import is_short_polynomial
from hamsym.codegen.functions import compile_observable
from hamsym.codegen.programs import programs_of
from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel.loops import Equations as Programs
from hamsym.solution.discontinuities import has_switches, has_time_switches


@dataclass(frozen=True, eq=False)  # one object per H, so that its tables can be cached
class Flow:
    """The equation z' = F(z, t) and the functions of H that the march and its checks evaluate."""

    #: The equations for the loops over windows; they are the same for all values of parameters.
    programs: Programs
    #: Values of the parameters, shape (k,).
    parameters: np.ndarray
    #: Row and column of each second derivative of H in ``programs``, shape (entries, 2).
    entries: np.ndarray
    #: Whether each entry also stands for its mirror image, without forces.
    symmetric: bool
    #: Whether the rates are polynomials of low degree, which are resolved wherever z^ is.
    is_short_polynomial: bool
    #: (z, t, parameters=None) -> F, shapes (n, dim), (n,), (n, k) -> (n, dim).
    vector_field: Callable[..., np.ndarray]
    #: (z, t) -> dF/dz, shape (n, dim, dim).
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray]
    #: (z, t) -> H, shape (n,), where H is conserved and does not jump at the cut of an angle.
    energy: Callable[[np.ndarray, np.ndarray], np.ndarray] | None
    #: (z, t) -> sum of the sizes of the terms of H, which may cancel, shape (n,).
    energy_terms: Callable[[np.ndarray, np.ndarray], np.ndarray]
    #: Whether the time does not occur.
    autonomous: bool
    #: (z, candidates) -> those components of one state that keep exactly their values.
    resting: Callable[[np.ndarray, np.ndarray], list[int]]
    #: Whether they have abs, sign, Min or Max of the state.
    switched: bool
    #: Whether they have these, or Heaviside, of the time alone.
    switched_in_time: bool


@functools.lru_cache(maxsize=64)
def flow_of(H: Hamiltonian) -> Flow:
    """Return the flow of H."""
    at, form = H.compile("numpy").at, H.real_equations

    @functools.cache
    def terms() -> Callable[..., np.ndarray]:
        return compile_observable(_sizes_of_terms(form.expr), form)

    return Flow(
        programs_of(form),
        np.array([H.parameters[name] for name in H.parameter_names], dtype=float),
        np.array([*form.stored_curvature], dtype=np.int64).reshape(-1, 2),
        not H.forces,
        is_short_polynomial(form),
        vector_field=functools.partial(at, "vector_field"),
        jacobian=functools.partial(at, "jacobian"),
        energy=functools.partial(at, "energy") if form.has_conserved_values else None,
        energy_terms=lambda z, t: np.broadcast_to(terms()(z, t), len(z)),
        autonomous=H.time is None,
        resting=lambda z, candidates: form.resting(z.tolist(), candidates.tolist()),
        switched=has_switches(H),
        switched_in_time=has_time_switches(H),
    )


def _sizes_of_terms(expr: sympy.Expr) -> sympy.Expr:
    """The sum of the sizes of all terms, also of those in factors."""
    if expr.is_Add or expr.is_Mul:
        return expr.func(*map(_sizes_of_terms, expr.args))
    return sympy.Abs(expr)
