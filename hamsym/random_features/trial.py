"""The trial solution of a march: z^ and dz^/dt as functions of t, one network per window."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated

import numpy as np

from hamsym.kernel.loops import Paths
from hamsym.random_features.basis import DEGREE, rate_series
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
    def of_march(cls, windows: March, series: np.ndarray) -> FeatureTrial:
        """Make the trial solution of the windows of a march, from the series of its columns."""
        origin = np.array(windows.origin)
        return cls(windows.edges, windows.states, windows.readouts, series, origin)

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
        z, dz = self._path.states_and_rates(t - self.origin)
        return z[0], dz[0]

    def states_at(self, t: np.ndarray) -> np.ndarray:
        """Evaluate z^ alone: the same numbers in half the time."""
        return self._path.states(t - self.origin)[0]

    def tensors(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Evaluate z^ and dz^/dt at times t of shape (K,), differentiable in t."""
        from hamsym.random_features.trial_tensors import evaluate

        own = {name: getattr(self, name) for name in fields_of(FeatureTrial)}
        return evaluate(t, **own, rate_series=rate_series(self.series))

    @cached_property
    def _path(self) -> Paths:
        return paths_of(
            np.zeros(1, np.int64),
            np.zeros(1, np.int64),
            np.array([len(self.readouts)]),
            (self.edges, self.states, self.readouts),
            self.series,
        )


def paths_of(
    first_edge: np.ndarray,
    first_window: np.ndarray,
    counts: np.ndarray,
    windows: tuple[np.ndarray, np.ndarray, np.ndarray],
    series: np.ndarray,
) -> Paths:
    """Return paths for their evaluation.

    - first_edge, first_window, counts: First edge and first window of each path, and how many
      windows it has.
    - windows: Edges, states and readouts.
    - series: Of the columns of the basis, shape (degree + 1, m).
    """
    edges, states, readouts = (np.ascontiguousarray(array, dtype=float) for array in windows)
    return Paths(
        paths=len(counts),
        columns=series.shape[1],
        terms=len(series),
        dim=states.shape[1],
        first_edge=np.ascontiguousarray(first_edge),
        first_window=np.ascontiguousarray(first_window),
        windows=np.ascontiguousarray(counts),
        edge=edges,
        state=states,
        readout=readouts,
        series=series.T,
    )
