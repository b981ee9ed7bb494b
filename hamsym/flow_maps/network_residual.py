"""Residual of Hamilton's equations for a network over a domain, and its derivatives in the weights.

With z^ = z_a + f N, the rows are (dz^/dt - J grad H(z^)) / unit at points (s, y), where the unit of
a component is its size divided by the length of the window. Their derivative J in the weights is
exact: sensitivities of the rows to the outputs, which contain the Hessian of H, are passed back
through the layers.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

import numpy as np
import torch
from scipy.linalg.blas import dsyrk
from scipy.stats import qmc
from torch import Tensor

from hamsym.flow_maps.domain import Domain
from hamsym.flow_maps.network_map import NetworkMap
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.network import layers_of, weights_of
from hamsym.networks.sensitivities import backward, forward

__all__ = ["Points", "Residual", "Window"]

_CHUNK = 4_000_000  # entries of J at once


class Window:
    """A network over a domain and a time, of the form that :class:`NetworkMap` evaluates.

    Parameters
    ----------
    domain : Domain
    sample : callable
        Scaled inputs of the whole box, in [-1, 1], -> inputs of this window, shape (n, d).
    begin, end : float
    hidden : tuple of int
    envelope : {"exponential", "linear"}
    tau : float
        Positive; the sign of the time is that of end - begin.
    """

    def __init__(
        self,
        domain: Domain,
        sample: Callable[[np.ndarray], np.ndarray],
        begin: float,
        end: float,
        hidden: tuple[int, ...],
        envelope: str,
        tau: float,
    ) -> None:
        self.domain, self.sample, self.begin, self.end = domain, sample, begin, end
        self.envelope, self.tau = envelope, math.copysign(tau, end - begin)
        self.sizes = (1 + len(domain), *hidden, len(domain.offset))

    @property
    def count(self) -> int:
        """Number of weights."""
        return weights_of(self.sizes)

    def first_weights(self, frequency: float, seed: list[int]) -> Tensor:
        """Return random weights: the first layer within +- frequency, its shifts within +- pi.

        Those of other hidden layers are within sqrt(6 / inputs), those of the last one are zero, so
        that the training begins with constant solutions.
        """
        generator = np.random.default_rng(seed)
        theta = torch.zeros(self.count, dtype=torch.float64)
        *hidden, _ = layers_of(theta, self.sizes)
        for position, (matrix, bias) in enumerate(hidden):
            within = math.sqrt(6 / matrix.shape[1]) if position else frequency
            matrix.copy_(torch.from_numpy(generator.uniform(-within, within, matrix.shape)))
            bias.copy_(torch.from_numpy(generator.uniform(-math.pi, math.pi, bias.shape)))
        return theta

    def map(self, theta: Tensor) -> NetworkMap:
        """Return the network with these weights."""
        domain = self.domain
        layers = [
            (matrix.numpy().copy(), bias.numpy().copy())
            for matrix, bias in layers_of(theta.detach().cpu(), self.sizes)
        ]
        return NetworkMap(
            self.begin,
            self.end - self.begin,
            self.tau,
            self.envelope,
            domain.scaling,
            domain.shift,
            domain.selection,
            domain.offset,
            domain.start_degrees,
            domain.start,
            layers,
        )


class Points:
    """Collocation points of a window, with all that does not depend on the weights.

    Parameters
    ----------
    window : Window
    count : int
    share : float
        Fraction of the window, from its begin, in which they are.
    seed : list of int
    device : torch.device
    """

    def __init__(
        self, window: Window, count: int, share: float, seed: list[int], device: torch.device
    ) -> None:
        domain = window.domain
        length = window.end - window.begin
        uniform = qmc.LatinHypercube(1 + len(domain), rng=np.random.default_rng(seed)).random(count)
        # Denser towards the faces of the box, where networks are least certain.
        inputs = window.sample(np.sin(np.pi * (uniform[:, 1:] - 0.5)))
        y = inputs @ domain.scaling.T + domain.shift
        times = share * uniform[:, 0] * length
        x = np.column_stack((2 * times / length - 1, y))
        xd = np.zeros_like(x)
        xd[:, 0] = 2 / length
        if window.envelope == "linear":
            f, rate = times / window.tau, np.full(count, 1 / window.tau)
        else:
            f = -np.expm1(-times / window.tau)
            rate = (1 - f) / window.tau

        def tensor(array: np.ndarray) -> Tensor:
            return torch.from_numpy(np.ascontiguousarray(array, dtype=float)).to(device)

        self.t = tensor(window.begin + times)
        self.x, self.xd = tensor(x), tensor(xd)
        self.f, self.rate = tensor(f)[:, None], tensor(rate)[:, None]
        self.start = tensor(domain.start_states(inputs))
        self.values = {name: tensor(value) for name, value in domain.values(inputs).items()}

    def __len__(self) -> int:
        return len(self.t)


class Residual:
    """Rows of residuals of a window as functions of its weights.

    Parameters
    ----------
    window : Window
    H : Hamiltonian
    scale : numpy.ndarray
        Size of each component, shape (dim,).
    """

    def __init__(
        self, window: Window, H: Hamiltonian, scale: np.ndarray, device: torch.device
    ) -> None:
        self.window, self._system = window, H.compile("torch")
        unit = torch.from_numpy(scale / abs(window.end - window.begin))
        self._unit = unit.to(device)

    def rows(self, theta: Tensor, points: Points) -> tuple[Tensor, Tensor]:
        """Return the rows, and dz^/dt in the same units, each of shape (K, dim)."""
        *hidden, (last, shift) = layers_of(theta, self.window.sizes)
        x, xd = points.x, points.xd
        for matrix, bias in hidden:
            a = x @ matrix.T + bias
            x, xd = torch.sin(a), torch.cos(a) * (xd @ matrix.T)
        value, slope = x @ last.T + shift, xd @ last.T
        z = points.start + points.f * value
        dz = points.rate * value + points.f * slope
        field = self._system.vector_field(*self._system.arguments(z, points.t), **points.values)
        return (dz - field) / self._unit, dz / self._unit

    def derivative(self, theta: Tensor, points: Points) -> Derivative:
        """Return the derivative of the rows in the weights."""
        return Derivative(self, theta, points)

    def slopes(self, z: Tensor, points: Points) -> tuple[Tensor, Tensor]:
        """Return the derivatives of the rows in z, (dim, K, dim), and in dz, (dim, 1, dim)."""
        jacobian = self._system.jacobian(*self._system.arguments(z, points.t), **points.values)
        in_z = -(jacobian / self._unit[:, None]).transpose(0, 1)
        return in_z, torch.diag(1 / self._unit)[:, None]


class Derivative:
    """The matrix J of derivatives of the rows in the weights, by products with it."""

    def __init__(self, residual: Residual, theta: Tensor, points: Points) -> None:
        layers = layers_of(theta, residual.window.sizes)
        self._layers = forward(layers, "sin", points.x, points.xd)
        last = self._layers[-1]
        z = points.start + points.f * (last.x @ last.matrix.T + layers[-1][1])
        in_z, in_dz = residual.slopes(z, points)
        self._to_value = points.f * in_z + points.rate * in_dz
        self._to_rate = (points.f * in_dz).expand_as(self._to_value)
        self._count = len(theta)

    def gram(self) -> Tensor:
        """Return J^T J, shape (weights, weights); only on and below its diagonal."""
        if self._to_value.device.type == "cpu":
            # Half of the products: torch has no symmetric product.
            total = np.zeros((self._count, self._count), order="F")
            for rows in self._blocks():
                total = dsyrk(1.0, rows.numpy().T, beta=1.0, c=total, overwrite_c=True)
            return torch.from_numpy(total.T)
        gram = self._to_value.new_zeros(self._count, self._count)
        for rows in self._blocks():
            gram.addmm_(rows.T, rows)
        return gram.tril()

    def _blocks(self) -> Iterator[Tensor]:
        """Yield J in blocks of rows."""
        dim, points, _ = self._to_value.shape
        step = max(1, _CHUNK // (dim * self._count))
        for first in range(0, points, step):
            part = slice(first, first + step)
            parts: list[Tensor] = []
            for layer, u, v in backward(
                [layer.at(part) for layer in self._layers],
                self._to_value[:, part],
                self._to_rate[:, part],
            ):
                matrix = u[..., None] * layer.x[:, None] + v[..., None] * layer.xd[:, None]
                parts += [u, matrix.flatten(2)]
            yield torch.cat(parts[::-1], -1).flatten(0, 1)

    def transposed(self, y: Tensor) -> Tensor:
        """Return J^T y for y of the shape of the rows, (K, dim)."""
        weights = y.T[:, :, None]
        value, rate = (weights * self._to_value).sum(0), (weights * self._to_rate).sum(0)
        parts = []
        for layer, u, v in backward(self._layers, value, rate):
            parts += [u.sum(0), (u.T @ layer.x + v.T @ layer.xd).reshape(-1)]
        return torch.cat(parts[::-1])
