"""Chebyshev models of the equations on many intervals: polynomials with bounds on their distance.

A feature of any width inside an interval, for example a pulse between all sampled places, is part
of the distance. Roundings are not counted. The arithmetic is in the library (``kernel/models.h``);
here are its tables and its calls.
"""

from __future__ import annotations

import ctypes
import functools

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.kernel.loops import (
    BoundTables,
    Equations,
    Pieces,
    Record,
    arrays,
    library,
    require_memory,
)
from hamsym.numerics.collocation import turns

DEGREE = 31  # of the polynomials: the columns of the march have 1e-14 beyond it
PLACES = 2 * DEGREE + 2  # enough for products
#: Places in [-1, 1], ascending.
NODES = -turns(PLACES)[1 : 2 * PLACES : 2].astype(float)


class ModelTables(Record):
    """Tables over the places."""

    _fields_ = arrays("coefficients low high values_of_high slopes_of_low defects at_middle")


@functools.cache
def model_tables() -> ModelTables:
    """Make the tables of the arithmetic."""
    angles = np.outer(2 * np.arange(PLACES) + 1, np.arange(PLACES)) % (4 * PLACES)
    # Coefficients -> values; the table of the recurrence would be off by tens of roundings.
    values = turns(PLACES)[angles] * (-1.0) ** np.arange(PLACES)
    weights = np.full(PLACES, 2.0 / PLACES)
    weights[0] = 1.0 / PLACES
    coefficients = values * weights
    low, half = DEGREE + 1, PLACES // 2
    slopes = chebyshev.chebder(np.eye(low)).T @ values[:, : low - 1].T
    integrals = coefficients @ chebyshev.chebint(np.eye(PLACES, dtype=values.dtype)).T
    # Of slopes and of values: odd degrees from even slopes and odd values, and the others.
    odd = np.concatenate((integrals[:half, 1::2], -coefficients[:half, 1::2]))
    more = np.zeros((half, 1), dtype=values.dtype)  # values have no coefficient of degree PLACES
    even = np.concatenate((integrals[:half, 2::2], np.hstack((-coefficients[:half, 2::2], more))))
    return ModelTables(
        coefficients=_parts(coefficients[:half]),
        low=_parts(coefficients[:half, :low]),
        high=_parts(coefficients[:half, low:]),
        values_of_high=_parts(values[:half, low:]).transpose(0, 2, 1),
        slopes_of_low=_parts(slopes[:, :half].T).transpose(0, 2, 1),
        defects=np.array((odd, even)),
        at_middle=chebyshev.chebvander(NODES[half], PLACES)[
            0, [*range(1, PLACES, 2), *range(2, PLACES + 1, 2)]
        ],
    )


def _parts(table: np.ndarray) -> np.ndarray:
    """Return the columns of even and those of odd degrees, shape (2, n, columns / 2)."""
    return np.array((table[:, 0::2], table[:, 1::2]))


def residual_bounds(
    programs: Equations,
    z: np.ndarray,
    rates: np.ndarray,
    t: np.ndarray,
    ends: np.ndarray,
    parameters: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bound the residual of each component on parts of windows.

    - z, rates: Trial solution and its derivative, shape (parts, PLACES, dim).
    - t: Shape (parts, PLACES).
    - ends: The least and the largest time of each part, shape (parts, 2).
    - parameters: Shape (k,) or (parts, k).
    - returns bounds, hidden, rounding: Shape (parts, dim). ``hidden`` bounds the distance of
      the residual from a polynomial through its values at the places. Both leave out the round-off
      of the formula, for which ``rounding`` is a bound.
    """
    found = np.empty((3, len(t), z.shape[2]))
    rows = [np.moveaxis(array, 2, 1) for array in (z, rates)]
    given = [np.ascontiguousarray(a, dtype=float) for a in (*rows, t, ends, parameters)]
    stride = given[-1].shape[1] if given[-1].ndim == 2 else 0
    done = library().hamsym_residual_bounds(
        *(ctypes.byref(programs.program(name)) for name in ("velocity", "force")),
        *(ctypes.byref(model_tables()), len(t), *(array.ctypes.data for array in given)),
        *(stride, *(array.ctypes.data for array in found)),
    )
    require_memory(done)
    return found[0], found[1], found[2]


def bounded(programs: Equations, tables: BoundTables, pieces: Pieces) -> np.ndarray:
    """Return whether a bound of the residual of each window is within its limit."""
    found = np.zeros(pieces.windows, dtype=np.int8)
    done = library().hamsym_bounded(
        *map(ctypes.byref, (programs, tables, pieces)), found.ctypes.data
    )
    require_memory(done)
    return found.astype(bool)
