"""Certificates: proven bounds on the error of a solution, as data and as JSON."""

from __future__ import annotations

import math
from bisect import bisect_left, bisect_right
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.formula.parser import check_name
from hamsym.proof.arithmetic.balls import decimal, decimal_above, decimal_below
from hamsym.support.record_fields import Limit, Written
from hamsym.support.sealed_text import SealedText
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.validation import checked_numbers

# Difference of upper and lower bounds that is always small enough, in units of the components.
FLOOR = 2.0**-60

LEAST_RTOL, MOST_RTOL = 1e-6, 1e6
_MOST_EDGES = 200_000  # times that divide the span

_Bound = Annotated[float, Written(decimal)]
_Exact = Annotated[float, Written(repr)]


@suggest_attributes
@dataclass(frozen=True)
class Certificate(SealedText):
    """Proven two-sided bounds on the error of one solution, the largest over its span.

    ``plot()`` draws the proven bound over time, and the bounds of each component;
    ``plot("bound")`` and ``plot("components")`` draw one of these panels.

    Attributes
    ----------
    bound, lower : float
        Bounds on the largest |z^(t) - z(t)| over the span, in the 2-norm.
    component_bounds, component_lowers : tuple of float
        The same for each of the dim components.
    energy_bound, energy_lower : float
        For max_t |H(z^(t)) - H(z(t))|; the bound is infinite where H is singular along z^.
    ell_max_bound, ell_max_lower : float
        For max_t |dz^/dt - J grad H(z^)|, the 2-norm.
    edges : tuple of float
        Distinct times that divide the span into pieces, in its direction.
    piece_bounds : tuple of float
        A bound on |z^(t) - z(t)| on each piece, both edges included. Where two windows of a
        solution meet, z^ has two values, which differ by round-off: at such an edge the bound of a
        piece applies to the value of the window in that piece, and :meth:`bound_at` bounds both.
    rtol : float
        Relative tolerance of the difference between upper and lower bounds.
    digest : str
        SHA-256 of what defines the solution: H, its parameters, z0, the span and all weights.
    seconds : float
        Run time of the proof. ``rtol`` and ``seconds`` are not part of the claim.
    components : tuple of str
        Names of the components, for texts and figures.
    asked : tuple of float or None
        The bound on each component's error that was asked for, and is proven.
    """

    _KIND = "hamsym certificate"
    _VERSION = 4
    _LONGEST = 16 * 2**20
    _OF = ""

    bound: _Bound
    lower: _Bound
    component_bounds: tuple[_Bound, ...]
    component_lowers: tuple[_Bound, ...]
    energy_bound: _Bound
    energy_lower: _Bound
    ell_max_bound: _Bound
    ell_max_lower: _Bound
    edges: Annotated[tuple[_Exact, ...], Limit(most=_MOST_EDGES)] = field(repr=False)
    piece_bounds: Annotated[tuple[_Bound, ...], Limit(most=_MOST_EDGES)] = field(repr=False)
    rtol: _Exact
    digest: str = field(repr=False)
    seconds: _Exact = field(compare=False)
    components: tuple[str, ...] = field(compare=False)
    asked: tuple[_Exact, ...] | None = None

    def check(self) -> None:
        """Raise ValueError unless the ranges and the order of the numbers are those of a proof."""
        if not LEAST_RTOL <= self.rtol <= MOST_RTOL:
            raise ValueError("its rtol is out of range")
        if not 0 <= self.seconds < math.inf:
            raise ValueError("its seconds are not a duration")
        if self.asked is not None:
            pairs = zip(self.component_bounds, self.asked, strict=True)
            if not all(0 <= bound <= asked < math.inf for bound, asked in pairs):
                raise ValueError("the bounds that it was asked for are not proven by its own")
        if len(self.components) != len(self.component_bounds) or (
            len({*self.components}) != len(self.components)
        ):
            raise ValueError("its components do not have a name each")
        for name in self.components:
            check_name(name)
        _check_pieces(self.edges, self.piece_bounds)
        _check_bounds(self)

    def __repr__(self) -> str:
        start, end = self.edges[0], self.edges[-1]
        return (
            f"Certificate(error at least {decimal(self.lower)} and at most {decimal(self.bound)}, "
            f"t from {start:.6g} to {end:.6g})"
        )

    @property
    def span(self) -> tuple[float, float]:
        """First and last of the edges."""
        return self.edges[0], self.edges[-1]

    def bound_at(self, t: Any) -> Any:
        """A proven bound on |z^(t) - z(t)|, the 2-norm, at times t of the span.

        Parameters
        ----------
        t : float or array

        Returns
        -------
        float or numpy.ndarray
            Shaped as t; at an edge the larger bound of the two pieces that meet there.

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        times = checked_numbers("t", t)
        values = np.array([self._bound_at(float(time)) for time in times.ravel()])
        return float(values[0]) if times.ndim == 0 else values.reshape(times.shape)

    def _bound_at(self, t: float) -> float:
        direction = 1 if self.edges[-1] > self.edges[0] else -1
        edges = [direction * edge for edge in self.edges]
        # At an edge both neighbours count, because z^ may have the values of two windows.
        first = bisect_left(edges, direction * t) - 1
        last = bisect_right(edges, direction * t) - 1
        if last < 0 or first >= len(self.piece_bounds) or not math.isfinite(t):
            start, end = self.edges[0], self.edges[-1]
            raise InputError(f"t = {t:.16g} is outside the span from {start:.16g} to {end:.16g}")
        places = range(max(first, 0), min(last, len(self.piece_bounds) - 1) + 1)
        return max(self.piece_bounds[place] for place in places)

    @property
    def statement(self) -> str:
        """The claim in words."""
        asked = ""
        if self.asked is not None:
            asked = (
                "As asked, the error of each component is proven to be at most "
                f"{', '.join(map(decimal, self.asked))}. "
            )
        return (
            f"Proven: the largest |z^(t) - z(t)| (2-norm) for t from {self.edges[0]!r} to "
            f"{self.edges[-1]!r} is at least {decimal(self.lower)} and at most "
            f"{decimal(self.bound)}. {asked}Here z is the exact solution of Hamilton's equations "
            "from z0, and z^ the real function that the stored weights of the solution define, "
            "without the rounding of its evaluation in floating point, which comes on top. z0, the "
            "span, the parameters and all weights are taken as the exact binary fractions that "
            "they are, numbers in the formula of H as the exact numbers written there. The proof "
            "solves the equation once more: on windows, polynomials near the exact solution and "
            "its derivatives with rigorous bounds on their distance (defect, logarithmic norm, "
            "sets of Lohner), and Chebyshev models of z^, in sums of two float64 numbers, 106 "
            "bits, with bounds on every rounding. It rests on the correctness of float64 "
            "arithmetic (IEEE 754), of Arb for constants and of this program; verify() runs it "
            "again. "
            f"SHA-256 of the solution: {self.digest}."
        )


def _check_pieces(edges: tuple[float, ...], bounds: tuple[float, ...]) -> None:
    if len(edges) != len(bounds) + 1 or not bounds or len(edges) > _MOST_EDGES:
        raise ValueError("the numbers of its edges and pieces do not match")
    direction = 1 if edges[-1] > edges[0] else -1
    if not all(
        math.isfinite(low) and math.isfinite(high) and direction * low < direction * high
        for low, high in pairwise(edges)
    ):
        raise ValueError("its edges are not in order")
    if not all(bound >= 0 for bound in bounds):
        raise ValueError("its bounds on pieces are not numbers from 0 on")


def _check_bounds(claims: Certificate) -> None:
    if len(claims.component_bounds) != len(claims.component_lowers):
        raise ValueError("the numbers of its component bounds do not match")
    lowers = (claims.lower, *claims.component_lowers, claims.energy_lower, claims.ell_max_lower)
    uppers = (claims.bound, *claims.component_bounds, claims.energy_bound, claims.ell_max_bound)
    if not all(
        0 <= low <= high and math.isfinite(low) for low, high in zip(lowers, uppers, strict=True)
    ):
        raise ValueError("its bounds are not in order")


def rounded_up(value: float) -> float:
    return float(decimal_above(value))


def rounded_down(value: float) -> float:
    return float(decimal_below(value))
