"""Known invariants of a problem: their check, their values, and their drift along trajectories.

Input:  a Hamiltonian and functions that are said to be conserved.
Output: their change along computed trajectories, and the part of it that allowed errors explain:
        errors e_i of the components change a function I by at most
        sum_i |dI/dz_i| e_i + sum_ij |d2I/dz_i dz_j| e_i e_j / 2, to second order.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np
import sympy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic.invariant import Invariant

#: Types of an invariant in arguments.
InvariantLike: TypeAlias = str | sympy.Expr | Invariant

_ROUND_OFF = 256 * 2.0**-52  # of a value, relative to the terms that make it
_ROWS = 65_536  # states that are evaluated at once


class KnownInvariants:
    """Functions that are conserved by a Hamiltonian.

    Raise InputError if one is not a function of the state, or is not conserved; the message names
    it.

    - varied: Parameters that have several values, for all of which the functions must be conserved.
    - formulas: The functions as text; texts as they were given.
    - functions: Each function as a Hamiltonian of its own, whose generated code evaluates it.

    Examples
    --------
    >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
    >>> known = KnownInvariants(H, ["x*p_y - y*p_x"])
    >>> states = np.array([[1, 0, 0, 1], [1, 0, 0, 1.5]])
    >>> change, explained = known.drifts(states[:1], 0.0, states, 0.0, 1e-3 * np.ones(4))
    >>> change, bool(explained[0, 1] > 1e-3)
    (array([[0. , 0.5]]), True)
    """

    def __init__(
        self, H: Hamiltonian, given: InvariantLike | Sequence[InvariantLike], varied: Any = ()
    ) -> None:
        if isinstance(given, (str, sympy.Expr, Invariant)):
            given = [given]
        if not isinstance(given, Sequence):
            raise InputError(
                f"invariants={given!r} cannot be used; give a list of formulas, for example "
                '["x*p_y - y*p_x"]'
            )
        self.H = H
        exprs = [f.expr if isinstance(f, Invariant) else f for f in given]
        for f in exprs:
            if not H.is_conserved(f, every=varied):
                raise InputError(
                    f"'{f}' is not an invariant: its time derivative {{f, H}} was not found to "
                    "be zero; leave it out, or see H.invariants()"
                )
        self.functions = tuple(self._function(f) for f in exprs)
        self.formulas = tuple(
            f if isinstance(f, str) else own.formula
            for f, own in zip(exprs, self.functions, strict=True)
        )

    def _function(self, f: str | sympy.Expr) -> Hamiltonian:
        H = self.H
        z = H.real_equations.z
        expr = H.function(f)
        if not expr.free_symbols & set(z):
            raise InputError(f"the invariant '{f}' does not depend on the state; leave it out")
        values = {
            n: v for n, v in H.parameters.items() if sympy.Symbol(n, real=True) in expr.free_symbols
        }
        return Hamiltonian(expr, q=z[: H.dof], p=z[H.dof :], parameters=values)

    def __repr__(self) -> str:
        return f"KnownInvariants({list(self.formulas)})"

    def __len__(self) -> int:
        return len(self.functions)

    def drifts(
        self,
        starts: np.ndarray,
        start: float,
        states: np.ndarray,
        times: Any,
        allowed: np.ndarray,
        parameters: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the changes since the start, and those that allowed errors explain.

        - starts: Initial states, shape (n, dim) or (1, dim).
        - states: Shape (n, dim).
        - times: Shape (n,).
        - allowed: Allowed errors, shape (n, dim) or (dim,).
        - parameters: Values of all parameters of H, shape (n, k) or (1, k).
        - returns change, explained: Shape (invariants, n); infinite and NaN where a value is.
        """
        change, explained = np.zeros((2, len(self), len(states)))
        times = np.broadcast_to(np.asarray(times, dtype=float), len(states))
        for first in range(0, len(states), _ROWS):
            part = slice(first, first + _ROWS)
            here = [a if len(a) == 1 or a.ndim == 1 else a[part] for a in (starts, allowed)]
            own = parameters
            if own is not None and len(own) > 1:
                own = own[part]
            for k, function in enumerate(self.functions):
                with np.errstate(all="ignore"):
                    change[k, part], explained[k, part] = self._drift(
                        function, here[0], start, states[part], times[part], here[1], own
                    )
        return change, explained

    def _drift(
        self,
        function: Hamiltonian,
        starts: np.ndarray,
        start: float,
        states: np.ndarray,
        times: np.ndarray,
        allowed: np.ndarray,
        parameters: np.ndarray | None,
    ) -> tuple[np.ndarray, np.ndarray]:
        system = function.compile("numpy")
        if parameters is not None:
            names = self.H.parameter_names
            parameters = parameters[..., [names.index(name) for name in function.parameter_names]]
        given = states, times, parameters
        first, now = system.at("energy", starts, start, parameters), system.at("energy", *given)
        slopes, curvatures = (np.abs(system.at(name, *given)) for name in ("gradient", "hessian"))
        rows = np.broadcast_to(allowed, states.shape)
        explained = (slopes * rows).sum(axis=-1)
        explained = explained + np.einsum("...ij,...i,...j->...", curvatures, rows, rows) / 2
        terms = np.abs(first) + (slopes * np.abs(states)).sum(axis=-1)
        return np.abs(now - first), explained + _ROUND_OFF * terms

    def verdict(self, change: np.ndarray, explained: np.ndarray) -> str:
        """Return why a trajectory is refused by its drifts, or "" if it is not.

        - change, explained: Of one trajectory, shape (invariants, n).
        """
        for formula, own, limit in zip(self.formulas, change, explained, strict=True):
            within = own <= limit
            if not within.all():
                place = int(np.argmin(within))
                return (
                    f"the invariant {formula} changes by {own[place]:.1e}, more than the allowed "
                    f"errors of the components explain, {limit[place]:.1e}"
                )
        return ""

    def largest(self, change: np.ndarray) -> dict[str, float]:
        """Return the largest change of each invariant; NaN counts as infinite."""
        largest = np.nan_to_num(change, nan=np.inf).max(axis=-1)
        return dict(zip(self.formulas, largest.tolist(), strict=True))
