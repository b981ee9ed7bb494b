"""The window lemma: bounds on the solutions from a set over a window, for any guess of y and V.

Lemmas 16 to 21 of examples/guide/how_proofs_work.md, with the numbers D, B, F, K, m, d and rho that
are bounded here. Nothing in this module knows how a guess was found: it imports no guess, and reads
of one only numbers, which may be any.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from hamsym.errors import CertificationError
from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.directed import MIDDLE, NORMAL, TINY, UNIT, nearest_up, two_sum, up
from hamsym.proof.arithmetic.programs import ModelRows
from hamsym.proof.windows.equation import Equation
from hamsym.proof.windows.window_sets import (
    ErrorSet,
    Place,
    Window,
    powers_of_two,
    set_sizes,
)

# Attempts at a tube, each of which doubles it.
_TUBES = 5


class TooLongError(Exception):
    """A window is too long: the factor of the length to try next, and why, where it is known."""

    def __init__(self, factor: float, reason: str = "") -> None:
        super().__init__(reason)
        self.factor, self.reason = factor, reason


@dataclass(frozen=True, eq=False)
class Start:
    """Bounds on the distance of the states at the start of a window from y(-1)."""

    #: On that of the centre of the set, shape (dim,).
    offset: np.ndarray
    #: On |xi|, that of all states and constants, shape (columns,).
    xi: np.ndarray


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds of the lemma."""

    #: On |z - y|, below rho, shape (dim,).
    tube: np.ndarray
    #: On |d - K xi|, shape (dim,).
    d: np.ndarray
    #: On |V_d - K|, shape (dim, columns).
    derivative: np.ndarray
    #: On |V|, shape (dim, columns).
    sizes: np.ndarray


