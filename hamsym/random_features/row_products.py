"""Functions of rows in compiled code, in place of those of the plain loops.

They compute what the functions of the same names in :mod:`hamsym.random_features.window_loop` and
:mod:`hamsym.random_features.error_loop` do. Array expressions would be slower, and take numba
seconds to compile.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hamsym.random_features import vector_products, window_loop
from hamsym.random_features.error_loop import PERTURBATIONS
from hamsym.random_features.window_loop import TINY

#: Names of the functions that replace those of the plain loops.
MARCH_FUNCTIONS = (
    *("add", "advance", "disturb", "fill", "largest_of", "multiply", "polynomials", "products"),
    *("ratio", "row_sizes", "shift", "store", "stretch", "subtract", "typical_sizes", "weighted"),
    *("widen", "worst"),
)
ERROR_FUNCTIONS = (
    *("apply", "component_sizes", "curvature", "deviations", "displace", "eliminate"),
    *("error_size", "force_error", "join_error", "typical_noise"),
)


margin_inside = njit(error_model="numpy")(window_loop.margin_inside)


@njit(error_model="numpy")
def products(table, rows, out):
    """Multiply rows (dim, n) by a table (n, k) into out (dim, k)."""
    vector_products.products(table, rows, out)


@njit(error_model="numpy", forceinline=True)
def advance(table, rows, base, h, states, changes):
    """Replace states by base + h rows table; changes (dim, 8) bound those of a row."""
    vector_products.advance(table, rows, base, h, states, changes)


@njit(error_model="numpy", forceinline=True)
def _largest(values):
    """Largest of eight magnitudes; NaN if one is."""
    size = 0.0
    for column in range(8):
        value = values[column]
        # A size that is NaN remains NaN.
        if not value <= size and size == size:
            size = value
    return size


@njit(error_model="numpy", forceinline=True)
def ratio(changes, scale):
    """Largest ratio of the changes, shape (dim, 8), to the scale; NaN if there is one."""
    found = np.empty(8)
    vector_products.ratios(changes, scale, found)
    return _largest(found)


@njit(error_model="numpy")
def row_sizes(rows, out):
    """Write the largest magnitude in each row; NaN if there is one."""
    sizes = np.empty((rows.shape[0], 8))
    vector_products.maxima(rows, sizes)
    for row in range(rows.shape[0]):
        out[row] = _largest(sizes[row])


@njit(error_model="numpy")
def typical_sizes(rows, others, out):
    """Write the mean |rows - others| of each row without its largest, which may lie at a jump."""
    for row in range(rows.shape[0]):
        total, largest = 0.0, 0.0
        for column in range(rows.shape[1]):
            change = abs(rows[row, column] - others[row, column])
            total += change
            largest = max(largest, change)
        out[row] = (total - largest) / (rows.shape[1] - 1)


@njit(error_model="numpy")
def widen(sizes, rows):
    """Replace sizes by the largest magnitude in each row where that is larger, or NaN."""
    found = np.empty((rows.shape[0], 8))
    vector_products.maxima(rows, found)
    for row in range(rows.shape[0]):
        value = _largest(found[row])
        if not value <= sizes[row] and sizes[row] == sizes[row]:
            sizes[row] = value


@njit(error_model="numpy")
def fill(rows, values):
    """Set each row to its value."""
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] = values[row]


@njit(error_model="numpy")
def shift(rows, values):
    """Add to each row its value."""
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] += values[row]


@njit(error_model="numpy")
def add(rows, others):
    """Add others to rows."""
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] += others[row, column]


@njit(error_model="numpy")
def stretch(places, h, start, out):
    """Write the times at places of a window, inside it by some units in the last place."""
    end = start + h
    margin = margin_inside(start, end)
    low, high = min(start, end) + margin, max(start, end) - margin
    for column in range(len(places)):
        out[column] = min(max(h * places[column] + start, low), high)


@njit(error_model="numpy")
def disturb(rows, signs, share, out):
    """Write rows whose numbers are changed by a share of themselves, with these signs."""
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            out[row, column] = rows[row, column] * (1.0 + share * signs[row, column])


@njit(error_model="numpy")
def subtract(rows, divisor, others):
    """Replace rows by rows / divisor - others."""
    for row in range(rows.shape[0]):
        for column in range(rows.shape[1]):
            rows[row, column] = rows[row, column] / divisor - others[row, column]


@njit(error_model="numpy")
def multiply(rows, factor):
    """Multiply rows by a factor."""
    values = rows.ravel()
    for k in range(len(values)):
        values[k] *= factor


@njit(error_model="numpy")
def largest_of(first, second, out):
    """Write the larger of two sizes, at least the smallest normal number; NaN if one is."""
    for k in range(len(out)):
        size = max(first[k], second[k])
        out[k] = max(size, TINY)


@njit(error_model="numpy")
def worst(defects, sizes, floors, tolerance, rounding, speeds, noise):
    """Largest defect in units of the allowed one; NaN if there is one."""
    largest = 0.0
    for k in range(len(defects)):
        size = max(sizes[k], floors[k])
        allowed = tolerance * size + rounding * speeds[k]
        error = defects[k] / ((max(allowed, TINY)) + noise[k])
        if not error <= largest and largest == largest:
            largest = error
    return largest


@njit(error_model="numpy")
def weighted(rows, weights, low, out):
    """Write sums of rows with weights that are high and low parts."""
    for row in range(rows.shape[0]):
        total, rest = 0.0, 0.0
        for column in range(rows.shape[1]):
            total += rows[row, column] * weights[column]
            rest += rows[row, column] * low[column]
        out[row] = total + rest


@njit(error_model="numpy")
def store(rows, out):
    """Write the transposed rows as far as out has columns for them."""
    for column in range(out.shape[0]):
        for row in range(rows.shape[0]):
            out[column, row] = rows[row, column]


@njit(error_model="numpy")
def polynomials(ratio, nodes, out):
    """Chebyshev polynomials at 1 + 2 ratio nodes, a row for each degree."""
    for column in range(nodes.shape[0]):
        x = 1.0 + 2.0 * ratio * nodes[column]
        out[0, column], out[1, column] = 1.0, x
    for k in range(2, out.shape[0]):
        for column in range(nodes.shape[0]):
            x = 2.0 * out[1, column]
            out[k, column] = x * out[k - 1, column] - out[k - 2, column]


# -- vectors of the error, in rows for component and vector ----------------------------------------


@njit(error_model="numpy", forceinline=True)
def apply(actions, second, vectors, out):
    """Write one half of A V to out; rows are grouped by component."""
    each = PERTURBATIONS + 2
    for row in range(out.shape[0]):
        for node in range(out.shape[1]):
            out[row, node] = 0.0
    count = len(actions.rows)
    for i in range(count):
        target = actions.rows[i] * each
        end = actions.starts[i + 1] if i + 1 < count else len(actions.sources)
        for k in range(actions.starts[i], end):
            source, entry, factor = (
                actions.sources[k] * each,
                actions.entries[k],
                actions.factors[k],
            )
            vector_products.add_products(second, entry, factor, vectors, source, out, target, each)


@njit(error_model="numpy")
def eliminate(first, other, second, base, h, table, out, moved):
    """Leave the elimination to the plain function."""
    return False


@njit(error_model="numpy")
def typical_noise(rows, others, out):
    """Write the root mean square of each row of rows - others."""
    for row in range(rows.shape[0]):
        total = 0.0
        for column in range(rows.shape[1]):
            total += (rows[row, column] - others[row, column]) ** 2
        out[row] = math.sqrt(total / rows.shape[1])


@njit(error_model="numpy")
def deviations(vectors, out):
    """Write the largest root mean square of the perturbations, and the largest last vector."""
    each = PERTURBATIONS + 2
    for i in range(out.shape[1]):
        largest, last = 0.0, 0.0
        for node in range(vectors.shape[1]):
            total = 0.0
            for k in range(PERTURBATIONS):
                total += vectors[i * each + 1 + k, node] ** 2
            largest = max(largest, total)
            last = max(last, abs(vectors[i * each + each - 1, node]))
        out[0, i], out[1, i] = math.sqrt(largest / PERTURBATIONS), last


@njit(error_model="numpy")
def component_sizes(vectors, factor, out):
    """Write the size of each component over its vectors at three nodes, times a factor, by row."""
    each, last = PERTURBATIONS + 2, vectors.shape[1] - 1
    for i in range(vectors.shape[0] // each):
        size = TINY
        for row in range(i * each, (i + 1) * each):
            size = max(size, abs(vectors[row, 0]), abs(vectors[row, last]))
            size = max(size, abs(vectors[row, last // 2]))
        for row in range(i * each, (i + 1) * each):
            out[row] = factor * size


@njit(error_model="numpy")
def force_error(base, drift, h, scale):
    """Add the integral of the residual to the first vector of each component."""
    each = PERTURBATIONS + 2
    for i in range(drift.shape[0]):
        for node in range(drift.shape[1]):
            base[i * each, node] -= drift[i, node] * (h / scale[i])


@njit(error_model="numpy")
def join_error(vectors, drift, h, scale, out):
    """Write the first vector of each component without the integral of the residual."""
    each = PERTURBATIONS + 2
    for i in range(drift.shape[0]):
        for node in range(drift.shape[1]):
            out[i, node] = vectors[i * each, node] * scale[i] + drift[i, node] * h


@njit(error_model="numpy")
def error_size(vectors):
    """Return the largest magnitude of the first vectors; NaN if there is one."""
    size = 0.0
    for row in range(0, vectors.shape[0], PERTURBATIONS + 2):
        for node in range(vectors.shape[1]):
            value = abs(vectors[row, node])
            if not value <= size and size == size:
                size = value
    return size


@njit(error_model="numpy")
def displace(z, vectors, scale, out):
    """Write z with the error added to it."""
    each = PERTURBATIONS + 2
    for i in range(z.shape[0]):
        for node in range(z.shape[1]):
            out[i, node] = vectors[i * each, node] * scale[i] + z[i, node]


@njit(error_model="numpy")
def curvature(displaced, rates, moved, scale):
    """Subtract from the rates at displaced states those at z, and their linear change."""
    each = PERTURBATIONS + 2
    for i in range(rates.shape[0]):
        for node in range(rates.shape[1]):
            displaced[i, node] -= rates[i, node] + moved[i * each, node] * scale[i]
