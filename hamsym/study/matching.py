"""Searches for the steps or the tolerance with which an integrator reaches an error."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import StepSizeWarning
from hamsym.integrators.integrate import Trajectory, integrate
from hamsym.integrators.table import INTEGRATORS
from hamsym.solution.solution import Solution

__all__ = [
    "SAMPLES",
    "Match",
    "largest",
    "run",
    "steps_to_match",
    "tolerance_to_match",
    "trajectory",
]

SAMPLES = 4_000  # largest number of intervals at whose ends errors are measured
_RUN_LIMIT = 10.0  # seconds, the predicted limit of one run of a search


@dataclass(frozen=True)
class Match:
    """Steps or tolerance with which an integrator reaches the network's error.

    Attributes
    ----------
    steps : int, optional
        Smallest number of steps, to 1 %; None if the error was not reached, and for an adaptive
        method.
    evaluations : int
    error : float
        Error with these steps or this tolerance, or the smallest error of the search.
    seconds : float
    tolerance : float, optional
        Largest sufficient tolerance of an adaptive method, to a factor of 1.8.
    extrapolated : float, optional
        Steps extrapolated from the largest number tried by the order of the method.
    reason : str
        Reason for which the error was not reached; empty if it was.
    """

    steps: int | None
    evaluations: int
    error: float
    seconds: float
    tolerance: float | None = None
    extrapolated: float | None = None
    reason: str = ""

    def __str__(self) -> str:
        if self.reason:
            far = "" if self.extrapolated is None else f" (extrapolated: {self.extrapolated:.1e})"
            return f"{self.reason}{far}"
        if self.tolerance is not None:
            return f"rtol {self.tolerance:.0e}"
        return f"{self.steps:,}"


def run(solution: Solution, name: str, amount: float) -> Trajectory:
    """Return a trajectory with a number of steps, or of an adaptive method with a tolerance."""
    if INTEGRATORS[name].adaptive:
        return trajectory(solution, name, steps=SAMPLES, rtol=amount)
    # At most SAMPLES states are kept; without a suitable divisor, a few more steps are taken.
    steps = int(amount)
    fewest = math.ceil(steps / SAMPLES)
    divisors = (n for n in range(fewest, 2 * fewest) if steps % n == 0)
    save_every = next(divisors, fewest)
    steps = math.ceil(steps / save_every) * save_every
    return trajectory(solution, name, steps=steps, save_every=save_every)


def trajectory(solution: Solution, name: str, **options: Any) -> Trajectory:
    """Integrate the problem of a solution, without warnings about the step size."""
    with warnings.catch_warnings():
        # Steps that are too long are part of the comparison, and their errors are measured.
        warnings.simplefilter("ignore", StepSizeWarning)
        found = integrate(solution.H, solution.z0, solution.span, name, **options)
    if found.interrupted:
        raise KeyboardInterrupt
    return found


def _error(trajectory: Trajectory, truth: Callable[[np.ndarray], np.ndarray]) -> float:
    """Return max |z - truth|, infinite for a trajectory that stopped early."""
    if not trajectory.success:
        return math.inf
    return largest(np.linalg.norm(trajectory.z - truth(trajectory.t), axis=-1))


def largest(values: np.ndarray) -> float:
    """Return the maximum, infinite if a value is not a number."""
    return float(np.nan_to_num(values, nan=np.inf, posinf=np.inf).max())


def tolerance_to_match(
    solution: Solution, name: str, target: float, truth: Callable[[np.ndarray], np.ndarray]
) -> Match:
    """Search the largest tolerance whose error is at most the target."""
    best = math.inf
    for quarter in range(8, 55):
        tolerance = max(10 ** (-quarter / 4), 2.3e-14)
        trajectory = run(solution, name, tolerance)
        error = _error(trajectory, truth)
        best = min(best, error)
        if error <= target:
            return Match(
                None, trajectory.evaluations, error, trajectory.seconds, tolerance=tolerance
            )
        if trajectory.seconds > _RUN_LIMIT:
            break
    return Match(None, 0, best, 0.0, reason=f"not reached, {best:.1e} at best")


def steps_to_match(
    solution: Solution,
    name: str,
    target: float,
    start: Trajectory,
    truth: Callable[[np.ndarray], np.ndarray],
    max_steps: int,
) -> Match:
    """Search the smallest number of steps, to 1 %, whose error is at most the target.

    The error falls as steps**-order once steps are small, so each guess is scaled by that, kept
    inside the bracket found so far.
    """
    order = INTEGRATORS[name].order
    # Errors above it are not attributed to round-off.
    round_off = 1e-8 * float(np.linalg.norm(solution.scale))
    too_few, enough, best = 1, None, math.inf
    trajectory = start
    for attempt in range(100):
        steps, error = trajectory.steps, _error(trajectory, truth)
        if error <= target:
            enough, error_enough = trajectory, error
        elif steps >= max_steps:
            return _beyond(steps, error, target, order, f"> {_short(max_steps)} steps")
        elif enough is None and steps > 2 * too_few and 0.9 * best < error < round_off:
            return Match(None, 0, best, 0.0, reason=f"not reached: round-off leaves {best:.1e}")
        else:
            too_few = max(too_few, steps)
        best = min(best, error)
        if enough is not None and enough.steps <= max(1.01 * too_few, too_few + 1):
            return Match(enough.steps, enough.evaluations, error_enough, enough.seconds)
        usable = math.isfinite(error) and target > 0
        ratio = (error / target) ** (1 / order) if usable else 10.0
        # Shift the guess to the side that closes the bracket.
        guess = steps * min(ratio, 1e4) * (1.004 if error > target else 0.998)
        if enough is not None and (attempt % 2 or not too_few < guess < enough.steps):
            guess = math.sqrt(too_few * enough.steps)  # where round-off conceals the order
        more = min(max(math.ceil(guess), too_few + 1), max_steps)
        if enough is None and max(trajectory.seconds, 1e-4) * more / steps > _RUN_LIMIT:
            return _beyond(steps, error, target, order, f"> {_short(steps)} steps")
        trajectory = run(solution, name, more)
    return _beyond(steps, error, target, order, f"> {_short(too_few)} steps")


def _beyond(steps: int, error: float, target: float, order: int, reason: str) -> Match:
    """Return a match with extrapolated steps."""
    usable = math.isfinite(error) and target > 0
    far = steps * (error / target) ** (1 / order) if usable else None
    return Match(None, 0, error, 0.0, extrapolated=far, reason=reason)


def _short(steps: int) -> str:
    """Return a number of steps in few characters."""
    return f"{steps:.0e}".replace("e+0", "e") if steps >= 10**6 else f"{steps:,}"
