"""Networks over a box: windows, one after the other, trained by one or several processes.

Input:  a box, a span, the allowed error, options.
Output: the map with the time up to which it holds, and how its training ended.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.description import MALFORMED, settings_text
from hamsym.errors import FileError, InputError
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.building import Built, image_of
from hamsym.flow_maps.domain import box_domain
from hamsym.flow_maps.expansion import Chain
from hamsym.flow_maps.network_map import NetworkMap
from hamsym.flow_maps.network_residual import Window
from hamsym.flow_maps.network_training import Budget, WindowTraining, pieces
from hamsym.flow_maps.options import NetworkMapOptions
from hamsym.flow_maps.workers import Interruption, Workers
from hamsym.networks.checkpoint import Checkpoint
from hamsym.networks.record import Stopped
from hamsym.networks.rules import Progress
from hamsym.support.checked_data import (
    checked_list,
    checked_mapping,
    checked_number,
    checked_record,
    require_names,
    taken,
)
from hamsym.support.tensor_files import one_line

__all__ = ["NetworkBuilder"]

_SHARE = 0.4  # of the allowed error, over all windows
_IMAGE_SEED = 2**32 - 2  # in the place of an iteration
# Options that do not determine the weights after an iteration.
_RULES = {"time_limit", "iterations", "patience", "checkpoint", "checkpoint_every", "device"}
# Adam's learning rate depends on the number of iterations.
_RULES_OF_ADAM = _RULES - {"iterations"}
_REASONS = {
    None: "not trained",
    Stopped.TARGET_ERROR: "converged",
    Stopped.ITERATIONS: "all iterations done",
    Stopped.PATIENCE: "no lower loss in the last iterations",
    Stopped.TIME_LIMIT: "time limit reached",
    Stopped.STALLED: "the optimizer stalled",
    Stopped.DIVERGED: "the loss was not finite",
    Stopped.INTERRUPTED: "interrupted",
}


class NetworkBuilder:
    """Training of the networks of one box over one span.

    Parameters
    ----------
    box : Box
    span : (float, float)
    allowed, scale : numpy.ndarray
        Allowed error and size of each component, shape (dim,).
    options : NetworkMapOptions
    seed : int
    workers : Workers
    note : callable
        Takes a line of text about the progress.

    Raises
    ------
    InputError
        If several windows are asked for, and a component of the state does not vary.
    """

    def __init__(
        self,
        box: Box,
        span: tuple[float, float],
        allowed: np.ndarray,
        scale: np.ndarray,
        options: NetworkMapOptions,
        seed: int,
        workers: Workers,
        note: Callable[[str], None],
    ) -> None:
        if options.windows > 1 and not box.is_whole:
            raise InputError(
                f"windows={options.windows} needs intervals for all components of z0, since each "
                "window starts where the one before it ends; give windows=1"
            )
        self._box, self._span, self._options, self._seed = box, span, options, seed
        self._allowed, self._scale = allowed, scale
        self._workers, self._note = workers, note
        self._edges = np.linspace(*span, options.windows + 1)
        self._trainings: list[WindowTraining] = []
        self._budget = Budget(options.time_limit or math.inf)

    def build(self) -> tuple[Built, str]:
        """Return the map, and how its training ended.

        Raises
        ------
        FileError
            If the checkpoint cannot be read or written, or belongs to another training.
        """
        interruption, checkpoint = Interruption(), self._checkpoint()
        with torch.no_grad():
            saved = None if checkpoint is None else self._workers.of_first(checkpoint.read)
            if checkpoint is not None and saved is not None:
                try:
                    self._resume(*saved)
                except MALFORMED as error:
                    raise FileError(
                        f"'{checkpoint.path}' is not a valid checkpoint of this training: "
                        f"{one_line(error)}; give another file"
                    ) from None
            else:
                self._begin()

            def write() -> None:
                if checkpoint is not None and self._workers.is_first:
                    checkpoint.write(*self._state())

            write()  # a path that cannot be written is refused before the training
            self._budget.start()
            with interruption.awaited():
                while True:
                    training = self._trainings[-1]
                    left = self._options.windows - len(self._trainings) + 1
                    training.run(self._budget, left, interruption, write)
                    if training.reason == Stopped.INTERRUPTED or training.is_short or left == 1:
                        break
                    self._begin()
            write()
        return self._built(), self._message()

    def _begin(self) -> None:
        """Begin the training of the next window."""
        number, options = len(self._trainings), self._options
        domain = box_domain(self._box)
        if number:
            before = self._trainings[-1].window
            domain = image_of(
                *(self._trainings[-1].map, before.domain, before.end, self._box, self._scale),
                np.random.default_rng([self._seed, number, _IMAGE_SEED]),
            )
        begin, end = self._edges[number : number + 2].tolist()
        tau = abs(end - begin) if options.tau is None else options.tau
        self._trainings.append(
            WindowTraining(
                number,
                Window(
                    *(domain, self._sample(number, begin), begin, end),
                    *(tuple(options.hidden), options.envelope, tau),
                ),
                self._box.H,
                _SHARE / options.windows * self._allowed,
                *(self._scale, options, self._seed, self._workers, self._note),
            )
        )

    def _sample(self, number: int, begin: float) -> Callable[[np.ndarray], np.ndarray]:
        """Return scaled inputs of the box -> inputs of a window.

        The states of the box at its begin fill a small part of the domain around them, and the
        network is needed only there.
        """
        box, dim = self._box, self._box.H.dim
        if not number:
            return box.at
        map = self._joined(number)

        def sample(y: np.ndarray) -> np.ndarray:
            inputs = box.at(y)
            states = map.evaluate(np.full(len(y), begin), inputs)
            return np.concatenate((states, inputs[:, dim:]), axis=1)

        return sample

    def _joined(self, count: int) -> NetworkMap | Chain:
        """Return the map of the first windows."""
        maps = [training.map for training in self._trainings[:count]]
        kept = np.arange(self._box.H.dim, len(self._box))
        return maps[0] if count == 1 else Chain(maps, self._edges[1:count], kept)

    def _built(self) -> Built:
        maps = [training.map for training in self._trainings]
        reached = self._trainings[-1].end
        edges = [np.array([self._span[0]])]
        for training, map in zip(self._trainings, maps, strict=True):
            edges.append(
                training.window.begin
                + (pieces(map)[1:] - training.window.begin)
                * ((training.end - training.window.begin) / map.length)
            )
        whole = self._joined(len(maps))
        failure = "" if reached == self._span[1] else f"the training ended there: {self._message()}"
        return Built(whole, reached, failure, np.concatenate(edges))

    def _message(self) -> str:
        """Return how the training ended."""
        iterations = sum(training.progress.iteration for training in self._trainings)
        weights = sum(training.window.count for training in self._trainings)
        windows, processes = self._options.windows, self._workers.count
        done = f"{weights:,} weights, {iterations:,} iterations"
        if processes > 1:
            done += f" by {processes} processes"
        if windows == 1:
            return f"{done}, {_REASONS[self._trainings[0].reason]}"
        counts = Counter(_REASONS[training.reason] for training in self._trainings)
        return f"{done}, " + ", ".join(
            f"{reason} in {count} of {windows} windows" for reason, count in counts.items()
        )

    # -- checkpoints -------------------------------------------------------------------------

    def _checkpoint(self) -> Checkpoint | None:
        """Return the checkpoint with all settings that determine the weights, if it has a path."""
        options, box = self._options, self._box
        if options.checkpoint is None:
            return None
        settings = settings_text(
            box.H,
            np.stack((box.low, box.high)),
            self._span,
            self._seed,
            options,
            without=_RULES_OF_ADAM if options.optimizer == "adam" else _RULES,
        )
        settings |= {
            "inputs": repr((box.names, sorted(box.fixed.items()), sorted(box.expressions.items()))),
            "tolerance": repr(self._allowed.tolist()),
            "processes": repr(self._workers.count),
            "torch": torch.__version__,
        }
        return Checkpoint(options.checkpoint, settings)

    def _state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the state of the training, from which it is resumed."""
        tensors = {f"best.{k}": part.best for k, part in enumerate(self._trainings)}
        tensors |= {f"now.{k}": tensor for k, tensor in self._trainings[-1].tensors().items()}
        return {name: tensor.cpu() for name, tensor in tensors.items()}, {
            "seconds": self._budget.seconds,
            "progress": [asdict(part.progress) for part in self._trainings],
            "reasons": [part.reason for part in self._trainings],
            "optimizer": self._trainings[-1].values(),
        }

    def _resume(self, tensors: Mapping[str, Tensor], values: dict[str, Any]) -> None:
        """Restore the state that :meth:`_state` returned."""
        require_names("state", values, {"settings", "seconds", "progress", "reasons", "optimizer"})
        self._budget.seconds = max(checked_number("seconds", values["seconds"]), 0.0)
        windows = checked_list("progress", values["progress"])
        reasons = checked_list("reasons", values["reasons"], len(windows))
        if not 1 <= len(windows) <= self._options.windows or None in reasons[:-1]:
            raise ValueError("its windows are not those of this training")
        given = dict(tensors)
        for number, (progress, reason) in enumerate(zip(windows, reasons, strict=True)):
            self._begin()
            self._trainings[-1].restore(
                given.pop(f"best.{number}"),
                checked_record(Progress, checked_mapping("progress", progress), {}),
                None if reason is None else Stopped(reason),
            )
        now = taken(given, "now")
        if given:
            raise ValueError("its weights are those of another network")
        self._trainings[-1].restore_optimizer(
            now, checked_mapping("optimizer", values["optimizer"])
        )
