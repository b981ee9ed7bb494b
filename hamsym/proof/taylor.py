"""Validated Taylor integration: polynomials with a proven distance to the exact solution.

The initial state, the span and the parameters are exact float64 numbers. Everything runs in elapsed
time s >= 0, t = t_0 + sigma s with sigma = +-1 the direction of the span, so that the equation is
dz/ds = G(s, z) = sigma J grad H(z, t).

**The claim.** On each step [a, a + h] there are polynomials y with exact binary coefficients and a
number eps such that the solution z exists there and |z(s) - y(s - a)| <= eps, in the norm
|v|^2 = sum_i (v_i / u_i)^2 with powers of two u_i, the units, that are the same throughout a step.

**The proof of a step.** Suppose |z(a) - y(0)| <= eps_0.

1. *Coefficients.* c_0 = y(0), c_k+1 the middle of the ball sigma F_k / (k + 1), with F_k the ball
   of the Taylor coefficient of s -> J grad H(c_0 + .. + c_k s^k, t). Whatever they are, y is the
   polynomial sum_k<=n c_k s^k with these exact coefficients: nothing is proven by this step.
2. *Defect.* Let r(s) = y'(s) - G(s, y(s)), for each component. G depends on no more than
   c_0 .. c_k in its k-th coefficient, so that the balls (k + 1) c_k+1 - sigma F_k of step 1 hold
   the coefficients r_k of r at 0 for all k < n. By Taylor's theorem with Lagrange's remainder

       |r_i(s)| <= sum_k<n |r_k,i| h^k + |R_i| h^n =: d_i   for 0 <= s <= h,

   where R_i holds the n-th coefficients of the series of G along y(xi + s), xi each of a few balls
   that cover [0, h] (y' has none of this order). d = (sum_i (d_i / u_i)^2)^(1/2).
3. *Tube.* Let rho > 0, and let B_j hold y(s) + v for all s in the j-th part of [0, h] and all
   |v| <= rho: the range of y there, widened by rho u_i. H, G and DG have finite balls over B_j; the
   functions that have them are analytic where they do, so that none of the three jumps in B_j. Let
   m_j >= 0 bound the eigenvalues of the symmetric part of U^-1 DG U over B_j, U = diag(u), by
   Gershgorin's circles:

       m_j >= max_i ( A_ii + sum_k!=i |A_ik + A_ki| / 2 ),  A = U^-1 DG U over B_j, entry by entry.

4. *Growth.* e = z - y obeys e' = G(y + e) - G(y) - r = A(s) e - r with A(s) the mean of DG over the
   segment from y to y + e, which is in B_j as long as |e| <= rho, because a ball is convex. The
   entries of A(s) are in those of step 3, so that (d/ds)|e| <= m_j |e| + d wherever |e| > 0, in the
   sense of the upper right derivative, and by Gronwall's inequality on each part, of length h_j,

       |e| <= exp(m_j h_j) (eps_j + h_j d) =: eps_j+1,

   as m_j >= 0. This holds until |e| reaches rho. If all eps_j < rho it never does: at the first
   time with |e| = rho the bound would still hold, a contradiction. The same bound keeps z in a
   compact set on which G is smooth, so that z exists until the end of the step.
5. *Next start.* y(0) of the next step is the middle of a ball that holds y(h); eps_0 there is the
   last eps_j plus the distance of that middle. In new units u' a vector is at most
   max_i u_i / u'_i times as long as before, and so is eps_0.

The largest eps of a step holds for all of it. If eps exceeds rho, the remedy is precision: a system
whose errors grow by 2^k needs k more bits. Bits are cheap, so this module needs no coordinates that
rotate with the flow.

Step sizes, units and precision are heuristic floating-point numbers; the proof does not depend on
them.

References: Lohner 1992; Nedialkov, Jackson & Corliss 1999; Soderlind 2006 (logarithmic norms);
Johansson 2017 (Arb).
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from flint import arb, arb_poly, arb_series, ctx

from hamsym.errors import CertificationError
from hamsym.proof.balls import above, ball, binary_logarithm, interval, working
from hamsym.proof.enclosures import Enclosures
from hamsym.proof.functions import SingularityError
from hamsym.proof.limits import Deadline, PrecisionError

__all__ = ["EnclosureStep", "SolutionEnclosure", "coefficient", "enclose_solution"]

_TUBE = -40  # log2 of the largest radius rho, in units
_PARTS, _FINE_PARTS = 4, 8  # subintervals of a step for the remainder, and for the growth
_NEARBY = -10  # log2 of the distance in which singularities are searched for, in units
_ESCAPED = 2.0**20  # size of the state, in units, that counts as an escape to infinity
_SHORTEST = 2.0**-36  # step, relative to the span
_TRIES = 60  # lengths of one step


@dataclass(frozen=True)
class EnclosureStep:
    """A polynomial and its distance from the exact solution, on one interval of elapsed time.

    Attributes
    ----------
    start, length : fractions.Fraction
        Elapsed time.
    polynomials : tuple of arb_poly
        One for each component, in the time since the start of the step; exact coefficients.
    radius : arb
        Bound on the distance of the solution, in the units (2-norm); exact.
    units : tuple of arb
        Powers of two.
    """

    start: Fraction
    length: Fraction
    polynomials: tuple[arb_poly, ...]
    radius: arb
    units: tuple[arb, ...]

    @property
    def widths(self) -> list[arb]:
        """Bounds on the distance of the solution in each component."""
        return [(unit * self.radius).upper() for unit in self.units]

    @property
    def end(self) -> Fraction:
        return self.start + self.length


@dataclass(frozen=True)
class SolutionEnclosure:
    """An enclosure of the exact solution over a span.

    Attributes
    ----------
    steps : tuple of EnclosureStep
        Consecutive steps that cover the span.
    bits : int
        Working precision.
    start : float
        t at elapsed time 0.
    direction : int
        +1, or -1 for a span that runs backwards.
    """

    steps: tuple[EnclosureStep, ...]
    bits: int
    start: float
    direction: int

    def accuracy(self, scales: Sequence[float]) -> float:
        """The largest bound on the distance of the solution, relative to scales of components."""
        ratios = np.array(
            [
                above(width) / scale
                for step in self.steps
                for width, scale in zip(step.widths, scales, strict=True)
            ]
        )
        return float(ratios.max())  # NaN if one is

    def __call__(self, t: float) -> list[arb]:
        """Balls that contain the exact state at time t, dim of them."""
        elapsed = (Fraction(t) - Fraction(self.start)) * self.direction
        step = next((step for step in self.steps if step.start <= elapsed <= step.end), None)
        if step is None:
            raise ValueError(f"t = {t} is outside the span")
        with working(self.bits):
            s = ball(elapsed - step.start)
            return [
                polynomial(s) + width * arb(0, 1)
                for polynomial, width in zip(step.polynomials, step.widths, strict=True)
            ]


def enclose_solution(
    H: Enclosures,
    z0: np.ndarray,
    span: tuple[float, float],
    units: Sequence[tuple[float, Sequence[float]]],
    bits: int,
    deadline: Deadline,
    progress: Callable[[float], None] | None = None,
) -> SolutionEnclosure:
    """Enclose the exact solution from z0 over a span.

    Parameters
    ----------
    H : Enclosures
    z0 : numpy.ndarray
        Shape (dim,); exact.
    span : (float, float)
        Exact.
    units : sequence of (float, sequence of float)
        Elapsed times, the first of which is 0, and the units of errors from there on, powers of
        two.
    bits : int
        Working precision.
    deadline : Deadline
    progress : callable, optional
        Called with the completed share of the span.

    Raises
    ------
    PrecisionError
        If more bits would help.
    CertificationError
        If the enclosure ends before the span, with the time, the reason and the remedy.
    """
    equation = _ElapsedEquation(H, span)
    stepper = _TaylorStepper(equation, units, bits, deadline)
    start, radius = [arb(float(value)) for value in z0], arb(0)
    steps: list[EnclosureStep] = []
    elapsed, total = Fraction(0), equation.total
    with working(bits, stepper.order + 1):
        while elapsed < total:
            step, start, radius = stepper.step(elapsed, start, radius)
            steps.append(step)
            elapsed = step.end
            if progress:
                progress(float(elapsed / total))
    return SolutionEnclosure(tuple(steps), bits, span[0], equation.direction)


class _ElapsedEquation:
    """Hamilton's equations in elapsed time, dz/ds = G(s, z).

    Attributes
    ----------
    H : Enclosures
    total : fractions.Fraction
        Elapsed time at the end of the span.
    direction : int
        sigma.
    """

    def __init__(self, H: Enclosures, span: tuple[float, float]) -> None:
        self.H = H
        start, end = (Fraction(float(time)) for time in span)
        self._start, self.total = start, abs(end - start)
        self.direction = 1 if end > start else -1

    def time(self, elapsed: Fraction) -> float:
        """t at an elapsed time, rounded."""
        return float(self._start + self.direction * elapsed)

    def clock(self, elapsed: arb) -> arb:
        """A ball of t for a ball of elapsed time."""
        return ball(self._start) + self.direction * elapsed

    def coefficients(
        self, elapsed: Fraction, start: list[arb], order: int, check: Callable[[], None]
    ) -> tuple[list[list[arb]], list[list[arb]]]:
        """Exact Taylor coefficients c_k of each component, and balls of the defect's, r_k."""
        coefficients = [[value] for value in start]
        defects: list[list[arb]] = [[] for _ in start]
        clock = [self.clock(ball(elapsed)), arb(self.direction)]
        for k in range(order):
            check()
            ctx.cap = k + 1
            series = [arb_series(known) for known in coefficients]
            rates = self.H.vector_field(series, arb_series(clock))
            for known, defect, rate in zip(coefficients, defects, rates, strict=True):
                slope = self.direction * coefficient(rate, k)
                known.append((slope / (k + 1)).mid())
                defect.append((k + 1) * known[-1] - slope)
        ctx.cap = order + 1
        if not all(value.is_finite() for known in coefficients for value in known):
            raise SingularityError("")
        return coefficients, defects

    def remainders(
        self, elapsed: Fraction, length: Fraction, coefficients: list[list[arb]]
    ) -> list[arb]:
        """Bounds on |R_i|, the last Taylor coefficients of G along y over the step."""
        order = len(coefficients[0]) - 1
        polynomials = [arb_poly(known) for known in coefficients]
        bounds = [arb(0) for _ in coefficients]
        for j in range(_PARTS):
            inside = interval(j * length / _PARTS, (j + 1) * length / _PARTS)
            shifted = arb_poly([inside, 1])
            series = [arb_series(polynomial(shifted).coeffs()) for polynomial in polynomials]
            clock = arb_series([self.clock(ball(elapsed) + inside), self.direction])
            for i, rate in enumerate(self.H.vector_field(series, clock)):
                bounds[i] = bounds[i].max(abs(coefficient(rate, order)))
        return bounds

    def logarithmic_norm(self, state: list[arb], clock: arb, units: Sequence[arb]) -> arb:
        """m >= 0, a bound on the eigenvalues of the symmetric part of U^-1 DG U."""
        dim = len(state)
        rows = [[arb(0)] * dim for _ in range(dim)]
        for (i, j), entry in self.H.jacobian(state, clock).items():
            rows[i][j] = self.direction * (entry * (units[j] / units[i]))
        largest = arb(0)
        for i in range(dim):
            circle = rows[i][i]
            for j in range(dim):
                if j != i:
                    circle += abs(rows[i][j] + rows[j][i]) / 2
            largest = largest.max(circle)
        return largest.upper()


