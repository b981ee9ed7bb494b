"""March over a span: windows of collocation, each solved, judged and checked.

Stage 1  On a window, collocation at Chebyshev nodes is the fixed point Z = z_a + h S F(Z) with a
         precomputed integration matrix S; the residual between the nodes decides whether the window
         is accepted, and the next length (:func:`hamsym.kernel.loops.march`).
Stage 2  Where that does not contract, or where that keeps the windows short although the residual
         allows longer ones (stiff equations), Newton's method with the generated Hessian solves the
         same equation.
Stage 3  Some tens of windows at a time are checked at times that were not used
         (:mod:`hamsym.random_features.window_checks`). Where a check fails the march goes back,
         with windows that end at the times that failed: at the end of a window the residual is
         judged.
"""

from __future__ import annotations

import contextlib
import functools
import math
import time
from collections.abc import Sequence

import numpy as np
import scipy

from hamsym.kernel import loops
from hamsym.numerics.linear_systems import solved
from hamsym.numerics.scales import SMALLEST, floored_sizes, smallest_sizes
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.flow import Flow
from hamsym.random_features.window_checks import Failure, WindowChecks
from hamsym.random_features.windows import March, Windows
from hamsym.solution.times import shown_time

_NEWTON_ITERATIONS = 12
_SHRINK = 0.6  # of a window for which Newton's method fails
_TINY = np.finfo(float).tiny
_SHORTEST = 1e-13  # window, relative to the times
_ROOM = 64  # windows for which there is room at first
_CHUNKS = 32, 1_024  # windows between checks: after a failure, and at most
_RETURNS = 12  # to one place, before the march goes on although it is not resolved
_MOST_FAILURES = 3  # after which there are no more checks
# Windows between checks that show rest at a switch, and the share of the span in which they are.
_RESTING, _REST = 256, 1e-7
REST = "the motion comes to rest where a force jumps, as under dry friction"
MAX_WINDOWS = 200_000
# Of a rough look at the whole span: the share of the sizes found there that floors become, that of
# what others make of a component, steps at least, and states at most.
_AHEAD, _MOVED, _LOOKS, _MOST_LOOKS = 1e-3, 1e-3, 64, 20_000
#: Share of the length expected of the first window, below which the march looks ahead.
SHORT = 1e-4
_SURE = 5_000  # windows from which the total is known within a factor of ten


def march(
    flow: Flow,
    z0: np.ndarray,
    span: tuple[float, float],
    tolerance: float,
    basis: FeatureBasis,
    *,
    breakpoints: Sequence[float] = (),
    longest: float = math.inf,
    max_windows: int = MAX_WINDOWS,
    absolute: np.ndarray | float = 0.0,
) -> March:
    """March windows over a span, each to a local tolerance relative to each component's size.

    - z0: Shape (dim,).
    - breakpoints: Times inside the span, in its direction, at which a window must end.
    - longest: Length that no window exceeds, but for a millionth of it.
    - max_windows: The march also ends early where more than ten times as many will clearly be
      needed.
    - absolute: Size, shape (dim,), relative to which the tolerance may be, where the terms of its
      own equation give a component at least that.
    """
    limits = longest, max_windows, absolute
    return _Marching(flow, z0, span, tolerance, basis, breakpoints, *limits).run()


class _Buffer:
    """Windows in arrays that grow; the loop fills them, the caller counts them."""

    def __init__(self, start: float, z0: np.ndarray, columns: int, room: int) -> None:
        dim = len(z0)
        self.room = room
        self._arrays = Windows(
            np.empty(room + 1), np.empty((room + 1, dim)), np.empty((room, columns, dim))
        )
        self._arrays.edges[0], self._arrays.states[0] = start, z0

    def part(self, first: int, end: int) -> Windows:
        """Views of the windows from ``first`` to before ``end``."""
        edges, states, readouts = self._arrays
        return Windows(edges[first : end + 1], states[first : end + 1], readouts[first:end])

    def grow(self, room: int) -> None:
        """Make room for this many windows in total."""
        more, self.room = room - self.room, room
        self._arrays = Windows(
            *(np.concatenate((old, np.empty((more, *old.shape[1:])))) for old in self._arrays)
        )


