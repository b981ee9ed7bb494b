"""Layers of a network with the derivative of their inputs along one direction, and sensitivities.

With x the input of a layer and xd its derivative, and u, v the sensitivities of a row of residuals
to the layer's pre-activations and to their derivatives, the derivative of the row is u x^T + v xd^T
in the layer's matrix and u in its bias.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from hamsym.networks.network import ACTIVATIONS


@dataclass(frozen=True)
class Layer:
    """A layer at K points: its matrix, its input x, and the input's derivative xd.

    ``slope`` is the activation's derivative f'(a), ``bend`` f''(a) a', both (K, neurons); both None
    for the last layer, which is linear.
    """

    matrix: Tensor
    x: Tensor
    xd: Tensor
    slope: Tensor | None
    bend: Tensor | None


def forward(
    layers: Sequence[tuple[Tensor, Tensor]], activation: str, x: Tensor, xd: Tensor
) -> list[Layer]:
    """Return the layers at inputs x of the network, with their rates xd; shapes (K, inputs)."""
    function = ACTIVATIONS[activation]
    *hidden, (last, _) = layers
    found = []
    for matrix, bias in hidden:
        a, a_dot = x @ matrix.T + bias, xd @ matrix.T
        h = function.value(a)
        slope = function.slope(a, h)
        found.append(Layer(matrix, x, xd, slope, function.curvature(h, slope) * a_dot))
        x, xd = h, slope * a_dot
    return [*found, Layer(last, x, xd, None, None)]


def backward(layers: Sequence[Layer], u: Tensor, v: Tensor) -> list[tuple[Layer, Tensor, Tensor]]:
    """Return sensitivities to pre-activations and their derivatives, last layer first.

    - u, v: Those to the outputs and to their derivatives, shape (..., K, outputs).
    """
    found = []
    for layer in reversed(layers):
        if layer.slope is not None and layer.bend is not None:
            u, v = u * layer.slope + v * layer.bend, v * layer.slope
        found.append((layer, u, v))
        u, v = u @ layer.matrix, v @ layer.matrix
    return found


def weight_rows(sensitivities: Sequence[tuple[Layer, Tensor, Tensor]]) -> Tensor:
    """Return the derivatives of rows in all weights, shape (..., K, weights), in their order.

    - sensitivities: As :func:`backward` returns them.
    """
    parts = []
    for layer, u, v in sensitivities:
        matrix = u.unsqueeze(-1) * layer.x.unsqueeze(-2) + v.unsqueeze(-1) * layer.xd.unsqueeze(-2)
        parts += [u, matrix.flatten(-2)]
    return torch.cat(parts[::-1], -1)
