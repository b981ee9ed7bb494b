"""OrbitCertificate: the proof of a periodic orbit, as data and in words."""

from __future__ import annotations

from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated

import numpy as np

import hamsym
from hamsym.errors import CertificationError, FileError, InputError
from hamsym.formula.parser import check_name
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.integrals import shared_integrals
from hamsym.orbits.orbit_check import check_orbit
from hamsym.orbits.proven_stability import WEAKER
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import decimal_above
from hamsym.support.record_fields import Limit, Size
from hamsym.support.records import digest_of
from hamsym.support.sealed_text import SealedText
from hamsym.support.suggestions import suggest_attributes

if TYPE_CHECKING:
    from hamsym.orbits.orbit import PeriodicOrbit


@suggest_attributes
@dataclass(frozen=True, eq=False)
class OrbitCertificate(SealedText):
    """Proof that a periodic orbit exists, from :meth:`PeriodicOrbit.certify`.

    ``plot()`` draws the multipliers of the orbit about the unit circle.

    Attributes
    ----------
    z0 : Ball
        Contains the state of the true orbit in the plane across the flow, and across the symmetries
        of further integrals, through the numerical start, or in the set of its reversing symmetry;
        shape (dim,).
    period : Ball
        Contains its period.
    bound : float
        Largest distance of the true from the numerical state at the starts of all pieces, relative
        to the size of each component.
    unique_within : float
        Distance from the true orbit, in the states at these places and in the period, relative to
        the same sizes, within which no other orbit meets the same conditions: the planes or the
        fixed set at the start, the energy or the period, and the symmetry.
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
        Run time of the proof; not part of the claim.
    statement : str
    digest : str
        SHA-256 of the orbit: H, its parameters, the conditions, and the states of its arc.
    components : tuple of str
        Names of the components of ``z0``.
    """

    _KIND = "hamsym orbit certificate"
    _VERSION = 5  # the bound of version 4 left out components that a symmetry makes zero
    _LONGEST = 2**22
    _OF = " of an orbit"

    z0: Ball
    period: Ball
    bound: Size
    unique_within: Size
    monodromy: Ball = field(repr=False)
    stability: str
    pieces: Annotated[int, Limit(1)]
    seconds: Size
    statement: str = field(repr=False)
    digest: str = field(repr=False)
    components: tuple[str, ...] = field(repr=False)

    def check(self) -> None:
        """Raise ValueError unless its balls are those of an orbit, and its stability is proven."""
        dim = np.size(self.z0.mid)
        shapes = [np.shape(ball.mid) for ball in (self.z0, self.period, self.monodromy)]
        if shapes != [(dim,), (), (dim, dim)] or not self.period.lower > 0:
            raise ValueError(
                "its balls do not have the shapes of an orbit, or its period is not > 0"
            )
        if len({*self.components}) != dim:
            raise ValueError("its components do not have a name each")
        for name in self.components:
            check_name(name)
        if self.stability not in WEAKER:
            raise ValueError("its stability is none that a proof gives")

    def __repr__(self) -> str:
        return (
            f"OrbitCertificate(period {float(self.period.mid)!r} +- "
            f"{decimal_above(float(self.period.radius))}, {self.stability}, {self.pieces:,} pieces)"
        )

    def verify(self, orbit: PeriodicOrbit, *, time_limit: float | None = None) -> None:
        """Prove the claims again; see :func:`hamsym.verify`."""
        self._require_form(orbit)
        found = hamsym.prove_orbit(orbit, time_limit=time_limit)
        proven = {
            "z0": _is_within(found.z0, self.z0),
            "period": _is_within(found.period, self.period),
            "monodromy": _is_within(found.monodromy, self.monodromy),
            "bound": found.bound <= self.bound,
            "unique_within": self.unique_within <= found.unique_within,
            "stability": self.stability in (found.stability, *WEAKER[found.stability]),
            "pieces": self.pieces == found.pieces,
            "components": self.components == found.components,
        }
        for name, holds in proven.items():
            if not holds:
                raise CertificationError(f"the {name} of the certificate is not proven")

    def require_form(self, orbit: PeriodicOrbit) -> None:
        """Require that the certificate is one of an orbit, which evaluates its stored states."""
        self._require_form(orbit)
        check_orbit(orbit, orbit.arc.edges[:-1], orbit.arc.ends[:-1])

    def _require_form(self, orbit: PeriodicOrbit) -> None:
        if not isinstance(orbit, hamsym.PeriodicOrbit):
            raise InputError(
                f"a certificate of an orbit needs its PeriodicOrbit, not {type(orbit).__name__}"
            )
        try:
            type(self).from_json(self.to_json())
        except (FileError, ValueError, TypeError) as error:
            raise CertificationError(f"not a valid certificate: {error}") from None
        if orbit_digest(orbit) != self.digest:
            raise CertificationError(
                "the certificate does not belong to this orbit (SHA-256 mismatch)"
            )
        numbers = self.period, self.bound, self.unique_within, self.stability, self.pieces
        if self.statement != statement_of(orbit.problem, *numbers):
            raise CertificationError("the statement of the certificate does not match its numbers")


