"""Checks that the numbers of a solution are finite, of exact types, and in arrays that fit.

A proof takes every stored number as the exact binary fraction that it is.
"""

from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np

from hamsym.errors import CertificationError
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution


def require_exact(solution: Solution) -> None:
    """Require that z0, the span and all weights are finite numbers of exact types.

    Raises
    ------
    CertificationError
        Naming the first number or array that is not, and the remedy.
    """
    z0, dim = solution.z0, solution.H.dim
    if not isinstance(z0, np.ndarray) or z0.dtype != np.float64 or z0.shape != (dim,):
        raise CertificationError(
            f"z0 of the solution is not an array of {dim} float64 numbers; solve again"
        )
    if not np.isfinite(z0).all():
        raise CertificationError("z0 of the solution is not finite; solve again")
    if not all(
        isinstance(edge, (int, float)) and abs(edge) <= sys.float_info.max for edge in solution.span
    ):
        raise CertificationError("the span of the solution is not two finite times; solve again")
    if float(solution.span[0]) == float(solution.span[1]):
        raise CertificationError("the span of the solution is empty; solve again")
    _require_exact_trial(solution.trial, dim)


def _require_exact_trial(trial: Any, dim: int) -> None:
    networks = [] if isinstance(trial, FeatureTrial) else _networks_of(trial)
    for name, array in trial.arrays().items():
        if array.dtype not in (np.float64, np.float32):
            raise CertificationError(
                f"'{name}' of the solution has type {array.dtype}, not float64 or float32; "
                "solve again"
            )
        if not np.isfinite(array).all():
            raise CertificationError(f"'{name}' of the solution is not finite; solve again")
    fits = _features_fit(trial, dim) if isinstance(trial, FeatureTrial) else bool(networks)
    if not fits or not all(_network_fits(network, dim) for network in networks):
        raise CertificationError("the arrays of the solution do not fit together; solve again")


def _features_fit(trial: FeatureTrial, dim: int) -> bool:
    if trial.readouts.ndim != 3 or trial.series.ndim != 2:
        return False
    count, columns, components = trial.readouts.shape
    return (
        components == dim
        and trial.edges.shape == (count + 1,)
        and trial.states.shape == (count + 1, dim)
        and len(trial.series) > 0
        and trial.series.shape[1] == columns
    )


def _networks_of(trial: Any) -> list[Any]:
    """The deep networks of which a trial solution consists."""
    # Only where torch is imported already can there be one.
    modules = (("hamsym.networks.trial", "TrialSolution"), ("hamsym.networks.chain", "Chain"))
    kinds = [getattr(sys.modules[name], kind) for name, kind in modules if name in sys.modules]
    if not isinstance(trial, tuple(kinds)):
        raise CertificationError(
            f"the trial solution is a {type(trial).__name__}, which has no enclosure; solve by "
            "'features', or with a network of hamsym"
        )
    return list(getattr(trial, "pieces", [trial]))


def _network_fits(network: Any, dim: int) -> bool:
    """Whether the weights have the shapes that their layers need, and the outputs are dim.

    Raise CertificationError if ``t0`` or ``tau`` cannot be used.
    """
    from hamsym.networks.network import weights_of  # needs torch

    if sum(part.sizes[-1] for part in network.parts) != dim or network.z0.shape != (dim,):
        return False
    if any(part.theta.shape != (weights_of(part.sizes),) for part in network.parts):
        return False
    for name in ("t0", "tau"):
        value = getattr(network, name)
        if type(value) is not float or not math.isfinite(value) or (name, value) == ("tau", 0):
            raise CertificationError(
                f"{name} of the solution is not a finite, nonzero float64 number; solve again"
            )
    return True
