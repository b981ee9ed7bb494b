"""Windows and results of many members, packed one after the other.

Input:  windows of members in ascending order, in pieces.
Output: :class:`Table`, a row for each member, and :class:`Windows`, rows of windows of any range.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import Annotated, Any, NamedTuple

import numpy as np

from hamsym.support.record_fields import Array, AsText, counts, flags, floats

# States of a member: not solved yet; accepted by the loop over members; solved by itself, with
# success or without; without a solution.
OPEN, ACCEPTED, MARCHED, REFUSED = range(4)


class Rows:
    """Rows of consecutive arrays, in memory or in a store, as those of one.

    - array: Number of an array -> the array; called when its rows are needed.
    - lengths: Rows of each array.
    - row: Shape of a row.
    """

    def __init__(
        self, array: Callable[[int], np.ndarray], lengths: Sequence[int], row: tuple[int, ...]
    ) -> None:
        self._array, self._row = array, row
        self._edges = np.cumsum([0, *lengths]).tolist()

    def __len__(self) -> int:
        return int(self._edges[-1])

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Rows of a range, not to be written to: a view where they are in one array."""
        if not start < stop:
            return np.empty((0, *self._row))
        found = []
        for place in range(bisect_right(self._edges, start) - 1, bisect_left(self._edges, stop)):
            first = self._edges[place]
            found.append(self._array(place)[max(start - first, 0) : stop - first])
        return found[0] if len(found) == 1 else np.concatenate(found)


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
    return Windows(
        *(
            Rows(arrays.__getitem__, [len(array) for array in arrays], arrays[0].shape[1:])
            for arrays in zip(*parts, strict=True)
        )
    )


@dataclass(frozen=True)
class Note:
    """What is known of one member beside its row."""

    message: str
    #: Of a marched member: the values of its march, and the sizes to which its tolerance is
    #: relative.
    march: Any = None
    scale: tuple[float, ...] | None = None


@dataclass(frozen=True, eq=False)
class Table:
    """Results of n members."""

    #: z0, parameters: Initial states, and values of all parameters.
    z0: Annotated[np.ndarray, floats("members", "dim", finite=False)]
    parameters: Annotated[np.ndarray, floats("members", "parameters")]
    #: State of each member.
    status: Annotated[np.ndarray, Array(("members",), (np.uint8,), most=REFUSED)]
    success: Annotated[np.ndarray, flags("members")]
    #: counts, evaluations: Windows, and evaluations of the vector field.
    counts: Annotated[np.ndarray, counts("members")]
    evaluations: Annotated[np.ndarray, counts("members")]
    #: Largest ratio of the estimated to the allowed error, infinite where it is unknown.
    excess: Annotated[np.ndarray, floats("members", finite=False, least=0)]
    #: Largest estimated error, infinite where it is unknown.
    largest: Annotated[np.ndarray, floats("members", "dim", finite=False, least=0)]
    #: Largest magnitude of each component.
    sizes: Annotated[np.ndarray, floats("members", "dim", least=0)]
    #: Of each marched or refused member.
    notes: Annotated[dict[int, Note], AsText] = field(default_factory=dict)
    #: Why members are open.
    stopped: str = ""

    def check(self) -> None:
        """Raise ValueError unless the columns agree with each other."""
        status, good = self.status, self.success
        solved = (status == ACCEPTED) | (status == MARCHED)
        if ((self.counts > 0) != solved).any():
            raise ValueError("members without windows have a solution, or the reverse")
        if (good & ~solved).any() or (~good & (status == ACCEPTED)).any():
            raise ValueError("success contradicts the state of a member")
        if not ((self.excess <= 1) | ~good).all() or not np.isfinite(self.largest[good]).all():
            raise ValueError("a member's success is true, but its error exceeds the tolerance")
        if not np.isfinite(self.z0[solved]).all():
            raise ValueError("a member with a solution starts at a state that is not finite")
        if sorted(self.notes) != np.flatnonzero((status == MARCHED) | (status == REFUSED)).tolist():
            raise ValueError("members without messages, or messages without members")
        for member, note in self.notes.items():
            if {note.march is not None, note.scale is not None} != {status[member] == MARCHED}:
                raise ValueError("a note does not belong to the state of its member")
        if (status == OPEN).any() != bool(self.stopped):
            raise ValueError("members are not solved without a reason")

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
        table, notes = cls.empty(z0, parameters), dict[int, Note]()
        for members, part in parts:
            for name, column in part.arrays().items():
                if name not in ("z0", "parameters"):
                    getattr(table, name)[members] = column
            notes.update({int(members[place]): note for place, note in part.notes.items()})
        for member, message in refused.items():
            table.status[member], notes[member] = REFUSED, Note(message)
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
        places = self.first_rows
        return Packed(
            *(
                rows.rows(int(before[first]), int(before[last]))
                for rows, before in zip(windows, places, strict=True)
            )
        )

    @property
    def first_rows(self) -> tuple[np.ndarray, ...]:
        """Rows of each array of :class:`Windows` before each member, and of all, (n + 1,) each."""
        edges, windows, errors = self.first_edge, self.first_window, self.first_error
        return edges, edges, windows, errors, errors
