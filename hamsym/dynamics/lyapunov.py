"""Tangent dynamics: how small differences grow, from the symbolic Hessian.

Input:  a Hamiltonian, an initial state, a time span.
Output: derivatives of the flow, the multipliers of a periodic orbit, Lyapunov exponents.

The tangent vectors are moved by the derivative of the integrator's own step, which for a symplectic
method is a symplectic matrix. The equations themselves are ``H.variational_equations``.
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
from hamsym.dynamics.monodromy import tangent_stepper
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.energy_drift import COARSE, EnergyDrift
from hamsym.integrators.integrate import (
    fastest_rate,
    fixed_step,
    usual_method,
)
from hamsym.problem import checked_span, checked_steps
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["LyapunovExponents", "lyapunov"]

_STEPS_PER_RADIAN = 5  # of the fastest linear motion at the start
# e-folds of the fastest linear motion between two renormalisations, at most: numbers end at 700,
# and several vectors would become parallel to round-off before.
_GROWTH_OF_ONE, _GROWTH_OF_SEVERAL = 200.0, 5.0
_KEPT = 2_000  # points of the history
_PARALLEL = 30.0  # e-folds by which one vector may outgrow another before they are one to round-off
_PILOT_STEPS, _PILOTS = 1_000, 8


@dataclass(frozen=True)
class LyapunovExponents:
    """Finite-time Lyapunov exponents and how they came about.

    Attributes
    ----------
    t : numpy.ndarray
        Times of the history, shape (n,).
    exponents : numpy.ndarray
        log of the growth up to t, over t, the largest first at every time, shape (n, count).
    start : float
        Time at the start.
    energy_error : float
        Largest change of H, nan if H depends on time.
    method : str
    dt : float
    seconds : float
    success : bool
        Whether the trajectory reached the end and kept H to 1 % of the energy that the motion
        exchanges (:mod:`hamsym.integrators.energy_drift`); not whether the exponent has converged.
    message : str
    is_integrable : bool
        Whether H has one degree of freedom and no explicit time, which excludes chaos.
    """

    t: np.ndarray = field(repr=False)
    exponents: np.ndarray = field(repr=False)
    start: float
    energy_error: float
    method: str
    dt: float
    seconds: float
    success: bool
    message: str
    title: str = field(repr=False, default="")
    is_integrable: bool = False

    @property
    def maximal(self) -> float:
        """The largest exponent at the last time, per unit of time."""
        return float(self.exponents[-1, 0])

    @cached_property
    def trend(self) -> float:
        """d log(exponent) / d log(t) over the last decade of time: near 0, or near -1.

        An exponent that has converged has slope 0; on a regular trajectory, where differences
        grow in proportion to t, it is that of log(t)/t, which is a little above -1.
        """
        elapsed, values = np.abs(self.t - self.start), self.exponents[:, 0]
        late = (elapsed >= 0.1 * elapsed[-1]) & (values > 0)
        if late.sum() < 10:
            return math.nan
        return float(np.polyfit(np.log(elapsed[late]), np.log(values[late]), 1)[0])

    @property
    def statement(self) -> str:
        """What these numbers say, and what no finite time can."""
        end = abs(self.t[-1] - self.start)
        begin = f"After a time of {end:.6g} the largest exponent is {self.maximal:.3g}"
        if self.trend < -0.5:
            verdict = (
                "and was still falling like log(t)/t, as it does on a regular trajectory. Up to "
                "this time nothing tells the trajectory from a regular one; chaos that is weaker "
                f"than about {max(self.maximal, 1 / end):.1g}, or sets in later, is not excluded."
            )
        elif abs(self.trend) < 0.2 and self.maximal > 0:
            verdict = (
                "and hardly changed over the last tenfold of time: nearby trajectories separate "
                f"by a factor of e in about {1 / self.maximal:.3g}. "
                + (
                    "With one degree of freedom and no explicit time this is no chaos."
                    if self.is_integrable
                    else "That is chaos over this time, if the motion is bounded and comes back; a "
                    "trajectory may still stick to a regular region later, and the limit is not "
                    "proved."
                )
            )
        else:
            verdict = (
                "and was still changing, neither level nor falling like log(t)/t. That decides "
                "nothing; take a longer time."
            )
        if not self.success:
            verdict = f"{verdict} But the run was no success: {self.message}."
        return f"{begin}, {verdict}"

    def plot(self) -> Figure:
        """The exponents over time, with log(t)/t beside them."""
        return hamsym.plot(self)


def lyapunov(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    count: int = 1,
    seed: int = 0,
    progress: bool | None = None,
) -> LyapunovExponents:
    """Maximal Lyapunov exponent, or the first few, with their convergence over time.

    Tangent vectors are moved by the derivative of the steps and made orthonormal again now and
    then (Benettin, Galgani, Giorgilli & Strelcyn 1980; Shimada & Nagashima 1979).

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence or mapping
    span : (float, float)
    method : str, optional
        A fixed-step method, not ``tao2`` or ``tao4``; by default ``blanes_moan6`` for a separable
        H, otherwise ``gauss6``.
    steps : int, optional
        Number of steps.
    dt : float, optional
        In place of ``steps``, the largest step. Without both a fifth of a radian of the fastest
        linear motion at the beginning of the trajectory.
    count : int
        How many exponents, up to dim.
    seed : int
        For the first tangent vectors.
    progress : bool, optional
        Show how far it is; by default on a terminal, after a second.

    Returns
    -------
    LyapunovExponents
        With a ``statement`` in words. The part before it, with ``success=False``, if the
        trajectory had to stop or Ctrl-C was pressed.

    Raises
    ------
    InputError
        If an option cannot be used.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 - x**2/2")  # its exponents are 1 and -1
    >>> lyapunov(H, [1e-9, 0.0], (0, 20), count=2).exponents[-1].round(1)
    array([ 1., -1.])
    """
    H = Hamiltonian.of(H)
    start, end = checked_span(span)
    state = H.state_from(z0)
    method = usual_method(H) if method is None else method
    require_whole("count", count, 1, H.dim)
    require_whole("seed", seed, 0)
    rate = _fastest_rate(H, method, state, start, end)
    usual = steps is None and dt is None
    if usual:
        dt = 1 / (_STEPS_PER_RADIAN * rate) if rate > 0 else abs(end - start) / 20_000
        dt = min(dt, abs(end - start))
    steps = checked_steps(end - start, steps, dt)
    size = (end - start) / steps
    vectors = np.linalg.qr(np.random.default_rng(seed).normal(size=(H.dim, count)))[0]
    stepper = tangent_stepper(H, method, state, start, size, vectors)
    growth_limit = _GROWTH_OF_ONE if count == 1 else _GROWTH_OF_SEVERAL
    each = max(rate * abs(size), 1e-3)
    between = max(1, min(steps // _KEPT, int(growth_limit / each)))
    rows = np.unique(np.geomspace(1, max(steps // between, 1), _KEPT).astype(int))
    began = time.perf_counter()
    growth, times, history, path = np.zeros(count), [], [], [state]
    message = ""
    with stepping_progress(steps, progress) as report:
        try:
            for block in range(1, -(-steps // between) + 1):
                done = min(block * between, steps)
                path.append(stepper.step(done - (block - 1) * between)[0].copy())
                report(done - (block - 1) * between)
                if not np.isfinite(path[-1]).all():
                    message = "the trajectory left the range of numbers, or a step was not solved"
                    break
                stepper.tangents[0], grown = _orthonormal(stepper.tangents[0])
                if not np.isfinite(grown).all() or np.ptp(grown) > _PARALLEL:
                    message = "nearby trajectories separate too fast for these steps; give a dt"
                    break
                growth = growth + grown
                if done == steps or block in rows:
                    times.append(start + size * done)
                    # The order in which vectors are made orthogonal is that of their growth only
                    # after a long time.
                    history.append(np.sort(growth)[::-1] / abs(size * done))
                else:
                    path.pop()
        except KeyboardInterrupt:
            message = "interrupted"
    if not history:
        raise InputError(f"the trajectory breaks off at its start: {message or 'no step was done'}")
    if message:
        message = f"stopped after t = {times[-1]:.6g}: {message}"
    states = np.array(path[: len(history) + 1])
    watched = EnergyDrift(H, 1)
    watched.add(states[None])
    energy_error = math.nan if H.time is not None else float(watched.change[0])
    share = float(watched.relative(steps)[0])
    fastest = fastest_rate(H, states, np.array([start, *times]))
    if H.time is None and not share <= COARSE and not message:
        message = f"H changed by {energy_error:.1e}, {share:.0%} of its scale: take a smaller dt"
    elif usual and not message and not fastest <= 3 * max(rate, 1 / abs(size)):
        message = f"the motion has rates up to {fastest:.2g}: give a dt that resolves them"
    return LyapunovExponents(
        t=np.array(times),
        exponents=np.array(history),
        start=start,
        energy_error=energy_error,
        method=method,
        dt=size,
        seconds=time.perf_counter() - began,
        success=not message,
        message=message or f"{method}: {steps:,} steps to t = {end:.6g}",
        title=H.formula,
        is_integrable=H.dof == 1 and H.time is None,
    )


def _orthonormal(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal vectors of the same flags, and the logarithm of what each has grown by."""
    q, r = np.linalg.qr(vectors)
    diagonal = np.diag(r)
    return q * np.sign(diagonal), np.log(np.abs(diagonal))


