"""The windows of a march: what it found, and what it cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hamsym.random_features.basis import NODES
from hamsym.support.checked_data import require_array, require_counts

__all__ = ["March"]


@dataclass(frozen=True)
class March:
    """Windows of a solution, and what they cost.

    Attributes
    ----------
    edges : numpy.ndarray
        Ends of the windows, shape (n + 1,).
    states : numpy.ndarray
        z at the edges, shape (n + 1, dim).
    readouts : numpy.ndarray
        Coefficients of the orthonormal columns, shape (n, m, dim).
    reached : float
        The time up to which there are windows.
    reason : str
        Why it ended before the end of the span; "" if it did not.
    evaluations : int
        Calls of the vector field, each at all points of a window.
    newton_windows : int
        Windows for which Newton's method was needed.
    compiled : bool
        Whether compiled code marched.
    scale : numpy.ndarray
        Largest magnitude of each component, shape (dim,).
    seconds, cpu_seconds : float
    seed : int
        Of the basis.
    origin : float
        Time from which the edges are counted: the start of the span, where H does not depend on
        time and differences to it are exact in float64, otherwise 0.
    doubt : str
        What a check of the windows found and shorter windows did not mend; "" if nothing.
    """

    edges: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)
    readouts: np.ndarray = field(repr=False)
    reached: float
    reason: str
    evaluations: int
    newton_windows: int
    compiled: bool
    scale: np.ndarray = field(repr=False)
    seconds: float
    cpu_seconds: float
    seed: int
    origin: float = 0.0
    doubt: str = ""

    points_per_window = NODES

    @property
    def history(self) -> March:
        """The windows themselves."""
        return self

    @property
    def point_evaluations(self) -> int:
        """Evaluations of the vector field, each at one point."""
        return self.evaluations * self.points_per_window

    def check(self, trial: Any, method: str) -> None:
        """Raise ValueError if these are not the windows of a trial solution."""
        if method != "features":
            raise ValueError(f"method '{method}' does not march")
        for name in ("edges", "states", "readouts"):
            if not np.array_equal(getattr(self, name), getattr(trial, name)):
                raise ValueError(f"its march has other {name}")
        require_array("scale", self.scale, self.states[0].shape)
        if (self.scale < 0).any():
            raise ValueError("its scale is below zero")
        if self.origin != trial.origin or self.reached != self.origin + self.edges[-1]:
            raise ValueError("its march reached another time")
        require_counts(self)

    @property
    def points(self) -> int:
        """Collocation points of all windows."""
        return self.points_per_window * len(self.readouts)

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """About so many times, at least nine in each window, its start among them, and the end."""
        return self.times_in_windows(max(9, count // len(self.edges)))

    def times_in_windows(self, per_window: int) -> np.ndarray:
        """So many equally spaced times in each window, its start among them, and the end."""
        inside = np.linspace(0, 1, per_window, endpoint=False)
        within = self.edges[:-1, None] + np.diff(self.edges)[:, None] * inside
        return self.origin + np.append(within.ravel(), self.edges[-1])
