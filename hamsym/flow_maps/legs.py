"""One leg of a flow map: the expansion of the solutions over one domain.

Stage 1  Solutions on lines through the domain: the pieces of the time, the degrees by direction,
         and from them the number of solutions that the expansion will need.
Stage 2  Solutions at the points of a lower set of degrees, enlarged where surpluses count and where
         the expansion differs from solutions at random points.
Stage 3  Series in time, truncation, and compression to the rank that is needed.

A leg ends early, or its domain is to be split, where its degrees would become too large.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from hamsym.families.solutions import Solutions
from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.flow_maps.domain import Domain, random_places
from hamsym.flow_maps.expansion import Leg, products, tables
from hamsym.numerics.collocation import collocation
from hamsym.numerics.lower_sets import (
    MOST_DEGREE,
    axis_degrees,
    chebyshev_coefficients,
    further_degrees,
    leja_points,
    margin,
    points,
    surpluses,
)

_TERMS = 12  # of the series in time of a piece
_LARGEST = 2_500  # terms of an expansion in the inputs: more make queries slow
_TIME = 0.03  # share of the allowed error for the series in time
_SURPLUS = 0.3  # share for a surplus
_TRUNCATION = 0.02  # share for what is left out
_RANDOM = 0.4  # share for the difference from a solution at a random point
_ROUNDS = 8  # comparisons with random points
_FEWEST_PIECES = 3  # of a leg after which another one is worthwhile
_LINE = {1: 65, 2: 49, 3: 41}  # solutions on a line through the domain, by dimension
_SHORT_LINE = 25
_DIAGONALS = 4
_SAMPLE = 48  # solutions by which the pieces of the time are chosen
_GROWTH = 1.4  # of the pieces
_SMALLEST_PIECE = 1e-7  # of the span
_WORTHWHILE = 0.4  # of a span that is twice the last leg
_SHORTEST = 1e-3  # of the span of a leg, before a solution fails
_MONITORS = 2  # times in each piece at which surpluses are computed
_PLACES = np.array([0.015, 0.145, 0.435, 0.715, 0.945, 0.995])  # at which a piece is compared
# Cost of a further leg relative to that of a leg. Images that depend on parameters are large.
_WITH_PARAMETERS = 8.0
_SPARE = 1.2  # times the largest number of terms, until a leg ends
_FEWEST_RANDOM = 32
_AT_END = 0.2  # probability that an input of a random point is an end of its interval
_BEFORE = 0.98  # of the time that a solution reached

Solve = Callable[[Domain, np.ndarray, tuple[float, float]], Solutions]


class FailedError(Exception):
    """A solution fails at the beginning of a leg."""


class _SplitError(Exception):
    """A solution from a part of an image fails too early."""


class LegBuilder:
    """Construction of one leg.

    Raise FailedError if a solution fails at the beginning.

    - span: From its start to the time at which it has to end at the latest.
    - solve: (domain, scaled inputs, span) -> Solutions.
    - allowed: Allowed error of each component, shape (dim,).
    - may_end: Whether the leg may end early because of its degrees.
    - note: Takes a text about the progress, and the time that is reached.
    - splits: Whether the domain has to be split, in the direction ``widest``; then there is no leg.
    - failure: Why the leg ends before the span; empty if it does not, or ends because of its
      degrees.
    - is_complete: Whether the leg has the whole span.
    """

    def __init__(
        self,
        domain: Domain,
        span: tuple[float, float],
        solve: Solve,
        allowed: np.ndarray,
        random: np.random.Generator,
        *,
        may_end: bool,
        note: Callable[..., None],
    ) -> None:
        self.domain, self._solve, self._allowed = domain, solve, allowed
        self._random, self._may_end, self._note = random, may_end, note
        self._each = _WITH_PARAMETERS if len(domain) > len(allowed) else 1.0
        self._begin, self._length = span[0], span[1] - span[0]
        self._whole = abs(self._length)
        self.failure, self.splits, self.widest = "", False, 0
        self.is_complete = True
        self._edges = np.empty(0)  # of the pieces, once they are chosen
        self._solutions: list[Solutions] = []
        try:
            self._probe()
            if not self.splits:
                self._enlarge()
        except _SplitError:
            self.splits = True

    # -- stage 1 ---------------------------------------------------------------------------------

    def _probe(self) -> None:
        d = len(self.domain)
        count = _LINE.get(d, _SHORT_LINE)
        axes, signs = axis_degrees(d, count - 1), self._signs(d)
        slanted = (leja_points()[1:count, None, None] * signs).reshape(-1, d)
        solutions = self._solved(np.concatenate((points(axes), slanted)))
        sample = self._random.permutation(solutions.size)[:_SAMPLE]
        self._edges = self._pieces(solutions[sample])
        values = self._monitored(solutions)
        self._degrees, self._values = axes, values[: len(axes)]
        self._solutions.append(solutions[: len(axes)])
        on_axis = [np.flatnonzero(axes.sum(axis=1) == axes[:, k]) for k in range(d)]
        straight = np.array([self._needed(values[line]) for line in on_axis])
        across = values[len(axes) :].reshape(count - 1, len(signs), *values.shape[1:])
        total = np.zeros(len(self._edges) - 1)
        for i in range(len(signs)):
            total = np.maximum(total, self._needed(np.concatenate((values[:1], across[:, i]))))
        numbers = _terms(straight, total)
        fine = (numbers <= _LARGEST) & (straight <= MOST_DEGREE).all(axis=0)
        self.widest = int(np.argmax(straight[:, -1]))
        if not fine.all() and not self._end_after(int(np.argmin(fine)), numbers[-1]):
            return
        predicted = int(numbers[len(self._edges) - 2])
        end = self._begin + self._edges[-1]
        self._note(f"t = {end:.6g}: about {predicted:,} solutions", end)

    def _signs(self, d: int) -> np.ndarray:
        """Return directions of diagonals, shape (lines, d)."""
        if d == 1:
            return np.empty((0, 1))
        most = min(d - 1, 30)
        codes = self._random.choice(2**most, min(2**most, _DIAGONALS), replace=False)
        signs = np.ones((len(codes), d))
        signs[:, 1 : most + 1] -= 2.0 * ((codes[:, None] >> np.arange(most)) & 1)
        return signs

    def _needed(self, line: np.ndarray) -> np.ndarray:
        """Return the degree that values on a line need until the end of each piece.

        Where the last surpluses are not small, their decay is continued.

        - line: Values at Leja points, shape (points, monitored times, dim).
        """
        found = surpluses(np.arange(len(line))[:, None], line)
        sizes = np.abs(found / (_SURPLUS * self._allowed)).max(axis=2)
        sizes = sizes.reshape(len(line), -1, _MONITORS).max(axis=2)
        counts = sizes > 1
        last = np.where(counts.any(axis=0), len(line) - 1 - np.argmax(counts[::-1], axis=0), 0)
        needed, half = last + 1.0, len(line) // 2
        for k in np.flatnonzero(last >= len(line) - 2):
            early, late = float(sizes[1:half, k].max()), float(sizes[half:, k].max())
            decay = math.log(early / late) / half if 0 < late < early else 0.0
            needed[k] = len(line) + math.log(late) / decay if decay > 0 else math.inf
        return np.maximum.accumulate(needed)

    def _pieces(self, sample: Solutions) -> np.ndarray:
        """Return the ends of pieces in which the series in time has enough terms, from 0."""
        table = collocation(_TERMS)
        matrix = table.interpolation(_PLACES)
        edges, step = [0.0], 1 / 16
        while edges[-1] < 1:
            left = math.ceil((1 - edges[-1]) / step)
            step = (1 - edges[-1]) / left
            if not step > _SMALLEST_PIECE:
                self.failure = "the solutions change too fast for an expansion in time"
                self.is_complete = False
                break
            places = edges[-1] + step * np.concatenate((table.nodes, _PLACES))
            times = self._length * places
            found = (sample(self._begin + times) - sample.z0[:, None]) / times[:, None]
            misses = found[:, _TERMS:] - np.einsum("pn,snc->spc", matrix, found[:, :_TERMS])
            error = np.abs(misses * times[_TERMS:, None] / self._allowed).max() / _TIME
            if error <= 1:
                edges.append(1.0 if left == 1 else edges[-1] + step)
            # The error of a piece of length h grows as a power of h, of about the number of terms.
            change = 0.9 * max(float(error), 1e-9) ** (-1 / _TERMS) if error < math.inf else 0.0
            step *= min(max(change, 0.3), _GROWTH)
        if len(edges) < 2:
            raise FailedError(self.failure)
        return self._length * np.array(edges)

    def _end_after(self, pieces: int, terms: float) -> bool:
        """End the leg after some pieces, or split the domain; return whether the leg remains.

        - terms: Terms that the whole leg would need: about as many solutions, if the domain is
          split.
        """
        ends = self._may_end and pieces >= _FEWEST_PIECES
        if ends and self.domain.samples is not None:  # of a span that is twice the last leg
            ends = abs(self._edges[pieces]) > _WORTHWHILE * self._whole
        elif ends:
            legs = (len(self._edges) - 1) / pieces
            ends = terms > self._each * legs * _LARGEST
        if not ends:
            self.splits = True
            return False
        self._keep(pieces)
        return True

    def _keep(self, pieces: int) -> None:
        self._edges = self._edges[: pieces + 1]
        self._length, self.is_complete = float(self._edges[-1]), False
        self._values = self._values[:, : _MONITORS * pieces]

    # -- stage 2 ---------------------------------------------------------------------------------

    def _enlarge(self) -> None:
        share, rounds = _SURPLUS, 0
        added = np.empty((0, len(self.domain)), dtype=int)
        while not self.splits:
            sizes = np.abs(surpluses(self._degrees, self._values) / (share * self._allowed))
            added = further_degrees(self._degrees, sizes.max(axis=(1, 2)))
            if not len(added):
                worst = self._worst_at_random()
                if worst <= _RANDOM:
                    return
                rounds += 1
                share *= min(max(0.5 * _RANDOM / worst, 0.1), 0.7) if worst < math.inf else 0.1
                added = further_degrees(self._degrees, sizes.max(axis=(1, 2)) * (_SURPLUS / share))
                added = added if len(added) else margin(self._degrees)
            highest = int(added.max(initial=0))
            too_many = len(self._degrees) + len(added) > _SPARE * _LARGEST
            if too_many or highest >= MOST_DEGREE or rounds > _ROUNDS:
                self.widest = int(np.argmax(self._degrees.max(axis=0)))
                self._end_after(3 * (len(self._edges) - 1) // 4, math.inf if self._each == 1 else 0)
                rounds = 0
                continue
            solutions = self._solved(points(added))
            self._solutions.append(solutions)
            values = self._monitored(solutions)
            self._degrees = np.concatenate((self._degrees, added))
            # A solution that failed has shortened the leg.
            self._values = np.concatenate((self._values[:, : values.shape[1]], values))

    def _worst_at_random(self) -> float:
        """Return the largest difference from solutions at random points, of the allowed error."""
        count, d = max(_FEWEST_RANDOM, len(self._degrees) // 8), len(self.domain)
        y = random_places(self._random, count, d, _AT_END)
        exact = self._monitored(self._solved(y))
        kept = self._values[:, : exact.shape[1]]
        coefficients = chebyshev_coefficients(self._degrees, kept)
        found = np.einsum(
            "nq,nmc->qmc",
            products(self._degrees, tables(self._degrees, y)),
            coefficients,
            optimize=True,
        )
        return float(np.abs((found - exact) / self._allowed).max())

    # -- solutions and their values --------------------------------------------------------------

    def _solved(self, y: np.ndarray) -> Solutions:
        """Return solutions from scaled inputs; where one fails, the leg ends before."""
        while True:
            span = (self._begin, self._begin + self._length)
            found = self._solve(self.domain, y, span)
            failed = np.flatnonzero(~found.success)
            if not len(failed):
                return found
            member = int(failed[0])
            inputs = self.domain.at(y[member : member + 1])
            state = ", ".join(f"{value:.6g}" for value in self.domain.states(inputs)[0])
            self.failure = f"from z = ({state}) at t = {self._begin:.6g}: {found.message[member]}"
            reached = found.table.counts[found.members[member]] and found[member].span[1]
            length = _BEFORE * ((reached or self._begin) - self._begin)
            if not 0 < length / self._length < _BEFORE:
                length = 0.5 * self._length
            self._shorten(length)

    def _shorten(self, length: float) -> None:
        """End the leg earlier; raises FailedError if nothing is left of it."""
        if len(self._edges):
            self._keep(int(np.sum(np.abs(self._edges[1:]) <= abs(length))))
        else:
            self._length, self.is_complete = length, False
        if self.domain.samples is not None and not abs(self._length) > _WORTHWHILE * self._whole:
            raise _SplitError
        if not abs(self._length) > _SHORTEST * self._whole:
            raise FailedError(self.failure)

    def _monitored(self, solutions: Solutions) -> np.ndarray:
        """Return states in the middle and at the end of each piece, shape (n, times, dim)."""
        ends = self._edges[1:]
        times = np.stack((0.5 * (self._edges[:-1] + ends), ends), axis=1).ravel()
        return solutions(self._begin + times)

    # -- stage 3 ---------------------------------------------------------------------------------

    def leg(self) -> Leg:
        """Return the expansion."""
        domain = self.domain
        starts = domain.start_states(domain.at(points(self._degrees)))
        table = collocation(_TERMS)
        pieces = []
        for low, high in zip(self._edges[:-1], self._edges[1:], strict=True):
            times = low + (high - low) * table.nodes
            states = np.concatenate([part(self._begin + times) for part in self._solutions])
            network = (states - starts[:, None]) / times[:, None]
            series = np.einsum("mn,snc->smc", table.to_series, network)
            pieces.append(self._piece(chebyshev_coefficients(self._degrees, series), high))
        return Leg(
            self._begin,
            self._edges,
            domain.scaling,
            domain.shift,
            domain.selection,
            domain.offset,
            domain.start_degrees,
            domain.start,
            pieces,
        )

    def _piece(self, coefficients: np.ndarray, time: float) -> CompiledPiece:
        """Truncate and compress the coefficients of N, shape (n, terms, dim), up to a time."""
        unit = self._allowed * _TRUNCATION / abs(time)
        sizes = np.abs(coefficients / unit).sum(axis=1).max(axis=1)
        order = np.argsort(sizes)
        kept = np.sort(order[np.cumsum(sizes[order]) > 1])
        if not len(kept):
            kept = np.array([0])
        matrix = (coefficients[kept] / unit).reshape(len(kept), -1)
        left, values, right = np.linalg.svd(matrix, full_matrices=False)
        rest = np.sqrt(np.cumsum(values[::-1] ** 2))[::-1]
        rank = max(int(np.sum(rest > 1)), 1)
        columns = right[:rank].reshape(rank, *coefficients.shape[1:]) * unit
        return CompiledPiece(self._degrees[kept], left[:, :rank] * values[:rank], columns)


def _terms(straight: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Return about how many terms an expansion needs until the end of each piece.

    They are counted as the multi-indices within the degrees by direction of which the sum is at
    most the degree on diagonals.

    - straight, total: Degrees by direction, (d, pieces), and on diagonals, (pieces,).
    """
    d = len(straight)
    places = np.random.default_rng(0).random((4_096, d))
    within = places @ straight <= np.maximum(total, straight.max(axis=0))
    return within.mean(axis=0) * np.prod(straight + 1, axis=0)
