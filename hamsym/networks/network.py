"""Fully connected networks of one input, with their derivative in it.

One forward pass computes the value and, in forward mode, the derivative.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import torch
from torch import Tensor

from hamsym.support.suggestions import require_known
from hamsym.support.validation import require_widths


@dataclass(frozen=True)
class _Activation:
    """An activation and its first two derivatives, from its value where that is cheaper."""

    value: Callable[..., Tensor]
    slope: Callable[[Tensor, Tensor], Tensor]  # of pre-activation a and value h
    curvature: Callable[[Tensor, Tensor], Tensor]  # of value h and slope


#: Activation functions by name.
ACTIVATIONS: dict[str, _Activation] = {
    "sin": _Activation(torch.sin, lambda a, h: torch.cos(a), lambda h, slope: -h),
    "sigmoid": _Activation(
        torch.sigmoid, lambda a, h: h * (1 - h), lambda h, slope: slope * (1 - 2 * h)
    ),
    "tanh": _Activation(torch.tanh, lambda a, h: 1 - h * h, lambda h, slope: -2 * h * slope),
}


class _Jet(torch.autograd.Function):
    """(N, dN/ds) of a fully connected network, with an explicit gradient of both.

    Automatic differentiation of the same computation records and visits about four times as many
    operations, and at the paper's sizes their number determines the cost of an epoch. The first
    K rows of each matrix x are values, the last K rows derivatives in s, so that a layer is one
    product.
    """

    @staticmethod
    def forward(
        ctx: Any, activation: _Activation, sizes: tuple[int, ...], s: Tensor, theta: Tensor
    ) -> Any:
        count = s.shape[0]
        (first, bias), *layers = layers_of(theta, sizes)
        a = torch.addcmul(bias, s.unsqueeze(1), first.T)
        a_dot = first.T.expand_as(a)
        saved = []
        for matrix, shift in layers:
            x = a.new_empty((2 * count, a.shape[1]))
            h = x[:count]
            activation.value(a, out=h)
            slope = activation.slope(a, h)
            torch.mul(slope, a_dot, out=x[count:])
            saved.append((x, slope, a_dot))
            product = x @ matrix.T
            a, a_dot = product[:count].add_(shift), product[count:]
        ctx.activation, ctx.sizes, ctx.saved, ctx.matrices = (
            activation,
            sizes,
            saved,
            [matrix for matrix, _ in layers],
        )
        ctx.save_for_backward(s, theta)  # theta too, so that torch detects a change before backward
        return a, a_dot

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_value: Tensor, grad_rate: Tensor) -> Any:
        s, theta = ctx.saved_tensors
        count = s.shape[0]
        gradient = torch.empty_like(theta)
        (first, first_bias), *layers = layers_of(gradient, ctx.sizes)
        upstream = torch.cat((grad_value, grad_rate))
        for (into, into_bias), matrix, (x, slope, a_dot) in zip(
            reversed(layers), reversed(ctx.matrices), reversed(ctx.saved), strict=True
        ):
            torch.mm(upstream.T, x, out=into)
            torch.sum(upstream[:count], 0, out=into_bias)
            towards = upstream @ matrix
            h, to_value, to_rate = x[:count], towards[:count], towards[count:]
            # With h = f(a) and h_dot = f'(a) a_dot, f'' couples the two halves.
            curvature = ctx.activation.curvature(h, slope).mul_(a_dot).mul_(to_rate)
            upstream = torch.empty_like(towards)
            torch.addcmul(curvature, to_value, slope, out=upstream[:count])
            torch.mul(to_rate, slope, out=upstream[count:])
        values = upstream[:count]
        torch.add(s @ values, upstream[count:].sum(0), out=first[:, 0])
        torch.sum(values, 0, out=first_bias)
        return None, None, None, gradient


def layers_of(theta: Tensor, sizes: tuple[int, ...]) -> list[tuple[Tensor, Tensor]]:
    """Return (matrix, bias) of each layer, as views into the flat vector of all weights."""
    layers, start = [], 0
    for inputs, neurons in pairwise(sizes):
        middle, end = start + inputs * neurons, start + (inputs + 1) * neurons
        layers.append((theta[start:middle].view(neurons, inputs), theta[middle:end]))
        start = end
    return layers


class Network(torch.nn.Module):
    """A fully connected network from one input to ``outputs`` outputs, with its derivative.

    All outputs share the hidden layers.

    - hidden: Neurons of each hidden layer, at least one layer.
    - activation: {"sin", "sigmoid", "tanh"}.
    - frequency: Weights of the first layer start uniform within +- this, its shifts within +- pi,
      further hidden layers within sqrt(6 / inputs). By default all start as torch's own linear
      layers do, uniform within 1/sqrt(inputs).
    - generator: Source of the initial weights.
    - dtype: By default float64.

    Examples
    --------
    >>> network = Network(2, hidden=(50, 50))
    >>> value, rate = network(torch.linspace(0, 1, 5, dtype=torch.float64))
    >>> value.shape, rate.shape
    (torch.Size([5, 2]), torch.Size([5, 2]))
    """

    def __init__(
        self,
        outputs: int,
        hidden: Sequence[int] = (50, 50),
        activation: str = "sin",
        *,
        frequency: float | None = None,
        generator: torch.Generator | None = None,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        super().__init__()
        require_known(activation, ACTIVATIONS, "an activation")
        self.activation, self.frequency = activation, frequency
        require_widths(hidden)
        self.sizes = (1, *hidden, outputs)
        count = weights_of(self.sizes)
        #: All weights as one vector, layer by layer, each matrix before its bias.
        self.theta = torch.nn.Parameter(torch.empty(count, dtype=dtype, device="cpu"))
        self.draw(generator)

    @torch.no_grad()
    def draw(self, generator: torch.Generator | None = None) -> None:
        """Draw new random weights."""
        last = len(self.sizes) - 2
        for position, (matrix, bias) in enumerate(self.layers):
            neurons, inputs = matrix.shape
            within = [1 / math.sqrt(inputs)] * 2  # of the matrix and of the bias
            if self.frequency is not None and position == 0:
                within = [self.frequency, math.pi]
            elif self.frequency is not None and position < last:
                within[0] = math.sqrt(6 / inputs)
            uniform = torch.rand(
                (inputs + 1) * neurons, generator=generator, dtype=self.theta.dtype, device="cpu"
            )
            uniform = 2 * uniform - 1
            matrix.copy_(within[0] * uniform[: inputs * neurons].view_as(matrix))
            bias.copy_(within[1] * uniform[inputs * neurons :])

    @property
    def layers(self) -> list[tuple[Tensor, Tensor]]:
        """(matrix, bias) of each layer, shapes (neurons, inputs) and (neurons,)."""
        return layers_of(self.theta, self.sizes)

    def forward(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return N(s) and dN/ds for s of shape (K,); each of shape (K, outputs)."""
        activation = ACTIVATIONS[self.activation]
        if has_explicit_gradient(self.theta, s):
            value, rate = _Jet.apply(activation, self.sizes, s, self.theta)
            return value, rate
        *hidden, (last, last_bias) = self.layers
        h, h_dot = s.unsqueeze(-1), torch.ones_like(s).unsqueeze(-1)
        for matrix, bias in hidden:
            a = torch.nn.functional.linear(h, matrix, bias)
            h = activation.value(a)
            h_dot = activation.slope(a, h) * (h_dot @ matrix.T)
        return torch.nn.functional.linear(h, last, last_bias), h_dot @ last.T


class ComponentNetworks(torch.nn.Module):
    """One network with a single output per component, in place of one with shared weights."""

    def __init__(self, networks: Sequence[Network]) -> None:
        super().__init__()
        self.networks = torch.nn.ModuleList(networks)
        self.activation = networks[0].activation

    def forward(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return values and derivatives as :meth:`Network.forward`, one column per component."""
        values, rates = zip(*(network(s) for network in self.networks), strict=True)
        return torch.cat(values, dim=-1), torch.cat(rates, dim=-1)


def weights_of(sizes: Sequence[int]) -> int:
    """Return the number of weights of a network with layers of these sizes."""
    return sum((inputs + 1) * neurons for inputs, neurons in pairwise(sizes))


def has_explicit_gradient(weights: Tensor, s: Tensor) -> bool:
    """Return whether only the gradient in the weights is needed, which has an explicit form."""
    return torch.is_grad_enabled() and weights.requires_grad and not s.requires_grad
