"""The trial solution of a march: z^ and dz^/dt as functions of t, one network per window."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hamsym.numerics.collocation import chebyshev_values
from hamsym.numerics.windows import locate
from hamsym.random_features.basis import DEGREE, FeatureBasis, rate_series
from hamsym.random_features.windows import March
from hamsym.support.record_fields import fields_of, floats

if TYPE_CHECKING:  # only functions of tensors need torch
    from torch import Tensor


@dataclass(frozen=True, eq=False)
class FeatureTrial:
    """z^(t) = z_a + f(s) N(s) on each window [t_a, t_b], s = (t - t_a)/(t_b - t_a).

    N is the product of a Chebyshev series, the same for all windows, with the window's readout; the
    derivative is that of the series.
    """

    #: Ends of the windows, counted from the origin.
    edges: Annotated[np.ndarray, floats("windows + 1")] = field(repr=False)
    #: z at the edges.
    states: Annotated[np.ndarray, floats("windows + 1", "dim")] = field(repr=False)
    #: Coefficients of the columns.
    readouts: Annotated[np.ndarray, floats("windows", "columns", "dim")] = field(repr=False)
    #: Chebyshev series of the columns in 2 s - 1.
    series: Annotated[np.ndarray, floats(DEGREE + 1, "columns")] = field(repr=False)
    #: Time from which the edges are counted.
    origin: Annotated[np.ndarray, floats()]

    @classmethod
    def of_march(cls, windows: March, basis: FeatureBasis) -> FeatureTrial:
        """Make the trial solution of the windows of a march."""
        origin = np.array(windows.origin)
        return cls(windows.edges, windows.states, windows.readouts, basis.series, origin)

    @property
    def dtype(self) -> np.dtype:
        """Data type of its numbers."""
        return self.states.dtype

    def check(self) -> None:
        """Raise ValueError unless its windows are in order."""
        if not self.readouts.size:
            raise ValueError("it has no windows")
        with np.errstate(over="ignore"):
            steps = np.diff(self.edges)
        if not (np.isfinite(steps).all() and ((steps > 0).all() or (steps < 0).all())):
            raise ValueError("its windows are not in order")

    def require_path(self, z0: np.ndarray, span: tuple[float, float]) -> None:
        """Raise ValueError unless it is a trial solution from z0 over the span."""
        start, end = span
        ends = (self.origin + self.edges[0], self.origin + self.edges[-1])
        if self.origin not in (0, start) or (start, end) != ends:
            raise ValueError("its span differs from that of its windows")
        if self.states[0].tobytes() != z0.tobytes():
            raise ValueError("it does not start at its z0")

    # -- evaluation --------------------------------------------------------------------------

    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        window, length, s, polynomials = self._place(t)
        f = -np.expm1(-s)[:, None]
        network, slopes = polynomials @ self.series, polynomials @ self._rate_series
        readout = self.readouts[window]
        z = self.states[window] + _products(f * network, readout)
        dz = _products((1 - f) * network + f * slopes, readout)
        return z, dz / length[:, None]

    def states_at(self, t: np.ndarray) -> np.ndarray:
        """Evaluate z^ alone: the same numbers in half the time."""
        window, _, s, polynomials = self._place(t)
        columns = -np.expm1(-s)[:, None] * (polynomials @ self.series)
        return np.asarray(self.states[window] + _products(columns, self.readouts[window]))

    def tensors(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate z^ and dz^/dt at times t of shape (K,), differentiable in t."""
        from hamsym.random_features.trial_tensors import evaluate

        own = {name: getattr(self, name) for name in fields_of(FeatureTrial)}
        return evaluate(t, **own, rate_series=self._rate_series)

    @cached_property
    def _rate_series(self) -> np.ndarray:
        return rate_series(self.series)

    def _place(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Return index and length of the window of each time, s and Chebyshev polynomials of s."""
        window, s = locate(self.edges, t - self.origin)
        length = self.edges[window + 1] - self.edges[window]
        return window, length, s, chebyshev_values(2 * s - 1, DEGREE + 1)


def _products(rows: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Multiply each row by its matrix, shapes (K, m) and (K, m, dim) -> (K, dim)."""
    return np.asarray(np.matmul(rows[:, None], matrices)[:, 0])
