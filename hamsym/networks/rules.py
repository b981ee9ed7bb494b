"""Rules of a training: when it stops, and how its span grows in stages."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hamsym.networks.methods import JointTraining
from hamsym.networks.record import Stopped


@dataclass(frozen=True)
class Stages:
    """Sequential training: a short span first, then longer ones, with the weights carried over."""

    #: Stage k trains on the fraction k / count of the span.
    count: int = 1
    #: A stage ends when the root mean square of the residual is below this fraction of that of
    #: dz/dt, or when its share of the iterations is used up.
    residual: float = 0.03
    #: Instead of the share: iterations after which the training restarts from the first stage with
    #: new weights, if the stage has not ended (the last stage: if the residual is above 1e-4).
    restart_after: int | None = None
    #: Largest number of such restarts.
    restarts: int = 10


@dataclass
class Course:
    """Where a training is: counters, levels, and the current stage with the rules for its end."""

    stages: Stages
    #: Start and end of the last stage.
    whole: tuple[float, float]
    #: Largest number of iterations.
    iterations: int
    #: iteration, stage, in_stage, restarts, improved: Iterations done, the current stage from 1,
    #: iterations in it, restarts, and the iteration of the best loss.
    iteration: int = 0
    stage: int = 1
    in_stage: int = 0
    restarts: int = 0
    improved: int = 0
    #: best_loss, best_ell_max: Of the best weights, at the fixed points.
    best_loss: float = math.inf
    best_ell_max: float = math.inf
    #: Lowest loss in this stage at the optimizer's points.
    lowest: float = math.inf
    #: Best loss when the criteria were last evaluated.
    judged: float = math.inf
    seconds: float = 0.0
    cpu_seconds: float = 0.0

    @property
    def share(self) -> float:
        """Fraction of the span that the current stage trains on."""
        return self.stage / self.stages.count

    @property
    def span(self) -> tuple[float, float]:
        """Start and end of the current stage."""
        start, end = self.whole
        return start, end if self.is_last else start + self.share * (end - start)

    @property
    def is_last(self) -> bool:
        """Whether the current stage trains on the whole span."""
        return self.stage == self.stages.count

    @property
    def is_exhausted(self) -> bool:
        """Whether the iterations after which the training restarts are used up."""
        limit = self.stages.restart_after
        return limit is not None and self.in_stage >= limit

    def is_passed(self, loss: float, motion: float) -> bool:
        """Whether the next stage begins, by the loss and the mean square of dz/dt."""
        stages = self.stages
        if loss <= stages.residual**2 * motion:
            return True
        # The remaining stages share the remaining iterations.
        before = self.iteration - self.in_stage
        share = (self.iterations - before) / (stages.count - self.stage + 1)
        return stages.restart_after is None and self.in_stage >= share

    def advance(self) -> None:
        """Begin the next stage."""
        self._begin(self.stage + 1)

    def can_restart(self) -> bool:
        """Whether a restart with new weights is allowed."""
        stages = self.stages
        return stages.restart_after is not None and self.restarts < stages.restarts

    def restart(self) -> None:
        """Begin the first stage again."""
        self.restarts += 1
        self._begin(1)

    def _begin(self, stage: int) -> None:
        self.stage, self.in_stage = stage, 0
        self.lowest = math.inf


def target_reached(method: JointTraining, course: Course) -> Stopped | None:
    """Return the target that the best weights reach, if any."""
    if method.target_loss is not None and course.best_loss <= method.target_loss:
        return Stopped.TARGET_LOSS
    if method.target_ell_max is not None and course.best_ell_max <= method.target_ell_max:
        return Stopped.TARGET_ELL_MAX
    return None


def limit_reached(method: JointTraining, course: Course) -> Stopped | None:
    """Return the limit of time or patience that is reached, if any."""
    if method.time_limit is not None and course.seconds >= method.time_limit:
        return Stopped.TIME_LIMIT
    waited = min(course.iteration - course.improved, course.in_stage)
    if method.patience is not None and course.is_last and waited >= method.patience:
        return Stopped.PATIENCE
    return None
