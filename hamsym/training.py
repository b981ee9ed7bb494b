"""A trainer for trial solutions of any first-order equation; it knows no Hamiltonian.

Input:  a trial solution t -> (z, dz/dt), an :class:`Objective` made of a residual function, a
        loss and regularisers, and a time span.
Output: the weights with the lowest loss at fixed points (left in the trial solution), and a
        :class:`Training` that tells how it went.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError

__all__ = [
    "AdamOptions",
    "History",
    "Objective",
    "Regularizer",
    "Training",
    "TrainingState",
    "train_adam",
]

_CHECK_EVERY = 50  # epochs between evaluations at the fixed points
# Products of points and weights below this are no faster on two threads, which cost twice the CPU
# time.
_ONE_THREAD = 4_000_000


@dataclass(frozen=True)
class Regularizer:
    """A term weight * mean(function(t, z, dz)) of the loss; the function returns shape (K,)."""

    weight: float
    function: Callable[[Tensor, Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class Objective:
    """What training makes small.

    Attributes
    ----------
    residual : callable
        (t, z, dz) -> shape (K, dim), zero on a solution.
    loss : callable, optional
        (t, z, dz) -> scalar; by default the mean over points of the squared 2-norm of the
        residual.
    regularizers : tuple of Regularizer
        Further terms.
    """

    residual: Callable[[Tensor, Tensor, Tensor], Tensor]
    loss: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None
    regularizers: tuple[Regularizer, ...] = ()

    def __call__(self, t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        """The loss with all its terms, a scalar."""
        if self.loss is not None:
            value = self.loss(t, z, dz)
        else:
            value = self.residual(t, z, dz).square().sum(-1).mean()
        for term in self.regularizers:
            value = value + term.weight * term.function(t, z, dz).mean()
        return value


@dataclass(frozen=True)
class TrainingState:
    """What a callback is told after each evaluation at the fixed points."""

    epoch: int
    epochs: int
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
        Loss at the noisy points, one value per epoch.
    epoch, fixed_loss, ell_max, seconds : numpy.ndarray
        Evaluations at the fixed points: after which epoch, the loss, the largest 2-norm of the
        residual, and the time since the start.
    """

    loss: np.ndarray = field(repr=False)
    epoch: np.ndarray = field(repr=False)
    fixed_loss: np.ndarray = field(repr=False)
    ell_max: np.ndarray = field(repr=False)
    seconds: np.ndarray = field(repr=False)


@dataclass(frozen=True)
class Training:
    """How a training ended; the best weights are in the trial solution."""

    history: History
    points: int
    epochs: int
    best_loss: float
    reached_target: bool
    stopped: str  # "epochs", "target", "diverged" or "interrupted"
    seconds: float
    cpu_seconds: float


@dataclass(frozen=True)
class AdamOptions:
    """Settings of :func:`train_adam`; but for the schedule the defaults are those of the paper.

    Attributes
    ----------
    epochs : int
    learning_rate : float
    betas : (float, float)
        Decay rates of Adam's moment estimates.
    schedule : {"constant", "cosine"}
        The learning rate stays, as in the paper, or falls to zero along half a cosine.
    points : int
        Collocation points K, equally spaced over the span.
    noise : float, optional
        Standard deviation of the Gaussian noise added to the points each epoch, in units of
        time; by default three times their spacing, which is what the paper's settings are.
    target_loss : float, optional
        Training stops when the loss at the fixed points is at most this.
    """

    epochs: int = 50_000
    learning_rate: float = 8e-3
    betas: tuple[float, float] = (0.9, 0.999)
    schedule: str = "cosine"
    points: int = 200
    noise: float | None = None
    target_loss: float | None = None

    def __post_init__(self) -> None:
        _require(
            isinstance(self.epochs, int) and self.epochs >= 1, "epochs", self.epochs, "1 or more"
        )
        _require(
            isinstance(self.points, int) and self.points >= 2, "points", self.points, "2 or more"
        )
        _require(_positive(self.learning_rate), "learning_rate", self.learning_rate, "above 0")
        _require(
            self.noise is None or self.noise == 0 or _positive(self.noise),
            "noise",
            self.noise,
            "0 or more",
        )
        _require(
            self.target_loss is None or _positive(self.target_loss),
            "target_loss",
            self.target_loss,
            "above 0",
        )
        _require(
            isinstance(self.betas, (tuple, list))
            and len(self.betas) == 2
            and all(isinstance(beta, (int, float)) and 0 <= beta < 1 for beta in self.betas),
            "betas",
            self.betas,
            "two numbers from 0 to below 1",
        )
        _require(
            self.schedule in ("constant", "cosine"),
            "schedule",
            self.schedule,
            "'constant' or 'cosine'",
        )


