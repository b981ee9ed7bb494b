"""The method "features": random sine features marched until the estimated error meets tol.

Stage 1  March with a local tolerance (:mod:`hamsym.random_features.march`).
Stage 2  Estimate the global error and the round-off along the march
         (:mod:`hamsym.random_features.error_estimate`).
Stage 3  If both together exceed the tolerance, or the windows of a loose one do not resolve the
         force or leave the march in doubt, march again with a tighter local tolerance.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import ratios
from hamsym.problem import InitialValueProblem
from hamsym.random_features.basis import FeatureBasis, feature_basis
from hamsym.random_features.error_estimate import (
    Estimate,
    MarchError,
    estimate_error,
)
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import MAX_WINDOWS, march
from hamsym.random_features.members import (
    LEAST_STEP,
    MARGIN,
    MOST_STEP,
    SMALLEST,
    TIGHTER,
    MemberSolver,
)
from hamsym.random_features.options import FEWEST_WINDOWS, FeatureOptions
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.accuracy import (
    checked_atol,
    checked_breakpoints,
    checked_tol,
    checked_window,
    window_ends,
)
from hamsym.solution.discontinuities import first_jump
from hamsym.solution.solution import Solution
from hamsym.solution.times import shown_time
from hamsym.solution.window_error import allowed_errors

_SMALL_BASIS = 1e-10  # tolerance from which the small basis takes less time
_LOCAL = 0.1  # local tolerance of the first march, relative to the tolerance
_ATTEMPTS = 6
_LOOSER, _NEAR_ROUND_OFF = 4.0, 1e-11  # local tolerance of a march after one that is in doubt
_JUMP_SAMPLES = 25  # of a window, in the search for jumps of the force


@dataclass(frozen=True)
class Accuracy:
    """Checked options of a march."""

    #: tol, local: Tolerance, and local tolerance of the first march.
    tol: float
    local: float
    #: Absolute tolerance, shape (dim,).
    absolute: np.ndarray
    #: Longest window.
    longest: float
    #: Times at which a window ends.
    stops: list[float]

    def allowed(self, sizes: np.ndarray) -> np.ndarray:
        """Return the allowed error of components of these computed sizes, shape (dim,)."""
        return allowed_errors(self.tol, self.absolute, sizes)


def checked_accuracy(options: FeatureOptions, span: tuple[float, float], dim: int) -> Accuracy:
    """Check the options of the method "features".

    Raise InputError if one cannot be used.
    """
    tol = checked_tol(options.tol)
    return Accuracy(
        tol,
        # The cost grows as a root of the accuracy: a margin is cheaper than a second march.
        max(_LOCAL * tol, SMALLEST),
        checked_atol(options.atol, dim),
        checked_window(
            options.max_window, span, abs(span[1] - span[0]) / FEWEST_WINDOWS, MAX_WINDOWS
        ),
        checked_breakpoints(options.breakpoints, span),
    )


def basis_for(seed: int, tol: float) -> FeatureBasis:
    """Return the basis that reaches a tolerance in the least time."""
    return feature_basis(seed, 16 if tol >= _SMALL_BASIS else 24)


def solve_by_features(problem: InitialValueProblem, options: FeatureOptions) -> Solution:
    """Solve by marching random features to a tolerance; options as in :func:`hamsym.solve`."""
    H, span = problem.H, problem.span
    accuracy = checked_accuracy(options, span, H.dim)
    basis = basis_for(problem.seed, accuracy.tol)
    if not accuracy.stops and MemberSolver.applies(H):
        wall, cpu = time.perf_counter(), time.thread_time()
        solver = MemberSolver(
            H, span, accuracy.tol, accuracy.local, accuracy.absolute, accuracy.longest, basis
        )
        parameters = np.array([[H.parameters[name] for name in H.parameter_names]], dtype=float)
        batch = solver.solve(problem.z0[None], parameters, keep_error=True)
        if batch.accepted[0]:
            seconds = time.perf_counter() - wall, time.thread_time() - cpu
            return accepted_solution(
                H,
                problem.z0,
                span,
                solver.march_of(batch, *seconds),
                basis,
                solver.error_of(batch),
                accuracy.tol,
                float(batch.excess[0]),
            )
    return solve_by_march(problem, options, basis, "features")


def accepted_solution(
    H: Hamiltonian,
    z0: np.ndarray,
    span: tuple[float, float],
    windows: March,
    basis: FeatureBasis,
    error: MarchError,
    tol: float,
    excess: float,
) -> Solution:
    """Make the solution of a march that passed every check."""
    return Solution(
        H,
        z0,
        span,
        FeatureTrial.of_march(windows, basis),
        method="features",
        record=windows,
        error=error,
        success=True,
        message=success_message(tol, len(windows.readouts), excess),
    )


def success_message(tol: float, windows: int, excess: float) -> str:
    """Return the message of a march that met its tolerance."""
    return f"tol {tol:.1e} met: {_state(windows, excess)}"


def _state(windows: int, excess: float) -> str:
    return f"{windows:,} windows, estimated error {excess:.1e} of the tolerance"


def solve_by_march(
    problem: InitialValueProblem, options: FeatureOptions, basis: FeatureBasis, method: str
) -> Solution:
    """Solve by marching windows of a basis to a tolerance; the solution has the method's name."""
    H = problem.H
    accuracy = checked_accuracy(options, problem.span, H.dim)
    tol, local = accuracy.tol, accuracy.local
    stops = window_ends(H, accuracy.stops, problem.span)
    flow = flow_of(H)
    best: _Attempt | None = None
    loosened = tightened = False
    with np.errstate(all="ignore"):
        for _ in range(_ATTEMPTS):
            windows = march(
                flow,
                problem.z0,
                problem.span,
                local,
                basis,
                breakpoints=stops,
                longest=accuracy.longest,
            )
            if not len(windows.readouts):
                break
            estimate = estimate_error(windows, basis, flow, local)
            error = estimate.error
            solution = _solution_of(problem, windows, basis, error, method)
            tried = _Attempt(windows, estimate, accuracy.allowed(error.scale), solution)
            if best is None or tried.is_better_than(best):
                best = tried
            # So close to round-off, residuals may exceed their limit in windows of any length.
            spare = tried.excess * _LOOSER < 1 and local <= _NEAR_ROUND_OFF
            if windows.doubt and spare and not loosened:
                local, loosened = local * _LOOSER, True
                continue
            # Shorter windows show whether a force that is steep for these jumps, and may resolve
            # what leaves a march in doubt.
            unresolved = bool(windows.doubt) and not (windows.reason or loosened or tightened)
            if (tried.is_too_steep or unresolved) and local > SMALLEST:
                local = max(local * LEAST_STEP, SMALLEST)
                tightened |= unresolved
                continue
            # A tighter march does not reduce an error that is mostly round-off.
            floors = error.floors.max(axis=0)
            at_round_off = (
                not estimate.limit
                and (error.largest <= np.maximum(2 * floors, tried.allowed)).all()
            )
            if tried.excess <= 1 or at_round_off or local <= SMALLEST:
                break
            local = max(local * min(max(MARGIN / tried.too_large, LEAST_STEP), MOST_STEP), SMALLEST)
    if best is None:
        reached = shown_time(windows.reached, *problem.span)
        raise InputError(f"no solution beyond t = {reached}: {windows.reason}")
    success, message = _verdict(best, tol, problem.span)
    if best.jump is not None:
        success, message = False, f"{best.jump} ({message})"
    return best.solution.judged(success, message)


