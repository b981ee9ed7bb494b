"""Floquet multipliers of periodic orbits and their kinds."""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg

__all__ = ["reduced_map", "stability_of"]

_PARABOLIC = 1e-5  # distance of a multiplier from 1 or -1 that round-off may cause
_ON_CIRCLE = 1e-6  # distance of |multiplier| from 1 that round-off may cause


def reduced_map(
    matrix: np.ndarray, rate: np.ndarray, slope: np.ndarray | None, scale: np.ndarray
) -> np.ndarray:
    """Return the map of states across the flow, and within the level of H where that is conserved.

    The matrix maps the vector field to itself and the level of H to itself; the reduced map acts on
    the level modulo the field, so that no multiplier is lost or doubled.

    Parameters
    ----------
    matrix : numpy.ndarray
        Shape (dim, dim).
    rate : numpy.ndarray
        The vector field, shape (dim,).
    slope : numpy.ndarray or None
        The gradient of a conserved H.
    scale : numpy.ndarray
        Units of the components.
    """
    scaled = matrix * scale / scale[:, None]
    trivial = [rate / scale] if slope is None else [rate / scale, slope * scale]
    if not (np.isfinite(scaled).all() and all(0 < _length(part) < math.inf for part in trivial)):
        left = len(matrix) - len(trivial)
        return np.full((left, left), math.nan)
    across = scipy.linalg.null_space(np.array([part / _length(part) for part in trivial]))
    return np.asarray(across.T @ scaled @ across)


def _length(vector: np.ndarray) -> float:
    return float(np.linalg.norm(vector))


def stability_of(multipliers: np.ndarray, *, conservative: bool = True) -> str:
    """Return the kind of linear stability that multipliers other than the trivial ones imply.

    Examples
    --------
    >>> stability_of(np.exp([0.3j, -0.3j])), stability_of(np.array([-2.0, -0.5]))
    ('elliptic', 'inverse hyperbolic')
    """
    sizes = np.abs(multipliers)
    if not np.isfinite(sizes).all():
        return "unknown"
    if not conservative:
        if (sizes < 1 - _ON_CIRCLE).all():
            return "attracting"
        return "repelling" if (sizes > 1 + _ON_CIRCLE).all() else "mixed"
    kinds = set()
    for value, size in zip(multipliers, sizes, strict=True):
        if min(abs(value - 1), abs(value + 1)) < _PARABOLIC:
            kinds.add("parabolic")
        elif abs(size - 1) < _ON_CIRCLE:
            kinds.add("elliptic")
        elif abs(value.imag) > _PARABOLIC * size:
            kinds.add("complex")
        else:
            kinds.add("hyperbolic" if value.real > 0 else "inverse hyperbolic")
    if not kinds:
        return "elliptic"
    return kinds.pop() if len(kinds) == 1 else "mixed"
