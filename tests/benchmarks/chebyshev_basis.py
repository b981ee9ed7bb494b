"""The march with 24 Chebyshev polynomials in place of the random sines.

Columns f(s) T_k(2s - 1), with f of the trial form, orthonormalised and collocated the same way, to
tell what the sines contribute from what collocation does.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.random_features.basis import FeatureBasis, feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import march
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March

from .opponents import Run
from .problems import Case


def _columns(s: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """f T_k and its derivative in s, in extended precision."""
    s = np.asarray(s, dtype=np.longdouble)
    unit = np.eye(count, dtype=np.longdouble)
    values = chebyshev.chebval(2 * s - 1, unit).T
    slopes = chebyshev.chebval(2 * s - 1, chebyshev.chebder(unit, scl=2)).T
    f = -np.expm1(-s)[:, None]
    return f * values, (1 - f) * values + f * slopes


@functools.cache
def chebyshev_basis(count: int = 24) -> FeatureBasis:
    """A basis of polynomials with the nodes of the random features."""
    like = feature_basis(0)
    angles = (2 * np.arange(160) + 1) * math.pi / 320
    raw = np.vstack(_columns((1 - np.cos(angles)) / 2, count)).astype(float)
    _, sizes, right = np.linalg.svd(raw, full_matrices=False)
    mixing = right.T / sizes
    at_nodes, rates_at_nodes, to_between, rates_between = (
        (part @ mixing).astype(float)
        for s in (like.nodes, like.between)
        for part in _columns(s, count)
    )
    fit = np.linalg.pinv(rates_at_nodes, rcond=1e-14)
    series = np.zeros((len(like.series), count))
    series[:count] = mixing
    return replace(
        like,
        fit=fit,
        integration=at_nodes @ fit,
        to_between=to_between,
        rates_between=rates_between,
        end=(_columns(np.ones(1), count)[0] @ mixing)[0],
        series=series,
    )


def march_runs(
    case: Case, name: str, basis: FeatureBasis, tolerances: Iterable[float]
) -> list[Run]:
    """March alone, without an estimate of the error."""
    flow = flow_of(case.H)

    def made(tol: float) -> Run:
        def call() -> March:
            with np.errstate(all="ignore"):
                return march(flow, case.z0, case.span, max(0.1 * tol, 1e-13), basis)

        def states(windows: March, t: np.ndarray) -> np.ndarray:
            if windows.reason:
                return np.full((len(t), len(case.z0)), np.inf)
            trial = FeatureTrial.of_march(windows, basis.series)
            return trial.states_at(t)

        return Run(f"{name}: march", tol, call, states)

    return [made(tol) for tol in tolerances]
