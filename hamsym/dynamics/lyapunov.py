"""Lyapunov exponents: the growth of small differences, from the symbolic variational equations.

Input:  a Hamiltonian, an initial state, a time span.
Output: finite-time Lyapunov exponents and their convergence.

The tangent vectors are moved by the derivative of the integrator's own step, which for a symplectic
method is a symplectic matrix: exponents come in pairs of opposite signs, unless forces act. Their
sum is the mean divergence of the rates. The equations themselves are ``H.variational_equations``.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.dynamics.lyapunov_map import LyapunovMap, lyapunov_map
from hamsym.dynamics.monodromy import reject_doubled, tangent_stepper
from hamsym.dynamics.tangent_steps import (
    APART,
    KEPT,
    LOST,
    PARALLEL,
    TangentSteps,
    first_vectors,
    growth_limit,
    orthonormal,
)
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import usual_method
from hamsym.problems.ensemble import ensemble_of
from hamsym.problems.problem import checked_span, checked_steps
from hamsym.support.progress import advance_in_blocks
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.tables import data_frame
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    import pandas


@suggest_attributes
@dataclass(frozen=True)
class LyapunovExponents(Drawn, Shown):
    """Finite-time Lyapunov exponents and the settings of their computation.

    ``plot()`` draws them over time, on logarithmic axes with log(t)/t for comparison, and where
    some are negative all of them in a second panel, on an axis that is linear around 0;
    ``plot("convergence")`` and ``plot("exponents")`` draw one of these panels.

    Attributes
    ----------
    t : numpy.ndarray
        Times of the history, shape (n,).
    exponents : numpy.ndarray
        Logarithm of the growth up to t, divided by t, the largest first, shape (n, count).
    H : Hamiltonian
    z0 : numpy.ndarray
        Initial state, shape (dim,).
    span : (float, float)
        The times that were asked for; the history ends early where the run failed.
    energy_error : float
        Largest change of H, nan if H depends on time or forces act.
    method : str
    dt : float
    seconds : float
    success : bool
        Whether the trajectory reached the end and kept H to 1 % of the energy that the motion
        exchanges (:mod:`hamsym.integrators.energy_drift`), or where H is not conserved, whether a
        step is at most 0.6 rad of the fastest linear motion and errs by at most 1 % of it;
        independent of convergence.
    message : str
    """

    t: np.ndarray = field(repr=False)
    exponents: np.ndarray = field(repr=False)
    H: Hamiltonian = field(repr=False, compare=False)
    z0: np.ndarray = field(repr=False)
    span: tuple[float, float]
    energy_error: float
    method: str
    dt: float
    seconds: float
    success: bool
    message: str

    def __repr__(self) -> str:
        return (
            f"LyapunovExponents({self.H.formulas!r}: largest {self.maximal:.4g} after t = "
            f"{self.t[-1]:.6g}, success={self.success})"
        )

    @property
    def maximal(self) -> float:
        """The largest exponent at the last time, per unit of time."""
        return float(self.exponents[-1, 0])

    @property
    def is_integrable(self) -> bool:
        """Whether H has one degree of freedom and no explicit time, which excludes chaos."""
        return self.H.dof == 1 and self.H.time is None

    @cached_property
    def trend(self) -> float:
        """Slope d log(exponent) / d log(t) over the last decade of time.

        A converged exponent has slope 0; on a regular trajectory, where differences grow in
        proportion to t, the slope is that of log(t)/t, slightly above -1.
        """
        elapsed, values = np.abs(self.t - self.span[0]), self.exponents[:, 0]
        late = (elapsed >= 0.1 * elapsed[-1]) & (values > 0)
        if late.sum() < 10:
            return math.nan
        return float(np.polyfit(np.log(elapsed[late]), np.log(values[late]), 1)[0])

    @property
    def statement(self) -> str:
        """Interpretation of the exponents, with the limits of a finite time."""
        end = abs(self.t[-1] - self.span[0])
        begin = f"After a time of {end:.6g} the largest exponent is {self.maximal:.3g}"
        if self.trend < -0.5:
            verdict = (
                "and was still falling like log(t)/t, as it does on a regular trajectory. Up to "
                "this time the trajectory is indistinguishable from a regular one; chaos weaker "
                f"than about {max(self.maximal, 1 / end):.1g}, or setting in later, is possible."
            )
        elif abs(self.trend) < 0.2 and self.maximal > 0:
            verdict = (
                "and hardly changed over the last tenfold of time: nearby trajectories separate "
                f"by a factor of e in about {1 / self.maximal:.3g}. "
                + (
                    "With one degree of freedom and no explicit time this is not chaos."
                    if self.is_integrable
                    else "This indicates chaos over this time, if the motion is bounded and "
                    "recurs; the trajectory may still stick to a regular region later, and the "
                    "limit is not proved."
                )
            )
        else:
            verdict = (
                "and was still changing, neither level nor falling like log(t)/t. This is "
                "inconclusive; use a longer span."
            )
        if not self.success:
            verdict = f"{verdict} However, the run failed: {self.message}."
        return f"{begin}, {verdict}"

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the exponents as a table of pandas: times as index, a column for each.

        H and the method are in ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> found = lyapunov("p**2/2 - x**2/2", [1, 0], (0, 30), count=2)
        >>> found.to_dataframe().iloc[-1].round(1).tolist()
        [1.0, -1.0]
        """
        columns = {f"exponent_{k + 1}": own for k, own in enumerate(self.exponents.T)}
        known = {"H": self.H.formulas, "start": self.span[0], "method": self.method, "dt": self.dt}
        return data_frame(columns, {"t": self.t}, {**known, "hamsym": hamsym.__version__})


