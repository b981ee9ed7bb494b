"""Training of trial solutions of any first-order equation; it does not depend on Hamiltonians.

Input:  a trial solution t -> (z, dz/dt), an :class:`Objective` made of a residual function, a
        loss and regularizers, a time span, an optimizer (:mod:`hamsym.networks.optimizers`,
        :mod:`hamsym.networks.self_scaled_broyden`, :mod:`hamsym.networks.levenberg_marquardt`)
        and rules for stopping.
Output: the weights with the lowest loss at fixed points (left in the trial solution), and a
        :class:`~hamsym.networks.record.Training`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import FileError
from hamsym.networks.best_weights import BestWeights
from hamsym.networks.checkpoint import Checkpoint
from hamsym.networks.module_trial import ModuleTrial
from hamsym.networks.network import Network
from hamsym.networks.objective import Objective
from hamsym.networks.record import History, Stopped, Training, TrainingState
from hamsym.networks.rules import Progress, Stages, StageSchedule, Stopping
from hamsym.support.records import packed, unpacked
from hamsym.support.tensor_files import one_line

# Products of points and weights below this are no faster on two threads, which cost twice the CPU
# time.
_ONE_THREAD = 4_000_000
# Mean square of the residual, relative to that of dz/dt, above which a stalled training restarts.
_POOR = 1e-8
# Endings after which a training goes on when it is resumed.
_RESUMABLE = (None, Stopped.ITERATIONS, Stopped.TIME_LIMIT)


class Optimizer(Protocol):
    """An optimizer that changes the weights, one iteration at a time."""

    points: int
    check_every: int  # iterations between evaluations at the fixed points

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        """Set the trial solution, the objective and the source of random numbers, once."""

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return the points at which weights are judged, and which are never trained on."""

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        """Perform one iteration.

        - span: Span of the current stage.
        - share: Its fraction of the whole span.
        - done: Fraction of all iterations that are done.
        - returns: The loss at the optimizer's points before the step, and the mean square of dz/dt
          there.
        """

    @property
    def stalled(self) -> bool:
        """Whether further iterations would not lower the loss."""

    def reset(self) -> None:
        """Reset the optimizer state after new weights were drawn."""

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the state that the next iterations depend on, as tensors and JSON values."""

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Restore a state returned by :meth:`state`."""


def train(
    trial: torch.nn.Module,
    objective: Objective,
    span: tuple[float, float],
    optimizer: Optimizer,
    stopping: Stopping,
    *,
    generator: torch.Generator,
    stages: Stages | None = None,
    callbacks: Sequence[Callable[[TrainingState], None]] = (),
    checkpoint: Checkpoint | None = None,
) -> Training:
    """Minimise an objective over a time span.

    The weights that are kept are the best at fixed points, which are never trained on.

    Raise FileError if the checkpoint cannot be read or written, or belongs to another training.

    - trial: t of shape (K,) -> (z, dz/dt), each (K, dim).
    - span: Start and end time; the end may be the smaller.
    - optimizer: An optimizer that was not used before.
    - generator: Source of all random numbers.
    - stages: By default the whole span from the beginning.
    - callbacks: Each is called with a :class:`TrainingState` after evaluations at the fixed points.
    """
    optimizer.bind(trial, objective, generator)
    run = _Run(trial, objective, span, optimizer, stopping, stages or Stages(), generator)
    if checkpoint is not None:
        saved = checkpoint.read()
        if saved is None:
            run.write(checkpoint)  # a path that cannot be written is refused before the training
        else:
            try:
                run.restore(*saved)
            except (
                *(ArithmeticError, AttributeError, LookupError, RuntimeError),
                *(TypeError, ValueError),
            ) as error:
                raise FileError(
                    f"'{checkpoint.path}' is not a valid checkpoint of this training: "
                    f"{one_line(error)}; give another file"
                ) from None
    return run.through(callbacks, checkpoint)


@dataclass(frozen=True)
class _State:
    """What a checkpoint contains of a training beside its tensors and settings."""

    progress: Progress
    #: Of the optimizer.
    optimizer: dict[str, Any]
    stopped: str | None
    rules: Any


