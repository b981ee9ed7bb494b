"""Searches for the steps or the tolerance with which an integrator reaches an error.

The error of a fixed-step method falls as steps**-order once steps are small. So the runs that are
known predict the number of steps, one or two runs confirm it, and numbers that would take too long
are extrapolated. Errors of adaptive methods fall about as a power of the tolerance, which predicts
it in the same way.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import StepSizeWarning
from hamsym.integrators.integrate import integrate
from hamsym.integrators.table import INTEGRATORS
from hamsym.integrators.trajectory import Trajectory
from hamsym.solution.solution import Solution
from hamsym.study.references import SAMPLES, ReferenceSolution, largest

_SEARCH_SECONDS = 2.0  # of the runs of one search
_NEAR = 0.008  # relative distance of steps that counts as the smallest number, within 1 %
_UNKNOWN = "unknown: the error of the reference is larger"
_TOLERANCES = [max(10 ** (-quarter / 4), 2.3e-14) for quarter in range(8, 56)]


@dataclass(frozen=True)
class Match:
    """Steps or tolerance with which an integrator reaches the network's error."""

    #: Smallest number of steps, to 1 % where the reference is a hundred times better than the
    #: network; None if the error was not reached, and for an adaptive method.
    steps: int | None
    evaluations: int
    #: Error with these steps or this tolerance, or the smallest error of the search.
    error: float
    seconds: float
    #: Largest sufficient tolerance of an adaptive method, to a factor of 1.8.
    tolerance: float | None = None
    #: Steps extrapolated from the largest number tried by the order of the method, if the errors
    #: fall by this order.
    extrapolated: float | None = None
    #: Why there is no number: the error was not reached, or is so near to that of the reference
    #: that only a bound is known. Empty if there is one.
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


def _error(trajectory: Trajectory, truth: ReferenceSolution) -> float:
    """Return max |z - truth|, infinite for a trajectory that stopped early."""
    if not trajectory.success:
        return math.inf
    return largest(np.linalg.norm(trajectory.z - truth(trajectory.t), axis=-1))


def find_match(
    solution: Solution,
    name: str,
    target: float,
    paths: Sequence[Trajectory],
    truth: ReferenceSolution,
    max_steps: int,
) -> Match:
    """Search what an integrator needs for an error, from trajectories that are known.

    The error to be reached and those of the integrator are known up to the error u of the
    reference. Where u is more than a tenth of it, the number of steps is unknown by far more than
    1 %. Certain is only that steps with a measured error above target + 2 u are too few.

    - target: The error, measured against the same reference.
    - paths: With numbers of steps that rise, or with the first three powers of 1e-3 as tolerances.
    """
    if not target < math.inf:
        return Match(None, 0, target, 0.0, reason="unknown: the network's error is not finite")
    if not truth.error < math.inf:
        return Match(None, 0, math.inf, 0.0, reason=_UNKNOWN)
    known = truth.judges(target)
    bound = target if known else target + 2 * truth.error
    search = _Search(solution, name, bound, truth)
    if INTEGRATORS[name].adaptive:
        found, below = search.tolerance(paths)
        least = f"rtol below {below:.0e}" if below < math.inf else _UNKNOWN
    else:
        found = search.steps(paths, max_steps)
        fewest = math.floor(0.99 * (found.steps or 0))
        least = f"at least {fewest:,} steps" if fewest > 1 else _UNKNOWN
    if known:
        return found
    return Match(None, 0, found.error, 0.0, reason=found.reason or least)


#: A trajectory and its error.
Run = tuple[Trajectory, float]