@checked_keywords
def lyapunov(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, Any] | np.ndarray,
    span: tuple[float, float],
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    count: int = 1,
    seed: int = 0,
    parameters: Mapping[Any, Any] | None = None,
    progress: bool | None = None,
) -> LyapunovExponents | LyapunovMap:
    """Compute the largest Lyapunov exponents, of one trajectory with their convergence over time.

    Tangent vectors are moved by the derivative of the steps and made orthonormal at intervals
    (Benettin, Galgani, Giorgilli & Strelcyn 1980; Shimada & Nagashima 1979). Where components
    differ by many powers of ten, as in SI units, lengths are measured in units that balance them;
    the limit for long times does not depend on units.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence, mapping or array
        A start, or an array of starts of shape (..., dim) or a mapping to arrays, as from
        ``H.state_at_energy``; a start of nan is a member that fails.
    span : (float, float)
    method : str, optional
        A fixed-step method, not ``tao2`` or ``tao4``; by default ``blanes_moan6`` for a separable
        H, otherwise ``gauss6``.
    steps : int, optional
        Number of steps.
    dt : float, optional
        Largest step, in place of ``steps``. By default a fifth of a radian of the fastest linear
        motion at the beginning of the trajectory. For many starts it is chosen for each from
        classes of powers of two, and made shorter where the motion turns out to need it.
    count : int
        Number of exponents, up to dim.
    seed : int
        Seed of the first tangent vectors.
    parameters : mapping of name to number or array, optional
        Values that replace those of H, broadcast with the starts.
    progress : bool, optional
        Show progress; by default on a terminal, after a second.

    Returns
    -------
    LyapunovExponents or LyapunovMap
        For one start, with an interpretation as ``statement``. After a failure or Ctrl-C, the part
        before it, with ``success=False``. For arrays, the exponents of each member at the end,
        computed on all cores, with nan and ``success`` False for those that fail.

    Raises
    ------
    InputError
        If an option cannot be used.

    Examples
    --------
    >>> H = hamsym.Hamiltonian("p**2/2 - x**2/2")  # its exponents are 1 and -1
    >>> lyapunov(H, [1e-9, 0.0], (0, 20), count=2).exponents[-1].round(1)
    array([ 1., -1.])
    >>> lyapunov(H, [[1e-9, 0.0], [np.nan, 0.0]], (0, 100)).exponents.round(1)
    array([[ 1.],
           [nan]])
    """
    members = ensemble_of(H, z0, parameters, finite=False)
    H = members.H
    span = checked_span(span)
    method = usual_method(H) if method is None else method
    require_whole("count", count, 1, H.dim)
    require_whole("seed", seed, 0)
    reject_doubled(H, method)  # before the pilot runs, which compile
    if members.shape:
        given = steps is not None or dt is not None
        number = checked_steps(span[1] - span[0], steps, dt) if given else None
        return lyapunov_map(members, span, method, number, count, seed, progress)
    state = H.state_from(members.states[0])
    plan = TangentSteps.choose(H, method, state, span, steps, dt)
    began = time.perf_counter()
    vectors = plan.scales * first_vectors(H.dim, count, seed)
    stepper = tangent_stepper(H, method, state, span[0], plan.size, vectors)
    run = _Benettin(stepper, state, plan, plan.block(growth_limit(count)))
    if advance_in_blocks(plan.number, run.block, progress, run.advance):
        run.problem = "interrupted"
    if not run.history:
        raise InputError(f"integration failed at the first step: {run.problem}")
    states = np.array(run.path[: len(run.history) + 1])
    return LyapunovExponents(
        t=np.array(run.times),
        exponents=np.array(run.history),
        **plan.outcome(run.times, states, run.problem, began),
    )


class _Benettin:
    """Growth of tangent vectors, made orthonormal again after every block of steps."""

    def __init__(self, stepper: Stepper, state: np.ndarray, plan: TangentSteps, block: int) -> None:
        self._stepper, self._plan, self.block = stepper, plan, block
        rows = np.geomspace(1, max(plan.number // block, 1), KEPT).astype(int)
        self._rows = set(rows.tolist())  # numbers of the blocks after which exponents are kept
        self._growth = np.zeros(stepper.tangents.shape[2])
        self.times: list[float] = []
        self.history: list[np.ndarray] = []
        self.path = [state]  # states at the start, and at each of the times
        self.problem = ""

    def advance(self, done: int, count: int) -> bool:
        """Take a block of steps; return False, with ``problem`` set, where that fails."""
        state, done = self._stepper.step(count)[0].copy(), done + count
        if not np.isfinite(state).all():
            self.problem = LOST
            return False
        vectors, grown = orthonormal(self._stepper.tangents[0] / self._plan.scales)
        self._stepper.tangents[0] = self._plan.scales * vectors
        if not np.isfinite(grown).all() or np.ptp(grown) > PARALLEL:
            self.problem = APART
            return False
        self._growth = self._growth + grown
        if done == self._plan.number or done // self.block in self._rows:
            self.path.append(state)
            elapsed = self._plan.size * done
            self.times.append(self._plan.span[0] + elapsed)
            # The order in which vectors are made orthogonal is that of their growth only after a
            # long time.
            self.history.append(np.sort(self._growth)[::-1] / abs(elapsed))
        return True
