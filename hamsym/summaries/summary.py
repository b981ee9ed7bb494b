"""summary(): what a result says as text, chosen by its type."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from hamsym.errors import InputError
from hamsym.integrators.trajectory import Trajectory
from hamsym.solution.solution import Solution
from hamsym.summaries.solutions import solution_summary
from hamsym.summaries.trajectories import trajectory_summary


@singledispatch
def summary(result: Any, *args: Any, **options: Any) -> str:
    """Describe a result in a few lines, the largest error against what was asked first.

    Parameters
    ----------
    result : Solution, Trajectory or another result with a method ``summary``
    *args, **options
        As in the method ``summary`` of the result.

    Raises
    ------
    InputError
        If the result has no summary.

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5), tol=1e-6)
    >>> print(summary(solution).splitlines()[0])
    converged: largest estimated error ... in ..., ... % of the 1.0e-06 asked
    """
    if not callable(getattr(result, "summary", None)):
        raise InputError(f"{type(result).__name__} has no summary; give a result of hamsym")
    return str(result.summary(*args, **options))


summary.register(Solution, solution_summary)
summary.register(Trajectory, trajectory_summary)
