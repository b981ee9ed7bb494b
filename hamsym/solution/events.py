"""Events of a solution, in the conventions of scipy's solve_ivp.

A smooth formula is bounded between a grid of times, so that all of its zeros are found
(:mod:`hamsym.numerics.isolation`). Any other function is sampled there and just after each of them,
which gives its slope; :mod:`hamsym.numerics.roots` describes the zeros that are found from both.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
import sympy

from hamsym.errors import EventWarning, InputError
from hamsym.numerics.intervals import Intervals, Ranges
from hamsym.numerics.isolation import (
    Cells,
    Isolated,
    component_ranges,
    isolated_zeros,
    rate_bends,
)
from hamsym.numerics.roots import suspects, zeros
from hamsym.problems.surface import Surface, parse_surface
from hamsym.support.validation import is_positive, require, require_number

if TYPE_CHECKING:
    from hamsym.solution.solution import Solution

#: A surface, for example "x = 0, p_x > 0", a sympy expression that is zero or an ``Eq``, or a
#: function of (t, z) as solve_ivp takes it.
Event: TypeAlias = str | sympy.Expr | sympy.Eq | Callable[[float, np.ndarray], float]

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


def find_events(solution: Solution, events: Event | Sequence[Event], times: np.ndarray) -> Events:
    """Find the zeros of the events along a solution, between the given times."""
    one = isinstance(events, (str, sympy.Basic)) or callable(events)
    valid = one or isinstance(events, Iterable)
    require(valid, "events", events, "a formula or a function, or some")
    listed: list[Any] = [events] if one else list(events)  # type: ignore[arg-type]
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


def _zeros(solution: Solution, event: Event, times: np.ndarray) -> np.ndarray:
    direction = getattr(event, "direction", 0.0) or 0.0
    require_number("direction", direction)
    if callable(event) and not isinstance(event, sympy.Basic):

        def value(t: np.ndarray) -> np.ndarray:
            pairs = zip(t, solution(t), strict=True)
            return np.array([_number(event(time, z)) for time, z in pairs])

        return _sampled(event, value, times, direction)
    if not isinstance(event, (str, sympy.Basic)):
        raise InputError(
            f"{event!r} is not an event; give a text, for example 'x = 0', or a function"
        )
    surface = parse_surface(solution.H, event)
    if surface.enclosed is not None:
        t = _isolated(solution, surface, times)
    else:
        t = _sampled(
            surface.text,
            lambda t: np.asarray(surface.value(solution(t), t), float),
            times,
            direction,
        )
    return t[surface.holds(solution(t), t)] if len(t) else t


def _isolated(solution: Solution, surface: Surface, times: np.ndarray) -> np.ndarray:
    """Find all zeros of a formula, by bounds between the times."""
    enclosed = surface.enclosed
    assert enclosed is not None

    def when(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        # Exact at both ends, so that no time is outside the span.
        return (1 - share) * times[index] + share * times[index + 1]

    def sample(t: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        states, rates = solution.evaluate(t)
        values = np.asarray(surface.value(states, t), dtype=float)
        _require_numbers(surface.text, t, values)
        return values, states[:, surface.components], rates[:, surface.components]

    def over(cells: Cells) -> Ranges:
        ends = np.stack([when(cells.low, cells.index), when(cells.high, cells.index)])
        one = np.ones(len(cells))
        time = Ranges.of_slopes(ends, Intervals(one, one), np.abs(ends[1] - ends[0]))
        return enclosed(lambda i: component_ranges(cells, i), time)

    def value(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        t = when(share, index)
        return np.asarray(surface.value(solution(t), t), dtype=float)

    with np.errstate(all="ignore"):
        values, states, rates = sample(times)
    cells = Cells.whole(
        np.diff(times),
        np.stack([values[:-1], values[1:]]),
        np.stack([states[:-1], states[1:]]),
        np.stack([rates[:-1], rates[1:]]),
        rate_bends(times, rates),
    )
    found = isolated_zeros(cells, over, lambda share, index: sample(when(share, index)), value)
    touched = [place for place in found.touched if place != (0.0, 0)]  # the start is no event
    if touched or found.undecided:
        _warn(surface.text, [float(when(*map(np.array, place))) for place in touched], found)
    return when(found.share, found.index)


def _warn(text: str, touched: Sequence[float], found: Isolated) -> None:
    if found.undecided:
        reason = (
            f"it may cross zero more often than the {len(found.index):,} times that were found, "
            "because it varies too fast or stays within round-off of zero"
        )
    else:
        listed = ", ".join(f"{t:.6g}" for t in touched[:3]) + ", ..." * (len(touched) > 3)
        reason = (
            f"it comes to zero within round-off at t = {listed} without a change of sign, which is "
            "not counted"
        )
    warnings.warn(f"'{text}': {reason}", EventWarning, stacklevel=6)


def _sampled(
    event: Event, value: Callable[[np.ndarray], np.ndarray], times: np.ndarray, direction: float
) -> np.ndarray:
    """Find zeros of any function, from its values and slopes at the times."""
    # The last slope is measured before the end of the span, beyond which there is no solution.
    aside = _AFTER * np.append(np.diff(times), times[-2] - times[-1])
    with np.errstate(all="ignore"):
        values = value(times)
        _require_numbers(event, times, values)
        slopes = np.append(np.ones(len(times) - 1), -1) * (value(times + aside) - values)
    (step,), dips = suspects(values, slopes)

    def when(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        return (1 - share) * times[step[index]] + share * times[step[index] + 1]

    share, index = zeros(
        lambda share, index: value(when(share, index)),
        values[step],
        values[step + 1],
        dips,
        direction,
    )
    return when(share, index)


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
