"""The loop over windows of collocation, one after the other, each to a local tolerance.

Written in the common subset of numpy and numba: it runs as plain Python, and
:mod:`hamsym.random_features.compiled_loop` compiles the same text. The vector field is a function
rates(z, t, out).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

__all__ = [
    "FINISHED",
    "FULL",
    "NEWTON",
    "TOO_SHORT",
    "Progress",
    "Settings",
    "Tables",
    "Windows",
    "march_windows",
]

# Outcomes of march_windows: at the end of the span, at a window whose equation the fixed-point
# iteration does not solve, at a window too short for float64, or with its arrays full.
FINISHED, NEWTON, TOO_SHORT, FULL = range(4)

ORDER = 18  # at which the residual falls with the length of the window, empirically
ROUND_OFF = 256 * 2.0**-52  # of the residual, relative to the rates
EPS = 2.0**-52
NOISE = 8.0  # times the typical change of the rates for one unit in the last place of the states
SLOW = 30  # iterations, after which the next window is shorter
ROUND_OFF_TESTS = 3  # estimates of the round-off of the rates in one window
SHRINK, GROW = 0.6, 2.5
GOOD = 0.3  # of the allowed residual: the next window need not be shorter
SLIVER = 1e-6  # share of a window by which it is lengthened to reach a stop
ITERATIONS = 60
SMALL, RETRIES = 600, 3  # unknowns above which shorter windows are tried, and how often
TAIL = 6  # last nodes of a window, from which the next one is extrapolated
TINY = 2.2250738585072014e-308

Array: TypeAlias = np.ndarray
Rates: TypeAlias = Callable[[Array, Array, Array], None]


class Tables(NamedTuple):
    """Tables of a :class:`~hamsym.random_features.basis.FeatureBasis`, contiguous.

    ``end`` and ``end_low`` are the high and low parts of its extended-precision values;
    ``tail_fit``, shape (3, TAIL), fits a parabola to the rates at the last nodes of a window.
    """

    nodes: Array
    integration: Array
    fit: Array
    between: Array
    to_between: Array
    rates_between: Array
    end: Array
    end_low: Array
    tail_fit: Array


class Settings(NamedTuple):
    """Constants of a march.

    Attributes
    ----------
    stops : array
        Times at which a window must end, the last of them the end of the march.
    tolerance : float
        Of each window, relative to the sizes of the components, each by itself.
    floors : array (dim,)
        Sizes below which no component is counted.
    signs : array (between, dim)
        1 and -1 at random. The change of the rates when states and times change by one unit in the
        last place, with these signs, is their round-off.
    shortest : float
        Length below which a window is not tried.
    longest : float
        Length that no window exceeds, but for a sliver.
    """

    stops: Array
    tolerance: float
    floors: Array
    signs: Array
    shortest: float
    longest: float


class Progress(NamedTuple):
    """State of a march between calls, updated in place.

    Attributes
    ----------
    clock : array (2,)
        Time, and length of the next window.
    counts : array (3,)
        Windows so far, evaluations of the vector field, stops passed.
    sizes : array (dim,)
        Largest magnitude of each component so far.
    tail : array (3, dim)
        Quadratic extrapolation of the rates after the last window, in units of its length.
    found : array (nodes, dim)
        Rates at the nodes of the present window.
    """

    clock: Array
    counts: Array
    sizes: Array
    tail: Array
    found: Array


class Windows(NamedTuple):
    """Consecutive windows: edges (n + 1,), states (n + 1, dim) and readouts (n, m, dim)."""

    edges: Array
    states: Array
    readouts: Array


def column_sizes(values: Array) -> Array:
    """Largest magnitude in each column."""
    return np.abs(values).max(axis=0)


def column_sizes_in_loops(values: Array) -> Array:
    """Largest magnitude in each column, for numba, which lacks the maximum along an axis."""
    sizes = np.zeros(values.shape[1])
    for row in range(values.shape[0]):
        for column in range(values.shape[1]):
            size = abs(values[row, column])
            # A size that is NaN remains NaN.
            if not size <= sizes[column] and sizes[column] == sizes[column]:
                sizes[column] = size
    return sizes


def typical_sizes(values: Array) -> Array:
    """Mean magnitude in each column without its largest entry, which may lie at a jump."""
    sizes = np.abs(values)
    return (sizes.sum(axis=0) - column_sizes(values)) / (len(values) - 1)


def iterate(
    rates: Rates,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    z: Array,
    h: float,
    ratio: float,
) -> tuple[int, int]:
    """Solve the collocation equation of one window by fixed-point iteration.

    Parameters
    ----------
    z : array (dim,)
        State at the start of the window.
    h : float
        Length of the window, negative backwards in time.
    ratio : float
        Length relative to the last window; 0 for the first window.

    Returns
    -------
    iterations, evaluations : int
        Iterations until convergence, 0 without convergence; evaluations of the vector field.
        ``progress.found`` contains the rates at the nodes.
    """
    values, signs = progress.found, settings.signs[: len(tables.nodes)]
    times = progress.clock[0] + h * tables.nodes
    enough = max(0.01 * settings.tolerance, 4e-16)
    guess = np.empty((len(times), 3))
    guess[:, 0] = 1.0
    guess[:, 1] = ratio * tables.nodes
    guess[:, 2] = guess[:, 1] ** 2
    scaled = h * tables.integration
    nearby = z + scaled @ (guess @ progress.tail)
    scale = np.maximum(np.maximum(progress.sizes, settings.floors), column_sizes(nearby))
    scale = np.maximum(scale, TINY)
    last = math.inf
    tests = 0
    for iteration in range(1, ITERATIONS + 1):
        rates(nearby, times, values)
        moved = z + scaled @ values
        changes = column_sizes(moved - nearby)
        change = (changes / scale).max()
        if change <= enough or (change < 1e-12 and change >= last):
            return iteration, iteration + tests
        if change >= last and tests < ROUND_OFF_TESTS:
            # A component may stay away from its limit by the round-off of its rate.
            tests += 1
            disturbed = np.empty(values.shape)
            rates(nearby * (1 + EPS * signs), times * (1 + EPS * signs[:, 0]), disturbed)
            noise = typical_sizes(disturbed - values)
            if (changes <= enough * scale + NOISE * abs(h) * noise).all():
                return iteration, iteration + tests
        if not change < 1e9 or (iteration > 31 and change > 0.9 * last):
            return 0, iteration + tests
        nearby = moved
        last = change
    return 0, ITERATIONS + tests


def judge(
    rates: Rates,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    z: Array,
    h: float,
    readout: Array,
) -> tuple[float, Array, int]:
    """Compare the residual between the nodes of a window with the tolerance.

    Returns
    -------
    error : float
        Largest ratio of the residual to the allowed one.
    sizes : array (dim,)
        Largest magnitudes of the components so far, this window included.
    evaluations : int
    """
    length, times = abs(h), progress.clock[0] + h * tables.between
    middle = z + tables.to_between @ readout
    flow = np.empty(middle.shape)
    rates(middle, times, flow)
    residual = (tables.rates_between @ readout) / h - flow
    sizes = np.maximum(progress.sizes, column_sizes(middle))
    # No window is short enough to bring the residual below the round-off of the rates.
    allowed = settings.tolerance * np.maximum(sizes, settings.floors)
    allowed = np.maximum(allowed + ROUND_OFF * length * column_sizes(progress.found), TINY)
    defects = length * column_sizes(residual)
    error = (defects / allowed).max()
    if error <= GOOD:
        return error, sizes, 1
    # Where large terms cancel, the round-off is many units of the rates.
    disturbed = np.empty(middle.shape)
    signs = settings.signs
    rates(middle * (1 + EPS * signs), times * (1 + EPS * signs[:, 0]), disturbed)
    allowed = allowed + NOISE * length * typical_sizes(disturbed - flow)
    return (defects / allowed).max(), sizes, 2


def march_windows(
    rates: Rates,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    windows: Windows,
    given: bool,
) -> int:
    """Fill windows from progress.counts[0] on; return the outcome.

    ``given`` says whether ``progress.found`` already contains the rates at the nodes of the first
    window.
    """
    edges, states, readouts = windows
    clock, counts, stops = progress.clock, progress.counts, settings.stops
    direction = 1.0 if stops[-1] > clock[0] else -1.0
    last_length = abs(clock[0] - edges[counts[0] - 1]) if counts[0] else 0.0
    # Where the iteration fails, Newton's method follows; in large systems only after shorter
    # windows failed too, or right after a window that needed it.
    stiff, failures = given, 0
    retries = 0 if progress.found.size <= SMALL else RETRIES
    while counts[2] < len(stops):
        stop, count = stops[counts[2]], counts[0]
        left = abs(stop - clock[0])
        length = min(clock[1], settings.longest, left)
        # Equal windows may miss the stop by round-off: no sliver is left before it.
        if left - length < SLIVER * length:
            length = left
        clock[1] = length
        if length < settings.shortest:
            return TOO_SHORT
        if count == len(readouts):
            return FULL
        h, z = direction * length, states[count]
        slow = False
        if not given:
            ratio = length / last_length if count else 0.0
            iterations, spent = iterate(rates, tables, settings, progress, z, h, ratio)
            counts[1] += spent
            if iterations == 0:
                if stiff or failures >= retries:
                    return NEWTON
                failures += 1
                clock[1] = length * SHRINK
                continue
            slow, stiff = iterations > SLOW + 1, False
        given = False
        readout = h * (tables.fit @ progress.found)
        error, sizes, spent = judge(rates, tables, settings, progress, z, h, readout)
        counts[1] += spent
        if not error <= 1:  # also where it is NaN
            factor = (0.3 / error) ** (1 / ORDER) if math.isfinite(error) else 0.3
            clock[1] = length * min(max(factor, 0.3), 0.9)
            continue
        # Rounding Q(1) would push every window the same way, and energies would drift.
        states[count + 1] = z + (tables.end @ readout + tables.end_low @ readout)
        readouts[count] = readout
        if length == left:
            clock[0] = stop
            counts[2] += 1
        else:
            clock[0] += h
        edges[count + 1] = clock[0]
        counts[0] += 1
        failures = 0
        progress.tail[:, :] = tables.tail_fit @ progress.found[-TAIL:]
        progress.sizes[:] = sizes
        growth = min(GROW, (0.1 / max(error, 1e-30)) ** (1 / ORDER))
        if error <= GOOD:
            growth = max(growth, 1.0)
        last_length = length
        clock[1] = length * (SHRINK if slow else growth)
    return FINISHED
