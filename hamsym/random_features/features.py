"""The method "features" with its options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from hamsym.support.method_object import Method, documented, option
from hamsym.support.validation import require_positive

if TYPE_CHECKING:
    from hamsym.problems.problem import InitialValueProblem
    from hamsym.solution.solution import Solution

#: Windows of a span, so that a short event in a long rest is sampled.
FEWEST_WINDOWS = 8


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class Features(Method):
    """Random sine features, marched window by window until the estimated error meets ``tol``.

    The default method of :func:`hamsym.solve`. The readouts of each window are the solution of a
    nonlinear least-squares problem; hidden weights are drawn once and never trained.

    Examples
    --------
    >>> import hamsym
    >>> short = hamsym.Features(max_window=0.5)
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 9), method=short)
    >>> solution.success, bool(len(solution.record.edges) > 18)
    (True, True)
    """

    name = "features"
    usual_tol = 1e-9
    marches = True

    max_window: float | None = option(
        None,
        "Longest window.",
        "Residuals are bounded on whole windows, so that no feature of H is missed; shorter "
        "windows resolve one that leaves a march in doubt.",
        default_text=f"span/{FEWEST_WINDOWS}",
        unit="TIME",
    )

    def check(self) -> None:
        """Raise InputError if an option is invalid."""
        if self.max_window is not None:
            require_positive("max_window", self.max_window)

    def solve(self, problem: InitialValueProblem) -> Solution:
        """Solve by marching random features to the tolerance of the problem."""
        from hamsym.random_features.method import solve_by_features

        return solve_by_features(problem, self)
