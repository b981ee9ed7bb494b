"""A trial solution against the true one: two-sided bounds on the largest difference over time.

Let z^ be a trial solution (:mod:`hamsym.proof.trials`), y a polynomial with |z - y| <= eps in
units u (:mod:`hamsym.proof.taylor`). On a piece of elapsed time [c - w, c + w] that lies in one
smooth part of z^ and in one step of y:

1. *Expansion.* By Taylor's theorem, for every |s| <= w and each component,

       z^(c + s) = sum_k<m a_k s^k + A s^m,

   where a_k is the Taylor coefficient at c and A some m-th coefficient at a point of the piece.
   Both come from :class:`~hamsym.proof.trials.Segment`, a_k on the ball {c} and A on the ball
   of the whole piece. The same for y, by shifting the polynomial to c and to the ball. Their
   difference is E(s) = sum_k<m e_k s^k + e_m s^m, a polynomial whose coefficients are balls: for
   every s there are numbers in these balls that give z^ - y at c + s. (The one in e_m depends on
   s.) Likewise z^' - G(z^) for the residual, and H(z^) - H, from the series of the formulas along
   z^.
2. *Shifting.* If numbers in the balls of P(s) = sum_k p_k s^k give a value at s, then those of
   P(b + x), multiplied out in ball arithmetic, give it at x = s - b: for a fixed s all is an
   identity between numbers. So a piece can be halved without a new expansion.
3. *Bounds.* |P(s)| <= sum_k |p_k| w^k for |s| <= w, with |p_k| the largest magnitude in the ball;
   and |P(0)| is at least the smallest magnitude in p_0. For the 2-norm this is done for the
   polynomial sum_i E_i(s)^2, and the square root taken.
4. *The solution itself.* |z_i - y_i| <= u_i eps, and |z - y| <= max_i u_i eps in the 2-norm.
   Upper bounds grow, lower bounds shrink by that. The residual does not involve z. If H does not
   depend on time, H(z(t)) = H(z0) exactly. Otherwise H(z^) - H(y) is expanded, and by the mean
   value theorem |H(z) - H(y)| <= sum_i sup |dH/dz_i| u_i eps, the supremum over the range of y on
   the piece widened by u_i eps.
5. *Refinement.* The largest of the upper bounds of pieces that cover the span is an upper bound on
   the maximum over time; the largest of their lower bounds is a lower bound. The piece with the
   largest upper bound is halved until both are as close as wanted: with a new expansion if the
   radii of the balls are what keeps its bound up, by shifting otherwise.
"""

from __future__ import annotations

import functools
import heapq
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from itertools import pairwise

import numpy as np
from flint import arb, arb_poly, arb_series, ctx

from hamsym.errors import CertificationError
from hamsym.proof.balls import above, ball, below, interval, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.functions import SingularityError
from hamsym.proof.segments import Segment
from hamsym.proof.taylor import Deadline, PrecisionError, Reference, ReferenceStep, coefficient

__all__ = ["MOST_LEAVES", "Comparison", "Goal", "Leaf", "Quantity", "Range", "joints_of"]

_ORDER = 10  # of the expansions
_MOST_SHIFTS = 8  # parts of an expansion that are bounded by shifting it
_NARROWEST = 2.0**-40  # piece, relative to the span
MOST_LEAVES = 200_000  # parts of a proof


