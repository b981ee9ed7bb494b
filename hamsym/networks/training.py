"""Training of trial solutions of any first-order equation; it does not depend on Hamiltonians.

Input:  a trial solution t -> (z, dz/dt), an :class:`Objective` made of a residual function, a
        loss and regularizers, a time span, and an optimizer (:mod:`hamsym.networks.optimizers`,
        :mod:`hamsym.networks.self_scaled_broyden`, :mod:`hamsym.networks.levenberg_marquardt`),
        whose method has rules for stopping.
Output: the weights with the lowest loss at fixed points (left in the trial solution), and a
        :class:`~hamsym.networks.record.Training`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import numpy as np
import torch
from torch import Tensor

from hamsym.networks.network import Network
from hamsym.networks.objective import Objective
from hamsym.networks.optimizers import Optimizer
from hamsym.networks.record import History, Stopped, Training, TrainingState
from hamsym.networks.rules import Course, Stages, limit_reached, target_reached

# Products of points and weights below this are no faster on two threads, which cost twice the CPU
# time.
_ONE_THREAD = 4_000_000
# Mean square of the residual, relative to that of dz/dt, above which a stalled training restarts.
_POOR = 1e-8


def train(
    trial: torch.nn.Module,
    objective: Objective,
    span: tuple[float, float],
    optimizer: Optimizer,
    *,
    generator: torch.Generator,
    stages: Stages,
    criteria: Mapping[str, Callable[[Training], bool]] | None = None,
    tell: Callable[[TrainingState], None] = lambda state: None,
) -> Training:
    """Minimise an objective over a time span.

    The weights that are kept are the best at fixed points, which are never trained on.

    - trial: t of shape (K,) -> (z, dz/dt), each (K, dim).
    - span: Start and end time; the end may be the smaller.
    - optimizer: An optimizer that was not used before.
    - generator: Source of all random numbers.
    - criteria: Further rules for stopping by their names: each judges the trial solution, with the
      best weights, and the record of the training so far, when the loss has quartered.
    - tell: Called after evaluations at the fixed points.
    """
    optimizer.bind(trial, objective, generator)
    run = _Run(trial, objective, span, optimizer, criteria or {}, stages, generator, tell)
    return run.through()


class BestWeights:
    """The weights with the lowest loss so far, and the trial solution's current ones."""

    def __init__(self, trial: torch.nn.Module) -> None:
        self.parameters = list(trial.parameters())
        self.keep()

    def keep(self) -> None:
        """Make the current weights the best ones."""
        self.best = self.current()

    def current(self) -> list[Tensor]:
        """Return a copy of the current weights."""
        return [parameter.detach().clone() for parameter in self.parameters]

    @torch.no_grad()
    def put(self, weights: list[Tensor]) -> None:
        """Put weights into the trial solution."""
        for parameter, value in zip(self.parameters, weights, strict=True):
            parameter.copy_(value)

    @contextmanager
    def in_trial(self) -> Iterator[None]:
        """Put the best weights into the trial solution for a while."""
        current = self.current()
        self.put(self.best)
        try:
            yield
        finally:
            self.put(current)


