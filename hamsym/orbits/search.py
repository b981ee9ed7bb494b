"""Search for a periodic orbit: a first arc from a guess, Newton's method, refinement of windows."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.integrate import DOP853, DenseOutput, OdeSolution
from scipy.optimize import minimize_scalar

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import floored_sizes
from hamsym.orbits.arc import Arc, Problem, vector_field_at
from hamsym.orbits.integrals import slice_of
from hamsym.orbits.newton_system import NewtonSystem, Step
from hamsym.orbits.symmetry import Closing
from hamsym.orbits.window_maps import WindowMaps
from hamsym.random_features.flow import flow_of

_NODES, _FEW_NODES, _MANY = 20, 12, 20  # points in a window; fewer from so many components on
_EXTRA_NODES = 8  # of the check
_ITERATIONS = 30
_HALVINGS = 6  # of a Newton step
_SLOW, _MOST_SLOW = 0.1, 4  # share of a step that is slow, and the number of slow ones
# Step from which corrections that are larger than the first one by a factor end the search.
_WANDERS, _AWAY = 6, 3.0
_CONVERGED = 1e-12  # size of a correction; later ones are round-off
_TAIL = 1e-13  # coefficients that a window leaves out, relative to the components
_REFINEMENTS = 12
_MOST_WINDOWS = 10_000
_MOST_ENTRIES = 50_000_000  # of the derivatives at the points of all windows
_FIRST, _STEPS_PER_WINDOW = 1e-10, 3  # tolerance and steps of DOP853 along a guess
_ACCURATE = 1e-13  # and where Newton's method fails: unstable orbits magnify errors
_INSIDE = 2  # corrections inside windows before the search
_SHOTS = 3  # corrections of the start before the search
_FAST, _SLOW_START = 1e-3, 1e-2  # change of states for which they are made, and share of the start
_CLOSED = 1e-5  # distance from closing that no other period makes smaller
_MOST_STEPS = 5000  # of DOP853 in the search for a return
_HORIZONS = 6  # times that the search for a return doubles its time
_NEAR = 0.1  # distance of a return that ends the search, relative to the motion
_LEAST = 1e-3  # size of a component relative to the largest of its half
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
    path, edges, period = _first_path(problem, state, period, _FIRST, _STEPS_PER_WINDOW)
    duration = period / problem.closing.parts
    points = edges[:-1, None] + np.diff(edges)[:, None] * collocation(_nodes(problem.H)).nodes
    states = path(problem.start + points.ravel() * duration).T
    ends = path(problem.start + edges * duration).T
    return Arc(edges, ends, states.reshape(*points.shape, -1), period)


def accurate_arc(problem: Problem, state: np.ndarray, period: float) -> Arc:
    """Integrate an arc from a guess as accurately as close encounters need.

    Raise InputError if the trajectory does not reach the end of the arc.
    """
    _, edges, period = _first_path(problem, state, period, _ACCURATE, 2 * _STEPS_PER_WINDOW)
    sizes = _sizes(problem.H, state, problem.start)[1]
    arc = _in_windows(problem, state, edges, period, sizes)
    # The coefficients that a window leaves out fall with a power of its width.
    parts = np.ceil(1.2 * (arc.tails() / _TAIL) ** (1 / arc.values.shape[1])).astype(int)
    if (parts > 1).any():
        pieces = zip(pairwise(edges.tolist()), np.maximum(parts, 1).tolist(), strict=True)
        finer = [np.linspace(*ends, count + 1)[:-1] for ends, count in pieces]
        arc = _in_windows(problem, state, np.append(np.concatenate(finer), 1.0), period, sizes)
    return _shot(problem, arc, sizes)


def _first_path(
    problem: Problem, state: np.ndarray, period: float, rtol: float, steps: int
) -> tuple[OdeSolution, np.ndarray, float]:
    """The trajectory of a guess, windows of so many of its steps, and the period of its return."""
    duration = period / problem.closing.parts
    free = problem.autonomous and problem.period is None
    longest = duration * (1 + _AROUND if free else 1)
    span = (problem.start, problem.start + longest)
    sizes = _sizes(problem.H, state, problem.start)[1]
    windows = _most_windows(problem.H)
    most = steps * (windows + 1)
    found, _ = _integrated(_rates(problem.H), span, state, rtol, sizes, most)
    reached = found.ts[-1] >= problem.start + duration
    if not reached and len(found.ts) <= most:
        raise InputError(
            f"the trajectory of the guess ends at t = {found.ts[-1]:.6g}, before its period; give "
            "another guess"
        )
    if not reached:
        raise InputError(
            f"the period {period:.6g} of the guess is too long for the motion: it would take more "
            f"than {windows:,} windows; give a guess with a shorter period"
        )
    if free and found.ts[-1] == span[1]:
        duration = _nearest_return(found, problem.closing, duration)
        period = duration * problem.closing.parts
    edges = (found.ts[::steps] - problem.start) / duration
    edges = np.append(edges[edges < 1 - 1e-9], 1.0)
    return found, edges if len(edges) > 3 else np.linspace(0, 1, 4), period


def _shot(problem: Problem, arc: Arc, sizes: np.ndarray) -> Arc:
    """Correct the start and the period alone, while that brings the end nearer.

    Where the motion is much faster than elsewhere, as in close encounters, a small shift of time
    changes the states by much, which Newton's method for all states does not follow.
    """
    with np.errstate(all="ignore"):
        before = NewtonSystem(problem, arc, slice_of(problem, arc)).solved()
        for _ in range(_SHOTS):
            start = float(np.abs(before.ends[0] / arc.scale).max())
            if not (before.size > _FAST and start < _SLOW_START * before.size):
                break
            state, period = arc.ends[0] + before.ends[0], arc.period + before.period
            try:
                trial = _in_windows(problem, state, arc.edges, period, sizes)
            except InputError:
                break
            after = NewtonSystem(problem, trial, slice_of(problem, trial)).solved()
            if not after.residual < before.residual / 2:
                break
            arc, before = trial, after
    return arc


def _in_windows(
    problem: Problem, state: np.ndarray, edges: np.ndarray, period: float, sizes: np.ndarray
) -> Arc:
    """Integrate an arc window by window, and solve the equations inside each.

    The time starts at 0 in each: sums of it are rounded, by more than close encounters allow.
    """
    rates, rule = _rates(problem.H), collocation(_nodes(problem.H))
    duration = period / problem.closing.parts
    ends, values = [state], []
    for low, high in pairwise(edges.tolist()):
        begin, length = problem.start + low * duration, (high - low) * duration

        def moved(t: float, z: np.ndarray, begin: float = begin) -> np.ndarray:
            return rates(begin + t, z)

        path, finished = _integrated(moved, (0.0, length), ends[-1], _ACCURATE, sizes, _MOST_STEPS)
        if not finished:
            raise InputError(
                f"the trajectory of the guess ends at t = {begin + path.ts[-1]:.6g}, before its "
                "period; give another guess"
            )
        ends.append(path(length))
        values.append(path(length * rule.nodes).T)
    return _inside_solved(problem, Arc(edges, np.array(ends), np.array(values), period))


def _inside_solved(problem: Problem, arc: Arc) -> Arc:
    """Solve the equations inside each window from its start.

    The polynomials between the steps of DOP853 are less accurate than the steps, and unstable
    orbits magnify their errors.
    """
    with np.errstate(all="ignore"):
        for _ in range(_INSIDE):
            maps = WindowMaps(problem, arc, ())
            if not (np.abs(maps.residual) / arc.scale).max() > _TAIL:
                break
            moved = replace(arc, values=arc.values + maps.inside[..., -1])
            if not np.isfinite(moved.values).all():
                break
            arc = moved
    return arc


def _nearest_return(found: OdeSolution, closing: Closing, duration: float) -> float:
    """The time near a duration at which a path, from its start, is nearest to closing.

    An error of the period is large where the motion is fast, as in close encounters, and Newton's
    method would have to shift these in time.
    """
    start = found.ts[0]
    units = np.ptp(found(found.ts).T, axis=0)

    def distance(times: np.ndarray) -> np.ndarray:
        return _distances(closing, found(start + np.append(0.0, times)).T, units)[1:]

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
    rates = _rates(H)
    rate, sizes = _sizes(H, state, 0.0)
    if not rate > 0:
        raise InputError("the guess is an equilibrium; give a state on or near a periodic orbit")
    horizon = 4 / rate
    best = (math.inf, 0.0)
    for _ in range(_HORIZONS):
        horizon *= 2
        found, reached = _integrated(rates, (0.0, horizon), state, 1e-9, sizes, _MOST_STEPS)
        times = np.linspace(0, found.ts[-1], 40 * len(found.ts))
        path = found(times).T
        if not np.isfinite(path).all():
            break
        distances = _distances(closing, path, np.ptp(path, axis=0))
        low = np.flatnonzero(
            (distances[1:-1] <= distances[:-2]) & (distances[1:-1] < distances[2:])
        )
        low = low[np.maximum.accumulate(distances)[low] > _FAR / 2] + 1
        for k in low:
            if distances[k] < best[0]:
                best = (float(distances[k]), float(times[k]))
            if distances[k] < _NEAR:
                return float(times[k]) * closing.parts
        if best[0] < _FAR / 2 or not reached:
            break
    if not best[0] < _FAR:
        raise InputError(
            "the trajectory of the guess does not come back near its start; give a guess with a "
            "period: (state, period)"
        )
    return best[1] * closing.parts


def _integrated(
    rates: Callable[[float, np.ndarray], np.ndarray],
    span: tuple[float, float],
    state: np.ndarray,
    rtol: float,
    sizes: np.ndarray,
    most: int,
) -> tuple[OdeSolution, bool]:
    """Integrate by DOP853, at most so many steps: the path, and whether it reaches the end."""
    times, pieces = [span[0]], list[DenseOutput]()
    with np.errstate(all="ignore"):
        solver = DOP853(rates, span[0], state, span[1], rtol=rtol, atol=1e-3 * rtol * sizes)
        while solver.status == "running" and len(pieces) < most:
            solver.step()
            if solver.status == "failed" or not np.isfinite(solver.y).all():
                break
            times.append(solver.t)
            pieces.append(solver.dense_output())
    if not pieces:
        raise InputError("the trajectory of the guess ends at its start; give another guess")
    return OdeSolution(times, pieces), solver.status == "finished"


def _sizes(H: Hamiltonian, state: np.ndarray, time: float) -> tuple[float, np.ndarray]:
    """The rate of the motion at a state, 0 at an equilibrium, and sizes of the components."""
    flow = flow_of(H)
    field = vector_field_at(H, state, time)
    jacobian = flow.jacobian(state[None], np.array([time]))[0]
    if not (np.isfinite(field).all() and np.isfinite(jacobian).all()):
        raise InputError("H or its derivatives are not finite at the guess; give another guess")
    rate, sizes = 0.0, np.abs(state)
    if field.any():
        rate = float(np.abs(np.linalg.eigvals(jacobian)).max())
        moving = state != 0
        if not rate > 0 and moving.any():
            rate = float(np.abs(field[moving] / state[moving]).max())
        rate = rate if rate > 0 else 1.0
        sizes = np.maximum(sizes, np.abs(field) / rate)
    return rate, floored_sizes(sizes, _LEAST)


def _distances(closing: Closing, path: np.ndarray, extent: np.ndarray) -> np.ndarray:
    """Distances of a path from closing, relative to its extent."""
    units = floored_sizes(extent, _LEAST)
    if closing.last is not None:
        gaps = path @ closing.last.conditions.T / (np.abs(closing.last.conditions) @ units)
    else:
        gaps = (path - closing.shift(path[0])) / units
    return np.asarray(np.abs(gaps).max(axis=1))


def _rates(H: Hamiltonian) -> Callable[[float, np.ndarray], np.ndarray]:
    flow = flow_of(H)

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        return np.asarray(flow.vector_field(z[None], np.array([t]))[0])

    return rates


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
            stalled = step.size <= 1e-7 and after.size > 0.3 * step.size
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
    for _ in range(_REFINEMENTS):
        if found.failure:
            return found
        wide = found.arc.tails() > _TAIL
        if not wide.any():
            return found
        edges = found.arc.edges
        middles = (edges[1:] + edges[:-1])[wide] / 2
        if len(edges) + len(middles) > _most_windows(problem.H):
            return replace(found, failure="the orbit was not resolved by the windows")
        found = converged(problem, found.arc.on(np.sort(np.append(edges, middles)), nodes))
    return replace(found, failure="the orbit was not resolved by the windows")


def check(problem: Problem, arc: Arc) -> tuple[Arc, Step, float]:
    """Correct an arc with more points in each window.

    - returns: The corrected arc, the linear system, and the size of the correction: the estimated
      error.
    """
    finer = arc.on(arc.edges, arc.values.shape[1] + _EXTRA_NODES)
    with np.errstate(all="ignore"):
        step = NewtonSystem(problem, finer, slice_of(problem, arc)).solved()
    ends = np.abs(step.ends / arc.scale).max()
    error = float(max(ends, abs(step.period) / arc.period))
    return (step.applied(finer) if math.isfinite(step.size) else arc), step, error
