"""Search for a periodic orbit: a first arc from a guess, Newton's method, refinement of windows."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.optimize import minimize_scalar

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import floored_sizes
from hamsym.orbits.arc import Arc, Problem, coupling_along, vector_field_at
from hamsym.orbits.integrals import slice_of
from hamsym.orbits.newton_system import NewtonSystem, Step
from hamsym.orbits.symmetry import Closing
from hamsym.random_features.basis import feature_basis
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import march
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March

_NODES, _FEW_NODES, _MANY = 20, 12, 20  # points in a window; fewer from so many components on
_EXTRA_NODES = 8  # of the check
_ITERATIONS = 30
_HALVINGS = 6  # of a Newton step
_SLOW, _MOST_SLOW = 0.1, 4  # share of a step that is slow, and the number of slow ones
# Step from which corrections that are larger than the first one by a factor end the search.
_WANDERS, _AWAY = 6, 3.0
_CONVERGED = 1e-12  # size of a correction; later ones are round-off
# Coefficients that a window leaves out, relative to the components, and those that windows are
# halved for twice: they may be round-off of a component.
_TAIL, _SMALL_TAIL, _SMALL_ROUNDS = 1e-13, 1e-14, 2
_REFINEMENTS = 12
_MOST_WINDOWS = 20_000
_MOST_ENTRIES = 100_000_000  # of the derivatives at the points of all windows
_LOCAL, _MARCH_NODES = 1e-13, 16  # local tolerance of a march along a guess, and its points
_IN_A_WINDOW = 1_000  # windows of a march in one of an arc, at most
_SHOTS = 3  # corrections of the start before the search
_FAST, _SLOW_START = 1e-3, 1e-2  # change of states for which they are made, and share of the start
_CLOSED = 1e-5  # distance from closing that no other period makes smaller
_COARSE, _MOST_MARCHED = 1e-9, 5_000  # of a march in the search for a return: windows at most
_HORIZONS = 6  # times that the search for a return doubles its time
_NEAR = 0.1  # distance of a return that ends the search, relative to the motion
_LEAST = 1e-3  # extent of a component relative to what others make of it
_AROUND, _PLACES = 1e-2, 401  # share of the period around which a return is looked for, and times
_FAR = 0.5  # distance of a return from which Newton's method has no chance


@dataclass(frozen=True)
class Found:
    """Result of Newton's method."""

    arc: Arc
    #: The last linear system.
    step: Step
    #: Reason of a failure, or an empty text.
    failure: str = ""


def _nodes(H: Hamiltonian) -> int:
    """Number of points in a window."""
    return _NODES if H.dim < _MANY else _FEW_NODES


