"""Sets of states at the ends of windows, and windows that are proven.

The set of the states at the start of a window is

    z(t_a) in y(-1) + G r,   r: all vectors with |r_i| <= R_i.

The first columns of G are derivatives by the initial balls (Lohner 1992); each window appends the
identity with the radii of its own errors, and later windows multiply all columns by their
derivatives. So sets do not wrap. Only when there are too many columns are those of the errors
replaced by an orthogonal matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Annotated

import numpy as np

from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.directed import UNDERFLOW, UNIT, up
from hamsym.support.record_fields import floats

# Most columns of a set, whose products cost their square.
_MOST_COLUMNS = 2_048
# Mantissa from which numbers are rounded up to a power of two.
_THRESHOLD = 0.70137


def powers_of_two(units: np.ndarray) -> np.ndarray:
    """Return powers of two near numbers > 0, by which division is exact.

    Numbers are rounded where none of a formula lies: what differs between processors in the last
    bits, as eigenvalues do, gives the same powers.
    """
    mantissa, exponent = np.frexp(units)
    return np.ldexp(1.0, (exponent - (mantissa < _THRESHOLD)).clip(-1022, 1023))


def set_sizes(V: np.ndarray, G: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Bounds on the components of V(x) G r over a window for all |r_i| <= R_i, shape (dim,)."""
    product, found = enclosures().product, enclosures().moved_sizes(V, G, R)
    rounding = 2 * (len(G) + 8) * UNIT  # of sums of so many products
    large = product(enclosures().norms(V), product(np.abs(G), R))
    found += rounding * large + UNDERFLOW * (1 + R.sum())
    return np.asarray(up(found))


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
        """Bounds on the components, shape (columns, kinds); without columns exactly zero."""
        found = up(enclosures().product(np.abs(self.G), self.R))
        return np.asarray(found + UNDERFLOW if self.G.size else found)

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
        return ErrorSet(np.hstack([G, np.eye(columns)]), np.vstack([R, up(rest + extra)]), first)


@dataclass(frozen=True)
class Place:
    """A window that is tried: half its length, exact and rounded, and balls of time."""

    half: Fraction
    w: float
    #: middle, slope: The time is middle + slope x.
    middle: tuple[float, float, float]
    slope: tuple[float, float, float]


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
