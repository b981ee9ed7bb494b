"""Enclosures of the true solution, window by window.

Each window has a polynomial y near the solution and a polynomial matrix V near its derivatives,
which :mod:`hamsym.proof.windows.guessed_windows` guesses, and the bounds of
``hamsym/kernel/enclosures.h``, which hold whatever the guess. The set of the states at the start of
a window is

    z(t_a) in y(-1) + G r,   r: all vectors with |r_i| <= R_i.

The first columns of G are derivatives by the initial balls (Lohner 1992); each window appends the
identity with the radii of its own errors, and later windows multiply all columns by their
derivatives. So sets do not wrap. Only when there are too many columns are those of the errors
replaced by an orthogonal matrix. A window whose polynomials are not resolved is made shorter.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np

from hamsym.errors import CertificationError
from hamsym.kernel.enclosures import MIDDLE, UNDERFLOW, UNIT, enclosures
from hamsym.proof.arithmetic.balls import number_of
from hamsym.proof.arithmetic.programs import ModelRows
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.guessed_windows import (
    AT_REST,
    Guess,
    Place,
    TooLongError,
    WindowGuess,
    powers_of_two,
)
from hamsym.support.record_fields import floats

#: Coefficients of the polynomials of a window.
TERMS = 32
# Shortest window, relative to the span: time has 2^53 steps.
_SHORTEST = Fraction(1, 2**40)
# Tries of one window: halving it so often would make it the shortest.
_TRIES = 60
# Rest of a window beside its derivative, in units of the accuracy, from which it is shortened.
_REST = 1e4
# Growth of the defect to the rest that is always allowed.
_GROWTH = 1e3
# Most columns of a set, whose products cost their square.
_MOST_COLUMNS = 2_048
# Relative width from which the shape of a set counts.
_WIDE = 1e-8
# Attempts at a tube, each of which doubles it.
_TUBES = 5


def set_sizes(V: np.ndarray, G: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Bounds on the components of V(x) G r over a window for all |r_i| <= R_i, shape (dim,)."""
    product = enclosures().product
    moved = product(G.T, V.transpose(1, 0, 2))
    found = product(R, np.abs(moved).sum(axis=2))
    rounding = 2 * (len(G) + 8) * UNIT  # of sums of so many products
    large = product(np.abs(V).sum(axis=2), product(np.abs(G), R))
    found += rounding * large + UNDERFLOW * R.sum()
    return np.asarray(found * (1 + 1e-9))


