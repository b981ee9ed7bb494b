"""Acceptance of a solution: its estimated error is within the tolerance, without a doubt.

Known invariants may refuse it afterwards.

Input:  a solution whose error is estimated, and what a method found amiss.
Output: the solution with its verdict and the reason.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hamsym.numerics.scales import ratios
from hamsym.problems.conservation import KnownInvariants
from hamsym.solution.solution import Solution
from hamsym.solution.times import shown_time


def excess(solution: Solution) -> float:
    """Return the largest ratio of an estimated error, round-off included, to the allowed one."""
    return float(ratios(solution.largest_error, solution.allowed_error).max())


def held(solution: Solution) -> float:
    """Return the time until which the estimated error is allowed."""
    if solution.error is not None:
        return solution.error.until(solution.allowed_error)
    times = solution.scan_times
    good = (np.abs(solution.error_estimate(times)) <= solution.allowed_error).all(axis=-1)
    return float(times[-1] if good.all() else times[max(0, int(np.argmin(good)) - 1)])


def with_error(state: str, ratio: float) -> str:
    """Return clauses about a solution with the ratio of its error to the allowed one."""
    return f"{state}, estimated error {ratio:.1e} of the tolerance"


def met(tol: float, state: str) -> str:
    """Return the message of a solution that meets its tolerance."""
    return f"tol {tol:.1e} met: {state}"


def accepted(
    solution: Solution,
    state: str,
    *,
    stopped: str = "",
    doubt: str = "",
    jump: str | None = None,
    cause: str = "",
) -> Solution:
    """Return the solution with its verdict.

    - state: Clauses about size and cost, for the message.
    - stopped: Why the solution ends before the span does.
    - doubt: Why its estimate may not hold.
    - jump: Description of a discontinuity of H on the way.
    - cause: Why the error could not be made smaller.
    """
    ratio, tol, span = excess(solution), solution.settings.tol, solution.settings.span
    state = with_error(state, ratio)
    reached = solution.span[1]
    if stopped and jump is not None:
        at = shown_time(reached, *span)
        return solution.judged(False, f"stopped at t = {at}: {stopped}; {jump}")
    if stopped:
        until = held(solution)
        shown, missing = shown_time(until, *span), abs(reached - until)
        if shown == shown_time(reached, *span):
            shown = f"{missing:.1e} before that" if missing else "there"
        else:
            shown = f"t = {shown}"
        return solution.judged(
            False,
            f"stopped at t = {shown_time(reached, *span)}: {stopped}; tol {tol:.1e} held until "
            f"{shown}",
        )
    if jump is not None:
        return solution.judged(False, f"{jump} ({state})")
    if doubt:
        return solution.judged(False, f"{doubt}; {state}")
    if ratio <= 1:
        return solution.judged(True, met(tol, state))
    end = shown_time(held(solution), *span)
    return solution.judged(False, f"tol {tol:.1e} met only until t = {end}: {cause}; {state}")


def judged_by_invariants(solution: Solution, known: KnownInvariants) -> Solution:
    """Return the solution with the drifts of known invariants, which may refuse it."""
    times = solution.scan_times
    change, explained = known.drifts(
        solution.z0[None], solution.span[0], solution(times), times, solution.allowed_error
    )
    solution = replace(solution, invariant_drift=known.largest(change))
    reason = known.verdict(change, explained)
    if not reason or not solution.success:
        return solution
    return solution.judged(False, f"{reason}; {solution.message}")
