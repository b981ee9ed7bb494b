"""What an optimizer does, its collocation points on the CPU, and Adam and L-BFGS of torch."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hamsym.networks import methods
from hamsym.networks.objective import Objective


class Optimizer:
    """An optimizer that changes the weights, one iteration at a time, with the options of a method.

    - check_every: Iterations between evaluations at the fixed points.
    """

    check_every: int

    def __init__(self, method: methods.JointTraining) -> None:
        self.method, self.points = method, int(method.points)

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        """Set the trial solution, the objective and the source of random numbers, once."""
        self._trial, self._objective, self._generator = trial, objective, generator
        self._parameters = list(trial.parameters())
        self._dtype, self._device = self._parameters[0].dtype, self._parameters[0].device
        self.reset()

    def reset(self) -> None:
        """Reset the optimizer state after new weights were drawn."""
        raise NotImplementedError

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return the points at which weights are judged, and which are never trained on."""
        raise NotImplementedError

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        """Perform one iteration.

        - span: Span of the current stage.
        - share: Its fraction of the whole span.
        - done: Fraction of all iterations that are done.
        - returns: The loss at the optimizer's points before the step, and the mean square of dz/dt
          there.
        """
        raise NotImplementedError

    @property
    def stalled(self) -> bool:
        """Whether further iterations would not lower the loss."""
        return False


class Adam(Optimizer):
    """Adam (Kingma & Ba 2015) on noisy points, as in the paper.

    Each iteration moves the collocation points by Gaussian noise, reflected into the span, so
    that the equation is enforced everywhere and not at K points only. The learning rate is
    constant, as in the paper, or decays to zero along half a cosine.
    """

    method: methods.Adam
    check_every = 50

    def reset(self) -> None:
        self._adam = torch.optim.Adam(
            self._parameters,
            lr=self.method.learning_rate,
            betas=self.method.betas,
            fused=self._device.type in ("cpu", "cuda") or None,
        )

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return the midpoints of a grid twice as fine."""
        return midpoints(span, 2 * self.points, self._dtype).to(self._device)

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        if self.method.schedule == "cosine":
            rate = self.method.learning_rate * (1 + math.cos(math.pi * done)) / 2
            self._adam.param_groups[0]["lr"] = rate
        t = self._noisy_points(min(span), max(span)).to(self._device)
        self._adam.zero_grad(set_to_none=True)
        z, dz = self._trial(t)
        loss = self._objective(t, z, dz)
        loss.backward()
        self._adam.step()
        motion = 0.0 if share == 1 else float(dz.detach().square().sum(-1).mean())
        return loss.item(), motion

    def _noisy_points(self, start: float, end: float) -> Tensor:
        """Return the points of an epoch, on the CPU."""
        points = torch.linspace(start, end, self.points, dtype=self._dtype, device="cpu")
        length, noise = end - start, self.method.noise
        if noise is None:
            noise = 3 * length / (self.points - 1)
        if not noise:
            return points
        moved = torch.randn(
            points.shape, generator=self._generator, dtype=self._dtype, device="cpu"
        )
        moved.mul_(noise).add_(points).sub_(start)
        # Reflection at both ends, as often as needed.
        return end - moved.remainder_(2 * length).sub_(length).abs_()


class QuasiNewton(Optimizer):
    """Common part of methods that stall after some failures in a row and draw random points."""

    check_every = 10
    refresh = 200  # iterations after which new points are drawn
    _PATIENCE = 5  # restarts in a row without a step that count as a stall
    _failures: int

    @property
    def stalled(self) -> bool:
        """Whether several iterations or restarts in a row, with new points, made no step."""
        return self._failures >= self._PATIENCE

    def fixed_points(self, span: tuple[float, float]) -> Tensor:
        """Return midpoints between twice as many points of the same density."""
        return points_between(span, self.points, self._dtype).to(self._device)

    def _drawn(self, span: tuple[float, float], count: int | None = None) -> Tensor:
        """Return new random points, by default K."""
        t = fresh_points(span, count or self.points, self._dtype, self._generator)
        return t.to(self._device)


class LBFGS(QuasiNewton):
    """L-BFGS with a strong Wolfe line search (Liu & Nocedal 1989), of torch.

    The points are constant while the curvature pairs are in use. New points are drawn, and the
    pairs discarded, after ``refresh`` iterations and whenever the line search fails.

    - memory: Number of pairs of steps and gradient changes.
    """

    memory = 50

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
            self._t = self._drawn(span)
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


# -- collocation points ---------------------------------------------------------------------------


def midpoints(span: tuple[float, float], count: int, dtype: torch.dtype) -> Tensor:
    """Return the midpoints of equal cells of a span, shape (count,)."""
    return min(span) + _cells(count, dtype) * abs(span[1] - span[0])


def fresh_points(
    span: tuple[float, float], count: int, dtype: torch.dtype, generator: torch.Generator
) -> Tensor:
    """Return random times, one in each of ``count`` cells of a span, and both its ends."""
    u = (
        torch.arange(count, dtype=dtype, device="cpu")
        + torch.rand(count, generator=generator, dtype=dtype, device="cpu")
    ) / count
    u[0], u[-1] = 0.0, 1.0
    return _spread(span, u)


def points_between(span: tuple[float, float], count: int, dtype: torch.dtype) -> Tensor:
    """Return the midpoints of 2 count + 1 cells with the density of :func:`fresh_points`."""
    return _spread(span, _cells(2 * count + 1, dtype))


def _spread(span: tuple[float, float], u: Tensor) -> Tensor:
    """Map u in [0, 1] to times that are denser at both ends, between uniform and Chebyshev points.

    A residual that is large at the start offsets the whole trajectory.
    """
    start, end = span
    s = 0.5 * u + 0.25 * (1 - torch.cos(math.pi * u))
    return start + s * (end - start)


def _cells(count: int, dtype: torch.dtype) -> Tensor:
    return (torch.arange(count, dtype=dtype, device="cpu") + 0.5) / count
