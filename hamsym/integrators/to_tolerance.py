"""Integration to a tolerance with fixed-step methods: the steps of each trajectory, and its error.

Input:  an ensemble, a method, a span, a tolerance.
Output: a :class:`Trajectory` with states at equally spaced times, estimated errors and verdicts.

Each trajectory is integrated with n, 2n and 4n steps, and with n steps and perturbations that stand
for round-off: twice the work of the finest run (:mod:`hamsym.integrators.compared_runs`). The
results are extrapolated (:mod:`hamsym.integrators.richardson`). The first n follows from the
fastest linear motion at the start. Where the estimated error exceeds the tolerance, the next n
follows from the estimate and the order. Trajectories with equal n are integrated together.

Three runs can agree on what all of them miss. A trajectory therefore succeeds only if, in addition,
H is conserved as far as the tolerance requires, and the force has no feature that the steps do not
resolve (:mod:`hamsym.integrators.hidden_features`). What the round-off of the force
may change at its narrow features, where the runs can agree in it, and that of the times at which it
is evaluated, are part of the error. States belong to the saved times as rounded. Everything
that is decided about a trajectory depends on that trajectory alone, so that a member that fails
changes no bit of the others.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from hamsym.integrators.coefficients import Splitting
from hamsym.integrators.compared_runs import SLACK, ComparedRuns, Round
from hamsym.integrators.invariant_drift import invariant_drifts
from hamsym.integrators.step_scales import fastest_rates
from hamsym.integrators.stepper import INTERRUPTED, require_memory
from hamsym.integrators.trajectory import Trajectory, Verdicts
from hamsym.parallel.threads import Threads
from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.ensemble import Ensemble
from hamsym.support.machine import available_cores
from hamsym.support.progress import stepping_progress

# Phase of the fastest linear motion in a coarse step at a tolerance of 1e-9, and its limits at
# other tolerances: where most systems of the catalogue need one round.
_ANGLE, _ANGLES = 0.9, (0.02, 1.5)
# Part of the tolerance for which the next number of steps is chosen, as estimates of it vary.
_AIM = 0.5
# Round-off, relative to the tolerance, from which summation is compensated.
_LIMITED = 0.2
# Largest factor between two numbers of steps: estimates that are far off say little.
_MAX_GROWTH = 4.0
# The same where the steps do not resolve a feature and the runs disagree.
_MAX_SHORTENED = 1e3
# Rounds without halving the error, with round-off above the tolerance in spite of compensated
# summation, and with a run that is not finite, after which the search ends.
_MAX_STALLED, _MAX_LIMITED, _MAX_LOST = 3, 4, 5
# Component updates of one trajectory in one run, minutes.
_MAX_UPDATES = 1e9
# Components of the states after each of the steps that may be taken to resolve a feature, seconds.
_MAX_RESOLVING = 2**24
# Components of the states of a run that are processed together, within a processor's cache.
_BLOCK = 2**16


def integrate_to_tolerance(
    members: Ensemble,
    name: str,
    span: tuple[float, float],
    tol: float,
    saves: int,
    compensated: bool,
    progress: bool | None,
    known: KnownInvariants,
) -> Trajectory:
    """Integrate every member until its estimated error is at most tol."""
    require_memory(2 * saves, members)  # states and error estimates
    began = time.perf_counter()
    runs = ComparedRuns(members, name, span, tol, saves, compensated)
    times = runs.times
    found = ToleranceSearch(runs, saves).run(progress)
    verdicts = found.verdicts
    drifts, refused = invariant_drifts(members, known, found.z, times, tol, found.errors)
    for index, (_, reason) in refused.items():
        if found.success[index]:
            found.success[index], verdicts.problems[index] = False, reason
    seconds = time.perf_counter() - began
    shape, z, errors = members.shape, found.z, found.errors
    if not shape:
        end = max(int(np.isfinite(z[0]).all(axis=-1).sum()), 1)
        z, errors, times = z[:, :end], errors[:, :end], times[:end]
        message = verdicts.outcome(0, name, span[1])
    else:
        message = verdicts.outcome_of_all(name, span[1])
    steps = int(verdicts.steps.max())
    return Trajectory(
        t=times,
        z=z.reshape(*shape, *z.shape[1:]),
        names=members.H.names,
        method=name,
        steps=steps,
        dt=(span[1] - span[0]) / max(steps, 1),
        evaluations=found.evaluations,
        seconds=seconds,
        success=found.success.reshape(shape) if shape else bool(found.success[0]),
        message=message,
        ensemble=members,
        interrupted=found.interrupted,
        errors=errors.reshape(*shape, *errors.shape[1:]),
        verdicts=verdicts,
        invariant_drift=drifts,
    )


@dataclass
class Tolerated:
    """Trajectories of an ensemble, and how far each of them meets the tolerance."""

    #: States, shape (count, 1 + saves, dim); nan after the end of a trajectory.
    z: np.ndarray
    #: Estimated errors in the units of the components, shape of z; infinite where unknown.
    errors: np.ndarray
    #: Shape (count,).
    success: np.ndarray
    verdicts: Verdicts
    evaluations: int = 0
    interrupted: bool = False


class ToleranceSearch:
    """Search for the number of steps of every member with an estimated error of at most tol.

    The error of each component is relative to its largest magnitude at the compared times, or, for
    a component that is zero or tiny, to 1e-8 of the size that the terms of its equation give it.

    Starts that are not finite are refused by themselves. States are returned at the ends of
    ``saves`` equal intervals.
    """

    def __init__(self, runs: ComparedRuns, saves: int) -> None:
        self._runs, self._members, self._span, self._tol = runs, runs.members, runs.span, runs.tol
        members = runs.members
        count, dim = members.states.shape
        #: Largest number of steps of the finest run of a member.
        self._most = _MAX_UPDATES / (runs.scheme.stages * dim)
        self._most_resolving = _MAX_RESOLVING / dim
        self._coarse = np.zeros(count, dtype=np.int64)
        self._best, self._stalled = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
        self._lost, self._limited = np.zeros((2, count), dtype=np.int64)
        self._unresolved, self._featured = np.zeros((2, count), dtype=bool)
        self._found = Tolerated(
            np.full((count, 1 + saves, dim), np.nan),
            np.full((count, 1 + saves, dim), np.inf),
            np.zeros(count, dtype=bool),
            Verdicts(np.zeros(count, dtype=np.int64), np.full(count, np.inf), {}, runs.tol),
        )
        self._found.z[:, 0] = members.states
        self._problems = self._found.verdicts.problems

    def run(self, progress: bool | None) -> Tolerated:
        """Search the number of steps of each member."""
        pending = self._prepared()
        found = self._found

        def compare(block: tuple[np.ndarray, int]) -> Round:
            return self._runs.compare(*block)

        try:
            while len(pending):
                blocks = list(self._blocks(pending))
                left: list[np.ndarray] = []
                work = int(sum(coarse * len(block) for block, coarse in blocks))
                with stepping_progress(work, progress) as update, Threads(len(blocks)) as threads:
                    for _, result in threads.results(compare, blocks):
                        found.evaluations += result.evaluations
                        left.append(self._judged(result))
                        update(result.coarse * len(result.members))
                pending = np.concatenate(left)
                self._runs.is_first = False
        except KeyboardInterrupt:
            found.interrupted = True
            for index in np.flatnonzero(~found.success).tolist():
                self._problems.setdefault(index, INTERRUPTED)
        return found

    # -- numbers of steps --------------------------------------------------------------------

    def _prepared(self) -> np.ndarray:
        """Choose the first number of steps of each member; return those that have one."""
        length, states = abs(self._span[1] - self._span[0]), self._members.states
        power = 1 / self._runs.next_order
        angle = float(np.clip(_ANGLE * (self._tol / 1e-9) ** power, *_ANGLES))
        rates = fastest_rates(
            self._members.H, states, self._span[0], self._members.own_parameters()
        )
        finite = np.isfinite(states).all(axis=1)
        usable = finite.copy()
        unknown = np.flatnonzero(finite & ~np.isfinite(rates))
        usable[unknown] = self._has_rates(unknown)
        rates[unknown] = 0.0
        for index in np.flatnonzero(~usable).tolist():
            self._problems[index] = (
                "H or its gradient is not finite at the start; choose another initial state"
                if finite[index]
                else "the start is not finite; give finite numbers"
            )
        wanted = np.where(usable, length * rates / angle, 1.0)
        slow = wanted <= self._most / 4
        for index in np.flatnonzero(usable & ~slow).tolist():
            self._problems[index] = (
                f"resolving the motion at the start needs {4 * wanted[index]:.0e} steps, above the "
                "limit; give a shorter span"
            )
        pending = np.flatnonzero(usable & slow)
        self._coarse[pending] = self._rounded(wanted[pending], 4)
        return pending

    def _has_rates(self, rows: np.ndarray) -> np.ndarray:
        """Whether H and its gradient are finite at the starts of members, shape (n,)."""
        given = self._members.states[rows], self._span[0], self._members.own_parameters(rows)
        energy, rates = (self._runs.system.at(name, *given) for name in ("energy", "vector_field"))
        return np.asarray(np.isfinite(energy) & np.isfinite(rates).all(axis=1))

    def _rounded(self, steps: np.ndarray, digits: int) -> np.ndarray:
        """Round up to multiples of the samples with this number of binary digits.

        Fewer digits give fewer, larger groups of members.
        """
        multiple = np.maximum(np.ceil(steps / self._runs.sampled), 1.0)
        grain = 2.0 ** np.maximum(np.floor(np.log2(multiple)) + 1 - digits, 0.0)
        return np.asarray(np.ceil(multiple / grain) * grain, dtype=np.int64) * self._runs.sampled

    # -- runs in blocks ----------------------------------------------------------------------

    def _blocks(self, pending: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
        """Divide the members with equal numbers of steps into blocks for the cores."""
        dim = self._members.H.dim
        kinds = 2 * self._coarse[pending] + self._runs.compensated[pending]
        for kind in np.unique(kinds).tolist():
            rows, coarse = pending[kinds == kind], kind // 2
            times = self._runs.middle_saves(coarse)
            size = max(1, _BLOCK // ((times + 1) * dim))
            size = max(64, min(size, math.ceil(len(rows) / available_cores())))
            for first in range(0, len(rows), size):
                yield rows[first : first + size], coarse

    # -- verdicts ----------------------------------------------------------------------------

    def _judged(self, result: Round) -> np.ndarray:
        """Keep the results of members; return those that go on with more steps."""
        found, tol, rows = self._found, self._tol, result.members
        relative, sizes = result.found.errors[:, self._runs.kept], result.found.sizes
        worst = relative[:, -1]
        excess = result.hidden.excess
        good = (worst <= tol) & (result.changes <= 1) & (excess <= 1) & result.finite
        found.z[rows] = result.states
        with np.errstate(all="ignore"):
            errors = relative[..., None] * sizes[:, None]
        errors[np.isnan(errors)] = np.inf
        errors[:, 0] = 0.0
        found.errors[rows] = errors
        found.success[rows] = good
        found.verdicts.steps[rows], found.verdicts.largest[rows] = 4 * result.coarse, worst
        bad = np.flatnonzero(~good)
        if not len(bad):
            return rows[:0]
        again = rows[bad]
        self._lost[again] += ~result.finite[bad]
        narrow, changes = excess[bad] > 1, result.changes[bad]
        # Until its features are resolved, the differences of the runs mean nothing.
        excess = np.where(narrow, excess[bad], np.maximum(worst[bad] / tol, changes))
        better = excess < self._best[again] / 2
        better |= ~narrow & self._unresolved[again]
        self._best[again] = np.where(better, excess, self._best[again])
        self._unresolved[again] = narrow
        self._featured[again] |= narrow
        finite = result.finite[bad]
        round_off = result.found.round_off[bad]
        limited = (round_off > _LIMITED * tol) & ~self._runs.compensated[again] & ~narrow
        limited &= isinstance(self._runs.scheme, Splitting) & self._members.H.is_separable
        self._runs.compensated[again] |= limited
        better |= limited
        self._limited[again] += (round_off > tol) & ~limited
        # Beside a pole the excess varies: rounds that did not help count until it is resolved.
        count = np.where(narrow & finite, self._stalled[again], 0)
        self._stalled[again] = np.where(better | ~finite, count, self._stalled[again] + 1)
        self._runs.coupled[again] |= finite & (self._stalled[again] > 0)
        with np.errstate(all="ignore"):
            factor = ((worst[bad] - round_off) / (_AIM * tol)) ** (1 / self._runs.next_order)
        least = np.where(limited, 1.0, 1.2)
        factor = np.clip(np.nan_to_num(factor, nan=3.0, posinf=3.0), least, _MAX_GROWTH)
        # Runs that disagree say little about where the trajectory passes.
        largest = np.where(worst[bad] <= tol, np.inf, _MAX_SHORTENED)
        wanted = np.where(narrow, np.clip(1.5 * result.hidden.factor[bad], 1.5, largest), factor)
        wanted *= result.coarse
        most = np.where(self._featured[again], min(self._most, self._most_resolving), self._most)
        stop = (self._stalled[again] >= _MAX_STALLED) | (self._lost[again] >= _MAX_LOST)
        stop |= ~(result.rounding[bad] <= tol)  # which no number of steps reduces
        stop |= (4 * wanted > most) | (self._limited[again] >= _MAX_LIMITED)
        coarse = self._rounded(np.minimum(wanted, self._most), 2)
        for position in bad[stop].tolist():
            self._problems[int(rows[position])] = self._problem(result, position)
        self._coarse[again] = coarse
        return again[~stop]

    def _problem(self, result: Round, position: int) -> str:
        """Describe why a member does not meet the tolerance."""
        start, end = self._span
        worst = float(result.found.errors[position, -1])
        if not result.finite[position]:
            states = result.found.states[position]
            times = np.linspace(start, end, self._runs.sampled + 1)
            there = np.logical_and.accumulate(np.isfinite(states).all(axis=1))
            last = times[max(int(there.sum()) - 1, 0)]
            return (
                f"stopped after t = {last:.6g}: the state is no longer finite, or a step could not "
                "be solved"
            )
        if not result.hidden.excess[position] <= 1 and result.rounding[position] <= self._tol:
            return (
                f"H has a pole, a jump or a feature narrower than a step near t = "
                f"{result.hidden.times[position]:.6g}; end the span before it"
            )
        if worst <= self._tol:
            return (
                f"H changes by {SLACK * result.changes[position]:.1e} times the change that tol "
                f"{self._tol:.1e} allows, though the runs agree; end the span earlier"
            )
        steps = 4 * result.coarse
        known = f"estimated error {worst:.1e}" if math.isfinite(worst) else "unknown error"
        if result.found.round_off[position] > 0.1 * self._tol:
            cause = "limited by float64 round-off"
        elif self._stalled[result.members[position]] < _MAX_STALLED:
            cause = "more steps are above the limit"
        else:
            cause = (
                "more steps do not reduce it, as in chaos, near collisions or where H is not smooth"
            )
        return f"tol {self._tol:.1e} not met: {known} with {steps:,} steps; {cause}"
