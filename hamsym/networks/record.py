"""Records of a training: its course, how it ended, and the state that callbacks receive."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, ClassVar

import numpy as np

from hamsym.support.record_fields import AnyFloat, Count, Size, counts, floats


class Stopped(StrEnum):
    """Reasons for which a training ended."""

    ITERATIONS = "iterations"
    TARGET_LOSS = "target loss"
    TARGET_ELL_MAX = "target ell_max"
    TOLERANCE = "tolerance"
    ACCURACY = "accuracy"
    PATIENCE = "patience"
    TIME_LIMIT = "time limit"
    STALLED = "stalled"
    DIVERGED = "diverged"
    INTERRUPTED = "interrupted"


@dataclass(frozen=True)
class TrainingState:
    """State of a training, passed to callbacks after each evaluation at the fixed points.

    Attributes
    ----------
    iteration, iterations : int
        Number of the iteration, and of all that are allowed.
    loss, best_loss : float
        The loss at the fixed points, and the lowest so far.
    ell_max : float
        Largest residual at the fixed points.
    seconds : float
        Time since the start.
    """

    iteration: int
    iterations: int
    loss: float
    best_loss: float
    ell_max: float
    seconds: float


@dataclass(frozen=True)
class History:
    """The course of a training.

    Attributes
    ----------
    loss : numpy.ndarray
        Loss at the optimizer's own points, one value per iteration.
    iteration, fixed_loss, ell_max, seconds : numpy.ndarray
        Evaluations at the fixed points: the iteration, the loss, the largest 2-norm of the
        residual, and the time since the start.
    """

    # The losses of a training that restarted may not be finite.
    loss: Annotated[np.ndarray, floats("iterations", finite=False)] = field(repr=False)
    iteration: Annotated[np.ndarray, counts("checks")] = field(repr=False)
    fixed_loss: Annotated[np.ndarray, floats("checks", finite=False)] = field(repr=False)
    ell_max: Annotated[np.ndarray, floats("checks", finite=False)] = field(repr=False)
    seconds: Annotated[np.ndarray, floats("checks")] = field(repr=False)


@dataclass(frozen=True)
class Training:
    """Record of a training; the best weights are in the trial solution.

    Attributes
    ----------
    history : History
    points : int
        Collocation points K.
    iterations : int
        Epochs of Adam, steps of the other optimizers.
    restarts : int
        Number of restarts with new weights.
    best_loss, best_ell_max : float
        Loss and largest residual of the best weights at the fixed points.
    stopped : str
        Reason for which the training ended: a value of :class:`Stopped`.
    seconds, cpu_seconds : float
        Wall and processor time.
    """

    history: History
    points: Count
    iterations: Count
    restarts: Count
    best_loss: AnyFloat
    best_ell_max: AnyFloat
    stopped: str
    seconds: Size
    cpu_seconds: Size

    # A network is one smooth function over the whole span.
    edges: ClassVar[None] = None
    origin: ClassVar[float] = 0.0

    @property
    def point_evaluations(self) -> int:
        """Evaluations of the vector field, each at one point."""
        return self.iterations * self.points

    def times(self, span: tuple[float, float], count: int) -> np.ndarray:
        """Return ``count`` equally spaced times over a span."""
        return np.linspace(*span, count)

    def check(self) -> None:
        """Raise ValueError unless its history has a loss for each iteration."""
        if len(self.history.loss) != self.iterations:
            raise ValueError("its history does not have its number of iterations")

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError if this is not the record of one network."""
        if hasattr(trial, "edges"):
            raise ValueError("its training is not that of its windows")
