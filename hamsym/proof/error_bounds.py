"""Two-sided bounds on the largest error over time, by branch and bound.

The expansions of :mod:`hamsym.proof.expansions` give polynomials P(s) with balls as coefficients on
pieces |s| <= w of elapsed time.

1. *Bounds.* |P(s)| <= sum_k |p_k| w^k for |s| <= w, with |p_k| the largest magnitude in the ball;
   and |P(0)| is at least the smallest magnitude in p_0. For the 2-norm this is done for the
   polynomial sum_i E_i(s)^2, and the square root taken. The distance of y from the exact solution
   is added to upper and subtracted from lower bounds.
2. *Refinement.* The largest of the upper bounds of pieces that cover the span is an upper bound on
   the maximum over time; the largest of their lower bounds is a lower bound. The piece with the
   largest upper bound is halved until both are as close as required: with a new expansion if the
   radii of the balls dominate its bound, by shifting otherwise.
"""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from flint import arb, arb_poly

from hamsym.errors import CertificationError
from hamsym.proof.balls import above, ball, below, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.expansions import ORDER, Expansion, TrialError, overlaps
from hamsym.proof.functions import SingularityError
from hamsym.proof.limits import Deadline, PrecisionError
from hamsym.proof.segments import Segment
from hamsym.proof.taylor import SolutionEnclosure

__all__ = [
    "MOST_LEAVES",
    "ErrorBounds",
    "Goal",
    "Leaf",
    "Quantity",
    "Range",
    "RefutedError",
    "joints_of",
    "quantities",
]

_MOST_SHIFTS = 8  # parts of an expansion that are bounded by shifting it
_NARROWEST = 2.0**-40  # piece, relative to the span
MOST_LEAVES = 200_000  # pieces of a proof


class RefutedError(CertificationError):
    """A claimed bound is proven false."""


@dataclass(frozen=True)
class Quantity:
    """A function of time whose largest magnitude is bounded.

    Attributes
    ----------
    name : str
    polynomial : callable
        Expansion -> its polynomial, or that of its square.
    slack : callable
        Expansion -> a bound on the distance of the quantity from the polynomial.
    squared : bool
        Whether the polynomial is that of the square.
    floor : float
        Difference between upper and lower bound that is always small enough.
    """

    name: str
    polynomial: Callable[[Expansion], arb_poly]
    slack: Callable[[Expansion], arb]
    squared: bool
    floor: float


class Leaf:
    """A part of a piece with bounds on one quantity."""

    def __init__(
        self,
        quantity: Quantity,
        expansion: Expansion,
        centre: Fraction,
        half: Fraction,
        polynomial: arb_poly | None,
    ) -> None:
        self.expansion, self.centre, self.half = expansion, centre, half
        self.start, self.end = centre - half, centre + half
        self.polynomial = polynomial
        self.upper, self.lower, self.middle = math.inf, 0.0, math.inf
        if polynomial is None:
            return
        width, upper, middle = ball(half), arb(0), arb(0)
        for value in reversed(polynomial.coeffs()):
            upper = upper * width + value.abs_upper()
            middle = middle * width + value.mid().abs_upper()
        lower, slack = polynomial[0].abs_lower(), quantity.slack(expansion)
        if quantity.squared:
            upper, middle, lower = (v.upper().sqrt() for v in (upper, middle, lower))
        self.upper = above(upper + slack)
        #: About the upper bound without the radii of the balls; steers the refinement.
        self.middle = above(middle + slack)
        self.lower = max(0.0, below(lower - slack))

    def __lt__(self, other: Leaf) -> bool:
        return self.upper > other.upper


@dataclass(frozen=True)
class Range:
    """Proven bounds on the largest magnitude of a quantity, with the pieces of the proof."""

    upper: float
    lower: float
    leaves: list[Leaf]


@dataclass(frozen=True)
class Goal:
    """Criterion for the end of a refinement.

    Attributes
    ----------
    rtol : float
        Difference of the bounds, relative to the lower one; ignored if there are claims.
    claims : (float, float), optional
        An upper and a lower bound to prove.
    """

    rtol: float
    claims: tuple[float, float] | None = None

    def allowed(self, lower: float, floor: float) -> float:
        """The largest upper bound that meets the goal."""
        if self.claims is not None:
            return self.claims[0]
        return max(lower * (1 + self.rtol), lower + floor)

    def met(self, upper: float, lower: float, floor: float) -> bool:
        """Whether the bounds meet the goal.

        Raises
        ------
        RefutedError
            If a claim is refuted.
        """
        if self.claims is None:
            return upper <= self.allowed(lower, floor)
        claimed_upper, claimed_lower = self.claims
        if not lower <= claimed_upper or not upper >= claimed_lower:
            raise RefutedError("a claimed bound is refuted")
        return upper <= claimed_upper and lower >= claimed_lower


def quantities(floors: dict[str, np.ndarray]) -> list[Quantity]:
    """The 2-norm of the error, its components, the energy error, and the residual.

    Parameters
    ----------
    floors : dict
        "error" of shape (dim,), "energy" and "ell" of shape ().
    """
    found = [
        Quantity(
            "norm",
            lambda e: _squares(e.errors),
            lambda e: functools.reduce(arb.max, e.step.widths),
            squared=True,
            floor=float(floors["error"].max()),
        )
    ]
    for i, floor in enumerate(floors["error"]):
        found.append(
            Quantity(
                f"component {i}",
                lambda e, i=i: e.errors[i],  # type: ignore[misc]
                lambda e, i=i: e.step.widths[i],  # type: ignore[misc]
                squared=False,
                floor=float(floor),
            )
        )
    found.append(
        Quantity(
            "energy",
            lambda e: e.energy,
            lambda e: e.energy_slack,
            squared=False,
            floor=float(floors["energy"]),
        )
    )
    found.append(
        Quantity(
            "ell_max",
            lambda e: _squares(e.residuals),
            lambda e: arb(0),
            squared=True,
            floor=float(floors["ell"]),
        )
    )
    return found


