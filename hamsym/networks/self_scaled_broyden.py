"""The self-scaled Broyden method with the whole matrix, with a strong Wolfe line search.

With s the step, y the change of the gradient, H the approximation of the inverse of the Hessian and
v = s / (s.y) - H y / (y.H y), the update is

    H <- (H - H y (H y)^T / (y.H y) + phi (y.H y) v v^T) / tau + s s^T / (s.y).

BFGS is phi = tau = 1. Here tau and phi follow from b = s.B s / (s.y), B the inverse of H, and
h = y.H y / (s.y) as in the method that Urban, Stefanou & Pons (2025) call SSBroyden2; the formulas
are of Al-Baali (1998) and of Al-Baali & Khalfan (2005).
"""

from __future__ import annotations

import math
import warnings
from typing import NamedTuple

import numpy as np
import torch
from scipy.optimize import line_search
from torch import Tensor
from torch.nn.utils import parameters_to_vector

from hamsym.errors import InputError
from hamsym.networks.objective import Objective
from hamsym.networks.optimizers import QuasiNewton

_LARGEST = 20_000  # weights: the matrix takes 3.2 GB


class InverseHessian:
    """Approximation of the inverse of a Hessian; a multiple of the identity at the start.

    - size: Number n of variables.
    - scale: Multiple of the identity.
    """

    def __init__(self, size: int, scale: float = 1.0) -> None:
        self.matrix = torch.zeros(size, size, dtype=torch.float64)
        self.matrix.diagonal().fill_(scale)

    def __matmul__(self, vector: Tensor) -> Tensor:
        return self.matrix @ vector

    def update(self, step: Tensor, change: Tensor, curvature: float) -> bool:
        """Fit the matrix, in place, to a step and the change of the gradient along it.

        - step, change: s and y, shape (n,).
        - curvature: s.B s; after a step of length alpha in the direction -H g it is -alpha s.g.
        - returns: False if the curvature measured or assumed is not positive; the matrix is the
          same then.
        """
        product = self @ change
        measured, inner = float(step @ change), float(change @ product)
        if not (0 < measured < math.inf and 0 < inner < math.inf and 0 < curvature < math.inf):
            return False
        b, h = curvature / measured, inner / measured
        tau, phi = _coefficients(b, h, len(step))
        if not (0 < tau < math.inf and abs(phi) < math.inf):
            return False
        # The update as [s, H y] C [s, H y]^T, which one pass through the matrix adds.
        mixed = -phi / (tau * measured)
        pair = torch.stack((step, product))
        small = torch.tensor(
            [[(1 + phi * h / tau) / measured, mixed], [mixed, (phi - 1) / (tau * inner)]],
            dtype=torch.float64,
        )
        self.matrix.addmm_(pair.T, small @ pair, beta=1 / tau)
        return True


def _coefficients(b: float, h: float, size: int) -> tuple[float, float]:
    """Return tau and phi of SSBroyden2 (Urban, Stefanou & Pons 2025, eqs. 13 to 23)."""
    # a >= 0 by the inequality of Cauchy and Schwarz; where it is 0, v is, and phi has no effect.
    a = max(b * h - 1, np.finfo(float).eps)
    least = min(1.0, h * (1 - math.sqrt(a / (1 + a))))
    theta = max((least - 1) / a, min(1 / least, (1 - b) / b))
    sigma = 1 + theta * a
    scaled = sigma ** (-1 / max(size - 1, 1))
    if theta <= 0:
        tau = min(min(1.0, 1 / b) * scaled, sigma)
    else:
        tau = min(1.0, 1 / b) * min(scaled, 1 / theta)
    return tau, (1 - theta) / sigma


class _Evaluation(NamedTuple):
    """Loss, its gradient and the mean square of dz/dt at weights."""

    weights: np.ndarray
    loss: float
    gradient: np.ndarray
    motion: float


class SelfScaledBroyden(QuasiNewton):
    """Self-scaled Broyden method in float64, with memory and time per iteration of O(weights^2).

    The points are constant for ``refresh`` iterations. The matrix is kept when new ones are drawn,
    and begins again where the line search fails.

    Raise InputError if the trial solution has more than 20,000 weights.
    """

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        super().bind(trial, objective, generator)
        self._size = sum(parameter.numel() for parameter in self._parameters)
        if self._size > _LARGEST:
            raise InputError(
                f"the network has {self._size:,} weights, more than the {_LARGEST:,} whose matrix "
                "'ssbroyden' can keep; use 'lbfgs', or fewer neurons"
            )

    def reset(self) -> None:
        self._inverse: InverseHessian | None = None
        self._t: Tensor | None = None
        self._age, self._failures, self._share = 0, 0, 0.0
        self._last: _Evaluation | None = None

    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        if self._t is None or self._age >= self.refresh or share != self._share:
            self._t = self._drawn(span)
            self._age, self._share, self._last = 0, share, None
        start = self._evaluation(parameters_to_vector(self._parameters).detach().numpy())
        gradient = torch.from_numpy(start.gradient)
        if self._inverse is None:
            # The first step has at most unit length.
            self._inverse = InverseHessian(
                self._size, 1 / max(1.0, float(np.linalg.norm(start.gradient)))
            )
        direction = -(self._inverse @ gradient)
        self._age += 1
        found = self._searched(start, direction.numpy())
        if found is None:
            self._put(start.weights)
            self._inverse = self._t = None
            self._failures += 1
        else:
            length, end = found
            self._put(end.weights)
            self._failures = 0
            self._inverse.update(
                length * direction,
                torch.from_numpy(end.gradient) - gradient,
                -(length**2) * float(direction @ gradient),
            )
        return start.loss, start.motion

    def _searched(
        self, start: _Evaluation, direction: np.ndarray
    ) -> tuple[float, _Evaluation] | None:
        """Return the length of a step that fulfils the strong Wolfe conditions, and its end."""
        if not start.gradient @ direction < 0:  # by round-off
            return None

        def loss(weights: np.ndarray) -> float:
            value = self._evaluation(weights).loss
            return math.inf if math.isnan(value) else value

        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")  # a search that fails returns None
            length = line_search(
                loss,
                lambda weights: self._evaluation(weights).gradient,
                start.weights,
                direction,
                start.gradient,
                start.loss,
            )[0]
        if length is None:
            return None
        end = self._evaluation(start.weights + length * direction)
        return (float(length), end) if end.loss < start.loss else None

    def _evaluation(self, weights: np.ndarray) -> _Evaluation:
        """Evaluate at weights, or return the last evaluation if it was there."""
        if self._last is not None and np.array_equal(self._last.weights, weights):
            return self._last
        t = self._t
        assert t is not None  # the caller has drawn points
        self._put(weights)
        z, dz = self._trial(t)
        loss = self._objective(t, z, dz)
        parts = torch.autograd.grad(loss, self._parameters)
        self._last = _Evaluation(
            weights.copy(),
            float(loss.detach()),
            parameters_to_vector(parts).numpy(),
            float(dz.detach().square().sum(-1).mean()),
        )
        return self._last

    @torch.no_grad()
    def _put(self, weights: np.ndarray) -> None:
        start = 0
        for parameter in self._parameters:
            end = start + parameter.numel()
            parameter.copy_(torch.from_numpy(weights[start:end]).view_as(parameter))
            start = end
