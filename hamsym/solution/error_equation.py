"""Integration of the equation of the error along a trajectory.

With z = z^ + delta and the residual r = dz^/dt - J grad H(z^), exactly

    d(delta)/dt = J grad H(z^ + delta) - dz^/dt,        delta = 0 at the start,

and to first order, the paper's eq. (ell), d(delta)/dt = J Hess(z^) delta - r.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import scipy

from hamsym.numerics.call_limit import TooManyCallsError, limited

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

#: Relative tolerance and largest step, as a share of the span: of the estimate, and of its check.
RESOLUTIONS = ((1e-6, 1 / 50), (1e-9, 1 / 200))
_CALLS = 20_000  # evaluations, at most, at the first resolution


def integrated_error(
    solution: Solution, *, linear: bool = False, resolution: int = 0
) -> Callable[[np.ndarray], np.ndarray]:
    """Integrate delta with DOP853; it is infinite from where the equation has no solution.

    - linear: Solve the linearised equation.
    - resolution: Index of :data:`RESOLUTIONS`.
    - returns: t -> delta, shape (*t.shape, dim).
    """
    H, system = solution.H, solution.H.compile("numpy")
    size = solution.ell_max or 1.0  # errors are measured in units of ell_max
    rtol, share = RESOLUTIONS[resolution]

    def rate(t: float, error: np.ndarray) -> np.ndarray:
        # Without the checks of times, which take a fifth of the time of a small network.
        z, dz = (rows[0] for rows in solution.trial.states_and_rates(np.array([t])))
        if linear:
            residual = dz - system.vector_field(*system.arguments(z, t))
            jacobian = system.jacobian(*system.arguments(z, t))
            return np.asarray(jacobian @ error - residual / size)
        flow = system.vector_field(*system.arguments(z + size * error, t))
        return np.asarray((flow - dz) / size)

    start, end = solution.span
    with np.errstate(all="ignore"):
        try:
            result = scipy.integrate.solve_ivp(
                limited(rate, _CALLS * (1 + 3 * resolution)),
                solution.span,
                np.zeros(H.dim),
                method="DOP853",
                dense_output=True,
                rtol=rtol,
                atol=0.1 * rtol * abs(end - start),
                max_step=share * abs(end - start),
            )
            reached, found = float(result.t[-1]), result.sol
        except TooManyCallsError:  # the residual oscillates too fast for a solution
            reached, found = start, lambda t: np.zeros((H.dim, *np.shape(t)))
    sign = np.sign(end - start)

    def error(t: np.ndarray) -> np.ndarray:
        solved = sign * t <= sign * reached
        values = size * found(np.where(solved, t, reached)).T
        return np.asarray(np.where(solved[..., None], values, np.inf))

    return error
