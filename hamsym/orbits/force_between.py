"""The force along an arc between the points of its windows.

Newton's method and the estimated error know the force at the points of the windows alone. In each
window it is bounded how far the force along the arc, a polynomial there, is from the polynomial
through its values at the points (:mod:`hamsym.bounds.residual`). A feature between the points, for
example a barrier that is narrower than their distance, shows whatever its width and its place.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.bounds.models import NODES
from hamsym.bounds.residual import NOISE, ROUND_OFF, ExcessSearch, Parts, Places
from hamsym.numerics.collocation import collocation
from hamsym.orbits.arc import Arc, Problem
from hamsym.random_features.flow import flow_of


def missed_feature(problem: Problem, arc: Arc, tol: float) -> str:
    """Describe where the force may differ from its values at the points, or an empty text.

    All windows together may miss a change of the states of the size that the tolerance allows.
    """
    flow = flow_of(problem.H)
    if flow.is_short_polynomial:
        return ""
    count, nodes, dim = arc.values.shape
    duration = arc.period / problem.closing.parts
    lengths = np.diff(arc.edges) * duration
    # Without a clock the time starts at 0 in each window: sums of it are rounded.
    start = np.zeros(count) if problem.autonomous else problem.start + arc.edges[:-1] * duration
    rule = collocation(nodes)
    with np.errstate(all="ignore"):
        at = start[:, None] + lengths[:, None] * rule.nodes
        force = flow.vector_field(arc.values.reshape(-1, dim), at.ravel())
        force = np.broadcast_to(force, (count * nodes, dim)).reshape(arc.values.shape)
        limits = tol / count * problem.scale_of(arc)
        limits = limits + ROUND_OFF * lengths[:, None] * np.abs(force).max(axis=1)
    curve, slopes = rule.to_series @ arc.values, rule.to_series @ force

    def rates(z: np.ndarray, t: np.ndarray, _window: np.ndarray) -> np.ndarray:
        return np.asarray(np.broadcast_to(flow.vector_field(z, t), z.shape))

    def trial(parts: Parts) -> Places:
        s = parts.places(NODES)
        basis = chebyshev.chebvander(2 * s - 1, nodes - 1)
        t = start[parts.window, None] + lengths[parts.window, None] * s
        return Places(basis @ curve[parts.window], basis @ slopes[parts.window], t)

    found = ExcessSearch(
        *(flow.programs, rates, trial, np.stack((start, start + lengths))),
        *(limits, flow.parameters, NOISE, True),
    ).run()
    if not found:
        return ""
    first = found[0]
    since = problem.start + float(arc.edges[first.window]) * duration
    time = since + first.time - float(start[first.window])
    return (
        f"near t = {time:.6g} the force has a feature, for example a barrier or a pulse, between "
        "the points of the windows; give a guess on an orbit that does not meet it"
    )
