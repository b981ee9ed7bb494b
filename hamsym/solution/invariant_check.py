"""Known invariants in the judgement of a solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hamsym.conservation import KnownInvariants
from hamsym.solution.solution import Solution


def judged_by_invariants(
    solution: Solution, known: KnownInvariants, allowed: np.ndarray
) -> Solution:
    """Return the solution with the drifts of known invariants, which may refuse it.

    - allowed: Allowed errors of the components, shape (dim,).
    """
    times = solution.scan_times
    change, explained = known.drifts(
        solution.z0[None], solution.span[0], solution(times), times, allowed
    )
    solution = replace(solution, invariant_drift=known.largest(change))
    reason = known.verdict(change, explained)
    if not reason or not solution.success:
        return solution
    return solution.judged(False, f"{reason}; {solution.message}")
