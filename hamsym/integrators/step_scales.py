"""Scales of the functions in the force, and of the linear motion, against steps.

Where the argument of every function in F changes little over some steps, F has no feature that is
narrower than these steps: a polynomial of low degree, composed with such functions, is resolved by
the states alone. Nor has it much round-off of its own, unless the terms of an argument cancel.
"""

from __future__ import annotations

import enum
from collections.abc import Sequence

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic.equations import Equations

_HIGHEST = 6  # power that a few steps resolve
_STEEPEST = 24  # negative or fractional power of a base that changes by the largest ratio
_LARGEST_RATIO = 2.0  # of an argument over a few steps, of functions of RATIO
_CANCELLED = 1e4  # largest sum of the magnitudes of terms of an argument


class Scale(enum.Enum):
    """How far an argument may change over steps that resolve its function.

    ENTIRE functions have no poles, STRIP functions have poles at a distance of 1 or more from the
    real axis, and functions of RATIO vary on the scale of their argument.
    """

    ENTIRE = 4.0
    STRIP = 1.0
    RATIO = _LARGEST_RATIO


_SCALES = {
    **dict.fromkeys((sympy.exp, sympy.sin, sympy.cos, sympy.sinh, sympy.cosh), Scale.ENTIRE),
    **dict.fromkeys((sympy.tanh, sympy.sech, sympy.atan, sympy.asinh, sympy.erf), Scale.STRIP),
    **dict.fromkeys((sympy.log, sympy.Abs, sympy.sign, sympy.Heaviside), Scale.RATIO),
}


class StepScales:
    """Tests of blocks of steps."""

    def __init__(self, equations: Equations) -> None:
        variables = [*equations.z, *([] if equations.time is None else [equations.time])]
        found = _arguments(equations.vector_field, variables)
        self._scales = None if found is None else [scale for _, scale in found]
        self._arguments = compile_expressions([g for g, _ in found or []], equations)
        terms = [_magnitude(g) for g, _ in found or [] if _cancels(g)]
        self._terms = compile_expressions(terms, equations)
        switches = [switch for switch, _ in equations.switches(variables)]
        self._switches = compile_expressions(switches, equations)

    def resolved(
        self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None, blocks: np.ndarray
    ) -> np.ndarray:
        """Whether every argument changes little over blocks of states, shape (n, blocks).

        - z, t, parameters: States, shape (n, times, dim), times, and values of each trajectory,
          shape (n, k).
        - blocks: Indices of the states of each block, shape (blocks, m).
        """
        if self._scales is None:
            return np.zeros((len(z), len(blocks)), dtype=bool)
        own = None if parameters is None else parameters[:, None]
        g = self._arguments(z, t, own)
        found = np.ones((len(z), len(blocks)), dtype=bool)
        states = np.ascontiguousarray(blocks.T)  # long rows have their largest values sooner
        for k, scale in enumerate(self._scales):
            values = g[:, states, k]
            high, low = values.max(axis=1), values.min(axis=1)
            if scale is Scale.RATIO:
                sizes = np.abs(high), np.abs(low)
                found &= np.maximum(*sizes) <= scale.value * np.minimum(*sizes)
                found &= high * low > 0
            else:
                found &= high - low <= scale.value
        terms = self._terms(z[:, blocks[:, 0]], t[blocks[:, 0]], own)
        return found & (terms <= _CANCELLED).all(axis=2)

    def switched(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None) -> np.ndarray:
        """Whether each argument of abs, sign or similar changes its sign in each step.

        The parameters are those of :meth:`resolved`; shape (n, steps, arguments).
        """
        signs = np.sign(self._switches(z, t, None if parameters is None else parameters[:, None]))
        return np.asarray(signs[:, 1:] != signs[:, :-1])


def _arguments(
    rates: Sequence[sympy.Expr], variables: Sequence[sympy.Symbol]
) -> list[tuple[sympy.Expr, Scale]] | None:
    """Arguments of all functions in the rates; None if a scale is unknown."""
    known = set(variables)
    found: dict[tuple[sympy.Expr, Scale], None] = {}
    for rate in rates:
        for part in sympy.preorder_traversal(rate):
            if not part.free_symbols & known or not part.args or part.is_Add or part.is_Mul:
                continue
            scale = _SCALES.get(part.func)
            if part.is_Pow and not part.exp.free_symbols & known:
                if part.exp.is_Integer and 0 < part.exp <= _HIGHEST:
                    continue
                steep = not part.exp.is_number or abs(part.exp) > _STEEPEST
                steep |= bool(part.exp.is_Integer and part.exp > 0)
                scale = None if steep else Scale.RATIO
            if scale is None:
                return None
            found[part.args[0], scale] = None
    return sorted(found, key=str)


def _cancels(argument: sympy.Expr) -> bool:
    """Whether terms of an argument may have different signs."""
    sums = argument.atoms(sympy.Add)
    return any(not all(term.is_nonnegative for term in part.args) for part in sums)


def _magnitude(argument: sympy.Expr) -> sympy.Expr:
    """Sum of the magnitudes of the terms of an argument."""
    if argument.is_Add or argument.is_Mul:
        return argument.func(*(_magnitude(part) for part in argument.args))
    return sympy.Abs(argument)


# -- linear motion ---------------------------------------------------------------------------------


def fastest_rates(
    H: Hamiltonian,
    states: np.ndarray,
    times: np.ndarray | float,
    parameters: np.ndarray | None = None,
) -> np.ndarray:
    """Spectral radius of J Hess at states, per unit of time; it does not depend on units of z.

    - states: Shape (..., dim).
    - times: Broadcast with the states, shape (...).
    - parameters: Values for each state, shape (..., k), by default those of H.
    - returns: Shape (...), infinite where the Hessian is not finite.

    Examples
    --------
    >>> fastest_rates(Hamiltonian("p**2/2 + 9*x**2/2"), np.zeros((1, 2)), 0.0).round(9)
    array([3.])
    """
    matrices = H.compile("numpy").at("jacobian", states, times, parameters)
    known = np.isfinite(matrices).all(axis=(-2, -1))
    usable = np.where(known[..., None, None], matrices, 0.0)
    return np.where(known, np.abs(np.linalg.eigvals(usable)).max(axis=-1), np.inf)
