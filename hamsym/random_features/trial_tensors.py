"""Evaluation of the trial solution of a march with torch, differentiable in the times."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def evaluate(
    t: Tensor,
    *,
    edges: np.ndarray,
    states: np.ndarray,
    readouts: np.ndarray,
    series: np.ndarray,
    rate_series: np.ndarray,
    origin: np.ndarray,
) -> tuple[Tensor, Tensor]:
    """Evaluate z^ and dz^/dt at times t of shape (K,), each of shape (K, dim).

    The arrays are those of :class:`~hamsym.random_features.trial.FeatureTrial`.
    """
    ends, starts, weights, columns, slopes = (
        torch.from_numpy(array) for array in (edges, states, readouts, series, rate_series)
    )
    t = t.to(torch.float64) - float(origin)
    direction = torch.sign(ends[-1] - ends[0])
    window = torch.searchsorted(direction * ends, (direction * t).detach(), right=True) - 1
    window = window.clamp(0, len(weights) - 1)
    length = (ends[1:] - ends[:-1])[window]
    s = (t - ends[window]) / length
    polynomials = _chebyshev_values(2 * s - 1, len(columns))
    f = -torch.expm1(-s).unsqueeze(-1)
    network, rates = polynomials @ columns, polynomials @ slopes
    readout = weights[window]
    z = starts[window] + torch.einsum("km,kmd->kd", f * network, readout)
    dz = torch.einsum("km,kmd->kd", (1 - f) * network + f * rates, readout)
    return z, dz / length.unsqueeze(-1)


def _chebyshev_values(x: Tensor, count: int) -> Tensor:
    """Evaluate T_0 .. T_(count-1) at x of shape (K,), shape (K, count)."""
    if not x.requires_grad:
        angles = torch.arccos(x.clamp(-1, 1)).unsqueeze(-1)
        return torch.cos(angles * torch.arange(count, dtype=x.dtype))
    # The arc cosine has no derivative at the ends of a window; the recurrence has one.
    values = [torch.ones_like(x), x]
    for _ in range(count - 2):
        values.append(2 * x * values[-1] - values[-2])
    return torch.stack(values, dim=-1)
