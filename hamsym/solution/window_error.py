"""Estimated errors as functions of time: Chebyshev series on windows, and the round-off floor."""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.numerics.scales import ratios
from hamsym.numerics.windows import locate, located_basis
from hamsym.support.record_fields import floats


@dataclass(frozen=True)
class WindowError:
    """Estimated error on windows: z - z^ and the round-off floor, as functions of time."""

    #: Ends of the windows.
    edges: Annotated[np.ndarray, floats("parts + 1")] = field(repr=False)
    #: Chebyshev series of z - z^ on each window.
    series: Annotated[np.ndarray, floats("parts", "terms", "dim", finite=False)] = field(repr=False)
    #: Size of the accumulated round-off in each window.
    floors: Annotated[np.ndarray, floats("parts", "dim", finite=False)] = field(repr=False)
    #: Largest magnitude of both together.
    largest: Annotated[np.ndarray, floats("dim", finite=False)]
    #: Sizes of the components to which tolerances are relative: the largest |z^_i|, or 1e-8 of its
    #: coupled size (:mod:`hamsym.numerics.scales`).
    scale: Annotated[np.ndarray, floats("dim", least=0)]
    #: Time from which the edges are counted.
    origin: Annotated[np.ndarray, floats()] = field(repr=False)

    def check(self) -> None:
        """Raise ValueError unless it has a series, and sizes that are not negative."""
        if not self.series.size:
            raise ValueError("its error has no series")
        if (self.floors < 0).any() or (self.largest < 0).any():
            raise ValueError("its error has a negative size")

    def require_finite(self) -> None:
        """Raise ValueError unless all its numbers are finite."""
        for name in ("series", "floors", "largest"):
            if not np.isfinite(getattr(self, name)).all():
                raise ValueError(f"'{name}' of its error is not finite")

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Estimated z - z^ at times t, shape (*t.shape, dim)."""
        window, basis = located_basis(self.edges, t - self.origin, self.series.shape[1])
        with np.errstate(invalid="ignore"):
            values = np.einsum("...l,...ld->...d", basis, self.series[window])
        return np.nan_to_num(values, nan=np.inf, posinf=np.inf, neginf=np.inf)

    def floor(self, t: np.ndarray) -> np.ndarray:
        """Estimated size of the accumulated round-off at times t, shape (*t.shape, dim)."""
        return self.floors[locate(self.edges, t - self.origin)[0]]

    def until(self, allowed: np.ndarray) -> float:
        """Return the end of the last window before estimate and floor exceed the allowed error."""
        with np.errstate(invalid="ignore"):
            peaks = np.abs(_dense(self.series.shape[1]) @ self.series).max(axis=1)
        good = (peaks + self.floors <= allowed).all(axis=1)
        end = self.edges[-1] if good.all() else self.edges[int(np.argmin(good))]
        return float(self.origin + end)

    def excess(self, allowed: np.ndarray) -> float:
        """Return the largest ratio of estimate and floor to the allowed error, or infinity."""
        return float(ratios(self.largest, allowed).max())


def relative_tolerance(tol: float) -> float:
    """Return the tolerance relative to computed sizes, which differ from the true ones by errors.

    An error of this share of the computed size is at most ``tol`` times the true one.
    """
    return tol / (1 + tol)


def allowed_errors(tol: float, atol: Any, sizes: np.ndarray) -> np.ndarray:
    """Return the error that a tolerance allows each component of these computed sizes."""
    return np.asarray(np.asarray(atol, dtype=float) + relative_tolerance(tol) * sizes)


@functools.cache
def _dense(count: int) -> np.ndarray:
    """Return the matrix from Chebyshev series of ``count`` terms to values that show peaks."""
    return chebyshev.chebvander(np.linspace(-1, 1, 4 * count), count - 1)
