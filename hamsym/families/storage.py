"""Solutions in one file, and in stores to which windows are written as they are found.

A store is a folder: a file that tells what was asked, a file for the windows and one for the table
of each part (:mod:`hamsym.families.parts`), and at the end a file with the table of all members.
The windows are read, and checked against their checksum, when they are needed.
"""

from __future__ import annotations

import json
import math
import os
import uuid
from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

import hamsym
from hamsym.errors import FileError
from hamsym.families.blocks import Block
from hamsym.families.distributed import BEGUN, StorePlace
from hamsym.families.parts import FOLDER, NAME, Part, part_of, read_parts, windows_of, write_part
from hamsym.families.solutions import Family, Solutions
from hamsym.families.windows import MARCHED, OPEN, Packed, Table, Windows, pieces_of
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.description import described, require_formula
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.problem import checked_span
from hamsym.random_features.basis import DEGREE
from hamsym.random_features.trial import FeatureTrial
from hamsym.support.atomic import create_atomically
from hamsym.support.locking import exclusive
from hamsym.support.record_fields import Count, Limit, convert, counts, floats
from hamsym.support.records import MALFORMED, digest_of_parts, packed, unpacked
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors

_KIND = "store of solutions"
_HEAD = "solutions.hamsym"  # the file with the table of all members
_MOST_PARTS = 1_000_000


@dataclass(frozen=True, eq=False)
class Contents:
    """Solutions without their windows."""

    H: Hamiltonian
    span: tuple[float, float]
    tol: float
    atol: tuple[float, ...]
    max_window: float | None
    seed: Count
    varied: tuple[str, ...]
    shape: Annotated[tuple[Count, ...], Limit(most=32)]
    table: Table
    basis: Annotated[np.ndarray, floats(DEGREE + 1, "columns")]

    @classmethod
    def of(cls, solutions: Solutions, **windows: Any) -> Any:
        """Make them from solutions, with windows or what stands for them."""
        family = solutions.family
        return cls(
            *(family.H, family.span, family.tol, family.atol, family.max_window),
            *(family.seed, family.varied, solutions.shape, solutions.table, family.series),
            **windows,
        )

    def check(self) -> None:
        """Raise ValueError unless its members and options are those of one call."""
        table = self.table
        Ensemble(self.H, table.z0, table.parameters, self.shape, self.varied).check()
        if not all(length > 0 for length in self.shape):
            raise ValueError("'shape' is out of range")
        if not self.family.accuracy.tol == self.tol:
            raise ValueError("its tolerance is not valid")

    @property
    def family(self) -> Family:
        """The problem of the members."""
        asked = self.tol, self.atol, self.max_window
        span = checked_span(self.span)
        return Family(self.H, span, *asked, self.seed, self.varied, self.basis)

    def solutions(self, windows: Windows, order: np.ndarray | None = None) -> Solutions:
        """Return the solutions with their windows.

        - order: Numbers of the members in the order of the table.
        """
        members = np.arange(len(self.table.status)) if order is None else np.argsort(order)
        return Solutions(self.family, self.table, windows, members.reshape(self.shape))


@dataclass(frozen=True, eq=False)
class FileContents(Contents):
    """Solutions with all their windows."""

    edges: Annotated[np.ndarray, floats("edges")]
    states: Annotated[np.ndarray, floats("edges", "dim")]
    readouts: Annotated[np.ndarray, floats("windows", "columns", "dim")]
    error: Annotated[np.ndarray, floats("errors", "terms", "dim", finite=False)]
    floors: Annotated[np.ndarray, floats("errors", "dim", finite=False)]

    @property
    def packed(self) -> Packed:
        """The windows of all members."""
        return Packed(*(getattr(self, name) for name in Packed._fields))

    def check(self) -> None:
        """Raise ValueError unless the windows are those of the members."""
        super().check()
        _require_windows(self.solutions(pieces_of([self.packed])), self.packed)


@dataclass(frozen=True, eq=False)
class StoreContents(Contents):
    """Solutions whose windows are in parts of a store."""

    #: Numbers of the members in the order of the table.
    order: Annotated[np.ndarray, counts("members")]
    #: Names and numbers of rows of the parts.
    parts: Annotated[tuple[tuple[str, tuple[Count, ...]], ...], Limit(most=_MOST_PARTS)]

    def check(self) -> None:
        """Raise ValueError unless the members are in an order."""
        super().check()
        if not np.array_equal(np.sort(self.order), np.arange(len(self.order))):
            raise ValueError("the order of its members is not one")
        if not all(NAME.fullmatch(name) and len(rows) == 5 for name, rows in self.parts):
            raise ValueError("a part has no valid name")


