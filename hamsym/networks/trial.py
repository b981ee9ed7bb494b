"""The trial solution z^(t) = z0 + f(s) N(s), s = |t - t0| / tau, and its time derivative.

f(0) = 0 makes the initial state exact for any weights of the network N (the paper's eqs.
par_sol and f_param).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Annotated, Any

import numpy as np
import torch
from torch import Tensor

from hamsym.networks.network import (
    ComponentNetworks,
    Network,
    has_explicit_gradient,
    weights_of,
)
from hamsym.support.record_fields import Array, convert
from hamsym.support.suggestions import require_known


def _exponential(s: Tensor) -> tuple[Tensor, Tensor]:
    # Without cancellation near s = 0; the derivative needs no second exponential.
    f = -torch.expm1(-s)
    return f, 1 - f


#: Envelopes f by name, each giving (f(s), f'(s)) with f(0) = 0.
ENVELOPES: dict[str, Callable[[Tensor], tuple[Tensor, Tensor]]] = {
    "exponential": _exponential,
    "linear": lambda s: (s, torch.ones_like(s)),
}


class _Envelope(torch.autograd.Function):
    """(z0 + f N, g N + f/tau dN) as one recorded operation; f and g = f'/tau have shape (K, 1)."""

    @staticmethod
    def forward(
        ctx: Any, z0: Tensor, f: Tensor, g: Tensor, tau: float, value: Tensor, rate: Tensor
    ) -> Any:
        scaled = f / tau
        ctx.factors = f, g, scaled
        return torch.addcmul(z0, f, value), (g * value).addcmul_(scaled, rate)

    @staticmethod
    @torch.autograd.function.once_differentiable
    def backward(ctx: Any, grad_z: Tensor, grad_dz: Tensor) -> Any:
        f, g, scaled = ctx.factors
        return None, None, None, None, (f * grad_z).addcmul_(g, grad_dz), scaled * grad_dz


