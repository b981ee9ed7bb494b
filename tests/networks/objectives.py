"""Objectives of tests: the squares of any residual."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

from hamsym.networks.objective import Objective


def squares_of(residual: Callable[[Tensor, Tensor, Tensor], Tensor], **others: Any) -> Objective:
    """The mean squared 2-norm of a residual, with derivatives by automatic differentiation."""

    def loss(t: Tensor, z: Tensor, dz: Tensor) -> Tensor:
        return residual(t, z, dz).square().sum(-1).mean()

    def slopes(t: Tensor, z: Tensor, dz: Tensor) -> tuple[Tensor, Tensor]:
        with torch.enable_grad():
            z, dz = z.requires_grad_(), dz.requires_grad_()
            rows = residual(t, z, dz)
            pairs = [
                torch.autograd.grad(
                    rows[:, i].sum(), (z, dz), retain_graph=True, materialize_grads=True
                )
                for i in range(rows.shape[1])
            ]
        in_z, in_dz = zip(*pairs, strict=True)
        return torch.stack(in_z, 1), torch.stack(in_dz, 1)

    return Objective(residual, **{"loss": loss, "rows": residual, "slopes": slopes, **others})
