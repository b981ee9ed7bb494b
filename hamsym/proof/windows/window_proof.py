"""Two-sided bounds on the error of a trial solution, from enclosures on windows.

On each window of :mod:`hamsym.proof.windows.proven_windows`, z = y + (a set of known size), and z^
is a Chebyshev model (:mod:`hamsym.proof.windows.trial_models`). So z^ - y, H(z^) - H and dz^/dt - J
grad H(z^) are models, too, formed in twice float64: P with |f - P| <= R.

Lemmas 23 to 25 of examples/guide/how_proofs_work.md bound their largest values from both sides.
"""

from __future__ import annotations

import functools
import math
from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np
from flint import arb

from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.balls import SMALLEST, above, at_least, at_most, number_of, working
from hamsym.proof.arithmetic.directed import TINY, UNIT, down, two_sum, up
from hamsym.proof.arithmetic.programs import BITS, ModelRows, Rows
from hamsym.proof.limits import Deadline, TimeLimitError
from hamsym.proof.windows.certificate import FLOOR, Certificate
from hamsym.proof.windows.equation import Equation, equation_of
from hamsym.proof.windows.followed_march import follow
from hamsym.proof.windows.proven_windows import WindowStepper
from hamsym.proof.windows.trial_models import Piece, trial_pieces, zero_components
from hamsym.proof.windows.window_sets import Window, set_sizes
from hamsym.random_features.trial import FeatureTrial
from hamsym.solution.solution import Solution

_TERMS = 64  # of models of z^
# Accuracy of the enclosure, terms of its polynomials and least number of windows of attempts.
_ATTEMPTS = ((2.0**-70, 32, 8), (2.0**-86, 48, 8))
_OF_NETWORKS = (2.0**-70, 32, 64)  # which vary in a window of the motion
_FLOOR_WITHOUT_SOLUTION = 2.0**-70  # floor of quantities that do not involve the exact solution
_WITHIN = 1 - 1e-6  # of a bound that is asked for: certificates round theirs up to nine digits
_MOST_SAMPLES = 16_384  # of a window
_OF_MARCHES = 128  # samples of windows that are those of a march
_FINE = 0.02  # rtol that every verification tries


@dataclass(frozen=True, eq=False)
class WindowBounds:
    """Proven bounds on largest magnitudes over the span."""

    #: uppers, lowers: Of the 2-norm of the error, its components, the energy error and the
    #: residual, shape (dim + 3,).
    uppers: np.ndarray
    lowers: np.ndarray
    #: Differences of upper and lower bounds that are always small enough, shape (dim + 3,).
    floors: np.ndarray
    #: start, direction: Time and sign of the span.
    start: Fraction
    direction: int
    #: Ends of the windows in elapsed time.
    edges: tuple[Fraction, ...]
    #: Upper bounds on the 2-norm of the error in each window.
    pieces: tuple[float, ...]

    def time(self, elapsed: Fraction) -> Fraction:
        """t at an elapsed time."""
        return self.start + self.direction * elapsed

    def bounds_between(self, times: Sequence[float]) -> list[float]:
        """Bounds on the error between times in the direction of the span."""
        found, first = [], 0
        places = [self.direction * (Fraction(time) - self.start) for time in times]
        for low, high in pairwise(places):
            while self.edges[first + 1] <= low:
                first += 1
            last = first
            while last + 1 < len(self.pieces) and self.edges[last + 1] < high:
                last += 1
            found.append(max(self.pieces[first : last + 1]))
        return found

    def decides(self, asked: Sequence[float]) -> bool:
        """Whether the errors are as small as asked, or one of them is larger."""
        allowed = np.asarray(asked)
        within = (self.uppers[1:-2] <= allowed * _WITHIN).all()
        return bool(within or (self.lowers[1:-2] > allowed).any())

    def close(self, rtol: float) -> np.ndarray:
        """Whether each upper bound is as close to the lower one as required, shape (dim + 3,)."""
        allowed = np.maximum(self.lowers * (1 + rtol), self.lowers + self.floors)
        return np.asarray(self.uppers <= allowed)


