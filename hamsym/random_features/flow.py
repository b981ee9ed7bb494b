"""Hamilton's equations as functions of arrays, for the march of random features."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
import sympy

from hamsym.bounds.vector_field import ModelField, model_field
from hamsym.hamiltonian import Hamiltonian
from hamsym.random_features.compiled_loop import PLAIN, Loops, compiled_loops, compiled_rows
from hamsym.symbolic.equations import Equations

Rows: TypeAlias = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], None]


class RowFunctions(NamedTuple):
    """Generated functions of states as rows, (states, times, parameters, out).

    States have the shape (dim, n), times (n,), parameters (k,), and out has a row for each value.

    Attributes
    ----------
    velocity, force : callable
        dq/dt and dp/dt, shape (dof, n).
    hessian : callable
        The nonzero second derivatives of H in the upper triangle, shape (entries, n); with forces
        the nonzero derivatives of dH/dq - F and dH/dp.
    """

    velocity: Rows
    force: Rows
    hessian: Rows


@dataclass(frozen=True)
class Flow:
    """The equation z' = F(z, t) and the functions of H that the march and its checks evaluate.

    Attributes
    ----------
    rows : RowFunctions
        The equations for the loops over windows.
    parameters : numpy.ndarray
        Values of the parameters, shape (k,).
    entries : numpy.ndarray
        Row and column of each value of ``rows.hessian``, shape (entries, 2).
    symmetric : bool
        Whether each entry also stands for its mirror image, without forces.
    separable : bool
        Whether dq/dt depends on p only, and dp/dt on q only, beside the time.
    vector_field : callable
        (z, t, parameters=None) -> F, shapes (n, dim), (n,), (n, k) -> (n, dim).
    jacobian : callable
        (z, t) -> dF/dz, shape (n, dim, dim).
    energy : callable, optional
        (z, t) -> H, shape (n,), where H is conserved and does not jump at the cut of an angle.
    autonomous : bool
        Whether the time does not occur.
    models : ModelField
        The equations in models, which bound the residual of windows.
    resting : callable, optional
        (z, candidates) -> those components of one state that keep exactly their values.
    rounded : bool
        Whether the formulas have numbers that float64 cannot represent.
    loops : Loops
        The loops over windows, plain or compiled.
    compiled : bool
        Whether ``rows`` and ``loops`` are compiled.
    compile : callable, optional
        Returns the flow with compiled ``rows`` and ``loops``; None if ``compiled`` is not "auto".
    """

    rows: RowFunctions
    parameters: np.ndarray
    entries: np.ndarray
    symmetric: bool
    separable: bool
    models: ModelField
    vector_field: Callable[..., np.ndarray]
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray]
    energy: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
    autonomous: bool = False
    resting: Callable[[np.ndarray, np.ndarray], list[int]] | None = None
    rounded: bool = False
    loops: Loops = PLAIN
    compiled: bool = False
    compile: Callable[[], Flow] | None = None


def flow_of(H: Hamiltonian, compiled: bool | Literal["auto"] = False) -> Flow:
    """Make the flow of H: compiled, plain, or with ``"auto"`` plain until compiling pays."""
    system = H.compile("numpy")

    def vector_field(
        z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None = None
    ) -> np.ndarray:
        given = system.keywords(parameters)
        return np.asarray(system.vector_field(*system.arguments(z, t), **given))

    def jacobian(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(system.jacobian(*system.arguments(z, t)))

    def energy(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(system.energy(*system.arguments(z, t)))

    plain = Flow(
        RowFunctions(*(system.function(f"{name}_rows") for name in RowFunctions._fields)),
        np.array([H.parameters[name] for name in H.parameter_names], dtype=float),
        stored_entries(H.real_equations),
        not H.forces,
        H.is_separable,
        model_field(H),
        vector_field,
        jacobian,
        energy=energy if has_conserved_values(H) else None,
        autonomous=H.time is None,
        resting=lambda z, candidates: H.real_equations.resting(z.tolist(), candidates.tolist()),
        rounded=any(map(has_rounded_numbers, H.real_equations.formulas)),
        compile=(lambda: _compiled(H, plain)) if compiled == "auto" else None,
    )
    return _compiled(H, plain) if compiled is True else plain


def has_conserved_values(H: Hamiltonian) -> bool:
    """Return whether values of H are constant along trajectories: no cut of an angle is in them."""
    return H.conserves_energy and not H.real_equations.has_angle_cut


def stored_entries(equations: Equations) -> np.ndarray:
    """Return row and column of the values of ``rows.hessian``, shape (entries, 2)."""
    return np.array([*equations.stored_curvature], dtype=np.int64).reshape(-1, 2)


def _compiled(H: Hamiltonian, plain: Flow) -> Flow:
    rows = RowFunctions(*(compiled_rows(H.kernels, name) for name in RowFunctions._fields))
    return replace(plain, rows=rows, loops=compiled_loops(), compiled=True, compile=None)


@functools.lru_cache(maxsize=64)
def has_rounded_numbers(expr: sympy.Expr) -> bool:
    """Return whether a formula has numbers that float64 cannot represent: pi, sqrt(2), 0.1."""
    return any(
        not isinstance(number, sympy.Rational) or number.q & (number.q - 1)
        for number in expr.atoms(sympy.Number, sympy.NumberSymbol)
        if not isinstance(number, sympy.Float)
    ) or any(power.is_number for power in expr.atoms(sympy.Pow))
