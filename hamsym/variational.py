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

from hamsym.drift import COARSE, EnergyDrift
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators import (
    checked_span,
    checked_steps,
    fastest_rate,
    fixed_step,
    usual_method,
)
from hamsym.progress import stepping_progress
from hamsym.schemes import Doubled
from hamsym.settings import require_number, require_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["LyapunovExponents", "TangentMap", "lyapunov", "monodromy", "tangent_map"]

_STEPS_PER_RADIAN = 5  # of the fastest linear motion at the start
# e-folds of the fastest linear motion between two renormalisations, at most: numbers end at 700,
# and several vectors would become parallel to round-off before.
_GROWTH_OF_ONE, _GROWTH_OF_SEVERAL = 200.0, 5.0
_KEPT = 2_000  # points of the history
_PARALLEL = 30.0  # e-folds by which one vector may outgrow another before they are one to round-off
_PILOT_STEPS, _PILOTS = 1_000, 8


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
        """|z - z0|, the 2-norm: how far the trajectory is from closed."""
        return float(np.linalg.norm(self.z - self.z0))

    @property
    def symplecticity_error(self) -> float:
        """|M^T J M - J|, the largest entry."""
        d = len(self.z) // 2
        J = np.kron([[0, 1], [-1, 0]], np.eye(d))
        return float(np.abs(self.matrix.T @ J @ self.matrix - J).max())


def tangent_map(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    method: str | None = None,
    *,
    steps: int | None = None,
    dt: float | None = None,
    progress: bool | None = None,
) -> TangentMap:
    """The derivative of the numerical flow: the variational equations, solved with the trajectory.

    Parameters
    ----------
    H, z0, span, dt, progress
        As in :func:`hamsym.integrate`, for one trajectory.
    steps : int, optional
        Number of steps, 20,000 unless given.
    method : str, optional
        A fixed-step method, not ``tao2`` or ``tao4``; by default ``blanes_moan6`` for a separable
        H, otherwise ``gauss6``.

    Returns
    -------
    TangentMap

    Raises
    ------
    InputError
        If an option cannot be used, or the trajectory does not reach the end.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> tangent_map(H, [1.0, 0.0], (0, np.pi / 2)).matrix.round(9) + 0.0
    array([[ 0.,  1.],
           [-1.,  0.]])
    """
    H = Hamiltonian.of(H)
    start, end = checked_span(span)
    steps = checked_steps(end - start, steps, dt)
    state = H.state_from(z0)
    method = usual_method(H) if method is None else method
    stepper = _tangent_stepper(H, method, state, start, (end - start) / steps, np.eye(H.dim))
    done = stepper.advance(1, steps, show=progress)
    if done.interrupted:
        raise KeyboardInterrupt
    if not np.isfinite(done.states).all() or not np.isfinite(stepper.tangents).all():
        raise InputError(f"the trajectory does not reach t = {end:.6g}; end the span before it")
    return TangentMap(state, done.states[0, -1], stepper.tangents[0], method)


def monodromy(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    period: float,
    *,
    tol: float = 1e-10,
    start: float = 0.0,
) -> TangentMap:
    """The monodromy matrix of a periodic orbit, from a trajectory of the given tolerance.

    Its eigenvalues, the Floquet multipliers, come in pairs m and 1/m; off the unit circle they
    mean instability. Two are 1 for every orbit of an H without explicit time.

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
        Whose ``closure`` says whether the orbit is closed.

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
    from hamsym.solving import solve  # torch is slow to import

    require_number("period", period)
    require_number("start", start)
    span = checked_span((start, start + period))
    solution = solve(H, z0, span, tol=tol)
    if not solution.success:
        raise InputError(f"the trajectory cannot be had to tol={tol:g}: {solution.message}")
    matrix = np.asarray(solution.sensitivity(span[1]))
    if not np.isfinite(matrix).all():
        raise InputError(
            "nearby trajectories separate beyond the range of numbers within the period; give a "
            "shorter one"
        )
    return TangentMap(solution.z0, solution(span[1]), matrix, "features")


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
        exchanges (:mod:`hamsym.drift`); not whether the exponent has converged.
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
        from hamsym.plotting import plot_lyapunov  # matplotlib is slow to import

        return plot_lyapunov(self)


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
    stepper = _tangent_stepper(H, method, state, start, size, vectors)
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


def _tangent_stepper(
    H: Hamiltonian, method: str, state: np.ndarray, start: float, size: float, vectors: np.ndarray
) -> Any:
    stepper = fixed_step(
        H,
        method,
        state[None],
        np.array([start]),
        np.array([size]),
        tangents=np.ascontiguousarray(vectors)[None],
    )
    if isinstance(stepper.scheme, Doubled):
        raise InputError(
            f"{method} steps in a doubled phase space; choose another one, such as gauss4"
        )
    return stepper


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
