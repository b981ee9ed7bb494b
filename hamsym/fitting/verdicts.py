"""Verdicts on fits: uncertainties, and whether estimates can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import special

from hamsym.families.solutions import Solutions
from hamsym.fitting.observations import Observations
from hamsym.fitting.rivals import aliased, reflected, reflections
from hamsym.fitting.search import Found, Model
from hamsym.fitting.uncertainty import Uncertainty
from hamsym.fitting.unknowns import Unknowns
from hamsym.solution.solution import Solution

if TYPE_CHECKING:
    from hamsym.flow_maps.flow_map import FlowMap

_ACCURACY = 0.1  # of sigma: errors of the motion
_IMPROBABLE = 1e-6
_CORRELATED = 4.0  # standard deviations of what noise alone makes of residuals
_SHOWN = 3  # further minima in a message


@dataclass(frozen=True)
class Verdicts:
    """Verdict on each set."""

    #: Standard deviations of the data, given or estimated, shape (sets, observables, times).
    sigma: np.ndarray
    #: freedom, p_value, success: Shape (sets,).
    freedom: np.ndarray
    p_value: np.ndarray
    success: np.ndarray
    messages: list[str]


def judged(
    model: Model, found: Found, uncertainty: Uncertainty, motion: Solution | Solutions | FlowMap
) -> Verdicts:
    """Judge every set."""
    unknowns, observed = model.unknowns, model.observed
    count, variance = len(unknowns.names), uncertainty.variance
    freedom, squares = observed.counts - count, found.chi_square
    with np.errstate(all="ignore"):
        p_value = np.full(len(squares), np.nan)
        if observed.known:
            p_value = np.where(freedom > 0, special.chdtrc(freedom, squares), np.nan)
        scatter = np.where(freedom > 0, squares / freedom, np.nan)
        sigma = observed.sigma * np.sqrt(variance)[:, None, None]
    ratios = _errors(model, found, motion, sigma)
    solved = np.broadcast_to(np.asarray(motion.success), len(squares))
    changes = reflections(unknowns, tuple(observed.expressions.values()))
    success, messages = np.zeros(len(squares), dtype=bool), []
    for k in range(len(squares)):
        problems = []
        if freedom[k] < (0 if observed.known else 1):
            problems.append(f"{observed.counts[k]} data are too few for {count} free quantities")
        elif not np.isfinite(squares[k]):
            problems.append("the motion cannot be solved from the first guess")
        else:
            problems += _undetermined(unknowns, uncertainty, k)
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
            problems += reflected(unknowns, changes, x, uncertainty.low[k], uncertainty.high[k])
            problems += aliased(model, found, variance, k)
            if rivals := [m for m in found.minima[1:] if not m[1] - squares[k] > 4 * variance[k]]:
                problems.append(f"another minimum fits as well, {unknowns.text(rivals[0][0])}")
            if observed.known and freedom[k] > 0 and not p_value[k] >= _IMPROBABLE:
                problems.append("the model does not fit the data with this sigma")
            if not observed.known:
                problems += _unexplained(observed, found, count, k)
        success[k] = not problems
        state = f"chi-square {squares[k]:.6g} for {freedom[k]} degrees of freedom"
        if not observed.known:
            state += f", sigma {np.sqrt(scatter[k]):.3g}"
        elif freedom[k] > 0:
            state += f", p = {p_value[k]:.2g}"
        start = (
            "; ".join(problems) if problems else f"converged in {found.iterations[k]} iterations"
        )
        if uncertainty.profiled[k]:
            state += "; intervals by profile likelihood"
        messages.append(f"{start}: {state}{_starts(unknowns, found, k)}")
    return Verdicts(sigma, freedom, p_value, success, messages)


def _unexplained(observed: Observations, found: Found, count: int, k: int) -> list[str]:
    """Say why the residuals of a set are not noise, from which sigma could be estimated."""
    data = observed.data[k]
    residuals = found.residuals[k].reshape(data.shape)
    squares, number = float((residuals**2).sum()), int(observed.counts[k])
    pairs = observed.present[k, :, 1:] & observed.present[k, :, :-1]
    correlation = float((residuals[:, 1:] * residuals[:, :-1])[pairs].sum())
    texts = []
    if not correlation <= _CORRELATED / np.sqrt(max(pairs.sum(), 1)) * squares:
        texts.append(
            f"successive residuals are correlated, {correlation / squares:.2f}, so that the model "
            "does not fit, and sigma cannot be estimated; try other first guesses, or give sigma"
        )
    about_mean = float(np.nansum((data - np.nanmean(data, axis=1, keepdims=True)) ** 2))
    if not squares * number <= about_mean * (number - count):
        texts.append(
            "the model fits no better than the mean of the data; try other first guesses, or give "
            "sigma"
        )
    return texts


def _undetermined(unknowns: Unknowns, uncertainty: Uncertainty, k: int) -> list[str]:
    """Say what the data of a set do not determine, or leave without an end."""
    texts = [text] if (text := uncertainty.undetermined[k]) else []
    if texts and not uncertainty.profiled[k]:
        return texts
    if k in uncertainty.better:
        texts.append(f"another solution fits better, {unknowns.text(uncertainty.better[k])}")
    for j, name in enumerate(unknowns.names):
        open_ = uncertainty.low[k, j] == -np.inf, uncertainty.high[k, j] == np.inf
        if any(open_):
            sides = " and ".join(np.array(["below", "above"])[list(open_)])
            texts.append(f"the data do not bound {name} from {sides}")
    return texts


def _errors(
    model: Model, found: Found, motion: Solution | Solutions | FlowMap, sigma: np.ndarray
) -> np.ndarray:
    """Return the largest estimated error of an observable in units of sigma, shape (sets,)."""
    unknowns, observed = model.unknowns, model.observed
    parameters = unknowns.parameter_rows(found.unknowns)
    shape = (len(found.unknowns), len(observed.t), unknowns.H.dim)
    if isinstance(motion, Solution):
        if motion.span[1] != model.span[1]:
            return np.full(len(sigma), np.inf)
        states, errors = motion(observed.t)[None], np.abs(motion.error_estimate(observed.t))[None]
    elif isinstance(motion, Solutions):
        states, errors = motion(observed.t), motion.largest_error[:, None]
    else:
        # Absolute: the largest error in the box, however small this motion is.
        states, errors = model.motions(found.unknowns)[0], motion.largest_error
    with np.errstate(all="ignore"):
        _, in_state, _ = model.observables(states, observed.t, parameters)
        moved = np.abs(in_state) * np.broadcast_to(errors, shape)[:, None]
        # A component of which the observable is independent may have an unknown error.
        sizes = np.where(in_state == 0, 0.0, moved).sum(axis=-1) / sigma
        sizes = np.where(observed.present, np.nan_to_num(sizes, nan=np.inf), 0.0)
    return np.asarray(sizes.max(axis=(1, 2)))


def _message(motion: Solution | Solutions | FlowMap, k: int) -> str:
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