class _Marching:
    """One march: its windows so far and the state of the loop."""

    def __init__(
        self,
        flow: Flow,
        z0: np.ndarray,
        span: tuple[float, float],
        tolerance: float,
        basis: FeatureBasis,
        breakpoints: Sequence[float],
        longest: float,
        max_windows: int,
        absolute: np.ndarray | float,
    ) -> None:
        self._began, self._cpu_began = time.perf_counter(), time.thread_time()
        self._flow, self._basis = flow, basis
        self._max_windows = max_windows
        self._origin = origin_of(flow.autonomous, span)
        self._start, self._end = (t - self._origin for t in span)
        self._whole = abs(self._end - self._start)
        self._direction = 1.0 if self._end > self._start else -1.0
        self._stops = [*(t - self._origin for t in breakpoints), self._end]
        dim = len(z0)
        self._tolerance, self._longest, self._absolute = tolerance, longest, absolute
        self._floors = np.zeros(dim)
        self._shortest = shortest_window(self._start, self._end)
        # Just inside the span: at the start a switch in time has neither of its values.
        inside = self._start + self._direction * self._shortest
        self._rate = flow.programs.rates(z0[None], np.array([inside]), flow.parameters)[0]
        self._clock = np.array([self._start, 0.0, 0.0])  # time, next length, last slow length
        self._counts = np.array([0, 1, 0, 0])  # windows, evaluations, stops passed, slow windows
        self._sizes = np.abs(z0)
        self._tail = np.zeros((dim, basis.tables.terms))
        self._found = np.empty((dim, len(basis.nodes)))
        self._tail[:, 0] = self._rate
        columns = basis.series.shape[1]
        self._windows = _Buffer(self._start, z0, columns, min(_ROOM, max_windows))
        self._checks = WindowChecks(flow, basis, tolerance)
        self._checked, self._chunk = 0, _ROOM
        self._known = self._sizes.copy()  # sizes up to the last window that was checked
        self._furthest: float | None = None  # end of the last window that failed a check
        self._returns = 0  # to windows before it
        self._failures: list[str] = []  # that shorter windows did not mend
        self._looked_ahead = False
        self._widen_floors()
        self._clock[1] = self._first = loops.first_length(
            *(flow.programs, basis.tables, flow.parameters, z0, self._rate, self._start, self._end)
        )

    @property
    def _count(self) -> int:
        return int(self._counts[0])

    def run(self) -> March:
        newton_windows, given, status = 0, False, loops.FULL
        reason = ""
        progress = loops.Progress(  # of arrays that are updated in place
            clock=self._clock,
            counts=self._counts,
            size=self._sizes,
            tail=self._tail,
            found=self._found,
        )
        while status != loops.FINISHED and not reason:
            # The loop returns when it has no room: after a chunk its windows are checked.
            room = min(self._windows.room, max(self._checked + self._chunk, self._count))
            status = loops.march(
                self._flow.programs,
                self._basis.tables,
                self._settings(),
                progress,
                loops.Windows(*self._windows.part(0, room)),
                given,
            )
            if self._begins_too_short():
                self._look_ahead()
                given, status = False, loops.FULL
                continue
            given = status == loops.NEWTON and self._newton()
            newton_windows += given
            if status == loops.NEWTON:
                continue
            resting = self._is_resting()
            failure = self._check()
            if failure is not None:
                self._go_back(failure)
                status = loops.FULL
            elif status == loops.TOO_SHORT and not self._count and not self._looked_ahead:
                self._look_ahead()
            elif status == loops.TOO_SHORT:
                reason = self._too_short()
            elif resting:
                reason = REST
            elif status == loops.FULL and not (reason := self._too_many()):
                if self._count == self._windows.room:
                    self._windows.grow(min(2 * self._count, self._max_windows))
                self._widen_floors()
        windows = self._windows.part(0, self._count)
        return March(
            edges=windows.edges.copy(),
            states=windows.states.copy(),
            readouts=windows.readouts.copy(),
            reached=self._origin + float(self._clock[0]),
            reason=reason,
            evaluations=int(self._counts[1]),
            newton_windows=newton_windows,
            scale=self._sizes,
            seconds=time.perf_counter() - self._began,
            cpu_seconds=time.thread_time() - self._cpu_began,
            seed=self._basis.seed,
            origin=self._origin,
            doubt=self._failures[0] if self._failures else "",
        )

    def _settings(self) -> loops.Settings:
        signs = node_signs(self._basis, len(self._floors))
        return loops.Settings(
            stops=len(self._stops),
            width=signs.shape[1],
            tolerance=self._tolerance,
            shortest=self._shortest,
            longest=self._longest,
            stop=np.array(self._stops),
            floor=self._floors,
            sign=signs,
            parameters=self._flow.parameters,
        )

    def _newton(self) -> bool:
        """Solve the present window by Newton's method; shorten it where that fails."""
        t, length = self._clock[:2]
        rates, spent = newton(
            self._flow,
            self._basis,
            self._windows.part(0, self._count).states[-1],
            float(t),
            self._direction * float(length),
            self._tolerance,
            np.maximum(self._sizes, self._floors),
        )
        self._counts[1] += spent
        if rates is None:
            self._clock[1] *= _SHRINK
            return False
        self._found[:] = rates.T
        return True

    # -- between two calls of the loop -----------------------------------------------------------

    def _shown(self, t: float) -> str:
        start, end = self._origin + self._start, self._origin + self._end
        return shown_time(self._origin + t, start, end)

    def _too_short(self) -> str:
        """The reason for ending at a window that is too short."""
        reason = (
            "window length fell below the float64 limit; the solution may be singular or leave the "
            "domain of H"
        )
        if max(abs(self._start), abs(self._end)) > 100 * self._whole:
            reason += ", or t is too large for float64 to resolve: shift the time towards 0"
        if not self._flow.autonomous:
            reason += "; give times at which H is discontinuous as breakpoints"
        return reason

    def _is_resting(self) -> bool:
        """Whether a force that jumps keeps the motion where it is since the last check."""
        first, count = self._checked, self._count
        if not self._flow.switched or count - first < _RESTING:
            return False
        edges = self._windows.part(first, count).edges
        return bool(abs(edges[-1] - edges[0]) < _REST * self._whole)

    def _too_many(self) -> str:
        """The reason for ending where more windows than allowed are needed, "" where they fit."""
        count, done = self._count, abs(float(self._clock[0]) - self._start)
        if not done > 0:
            return ""
        needed = count * self._whole / done
        if count >= self._max_windows or (count >= _SURE and needed > 10 * self._max_windows):
            return f"the span needs about {needed:.0e} windows, more than {self._max_windows:,}"
        return ""

    def _widen_floors(self) -> None:
        """Update the smallest sizes of the components from their coupling to the others."""
        count = self._count
        places = np.unique(np.linspace(0, count, min(count + 1, 8)).astype(int))
        windows = self._windows.part(0, count)
        z, t = windows.states[places], windows.edges[places]
        coupling = np.abs(self._flow.jacobian(z, t)).mean(axis=0)
        smallest = smallest_sizes(self._sizes, coupling, self._whole)
        counted = np.minimum(self._absolute, smallest / SMALLEST)
        self._floors = np.maximum(self._floors, np.maximum(smallest, counted))

    def _begins_too_short(self) -> bool:
        """Whether the first window is short for a component that begins at zero, moved by none."""
        if self._looked_ahead or self._checked or not self._count:
            return False
        windows = self._windows.part(0, 1)
        resting = (windows.states[0] == 0) & (self._floors == 0)
        return bool(abs(np.diff(windows.edges)[0]) < SHORT * self._first and resting.any())

    def _look_ahead(self) -> None:
        """Raise the floors to a share of the sizes that components have later, and begin again.

        A component that begins with a high power of the time, as the far end of a chain of quartic
        springs, is in no short window resolved relative to itself.
        """
        self._looked_ahead = True
        z0, time = self._windows.part(0, 0).states[0], np.array([self._start])
        states = [np.abs(z0)]

        def rates(t: float, z: np.ndarray) -> np.ndarray:
            if len(states) > _MOST_LOOKS or not np.isfinite(z).all():
                raise StopIteration
            states.append(np.abs(z))
            return np.asarray(self._flow.vector_field(z[None], np.array([t]))[0])

        coupling = np.abs(self._flow.jacobian(z0[None], time)[0])
        scale = floored_sizes(states[0], coupling, self._whole, _MOVED)
        span, longest = (self._start, self._end), self._whole / _LOOKS
        with contextlib.suppress(StopIteration), np.errstate(all="ignore"):
            scipy.integrate.solve_ivp(
                rates, span, z0, max_step=longest, rtol=1e-4, atol=1e-6 * scale
            )
        self._floors = np.maximum(self._floors, _AHEAD * np.max(states, axis=0))
        self._clock[:] = self._start, self._whole, 0.0
        self._counts[[0, 2, 3]] = 0
        self._known = np.abs(z0)
        self._sizes[:] = np.abs(z0)
        self._tail[:, 1:], self._tail[:, 0] = 0.0, self._rate

    def _check(self) -> Failure | None:
        """Check the windows since the last check."""
        first, count = self._checked, self._count
        if count == first or len(self._failures) >= _MOST_FAILURES:
            self._checked = count
            return None
        windows = self._windows.part(first, count)
        # Those so far: a window that fails may be followed by states of any size.
        inside = self._basis.columns(self._basis.nodes)[0] @ windows.readouts
        inside = np.abs(windows.states[:-1, None] + inside).max(axis=1)
        sizes = np.maximum.accumulate(np.vstack([self._known, inside]))
        failure = self._checks.first_failure(windows, np.maximum(sizes[1:], self._floors))
        passed = count - first if failure is None else failure.window
        self._known, self._checked = sizes[passed], first + passed
        self._chunk = _CHUNKS[0] if failure else min(2 * self._chunk, _CHUNKS[1])
        return failure and failure._replace(window=first + failure.window)

    def _go_back(self, failure: Failure) -> None:
        """Return to the start of a window, with stops at the times that failed."""
        window, direction = failure.window, self._direction
        start, end = (float(edge) for edge in self._windows.part(window, window + 1).edges)
        if self._furthest is None or direction * end > direction * self._furthest:
            self._furthest, self._returns = end, 0
        self._returns += 1
        shortest = self._shortest
        if self._returns > _RETURNS or abs(end - start) < 100 * shortest:
            # For example at a jump: the march goes on, without success.
            self._failures.append(
                f"near t = {self._shown(failure.times[0])}, between the points of "
                f"collocation, {failure.cause} changes by {failure.excess:.0e} times the tolerance "
                "in windows of any length"
            )
            self._checked = window + 1
            return
        clock, counts, tail = self._clock, self._counts, self._tail
        counts[0], clock[0] = window, start
        self._sizes[:] = self._known
        for t in failure.times:
            nearest = min(abs(t - stop) for stop in (*self._stops, start, end))
            if nearest > 10 * shortest:
                self._stops.append(t)
        self._stops.sort(key=lambda stop: direction * stop)
        counts[2] = sum(direction * stop <= direction * start for stop in self._stops)
        clock[1] = abs(end - start) / 2
        tail[:, 1:] = 0
        tail[:, 0] = self._rate
        if window:
            last = self._windows.part(window - 1, window)
            _, rates = self._basis.columns(self._basis.nodes)
            found = rates @ last.readouts[0] / (start - last.edges[0])
            tail[:] = found.T @ self._basis.tables["extrapolation"]