def train_adam(
    trial: torch.nn.Module,
    objective: Objective,
    span: tuple[float, float],
    options: AdamOptions,
    *,
    generator: torch.Generator,
    callbacks: Sequence[Callable[[TrainingState], None]] = (),
) -> Training:
    """Minimise an objective over a time span with Adam (Kingma & Ba 2015).

    Each epoch moves the collocation points by Gaussian noise, reflected into the span, so that
    the equation is enforced everywhere and not at K points only. The weights that are kept are
    the best at fixed points, the midpoints of a grid twice as fine, which are never trained on.

    Parameters
    ----------
    trial : torch.nn.Module
        t of shape (K,) -> (z, dz/dt), each (K, dim).
    objective : Objective
    span : (float, float)
        Start and end time; the end may be the smaller.
    options : AdamOptions
    generator : torch.Generator
        Source of the noise.
    callbacks : sequence of callable
        Each is given a :class:`TrainingState` now and then.

    Returns
    -------
    Training
    """
    start, end = min(span), max(span)
    length = end - start
    parameters = list(trial.parameters())
    dtype = parameters[0].dtype
    grid = torch.linspace(start, end, options.points, dtype=dtype)
    offsets = grid - start
    noise = 3 * length / (options.points - 1) if options.noise is None else options.noise
    count = 2 * options.points
    fixed = start + (torch.arange(count, dtype=dtype) + 0.5) * (length / count)

    optimizer = torch.optim.Adam(
        parameters, lr=options.learning_rate, betas=options.betas, fused=True
    )
    losses: list[float] = []
    checks: list[tuple[int, float, float, float]] = []
    best_loss, best = math.inf, [parameter.detach().clone() for parameter in parameters]
    lowest = math.inf
    stopped = "epochs"
    began, cpu_began = time.perf_counter(), time.process_time()

    def check(epoch: int) -> float:
        nonlocal best_loss, best
        with torch.no_grad():
            z, dz = trial(fixed)
            loss = float(objective(fixed, z, dz))
            ell_max = float(objective.residual(fixed, z, dz).square().sum(-1).max().sqrt())
        if loss < best_loss:
            best_loss, best = loss, [parameter.detach().clone() for parameter in parameters]
        checks.append((epoch, loss, ell_max, time.perf_counter() - began))
        state = TrainingState(epoch, options.epochs, loss, best_loss, ell_max, checks[-1][3])
        for callback in callbacks:
            callback(state)
        return loss

    threads = torch.get_num_threads()
    try:
        if count * sum(parameter.numel() for parameter in parameters) < _ONE_THREAD:
            torch.set_num_threads(1)
        for epoch in range(1, options.epochs + 1):
            if options.schedule == "cosine":
                fraction = (epoch - 1) / options.epochs
                optimizer.param_groups[0]["lr"] = (
                    options.learning_rate * (1 + math.cos(math.pi * fraction)) / 2
                )
            t = grid
            if noise:
                moved = torch.randn(grid.shape, generator=generator, dtype=dtype)
                moved.mul_(noise).add_(offsets)
                # Reflection at both ends, as often as needed.
                t = end - moved.remainder_(2 * length).sub_(length).abs_()
            optimizer.zero_grad(set_to_none=True)
            loss = objective(t, *trial(t))
            loss.backward()
            optimizer.step()
            losses.append(loss.item())
            if not math.isfinite(losses[-1]):
                stopped = "diverged"
                break
            record = losses[-1] < 0.9 * lowest
            lowest = min(lowest, losses[-1])
            if record or epoch % _CHECK_EVERY == 0 or epoch == options.epochs:
                fixed_loss = check(epoch)
                if options.target_loss is not None and fixed_loss <= options.target_loss:
                    stopped = "target"
                    break
    except KeyboardInterrupt:
        stopped = "interrupted"
    finally:
        torch.set_num_threads(threads)
    with torch.no_grad():
        for parameter, value in zip(parameters, best, strict=True):
            parameter.copy_(value)
    columns = np.array(checks, dtype=float).reshape(-1, 4).T
    return Training(
        history=History(np.array(losses), columns[0].astype(int), *columns[1:]),
        points=options.points,
        epochs=len(losses),
        best_loss=best_loss,
        reached_target=stopped == "target",
        stopped=stopped,
        seconds=time.perf_counter() - began,
        cpu_seconds=time.process_time() - cpu_began,
    )


def _positive(value: float) -> bool:
    return isinstance(value, (int, float)) and math.isfinite(value) and value > 0


def _require(holds: bool, name: str, value: object, wanted: str) -> None:
    if not holds:
        raise InputError(f"{name}={value!r} cannot be used; give {wanted}")
