"""OrbitCertificate: the proof of a periodic orbit, as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import hamsym
from hamsym.proof.ball import Ball
from hamsym.proof.balls import decimal_above
from hamsym.suggestions import suggest_attributes
from hamsym.support.shown import Shown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["OrbitCertificate"]


@suggest_attributes
@dataclass(frozen=True, eq=False)
class OrbitCertificate(Shown):
    """Proof that a periodic orbit exists, from :meth:`PeriodicOrbit.certify`.

    Attributes
    ----------
    z0 : Ball
        Contains the state of the true orbit in the plane across the flow through the numerical
        start, or in the set of its reversing symmetry; shape (dim,).
    period : Ball
        Contains its period.
    bound : float
        Largest distance of the true from the numerical state at the start and at all ends of
        pieces, relative to the size of each component.
    unique_within : float
        The same, of a ball of states and periods in which no other orbit meets these conditions:
        the plane or the fixed set at the start, the energy or the period, and the symmetry.
    monodromy : Ball
        Contains dz(T)/dz0 of the true orbit over one shift of its symmetry, and back by it; over
        the period without a symmetry. Shape (dim, dim).
    stability : str
        As :attr:`PeriodicOrbit.stability`, of one shift of the symmetry: "elliptic", "hyperbolic"
        or "mixed" with pairs that are proven to be simple, "complex unstable" of two pairs,
        "parabolic" where no pair is left; "unstable" if only one pair is proven to be off the unit
        circle; or "undecided". All but the last are proven. With forces "attracting", "repelling"
        or "unstable": all are inside the circle, outside it, or at least one is.
    pieces : int
    seconds : float
        Run time of the proof.
    statement : str
    """

    z0: Ball
    period: Ball
    bound: float
    unique_within: float
    monodromy: Ball = field(repr=False)
    stability: str
    pieces: int
    seconds: float
    statement: str = field(repr=False)

    def plot(self, *, ax: Any = None) -> Figure:
        """Draw the multipliers of the orbit about the unit circle.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes to draw into, in your own style.
        """
        return hamsym.plot(self, ax=ax)

    def __repr__(self) -> str:
        return (
            f"OrbitCertificate(period {float(self.period.mid)!r} +- "
            f"{decimal_above(float(self.period.radius))}, {self.stability}, {self.pieces:,} pieces)"
        )
