"""Collocation points of a training, on the CPU."""

from __future__ import annotations

import math

import torch
from torch import Tensor


def midpoints(span: tuple[float, float], count: int, dtype: torch.dtype) -> Tensor:
    """Return the midpoints of equal cells of a span, shape (count,)."""
    return min(span) + _cells(count, dtype) * abs(span[1] - span[0])


def fresh_points(
    span: tuple[float, float], count: int, dtype: torch.dtype, generator: torch.Generator
) -> Tensor:
    """Return random times, one in each of ``count`` cells of a span, and both its ends."""
    u = (
        torch.arange(count, dtype=dtype, device="cpu")
        + torch.rand(count, generator=generator, dtype=dtype, device="cpu")
    ) / count
    u[0], u[-1] = 0.0, 1.0
    return _spread(span, u)


def points_between(span: tuple[float, float], count: int, dtype: torch.dtype) -> Tensor:
    """Return the midpoints of 2 count + 1 cells with the density of :func:`fresh_points`."""
    return _spread(span, _cells(2 * count + 1, dtype))


def _spread(span: tuple[float, float], u: Tensor) -> Tensor:
    """Map u in [0, 1] to times that are denser at both ends, between uniform and Chebyshev points.

    A residual that is large at the start offsets the whole trajectory.
    """
    start, end = span
    s = 0.5 * u + 0.25 * (1 - torch.cos(math.pi * u))
    return start + s * (end - start)


def _cells(count: int, dtype: torch.dtype) -> Tensor:
    return (torch.arange(count, dtype=dtype, device="cpu") + 0.5) / count
