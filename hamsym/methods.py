"""The methods of solution: a table of their names, options and functions.

Nothing that solves is imported here: the command line builds its options from this table, also to
complete a word in a shell.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hamsym.networks.options import (
    AdamOptions,
    DeepOptions,
    LBFGSOptions,
    LevenbergMarquardtOptions,
    SelfScaledBroydenOptions,
    check_options,
)
from hamsym.random_features.options import FeatureOptions

if TYPE_CHECKING:
    from hamsym.problem import InitialValueProblem
    from hamsym.solution.solution import Solution

#: Defaults of :func:`hamsym.solve`.
METHOD, SEED = "features", 0


@dataclass(frozen=True)
class Method:
    """A method of solution."""

    #: Frozen dataclass of its options, with defaults.
    options: type[Any]
    #: (problem, options) -> Solution.
    run: Callable[[InitialValueProblem, Any], Solution]
    #: Whether its trial solution is a march of windows instead of a network.
    marches: bool = False


def _march(problem: InitialValueProblem, options: FeatureOptions) -> Solution:
    from hamsym.random_features.method import solve_by_features

    return solve_by_features(problem, options)


def _train(problem: InitialValueProblem, options: DeepOptions) -> Solution:
    check_options(problem.H, options)
    # torch takes seconds to import, and the method "features" does not need it.
    from hamsym.networks.method import solve_by_training

    return solve_by_training(problem, options)


#: Methods of solution by name.
METHODS: dict[str, Method] = {
    "features": Method(FeatureOptions, _march, marches=True),
    "levenberg-marquardt": Method(LevenbergMarquardtOptions, _train),
    "ssbroyden": Method(SelfScaledBroydenOptions, _train),
    "lbfgs": Method(LBFGSOptions, _train),
    "adam": Method(AdamOptions, _train),
}
