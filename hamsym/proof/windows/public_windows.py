"""Comparison of a solution or an enclosure with the polynomials on windows that were proven."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.numerics.collocation import chebyshev_values
from hamsym.proof.arithmetic.directed import UNIT
from hamsym.proof.arithmetic.taylor_models import space_of
from hamsym.proof.boxes.wide_sets import SetWindow
from hamsym.proof.public_check import ROOM, require_same
from hamsym.proof.windows.trial_models import feature_models, trial_pieces
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution

_WINDOWS = 14  # that are compared, of a solution
_PLACES = 3  # in each window: random ones
_TERMS = 4  # of models at points


def check_solution(solution: Solution) -> None:
    """Require that a solution evaluates the function that :func:`trial_pieces` encloses.

    Raises
    ------
    CertificationError
    """
    begin, end = map(float, solution.span)
    direction = 1 if end > begin else -1
    # Times are counted from the origin of a march, or from the start of a network.
    trial: Any = solution.trial
    features = isinstance(trial, FeatureTrial)
    origin = float(trial.origin) if features else begin
    pieces = [] if features else trial_pieces(trial, solution.span)
    edges = (
        direction * trial.edges
        if features
        else np.array([float(pieces[0].start), *(float(piece.end) for piece in pieces)])
    )
    times = _times(edges[:-1], edges[1:], origin, (begin, end))
    unit = float(np.finfo(trial.dtype).eps) / 2
    elapsed = direction * (times - origin)
    near = 4 * unit * np.maximum(np.abs(times), abs(begin))
    last = np.searchsorted(edges[:-1], elapsed + near, side="right") - 1
    both = np.stack([np.maximum(last - 1, 0), last])
    rows, numbers = np.nonzero(elapsed - near <= edges[both + 1])
    windows = both[rows, numbers]
    found = np.full((2, len(times), solution.H.dim), np.nan)
    allowed, rates = np.zeros_like(found), np.zeros_like(found)
    place = rows, numbers
    if features:
        length = np.diff(edges)[windows]
        shares = (elapsed[numbers] - edges[windows]) / length
        found[place], allowed[place], slopes = _of_features(trial, windows, shares)
        rates[place] = slopes / length[:, None]
    else:
        for m, n, k in zip(*map(np.ndarray.tolist, (rows, numbers, windows)), strict=True):
            t = float(times[n])
            at = direction * (Fraction(t) - Fraction(begin))
            states, slope = pieces[k].models(at, Fraction(0), _TERMS)
            found[m, n] = states.high[:, 0] + states.low[:, 0]
            allowed[m, n] = np.abs(states.high[:, 1:]).sum(axis=1) + states.radius
            allowed[m, n] += ROOM * unit * _rounding_of_network(trial, k, t)
            rates[m, n] = np.abs(slope.high).sum(axis=1)
    longest = max(abs(begin - origin), abs(end - origin))
    allowed += (16 * unit * (np.abs(times - origin) + longest))[:, None] * rates
    require_same("solution", solution.H.names, solution(times), found, allowed, _at(times))


def _at(times: np.ndarray) -> Callable[[int], str]:
    return lambda n: f"t = {float(times[n])!r}"


def _times(
    starts: np.ndarray, ends: np.ndarray, origin: float, span: tuple[float, float]
) -> np.ndarray:
    """Times in windows that are spread over the span, at their ends, and at random.

    - starts, ends: Elapsed times from the origin.
    """
    random = np.random.default_rng(len(starts))
    chosen = np.unique(np.linspace(0, len(starts) - 1, _WINDOWS).astype(int))
    each = max(_PLACES, 3 * _WINDOWS // len(chosen))
    shares = np.hstack([np.tile([0.0, 1.0], (len(chosen), 1)), random.random((len(chosen), each))])
    found = starts[chosen, None] + shares * (ends - starts)[chosen, None]
    found[:, 1] = ends[chosen]
    direction = 1 if span[1] > span[0] else -1
    return np.unique(np.clip(origin + direction * found.ravel(), min(span), max(span)))


def _of_features(
    trial: FeatureTrial, windows: np.ndarray, shares: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Values of the models of z^ at shares of windows, their errors, and their rates by s.

    Errors have the roundings of z_a + f(s) sum_l T_l sum_m S_lm C_m, and those of the values here.
    """
    found, slopes = feature_models(trial.series)
    table = chebyshev_values(2 * shares - 1, found.high.shape[1])
    readouts, states = trial.readouts[windows], trial.states[windows]
    values, rates = (
        np.einsum("pl,pli->pi", table @ (part.high + part.low).T, readouts)
        for part in (found, slopes)
    )
    sizes, unit = np.abs(readouts), float(np.finfo(trial.dtype).eps) / 2
    errors = np.abs(states) + np.abs(states + values)
    for series in (np.abs(trial.series), np.abs(found.high.T)):
        weights = np.arange(len(series)) ** 2 + len(series) + sizes.shape[1] + 8.0
        errors += np.einsum("l,pli->pi", weights @ series, sizes)
    radii = np.einsum("l,pli->pi", found.radius, sizes)
    return states + values, radii + ROOM * unit * errors, np.abs(rates)