def _squares(polynomials: Sequence[arb_poly]) -> arb_poly:
    return sum((polynomial * polynomial for polynomial in polynomials), arb_poly([0]))


class ErrorBounds:
    """Branch and bound on the error of a trial solution.

    Parameters
    ----------
    H : Enclosures
    z0 : numpy.ndarray
        Start of the exact solution.
    parts : list of Segment
        Smooth parts of the trial solution.
    solution : SolutionEnclosure
        The exact solution.
    deadline : Deadline

    Raises
    ------
    CertificationError
        If there are too many pieces.
    """

    def __init__(
        self,
        H: Enclosures,
        z0: np.ndarray,
        parts: list[Segment],
        solution: SolutionEnclosure,
        deadline: Deadline,
    ) -> None:
        self.bits, self._deadline = solution.bits, deadline
        self._total = solution.steps[-1].end
        with working(self.bits, ORDER + 2):
            error = TrialError(H, z0, solution)
            self._pieces = []
            intervals = overlaps(parts, solution.steps)
            if len(intervals) > MOST_LEAVES:
                raise CertificationError(
                    f"the proof needs more than {MOST_LEAVES} pieces; solve on a shorter span or "
                    "with a looser tolerance"
                )
            for segment, step, low, high in intervals:
                deadline.check("the trial solution was expanded")
                middle, half = (low + high) / 2, (high - low) / 2
                self._pieces.append(Expansion(error, segment, step, middle, half))

    def leaves(self, quantity: Quantity, known: list[Leaf] | None = None) -> list[Leaf]:
        """Leaves that cover the span: on the first pieces, or on the leaves of another quantity."""
        if known is None:
            places = [(piece, piece.centre, piece.half) for piece in self._pieces]
        else:
            places = [(leaf.expansion, leaf.centre, leaf.half) for leaf in known]
        with working(self.bits, ORDER + 2):
            return [self._leaf(quantity, *place) for place in places]

    def cut(
        self, quantity: Quantity, leaves: Sequence[Leaf], low: Fraction, high: Fraction
    ) -> list[Leaf]:
        """Restrict leaves to [low, high].

        A narrow rest of a leaf gets an expansion of its own, because the remainder of the wide
        expansion would dominate its bound.
        """
        found = []
        with working(self.bits, ORDER + 2):
            for leaf in leaves:
                start, end = max(leaf.start, low), min(leaf.end, high)
                if (start, end) == (leaf.start, leaf.end):
                    found.append(leaf)
                elif start < end:
                    centre, half = (start + end) / 2, (end - start) / 2
                    expansion = leaf.expansion
                    if half * _MOST_SHIFTS <= expansion.half:
                        expansion = expansion.narrowed(centre, half)
                    found.append(self._leaf(quantity, expansion, centre, half))
        return found

    def refine(self, quantity: Quantity, leaves: list[Leaf], goal: Goal) -> Range:
        """Bounds on the largest magnitude over time.

        Raises
        ------
        PrecisionError
            If the enclosure of the solution is too wide for the goal.
        CertificationError
            If a claim is refuted, or the time limit is exceeded.
        """
        heap, lower = list(leaves), max(leaf.lower for leaf in leaves)
        heapq.heapify(heap)
        narrowest = self._total * Fraction(_NARROWEST)
        with working(self.bits, ORDER + 2):
            while True:
                top = heap[0]
                if goal.met(top.upper, lower, quantity.floor):
                    break
                if top.half < narrowest or len(heap) > MOST_LEAVES:
                    if top.polynomial is None:  # no bound at all: H is singular along z^
                        return Range(math.inf, lower, heap)
                    raise PrecisionError
                self._deadline.check(f"the {quantity.name} was bounded")
                heapq.heappop(heap)
                for leaf in self._halves(quantity, top, goal.allowed(lower, quantity.floor)):
                    lower = max(lower, leaf.lower)
                    heapq.heappush(heap, leaf)
        return Range(top.upper, lower, heap)

    def _halves(self, quantity: Quantity, leaf: Leaf, allowed: float) -> list[Leaf]:
        """Both halves of a leaf, with new expansions where they are needed."""
        half = leaf.half / 2
        # A new expansion, if the radii of the balls dominate the bound, or after many shifts.
        fat = (
            not leaf.upper - leaf.middle <= (leaf.upper - allowed) / 2
            or leaf.half * _MOST_SHIFTS <= leaf.expansion.half
        )
        found = []
        for side in (-1, 1):
            centre, expansion = leaf.centre + side * half, leaf.expansion
            if fat:
                expansion = expansion.narrowed(centre, half)
            found.append(self._leaf(quantity, expansion, centre, half))
        return found

    def _leaf(
        self, quantity: Quantity, expansion: Expansion, centre: Fraction, half: Fraction
    ) -> Leaf:
        try:
            polynomial = quantity.polynomial(expansion)
            if centre != expansion.centre:
                polynomial = polynomial(arb_poly([ball(centre - expansion.centre), 1]))
        except SingularityError:
            return Leaf(quantity, expansion, centre, half, None)
        return Leaf(quantity, expansion, centre, half, polynomial)


def joints_of(leaves: Sequence[Leaf]) -> list[Fraction]:
    """Elapsed times inside the span at which the expansion changes."""
    ordered = sorted(leaves, key=lambda leaf: leaf.centre)
    return [
        after.start
        for before, after in pairwise(ordered)
        if before.expansion is not after.expansion
    ]
