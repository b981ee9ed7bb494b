"""Enclosures of the true solution, window by window.

A window is tried: :mod:`hamsym.proof.windows.guessed_windows` guesses polynomials near the solution
and its derivatives, and :mod:`hamsym.proof.windows.window_lemma` proves bounds beside them. A
window whose polynomials are not resolved, or which has no bounds, is made shorter.
"""

from __future__ import annotations

from fractions import Fraction

import numpy as np

from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.balls import number_of
from hamsym.proof.arithmetic.directed import UNIT
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.guessed_windows import AT_REST, WindowGuess
from hamsym.proof.windows.window_lemma import TooLongError, WindowLemma
from hamsym.proof.windows.window_sets import Place, Window

#: Coefficients of the polynomials of a window.
TERMS = 32
# Shortest window, relative to the span: time has 2^53 steps.
_SHORTEST = Fraction(1, 2**40)
# Tries of one window: halving it so often would make it the shortest.
_TRIES = 60
# Relative width from which the shape of a set counts.
_WIDE = 1e-8
# Window from which its rest may be too large, relative to the span.
_LONG = 1e-6


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
        self._deadline = deadline
        self._time, self._direction, self.total = start_time, direction, total
        self._lemma = WindowLemma(equation, direction, centre, radii, terms)
        self._guess = WindowGuess(self._lemma, direction, accuracy, terms)
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
        self._guess.forget_defect()
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
        """Prove a window of this length; return the factor of the next length, too.

        Raise TooLongError if it cannot be proven.
        """
        guess, lemma, dim, half = self._guess, self._lemma, self._lemma.equation.dim, length / 2
        middle = number_of(self._time + self._direction * (self.elapsed + half))
        lemma.enter(Place(half, float(half), middle, number_of(half * self._direction)))
        found = guess.window(lemma.set.initial_sizes()[:dim, 0])
        start = lemma.start()
        safe = np.where(guess.sizes > AT_REST, guess.sizes, found.units)
        width = float((start.xi[:dim] / safe).max())
        least = 4 * UNIT * UNIT * guess.sizes + 1e-280
        bounds = lemma.bounds(found.V, found.units, start, least, width < _WIDE)
        factor = guess.accepted(found, bounds.d, safe, width, _LONG * float(self.total))
        units = guess.all_units(found.units)
        window = lemma.accepted(self.elapsed, found.V, units, start, bounds)
        self.elapsed = window.end
        return window, factor