class _TaylorStepper:
    """Steps of the enclosure: length, defect, tube and growth of the error.

    Attributes
    ----------
    order : int
        Degree n of the polynomials.
    """

    def __init__(
        self,
        equation: _ElapsedEquation,
        units: Sequence[tuple[float, Sequence[float]]],
        bits: int,
        deadline: Deadline,
    ) -> None:
        self._equation, self._bits, self._deadline = equation, bits, deadline
        self.order = max(24, round(0.3 * (bits - 16)))
        self._schedule = [(since, [arb(unit) for unit in sizes]) for since, sizes in units]
        self._units = self._schedule.pop(0)[1]
        self._previous: Fraction | None = None

    def step(
        self, elapsed: Fraction, start: list[arb], radius: arb
    ) -> tuple[EnclosureStep, list[arb], arb]:
        """One step, the exact start of the next, and its distance from the solution."""
        radius = self._in_present_units(elapsed, radius)
        time = self._equation.time(elapsed)
        stage = f"the solution was enclosed, at t = {time:.6g}"
        try:
            coefficients, defects = self._equation.coefficients(
                elapsed, start, self.order, lambda: self._deadline.check(stage)
            )
        except SingularityError as error:
            raise _ended(time, str(error)) from None
        length, reason, crowded = self._guess(elapsed, coefficients), "", False
        for _ in range(_TRIES):
            if length < self._equation.total * Fraction(_SHORTEST):
                break
            try:
                defect = self._defect(elapsed, length, coefficients, defects)
                if defect * ball(length) < arb(2) ** (36 - self._bits):
                    # Rounding inside the middle of the next start is far below this.
                    tube = self._tube(ball(length) * defect + radius)
                    grown = self._growth(elapsed, length, coefficients, defect, radius, tube)
                    if grown < tube:
                        return self._accepted(elapsed, length, coefficients, grown)
                    crowded = True
            except SingularityError as error:
                reason = str(error)
            length = _short(length * Fraction(3, 5))
        if self._size(start) > _ESCAPED:
            raise CertificationError(
                f"no bound beyond t = {time:.6g}: the solution escapes to infinity; use an earlier "
                "end time"
            )
        if crowded and not reason:
            raise PrecisionError(elapsed)
        raise _ended(time, reason or self._nearby(elapsed, start))

    def _in_present_units(self, elapsed: Fraction, radius: arb) -> arb:
        """Change to the units of an elapsed time; the radius in these units."""
        while self._schedule and self._schedule[0][0] <= elapsed:
            before, self._units = self._units, self._schedule.pop(0)[1]
            ratios = [old / new for old, new in zip(before, self._units, strict=True)]
            radius = (radius * functools.reduce(arb.max, ratios)).upper()
        return radius

    def _nearby(self, elapsed: Fraction, start: list[arb]) -> str:
        """A subexpression that is not smooth at some point near the state, or an empty text."""
        for size in range(-40, _NEARBY):
            width = arb(2) ** size * arb(0, 1)
            state = [value + width * unit for value, unit in zip(start, self._units, strict=True)]
            try:
                self._equation.H.jacobian(state, self._equation.clock(ball(elapsed)))
            except SingularityError as error:
                return str(error)
        return ""

    def _size(self, state: Sequence[arb]) -> float:
        return max(above(abs(value) / unit) for value, unit in zip(state, self._units, strict=True))

    def _guess(self, elapsed: Fraction, coefficients: list[list[arb]]) -> Fraction:
        """A length for which the last terms are about as small as the rounding errors."""
        total = self._equation.total
        left = total - elapsed
        # The total may be beyond the range of floats.
        longest = math.log2(total.numerator) - math.log2(total.denominator) - 2
        for known, unit in zip(coefficients, self._units, strict=True):
            for k in (self.order - 1, self.order):
                size = binary_logarithm(known[k]) - binary_logarithm(unit)
                if size > -math.inf:
                    longest = min(longest, (16 - self._bits - size) / k)
        length = _short(Fraction(2) ** math.floor(longest) * Fraction(2 ** (longest % 1)))
        if self._previous is not None:
            length = min(length, 4 * self._previous)
        if length >= left:
            return left
        return length if 2 * length < left else _short(left / 2)

    def _defect(
        self,
        elapsed: Fraction,
        length: Fraction,
        coefficients: list[list[arb]],
        defects: list[list[arb]],
    ) -> arb:
        """d, a bound on the defect |y' - G(y)| over the step, in units per time."""
        bounds = self._equation.remainders(elapsed, length, coefficients)
        h, total = ball(length), arb(0)
        for bound, known, unit in zip(bounds, defects, self._units, strict=True):
            for value in reversed(known):
                bound = bound * h + abs(value)
            total += _square(bound.upper() / unit)
        return total.upper().sqrt().upper()

    def _tube(self, radius: arb) -> arb:
        """rho: room for a growth by 2^8 in one step, limited to 2^-40 units.

        Positive even for an exact start, because errors must stay below it.
        """
        room = (radius * 2**8).upper() + arb(2) ** (-2 * self._bits)
        return room.min(arb(2) ** _TUBE).mid()

    def _growth(
        self,
        elapsed: Fraction,
        length: Fraction,
        coefficients: list[list[arb]],
        defect: arb,
        radius: arb,
        tube: arb,
    ) -> arb:
        """The distance from the solution after the step, valid if it is below the tube."""
        part = length / _FINE_PARTS
        duration = ball(part)
        polynomials = [arb_poly(known) for known in coefficients]
        for j in range(_FINE_PARTS):
            middle, half = ball((2 * j + 1) * part / 2), ball(part / 2) * arb(0, 1)
            around = arb_poly([middle, 1])
            state = [
                polynomial(around)(half) + tube * unit * arb(0, 1)
                for polynomial, unit in zip(polynomials, self._units, strict=True)
            ]
            clock = self._equation.clock(ball(elapsed) + middle + half)
            # Finite balls prove that H and G are smooth throughout, not only DG.
            self._equation.H.energy(state, clock)
            self._equation.H.vector_field(state, clock)
            rate = self._equation.logarithmic_norm(state, clock, self._units)
            radius = ((rate * duration).exp() * (radius + duration * defect)).upper()
        return radius

    def _accepted(
        self, elapsed: Fraction, length: Fraction, coefficients: list[list[arb]], radius: arb
    ) -> tuple[EnclosureStep, list[arb], arb]:
        """The finished step, the exact start of the next, and its distance from the solution."""
        polynomials = tuple(arb_poly(known) for known in coefficients)
        reached = [polynomial(ball(length)) for polynomial in polynomials]
        if not all(value.is_finite() for value in reached):
            raise PrecisionError(elapsed)
        start = [value.mid() for value in reached]
        moved = sum(
            (
                _square((value - middle).abs_upper() / unit)
                for value, middle, unit in zip(reached, start, self._units, strict=True)
            ),
            arb(0),
        )
        self._previous = length
        step = EnclosureStep(elapsed, length, polynomials, radius, tuple(self._units))
        return step, start, (radius + moved.upper().sqrt()).upper()


def coefficient(series: arb | arb_series, k: int) -> arb:
    """The k-th Taylor coefficient of a series, or of a constant."""
    if isinstance(series, arb):
        return series if k == 0 else arb(0)
    return series[k]


def _square(value: arb) -> arb:
    return value * value


def _short(length: Fraction) -> Fraction:
    """The next smaller number of six bits; sums of such lengths have few bits, too."""
    shift = length.numerator.bit_length() - length.denominator.bit_length() - 6
    scale = Fraction(2) ** shift
    return (length // scale) * scale


def _ended(time: float, reason: str) -> CertificationError:
    found = f"'{reason}' is not smooth there" if reason else "near-collision or escape to infinity"
    return CertificationError(f"no bound beyond t = {time:.6g}: {found}; use an earlier end time")
