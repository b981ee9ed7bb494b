"""Adam and L-BFGS of torch with the interface of :class:`hamsym.networks.training.Optimizer`."""

from __future__ import annotations

import math

import numpy as np
import torch
from torch import Tensor

from hamsym.networks.objective import Objective
from hamsym.networks.points import Collocation, midpoints, points_between, points_within
from hamsym.support.validation import require_whole


class GradientOptimizer:
    """Common part of the optimizers that need the loss and its gradient."""

    _collocation: Collocation

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        self._trial, self._objective, self._generator = trial, objective, generator
        self._collocation.bind(trial, generator)
        self._parameters = list(trial.parameters())
        self._dtype, self._device = self._parameters[0].dtype, self._parameters[0].device
        self.reset()

    def reset(self) -> None:
        raise NotImplementedError


class Adam(GradientOptimizer):
    """Adam (Kingma & Ba 2015) on noisy points, as in the paper.

    Each iteration moves the collocation points by Gaussian noise, reflected into the span, so
    that the equation is enforced everywhere and not at K points only.

    - betas: Decay rates of the moment estimates.
    - schedule: {"constant", "cosine"}. Constant learning rate, as in the paper, or decay to zero
      along half a cosine.
    - points: Collocation points K, equally spaced over the span; or times, from the start of the
      span on.
    - noise: Standard deviation of the noise, in units of time; by default three times the spacing
      of the points, as in the paper, and no noise of given times.
    """

    check_every = 50
    stalled = False

    def __init__(
        self,
        *,
        learning_rate: float = 8e-3,
        betas: tuple[float, float] = (0.9, 0.999),
        schedule: str = "cosine",
        points: int | np.ndarray = 200,
        noise: float | None = None,
    ) -> None:
        self._collocation = Collocation(points)
        self.learning_rate, self.betas, self.schedule = learning_rate, betas, schedule
        self.points, self.noise = self._collocation.count, noise

    def reset(self) -> None:
        self._adam = torch.optim.Adam(
            self._parameters,
            lr=self.learning_rate,
            betas=self.betas,
            fused=self._device.type in ("cpu", "cuda") or None,
        )

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return the midpoints of a grid twice as fine."""
        count = 2 * self._collocation.judging
        return midpoints(span, count, self._dtype).to(self._device)

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        if self.schedule == "cosine":
            rate = self.learning_rate * (1 + math.cos(math.pi * done)) / 2
            self._adam.param_groups[0]["lr"] = rate
        t = self._noisy(self._base_points(span), min(span), max(span)).to(self._device)
        self._adam.zero_grad(set_to_none=True)
        z, dz = self._trial(t)
        loss = self._objective(t, z, dz)
        loss.backward()
        self._adam.step()
        motion = 0.0 if share == 1 else float(dz.detach().square().sum(-1).mean())
        return loss.item(), motion

    def _base_points(self, span: tuple[float, float]) -> Tensor:
        """Return the points of an epoch before noise is added, on the CPU."""
        if self._collocation.times is not None:
            return points_within(self._collocation.times, span, self._dtype)
        return torch.linspace(min(span), max(span), self.points, dtype=self._dtype, device="cpu")

    def _noisy(self, points: Tensor, start: float, end: float) -> Tensor:
        length = end - start
        noise = self.noise
        if noise is None:
            noise = 3 * length / (self.points - 1) if self._collocation.times is None else 0.0
        if not noise:
            return points
        moved = torch.randn(
            points.shape, generator=self._generator, dtype=self._dtype, device="cpu"
        )
        moved.mul_(noise).add_(points).sub_(start)
        # Reflection at both ends, as often as needed.
        return end - moved.remainder_(2 * length).sub_(length).abs_()


class QuasiNewton(GradientOptimizer):
    """Common part of quasi-Newton methods, whose points are constant for some iterations."""

    check_every = 10
    _PATIENCE = 5  # restarts in a row without a step that count as a stall
    _failures: int

    @property
    def stalled(self) -> bool:
        """Whether several restarts in a row with new points made no step."""
        return self._failures >= self._PATIENCE

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return midpoints between twice as many points of the same density."""
        return points_between(span, self._collocation.judging, self._dtype).to(self._device)


class LBFGS(QuasiNewton):
    """L-BFGS with a strong Wolfe line search (Liu & Nocedal 1989), of torch.

    The points are constant while the curvature pairs are in use. New points are drawn, and the
    pairs discarded, after ``refresh`` iterations and whenever the line search fails.

    - points: Collocation points K; or times, from the start of the span on.
    - memory: Number of pairs of steps and gradient changes.
    - refresh: Iterations after which new points are drawn.
    """

    def __init__(
        self,
        *,
        points: int | np.ndarray = 200,
        memory: int = 50,
        refresh: int = 200,
    ) -> None:
        self._collocation = Collocation(points)
        require_whole("memory", memory, 1)
        require_whole("refresh", refresh, 1)
        self.points, self.memory, self.refresh = self._collocation.count, memory, refresh

    def reset(self) -> None:
        self._lbfgs = torch.optim.LBFGS(
            self._parameters,
            max_iter=1,
            max_eval=25,
            history_size=self.memory,
            line_search_fn="strong_wolfe",
            tolerance_grad=0,
            tolerance_change=0,
        )
        self._t: Tensor | None = None
        self._age, self._failures, self._share = 0, 0, 0.0

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        if self._t is None or self._age >= self.refresh or share != self._share:
            failures = self._failures
            self.reset()
            self._t = self._collocation.draw(span, self.points)
            self._failures, self._share = failures, share
        t, motion = self._t, 0.0

        def closure() -> Tensor:
            nonlocal motion
            self._lbfgs.zero_grad(set_to_none=True)
            z, dz = self._trial(t)
            motion = float(dz.detach().square().sum(-1).mean())
            loss = self._objective(t, z, dz)
            loss.backward()
            return loss

        before = [parameter.detach().clone() for parameter in self._parameters]
        loss = float(self._lbfgs.step(closure).detach())
        self._age += 1
        moved = any(not torch.equal(b, p) for b, p in zip(before, self._parameters, strict=True))
        if moved:
            self._failures = 0
        else:
            self._failures += 1
            self._t = None
        return loss, motion
