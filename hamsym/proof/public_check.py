"""Comparison of what users evaluate with the function whose error was proven.

A proof reads the numbers that define a function, not the code that evaluates it. Before a
certificate is made, the public object is evaluated at about 50 times, in windows that are spread
over the span, at their joints, at both ends and at random, and compared with models of the function
that was proven. Both may differ by the roundings of the evaluation, which are bounded a priori:
u = 2^-53 times the sizes of all terms that are added, times the number of operations, or n^2 for
Chebyshev polynomials of degree n, plus the rate of change times the rounding of the time.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.errors import CertificationError
from hamsym.flow_maps.expansion import Leg
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.numerics.collocation import chebyshev_values
from hamsym.proof.map_models import LegModels, Step, affine_models
from hamsym.proof.taylor_models import Model, Space, space_of
from hamsym.proof.trial_models import trial_pieces
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution

_UNIT = 2.0**-53
_WINDOWS = 14  # that are compared, of a solution
_PLACES = 3  # in each window: random ones
_TERMS = 4  # of models at points
_PIECES, _STARTS, _REGIONS = 8, 4, 8  # of a flow map
_ROOM = 2.0  # for products of roundings


def require_same(
    what: str,
    names: Sequence[str],
    public: np.ndarray,
    proven: np.ndarray,
    allowed: np.ndarray,
    places: Callable[[int], str],
) -> None:
    """Require that values of a public object are those of the function that was proven.

    - what: The public object.
    - names: Of the components.
    - public: Shape (n, dim).
    - proven, allowed: Values and bounds on the difference, shape (m, n, dim): at a joint that of
      either window.
    - places: The number of a value -> where it is.

    Raises
    ------
    CertificationError
        Naming the first place at which they differ.
    """
    public = np.asarray(public)
    if public.shape != proven.shape[1:] or public.dtype != np.float64:
        raise CertificationError(f"the {what} is not evaluated to states; load it again")
    with np.errstate(all="ignore"):
        differences = np.abs(public - proven)
        same = (differences <= allowed).all(axis=2).any(axis=0)
    if not same.all():
        n = int(np.argmin(same))
        i = int(np.argmax(~(differences[0, n] <= allowed[0, n])))
        raise CertificationError(
            f"the {what} at {places(n)} has {names[i]} = {float(public[n, i])!r}, but what was "
            f"proven is about {float(proven[0, n, i])!r}, more apart than the rounding of its "
            f"evaluation, {allowed[0, n, i]:.2g}; save it and load it again"
        )


# -- solutions -------------------------------------------------------------------------------------


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
            allowed[m, n] += _ROOM * unit * rounding(solution.trial, k, t)
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
        allowed[m, n] = _ROOM * _UNIT * (np.abs(window.high) @ weights)
        radii[m, n] = window.beside
    balls = enclosure(times)
    radius = np.asarray(balls.radius)
    # A radius that is too small differs as a middle that is not a number.
    middle = np.where((radius >= radii.min(axis=0)).all(axis=1)[:, None], balls.mid, np.nan)
    require_same("enclosure", enclosure.H.names, middle, found, allowed, _at(times))


# -- flow maps -------------------------------------------------------------------------------------


def check_map(flow: FlowMap, regions: Sequence[tuple[Any, ...]]) -> None:
    """Require that a flow map evaluates the function that :class:`LegModels` enclose.

    - regions: Parts of the box with one sequence of legs each: legs, joints, kept inputs,
      intervals.

    Raises
    ------
    CertificationError
    """
    random = np.random.default_rng(len(regions))
    chosen = np.unique(np.linspace(0, len(regions) - 1, _REGIONS).astype(int)).tolist()
    times, inputs, found, allowed = [], [], [], []
    for number in chosen:
        legs, joints, kept, box = regions[number]
        starts = _starts(flow, box, random)
        for time, values, bounds in _along(flow, legs, joints, kept, starts, random):
            times.append(np.full(len(starts), time))
            inputs.append(starts)
            found.append(values)
            allowed.append(bounds)
    t, z0 = np.concatenate(times), np.concatenate(inputs)
    columns = dict(zip(flow.inputs, z0.T, strict=True))
    components = {name: columns[name] for name in flow.region.components}
    parameters = {name: columns[name] for name in flow.region.parameters}
    require_same(
        "flow map",
        flow.H.names,
        flow(t, components, parameters),
        np.concatenate(found, axis=1),
        np.concatenate(allowed, axis=1),
        lambda n: f"t = {float(t[n])!r} from {flow.region.described(z0[n])}",
    )


def _starts(flow: FlowMap, box: Sequence[Any], random: np.random.Generator) -> np.ndarray:
    """Random inputs of a region, and one at a corner of the box that the region has."""
    low, high = np.array([[float(end) for end in interval] for interval in box]).T
    found = low + (high - low) * random.uniform(0.001, 0.999, (_STARTS, len(low)))
    # Where a box is split, the maps of both sides are proven, but one of them is evaluated.
    found[0] = np.where(
        low == flow.region.low, low, np.where(high == flow.region.high, high, found[0])
    )
    return found


def _along(
    flow: FlowMap,
    legs: Sequence[Leg],
    joints: Sequence[float],
    kept: Sequence[int],
    starts: np.ndarray,
    random: np.random.Generator,
) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
    """Times in pieces of legs, with the states there and bounds on roundings, (2, n, dim)."""
    space = space_of(starts.shape[1], 1, 1)
    points = [tuple((Fraction(v), Fraction(v)) for v in row) for row in starts.tolist()]
    given = affine_models(space, points)
    columns = list(kept)
    part = _LegAtPoints(legs[0], space, given, starts, np.zeros(starts.shape))
    first, count = 0, sum(len(leg.pieces) for leg in legs)
    chosen = {*np.linspace(0, count - 1, _PIECES).astype(int).tolist()}
    for number, end in enumerate([*joints, float(flow.span[1])]):
        pieces = len(part.leg.pieces)
        for k in range(pieces):
            if first + k in chosen:
                yield from part.compared(k, end, random)
        first += pieces
        if number < len(joints):
            states, values, errors = part.at(pieces - 1, end)
            part = _LegAtPoints(
                legs[number + 1],
                space,
                [*states, *(given[column] for column in columns)],
                np.concatenate((values, starts[:, columns]), axis=1),
                np.concatenate((errors, np.zeros((len(starts), len(columns)))), axis=1),
            )


class _LegAtPoints:
    """Models of a leg at points.

    - models: The inputs of the leg.
    - values, errors: The same as numbers, and the roundings that they have in the evaluation, shape
      (n, d).
    """

    def __init__(
        self, leg: Leg, space: Space, models: list[Model], values: np.ndarray, errors: np.ndarray
    ) -> None:
        self.leg, self._values, self._errors = leg, values, errors
        self._models = LegModels(leg, space, models)
        self._start = self._models.start()

    def compared(
        self, k: int, end: float, random: np.random.Generator
    ) -> Iterator[tuple[float, np.ndarray, np.ndarray]]:
        """A random time in a piece and its ends, with the states of the piece beside it, too."""
        low, high = (self.leg.begin + edge for edge in self.leg.edges[k : k + 2])
        last = len(self.leg.pieces) - 1
        high = end if k == last else high
        inner = low + random.uniform(0.01, 0.99) * (high - low)
        for t, other in ((low, max(k - 1, 0)), (inner, k), (high, min(k + 1, last))):
            found = [self.at(number, float(t)) for number in (k, other)]
            yield float(t), np.array([each[1] for each in found]), np.array([e[2] for e in found])

    def at(self, k: int, t: float) -> tuple[list[Model], np.ndarray, np.ndarray]:
        """Models of the states of a piece, the states, and the differences that are allowed."""
        elapsed = Fraction(t) - Fraction(float(self.leg.begin))
        models, _ = self._models.states(Step(k, elapsed, elapsed), self._start)
        values = np.array([model.coefficients[0] for model in models]).T
        sizes = np.array([model.amount() + model.radius for model in models]).T
        count = np.full(len(self._values), t)
        slopes = np.abs(self.leg.derivatives(count, self._values)[2])
        moved = (slopes @ self._errors[..., None])[..., 0]
        rounding = _rounding_of_leg(self.leg, k, t, self._values)
        return models, values, sizes - np.abs(values) + _ROOM * (moved + rounding)


def _rounding_of_leg(leg: Leg, number: int, t: float, inputs: np.ndarray) -> np.ndarray:
    """A bound on the rounding of z_a + (t - t_a) sum_r W_r(y) phi_r(t), shape (n, dim)."""
    piece, d = leg.pieces[number], inputs.shape[1]
    low, high = (abs(float(edge)) for edge in leg.edges[number : number + 2])
    time, size = abs(t - leg.begin), np.abs(inputs)
    # of the scaled inputs, the scaled time and the time itself, in units of u
    y = (d + 2) * (size @ np.abs(leg.scaling).T + np.abs(leg.shift))
    clock = 2 * (abs(t) + abs(leg.begin)) + 4 * (time + low + high)
    tau = 2 * clock / abs(leg.edges[number + 1] - leg.edges[number])

    def of_inputs(degrees: np.ndarray, weights: np.ndarray) -> np.ndarray:
        """Roundings of sums of weights times T_nu(y), shape (n, columns of the weights)."""
        return (len(degrees) + 8 * d + (1 + y) @ (degrees**2).T) @ np.abs(weights)

    terms = np.arange(piece.columns.shape[1])
    columns = np.abs(piece.columns)
    series = np.einsum("rni->ri", columns)
    varied = np.einsum("n,rni->ri", len(terms) + len(columns) + 8 + terms**2 * (1 + tau), columns)
    whole = np.abs(piece.readouts).sum(axis=0)
    network = of_inputs(piece.degrees, piece.readouts) @ series + whole @ varied
    found = time * network + clock * (whole @ series)
    found += (d + 4) * (size @ np.abs(leg.selection).T + np.abs(leg.offset))
    if len(leg.start):
        found += of_inputs(leg.start_degrees, leg.start)
    return np.asarray(_UNIT * found)
