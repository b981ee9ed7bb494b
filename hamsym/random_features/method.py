"""The method "features": random sine features marched until the estimated error meets tol.

Stage 1  March with a local tolerance (:mod:`hamsym.random_features.march`).
Stage 2  Estimate the global error and the round-off along the march
         (:mod:`hamsym.random_features.error_estimate`).
Stage 3  If both together exceed the tolerance, or the windows of a loose one do not resolve the
         force or leave the march in doubt, march again with a tighter local tolerance.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import ratios
from hamsym.problems.problem import InitialValueProblem
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.error_estimate import Estimate, MarchError, estimate_error
from hamsym.random_features.features import Features
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import REST, SHORT, march
from hamsym.random_features.members import (
    LEAST_STEP,
    MARGIN,
    MOST_STEP,
    SMALLEST,
    TIGHTER,
    MemberSolver,
    basis_for,
    checked_accuracy,
)
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.acceptance import accepted, excess, held, met, with_error
from hamsym.solution.discontinuities import first_jump
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution
from hamsym.solution.times import shown_time
from hamsym.solution.window_error import relative_tolerance

_ATTEMPTS = 6
_LOOSER, _NEAR_ROUND_OFF = 4.0, 1e-11  # local tolerance of a march after one that is in doubt
_MOST_NAMES = 6  # in a message
_JUMP_SAMPLES = 25  # of a window, in the search for jumps of the force


def solve_by_features(problem: InitialValueProblem, method: Features) -> Solution:
    """Solve by marching random features to the tolerance of the problem."""
    H, span = problem.H, problem.span
    accuracy = checked_accuracy(problem.tol, problem.atol, method.max_window, span, H.dim)
    basis = basis_for(problem.seed, accuracy.tol)
    if not problem.breakpoints and MemberSolver.applies(H):
        flow = flow_of(H)
        if flow.energy is None:
            problem.require_finite()  # of its values a march sees none
        found = MemberSolver(H, span, accuracy, basis).solve_one(problem.z0, flow.parameters)
        if found is not None and not _crept(problem.z0, found.march.edges):
            # The library judged it; to judge it here again takes 25 us, a fifth of a short solve.
            message = met_message(accuracy.tol, len(found.march.readouts), found.excess)
            given = found.march, basis.series, found.error, Settings.of(problem, method)
            return solution_of(H, problem.z0, *given, success=True, message=message)
    return solve_by_march(problem, method, basis)


def _crept(z0: np.ndarray, edges: np.ndarray) -> bool:
    """Whether windows began short, as for components at rest, which the other march foresees."""
    lengths = np.abs(np.diff(edges))
    return bool((z0 == 0).any() and lengths[0] < SHORT * lengths.max())


def met_message(tol: float, windows: int, excess: float) -> str:
    """Return the message of a march that meets its tolerance."""
    return met(tol, with_error(state_of(windows), excess))


def state_of(windows: int) -> str:
    """Return the number of windows, for a message."""
    return f"{windows:,} windows"


def solution_of(
    H: Hamiltonian,
    z0: np.ndarray,
    windows: March,
    series: np.ndarray,
    error: MarchError,
    settings: Settings,
    name: str = Features.name,
    **verdict: Any,
) -> Solution:
    """Make the solution of a march, by default before its verdict.

    - series: Of the columns of its basis.
    """
    return Solution(
        H,
        z0,
        (settings.span[0], windows.reached),
        FeatureTrial.of_march(windows, series),
        method=name,
        record=windows,
        settings=settings,
        error=error,
        **verdict,
    )


def solve_by_march(problem: InitialValueProblem, method: Features, basis: FeatureBasis) -> Solution:
    """Solve by marching windows of a basis to a tolerance; the solution has the method's name."""
    problem.require_finite()
    H, span = problem.H, problem.span
    accuracy = checked_accuracy(problem.tol, problem.atol, method.max_window, span, H.dim)
    local, stops = accuracy.local, problem.window_ends()
    settings, flow = Settings.of(problem, method), flow_of(H)
    best: _Attempt | None = None
    loosened = tightened = False
    with np.errstate(all="ignore"):
        for _ in range(_ATTEMPTS):
            windows = march(
                flow,
                problem.z0,
                span,
                local,
                basis,
                breakpoints=stops,
                longest=accuracy.longest,
                absolute=accuracy.absolute / relative_tolerance(accuracy.tol),
            )
            if not len(windows.readouts):
                break
            estimate = estimate_error(windows, basis, flow, local)
            error = estimate.error
            given = windows, basis.series, error, settings, method.name
            solution = solution_of(H, problem.z0, *given)
            tried = _Attempt(windows, estimate, solution)
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
                not (estimate.limit or estimate.hidden)
                and (error.largest <= np.maximum(2 * floors, tried.allowed)).all()
            )
            if tried.excess <= 1 or at_round_off or local <= SMALLEST:
                break
            local = max(local * min(max(MARGIN / tried.too_large, LEAST_STEP), MOST_STEP), SMALLEST)
    if best is None:
        reached = shown_time(windows.reached, *span)
        raise InputError(f"no solution beyond t = {reached}: {windows.reason}")
    return accepted(
        best.solution,
        state_of(len(best.windows.readouts)),
        stopped=best.windows.reason,
        jump=best.jump,
        doubt=best.doubt,
        cause=best.cause,
    )


@dataclass(frozen=True)
class _Attempt:
    """A march, its estimated error, and its solution."""

    windows: March
    estimate: Estimate
    solution: Solution

    @property
    def allowed(self) -> np.ndarray:
        """Error that is allowed, shape (dim,)."""
        return self.solution.allowed_error

    @cached_property
    def excess(self) -> float:
        return excess(self.solution)

    @property
    def doubt(self) -> str:
        """Why its estimate may not hold, empty without a reason."""
        cause = "a close encounter, a narrow pulse, a step or a jump"
        return self.windows.doubt and f"{self.windows.doubt}: {cause}"

    @property
    def cause(self) -> str:
        """Why its error could not be made smaller."""
        # An estimate that ends on the way has no round-off beyond its last window.
        floors = self.estimate.error.floors
        floors = floors[np.isfinite(floors).all(axis=1)].max(axis=0, initial=0.0)
        limit = self.estimate.limit
        rounded = ~(floors <= 0.3 * self.allowed)
        if rounded.any():
            cause = "limited by float64 round-off, beyond which hamsym.enclose goes on"
            if (self.windows.scale < self.estimate.error.scale)[rounded].all():
                names = ", ".join(np.array(self.solution.H.names)[rounded][:_MOST_NAMES])
                cause = f"limited by float64 round-off of {names}, whose terms cancel: give atol"
            return f"{cause}; {limit}" if limit else cause
        return limit or "the march could not be made accurate enough"

    @cached_property
    def jump(self) -> str | None:
        """Description of a discontinuity, where nothing else is amiss or the march is in doubt."""
        passed = not self.windows.reason and (self.windows.doubt or self.excess <= 1)
        searched = passed or self.windows.reason == REST
        return self._jump(self.estimate.unresolved) if searched else None

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
        return bool(abs(held(self.solution) - start) > abs(held(other.solution) - start))
