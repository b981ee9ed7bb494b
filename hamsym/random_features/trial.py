"""The trial solution of a march: z^ and its derivative as functions of t."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from hamsym.random_features.basis import DEGREE, FeatureBasis, rate_series
from hamsym.random_features.windows import March

__all__ = ["FeatureTrial"]


class FeatureTrial(torch.nn.Module):
    """The solution of a march as a function of time, with its derivative; one network a window.

    The derivative is that of the series: nothing but what defines the function is kept.
    """

    terms = DEGREE + 1  # of the series

    def __init__(
        self,
        edges: Tensor,
        states: Tensor,
        readouts: Tensor,
        series: Tensor,
        origin: Tensor | None = None,
    ) -> None:
        super().__init__()
        self.register_buffer("edges", edges)
        self.register_buffer("states", states)
        self.register_buffer("readouts", readouts)
        self.register_buffer("series", series)
        rates = torch.from_numpy(rate_series(series.numpy()))
        self.register_buffer("rate_series", rates, persistent=False)
        zero = torch.zeros((), dtype=edges.dtype)
        self.register_buffer("origin", zero if origin is None else origin)
        self.direction = math.copysign(1.0, float(edges[-1] - edges[0]))

    @classmethod
    def of_march(cls, windows: March, basis: FeatureBasis) -> FeatureTrial:
        """The trial solution of windows that were marched with a basis."""
        return cls(
            *(
                torch.tensor(array, dtype=torch.float64)
                for array in (
                    windows.edges,
                    windows.states,
                    windows.readouts,
                    basis.series,
                    windows.origin,
                )
            )
        )

    edges: Tensor
    states: Tensor
    readouts: Tensor
    series: Tensor
    rate_series: Tensor
    origin: Tensor

    def forward(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        window, length, s, polynomials = self._place(t)
        f = -torch.expm1(-s).unsqueeze(-1)
        network, slopes = polynomials @ self.series, polynomials @ self.rate_series
        readout = self.readouts[window]
        z = self.states[window] + torch.einsum("km,kmd->kd", f * network, readout)
        dz = torch.einsum("km,kmd->kd", (1 - f) * network + f * slopes, readout)
        return z, dz / length.unsqueeze(-1)

    def value(self, t: Tensor) -> Tensor:
        """z^ alone, the same numbers in half the time."""
        window, _, s, polynomials = self._place(t)
        columns = -torch.expm1(-s).unsqueeze(-1) * (polynomials @ self.series)
        return self.states[window] + torch.einsum("km,kmd->kd", columns, self.readouts[window])

    def _place(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Which window t is in, the window's length, s there, and Chebyshev polynomials of s."""
        t = t - self.origin
        window = torch.searchsorted(self.direction * self.edges, self.direction * t, right=True) - 1
        window = window.clamp(0, len(self.readouts) - 1)
        start, length = self.edges[window], (self.edges[1:] - self.edges[:-1])[window]
        s = (t - start) / length
        return window, length, s, _chebyshev_values(2 * s - 1)


def _chebyshev_values(x: Tensor) -> Tensor:
    """T_0 .. T_degree at x of shape (K,), shape (K, degree + 1)."""
    if not x.requires_grad:
        angles = torch.arccos(x.clamp(-1, 1)).unsqueeze(-1)
        return torch.cos(angles * torch.arange(DEGREE + 1, dtype=x.dtype))
    # The arc cosine has no derivative at the ends of a window; the recurrence has.
    values = [torch.ones_like(x), x]
    for _ in range(DEGREE - 1):
        values.append(2 * x * values[-1] - values[-2])
    return torch.stack(values, dim=-1)
