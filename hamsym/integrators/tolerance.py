"""Integration to a tolerance with fixed-step methods: the steps of each trajectory, and its error.

Input:  an ensemble, a method, a span, a tolerance.
Output: :class:`Tolerated`: states at equally spaced times, estimated errors and verdicts.

Each trajectory is integrated with n, 2n and 4n steps, and with n steps and perturbations that stand
for round-off: twice the work of the finest run. The results are extrapolated
(:mod:`hamsym.integrators.richardson`). The first n follows from the fastest linear motion at the
start. Where the estimated error exceeds the tolerance, the next n follows from the estimate and the
order. Trajectories with equal n are integrated together.

Three runs can agree on what all of them miss. A trajectory therefore succeeds only if, in addition,
H is conserved as far as the tolerance requires, no feature at the places that the formula names is
narrower than the steps (:mod:`hamsym.integrators.narrow_features`), and the force has no other
feature between them (:mod:`hamsym.integrators.hidden_features`). What the round-off of the force
may change at its narrow features, where the runs can agree in it, is part of the error. Everything
that is decided about a trajectory depends on that trajectory alone, so that a member that fails
changes no bit of the others.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Annotated, NamedTuple

import numpy as np

from hamsym.ensemble import Ensemble
from hamsym.integrators.coefficients import Scheme, Splitting
from hamsym.integrators.fixed_step import Stepper
from hamsym.integrators.hidden_features import Hidden, hidden_features
from hamsym.integrators.narrow_features import narrow_features
from hamsym.integrators.richardson import Extrapolation, extrapolate, perturb
from hamsym.integrators.table import INTEGRATORS
from hamsym.numerics.scales import SMALLEST, coupled_sizes
from hamsym.support.cores import available_cores
from hamsym.support.progress import stepping_progress
from hamsym.support.record_fields import Size, counts, floats

_SAMPLES = 5  # fewest times at which the three runs are compared
_MIDDLE_SAVES = 64  # most saved states of the middle run between two of these times
_PERTURBED = 8  # most perturbations between two of these times
_ANGLE = 0.9  # phase of the fastest linear motion in a coarse step, at a tolerance of 1e-9
_ANGLES = (0.02, 1.5)  # limits of this phase at other tolerances
_AIM = 0.5  # of the tolerance, for the choice of the next number of steps
#: Rounding errors of a step in units of the last place: of implicit methods, which stop iterating
#: there, and of splitting methods without and with compensated summation.
_ROUNDING = {"implicit": 4.0, "plain": 8.0, "compensated": 0.25}
_LIMITED = 0.2  # round-off, relative to the tolerance, from which summation is compensated
_SLACK = 10.0  # change of H in units of the change that the tolerance allows
_MAX_GROWTH = 4.0  # largest factor between two numbers of steps
_MAX_STALLED = 3  # rounds without halving the error, after which the search ends
_MAX_LIMITED = 4  # rounds in which round-off exceeds the tolerance, in compensated summation
_MAX_LOST = 5  # rounds in which a run is not finite
_MAX_UPDATES = 1e9  # component updates of one trajectory in one run
_BLOCK = 2**16  # components of the states of a run that are processed together
_MAX_NARROW = 2**23  # components of the states after every step, for the search of features
_HIDDEN = 16.0  # factor by which steps over a feature that was found between them are too long
_EPS = float(np.finfo(float).eps)


@dataclass(frozen=True)
class Verdicts:
    """How far each trajectory of an ensemble meets the tolerance."""

    #: Steps of the finest run of each trajectory.
    steps: Annotated[np.ndarray, counts("members")]
    #: Largest estimated error of each trajectory relative to the sizes of its components.
    largest: Annotated[np.ndarray, floats("members", finite=False)]
    #: Reason for each trajectory that did not succeed, by its index.
    problems: dict[int, str]
    tol: Size


@dataclass
class Tolerated:
    """Trajectories of an ensemble, and how far each of them meets the tolerance."""

    #: States, shape (count, 1 + saves, dim); nan after the end of a trajectory.
    z: np.ndarray = field(repr=False)
    #: Estimated errors in the units of the components, shape of z; infinite where unknown.
    errors: np.ndarray = field(repr=False)
    #: Shape (count,).
    success: np.ndarray
    #: Steps of the finest run of each trajectory, shape (count,).
    steps: np.ndarray
    #: Largest estimated error of each trajectory relative to the sizes of its components.
    largest: np.ndarray
    #: Reason for each trajectory that did not succeed, by its index.
    problems: dict[int, str]
    evaluations: int = 0
    interrupted: bool = False
    tol: float = math.nan

    @property
    def verdicts(self) -> Verdicts:
        """The verdicts without the trajectories."""
        return Verdicts(self.steps, self.largest, self.problems, self.tol)


class _Round(NamedTuple):
    """Result of one number of steps for some members, which are along the first axis."""

    members: np.ndarray
    coarse: int
    states: np.ndarray
    found: Extrapolation
    finite: np.ndarray
    changes: np.ndarray
    narrow: np.ndarray
    narrow_times: np.ndarray
    rounding: np.ndarray
    evaluations: int


class ToleranceSearch:
    """Integration of every member until its estimated error is at most tol.

    The error of each component is relative to its largest magnitude at the compared times, or, for
    a component that is zero or tiny, to 1e-8 of the size that the terms of its equation give it.

    - members: States that are not finite are refused by themselves.
    - method: A splitting or implicit Runge-Kutta method.
    - saves: Number of equal intervals between the times at which states are returned.
    """

    def __init__(
        self,
        members: Ensemble,
        method: str,
        span: tuple[float, float],
        tol: float,
        saves: int,
        compensated: bool,
    ) -> None:
        self._members, self._method, self._span, self._tol = members, method, span, tol
        scheme = INTEGRATORS[method].scheme
        assert isinstance(scheme, Scheme)
        self._scheme: Scheme = scheme
        self._order = INTEGRATORS[method].order
        self._next_order = self._order + (2 if scheme.is_symmetric else 1)
        self._saves = saves
        self._sampled = saves * math.ceil(_SAMPLES / saves)
        self._narrow, self._hidden = narrow_features(members.H), hidden_features(members.H)
        self._system = members.H.compile("numpy")
        count, dim = members.states.shape
        #: Largest number of steps of the finest run of a member.
        self._most = _MAX_UPDATES / (scheme.stages * dim)
        if self._narrow is not None:
            self._most = min(self._most, 2 * _MAX_NARROW / dim)
        self._coarse = np.zeros(count, dtype=np.int64)
        self._best, self._stalled = np.full(count, np.inf), np.zeros(count, dtype=np.int64)
        self._lost, self._limited = np.zeros((2, count), dtype=np.int64)
        self._unresolved = np.zeros(count, dtype=bool)
        self._compensated = np.full(count, compensated)
        self._is_first = True
        self._least = np.zeros((count, dim))
        self._coupled = np.zeros(count, dtype=bool)
        self._found = Tolerated(
            np.full((count, 1 + saves, dim), np.nan),
            np.full((count, 1 + saves, dim), np.inf),
            np.zeros(count, dtype=bool),
            np.zeros(count, dtype=np.int64),
            np.full(count, np.inf),
            {},
        )
        self._found.z[:, 0] = members.states

    def run(self, progress: bool | None) -> Tolerated:
        """Search the number of steps of each member."""
        pending = self._prepared()
        found = self._found
        try:
            while len(pending):
                blocks = list(self._blocks(pending))
                left: list[np.ndarray] = []
                work = int(sum(coarse * len(block) for block, coarse in blocks))
                with stepping_progress(work, progress) as update:
                    for result in self._rounds(blocks):
                        found.evaluations += result.evaluations
                        left.append(self._judged(result))
                        update(result.coarse * len(result.members))
                pending = np.concatenate(left)
                self._is_first = False
        except KeyboardInterrupt:
            found.interrupted = True
            for index in np.flatnonzero(~found.success).tolist():
                found.problems.setdefault(index, "interrupted")
        return found

    # -- numbers of steps --------------------------------------------------------------------

    def _prepared(self) -> np.ndarray:
        """Choose the first number of steps of each member; return those that have one."""
        length, states = abs(self._span[1] - self._span[0]), self._members.states
        power = 1 / self._next_order
        angle = float(np.clip(_ANGLE * (self._tol / 1e-9) ** power, *_ANGLES))
        rates = np.concatenate(
            [self._rates(np.arange(i, min(i + 1024, len(states)))) for i in _starts(len(states))]
        )
        finite = np.isfinite(states).all(axis=1)
        usable = finite.copy()
        unknown = np.flatnonzero(finite & ~np.isfinite(rates))
        usable[unknown] = self._has_rates(unknown)
        rates[unknown] = 0.0
        for index in np.flatnonzero(~usable).tolist():
            self._found.problems[index] = (
                "H or its gradient is not finite at the start; choose another initial state"
                if finite[index]
                else "the start is not finite; give finite numbers"
            )
        wanted = np.where(usable, length * rates / angle, 1.0)
        slow = wanted <= self._most / 4
        for index in np.flatnonzero(usable & ~slow).tolist():
            self._found.problems[index] = (
                f"resolving the motion at the start needs {4 * wanted[index]:.0e} steps, above the "
                "limit; give a shorter span"
            )
        pending = np.flatnonzero(usable & slow)
        self._coarse[pending] = self._rounded(wanted[pending], 4)
        return pending

    def _rates(self, rows: np.ndarray) -> np.ndarray:
        """Fastest linear motion at the starts, from a trace that is the same in all units.

        The trace of (J Hess)^4 is the sum of the fourth powers of its eigenvalues.
        """
        states = self._members.states[rows]
        with np.errstate(all="ignore"):
            arguments = self._system.arguments(states, self._span[0])
            given = self._system.keywords(self._members.own_parameters(rows))
            matrices = np.asarray(self._system.jacobian(*arguments, **given))
            squares = matrices @ matrices
            traces = np.einsum("nij,nji->n", squares, squares)
        return np.asarray(np.abs(traces / 2) ** 0.25)

    def _has_rates(self, rows: np.ndarray) -> np.ndarray:
        """Whether H and its gradient are finite at the starts of members, shape (n,)."""
        states = self._members.states[rows]
        given = self._system.keywords(self._members.own_parameters(rows))
        arguments = self._system.arguments(states, self._span[0])
        with np.errstate(all="ignore"):
            energy = np.asarray(self._system.energy(*arguments, **given))
            rates = np.asarray(self._system.vector_field(*arguments, **given))
        return np.asarray(np.isfinite(energy) & np.isfinite(rates).all(axis=1))

    def _rounded(self, steps: np.ndarray, digits: int) -> np.ndarray:
        """Round up to multiples of the samples with this number of binary digits.

        Fewer digits give fewer, larger groups of members.
        """
        multiple = np.maximum(np.ceil(steps / self._sampled), 1.0)
        grain = 2.0 ** np.maximum(np.floor(np.log2(multiple)) + 1 - digits, 0.0)
        return np.asarray(np.ceil(multiple / grain) * grain, dtype=np.int64) * self._sampled

    # -- runs --------------------------------------------------------------------------------

    def _blocks(self, pending: np.ndarray) -> Iterator[tuple[np.ndarray, int]]:
        """Divide the members with equal numbers of steps into blocks for the cores."""
        dim = self._members.H.dim
        kinds = 2 * self._coarse[pending] + self._compensated[pending]
        for kind in np.unique(kinds).tolist():
            rows, coarse = pending[kinds == kind], kind // 2
            times = self._middle_saves(coarse)
            size = max(1, _BLOCK // ((times + 1) * dim))
            size = max(64, min(size, math.ceil(len(rows) / available_cores())))
            for first in range(0, len(rows), size):
                yield rows[first : first + size], coarse

    def _middle_saves(self, coarse: int) -> int:
        """Number of saved states of the run with 2*coarse steps.

        It gives the sizes of the components. In the first round few states save time; they may all
        be at the same phase of a motion.
        """
        if self._narrow is not None or self._is_searched(coarse):
            return 2 * coarse
        more = 1 if self._is_first else math.gcd(2 * coarse // self._sampled, _MIDDLE_SAVES)
        return self._sampled * more

    def _is_searched(self, coarse: int) -> bool:
        """Whether features between the steps are looked for, which takes all states."""
        return self._hidden is not None and 2 * coarse * self._members.H.dim <= _MAX_NARROW

    def _rounds(self, blocks: list[tuple[np.ndarray, int]]) -> Iterator[_Round]:
        cores = min(available_cores(), len(blocks))
        if cores == 1:
            yield from itertools.starmap(self._round, blocks)
            return
        pool = ThreadPoolExecutor(cores)
        try:
            waiting: list[Future[_Round]] = [pool.submit(self._round, *block) for block in blocks]
            for future in waiting:
                yield future.result()
        finally:
            pool.shutdown(cancel_futures=True)

    def _round(self, rows: np.ndarray, coarse: int) -> _Round:
        """Integrate members with three numbers of steps and compare the results."""
        starts = self._members.states[rows]
        first, one = self._path(rows, starts, coarse, self._sampled)
        other, count, two = self._perturbed(rows, first, coarse)
        dense, three = self._path(rows, starts, 2 * coarse, self._middle_saves(coarse))
        last, four = self._path(rows, starts, 4 * coarse, self._sampled)
        evaluations = one + two + three + four
        finite = np.isfinite(last[:, -1]).all(axis=1)  # and so it was before
        found = extrapolate(
            first,
            dense,
            last,
            other,
            count,
            self._order,
            self._next_order,
            4 * coarse,
            self._rounding(rows),
            self._least[rows],
        )
        narrow, narrow_times = np.zeros(len(rows)), np.zeros(len(rows))
        if self._narrow is not None:
            times = np.linspace(*self._span, dense.shape[1])
            narrow, place = self._narrow.unresolved(
                dense, times, self._members.own_parameters(rows), self._tol * found.sizes
            )
            narrow_times = times[place]
        states = found.states[:, :: self._sampled // self._saves]
        changes = self._energy_changes(rows, states, found.sizes, 4 * coarse)
        good = (found.errors[:, -1] <= self._tol) & (changes <= 1) & (narrow <= 1) & finite
        rounding = np.zeros(len(rows))
        if good.any() and self._is_searched(coarse):
            hidden = self._hidden_features(rows[good], dense[good], found.sizes[good])
            passed_over = ~np.isnan(hidden.times)
            narrow[good] = np.where(passed_over, _HIDDEN, narrow[good])
            narrow_times[good] = np.where(passed_over, hidden.times, narrow_times[good])
            # The runs may agree in what the round-off of the force changes in all of them. It grows
            # as the perturbations do.
            unit = self._rounding(rows) * math.sqrt(4 * coarse)
            growth = np.maximum((found.round_off / _EPS - 4 * coarse) / unit, 1.0)
            rounding[good] = (hidden.rounding / found.sizes[good]).max(axis=1) * growth[good]
            found.add_round_off(rounding)
        return _Round(
            *(rows, coarse, states, found, finite, changes, narrow, narrow_times, rounding),
            evaluations,
        )

    def _hidden_features(self, rows: np.ndarray, path: np.ndarray, sizes: np.ndarray) -> Hidden:
        """Search for features of the force between all states of members."""
        assert self._hidden is not None
        times = np.linspace(*self._span, path.shape[1])
        allowed = self._tol * sizes
        return self._hidden.search(
            path, times, self._members.own_parameters(rows), lambda i: allowed[i]
        )

    def _rounding(self, rows: np.ndarray) -> float:
        if not isinstance(self._scheme, Splitting):
            return _ROUNDING["implicit"]
        return _ROUNDING["compensated" if self._compensated[rows[0]] else "plain"]

    def _path(
        self, rows: np.ndarray, starts: np.ndarray, steps: int, saves: int
    ) -> tuple[np.ndarray, int]:
        done = self._stepper(rows, starts, steps).advance(
            saves, steps // saves, show=False, cores=1
        )
        return done.path, done.evaluations

    def _perturbed(
        self, rows: np.ndarray, coarse_path: np.ndarray, steps: int
    ) -> tuple[np.ndarray, int, int]:
        """Integrate with perturbations; return the path, their number, and evaluations."""
        stepper = self._stepper(rows, coarse_path[:, 0], steps)
        # A divisor of the steps; short runs have few perturbations.
        between = steps // self._sampled
        pieces = math.gcd(between, _PERTURBED) if between >= 2 * _PERTURBED else 1
        count = pieces * self._sampled
        path = np.empty_like(coarse_path)
        path[:, 0] = coarse_path[:, 0]
        for number in range(1, 1 + count):
            perturb(stepper.states, coarse_path, number)
            states = stepper.step(steps // count)
            if number % pieces == 0:
                path[:, number // pieces] = states
        return path, count, stepper.evaluations

    def _stepper(self, rows: np.ndarray, starts: np.ndarray, steps: int) -> Stepper:
        start, end = self._span
        return Stepper(
            self._members.H,
            self._scheme,
            self._method,
            starts,
            np.full(len(rows), start),
            np.full(len(rows), (end - start) / steps),
            self._members.parameters[rows],
            compensated=bool(self._compensated[rows[0]]),  # equal in a block
        )

    def _energy_changes(
        self, rows: np.ndarray, states: np.ndarray, sizes: np.ndarray, steps: int
    ) -> np.ndarray:
        """Largest change of H, in units of the change that errors of the tolerance can cause."""
        if not self._members.H.conserves_energy:
            return np.zeros(len(rows))
        z = states.transpose(1, 0, 2)
        given = self._system.keywords(self._members.own_parameters(rows))
        with np.errstate(all="ignore"):
            energy = np.asarray(self._system.energy(z, **given))
            slopes = np.abs(np.asarray(self._system.gradient(z, **given)))
            # Of the sizes, by the tolerance; of the states and of H, by round-off.
            allowed = np.einsum("tni,ni->tn", slopes, _SLACK * self._tol * sizes)
            noise = 4 * _EPS * math.sqrt(steps)
            allowed += noise * np.einsum("tni,tni->tn", slopes, np.abs(z)) + noise * np.abs(energy)
            change = np.abs(energy - energy[0])
            allowed = np.maximum(allowed, allowed[0])
            share = np.where(change == 0, 0.0, change / allowed).max(axis=0)
        return np.where(np.isfinite(share), share, np.inf)

    # -- verdicts ----------------------------------------------------------------------------

    def _judged(self, result: _Round) -> np.ndarray:
        """Keep the results of members; return those that go on with more steps."""
        found, tol, rows = self._found, self._tol, result.members
        kept = slice(None, None, self._sampled // self._saves)
        relative, sizes = result.found.errors[:, kept], result.found.sizes
        worst = relative[:, -1]
        good = (worst <= tol) & (result.changes <= 1) & (result.narrow <= 1) & result.finite
        found.z[rows] = result.states
        with np.errstate(all="ignore"):
            errors = relative[..., None] * sizes[:, None]
        errors[np.isnan(errors)] = np.inf
        errors[:, 0] = 0.0
        found.errors[rows] = errors
        found.success[rows], found.steps[rows], found.largest[rows] = good, 4 * result.coarse, worst
        bad = np.flatnonzero(~good)
        if not len(bad):
            return rows[:0]
        again = rows[bad]
        self._lost[again] += ~result.finite[bad]
        narrow, changes = result.narrow[bad], result.changes[bad]
        narrow = np.where(np.isnan(narrow), np.inf, narrow)
        # Until its features are resolved, the differences of the runs mean nothing.
        excess = np.where(narrow > 1, narrow, np.maximum(worst[bad] / tol, changes))
        better = excess < self._best[again] / 2
        better |= (narrow <= 1) & self._unresolved[again]
        self._best[again] = np.where(better, excess, self._best[again])
        self._unresolved[again] = narrow > 1
        finite = result.finite[bad]
        round_off = result.found.round_off[bad]
        limited = (round_off > _LIMITED * tol) & ~self._compensated[again] & (narrow <= 1)
        limited &= isinstance(self._scheme, Splitting) & self._members.H.is_separable
        self._compensated[again] |= limited
        better |= limited
        self._limited[again] += (round_off > tol) & ~limited
        self._stalled[again] = np.where(better | ~finite, 0, self._stalled[again] + 1)
        for position in bad[~self._coupled[again] & finite & (self._stalled[again] > 0)]:
            self._widen(int(rows[position]), result, position)
        with np.errstate(all="ignore"):
            factor = ((worst[bad] - round_off) / (_AIM * tol)) ** (1 / self._next_order)
        least = np.where(limited, 1.0, 1.2)
        factor = np.clip(np.nan_to_num(factor, nan=3.0, posinf=3.0), least, _MAX_GROWTH)
        wanted = np.where(narrow > 1, np.clip(1.5 * np.sqrt(narrow), 1.5, 1e3), factor)
        wanted *= result.coarse
        stop = (self._stalled[again] >= _MAX_STALLED) | (self._lost[again] >= _MAX_LOST)
        stop |= ~(result.rounding[bad] <= tol)  # which no number of steps reduces
        stop |= (4 * wanted > self._most) | (self._limited[again] >= _MAX_LIMITED)
        coarse = self._rounded(np.minimum(wanted, self._most), 2)
        for position in bad[stop].tolist():
            found.problems[int(rows[position])] = self._problem(result, position)
        self._coarse[again] = coarse
        return again[~stop]

    def _widen(self, member: int, result: _Round, position: int) -> None:
        """Compute the least sizes of the components of a member from its equations, once."""
        self._coupled[member] = True
        z, sizes = result.states[position], result.found.sizes[position]
        times = np.linspace(*self._span, len(z))
        given = self._system.keywords(self._members.own_parameters(np.array([member])))
        with np.errstate(all="ignore"):
            jacobian = self._system.jacobian(*self._system.arguments(z, times), **given)
            coupling = np.abs(np.asarray(jacobian)).mean(axis=0)
        length = abs(self._span[1] - self._span[0])
        if np.isfinite(sizes).all():
            self._least[member] = SMALLEST * coupled_sizes(sizes, coupling, length)

    def _problem(self, result: _Round, position: int) -> str:
        """Describe why a member does not meet the tolerance."""
        start, end = self._span
        worst = float(result.found.errors[position, -1])
        if not result.finite[position]:
            states, times = (
                result.found.states[position],
                np.linspace(start, end, self._sampled + 1),
            )
            there = np.logical_and.accumulate(np.isfinite(states).all(axis=1))
            last = times[max(int(there.sum()) - 1, 0)]
            return (
                f"stopped after t = {last:.6g}: the state is no longer finite, or a step could not "
                "be solved"
            )
        if not result.narrow[position] <= 1:
            return (
                f"H has a pole, a jump or a feature narrower than a step near t = "
                f"{result.narrow_times[position]:.6g}; end the span before it"
            )
        if worst <= self._tol:
            return (
                f"H changes by {_SLACK * result.changes[position]:.1e} times the change that tol "
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


def _starts(count: int) -> range:
    return range(0, count, 1024)
