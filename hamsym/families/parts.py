"""Parts of a store: the results of some members, written once and then never changed.

A part is a file of the windows and one of the table of its members, which is written last: a part
without it is not there. Each process of a cluster may write its own.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hamsym.errors import FileError
from hamsym.families.blocks import Block
from hamsym.families.windows import Rows, Table, Windows
from hamsym.support.records import MALFORMED, packed, unpacked
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors

FOLDER = "parts"
#: Name of a part: its first member, and a digest of all.
NAME = re.compile(r"\d{12,}-[0-9a-f]{16}")
# Kinds of files, and their endings.
_TABLE, _WINDOWS = "table of members", "windows of members"
_ENDINGS = {_TABLE: ".table", _WINDOWS: ".windows"}
_KEPT = 2**28  # bytes of windows that are kept once they were read


class Part(NamedTuple):
    """A part of a store: its name, and its number of rows in each array of the windows."""

    name: str
    rows: tuple[int, ...]


def part_of(block: Block) -> Part:
    """Return the name and the rows of a part from the table of its members."""
    rows = tuple(int(before[-1]) for before in block.table.first_rows)
    content = hashlib.sha256(block.members.astype("<i8").tobytes()).hexdigest()
    name = f"{int(block.members[0]):012d}-{content[:16]}"
    return Part(name, rows)


def write_part(path: Path, block: Block) -> None:
    """Write a block, all of whose members are solved, to the store at ``path``.

    A part with the same members is the same part, and is left as it is.

    Raise FileError if the store cannot be written.
    """
    assert block.windows is not None
    name = part_of(block).name
    if _file(path, name, _TABLE).is_file():
        return
    write_tensors(_file(path, name, _WINDOWS), _WINDOWS, block.windows._asdict(), {})
    arrays, values = packed(block.table)
    table = {**arrays, "members": block.members}
    write_tensors(_file(path, name, _TABLE), _TABLE, table, {"table": values})


def read_parts(path: Path) -> list[Block]:
    """Return the parts of a store, in the order of their names, without their windows.

    A part with members of an earlier one is left out: a task of an interrupted call ended late.

    Raise FileError if a part is damaged.
    """
    files = sorted((path / FOLDER).glob(f"*{_ENDINGS[_TABLE]}"))
    found, seen = [], set[int]()
    for file in files:
        try:
            arrays, values = read_tensors(file, _TABLE)
            members = arrays.pop("members")
            table = unpacked(Table, arrays, values["table"])
        except MALFORMED as error:
            raise FileError(
                f"{one_line(error)}; remove it, and its members are solved again"
            ) from None
        if seen.isdisjoint(members.tolist()):
            found.append(Block(members, table, None))
            seen.update(members.tolist())
    return found


def windows_of(path: Path, parts: Sequence[Part], shapes: Mapping[str, tuple[int, ...]]) -> Windows:
    """Return the windows of consecutive parts, which are read when they are needed.

    Raise ValueError if those of a part are missing.
    """
    if not all(_file(path, part.name, _WINDOWS).is_file() for part in parts):
        raise ValueError("windows are missing")
    reader = _Reader(path, parts, shapes)
    return Windows(
        *(
            Rows(reader.array_of(name), [part.rows[k] for part in parts], shapes[name])
            for k, name in enumerate(Windows._fields)
        )
    )


def _file(path: Path, name: str, kind: str) -> Path:
    return path / FOLDER / f"{name}{_ENDINGS[kind]}"


class _Reader:
    """Reader of the windows of parts, which keeps those of some parts."""

    def __init__(
        self, path: Path, parts: Sequence[Part], shapes: Mapping[str, tuple[int, ...]]
    ) -> None:
        self._path, self._parts, self._shapes = path, parts, shapes
        self._kept: dict[int, dict[str, np.ndarray]] = {}
        self._size = 0  # bytes of those

    def array_of(self, name: str) -> Callable[[int], np.ndarray]:
        """Return the function from the number of a part to one of its arrays."""
        return lambda place: self._windows(place)[name]

    def _windows(self, place: int) -> dict[str, np.ndarray]:
        """Return the windows of a part.

        Raise FileError if they are damaged.
        """
        if (known := self._kept.get(place)) is not None:
            return known
        part = self._parts[place]
        file = _file(self._path, part.name, _WINDOWS)
        found, _ = read_tensors(file, _WINDOWS)
        for (name, row), count in zip(self._shapes.items(), part.rows, strict=True):
            array = found.get(name)
            if array is None or array.shape != (count, *row) or array.dtype != np.float64:
                raise FileError(f"'{file}' is damaged: '{name}' is not of float64 and {count} rows")
        size = sum(array.nbytes for array in found.values())
        if self._size + size > _KEPT:
            self._kept, self._size = {}, 0
        self._kept[place] = found
        self._size += size
        return found
