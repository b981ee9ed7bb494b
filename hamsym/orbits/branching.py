"""The first orbit of a family that leaves another one at a bifurcation.

At a bifurcation Newton's system of orbits with less symmetry, or with twice the period, has two
null vectors: one along the family, and another one along the family that leaves it. The start is
moved along the latter, and Newton's method follows across it (Keller 1977).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from hamsym.errors import InputError
from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.continuation import Bifurcation, orbit_beside
from hamsym.orbits.integrals import slice_of
from hamsym.orbits.newton_system import NewtonSystem
from hamsym.orbits.orbit import PeriodicOrbit, solved_orbit
from hamsym.orbits.period import period_of
from hamsym.orbits.symmetry import Closing, SignedPermutation

#: Kinds of bifurcations at which another family of periodic orbits leaves.
LEAVING = ("branching", "period doubling", "symmetry breaking")

#: Of the first orbit, in states relative to the extents of the motion.
_AMPLITUDES = (0.02, 0.005, 0.05, 0.001)
_GAP = 1e-2  # ratio of the second singular value to the third one at a bifurcation
_APART = 0.1  # distance of the first orbit from the family, relative to its amplitude
_PLACES, _POINTS = 12, 1000  # of an orbit, and of another one that is compared with it


def first_of_branch(
    found: Bifurcation,
    beside: PeriodicOrbit,
    parameter: str | None,
    size: float,
    side: int,
    tol: float,
) -> PeriodicOrbit:
    """Compute an orbit of the family that leaves at a bifurcation.

    Raise InputError if none is found.

    - beside: Another orbit of the family, near the bifurcation.
    - parameter, size: The parameter that varies along the family, and its size.
    - side: 1 or -1, the sense of the null vector.
    """
    for problem, arc, turns in _less_symmetric(found, parameter, size):
        share = turns * beside.period / problem.closing.parts
        change = [(beside(problem.start + share * arc.edges) - arc.ends).ravel()]
        change.append(np.array([turns * beside.period - arc.period, 0.0]))
        if parameter is not None:
            change[1][1] = beside.H.parameters[parameter] - problem.H.parameters[parameter]
        leaving = _leaving(problem, arc, np.concatenate(change))
        if leaving is None:
            continue
        system, direction, units = leaving
        for amplitude in _AMPLITUDES:
            moved = side * amplitude * direction * units
            orbit = orbit_beside(problem, arc, system, moved, (direction, units), tol)
            if orbit is not None and is_new(orbit, found.orbit, parameter, amplitude, tol):
                return orbit
    name, value = "energy", found.orbit.energy
    if parameter is not None:
        name, value = parameter, found.orbit.H.parameters[parameter]
    raise InputError(
        f"no orbit of another family was found at the {found.kind} at {name} {value:.10g}; "
        "continue the family with smaller steps (max_step=)"
    )


def _less_symmetric(
    found: Bifurcation, parameter: str | None, size: float
) -> Iterator[tuple[Problem, Arc, int]]:
    """Problems whose solutions may leave the family, with the arc of the bifurcation and its number
    of periods.
    """
    orbit = found.orbit
    problem = replace(orbit.problem, parameter=parameter, parameter_size=size)
    if parameter is None:
        problem = replace(problem, energy=None, period=None, exact_period=None)
    whole = Closing(SignedPermutation.identity(orbit.H.dim))
    if found.kind == "branching":
        yield problem, orbit.arc, 1
        if problem.closing == whole:
            return
    turns = 2 if found.kind == "period doubling" else 1
    if problem.exact_period is not None:
        exact = period_of(problem.H, turns * problem.exact_period.formula)
        problem = replace(problem, period=turns * orbit.period, exact_period=exact)
    yield replace(problem, closing=whole), _unfolded(orbit, turns), turns


def _unfolded(orbit: PeriodicOrbit, turns: int) -> Arc:
    """The arc over a number of periods, without symmetry."""
    arc, closing = orbit.arc, orbit.problem.closing
    count = turns * closing.parts
    edges, ends, values = [np.zeros(1)], [arc.ends[:1]], []
    for part in range(count):
        own, states, inside = arc.edges, arc.ends, arc.values
        if closing.reversing and part % 2:
            own, states, inside = 1 - own[::-1], states[::-1], inside[::-1, ::-1]
        edges.append((part + own[1:]) / count)
        ends.append(closing.unfolded(part % closing.parts, states[1:]))
        values.append(closing.unfolded(part % closing.parts, inside))
    return Arc(
        np.concatenate(edges), np.concatenate(ends), np.concatenate(values), turns * arc.period
    )


def _leaving(
    problem: Problem, arc: Arc, along: np.ndarray
) -> tuple[NewtonSystem, np.ndarray, np.ndarray] | None:
    """The null vector that leads away from the family, or None if there is no second one.

    - along: Changes of all unknowns to a neighbour of the family, shape (n,).
    - returns: Newton's system, and the direction with its units: states at the ends of windows,
      whose root mean square is 1 in natural units, the period and the parameter.
    """
    with np.errstate(all="ignore"):
        system = NewtonSystem(problem, arc, slice_of(problem, arc))
        vectors = system.null_vectors(_GAP)
    if vectors is None:
        return None
    count = arc.ends.size
    # Coordinates count alike in the extent of the motion, and momenta.
    units = np.concatenate([np.tile(_extents(problem, arc), len(arc.ends)), system.units[count:]])
    weights = np.ones(len(units))
    weights[:count] = 1 / np.sqrt(count)
    vectors = vectors * system.units / units * weights
    # Of their combinations the one nearest to the neighbour is along the family.
    shares = np.linalg.lstsq(vectors.T, along / units * weights, rcond=None)[0]
    products = vectors @ vectors.T @ shares
    found = (products[1] * vectors[0] - products[0] * vectors[1]) / weights
    size = np.sqrt(np.mean(found[:count] ** 2))
    if not 0 < size < np.inf:
        return None
    largest = found[np.argmax(np.abs(found[:count]))]
    return system, found / size * np.sign(largest), units


def _extents(problem: Problem, arc: Arc) -> np.ndarray:
    """Extents of components that move as far as the largest; of an orbit at rest, their sizes."""
    extents = np.ptp(arc.ends, axis=0)
    return problem.paired(extents if extents.any() else problem.scale_of(arc), arc)


def is_new(
    orbit: PeriodicOrbit, old: PeriodicOrbit, parameter: str | None, amplitude: float, tol: float
) -> bool:
    """Whether an orbit is not that of the family with the same energy or parameter."""
    problem = replace(old.problem, H=orbit.H)
    if parameter is None:
        problem = replace(problem, energy=orbit.energy, period=None, exact_period=None)
    other = solved_orbit(problem, old.arc, tol)
    if not other.success:
        other = old
    start = problem.start
    path = other(start + np.linspace(0, other.period, _POINTS))
    states = orbit(start + np.linspace(0, orbit.period, _PLACES))
    units = _extents(old.problem, old.arc)
    path, states = path / units, states / units
    legs = np.diff(path, axis=0)
    from_start = states[:, None] - path[:-1]
    lengths = np.maximum((legs**2).sum(-1), np.finfo(float).tiny)  # 0 of an orbit at rest
    along = np.clip((from_start * legs).sum(-1) / lengths, 0, 1)
    distances = np.linalg.norm(from_start - along[..., None] * legs, axis=-1).min(axis=1)
    return bool(distances.max() > _APART * amplitude)