class _Run:
    """A training in progress."""

    def __init__(
        self,
        trial: torch.nn.Module,
        objective: Objective,
        span: tuple[float, float],
        optimizer: Optimizer,
        criteria: Mapping[str, Callable[[Training], bool]],
        stages: Stages,
        generator: torch.Generator,
        tell: Callable[[TrainingState], None],
    ) -> None:
        self.trial, self.objective, self.generator, self.tell = trial, objective, generator, tell
        self.optimizer, self.method, self.criteria = optimizer, optimizer.method, criteria
        self.fixed = optimizer.fixed_points(span)
        self.weights = BestWeights(trial)
        self.course = Course(stages, span, self.method.total)
        self.losses: list[float] = []
        self.checks: list[tuple[int, float, float, float]] = []

    def through(self) -> Training:
        """Train until a rule ends it."""
        threads = torch.get_num_threads()
        size = len(self.fixed) * sum(weights.numel() for weights in self.weights.parameters)
        self.began, self.cpu_began = time.perf_counter(), time.process_time()
        stopped: str | None = None
        try:
            if size < _ONE_THREAD:
                torch.set_num_threads(1)
            while stopped is None:
                if self.course.iteration >= self.method.total:
                    stopped = Stopped.ITERATIONS
                    break
                stopped = self._iterate()
        except KeyboardInterrupt:
            stopped = Stopped.INTERRUPTED
        finally:
            torch.set_num_threads(threads)
        self._clock()
        self.weights.put(self.weights.best)
        return self._record(stopped)

    def _record(self, stopped: str) -> Training:
        columns = np.array(self.checks, dtype=float).reshape(-1, 4).T
        course = self.course
        return Training(
            history=History(np.array(self.losses), columns[0].astype(int), *columns[1:]),
            points=self.optimizer.points,
            iterations=len(self.losses),
            restarts=course.restarts,
            best_loss=course.best_loss,
            best_ell_max=course.best_ell_max,
            stopped=stopped,
            seconds=course.seconds,
            cpu_seconds=course.cpu_seconds,
        )

    def _iterate(self) -> str | None:
        """Perform one iteration; return the reason for which the training ends, if any."""
        course, total = self.course, self.method.total
        last_stage = course.is_last
        loss, motion = self.optimizer.iterate(course.span, course.share, course.iteration / total)
        self.losses.append(loss)
        course.iteration += 1
        course.in_stage += 1
        if not math.isfinite(loss):
            return self._restart(Stopped.DIVERGED)
        is_record = loss < 0.9 * course.lowest
        course.lowest = min(course.lowest, loss)
        if not last_stage:
            if course.is_passed(loss, motion):
                course.advance()
            elif self.optimizer.stalled or course.is_exhausted:
                return self._restart(Stopped.STALLED)
        regular = course.iteration % self.optimizer.check_every == 0
        checked = regular or course.iteration == total or (last_stage and is_record)
        if checked:
            self._check()
            if (stopped := self._rule_met()) is not None:
                return stopped
        if not last_stage:
            return None
        stalled = self.optimizer.stalled
        poor = course.best_loss > _POOR * motion
        if poor and (stalled or (checked and course.is_exhausted)):
            return self._restart(Stopped.STALLED)
        return Stopped.STALLED if stalled else None

    def _check(self) -> None:
        """Evaluate the current weights at the fixed points, and keep them if they are the best."""
        course = self.course
        with torch.no_grad():
            z, dz = self.trial(self.fixed)
            loss = float(self.objective(self.fixed, z, dz))
            residual = self.objective.residual(self.fixed, z, dz)
            ell_max = float(residual.square().sum(-1).max().sqrt())
        if loss < course.best_loss:
            course.best_loss, course.best_ell_max = loss, ell_max
            course.improved = course.iteration
            self.weights.keep()
        self._clock()
        self.checks.append((course.iteration, loss, ell_max, course.seconds))
        given = course.iteration, self.method.total, loss, course.best_loss, ell_max
        self.tell(TrainingState(*given, course.seconds))

    def _rule_met(self) -> str | None:
        """Return the first rule that the best weights meet, if any."""
        course = self.course
        if (target := target_reached(self.method, course)) is not None:
            return target
        if self.criteria and course.best_loss <= course.judged / 4:
            course.judged = course.best_loss
            record = self._record(Stopped.INTERRUPTED)
            with self.weights.in_trial():
                met = [name for name, is_met in self.criteria.items() if is_met(record)]
            if met:
                return met[0]
        return limit_reached(self.method, course)

    def _restart(self, reason: Stopped) -> Stopped | None:
        """Restart with new weights, or end for this reason if no restart is left."""
        if not self.course.can_restart():
            return reason
        for module in self.trial.modules():
            if isinstance(module, Network):
                module.draw(self.generator)
        self.optimizer.reset()
        self.course.restart()
        return None

    def _clock(self) -> None:
        self.course.seconds = time.perf_counter() - self.began
        self.course.cpu_seconds = time.process_time() - self.cpu_began
