"""Checks of windows between the times that the march used.

1. *Residual.* The march judges a window by its residual at fixed places; here the residual is
   bounded on the whole window (:mod:`hamsym.bounds.residual`). What is narrower than the distance
   of the places, for example a pulse of the force, is found whatever its width and its place.
2. *Energy.* Where H does not depend on time, it may change over a window by no more than the local
   error that the tolerance allows. A step of the potential changes it without a force.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hamsym.bounds.discs import decade_of, disc_tables
from hamsym.bounds.models import DEGREE, NODES, PLACES, bounded, model_tables
from hamsym.bounds.residual import (
    ROUND_OFF,
    SHARE,
    Excess,
    ExcessSearch,
    Parts,
    Places,
    bounds_on_parts,
    largest_ratios,
)
from hamsym.kernel import loops
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import ratios
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.flow import Flow
from hamsym.random_features.windows import Windows

SLACK = 10.0  # times the residual that the march allows at its own places
_ROUND_OFF_OF_TERMS = 4 * 2.0**-52  # of H, relative to its terms
_NOISE = 8.0  # times the typical change of the rates for one unit in the last place of the states
# Distance of places from the ends of their window, as in the march: units in the last place of the
# time at least, and at most where that is a small share of the window.
_LEAST_INSIDE, _INSIDE, _SMALL_INSIDE = 1.0, 4.0, 1e-6
_NODES, _BISECTIONS = 32, 40  # of the search for the place at which H changes
#: Share of the limit of the residual that the estimated error may leave out.
HIDDEN = 1e-3
# Of what it leaves out: width of parts from which it counts; wider ones are smooth, and the error
# has room for that. Halvings and parts until it is small.
_NARROW = 1 / 8
_ULPS = 32 * 2.0**-52  # of the time, below which a part is not divided
_GENERATIONS, _MOST_PARTS = 40, 1024


class Failure(NamedTuple):
    """The first window that failed: suspicious times, the excess over the limit, and its cause."""

    window: int
    times: list[float]
    excess: float
    cause: str


class Pieces(NamedTuple):
    """Windows that need not follow each other."""

    #: start, end: Shape (windows,).
    start: np.ndarray
    end: np.ndarray
    #: At the starts, shape (windows, dim).
    states: np.ndarray
    #: Shape (windows, columns, dim).
    readouts: np.ndarray


@dataclass
class WindowChecks:
    """The checks of one march."""

    flow: Flow
    basis: FeatureBasis
    #: Local tolerance of the march.
    tolerance: float

    def first_failure(self, windows: Windows, sizes: np.ndarray) -> Failure | None:
        """Check windows with components of these sizes; return None if all pass."""
        pieces, failure = pieces_of(windows), None
        left = self._unbounded(pieces, sizes)
        if len(left):
            own = sizes if sizes.ndim == 1 else sizes[left]
            some = Pieces(*(array[left] for array in pieces))
            found = self.exceeding(some, own, self.flow.parameters, first_only=True)
            if found:
                first = found[0]
                window = int(left[first.window])
                failure = Failure(window, [first.time], first.ratio, "the residual")
        if self.flow.energy is not None:
            changes = self._energy_changes(windows, sizes)
            jumps = np.flatnonzero(~(changes[: failure.window if failure else None] <= 1))
            if len(jumps):
                window = int(jumps[0])
                times = [self._energy_jump(windows, window)]
                return Failure(window, times, float(changes[window]), "H")
        return failure

    def exceeding(
        self,
        pieces: Pieces,
        sizes: np.ndarray,
        given: np.ndarray,
        *,
        first_only: bool = False,
    ) -> list[Excess]:
        """Search windows, by halves, for those whose residual is larger between the points.

        - sizes, given: Sizes of components and values of parameters, for all or for each window.
        - first_only: Whether to search for the first of them only.
        """
        limits = self._limits(pieces, sizes)

        def rates(z: np.ndarray, t: np.ndarray, window: np.ndarray) -> np.ndarray:
            return self.flow.vector_field(z, t, given if given.ndim == 1 else given[window])

        def trial(parts: Parts) -> Places:
            return self._at(pieces, parts, NODES)

        search = ExcessSearch(
            *(self.flow.programs, rates, trial, np.stack((pieces.start, pieces.end))),
            *(limits, given, SLACK * _NOISE, first_only),
        )
        return search.run()

    def kicks(self, windows: Windows, sizes: np.ndarray, count: int) -> np.ndarray | None:
        """Bound what the estimated error leaves out of the residual; None where that is small.

        - count: Places at which it has the residual.
        - returns: Integrals over the windows, shape (windows, dim).
        """
        pieces, given = pieces_of(windows), self.flow.parameters
        left = self._unbounded(pieces, sizes)
        if not len(left):
            return None
        shares, limits = self.hidden(Pieces(*(part[left] for part in pieces)), sizes, given, count)
        if (shares <= HIDDEN).all():
            return None
        found = np.zeros((len(pieces.start), self.flow.programs.dim))
        found[left] = shares * limits
        return found

    def hidden(
        self, pieces: Pieces, sizes: np.ndarray, given: np.ndarray, count: int
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bound what values of the residual at few places leave out, integrated over windows.

        A window is halved until that is seen at the places of its parts, as a narrow pulse is, or
        is small.

        - sizes, given: As of :meth:`exceeding`.
        - count: Places that are known, of the estimated error.
        - returns: In units of the limits of :meth:`exceeding`, and these, shapes (windows, dim).
        """
        rule, limits = collocation(count), self._limits(pieces, sizes)
        parts, found, missed = Parts.whole(len(limits)), *np.zeros((2, *limits.shape))
        weights, sums = collocation(PLACES).integration[-1], []
        _, known = self._residuals(pieces, parts, 2 * rule.nodes - 1, given)
        edges = np.stack((pieces.start, pieces.end))
        lengths, shortest = np.abs(edges[1] - edges[0]), _ULPS * np.abs(edges).max(axis=0)
        with np.errstate(all="ignore"):  # what has no bound is infinite or NaN
            for generation in range(_GENERATIONS):
                at, residual = self._residuals(pieces, parts, NODES, given)
                bounds, between, _ = bounds_on_parts(self.flow.programs, at, edges, parts, given)
                between = np.fmin(between, bounds + np.abs(residual).max(axis=1))
                shown = rule.interpolated(known[parts.window], parts.places(NODES))
                long = (lengths[parts.window] * parts.width)[:, None]
                between = ratios(long * between, limits[parts.window])
                beside = long * (weights @ (residual - shown)) / limits[parts.window]
                beside = np.where(np.isfinite(beside), beside, 0.0)  # where there is no residual
                least = np.maximum(parts.width, SHARE)[:, None]
                small = HIDDEN * np.maximum(least, np.abs(beside))
                # At a kink that float64 does not divide there may be no bound.
                last = parts.width * lengths[parts.window] <= shortest[parts.window]
                between[last] = np.where(np.isfinite(between[last]), between[last], 0.0)
                done = last | (between <= small).all(axis=1)
                # Round-off of late times does not become less.
                finite = np.where(np.isfinite(between), between, 0.0).max(axis=1)
                sums.append(np.bincount(parts.window, finite, len(limits)))
                done |= ~(sums[-1] <= 0.5 * sums[-4])[parts.window] if len(sums) > 4 else False
                done |= generation == _GENERATIONS - 1 or len(parts) > _MOST_PARTS
                np.add.at(found, parts.window[done], between[done])
                narrow = done & (parts.width <= _NARROW)
                np.add.at(missed, parts.window[narrow], beside[narrow])
                parts = parts[~done].halves()
                if not len(parts):
                    break
        return found + np.abs(missed), limits

    def _unbounded(self, pieces: Pieces, sizes: np.ndarray) -> np.ndarray:
        """Return the windows that the bound on the whole of each does not accept."""
        if self.flow.is_short_polynomial:
            return np.empty(0, dtype=int)
        accepted = bounded(
            self.flow.programs,
            bound_tables(self.basis, self.tolerance),
            loops.Pieces(
                windows=len(pieces.start),
                readout=pieces.readouts.shape[1],
                size_stride=sizes.shape[1] if sizes.ndim == 2 else 0,
                parameter_stride=0,
                tolerance=self.tolerance,
                start=pieces.start,
                end=pieces.end,
                state=pieces.states,
                coefficient=pieces.readouts,
                size=sizes,
                parameters=self.flow.parameters,
            ),
        )
        return np.flatnonzero(~accepted)

    def _limits(self, pieces: Pieces, sizes: np.ndarray) -> np.ndarray:
        """Allowed integrals of the residual over windows, shape (windows, dim)."""
        lengths = np.abs(pieces.end - pieces.start)[:, None]
        largest = np.abs(self._at(pieces, Parts.whole(len(lengths)), NODES).rates).max(axis=1)
        return np.asarray(self.tolerance * sizes + ROUND_OFF * lengths * largest)

    def _residuals(
        self, pieces: Pieces, parts: Parts, x: np.ndarray, given: np.ndarray
    ) -> tuple[Places, np.ndarray]:
        """The trial solution and its residual at places in [-1, 1] of parts."""
        at = self._at(pieces, parts, x)
        window, shape = np.repeat(parts.window, len(x)), at.z.shape
        own = given if given.ndim == 1 else given[window]
        found = self.flow.vector_field(at.z.reshape(-1, shape[-1]), at.t.ravel(), own)
        return at, at.rates - found.reshape(shape)

    def _energy_changes(self, windows: Windows, sizes: np.ndarray) -> np.ndarray:
        """Return the change of H over each window, in units of the limit."""
        assert self.flow.energy is not None
        z, t = windows.states, windows.edges
        energies = self.flow.energy(z, t)
        # The gradient of H is the vector field with its halves exchanged, up to signs.
        half = z.shape[1] // 2
        slopes = np.abs(np.roll(self.flow.vector_field(z, t), half, axis=1))
        slopes = np.maximum(slopes[:-1], slopes[1:])
        size = np.maximum(np.abs(z[:-1]), np.abs(z[1:]))
        rounding = ROUND_OFF * (np.abs(energies[:-1]) + (slopes * size).sum(axis=1))
        allowed = self.tolerance * (slopes * sizes).sum(axis=1) + rounding
        changes = np.abs(np.diff(energies))[:, None]
        found = largest_ratios(changes, SLACK * allowed[:, None])
        if (found <= 1).all() or self.flow.switched:
            return found
        # The terms of H may cancel, as a rest energy does; where H is smooth that is no jump.
        terms = self.flow.energy_terms(z, t)
        allowed = allowed + _ROUND_OFF_OF_TERMS * np.maximum(terms[:-1], terms[1:])
        return largest_ratios(changes, SLACK * allowed[:, None])

    def _energy_jump(self, windows: Windows, index: int) -> float:
        """Locate the time in a window at which H changes fastest."""
        assert self.flow.energy is not None
        energy = self.flow.energy

        def values(s: np.ndarray) -> np.ndarray:
            parts = Parts(np.full(len(s), index), s, np.zeros(len(s)))
            z, _, t = self._at(pieces_of(windows), parts, np.array([-1.0]))
            return energy(z[:, 0], t[:, 0])

        s = np.concatenate(([0.0], collocation(_NODES).nodes, [1.0]))
        h = values(s)
        widest = int(np.argmax(np.nan_to_num(np.abs(np.diff(h)), nan=np.inf)))
        low, high, at_low, at_high = s[widest], s[widest + 1], h[widest], h[widest + 1]
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            at_middle = values(np.array([middle]))[0]
            if abs(at_middle - at_low) > abs(at_high - at_middle):
                high, at_high = middle, at_middle
            else:
                low, at_low = middle, at_middle
        start, end = windows.edges[index : index + 2]
        return float(start + (end - start) * (low + high) / 2)

    def _at(self, pieces: Pieces, parts: Parts, x: np.ndarray) -> Places:
        """Evaluate the trial solution at places in [-1, 1] of parts of windows."""
        start, end, states, readouts = (array[parts.window] for array in pieces)
        lengths = (end - start)[:, None]
        if (parts.width == 1).all():
            values, slopes = _columns(self.basis, x.tobytes())
            z, rates = values @ readouts, slopes @ readouts
        else:
            s = parts.places(x)
            columns = self.basis.columns(s.ravel())
            z, rates = (c.reshape(*s.shape, -1) @ readouts for c in columns)
        t = times_of(pieces, parts, x)
        return Places(states[:, None] + z, rates / lengths[..., None], t)


