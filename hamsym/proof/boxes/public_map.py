"""Comparison of a flow map with the models of its legs that were proven."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.proof.arithmetic.directed import UNIT
from hamsym.proof.arithmetic.taylor_models import Model, Parts, Space, space_of
from hamsym.proof.boxes.map_models import LegModels, Step, affine_models
from hamsym.proof.public_check import ROOM, require_same

_PIECES, _STARTS, _CELLS = 8, 4, 8  # of a leg, of a cell, and of a flow map


def check_map(flow: FlowMap, cells: Sequence[Any]) -> None:
    """Require that a flow map evaluates the function that :class:`LegModels` enclose.

    - cells: Of the box, on which the map was proven.

    Raises
    ------
    CertificationError
    """
    random = np.random.default_rng(len(cells))
    chosen = np.unique(np.linspace(0, len(cells) - 1, _CELLS).astype(int)).tolist()
    z0 = np.concatenate([_starts(flow, cells[number], random) for number in chosen])
    found = list(_along(flow, z0, random))
    t, rows = (np.concatenate([each[place] for each in found]) for place in (0, 1))
    columns = dict(zip(flow.inputs, z0[rows].T, strict=True))
    components = {name: columns[name] for name in flow.region.components}
    parameters = {name: columns[name] for name in flow.region.parameters}
    require_same(
        "flow map",
        flow.H.names,
        flow(t, components, parameters),
        np.concatenate([each[2] for each in found], axis=1),
        np.concatenate([each[3] for each in found], axis=1),
        lambda n: f"t = {float(t[n])!r} from {flow.region.described(z0[rows[n]])}",
    )


def _starts(flow: FlowMap, cell: Sequence[Any], random: np.random.Generator) -> np.ndarray:
    """Random inputs of a cell, and one at a corner of the box that the cell has."""
    low, high = np.array([[float(end) for end in interval] for interval in cell]).T
    found = low + (high - low) * random.uniform(0.001, 0.999, (_STARTS, len(low)))
    # Where a box is split, the maps of both sides are proven, but one of them is evaluated.
    found[0] = np.where(
        low == flow.region.low, low, np.where(high == flow.region.high, high, found[0])
    )
    return found


def _along(
    flow: FlowMap, starts: np.ndarray, random: np.random.Generator
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Times in pieces of legs, numbers of starts, states there and bounds on roundings."""
    space, rows = space_of(starts.shape[1], 1, 1), np.arange(len(starts))
    points = [tuple((Fraction(v), Fraction(v)) for v in row) for row in starts.tolist()]
    first, dim = [(flow.map, float(flow.span[1]))], flow.H.dim
    waiting = [(first, rows, affine_models(space, points), starts, np.zeros(starts.shape))]
    while waiting:
        ((part, end), *later), rows, given, values, errors = waiting.pop()
        if isinstance(part, Chain):
            parts = [*zip(part.maps, [*map(float, part.joints), end], strict=True), *later]
            waiting.append((parts, rows, given, values, errors))
        elif isinstance(part, Split):
            for side, own in zip((part.low, part.high), part.sides(values), strict=False):
                models = [space.parts_of(model, Parts.chosen(own)) for model in given]
                if len(own):
                    parts = [(side, end), *later]
                    waiting.append((parts, rows[own], models, values[own], errors[own]))
        else:
            leg, count = _LegAtPoints(part, space, given, values, errors), len(part.pieces)
            for k in np.unique(np.linspace(0, count - 1, _PIECES).astype(int)).tolist():
                for time, states, bounds in leg.compared(k, end, random):
                    yield np.full(len(rows), time), rows, states, bounds
            if later:
                models, states, bounds = leg.at(count - 1, end)
                values = np.concatenate((states, values[:, dim:]), axis=1)
                errors = np.concatenate((bounds, errors[:, dim:]), axis=1)
                waiting.append((later, rows, [*models, *given[dim:]], values, errors))


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