class _Search:
    """A search, with the seconds that its runs took."""

    def __init__(
        self, solution: Solution, name: str, target: float, truth: ReferenceSolution
    ) -> None:
        self._solution, self._name = solution, name
        self._target, self._truth = target, truth
        self._order = INTEGRATORS[name].order
        self._left = _SEARCH_SECONDS

    def _run(self, amount: float) -> Run:
        path = run(self._solution, self._name, amount)
        self._left -= path.seconds
        return path, _error(path, self._truth)

    # -- steps -----------------------------------------------------------------------------------

    def steps(self, paths: Sequence[Trajectory], max_steps: int) -> Match:
        """Search the smallest number of steps, to 1 %, whose error is at most the target."""
        # Errors above it are not attributed to round-off.
        round_off = 1e-8 * float(np.linalg.norm(self._solution.scale))
        waiting = [(p, _error(p, self._truth)) for p in paths if p.steps <= max_steps]
        runs: list[Run] = []
        enough: Run | None = None
        too_few, best, guess = 0, math.inf, max_steps
        for attempt in range(100):
            path, error = waiting.pop(0) if waiting else self._run(guess)
            runs.append((path, error))
            if error <= self._target:
                if enough is None or path.steps < enough[0].steps:
                    enough = path, error
                waiting.clear()  # more steps than are sufficient
            elif enough is None and path.steps > 2 * too_few and 0.9 * best < error < round_off:
                return Match(None, 0, best, 0.0, reason=f"not reached: round-off leaves {best:.1e}")
            else:
                too_few = max(too_few, path.steps)
            best = min(best, error)
            if waiting:
                continue
            if enough is not None and self._is_smallest(enough, too_few, runs):
                return Match(enough[0].steps, enough[0].evaluations, enough[1], enough[0].seconds)
            if enough is None and path.steps >= max_steps:
                break
            guess = self._guess(runs, enough, too_few, attempt)
            rate = max(path.seconds, 1e-4) / path.steps
            if enough is not None:
                if rate * guess > self._left:
                    between = f"{too_few + 1:,} to {enough[0].steps:,} steps"
                    return Match(None, 0, enough[1], 0.0, extrapolated=guess, reason=between)
            elif guess > max_steps or rate * guess > self._left:
                # Where the known runs do not show the order, a longer one may.
                most = int(min(0.5 * self._left / rate, max_steps))
                shown = self._target > 0 and self._is_regular((path, error), runs)
                if shown or most < 2 * path.steps:
                    break
                guess = most
        return self._beyond(runs)

    def _guess(self, runs: list[Run], enough: Run | None, too_few: int, attempt: int) -> int:
        """Predict the number of steps, by the order from the run that is nearest to the target."""
        usable = [(path.steps, error) for path, error in runs if 0 < error < math.inf]
        if not usable or not self._target > 0:
            guess = 10.0 * runs[-1][0].steps
        else:
            steps, error = min(usable, key=lambda run: abs(math.log(run[1] / self._target)))
            ratio = min((error / self._target) ** (1 / self._order), 1e12)
            # Shift the guess to the side that closes the bracket.
            guess = steps * ratio * (1 + _NEAR / 2 if error > self._target else 1 - _NEAR / 2)
        if enough is None:
            return max(math.ceil(guess), too_few + 1)
        if attempt % 3 == 2 or not too_few < guess < enough[0].steps:  # the order is concealed
            guess = math.sqrt(max(too_few, 1) * enough[0].steps)
        return min(max(math.ceil(guess), too_few + 1), enough[0].steps - 1)

    def _is_smallest(self, enough: Run, too_few: int, runs: list[Run]) -> bool:
        """Whether a sufficient number of steps is the smallest one, to 1 %."""
        path, error = enough
        if path.steps <= max(1.01 * too_few, too_few + 1):
            return True
        # Few steps are searched to the end: that takes no time, and their errors are irregular.
        near = error >= self._target * (1 - _NEAR) ** self._order and path.steps > SAMPLES
        return near and self._is_regular(enough, runs)

    def _is_regular(self, run: Run, runs: list[Run]) -> bool:
        """Whether the error falls between two runs as the order says, to 1 % in steps.

        The next term of the error is a share a of the leading one if the constants error *
        steps**order of two runs differ by a times the ratio of their steps less 1, or more.
        """
        steps, error = run[0].steps, run[1]
        others = [(path.steps, e) for path, e in runs if abs(math.log(path.steps / steps)) > 0.2]
        if not others:
            return False
        other = min(others, key=lambda known: abs(math.log(known[0] / steps)))
        (coarse, large), (fine, small) = sorted(((steps, error), other))
        if not (0 < small < math.inf and 0 < large < math.inf):
            return False
        ratio = fine / coarse
        change = abs(large / small / ratio**self._order - 1)
        return change <= min(0.01 * self._order * (ratio - 1), 0.5)

    def _beyond(self, runs: list[Run]) -> Match:
        """Return a match with steps extrapolated by the order, if the errors show it."""
        path, error = finest = max(runs, key=lambda run: run[0].steps)
        far = None
        if self._target > 0 and self._is_regular(finest, runs):
            far = path.steps * (error / self._target) ** (1 / self._order)
        reason = f"> {_short(path.steps)} steps"
        return Match(None, 0, error, 0.0, extrapolated=far, reason=reason)

    # -- tolerances ------------------------------------------------------------------------------

    def tolerance(self, paths: Sequence[Trajectory]) -> tuple[Match, float]:
        """Search the largest tolerance whose error is at most the target.

        The second result is the smallest tolerance known to be too large.
        """
        last = len(_TOLERANCES) - 1
        runs = {
            place: (path, _error(path, self._truth))
            for place, path in zip((4, 16, 28), paths, strict=True)  # 1e-3, 1e-6, 1e-9
        }
        for attempt in itertools.count():
            good = min((k for k, (_, e) in runs.items() if e <= self._target), default=last + 1)
            bad = max((k for k in runs if k < good), default=-1)
            below = _TOLERANCES[bad] if bad >= 0 else math.inf
            if good == bad + 1 and good <= last:
                path, error = runs[good]
                tolerance = _TOLERANCES[good]
                return Match(None, path.evaluations, error, path.seconds, tolerance), below
            if bad == last or self._left < 0:
                break
            place = self._place(runs) if attempt % 3 < 2 or good > last else (bad + good) // 2
            place = min(max(place, bad + 1), good - 1)
            runs[place] = self._run(_TOLERANCES[place])
        best = min(error for _, error in runs.values())
        reason = f"not reached, {best:.1e} at best" if bad == last else f"rtol below {below:.0e}"
        return Match(None, 0, best, 0.0, reason=reason), below

    def _place(self, runs: Mapping[int, Run]) -> int:
        """Predict the place of the tolerance in the table, by a line through two known errors."""
        usable = [(k, math.log(error)) for k, (_, error) in runs.items() if 0 < error < math.inf]
        if len(usable) < 2 or not self._target > 0:
            return max(runs) + 8
        wanted = math.log(self._target)
        nearest = sorted(usable, key=lambda known: abs(known[1] - wanted))
        (first, a), (second, b) = sorted(nearest[:2])
        if not b < a:  # round-off conceals the slope
            return max(runs) + 4
        return math.ceil(first + (wanted - a) / (b - a) * (second - first))


def _short(steps: int) -> str:
    """Return a number of steps in few characters, not rounded up."""
    power = len(str(steps)) - 1
    return f"{steps // 10**power}e{power}" if steps >= 10**6 else f"{steps:,}"
