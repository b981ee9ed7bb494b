"""What a certificate of an orbit claims in words, and of which orbit."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Arc, Problem
from hamsym.proof.ball import Ball
from hamsym.support.records import digest_of

if TYPE_CHECKING:
    from hamsym.orbits.orbit import PeriodicOrbit


def statement_of(
    problem: Problem, period: Ball, bound: float, unique: float, stability: str, pieces: int
) -> str:
    """Return what is proven, in words."""
    energy = "" if problem.energy is None else f"of energy {float(problem.energy)!r} "
    places = "At its start" + (
        f" and at the ends of {pieces} equal parts of its arc" if pieces > 1 else ""
    )
    free = problem.autonomous and problem.period is None
    alike = "a period as near" if free else "the same period"
    if problem.energy is not None:
        alike += " and the same energy"
    if problem.closing.parts > 1:
        alike += " and symmetry"
    statement = (
        f"{_equation(problem.H)} has a periodic orbit {energy}with a period in "
        f"{period.mid!r} +- {_rounded_up(period.radius)}. {places} it is within "
        f"{_rounded_up(bound)} of the computed states, relative to the size of each component, "
        f"and no other one with {alike} is within {_rounded_down(unique)}."
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


def _rounded_down(value: float) -> str:
    return f"{value * 0.94:.1e}"
