"""The loop over windows of collocation, one after the other, each to a local tolerance.

Written in the common subset of numpy and numba: it runs as plain Python, and
:mod:`hamsym.random_features.compiled_loop` compiles the same text, with the functions of
:mod:`hamsym.random_features.row_products` in place of those that are marked below.

States and rates are rows, shape (dim, n): one row for each component, so that the processor
computes several points at once. The equations are functions velocity and force (states, times,
parameters, out), which write dq/dt and dp/dt, shape (dof, n). The fixed point is iterated by
halves: the momenta with the force at the last coordinates, then the coordinates with the velocity
at the new momenta, which needs half as many iterations as both at once.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

# Outcomes of march_windows: at the end of the span, at a window whose equation the fixed-point
# iteration does not solve, at a window too short for float64, or with its arrays full.
FINISHED, NEWTON, TOO_SHORT, FULL = range(4)

ROUND_OFF = 256 * 2.0**-52  # of the residual, relative to the rates
EPS = 2.0**-52
# Distance of places from the ends of their window: units in the last place of the time at least,
# and at most where that is a small share of the window.
LEAST_INSIDE, INSIDE, SMALL_INSIDE = 1.0, 4.0, 1e-6
NOISE = 8.0  # times the typical change of the rates for one unit in the last place of the states
SLOW = 20  # iterations, after which the next window is shorter
# Slow windows after which longer ones are solved by Newton's method; those until it is tried again
# where that did not pay; and the ratio of the lengths from which it pays, larger in large systems.
PATIENCE, PAUSE, PAYS = 4, 200, 3.0
ROUND_OFF_TESTS = 3  # estimates of the round-off of the rates in one window
SHRINK, GROW = 0.6, 2.5
AIM, GOOD = 0.1, 0.3  # of the allowed residual: of the next window; it need not be shorter
ENOUGH = 0.01  # of the tolerance, to which the equation of a window is solved
FIRST = 0.7  # length of the first window, in units of the shortest time of change
NEAR = 1e-6  # of a short time, over which the change of the rates is measured
SLIVER = 1e-6  # share of a window by which it is lengthened to reach a stop
ITERATIONS = 60
SMALL, RETRIES = 600, 3  # unknowns above which shorter windows are tried, and how often
SMALL_MATRIX = 100  # unknowns above which the equations of Newton's method take most of its time
TINY = 2.2250738585072014e-308

Array: TypeAlias = np.ndarray
Rates: TypeAlias = Callable[[Array, Array, Array, Array], None]


class Tables(NamedTuple):
    """Tables of a :class:`~hamsym.random_features.basis.FeatureBasis`, contiguous.

    They multiply rows from the right: a table from n values to k has the shape (n, k). ``end`` and
    ``end_low`` are the high and low parts of extended-precision values; ``extrapolation`` fits a
    Chebyshev series to the rates at the nodes, which is continued into the next window; ``order``
    is that at which the residual falls with the length of the window, shape (1,).
    """

    nodes: Array
    integration: Array
    fit: Array
    between: Array
    to_between: Array
    rates_between: Array
    end: Array
    end_low: Array
    extrapolation: Array
    order: Array


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
    signs : array (dim, between)
        1 and -1 at random. The change of the rates when states and times change by one unit in the
        last place, with these signs, is their round-off.
    shortest : float
        Length below which a window is not tried.
    longest : float
        Length that no window exceeds, but for a sliver.
    parameters : array
        Values of the parameters of H.
    separable : bool
        Whether H is separable: the coordinates alone then determine the next iteration.
    """

    stops: Array
    tolerance: float
    floors: Array
    signs: Array
    shortest: float
    longest: float
    parameters: Array
    separable: bool


