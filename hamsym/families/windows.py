"""Windows and results of many members, packed one after the other.

Input:  windows of members in ascending order, in pieces.
Output: :class:`Table`, a row for each member, and :class:`Windows`, rows of windows of any range.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Any, NamedTuple, Protocol

import numpy as np

# States of a member: not solved yet; accepted by the loop over members; solved by itself, with
# success or without; without a solution.
OPEN, ACCEPTED, MARCHED, REFUSED = range(4)


class Rows(Protocol):
    """An array that grows along its first axis, in memory or in a store."""

    def __len__(self) -> int:
        """Number of rows."""

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Rows of a range, not to be written to."""


class Pieces:
    """Rows in memory, as consecutive arrays."""

    def __init__(self, pieces: Sequence[np.ndarray]) -> None:
        filled = [piece for piece in pieces if len(piece)]
        self._pieces = filled or list(pieces[:1])
        self._ends = np.cumsum([len(piece) for piece in self._pieces]).tolist()

    def __len__(self) -> int:
        return int(self._ends[-1])

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Rows of a range: a view where they are in one piece."""
        first = min(bisect_right(self._ends, start), len(self._pieces) - 1)
        last = first
        while self._ends[last] < stop:
            last += 1
        offset = self._ends[first] - len(self._pieces[first])
        if first == last:
            return self._pieces[first][start - offset : stop - offset]
        found = [
            self._pieces[first][start - offset :],
            *self._pieces[first + 1 : last],
            self._pieces[last][: stop - self._ends[last] + len(self._pieces[last])],
        ]
        return np.concatenate(found)


class Packed(NamedTuple):
    """Windows of consecutive members."""

    #: edges, states: A member with n windows has n + 1 edges and states; one without windows has
    #: none.
    edges: np.ndarray
    states: np.ndarray
    #: Shape (windows, m, dim).
    readouts: np.ndarray
    #: error, floors: Series and floors of the estimated error, of the windows of marched members
    #: only: those of the others are computed again when they are needed.
    error: np.ndarray
    floors: np.ndarray


class Windows(NamedTuple):
    """Windows of all members: :class:`Packed`, each array as rows."""

    edges: Rows
    states: Rows
    readouts: Rows
    error: Rows
    floors: Rows


def pieces_of(parts: Sequence[Packed]) -> Windows:
    """Return the windows of consecutive parts, which are not copied."""
    return Windows(*(Pieces(arrays) for arrays in zip(*parts, strict=True)))


@dataclass(frozen=True, eq=False)
class Table:
    """Results of n members."""

    #: z0, parameters: Initial states, shape (n, dim), and values of all parameters, shape (n, k).
    z0: np.ndarray
    parameters: np.ndarray
    #: State of each member, shape (n,), of uint8.
    status: np.ndarray
    #: Shape (n,), of bool.
    success: np.ndarray
    #: counts, evaluations: Windows, and evaluations of the vector field, shape (n,), of int64.
    counts: np.ndarray
    evaluations: np.ndarray
    #: Largest ratio of the estimated to the allowed error, infinite where it is unknown.
    excess: np.ndarray
    #: largest, sizes: Largest estimated error, infinite where it is unknown, and largest magnitude
    #: of each component, shape (n, dim).
    largest: np.ndarray
    sizes: np.ndarray
    #: The message of each marched or refused member; of a marched one also the numbers of its march
    #: and the sizes to which its tolerance is relative.
    notes: Mapping[int, dict[str, Any]] = field(default_factory=dict)
    #: Why members are open.
    stopped: str = ""

    @classmethod
    def empty(cls, z0: np.ndarray, parameters: np.ndarray) -> Table:
        """Make the table of members none of which is solved."""
        count, dim = z0.shape
        return cls(
            z0=z0,
            parameters=parameters,
            status=np.full(count, OPEN, dtype=np.uint8),
            success=np.zeros(count, dtype=bool),
            counts=np.zeros(count, dtype=np.int64),
            evaluations=np.zeros(count, dtype=np.int64),
            excess=np.full(count, np.inf),
            largest=np.full((count, dim), np.inf),
            sizes=np.zeros((count, dim)),
        )

    @classmethod
    def of_members(
        cls,
        z0: np.ndarray,
        parameters: np.ndarray,
        parts: Sequence[tuple[np.ndarray, Table]],
        refused: Mapping[int, str],
        stopped: str,
    ) -> Table:
        """Make the table of all members from numbers of members with their tables."""
        table, notes = cls.empty(z0, parameters), {}
        for members, part in parts:
            for name, column in part.arrays().items():
                if name not in ("z0", "parameters"):
                    getattr(table, name)[members] = column
            notes.update({int(members[place]): note for place, note in part.notes.items()})
        for member, message in refused.items():
            table.status[member], notes[member] = REFUSED, {"message": message}
        # Without open members there is nothing that was stopped.
        stopped = stopped if (table.status == OPEN).any() else ""
        return replace(table, notes=notes, stopped=stopped)

    def selected(self, members: np.ndarray) -> Table:
        """Return the table of some members, in their order."""
        rows = {name: column[members] for name, column in self.arrays().items()}
        notes = {k: self.notes[m] for k, m in enumerate(members.tolist()) if m in self.notes}
        return Table(**rows, notes=notes, stopped=self.stopped)

    def arrays(self) -> dict[str, np.ndarray]:
        """Return its arrays by name."""
        values = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        return {name: value for name, value in values.items() if isinstance(value, np.ndarray)}

    @cached_property
    def first_window(self) -> np.ndarray:
        """Number of windows before each member, and of all, shape (n + 1,)."""
        return np.append(0, np.cumsum(self.counts))

    @cached_property
    def first_edge(self) -> np.ndarray:
        """Number of edges before each member, and of all, shape (n + 1,)."""
        return self.first_window + np.append(0, np.cumsum(self.counts > 0))

    @cached_property
    def first_error(self) -> np.ndarray:
        """Number of windows of marched members before each member, and of all, shape (n + 1,)."""
        return np.append(0, np.cumsum(np.where(self.status == MARCHED, self.counts, 0)))

    def packed(self, windows: Windows, first: int, last: int) -> Packed:
        """Return the windows of members from ``first`` to below ``last``."""
        edges, places, errors = (
            (int(places[first]), int(places[last]))
            for places in (self.first_edge, self.first_window, self.first_error)
        )
        return Packed(
            windows.edges.rows(*edges),
            windows.states.rows(*edges),
            windows.readouts.rows(*places),
            windows.error.rows(*errors),
            windows.floors.rows(*errors),
        )
