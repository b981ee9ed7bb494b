"""Protocols of the parts of a solution: its trial solution, its record, its error estimate.

A method of solution provides classes that satisfy them; :class:`~hamsym.solution.solution.Solution`
and everything that evaluates one is written against the protocols alone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from hamsym.support.record_fields import OneOf

if TYPE_CHECKING:  # torch is imported only by functions of tensors
    from torch import Tensor


class Trial(Protocol):
    """A trial solution z^(t), exact at the start of the span."""

    @property
    def dtype(self) -> np.dtype:
        """Data type of its numbers, float64 or float32."""

    def states_at(self, t: np.ndarray) -> np.ndarray:
        """z^ at times t of shape (K,); shape (K, dim)."""

    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""

    def tensors(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """z^ and dz^/dt at times t of shape (K,), differentiable in t; each of shape (K, dim)."""

    def require_path(self, z0: np.ndarray, span: tuple[float, float]) -> None:
        """Raise ValueError unless it is a trial solution from z0 over the span."""


class Record(Protocol):
    """Account of how a solution was found."""

    @property
    def seconds(self) -> float:
        """Wall time of the search."""

    @property
    def cpu_seconds(self) -> float:
        """Processor time of the search."""

    @property
    def points(self) -> int:
        """Collocation points K."""

    @property
    def point_evaluations(self) -> int:
        """Evaluations of the vector field, each at one point."""

    @property
    def history(self) -> Any:
        """The course of the search: losses of a training, or the windows of a march."""

    @property
    def edges(self) -> np.ndarray | None:
        """Ends of the windows of z^, counted from the origin, shape (n + 1,); None for one."""

    @property
    def origin(self) -> float:
        """Time from which the edges are counted."""

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """Return about ``count`` times over the span, in its direction, nine or more per window."""

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError unless it is the record of this trial solution."""


class ErrorEstimate(Protocol):
    """Estimated error z - z^ as a function of time."""

    @property
    def largest(self) -> np.ndarray:
        """Largest magnitude of each component over the span, shape (dim,)."""

    @property
    def scale(self) -> np.ndarray:
        """Size of each component, to which tolerances are relative, shape (dim,)."""

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """z - z^ at times t, shape (*t.shape, dim)."""

    def until(self, allowed: np.ndarray) -> float:
        """Time until which the error is within the allowed one, shape (dim,)."""

    def refined(self, path: Any) -> Any:
        """The estimate at a finer resolution, a function of t."""

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError unless it is the error of this trial solution."""

    def require_finite(self) -> None:
        """Raise ValueError unless all its numbers are finite."""


#: What a file may contain for the parts of a solution.
TRIALS = OneOf(
    features="hamsym.random_features.trial:FeatureTrial",
    chain="hamsym.networks.chain:Chain",
    network="hamsym.networks.trial:TrialSolution",
)
RECORDS = OneOf(
    march="hamsym.random_features.windows:March",
    chain="hamsym.networks.chain:ChainTraining",
    training="hamsym.networks.record:Training",
)
ERRORS = OneOf(
    march="hamsym.random_features.error_estimate:MarchError",
    chain="hamsym.networks.chain_error:ChainError",
)