@dataclass(frozen=True, eq=False)
class ErrorSet:
    """Sets {G r} with \\|r\\| <= R, one for each column of R."""

    #: G, R: Shapes (columns, m) and (m, kinds).
    G: np.ndarray
    R: np.ndarray
    #: Number of the first columns of G, which are kept.
    initial: int

    @classmethod
    def of_radii(cls, R: np.ndarray) -> ErrorSet:
        """The sets of all vectors within radii, shape (columns, kinds)."""
        initial = len(R) if R.any() else 0
        return cls(np.eye(len(R))[:, :initial], R[:initial], initial)

    def sizes(self) -> np.ndarray:
        """Bounds on the components, shape (columns, kinds)."""
        return enclosures().product(np.abs(self.G), self.R) * (1 + 1e-9)

    def initial_sizes(self) -> np.ndarray:
        """About the sizes of the components from the initial set alone, shape (columns, kinds)."""
        return enclosures().product(np.abs(self.G[:, : self.initial]), self.R[: self.initial])

    def moved(
        self, J: np.ndarray, J_error: np.ndarray, extra: np.ndarray, units: np.ndarray
    ) -> ErrorSet:
        """The sets {(J +- J_error) G r + e} with \\|e\\| <= extra, shape (columns, kinds).

        ``units`` are those of the components, powers of two.
        """
        columns, first, R = len(self.G), self.initial, self.R
        G, rest = enclosures().moved_set(J, J_error, self.G, R)
        if G.shape[1] - first > columns * min(max(_MOST_COLUMNS // columns, 6), 64):
            later = np.ascontiguousarray(G[:, first:]), np.ascontiguousarray(R[first:])
            Q, radii = enclosures().boxed_set(*later, units)
            G, R = np.hstack([G[:, :first], Q]), np.vstack([R[:first], radii])
        fresh = (rest + extra) * (1 + 1e-9)
        return ErrorSet(np.hstack([G, np.eye(columns)]), np.vstack([R, fresh]), first)


@dataclass(frozen=True, eq=False)
class Window:
    """One window: z(t) in y(x) + V(x) G r + balls of the radii ``beside``, \\|r\\| <= R."""

    #: start, half: Elapsed time; start + half (1 + x).
    start: Fraction
    half: Fraction
    #: high, low: Coefficients of y.
    high: Annotated[np.ndarray, floats("dim", "terms")]
    low: Annotated[np.ndarray, floats("dim", "terms")]
    V: Annotated[np.ndarray, floats("dim", "columns", "slopes")]
    #: G, R: The set at the start.
    G: Annotated[np.ndarray, floats("columns", "kinds")]
    R: Annotated[np.ndarray, floats("kinds", least=0)]
    #: Bounds on everything else.
    beside: Annotated[np.ndarray, floats("dim", least=0)]
    #: Bounds on V_d.
    derivative: Annotated[np.ndarray, floats("dim", "columns", least=0)]
    #: J, J_error: V(1) with rows of the identity for the constants, and bounds on its rounding.
    J: Annotated[np.ndarray, floats("columns", "columns")]
    J_error: Annotated[np.ndarray, floats("columns", "columns", least=0)]
    #: Bounds on |z - y|.
    tube: Annotated[np.ndarray, floats("dim", least=0)]
    #: Of the components and constants, powers of two, in which DG is nearly balanced.
    units: Annotated[np.ndarray, floats("columns", least=0)]

    @property
    def columns(self) -> int:
        return len(self.units)

    @property
    def end(self) -> Fraction:
        return self.start + 2 * self.half


class WindowStepper:
    """Encloses one window after the other.

    - total: Length of the span.
    - centre: Middle of the initial set, shape (columns,); the constants are the last.
    - radii: Of the initial set.
    - accuracy: Of the polynomials, relative to the components.
    """

    def __init__(
        self,
        equation: Equation,
        start_time: Fraction,
        direction: int,
        total: Fraction,
        centre: np.ndarray,
        radii: np.ndarray,
        accuracy: float,
        deadline: Deadline,
        terms: int = TERMS,
    ) -> None:
        self.equation, self._deadline = equation, deadline
        self._time, self._direction, self.total = start_time, direction, total
        self._accuracy, self._terms = accuracy, terms
        self.guess = WindowGuess(equation, direction, centre, accuracy, terms)
        self._unknown = radii[equation.dim :].astype(float)
        self._set = ErrorSet.of_radii(radii.astype(float)[:, None])
        self._energy = ModelRows(equation.energy, terms)
        self.elapsed = Fraction(0)
        self.length: float | None = None  # suggestion for the next window
        self._reason = "the windows became too short"

    def step(self, limit: Fraction) -> Window:
        """The next window, which ends at ``limit`` or before.

        Raise CertificationError if there is none.
        """
        time = float(self._time + self._direction * self.elapsed)
        room = limit - self.elapsed
        length = float(room) if self.length is None else self.length
        self.guess.forget_defect()
        for _ in range(_TRIES):
            self._deadline.check(f"the solution was enclosed, at t = {time:.6g}")
            if not length > float(self.total * _SHORTEST):
                break
            if length >= float(room) * (1 - 1e-9):
                chosen = room
            else:
                if length * 2 > float(room):
                    length = float(room) / 2
                chosen = self._rounded(length, room)
            try:
                with np.errstate(all="ignore"):  # infinite and NaN are refused
                    window, factor = self._enclosed(chosen)
            except TooLongError as refusal:
                self._reason = refusal.reason or self._reason
                length = float(chosen) * refusal.factor
            else:
                self.length = float(chosen) * min(max(factor, 0.5), 2.0)
                return window
        raise CertificationError(
            f"no enclosure beyond t = {time:.6g}: {self._reason}; use an earlier end time"
        )

    def _rounded(self, length: float, room: Fraction) -> Fraction:
        """About this length, so that the window ends at a float64 time if possible."""
        wanted = self.elapsed + Fraction(length)
        end = Fraction(float(self._time + self._direction * wanted))
        chosen = self._direction * (end - self._time) - self.elapsed
        return chosen if 0 < chosen < room else Fraction(length)

    def _enclosed(self, length: Fraction) -> tuple[Window, float]:
        """Prove a window of this length by the lemma; return the factor of the next length, too.

        Raise TooLongError if it cannot be proven.
        """
        half = length / 2
        middle = number_of(self._time + self._direction * (self.elapsed + half))
        place = Place(half, float(half), middle, number_of(half * self._direction))
        guess = self.guess.window(place, self._set.initial_sizes()[: self.equation.dim, 0])
        D, V, units, factor = guess.D, guess.V, guess.units, guess.factor
        equation, w, dim = self.equation, place.w, self.equation.dim
        offset = self._offset(guess.y)
        start = self._set.sizes()[:, 0]
        start[:dim] += offset
        start *= 1 + 1e-9
        safe = np.where(self.guess.sizes > AT_REST, self.guess.sizes, units)
        width = float((start[:dim] / safe).max())
        hull = self._hull(V, start, offset, width)
        tube = 1.5 * (hull + 2 * D) + 4 * UNIT * UNIT * self.guess.sizes + 1e-280
        accepted = None
        for _ in range(_TUBES):
            jacobian = self._over_tube(place, guess.y, tube)
            found, d, derivative, _ = enclosures().transport(
                *jacobian,
                equation.entries,
                self.guess.signs,
                start,
                hull,
                V,
                D,
                w * (1 + 4 * UNIT),
                units,
                dim,
            )
            if (found < tube).all():
                accepted = found, d, derivative
                if width < _WIDE or (tube < 1.1 * found).all():
                    break
                tube = 1.02 * found  # a second proof in a narrower tube
            elif accepted is not None or not np.isfinite(found).all():
                break
            else:
                tube = np.maximum(tube, 2 * found)
        if accepted is None:
            raise TooLongError(0.6, "the set of solutions became too wide")
        found, d, derivative = accepted
        # Derivatives of H may be smooth where H is not, as those of acot(x) at 0.
        self._run_over_tube(self._energy, place, guess.y, found)
        if not np.isfinite(self._energy.radius[equation.energy.results]).all():
            raise TooLongError(0.5, "H is not smooth there, or was not resolved")
        # A shorter window has a smaller rest d beside the derivative.
        room = _REST * self._accuracy + 0.03 * width
        share = float((d / safe).max())
        grown = float((d / units).max()) > _GROWTH * float((D / units).max())
        if share > room and grown and w > 1e-6 * float(self.total):
            raise TooLongError(0.6)
        if share > 0.1 * room:
            factor = min(factor, 1.0)
        return self._accepted(half, guess, d, derivative, offset, found), factor

    def _offset(self, models: ModelRows) -> np.ndarray:
        """Bounds on the distance of y(-1) from the centre."""
        dim = self.equation.dim
        high, low, radius = enclosures().end_values(models.high[:dim], models.low[:dim], -1)
        gap = (high - self.guess.centre) + (low - self.guess.centre_low)
        rounding = MIDDLE * (np.abs(high) + np.abs(self.guess.centre))
        return np.asarray((np.abs(gap) + rounding + radius) * (1 + 1e-9) + 1e-290)

    def _hull(
        self, V: np.ndarray, start: np.ndarray, offset: np.ndarray, width: float
    ) -> np.ndarray:
        """Bounds on |V xi| over a window; of thin sets without regard to their shape."""
        sizes = np.abs(V).sum(axis=2)
        if width < _WIDE:
            return enclosures().product(sizes, start) * (1 + 1e-9)
        beside = enclosures().product(sizes[:, : len(offset)], offset)
        return (set_sizes(V, self._set.G, self._set.R[:, 0]) + beside) * (1 + 1e-9)

    def _over_tube(
        self, place: Place, models: ModelRows, tube: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Models of DG over a tube around y: coefficients, radii and lengths."""
        own = self.guess.jacobian
        self._run_over_tube(own, place, models, tube)
        places = self.equation.placed[:, 2]
        # The half length may not be exact.
        radius = own.radius[places] + 8 * UNIT * np.abs(own.high[places]).sum(axis=1)
        return own.high[places], radius * (1 + 1e-9), own.length[places]

    def _run_over_tube(
        self, own: ModelRows, place: Place, models: ModelRows, tube: np.ndarray
    ) -> None:
        dim, columns = self.equation.dim, self.equation.columns
        own.high[:dim] = models.high[:dim]
        own.low[:dim] = models.low[:dim]
        own.length[:dim] = self._terms
        own.radius[:dim] = tube
        own.high[dim:columns, 0] = self.guess.constants
        own.radius[dim:columns] = self._unknown
        own.set_line(columns, place.middle, place.slope)
        own.run(double=False)

    def _accepted(
        self,
        half: Fraction,
        guess: Guess,
        d: np.ndarray,
        derivative: np.ndarray,
        offset: np.ndarray,
        tube: np.ndarray,
    ) -> Window:
        """The window, from whose end the next one goes on."""
        V, y = guess.V, guess.y
        dim, columns = self.equation.dim, self.equation.columns
        large = np.abs(V).sum(axis=2)
        beside = (enclosures().product(large[:, :dim], offset) + d + guess.D) * (1 + 1e-9)
        J, J_error = np.eye(columns), np.zeros((columns, columns))
        J[:dim], rest, radius = enclosures().end_values(V, None, 1)
        J_error[:dim] = (np.abs(rest) + radius) * (1 + 1e-9)
        extra = np.zeros(columns)
        self.guess.centre, self.guess.centre_low, radius = enclosures().end_values(
            y.high[:dim], y.low[:dim], 1
        )
        extra[:dim] = (beside + radius) * (1 + 1e-9)
        window = Window(
            self.elapsed,
            half,
            y.high[:dim].copy(),
            y.low[:dim].copy(),
            V,
            self._set.G,
            self._set.R[:, 0],
            beside,
            derivative,
            J,
            J_error,
            tube,
            powers_of_two(
                np.concatenate([guess.units, self.guess.constant_units(half, guess.units)])
            ),
        )
        self._set = self._set.moved(J, J_error, extra[:, None], window.units)
        if not np.isfinite(self._set.R).all():
            raise CertificationError("the enclosure became infinite; use an earlier end time")
        self.elapsed = window.end
        return window
