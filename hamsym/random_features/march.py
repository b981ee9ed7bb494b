"""The march over a span: windows of collocation, each solved, judged and checked.

Stage 1  On a window, collocation at Chebyshev nodes is the fixed point Z = z_a + h S F(Z) with a
         precomputed integration matrix S; the residual between the nodes decides whether the window
         is accepted, and the next length (:mod:`hamsym.random_features.window_loop`).
Stage 2  Where that does not contract, Newton's method with the generated Hessian solves the same
         equation.
Stage 3  Some tens of windows at a time are checked at times that were not used
         (:mod:`hamsym.random_features.window_checks`). Where a check fails the march goes back,
         with windows that end at the times that failed, so that what is there lies at the end of a
         window, where the residual is judged.
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Sequence

import numpy as np

from hamsym.numerics.scales import SMALLEST, coupled_sizes
from hamsym.random_features import compiled_loop, window_loop
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.flow import Flow
from hamsym.random_features.window_checks import Failure, WindowChecks, Windows
from hamsym.random_features.windows import March

__all__ = ["MAX_WINDOWS", "march", "newton"]

_NEWTON_ITERATIONS = 12
_SHORTEST = 1e-13  # window, relative to the times
_ROOM = 64  # windows for which there is room at first
_CHUNKS = 32, 1_024  # windows between checks: after a failure, and at most
_RETURNS = 12  # to one place, before the march goes on without its being resolved
_DOUBTS = 3  # after which there are no more checks
MAX_WINDOWS = 200_000
_SURE = 5_000  # windows after which it is clear how many more are needed, within a factor of ten


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
) -> March:
    """March windows over a span, each to a local tolerance relative to each component's size.

    Parameters
    ----------
    flow : Flow
    z0 : numpy.ndarray
        Shape (dim,).
    span : (float, float)
    tolerance : float
    basis : FeatureBasis
    breakpoints : sequence of float
        Times inside the span, in its direction, at which a window must end.
    longest : float
        Length that no window exceeds, but for a millionth of it.
    max_windows : int
        The march also ends early where more than ten times as many will clearly be needed.
    """
    return _Marching(flow, z0, span, tolerance, basis, breakpoints, longest, max_windows).run()


class _Marching:
    """One march: its windows so far, and what the loop needs to go on."""

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
    ) -> None:
        self._began, self._cpu_began = time.perf_counter(), time.process_time()
        self._flow, self._basis, self._tolerance = flow, basis, tolerance
        self._longest, self._max_windows = longest, max_windows
        self._origin = _origin(flow, span)
        self._start, self._end = (t - self._origin for t in span)
        self._direction = 1.0 if self._end > self._start else -1.0
        self._stops = [*(t - self._origin for t in breakpoints), self._end]
        self._shortest = _SHORTEST * max(
            abs(self._end - self._start), abs(self._start), abs(self._end)
        )
        dim, columns = len(z0), basis.mixing.shape[1]
        self._signs = _signs(basis, dim)
        # What the loop carries from call to call.
        self._rate = np.empty((1, dim))
        flow.rates(z0[None], np.array([self._start]), self._rate)
        self._sizes, self._floors = np.abs(z0), np.zeros(dim)
        self._clock = np.array([self._start, 0.0])
        self._counts = np.array([0, 1, 0])
        self._tail = np.vstack((self._rate, np.zeros((2, dim))))
        self._found = np.empty((len(basis.nodes), dim))
        room = min(_ROOM, max_windows)
        self._edges, self._states = np.empty(room + 1), np.empty((room + 1, dim))
        self._readouts = np.empty((room, columns, dim))
        self._edges[0], self._states[0] = self._start, z0
        self._checks = WindowChecks(flow, basis, tolerance)
        self._checked, self._chunk = 0, _ROOM
        self._furthest: float | None = None  # end of a window that failed
        self._returns = 0  # to windows before it
        self._doubts: list[str] = []
        self._widen_floors()
        sizes = np.maximum(self._sizes, self._floors / SMALLEST)
        self._clock[1] = _first_length(sizes, self._rate[0], abs(self._end - self._start))

    @property
    def _count(self) -> int:
        return int(self._counts[0])

    def run(self) -> March:
        newton_windows, given, reason = 0, False, ""
        while True:
            # The loop returns when it has no room: after a chunk its windows are checked.
            room = min(len(self._readouts), max(self._checked + self._chunk, self._count))
            status = self._loop(room, given)
            given = False
            if status == window_loop.NEWTON:
                rates, spent = newton(
                    self._flow,
                    self._basis,
                    self._states[self._count],
                    float(self._clock[0]),
                    self._direction * float(self._clock[1]),
                    self._tolerance,
                    np.maximum(self._sizes, self._floors),
                )
                self._counts[1] += spent
                if rates is None:
                    self._clock[1] *= window_loop.SHRINK
                else:
                    given, self._found = True, rates
                    newton_windows += 1
                continue
            failure = self._check()
            if failure is not None:
                self._go_back(failure)
                continue
            if status == window_loop.FINISHED:
                reason = ""
                break
            if status == window_loop.TOO_SHORT:
                reason = (
                    "the windows became too short, as near a singularity or the end of a domain"
                )
                if max(abs(self._start), abs(self._end)) > 100 * abs(self._end - self._start):
                    reason += ", or for float64 to resolve t; let the time begin nearer to 0"
                if self._flow.energy is None:
                    reason += "; where the time switches a force, give such times as breakpoints"
                break
            if reason := self._too_many():
                break
            self._grow()
        count = self._count
        return March(
            edges=self._edges[: count + 1].copy(),
            states=self._states[: count + 1].copy(),
            readouts=self._readouts[:count].copy(),
            reached=self._origin + float(self._clock[0]),
            reason=reason,
            evaluations=int(self._counts[1]),
            newton_windows=newton_windows,
            compiled=self._flow.compiled,
            scale=self._sizes,
            seconds=time.perf_counter() - self._began,
            cpu_seconds=time.process_time() - self._cpu_began,
            seed=self._basis.seed,
            origin=self._origin,
            doubt=self._doubts[0] if self._doubts else "",
        )

    def _loop(self, room: int, given: bool) -> int:
        return self._flow.loop(
            self._flow.rates,
            *self._basis.tables,
            np.array(self._stops),
            self._tolerance,
            self._floors,
            self._signs,
            self._shortest,
            self._longest,
            given,
            self._found,
            self._clock,
            self._counts,
            self._sizes,
            self._tail,
            self._edges[: room + 1],
            self._states[: room + 1],
            self._readouts[:room],
        )

    # -- going on ------------------------------------------------------------------------------

    def _too_many(self) -> str:
        """Why there will be more windows than allowed, if that is clear, or ""."""
        count, done = self._count, abs(float(self._clock[0]) - self._start)
        if not done > 0:
            return ""
        needed = count * abs(self._end - self._start) / done
        if count >= self._max_windows or (count >= _SURE and needed > 10 * self._max_windows):
            return f"the span needs about {needed:.0e} windows, more than {self._max_windows:,}"
        return ""

    def _grow(self) -> None:
        """Make room for more windows, with compiled code where that saves more than it costs."""
        count = self._count
        if count == len(self._readouts):
            room = min(2 * count, self._max_windows) - count
            self._edges, self._states, self._readouts = (
                np.concatenate((array, np.empty((room, *array.shape[1:]))))
                for array in (self._edges, self._states, self._readouts)
            )
        spent, done = time.perf_counter() - self._began, abs(self._clock[0] - self._start)
        left = abs(self._end - self._start) / done - 1
        if self._flow.compile and spent * left > compiled_loop.cost():
            self._flow = self._flow.compile()
        self._widen_floors()

    def _widen_floors(self) -> None:
        """Sizes that components have at least, from what the others do to them."""
        count = self._count
        places = np.unique(np.linspace(0, count, min(count + 1, 8)).astype(int))
        z, t = self._states[places], self._edges[places]
        coupling = np.abs(self._flow.jacobian(z, t)).mean(axis=0)
        coupled = coupled_sizes(self._sizes, coupling, abs(self._end - self._start))
        self._floors = np.maximum(self._floors, SMALLEST * coupled)

    # -- checking ------------------------------------------------------------------------------

    def _check(self) -> Failure | None:
        """Check the windows since the last check."""
        first, count = self._checked, self._count
        if count == first or len(self._doubts) >= _DOUBTS:
            self._checked = count
            return None
        part = Windows(
            self._edges[first : count + 1],
            self._states[first : count + 1],
            self._readouts[first:count],
        )
        failure = self._checks.first_failure(part, np.maximum(self._sizes, self._floors))
        if failure is None:
            self._checked, self._chunk = count, min(2 * self._chunk, _CHUNKS[1])
            return None
        self._checked, self._chunk = first + failure.window, _CHUNKS[0]
        return failure._replace(window=first + failure.window)

    def _go_back(self, failure: Failure) -> None:
        """Return to the start of a window with stops at what is in it."""
        window, direction = failure.window, self._direction
        start, end = (float(edge) for edge in self._edges[window : window + 2])
        if self._furthest is None or direction * end > direction * self._furthest:
            self._furthest, self._returns = end, 0
        self._returns += 1
        if self._returns > _RETURNS or abs(end - start) < 100 * self._shortest:
            # As at a jump: the march goes on, but is no success.
            self._doubts.append(
                f"near t = {self._origin + failure.times[0]:.6g}, between the points of "
                f"collocation, {failure.cause} changes by {failure.excess:.0e} times what the "
                "tolerance allows, in windows of any length"
            )
            self._checked = window + 1
            return
        self._counts[0], self._clock[0] = window, start
        for t in failure.times:
            nearest = min(abs(t - stop) for stop in (*self._stops, start, end))
            if nearest > 10 * self._shortest:
                self._stops.append(t)
        self._stops.sort(key=lambda stop: direction * stop)
        self._counts[2] = sum(direction * stop <= direction * start for stop in self._stops)
        self._clock[1] = abs(end - start) / 2
        if window:
            h = start - self._edges[window - 1]
            _, rates = self._basis.columns(self._basis.nodes[-window_loop.TAIL :])
            last = rates @ self._readouts[window - 1] / h
            self._tail[:] = self._basis.tables[-1] @ last
        else:
            self._tail[:] = 0
            self._tail[0] = self._rate[0]


def newton(
    flow: Flow,
    basis: FeatureBasis,
    z: np.ndarray,
    start: float,
    length: float,
    tolerance: float,
    sizes: np.ndarray,
) -> tuple[np.ndarray | None, int]:
    """F at the nodes of one window by Newton's method from the constant state, and evaluations.

    None in place of F where it does not converge. ``length`` has the sign of the direction of time.
    """
    times, integration = start + length * basis.nodes, length * basis.integration
    count, dim = len(times), len(z)
    enough = max(0.01 * tolerance, 4e-16)
    Z, rates = np.tile(z, (count, 1)), np.empty((count, dim))
    last = math.inf
    for step in range(1, _NEWTON_ITERATIONS + 1):
        flow.rates(Z, times, rates)
        defect = z + integration @ rates - Z
        matrix = np.eye(count * dim) - np.einsum(
            "kl,lij->kilj", integration, flow.jacobian(Z, times)
        ).reshape(count * dim, count * dim)
        try:
            correction = np.linalg.solve(matrix, defect.ravel()).reshape(count, dim)
        except np.linalg.LinAlgError:
            return None, step
        Z = Z + correction
        scale = np.maximum(np.maximum(sizes, np.abs(Z).max(axis=0)), window_loop.TINY)
        change = float((np.abs(correction) / scale).max())
        if change <= enough or (change < 1e-11 and change >= last):
            flow.rates(Z, times, rates)
            return rates, step + 1
        if not change < 1e6:
            return None, step
        last = change
    return None, _NEWTON_ITERATIONS


@functools.lru_cache(maxsize=64)
def _signs(basis: FeatureBasis, dim: int) -> np.ndarray:
    generator = np.random.default_rng(basis.seed)
    return generator.choice((-1.0, 1.0), size=(len(basis.between), dim))


def _origin(flow: Flow, span: tuple[float, float]) -> float:
    """Where to count the time from: near times far from zero float64 resolves no short windows."""
    start, end = span
    # By Sterbenz's lemma all differences to the start are exact then.
    exact = start != 0 and 0.5 <= end / start <= 2
    return start if flow.energy is not None and exact else 0.0


def _first_length(sizes: np.ndarray, rate: np.ndarray, span: float) -> float:
    """A tenth of the shortest time in which a component would change by its size."""
    speeds = np.abs(rate)
    known = (sizes > 0) & (speeds > 0)
    return min(span, 0.1 * float((sizes[known] / speeds[known]).min(initial=math.inf)))
