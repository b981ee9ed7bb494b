"""Features of the force that equal steps pass over, where only some of their states are kept.

The steps are taken once more without tangent vectors, in blocks, and searched by
:mod:`hamsym.integrators.hidden_features`.
"""

from __future__ import annotations

import numpy as np

from hamsym.integrators.energy_drift import COARSE
from hamsym.integrators.hidden_features import Path, hidden_features
from hamsym.integrators.stepper import Stepper
from hamsym.problems.ensemble import Ensemble

_HELD = 1_000_000  # components of the states of a block of steps


def first_passed(
    members: Ensemble, method: str, start: float, size: float, steps: int
) -> np.ndarray:
    """Return the time of the first feature that the steps of each member pass over, or nan.

    What all features together may change is the share of the sizes of the components that the
    energy may change, too.
    """
    count = len(members)
    found = np.full(count, np.nan)
    features, values = hidden_features(members.H), members.own_parameters()
    if features is None or not count:
        return found
    sizes = np.full(count, size)
    stepper = Stepper(
        *(members.H, method, members.states, np.full(count, start), sizes),
        parameters=members.parameters,
    )
    block = max(1, _HELD // members.states.size)
    for done in range(0, steps, block):
        taken = min(block, steps - done)
        path = stepper.advance(taken, show=False).path
        times = start + size * np.arange(done, done + taken + 1)
        new = features.passed(Path(path, times), values, COARSE * taken / steps)
        found = np.where(np.isnan(found), new, found)
    return found
