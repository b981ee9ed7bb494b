"""Trajectories of a manifold: their starts, where they end, and those inserted between neighbours.

Starts lie on strands, curves in the fundamental domain of the local manifold: a ring of directions
about an equilibrium, or phases on each side of an orbit. Neighbours on a strand are compared at
equal times.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from hamsym.families.many import solve_many
from hamsym.families.solutions import Solutions
from hamsym.invariant_manifolds.origins import Departure
from hamsym.numerics.collocation import collocation
from hamsym.random_features.flow import flow_of

_ROUNDS, _MOST = 6, 4  # of insertions, and times the trajectories of the first round
_COMPARED = 200  # times at which neighbours are compared
_POINTS = 8  # of a window, along a trajectory
_NODES = 10  # between two of these, for arc lengths
_PHASES = 4  # trajectories for each start of a ring, about an orbit
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, eq=False)
class Starts:
    """Starts in the order of strands, and of places along each, from 0 to 1."""

    leaving: Departure
    strands: np.ndarray
    places: np.ndarray

    @staticmethod
    def first(leaving: Departure, count: int) -> Starts:
        """The starts before insertions, about as many on each strand as a count."""
        even = np.arange(count) / count
        if _is_ring(leaving):
            return Starts(leaving, np.zeros(count, int), even)
        if leaving.local.dimension > 1:  # each one is a strand
            number = count * (1 if leaving.period is None else _PHASES)
            return Starts(leaving, np.arange(number), np.zeros(number))
        if leaving.period is None:
            return Starts(leaving, np.array([0, 1]), np.zeros(2))
        sides = 1 if _is_twisted(leaving) else 2
        return Starts(leaving, np.repeat(np.arange(sides), count), np.tile(even, sides))

    @property
    def closed(self) -> bool:
        """Whether the last start of a strand is a neighbour of the first."""
        return _is_ring(self.leaving)

    @property
    def directions(self) -> np.ndarray:
        """Real coordinates of length 1, shape (n, k)."""
        dimension = self.leaving.local.dimension
        if _is_ring(self.leaving):
            angles = 2 * np.pi * self.places
            return np.stack([np.cos(angles), np.sin(angles)], axis=1)
        if dimension == 1:
            return np.where(self.strands == 0, 1.0, -1.0)[:, None]
        random = np.random.default_rng(0).normal(size=(len(self.strands), dimension))
        return np.asarray(random / np.linalg.norm(random, axis=1, keepdims=True))

    @property
    def phases(self) -> np.ndarray:
        """Phases along an orbit, shape (n,)."""
        if self.leaving.period is None:
            return np.zeros(len(self.places))
        if self.leaving.local.dimension > 1:
            return np.asarray((_GOLDEN * self.strands) % 1.0)
        return self.places * (2 if _is_twisted(self.leaving) else 1)

    def neighbours(self) -> np.ndarray:
        """Pairs of neighbours, shape (m, 2)."""
        n = len(self.places)
        pairs = np.stack([np.arange(n), np.arange(1, n + 1)], axis=1)
        if self.closed:
            pairs[-1, 1] = 0
            return pairs
        return pairs[:-1][self.strands[1:] == self.strands[:-1]]

    def between(self, pairs: np.ndarray) -> Starts:
        """Further starts, in the middle between pairs of neighbours."""
        low, high = self.places[pairs[:, 0]], self.places[pairs[:, 1]]
        middle = (low + np.where(high <= low, high + 1, high)) / 2
        return Starts(self.leaving, self.strands[pairs[:, 0]], middle)

    def with_further(self, other: Starts) -> tuple[Starts, np.ndarray]:
        """All starts of both in order, and their numbers in both, those of the other last."""
        strands = np.concatenate([self.strands, other.strands])
        places = np.concatenate([self.places, other.places])
        order = np.lexsort((places, strands))
        return Starts(self.leaving, strands[order], places[order]), order

    def planned(self, elapsed: float) -> np.ndarray:
        """Times at which trajectories end, a while after they left the local manifold."""
        leaving = self.leaving
        return leaving.start + leaving.sign * (self.phases * (leaving.period or 0.0) + elapsed)

    def solved(self, elapsed: float, tol: float) -> Solutions:
        """The trajectories away from the origin, over the longest time of any."""
        leaving = self.leaving
        longest = elapsed + (leaving.period or 0.0) * (2 if _is_twisted(leaving) else 1)
        span = leaving.start, leaving.start + leaving.sign * longest
        states = leaving.states(self.directions, self.phases)
        least = self.least(tol).tolist()
        return solve_many(leaving.H, states, span, tol=tol, atol=least, progress=False)

    def least(self, tol: float) -> np.ndarray:
        """Absolute tolerances: of the sizes of the components on the local manifold."""
        return tol * self.leaving.local.scale


def _is_ring(leaving: Departure) -> bool:
    return leaving.local.dimension == 2 and leaving.period is None


def _is_twisted(leaving: Departure) -> bool:
    return bool(leaving.rates[0].real < 0)


@dataclass(frozen=True, eq=False)
class Growth:
    """Trajectories and where they end."""

    starts: Starts
    many: Solutions
    #: Times, shape (n,).
    ends: np.ndarray
    #: Whether it has the length that was asked for.
    long: np.ndarray
    #: Whether it is not accurate until its end.
    failed: np.ndarray
    #: Largest distance of neighbours relative to the extent.
    gap: float


def grow(
    starts: Starts, elapsed: float, length: float | None, spacing: float, tol: float
) -> Growth:
    """Solve from the starts, and from further ones between neighbours that part."""
    many, first = starts.solved(elapsed, tol), starts
    room, samples = _MOST * len(starts.places), _Samples.of(starts, many, elapsed, tol)
    for _ in range(_ROUNDS):
        pairs, gaps = _gaps(starts, samples)
        # Beside a trajectory that ends early, as at a collision, more of them would, too.
        wide = np.flatnonzero((gaps > spacing) & ~samples.failed[pairs].any(axis=1))
        wide = wide[np.argsort(-gaps[wide], kind="stable")][: room - len(starts.places)]
        if not len(wide):
            break
        further = starts.between(pairs[wide])
        starts, order = starts.with_further(further)
        more = _Samples.of(further, further.solved(elapsed, tol), elapsed, tol)
        samples = samples.with_further(more, order)
    if starts is not first:  # all in one, in their order
        many = starts.solved(elapsed, tol)
    ends, long = samples.ends.copy(), np.zeros(len(starts.places), bool)
    if length is not None:
        for k, end in enumerate(ends.tolist()):
            found = _end_at(many, k, end, length)
            if found is not None:
                ends[k], long[k] = found, True
    gap = float(_gaps(starts, samples)[1].max(initial=0.0))
    return Growth(starts, many, ends, long, samples.failed & ~long, gap)


@dataclass(frozen=True, eq=False)
class _Samples:
    """States of trajectories at equal times, nan after their ends."""

    states: np.ndarray
    ends: np.ndarray
    failed: np.ndarray

    @staticmethod
    def of(starts: Starts, many: Solutions, elapsed: float, tol: float) -> _Samples:
        sign = starts.leaving.sign
        ends, failed = starts.planned(elapsed), np.zeros(len(starts.places), bool)
        for k in np.flatnonzero(~many.success).tolist():
            last = _accurate_until(many, k, tol, starts.least(tol))
            if not sign * last >= sign * ends[k]:
                ends[k], failed[k] = last, True
        times = np.linspace(*many.span, _COMPARED)
        states = many(times)
        states[sign * times > sign * ends[:, None]] = np.nan
        return _Samples(states, ends, failed)

    def with_further(self, other: _Samples, order: np.ndarray) -> _Samples:
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return _Samples(*(np.concatenate(pair)[order] for pair in pairs))


def _accurate_until(many: Solutions, k: int, tol: float, least: np.ndarray) -> float:
    """The last time until which the estimated error of a failed member is within the tolerance."""
    if not many.table.counts[many.members[k]]:
        return many.span[0]
    solution = many[k]
    times = np.asarray(solution.scan_times)
    with np.errstate(all="ignore"):
        errors = np.abs(solution.error_estimate(times))
        sizes = np.maximum.accumulate(np.abs(solution(times)), axis=0)
        good = (errors <= tol * sizes + least).all(axis=1) & np.isfinite(sizes).all(axis=1)
    good |= np.arange(len(times)) == 0
    return float(times[-1] if good.all() else times[int(np.argmin(good)) - 1])


def _gaps(starts: Starts, samples: _Samples) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of neighbours, and their largest distances relative to the extent."""
    pairs, states = starts.neighbours(), samples.states
    known = states[np.isfinite(states).all(axis=-1)]
    if not (len(pairs) and len(known)):
        return pairs, np.zeros(len(pairs))
    extents = np.ptp(known, axis=0)
    apart = np.abs(states[pairs[:, 0]] - states[pairs[:, 1]]) / np.where(extents > 0, extents, 1.0)
    return pairs, np.nan_to_num(apart, nan=0.0).max(axis=(1, 2))


