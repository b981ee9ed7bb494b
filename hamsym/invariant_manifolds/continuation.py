"""Continuation of a connection in the energy of its orbits, or in a parameter of H."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from hamsym.dynamics.equilibria import equilibria
from hamsym.errors import InputError
from hamsym.invariant_manifolds.connection import Connection, connection_of
from hamsym.invariant_manifolds.manifold import LOCAL
from hamsym.invariant_manifolds.meeting import Side, meet
from hamsym.invariant_manifolds.origins import Departure, Origin, departure
from hamsym.orbits.family import orbit_family
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.problems.surface import parse_surface
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require, require_number, require_whole

_HALVINGS = 5  # of a step
_TOL = 1e-9  # of which the local manifolds are a small share


@checked_keywords
def connection_family(
    connection: Connection,
    *,
    energy: float | None = None,
    parameter: tuple[str, float] | None = None,
    steps: int = 8,
    tol: float = 1e-10,
) -> tuple[Connection, ...]:
    """Continue a connection until its orbits have an energy, or H a value of a parameter.

    At each step the origins and their local manifolds are computed again, and Newton's method
    begins at the connection before. A step at which it fails is halved, up to five times.

    Parameters
    ----------
    connection : Connection
        Successful.
    energy : float, optional
        Of the last connection, between periodic orbits.
    parameter : (str, float), optional
        A parameter of H and its last value; orbits keep their energy.
    steps : int
        Number of equal steps.
    tol : float
        Largest mismatch, as of :func:`hamsym.connections`.

    Returns
    -------
    tuple of Connection
        The first one is ``connection``. The last one has the energy or value that was asked for,
        unless the family was lost before, as at a tangency of the manifolds.

    Raises
    ------
    InputError
        If the arguments do not fit the connection.
    """
    require(isinstance(connection, Connection), "connection", connection, "a Connection")
    if not connection.success:
        raise InputError("the connection did not succeed; continue one that did")
    if (energy is None) == (parameter is None):
        raise InputError("give one of energy and parameter as the target")
    require_whole("steps", steps)
    if energy is not None:
        require_number("energy", energy)
        if not all(isinstance(origin, PeriodicOrbit) for origin in connection.origins):
            raise InputError("an equilibrium has one energy; continue in a parameter of H")
        name, here, target = None, connection.energy, float(energy)
    else:
        name, here, target = _checked(connection, parameter)
    path, step = [connection], (target - here) / steps
    least = abs(step) / 2**_HALVINGS
    while here != target:
        there = target if abs(target - here) <= 1.001 * abs(step) else here + step
        found = _next(path[-1], name, there, tol)
        if found is not None:
            path.append(found)
            here = there
        elif abs(step) > least:
            step /= 2
        else:
            break
    return tuple(path)


def _checked(connection: Connection, parameter: object) -> tuple[str, float, float]:
    if not (isinstance(parameter, Sequence) and len(parameter) == 2):
        raise InputError('parameter must be a pair of a name and a value, such as ("mu", 0.1)')
    name, value = parameter
    if name not in connection.H.parameters:
        raise InputError(f"H has no parameter {name!r} with a value; name one that it has")
    require_number(f"the value of {name}", value)
    return str(name), float(connection.H.parameters[name]), float(value)


def _next(before: Connection, name: str | None, value: float, tol: float) -> Connection | None:
    """The connection at a value of the energy or of a parameter; None if none is found."""
    first = _origin_at(before.origins[0], name, value)
    same = before.origins[0] is before.origins[1]
    second = first if same else _origin_at(before.origins[1], name, value)
    if first is None or second is None:
        return None
    try:
        sides = [
            _carried(side, departure(origin, side.leaving.sign, LOCAL * _TOL))
            for side, origin in zip(before.met.sides, (first, second), strict=True)
        ]
    except InputError:  # the origin is no more hyperbolic
        return None
    where = parse_surface(sides[0].leaving.H, before.surface)
    met = meet((sides[0], sides[1]), where, tol)
    if met is None or not met.mismatch <= tol:
        return None
    found = connection_of((first, second), where, met, tol)
    return found if found.success else None


def _origin_at(origin: Origin, name: str | None, value: float) -> Origin | None:
    if isinstance(origin, PeriodicOrbit):
        target: Any = {"energy": value} if name is None else {"parameter": (name, value)}
        family = orbit_family(origin, **target, progress=False)
        return family[-1] if family.success else None
    if origin.H is None or name is None:
        return None
    found = equilibria(origin.H.with_parameters(**{name: value}), guess=origin.z)
    return min(found, key=lambda one: float(np.abs(one.z - origin.z).max()), default=None)


def _carried(side: Side, leaving: Departure) -> Side:
    """The side that leaves another local manifold at the same distance from its origin."""
    before = side.leaving
    old, new = (each.local.series[1 : 1 + len(each.rates)] for each in (before, leaving))
    if len(old) != len(new):
        raise InputError("the origin has another number of exponents")
    scale = before.local.scale
    ratio = float(np.linalg.norm(new / scale) / np.linalg.norm(old / scale))
    direction = side.direction
    if len(direction) == 1 and float(((old / scale) @ (new / scale).T).real.sum()) < 0:
        direction = -direction
    slowest = float(np.abs(leaving.rates).min())
    if leaving.period is None:
        time = side.time - math.log(ratio) / float(leaving.rates.real.min())
        return replace(side, leaving=leaving, direction=direction, time=max(time, side.time / 4))
    phase = side.phase + math.log(ratio) / math.log(slowest)
    time = side.time * leaving.period / (before.period or leaving.period)
    return replace(side, leaving=leaving, direction=direction, phase=phase, time=time).within()
