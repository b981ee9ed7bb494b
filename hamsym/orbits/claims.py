"""What a certificate of an orbit claims in words, and of which orbit."""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.description import described
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Problem
from hamsym.orbits.symmetry import SignedPermutation
from hamsym.proof.ball import Ball

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
    problem, arc = orbit.problem, orbit.arc
    exact = None if problem.exact_period is None else str(problem.exact_period.formula)
    values: dict[str, Any] = {
        "version": 1,
        "H": described(orbit.H),
        "energy": None if problem.energy is None else float(problem.energy).hex(),
        "period": [None if problem.period is None else float(problem.period).hex(), exact],
        "start": float(problem.start).hex(),
        "parameter": problem.parameter,
        "closing": [
            _map(each)
            for each in (problem.closing.shift, problem.closing.first, problem.closing.last)
        ],
    }
    found = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for numbers in (arc.edges, arc.ends, arc.values, np.array(arc.period)):
        data = np.asarray(numbers).astype("<f8")
        found.update(f"{list(data.shape)} ".encode())
        found.update(data.tobytes())
    return found.hexdigest()


def _map(symmetry: SignedPermutation | None) -> Any:
    return None if symmetry is None else [[*symmetry.places], [*symmetry.signs]]


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
