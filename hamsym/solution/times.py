"""Times at which a solution is evaluated: floats, lists, arrays or tensors."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.support.validation import checked_numbers, outside_span

if TYPE_CHECKING:  # torch is imported only by callers that have tensors
    from torch import Tensor

_CHUNK = 4_096  # times evaluated at once, to bound the memory


def shown_time(t: float, start: float, end: float) -> str:
    """Write a time with enough digits to tell it from the ends of its span.

    Examples
    --------
    >>> shown_time(1 / 3, 0, 1), shown_time(1e8 + 1 / 3, 1e8, 1e8 + 10)
    ('0.333333', '100000000.33333')
    """
    largest, whole = max(abs(start), abs(end)), abs(end - start)
    more = max(0, math.ceil(math.log10(largest / whole) - 1e-9)) if 0 < whole < largest else 0
    return f"{t:.{min(6 + more, 17)}g}"


def times_in_span(t: Any, span: tuple[float, float], *, extrapolate: bool = False) -> np.ndarray:
    """Return one time or a list of times as an array.

    Raise InputError if they are not finite numbers, or outside the span unless
    ``extrapolate=True``.
    """
    precision = {}
    if is_tensor(t):
        t = t.detach().cpu().numpy()
        if t.dtype == np.float32:  # which rounds the ends of the span
            precision["round_off"] = float(np.finfo(np.float32).eps)
    times = checked_numbers("t", t)
    if times.ndim > 1 or times.size == 0:
        raise InputError(f"t has shape {times.shape}; give one time or a list of times")
    outside = outside_span(times, span, **precision)
    if outside.any():
        if not np.all(np.isfinite(times)):
            raise InputError("t has an entry that is not finite; give finite times")
        if not extrapolate:
            raise InputError(
                f"t = {times[outside].flat[0]:.16g} is outside the span from {min(span):.16g} to "
                f"{max(span):.16g}; give times inside it, or extrapolate=True"
            )
    return times


def evaluate_in_parts(
    function: Callable[[np.ndarray], tuple[np.ndarray, ...]], times: np.ndarray
) -> tuple[np.ndarray, ...]:
    """Apply a function (K,) -> (K, dim) to one time or a list; shape (*times.shape, dim)."""
    flat = times.reshape(-1)
    parts = [function(flat[k : k + _CHUNK]) for k in range(0, len(flat), _CHUNK)]
    if len(parts) > 1:
        parts = [tuple(np.concatenate(part) for part in zip(*parts, strict=True))]
    return parts[0] if times.ndim else tuple(value[0] for value in parts[0])


def is_tensor(value: Any) -> bool:
    """Return whether a value is a tensor of torch, without importing torch."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def tensor_of(values: np.ndarray) -> Tensor:
    """Return an array as a tensor."""
    import torch

    return torch.from_numpy(values)
