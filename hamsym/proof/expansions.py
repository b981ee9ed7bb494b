"""Taylor expansions of a trial solution minus the exact solution, on pieces of elapsed time.

Let z^ be a trial solution (:mod:`hamsym.proof.trials`), y a polynomial with |z - y| <= eps in units
u (:mod:`hamsym.proof.taylor`). On a piece [c - w, c + w] of elapsed time that lies in one smooth
part of z^ and in one step of y:

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
3. *Exact solution.* |z_i - y_i| <= u_i eps, and |z - y| <= max_i u_i eps in the 2-norm. Upper
   bounds grow, lower bounds shrink by that. The residual does not involve z. If H does not depend
   on time, H(z(t)) = H(z0) exactly. Otherwise H(z^) - H(y) is expanded, and by the mean value
   theorem |H(z) - H(y)| <= sum_i sup |dH/dz_i| u_i eps, the supremum over the range of y on the
   piece widened by u_i eps.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property

import numpy as np
from flint import arb, arb_poly, arb_series, ctx

from hamsym.proof.balls import ball, interval, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.segments import Segment
from hamsym.proof.taylor import EnclosureStep, SolutionEnclosure, coefficient

__all__ = ["ORDER", "Expansion", "TrialError", "overlaps"]

ORDER = 10  # of the expansions


class TrialError:
    """The trial solution minus the exact solution.

    Attributes
    ----------
    H : Enclosures
    solution : SolutionEnclosure
        The exact solution.
    energy_0 : arb or None
        H at the start, if H is conserved.
    """

    def __init__(self, H: Enclosures, z0: np.ndarray, solution: SolutionEnclosure) -> None:
        self.H, self.solution = H, solution
        self.energy_0: arb | None = None
        if H.conserved:
            start = ball(Fraction(solution.start))
            self.energy_0 = H.energy([arb(float(value)) for value in z0], start)


class Expansion:
    """Expansions of the error, the residual and the energy error on a piece of elapsed time.

    Attributes
    ----------
    centre, half : fractions.Fraction
        The piece is [centre - half, centre + half].
    """

    def __init__(
        self,
        error: TrialError,
        segment: Segment,
        step: EnclosureStep,
        centre: Fraction,
        half: Fraction,
    ) -> None:
        self._error, self._segment, self.step = error, segment, step
        self.centre, self.half = centre, half
        solution = error.solution
        self._exact = segment.series(centre, Fraction(0), ORDER + 1)
        self._around = segment.series(centre, half, ORDER + 2)
        place = ball(centre - step.start)
        spread = interval(centre - half - step.start, centre + half - step.start)
        at_centre, around = arb_poly([place, 1]), arb_poly([spread, 1])
        self._true_exact = [polynomial(at_centre) for polynomial in step.polynomials]
        self._true_around = [polynomial(around) for polynomial in step.polynomials]
        start, direction = ball(Fraction(solution.start)), solution.direction
        with working(ctx.prec, ORDER + 2):
            self._clock = arb_series([start + direction * ball(centre), direction])
            times = interval(centre - half, centre + half)
            self._clock_around = arb_series([start + direction * times, direction])

    def narrowed(self, centre: Fraction, half: Fraction) -> Expansion:
        """A new expansion on a part of the piece."""
        return Expansion(self._error, self._segment, self.step, centre, half)

    @cached_property
    def errors(self) -> list[arb_poly]:
        """z^_i - y_i in the time since the centre, for each component."""
        return [
            arb_poly([a[k] - b[k] for k in range(ORDER + 1)] + [A[ORDER + 1] - B[ORDER + 1]])
            for a, b, A, B in zip(
                self._exact, self._true_exact, self._around, self._true_around, strict=True
            )
        ]

    @cached_property
    def residuals(self) -> list[arb_poly]:
        """sigma (dz^/dt - J grad H(z^, t)) for each component."""
        H, direction = self._error.H, self._error.solution.direction
        with working(ctx.prec, ORDER + 2):
            exact = H.vector_field(self._exact, self._clock)
            around = H.vector_field(self._around, self._clock_around)
        return [
            arb_poly(
                [(k + 1) * a[k + 1] - direction * coefficient(f, k) for k in range(ORDER)]
                + [(ORDER + 1) * A[ORDER + 1] - direction * coefficient(F, ORDER)]
            )
            for a, f, A, F in zip(self._exact, exact, self._around, around, strict=True)
        ]

    @cached_property
    def energy(self) -> arb_poly:
        """H(z^, t) - H(y, t), or H(z^) - H(z0) if H is conserved."""
        H = self._error.H
        with working(ctx.prec, ORDER + 2):
            value = H.energy(self._exact, self._clock)
            rest = H.energy(self._around, self._clock_around)
            if not H.conserved:
                value -= H.energy(_series(self._true_exact), self._clock)
                rest -= H.energy(_series(self._true_around), self._clock_around)
            else:
                value -= self._error.energy_0
        return arb_poly(
            [coefficient(value, k) for k in range(ORDER + 1)] + [coefficient(rest, ORDER + 1)]
        )

    @cached_property
    def energy_slack(self) -> arb:
        """A bound on |H(z) - H(y)|."""
        if self._error.H.conserved:
            return arb(0)
        H = self._error.H
        widths = self.step.widths
        state = [
            polynomial[0] + width * arb(0, 1)
            for polynomial, width in zip(self._true_around, widths, strict=True)
        ]
        H.energy(state, self._clock_around[0])  # finite: H is smooth between z and y
        slopes = H.gradient(state, self._clock_around[0])
        return sum((abs(s) * w for s, w in zip(slopes, widths, strict=True)), arb(0)).upper()


def _series(polynomials: Sequence[arb_poly]) -> list[arb_series]:
    return [arb_series(polynomial.coeffs()[: ctx.cap]) for polynomial in polynomials]


def overlaps(
    parts: Sequence[Segment], steps: Sequence[EnclosureStep]
) -> list[tuple[Segment, EnclosureStep, Fraction, Fraction]]:
    """The common intervals (low, high) of smooth parts and steps, in order."""
    found, place = [], 0
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
