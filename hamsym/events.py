"""Events on a solution, as scipy's solve_ivp has them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from hamsym.errors import InputError
from hamsym.settings import is_positive, require
from hamsym.surfaces import parse_surface, refine, sign_changes

if TYPE_CHECKING:
    from hamsym.solution import Solution

__all__ = ["Event", "Events", "find_events"]

#: A surface such as "x = 0, p_x > 0", or a function of (t, z) as solve_ivp takes it.
Event = str | Callable[[float, np.ndarray], float]


class Events(NamedTuple):
    """When and where each event happened.

    Attributes
    ----------
    t_events : list of numpy.ndarray
        Times, shape (n,), for each event.
    y_events : list of numpy.ndarray
        States, shape (n, dim), for each event.
    """

    t_events: list[np.ndarray]
    y_events: list[np.ndarray]


def find_events(solution: Solution, events: Event | Sequence[Event], times: np.ndarray) -> Events:
    """Zeros of the events along a solution, looked for between the given times."""
    wanted = [events] if isinstance(events, str) or callable(events) else list(events)
    found = [_zeros(solution, event, times) for event in wanted]
    backward = solution.span[1] < solution.span[0]
    end = np.inf
    for event, t in zip(wanted, found, strict=True):
        limit = _terminal(event)
        if limit and len(t) >= limit:
            end = min(end, -t[limit - 1] if backward else t[limit - 1])
    found = [t[(-t if backward else t) <= end] for t in found]
    dim = solution.H.dim
    return Events(found, [solution(t) if len(t) else np.empty((0, dim)) for t in found])


def _terminal(event: Event) -> int:
    """After how many of them an event ends the search; 0 for never."""
    terminal = getattr(event, "terminal", False)
    if terminal is None or isinstance(terminal, (bool, np.bool_)):
        return int(bool(terminal))
    whole = float(terminal).is_integer() if is_positive(terminal) else False
    require(whole, "terminal", terminal, "True or a whole number from 1")
    return int(terminal)


def _zeros(solution: Solution, event: Event, times: np.ndarray) -> np.ndarray:
    conditions: Callable[..., np.ndarray] | None = None
    if isinstance(event, str):
        surface = parse_surface(solution.H, event)
        conditions = surface.holds

        def value(t: np.ndarray) -> np.ndarray:
            return surface.value(solution(t), t)

    elif callable(event):

        def value(t: np.ndarray) -> np.ndarray:
            pairs = zip(t, solution(t), strict=True)
            return np.array([_number(event(time, z)) for time, z in pairs])

    else:
        raise InputError(f"{event!r} is not an event; give a text such as 'x = 0' or a function")
    step = sign_changes(value(times), getattr(event, "direction", 0.0) or 0.0)[0]
    t = refine(lambda t, _: value(t), times[step], times[step + 1])
    t = t[np.isfinite(t)]
    return t if conditions is None or not len(t) else t[conditions(solution(t), t)]


def _number(value: Any) -> float:
    try:
        return float(value)
    except (TypeError, ValueError):
        raise InputError(f"an event returned {value!r}; it must return a number") from None
