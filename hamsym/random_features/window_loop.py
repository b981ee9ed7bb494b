"""The march itself: windows of collocation, one after the other, each to a local tolerance.

Written in what numpy and numba have in common: it runs as it stands, and
:mod:`hamsym.random_features.compiled_loop` compiles the same text. The vector field is a function
rates(z, t, out).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TypeAlias

import numpy as np

__all__ = ["FINISHED", "FULL", "NEWTON", "TOO_SHORT", "march_windows"]

# How march_windows ends: at the end of the span, at a window whose equation the fixed point
# iteration does not solve, at a window too short for float64, or with its arrays full.
FINISHED, NEWTON, TOO_SHORT, FULL = range(4)

ORDER = 18  # at which the residual falls with the length of the window, empirically
ROUND_OFF = 256 * 2.0**-52  # of the residual, relative to the rates
EPS = 2.0**-52
NOISE = 8.0  # times what a unit in the last place of the states typically changes in the rates
SLOW = 30  # iterations, after which the next window is shorter
LOOKS = 3  # at the round-off of the rates, in one window
SHRINK, GROW = 0.6, 2.5
WELL = 0.3  # of the allowed residual: the next window need not be shorter
SLIVER = 1e-6  # of a window that it takes along rather than leave
ITERATIONS = 60
SMALL, RETRIES = 600, 3  # unknowns above which so many shorter windows are tried before Newton
TAIL = 6  # last nodes of a window, from which the next one is guessed
TINY = 2.2250738585072014e-308

Array: TypeAlias = np.ndarray


def column_sizes(values: Array) -> Array:
    """Largest magnitude in each column."""
    return np.abs(values).max(axis=0)


def column_sizes_in_loops(values: Array) -> Array:
    """The same for the compiler, which knows no maximum along an axis."""
    sizes = np.zeros(values.shape[1])
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            size = abs(values[row, column])
            # Once it is not a number, it stays so.
            if not size <= sizes[column] and sizes[column] == sizes[column]:
                sizes[column] = size
    return sizes


def typical_sizes(values: Array) -> Array:
    """Mean magnitude in each column but for the largest, which may sit at a jump."""
    sizes = np.abs(values)
    return (sizes.sum(axis=0) - column_sizes(values)) / (len(values) - 1)


def march_windows(
    rates: Callable[[Array, Array, Array], None],
    nodes: Array,
    integration: Array,
    fit: Array,
    between: Array,
    to_between: Array,
    rates_between: Array,
    end: Array,
    end_low: Array,
    tail_fit: Array,
    stops: Array,
    tolerance: float,
    floors: Array,
    signs: Array,
    shortest: float,
    longest: float,
    given: bool,
    found: Array,
    clock: Array,
    counts: Array,
    sizes: Array,
    tail: Array,
    edges: Array,
    states: Array,
    readouts: Array,
) -> int:
    """Fill edges, states and readouts from counts[0] on; returns how it ended.

    Parameters
    ----------
    rates : callable
        (z, t, out) for z, out of shape (n, dim) and t of shape (n,).
    nodes, integration, fit, between, to_between, rates_between, end, end_low, tail_fit
        Tables of the :class:`~hamsym.random_features.basis.FeatureBasis`.
    stops : array
        Times at which a window must end, the last of them the end of the march.
    tolerance : float
        Of each window, relative to the sizes of the components, each by itself.
    floors : array (dim,)
        Sizes that components count as having at least.
    signs : array (between, dim)
        1 and -1 at random. What the rates change by when states and times change by a unit in
        the last place, with these signs, is their round-off.
    shortest : float
        Length below which a window is not tried.
    longest : float
        Length that no window exceeds, but for a sliver.
    given : bool
        Whether ``found`` has the rates at the nodes of the first window already.
    found : array (nodes, dim)
        Those rates.
    clock : array (2,)
        Time, and length of the next window; updated.
    counts : array (3,)
        Windows so far, evaluations of the vector field, stops passed; updated.
    sizes : array (dim,)
        Largest magnitude of each component so far; updated.
    tail : array (3, dim)
        Quadratic guess of the rates after the last window, in units of its length; updated.
    edges, states, readouts : arrays
        Shapes (n + 1,), (n + 1, dim) and (n, columns, dim).
    """
    dim = len(sizes)
    count, evaluations, passed = counts[0], counts[1], counts[2]
    t, length = clock[0], clock[1]
    direction = 1.0 if stops[-1] > t else -1.0
    last_length = abs(t - edges[count - 1]) if count else 0.0
    enough = max(0.01 * tolerance, 4e-16)
    guess = np.empty((len(nodes), 3))
    values = np.empty((len(nodes), dim))
    flow = np.empty((len(between), dim))
    disturbed = np.empty((len(between), dim))
    # Where the iteration fails, Newton's method is asked; in large systems only if shorter windows
    # fail too, or if it served the last window.
    stiff, failures = given, 0
    retries = 0 if dim * len(nodes) <= SMALL else RETRIES
    status = FINISHED
    while passed < len(stops):
        stop = stops[passed]
        left = abs(stop - t)
        length = min(length, longest, left)
        # Equal windows may miss the stop by round-off: no sliver is left before it.
        if left - length < SLIVER * length:
            length = left
        if length < shortest:
            status = TOO_SHORT
            break
        if count == len(readouts):
            status = FULL
            break
        h = direction * length
        z = states[count]
        if not given:
            times = t + h * nodes
            ratio = length / last_length if count else 0.0
            guess[:, 0] = 1.0
            guess[:, 1] = ratio * nodes
            guess[:, 2] = guess[:, 1] ** 2
            scaled = h * integration
            nearby = z + scaled @ (guess @ tail)
            scale = np.maximum(np.maximum(sizes, floors), column_sizes(nearby))
            scale = np.maximum(scale, TINY)
            last = math.inf
            looks = 0
            solved = False
            for attempt in range(ITERATIONS):
                rates(nearby, times, values)
                moved = z + scaled @ values
                changes = column_sizes(moved - nearby)
                change = (changes / scale).max()
                evaluations += 1
                if change <= enough or (change < 1e-12 and change >= last):
                    nearby = moved
                    solved = True
                    break
                if change >= last and looks < LOOKS:
                    # A component may stay away from its limit by the round-off of its rate.
                    looks += 1
                    inner = disturbed[: len(nodes)]
                    late = times * (1 + EPS * signs[: len(nodes), 0])
                    rates(nearby * (1 + EPS * signs[: len(nodes)]), late, inner)
                    evaluations += 1
                    noise = typical_sizes(inner - values)
                    if (changes <= enough * scale + NOISE * length * noise).all():
                        nearby = moved
                        solved = True
                        break
                nearby = moved
                if not change < 1e9 or (attempt > 30 and change > 0.9 * last):
                    break
                last = change
            if not solved and (stiff or failures >= retries):
                status = NEWTON
                break
            if not solved:
                failures += 1
                length *= SHRINK
                continue
            slow = attempt > SLOW
            found = values
            stiff = False
        else:
            slow = False
        given = False
        readout = h * (fit @ found)
        middle = z + to_between @ readout
        rates(middle, t + h * between, flow)
        evaluations += 1
        residual = (rates_between @ readout) / h - flow
        sizes_now = np.maximum(sizes, column_sizes(middle))
        # No window is short enough to bring the residual below the round-off of the rates.
        allowed = tolerance * np.maximum(sizes_now, floors)
        allowed = np.maximum(allowed + ROUND_OFF * length * column_sizes(found), TINY)
        defects = length * column_sizes(residual)
        error = (defects / allowed).max()
        if not error <= WELL:
            # That is many units of the rates where large terms cancel.
            late = (t + h * between) * (1 + EPS * signs[:, 0])
            rates(middle * (1 + EPS * signs), late, disturbed)
            evaluations += 1
            allowed = allowed + NOISE * length * typical_sizes(disturbed - flow)
            error = (defects / allowed).max()
        if not error <= 1:  # also where it is not a number
            factor = (0.3 / error) ** (1 / ORDER) if math.isfinite(error) else 0.3
            length *= min(max(factor, 0.3), 0.9)
            continue
        # Rounding Q(1) would push every window the same way, and energies would drift.
        states[count + 1] = z + (end @ readout + end_low @ readout)
        if length == left:
            t = stop
            passed += 1
        else:
            t += h
        failures = 0
        readouts[count] = readout
        count += 1
        edges[count] = t
        tail[:, :] = tail_fit @ found[-TAIL:]
        sizes[:] = sizes_now
        growth = min(GROW, (0.1 / max(error, 1e-30)) ** (1 / ORDER))
        if error <= WELL:
            growth = max(growth, 1.0)
        last_length = length
        length *= SHRINK if slow else growth
    clock[0], clock[1] = t, length
    counts[0], counts[1], counts[2] = count, evaluations, passed
    return status