class WindowProof:
    """Bounds on the error of one solution.

    - progress: Called with the completed share of the span.
    """

    def __init__(
        self,
        solution: Solution,
        deadline: Deadline,
        progress: Callable[[float], None] | None = None,
    ) -> None:
        self._solution, self._deadline, self._progress = solution, deadline, progress
        self._begin, end = (Fraction(float(value)) for value in solution.span)
        self._direction = 1 if end > self._begin else -1
        self._total = abs(end - self._begin)
        self._equation = equation_of(solution.H)
        self._pieces = trial_pieces(solution.trial, solution.span)
        # Rows of the bounds whose errors are exactly zero.
        self._exact = [1 + i for i in self._equation.resting(zero_components(solution.trial))]

    def bounds(self, rtol: float, asked: Sequence[float] | None) -> WindowBounds:
        """Bounds that are as close as required, or decide whether errors are as small as asked.

        Raise CertificationError if there are none.
        """
        samples = _samples(rtol if asked is None else 1.0)
        if asked is not None and (quick := self._followed()) and quick.decides(asked):
            return quick
        failure: CertificationError | None = None
        partial: WindowBounds | None = None
        for accuracy, terms, fewest in self._attempts:
            try:
                times = self._inner_times(fewest)
                found = self._found(accuracy, terms, samples, times, asked is None)
            except TimeLimitError as error:
                raise failure or error from None  # a reason says more than the limit
            except CertificationError as error:
                failure = error
                continue
            if asked is not None:
                if found.decides(asked):
                    return found
            else:
                close = found.close(rtol * (1 - 1e-4))
                if close.all():
                    return found
                if (close | np.isinf(found.uppers)).all():  # H is singular along z^
                    partial = found
        if partial:
            return partial
        raise failure or CertificationError("the bounds are not close enough")

    @property
    def _attempts(self) -> list[tuple[float, int, int]]:
        few = len(self._pieces) < _OF_NETWORKS[2]
        networks = not isinstance(self._solution.trial, FeatureTrial)
        return [*_ATTEMPTS, _OF_NETWORKS] if few and networks else list(_ATTEMPTS)

    def _inner_times(self, fewest: int) -> list[float]:
        """Times at which windows end, so that there are so many at least."""
        if len(self._pieces) >= fewest:
            return []
        total = self._direction * self._total
        return [float(self._begin + total * k / fewest) for k in range(1, fewest)]

    def require(self, claims: Certificate) -> None:
        """Prove every claim of a certificate.

        Raise CertificationError if a claim is not proven, naming the first one, or if there are no
        bounds.
        """
        uppers = [claims.bound, *claims.component_bounds, claims.energy_bound, claims.ell_max_bound]
        lowers = [claims.lower, *claims.component_lowers, claims.energy_lower, claims.ell_max_lower]
        high = np.array([at_most(value) for value in uppers])
        low = np.array([at_least(value) for value in lowers])
        claimed = np.array([at_most(value) for value in claims.piece_bounds])
        errors = [f"the error of {name}" for name in claims.components]
        names = ["the norm", *errors, "the energy", "ell_max", "the pieces"]
        if claims.asked is not None and (quick := self._followed()):
            pieces = np.array(quick.bounds_between(claims.edges))
            if ((quick.uppers <= high) & (quick.lowers >= low)).all() and (pieces <= claimed).all():
                return
        first_failure = ""
        whole = bool(np.isfinite(high[-2:]).any() or low[-2:].any())
        first = _samples(claims.rtol if claims.asked is None else 1.0)
        finer = max(first, _samples(_FINE))  # no claim depends on the rtol of the certificate
        attempts = [(*rest, n) for n in dict.fromkeys((first, finer)) for rest in self._attempts]
        for accuracy, terms, fewest, samples in attempts:
            times = [*claims.edges, *self._inner_times(fewest)]
            found = self._found(accuracy, terms, samples, times, whole)
            pieces = np.array(found.bounds_between(claims.edges))
            proven = [*((found.uppers <= high) & (found.lowers >= low)), (pieces <= claimed).all()]
            if all(proven):
                return
            first_failure = first_failure or names[proven.index(False)]
        raise CertificationError(
            f"the certificate does not hold: its claim about {first_failure} is not proven"
        )

    def _followed(self) -> WindowBounds | None:
        """Bounds by windows that are those of a march, if there are."""
        trial, dim = self._solution.trial, self._equation.dim
        if not isinstance(trial, FeatureTrial):
            return None
        edges = [self._pieces[0].start, *(piece.end for piece in self._pieces)]
        count = bisect_left(edges, self._total)
        if edges[0] != 0:
            return None
        uppers, lowers, norms = np.zeros(dim + 3), np.zeros(dim + 3), []
        for part in follow(self._equation, trial, count):
            time = float(self._begin + self._direction * edges[part.end])
            self._deadline.check(f"the solution was enclosed, at t = {time:.6g}")
            upper, lower = norm_and_parts(part.apart, part.radius, _OF_MARCHES)
            upper[:, self._exact] = lower[:, self._exact] = 0.0
            if not (np.isfinite(upper).all() and len(upper)):
                return None
            if part.end == count and edges[count] != self._total:
                lower[-1] = 0.0  # its largest error may be behind the span
            uppers[: dim + 1] = np.maximum(uppers[: dim + 1], upper.max(axis=0))
            lowers[: dim + 1] = np.maximum(lowers[: dim + 1], lower.max(axis=0))
            norms += upper[:, 0].tolist()
            if self._progress:
                self._progress(part.end / count)
        if len(norms) < count:
            return None
        uppers[-2:] = np.inf
        ends = *edges[:count], self._total
        floors = np.full(dim + 3, SMALLEST)
        return WindowBounds(
            uppers, lowers, floors, self._begin, self._direction, ends, tuple(norms)
        )

    def _found(
        self, accuracy: float, terms: int, samples: int, times: Sequence[float], whole: bool
    ) -> WindowBounds:
        """Bounds by an enclosure of some accuracy; no window contains one of the times.

        Times within a rounding of the ends of a piece of z^ count as these ends: certificates have
        them as float64 numbers, and no window is as short as a rounding.

        If not ``whole``, the energy error and the residual are not bounded.
        """
        equation, dim = self._equation, self._equation.dim
        stepper = WindowStepper(
            equation,
            self._begin,
            self._direction,
            self._total,
            self._solution.z0,
            np.zeros(dim),
            accuracy,
            self._deadline,
            terms,
        )
        comparison = _Comparison(equation, self._begin, self._direction, self._solution.z0, samples)
        inner = sorted(self._direction * (Fraction(time) - self._begin) for time in times)
        rounding = Fraction(np.spacing(max(map(abs, map(float, self._solution.span)))))
        uppers, lowers, scales = (np.zeros(dim + 3) for _ in range(3))
        edges, norms = [Fraction(0)], []
        for piece in self._pieces:
            limit = min(piece.end, self._total)
            if limit <= stepper.elapsed:
                continue
            first = bisect_right(inner, stepper.elapsed + rounding)
            stops = inner[first : bisect_left(inner, limit - rounding)]
            for stop in (*stops, limit):
                while stepper.elapsed < stop:
                    window = stepper.step(stop)
                    upper, lower, scale = comparison.bounds(piece, window, whole)
                    if not np.isfinite(upper[:-2]).all():
                        raise CertificationError("the trial solution was not resolved")
                    unbounded = ~np.isfinite(upper)
                    upper[unbounded], lower[unbounded] = np.inf, 0.0
                    upper[self._exact] = lower[self._exact] = 0.0
                    uppers, lowers = np.maximum(uppers, upper), np.maximum(lowers, lower)
                    scales = np.maximum(scales, scale)
                    edges.append(window.end)
                    norms.append(float(upper[0]))
                    if self._progress:
                        self._progress(float(stepper.elapsed / self._total))
        floors = scales * FLOOR
        if equation.conserved:
            floors[-2] = scales[-2] * _FLOOR_WITHOUT_SOLUTION
        floors[-1] = scales[-1] * _FLOOR_WITHOUT_SOLUTION
        floors = np.where(np.isfinite(floors), floors, 0.0).clip(SMALLEST)
        return WindowBounds(
            uppers, lowers, floors, self._begin, self._direction, tuple(edges), tuple(norms)
        )


