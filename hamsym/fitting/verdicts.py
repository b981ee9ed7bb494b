"""Verdicts on fits: uncertainties, and whether estimates can be trusted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import special

from hamsym.families.solutions import Solutions
from hamsym.fitting.motions import FlowLike
from hamsym.fitting.search import Found, Model
from hamsym.fitting.unknowns import Unknowns
from hamsym.solution.solution import Solution

__all__ = ["Verdicts", "judged"]

_SINGULAR = 1e-6  # of the largest singular value of J, its columns of unit length
_IN_COMBINATION = 1e-4  # part of a unit vector
_ACCURACY = 0.1  # of sigma: errors of the motion
_IMPROBABLE = 1e-6
_SHOWN = 3  # further minima in a message


@dataclass(frozen=True)
class Verdicts:
    """Uncertainty and verdict of each set.

    Attributes
    ----------
    covariance : numpy.ndarray
        Shape (sets, k, k).
    low, high : numpy.ndarray
        Ends of the confidence intervals, shape (sets, k).
    sigma : numpy.ndarray
        Standard deviations of the data, given or estimated, shape (sets, observables, times).
    freedom, p_value, success : numpy.ndarray
        Shape (sets,).
    messages : list of str
    """

    covariance: np.ndarray
    low: np.ndarray
    high: np.ndarray
    sigma: np.ndarray
    freedom: np.ndarray
    p_value: np.ndarray
    success: np.ndarray
    messages: list[str]


def judged(
    model: Model,
    found: Found,
    confidence: float,
    motion: Solution | Solutions | FlowLike,
) -> Verdicts:
    """Compute uncertainties, and judge every set."""
    unknowns, observed = model.unknowns, model.observed
    count = len(unknowns.names)
    freedom = observed.counts - count
    with np.errstate(all="ignore"):
        squares = found.chi_square
        scatter = np.where(freedom > 0, squares / freedom, np.nan)
        if observed.known:
            variance, p_value = np.ones(len(squares)), special.chdtrc(freedom, squares)
            p_value = np.where(freedom > 0, p_value, np.nan)
            factor = np.full(len(squares), special.ndtri((1 + confidence) / 2))
        else:
            variance, p_value = scatter, np.full(len(squares), np.nan)
            factor = np.where(freedom > 0, special.stdtrit(freedom, (1 + confidence) / 2), np.nan)
    covariance, combinations = _covariance(unknowns, found, max(_SINGULAR, 30 * model.tol))
    covariance = covariance * variance[:, None, None]
    with np.errstate(all="ignore"):
        errors = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) * factor[:, None]
        sigma = observed.sigma * np.sqrt(variance)[:, None, None]
    ratios = _errors(model, found, motion, sigma)
    solved = np.broadcast_to(np.asarray(motion.success), len(squares))
    success, messages = np.zeros(len(squares), dtype=bool), []
    for k in range(len(squares)):
        problems = []
        if freedom[k] < (0 if observed.known else 1):
            problems.append(f"{observed.counts[k]} data are too few for {count} free quantities")
        elif not np.isfinite(squares[k]):
            problems.append("the motion cannot be solved from the first guess")
        else:
            if combinations[k]:
                problems.append(combinations[k])
            if not found.converged[k]:
                problems.append(f"no convergence in {found.iterations[k]} iterations")
            x = found.unknowns[k]
            problems += [
                f"{name} is at its bound {x[j]:.6g}"
                for j, name in enumerate(unknowns.names)
                if not unknowns.low[j] < x[j] < unknowns.high[j]
            ]
            if not solved[k]:
                problems.append(f"the motion is not accurate: {_message(motion, k)}")
            elif not ratios[k] <= _ACCURACY:
                problems.append(
                    f"errors of the motion reach {ratios[k]:.1e} sigma; give a smaller tol"
                    if observed.known
                    else "residuals are not much larger than errors of the motion, so that sigma "
                    "cannot be estimated"
                )
            if rivals := [m for m in found.minima[1:] if not m[1] - squares[k] > 4 * variance[k]]:
                problems.append(f"another minimum fits as well, {unknowns.text(rivals[0][0])}")
            if observed.known and freedom[k] > 0 and not p_value[k] >= _IMPROBABLE:
                problems.append("the model does not fit the data with this sigma")
        success[k] = not problems
        state = f"chi-square {squares[k]:.6g} for {freedom[k]} degrees of freedom"
        if not observed.known:
            state += f", sigma {np.sqrt(scatter[k]):.3g}"
        elif freedom[k] > 0:
            state += f", p = {p_value[k]:.2g}"
        start = (
            "; ".join(problems) if problems else f"converged in {found.iterations[k]} iterations"
        )
        messages.append(f"{start}: {state}{_starts(unknowns, found, k)}")
    return Verdicts(
        covariance,
        found.unknowns - errors,
        found.unknowns + errors,
        sigma,
        freedom,
        p_value,
        success,
        messages,
    )


def _covariance(unknowns: Unknowns, found: Found, smallest: float) -> tuple[np.ndarray, list[str]]:
    """Return (J^T J)^-1 of each set, and what the data do not determine, or an empty text."""
    sets, _, count = found.jacobian.shape
    covariance, texts = np.full((sets, count, count), np.nan), [""] * sets
    for k, J in enumerate(found.jacobian):
        if not np.isfinite(J).all():
            continue
        lengths = np.linalg.norm(J, axis=0)
        if lost := [n for n, size in zip(unknowns.names, lengths, strict=True) if not size > 0]:
            texts[k] = f"the data do not depend on {', '.join(lost)}"
            continue
        _, values, right = np.linalg.svd(J / lengths, full_matrices=len(J) < count)
        values = np.append(values, np.zeros(count - len(values)))
        null = right[~(values > smallest * values[0])]
        if len(null):
            texts[k] = _combination(unknowns, null, lengths)
            continue
        root = right.T / values / lengths[:, None]
        covariance[k] = root @ root.T
    return covariance, texts


def _combination(unknowns: Unknowns, null: np.ndarray, lengths: np.ndarray) -> str:
    """Name the free quantities that data do not determine, with the direction if it is one."""
    involved = np.flatnonzero((np.abs(null) > _IN_COMBINATION).any(axis=0))
    names = [unknowns.names[j] for j in involved]
    if len(names) == 1:
        return f"the data do not determine {names[0]}"
    text = f"the data do not determine {', '.join(names[:-1])} and {names[-1]} separately"
    if len(null) > 1:
        return f"{text}, only {len(lengths) - len(null)} combinations"
    change = (null[0] / lengths)[involved]
    change /= change[np.argmax(np.abs(change))]
    listed = ", ".join(f"{c:+.4g} in {n}" for c, n in zip(change, names, strict=True))
    return f"{text}: changes by {listed} together have no effect"


def _errors(
    model: Model,
    found: Found,
    motion: Solution | Solutions | FlowLike,
    sigma: np.ndarray,
) -> np.ndarray:
    """Return the largest estimated error of an observable in units of sigma, shape (sets,)."""
    unknowns, observed = model.unknowns, model.observed
    parameters = unknowns.parameters(found.unknowns)
    shape = (len(found.unknowns), len(observed.t), unknowns.H.dim)
    if isinstance(motion, Solution):
        if motion.span[1] != model.span[1]:
            return np.full(len(sigma), np.inf)
        states, errors = motion(observed.t)[None], np.abs(motion.error_estimate(observed.t))[None]
    elif isinstance(motion, Solutions):
        states, errors = motion(observed.t), motion.error_estimate[:, None]
    else:
        states = model.motions(found.unknowns)[0]
        errors = motion.tol * np.abs(states).max(axis=1, keepdims=True)
    with np.errstate(all="ignore"):
        _, in_state, _ = model.observables(states, observed.t, parameters)
        moved = np.abs(in_state) * np.broadcast_to(errors, shape)[:, None]
        # A component of which the observable is independent may have an unknown error.
        sizes = np.where(in_state == 0, 0.0, moved).sum(axis=-1) / sigma
        sizes = np.where(observed.present, np.nan_to_num(sizes, nan=np.inf), 0.0)
    return np.asarray(sizes.max(axis=(1, 2)))


def _message(motion: Solution | Solutions | FlowLike, k: int) -> str:
    if isinstance(motion, Solutions):
        return str(motion.message[k])
    return motion.message if isinstance(motion, Solution) else "the flow map has success=False"


def _starts(unknowns: Unknowns, found: Found, k: int) -> str:
    """Say how many starts reached the minimum, and which other minima there are."""
    if found.refined == 1:
        return ""
    text = f"; reached from {found.reached[k]} of the {found.refined} best starts"
    if others := found.minima[1 : 1 + _SHOWN]:
        listed = "; ".join(f"{squares:.6g} at {unknowns.text(x)}" for x, squares, _ in others)
        text += f"; other minima: {listed}"
    return text