def _fastest_rate(
    H: Hamiltonian, method: str, state: np.ndarray, start: float, end: float
) -> float:
    """Spectral radius of J Hess along the beginning of the trajectory, per unit of time.

    Each pilot run uses steps by what the one before it found, so that a start where little happens
    does not set the steps for the rest.
    """
    rate = fastest_rate(H, state[None], start)
    if not math.isfinite(rate):
        raise InputError("the Hessian of H is not finite at z0; start elsewhere")
    whole = abs(end - start)
    length = whole / 1_000 if rate == 0 else min(whole, _PILOT_STEPS / (_STEPS_PER_RADIAN * rate))
    for _ in range(_PILOTS):
        size = math.copysign(length / _PILOT_STEPS, end - start)
        stepper = fixed_step(H, method, state[None], np.array([start]), np.array([size]))
        path = stepper.advance(_PILOT_STEPS, show=False).states[0]
        if not np.isfinite(path).all():
            length /= 30
            continue
        found = fastest_rate(H, path, start + size * np.arange(1, len(path) + 1))
        if not rate * 1.5 < found < math.inf:
            return rate if math.isinf(found) else max(rate, found)
        rate = found
        length = min(length, _PILOT_STEPS / (_STEPS_PER_RADIAN * rate))
    return rate
