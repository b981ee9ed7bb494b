"""Guesses of windows: a polynomial near the solution, one near its derivatives, units, lengths.

The polynomial y solves the equations by collocation in float64; linear corrections of its defect
complete it to twice float64. V follows from linear equations along y, and the units balance their
matrix. All this is heuristic: a bad guess gives wide bounds, or a window that is refused and made
shorter. Proven are only the bounds D on the defect of y, whatever y is
(:mod:`hamsym.proof.windows.proven_windows` proves the rest); they need low parts of y within half
an ulp of its high parts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.kernel.enclosures import enclosures
from hamsym.numerics.scales import coupled_sizes
from hamsym.proof.arithmetic.programs import ModelRows, tables
from hamsym.proof.windows.equation import Equation

#: Size up to which a component is at rest.
AT_REST = 1e-200
#: Most sweeps of an iteration to a fixed point; those of solvable windows need a few dozen.
_ITERATIONS = 80
# Most linear corrections of y: each gains about ten digits, of thirty-two.
_CORRECTIONS = 3
# Size of a component beside the radius of a ball around zero.
_BESIDE = 100.0
# Least size of a component: radii have the root of 1e-290 as a floor.
_LEAST = 1e-130
# Root of the product q p of a pair at rest, relative to the others: errors of the derivatives of
# the others by the pair are larger by 1e6 than their own, and its own errors smaller.
_UNCOUPLED = 1e-6
# Defect in units of the accuracy from which y is not resolved.
_LOOSE = 32.0
# Finest accuracy that twice float64 can reach.
_FINEST = 1e-28
# Round-off of coefficients, relative to the component.
_ROUND_OFF = 2e-14
# Mantissa from which numbers are rounded up to a power of two.
_THRESHOLD = 0.70137
# Drop of the coefficients to round-off which is that of a polynomial.
_ABRUPT = 1e3


class TooLongError(Exception):
    """A window is too long: the factor of the length to try next, and why, where it is known."""

    def __init__(self, factor: float, reason: str = "") -> None:
        super().__init__(reason)
        self.factor, self.reason = factor, reason


@dataclass(frozen=True)
class Place:
    """A window that is tried: half its length, exact and rounded, and balls of time."""

    half: Fraction
    w: float
    #: middle, slope: The time is middle + slope x.
    middle: tuple[float, float, float]
    slope: tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Guess:
    """What is guessed of a window."""

    #: y in twice float64, in the first registers.
    y: ModelRows
    #: Proven bounds on the defect of y, shape (dim,).
    D: np.ndarray
    #: Near the derivatives by the state and the constants, shape (dim, columns, terms).
    V: np.ndarray
    #: Of the components, shape (dim,).
    units: np.ndarray
    #: Of the length, for the next window.
    factor: float


class WindowGuess:
    """Guesses one window after the other, with what the last ones tell.

    - centre: Middle of the initial set, shape (columns,); the constants are the last.
    - accuracy: Of the polynomials, relative to the components.
    """

    def __init__(
        self, equation: Equation, direction: int, centre: np.ndarray, accuracy: float, terms: int
    ) -> None:
        self._equation, self._direction = equation, direction
        self._accuracy, self._terms, self._tables = accuracy, terms, tables(terms)
        dim = equation.dim
        #: State at which y starts, in twice float64.
        self.centre, self.centre_low = centre[:dim].astype(float), np.zeros(dim)
        self.constants = centre[dim:].astype(float)
        #: Largest sizes of the components so far.
        self.sizes = np.abs(self.centre)
        self._rates = ModelRows(equation.rates, terms)
        #: For DG over a tube too, which uses the parts of a window that do not move.
        self.jacobian = ModelRows(equation.jacobian, terms)
        self.signs = equation.signs * direction
        self._rows = [
            np.repeat(models.high[:, :1], terms, axis=1) for models in (self._rates, self.jacobian)
        ]
        self._defect = np.full(dim, math.inf)  # per time, of the try before
        self._round_off = np.zeros(dim)  # defects per time that no window reduced

    def forget_defect(self) -> None:
        """Begin another window, with which the defects of the last one are not compared."""
        self._defect = np.full(self._equation.dim, math.inf)

    def window(self, place: Place, radii: np.ndarray) -> Guess:
        """Guess a window; raise TooLongError if the solution is not resolved there.

        - radii: Of the components from the initial set alone, shape (dim,).
        """
        sizes, y = self._collocated(place)
        # What the others drive a component to; its round-off has that scale if it is nearly zero.
        couplings = self._couplings()
        driven = place.w * enclosures().product(couplings, sizes)
        tail, factor = self._decay(y, np.maximum(sizes, 0.02 * driven))
        if not tail <= 30 * self._accuracy:
            raise TooLongError(min(max(0.9 * factor, 0.25), 0.8))
        sizes = np.maximum(self.sizes, np.maximum(sizes, 1e-8 * driven))
        units = self._units(place.w, couplings, sizes, radii)
        models, D = self._completed(place, y, units)
        if not np.isfinite(D).all():
            raise TooLongError(0.5, "a function was not resolved")
        self.sizes = sizes
        factor = self._resolved(D / place.w, D, factor)
        # Roundings of a component at rest may have a size, as those of sin(x) at 0: the 2-norm has
        # to compare them with those of the others.
        least = D / (_LOOSE * max(self._accuracy, _FINEST))
        units = self._units(place.w, couplings, sizes, radii, least)
        values = enclosures().tangents(
            self._rows[1],
            self._equation.placed,
            self.signs,
            self._equation.dim,
            self._equation.columns,
            self._tables.integral,
            place.w,
            units,
            _ITERATIONS,
        )
        V = enclosures().product(values, self._tables.series)
        return Guess(models, D, V, units, factor)

    def _collocated(self, place: Place) -> tuple[np.ndarray, np.ndarray]:
        """Sizes of the components and coefficients of y in float64; and DG along y in rows.

        What does not depend on the state is put into the models, and rounded into the rows: a time
        of many periods has too few digits in float64.
        """
        equation, tabs = self._equation, self._tables
        dim, columns = equation.dim, equation.columns
        rows, more = self._rows
        signed = place.w * self._direction
        rows[:dim] = self.centre[:, None]
        rows[dim:columns] = self.constants[:, None]
        rows[columns] = place.middle[0] + signed * tabs.points
        for values, models in ((rows, self._rates), (more, self.jacobian)):
            models.high[dim:columns, 0] = self.constants
            models.radius[dim : columns + 1] = 0.0
            models.set_line(columns, place.middle, place.slope)
            models.run_still()
            values[models.program.still_places] = models.still_values()
        count = enclosures().collocate(
            equation.rates.steps,
            equation.rates.results,
            rows,
            tabs.integral,
            self.centre,
            signed,
            _ITERATIONS,
        )
        sizes = np.abs(rows[:dim]).max(axis=1)
        more[: columns + 1] = rows[: columns + 1]
        enclosures().run_values(equation.jacobian.steps, more)
        if not count:
            raise TooLongError(
                0.5, "the solution leaves every scale there, as at a collision or a jump"
            )
        return sizes, enclosures().product(rows[:dim], tabs.series)

    def _completed(
        self, place: Place, y: np.ndarray, units: np.ndarray
    ) -> tuple[ModelRows, np.ndarray]:
        """y in twice float64, by linear corrections of its defect, and bounds on the defect."""
        equation, tabs, models = self._equation, self._tables, self._rates
        dim = equation.dim
        models.high[:dim], models.low[:dim] = y, 0.0
        models.length[:dim] = self._terms
        models.radius[:dim] = 0.0
        self.start(models)
        arguments = (equation.rates.steps, equation.rates.results, models.models, dim, place.slope)
        series, D = enclosures().defects(*arguments)
        for _ in range(_CORRECTIONS):
            before = D
            found = enclosures().correct(
                self._rows[1],
                equation.placed,
                self.signs,
                dim,
                tabs.integral,
                place.w,
                -enclosures().product(series[:, : self._terms], tabs.values),
                units,
                _ITERATIONS,
            )
            self._corrected(models, enclosures().product(found, tabs.series))
            series, D = enclosures().defects(*arguments)
            if not (0.1 * before > D).any():
                break
        return models, D

    def _resolved(self, rates: np.ndarray, D: np.ndarray, factor: float) -> float:
        """Factor of the length of the next window; raise TooLongError if the defect is large."""
        shares = D / np.maximum(self.sizes, _LEAST)
        loose = shares > _LOOSE * max(self._accuracy, _FINEST)
        share = max(float(shares.max()), 1e-3 * self._accuracy)
        reach = shortened((self._accuracy / share) ** (2 / self._terms))
        before, self._defect = self._defect, rates
        if not loose.any():
            return min(factor, reach)
        # A defect that a shorter window did not reduce is round-off, as near an equilibrium.
        reducible = rates > 4 * self._round_off
        if (reducible & (rates < 0.5 * before))[loose].any():
            raise TooLongError(max(0.9 * reach, 0.4), "the solution was not resolved")
        self._round_off = np.maximum(self._round_off, np.where(loose, rates, 0.0))
        return factor

    def _decay(self, y: np.ndarray, sizes: np.ndarray) -> tuple[float, float]:
        """The size of the terms that y leaves out, and the factor of the window that is allowed.

        Extrapolated from the terms above round-off, because those below say nothing.
        """
        shares = (np.abs(y) / np.maximum(sizes, 1e-300)[:, None]).max(axis=0)
        if not np.isfinite(shares).all():
            return math.inf, 0.5
        places = np.flatnonzero(shares > _ROUND_OFF)
        last = max(int(places[-1]), 2) if len(places) else 2
        share = max(float(shares[last]), _ROUND_OFF)
        rate = math.log(share) / last if last < self._terms - 2 else -0.1
        if last < self._terms - 2 and share > _ABRUPT * _ROUND_OFF:  # a polynomial of this degree
            rate = math.log(_ROUND_OFF) / (last + 1)
        tail = math.exp(rate * self._terms)
        factor = shortened((self._accuracy / max(tail, 1e-100)) ** (1 / self._terms))
        y[:, last + 1 :] = 0.0  # round-off, which the corrections replace
        return tail, factor

    def start(self, models: ModelRows) -> None:
        """Shift y so that y(-1) is the centre."""
        high, low = (part[: self._equation.dim] for part in (models.high, models.low))
        value, rest, _ = enclosures().end_values(high, low, -1)
        gap = (self.centre - value) + (self.centre_low - rest)
        total, error = _two_sum(high[:, 0], gap)
        high[:, 0], low[:, 0] = _two_sum(total, low[:, 0] + error)

    def _corrected(self, models: ModelRows, series: np.ndarray) -> None:
        dim = self._equation.dim
        pair = _two_sum(models.high[:dim], models.low[:dim] + series)
        models.high[:dim], models.low[:dim] = pair
        self.start(models)

    def _couplings(self) -> np.ndarray:
        """Sizes of the entries of DG at the points, shape (dim, dim)."""
        dim = self._equation.dim
        i, j, place = self._equation.placed.T
        found = np.zeros((dim, self._equation.columns))
        np.add.at(found, (i, j), np.abs(self._rows[1][place]).max(axis=1))
        return found[:, :dim]

    def _units(
        self,
        w: float,
        couplings: np.ndarray,
        sizes: np.ndarray,
        radii: np.ndarray,
        least: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """Units in which DG is nearly balanced (Osborne 1960), powers of two.

        ``sizes`` are those of the components on the windows so far, ``radii`` those of the initial
        set, and ``least`` the smallest to be balanced.
        """
        dim, matrix = self._equation.dim, couplings.copy()
        np.fill_diagonal(matrix, 0.0)
        # A ball around zero gives a component its size: more than the radius, because roundings of
        # its shares in the unit are errors of the others, too. Errors of windows give none: they
        # are small in units of the component, which would be theirs.
        sizes = np.where(sizes < radii, _BESIDE * radii, sizes)
        safe = np.maximum(_sizes_of_all(sizes, matrix, w), least)
        safe = coupled_sizes(safe, matrix, w)
        matrix += 1e-3 / w * safe[:, None] / safe[None, :] * (1 - np.eye(dim))
        units = safe.copy()
        enclosures().balance(matrix, units)
        return powers_of_two(units)

    def constant_units(self, half: Fraction, units: np.ndarray) -> np.ndarray:
        """Changes of the constants that move a component by its unit within half a window."""
        dim = self._equation.dim
        shares = np.zeros(self._equation.columns - dim)
        for i, j, place in self._equation.placed:
            if j >= dim:
                share = float(half) * np.abs(self._rows[1][place]).max() / units[i]
                shares[j - dim] = max(shares[j - dim], share)
        found = 1 / shares
        return np.where((found > 0) & (found < math.inf), found, 1.0)


def powers_of_two(units: np.ndarray) -> np.ndarray:
    """Return powers of two near numbers > 0, by which division is exact.

    Numbers are rounded where none of a formula lies: what differs between processors in the last
    bits, as eigenvalues do, gives the same powers.
    """
    mantissa, exponent = np.frexp(units)
    return np.ldexp(1.0, (exponent - (mantissa < _THRESHOLD)).clip(-1022, 1023))


def shortened(factor: float) -> float:
    """Return the first sixteen bits, since powers differ between processors in the last ones."""
    mantissa, exponent = math.frexp(factor)
    return math.ldexp(round(mantissa * 2**16), exponent - 16)


def _two_sum(a: Any, b: Any) -> tuple[Any, Any]:
    """a + b rounded, and its error: a low part within half an ulp, as bounds of products need."""
    total = a + b
    back = total - a
    return total, (a - (total - back)) + (b - back)


def _sizes_of_all(sizes: np.ndarray, couplings: np.ndarray, w: float) -> np.ndarray:
    """Sizes of all components, positive also for those that are at rest.

    Such a component has the size that the others drive it to, or else that which would move
    another one by its own size within w. Without such couplings, the product of a coordinate and
    its momentum is compared with those of the others: all have the dimension of H times time.
    Components are never compared otherwise, because they may have different dimensions.
    """
    found = coupled_sizes(np.where(sizes > AT_REST, sizes, 0.0), couplings, w)
    half = len(found) // 2
    action = float((np.sqrt(found[:half]) * np.sqrt(found[half:])).max())  # its root
    while (at_rest := found == 0).any():
        moved = np.where((couplings > 0) & ~at_rest[:, None], found[:, None], math.inf)
        moving = (moved / couplings).min(axis=0) / w
        chosen = np.flatnonzero(at_rest & (moving < math.inf))
        if len(chosen):
            found[chosen] = np.maximum(moving[chosen], math.ulp(0.0))  # it may underflow
        else:  # nothing moves it, and it moves nothing
            i = int(np.flatnonzero(at_rest)[0])
            found[i] = _size_beside(i, couplings, w, _UNCOUPLED * action or _LEAST)
        found = coupled_sizes(found, couplings, w)
    return found


def _size_beside(i: int, couplings: np.ndarray, w: float, action: float) -> float:
    """The size of a component whose product with its partner is the square of ``action``."""
    dim = len(couplings)
    partner = (i + dim // 2) % dim
    alone = np.zeros(dim)
    alone[i] = 1.0
    ratio = float(coupled_sizes(alone, couplings, w)[partner])
    if ratio == 0:
        ratio = float(1 / (w * couplings[i, partner]))
    found = action / math.sqrt(ratio) if ratio > 0 else math.inf
    return found if 0 < found < math.inf else _LEAST
