"""Proofs of the error of a flow map, for all starts and parameters in a box.

The box is cut into cells. On each of them the map is enclosed by Taylor models
(:mod:`hamsym.proof.boxes.map_models`), its defect and its error by a tube
(:mod:`hamsym.proof.boxes.tube`). Cells whose bound is much larger than the error itself are halved.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from hamsym.codegen.functions import compile_straight_line
from hamsym.errors import CertificationError, InputError
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.formula.parser import canonical_name
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.arithmetic.generated import evaluated, require_smooth
from hamsym.proof.arithmetic.taylor_models import BITS, MODELS, Model, Space, space_of
from hamsym.proof.boxes.box_certificate import BoxCertificate, map_digest
from hamsym.proof.boxes.map_models import Cells, LegModels, Step, affine_models
from hamsym.proof.boxes.public_map import check_map
from hamsym.proof.boxes.tube import Flow, StepModels, Stepper, Tube
from hamsym.proof.limits import Deadline
from hamsym.support.records import packed
from hamsym.support.validation import require_whole

# Largest degrees in tau and in the inputs, by the number of inputs.
_DEGREES = {1: (16, 12), 2: (14, 10), 3: (12, 7), 4: (10, 5)}
_MANY_INPUTS = (10, 4)
_SHARE = 0.3  # of a bound, that second order and radii may be
_DEFECT = 0.01  # radius of the defect, relative to it, in thin cells
_SMALL, _SMALLEST = 0.01, 2e-11  # always small enough: of the tolerance, and of the states
_RADII = 0.03  # share of the estimated error that radii of the defect may add
_MISMATCH = 1e-3  # integral of S' + S A, relative to S
_REST = 0.01  # 1 - M S
_HELPS = 0.2  # largest factor by which the halving of a step reduces what it leaves out
_THIN = Fraction(1, 2**24)  # of the box
_SHORTEST = Fraction(1, 2**12)  # of a piece
_TOGETHER = 48  # cells at once
_DEEPEST = 40  # halvings
_MARGIN = 1e-7  # another processor may find bounds that differ by round-off

Interval = tuple[Fraction, Fraction]
Region = tuple[list[Leg], list[float], list[int], tuple[Interval, ...]]


def certify_box(
    flow: FlowMap,
    box: Mapping[str, Any] | None = None,
    time_limit: float | None = None,
    max_parts: int = 4_096,
) -> BoxCertificate:
    """Compute a rigorous bound on the error of a flow map; see :meth:`hamsym.FlowMap.certify`."""
    require_whole("max_parts", max_parts, 1)
    began = time.monotonic()
    intervals, bound, parts = proven_bound(flow, box, Deadline.after(time_limit), max_parts)
    return BoxCertificate(
        bound=tuple((bound * (1 + _MARGIN)).tolist()),
        components=tuple(flow.H.names),
        box={
            name: (float(low), float(high))
            for name, (low, high) in zip(flow.inputs, intervals, strict=True)
        },
        fixed={name: float(value) for name, value in flow.fixed.items()},
        expressions=dict(flow.region.expressions),
        span=(float(flow.span[0]), float(flow.span[1])),
        formula=flow.H.formulas,
        parts=parts,
        digest=map_digest(flow),
        seconds=time.monotonic() - began,
    )


def proven_bound(
    flow: FlowMap, box: Mapping[str, Any] | None, deadline: Deadline, max_parts: int
) -> tuple[list[Interval], np.ndarray, int]:
    """Prove a bound on the error of each component, over a box in a number of parts.

    Raises
    ------
    CertificationError
    """
    require_float64()
    intervals = _intervals(flow, box)
    try:
        packed(flow)
    except ValueError as error:
        raise CertificationError(f"the map is not valid: {error}; make it again") from None
    proof = _Proof(flow, deadline, max_parts)
    bound, parts = np.zeros(flow.H.dim), 0
    with np.errstate(all="ignore"):  # what overflows has no bound
        regions = list(_regions(flow.map, tuple(intervals)))
        for region in regions:
            found, count = proof.bound(region)
            bound, parts = np.maximum(bound, found), parts + count
        check_map(flow, regions)
    if not np.isfinite(bound).all():
        raise CertificationError("the bound of a component is not finite; give a smaller box")
    return intervals, bound, parts


def _intervals(flow: FlowMap, box: Mapping[str, Any] | None) -> list[Interval]:
    """The box of the claim: that of the map, or a part of it."""
    whole = flow.box
    if box is None:
        box = {}
    if not isinstance(box, Mapping):
        raise InputError(f'box={box!r} is not a mapping; give for example {{"x": (1.0, 1.1)}}')
    known = {canonical_name(name): name for name in whole}
    given = dict(whole)
    for key, value in box.items():
        name = known.get(canonical_name(str(key)))
        if name is None:
            raise InputError(
                f"'{key}' does not vary in this map; box has intervals of {', '.join(whole)}"
            )
        try:
            low, high = (float(end) for end in value)
        except (TypeError, ValueError):
            raise InputError(f"box has {name}={value!r}; give an interval (low, high)") from None
        least, most = whole[name]
        if not least <= low < high <= most:
            raise InputError(
                f"box has {name}={value!r}; give an interval within that of the map, from "
                f"{least:.6g} to {most:.6g}"
            )
        given[name] = low, high
    return [(Fraction(low), Fraction(high)) for low, high in given.values()]


def _regions(map: Any, box: tuple[Interval, ...]) -> Iterator[Region]:
    """The parts of a box with one sequence of legs each."""
    if isinstance(map, Split):
        (axes,) = np.nonzero(map.normal)
        if len(axes) != 1:
            raise CertificationError(
                "the map is split along a slanted plane, for which there is no proof; make one "
                "with smaller intervals"
            )
        axis = int(axes[0])
        factor = Fraction(float(map.normal[axis]))
        cut = Fraction(float(map.threshold)) / factor
        below, above = (map.low, map.high) if factor > 0 else (map.high, map.low)
        low, high = box[axis]
        if low <= cut:
            yield from _regions(below, _replaced(box, axis, (low, min(high, cut))))
        if high >= cut:
            yield from _regions(above, _replaced(box, axis, (max(low, cut), high)))
    elif isinstance(map, Chain):
        if not all(isinstance(part, Leg) for part in map.maps):
            raise CertificationError(
                "the map is split after its first leg, for which there is no proof; make one with "
                "smaller intervals or a shorter span"
            )
        joints = [float(joint) for joint in map.joints]
        yield list(map.maps), joints, [int(column) for column in map.kept], box
    else:
        yield [map], [], [], box


def _replaced(box: tuple[Interval, ...], axis: int, interval: Interval) -> tuple[Interval, ...]:
    return (*box[:axis], interval, *box[axis + 1 :])


class _Proof:
    """Proofs for the regions of a map."""

    def __init__(self, flow: FlowMap, deadline: Deadline, most: int) -> None:
        self._map, self._region, self._deadline, self._most = flow, flow.region, deadline, most
        self._flow = Flow(flow.region)
        d = len(flow.inputs)
        self._space = space_of(d, *_DEGREES.get(d, _MANY_INPUTS))
        self._stepper = Stepper(self._flow, self._space)
        estimate = np.asarray(flow.largest_error, dtype=float)
        self._goal = np.where(np.isfinite(estimate), estimate, 0.0)
        self._starts = _Starts(flow.region, self._space)

    def bound(self, region: Region) -> tuple[np.ndarray, int]:
        """A bound on the error over a region, and the number of its cells."""
        legs, joints, kept, box = region
        self._legs, self._kept = legs, kept
        self._start, end = (Fraction(float(t)) for t in self._map.span)
        self._ends = [*(Fraction(joint) for joint in joints), end]
        self._direction = 1 if end > self._start else -1
        grid = self._grid(box)
        largest, accepted = np.zeros(self._flow.dim), 0
        waiting: list[tuple[tuple[Interval, ...], int]] = [(box, 0)]
        while waiting:
            batch, waiting = waiting[:_TOGETHER], waiting[_TOGETHER:]
            cells = [cell for cell, _ in batch]
            full = accepted + len(batch) + len(waiting) >= self._most
            result = self._run(cells, grid, strict=not full)
            for place, (cell, depth) in enumerate(batch):
                if result.done[place]:
                    largest = np.maximum(largest, result.bound[:, place])
                    accepted += 1
                    continue
                if full or depth >= _DEEPEST:
                    raise self._refusal(cell, result.reached[place], accepted + len(waiting))
                axis = result.axes[place]
                low, high = cell[axis]
                middle = (low + high) / 2
                waiting.append((_replaced(cell, axis, (low, middle)), depth + 1))
                waiting.append((_replaced(cell, axis, (middle, high)), depth + 1))
        return largest, accepted

    def _refusal(self, cell: tuple[Interval, ...], t: float, count: int) -> CertificationError:
        place = ", ".join(
            f"{name} from {float(low):.6g} to {float(high):.6g}"
            for name, (low, high) in zip(self._map.inputs, cell, strict=True)
        )
        return CertificationError(
            f"no bound beyond t = {t:.6g} for {place}, with {count} parts of the box: errors grow "
            "too fast or H is not smooth there; give a smaller box, a shorter span or more parts "
            "(max_parts)"
        )

    # -- walking along the map ---------------------------------------------------------------------

    def _pieces(self, number: int) -> Iterator[Step]:
        """The pieces of a leg, up to its end."""
        leg = self._legs[number]
        begin, end = Fraction(float(leg.begin)), self._ends[number]
        # The last piece ends with the leg: its own edge is that, up to round-off.
        edges = [*(Fraction(float(edge)) for edge in leg.edges[:-1]), end - begin]
        starts = [self._start, *self._ends][number]
        forward = all(self._direction * (high - low) > 0 for low, high in pairwise(edges))
        if not (begin == starts and edges[0] == 0 and forward and len(edges) == len(leg.edges)):
            raise CertificationError("the pieces of the map are not in order; make it again")
        for place, (low, high) in enumerate(pairwise(edges)):
            yield Step(place, low, high)

    def _grid(self, box: tuple[Interval, ...]) -> list[list[list[Step]]]:
        """Steps of each piece of each leg, chosen where the inputs hardly vary."""
        random, cells = np.random.default_rng(0), []
        for _ in range(4):
            cell = []
            for (low, high), place in zip(box, random.random(len(box)).tolist(), strict=True):
                middle = low + Fraction(place) * (high - low)
                half = _THIN * (high - low)
                cell.append((max(low, middle - half), min(high, middle + half)))
            cells.append(tuple(cell))
        walk = _Walk(self, cells)
        goal = _RADII * self._goal / abs(self._map.span[1] - self._map.span[0])
        found: list[list[list[Step]]] = []
        for number in range(len(self._legs)):
            walk.enter(number)
            found.append([])
            for piece in self._pieces(number):
                steps, stack = [], [(piece, np.inf)]
                while stack:
                    self._deadline.check("the steps of the proof were chosen")
                    step, before = stack.pop()
                    models = walk.models(step)
                    coarse = np.inf if models is None else _coarseness(models, goal)
                    # Where halving does not help, rounding is all that is left.
                    if models is not None and (coarse <= 1 or _HELPS * before < coarse < np.inf):
                        walk.accept(models)
                        steps.append(step)
                    elif abs(step.half) <= _SHORTEST * abs(piece.half):
                        raise self._refusal(box, self._time(number, step.low), 1)
                    else:
                        first, second = step.halves
                        stack += [(second, coarse), (first, coarse)]
                found[-1].append(steps)
        return found

    def _time(self, number: int, elapsed: Fraction) -> float:
        return float(Fraction(float(self._legs[number].begin)) + elapsed)

    def _run(self, cells: list[Any], grid: list[list[list[Step]]], *, strict: bool) -> _Result:
        """Bounds for cells; those whose bound becomes useless are left out."""
        result = _Result(len(cells), self._flow.dim, self._time(0, Fraction(0)))
        walk = _Walk(self, cells)
        tube = Tube(self._stepper, walk.start_error())
        enough = max(_SMALL * self._map.tol, _SMALLEST)
        scale = np.zeros((self._flow.dim, len(cells)))
        for number, pieces in enumerate(grid):
            walk.enter(number)
            before: list[Model] | None = None
            for steps in pieces:
                for place, step in enumerate(steps):
                    self._deadline.check(
                        f"the error was bounded, at t = {self._time(number, step.low):.6g}"
                    )
                    models = walk.models(step)
                    if models is None:
                        result.axes[:] = walk.widest()
                        return result
                    if not place and before is not None:
                        starts = [self._space.at_end(model, -1) for model in models.states]
                        tube.jump([a - b for a, b in zip(starts, before, strict=True)])
                    tube.advance(models)
                    walk.accept(models)
                    before = [self._space.at_end(model, 1) for model in models.states]
                    result.reached[~result.failed] = self._time(number, step.high)
                    excess = tube.bound - tube.sharp
                    scale = np.maximum(scale, [model.size() for model in models.states])
                    allowed = _SHARE * np.maximum(self._goal[:, None], tube.sharp)
                    allowed = np.maximum(allowed, enough * scale)
                    useful = np.isfinite(tube.bound)
                    if strict:
                        useful &= excess <= allowed
                    failed = ~useful.all(axis=0) & ~result.failed
                    result.axes[failed] = walk.axes(models)[failed]
                    result.failed |= failed
                    if result.failed.all():
                        return result
        result.bound, result.done = tube.bound, ~result.failed
        return result


class _Result:
    def __init__(self, cells: int, dim: int, begin: float) -> None:
        self.bound = np.full((dim, cells), np.inf)
        self.done, self.failed = np.zeros(cells, dtype=bool), np.zeros(cells, dtype=bool)
        self.reached, self.axes = np.full(cells, begin), np.zeros(cells, dtype=int)


def _coarseness(models: StepModels, goal: np.ndarray) -> float:
    """How far a step is from one on which models are sharp; at most 1 if they are.

    - goal: Error that the radii of the defect may add over the whole span, per time; shape (dim,).
    """
    radii = np.array([entry.radius for entry in models.forced])
    growth = np.array([[entry.size() for entry in row] for row in models.fundamental])
    sizes = np.array([[entry.size() for entry in row] for row in models.adjoint])
    added = np.einsum("ijc,jc->ic", growth, radii)
    small = np.array([_DEFECT * entry.size() for entry in models.defect])
    least = np.where(goal[:, None] > 0, goal[:, None], small)
    limit = _MISMATCH * sizes.max(axis=(0, 1))
    found = (added / least).max(), (models.length * models.mismatch / limit).max()
    worst = max(*found, models.rest.max() / _REST)
    return float(worst) if np.isfinite(worst) else np.inf


class _Walk:
    """Models of the map along its legs and steps, for some cells."""

    def __init__(self, proof: _Proof, cells: Cells) -> None:
        self._proof, self._cells = proof, cells
        self._inputs = affine_models(proof._space, cells)
        names = proof._region.names
        self._parameters = [self._inputs[names.index(name)] for name in proof._flow.parameters]
        self._matrices = proof._stepper.first(len(cells))
        self._last: list[Model] | None = None

    def enter(self, number: int) -> None:
        """Begin a leg at the end of the one before."""
        proof = self._proof
        leg = proof._legs[number]
        inputs = self._inputs
        if self._last is not None:
            inputs = [*self._last, *(inputs[column] for column in proof._kept)]
        self._number = number
        self._leg = LegModels(leg, proof._space, inputs)
        self._start = self._leg.start()

    def start_error(self) -> list[Model]:
        """z^ - z at the start."""
        leg = self._proof._legs[0]
        found = LegModels(leg, self._proof._space, self._inputs).start()
        return self._proof._starts.errors(leg, found, self._inputs)

    def models(self, step: Step) -> StepModels | None:
        """The models of a step; None if H is not smooth there in any cell."""
        proof = self._proof
        states, rates = self._leg.states(step, self._start)
        begin = Fraction(float(proof._legs[self._number].begin))
        clock = step.clock(proof._space, begin, len(self._cells))
        try:
            with np.errstate(all="ignore"):
                return proof._stepper.models(
                    step, states, rates, clock, self._parameters, self._matrices
                )
        except (SingularityError, np.linalg.LinAlgError):
            return None

    def accept(self, models: StepModels) -> None:
        self._matrices = models.matrices
        self._last = [self._proof._space.at_end(model, 1) for model in models.states]

    def axes(self, models: StepModels) -> np.ndarray:
        """The input of each cell in which its models vary most."""
        exponents = self._proof._space.exponents[:, 1:]
        high = exponents.sum(axis=1) * 2 >= self._proof._space.degree
        found = np.zeros((exponents.shape[1], len(self._cells)))
        for model in (*models.defect, *models.states):
            size = np.abs(model.coefficients[high])
            unit = np.abs(model.coefficients).sum(axis=0) + 1e-300
            found += exponents[high].T @ size / unit
        return np.asarray(np.argmax(np.nan_to_num(found), axis=0))

    def widest(self) -> np.ndarray:
        box = self._proof._map.box.values()
        return np.array(
            [
                int(
                    np.argmax(
                        [
                            float(high - low) / (most - least)
                            for (low, high), (least, most) in zip(cell, box, strict=True)
                        ]
                    )
                )
                for cell in self._cells
            ]
        )


class _Starts:
    """z_a - z_0 of a first leg: exactly zero where z0 is an input or a number."""

    def __init__(self, box: Box, space: Space) -> None:
        self._box, self._space = box, space
        self._functions: dict[str, Callable[..., list[Model]]] = {}
        for component, expr in box.formulas.items():
            require_smooth(expr)
            self._functions[component] = compile_straight_line([expr], box.symbols)

    def errors(self, leg: Leg, start: list[Model], inputs: list[Model]) -> list[Model]:
        box, cells = self._box, len(inputs[0].radius)
        found = []
        for i, name in enumerate(box.H.names):
            row, offset = leg.selection[i], float(leg.offset[i])
            if name in self._functions:
                with working(BITS):
                    (exact,) = evaluated(self._functions[name], MODELS, *inputs)
                found.append(start[i] - exact)
                continue
            one = np.zeros(len(box))
            if name in box.components:
                one[box.names.index(name)] = 1.0
            expansion = leg.start[:, i] if len(leg.start) else np.zeros(1)
            same = (row == one).all() and offset == float(box.fixed.get(name, 0.0))
            if not same or expansion.any():
                raise CertificationError(
                    f"the map does not start with '{name}' as given; make it again"
                )
            found.append(self._space.constant(np.zeros(cells)))
        return found