def newton(
    flow: Flow,
    basis: FeatureBasis,
    z: np.ndarray,
    start: float,
    length: float,
    tolerance: float,
    sizes: np.ndarray,
) -> tuple[np.ndarray | None, int]:
    """Solve one window by Newton's method from the constant state.

    - z: State at the start of the window, shape (dim,).
    - start, length: Start and length of the window, negative backwards in time.
    - sizes: Sizes of the components, shape (dim,).
    - returns rates: F at the nodes, shape (nodes, dim); None without convergence.
    """
    times, integration = start + length * basis.nodes, length * basis.integration
    count, dim = len(times), len(z)
    enough = max(0.01 * tolerance, 4e-16)
    Z = np.tile(z, (count, 1))
    last = math.inf
    for step in range(1, _NEWTON_ITERATIONS + 1):
        rates = flow.vector_field(Z, times)
        defect = z + integration @ rates - Z
        matrix = np.eye(count * dim) - np.einsum(
            "kl,lij->kilj", integration, flow.jacobian(Z, times)
        ).reshape(count * dim, count * dim)
        correction = solved(matrix, defect.reshape(-1, 1)).reshape(count, dim)
        Z = Z + correction
        scale = np.maximum(np.maximum(sizes, np.abs(Z).max(axis=0)), _TINY)
        change = float((np.abs(correction) / scale).max())
        if change <= enough or (change < 1e-11 and change >= last):
            return flow.vector_field(Z, times), step + 1
        if not change < 1e6:
            return None, step
        last = change
    return None, _NEWTON_ITERATIONS


@functools.lru_cache(maxsize=64)
def node_signs(basis: FeatureBasis, dim: int) -> np.ndarray:
    """Return the signs with which the states of a window are disturbed, shape (dim, points)."""
    generator = np.random.default_rng(basis.seed)
    return generator.choice((-1.0, 1.0), size=(dim, max(len(basis.nodes), len(basis.between))))


def origin_of(autonomous: bool, span: tuple[float, float]) -> float:
    """Choose the time from which times are counted, since float64 resolves large times coarsely."""
    start, end = span
    # Then all differences to the start are exact (Sterbenz's lemma).
    exact = start != 0 and 0.5 <= end / start <= 2
    return start if autonomous and exact else 0.0


def shortest_window(start: float, end: float) -> float:
    """Return the length below which float64 does not resolve a window."""
    return _SHORTEST * max(abs(end - start), abs(start), abs(end))