class Progress(NamedTuple):
    """State of a march between calls, updated in place.

    Attributes
    ----------
    clock : array (3,)
        Time, length of the next window, and that of the last slow one.
    counts : array (4,)
        Windows so far, evaluations of the vector field, stops passed, slow windows; a negative
        number of them is a pause of Newton's method.
    sizes : array (dim,)
        Largest magnitude of each component so far.
    tail : array (dim, terms)
        Chebyshev series of the rates in the last window.
    found : array (dim, nodes)
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


class Scratch(NamedTuple):
    """Arrays of the present window, allocated once: at the nodes, and at the points in between."""

    times: Array
    basis: Array
    base: Array
    nearby: Array
    changes: Array
    readout: Array
    times_between: Array
    middle: Array
    flow: Array
    residual: Array
    scale: Array
    sizes: Array
    defects: Array
    speeds: Array
    noise: Array


def margin_inside(start: float, end: float) -> float:
    """Return the least distance of a place from the ends of its window."""
    unit = EPS * max(abs(start), abs(end))
    return max(LEAST_INSIDE * unit, min(INSIDE * unit, SMALL_INSIDE * abs(end - start)))


# -- products of rows and tables; replaced in compiled code ----------------------------------------


def products(table: Array, rows: Array, out: Array) -> None:
    """Multiply rows (dim, n) by a table (n, k) into out (dim, k)."""
    np.matmul(rows, table, out=out)


def advance(
    table: Array, rows: Array, base: Array, h: float, states: Array, changes: Array
) -> None:
    """Replace states by base + h rows table; changes (dim, 8) bound those of a row."""
    moved = rows @ table
    moved *= h
    moved += base
    changes[:] = np.abs(moved - states).max(axis=1)[:, None]
    states[:] = moved


def ratio(changes: Array, scale: Array) -> float:
    """Largest ratio of the changes, shape (dim, 8), to the scale; NaN if there is one."""
    return float((changes[:, 0] / scale).max())


def row_sizes(rows: Array, out: Array) -> None:
    """Write the largest magnitude in each row; NaN if there is one."""
    np.abs(rows).max(axis=1, out=out)


def typical_sizes(rows: Array, others: Array, out: Array) -> None:
    """Write the mean |rows - others| of each row without its largest, which may lie at a jump."""
    changes = np.abs(rows - others)
    out[:] = (changes.sum(axis=1) - changes.max(axis=1)) / (rows.shape[1] - 1)


def widen(sizes: Array, rows: Array) -> None:
    """Replace sizes by the largest magnitude in each row where that is larger, or NaN."""
    np.maximum(sizes, np.abs(rows).max(axis=1), out=sizes)


def fill(rows: Array, values: Array) -> None:
    """Set each row to its value."""
    rows[:] = values[:, None]


def shift(rows: Array, values: Array) -> None:
    """Add to each row its value."""
    rows += values[:, None]


def add(rows: Array, others: Array) -> None:
    """Add others to rows."""
    rows += others


def stretch(places: Array, h: float, start: float, out: Array) -> None:
    """Write the times at places of a window, inside it by some units in the last place.

    At its ends, to which float64 rounds places of short windows, a switch has neither of its
    values.
    """
    np.multiply(places, h, out=out)
    out += start
    end = start + h
    margin = margin_inside(start, end)
    np.clip(out, min(start, end) + margin, max(start, end) - margin, out=out)


def disturb(rows: Array, signs: Array, share: float, out: Array) -> None:
    """Write rows whose numbers are changed by a share of themselves, with these signs."""
    np.multiply(signs[:, : rows.shape[1]], share, out=out)
    out += 1.0
    out *= rows


def subtract(rows: Array, divisor: float, others: Array) -> None:
    """Replace rows by rows / divisor - others."""
    rows /= divisor
    rows -= others


def multiply(rows: Array, factor: float) -> None:
    """Multiply rows by a factor."""
    rows *= factor


def largest_of(first: Array, second: Array, out: Array) -> None:
    """Write the larger of two sizes, at least the smallest normal number; NaN if one is."""
    np.maximum(first, second, out=out)
    np.maximum(out, TINY, out=out)


def worst(
    defects: Array,
    sizes: Array,
    floors: Array,
    tolerance: float,
    rounding: float,
    speeds: Array,
    noise: Array,
) -> float:
    """Largest defect in units of the allowed one; NaN if there is one."""
    # No window is short enough to bring the residual below the round-off of the rates.
    allowed = tolerance * np.maximum(sizes, floors) + rounding * speeds
    return float((defects / (np.maximum(allowed, TINY) + noise)).max())


def weighted(rows: Array, weights: Array, low: Array, out: Array) -> None:
    """Write sums of rows with weights that are high and low parts."""
    np.matmul(rows, weights, out=out)
    out += rows @ low


def store(rows: Array, out: Array) -> None:
    """Write the transposed rows as far as out has columns for them."""
    out[:] = rows.T[: len(out)]


def polynomials(ratio: float, nodes: Array, out: Array) -> None:
    """Chebyshev polynomials at 1 + 2 ratio nodes, a row for each degree."""
    x = 1.0 + 2.0 * ratio * nodes
    out[0], out[1] = 1.0, x
    x = 2.0 * x
    for k in range(2, len(out)):
        np.multiply(x, out[k - 1], out=out[k])
        out[k] -= out[k - 2]


# -- one window ------------------------------------------------------------------------------------


def evaluate(
    velocity: Rates, force: Rates, states: Array, times: Array, parameters: Array, out: Array
) -> None:
    """Write the rates of all components at states to out."""
    half = len(states) // 2
    velocity(states, times, parameters, out[:half])
    force(states, times, parameters, out[half:])


def round_off(
    velocity: Rates,
    force: Rates,
    settings: Settings,
    states: Array,
    times: Array,
    rates: Array,
    factor: float,
    noise: Array,
) -> None:
    """Write the typical change of the rates for one unit in the last place, times a factor."""
    changed, nearby, late = (
        np.empty(states.shape),
        np.empty(states.shape),
        np.empty((1, len(times))),
    )
    disturb(states, settings.signs, EPS, nearby)
    disturb(times.reshape(1, -1), settings.signs[:1], EPS, late)
    evaluate(velocity, force, nearby, late[0], settings.parameters, changed)
    typical_sizes(changed, rates, noise)
    noise *= factor


def iterate(
    velocity: Rates,
    force: Rates,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    scratch: Scratch,
    z: Array,
    h: float,
    longer: float,
) -> tuple[int, int]:
    """Solve the collocation equation of one window by fixed-point iteration.

    Parameters
    ----------
    z : array (dim,)
        State at the start of the window.
    h : float
        Length of the window, negative backwards in time.
    longer : float
        Length relative to the last window; 0 for the first window.

    Returns
    -------
    iterations, evaluations : int
        Iterations until convergence, 0 without convergence; evaluations of the vector field.
        ``progress.found`` contains the rates at the nodes.
    """
    found, parameters = progress.found, settings.parameters
    times, base, nearby, changes = scratch.times, scratch.base, scratch.nearby, scratch.changes
    half = len(found) // 2
    stretch(tables.nodes, h, progress.clock[0], times)
    enough = max(ENOUGH * settings.tolerance, 4e-16)
    fill(base, z)
    fill(nearby, z)
    polynomials(longer, tables.nodes, scratch.basis)
    products(scratch.basis, progress.tail, found)
    advance(tables.integration, found, base, h, nearby, changes)
    scale, noise = scratch.scale, scratch.noise
    largest_of(progress.sizes, settings.floors, scale)
    widen(scale, base)
    widen(scale, nearby)
    # Slices that are made in every iteration would take as long as the products.
    slopes, starts, momenta, kicks = found[half:], base[half:], nearby[half:], changes[half:]
    speeds, places, coordinates, moves = found[:half], base[:half], nearby[:half], changes[:half]
    move_scale, kick_scale = scale[:half], scale[half:]
    last = math.inf
    tests = 0
    for iteration in range(1, ITERATIONS + 1):
        force(nearby, times, parameters, slopes)
        advance(tables.integration, slopes, starts, h, momenta, kicks)
        velocity(nearby, times, parameters, speeds)
        advance(tables.integration, speeds, places, h, coordinates, moves)
        change, kick = ratio(moves, move_scale), ratio(kicks, kick_scale)
        # The momenta of a separable H follow the coordinates of the last iteration: their next
        # change is smaller by as much as that of the coordinates is.
        if not (settings.separable and change <= last):
            change = max(change, kick)
        elif iteration > 1:
            change = max(change, kick * (change / last))
        if change <= enough or (change < 1e-12 and change >= last):
            return iteration, iteration + tests
        if change >= last and tests < 2 * ROUND_OFF_TESTS:
            # A component may stay away from its limit by the round-off of its rate, which is that
            # at the same states: where the iteration diverges, those of the last one are far away.
            tests += 2
            factor = NOISE * abs(h)
            evaluate(velocity, force, nearby, times, parameters, found)
            round_off(velocity, force, settings, nearby, times, found, factor, noise)
            for i in range(len(noise)):
                noise[i] += enough * scale[i]
            if ratio(changes, noise) <= 1:
                return iteration, iteration + tests
        if not change < 1e9 or (iteration > 31 and change > 0.9 * last):
            return 0, iteration + tests
        last = change
    return 0, ITERATIONS + tests


def judge(
    velocity: Rates,
    force: Rates,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    scratch: Scratch,
    z: Array,
    h: float,
) -> tuple[float, int]:
    """Compare the residual between the nodes of a window with the tolerance.

    Returns
    -------
    error : float
        Largest ratio of the residual to the allowed one. ``scratch.sizes`` contains the largest
        magnitudes of the components so far, this window included.
    evaluations : int
    """
    length, times, middle = abs(h), scratch.times_between, scratch.middle
    flow, residual, sizes = scratch.flow, scratch.residual, scratch.sizes
    stretch(tables.between, h, progress.clock[0], times)
    products(tables.to_between, scratch.readout, middle)
    shift(middle, z)
    evaluate(velocity, force, middle, times, settings.parameters, flow)
    products(tables.rates_between, scratch.readout, residual)
    subtract(residual, h, flow)
    sizes[:] = progress.sizes
    widen(sizes, middle)
    defects, speeds, noise = scratch.defects, scratch.speeds, scratch.noise
    row_sizes(residual, defects)
    multiply(defects, length)
    row_sizes(progress.found, speeds)
    noise[:] = 0.0
    tolerance, rounding = settings.tolerance, ROUND_OFF * length
    error = worst(defects, sizes, settings.floors, tolerance, rounding, speeds, noise)
    if error <= GOOD:
        return error, 1
    # Where large terms cancel, the round-off is many units of the rates.
    round_off(velocity, force, settings, middle, times, flow, NOISE * length, noise)
    return worst(defects, sizes, settings.floors, tolerance, rounding, speeds, noise), 2


# -- the march -------------------------------------------------------------------------------------


def first_length(
    velocity: Rates,
    force: Rates,
    z: Array,
    rates: Array,
    start: float,
    end: float,
    parameters: Array,
) -> float:
    """Return a length for the first window, from the times in which the components change.

    With the slopes a of the rates f along the motion, component z changes in the longer of the
    times sqrt(z/a) and f/a; ``rates`` has the shape (dim, 1).
    """
    dim, whole = len(z), abs(end - start)
    time = whole
    for i in range(dim):
        if rates[i, 0] != 0.0 and z[i] != 0.0:
            time = min(time, abs(z[i] / rates[i, 0]))
    step = math.copysign(NEAR * time, end - start)
    near, later, times = np.empty((dim, 1)), np.empty((dim, 1)), np.empty(1)
    for i in range(dim):
        near[i, 0] = z[i] + step * rates[i, 0]
    times[0] = start + step
    evaluate(velocity, force, near, times, parameters, later)
    time = whole
    for i in range(dim):
        slope = abs((later[i, 0] - rates[i, 0]) / step)
        if slope > 0.0 and slope < math.inf:
            own = max(math.sqrt(abs(z[i]) / slope), abs(rates[i, 0]) / slope)
            if own > 0.0:
                time = min(time, own)
    return FIRST * time


def march_windows(
    velocity: Rates,
    force: Rates,
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
    order = tables.order[0]
    dim, nodes, between = states.shape[1], len(tables.nodes), len(tables.between)
    scratch = Scratch(
        np.empty(nodes),
        np.empty((progress.tail.shape[1], nodes)),
        np.empty((dim, nodes)),
        np.empty((dim, nodes)),
        np.empty((dim, 8)),
        np.empty((dim, tables.fit.shape[1])),
        np.empty(between),
        np.empty((dim, between)),
        np.empty((dim, between)),
        np.empty((dim, between)),
        np.empty(dim),
        np.empty(dim),
        np.empty(dim),
        np.empty(dim),
        np.empty(dim),
    )
    readout = scratch.readout
    # Where the iteration fails, Newton's method follows; in large systems only after shorter
    # windows failed too, or right after a window that needed it.
    stiff, failures = given, 0
    retries = 0 if progress.found.size <= SMALL else RETRIES
    pays = PAYS * (1 + (progress.found.size / SMALL_MATRIX) ** 2)
    while counts[2] < len(stops):
        stop, count = stops[counts[2]], counts[0]
        left = abs(stop - clock[0])
        length = min(clock[1], settings.longest, left)
        # Equal windows may miss the stop by round-off: no sliver is left before it.
        if left - length < SLIVER * length:
            length = left
        # The difference of two times that float64 has: others round each window's length.
        end = stop if length == left else clock[0] + direction * length
        h, z = end - clock[0], states[count]
        clock[1] = length = abs(h)
        if length < settings.shortest:
            return TOO_SHORT
        if count == len(readouts):
            return FULL
        slow = False
        if not given:
            longer = length / last_length if count else 0.0
            iterations, spent = iterate(
                velocity, force, tables, settings, progress, scratch, z, h, longer
            )
            counts[1] += spent
            slow = iterations > SLOW + 1
            if slow and counts[3] >= PATIENCE:
                return NEWTON
            if iterations == 0:
                if stiff or failures >= retries or counts[3] >= PATIENCE:
                    return NEWTON
                failures += 1
                clock[1] = length * SHRINK
                continue
            stiff = False
        by_newton, given = given, False
        products(tables.fit, progress.found, readout)
        multiply(readout, h)
        error, spent = judge(velocity, force, tables, settings, progress, scratch, z, h)
        counts[1] += spent
        if not error <= 1:  # also where it is NaN
            factor = (GOOD / error) ** (1 / order) if math.isfinite(error) else 0.3
            clock[1] = length * min(max(factor, 0.3), 0.9)
            continue
        # Rounding Q(1) would push every window the same way, and energies would drift.
        weighted(readout, tables.end, tables.end_low, states[count + 1])
        states[count + 1] += z
        store(readout, readouts[count])
        clock[0] = end
        if end == stop:
            counts[2] += 1
        edges[count + 1] = clock[0]
        counts[0] += 1
        failures = 0
        products(tables.extrapolation, progress.found, progress.tail)
        progress.sizes[:] = scratch.sizes
        growth = min(GROW, (AIM / max(error, 1e-30)) ** (1 / order))
        if error <= GOOD:
            growth = max(growth, 1.0)
        last_length = length
        clock[1] = length * (SHRINK if slow else growth)
        if slow:
            counts[3] += 1
            clock[2] = length
        elif growth <= 1 and counts[3] >= PATIENCE:
            # The residual limits the windows: they are worth Newton's method, or are not.
            if not by_newton:
                counts[3] = 0
            elif length < pays * clock[2]:
                counts[3] = -PAUSE
            else:
                clock[2] = 0.0
    return FINISHED
