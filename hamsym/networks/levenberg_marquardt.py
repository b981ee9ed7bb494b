"""Levenberg-Marquardt for trial solutions: least squares with more weights than residuals.

With J the derivative of the m K residual rows r in the weights, the step is -J^T y with
(J J^T + mu) y = r: a system of the size of the residuals. J itself is never formed. Each layer of a
network contributes to J J^T sums of elementwise products of small Gram matrices: with x the input
of the layer and xd its derivative in s, and U, V the sensitivities of the rows to a layer's
pre-activations and to their derivatives,

    (U U^T) (x x^T + 1) + (U V^T) (x xd^T) + (V U^T) (xd x^T) + (V V^T) (xd xd^T).

A second-order correction along the step, geodesic acceleration (Transtrum & Sethna 2012), costs
one more solve with the same factor and saves most of the iterations.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.networks.module_rates import ModuleRates
from hamsym.networks.module_trial import ModuleTrial
from hamsym.networks.network import layers_of
from hamsym.networks.objective import Objective
from hamsym.networks.optimizers import QuasiNewton
from hamsym.networks.sensitivities import Layer, backward, forward
from hamsym.networks.trial import TrialSolution

# Damping relative to the mean diagonal of J J^T; the least in units of the type's precision,
# 1e-14 in float64.
_MU_FIRST, _MU_LEAST = 1e-3, 1e-14 / torch.finfo(torch.float64).eps
_ATTEMPTS = 10
_FEWEST_POINTS = 60
_PROBE = 0.1  # fraction of the step over which its curvature is measured


class LevenbergMarquardt(QuasiNewton):
    """Levenberg-Marquardt with new random points in every iteration.

    Raise InputError if a trial solution has no known derivative in its weights, or the objective
    has regularizers, which have no least-squares form.

    The collocation points are those on the whole span; short spans of sequential training have
    fewer.
    """

    _trial: TrialSolution | ModuleTrial
    check_every = 5
    _PATIENCE = 3  # iterations in a row without an acceptable step that count as a stall

    def bind(
        self, trial: torch.nn.Module, objective: Objective, generator: torch.Generator
    ) -> None:
        if objective.regularizers:
            raise InputError(
                "regularizers have no least-squares form; use method 'adam' or 'lbfgs' with them"
            )
        if not isinstance(trial, (TrialSolution, ModuleTrial)):
            raise InputError("the trial solution is not a TrialSolution; use Adam or LBFGS")
        super().bind(trial, objective, generator)
        self._weights = trial.weights
        self._mu_least = _MU_LEAST * torch.finfo(self._dtype).eps

    def reset(self) -> None:
        self._mu, self._failures = _MU_FIRST, 0

    @torch.no_grad()
    def iterate(self, span: tuple[float, float], share: float, done: float) -> tuple[float, float]:
        count = max(min(_FEWEST_POINTS, self.points), round(share * self.points))
        t = self._drawn(span, count)
        z, dz = self._trial(t)
        rows = self._objective.rows(t, z, dz)
        kind: Any = ModuleRates if isinstance(self._trial, ModuleTrial) else _Linearised
        rates = kind(self._trial, t, *self._objective.slopes(t, z, dz))
        gram = rates.gram()
        # Rows in the order (component, point), as in the Gram matrix.
        residual = rows.T.reshape(-1)
        square = float(residual @ residual)
        before = [weights.clone() for weights in self._weights]
        diagonal = gram.diagonal().clone()
        unit = float(diagonal.mean())
        for _ in range(_ATTEMPTS):
            damping = self._mu * unit
            gram.diagonal().copy_(diagonal + damping)
            factor, failed = torch.linalg.cholesky_ex(gram)
            if failed:
                self._mu *= 10
                continue
            y = _solved(factor, residual)
            step = [-part for part in rates.transposed(y)]
            # The derivative of the rows along the step needs no derivative: J J^T y = r - mu y.
            along = damping * y - residual
            self._move(before, step, _PROBE)
            bend = (2 / _PROBE) * ((self._residual(t) - residual) / _PROBE - along)
            second = [-0.5 * part for part in rates.transposed(_solved(factor, bend))]
            if _norm(second) < 0.375 * _norm(step):
                step = [one + two for one, two in zip(step, second, strict=True)]
            self._move(before, step, 1.0)
            new = self._residual(t)
            left = float(new @ new)
            if left < square:
                predicted = square - damping**2 * float(y @ y)
                good = square - left > 0.25 * predicted
                self._mu = max(self._mu / 4, self._mu_least) if good else 2 * self._mu
                self._failures = 0
                break
            self._mu *= 3
        else:
            self._move(before, before, 0.0)
            self._failures += 1
        return square / count, float(dz.square().sum(-1).mean())

    def _residual(self, t: Tensor) -> Tensor:
        return self._objective.rows(t, *self._trial(t)).T.reshape(-1)

    def _move(self, start: list[Tensor], step: list[Tensor], length: float) -> None:
        for weights, first, part in zip(self._weights, start, step, strict=True):
            weights.copy_(first + length * part)


def _solved(factor: Tensor, right: Tensor) -> Tensor:
    return torch.cholesky_solve(right.unsqueeze(1), factor).squeeze(1)


def _norm(parts: list[Tensor]) -> float:
    return float(torch.cat([part.reshape(-1) for part in parts]).norm())


class _Linearised:
    """Products with the derivative J of the rows (component, point) in the weights."""

    def __init__(self, trial: TrialSolution, t: Tensor, in_z: Tensor, in_dz: Tensor) -> None:
        networks = trial.parts
        self._to_value, self._to_rate = trial.to_network(t, in_z, in_dz)
        s = trial.envelope_at(t)[0].unsqueeze(1)
        ones = torch.ones_like(s)
        self._layers = [
            # Copies: the weights are moved before the last product.
            forward(layers_of(network.theta.clone(), network.sizes), network.activation, s, ones)
            for network in networks
        ]
        outputs = [network.sizes[-1] for network in networks]
        ends = accumulate(outputs)
        self._columns = [slice(e - n, e) for e, n in zip(ends, outputs, strict=True)]

    def gram(self) -> Tensor:
        """Return J J^T; only the blocks on and below the diagonal are filled."""
        m, count, _ = self._to_value.shape
        gram = self._to_value.new_zeros(m * count, m * count)
        for layers, columns in zip(self._layers, self._columns, strict=True):
            sensitivities = backward(
                layers, self._to_value[..., columns], self._to_rate[..., columns]
            )
            for layer, u, v in sensitivities:
                _add_gram(gram, layer, u, v)
        return gram

    def transposed(self, y: Tensor) -> list[Tensor]:
        """Return J^T y, one vector for each network."""
        weights = y.view(*self._to_value.shape[:2], 1)
        value, rate = (weights * self._to_value).sum(0), (weights * self._to_rate).sum(0)
        result = []
        for layers, columns in zip(self._layers, self._columns, strict=True):
            parts = []
            for layer, u, v in backward(layers, value[:, columns], rate[:, columns]):
                parts += [u.sum(0), (u.T @ layer.x + v.T @ layer.xd).reshape(-1)]
            result.append(torch.cat(parts[::-1]))
        return result


def _add_gram(gram: Tensor, layer: Layer, u: Tensor, v: Tensor) -> None:
    blocks, count, _ = u.shape
    views = gram.view(blocks, count, blocks, count)
    if layer.x.shape[1] == 1:
        # With one input the rows of J are shorter than the sums of products.
        rows = torch.cat((u * layer.x + v * layer.xd, u), -1)
        for i in range(blocks):
            for j in range(i + 1):
                views[i, :, j].addmm_(rows[i], rows[j].T)
        return
    values = torch.addmm(u.new_ones(1, 1), layer.x, layer.x.T)
    mixed, rates = layer.x @ layer.xd.T, layer.xd @ layer.xd.T
    for i in range(blocks):
        for j in range(i + 1):
            block = views[i, :, j]
            block.addcmul_(u[i] @ u[j].T, values)
            block.addcmul_(v[i] @ v[j].T, rates)
            block.addcmul_(u[i] @ v[j].T, mixed)
            block.addcmul_(v[i] @ u[j].T, mixed.T)
