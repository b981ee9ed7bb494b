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

from hamsym.kernel.loops import Equations, Pieces, Record, arrays, library, require_memory
from hamsym.numerics.collocation import turns

DEGREE = 31  # of the polynomials: the columns of the march have 1e-14 beyond it
PLACES = 2 * DEGREE + 2  # enough for products
#: Places in [-1, 1], ascending.
NODES = -turns(PLACES)[1 : 2 * PLACES : 2].astype(float)


class ModelTables(Record):
    """Tables over the places."""

    _fields_ = arrays("coefficients low high values_of_high slopes_of_low integrals")


@functools.cache
def model_tables() -> ModelTables:
    """Make the tables of the arithmetic."""
    angles = np.outer(2 * np.arange(PLACES) + 1, np.arange(PLACES)) % (4 * PLACES)
    # Coefficients -> values; the table of the recurrence would be off by tens of roundings.
    values = turns(PLACES)[angles] * (-1.0) ** np.arange(PLACES)
    weights = np.full(PLACES, 2.0 / PLACES)
    weights[0] = 1.0 / PLACES
    coefficients = values * weights
    low = DEGREE + 1
    integrals = chebyshev.chebint(np.eye(PLACES, dtype=values.dtype), lbnd=NODES[PLACES // 2]).T
    return ModelTables(
        coefficients=coefficients,
        low=coefficients[:, :low],
        high=coefficients[:, low:],
        values_of_high=values[:, low:].T,
        slopes_of_low=chebyshev.chebder(np.eye(low)).T @ values[:, : low - 1].T,
        # From values to coefficients of the integral from the place in the middle.
        integrals=np.pad(coefficients @ integrals, ((0, 0), (0, PLACES + 8 - integrals.shape[1]))),
    )


def residual_bounds(
    programs: Equations,
    z: np.ndarray,
    rates: np.ndarray,
    t: np.ndarray,
    ends: np.ndarray,
    parameters: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Bound the residual of each component on parts of windows.

    - z, rates: Trial solution and its derivative, shape (parts, PLACES, dim).
    - t: Shape (parts, PLACES).
    - ends: The least and the largest time of each part, shape (parts, 2).
    - parameters: Shape (k,) or (parts, k).
    - returns bounds, rounding: Shape (parts, dim). Bounds leave out the round-off of the formula,
      for which ``rounding`` is a bound.
    """
    bounds, rounding = np.empty((2, len(t), z.shape[2]))
    rows = [np.moveaxis(array, 2, 1) for array in (z, rates)]
    given = [np.ascontiguousarray(a, dtype=float) for a in (*rows, t, ends, parameters)]
    done = library().hamsym_residual_bounds(
        *(ctypes.byref(programs.program(name)) for name in ("velocity", "force")),
        *(ctypes.byref(model_tables()), len(t), *(array.ctypes.data for array in given)),
        *(_stride(given[-1]), bounds.ctypes.data, rounding.ctypes.data),
    )
    require_memory(done)
    return bounds, rounding


def resolved(programs: Equations, pieces: Pieces) -> np.ndarray:
    """Return whether the bound of the residual of each window is within its limit."""
    found = np.zeros(pieces.windows, dtype=np.int8)
    done = library().hamsym_resolved(
        *(ctypes.byref(programs.program(name)) for name in ("velocity", "force")),
        *(ctypes.byref(model_tables()), ctypes.byref(pieces), found.ctypes.data),
    )
    require_memory(done)
    return found.astype(bool)


def _stride(parameters: np.ndarray) -> int:
    return int(parameters.shape[1]) if parameters.ndim == 2 else 0
