"""Discs around a window, in which the formulas of H are bounded (``kernel/discs.h``)."""

from __future__ import annotations

import functools
import math

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.bounds.models import PLACES
from hamsym.kernel.loops import Record, arrays, counts, numbers

DISCS = 8  # around a window
_SHARE = 1e-3  # of the tolerance, times the bound of the formulas: what polynomials may leave out


class DiscTables(Record):
    """Tables of the discs that cover an ellipse around a window."""

    _fields_ = [*counts("terms"), *numbers("radius share"), *arrays("place middle extent")]


@functools.lru_cache(maxsize=64)
def disc_tables(terms: int, decade: int) -> DiscTables:
    """Make the tables for Chebyshev series of so many terms and a tolerance of a power of ten."""
    share = _SHARE * 10.0**decade
    # The smallest sum of half axes, in hundredths.
    rho = next(rho for rho in np.arange(1.05, 9.0, 0.01).tolist() if _left_out(rho) <= share)
    middles, radius = _cover(rho)
    series: np.ndarray = np.eye(terms)
    at = chebyshev.chebvander(middles, terms - 1).T  # T_k at the centres
    # |T_k(c + w) - T_k(c)| is at most the sum of the terms of its Taylor series.
    extent, weight = np.zeros_like(at), 1.0
    for order in range(1, terms):
        series = chebyshev.chebder(series)
        weight *= radius / order
        extent += weight * np.abs(chebyshev.chebval(middles, series))
    return DiscTables(
        terms=terms,
        radius=radius / 2,
        share=_left_out(rho),
        place=(middles + 1) / 2,
        middle=at,
        extent=extent,
    )


def decade_of(tolerance: float) -> int:
    """Return the largest power of ten that is not above a tolerance."""
    return math.floor(math.log10(tolerance))


def _left_out(rho: float) -> float:
    """What a polynomial through PLACES points leaves out of a function bounded by 1."""
    return float(4 * rho ** (1 - PLACES) / (rho - 1))


def _cover(rho: float) -> tuple[np.ndarray, float]:
    """Return centres and radius, in thousandths, of discs that cover an ellipse around [-1, 1]."""
    angles = np.linspace(0, math.pi, 2_001)
    long, short = (rho + 1 / rho) / 2, (rho - 1 / rho) / 2
    edge = long * np.cos(angles) + 1j * short * np.sin(angles)
    middles = np.linspace(-1, 1, DISCS) * round(long - short**2 / long, 3)
    distance = np.abs(edge[:, None] - middles).min(axis=1).max()
    return middles, (math.ceil(1e3 * distance) + 1) / 1e3
