"""The best weights of a training."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch
from torch import Tensor


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