def pieces_of(windows: Windows) -> Pieces:
    """Return windows that follow each other as pieces."""
    edges, states, readouts = windows
    return Pieces(edges[:-1], edges[1:], states[:-1], readouts)


def places_of(
    function: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]],
    pieces: Pieces,
    parts: Parts,
    x: np.ndarray,
) -> Places:
    """Evaluate a function t -> (z^, dz^/dt) at places in [-1, 1] of parts of windows."""
    t = times_of(pieces, parts, x)
    z, rates = function(t.ravel())
    return Places(z.reshape(*t.shape, -1), rates.reshape(*t.shape, -1), t)


def times_of(pieces: Pieces, parts: Parts, x: np.ndarray) -> np.ndarray:
    """Return the times at places in [-1, 1] of parts of windows, shape (parts, places).

    They are inside the windows, as those of the march: at their ends a switch has neither value.
    """
    start, end = pieces.start[parts.window], pieces.end[parts.window]
    unit = np.finfo(float).eps * np.maximum(np.abs(start), np.abs(end))
    margin = np.minimum(_INSIDE * unit, _SMALL_INSIDE * np.abs(end - start))
    margin = np.maximum(_LEAST_INSIDE * unit, margin)
    low, high = np.minimum(start, end) + margin, np.maximum(start, end) - margin
    t = start[:, None] + (end - start)[:, None] * parts.places(x)
    return np.asarray(np.clip(t, low[:, None], high[:, None]))


def bound_tables(basis: FeatureBasis, tolerance: float) -> loops.BoundTables:
    """Return the tables of the bounds of windows for a local tolerance."""
    return _bound_tables(basis, decade_of(tolerance))


@functools.lru_cache(maxsize=64)
def _bound_tables(basis: FeatureBasis, decade: int) -> loops.BoundTables:
    columns = _columns(basis, NODES.tobytes())
    exact = np.longdouble  # multiplied in one order; BLAS has one for each processor
    values = basis.columns((NODES.astype(exact) + 1) / 2)[0]
    series = values.T @ collocation(PLACES).to_series[: DEGREE + 1].T.astype(exact)
    return loops.BoundTables(
        columns=len(series),
        models=model_tables(),
        around=disc_tables(DEGREE + 1, decade),
        places=(NODES + 1) / 2,
        values=columns[0].T,
        rates=columns[1].T,
        series=series.astype(float),
    )


@functools.lru_cache(maxsize=16)
def _columns(basis: FeatureBasis, places: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Return the columns and their derivatives at places in [-1, 1] of a whole window."""
    return basis.columns((np.frombuffer(places) + 1) / 2)