def _most_windows(H: Hamiltonian) -> int:
    """The number of windows whose derivatives fit into memory."""
    return min(_MOST_WINDOWS, _MOST_ENTRIES // (_nodes(H) * H.dim * (H.dim + 4)))


def first_arc(problem: Problem, state: np.ndarray, period: float) -> Arc:
    """Integrate an arc from a guess, to its nearest return where the period is unknown.

    Raise InputError if the trajectory does not reach the end of the arc.
    """
    H, start, duration = problem.H, problem.start, period / problem.closing.parts
    _rates(H, state, start)
    free = problem.autonomous and problem.period is None
    most = _most_windows(H)
    longest = duration * (1 + _AROUND if free else 1)
    path = _marched(H, state, (start, start + longest), _LOCAL, math.ceil(_longer(H) * most))
    if not path.reached >= start + duration:
        raise InputError(
            f"the trajectory of the guess ends at t = {path.reached:.6g}, before its period: "
            f"{path.reason}; give another guess, or one with a shorter period"
        )
    if free and not path.reason:
        duration = _nearest_return(H, path, problem.closing, duration)
    # Windows in proportion to those of the march, whose basis has another number of points.
    times = path.edges + (path.origin - start)
    count = int(np.searchsorted(times, duration))
    times = np.append(times[:count], duration)
    parts = max(3, math.ceil(count / _longer(H)))
    edges = np.interp(np.linspace(0, count, parts + 1), np.arange(count + 1), times) / duration
    edges[-1] = 1.0
    return _in_windows(problem, state, edges, duration * problem.closing.parts)


def _marched(
    H: Hamiltonian, state: np.ndarray, span: tuple[float, float], local: float, most: int
) -> March:
    """March from a state over a span, or to where a window has no solution."""
    basis = feature_basis(nodes=_MARCH_NODES)
    with np.errstate(all="ignore"):
        return march(flow_of(H), state, span, local, basis, max_windows=most)


def _states(path: March, times: np.ndarray) -> np.ndarray:
    """Evaluate a march, shape (n,) -> (n, dim)."""
    return FeatureTrial.of_march(path, feature_basis(nodes=_MARCH_NODES).series).states_at(times)


def _longer(H: Hamiltonian) -> float:
    """The length of windows of an arc, relative to those of a march.

    Coefficients of n terms fall to a tolerance in windows whose distance from singularities is that
    of an ellipse with radius tolerance^(-1/n) (Trefethen 2013, chapter 8).
    """
    radii = _TAIL ** (-1 / np.array([_MARCH_NODES, _nodes(H)]))
    axes = radii + 1 / radii
    return float(axes[0] / axes[1])


def shot(problem: Problem, arc: Arc) -> Arc:
    """Correct the start and the period alone, while that brings the end nearer.

    Where the motion is much faster than elsewhere, as in close encounters, a small shift of time
    changes the states by much, which Newton's method for all states does not follow.
    """
    with np.errstate(all="ignore"):
        before = NewtonSystem(problem, arc, slice_of(problem, arc)).solved()
        scale = problem.scale_of(arc)
        for _ in range(_SHOTS):
            start = float(np.abs(before.ends[0] / scale).max())
            if not (before.size > _FAST and start < _SLOW_START * before.size):
                break
            state, period = arc.ends[0] + before.ends[0], arc.period + before.period
            try:
                trial = _in_windows(problem, state, arc.edges, period)
            except InputError:
                break
            after = NewtonSystem(problem, trial, slice_of(problem, trial)).solved()
            if not after.residual < before.residual / 2:
                break
            arc, before = trial, after
    return arc


def _in_windows(problem: Problem, state: np.ndarray, edges: np.ndarray, period: float) -> Arc:
    """Integrate an arc window by window.

    The time starts at 0 in each: sums of it are rounded, by more than close encounters allow.
    """
    H, nodes = problem.H, collocation(_nodes(problem.H)).nodes
    duration = period / problem.closing.parts
    ends, values = [state], []
    for low, high in pairwise(edges.tolist()):
        begin = 0.0 if problem.autonomous else problem.start + low * duration
        length = (high - low) * duration
        path = _marched(H, ends[-1], (begin, begin + length), _LOCAL, _IN_A_WINDOW)
        if path.reason:
            raise InputError(
                f"the trajectory of the guess ends at t = {problem.start + low * duration:.6g}, "
                f"before its period: {path.reason}; give another guess"
            )
        ends.append(path.states[-1])
        values.append(_states(path, begin + length * nodes))
    return Arc(edges, np.array(ends), np.array(values), period)


def _nearest_return(H: Hamiltonian, path: March, closing: Closing, duration: float) -> float:
    """The time near a duration at which a path, from its start, is nearest to closing.

    An error of the period is large where the motion is fast, as in close encounters, and Newton's
    method would have to shift these in time.
    """
    start = path.ends[0]
    units = _extents(H, path.states, path.origin + path.edges)

    def distance(times: np.ndarray) -> np.ndarray:
        return _distances(closing, _states(path, start + np.append(0.0, times)), units)[1:]

    if distance(np.array([duration]))[0] < _CLOSED:
        return duration
    near = duration * np.linspace(1 - _AROUND, 1 + _AROUND, _PLACES)
    k = int(np.argmin(distance(near)))
    if k in (0, _PLACES - 1):
        return duration
    best = minimize_scalar(
        lambda t: float(distance(np.array([t]))[0]),
        bounds=(near[k - 1], near[k + 1]),
        method="bounded",
        options={"xatol": 1e-12 * duration},
    )
    return float(best.x)


def first_return(H: Hamiltonian, closing: Closing, state: np.ndarray) -> float:
    """Return the period for which the trajectory of a guess nearly closes first.

    Raise InputError if there is none.
    """
    rate = _rate(H, state)
    if not rate > 0:
        raise InputError("the guess is an equilibrium; give a state on or near a periodic orbit")
    horizon = 4 / rate
    best = (math.inf, 0.0)
    for _ in range(_HORIZONS):
        horizon *= 2
        found = _marched(H, state, (0.0, horizon), _COARSE, _MOST_MARCHED)
        times = np.linspace(0, found.reached, 40 * len(found.edges))
        path = _states(found, times)
        if not np.isfinite(path).all():
            break
        distances = _distances(closing, path, _extents(H, path, times))
        low = np.flatnonzero(
            (distances[1:-1] <= distances[:-2]) & (distances[1:-1] < distances[2:])
        )
        low = low[np.maximum.accumulate(distances)[low] > _FAR / 2] + 1
        for k in low:
            if distances[k] < best[0]:
                best = (float(distances[k]), float(times[k]))
            if distances[k] < _NEAR:
                return float(times[k]) * closing.parts
        if best[0] < _FAR / 2 or found.reason:
            break
    if not best[0] < _FAR:
        raise InputError(
            "the trajectory of the guess does not come back near its start; give a guess with a "
            "period: (state, period)"
        )
    return best[1] * closing.parts


def _rate(H: Hamiltonian, state: np.ndarray) -> float:
    """The rate of the motion at a state, 0 at an equilibrium."""
    field, jacobian = _rates(H, state, 0.0)
    if not field.any():
        return 0.0
    rate = float(np.abs(np.linalg.eigvals(jacobian)).max())
    moving = state != 0
    if not rate > 0 and moving.any():
        rate = float(np.abs(field[moving] / state[moving]).max())
    return rate if rate > 0 else 1.0


def _rates(H: Hamiltonian, state: np.ndarray, time: float) -> tuple[np.ndarray, np.ndarray]:
    """The vector field and its derivatives at a guess, which must be finite."""
    field = vector_field_at(H, state, time)
    jacobian = flow_of(H).jacobian(state[None], np.array([time]))[0]
    if not (np.isfinite(field).all() and np.isfinite(jacobian).all()):
        raise InputError("H or its derivatives are not finite at the guess; give another guess")
    return field, jacobian


def _extents(H: Hamiltonian, states: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Extents of the components, with a floor for those that hardly move."""
    return floored_sizes(np.ptp(states, axis=0), *coupling_along(H, states, times), _LEAST)


def _distances(closing: Closing, path: np.ndarray, units: np.ndarray) -> np.ndarray:
    """Distances of a path from closing, in units of the components."""
    if closing.last is not None:
        gaps = path @ closing.last.conditions.T / (np.abs(closing.last.conditions) @ units)
    else:
        gaps = (path - closing.shift(path[0])) / units
    return np.asarray(np.abs(gaps).max(axis=1))


def converged(problem: Problem, arc: Arc) -> Found:
    """Apply Newton's method with step control until corrections are round-off."""
    with np.errstate(all="ignore"):
        planes = slice_of(problem, arc)
        step = NewtonSystem(problem, arc, planes).solved()
        slow, first = 0, step.size
        for iteration in range(_ITERATIONS):
            if not math.isfinite(step.size):
                return Found(arc, step, "the equations are not finite along the guess")
            if step.size <= _CONVERGED:
                return Found(step.applied(arc), step)
            share = min(1.0, 1.0 / step.size)
            for _ in range(_HALVINGS):
                trial = step.applied(arc, share)
                after = NewtonSystem(problem, trial, planes).solved()
                # Smaller corrections are progress as well as smaller residuals, in any units.
                less = 1 - share / 4
                progress = after.residual <= less * step.residual or after.size <= less * step.size
                if trial.period > 0 and progress:
                    break
                # Near the solution corrections do not fall below their round-off.
                if after.residual < 1e-11 and after.size <= step.size and trial.period > 0:
                    break
                share /= 2
            else:
                if step.size <= 1e-8 and step.residual <= 1e-11:
                    return Found(arc, step)
                return Found(arc, step, "Newton's method made no more progress")
            if iteration >= _WANDERS and not after.size <= _AWAY * first:
                return Found(trial, after, "Newton's method goes away from this guess")
            slow += share < _SLOW
            if slow > _MOST_SLOW:
                return Found(trial, after, "Newton's method is too slow from this guess")
            # Residuals fall before corrections do, which have the round-off of the linear system.
            stalled = after.size > 0.3 * step.size and after.residual > 0.3 * step.residual
            stalled &= step.size <= 1e-7
            arc, step = trial, after
            if stalled:
                return Found(arc, step)
    return Found(arc, step, f"Newton's method did not converge in {_ITERATIONS} iterations")


def refined(problem: Problem, arc: Arc) -> Found:
    """Alternate Newton's method and halving of windows that are not resolved."""
    nodes = _nodes(problem.H)
    if arc.values.shape[1] != nodes:
        arc = arc.on(arc.edges, nodes)
    found = converged(problem, arc)
    for count in range(_REFINEMENTS):
        if found.failure:
            return found
        wide = found.arc.tails(problem.scale_of(found.arc)) > (
            _SMALL_TAIL if count < _SMALL_ROUNDS else _TAIL
        )
        if not wide.any():
            return found
        edges = found.arc.edges
        middles = (edges[1:] + edges[:-1])[wide] / 2
        if len(edges) + len(middles) > _most_windows(problem.H):
            break
        found = converged(problem, found.arc.on(np.sort(np.append(edges, middles)), nodes))
    return replace(found, failure="the orbit was not resolved by the windows")


def check(problem: Problem, arc: Arc) -> tuple[Arc, Step, float]:
    """Correct an arc with more points in each window.

    - returns: The corrected arc, the linear system, and the size of the correction: the estimated
      error of the arc in float64.
    """
    finer = arc.on(arc.edges, arc.values.shape[1] + _EXTRA_NODES)
    with np.errstate(all="ignore"):
        step = NewtonSystem(problem, finer, slice_of(problem, arc)).solved()
    found = step.applied(finer) if math.isfinite(step.size) else arc
    # What is rounded of it counts as well.
    rest, scale = found.precise, problem.scale_of(arc)
    ends = ((np.abs(step.ends) + np.abs(rest.ends.low)) / scale).max()
    period = abs(step.period) + abs(float(rest.period.low))
    # States move by as much as the motion in the error of the period.
    times = problem.start + arc.edges * (arc.period / problem.closing.parts)
    with np.errstate(all="ignore"):
        moved = np.abs(flow_of(problem.H).vector_field(arc.ends, times)).max(axis=0) * period
    errors = (ends, period / arc.period, (moved / scale).max())
    return found, step, float(np.max(errors))  # NaN if one is
