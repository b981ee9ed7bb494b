"""Evaluation of many members at the same times.

Members are evaluated in groups that bound the memory, by the function that evaluates one solution,
so that the result is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from hamsym.families.windows import Table, Windows
from hamsym.random_features.trial import paths_of

if TYPE_CHECKING:
    from hamsym.families.solutions import Family

_TIMES = 4_096  # as for one solution
_STATES = 8_192  # of a group
_WINDOWS = 8_192  # that are read for a group


def states_in_groups(
    family: Family, table: Table, windows: Windows, members: np.ndarray, times: np.ndarray
) -> Iterator[tuple[np.ndarray, slice, np.ndarray]]:
    """Yield places in ``members``, a slice of the times, and the states there.

    - members: Numbers of members, shape (n,). Those without windows are left out.
    - times: Shape (K,).
    - yields places: Shape (g,).
    - yields states: Shape (g, k, dim); nan after the time that a member reached.
    """
    origin, end = family.origin, family.span[1]
    there = np.flatnonzero(table.counts[members] > 0)
    order = there[np.argsort(members[there], kind="stable")]
    most = max(1, _STATES // min(len(times), _TIMES))
    for places in _groups(order, members, table.first_window, most):
        group = members[places]
        first = int(group[0])
        packed = table.packed(windows, first, int(group[-1]) + 1)
        edge = table.first_edge[group] - table.first_edge[first]
        window = table.first_window[group] - table.first_window[first]
        counts = table.counts[group]
        reached = origin + packed.edges[edge + counts]
        backwards = bool(packed.edges[0] > packed.edges[1])
        paths = paths_of(edge, window, counts, packed[:3], family.series)
        for start in range(0, len(times), _TIMES):
            part = slice(start, min(start + _TIMES, len(times)))
            t = times[part]
            states = paths.states(t - origin)
            late = t < reached[:, None] if backwards else t > reached[:, None]
            late &= (reached != end)[:, None]
            states[late] = np.nan
            yield places, part, states


def _groups(
    places: np.ndarray, members: np.ndarray, first_window: np.ndarray, most: int
) -> Iterator[np.ndarray]:
    """Divide places, in the order of their members, into groups of at most ``most``."""
    pending = [places[k : k + most] for k in range(0, len(places), most)][::-1]
    while pending:
        group = pending.pop()
        read = first_window[members[group[-1]] + 1] - first_window[members[group[0]]]
        if len(group) == 1 or read <= _WINDOWS:
            yield group
        else:
            middle = len(group) // 2
            pending += [group[middle:], group[:middle]]