def _samples(rtol: float) -> int:
    """M such that the bounds between samples are closer than 0.6 rtol, within limits."""
    needed = _TERMS * math.pi / math.sqrt(2.4 * rtol)
    return int(min(max(2.0 ** math.ceil(math.log2(needed)), 256), _MOST_SAMPLES))


class _Comparison:
    """z^ beside the enclosure of z."""

    def __init__(
        self, equation: Equation, begin: Fraction, direction: int, z0: np.ndarray, samples: int
    ) -> None:
        self._equation, self._samples = equation, samples
        self._begin, self._direction = begin, direction
        self._rates = ModelRows(equation.rates, _TERMS)
        self._energy = ModelRows(equation.energy, _TERMS)
        #: H at the start, if it is conserved.
        self._start: Rows | None = None
        if equation.conserved:
            place = ModelRows(equation.energy, 4)
            for i, value in enumerate(z0.tolist()):
                place.set_number(i, (value, 0.0, 0.0))
            place.run(double=True)
            found = place.taken(equation.energy.results)
            radius = up(found.radius + np.abs(found.high[:, 1:]).sum(axis=1))
            self._start = Rows(found.high[:, :1], found.low[:, :1], radius, np.array([1]))

    def bounds(
        self, piece: Piece, window: Window, whole: bool
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Upper and lower bounds of the dim + 3 quantities in a window, and their scales."""
        equation, dim = self._equation, self._equation.dim
        state, rate = piece.models(window.start, window.half, _TERMS)
        centre = number_of(self._begin + self._direction * (window.start + window.half))
        slope = number_of(self._direction * window.half)
        # Bounds on |z_i - y_i| over the window.
        wide = up(window.beside + set_sizes(window.V, window.G, window.R))
        width = np.minimum(wide, window.tube)
        terms = window.high.shape[1]
        y = Rows(window.high, window.low, np.zeros(dim), np.full(dim, terms))
        error, error_radius = _difference(state, y)
        uppers, lowers = np.zeros(dim + 3), np.zeros(dim + 3)
        uppers[: dim + 1], lowers[: dim + 1] = norm_and_parts(
            error, up(error_radius + width), self._samples
        )
        sizes = np.abs(window.high).sum(axis=1)
        if not whole:
            uppers[-2:] = np.inf
            return uppers, lowers, np.array([sizes.max(), *sizes, 0.0, 0.0])
        # the residual
        rows = self._rates
        rows.set_models(0, state)
        rows.set_line(dim, centre, slope)
        rows.run(double=True)
        G = rows.taken(equation.rates.results)
        signed = Rows(self._direction * G.high, self._direction * G.low, G.radius, G.length)
        residual, residual_radius = _difference(rate, signed)
        upper, lower = norm_and_parts(residual, residual_radius, self._samples)
        uppers[-1], lowers[-1] = upper[0], lower[0]
        # the energy
        energy = self._energy_of(state, centre, slope)
        slack = 0.0
        if self._start is not None:
            other = self._start
        else:
            other = self._energy_of(y, centre, slope)
            slack = self._energy_slack(window, width, centre, slope)
        change, radius = _difference(energy, other)
        upper, lower = norm_and_parts(change, up(radius + slack), self._samples)
        uppers[-2], lowers[-2] = upper[1], lower[1]
        rates = np.abs(G.high).sum(axis=1)
        half = dim // 2
        slopes = np.concatenate([rates[half:], rates[:half]])
        scale = np.array([sizes.max(), *sizes, slopes @ sizes, np.linalg.norm(rates)])
        return uppers, lowers, scale

    def _energy_of(
        self, state: Rows, centre: tuple[float, float, float], slope: tuple[float, float, float]
    ) -> Rows:
        rows = self._energy
        rows.set_models(0, state)
        if state.high.shape[1] < _TERMS:
            rows.high[: len(state.radius), state.high.shape[1] :] = 0.0
            rows.low[: len(state.radius), state.high.shape[1] :] = 0.0
        rows.set_line(self._equation.dim, centre, slope)
        rows.run(double=True)
        return rows.taken(self._equation.energy.results)

    def _energy_slack(
        self,
        window: Window,
        width: np.ndarray,
        centre: tuple[float, float, float],
        slope: tuple[float, float, float],
    ) -> float:
        """A bound on |H(z) - H(y)|."""
        dim, program = self._equation.dim, self._equation.slopes
        rows = ModelRows(program, window.high.shape[1])
        rows.high[:dim], rows.low[:dim] = window.high, window.low
        rows.length[:dim] = window.high.shape[1]
        rows.radius[:dim] = window.tube
        rows.set_line(dim, centre, slope)
        rows.run(double=False)
        found = rows.taken(program.results)
        slopes = up(np.abs(found.high).sum(axis=1) + found.radius)
        if program is self._equation.rates:
            # J grad H has the slopes in p first, then minus those in q.
            slopes = np.concatenate([slopes[dim // 2 :], slopes[: dim // 2]])
        return float(up(slopes @ width) + TINY)


def norm_and_parts(
    series: np.ndarray, radius: np.ndarray, samples: int
) -> tuple[np.ndarray, np.ndarray]:
    """Bounds on the 2-norm and on the size of each of n models, shapes (..., n, terms), (..., n).

    Both have the shape (..., 1 + n). TINY covers underflow, also of squares that vanish in the unit
    of the largest number: they change a norm by less than 10^-150 units, and one of the three norms
    is a unit.
    """
    table = _sample_table(samples)
    terms = series.shape[-1]
    with np.errstate(all="ignore"):
        values = series @ table[:terms]
        sums = up(np.abs(series).sum(axis=-1))
        rounding = sums * (terms + 4) * 2 * UNIT + TINY
        largest = np.abs(values).max(axis=-1)
        unit = np.max([largest, rounding, radius], axis=(0, -1))[..., None]
        squares = (
            unit * np.sqrt(((values / unit[..., None]) ** 2).sum(axis=-2).max(axis=-1))[..., None]
        )
        beside, whole = (
            unit * np.sqrt(((part / unit) ** 2).sum(axis=-1))[..., None]
            for part in (rounding, radius)
        )
        parts = np.minimum((largest + rounding) * _factor(terms - 1, samples), sums)
        norm = (squares + beside) * math.sqrt(_factor(2 * (terms - 1), samples))
    uppers = up(np.concatenate([norm + whole, parts + radius], axis=-1))
    sizes = down(np.concatenate([squares, largest], axis=-1))
    errors = up(np.concatenate([beside + whole, rounding + radius], axis=-1))
    return uppers, np.maximum(down(sizes - errors), 0.0)


@functools.cache
def _sample_table(samples: int) -> np.ndarray:
    """T_k at the zeros of T_M, shape (terms, M), each rounded from a proven ball."""
    with working(BITS):
        step = arb.pi() / (2 * samples)
        cosines = np.array([float((step * n).cos().mid()) for n in range(4 * samples)])
    angles = np.arange(_TERMS)[:, None] * (2 * np.arange(samples) + 1)
    return np.ascontiguousarray(cosines[angles % (4 * samples)])


@functools.lru_cache(maxsize=64)
def _factor(degree: int, samples: int) -> float:
    """An upper bound on 1/cos(degree pi/(2 M))."""
    with working(BITS):
        return above(1 / (arb.pi() * degree / (2 * samples)).cos())


def _difference(first: Rows, second: Rows) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients of the difference of models, rounded, and its radii."""
    count, terms = first.high.shape
    b, c = np.zeros((count, terms)), np.zeros((count, terms))
    width = second.high.shape[1]
    b[:, :width], c[:, :width] = second.high, second.low
    used, other = (
        np.arange(terms) < first.length[:, None],
        np.arange(terms) < second.length[:, None],
    )
    a, x = np.where(used, first.high, 0.0), np.where(used, first.low, 0.0)
    b, c = np.where(other, b, 0.0), np.where(other, c, 0.0)
    s, e = two_sum(a, -b)
    found = s + (e + (x - c))
    rounding = np.abs(found) + np.abs(e) + np.abs(x) + np.abs(c)
    radius = first.radius + second.radius + 4 * UNIT * rounding.sum(axis=1)
    return found, up(radius)
