"""The loop that carries the error of a march from window to window.

Written in the common subset of numpy and numba, as :mod:`hamsym.random_features.window_loop` is.

The linear equation of the error (the paper's eq. ell) is solved for the vectors that are needed:
the error itself, driven by the residual, and perturbations of the size of round-off. With rows for
component and vector, a window is a fixed point V = V_a + D + h S A V, with A = J Hess at its nodes
and D the integral of the residual; it is iterated by halves, as the states were.

An error e obeys e' = F(z^ + e) - F(z^) - r, of which that equation is the linear part. It is valid
as long as what it lacks, F(z^ + e) - F(z^) - A e, changes e by little.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hamsym.random_features.window_loop import (
    EPS,
    ROUND_OFF,
    TINY,
    Array,
    Rates,
    Windows,
    add,
    advance,
    disturb,
    evaluate,
    fill,
    multiply,
    products,
    ratio,
    row_sizes,
    shift,
    store,
    stretch,
    subtract,
    weighted,
)

# Outcomes of carry_errors: all windows estimated; errors as large as the motion, or not finite; a
# window whose equation neither iteration nor elimination solves.
DONE, LOST, STUCK = range(3)
# Marks of windows: the residual is large relative to the rates, or exceeds its limit; the error is
# so large that its equation is not linear.
UNRESOLVED, EXCESSIVE, BENT = 1, 2, 4

PERTURBATIONS = 4  # random vectors that represent round-off
COHERENT = 2.0  # times the round-off of independent places
RESOLVED = 1e-3  # residual, relative to the rates, that a smooth force leaves at most
LARGEST = 1.0  # error, in units of the motion, beyond which there is no estimate
TESTED = 1e-6  # error, in units of the motion, from which the linear equation is tested
CURVED = 1e-3  # of the error in a window: change by what the linear equation lacks, at most
PASSING = 10.0  # typical errors: larger ones may pass, so their vectors are solved more accurately
ACCURACY, FEWEST = 1e-3, 10.0  # of the vectors after all windows, and the least number of these
TIGHTER = 3.0  # excess over the tolerance that errors beyond the linear equation count as, at least
SLACK = 10.0  # times the residual that the march allows at its own places
MISSED = 1.1  # times a peak between two of the values that show it
ITERATIONS = 60
ELIMINATED = 160  # unknowns up to which plain code eliminates, as fast as an iteration in numpy


class ErrorTables(NamedTuple):
    """Tables of a basis for the estimate, which multiply rows from the right.

    Attributes
    ----------
    nodes : array (n,)
        Places of the tangent equation.
    at_nodes : array (m, n)
        Columns of the basis there.
    places : array (sets, f)
        Places of the residual: Chebyshev nodes, then random ones; one set for each window in turn.
    values, values_low, rates, rates_low : array (sets, m, f)
        Columns of the basis and their derivatives there, as high and low parts.
    drift, drift_inside : array (f, n), (f, k)
        From the residual at the places to its integral, at the nodes and at k places inside.
    drift_end, drift_none : array (f,)
        Weights of its integral over the window, and zeros.
    integration, lift : array (n, n), (n, k)
        From values at the nodes to their integral there, and to the places inside.
    end, none : array (n,)
        Weights of the integral over the window, and zeros.
    to_series : array (k, k)
        From values inside to a Chebyshev series.
    dense : array (k, 2 k)
        From values inside to more values, which show peaks.
    """

    nodes: Array
    at_nodes: Array
    places: Array
    values: Array
    values_low: Array
    rates: Array
    rates_low: Array
    drift: Array
    drift_inside: Array
    drift_end: Array
    drift_none: Array
    integration: Array
    lift: Array
    end: Array
    none: Array
    to_series: Array
    dense: Array


class Actions(NamedTuple):
    """Terms of one half of A V: row += factor * second derivative * source row.

    Terms of one row are consecutive: those of ``rows[i]`` begin at ``starts[i]``.
    """

    rows: Array
    starts: Array
    sources: Array
    entries: Array
    factors: Array


class ErrorSettings(NamedTuple):
    """Constants of an estimate.

    Attributes
    ----------
    scale : array (dim,)
        Units of the components, positive.
    sizes : array (dim,)
        Sizes of the components to which the tolerance is relative.
    tolerance : float
        Local tolerance of the march.
    accuracy : float
        Of the vectors at the end of each window.
    usual_length : float
        Expected length of the window that contains a random time.
    rounded : float
        1 if H has numbers that float64 cannot represent, else 0.
    signs : array (sets, dim, f)
        1 and -1 at random, for the disturbance of the states.
    kicks : array (period, dim, PERTURBATIONS)
        1 and -1 at random, for each window in turn.
    parameters : array
        Values of the parameters of H.
    """

    scale: Array
    sizes: Array
    tolerance: float
    accuracy: float
    usual_length: float
    rounded: float
    signs: Array
    kicks: Array
    parameters: Array


# -- replaced in compiled code ---------------------------------------------------------------------


def apply(actions: Actions, second: Array, vectors: Array, out: Array) -> None:
    """Write one half of A V to out; rows are grouped by component."""
    shape = (-1, PERTURBATIONS + 2, vectors.shape[1])
    out[:] = 0.0
    if len(actions.rows):
        terms = (actions.factors[:, None] * second[actions.entries])[:, None]
        terms = terms * vectors.reshape(shape)[actions.sources]
        out.reshape(shape)[actions.rows] = np.add.reduceat(terms, actions.starts, axis=0)


def eliminate(
    first: Actions,
    other: Actions,
    second: Array,
    base: Array,
    h: float,
    table: Array,
    out: Array,
    moved: Array,
) -> bool:
    """Solve the equations of one window by elimination; return whether there is a solution."""
    count = base.shape[1]
    dim = len(base) // (PERTURBATIONS + 2)
    matrix = np.zeros((dim, count, dim, count))
    for half, offset in ((first, dim // 2), (other, 0)):
        rows = np.repeat(half.rows + offset, np.diff(np.append(half.starts, len(half.sources))))
        values = (-h * half.factors)[:, None, None] * table.T * second[half.entries][:, None]
        matrix[rows, :, half.sources] = values
    size = dim * count
    right = base.reshape(dim, -1, count).transpose(0, 2, 1).reshape(size, -1)
    try:
        found = np.linalg.solve(np.eye(size) + matrix.reshape(size, size), right)
    except np.linalg.LinAlgError:
        return False
    out[:] = found.reshape(dim, count, -1).transpose(0, 2, 1).reshape(out.shape)
    apply(first, second, out, moved[len(out) // 2 :])
    apply(other, second, out, moved[: len(out) // 2])
    return bool(np.isfinite(out).all())


def typical_noise(rows: Array, others: Array, out: Array) -> None:
    """Write the root mean square of each row of rows - others."""
    changes = rows - others
    np.sqrt((changes * changes).mean(axis=1), out=out)


def deviations(vectors: Array, out: Array) -> None:
    """Write the largest root mean square of the perturbations, and the largest last vector."""
    rows = vectors.reshape(-1, PERTURBATIONS + 2, vectors.shape[1])
    out[0] = np.sqrt((rows[:, 1:-1] ** 2).mean(axis=1)).max(axis=1)
    out[1] = np.abs(rows[:, -1]).max(axis=1)


def component_sizes(vectors: Array, factor: float, out: Array) -> None:
    """Write the size of each component over its vectors at three nodes, times a factor, by row."""
    last = vectors.shape[1] - 1
    some = np.abs(vectors[:, [0, last // 2, last]])
    sizes = some.reshape(-1, 3 * (PERTURBATIONS + 2)).max(axis=1)
    out.reshape(len(sizes), -1)[:] = factor * np.maximum(sizes, TINY)[:, None]


def force_error(base: Array, drift: Array, h: float, scale: Array) -> None:
    """Add the integral of the residual to the first vector of each component."""
    base[:: PERTURBATIONS + 2] -= drift * (h / scale[:, None])


def join_error(vectors: Array, drift: Array, h: float, scale: Array, out: Array) -> None:
    """Write the first vector of each component without the integral of the residual."""
    np.multiply(vectors[:: PERTURBATIONS + 2], scale[:, None], out=out)
    out += drift * h


def error_size(vectors: Array) -> float:
    """Return the largest magnitude of the first vectors; NaN if there is one."""
    return float(np.abs(vectors[:: PERTURBATIONS + 2]).max())


def displace(z: Array, vectors: Array, scale: Array, out: Array) -> None:
    """Write z with the error added to it."""
    np.multiply(vectors[:: PERTURBATIONS + 2], scale[:, None], out=out)
    out += z


def curvature(displaced: Array, rates: Array, moved: Array, scale: Array) -> None:
    """Subtract from the rates at displaced states those at z, and their linear change."""
    displaced -= rates
    displaced -= moved[:: PERTURBATIONS + 2] * scale[:, None]


# -- one window ------------------------------------------------------------------------------------


def transport(
    forces: Actions,
    velocities: Actions,
    tables: ErrorTables,
    second: Array,
    base: Array,
    h: float,
    accuracy: float,
    vectors: Array,
    moved: Array,
    changes: Array,
) -> bool:
    """Solve the tangent equation of a window for all vectors.

    ``base`` are the vectors without it; ``vectors`` and ``moved``, the products A V, are written.
    """
    half, limits = len(vectors) // 2, np.empty(len(vectors))
    vectors[:, :] = base
    slopes, starts, momenta, kicks = moved[half:], base[half:], vectors[half:], changes[half:]
    speeds, places, coordinates, moves = moved[:half], base[:half], vectors[:half], changes[:half]
    for iteration in range(1, ITERATIONS + 1):
        apply(forces, second, vectors, slopes)
        advance(tables.integration, slopes, starts, h, momenta, kicks)
        apply(velocities, second, vectors, speeds)
        advance(tables.integration, speeds, places, h, coordinates, moves)
        if iteration > 2:
            component_sizes(vectors, accuracy, limits)
            largest = ratio(changes, limits)
            if largest <= 1:
                return True
            if not largest < 1e100:
                return False
    return False


def carry_errors(
    velocity: Rates,
    force: Rates,
    hessian: Rates,
    tables: ErrorTables,
    forces: Actions,
    velocities: Actions,
    settings: ErrorSettings,
    windows: Windows,
    jumps: Array,
    joint: Array,
    history: Array,
    series: Array,
    floors: Array,
    largest: Array,
    marks: Array,
    first: int,
    end: int,
) -> tuple[int, int]:
    """Estimate the error of windows from ``first`` to before ``end``.

    Parameters
    ----------
    jumps : array (windows, dim)
        z - z^ due to the rounding of the state at the end of each window.
    joint : array (dim * vectors,)
        Vectors at the start, in units of the scale; at the end on return.
    history : array (2,)
        Integral of the root of the error over the windows before, and the error in the last one,
        in units of the scale; updated.
    series : array (windows, k, dim)
        Chebyshev series of the error; nothing is written if it has no windows.
    floors : array (windows, dim)
        Accumulated round-off; nothing is written if it has no windows.
    largest : array (dim,)
        Largest error and round-off so far; updated.
    marks : array (windows,)
        UNRESOLVED, EXCESSIVE and BENT windows; from a BENT one on the error is not reliable.

    Returns
    -------
    window, outcome : int
        The first window that was not estimated, and DONE, LOST or STUCK.
    """
    edges, states, readouts = windows
    scale, parameters = settings.scale, settings.parameters
    dim, columns = states.shape[1], readouts.shape[1]
    each = PERTURBATIONS + 2
    sets, places = tables.places.shape
    nodes = len(tables.nodes)
    inside = tables.lift.shape[1]
    readout = np.zeros((dim, tables.at_nodes.shape[0]))
    times, late = np.empty(places), np.empty((1, places))
    left, speeds, tops = np.empty(dim), np.empty(dim), np.empty(dim)
    noise, through, peaks, spread = np.empty(dim), np.empty(dim), np.empty(dim), np.empty((2, dim))
    before, ends = np.empty(len(joint)), np.empty(len(joint))
    z, dz, low = np.empty((dim, places)), np.empty((dim, places)), np.empty((dim, places))
    rates, disturbed = np.empty((dim, places)), np.empty((dim, places))
    at_nodes, node_times = np.empty((dim, nodes)), np.empty(nodes)
    drift, smooth = np.empty((dim, nodes)), np.empty((dim, nodes))
    drift_inside, found = np.empty((dim, inside)), np.empty((dim, inside))
    coefficients, shown = np.empty((dim, inside)), np.empty((dim, tables.dense.shape[1]))
    entries = 1
    for half in (forces, velocities):
        for entry in half.entries:
            entries = max(entries, entry + 1)
    second = np.empty((entries, nodes))
    rows = dim * each
    flow, displaced, lacking = (
        np.empty((dim, nodes)),
        np.empty((dim, nodes)),
        np.empty((dim, nodes)),
    )
    base, vectors = np.empty((rows, nodes)), np.empty((rows, nodes))
    moved, changes = np.empty((rows, nodes)), np.empty((rows, 8))
    for w in range(first, end):
        h = edges[w + 1] - edges[w]
        length = abs(h)
        for m in range(columns):
            for i in range(dim):
                readout[i, m] = readouts[w, m, i]
        which = w % sets
        # -- the residual
        products(tables.values[which], readout, z)
        # A rounded table would push every window the same way.
        products(tables.values_low[which], readout, low)
        add(z, low)
        shift(z, states[w])
        stretch(tables.places[which], h, edges[w], times)
        products(tables.rates[which], readout, dz)
        products(tables.rates_low[which], readout, low)
        add(dz, low)
        evaluate(velocity, force, z, times, parameters, rates)
        subtract(dz, h, rates)
        residual = dz
        row_sizes(residual, left)
        row_sizes(rates, speeds)
        row_sizes(z, tops)
        mark = 0
        for i in range(dim):
            # The rates of components that are nothing but round-off are noise.
            small = settings.usual_length * left[i] <= RESOLVED * scale[i]
            if not (left[i] <= RESOLVED * speeds[i] or small):
                mark |= UNRESOLVED
            allowed = settings.tolerance * settings.sizes[i] + ROUND_OFF * length * speeds[i]
            if not length * left[i] <= SLACK * allowed:
                mark |= EXCESSIVE
        marks[w] = mark
        # -- round-off, as the change of the rates for half a unit in the last place
        disturb(z, settings.signs[which], EPS / 2, low)
        disturb(times.reshape(1, -1), settings.signs[which][:1], EPS / 2, late)
        evaluate(velocity, force, low, late[0], parameters, disturbed)
        typical_noise(disturbed, rates, noise)
        # -- the tangent equation
        products(tables.at_nodes, readout, at_nodes)
        shift(at_nodes, states[w])
        stretch(tables.nodes, h, edges[w], node_times)
        hessian(at_nodes, node_times, parameters, second)
        products(tables.drift, residual, drift)
        before[:] = joint
        for i in range(dim):
            # The places average the round-off, but not independently.
            kick = COHERENT * length * (noise[i] + EPS * speeds[i]) / math.sqrt(places) / scale[i]
            for k in range(PERTURBATIONS):
                joint[i * each + 1 + k] += kick * settings.kicks[w % len(settings.kicks), i, k]
            push = settings.rounded * (EPS / 2) * (states[w + 1, i] - states[w, i])
            joint[i * each + each - 1] += push / scale[i]
        fill(base, joint)
        force_error(base, drift, h, scale)
        few = dim * nodes <= ELIMINATED
        # The mean root is the typical size of the error, also if it has short peaks beside a pole.
        mean = history[0] / max(abs(edges[w] - edges[0]), TINY)
        accuracy = settings.accuracy
        if PASSING * mean * mean < history[1]:
            accuracy *= PASSING * mean * mean / history[1]
        solved = few and eliminate(
            forces, velocities, second, base, h, tables.integration, vectors, moved
        )
        solved = solved or transport(
            forces, velocities, tables, second, base, h, accuracy, vectors, moved, changes
        )
        solved = solved or (
            not few
            and eliminate(forces, velocities, second, base, h, tables.integration, vectors, moved)
        )
        if not solved:
            joint[:] = before
            return w, STUCK
        # -- whether the equation is linear
        size = error_size(vectors)
        history[0] += length * math.sqrt(size)
        history[1] = size
        if not size <= TESTED:
            displace(at_nodes, vectors, scale, displaced)
            evaluate(velocity, force, at_nodes, node_times, parameters, flow)
            evaluate(velocity, force, displaced, node_times, parameters, lacking)
            curvature(lacking, flow, moved, scale)
            products(tables.integration, lacking, flow)
            row_sizes(flow, left)
            for i in range(dim):
                if not length * left[i] <= CURVED * size * scale[i]:
                    marks[w] |= BENT
        weighted(moved, tables.end, tables.none, ends)
        weighted(residual, tables.drift_end, tables.drift_none, through)
        for k in range(len(joint)):
            joint[k] += h * ends[k]
        for i in range(dim):
            joint[i * each] += (jumps[w, i] - h * through[i]) / scale[i]
        for value in joint:
            if not abs(value) <= LARGEST:
                return w, LOST
        # -- the error inside the window: its smooth part, and the integral of the residual
        join_error(vectors, drift, h, scale, smooth)
        products(tables.lift, smooth, found)
        products(tables.drift_inside, residual, drift_inside)
        multiply(drift_inside, h)
        subtract(found, 1.0, drift_inside)
        products(tables.dense, found, shown)
        row_sizes(shown, peaks)
        deviations(vectors, spread)
        for i in range(dim):
            # Three standard deviations, at worst in the window, and the rounding of z^ itself.
            floor = scale[i] * (3 * spread[0, i] + spread[1, i]) + EPS / 2 * tops[i]
            peak = MISSED * peaks[i] + floor
            if not peak < math.inf:
                return w, LOST
            largest[i] = max(largest[i], peak)
            if len(floors):
                floors[w, i] = floor
        if len(series):
            products(tables.to_series, found, coefficients)
            store(coefficients, series[w])
    return end, DONE