class _Run:
    """A training in progress, whose complete state is saved in a checkpoint."""

    def __init__(
        self,
        trial: torch.nn.Module,
        objective: Objective,
        span: tuple[float, float],
        optimizer: Optimizer,
        stopping: Stopping,
        stages: Stages,
        generator: torch.Generator,
    ) -> None:
        self.trial, self.objective, self.generator = trial, objective, generator
        self.optimizer, self.stopping = optimizer, stopping
        self.fixed = optimizer.fixed_points(span)
        self.weights = BestWeights(trial)
        self.progress = Progress()
        self.schedule = StageSchedule(stages, span, stopping.iterations, self.progress)
        self.stopped: str | None = None
        self.losses: list[float] = []
        self.checks: list[tuple[int, float, float, float]] = []

    def through(
        self, callbacks: Sequence[Callable[[TrainingState], None]], checkpoint: Checkpoint | None
    ) -> Training:
        """Train until a rule ends it."""
        threads = torch.get_num_threads()
        size = len(self.fixed) * sum(weights.numel() for weights in self.weights.parameters)
        self.began = time.perf_counter() - self.progress.seconds
        self.cpu_began = time.process_time() - self.progress.cpu_seconds
        written = time.perf_counter()
        # A training that had ended takes no further step, unless its rules have changed.
        stopped = None if self.stopped in _RESUMABLE else self.stopped
        try:
            if size < _ONE_THREAD:
                torch.set_num_threads(1)
            while stopped is None:
                if self.progress.iteration >= self.stopping.iterations:
                    stopped = Stopped.ITERATIONS
                    break
                stopped = self._iterate(callbacks)
                if checkpoint is not None and time.perf_counter() - written >= checkpoint.every:
                    self._clock()
                    self.write(checkpoint)
                    written = time.perf_counter()
        except KeyboardInterrupt:
            # The iteration is incomplete: resumption begins from the last checkpoint written.
            stopped = Stopped.INTERRUPTED
        finally:
            torch.set_num_threads(threads)
        self._clock()
        if checkpoint is not None and stopped != Stopped.INTERRUPTED:
            self.stopped = stopped
            self.write(checkpoint)
        self.weights.put(self.weights.best)
        return self._record(stopped or Stopped.INTERRUPTED)

    def _record(self, stopped: str) -> Training:
        columns = np.array(self.checks, dtype=float).reshape(-1, 4).T
        progress = self.progress
        return Training(
            history=History(np.array(self.losses), columns[0].astype(int), *columns[1:]),
            points=self.optimizer.points,
            iterations=len(self.losses),
            restarts=progress.restarts,
            best_loss=progress.best_loss,
            best_ell_max=progress.best_ell_max,
            stopped=stopped,
            seconds=progress.seconds,
            cpu_seconds=progress.cpu_seconds,
        )

    def _iterate(self, callbacks: Sequence[Callable[[TrainingState], None]]) -> str | None:
        """Perform one iteration; return the reason for which the training ends, if any."""
        progress, schedule, total = self.progress, self.schedule, self.stopping.iterations
        last_stage = schedule.is_last
        loss, motion = self.optimizer.iterate(
            schedule.span, schedule.share, progress.iteration / total
        )
        self.losses.append(loss)
        progress.iteration += 1
        progress.in_stage += 1
        if not math.isfinite(loss):
            return self._restart(Stopped.DIVERGED)
        is_record = loss < 0.9 * progress.lowest
        progress.lowest = min(progress.lowest, loss)
        if not last_stage:
            if schedule.is_passed(loss, motion):
                schedule.advance()
            elif self.optimizer.stalled or schedule.is_exhausted:
                return self._restart(Stopped.STALLED)
        regular = progress.iteration % self.optimizer.check_every == 0
        checked = regular or progress.iteration == total or (last_stage and is_record)
        if checked:
            self._check(callbacks)
            if (stopped := self._rule_met()) is not None:
                return stopped
        if not last_stage:
            return None
        stalled = self.optimizer.stalled
        poor = progress.best_loss > _POOR * motion
        if poor and (stalled or (checked and schedule.is_exhausted)):
            return self._restart(Stopped.STALLED)
        return Stopped.STALLED if stalled else None

    def _check(self, callbacks: Sequence[Callable[[TrainingState], None]]) -> None:
        """Evaluate the current weights at the fixed points, and keep them if they are the best."""
        progress = self.progress
        with torch.no_grad():
            z, dz = self.trial(self.fixed)
            loss = float(self.objective(self.fixed, z, dz))
            residual = self.objective.residual(self.fixed, z, dz)
            ell_max = float(residual.square().sum(-1).max().sqrt())
        if loss < progress.best_loss:
            progress.best_loss, progress.best_ell_max = loss, ell_max
            progress.improved = progress.iteration
            self.weights.keep()
        self._clock()
        self.checks.append((progress.iteration, loss, ell_max, progress.seconds))
        state = TrainingState(
            iteration=progress.iteration,
            iterations=self.stopping.iterations,
            loss=loss,
            best_loss=progress.best_loss,
            ell_max=ell_max,
            seconds=progress.seconds,
        )
        for callback in callbacks:
            callback(state)

    def _rule_met(self) -> str | None:
        """Return the first rule that the best weights meet, if any."""
        rules, progress = self.stopping, self.progress
        if (target := rules.target_reached(progress)) is not None:
            return target
        if rules.criteria and progress.best_loss <= progress.judged / 4:
            progress.judged = progress.best_loss
            record = self._record(Stopped.INTERRUPTED)
            with self.weights.in_trial():
                met = [rule.name for rule in rules.criteria if rule.is_met(self.trial, record)]
            if met:
                return met[0]
        return rules.limit_reached(progress, self.schedule.is_last)

    def _restart(self, reason: Stopped) -> Stopped | None:
        """Restart with new weights, or end for this reason if no restart is left."""
        if not self.schedule.can_restart():
            return reason
        for module in self.trial.modules():
            if isinstance(module, (Network, ModuleTrial)):
                module.draw(self.generator)
        self.optimizer.reset()
        self.schedule.restart()
        return None

    def _clock(self) -> None:
        self.progress.seconds = time.perf_counter() - self.began
        self.progress.cpu_seconds = time.process_time() - self.cpu_began

    def write(self, checkpoint: Checkpoint) -> None:
        """Write the complete state to a file."""
        tensors = {
            "losses": torch.tensor(self.losses, dtype=torch.float64, device="cpu"),
            "checks": torch.tensor(self.checks, dtype=torch.float64, device="cpu").reshape(-1, 4),
            "generator": self.generator.get_state(),
            **self.weights.tensors(),
        }
        own, values = self.optimizer.state()
        tensors |= {f"optimizer.{name}": tensor.clone() for name, tensor in own.items()}
        state = _State(self.progress, values, self.stopped, self.stopping.summary())
        checkpoint.write(tensors, packed(state)[1])

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Restore the state that :meth:`write` wrote.

        Raise ValueError if it is not the state of this training.
        """
        state = unpacked(_State, {}, {k: v for k, v in values.items() if k != "settings"})
        progress, self.stopped = state.progress, state.stopped
        stages, losses = self.schedule.stages.count, tensors["losses"]
        if not 1 <= progress.stage <= stages or progress.iteration != len(losses):
            raise ValueError("its iterations, stages and losses are inconsistent")
        own = {name: t for name, t in tensors.items() if not name.startswith("optimizer.")}
        expected = {
            "losses": torch.empty(len(losses), dtype=torch.float64, device="cpu"),
            "checks": torch.empty(len(tensors["checks"]), 4, dtype=torch.float64, device="cpu"),
            "generator": self.generator.get_state(),
            **self.weights.tensors(),
        }
        _require_alike(own, expected)
        self.weights.restore(own)
        self.losses = losses.tolist()
        self.checks = [(int(row[0]), *row[1:]) for row in own["checks"].tolist()]
        self.generator.set_state(own["generator"])
        self.progress = self.schedule.progress = progress
        if state.rules != self.stopping.summary():
            # The best weights so far may meet rules that have changed.
            progress.judged = math.inf
            self.stopped = self._rule_met()
        start = "optimizer."
        found = {n.removeprefix(start): t for n, t in tensors.items() if n.startswith(start)}
        self.optimizer.restore(found, state.optimizer)


def _require_alike(found: dict[str, Tensor], expected: dict[str, Tensor]) -> None:
    """Raise ValueError unless tensors have the expected names, shapes and types."""
    if found.keys() != expected.keys():
        raise ValueError("its weights are those of another network")
    for name, like in expected.items():
        if found[name].shape != like.shape or found[name].dtype != like.dtype:
            raise ValueError(f"its {name} have another shape or type")
        if name.startswith("best.") and not bool(torch.isfinite(found[name]).all()):
            raise ValueError(f"its {name} are not finite")
