"""Options of methods that solve to a tolerance: the accuracy, and the windows."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic.switching import switch_times

#: Smallest tolerance that float64 allows.
SMALLEST_TOL = 1e-12


def checked_tol(tol: Any) -> float:
    """Return a relative tolerance.

    Raise InputError if it is not a number from 1e-12 to below 1.
    """
    if not (isinstance(tol, (int, float, np.floating)) and SMALLEST_TOL <= tol < 1):
        raise InputError(
            f"tol={tol!r} cannot be used; give a number from {SMALLEST_TOL:g} to below 1"
        )
    return float(tol)


def checked_atol(atol: float | Sequence[float], dim: int) -> np.ndarray:
    """Return absolute tolerances of all components, shape (dim,)."""
    try:
        values = np.broadcast_to(np.asarray(atol, dtype=float), (dim,)).copy()
    except (TypeError, ValueError):
        values = np.array([math.nan])
    if not (np.all(np.isfinite(values)) and np.all(values >= 0)):
        raise InputError(f"atol={atol!r} cannot be used; give a number from 0, or a list of {dim}")
    return values


def checked_window(
    max_window: float | None, span: tuple[float, float], default: float, most: int
) -> float:
    """Return the length of the longest window; a span may have ``most`` windows."""
    if max_window is None:
        return default
    if not (isinstance(max_window, (int, float)) and max_window > 0):
        raise InputError(f"max_window={max_window!r} cannot be used; give a time above 0")
    if (shortest := abs(span[1] - span[0]) / most) > max_window:
        raise InputError(
            f"max_window={max_window!r} needs more than {most:,} windows; give "
            f"{shortest:.3g} or more, or a shorter span"
        )
    return float(max_window)


def window_ends(
    H: Hamiltonian, breakpoints: Sequence[float], span: tuple[float, float]
) -> list[float]:
    """Breakpoints and the times at which t switches H, in the direction of the span.

    Raise InputError if a breakpoint is not a time inside the span.
    """
    given = checked_breakpoints(breakpoints, span)
    apart = 1e-12 * max(map(abs, span))
    times = switch_times(H.real_equations, span)
    found = [t for t in times if all(abs(t - stop) > apart for stop in given)]
    return sorted([*given, *found], reverse=bool(span[1] < span[0]))


def checked_breakpoints(breakpoints: Sequence[float], span: tuple[float, float]) -> list[float]:
    """Return the breakpoints in the direction of the span, without repetitions."""
    try:
        times = sorted({float(stop) for stop in breakpoints})
    except (TypeError, ValueError):
        raise InputError(
            f"breakpoints={breakpoints!r} is not a list of times; give a list of numbers"
        ) from None
    for stop in times:
        if not min(span) < stop < max(span):
            raise InputError(
                f"breakpoint {stop:.6g} is not inside the span from {min(span):.6g} to "
                f"{max(span):.6g}; leave it out"
            )
    return times if span[0] < span[1] else times[::-1]
