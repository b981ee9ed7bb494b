"""Comparison of a solution or an enclosure with the polynomials on windows that were proven."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.numerics.collocation import chebyshev_values
from hamsym.proof.arithmetic.directed import UNIT
from hamsym.proof.public_check import ROOM, require_same
from hamsym.proof.windows.trial_models import trial_pieces
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
    begin, end = (Fraction(float(value)) for value in solution.span)
    direction = 1 if end > begin else -1
    pieces = trial_pieces(solution.trial, solution.span)
    total = abs(end - begin)
    times = _times(pieces, begin, total, direction)
    rounding = _rounding_of_features if isinstance(solution.trial, FeatureTrial) else _of_networks
    unit = float(np.finfo(solution.trial.dtype).eps) / 2
    # Times are counted from the origin of a march, or from the start of a network.
    origin = float(getattr(solution.trial, "origin", begin))
    longest = max(abs(float(time) - origin) for time in solution.span)
    found = np.full((2, len(times), solution.H.dim), np.nan)
    allowed = np.zeros_like(found)
    for n, t in enumerate(times.tolist()):
        elapsed = direction * (Fraction(t) - begin)
        near = Fraction(4 * unit * max(abs(t), abs(float(begin))))
        beside = [k for k, p in enumerate(pieces) if p.start - near <= elapsed <= p.end + near]
        for m, k in enumerate(beside[:2]):
            states, rates = pieces[k].models(elapsed, Fraction(0), _TERMS)
            found[m, n] = states.high[:, 0] + states.low[:, 0]
            moved = 16 * unit * (abs(t - origin) + longest)
            allowed[m, n] = np.abs(states.high[:, 1:]).sum(axis=1) + states.radius
            allowed[m, n] += moved * np.abs(rates.high).sum(axis=1)
            allowed[m, n] += ROOM * unit * rounding(solution.trial, k, t)
    require_same("solution", solution.H.names, solution(times), found, allowed, _at(times))


def _at(times: np.ndarray) -> Callable[[int], str]:
    return lambda n: f"t = {float(times[n])!r}"


def _times(pieces: Sequence[Any], begin: Fraction, total: Fraction, direction: int) -> np.ndarray:
    """Times in pieces that are spread over the span, at their ends, and at random."""
    random = np.random.default_rng(len(pieces))
    chosen = np.unique(np.linspace(0, len(pieces) - 1, _WINDOWS).astype(int)).tolist()
    each = max(_PLACES, 3 * _WINDOWS // len(chosen))
    found = []
    for k in chosen:
        low, high = max(pieces[k].start, Fraction(0)), min(pieces[k].end, total)
        shares = [0.0, 1.0, *random.random(each).tolist()]
        found += [begin + direction * (low + Fraction(share) * (high - low)) for share in shares]
    low, high = sorted((float(begin), float(begin + direction * total)))
    return np.unique(np.clip(np.array([float(time) for time in found]), low, high))


def _rounding_of_features(trial: Any, number: int, t: float) -> np.ndarray:
    """Roundings of z_a + f(s) sum_l T_l sum_m S_lm C_m, in units of u; t is accounted for."""
    readouts = np.abs(trial.readouts[number])
    degrees = np.arange(len(trial.series))
    weights = degrees**2 + len(trial.series) + len(readouts) + 8.0
    return np.asarray(
        np.abs(trial.states[number]) + (weights @ np.abs(trial.series)) @ readouts, dtype=float
    )


def _of_networks(trial: Any, number: int, t: float) -> np.ndarray:
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
    times = _times(enclosure.windows, begin, abs(end - begin), direction)
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
