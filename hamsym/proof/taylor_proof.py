"""Proof of error bounds by Taylor steps in ball arithmetic of any precision (Arb).

Stage 1  H, J grad H and Hess become functions of balls (:mod:`hamsym.proof.enclosures`).
Stage 2  A validated integration encloses the exact solution, far more accurately than the neural
         trajectory (:mod:`hamsym.proof.taylor`).
Stage 3  The trajectory, as the real function that its weights define
         (:mod:`hamsym.proof.trials`), minus the exact solution is expanded
         (:mod:`hamsym.proof.expansions`) and bounded (:mod:`hamsym.proof.error_bounds`).

The docstrings of the modules of stages 2 and 3 contain the proof, with every inequality.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import TypeVar

import numpy as np

from hamsym.errors import CertificationError
from hamsym.proof.balls import SMALLEST, at_least, at_most
from hamsym.proof.certificate import FLOOR, MOST_BITS, Certificate, rounded_up
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.error_bounds import (
    ErrorBounds,
    Goal,
    Leaf,
    Quantity,
    Range,
    RefutedError,
    joints_of,
    quantities,
)
from hamsym.proof.limits import Deadline, PrecisionError
from hamsym.proof.presolve import Presolution, presolve
from hamsym.proof.taylor import SolutionEnclosure, enclose_solution
from hamsym.proof.trials import segments
from hamsym.solution.solution import Solution
from hamsym.support.progress import share_progress

__all__ = ["TaylorProof"]

_ACCURACY = 2.0**-62  # of the enclosure of the solution, in units of the components
_FLOOR_WITHOUT_SOLUTION = 2.0**-70  # floor of quantities that do not involve the exact solution
_PROGRESS = Fraction(1, 1_000)  # of the span: least gain of half as many bits again
_SPARE_BITS = 4
_TRIES = 2  # precisions, at least, before an undecided claim is rejected

_Found = TypeVar("_Found")


def _accuracy(rtol: float) -> float:
    """Accuracy that the enclosure of the solution needs, in units of the components."""
    return _ACCURACY * min(1.0, 50 * rtol)


def _implied(
    bounds: ErrorBounds,
    quantity: Quantity,
    leaves: list[Leaf],
    pair: tuple[float, float],
    last: bool,
) -> Range:
    """Bounds at least as tight as a claimed pair (upper, lower).

    Raises
    ------
    PrecisionError
        If more bits may help, and this is not the last try.
    CertificationError
        If the claim is refuted, or not proven.
    """
    upper, lower = at_most(pair[0]), at_least(pair[1])
    try:
        found = bounds.refine(quantity, leaves, Goal(0.0, (upper, lower)))
        if found.upper <= upper and found.lower >= lower:  # False where H is singular along z^
            return found
    except RefutedError:
        pass
    except PrecisionError:
        if not last:
            raise
    raise CertificationError(
        f"the certificate does not hold: its claim about the {quantity.name} is not proven"
    )


def _within(
    ordered: list[Leaf], intervals: Iterable[tuple[Fraction, Fraction]]
) -> Iterator[list[Leaf]]:
    """For consecutive intervals, the leaves that overlap each of them."""
    first = 0
    for low, high in intervals:
        while first < len(ordered) and ordered[first].end <= low:
            first += 1
        last = first
        while last < len(ordered) and ordered[last].start < high:
            last += 1
        yield ordered[first:last]


class TaylorProof:
    """Bounds on the error of one solution."""

    def __init__(self, solution: Solution, deadline: Deadline, progress: bool | None) -> None:
        self._deadline, self._progress = deadline, progress
        self._span = float(solution.span[0]), float(solution.span[1])
        self._enclosures = Enclosures(solution.H)
        self._parts = segments(solution.trial, self._span)
        self._z0 = solution.z0
        self._presolution: Presolution = presolve(solution.H, self._z0, self._span, solution.scale)
        start, end = map(Fraction, self._span)
        self._start, self._direction = start, 1 if end > start else -1
        self._total = abs(end - start)

    def bounds(
        self, rtol: float, bits: int | None
    ) -> tuple[int, list[Range], dict[str, tuple[float, ...]]]:
        """The precision that was used, the bounds of all quantities, and the pieces.

        Raises
        ------
        CertificationError
            If there are no bounds.
        """
        goal = Goal(rtol)

        def attempt(bounds: ErrorBounds) -> tuple[list[Range], dict[str, tuple[float, ...]]]:
            found: list[Range] = []
            profile: dict[str, tuple[float, ...]] = {}
            leaves: list[Leaf] | None = None
            for quantity in quantities(self.floors):
                found.append(bounds.refine(quantity, bounds.leaves(quantity, leaves), goal))
                leaves = found[-1].leaves
                profile = profile or self.profile(bounds, quantity, leaves)
            return found, profile

        used, (found, profile) = self.run(attempt, bits, _accuracy(rtol))
        return used, found, profile

    def check(self, claims: Certificate) -> None:
        """Prove every claim of a certificate.

        Raises
        ------
        CertificationError
            If a claim is not proven, naming the first one.
        """
        pairs = [
            (claims.bound, claims.lower),
            *zip(claims.component_bounds, claims.component_lowers, strict=True),
            (claims.energy_bound, claims.energy_lower),
            (claims.ell_max_bound, claims.ell_max_lower),
        ]
        tries = 0

        def attempt(bounds: ErrorBounds) -> None:
            nonlocal tries
            tries += 1
            last = tries >= _TRIES and bounds.bits >= claims.bits
            leaves: list[Leaf] | None = None
            found = quantities(self.floors)
            for quantity, pair in zip(found, pairs, strict=True):
                leaves = bounds.leaves(quantity, leaves)
                leaves = _implied(bounds, quantity, leaves, pair, last).leaves
            norm = found[0]
            pieces = self.cuts(bounds, norm, bounds.leaves(norm, leaves), claims.edges)
            for piece, claimed in zip(pieces, claims.piece_bounds, strict=True):
                _implied(bounds, norm, piece, (claimed, 0.0), last)

        self.run(attempt, None, _accuracy(claims.rtol))

    @property
    def floors(self) -> dict[str, np.ndarray]:
        """Differences of bounds that are always small enough, in the units of each quantity."""
        energy = _FLOOR_WITHOUT_SOLUTION if self._enclosures.conserved else FLOOR
        floors = {
            "error": FLOOR * np.array(self._presolution.scales),
            "energy": np.array(energy * self._presolution.energy_scale),
            "ell": np.array(_FLOOR_WITHOUT_SOLUTION * self._presolution.rate_scale),
        }
        # An infinite floor would accept any bound; SMALLEST is the smallest bound.
        return {
            name: np.where(np.isfinite(value), value, 0.0).clip(SMALLEST)
            for name, value in floors.items()
        }

    def profile(
        self, bounds: ErrorBounds, norm: Quantity, leaves: list[Leaf]
    ) -> dict[str, tuple[float, ...]]:
        """Edges of the pieces of the proof, and the upper bound on each piece."""
        start, end = self._span
        joints = [self.time(place) for place in joints_of(leaves)]
        edges = tuple(dict.fromkeys((start, *joints, end)))
        # Edges are rounded to floats, so that a piece may contain a narrow part of the next one.
        cuts = self.cuts(bounds, norm, leaves, edges)
        uppers = [max(leaf.upper for leaf in part) for part in cuts]
        return {"edges": edges, "piece_bounds": tuple(rounded_up(upper) for upper in uppers)}

    def cuts(
        self,
        bounds: ErrorBounds,
        norm: Quantity,
        leaves: list[Leaf],
        edges: Sequence[float],
    ) -> Iterator[list[Leaf]]:
        """Leaves that cover exactly each piece between two edges."""
        ordered = sorted(leaves, key=lambda leaf: leaf.centre)
        intervals = list(pairwise([self.elapsed(edge) for edge in edges]))
        for (low, high), part in zip(intervals, _within(ordered, intervals), strict=True):
            self._deadline.check("the pieces were bounded")
            yield bounds.cut(norm, part, low, high)

    def elapsed(self, t: float) -> Fraction:
        return self._direction * (Fraction(t) - self._start)

    def run(
        self, attempt: Callable[[ErrorBounds], _Found], bits: int | None, accuracy: float
    ) -> tuple[int, _Found]:
        """A sufficient precision, and the result of an attempt at it."""
        used = self._presolution.bits if bits is None else bits
        reached = Fraction(-1)
        while True:
            if used > MOST_BITS:
                raise self._separated(self._presolution.until(MOST_BITS))
            try:
                exact = self._solution(used)
                reached_accuracy = exact.accuracy(self._presolution.scales)
                if not reached_accuracy <= accuracy:
                    raise PrecisionError(missing=math.log2(reached_accuracy / accuracy))
                bounds = ErrorBounds(self._enclosures, self._z0, self._parts, exact, self._deadline)
                return used, attempt(bounds)
            except PrecisionError as error:
                if bits is not None:
                    raise CertificationError(
                        f"{bits} bits are not enough; give more, or omit bits"
                    ) from None
                if error.elapsed is not None:
                    # Near a singularity more bits bring no progress.
                    if error.elapsed - reached < _PROGRESS * self._total:
                        raise self._separated(float(error.elapsed)) from None
                    reached = error.elapsed
                missing = used / 2 if error.missing is None else error.missing + _SPARE_BITS
            used += 32 * math.ceil(missing / 32)

    def _separated(self, elapsed: float) -> CertificationError:
        t = self.time(Fraction(elapsed))
        return CertificationError(
            f"no bound beyond t = {t:.6g}: trajectories separate too fast (near-collision, escape "
            "or chaos); use an earlier end time"
        )

    def time(self, elapsed: Fraction) -> float:
        return float(self._start + self._direction * elapsed)

    def _solution(self, bits: int) -> SolutionEnclosure:
        with share_progress(self._progress) as report:
            return enclose_solution(
                self._enclosures,
                self._z0,
                self._span,
                self._presolution.units,
                bits,
                self._deadline,
                report,
            )
