"""Collocation points that are denser where the residual is larger."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from hamsym.networks.objective import Objective
from hamsym.networks.points import fresh_points, judging_count, points_within, spread
from hamsym.support.validation import require, require_whole

__all__ = ["SAMPLINGS", "Collocation", "cumulative_density", "drawn_points"]

#: Densities of collocation points by name.
SAMPLINGS = ("uniform", "residual")
_NODES = 4  # at which the residual is evaluated, for each point


class Collocation:
    """The collocation points of an optimizer of second order.

    Parameters
    ----------
    points : int or numpy.ndarray
        Their number K, or the times themselves, from the start of the span on.
    sampling : {"uniform", "residual"}
        Density of points that are drawn: that of :func:`~hamsym.networks.points.spread`, or this
        density times 1 + |residual| / mean |residual|.
    """

    def __init__(self, points: int | np.ndarray, sampling: str) -> None:
        self.times = points if isinstance(points, np.ndarray) else None
        if not isinstance(points, np.ndarray):
            require_whole("points", points, 2)
        require(sampling in SAMPLINGS, "sampling", sampling, "'uniform' or 'residual'")
        self.count = points if isinstance(points, int) else len(points)
        #: Number of collocation points by which that of the judging points is chosen.
        self.judging = judging_count(points)
        self.by_residual = sampling == "residual"

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        """Set the trial solution, the objective and the source of random numbers, once."""
        self._trial, self._objective, self._generator = trial, objective, generator
        weights = next(trial.parameters())
        self._dtype, self._device = weights.dtype, weights.device

    def draw(self, span: tuple[float, float], count: int) -> Tensor:
        """Return times in a span: those of the caller's choice, or ``count`` random ones."""
        if self.times is not None:
            return points_within(self.times, span, self._dtype).to(self._device)
        if not self.by_residual:
            return fresh_points(span, count, self._dtype, self._generator).to(self._device)

        def place(u: Tensor) -> Tensor:
            return spread(span, u).to(self._dtype).to(self._device)

        density = cumulative_density(self._trial, self._objective, place, count)
        return place(drawn_points(density, count, self._generator))


def cumulative_density(
    trial: torch.nn.Module, objective: Objective, place: Callable[[Tensor], Tensor], count: int
) -> np.ndarray:
    """Return the cumulative density of points by the residual, at equally spaced u in [0, 1].

    The density of u is proportional to 1 + |residual| / mean |residual|: half of the points go
    where the residual is (residual-based adaptive distribution, RAD, of Wu, Zhu, Tan, Kartha & Lu
    2023, with their k = c = 1). It is uniform where the residual is not finite.

    Parameters
    ----------
    trial : torch.nn.Module
    objective : Objective
    place : callable
        u of shape (n,) on the CPU -> times, of the type and on the device of the trial solution.
    count : int
        Points that will be drawn.
    """
    nodes = _NODES * count + 1
    uniform = np.linspace(0, 1, nodes)
    with torch.no_grad():
        t = place(torch.from_numpy(uniform))
        size = objective.residual(t, *trial(t)).norm(dim=-1).cpu().double().numpy()
    mean = size.mean()
    if not 0 < mean < np.inf:
        return uniform
    density = 1 + size / mean
    found = np.concatenate(([0.0], np.cumsum(density[1:] + density[:-1])))
    return np.asarray(found / found[-1])


def drawn_points(cumulative: np.ndarray, count: int, generator: torch.Generator) -> Tensor:
    """Return random u, one in each of ``count`` cells of equal probability, and both ends."""
    cells = torch.arange(count, dtype=torch.float64, device="cpu")
    chance = torch.rand(count, generator=generator, dtype=torch.float64, device="cpu")
    places = np.linspace(0, 1, len(cumulative))
    u = np.asarray(np.interp((cells + chance) / count, cumulative, places))
    u[0], u[-1] = 0.0, 1.0
    return torch.from_numpy(u)
