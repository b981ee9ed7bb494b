"""The paper's error analysis of a solution, complete and unchanged.

Its assumptions and their limits:

- The residual ell(t) = dz^/dt - J grad H(z^) and the Hessian along z^ give the error to first
  order in it, eq. (ell). This is valid while the error is small.
- Eq. (dz_bound) bounds |delta z| at a time by ell_max, sigma_min and |d(delta z)/dt| there. It
  holds for the linearised error, but needs the rate of the error, which is unknown beforehand.
- Eq. (dz), |delta z_i| <= ell_max/sigma_min, follows only if one component has all of the error and
  is at its maximum, where its rate is zero. Neither holds in general: a residual in resonance with
  the motion makes the error grow with time at constant ell_max. On the harmonic oscillator
  z^ = (1 + eps t)(cos t, -sin t) has ell_max = eps, sigma_min = 1 and an error of eps T. The bound
  is therefore called a heuristic.
- Where the Hessian is singular, eq. (dz) gives no bound: on the whole trajectory with a cyclic
  coordinate or a translation symmetry, and at single times where det Hess changes its sign, for
  example for Henon-Heiles on x^2 + y^2 = 1/4.
- sigma_min, |ell| and the 2-norm mix the units of q and p, and change under canonical rescaling.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import scipy

from hamsym.numerics.roots import refine, sign_changes
from hamsym.numerics.symplectic import generators
from hamsym.solution.error_equation import integrated_error
from hamsym.support.validation import checked_numbers

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

_SINGULAR = 1e-12  # of the largest eigenvalue; below it an eigenvalue is round-off


class Analysis:
    """ell, sigma_min and the bounds from them, for one solution.

    Examples
    --------
    >>> import hamsym
    >>> problem = hamsym.systems.henon_heiles()
    >>> found = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9).analysis
    >>> x, y = found.solution(found.singular_times).T[:2]
    >>> (x**2 + y**2).round(9)
    array([0.25, 0.25, 0.25, 0.25, 0.25, 0.25])
    >>> found.sigma_min, found.bound
    (0.0, inf)
    """

    def __init__(self, solution: Solution) -> None:
        self.solution = solution

    # -- ell -----------------------------------------------------------------------------------

    def ell(self, t: np.ndarray) -> np.ndarray:
        """Return |ell(t)|, the 2-norm of the residual, shaped as t."""
        return np.asarray(np.linalg.norm(self.solution.residual(np.asarray(t, float)), axis=-1))

    @property
    def ell_max(self) -> float:
        """max_t |ell(t)| over continuous time, without the energy term."""
        return self._largest_ell[0]

    @property
    def ell_max_time(self) -> float:
        """Time at which |ell| is largest."""
        return self._largest_ell[1]

    @cached_property
    def _largest_ell(self) -> tuple[float, float]:
        return self._largest(self.ell)

    @cached_property
    def ell_max_regularized(self) -> float:
        """The paper's ell_max with its energy term, sqrt(max_t |ell|^2 + lambda (H - E0)^2)."""
        weight, energy = self.solution.energy_weight, self.solution.energy
        if not weight:
            return self.ell_max
        energy_0 = float(energy(self.solution.span[0]))
        return self._largest(
            lambda t: np.sqrt(self.ell(t) ** 2 + weight * (energy(t) - energy_0) ** 2)
        )[0]

    # -- the Hessian ---------------------------------------------------------------------------

    def eigenvalues(self, t: np.ndarray) -> np.ndarray:
        """Return eigenvalues of the Hessian along the trajectory, ascending, shape (*t.shape, dim).

        The matrix is symmetric: its singular values are their magnitudes. They are NaN where it
        is not finite.
        """
        matrices = self.solution.hessians(checked_numbers("t", t))
        finite = np.isfinite(matrices).all(axis=(-2, -1))
        values = np.linalg.eigvalsh(np.where(finite[..., None, None], matrices, 0.0))
        return np.where(finite[..., None], values, np.nan)

    @cached_property
    def _scanned(self) -> np.ndarray:
        return self.eigenvalues(self.solution.scan_times)

    @cached_property
    def is_always_singular(self) -> bool:
        """Whether an eigenvalue is zero at all times, for example with a cyclic coordinate."""
        sizes = np.abs(self._scanned)
        return bool(np.all(sizes.min(axis=1) <= _SINGULAR * sizes.max()))

    @cached_property
    def singular_times(self) -> np.ndarray:
        """Times at which det Hess changes its sign, to round-off; empty if it is always zero.

        Two changes between neighbouring points of the scan are missed.
        """
        if self.is_always_singular:
            return np.empty(0)
        times, unit = self.solution.scan_times, np.nanmax(np.abs(self._scanned), initial=0.0) or 1.0

        def determinant(t: np.ndarray, _: object = None) -> np.ndarray:
            return np.prod(self.eigenvalues(t) / unit, axis=-1)

        step = sign_changes(np.prod(self._scanned / unit, axis=-1))[0]
        return refine(determinant, times[step], times[step + 1])

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the Hessian along the trajectory.

        Zero if an eigenvalue changes its sign, which a grid of times alone would miss, or if the
        Hessian is not finite somewhere. It is nan with forces: the equation of the error has
        another matrix then, which is not symmetric.
        """
        return self._smallest[0]

    @property
    def sigma_min_time(self) -> float:
        """Time at which the smallest singular value is smallest."""
        return self._smallest[1]

    @cached_property
    def _smallest(self) -> tuple[float, float]:
        if self.solution.H.forces:
            return math.nan, math.nan
        largest = np.abs(self._scanned).max()
        if not np.isfinite(largest):
            lost = np.flatnonzero(np.isnan(self._scanned).any(axis=1))
            return 0.0, float(self.solution.scan_times[lost[0]])
        negative = (self._scanned < 0).sum(axis=1)
        changed = np.flatnonzero(negative != negative[0])
        if self.is_always_singular or len(changed) or largest == 0:
            return 0.0, float(self.solution.scan_times[changed[0] if len(changed) else 0])
        value, t = self._largest(lambda t: -np.abs(self.eigenvalues(t)).min(axis=-1))
        return (-value if -value > _SINGULAR * largest else 0.0), t

    # -- bounds --------------------------------------------------------------------------------

    @property
    def vacuous(self) -> str:
        """The reason why the bound is infinite."""
        reason = "the Hessian is singular on the trajectory"
        if self.solution.H.forces:
            reason = "it rests on a symmetric Hessian, and forces act"
        return f"the bound ell_max/sigma_min is infinite: {reason}"

    @property
    def bound(self) -> float:
        """Heuristic bound ell_max / sigma_min, eq. (dz); infinite if sigma_min is zero or nan."""
        return self.ell_max_regularized / self.sigma_min if self.sigma_min > 0 else math.inf

    def linearized_error(self, t: np.ndarray) -> np.ndarray:
        """Integrate eq. (ell) from zero to z - z^, shape (n, dim); NaN after a failure."""
        times = checked_numbers("t", t)
        estimate = self.solution.error
        if estimate is not None:  # the solution of this equation
            return estimate(times)
        error = self._linear(times)
        return np.where(np.isinf(error), np.nan, error)

    @cached_property
    def _linear(self) -> Callable[[np.ndarray], np.ndarray]:
        return integrated_error(self.solution, linear=True)

    def inequality(self, t: np.ndarray) -> np.ndarray:
        """Evaluate the right-hand side of eq. (dz_bound) at times t, shape (n,).

        It combines ell_max and sigma_min of the whole trajectory with the norm of the Hessian and
        the rate of the linearised error at t, and bounds the 2-norm of that error. It is infinite
        if sigma_min is zero or nan.
        """
        times = checked_numbers("t", t)
        if not self.sigma_min > 0:
            return np.full(times.shape, math.inf)
        hessians = self.solution.hessians(times)
        error = self.linearized_error(times)[..., None]
        rate = (generators(hessians) @ error)[..., 0] - self.solution.residual(times)
        speed = np.linalg.norm(rate, axis=-1)
        norm, sigma = np.abs(self.eigenvalues(times)).max(axis=-1), self.sigma_min
        root = (sigma * self.ell_max) ** 2 - speed**2 * (sigma**2 - norm**2)
        return (speed * norm + np.sqrt(root)) / sigma**2

    def _largest(self, function: Callable[[np.ndarray], np.ndarray]) -> tuple[float, float]:
        """Find the maximum of a function of time and its place by a scan and a search at its peaks.

        The maximum is infinite if the function is NaN somewhere.
        """
        times = self.solution.scan_times
        # Beside the joints of windows, not on them: the value of a switched force at the joint
        # itself has no effect on the motion.
        times = times + 1e-9 * np.append(np.diff(times), times[-2] - times[-1])
        values = np.nan_to_num(function(times), nan=np.inf, posinf=np.inf, neginf=-np.inf)
        best = int(np.argmax(values))
        if values[best] == np.inf:
            return math.inf, float(times[best])
        found = [(float(values[best]), float(times[best]))]
        for index in np.argsort(values)[-3:]:
            ends = times[max(index - 1, 0)], times[min(index + 1, len(times) - 1)]
            peak = scipy.optimize.minimize_scalar(
                lambda t: -float(function(np.array([t]))[0]),
                bounds=sorted(ends),
                method="bounded",
                options={"xatol": 1e-6 * abs(ends[1] - ends[0])},
            )
            found.append((-float(peak.fun), float(peak.x)))
        return max(pair for pair in found if not math.isnan(pair[0]))
