"""Proofs of the error of a flow map, for all starts and parameters in a box.

Cells of the box go through the map together, as fronts, from step to step of the time. On each step
the map is enclosed by Taylor models (:mod:`hamsym.proof.boxes.map_models`), and its error by a tube
(:mod:`hamsym.proof.boxes.tube`) that the step before hands on
(:mod:`hamsym.proof.boxes.carried_errors`), across the legs of chains, too. Where a step adds too
much to the bound, it is halved, or the cells are, and the proof goes on from there. At a split a
front goes to both sides; cells that are surely on one side leave the other.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from hamsym.codegen.functions import compile_straight_line
from hamsym.errors import CertificationError, InputError
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.flow_maps.time_order import legs_of
from hamsym.formula.parser import canonical_name
from hamsym.numerics.linear_systems import blas_on_one_core
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.arithmetic.generated import ParameterSlopes, evaluated, require_smooth
from hamsym.proof.arithmetic.taylor_models import BITS, MODELS, Model, Parts, space_of
from hamsym.proof.boxes.box_certificate import BoxCertificate, map_digest
from hamsym.proof.boxes.carried_errors import CarriedErrors, ErrorStep
from hamsym.proof.boxes.map_models import Cells, LegModels, Step, affine_models, combined
from hamsym.proof.boxes.public_map import check_map
from hamsym.proof.boxes.tube import Flow, StepModels, Stepper, sizes, steepest_inputs
from hamsym.proof.limits import Deadline
from hamsym.support.records import packed
from hamsym.support.validation import checked_mapping, require_whole

# Largest degrees in tau, by the number of inputs: of the map with its defect, and of all else.
_IN_TIME = {1: (16, 12), 2: (14, 12), 3: (12, 10)}
_IN_TIME_OF_MANY = 10, 8
# Largest and least degrees in the inputs, as far as models without time have so many terms; by how
# much they exceed that of the map, since products that are left out do not cancel in the defect;
# and the degree of M, on which second-order terms depend alone.
_MOST, _LEAST, _TERMS, _BEYOND, _OF_MATRIX = 18, 6, 800, 3, 4
_SHARE = 1.0  # of the estimated error, that second order and radii may add
_AT_ONCE = 0.2  # of that, at the start of the span; all of it at the end
_SMALL, _SMALLEST = 0.01, 2e-11  # always small enough: of the tolerance, and of the states
# Of what the tolerance leaves beside the estimated error, what radii may add where sharper bounds
# need more than so many cells; all of that for twice as many.
_ROOM, _MANY = 0.5, 32
# Where steps are chosen: points; radius of the defect, relative to it; share of the estimated error
# that these radii may add; integral of S' + S A, relative to S; 1 - M S; largest factor by which
# the halving of a step reduces what it leaves out.
_POINTS, _DEFECT, _RADII, _MISMATCH, _REST, _RESOLVED = 4, 0.01, 0.003, 1e-3, 0.01, 0.2
# Halvings of a step before cells are halved, and the least gain of each.
_HALVINGS, _GAIN = 2, 0.1
# Factor of what a step adds from which halving of a cell does not help, and factor by which what
# rounding adds varies from step to step.
_HELPS, _ROUGHLY = 0.8, 2.0
_SHORTEST = Fraction(1, 2**12)  # of a piece
_TOGETHER = 48  # cells at once
_DEEPEST = 40  # halvings
_MARGIN = 1e-7  # another processor may find bounds that differ by round-off
_TINY = 1e-250

Interval = tuple[Fraction, Fraction]
Cell = tuple[Interval, ...]


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
    with blas_on_one_core(), np.errstate(all="ignore"):  # what overflows has no bound
        proof.run(tuple(intervals))
        check_map(flow, proof.proven)
    if not np.isfinite(proof.largest).all():
        raise CertificationError("the bound of a component is not finite; give a smaller box")
    return intervals, proof.largest, len(proof.proven)


def _intervals(flow: FlowMap, box: Mapping[str, Any] | None) -> list[Interval]:
    """The box of the claim: that of the map, or a part of it."""
    whole = flow.box
    known = {canonical_name(name): name for name in whole}
    given = dict(whole)
    for key, value in checked_mapping("box", box, '{"x": (1.0, 1.1)}').items():
        name = known.get(canonical_name(str(key)))
        if name is None:
            raise InputError(
                f"'{key}' does not vary in this map; box has intervals of {', '.join(whole)}"
            )
        try:
            low, high = (float(end) for end in value)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"box has {name}={value!r}; give an interval (low, high)") from None
        least, most = whole[name]
        if not least <= low < high <= most:
            raise InputError(
                f"box has {name}={value!r}; give an interval within that of the map, from "
                f"{least:.6g} to {most:.6g}"
            )
        given[name] = low, high
    return [(Fraction(low), Fraction(high)) for low, high in given.values()]


def _degree(flow: FlowMap) -> int:
    """The degree of models in the inputs: above that of the map, between limits."""
    d = len(flow.inputs)
    own = max(piece.degrees.sum(axis=1).max() for leg in legs_of(flow.map) for piece in leg.pieces)
    most = max(m for m in range(1, _MOST + 1) if math.comb(d + m, d) <= _TERMS or m == 1)
    return int(min(max(own + _BEYOND, _LEAST), most))


class _Proof:
    """The proof for a map over a box.

    - largest: Bound on the error of each component so far.
    - proven: Cells on which the proof reached the end.
    """

    def __init__(self, flow: FlowMap, deadline: Deadline, most: int) -> None:
        self.map, self.region, self._deadline, self._most = flow, flow.region, deadline, most
        H, d = flow.H, len(flow.inputs)
        self.flow = Flow(H, [name for name in flow.region.parameters if name in H.parameter_names])
        (most, in_time), degree = _IN_TIME.get(d, _IN_TIME_OF_MANY), _degree(flow)
        self.space = space_of(d, most, degree)
        lower = degree - 1 - degree // 9  # all else is multiplied with defects or errors
        self.stepper = Stepper(self.flow, space_of(d, in_time, lower), min(lower - 1, _OF_MATRIX))
        self.slopes = ParameterSlopes(H, [])
        # Steps are chosen with models whose inputs are fixed.
        self._fixed = space_of(d, most, 1)
        self._fixed_stepper = Stepper(self.flow, space_of(d, in_time, 1), 0)
        self._end = Fraction(float(flow.span[1]))
        self._start = Fraction(float(flow.span[0]))
        self._length = abs(self._end - self._start)
        self._direction = 1 if flow.span[1] > flow.span[0] else -1
        estimate = np.asarray(flow.largest_error, dtype=float)
        self._goal = np.where(np.isfinite(estimate), estimate, 0.0)
        self.starts = Starts(flow.region)
        self._grids: dict[tuple[int, Fraction], _Grid] = {}
        self.largest = np.zeros(H.dim)
        self.proven: list[Cell] = []

    def run(self, box: Cell) -> None:
        """Prove a bound over a box."""
        waiting = [_Front(self, [box], [(self.map.map, self._end)], np.zeros(1, dtype=int))]
        while waiting:
            front = waiting.pop()
            waiting += self._advanced(front, len(self.proven) + sum(map(len, waiting)))

    def _advanced(self, front: _Front, others: int) -> list[_Front]:
        """What becomes of a front by one step, of a number of cells beside it."""
        if not len(front):
            return []
        if not front.parts:
            self.proven += front.cells
            return []
        part, end = front.parts[0]
        if isinstance(part, Chain):
            ends = [*(Fraction(float(joint)) for joint in part.joints), end]
            front.parts = [*zip(part.maps, ends, strict=True), *front.parts[1:]]
            return [front]
        if isinstance(part, Split):
            return front.sides(part)
        if len(front) > _TOGETHER:
            middle = len(front) // 2
            parts = range(middle), range(middle, len(front))
            return [front.split(Parts.chosen(cells)) for cells in parts]
        grid = self._grid(front)
        if not front.steps:
            front.steps = grid.steps[::-1]
        return [self._stepped(front, grid, others + len(front))]

    def _stepped(self, front: _Front, grid: _Grid, count: int) -> _Front:
        """A front after a step, or before it with a shorter step or narrower cells."""
        step = front.steps[-1]
        begin, length = Fraction(float(front.parts[0][0].begin)), float(abs(step.half))
        t = float(begin + step.low)
        self._deadline.check(f"the error was bounded, at t = {t:.6g}")
        trial = front.trial(step)
        own = grid.shares(trial, len(front), count)
        passed = float(abs(begin + step.high - self._start) / self._length)
        limit = _AT_ONCE + (1 - _AT_ONCE) * passed
        # Where a cell was halved along every input, and it does not help, rounding is left.
        halved = (front.tries > 0) & (front.tries % len(self.map.inputs) == 0)
        rounding = halved & (_HELPS * front.before < own) & (own < np.inf)
        front.floor = np.where(rounding, np.maximum(front.floor, own / length), front.floor)
        final = (own <= _ROUGHLY * front.floor * length) | (front.depths >= _DEEPEST)
        fine = final | (front.spent + own <= limit)
        full = count + (~fine).sum() > self._most
        lost = ~(own < np.inf) & (full | fine)
        if lost.any():
            raise self._refusal(front.cells[int(np.argmax(lost))], t, count)
        if trial is not None and (full or fine.all()):
            self.largest = np.maximum(self.largest, trial.errors.bound.max(axis=1))
            front.accept(trial, np.minimum(front.spent + own, limit))
            return front
        worst = float(own[~fine].max())
        many = 2 * fine.sum() < len(front)
        if many and front.halvings < _HALVINGS and not worst > _GAIN * front.worst:
            # A step is halved for itself, a cell up to the end.
            front.steps[-1:] = step.halves[::-1]
            front.halvings, front.worst = front.halvings + 1, worst
            return front
        # All models are made again: cells too wide for a further such step are halved, too.
        wide = ~final & (front.spent + 2 * own > limit)
        wide = wide if count + wide.sum() <= self._most else ~fine
        front.before = np.where(wide & (front.tries % len(self.map.inputs) == 0), own, front.before)
        front.tries = front.tries + wide
        return front.split(Parts.halving(wide, front.axes(trial)))

    def _refusal(self, cell: Cell, t: float, count: int) -> CertificationError:
        place = ", ".join(
            f"{name} from {float(low):.6g} to {float(high):.6g}"
            for name, (low, high) in zip(self.map.inputs, cell, strict=True)
        )
        return CertificationError(
            f"no bound beyond t = {t:.6g} for {place}, with {count} parts of the box: errors grow "
            "too fast or H is not smooth there; give a smaller box, a shorter span or more parts "
            "(max_parts)"
        )

    # -- steps -------------------------------------------------------------------------------------

    def _pieces(self, leg: Leg, end: Fraction) -> list[Step]:
        """The pieces of a leg, up to its end."""
        # The last piece ends with the leg: its own edge is that, up to round-off.
        last = end - Fraction(float(leg.begin))
        edges = [*(Fraction(float(edge)) for edge in leg.edges[:-1]), last]
        forward = all(self._direction * (high - low) > 0 for low, high in pairwise(edges))
        if not (edges[0] == 0 and forward and len(edges) == len(leg.pieces) + 1):
            raise CertificationError("the pieces of the map are not in order; make it again")
        return [Step(place, low, high) for place, (low, high) in enumerate(pairwise(edges))]

    def _grid(self, front: _Front) -> _Grid:
        """Steps of a leg, chosen at some points of the cells that first come to it."""
        leg, end = front.parts[0]
        if (id(leg), end) in self._grids:
            return self._grids[id(leg), end]
        space, stepper = self._fixed, self._fixed_stepper
        cells = np.random.default_rng(0).integers(len(front), size=_POINTS)
        inputs, parameters = (
            [space.constant(values) for values in front.at(models, cells)]
            for models in (front.inputs, front.parameters)
        )
        models = LegModels(leg, space, inputs)
        start, begin = models.start(), Fraction(float(leg.begin))
        matrices = stepper.first(_POINTS)
        goal = _RADII * self._goal / float(self._length)
        steps: list[Step] = []
        growth, scale = np.eye(self.flow.dim), np.zeros(self.flow.dim)
        for piece in self._pieces(leg, end):
            stack = [(piece, np.inf)]
            while stack:
                self._deadline.check("the steps of the proof were chosen")
                step, before = stack.pop()
                states, rates = models.states(step, start)
                clock = step.clock(space, begin, _POINTS)
                try:
                    found = stepper.models(step, states, rates, clock, parameters, matrices)
                except (SingularityError, np.linalg.LinAlgError):
                    found = None
                coarse = np.inf if found is None else _coarseness(found, goal)
                # Where halving does not help, rounding is all that is left.
                if found is not None and (coarse <= 1 or _RESOLVED * before < coarse < np.inf):
                    matrices = found.fundamental_at_end()
                    growth = np.maximum(growth, sizes(found.fundamental).max(axis=2))
                    scale = np.maximum(scale, [model.size().max() for model in states])
                    steps.append(step)
                elif abs(step.half) <= _SHORTEST * abs(piece.half):
                    raise self._refusal(front.cells[0], float(begin + step.low), len(front))
                else:
                    first, second = step.halves
                    stack += [(second, coarse), (first, coarse)]
        enough = max(_SMALL * self.map.tol, _SMALLEST) * scale
        allowed = np.maximum(_SHARE * self._goal, enough) + _TINY
        room = np.maximum(_ROOM * (self.map.tol * scale - self._goal), 0)
        return self._grids.setdefault((id(leg), end), _Grid(steps, growth, allowed, room))


@dataclass
class _Grid:
    """Steps of a leg.

    - growth: Bounds on the entries of M, not proven, shape (dim, dim).
    - allowed, room: Radii that the steps may add to the error over the whole span, shape (dim,),
      and what many cells may add to it.
    """

    steps: list[Step]
    growth: np.ndarray
    allowed: np.ndarray
    room: np.ndarray

    def shares(self, trial: _Trial | None, cells: int, count: int) -> np.ndarray:
        """What a step adds, of what all steps may add; infinite where there is no bound.

        - count: Of all cells of the proof.
        """
        if trial is None:
            return np.full(cells, np.inf)
        errors = trial.errors
        added = np.einsum("ij,jc->ic", self.growth, errors.added)
        allowed = np.maximum(self.allowed[:, None], _SHARE * errors.sharp)
        allowed = allowed + self.room[:, None] * min(max(count / _MANY - 1, 0), 1)
        found = (added / allowed).max(axis=0)
        known = np.isfinite(errors.bound).all(axis=0) & np.isfinite(found)
        return np.where(known, found, np.inf)


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


@dataclass
class _Trial:
    """A step of a front: the states, of high degrees; the models; and the error."""

    states: list[Model]
    models: StepModels
    errors: ErrorStep


class _Front:
    """Cells of the box at one time, with the map and its error there.

    - parts: What is left of the map, with the time at which each part ends.
    - depths: How often each cell was halved.
    - steps: Those up to the end of the leg, the next one last.
    - halvings, worst: How often the next one was halved, and what it would have added before.
    - spent: What the steps of each cell added, of what they may add up to the end.
    - before: What the next step would have added before the cell was halved for it.
    - floor: What rounding adds in half a unit of time.
    """

    def __init__(
        self, proof: _Proof, cells: Cells, parts: list[tuple[Any, Fraction]], depths: np.ndarray
    ) -> None:
        self._proof, self.cells, self.parts, self.depths = proof, cells, parts, depths
        self.steps: list[Step] = []
        self.halvings, self.worst = 0, np.inf
        self.spent = np.zeros(len(cells))
        self.tries, self.before = np.zeros(len(cells), dtype=int), np.full(len(cells), np.inf)
        self.floor = np.zeros(len(cells))
        self._number = -1  # of the piece in which the last step was
        self._entry: list[Model] = []  # states where the leg begins, of all but the first one
        self._states: list[Model] = []  # where the last step ended
        self._errors: CarriedErrors | None = None
        # Not above zero at the points at which the sides of splits are evaluated.
        self._limits: list[Model] = []

    def __len__(self) -> int:
        return len(self.cells)

    @cached_property
    def _box(self) -> list[Model]:
        return affine_models(self._proof.space, self.cells)

    @property
    def inputs(self) -> list[Model]:
        """The inputs of what is left of the map."""
        return [*self._entry, *self._box[len(self._entry) :]]

    @property
    def parameters(self) -> list[Model]:
        """The parameters of H that vary."""
        names = self._proof.region.names
        return [self._box[names.index(name)] for name in self._proof.flow.parameters]

    @cached_property
    def _leg(self) -> tuple[LegModels, list[Model]]:
        """Models of the leg, and of its start."""
        found = LegModels(self.parts[0][0], self._proof.space, self.inputs)
        return found, found.start()

    def at(self, models: list[Model], cells: np.ndarray) -> np.ndarray:
        """Values of models without time at random points of cells, shape (models, cells)."""
        exponents = self._proof.space.exponents[:, 1:]
        points = np.random.default_rng(1).uniform(-1, 1, (len(cells), exponents.shape[1]))
        powers = np.prod(points[:, None] ** exponents, axis=2).T
        found = [(model.coefficients[:, cells] * powers).sum(axis=0) for model in models]
        return np.array(found).reshape(len(models), len(cells))

    # -- steps -------------------------------------------------------------------------------------

    def trial(self, step: Step) -> _Trial | None:
        """A step; None if H is not smooth there in any cell."""
        proof, stepper = self._proof, self._proof.stepper
        leg, start = self._leg
        if self._errors is None:
            first = proof.starts.errors(self.parts[0][0], start, self._box)
            self._errors = CarriedErrors.of_map(stepper, proof.slopes, stepper.lowered(first))
        states, rates = leg.states(step, start)
        begin = Fraction(float(self.parts[0][0].begin))
        clock = step.clock(proof.space, begin, len(self))
        try:
            models = stepper.models(
                step, states, rates, clock, self.parameters, self._errors.fundamental
            )
        except (SingularityError, np.linalg.LinAlgError):
            return None
        jump = None
        if self._states and step.number != self._number:
            pairs = zip(states, self._states, strict=True)
            jump = stepper.lowered([proof.space.at_end(new, -1) - old for new, old in pairs])
        return _Trial(states, models, self._errors.step(models, jump))

    def accept(self, trial: _Trial, spent: np.ndarray) -> None:
        """Go on from the end of a step."""
        assert self._errors is not None
        self.spent, self.tries = spent, np.zeros(len(self), dtype=int)
        is_last = len(self.steps) == 1  # of the leg
        self._errors = self._errors.after(trial.models, trial.errors, is_last=is_last)[0]
        self._states = [self._proof.space.at_end(model, 1) for model in trial.states]
        self._number = trial.models.step.number
        self.steps.pop()
        self.halvings, self.worst = 0, np.inf
        if is_last:
            self.parts, self._number = self.parts[1:], -1
            self._entry = self._states
            del self._leg

    # -- cells -------------------------------------------------------------------------------------

    def split(self, parts: Parts) -> _Front:
        """The front on parts of its cells, without those that are not in the map."""
        cells = []
        for parent, halved, axis, side in zip(
            *(array.tolist() for array in (parts.parents, parts.halved, parts.axes, parts.sides)),
            strict=True,
        ):
            cell = self.cells[parent]
            low, high = cell[axis]
            middle = (low + high) / 2
            half = (low, middle) if side < 0 else (middle, high)
            cells.append(_replaced(cell, axis, half) if halved else cell)
        depths = self.depths[parts.parents] + parts.halved
        found = _Front(self._proof, cells, self.parts, depths)
        found.steps, found.halvings = [*self.steps], self.halvings
        found.worst, found.spent = self.worst, self.spent[parts.parents]
        found.tries = self.tries[parts.parents]
        found.before, found.floor = self.before[parts.parents], self.floor[parts.parents]
        found._number = self._number
        for name in ("_entry", "_states", "_limits"):
            models = [self._proof.space.parts_of(model, parts) for model in getattr(self, name)]
            setattr(found, name, models)
        # At the start the error is known better from the cells themselves.
        found._errors = self._errors.split(parts) if self._errors and self._states else None
        return found._in_limits()

    def _in_limits(self) -> _Front:
        """The front without cells on which the map is never evaluated."""
        inside = np.full(len(self), True)
        for middle, radius in (model.range() for model in self._limits):
            inside &= ~(middle - radius > 0)
        return self if inside.all() else self.split(Parts.chosen(np.flatnonzero(inside)))

    def sides(self, split: Split) -> list[_Front]:
        """The fronts of both sides of a split, which both have the cells that it cuts."""
        found = []
        end = self.parts[0][1]
        axes = np.flatnonzero(split.normal)
        for sign, part in ((1.0, split.low), (-1.0, split.high)):
            if self._states or len(axes) != 1:
                front = self.split(Parts.chosen(range(len(self))))
                limit = combined(sign * split.normal, self.inputs)
                front._limits.append(limit.plus(-sign * split.threshold))
            else:
                front = self._cut(int(axes[0]), split, sign)
            front.parts = [(part, end), *self.parts[1:]]
            found.append(front._in_limits())
        return found

    def _cut(self, axis: int, split: Split, sign: float) -> _Front:
        """The front on one side of a plane across an input of the box."""
        factor = Fraction(sign * split.normal[axis])
        cut = Fraction(sign * split.threshold) / factor
        cells, kept = [], []
        for place, cell in enumerate(self.cells):
            low, high = cell[axis]
            low, high = (low, min(high, cut)) if factor > 0 else (max(low, cut), high)
            if low <= high:
                cells.append(_replaced(cell, axis, (low, high)))
                kept.append(place)
        return _Front(self._proof, cells, [], self.depths[kept])

    def axes(self, trial: _Trial | None) -> np.ndarray:
        """The input of each cell in which its models vary most, or which is widest."""
        if trial is None:
            whole = self._proof.map.box.values()
            widths = [
                [
                    float(high - low) / (most - least)
                    for (low, high), (least, most) in zip(cell, whole, strict=True)
                ]
                for cell in self.cells
            ]
            return np.argmax(widths, axis=1)
        return steepest_inputs([*trial.models.defect, *trial.states])


def _replaced(cell: Cell, axis: int, interval: Interval) -> Cell:
    return (*cell[:axis], interval, *cell[axis + 1 :])


class Starts:
    """z_a - z_0 of a first leg: exactly zero where z0 is an input or a number."""

    def __init__(self, box: Box) -> None:
        self._box = box
        self._functions: dict[str, Callable[..., list[Model]]] = {}
        for component, expr in box.formulas.items():
            require_smooth(expr)
            self._functions[component] = compile_straight_line([expr], box.symbols)

    def errors(self, leg: Leg, start: list[Model], inputs: list[Model]) -> list[Model]:
        box = self._box
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
            found.append(start[i].times(0.0))
        return found
