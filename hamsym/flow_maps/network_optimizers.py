"""Levenberg-Marquardt and Adam for a window, with rows spread over processes.

Each process has its own points. Gram matrices and gradients are summed over the processes, so that
all of them take the same step.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import torch
from torch import Tensor

from hamsym.flow_maps.network_residual import Points, Residual
from hamsym.flow_maps.workers import Workers
from hamsym.support.validation import is_positive

__all__ = ["Adam", "LevenbergMarquardt", "WindowOptimizer"]

_MU_FIRST, _MU_LEAST = 1e-3, 1e-15  # relative to the diagonal of J^T J
_FLOOR = 1e-6  # of the mean of this diagonal, added to it
_ATTEMPTS = 10
_FAILURES = 3  # iterations in a row without an acceptable step that count as a stall
_PROBE = 0.1  # fraction of the step over which its curvature is measured
_BEND = 0.375  # largest correction by the curvature, relative to the step


class WindowOptimizer(Protocol):
    """An optimizer of the weights of one window."""

    check_every: int  # iterations between evaluations at the held-out points

    def iterate(self, theta: Tensor, points: Points, done: float) -> tuple[float, float]:
        """Change theta in place; ``done`` is the fraction of all iterations that are done.

        Returns
        -------
        (float, float)
            Mean squares of the rows before the step and of dz^/dt, over all processes.
        """

    @property
    def stalled(self) -> bool:
        """Whether further iterations would not lower the loss."""

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        """Return the state that the next iterations depend on, as tensors and JSON values."""

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        """Restore a state returned by :meth:`state`."""


class LevenbergMarquardt:
    """Levenberg-Marquardt with more rows than weights: (J^T J + mu D) step = -J^T r.

    D is the diagonal of J^T J, as Marquardt chose it, since readouts and inner weights differ in
    size. As in :mod:`hamsym.networks.levenberg_marquardt`, a correction of second order along the
    step (geodesic acceleration) costs one more solve with the same factor.
    """

    check_every = 5

    def __init__(self, residual: Residual, workers: Workers) -> None:
        self._residual, self._workers = residual, workers
        self._mu, self._failures = _MU_FIRST, 0

    @property
    def stalled(self) -> bool:
        """Whether several iterations in a row found no acceptable step."""
        return self._failures >= _FAILURES

    def iterate(self, theta: Tensor, points: Points, done: float) -> tuple[float, float]:
        workers, before = self._workers, theta.clone()
        rows, motion = self._residual.rows(theta, points)
        rates = self._residual.derivative(theta, points)
        gram, slope = rates.gram(), rates.transposed(rows)
        sums = torch.stack((rows.square().sum(), motion.square().sum(), _count(rows)))
        workers.sum(gram, slope, sums)
        square, moved, count = sums.tolist()
        diagonal = gram.diagonal().clone()
        unit = diagonal + _FLOOR * diagonal.mean()
        for _ in range(_ATTEMPTS):
            damping = self._mu * unit
            gram.diagonal().copy_(diagonal + damping)
            factor, failed = torch.linalg.cholesky_ex(gram)
            if failed:
                self._mu *= 10
                continue
            step = -_solved(factor, slope)
            theta.copy_(before + _PROBE * step)
            # J^T of the rows' second derivative along the step.
            change = (self._residual.rows(theta, points)[0] - rows) / _PROBE
            bend = rates.transposed(change)
            workers.sum(bend)
            along = -slope - damping * step  # J^T J step
            second = -_solved(factor, (bend - along) / _PROBE)
            if float(second.norm()) < _BEND * float(step.norm()):
                step = step + second
            theta.copy_(before + step)
            workers.share(theta)
            left = self._residual.rows(theta, points)[0].square().sum()
            workers.sum(left)
            if float(left) < square:
                predicted = -float(step @ slope)
                good = square - float(left) > 0.25 * predicted
                self._mu = max(self._mu / 4, _MU_LEAST) if good else 2 * self._mu
                self._failures = 0
                break
            self._mu *= 3
        else:
            theta.copy_(before)
            self._failures += 1
        return square / count, moved / count

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        return {}, {"mu": self._mu, "failures": self._failures}

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        mu, failures = values["mu"], values["failures"]
        if tensors or not (is_positive(mu) and isinstance(failures, int)):
            raise ValueError("its damping does not belong to this method")
        self._mu, self._failures = mu, failures


class Adam:
    """Adam (Kingma & Ba 2015); the learning rate falls to zero along half a cosine."""

    check_every = 50
    stalled = False

    def __init__(self, residual: Residual, workers: Workers, learning_rate: float) -> None:
        self._residual, self._workers, self._rate = residual, workers, learning_rate
        self._moments: dict[str, Tensor] = {}

    def iterate(self, theta: Tensor, points: Points, done: float) -> tuple[float, float]:
        rows, motion = self._residual.rows(theta, points)
        slope = self._residual.derivative(theta, points).transposed(rows)
        sums = torch.stack((rows.square().sum(), motion.square().sum(), _count(rows)))
        self._workers.sum(slope, sums)
        square, moved, count = sums.tolist()
        theta.grad = (2 / count) * slope
        optimizer = torch.optim.Adam([theta], lr=self._rate * 0.5 * (1 + math.cos(math.pi * done)))
        if self._moments:
            optimizer.state[theta] = self._moments
        optimizer.step()
        self._moments = optimizer.state[theta]
        theta.grad = None
        self._workers.share(theta)
        return square / count, moved / count

    def state(self) -> tuple[dict[str, Tensor], dict[str, Any]]:
        return dict(self._moments), {}

    def restore(self, tensors: dict[str, Tensor], values: dict[str, Any]) -> None:
        if values or set(tensors) - {"step", "exp_avg", "exp_avg_sq"}:
            raise ValueError("its moments do not belong to this method")
        self._moments = dict(tensors)


def _count(rows: Tensor) -> Tensor:
    return rows.new_tensor(float(rows.numel()))


def _solved(factor: Tensor, right: Tensor) -> Tensor:
    return torch.cholesky_solve(right.unsqueeze(1), factor).squeeze(1)
