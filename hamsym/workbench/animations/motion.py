"""States of a result at any times: what an animation shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.trajectory import Trajectory
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.solution.solution import Solution

#: Members of an ensemble that are drawn.
MOST_MEMBERS = 50


@dataclass(frozen=True)
class Motion:
    """States of one or several trajectories over a time span."""

    H: Hamiltonian
    #: From where states are finite to where they are.
    span: tuple[float, float]
    #: Times of shape (n,) to states of shape (n, members, dim).
    at: Callable[[np.ndarray], np.ndarray]
    #: Whether it repeats after the span.
    closed: bool = False
    #: Parameters that differ between the members.
    varied: tuple[str, ...] = ()
    #: Of each member, shape (members, k); None where all have those of H.
    parameters: np.ndarray | None = None
    #: What is not drawn, in words.
    notes: tuple[str, ...] = ()
    #: What did not succeed, in words; empty if all did.
    failure: str = ""


def motion_of(result: Any) -> Motion:
    """Return the motion of a solution, of solutions, a trajectory or a periodic orbit.

    Raise InputError if the result is of another type, or ends where it begins.
    """
    if isinstance(result, Solution):
        failure = "" if result.success else f"No success: {result.message}"
        found = Motion(result.H, result.span, lambda t: result(t)[:, None], failure=failure)
    elif isinstance(result, Solutions):
        found = _of_solutions(result)
    elif isinstance(result, Trajectory):
        found = _of_trajectory(result)
    elif isinstance(result, PeriodicOrbit):
        found = _of_orbit(result)
    else:
        raise InputError(
            f"{type(result).__name__} cannot be animated; give a solution, solutions, a "
            "trajectory or a periodic orbit"
        )
    if not found.span[1] - found.span[0]:
        raise InputError("the trajectory ends where it begins; there is no motion to animate")
    return found


def _of_solutions(solutions: Solutions) -> Motion:
    first = solutions.members.ravel()[:MOST_MEMBERS]
    shown = Solutions(solutions.family, solutions.table, solutions.windows, first)
    return Motion(
        solutions.H,
        solutions.span,
        lambda t: np.moveaxis(shown(t), 0, 1),
        varied=tuple(solutions.parameters),
        parameters=shown.own_parameters,
        notes=_left_out(solutions.size),
        failure=_failed(np.asarray(shown.success)),
    )


def _of_trajectory(trajectory: Trajectory) -> Motion:
    z = trajectory.z.reshape(-1, *trajectory.z.shape[-2:])
    count, z = len(z), z[:MOST_MEMBERS]
    members = trajectory.ensemble
    values = members.own_parameters(np.s_[:MOST_MEMBERS, None])
    rates = members.H.compile("numpy").at("vector_field", z, trajectory.t, values)
    direction = 1 if trajectory.t[-1] >= trajectory.t[0] else -1
    pieces = [
        _spline(direction * trajectory.t, path, direction * rate)
        for path, rate in zip(z, rates, strict=True)
    ]
    if not members.shape:
        failure = "" if trajectory.success else f"No success: {trajectory.message}"
    elif np.ndim(trajectory.success):
        failure = _failed(np.ravel(trajectory.success)[:MOST_MEMBERS])
    else:  # whether all of them reached the end
        failure = _failed(np.isfinite(z[:, -1]).all(axis=1))
    return Motion(
        members.H,
        (float(trajectory.t[0]), float(trajectory.t[-1])),
        lambda t: np.stack([piece(direction * t) for piece in pieces], axis=1),
        varied=tuple(members.varied),
        parameters=members.own_parameters(np.s_[:MOST_MEMBERS]),
        notes=_left_out(count),
        failure=failure,
    )


def _spline(t: np.ndarray, z: np.ndarray, rates: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Cubic Hermite interpolation up to the last finite state; nan after it."""
    finite = np.isfinite(z).all(axis=1) & np.isfinite(rates).all(axis=1)
    end = len(t) if finite.all() else int(np.argmin(finite))
    if end < 2:
        return lambda times: np.where(times[:, None] <= t[0], z[:1], np.nan)
    spline = CubicHermiteSpline(t[:end], z[:end], rates[:end], extrapolate=False)
    return lambda times: np.asarray(spline(times))


def _of_orbit(orbit: PeriodicOrbit) -> Motion:
    start = orbit.problem.start
    failure = "" if orbit.success else f"No success: {orbit.message}"
    span = start, start + orbit.period
    return Motion(orbit.H, span, lambda t: orbit(t)[:, None], closed=True, failure=failure)


def _left_out(count: int) -> tuple[str, ...]:
    if count <= MOST_MEMBERS:
        return ()
    return (f"Drawn are the first {MOST_MEMBERS} of {count:,} members",)


def _failed(success: np.ndarray) -> str:
    failed = int((~success).sum())
    return f"{failed:,} of {success.size:,} members did not succeed." if failed else ""