class Expansion:
    """z^, and its difference from the true solution, on a piece of elapsed time.

    Attributes
    ----------
    centre, half : fractions.Fraction
        The piece is [centre - half, centre + half].
    """

    def __init__(
        self,
        comparison: Comparison,
        segment: Segment,
        step: ReferenceStep,
        centre: Fraction,
        half: Fraction,
    ) -> None:
        self._comparison, self.segment, self.step = comparison, segment, step
        self.centre, self.half = centre, half
        reference = comparison.reference
        self._exact = segment.series(centre, Fraction(0), _ORDER + 1)
        self._around = segment.series(centre, half, _ORDER + 2)
        place = ball(centre - step.start)
        spread = interval(centre - half - step.start, centre + half - step.start)
        at_centre, around = arb_poly([place, 1]), arb_poly([spread, 1])
        self._true_exact = [polynomial(at_centre) for polynomial in step.polynomials]
        self._true_around = [polynomial(around) for polynomial in step.polynomials]
        start, direction = ball(Fraction(reference.start)), reference.direction
        with working(ctx.prec, _ORDER + 2):
            self._clock = arb_series([start + direction * ball(centre), direction])
            times = interval(centre - half, centre + half)
            self._clock_around = arb_series([start + direction * times, direction])

    @cached_property
    def errors(self) -> list[arb_poly]:
        """z^_i - y_i in the time since the centre, for each component."""
        return [
            arb_poly([a[k] - b[k] for k in range(_ORDER + 1)] + [A[_ORDER + 1] - B[_ORDER + 1]])
            for a, b, A, B in zip(
                self._exact, self._true_exact, self._around, self._true_around, strict=True
            )
        ]

    @cached_property
    def residuals(self) -> list[arb_poly]:
        """sigma (dz^/dt - J grad H(z^, t)) for each component."""
        H, direction = self._comparison.H, self._comparison.reference.direction
        with working(ctx.prec, _ORDER + 2):
            exact = H.vector_field(self._exact, self._clock)
            around = H.vector_field(self._around, self._clock_around)
        return [
            arb_poly(
                [(k + 1) * a[k + 1] - direction * coefficient(f, k) for k in range(_ORDER)]
                + [(_ORDER + 1) * A[_ORDER + 1] - direction * coefficient(F, _ORDER)]
            )
            for a, f, A, F in zip(self._exact, exact, self._around, around, strict=True)
        ]

    @cached_property
    def energy(self) -> arb_poly:
        """H(z^, t) - H(y, t), or H(z^) - H(z0) if H does not depend on t."""
        H = self._comparison.H
        with working(ctx.prec, _ORDER + 2):
            value = H.energy(self._exact, self._clock)
            rest = H.energy(self._around, self._clock_around)
            if H.time_dependent:
                value -= H.energy(_series(self._true_exact), self._clock)
                rest -= H.energy(_series(self._true_around), self._clock_around)
            else:
                value -= self._comparison.energy_0
        return arb_poly(
            [coefficient(value, k) for k in range(_ORDER + 1)] + [coefficient(rest, _ORDER + 1)]
        )

    @cached_property
    def energy_slack(self) -> arb:
        """|H(z) - H(y)| at most."""
        if not self._comparison.H.time_dependent:
            return arb(0)
        H = self._comparison.H
        widths = self.step.widths
        state = [
            polynomial[0] + width * arb(0, 1)
            for polynomial, width in zip(self._true_around, widths, strict=True)
        ]
        H.energy(state, self._clock_around[0])  # a ball: H does not jump between z and y
        slopes = H.vector_field(state, self._clock_around[0])
        # J grad H has the slopes in p first, then minus those in q.
        dof = len(slopes) // 2
        slopes = slopes[dof:] + slopes[:dof]
        return sum((abs(s) * w for s, w in zip(slopes, widths, strict=True)), arb(0)).upper()


def _series(polynomials: Sequence[arb_poly]) -> list[arb_series]:
    return [arb_series(polynomial.coeffs()[: ctx.cap]) for polynomial in polynomials]


@dataclass(frozen=True)
class Quantity:
    """A function of time whose largest magnitude is wanted.

    Attributes
    ----------
    name : str
    polynomial : callable
        Expansion -> its polynomial, or that of its square.
    slack : callable
        Expansion -> how far the quantity can be from the polynomial.
    squared : bool
    floor : float
        A difference between upper and lower bound that is small enough whatever they are.
    """

    name: str
    polynomial: Callable[[Expansion], arb_poly]
    slack: Callable[[Expansion], arb]
    squared: bool
    floor: float


class Leaf:
    """A part of a piece, and bounds on one quantity there."""

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
        #: About what the upper bound would be if the balls were points; steers the refinement.
        self.middle = above(middle + slack)
        self.lower = max(0.0, below(lower - slack))

    def __lt__(self, other: Leaf) -> bool:
        return self.upper > other.upper


@dataclass(frozen=True)
class Range:
    """Proven bounds on the largest magnitude of a quantity, and the pieces that prove it."""

    upper: float
    lower: float
    leaves: list[Leaf]


@dataclass(frozen=True)
class Goal:
    """When the bounds on a quantity are good enough.

    Attributes
    ----------
    rtol : float
        Upper and lower bound this close, relative to the lower one; without effect where there
        are claims.
    claims : (float, float), optional
        An upper and a lower bound that are to be proven.
    """

    rtol: float
    claims: tuple[float, float] | None = None

    def allowed(self, lower: float, floor: float) -> float:
        """How large an upper bound may be."""
        if self.claims is not None:
            return self.claims[0]
        return max(lower * (1 + self.rtol), lower + floor)

    def met(self, upper: float, lower: float, floor: float) -> bool:
        """Whether to stop.

        Raises
        ------
        CertificationError
            If a claim is refuted.
        """
        if self.claims is None:
            return upper <= self.allowed(lower, floor)
        claimed_upper, claimed_lower = self.claims
        if not lower <= claimed_upper or not upper >= claimed_lower:
            raise CertificationError("refuted")
        return upper <= claimed_upper and lower >= claimed_lower


