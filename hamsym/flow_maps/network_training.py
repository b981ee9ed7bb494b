"""Training of the network of one window: growing spans, fresh points, a held-out sample.

Points are drawn from the seed, the window, the iteration and the rank of the process, so that a
training that is resumed continues with the same ones.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.flow_maps.judging import linear_error
from hamsym.flow_maps.network_map import NetworkMap
from hamsym.flow_maps.network_optimizers import Adam, LevenbergMarquardt, WindowOptimizer
from hamsym.flow_maps.network_residual import Points, Residual, Window
from hamsym.flow_maps.options import NetworkMapOptions
from hamsym.flow_maps.workers import Interruption, Workers
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.record import Stopped
from hamsym.networks.rules import Progress, Stages, StageSchedule

__all__ = ["Budget", "WindowTraining", "pieces"]

_ROWS = 2.0  # rows for each weight
_FEWEST = 100  # points
_HELD_OUT, _STARTS = 1_000, 24  # points, and starts of which the error is estimated
_HELD_OUT_SEED = 2**32 - 1  # in the place of the iteration
_QUARTER = 0.5  # of the loss, by which it falls between two estimates of the error
_SEQUENTIAL = 0.5  # share of the time for all spans but the last
# Endings after which a training that is resumed does not go on.
_FINAL = (Stopped.TARGET_ERROR, Stopped.STALLED, Stopped.DIVERGED)
_FEWEST_PIECES = 4
_ANGLE = 6.0  # largest change of a neuron of the first layer in a piece


@dataclass
class Budget:
    """Time of a whole training.

    Attributes
    ----------
    limit : float
        Seconds.
    seconds : float
        Used so far, also before a training was resumed.
    """

    limit: float
    seconds: float = 0.0

    def start(self) -> None:
        self._began = time.perf_counter() - self.seconds

    def clock(self, workers: Workers, came: bool) -> bool:
        """Take the time, the same in all processes; return whether any was interrupted."""
        self.seconds, interrupted = workers.largest(time.perf_counter() - self._began, float(came))
        return interrupted > 0


class WindowTraining:
    """Training of one window.

    Parameters
    ----------
    number : int
        Of the window, from 0; it chooses the random numbers.
    window : Window
    H : Hamiltonian
    allowed, scale : numpy.ndarray
        Allowed error and size of each component, shape (dim,).
    options : NetworkMapOptions
    seed : int
    workers : Workers
    note : callable
        Takes a line of text about the progress.
    """

    def __init__(
        self,
        number: int,
        window: Window,
        H: Hamiltonian,
        allowed: np.ndarray,
        scale: np.ndarray,
        options: NetworkMapOptions,
        seed: int,
        workers: Workers,
        note: Callable[[str], None],
    ) -> None:
        self.window, self._H, self._allowed, self._options = window, H, allowed, options
        self._seed, self._workers, self._note = [seed, number], workers, note
        self._residual = Residual(window, H, scale, workers.device)
        self._optimizer: WindowOptimizer = (
            Adam(self._residual, workers, options.learning_rate)
            if options.optimizer == "adam"
            else LevenbergMarquardt(self._residual, workers)
        )
        dim = len(scale)
        self._points = options.collocation_points or max(
            _FEWEST, math.ceil(_ROWS * window.count / dim)
        )
        self.progress = Progress()
        self._schedule = StageSchedule(
            Stages(options.stages),
            (window.begin, window.end),
            options.iterations,
            self.progress,
        )
        self.theta = window.first_weights(options.frequency, self._seed).to(workers.device)
        self.best = self.theta.clone()
        self._held_out = Points(
            window, _HELD_OUT, 1.0, [*self._seed, _HELD_OUT_SEED, 0], workers.device
        )
        y = np.random.default_rng([*self._seed, _HELD_OUT_SEED]).uniform(
            -1, 1, (_STARTS, len(window.domain))
        )
        self._starts = window.sample(y)
        self.reason: Stopped | None = None
        self.error = math.inf  # of the allowed error, at the held-out starts

    @property
    def end(self) -> float:
        """End of the span on which the network was trained."""
        return self._schedule.span[1]

    @property
    def is_short(self) -> bool:
        """Whether the network was not trained on the whole window, or not at all."""
        return not self._schedule.is_last or self.reason == Stopped.DIVERGED

    @property
    def map(self) -> NetworkMap:
        """The network with the best weights."""
        return self.window.map(self.best)

    def run(
        self, budget: Budget, left: int, interruption: Interruption, write: Callable[[], None]
    ) -> None:
        """Train until a rule ends it, which is then ``reason``; the best weights are ``best``.

        Parameters
        ----------
        budget : Budget
            Its time is divided among the windows that are left.
        left : int
            Number of windows that are left, with this one.
        interruption : Interruption
        write : callable
            Writes a checkpoint.
        """
        if self.reason in _FINAL:
            return
        self.reason = None
        until = budget.seconds + (budget.limit - budget.seconds) / left
        stage_began = budget.seconds
        progress, schedule, options = self.progress, self._schedule, self._options
        while self.reason is None:
            if progress.iteration >= options.iterations:
                self.reason = Stopped.ITERATIONS
            elif budget.seconds >= until:
                self.reason = Stopped.TIME_LIMIT
            if self.reason is not None:
                break
            stage = progress.stage
            self.reason = self._iterate(budget, interruption, until, stage_began)
            if progress.stage > stage:
                stage_began = budget.seconds
            if progress.iteration % options.checkpoint_every == 0:
                write()
        if schedule.is_last:
            self._check()
        else:
            self.best = self.theta.clone()

    def _iterate(
        self, budget: Budget, interruption: Interruption, until: float, stage_began: float
    ) -> Stopped | None:
        """Perform one iteration; return the reason for which the training ends, if any."""
        progress, schedule, options = self.progress, self._schedule, self._options
        points = Points(
            *(self.window, self._points, schedule.share),
            [*self._seed, progress.iteration, self._workers.rank],
            self._workers.device,
        )
        done = progress.iteration / options.iterations
        loss, motion = self._optimizer.iterate(self.theta, points, done)
        progress.iteration += 1
        progress.in_stage += 1
        interrupted = budget.clock(self._workers, interruption.came)
        if not math.isfinite(loss):
            return Stopped.DIVERGED
        if not schedule.is_last:
            left = options.stages - progress.stage
            share = stage_began + _SEQUENTIAL * (until - stage_began) / left
            if schedule.is_passed(loss, motion) or budget.seconds >= share:
                self._note(
                    f"trained to t = {self.end:.6g}, iteration {progress.iteration:,}, "
                    f"residual {math.sqrt(loss):.2g}"
                )
                schedule.advance()
        elif progress.iteration % self._optimizer.check_every == 0:
            self._check()
            if self.error <= 1:
                return Stopped.TARGET_ERROR
            waited = min(progress.iteration - progress.improved, progress.in_stage)
            if options.patience is not None and waited >= options.patience:
                return Stopped.PATIENCE
        if interrupted:
            return Stopped.INTERRUPTED
        return Stopped.STALLED if self._optimizer.stalled else None

    def _check(self) -> None:
        """Keep the weights if they are the best at the held-out points."""
        progress = self.progress
        rows, _ = self._residual.rows(self.theta, self._held_out)
        mean = rows.square().mean()
        self._workers.share(mean)
        loss = float(mean)
        if not loss < progress.best_loss:
            return
        progress.best_loss, progress.improved = loss, progress.iteration
        self.best = self.theta.clone()
        if loss > _QUARTER * progress.judged:
            return
        progress.judged = loss
        self.error = float(self._workers.of_first(self._relative_error))
        self._note(
            f"t = {self.window.end:.6g}, iteration {progress.iteration:,}: held-out residual "
            f"{math.sqrt(loss):.2g}, error {self.error:.2g} of what is allowed"
        )

    def _relative_error(self) -> float:
        """Return the error at the held-out starts, of the allowed one."""
        found = self.map
        error = linear_error(found, self._H, self.window.domain, pieces(found), self._starts)
        return float(np.nan_to_num(error / self._allowed, nan=np.inf).max())

    # -- checkpoints -------------------------------------------------------------------------

    def tensors(self) -> dict[str, Tensor]:
        """Return the present weights and the state of the optimizer by name."""
        state = self._optimizer.state()[0]
        return {"theta": self.theta} | {
            f"optimizer.{name}": tensor for name, tensor in state.items()
        }

    def values(self) -> dict[str, Any]:
        """Return the state of the optimizer that is JSON values."""
        return self._optimizer.state()[1]

    def restore(self, best: Tensor, progress: Progress, reason: Stopped | None) -> None:
        """Restore the best weights, the progress and the reason for which the training ended.

        Raises
        ------
        ValueError
            If they are not those of this training.
        """
        progress.check()
        if not 1 <= progress.stage <= self._options.stages:
            raise ValueError("its stage is not one of this training")
        self.best, self.reason = self._restored(best), reason
        self.progress = self._schedule.progress = progress

    def restore_optimizer(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Restore the state of :meth:`tensors` and :meth:`values`."""
        self.theta = self._restored(tensors.pop("theta"))
        own = {
            name.removeprefix("optimizer."): tensor.to(self._workers.device)
            for name, tensor in tensors.items()
        }
        self._optimizer.restore(own, values)

    def _restored(self, weights: Tensor) -> Tensor:
        like = self.theta
        if weights.shape != like.shape or weights.dtype != like.dtype:
            raise ValueError("its weights are those of another network")
        if not bool(torch.isfinite(weights).all()):
            raise ValueError("its weights are not finite")
        return weights.to(like.device)


def pieces(map: NetworkMap) -> np.ndarray:
    """Return ends of pieces of the time of a :class:`NetworkMap` in which it is smooth."""
    frequency = float(np.abs(map.layers[0][0][:, 0]).max())
    count = max(_FEWEST_PIECES, math.ceil(2 * frequency / _ANGLE))
    return np.linspace(map.begin, map.begin + map.length, count + 1)
