"""Events of a solution, in the conventions of scipy's solve_ivp.

The event function is sampled on a grid of times and just after each of them, which gives its slope;
:mod:`hamsym.numerics.roots` describes the zeros that are found from both.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from hamsym.errors import InputError
from hamsym.numerics.roots import suspects, zeros
from hamsym.solution.path import Path
from hamsym.support.validation import is_positive, require, require_number
from hamsym.surface import parse_surface

__all__ = ["Event", "Events", "find_events"]

#: A surface, for example "x = 0, p_x > 0", or a function of (t, z) as solve_ivp takes it.
Event = str | Callable[[float, np.ndarray], float]

_AFTER = 1e-4  # of an interval: distance over which the slope of an event is measured


class Events(NamedTuple):
    """Times and states of each event.

    Attributes
    ----------
    t_events : list of numpy.ndarray
        Times, shape (n,), for each event.
    y_events : list of numpy.ndarray
        States, shape (n, dim), for each event.
    """

    t_events: list[np.ndarray]
    y_events: list[np.ndarray]


def find_events(solution: Path, events: Event | Sequence[Event], times: np.ndarray) -> Events:
    """Find the zeros of the events along a solution, between the given times."""
    listed = [events] if isinstance(events, str) or callable(events) else list(events)
    found = [_zeros(solution, event, times) for event in listed]
    backward = solution.span[1] < solution.span[0]
    end = np.inf
    for event, t in zip(listed, found, strict=True):
        limit = _terminal(event)
        if limit and len(t) >= limit:
            end = min(end, -t[limit - 1] if backward else t[limit - 1])
    found = [t[(-t if backward else t) <= end] for t in found]
    dim = solution.H.dim
    return Events(found, [solution(t) if len(t) else np.empty((0, dim)) for t in found])


def _terminal(event: Event) -> int:
    """Return the number of zeros after which an event ends the search; 0 for never."""
    terminal = getattr(event, "terminal", False)
    if terminal is None or isinstance(terminal, (bool, np.bool_)):
        return int(bool(terminal))
    whole = float(terminal).is_integer() if is_positive(terminal) else False
    require(whole, "terminal", terminal, "True or a whole number from 1")
    return int(terminal)


def _zeros(solution: Path, event: Event, times: np.ndarray) -> np.ndarray:
    conditions: Callable[..., np.ndarray] | None = None
    if isinstance(event, str):
        surface = parse_surface(solution.H, event)
        conditions = surface.holds

        def value(t: np.ndarray) -> np.ndarray:
            return np.asarray(surface.value(solution(t), t), dtype=float)

    elif callable(event):

        def value(t: np.ndarray) -> np.ndarray:
            pairs = zip(t, solution(t), strict=True)
            return np.array([_number(event(time, z)) for time, z in pairs])

    else:
        raise InputError(
            f"{event!r} is not an event; give a text, for example 'x = 0', or a function"
        )
    direction = getattr(event, "direction", 0.0) or 0.0
    require_number("direction", direction)
    # The last slope is measured before the end of the span, beyond which there is no solution.
    aside = _AFTER * np.append(np.diff(times), times[-2] - times[-1])
    with np.errstate(all="ignore"):
        values = value(times)
        _require_numbers(event, times, values)
        slopes = np.append(np.ones(len(times) - 1), -1) * (value(times + aside) - values)
    (step,), dips = suspects(values, slopes)

    def when(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        # Exact at both ends, so that no time is outside the span.
        return (1 - share) * times[step[index]] + share * times[step[index] + 1]

    share, index = zeros(
        lambda share, index: value(when(share, index)),
        values[step],
        values[step + 1],
        dips,
        direction,
    )
    t = when(share, index)
    return t if conditions is None or not len(t) else t[conditions(solution(t), t)]


def _require_numbers(event: Event, times: np.ndarray, values: np.ndarray) -> None:
    """Raise InputError for an event that is NaN somewhere: zeros there would be missed."""
    if np.isnan(values).any():
        name = f"'{event}'" if isinstance(event, str) else "an event"
        first = times[np.isnan(values)][0]
        raise InputError(
            f"{name} is not a number at t = {first:.6g}; give an event with a value at all times"
        )


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"an event returned {value!r}; it must return a number") from None