class Comparison:
    """Bounds on what a trial solution is off by, from a validated reference.

    Parameters
    ----------
    H : Enclosures
    z0 : numpy.ndarray
        Where the true solution starts.
    parts : list of Segment
    reference : Reference
    deadline : Deadline
    """

    def __init__(
        self,
        H: Enclosures,
        z0: np.ndarray,
        parts: list[Segment],
        reference: Reference,
        deadline: Deadline,
    ) -> None:
        self.H, self.reference = H, reference
        self._deadline = deadline
        self._total = reference.steps[-1].end
        with working(reference.bits, _ORDER + 2):
            if not H.time_dependent:
                start = ball(Fraction(reference.start))
                self.energy_0 = H.energy([arb(float(value)) for value in z0], start)
            self._pieces = []
            overlaps = self._overlaps(parts)
            if len(overlaps) > MOST_LEAVES:
                raise CertificationError(
                    f"the proof has more than {MOST_LEAVES} parts; solve on a shorter span, or to "
                    "a looser tolerance"
                )
            for segment, step, low, high in overlaps:
                deadline.check("the solution was enclosed")
                middle, half = (low + high) / 2, (high - low) / 2
                self._pieces.append(Expansion(self, segment, step, middle, half))

    def _overlaps(
        self, parts: list[Segment]
    ) -> list[tuple[Segment, ReferenceStep, Fraction, Fraction]]:
        """The common intervals of the smooth parts and the steps of the reference."""
        found = []
        place, steps = 0, self.reference.steps
        for segment in parts:
            while True:
                step = steps[place]
                low, high = max(segment.start, step.start), min(segment.end, step.end)
                if low < high:
                    found.append((segment, step, low, high))
                if step.end > segment.end or place == len(steps) - 1:
                    break
                place += 1
        return found

    # -- quantities --------------------------------------------------------------------------

    def quantities(self, floors: dict[str, np.ndarray]) -> list[Quantity]:
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

    # -- refinement --------------------------------------------------------------------------

    def leaves(self, quantity: Quantity, known: list[Leaf] | None = None) -> list[Leaf]:
        """Pieces that cover the span: those at first, or those that another quantity has left."""
        if known is None:
            places = [(piece, piece.centre, piece.half) for piece in self._pieces]
        else:
            places = [(leaf.expansion, leaf.centre, leaf.half) for leaf in known]
        with working(self.reference.bits, _ORDER + 2):
            return [self._leaf(quantity, *place) for place in places]

    def cut(
        self, quantity: Quantity, leaves: Sequence[Leaf], low: Fraction, high: Fraction
    ) -> list[Leaf]:
        """Leaves without what is outside [low, high].

        What is left of a leaf may be a sliver: its bound would be that of a wide expansion, and as
        it is too narrow to be halved it would keep it. So it gets an expansion of its own.
        """
        found = []
        with working(self.reference.bits, _ORDER + 2):
            for leaf in leaves:
                start, end = max(leaf.start, low), min(leaf.end, high)
                if (start, end) == (leaf.start, leaf.end):
                    found.append(leaf)
                elif start < end:
                    centre, half = (start + end) / 2, (end - start) / 2
                    expansion = leaf.expansion
                    if half * _MOST_SHIFTS <= expansion.half:
                        expansion = Expansion(self, expansion.segment, expansion.step, centre, half)
                    found.append(self._leaf(quantity, expansion, centre, half))
        return found

    def refine(self, quantity: Quantity, leaves: list[Leaf], goal: Goal) -> Range:
        """Bounds on the largest magnitude over time.

        Raises
        ------
        PrecisionError
            If the reference is not accurate enough for the goal.
        CertificationError
            If a claim is refuted, or time runs out.
        """
        heap, lower = list(leaves), max(leaf.lower for leaf in leaves)
        heapq.heapify(heap)
        narrowest = self._total * Fraction(_NARROWEST)
        with working(self.reference.bits, _ORDER + 2):
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
        half = leaf.half / 2
        # The radii of the balls keep the bound up, not the polynomial: a new expansion is needed.
        # The same if shifting has narrowed the piece without end in sight.
        fat = (
            not leaf.upper - leaf.middle <= (leaf.upper - allowed) / 2
            or leaf.half * _MOST_SHIFTS <= leaf.expansion.half
        )
        found = []
        for side in (-1, 1):
            centre, expansion = leaf.centre + side * half, leaf.expansion
            if fat:
                expansion = Expansion(self, expansion.segment, expansion.step, centre, half)
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


def _squares(polynomials: Sequence[arb_poly]) -> arb_poly:
    return sum((polynomial * polynomial for polynomial in polynomials), arb_poly([0]))


def joints_of(leaves: Sequence[Leaf]) -> list[Fraction]:
    """Elapsed times inside the span at which one expansion follows another."""
    ordered = sorted(leaves, key=lambda leaf: leaf.centre)
    return [
        after.start
        for before, after in pairwise(ordered)
        if before.expansion is not after.expansion
    ]