def _solution_of(
    problem: InitialValueProblem,
    windows: March,
    basis: FeatureBasis,
    error: MarchError,
    method: str,
) -> Solution:
    """Make the solution of a march, before its verdict."""
    return Solution(
        problem.H,
        problem.z0,
        (problem.span[0], windows.reached),
        FeatureTrial.of_march(windows, basis),
        method=method,
        record=windows,
        error=error,
    )


@dataclass(frozen=True)
class _Attempt:
    """A march, its estimated error, the error that is allowed, shape (dim,), and its solution."""

    windows: March
    estimate: Estimate
    allowed: np.ndarray
    solution: Solution

    @cached_property
    def excess(self) -> float:
        return self.estimate.error.excess(self.allowed)

    @cached_property
    def jump(self) -> str | None:
        """Description of a discontinuity, where nothing else is amiss or the march is in doubt."""
        passed = not self.windows.reason and (self.windows.doubt or self.excess <= 1)
        return self._jump(self.estimate.unresolved) if passed else None

    @property
    def is_too_steep(self) -> bool:
        """Whether only windows that do not resolve the force speak against it."""
        return bool(self.jump and not self.windows.doubt and self._jump([]) is None)

    def _jump(self, suspects: list[tuple[float, float]]) -> str | None:
        return first_jump(self.solution, self.windows.times_in_windows(_JUMP_SAMPLES), suspects)

    @property
    def too_large(self) -> float:
        """Ratio of the error to the allowed one, of which a tighter march has a smaller one."""
        linear = float(ratios(self.estimate.linear, self.allowed).max())
        return max(linear, TIGHTER) if self.estimate.limit else linear

    @cached_property
    def held(self) -> float:
        """Time until which the error is allowed."""
        return self.estimate.error.until(self.allowed)

    @property
    def fails(self) -> bool:
        """Whether it is in doubt, its error is not allowed, or the force seems to jump."""
        return bool(self.windows.doubt) or not self.excess <= 1 or self.jump is not None

    def is_better_than(self, other: _Attempt) -> bool:
        """Return whether it reached further, or else failed less: without doubt, error, time."""
        own, others = (
            abs(float(attempt.windows.edges[-1] - attempt.windows.edges[0]))
            for attempt in (self, other)
        )
        if own != others:
            return own > others
        if (self.fails, self.excess) != (other.fails, other.excess):
            return (self.fails, self.excess) < (other.fails, other.excess)
        start = self.windows.origin + self.windows.edges[0]
        return bool(abs(self.held - start) > abs(other.held - start))


def _verdict(attempt: _Attempt, tol: float, span: tuple[float, float]) -> tuple[bool, str]:
    windows, excess = attempt.windows, attempt.excess
    error, limit = attempt.estimate.error, attempt.estimate.limit
    state = _state(len(windows.readouts), excess)
    held = shown_time(attempt.held, *span)
    if windows.reason:
        until, missing = f"t = {held}", abs(windows.reached - attempt.held)
        reached = shown_time(windows.reached, *span)
        if held == reached:
            until = f"{missing:.1e} before that" if missing else "there"
        return False, (
            f"stopped at t = {reached}: {windows.reason}; tol {tol:.1e} held until {until}"
        )
    if windows.doubt:
        cause = "a close encounter, a narrow pulse, a step or a jump"
        return False, f"{windows.doubt}: {cause}; {state}"
    if excess <= 1:
        return True, success_message(tol, len(windows.readouts), excess)
    # An estimate that ends on the way has no round-off beyond its last window.
    floors = error.floors[np.isfinite(error.floors).all(axis=1)].max(axis=0, initial=0.0)
    if not (floors <= 0.3 * attempt.allowed).all():
        cause = "limited by float64 round-off, beyond which hamsym.enclose goes on; "
    else:
        cause = "" if limit else "the march could not be made accurate enough; "
    return False, f"tol {tol:.1e} met only until t = {held}: {cause}{limit or state}"
