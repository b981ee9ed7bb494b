"""Drift of known invariants along trajectories, and whether the allowed errors explain it."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.ensemble import Ensemble


def invariant_drifts(
    members: Ensemble,
    known: KnownInvariants,
    z: np.ndarray,
    times: np.ndarray,
    tol: float,
    errors: np.ndarray | None = None,
) -> tuple[dict[str, Any], dict[int, tuple[str, str]]]:
    """Return largest changes of invariants, and those that ``tol`` does not explain.

    - errors: Estimated errors of the states, which explain more where they are larger: tolerances
      of components that are zero are.
    - returns: The changes by formula; by number of a trajectory the formula of the first invariant
      that drifts too far, and the reason for a refusal.
    """
    drifts = {name: np.zeros(len(members)) for name in known.formulas}
    refused: dict[int, tuple[str, str]] = {}
    for index in range(len(members) if known else 0):
        path = z[index][np.isfinite(z[index]).all(axis=-1)]
        if not len(path):
            continue
        allowed = tol * np.abs(path).max(axis=0)
        if errors is not None:
            own = errors[index, : len(path)]
            allowed = np.maximum(allowed, np.where(np.isfinite(own), own, 0).max(axis=0))
        values = members.own_parameters([index])
        change, explained = known.drifts(
            path[:1], times[0], path, times[: len(path)], allowed, values
        )
        for name, largest in known.largest(change).items():
            drifts[name][index] = largest
        if reason := known.verdict(change, explained):
            first = int(np.argmin((change <= explained).all(axis=1)))
            refused[index] = known.formulas[first], reason
    shape = members.shape
    found = {n: own.reshape(shape) if shape else float(own[0]) for n, own in drifts.items()}
    return found, refused
