"""First integrals along periodic orbits: their gradients at a state."""

from __future__ import annotations

import functools

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.symmetry import SignedPermutation
from hamsym.symbolic.invariants import find_invariants, suggested_basis

_DEGREE = 2  # of momenta, angular momenta and quadratic integrals
_SECONDS = 60.0  # for their search


def gradients_of_integrals(
    H: Hamiltonian, state: np.ndarray, shift: SignedPermutation
) -> np.ndarray:
    """Return gradients of H and of its further integrals at a state, shape (n, dim).

    Integrals are those that :meth:`hamsym.Hamiltonian.invariants` finds for all values of the
    parameters, and their images under a symmetry, so that it maps the span of the gradients to
    itself. Where energy is not conserved, or the search fails, there are fewer.

    - state: Shape (dim,).
    - shift: A symplectic symmetry of H.
    """
    found = []
    if H.conserves_energy:
        found.append(np.asarray(H.compile("numpy").gradient(state))[None])
    integrals = () if H.forces else _integrals(H.real_equations.expr, H.real_equations.z, H.time)
    if integrals:
        z = H.real_equations.z
        slopes = [sympy.diff(integral, symbol) for integral in integrals for symbol in z]
        function = compile_expressions(slopes, H.real_equations)
        for k in range(shift.order):
            power = shift.power(k)
            rows = np.asarray(function(power(state))).reshape(len(integrals), H.dim)
            found.append(rows @ power.matrix)
    return np.concatenate(found) if found else np.zeros((0, H.dim))


@functools.lru_cache(maxsize=64)
def _integrals(
    H: sympy.Expr, z: tuple[sympy.Symbol, ...], time: sympy.Symbol | None
) -> tuple[sympy.Expr, ...]:
    """Further integrals that do not contain the time."""
    try:
        found = find_invariants(H, z, time, {}, _DEGREE, suggested_basis(H, z), _SECONDS)
    except InputError:  # too many candidates, or a function without exact rules
        return ()
    return tuple(integral.expr for integral in found if time not in integral.expr.free_symbols)