def _contents_of(solutions: Solutions) -> FileContents:
    solutions = _compact(solutions)
    windows = {name: rows.rows(0, len(rows)) for name, rows in solutions.windows._asdict().items()}
    found: FileContents = FileContents.of(solutions, **windows)
    return found


convert(
    Solutions, FileContents, _contents_of, lambda found: found.solutions(pieces_of([found.packed]))
)


class WindowStore:
    """A store to which members are written in parts.

    Raise FileError if the path exists and is not a store that was begun with the same arguments, or
    it cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], family: Family, members: Ensemble) -> None:
        self._family, self._members = family, members
        require_formula(path, family.H)
        request = _request(family, members)
        try:
            self._path = Path(os.path.abspath(path))
            if self._path.exists():
                text = (self._path / BEGUN).read_text("utf-8") if is_store(path) else "{}"
                begun = json.loads(text)
                if begun.get("request") != request:
                    raise FileError(
                        f"'{path}' exists; give the path of a new store, or the arguments with "
                        "which this one was begun"
                    )
            else:
                begun = {"request": request, "token": uuid.uuid4().hex}

                def fill(aside: Path) -> None:
                    (aside / FOLDER).mkdir(parents=True)
                    (aside / BEGUN).write_text(json.dumps(begun), "utf-8")

                create_atomically(self._path, fill)
        except (OSError, ValueError, TypeError) as error:
            reason = getattr(error, "strerror", None) or error
            raise FileError(f"'{path}' cannot be written: {reason}") from None
        self._token, self._changed = begun["token"], False
        self._blocks = read_parts(self._path)

    def locked(self) -> AbstractContextManager[None]:
        """Lock the store against other processes that would write to it."""
        return exclusive(self._path, self._path.with_name(f".{self._path.name}.lock"))

    @property
    def place(self) -> StorePlace:
        """The store, for workers that write to it."""
        return StorePlace(self._path, self._token)

    @property
    def solved(self) -> np.ndarray:
        """Numbers of the members in it."""
        return np.concatenate([np.empty(0, np.int64), *(b.members for b in self._blocks)])

    def append(self, block: Block) -> None:
        """Write the members of a block that are solved, unless a worker has written it."""
        solved = np.flatnonzero(block.table.status != OPEN)
        if not len(solved):
            return
        if len(solved) < len(block.members):  # it was interrupted
            block = Block(block.members[solved], block.table.selected(solved), block.windows)
        if block.windows is not None:
            write_part(self._path, block)
        self._blocks.append(block._replace(windows=None))
        self._changed = True

    def finished(self, refused: Mapping[int, str], stopped: str) -> Solutions:
        """Write the table, and return the solutions, which read their windows from the store."""
        if not self._changed and (self._path / _HEAD).is_file():
            found = open_store(self._path)
            if not found.table.stopped:
                return found
        blocks = sorted(self._blocks, key=lambda block: int(block.members[0]))
        members, solved = self._members, np.concatenate([[-1], *(b.members for b in blocks)])
        order = np.arange(len(members))
        if not (np.diff(solved) > 0).all():  # members of a later call are between those of others
            order = np.concatenate((solved[1:], np.setdiff1d(order, solved))).astype(np.int64)
        tables = [(block.members, block.table) for block in blocks]
        table = Table.of_members(members.states, members.parameters, tables, refused, stopped)
        table, parts = table.selected(order), [part_of(block) for block in blocks]
        windows = windows_of(self._path, parts, _row_shapes(self._family))
        index = np.argsort(order).reshape(members.shape)
        solutions = Solutions(self._family, table, windows, index)
        rows = tuple((part.name, part.rows) for part in parts)
        contents = packed(StoreContents.of(solutions, order=order, parts=rows))
        # Last: a store without it is not complete.
        write_tensors(self._path / _HEAD, _KIND, *contents)
        if not table.stopped:
            for leftover in (self._path / FOLDER).glob(".*"):  # of processes that were killed
                leftover.unlink(missing_ok=True)
        return solutions


def _request(family: Family, members: Ensemble) -> str:
    """Compute SHA-256 of all that determines the solutions."""
    values = {
        "version": hamsym.__version__,
        "H": described(family.H),
        "span": [float(time).hex() for time in family.span],
        "options": [family.tol, list(family.atol), family.max_window],
        "seed": family.seed,
        "varied": list(family.varied),
        "shape": list(members.shape),
    }
    arrays = {"z0": members.states, "parameters": members.parameters, "basis": family.series}
    return digest_of_parts(arrays, values)


def is_store(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder to which a store was begun."""
    try:
        return os.path.isfile(os.path.join(path, BEGUN))
    except (ValueError, TypeError):  # it is no path
        return False


