"""Uncertainty of estimates: covariances, and confidence intervals with a check of the curvature."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import special

from hamsym.fitting.profiles import profiled
from hamsym.fitting.search import Found, Model
from hamsym.fitting.unknowns import Unknowns

_SINGULAR = 1e-6  # of the largest singular value of J, its columns of unit length
_IN_COMBINATION = 1e-4  # part of a unit vector
_CURVED = 0.1  # relative error of the root of the rise of chi-square at the end of an interval
_VAGUE = 3.0  # sizes of a quantity: a linear interval as wide says nothing
_BESIDE = 0.1  # sizes
_NO_EFFECT = 1e-6  # of the variance: rise of chi-square


@dataclass(frozen=True)
class Uncertainty:
    """Uncertainty of the estimates of each set."""

    #: Shape (sets, k, k).
    covariance: np.ndarray
    #: What the data do not determine, or an empty text.
    undetermined: list[str]
    #: low, high: Ends of the confidence intervals, shape (sets, k).
    low: np.ndarray
    high: np.ndarray
    #: Whether they are those of the profile likelihood, shape (sets,).
    profiled: np.ndarray
    #: Of the data in units of sigma^2, given or estimated, shape (sets,).
    variance: np.ndarray
    #: Free quantities that fit better than the minimum found, by set.
    better: dict[int, np.ndarray]


def uncertainty_of(
    model: Model, found: Found, confidence: float, many: Callable[[], Model]
) -> Uncertainty:
    """Compute covariances and intervals.

    Intervals of a set are those of the linear model if chi-square at all their ends is what that
    model predicts, and those of the profile likelihood otherwise, from the model with a source of
    many motions at once.
    """
    unknowns, observed = model.unknowns, model.observed
    freedom = observed.counts - len(unknowns.names)
    with np.errstate(all="ignore"):
        if observed.known:
            variance = np.ones(len(freedom))
            factor = np.full(len(freedom), special.ndtri((1 + confidence) / 2))
        else:
            variance = np.where(freedom > 0, found.chi_square / freedom, np.nan)
            factor = np.where(freedom > 0, special.stdtrit(freedom, (1 + confidence) / 2), np.nan)
    covariance, texts, lost, unknown = _covariance(unknowns, found, max(_SINGULAR, 30 * model.tol))
    covariance = covariance * variance[:, None, None]
    with np.errstate(all="ignore"):
        errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        level = factor * np.sqrt(variance)
        traces = covariance / errors[..., None] ** 2
        widths = np.where(lost, model.sizes, errors * factor[:, None])
    low, high = found.unknowns - widths, found.unknowns + widths
    low[unknown], high[unknown] = -np.inf, np.inf
    fitted = np.isfinite(found.chi_square) & (level > 0) & ~unknown.any(axis=1)
    reach = np.maximum(np.abs(found.unknowns), model.sizes)
    losing = np.flatnonzero(lost.any(axis=1))
    traces[losing] = np.eye(lost.shape[1])
    curved, rises = _curvature(model, found, np.flatnonzero(fitted), traces, widths, level)
    idle = lost & ~(rises > _NO_EFFECT * variance[:, None])
    for k in losing:
        if idle[k].any():
            names = [name for j, name in enumerate(unknowns.names) if idle[k, j]]
            texts[k] = f"the data do not depend on {', '.join(names)}"
            low[k], high[k] = (np.where(idle[k], end, np.nan) for end in (-np.inf, np.inf))
        else:
            names = [name for j, name in enumerate(unknowns.names) if lost[k, j]]
            texts[k] = f"the data depend on {', '.join(names)} to second order only"
        curved[k] = not idle[k].any()
    better = {}
    if curved.any():
        count = low.shape[1]
        sets, columns, sides = (
            part.ravel()
            for part in np.meshgrid(np.flatnonzero(curved), np.arange(count), [0, 1], indexing="ij")
        )
        signs = 2.0 * sides - 1.0
        first = np.fmin(widths, reach)[sets, columns] / 2
        # Searches hardly leave a point at which a column of J vanishes, so they start beside it.
        vague = lost | ~(widths <= _VAGUE * reach)
        beside = np.where(found.unknowns + _BESIDE * reach < unknowns.high, _BESIDE, -_BESIDE)
        beside = (beside * reach)[sets] / first[:, None]
        profiles = profiled(
            many(),
            *(sets, columns, signs, found.unknowns[sets], found.chi_square[sets], level[sets]),
            first,
            np.where(vague[sets], beside, signs[:, None] * traces[sets, columns]),
        )
        ends = profiles.ends.reshape(-1, count, 2)
        low[curved], high[curved] = ends[..., 0], ends[..., 1]
        better = profiles.better
    return Uncertainty(covariance, texts, low, high, curved, variance, better)


def _curvature(
    model: Model,
    found: Found,
    sets: np.ndarray,
    traces: np.ndarray,
    widths: np.ndarray,
    level: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Compare chi-square at the ends of linear intervals with what the linear model predicts.

    - returns curved, rises: Whether it is another one, or an end is out of bounds, shape (sets,);
      the larger rise, shape (sets, k).
    """
    unknowns, count = model.unknowns, len(model.unknowns.names)
    curved = np.zeros(len(widths), dtype=bool)
    rises = np.full(widths.shape, np.nan)
    if not len(sets):
        return curved, rises
    shifts = np.einsum("s,nji,nj->nsji", [-1.0, 1.0], traces[sets], widths[sets])
    ends = found.unknowns[sets, None, None] + shifts
    inside = ((ends >= unknowns.low) & (ends <= unknowns.high)).all(axis=-1)
    values = np.clip(ends, unknowns.low, unknowns.high).reshape(-1, count)
    squares = model.squares(values, np.repeat(sets, 2 * count)).reshape(inside.shape)
    with np.errstate(all="ignore"):
        rise = squares - found.chi_square[sets, None, None]
        ratio = np.sqrt(np.maximum(rise, 0.0)) / level[sets, None, None]
    curved[sets] = ~(inside & (np.abs(ratio - 1) <= _CURVED)).all(axis=(1, 2))
    rises[sets] = np.where(np.isnan(rise), np.inf, rise).max(axis=1)
    return curved, rises


