"""Tangent maps of trajectories and the multipliers of periodic ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.coefficients import Doubled
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import INTEGRATORS, usable_method
from hamsym.numerics.symplectic import poisson_matrix
from hamsym.problems.problem import checked_span
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import require_number


@suggest_attributes
@dataclass(frozen=True)
class TangentMap:
    """The derivative of the flow along a trajectory.

    Attributes
    ----------
    z0, z : numpy.ndarray
        Start and end, shape (dim,).
    matrix : numpy.ndarray
        dz/dz0, shape (dim, dim); of a period it is the monodromy matrix.
    method : str
    """

    z0: np.ndarray
    z: np.ndarray
    matrix: np.ndarray
    method: str

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the matrix, the largest first, shape (dim,), complex."""
        values = np.linalg.eigvals(self.matrix).astype(complex)
        return values[np.argsort(-np.abs(values), kind="stable")]

    @property
    def closure(self) -> float:
        """|z - z0|, the 2-norm; 0 for a closed trajectory."""
        return float(np.linalg.norm(self.z - self.z0))

    @property
    def symplecticity_error(self) -> float:
        """Largest entry of |M^T J M - J|; with forces it is not an error."""
        J = poisson_matrix(len(self.z) // 2)
        return float(np.abs(self.matrix.T @ J @ self.matrix - J).max())


@checked_keywords
def monodromy(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    period: float,
    *,
    tol: float = 1e-10,
    start: float = 0.0,
) -> TangentMap:
    """Compute the monodromy matrix of a periodic orbit.

    Its eigenvalues, the Floquet multipliers, come in pairs m and 1/m; multipliers off the unit
    circle indicate instability. If H has no explicit time, two of them are 1. With forces the
    matrix is not symplectic: there are no pairs, multipliers inside the unit circle indicate
    attraction, and without explicit time one of them is 1.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence or mapping
        A state on the orbit.
    period : float
    tol : float
        As in :func:`hamsym.solve`.
    start : float
        Time of z0, where H depends on time.

    Returns
    -------
    TangentMap
        Its ``closure`` is 0 for a closed orbit.

    Raises
    ------
    InputError
        If the period cannot be used, the tolerance cannot be met, or the matrix is not finite.

    Examples
    --------
    >>> from hamsym import systems
    >>> problem = systems.kepler()
    >>> found = monodromy(problem.H, problem.z0, problem.period)
    >>> found.closure < 1e-9, bool(np.allclose(found.multipliers, 1, atol=1e-3))
    (True, True)
    """
    from hamsym.solving.solve import solve  # slow to import

    require_number("period", period)
    require_number("start", start)
    if Hamiltonian.of(H).time is None:
        start = 0.0  # at any time; the sum with a large one is rounded
    span = checked_span((start, start + period))
    solution = solve(H, z0, span, tol=tol)
    if not solution.success:
        raise InputError(f"the trajectory does not reach tol={tol:g}: {solution.message}")
    matrix = np.asarray(solution.sensitivity(span[1]))
    if not np.isfinite(matrix).all():
        raise InputError("the tangent map overflows within the period; give a shorter period")
    return TangentMap(solution.z0, solution(span[1]), matrix, "features")


def tangent_stepper(
    H: Hamiltonian, method: str, state: np.ndarray, start: float, size: float, vectors: np.ndarray
) -> Stepper:
    """Make a stepper that moves one trajectory and tangent vectors, shape (dim, count)."""
    reject_doubled(H, method)
    return Stepper(
        H,
        method,
        state[None],
        np.array([start]),
        np.array([size]),
        tangents=np.ascontiguousarray(vectors)[None],
    )


def reject_doubled(H: Hamiltonian, method: str) -> None:
    """Raise InputError if a method steps in a doubled phase space."""
    if isinstance(INTEGRATORS[usable_method(H, method)].scheme, Doubled):
        raise InputError(
            f"{method} steps in a doubled phase space; choose another method, for example gauss4"
        )
