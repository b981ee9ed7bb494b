"""Crossings of a surface between the steps of trajectories.

Input:  an ensemble, a surface and equal steps.
Output: times, states and trajectories of the crossings, and what may be missing among them.

The trajectories are stepped with a generated loop. Between two steps with different signs a
crossing is located by taking part of a step: the point lies on the curve of the method itself. The
formula of a smooth surface is bounded between steps, so that every crossing is found. Others are
sampled, and a pair of crossings within one step is found from the slopes at its ends.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hamsym.errors import InputError
from hamsym.integrators.automatic_steps import AIM, fastest_rate
from hamsym.integrators.coefficients import Doubled
from hamsym.integrators.energy_drift import EnergyDrift
from hamsym.integrators.hidden_features import Path, hidden_features
from hamsym.integrators.stepper import Stepper
from hamsym.numerics.intervals import Intervals, Ranges
from hamsym.numerics.isolation import Cells, component_ranges, isolated_zeros, rate_bends
from hamsym.numerics.roots import suspects, zeros
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.surface import Surface
from hamsym.support.progress import advance_in_blocks

# Components of the states of a block of steps that are held at once: 16 MB an array.
_HELD = 2_000_000
# Part of a step: distance along the flow over which slopes of a surface are measured. Rounding
# disturbs shorter differences, curvature longer ones.
_ASIDE = 1e-3


class Doubts(NamedTuple):
    """What may be missing among crossings.

    ``undefined`` is the first time at which a state is finite and the surface is NaN, or NaN,
    ``touches`` the number of places, other than starts, where the surface is touched within
    round-off, ``unresolved`` that of parts of steps with too many crossings to be resolved.
    """

    undefined: float = math.nan
    touches: int = 0
    unresolved: int = 0
    hidden: float = math.nan

    def together(self, other: Doubts) -> Doubts:
        """Doubts of both, these first in time."""
        undefined = other.undefined if math.isnan(self.undefined) else self.undefined
        both = self.touches + other.touches, self.unresolved + other.unresolved
        hidden = other.hidden if math.isnan(self.hidden) else self.hidden
        return Doubts(undefined, *both, hidden)


@dataclass(frozen=True)
class Setting:
    """What :func:`section` looks for, and the steps that it takes."""

    method: str
    surface: str
    where: Surface
    direction: float
    start: float
    size: float
    steps: int
    limit: int | None


class Crossings:
    """Crossings of a surface found so far, while the trajectories are stepped."""

    def __init__(self, members: Ensemble, setting: Setting) -> None:
        count, method = len(members), setting.method
        self._stepper = Stepper(
            members.H,
            method,
            members.states,
            np.full(count, setting.start),
            np.full(count, setting.size),
            parameters=members.parameters,
        )
        if isinstance(self._stepper.scheme, Doubled):
            raise InputError(
                f"{method} cannot take part of a step; choose another method, for example gauss4"
            )
        self._members, self._setting = members, setting
        self._found = [(np.empty(0), np.empty((0, members.H.dim)), np.empty(0, dtype=int))]
        self._numbers = np.zeros(count, dtype=int)  # of crossings of each trajectory
        self.doubts = Doubts()
        self._last, self._interrupted = members.states, False
        self.done = 0
        #: Fastest rate of the linear motion, from 0 on, where nothing else tests the steps.
        self.fastest = 0.0
        self.drift = EnergyDrift(members.H, count, members.own_parameters())

    def advance_all(self, progress: bool | None) -> None:
        """Take all steps, until Ctrl-C or enough crossings."""
        block = max(1, _HELD // self._members.states.size)
        steps = self._setting.steps
        self._interrupted = advance_in_blocks(steps, block, progress, self._advance)

    def problem(self, count: int, end: float) -> str:
        """Describe why the crossings are incomplete; "" if they are complete."""
        setting, numbers = self._setting, self._numbers
        if self._interrupted:
            until = setting.start + setting.size * self.done
            return f"stopped after t = {until:.6g}: interrupted"
        lost = ~np.isfinite(self._last).all(axis=-1)
        if lost.any():
            return (
                f"{lost.sum()} of {len(lost):,} trajectories overflowed or came to a step that "
                f"could not be solved, for example number {int(np.argmax(lost))}"
            )
        if not math.isnan(self.doubts.undefined):
            return (
                f"{setting.surface} is not a number at t = {self.doubts.undefined:.6g}; crossings "
                "there are missed"
            )
        if self.doubts.unresolved:
            return (
                f"{setting.surface} may be crossed more often than the {count:,} times that "
                "were found, because it varies too fast or stays within round-off of zero"
            )
        if setting.limit is not None and numbers.min() < setting.limit:
            return (
                f"trajectory {int(np.argmin(numbers))} has only {numbers.min()} of {setting.limit} "
                f"crossings by t = {end:.6g}"
            )
        return ""

    def _advance(self, done: int, count: int) -> bool:
        """Take a block of steps; return False after enough crossings or without trajectories."""
        moved = self._stepper.advance(count, show=False)
        if moved.interrupted:
            raise KeyboardInterrupt
        path = np.concatenate((self._last[:, None], moved.states), axis=1)
        setting = self._setting
        times = setting.start + setting.size * np.arange(done, done + count + 1)
        found, doubts = _located(self._members, setting, path, times)
        self._found.append(found)
        self.drift.add(path)
        if not self._members.H.conserves_energy:
            self.fastest = max(self.fastest, fastest_rate(self._members, path, times))
        doubts = doubts._replace(hidden=self._passed_over(path, times))
        self.doubts = self.doubts.together(doubts)
        self._numbers += np.bincount(found[2], minlength=len(self._numbers))
        self.done, self._last = done + count, path[:, -1]
        enough = setting.limit is not None and self._numbers.min() >= setting.limit
        return bool(np.isfinite(self._last).any()) and not enough

    def _passed_over(self, path: np.ndarray, times: np.ndarray) -> float:
        """Return the first time at which the steps pass over a feature of the force, or nan."""
        features, values = hidden_features(self._members.H), self._members.own_parameters()
        if features is None or not math.isnan(self.doubts.hidden):
            return math.nan

        # What the steps pass over may hide crossings inside it, whatever the steps may change.
        share = AIM / self._setting.steps * (len(times) - 1)
        found = features.passed(Path(path, times), values, share)
        return (
            math.nan if np.isnan(found).all() else float(found[np.nanargmin(abs(found - times[0]))])
        )

    def ordered(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times, states and trajectories, at most up to the limit for each."""
        t, z, trajectory = (np.concatenate(parts) for parts in zip(*self._found, strict=True))
        order = np.lexsort((np.sign(self._setting.size) * t, trajectory))
        if self._setting.limit is not None:
            first = np.searchsorted(trajectory[order], trajectory[order])
            order = order[np.arange(len(order)) - first < self._setting.limit]
        return t[order], z[order], trajectory[order]


