"""Solution of any number of initial-value problems of one Hamiltonian, each by itself.

:func:`hamsym.solve` has one member, :func:`hamsym.solve_many` and :func:`hamsym.fit` have many; all
stand on it.

Input:  a Hamiltonian, initial states and parameter values, a span, a tolerance.
Output: :class:`Batch`, the windows of all members that pass every check.

What the loop over members (:func:`hamsym.kernel.loops.solve_members`) does not accept is left to
:func:`hamsym.random_features.method.solve_by_march`, which treats one member at a time.
"""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.kernel import loops
from hamsym.kernel.loops import Members, Shared, Span
from hamsym.problems.problem import checked_atol, checked_tol, checked_window
from hamsym.random_features.basis import FeatureBasis, feature_basis
from hamsym.random_features.error_estimate import (
    ACCURACY,
    FEWEST,
    MarchError,
    disturbances,
    error_tables,
    kicks,
    rows_of_signs,
    terms_of,
)
from hamsym.random_features.features import FEWEST_WINDOWS
from hamsym.random_features.flow import Flow, flow_of
from hamsym.random_features.march import MAX_WINDOWS, node_signs, origin_of, shortest_window
from hamsym.random_features.window_checks import HIDDEN, Pieces, WindowChecks, bound_tables
from hamsym.random_features.windows import March
from hamsym.solution.discontinuities import has_switches, has_time_switches
from hamsym.solution.window_error import allowed_errors, relative_tolerance

# Of the local tolerance from one march to the next: share of the allowed error at which it aims,
# and limits of the step; below the smallest one residuals are round-off.
MARGIN, LEAST_STEP, MOST_STEP, SMALLEST = 0.3, 1e-4, 0.3, 1e-13
_SMALL_BASIS = 1e-10  # tolerance from which the small basis takes less time
# Local tolerance of the first march, relative to the tolerance, and at most: longer windows take as
# many evaluations each, and errors that grow need a second march.
_LOCAL, _MOST_LOCAL = 0.1, 1e-8
TIGHTER = 3.0  # least excess that marked windows count as
_ROOM = 64  # windows for each member at first
_LEAST_ROOM = 1_024  # windows of one call
_MOST_ROOM = 2**21  # numbers in the readouts of one call
_MOST_WINDOWS = 50_000  # of one member; more are left to the general march
#: Memory of solutions of one member, by dimension, columns and places, for the next ones: to
#: allocate it takes a tenth of a short march. So many are kept, for so many components at most.
_SPARE: dict[tuple[int, int, int], Members] = {}
_MOST_SPARE, _MOST_COMPONENTS = 4, 32


@dataclass(frozen=True)
class Accuracy:
    """Checked accuracy of a march."""

    #: tol, local: Tolerance, and local tolerance of the first march.
    tol: float
    local: float
    #: Absolute tolerance, shape (dim,).
    absolute: np.ndarray
    #: Longest window.
    longest: float

    def allowed(self, sizes: np.ndarray) -> np.ndarray:
        """Return the allowed error of components of these computed sizes, shape (dim,)."""
        return allowed_errors(self.tol, self.absolute, sizes)


def checked_accuracy(
    tol: float, atol: Any, max_window: float | None, span: tuple[float, float], dim: int
) -> Accuracy:
    """Check the accuracy of a march and its longest window.

    Raise InputError if a value cannot be used.
    """
    tol, absolute = checked_tol(tol), checked_atol(atol, dim)
    return Accuracy(
        tol,
        # The cost grows as a root of the accuracy: a margin is cheaper than a second march.
        min(max(_LOCAL * tol, SMALLEST), _MOST_LOCAL),
        np.array(absolute * dim if len(absolute) == 1 else absolute),
        checked_window(max_window, span, abs(span[1] - span[0]) / FEWEST_WINDOWS, MAX_WINDOWS),
    )


def basis_for(seed: int, tol: float) -> FeatureBasis:
    """Return the basis that reaches a tolerance in the least time."""
    return feature_basis(seed, 16 if tol >= _SMALL_BASIS else 24)