def _rounding_of_network(trial: Any, number: int, t: float) -> np.ndarray:
    """Roundings of z_0 + f(s) N(s), in units of u: through a layer errors grow by |W| at most."""
    network = trial.pieces[number] if hasattr(trial, "pieces") else trial
    s = abs((t - network.t0) / network.tau)
    factor = max(s, 1.0) if network.envelope == "linear" else 1.0
    found = []
    for part in network.parts:
        size, error = np.array([s]), np.zeros(1)  # the rounding of s is that of the time
        for depth, (matrix, bias) in enumerate(part.layers):
            weights = np.abs(matrix.detach().numpy().astype(float))
            shifts = np.abs(bias.detach().numpy().astype(float))
            if depth:
                size, error = np.ones(len(error)), error + 8.0  # of an activation
            error = weights @ error + (len(size) + 4) * (weights @ size + shifts)
        found.append(error + 8 * (weights @ size + shifts))
    starts = np.abs(network.z0.numpy().astype(float))
    return np.asarray(2 * starts + factor * np.concatenate(found))


# -- enclosures ------------------------------------------------------------------------------------


def check_enclosure(enclosure: Any) -> None:
    """Require that the balls of an :class:`Enclosure` are around the polynomials of its windows.

    Raises
    ------
    CertificationError
    """
    begin, end = (Fraction(value) for value in enclosure.span)
    direction = 1 if end > begin else -1
    ends = np.array([0.0, *(float(window.end) for window in enclosure.windows)])
    times = _times(ends[:-1], ends[1:], float(begin), enclosure.span)
    if isinstance(enclosure.windows[0], SetWindow):
        _check_set(enclosure, times, begin, direction)
        return
    places = []
    for n, t in enumerate(times.tolist()):
        elapsed = direction * (Fraction(t) - begin)
        last = bisect_right(enclosure.windows, elapsed, key=lambda window: window.start) - 1
        for m, k in enumerate(dict.fromkeys((last, max(last - 1, 0)))):
            window = enclosure.windows[k]
            x = float((elapsed - window.start) / window.half - 1)
            if not m or x <= 1:
                places.append((m, n, window, x))
    terms = enclosure.windows[0].high.shape[1]
    tables = chebyshev_values(np.array([x for *_, x in places]), terms)
    weights = 4.0 * np.arange(terms) ** 2 + 2 * terms + 8
    found = np.full((2, len(times), enclosure.H.dim), np.nan)
    allowed, radii = np.zeros_like(found), np.zeros_like(found)
    for (m, n, window, _), table in zip(places, tables, strict=True):
        found[m, n] = (window.high + window.low) @ table
        allowed[m, n] = ROOM * UNIT * (np.abs(window.high) @ weights)
        radii[m, n] = window.beside
    balls = enclosure(times)
    radius = np.asarray(balls.radius)
    # A radius that is too small differs as a middle that is not a number.
    middle = np.where((radius >= radii.min(axis=0)).all(axis=1)[:, None], balls.mid, np.nan)
    require_same("enclosure", enclosure.H.names, middle, found, allowed, _at(times))


def _check_set(enclosure: Any, times: np.ndarray, begin: Fraction, direction: int) -> None:
    """Require that balls contain values of the polynomials of a wide set, at random inputs."""
    random, balls = np.random.default_rng(len(times)), enclosure(times)
    found = np.full((1, len(times), enclosure.H.dim), np.nan)
    allowed = np.zeros_like(found)
    middle = np.array(balls.mid)
    for n, t in enumerate(times.tolist()):
        elapsed = direction * (Fraction(t) - begin)
        last = bisect_right(enclosure.windows, elapsed, key=lambda window: window.start) - 1
        window = enclosure.windows[last]
        x = float((elapsed - window.start) / window.half - 1)
        exponents = space_of(window.inputs, window.time_degree, window.degree).exponents
        part = int(random.integers(window.parts))
        place = np.array([x, *random.choice([-1.0, 1.0, 0.5, 0.0], window.inputs)])
        terms = window.polynomials[:, :, part] * np.prod(place**exponents, axis=1)
        found[0, n] = terms.sum(axis=1)
        radius = balls.radius[n] - window.bound[:, part]
        middle[n] = np.where(radius >= 0, middle[n], np.nan)
        rounding = ROOM * UNIT * (len(exponents) + 2 * exponents.max()) * np.abs(terms).sum(axis=1)
        allowed[0, n] = np.maximum(radius, 0.0) + rounding
    require_same("enclosure", enclosure.H.names, middle, found, allowed, _at(times))