class EnvelopedNetwork(torch.nn.Module):
    """z^(t) = z0 + f(s) N(s) with s = (t - t0) / tau, for a network N of any kind.

    - network: Its outputs are the components of z0.
    - z0: Initial state, shape (dim,).
    - t0: Initial time, in the units of the Hamiltonian.
    - tau: Unit of the network's input; negative for a span that runs backwards.
    - envelope: {"exponential", "linear"}. f(s) = 1 - exp(-s) or f(s) = s.
    """

    z0: Tensor
    moving: Tensor | None  # 0 for components that are constant, else 1

    def __init__(
        self,
        network: torch.nn.Module,
        z0: Tensor,
        *,
        t0: float = 0.0,
        tau: float = 1.0,
        envelope: str = "exponential",
    ) -> None:
        super().__init__()
        require_known(envelope, ENVELOPES, "an envelope")
        self.network = network
        self.register_buffer("z0", z0)
        self.register_buffer("moving", None, persistent=False)
        self.t0, self.tau, self.envelope = float(t0), float(tau), envelope

    def envelope_at(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return s, f(s) and f'(s) at times t of shape (K,)."""
        s = (t - self.t0) / self.tau
        return s, *ENVELOPES[self.envelope](s)

    def hold(self, components: Sequence[int]) -> None:
        """Make components constant: their N is zero, for any weights."""
        if components:
            self.moving = torch.ones_like(self.z0)
            self.moving[list(components)] = 0

    @property
    def held(self) -> list[int]:
        """The components that :meth:`hold` made constant."""
        return [] if self.moving is None else torch.nonzero(self.moving == 0).flatten().tolist()

    def network_at(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return N(s) and dN/ds at s of shape (K,); each of shape (K, dim)."""
        raise NotImplementedError

    def forward(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Return z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        s, *envelope = self.envelope_at(t)
        value, rate = self.network_at(s)
        if self.moving is not None:
            value, rate = value * self.moving, rate * self.moving
        f, f_dot = (part.unsqueeze(-1) for part in envelope)
        if has_explicit_gradient(value, s):
            z, dz = _Envelope.apply(self.z0, f, f_dot / self.tau, self.tau, value, rate)
            return z, dz
        return self.z0 + f * value, (f_dot * value + f * rate) / self.tau

    def to_network(self, t: Tensor, in_z: Tensor, in_dz: Tensor) -> tuple[Tensor, Tensor]:
        """Return derivatives of rows in N and in dN/ds from those in z and in dz.

        - t: Times, shape (K,).
        - in_z, in_dz: Shape (K, m, dim); the results have shape (m, K, dim).
        """
        _, f, f_dot = (part.unsqueeze(1) for part in self.envelope_at(t))
        # z = z0 + f N and dz = (f' N + f dN/ds) / tau.
        in_z, in_dz = in_z.transpose(0, 1), in_dz.transpose(0, 1)
        if self.moving is not None:
            in_z, in_dz = in_z * self.moving, in_dz * self.moving
        return f * in_z + f_dot / self.tau * in_dz, f / self.tau * in_dz

    # -- as a part of a solution ---------------------------------------------------------------

    @property
    def weights(self) -> list[torch.nn.Parameter]:
        """The parameters that a training changes."""
        return [weights for weights in self.parameters() if weights.requires_grad]

    @property
    def dtype(self) -> np.dtype:
        """Type of the weights and of z0, float32 or float64."""
        return np.dtype(str(self.z0.dtype).removeprefix("torch."))

    @torch.no_grad()
    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return z^ and dz^/dt at times t of shape (K,); each of shape (K, dim) and float64.

        They are those of the function that the weights define: float32 weights are evaluated in
        float64, since an error estimated from rounded rates is that of the rounding.
        """
        times = torch.from_numpy(np.ascontiguousarray(t)).double()
        if self.z0.dtype == torch.float64 and self.z0.device.type == "cpu":
            z, dz = self(times)
        else:
            tensors = chain(self.named_parameters(), self.named_buffers())
            precise = {
                name: tensor.cpu().double() if tensor.is_floating_point() else tensor.cpu()
                for name, tensor in tensors
            }
            z, dz = torch.func.functional_call(self, precise, (times,))
        return z.numpy(), dz.numpy()

    def states_at(self, t: np.ndarray) -> np.ndarray:
        """Return z^ at times t of shape (K,), shape (K, dim)."""
        return self.states_and_rates(t)[0]

    def tensors(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """Return z^ and dz^/dt at times t of shape (K,), differentiable in t."""
        # The type first: a device may lack that of the times.
        z, dz = self(t.to(self.z0.dtype).to(self.z0.device))
        return z, dz

    def require_path(self, z0: np.ndarray, span: tuple[float, float]) -> None:
        """Raise ValueError unless z^ starts at z0 at the start of the span."""
        own, (start, end) = self.z0.numpy(), span
        if self.t0 != start or not 0 < math.copysign(1.0, end - start) * self.tau < math.inf:
            raise ValueError("its span is not that of its network")
        with np.errstate(over="ignore"):
            if own.tobytes() != z0.astype(own.dtype).tobytes():
                raise ValueError("its network does not start at its z0")


_WEIGHTS = (np.float32, np.float64)


@dataclass(frozen=True, eq=False)
class NetworkData:
    """A trial solution with a fully connected network, or one for each component, as data."""

    #: Whether the components share one network.
    shared: bool
    #: Of the layers of a network.
    sizes: tuple[int, ...]
    activation: str
    frequency: float | None
    t0: float
    tau: float
    envelope: str
    z0: Annotated[np.ndarray, Array(("dim",), _WEIGHTS)]
    weights: Annotated[np.ndarray, Array(("networks", "weights"), _WEIGHTS)]

    def check(self) -> None:
        """Raise ValueError unless the weights are those of the layers."""
        if self.frequency is not None and not self.frequency > 0:
            raise ValueError("its frequency is not a positive number")
        dim, sizes = len(self.z0), self.sizes
        networks, outputs = (1, dim) if self.shared else (dim, 1)
        if len(sizes) < 3 or min(sizes) < 1 or sizes[0] != 1 or sizes[-1] != outputs:
            raise ValueError("the layer sizes of its networks are inconsistent")
        shape = (networks, weights_of(sizes))
        if self.weights.shape != shape or self.weights.dtype != self.z0.dtype:
            raise ValueError("its weights do not have the size and type that its layers need")


class TrialSolution(EnvelopedNetwork):
    """z^(t) = z0 + f(s) N(s) with a fully connected network N of hamsym.

    - network: Its outputs are the components of z0.
    - z0, t0, tau, envelope: As of :class:`EnvelopedNetwork`.
    """

    network: Network | ComponentNetworks

    def network_at(self, s: Tensor) -> tuple[Tensor, Tensor]:
        """Return N(s) and dN/ds at s of shape (K,); each of shape (K, dim)."""
        value, rate = self.network(s)
        return value, rate

    @property
    def parts(self) -> list[Network]:
        """The network, or the networks of the components."""
        whole = self.network
        return [whole] if isinstance(whole, Network) else list(whole.networks)  # type: ignore[arg-type]

    @torch.no_grad()
    def release(self) -> None:
        """Put zeros into the last layer for the components that are held: the same function."""
        parts = self.parts
        for component in self.held:
            shared = len(parts) == 1 and parts[0].sizes[-1] > 1
            matrix, bias = parts[0 if shared else component].layers[-1]
            row = component if shared else 0
            matrix[row], bias[row] = 0, 0
        self.moving = None

    @property
    def data(self) -> NetworkData:
        """The networks as data."""
        first, *rest = self.parts
        form = (first.sizes, first.activation, first.frequency)
        if any((part.sizes, part.activation, part.frequency) != form for part in rest):
            raise ValueError("its networks differ in layers, activation or frequency")
        return NetworkData(
            shared=isinstance(self.network, Network),
            sizes=tuple(first.sizes),
            activation=first.activation,
            frequency=None if first.frequency is None else float(first.frequency),
            t0=self.t0,
            tau=self.tau,
            envelope=self.envelope,
            z0=self.z0.detach().numpy(),
            weights=np.stack([part.theta.detach().numpy() for part in (first, *rest)]),
        )

    @classmethod
    def of_data(cls, data: NetworkData) -> TrialSolution:
        """Build the networks that data describe."""
        outputs, precision = data.sizes[-1], torch.from_numpy(data.z0).dtype

        def network(theta: np.ndarray) -> Network:
            found = Network(
                outputs,
                data.sizes[1:-1],
                data.activation,
                frequency=data.frequency,
                generator=torch.Generator(),
                dtype=precision,
            )
            found.load_state_dict({"theta": torch.from_numpy(np.array(theta))})
            return found

        parts = [network(theta) for theta in data.weights]
        trial = cls(
            parts[0] if data.shared else ComponentNetworks(parts),
            torch.from_numpy(np.array(data.z0)),
            t0=data.t0,
            tau=data.tau,
            envelope=data.envelope,
        )
        trial.requires_grad_(False)
        return trial


convert(TrialSolution, NetworkData, lambda trial: trial.data, TrialSolution.of_data)