@dataclass(frozen=True)
class Batch:
    """Windows of consecutive members."""

    #: Whether the member passed every check, shape (members,). The others have no windows.
    accepted: np.ndarray
    #: counts, evaluations: Windows, and evaluations of the vector field, shape (members,).
    counts: np.ndarray
    evaluations: np.ndarray
    #: Largest ratio of the estimated to the allowed error, shape (members,).
    excess: np.ndarray
    #: largest, sizes: Largest estimated error, and largest magnitude of each component, shape
    #: (members, dim).
    largest: np.ndarray
    sizes: np.ndarray
    #: edges, states, readouts: Of all windows: those of a member follow those of the members before
    #: it. A member with n windows has n + 1 edges and states; one without windows has none.
    edges: np.ndarray
    states: np.ndarray
    readouts: np.ndarray


class Solved(NamedTuple):
    """One member that passed every check."""

    march: March
    error: MarchError
    #: Largest ratio of the estimated to the allowed error.
    excess: float


class MemberSolver:
    """Solver of members of one Hamiltonian over one span.

    - H: With a value for every parameter; members may have others.
    """

    def __init__(
        self, H: Hamiltonian, span: tuple[float, float], accuracy: Accuracy, basis: FeatureBasis
    ) -> None:
        self.H, self.basis, self.origin = H, basis, origin_of(H.time is None, span)
        start, end = (time - self.origin for time in span)
        self._flow, self._local = flow_of(H), accuracy.local
        self._shared = _shared(self._flow, basis, accuracy.local)
        self._span = Span(
            start=start,
            end=end,
            tolerance=relative_tolerance(accuracy.tol),
            longest=accuracy.longest,
            shortest=shortest_window(start, end),
            absolute=accuracy.absolute,
        )
        self._room = _ROOM
        self._places = self._shared.arrays["error_tables"].places

    @staticmethod
    def applies(H: Hamiltonian) -> bool:
        """Return whether H has no switches: those in time end windows, others need a search."""
        return not (has_switches(H) or has_time_switches(H))

    def solve(self, states: np.ndarray, parameters: np.ndarray) -> Batch:
        """Solve members from states of shape (members, dim) with parameters (members, k)."""
        first, parts = 0, []
        room = max(_LEAST_ROOM, min(self._room * len(states), _MOST_ROOM // states.shape[1]))
        states, parameters = (np.ascontiguousarray(array) for array in (states, parameters))
        while first < len(states):
            rest = states[first:], parameters[first:]
            members = self._allocated(len(rest[0]), room)
            done = loops.solve_members(self._shared, self._span, *rest, members)
            if done == 0:  # one member does not fit
                if room > _MOST_WINDOWS:
                    members["count"][0], members["verdict"][0] = 0, loops.LEFT
                    members["excess"][0], members["evaluations"][0] = np.inf, 0
                    done = 1
                else:
                    room *= 4
                    continue
            parts.append(self._checked(members, done, *rest))
            first += done
        total = sum(int(part.counts.sum()) for part in parts)
        self._room = max(self._room, 1 + total // len(states))
        if len(parts) == 1:
            return parts[0]
        names = Batch.__dataclass_fields__
        return Batch(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    def solve_one(self, z0: np.ndarray, parameters: np.ndarray) -> Solved | None:
        """Solve one member, with its error; return None if it does not pass every check."""
        wall, cpu = time.perf_counter(), time.thread_time()
        room, key = _LEAST_ROOM, (self.H.dim, self.basis.series.shape[1], self._places)
        members = _SPARE.pop(key, None) or self._allocated(1, room, keep_error=True)
        while not loops.solve_members(self._shared, self._span, z0, parameters, members):
            if room > _MOST_WINDOWS:
                return None
            room *= 4
            members = self._allocated(1, room, keep_error=True)
        count = members["count"]
        windows = int(count[0])
        if not windows or len(self._exceeding(members, count, windows, parameters[None])):
            return None
        edges, states = (members[name][: windows + 1].copy() for name in ("edge", "state"))
        readouts, series, floors = (
            members[name][:windows].copy() for name in ("coefficient", "series", "floor")
        )
        sizes, largest = (members[name][0].copy() for name in ("size", "largest"))
        evaluations, excess = int(members["evaluations"][0]), float(members["excess"][0])
        if room == _LEAST_ROOM and self.H.dim <= _MOST_COMPONENTS:
            if len(_SPARE) >= _MOST_SPARE:
                _SPARE.clear()
            _SPARE[key] = members
        march = March(
            edges=edges,
            states=states,
            readouts=readouts,
            reached=self.origin + float(edges[-1]),
            evaluations=evaluations,
            scale=sizes,
            seconds=time.perf_counter() - wall,
            cpu_seconds=time.thread_time() - cpu,
            seed=self.basis.seed,
            origin=self.origin,
        )
        origin = np.array(self.origin)
        return Solved(march, MarchError(edges, series, floors, largest, sizes, origin), excess)

    def _allocated(self, count: int, room: int, keep_error: bool = False) -> Members:
        dim, columns = self.H.dim, self.basis.series.shape[1]
        more = {}
        if keep_error:
            more["series"] = np.empty((room, self._places, dim))
            more["floor"] = np.empty((room, dim))
        return Members(
            members=count,
            room=room,
            readout=columns,
            count=np.zeros(count, dtype=np.int64),
            verdict=np.zeros(count, dtype=np.int64),
            evaluations=np.zeros(count, dtype=np.int64),
            excess=np.empty(count),
            largest=np.empty((count, dim)),
            size=np.empty((count, dim)),
            edge=np.empty(room + count + 1),
            state=np.empty((room + count + 1, dim)),
            coefficient=np.empty((room, columns, dim)),
            mark=np.zeros(room, dtype=np.int64),
            **more,
        )

    def _checked(
        self, members: Members, done: int, states: np.ndarray, parameters: np.ndarray
    ) -> Batch:
        """Return the first ``done`` members, after the check between the points of the march."""
        counts, verdicts = members["count"][:done], members["verdict"][:done]
        total = int(counts.sum())
        verdicts[self._exceeding(members, counts, total, parameters)] = loops.LEFT
        accepted = verdicts != loops.LEFT
        kept: Any = slice(None)
        rows: Any = kept
        final = np.where(accepted, counts, 0)
        if not accepted.all():
            kept, rows = np.repeat(accepted, counts), np.repeat(final > 0, counts + 1)
        return Batch(
            accepted=accepted,
            counts=final,
            evaluations=members["evaluations"][:done],
            excess=members["excess"][:done],
            largest=members["largest"][:done],
            sizes=members["size"][:done],
            edges=members["edge"][: total + done][rows].copy(),
            states=members["state"][: total + done][rows].copy(),
            readouts=members["coefficient"][:total][kept].copy(),
        )

    def _exceeding(
        self, members: Members, counts: np.ndarray, total: int, parameters: np.ndarray
    ) -> np.ndarray:
        """Return the members with windows that the loop did not bound, and a search refuses."""
        (left,) = (members["mark"][:total] & loops.UNBOUNDED).nonzero()
        if not len(left):
            return left
        owner = np.repeat(np.arange(len(counts)), counts)[left]
        edge = left + owner  # there is one edge more for every member, also for one without windows
        pieces = Pieces(
            members["edge"][edge],
            members["edge"][edge + 1],
            members["state"][edge],
            members["coefficient"][left],
        )
        checks = WindowChecks(self._flow, self.basis, self._local)
        with np.errstate(all="ignore"):
            given = pieces, members["size"][owner], parameters[owner]
            refused = np.zeros(len(left), dtype=bool)
            refused[[excess.window for excess in checks.exceeding(*given)]] = True
            # The estimate of the library leaves out what its places do not show.
            hidden, _ = checks.hidden(*given, self._places)
            refused |= ~(hidden <= HIDDEN).all(axis=1)
        return np.unique(owner[refused])


@functools.lru_cache(maxsize=64)
def _shared(flow: Flow, basis: FeatureBasis, local: float) -> Shared:
    """Return what the members of one H share."""
    tables, dim = error_tables(basis), flow.programs.dim
    signs, kicked = node_signs(basis, dim), kicks(tables.perturbations, dim)
    return Shared(
        equations=flow.programs,
        tables=basis.tables,
        error_tables=tables,
        actions=terms_of(flow),
        bounds=None if flow.is_short_polynomial else bound_tables(basis, local),
        width=signs.shape[1],
        period=len(kicked),
        sign=signs,
        disturbance=disturbances(tables.places, rows_of_signs(flow)),
        kick=kicked,
        local=local,
        margin=MARGIN,
        least_step=LEAST_STEP,
        most_step=MOST_STEP,
        smallest=SMALLEST,
        tighter=TIGHTER,
        accuracy=ACCURACY,
        fewest=FEWEST,
    )
