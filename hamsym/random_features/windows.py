"""The windows of a march and their cost."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Any, NamedTuple

import numpy as np

from hamsym.numerics.windows import times_in_windows
from hamsym.random_features.basis import size_of
from hamsym.support.record_fields import Count, Size, floats


class Windows(NamedTuple):
    """Consecutive windows: edges (n + 1,), states (n + 1, dim) and readouts (n, m, dim)."""

    edges: np.ndarray
    states: np.ndarray
    readouts: np.ndarray


@dataclass(frozen=True)
class March:
    """Windows of a solution and their cost."""

    #: Ends of the windows.
    edges: Annotated[np.ndarray, floats("windows + 1")] = field(repr=False)
    #: z at the edges.
    states: Annotated[np.ndarray, floats("windows + 1", "dim")] = field(repr=False)
    #: Coefficients of the orthonormal columns.
    readouts: Annotated[np.ndarray, floats("windows", "columns", "dim")] = field(repr=False)
    #: Time at which the last window ends.
    reached: float
    #: Largest magnitude of each component.
    scale: Annotated[np.ndarray, floats("dim", least=0)] = field(repr=False)
    #: Calls of the vector field, each at all points of a window.
    evaluations: Count = 0
    seconds: Size = 0.0
    cpu_seconds: Size = 0.0
    #: Of the basis.
    seed: Count = 0
    #: Windows for which Newton's method was needed.
    newton_windows: Count = 0
    #: Reason for ending before the end of the span, "" at its end.
    reason: str = ""
    #: Time from which the edges are counted: the start of the span, where H does not depend on time
    #: and differences to it are exact in float64, otherwise 0.
    origin: float = 0.0
    #: First failure of a check that shorter windows did not mend, "" without one.
    doubt: str = ""

    @property
    def points_per_window(self) -> int:
        """Collocation points of a window."""
        return size_of(self.readouts.shape[1]).nodes

    @property
    def history(self) -> March:
        """The windows themselves."""
        return self

    @property
    def point_evaluations(self) -> int:
        """Evaluations of the vector field, each at one point."""
        return self.evaluations * self.points_per_window

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError unless these are the windows of the trial solution."""
        for name in ("edges", "states", "readouts"):
            if not np.array_equal(getattr(self, name), getattr(trial, name, ())):
                raise ValueError(f"the {name} of its march differ from those of its trial solution")
        if self.origin != trial.origin or self.reached != self.origin + self.edges[-1]:
            raise ValueError("its march does not end at the end of its windows")

    @property
    def ends(self) -> tuple[float, float]:
        """Start and end of the windows."""
        return self.origin + float(self.edges[0]), self.origin + float(self.edges[-1])

    @property
    def points(self) -> int:
        """Collocation points of all windows."""
        return self.points_per_window * len(self.readouts)

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """Return about ``count`` times: at least nine per window, its start first, and the end."""
        return self.times_in_windows(max(9, count // len(self.edges)))

    def times_in_windows(self, per_window: int) -> np.ndarray:
        """Return equally spaced times in each window, with its start, and the end."""
        return self.origin + times_in_windows(self.edges, per_window)