def _is_within(inner: Ball, outer: Ball) -> bool:
    """Whether every number of a ball is in another one, decided exactly."""
    if np.shape(inner.mid) != np.shape(outer.mid):
        return False
    numbers = (
        np.ravel(part).tolist() for ball in (inner, outer) for part in (ball.mid, ball.radius)
    )
    return all(
        np.isfinite(r) and abs(Fraction(a) - Fraction(b)) + Fraction(r) <= Fraction(s)
        for a, r, b, s in zip(*numbers, strict=True)
        if np.isfinite(s)
    )


# -- what is claimed, in words ---------------------------------------------------------------------


def statement_of(
    problem: Problem, period: Ball, bound: float, unique: float, stability: str, pieces: int
) -> str:
    """Return what is proven, in words."""
    energy = "" if problem.energy is None else f"of energy {float(problem.energy)!r} "
    places = f"At the starts of {pieces} parts of its arc" if pieces > 1 else "At its start"
    free = problem.autonomous and problem.period is None
    alike = "a period as near" if free else "the same period"
    if problem.energy is not None:
        alike += " and the same energy"
    if problem.closing.parts > 1:
        alike += " and symmetry"
    further = [each for each in shared_integrals(problem.H, problem.closing) if each != problem.H]
    fixed = problem.closing.first is not None
    across = ["the flow"] * (problem.autonomous and not fixed)
    across += ["the motions that its integrals generate"] * bool(further)
    starts = ["the fixed set of the symmetry"] * fixed
    if across:
        starts.append(f"the plane{'s' * bool(further)} across {' and '.join(across)}")
    where = f" that starts in {' and '.join(starts)}" if starts else ""
    statement = (
        f"{_equation(problem.H)} has a periodic orbit {energy}with a period in "
        f"{period.mid!r} +- {_rounded_up(period.radius)}. {places} it is within "
        f"{_rounded_up(bound)} of the computed states, relative to the size of each component, "
        f"and no other one with {alike}{where} is within {unique * 0.94:.1e} of it."
    )
    return statement if stability == "undecided" else f"{statement} It is {stability}."


def orbit_digest(orbit: PeriodicOrbit) -> str:
    """SHA-256 of an orbit: H, the conditions that it meets, and the states of its arc."""
    return digest_of((orbit.problem, orbit.arc), tuple[Problem, Arc])


def _equation(H: Hamiltonian) -> str:
    """H with its forces and the values of its parameters."""
    forces = [f"the force {text} on {name}" for name, text in H.force_texts.items()]
    values = [f"{name} = {value!r}" for name, value in H.parameters.items()]
    parts = [*forces, *values]
    return f"H = {H.formula}" + (f", with {', '.join(parts)}," if parts else "")


def _rounded_up(value: float) -> str:
    return f"{value * 1.06:.1e}" if value else "0"