def open_store(path: str | os.PathLike[str]) -> Solutions:
    """Open the solutions of a store; their windows are read when they are needed.

    Raise FileError if it is damaged, or was not finished.
    """
    place = Path(os.path.abspath(path))
    if not (place / _HEAD).is_file():
        raise FileError(f"the store '{path}' was not finished; solve again")
    try:
        contents = unpacked(StoreContents, *read_tensors(place / _HEAD, _KIND))
        parts = [Part(*part) for part in contents.parts]
        windows = windows_of(place, parts, _row_shapes(contents.family))
        solutions = contents.solutions(windows, contents.order)
        if [len(rows) for rows in windows] != [n[-1] for n in solutions.table.first_rows]:
            raise ValueError("windows are missing")
    except FileError:
        raise
    except MALFORMED as error:
        raise FileError(f"'{path}' is damaged: {one_line(error)}") from None
    return solutions


def _compact(solutions: Solutions) -> Solutions:
    """Return the same solutions with a table and windows of their members alone, in order."""
    members, table = solutions.members.ravel(), solutions.table
    if np.array_equal(members, np.arange(len(table.status))):
        return solutions
    none = table.packed(solutions.windows, 0, 0)
    parts = [table.packed(solutions.windows, m, m + 1) for m in members.tolist()]
    return Solutions(
        solutions.family,
        table.selected(members),
        pieces_of([*parts, none]),
        np.arange(len(members)).reshape(solutions.shape),
    )


def _row_shapes(family: Family) -> dict[str, tuple[int, ...]]:
    """Return the shape of a row of each array of :class:`Windows`."""
    dim, columns = family.H.dim, family.series.shape[1]
    return {
        "edges": (),
        "states": (dim,),
        "readouts": (columns, dim),
        "error": (family.degrees, dim),
        "floors": (dim,),
    }


def _require_windows(solutions: Solutions, packed: Packed) -> None:
    """Raise ValueError unless the windows are those of the members."""
    family, table = solutions.family, solutions.table
    rows = _row_shapes(family).items()
    for (name, row), before, array in zip(rows, table.first_rows, packed, strict=True):
        if array.shape != (int(before[-1]), *row):
            raise ValueError(f"'{name}' has shape {array.shape}, not {(int(before[-1]), *row)}")
    solved = table.counts > 0
    first, last = table.first_edge[:-1][solved], table.first_edge[1:][solved] - 1
    start, end = family.span
    with np.errstate(over="ignore"):
        steps = np.diff(packed.edges) * math.copysign(1.0, end - start)
    inner = np.ones(len(steps), dtype=bool)
    inner[last[:-1]] = False  # from one member to the next
    if not (steps[inner] > 0).all() or not np.isfinite(steps[inner]).all():
        raise ValueError("its windows are not in order")
    if not (family.origin + packed.edges[first] == start).all():
        raise ValueError("a member does not start at the start of the span")
    reached = family.origin + packed.edges[last]
    if not (reached[table.success[solved]] == end).all():
        raise ValueError("a member's success is true, but it ends before the span")
    if packed.states[first].tobytes() != table.z0[solved].tobytes():
        raise ValueError("a member does not start at its z0")
    for member in np.flatnonzero(table.status == MARCHED).tolist():
        march, error = solutions.marched(member)
        trial = FeatureTrial.of_march(march, family.series)
        success = bool(table.success[member])
        if march.origin != family.origin:
            raise ValueError("the times of a member have another origin")
        trial.check()
        march.require_trial(trial)
        error.check()
        error.require_trial(trial)
        if success:
            error.require_finite()
