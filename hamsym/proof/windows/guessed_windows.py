"""Guesses of windows: a polynomial near the solution, one near its derivatives, units, lengths.

The polynomial y solves the equations by collocation in float64; linear corrections of its defect
complete it to twice float64. V follows from linear equations along y by Taylor series between the
points, and the units balance their matrix. All this is heuristic: a bad guess gives wide bounds, or
a window that is refused and made shorter. What is proven of it,
:mod:`hamsym.proof.windows.window_lemma` proves from the numbers alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hamsym.kernel.enclosures import enclosures
from hamsym.numerics.collocation import chebyshev_tables
from hamsym.numerics.scales import coupling_shares, shared_sizes
from hamsym.proof.arithmetic.directed import UNIT, two_sum
from hamsym.proof.arithmetic.programs import ModelRows
from hamsym.proof.windows.window_lemma import TooLongError, WindowLemma
from hamsym.proof.windows.window_sets import powers_of_two

#: Size up to which a component is at rest.
AT_REST = 1e-200
#: Most sweeps of an iteration to a fixed point; those of solvable windows need a few dozen.
_ITERATIONS = 80
# Most linear corrections of y: each gains about ten digits, of thirty-two.
_CORRECTIONS = 3
# Size of a component beside the radius of a ball around zero.
_BESIDE = 1e8
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
# Rest of a window beside its derivative, in units of the accuracy, from which it is shortened.
_REST = 1e4
# Share of the length of a window whose rest was too large that later ones may have, and by how much
# it grows from window to window.
_SHORTER, _LONGER = 0.7, 1.02
# Growth of the defect to the rest that is always allowed.
_GROWTH = 1e3
# Drop of the coefficients to round-off which is that of a polynomial.
_ABRUPT = 1e3


@dataclass(frozen=True, eq=False)
class Guess:
    """What is guessed of a window beside y."""

    #: Near the derivatives by the state and the constants, shape (dim, columns, terms).
    V: np.ndarray
    #: Of the components, shape (dim,).
    units: np.ndarray
    #: Of the length, for the next window.
    factor: float


class WindowGuess:
    """Guesses one window after the other, with what the last ones tell.

    - lemma: To which y is given; its bounds on the defect tell how good y is.
    - accuracy: Of the polynomials, relative to the components.
    """

    def __init__(self, lemma: WindowLemma, direction: int, accuracy: float, terms: int) -> None:
        self._lemma, self._equation, self._direction = lemma, lemma.equation, direction
        self._accuracy, self._terms, self._tables = accuracy, terms, chebyshev_tables(terms)
        dim = self._equation.dim
        #: Largest sizes of the components so far.
        self.sizes = np.abs(lemma.centre)
        self._rows = [
            np.repeat(models.high[:, :1], terms, axis=1) for models in (lemma.rates, lemma.jacobian)
        ]
        #: The linear equations along y.
        self._linear = self._rows[1], self._equation.placed, lemma.signs, dim
        self._defect = np.full(dim, math.inf)  # per time, of the try before
        self._round_off = np.zeros(dim)  # defects per time that no window reduced
        self._longest = math.inf  # half length of windows, after one whose rest was too large

    def forget_defect(self) -> None:
        """Begin another window, with which the defects of the last one are not compared."""
        self._defect = np.full(self._equation.dim, math.inf)

    def window(self, radii: np.ndarray) -> Guess:
        """Guess the window at the place of the lemma; leave y there.

        Raise TooLongError if the solution is not resolved there.

        - radii: Of the components from the initial set alone, shape (dim,).
        """
        lemma = self._lemma
        w = lemma.place.w
        sizes, y = self._collocated(w)
        # What the others drive a component to; its round-off has that scale if it is nearly zero.
        couplings = self._couplings()
        driven = w * enclosures().product(couplings, sizes)
        np.fill_diagonal(couplings, 0.0)
        shares = coupling_shares(couplings, w)
        tail, factor = self._decay(y, np.maximum(sizes, 0.02 * driven))
        if not tail <= 30 * self._accuracy:
            raise TooLongError(min(max(0.9 * factor, 0.25), 0.8))
        sizes = np.maximum(self.sizes, np.maximum(sizes, 1e-8 * driven))
        units = self._units(w, couplings, shares, sizes, radii)
        self._complete(w, y, units)
        D = lemma.D
        if not np.isfinite(D).all():
            raise TooLongError(0.5, "a function was not resolved")
        self.sizes = sizes
        factor = self._resolved(D / w, D, factor)
        # Roundings of a component at rest may have a size, as those of sin(x) at 0: the 2-norm has
        # to compare them with those of the others.
        least = D / (_LOOSE * max(self._accuracy, _FINEST))
        units = self._units(w, couplings, shares, sizes, radii, least)
        given = self._equation.columns, self._tables.steps, self._tables.series
        V = enclosures().tangents(*self._linear, *given, w, units, UNIT)
        return Guess(V, units, factor)

    def accepted(
        self, guess: Guess, d: np.ndarray, safe: np.ndarray, width: float, shortest: float
    ) -> float:
        """Factor of the length of the next window; raise TooLongError if the rest d is large.

        A shorter window has a smaller rest beside the derivative.

        - safe: Sizes of the components, and ``width`` the largest of the set relative to them.
        """
        room = _REST * self._accuracy + 0.03 * width
        share = float((d / safe).max())
        largest = float((self._lemma.D / guess.units).max())
        grown = float((d / guess.units).max()) > _GROWTH * largest
        w = self._lemma.place.w
        if share > room and grown and w > shortest:
            self._longest = _SHORTER * w
            raise TooLongError(0.6)
        factor = min(guess.factor, self._longest / w)
        self._longest *= _LONGER
        return min(factor, 1.0) if share > 0.1 * room else factor

    def _collocated(self, w: float) -> tuple[np.ndarray, np.ndarray]:
        """Sizes of the components and coefficients of y in float64; and DG along y in rows.

        What does not depend on the state is rounded into the rows from the models of the lemma: a
        time of many periods has too few digits in float64.
        """
        equation, lemma, tables = self._equation, self._lemma, self._tables
        dim, columns = equation.dim, equation.columns
        rows, more = self._rows
        signed = w * self._direction
        rows[:dim] = lemma.centre[:, None]
        rows[dim:columns] = lemma.constants[:, None]
        rows[columns] = lemma.place.middle[0] + signed * tables.points
        for values, models in ((rows, lemma.rates), (more, lemma.jacobian)):
            values[models.program.still_places] = still_values(models)
        rates = equation.rates
        given = rates.steps, rates.results, rows, tables.integral, lemma.centre
        count = enclosures().collocate(*given, signed, _ITERATIONS)
        sizes = np.abs(rows[:dim]).max(axis=1)
        more[: columns + 1] = rows[: columns + 1]
        enclosures().run_values(equation.jacobian.steps, more)
        if not count:
            raise TooLongError(
                0.5, "the solution leaves every scale there, as at a collision or a jump"
            )
        return sizes, enclosures().product(rows[:dim], tables.series)

    def _complete(self, w: float, y: np.ndarray, units: np.ndarray) -> None:
        """Complete y to twice float64 by linear corrections of its defect."""
        tables, lemma = self._tables, self._lemma
        series = lemma.bound_defect(*self._from_centre(y, np.zeros_like(y)))
        for _ in range(_CORRECTIONS):
            before = lemma.D
            wanted = -enclosures().product(series[:, : self._terms], tables.values)
            found = enclosures().correct(
                *self._linear, tables.integral, w, wanted, units, _ITERATIONS
            )
            high, low = lemma.y
            pair = two_sum(high, low + enclosures().product(found, tables.series))
            series = lemma.bound_defect(*self._from_centre(*pair))
            if not (0.1 * before > lemma.D).any():
                break

    def _from_centre(self, high: np.ndarray, low: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """y shifted so that y(-1) is the centre."""
        value, rest, _ = enclosures().end_values(high, low, -1)
        gap = (self._lemma.centre - value) + (self._lemma.centre_low - rest)
        total, error = two_sum(high[:, 0], gap)
        high[:, 0], low[:, 0] = two_sum(total, low[:, 0] + error)
        return high, low

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
        shares: np.ndarray,
        sizes: np.ndarray,
        radii: np.ndarray,
        least: np.ndarray | float = 0.0,
    ) -> np.ndarray:
        """Units in which DG is nearly balanced (Osborne 1960), powers of two.

        ``sizes`` are those of the components on the windows so far, ``radii`` those of the initial
        set, and ``least`` the smallest to be balanced.
        """
        dim = self._equation.dim
        # A ball around zero gives a component its size: more than the radius, because roundings of
        # its shares in the unit are errors of the others, too. Errors of windows give none: they
        # are small in units of the component, which would be theirs.
        sizes = np.where(sizes < radii, _BESIDE * radii, sizes)
        safe = np.maximum(sizes_of_all(sizes, couplings, shares, w), least)
        safe = shared_sizes(safe, shares)
        matrix = couplings + 1e-3 / w * safe[:, None] / safe[None, :] * (1 - np.eye(dim))
        units = safe.copy()
        enclosures().balance(matrix, units)
        return powers_of_two(units)

    def all_units(self, units: np.ndarray) -> np.ndarray:
        """Those of the components, and of constants, which move them by them in half a window."""
        dim = self._equation.dim
        shares = np.zeros(self._equation.columns - dim)
        for i, j, place in self._equation.placed:
            if j >= dim:
                share = self._lemma.place.w * np.abs(self._rows[1][place]).max() / units[i]
                shares[j - dim] = max(shares[j - dim], share)
        found = 1 / shares
        return np.concatenate([units, np.where((found > 0) & (found < math.inf), found, 1.0)])


def still_values(models: ModelRows) -> np.ndarray:
    """Values at the points of what does not depend on the state, rounded, (still, points)."""
    places, terms = models.program.still_places, models.high.shape[1]
    used = np.arange(terms) < models.length[places, None]
    values = np.where(used, models.high[places] + models.low[places], 0.0)
    return enclosures().product(values, chebyshev_tables(terms).values)


def shortened(factor: float) -> float:
    """Return the first sixteen bits, since powers differ between processors in the last ones."""
    mantissa, exponent = math.frexp(factor)
    return math.ldexp(round(mantissa * 2**16), exponent - 16)


def sizes_of_all(
    sizes: np.ndarray, couplings: np.ndarray, shares: np.ndarray, w: float
) -> np.ndarray:
    """Sizes of all components, positive also for those that are at rest.

    Such a component has the size that the others drive it to, or else that which would move
    another one by its own size within w. Without such couplings, the product of a coordinate and
    its momentum is compared with those of the others: all have the dimension of H times time.
    Components are never compared otherwise, because they may have different dimensions.

    - shares: Those of the couplings within w.
    """
    found = shared_sizes(np.where(sizes > AT_REST, sizes, 0.0), shares)
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
            found[i] = _size_beside(i, couplings, shares, w, _UNCOUPLED * action or _LEAST)
        found = shared_sizes(found, shares)
    return found


def _size_beside(
    i: int, couplings: np.ndarray, shares: np.ndarray, w: float, action: float
) -> float:
    """The size of a component whose product with its partner is the square of ``action``."""
    dim = len(couplings)
    partner = (i + dim // 2) % dim
    alone = np.zeros(dim)
    alone[i] = 1.0
    ratio = float(shared_sizes(alone, shares)[partner])
    if ratio == 0:
        ratio = float(1 / (w * couplings[i, partner]))
    found = action / math.sqrt(ratio) if ratio > 0 else math.inf
    return found if 0 < found < math.inf else _LEAST
