"""Drift of known invariants along trajectories, and whether the allowed errors explain it."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.integrators.compared_runs import Tolerated
from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.ensemble import Ensemble


def invariant_drifts(
    members: Ensemble,
    known: KnownInvariants,
    z: np.ndarray,
    times: np.ndarray,
    found: Tolerated | None,
    tol: float,
) -> tuple[dict[str, Any], str]:
    """Return largest changes of invariants, and the first that ``tol`` does not explain.

    Trajectories of ``found`` that drift more than that fail.
    """
    drifts = {name: np.zeros(len(members)) for name in known.formulas}
    first = ""
    for index in range(len(members) if known else 0):
        path = z[index][np.isfinite(z[index]).all(axis=-1)]
        if not len(path):
            continue
        allowed = tol * np.abs(path).max(axis=0)
        if found is not None:  # zero components have larger tolerances
            errors = found.errors[index, : len(path)]
            allowed = np.maximum(allowed, np.where(np.isfinite(errors), errors, 0).max(axis=0))
        own = members.own_parameters([index])
        change, explained = known.drifts(path[:1], times[0], path, times[: len(path)], allowed, own)
        for name, largest in known.largest(change).items():
            drifts[name][index] = largest
        if reason := known.verdict(change, explained):
            first = first or known.formulas[int(np.argmin((change <= explained).all(axis=1)))]
            if found is not None and found.success[index]:
                found.success[index] = False
                found.problems[index] = reason
    shape = members.shape
    return {n: own.reshape(shape) if shape else float(own[0]) for n, own in drifts.items()}, first
