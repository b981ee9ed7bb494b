"""The loop over members of an ensemble: march, estimate and verdict, one after the other.

It accepts what every check passes and leaves all other members to the caller, who solves them with
Newton's method and repeated marches. A member is computed by itself, so
that its numbers do not depend on the others. This module is always compiled
(:mod:`hamsym.random_features.compiled_loop`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hamsym.random_features.error_loop import (
    ACCURACY,
    BENT,
    DONE,
    FEWEST,
    PERTURBATIONS,
    SLACK,
    TIGHTER,
    Actions,
    ErrorSettings,
    ErrorTables,
    carry_errors,
)
from hamsym.random_features.window_loop import (
    FINISHED,
    FULL,
    PAUSE,
    ROUND_OFF,
    TINY,
    Array,
    Progress,
    Rates,
    Settings,
    Tables,
    Windows,
    evaluate,
    first_length,
    march_windows,
)

# Verdicts: the checks of the loop passed; left to the caller.
ACCEPTED, LEFT = range(2)

ATTEMPTS = 3  # marches of a member, each to a tighter local tolerance
# Of the local tolerance from one march to the next: share of the allowed error at which it aims,
# and limits of the step; below the smallest one residuals are round-off.
MARGIN, STEP, MOST, SMALLEST = 0.3, 1e-4, 0.3, 1e-13
SPLITTER = 134217729.0  # 2**27 + 1


class Span(NamedTuple):
    """Constants of all members.

    Attributes
    ----------
    start, end : float
        Times relative to the origin.
    tolerance, local : float
        Tolerance relative to the computed sizes, and the local one of the first march.
    absolute : array (dim,)
        Absolute tolerance.
    longest, shortest : float
        Lengths of windows.
    separable, conserved, rounded : bool
        Whether H is separable and conserved, and the formulas have rounded numbers.
    """

    start: float
    end: float
    tolerance: float
    local: float
    absolute: Array
    longest: float
    shortest: float
    separable: bool
    conserved: bool
    rounded: bool


class Members(NamedTuple):
    """Results of members, in consecutive rows.

    Attributes
    ----------
    counts : array (members,)
        Windows of each.
    verdicts : array (members,)
    evaluations : array (members,)
        Of the vector field, each at all points of a window.
    excess : array (members,)
        Largest ratio of estimated to allowed error.
    largest, sizes : array (members, dim)
        Largest estimated error, and largest magnitude of each component.
    edges, states : array (room + members), array (room + members, dim)
        Those of a member begin after those of the members before it.
    readouts : array (room, m, dim)
    marks : array (room,)
    series, floors : array (room, k, dim), array (room, dim)
        Of the error; without rows they are not stored.
    """

    counts: Array
    verdicts: Array
    evaluations: Array
    excess: Array
    largest: Array
    sizes: Array
    edges: Array
    states: Array
    readouts: Array
    marks: Array
    series: Array
    floors: Array


def joint_errors(windows: Windows, tables: Tables, out: Array) -> None:
    """Compute the rounding of the state at each joint, with twice the digits."""
    states, readouts = windows.states, windows.readouts
    for w in range(len(out)):
        for i in range(states.shape[1]):
            total, rest = states[w, i], 0.0
            for m in range(readouts.shape[1]):
                a, b = readouts[w, m, i], tables.end[m]
                product = a * b
                # The rounding error of the product (Dekker), and of the sum (Knuth).
                c = SPLITTER * a
                high_a = c - (c - a)
                c = SPLITTER * b
                high_b = c - (c - b)
                low_a, low_b = a - high_a, b - high_b
                lost = low_a * low_b - (
                    ((product - high_a * high_b) - low_a * high_b) - high_a * low_b
                )
                added = total + product
                part = added - total
                rest += (total - (added - part)) + (product - part) + lost
                rest += a * tables.end_low[m]
                total = added
            out[w, i] = (total - states[w + 1, i]) + rest


def keeps_energy(
    velocity: Rates,
    force: Rates,
    energy: Rates,
    windows: Windows,
    parameters: Array,
    tolerance: float,
    sizes: Array,
) -> bool:
    """Return whether H changes in no window by more than the local tolerance explains."""
    edges, states = windows.edges, windows.states
    count, dim = len(states), states.shape[1]
    rows = np.ascontiguousarray(states.T)
    energies, slopes = np.empty((1, count)), np.empty((dim, count))
    energy(rows, edges, parameters, energies)
    # The gradient of H is the vector field with its halves exchanged, up to signs.
    velocity(rows, edges, parameters, slopes[dim // 2 :])
    force(rows, edges, parameters, slopes[: dim // 2])
    for w in range(count - 1):
        allowed, rounding = 0.0, abs(energies[0, w])
        for i in range(dim):
            slope = max(abs(slopes[i, w]), abs(slopes[i, w + 1]))
            allowed += slope * sizes[i]
            rounding += slope * max(abs(rows[i, w]), abs(rows[i, w + 1]))
        allowed = SLACK * (tolerance * allowed + ROUND_OFF * rounding)
        if not (abs(energies[0, w + 1] - energies[0, w]) <= allowed and allowed < math.inf):
            return False
    return True


def scaled(actions: Actions, offset: int, scale: Array) -> Actions:
    """Return the terms of a half, whose rows begin at ``offset``, in units of the scale."""
    factors = np.empty(len(actions.factors))
    count = len(actions.rows)
    for i in range(count):
        end = actions.starts[i + 1] if i + 1 < count else len(factors)
        for k in range(actions.starts[i], end):
            unit = scale[actions.sources[k]] / scale[actions.rows[i] + offset]
            factors[k] = actions.factors[k] * unit
    return Actions(actions.rows, actions.starts, actions.sources, actions.entries, factors)


def solve_members(
    velocity: Rates,
    force: Rates,
    hessian: Rates,
    energy: Rates,
    tables: Tables,
    error_tables: ErrorTables,
    forces: Actions,
    velocities: Actions,
    signs: Array,
    disturbances: Array,
    kicks: Array,
    span: Span,
    starts: Array,
    parameters: Array,
    members: Members,
) -> int:
    """Solve members until the room for windows is full; return how many were solved.

    Parameters
    ----------
    forces, velocities : Actions
        Terms of J Hess v in the units of H.
    signs : array (dim, points)
        See :class:`~hamsym.random_features.window_loop.Settings`.
    disturbances, kicks : array
        See :class:`~hamsym.random_features.error_loop.ErrorSettings`.
    starts, parameters : array (members, dim), array (members, k)
    """
    dim = starts.shape[1]
    half, nodes = dim // 2, len(tables.nodes)
    stops = np.array([span.end])
    whole = abs(span.end - span.start)
    found = np.empty((dim, nodes))
    tail = np.empty((dim, tables.extrapolation.shape[1]))
    rates, place, time = np.empty((dim, 1)), np.empty((dim, 1)), np.empty(1)
    time[0] = span.start
    clock, counts = np.empty(3), np.empty(4, np.int64)
    sizes, floors, scale = np.empty(dim), np.zeros(dim), np.empty(dim)
    joint, largest = np.empty(dim * (PERTURBATIONS + 2)), np.empty(dim)
    history = np.empty(2)
    done = 0
    for member in range(len(starts)):
        z, values = starts[member], parameters[member]
        edges, states = members.edges[done + member :], members.states[done + member :]
        windows = Windows(edges, states, members.readouts[done:])
        place[:, 0] = z
        evaluate(velocity, force, place, time, values, rates)
        length = first_length(velocity, force, z, rates, span.start, span.end, values)
        local, evaluations = span.local, 2
        verdict, count, excess = LEFT, 0, math.inf
        for _attempt in range(ATTEMPTS):
            edges[0], states[0] = span.start, z
            tail[:, :] = 0.0
            tail[:, 0] = rates[:, 0]
            sizes[:] = np.abs(z)
            clock[0], clock[1], clock[2] = span.start, length, 0.0
            counts[0], counts[1], counts[2], counts[3] = 0, evaluations, 0, -PAUSE
            settings = Settings(
                stops, local, floors, signs, span.shortest, span.longest, values, span.separable
            )
            progress = Progress(clock, counts, sizes, tail, found)
            outcome = march_windows(velocity, force, tables, settings, progress, windows, False)
            evaluations = counts[1]
            if outcome == FULL:
                return member
            count = counts[0]
            verdict = LEFT
            if outcome != FINISHED:
                break
            solved = Windows(
                edges[: count + 1], states[: count + 1], members.readouts[done : done + count]
            )
            marks = members.marks[done : done + count]
            squares = 0.0
            for w in range(count):
                squares += (edges[w + 1] - edges[w]) ** 2
            for i in range(dim):
                scale[i] = sizes[i] if sizes[i] > 0.0 else 1.0
            error_settings = ErrorSettings(
                scale,
                sizes,
                local,
                ACCURACY / max(1.0 * count, FEWEST),
                squares / whole,
                1.0 if span.rounded else 0.0,
                disturbances,
                kicks,
                values,
            )
            jumps = np.empty((count, dim))
            joint_errors(solved, tables, jumps)
            joint[:], history[:] = 0.0, 0.0
            largest[:] = 0.0
            stored = len(members.series) > 0
            _, outcome = carry_errors(
                velocity,
                force,
                hessian,
                error_tables,
                scaled(forces, half, scale),
                scaled(velocities, 0, scale),
                error_settings,
                solved,
                jumps,
                joint,
                history,
                members.series[done : done + count] if stored else members.series,
                members.floors[done : done + count] if stored else members.floors,
                largest,
                marks,
                0,
                count,
            )
            if outcome != DONE:
                break
            excess = 0.0
            for i in range(dim):
                allowed = max(span.absolute[i] + span.tolerance * sizes[i], TINY)
                if largest[i] != 0.0:
                    excess = max(excess, largest[i] / allowed)
            for w in range(count):
                if marks[w] & BENT:
                    excess = max(excess, TIGHTER)
            if not excess <= 1.0:
                if local <= SMALLEST or not excess < math.inf:
                    break
                local = max(local * min(max(MARGIN / excess, STEP), MOST), SMALLEST)
                continue
            good = True
            for w in range(count):
                good = good and marks[w] == 0
            if good and span.conserved:
                good = keeps_energy(velocity, force, energy, solved, values, local, sizes)
            if good:
                verdict = ACCEPTED
            break
        if verdict == LEFT:
            count = 0
        members.counts[member] = count
        members.verdicts[member] = verdict
        members.evaluations[member] = evaluations
        members.excess[member] = excess
        members.largest[member] = largest
        members.sizes[member] = sizes
        done += count
    return len(starts)
