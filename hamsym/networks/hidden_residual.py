"""The residual of a jointly trained network between all times at which it is sampled.

The training and the estimate of the error sample the residual dz^/dt - J grad H(z^). A pulse of the
force that is narrower than their distance leaves no trace there, although it moves the solution.
So the residual is bounded on windows of the span (:mod:`hamsym.bounds.residual`) and compared with
the usual one at places that resolve the network.
"""

from __future__ import annotations

import math

import numpy as np

from hamsym.bounds.models import NODES
from hamsym.bounds.residual import NOISE, ExcessSearch, Parts, Places
from hamsym.random_features.flow import flow_of
from hamsym.random_features.window_checks import Pieces, places_of
from hamsym.solution.solution import Solution
from hamsym.support.machine import one_core

# A window may hide four times its limit: the residual of 1/32 of the span.
_LEAST_WINDOWS = 256
# Times the median of the residual at the places of a window: a pulse that a few of them meet adds
# nothing to it.
_USUAL = 2.0
_POINTS = 16  # of collocation in a window at most: less than half of the degree of the bounds
_SHARE = 0.1  # of the allowed error that the windows may hide in all


def hidden_residual(solution: Solution) -> str:
    """Describe the first residual that the estimate may have missed, "" if there is none."""
    flow = flow_of(solution.H)
    if flow.is_short_polynomial:
        return ""
    count = max(_LEAST_WINDOWS, math.ceil(solution.points / _POINTS))
    edges = np.linspace(*solution.span, count + 1)
    pieces = Pieces(edges[:-1], edges[1:], np.empty((count, 0)), np.empty((count, 0, 0)))

    def trial(parts: Parts) -> Places:
        return places_of(solution.evaluate, pieces, parts, NODES)

    def rates(z: np.ndarray, t: np.ndarray, _window: np.ndarray) -> np.ndarray:
        return flow.vector_field(z, t, flow.parameters)

    at = trial(Parts.whole(count))
    with one_core(), np.errstate(all="ignore"):  # the products are too small for more
        found = rates(at.z.reshape(-1, at.z.shape[2]), at.t.ravel(), np.empty(0))
        usual = np.median(np.abs(at.rates - found.reshape(at.z.shape)), axis=1)
        length = abs(solution.span[1] - solution.span[0]) / count
        limits = _USUAL * length * usual + _SHARE / count * solution.allowed_error
        search = ExcessSearch(
            *(flow.programs, rates, trial, np.stack((pieces.start, pieces.end))),
            *(limits, flow.parameters, NOISE, True),
        )
        excesses = search.run()
    if not excesses:
        return ""
    first = excesses[0]
    return (
        f"near t = {first.time:.6g}, between the points of collocation, the residual changes by "
        f"{first.ratio:.0e} times what the estimated error knows: a narrow pulse, a step or a jump"
    )
