"""Comparison of a flow map with the models of its legs that were proven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.flow_maps.expansion import Leg
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.arithmetic.directed import UNIT
from hamsym.proof.arithmetic.taylor_models import Model, Space, space_of
from hamsym.proof.boxes.map_models import LegModels, Step, affine_models
from hamsym.proof.public_check import ROOM, require_same

_PIECES, _STARTS, _REGIONS = 8, 4, 8  # of a flow map


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
        return models, values, sizes - np.abs(values) + ROOM * (moved + rounding)


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
    return np.asarray(UNIT * found)
