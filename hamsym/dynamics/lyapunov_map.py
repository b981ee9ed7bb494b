"""Lyapunov exponents of many trajectories at once.

Input:  an ensemble of initial states and parameter values, a time span.
Output: the finite-time exponents of each member, without their history.

Members are divided by the fastest rate of their linear motion into classes of powers of two, and
each class has its own step, so that a member's result does not depend on the others. A class is
stepped in chunks that bound the memory and that occupy all cores. A member whose steps turn out to
be too long is computed again with shorter ones.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from hamsym.dynamics.tangent_steps import (
    APART,
    PARALLEL,
    STEPS_PER_RADIAN,
    UNRESOLVED,
    first_passed,
    first_vectors,
    growth_limit,
    orthonormal,
)
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.energy_drift import COARSE, EnergyDrift
from hamsym.integrators.hidden_features import passed_over
from hamsym.integrators.step_scales import fastest_rates
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import resolved_angle, too_fast
from hamsym.numerics.scales import tangent_scales
from hamsym.parallel.threads import Threads
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.problem import MAX_STEPS
from hamsym.support.machine import available_cores
from hamsym.support.progress import stepping_progress
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import suggest_attributes

_BLOCKS = 200  # fewest renormalisations, after which the energy is checked as well
_FEWEST_STEPS = 1_000
_LONGEST_BLOCK = 10_000  # steps
_HELD = 1_000_000  # numbers of the paths of a chunk
_SAMPLED = 50  # states of a path at which the rate is measured
_RESOLVED = 1.5  # times its first rate that a member's motion may reach
_FASTER = 8.0  # times by which steps become shorter in one repetition
_REPETITIONS = 3
_OCTAVES = 40  # of times after a start at which the linear motion has no rate
_TESTED_SHARE = 0.9  # tested part of a trajectory that ends early; no step resolves the rest


@suggest_attributes
@dataclass(frozen=True)
class LyapunovMap(Drawn, Shown):
    """Finite-time Lyapunov exponents of many trajectories; ``...`` is the shape of the starts.

    There is no history: the memory is that of the results.

    ``plot()`` draws the largest exponent over the plane, or the row, of what varies along the axes
    of the array, of which there must be one or two; ``plot("x")`` over a component or a parameter,
    ``plot("x", "p")`` as a point of each start in the plane of two.

    Attributes
    ----------
    exponents : numpy.ndarray
        Logarithm of the growth up to the end, divided by the time, the largest first, shape
        (..., count); nan where ``success`` is False.
    success : numpy.ndarray
        Whether the trajectory reached the end, kept H as for :class:`hamsym.LyapunovExponents`, and
        passed over no feature of the force, shape (...).
    message : numpy.ndarray
        Outcome of each member, shape (...), of str.
    z0 : numpy.ndarray
        Starts, shape (..., dim).
    parameters : dict of str to numpy.ndarray
        Values of the parameters that were given, shape (...).
    names : tuple of str
        Components of z0.
    span : (float, float)
    energy_error : numpy.ndarray
        Largest change of H at 200 times or more, shape (...); nan if H depends on time.
    steps : numpy.ndarray
        Number of steps of each member, shape (...); 0 where none was taken.
    method : str
    seconds : float
    interrupted : bool
        Whether Ctrl-C ended the run; members that were not finished are nan.
    H : Hamiltonian
        With the parameters of the first member where they differ.
    """

    exponents: np.ndarray = field(repr=False)
    success: np.ndarray = field(repr=False)
    message: np.ndarray = field(repr=False)
    z0: np.ndarray = field(repr=False)
    parameters: dict[str, np.ndarray] = field(repr=False)
    H: Hamiltonian = field(repr=False, compare=False)
    names: tuple[str, ...]
    span: tuple[float, float]
    energy_error: np.ndarray = field(repr=False)
    steps: np.ndarray = field(repr=False)
    method: str
    seconds: float
    interrupted: bool = False

    def __repr__(self) -> str:
        good, size = int(self.success.sum()), self.success.size
        return (
            f"LyapunovMap({self.H.formulas!r}, shape {self.success.shape}, "
            f"t to {self.span[1]:.6g}: {good:,} succeeded, {size - good:,} failed)"
        )

    @property
    def maximal(self) -> np.ndarray:
        """The largest exponent of each member, per unit of time, shape (...)."""
        return self.exponents[..., 0]

    @property
    def statement(self) -> str:
        """Number of members that succeeded, the range of their exponents, the first failure."""
        given = np.isfinite(self.z0).all(axis=-1)
        text = (
            f"{self.success.sum():,} of {given.sum():,} trajectories reached t = {self.span[1]:.6g}"
        )
        if not given.all():
            text += f" (starts that are not finite: {(~given).sum():,})"
        if self.success.any():
            values = self.maximal[self.success]
            text += (
                f"; their largest exponents run from {values.min():.3g} to {values.max():.3g}, "
                f"with median {np.median(values):.3g}"
            )
        failed = given & ~self.success
        if failed.any():
            first = np.unravel_index(int(np.argmax(failed)), failed.shape)
            index = ", ".join(map(str, first))
            text += f"; the first that failed is [{index}]: {self.message[first]}"
        return text + "."


def lyapunov_map(
    members: Ensemble,
    span: tuple[float, float],
    method: str,
    steps: int | None,
    count: int,
    seed: int,
    progress: bool | None,
) -> LyapunovMap:
    """Compute the exponents of each member; see :func:`hamsym.lyapunov`.

    - steps: Number of steps of every member; by default it is chosen for each.
    """
    began = time.perf_counter()
    run = _Run(members, span, method, steps, count, seed)
    interrupted = False
    for _ in range(1 + _REPETITIONS):
        interrupted = interrupted or run.repeat(progress)
    shape = members.shape
    messages = np.array(run.problems, dtype=object)
    success = messages == ""
    messages[success] = [
        f"{method}: {steps:,} steps to t = {span[1]:.6g}" for steps in run.steps[success]
    ]
    exponents = np.where(success[:, None], run.exponents, np.nan)
    return LyapunovMap(
        exponents=exponents.reshape(*shape, exponents.shape[1]),
        success=success.reshape(shape),
        message=messages.reshape(shape),
        z0=members.states.reshape(*shape, members.H.dim),
        parameters={name: own.reshape(shape) for name, own in members.columns.items()},
        names=members.H.names,
        span=span,
        energy_error=run.energy_error.reshape(shape),
        steps=run.steps.reshape(shape),
        method=method,
        seconds=time.perf_counter() - began,
        interrupted=interrupted,
        H=members.H,
    )


@dataclass(frozen=True)
class _Outcome:
    """Results of a chunk, in the order of its members.

    ``rates`` are the rates for which a member's steps are too long, nan if they are not.
    """

    exponents: np.ndarray
    energy_error: np.ndarray
    problems: list[str]
    rates: np.ndarray


class _Run:
    """Results of all members so far."""

    def __init__(
        self,
        members: Ensemble,
        span: tuple[float, float],
        method: str,
        steps: int | None,
        count: int,
        seed: int,
    ) -> None:
        self._members, self._span, self._method, self._steps = members, span, method, steps
        self._length = abs(span[1] - span[0])
        self._limit = growth_limit(count)
        self._vectors = first_vectors(members.H.dim, count, seed)
        size = len(members)
        self.exponents = np.full((size, count), np.nan)
        self.energy_error = np.full(size, np.nan)
        self.steps = np.zeros(size, dtype=np.int64)
        self.problems = ["interrupted"] * size
        there = np.isfinite(members.states).all(axis=1)
        #: Fastest rate for which the steps of the next run are chosen; nan if there is none.
        self._rates = np.full(size, np.nan)
        if there.any():
            index = np.flatnonzero(there)
            rates = self._class(self._fastest(index, members.states[there][:, None], span[0]))
            self._rates[index] = np.where(np.isfinite(rates), rates, np.nan)
        for i in np.flatnonzero(np.isnan(self._rates)):
            self.problems[i] = (
                "the Hessian of H is not finite at the start"
                if there[i]
                else "the start is not finite"
            )

    def repeat(self, progress: bool | None) -> bool:
        """Run the members that need it; return whether Ctrl-C interrupted."""
        chunks = list(self._chunks())
        self._rates[:] = np.nan
        work = sum(len(index) * steps for index, _, steps, _ in chunks)
        with stepping_progress(work, progress) as report, Threads(len(chunks)) as threads:

            def advance(chunk: tuple[np.ndarray, float, int, int]) -> _Outcome:
                return self._advance(*chunk, report, threads)

            try:
                for (index, _, steps, _), found in threads.results(advance, chunks):
                    self._store(index, steps, found)
            except KeyboardInterrupt:
                return True
        return False

    def _store(self, index: np.ndarray, steps: int, found: _Outcome) -> None:
        self.exponents[index] = found.exponents
        self.energy_error[index] = found.energy_error
        self.steps[index] = steps
        self._rates[index] = found.rates
        for i, problem in zip(index, found.problems, strict=True):
            self.problems[i] = problem

    def _chunks(self) -> Iterator[tuple[np.ndarray, float, int, int]]:
        """Yield indices of members with one rate, the rate, and numbers of steps and blocks."""
        for rate in np.unique(self._rates[np.isfinite(self._rates)]).tolist():
            index = np.flatnonzero(self._rates == rate)
            wanted = STEPS_PER_RADIAN * rate * self._length
            if self._steps is None and not wanted <= MAX_STEPS:
                for i in index:
                    self.problems[i] = f"the motion has rates up to {rate:.2g}: give steps or dt"
                continue
            steps = math.ceil(wanted) if self._steps is None else self._steps
            grown = min(rate * self._length / self._limit, steps)
            blocks = min(steps, max(_BLOCKS, math.ceil(grown), steps // _LONGEST_BLOCK))
            held = max(1, _HELD // (blocks * self._members.H.dim))
            parts = max(-(-len(index) // held), min(available_cores(), len(index)))
            for part in np.array_split(index, parts):
                yield part, rate, steps, blocks

    def _advance(
        self,
        index: np.ndarray,
        rate: float,
        steps: int,
        blocks: int,
        report: Callable[[int], None],
        threads: Threads,
    ) -> _Outcome:
        """Step a chunk through the span."""
        (start, end), states = self._span, self._members.states[index]
        size, count = (end - start) / steps, len(index)
        scales = self._scales(index)
        stepper = Stepper(
            self._members.H,
            self._method,
            states,
            np.full(count, start),
            np.full(count, size),
            tangents=scales * self._vectors,
            parameters=self._members.parameters[index],
        )
        edges = np.linspace(0, steps, blocks + 1).astype(np.int64)
        path = np.full((count, blocks + 1, states.shape[1]), np.nan)
        path[:, 0] = states
        growth, apart = np.zeros((count, self._vectors.shape[1])), np.zeros(count, dtype=bool)
        there = np.ones(count, dtype=bool)
        for block, taken in enumerate(np.diff(edges).tolist(), 1):
            if threads.is_stopped:
                raise KeyboardInterrupt
            path[:, block] = stepper.step(taken)
            with np.errstate(all="ignore"):  # of members that have escaped
                vectors, grown = orthonormal(stepper.tangents / scales)
                stepper.tangents[:] = scales * vectors
                kept = np.isfinite(grown).all(axis=1) & (np.ptp(grown, axis=1) <= PARALLEL)
            there &= np.isfinite(path[:, block]).all(axis=1)
            apart |= there & ~kept
            growth += grown
            report(taken * count)
            if not there.any():
                break
        exponents = np.sort(growth, axis=1)[:, ::-1] / self._length
        return self._judged(index, rate, steps, start + size * edges, path, apart, exponents)

    def _judged(
        self,
        index: np.ndarray,
        rate: float,
        steps: int,
        times: np.ndarray,
        path: np.ndarray,
        apart: np.ndarray,
        exponents: np.ndarray,
    ) -> _Outcome:
        """Find what failed for each member, and whether shorter steps may help."""
        H, chosen = self._members.H, self._steps is None
        reached = np.logical_and.accumulate(np.isfinite(path).all(axis=2), axis=1).sum(axis=1)
        lost = reached < len(times)
        tested = np.where(lost, np.ceil(_TESTED_SHARE * reached), reached)
        path[np.arange(len(times)) >= tested[:, None]] = np.nan
        drift = EnergyDrift(H, len(index), self._members.own_parameters(index))
        drift.add(path)
        share = drift.relative(steps)
        coarse = ~(share <= COARSE) if H.conserves_energy else np.zeros(len(index), dtype=bool)
        every = -(-len(times) // _SAMPLED)
        fastest = self._fastest(index, path[:, ::every], times[::every])
        again = apart | (chosen & (coarse | ~(fastest <= _RESOLVED * rate)))
        rates = np.clip(self._class(fastest), 2 * rate, _FASTER * rate)
        most = UNRESOLVED * rate if chosen else math.inf
        if not H.conserves_energy:  # which tests steps that are given
            most = min(most, resolved_angle(self._method) * steps / self._length)
        problems = []
        for i in range(len(index)):
            problem = ""
            if lost[i]:
                problem = (
                    f"stopped after t = {times[reached[i] - 1]:.6g}: the states overflowed, or a "
                    "step could not be solved"
                )
            elif apart[i]:
                problem = APART
            elif coarse[i]:
                problem = (
                    f"H changed by {drift.change[i]:.1e}, {share[i]:.0%} of its scale: take a "
                    "smaller dt"
                )
            elif not fastest[i] <= most:
                problem = too_fast(fastest[i], self._method)
            problems.append(problem)
        good = np.flatnonzero([not problem for problem in problems])
        members = self._members.some(index[good])
        passed = first_passed(
            members, self._method, times[0], (times[-1] - times[0]) / steps, steps
        )
        for k in np.flatnonzero(np.isfinite(passed)):
            problems[good[k]] = passed_over(passed[k])
        change = drift.change if H.conserves_energy else np.full(len(index), np.nan)
        return _Outcome(exponents, change, problems, np.where(again, rates, np.nan))

    def _class(self, rates: np.ndarray) -> np.ndarray:
        """Return the next power of two, at least that of the fewest steps."""
        least = _FEWEST_STEPS / (STEPS_PER_RADIAN * self._length)
        return np.exp2(np.ceil(np.log2(np.maximum(rates, least))))

    def _fastest(
        self, index: np.ndarray, states: np.ndarray, times: np.ndarray | float
    ) -> np.ndarray:
        """Return the fastest rate of members along finite states, (n, k, dim), shape (n,)."""
        own = self._members.own_parameters(index)
        own = None if own is None else own[:, None]
        rates = fastest_rates(self._members.H, states, times, own)
        return np.where(np.isfinite(states).all(axis=-1), rates, 0.0).max(axis=-1)

    def _scales(self, index: np.ndarray) -> np.ndarray:
        """Return the units of the tangent vectors of members, from their starts, (n, dim, 1).

        Where the linear motion has no rate at the start, the states are those at constant rates of
        change after times at whose end it has turned by a radian.
        """
        system, states = self._members.H.compile("numpy"), self._members.states[index]
        start, values = self._span[0], self._members.own_parameters(index)
        dim, there = states.shape[1], states
        resting = self._fastest(index, states[:, None], start) == 0
        if resting.any():
            moving = system.at("vector_field", states, start, values)
            left = resting.copy()
            for octave in range(_OCTAVES):
                time = self._length * 2.0 ** (octave - _OCTAVES + 1)
                with np.errstate(all="ignore"):
                    tried = states + np.where(left[:, None], time * moving, 0.0)
                    turned = self._fastest(index, tried[:, None], start) * time
                there = np.where(left[:, None], tried, there)
                left &= ~(turned >= 1)
        found = system.at("jacobian", there, start, values)
        if found.ndim == 2:  # a constant matrix
            found = found[None]
        found = found.reshape(-1, dim, dim)
        units = np.array([tangent_scales(one, self._length) for one in found])
        return np.broadcast_to(units, states.shape)[..., None]
