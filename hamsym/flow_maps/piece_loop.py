"""Evaluation of a piece of a flow map, in plain code that numba compiles.

Queries are taken in blocks, so that the innermost loops run over the queries of a block. A value is
the same to the last bit whatever the other queries are.
"""

import numpy as np

BLOCK = 24  # queries: three vector registers of eight numbers


def products(table, rows, out):
    """Write rows @ table; compiled, by vector instructions."""
    out[:] = rows @ table


def fill_table(table, x):
    """Write the Chebyshev polynomials at x, shape (BLOCK,), into the rows of a table."""
    for b in range(BLOCK):
        table[0, b] = 1.0
    if table.shape[0] > 1:
        for b in range(BLOCK):
            table[1, b] = x[b]
    for n in range(2, table.shape[0]):
        for b in range(BLOCK):
            table[n, b] = 2 * x[b] * table[n - 1, b] - table[n - 2, b]


def fill_slopes(slopes, table, x):
    """Write their derivatives."""
    for b in range(BLOCK):
        slopes[0, b] = 0.0
    if slopes.shape[0] > 1:
        for b in range(BLOCK):
            slopes[1, b] = 1.0
    for n in range(2, slopes.shape[0]):
        for b in range(BLOCK):
            slopes[n, b] = 2 * (table[n - 1, b] + x[b] * slopes[n - 1, b]) - slopes[n - 2, b]


def evaluate_piece(degrees, readouts, columns, time, y, slope, rate, out):
    """Write sum_r W_r(y) phi_r(t) of each query.

    Parameters
    ----------
    degrees : numpy.ndarray
        Multi-indices, shape (n, d).
    readouts : numpy.ndarray
        Shape (r, n).
    columns : numpy.ndarray
        Shape (r * dim, terms), component after component for each r.
    time : numpy.ndarray
        Scaled times, shape (q,).
    y : numpy.ndarray
        Scaled inputs, shape (q, d).
    slope : int
        The component of y in which to differentiate; -1 for none.
    rate : bool
        Whether to differentiate in the scaled time.
    out : numpy.ndarray
        Shape (q, dim).
    """
    count, d = degrees.shape
    terms, dim, rank = columns.shape[1], out.shape[1], len(readouts)
    most = terms
    for nu in range(count):
        for k in range(d):
            most = max(most, degrees[nu, k] + 1)
    tables, slopes = np.empty((d, most, BLOCK)), np.empty((most, BLOCK))
    series, place = np.empty((terms, BLOCK)), np.zeros(BLOCK)
    polynomials = np.empty((count, BLOCK))
    sums, parts = np.empty((rank, BLOCK)), np.empty((rank * dim, BLOCK))
    for first in range(0, len(time), BLOCK):
        size = min(BLOCK, len(time) - first)
        for k in range(d):
            for b in range(size):
                place[b] = y[first + b, k]
            fill_table(tables[k], place)
            if k == slope:
                fill_slopes(slopes, tables[k], place)
                tables[k] = slopes
        for nu in range(count):
            for b in range(BLOCK):
                polynomials[nu, b] = tables[0, degrees[nu, 0], b]
            for k in range(1, d):
                for b in range(BLOCK):
                    polynomials[nu, b] *= tables[k, degrees[nu, k], b]
        products(polynomials, readouts, sums)
        for b in range(size):
            place[b] = time[first + b]
        fill_table(series, place)
        if rate:
            fill_slopes(slopes[:terms], series, place)
            series[:] = slopes[:terms]
        products(series, columns, parts)
        for i in range(dim):
            for b in range(size):
                out[first + b, i] = 0.0
            for r in range(rank):
                for b in range(size):
                    out[first + b, i] += sums[r, b] * parts[r * dim + i, b]