class WindowLemma:
    """The lemma for one window after the other.

    - centre: Middle of the initial set, shape (columns,); the constants are the last.
    - radii: Of the initial set.
    """

    def __init__(
        self,
        equation: Equation,
        direction: int,
        centre: np.ndarray,
        radii: np.ndarray,
        terms: int,
    ) -> None:
        self.equation, self._terms = equation, terms
        dim = equation.dim
        self.signs = equation.signs * direction
        self.constants, self._unknown = centre[dim:].astype(float), radii[dim:].astype(float)
        #: State around which the set is, in twice float64.
        self.centre, self.centre_low = centre[:dim].astype(float), np.zeros(dim)
        #: z(-1) - centre, and the constants less their centres.
        self.set = ErrorSet.of_radii(radii.astype(float)[:, None])
        #: rates, jacobian: Registers of G along y, and of DG over the tube.
        self.rates, self.jacobian = (
            ModelRows(equation.rates, terms),
            ModelRows(equation.jacobian, terms),
        )
        self._energy = ModelRows(equation.energy, terms)
        #: Bounds on the defect of the present y, shape (dim,).
        self.D = np.full(dim, np.inf)

    # -- y and its defect --------------------------------------------------------------------------

    def enter(self, place: Place) -> None:
        """Begin a window: put the constants and its time into the programs along y.

        Raise CertificationError if float64 has no relative bound of its length.
        """
        if not place.w >= NORMAL:
            raise CertificationError(f"a window is shorter than {NORMAL}; use another unit of time")
        self.place = place
        for rows in (self.rates, self.jacobian):
            self._set_known(rows, 0.0)
            rows.run_still()

    def _set_known(self, rows: ModelRows, radii: np.ndarray | float) -> None:
        dim, columns = self.equation.dim, self.equation.columns
        rows.high[dim:columns, 0] = self.constants
        rows.radius[dim:columns] = radii
        rows.set_line(columns, self.place.middle, self.place.slope)

    @property
    def y(self) -> tuple[np.ndarray, np.ndarray]:
        """The coefficients of y, (dim, terms) each."""
        return self.rates.high[: self.equation.dim], self.rates.low[: self.equation.dim]

    def bound_defect(self, high: np.ndarray, low: np.ndarray) -> np.ndarray:
        """Take y and bound its defect D; return the coefficients of D, near it.

        Low parts become those within half an ulp of high ones, which bounds of products need.
        """
        rows, dim, rates = self.rates, self.equation.dim, self.equation.rates
        rows.high[:dim], rows.low[:dim] = two_sum(high, low)
        rows.length[:dim], rows.radius[:dim] = self._terms, 0.0
        series, self.D = enclosures().defects(
            rates.steps, rates.results, rows.models, dim, self.place.slope
        )
        return series

    # -- the set -----------------------------------------------------------------------------------

    def start(self) -> Start:
        """Bounds on xi, by the set and the distance of y(-1) from the centre."""
        high, low, radius = enclosures().end_values(*self.y, -1)
        gap = (high - self.centre) + (low - self.centre_low)
        rounding = MIDDLE * (np.abs(high) + np.abs(self.centre))
        offset = up(np.abs(gap) + rounding + radius) + TINY
        xi = self.set.sizes()[:, 0]
        xi[: len(offset)] += offset
        return Start(offset, up(xi))

    def _hull(self, V: np.ndarray, sizes: np.ndarray, start: Start, thin: bool) -> np.ndarray:
        """Bounds on |V xi| over the window, shape (dim,); of thin sets without their shape."""
        if thin:
            return np.asarray(up(enclosures().product(sizes, start.xi)))
        beside = enclosures().product(sizes[:, : len(start.offset)], start.offset)
        return np.asarray(up(set_sizes(V, self.set.G, self.set.R[:, 0]) + beside))

    # -- existence ---------------------------------------------------------------------------------

    def bounds(
        self, V: np.ndarray, units: np.ndarray, start: Start, least: np.ndarray, thin: bool
    ) -> Bounds:
        """Bounds with |z - y| < rho; raise TooLongError if there are none.

        - least: Part of the first rho that is tried.
        - thin: Whether the shape of the set does not matter; otherwise what is found in a wide
          tube is proven once more in a narrower one.
        """
        sizes, half = enclosures().norms(V), nearest_up(self.place.w)
        hull, signed = self._hull(V, sizes, start, thin), (self.equation.entries, self.signs)
        equation, accepted, before = self.equation, None, (np.empty(0), np.empty(0))
        tube = 1.5 * (hull + 2 * self.D) + least
        for _ in range(_TUBES):
            series, radius, length = self._jacobian_over(tube)
            if not all(map(np.array_equal, before, (series, length))):
                flow = enclosures().flow_defects(series, length, *signed, V, sizes, half)
                before = series, length
            over = series, radius, length, *signed, start.xi, hull, sizes
            found, d, derivative, _ = enclosures().transport(*over, *flow, self.D, half, units)
            if (found < tube).all():
                accepted = Bounds(found, d, derivative, sizes)
                if thin or (tube < 1.1 * found).all():
                    break
                tube = 1.02 * found
            elif accepted is not None or not np.isfinite(found).all():
                break
            else:
                tube = np.maximum(tube, 2 * found)
        if accepted is None:
            raise TooLongError(0.6, "the set of solutions became too wide")
        # Derivatives of H may be smooth where H is not, as those of acot(x) at 0.
        self._run_over(self._energy, accepted.tube)
        if not np.isfinite(self._energy.radius[equation.energy.results]).all():
            raise TooLongError(0.5, "H is not smooth there, or was not resolved")
        return accepted

    def _jacobian_over(self, tube: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Models of DG over |z - y| <= rho: coefficients, radii and lengths."""
        own = self.jacobian
        self._run_over(own, tube)
        places = self.equation.placed[:, 2]
        # A_0 has the upper bound of the half length, B what this is above w.
        radius = own.radius[places] + 8 * UNIT * np.abs(own.high[places]).sum(axis=1)
        return own.high[places], up(radius), own.length[places]

    def _run_over(self, rows: ModelRows, tube: np.ndarray) -> None:
        """Run a program over all states in the tube and all constants."""
        dim = self.equation.dim
        rows.high[:dim], rows.low[:dim] = self.y
        rows.length[:dim], rows.radius[:dim] = self._terms, tube
        self._set_known(rows, self._unknown)
        rows.run(double=False)

    # -- from window to window ---------------------------------------------------------------------

    def accepted(
        self, elapsed: Fraction, V: np.ndarray, units: np.ndarray, start: Start, found: Bounds
    ) -> Window:
        """The window of these bounds; the centre and the set become those at its end.

        - units: Of the components and the constants, any numbers > 0.

        Raise TooLongError if the set at the end is not finite.
        """
        units = powers_of_two(units)
        dim, columns = self.equation.dim, self.equation.columns
        high, low = self.y
        beside = up(enclosures().product(found.sizes[:, :dim], start.offset) + found.d + self.D)
        J, J_error, extra = np.eye(columns), np.zeros((columns, columns)), np.zeros(columns)
        J[:dim], rest, radius = enclosures().end_values(V, None, 1)
        J_error[:dim] = up(np.abs(rest) + radius)
        *centre, radius = enclosures().end_values(high, low, 1)
        extra[:dim] = up(beside + radius)
        moved = self.set.moved(J, J_error, extra[:, None], units)
        if not np.isfinite(moved.R).all():
            raise TooLongError(0.6, "the set of solutions became too wide")
        window = Window(
            start=elapsed,
            half=self.place.half,
            high=high.copy(),
            low=low.copy(),
            V=V,
            G=self.set.G,
            R=self.set.R[:, 0],
            beside=beside,
            derivative=found.derivative,
            J=J,
            J_error=J_error,
            tube=found.tube,
            units=units,
        )
        self.set, (self.centre, self.centre_low) = moved, centre
        return window