def _located(
    members: Ensemble, setting: Setting, path: np.ndarray, times: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], Doubts]:
    """Locate crossings on paths of shape (n, steps + 1, dim).

    - returns crossings: Times, states and trajectories.
    """
    where, size, direction = setting.where, setting.size, setting.direction
    at, parameters = np.broadcast_to(times, path.shape[:2]), members.own_parameters()
    with np.errstate(all="ignore"):  # where a trajectory has escaped
        rows = None if parameters is None else parameters[:, None]
        values = np.asarray(where.value(path, at, rows), dtype=float)
        rates = members.H.compile("numpy").at("vector_field", path, at, rows)
    without = (np.isnan(values) & np.isfinite(path).all(axis=-1)).any(axis=0)
    undefined = float(times[np.argmax(without)]) if without.any() else math.nan
    if where.enclosed is None:
        aside = _ASIDE * size
        ahead, behind = (
            np.asarray(where.value(path + h * rates, at + h, rows), dtype=float)
            for h in (aside, -aside)
        )
        (trajectory, step), dips = suspects(values, ahead - behind)
    else:
        finite = np.isfinite(values) & np.isfinite(rates).all(axis=-1)
        trajectory, step = np.nonzero(finite[:, :-1] & finite[:, 1:])
    steps = _Steps(members, setting, path[trajectory, step], times[step], trajectory)
    ends = np.stack([values[trajectory, step], values[trajectory, step + 1]])
    touches, unresolved = np.empty(0), 0
    if where.enclosed is None:
        share, index = zeros(steps.value, ends[0], ends[1], dips, direction)
    else:
        path, rates = path[..., where.components], rates[..., where.components]
        with np.errstate(all="ignore"):
            bends = rate_bends(times, rates)[trajectory, step]
        cells = Cells.whole(
            np.full(len(step), size),
            ends,
            np.stack([path[trajectory, step], path[trajectory, step + 1]]),
            np.stack([rates[trajectory, step], rates[trajectory, step + 1]]),
            bends,
        )
        found = isolated_zeros(cells, steps.enclosed, steps.sample, steps.value, direction)
        share, index, unresolved = found.share, found.index, found.undecided
        touches = np.array([steps.since[i] + low * size for low, i in found.touched])
    z, t, own = steps.states(share, index), steps.times(share, index), steps.parameters(index)
    holds = where.holds(z, t, own)
    doubts = Doubts(undefined, int((touches != setting.start).sum()), unresolved)
    return (t[holds], z[holds], trajectory[index][holds]), doubts


@dataclass(frozen=True)
class _Steps:
    """The path within steps, from the states ``before`` them at the times ``since``."""

    members: Ensemble
    setting: Setting
    before: np.ndarray
    since: np.ndarray
    trajectory: np.ndarray

    def times(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.asarray(self.since[index] + share * self.setting.size)

    def parameters(self, index: np.ndarray) -> np.ndarray | None:
        return self.members.own_parameters(self.trajectory[index])

    def states(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        """States after parts of steps."""
        before = self.before[index]
        if not len(index):
            return before
        stepper = Stepper(
            self.members.H,
            self.setting.method,
            before,
            self.since[index],
            share * self.setting.size,
            parameters=self.members.parameters[self.trajectory[index]],
        )
        # No step at all is the state itself, also where a method divides by the step.
        return np.where(share[:, None] == 0, before, stepper.step(1))

    def value(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Values of the surface function."""
        z, t = self.states(share, index), self.times(share, index)
        return np.asarray(self.setting.where.value(z, t, self.parameters(index)), dtype=float)

    def sample(
        self, share: np.ndarray, index: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values of the surface function, and its components with their rates."""
        z, t, own = self.states(share, index), self.times(share, index), self.parameters(index)
        values = np.asarray(self.setting.where.value(z, t, own), dtype=float)
        rates = self.members.H.compile("numpy").at("vector_field", z, t, own)
        return values, z[:, self.setting.where.components], rates[:, self.setting.where.components]

    def enclosed(self, cells: Cells) -> Ranges:
        """The surface function over parts of steps."""
        ends = np.stack([self.times(share, cells.index) for share in (cells.low, cells.high)])
        one, own = np.ones(len(cells)), self.parameters(cells.index)
        t = Ranges.of_slopes(ends, Intervals(one, one), np.abs(ends[1] - ends[0]))
        given = None if own is None else lambda i: Ranges.constant(own[:, i])
        assert self.setting.where.enclosed is not None
        return self.setting.where.enclosed(lambda i: component_ranges(cells, i), t, given)
