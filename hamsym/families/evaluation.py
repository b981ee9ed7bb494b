"""Evaluation of many members at the same times.

Members are evaluated side by side, in groups that bound the memory. Every sum is taken in the order
of :class:`~hamsym.random_features.trial.FeatureTrial`: a member's matrices have the shapes that
they have when it is evaluated alone, so that the result is the same to the last bit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from hamsym.families.windows import Table, Windows
from hamsym.numerics.collocation import chebyshev_values

_TIMES = 4_096  # as for one solution
_STATES = 8_192  # of a group
_WINDOWS = 8_192  # that are read for a group


def states_in_groups(
    table: Table,
    windows: Windows,
    series: np.ndarray,
    origin: float,
    end: float,
    members: np.ndarray,
    times: np.ndarray,
) -> Iterator[tuple[np.ndarray, slice, np.ndarray]]:
    """Yield places in ``members``, a slice of the times, and the states there.

    - series: Of the columns of the basis, shape (degree + 1, m).
    - origin, end: Time from which edges are counted, and the end of the span.
    - members: Numbers of members, shape (n,). Those without windows are left out.
    - times: Shape (K,).
    - yields places: Shape (g,).
    - yields states: Shape (g, k, dim); nan after the time that a member reached.
    """
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
        for start in range(0, len(times), _TIMES):
            part = slice(start, min(start + _TIMES, len(times)))
            t = times[part]
            place, s = _located(packed.edges, edge, counts, t - origin)
            late = t < reached[:, None] if backwards else t > reached[:, None]
            late &= (reached != end)[:, None]
            s[late] = 0.0  # where the series would overflow
            # The layout of each member's matrix is that of one solution, with the times last.
            polynomials = np.ascontiguousarray(
                chebyshev_values(2 * s - 1, len(series)).swapaxes(1, 2)
            ).swapaxes(1, 2)
            columns = -np.expm1(-s)[..., None] * (polynomials @ series)
            rows = columns.reshape(-1, 1, columns.shape[-1])
            readouts = packed.readouts[(window[:, None] + place).ravel()]
            changes = np.matmul(rows, readouts)[:, 0].reshape(*place.shape, -1)
            states = packed.states[edge[:, None] + place] + changes
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


def _located(
    edges: np.ndarray, first: np.ndarray, counts: np.ndarray, t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the window of each time, and the position in it, for each member; shapes (g, k).

    - edges: Of all members, one after the other.
    - first, counts: First edge and number of windows of each member, shape (g,).
    - t: Times, counted as the edges, shape (k,).
    """
    first, last = first[:, None], counts[:, None] - 1
    backwards = bool(edges[0] > edges[1])
    low = np.zeros((len(first), len(t)), dtype=np.int64)
    high = np.broadcast_to(last, low.shape)
    # The last window that begins at or before the time, by bisection; else the first one.
    for _ in range(int(last.max()).bit_length()):
        middle = (low + high + 1) // 2
        start = edges[first + middle]
        begun = start >= t if backwards else start <= t
        low, high = np.where(begun, middle, low), np.where(begun, high, middle - 1)
        high = np.maximum(low, high)
    start = edges[first + low]
    return low, (t - start) / (edges[first + low + 1] - start)