def path(many: Solutions, k: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and states of a member up to an end, at points that resolve its windows."""
    member = int(many.members[k])
    own = many.table.packed(many.windows, member, member + 1)
    edges = np.asarray(own.edges) + many.family.origin
    if len(edges) < 2:
        return np.array([many.span[0]]), many.z0[k : k + 1]
    inner = edges[:-1, None] + np.diff(edges)[:, None] * np.arange(_POINTS) / _POINTS
    times = np.append(inner.ravel(), edges[-1])
    sign = 1 if many.span[1] > many.span[0] else -1
    times = np.append(times[sign * times < sign * end], end)
    low, high = sorted(many.span)
    times = np.clip(times, low, high)
    return times, many[[k]](times)[0]


def arc_length(many: Solutions, k: int, end: float) -> float:
    """Arc length of a member up to an end."""
    times, rates = _speeds(many, k, end)
    return float(np.abs(np.diff(times)) @ rates @ collocation(_NODES).integration[-1])


def _speeds(many: Solutions, k: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Times of a member up to an end, and |dz/dt| at the nodes between them, (n,), (n - 1, m)."""
    times, _ = path(many, k, end)
    nodes = (times[:-1, None] + np.diff(times)[:, None] * collocation(_NODES).nodes).ravel()
    rates = flow_of(many.H).vector_field(many[[k]](nodes)[0], nodes)
    return times, np.linalg.norm(rates, axis=1).reshape(-1, _NODES)


def _end_at(many: Solutions, k: int, end: float, length: float) -> float | None:
    """The time up to which a member has an arc length, or None if it is not before an end."""
    rule = collocation(_NODES)
    times, rates = _speeds(many, k, end)
    steps = np.diff(times)
    along = np.cumsum(np.abs(steps) * (rates @ rule.integration[-1]))
    if not (len(along) and along[-1] >= length):
        return None
    piece = int(np.argmax(along >= length))
    inside = np.abs(steps[piece]) * (rule.integration[:-1] @ rates[piece])
    rest = length - (along[piece - 1] if piece else 0.0)

    def excess(share: float) -> float:
        return float((rule.interpolation(np.array([share])) @ inside)[0]) - rest

    crossed = excess(0.0) < 0 < excess(1.0)
    share = brentq(excess, 0.0, 1.0) if crossed else float(excess(0.0) < 0)
    return float(times[piece] + share * steps[piece])