def _covariance(
    unknowns: Unknowns, found: Found, smallest: float
) -> tuple[np.ndarray, list[str], np.ndarray, np.ndarray]:
    """Compute (J^T J)^-1 of each set.

    - returns texts: What the data determine only in combination.
    - returns lost, unknown: Quantities of which the linear model is independent, and those in such
      combinations, shape (sets, k).
    """
    sets, _, count = found.jacobian.shape
    covariance, texts = np.full((sets, count, count), np.nan), [""] * sets
    lost, unknown = np.zeros((2, sets, count), dtype=bool)
    for k, J in enumerate(found.jacobian):
        if not np.isfinite(J).all():
            continue
        lengths = np.linalg.norm(J, axis=0)
        lost[k] = ~(lengths > 0)
        if lost[k].any():
            continue
        _, values, right = np.linalg.svd(J / lengths, full_matrices=len(J) < count)
        values = np.append(values, np.zeros(count - len(values)))
        null = right[~(values > smallest * values[0])]
        if len(null):
            unknown[k] = (np.abs(null) > _IN_COMBINATION).any(axis=0)
            texts[k] = _combination(unknowns, null, lengths, unknown[k])
            continue
        root = right.T / values / lengths[:, None]
        covariance[k] = root @ root.T
    return covariance, texts, lost, unknown


def _combination(
    unknowns: Unknowns, null: np.ndarray, lengths: np.ndarray, involved: np.ndarray
) -> str:
    """Name the free quantities that data do not determine, with the direction if it is one."""
    names = [name for name, one in zip(unknowns.names, involved, strict=True) if one]
    if len(names) == 1:
        return f"the data do not determine {names[0]}"
    text = f"the data do not determine {', '.join(names[:-1])} and {names[-1]} separately"
    if len(null) > 1:
        return f"{text}, only {len(lengths) - len(null)} combinations"
    change = (null[0] / lengths)[involved]
    change /= change[np.argmax(np.abs(change))]
    listed = ", ".join(f"{c:+.4g} in {n}" for c, n in zip(change, names, strict=True))
    return f"{text}: changes by {listed} together have no effect"
