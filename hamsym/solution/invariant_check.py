"""Known invariants in the judgement of a solution."""

from __future__ import annotations

from dataclasses import replace

from hamsym.problems.conservation import KnownInvariants
from hamsym.solution.solution import Solution


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
