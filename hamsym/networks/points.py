"""Collocation points of a training, on the CPU."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from torch import Tensor

from hamsym.errors import InputError
from hamsym.support.validation import require_whole

_FEWEST_JUDGING = 200  # points beside those of the caller's choice, which may be few


def checked_points(points: Any, span: tuple[float, float]) -> int | np.ndarray:
    """Return a number of points, or times of the caller's choice as an array from span[0] on.

    Raise InputError if it is neither a whole number from 2 nor an increasing list of times in the
    span.

    Examples
    --------
    >>> checked_points(50, (0.0, 1.0))
    50
    >>> checked_points([0.5, 2.0, 3.0], (3.0, 0.0))
    array([3. , 2. , 0.5])
    """
    if not isinstance(points, (list, tuple, range, np.ndarray)):
        require_whole("points", points, 2)
        return int(points)
    try:
        times = np.asarray(points, dtype=float)
    except (TypeError, ValueError):
        raise InputError("points has an entry that is not a number; give times") from None
    if times.ndim != 1 or len(times) < 2:
        raise InputError(f"points has shape {times.shape}; give at least two times in a list")
    low, high = min(span), max(span)
    if not bool(np.all(np.diff(times) > 0)):
        raise InputError("the times in points do not increase; sort them, each once")
    if not (low <= times[0] and times[-1] <= high):
        raise InputError(
            f"points has times from {times[0]:.6g} to {times[-1]:.6g}, outside the span from "
            f"{low:.6g} to {high:.6g}; give times inside it"
        )
    return times if span[0] < span[1] else times[::-1].copy()


class Collocation:
    """The collocation points of an optimizer.

    - points: Their number K, or the times themselves, from the start of the span on.
    """

    def __init__(self, points: int | np.ndarray) -> None:
        self.times = points if isinstance(points, np.ndarray) else None
        if not isinstance(points, np.ndarray):
            require_whole("points", points, 2)
        self.count = points if isinstance(points, int) else len(points)
        #: Number of collocation points by which that of the judging points is chosen.
        self.judging = self.count if self.times is None else max(self.count, _FEWEST_JUDGING)

    def bind(self, trial: torch.nn.Module, generator: torch.Generator) -> None:
        """Set the source of random numbers, and the type and device of the times, once."""
        self._generator, weights = generator, next(trial.parameters())
        self._dtype, self._device = weights.dtype, weights.device

    def draw(self, span: tuple[float, float], count: int) -> Tensor:
        """Return times in a span: those of the caller's choice, or ``count`` random ones."""
        if self.times is not None:
            return points_within(self.times, span, self._dtype).to(self._device)
        return fresh_points(span, count, self._dtype, self._generator).to(self._device)


def points_within(times: np.ndarray, span: tuple[float, float], dtype: torch.dtype) -> Tensor:
    """Return the times inside a span that starts where they do, at least two."""
    start, end = span
    inside = int((np.abs(times - start) <= abs(end - start)).sum())
    return torch.from_numpy(times[: max(inside, 2)]).to(dtype)


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
