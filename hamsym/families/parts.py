"""Parts of a store of zarr: the results of some members, written once and then never changed.

A part is a group with the windows, and with the table of its members as bytes in the safetensors
format. It is written beside its place and renamed, so that it is there as a whole or not at all.
Each process of a cluster may write its own.
"""

from __future__ import annotations

import hashlib
import math
import os
import re
import shutil
import uuid
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import safetensors.numpy

from hamsym.errors import FileError
from hamsym.families.blocks import Block
from hamsym.families.windows import MARCHED, Table, Windows
from hamsym.support.record_fields import fields_of
from hamsym.support.records import packed, unpacked
from hamsym.support.tables import optional_package
from hamsym.support.tensor_files import one_line

FOLDER = "parts"
#: Name of a part: its first member, and a digest of all.
NAME = re.compile(r"\d{12,}-[0-9a-f]{16}")
_CHUNK = 2**20  # bytes of a chunk
_TABLE = "table"


class Part(NamedTuple):
    """A part of a store: its name, and its number of rows in each array of the windows."""

    name: str
    rows: tuple[int, ...]


def zarr_of() -> Any:
    """Return the module zarr."""
    return optional_package("zarr", "a store", '"zarr>=3"')


def create_array(
    group: Any, name: str, shape: tuple[int, ...], dtype: str, most: int | None = None
) -> None:
    """Create an array with checksums in a group, with at most ``most`` rows in a chunk."""
    from zarr.codecs import Crc32cCodec

    inner = [max(1, length) for length in shape[1:]]
    rows = _CHUNK // (math.prod(inner) * np.dtype(dtype).itemsize)
    group.create_array(
        name,
        shape=shape,
        chunks=(max(1, min(rows, most or rows)), *inner),
        dtype=dtype,
        compressors=[Crc32cCodec()],  # numbers that are not compressible, with a checksum
        # A lost chunk reads as NaN, which is no window.
        fill_value=math.nan if dtype == "float64" else 0,
        overwrite=True,
    )


def part_of(block: Block) -> Part:
    """Return the name and the rows of a part from the table of its members."""
    table = block.table
    edges = int((table.counts + 1)[table.counts > 0].sum())
    windows, marched = int(table.counts.sum()), int(table.counts[table.status == MARCHED].sum())
    content = hashlib.sha256(block.members.astype("<i8").tobytes()).hexdigest()
    name = f"{int(block.members[0]):012d}-{content[:16]}"
    return Part(name, (edges, edges, windows, marched, marched))


def write_part(path: Path, block: Block) -> Part:
    """Write a block, all of whose members are solved, to the store at ``path``.

    A part with the same members is the same part, and is left as it is.

    Raise FileError if the store cannot be written.
    """
    assert block.windows is not None
    arrays, part = block.windows._asdict(), part_of(block)
    place = path / FOLDER / part.name
    if place.is_dir():
        return part
    aside = path / FOLDER / f".{part.name}-{uuid.uuid4().hex}"
    columns = packed(block.table)[0] | {"members": block.members}
    table = safetensors.numpy.save({k: np.array(v, order="C") for k, v in columns.items()})
    try:
        group = zarr_of().open_group(aside, mode="w")
        for name, array in (arrays | {_TABLE: np.frombuffer(table, dtype=np.uint8)}).items():
            create_array(group, name, array.shape, array.dtype.name)
            if array.size:
                group[name][...] = array
        os.rename(aside, place)
    except OSError as error:
        shutil.rmtree(aside, ignore_errors=True)
        if not place.is_dir():  # else another process has written it
            raise FileError(f"'{path}' cannot be written: {error.strerror or error}") from None
    return part


def read_parts(path: Path) -> list[Block]:
    """Return the parts of a store, in the order of their names, without their windows.

    A part with members of an earlier one is left out: a task of an interrupted call ended late.

    Raise FileError if a part is damaged.
    """
    names = sorted(entry.name for entry in os.scandir(path / FOLDER) if NAME.fullmatch(entry.name))
    found, seen = [], set[int]()
    for name in names:
        try:
            content = np.asarray(_array(path, name, _TABLE)[...]).tobytes()
            columns: dict[str, Any] = safetensors.numpy.load(content)
            members = columns.pop("members")
            table = unpacked(Table, columns, dict.fromkeys(fields_of(Table)) | {"stopped": ""})
        except Exception as error:  # of any codec
            raise FileError(
                f"'{path / FOLDER / name}' is damaged: {one_line(error)}; remove it, and its "
                "members are solved again"
            ) from None
        if seen.isdisjoint(members.tolist()):
            found.append(Block(members, table, None))
            seen.update(members.tolist())
    return found


def _array(path: Path, part: str, name: str) -> Any:
    return zarr_of().open_array(path / FOLDER / part / name, mode="r")


def windows_of(path: Path, parts: Sequence[Part], shapes: Mapping[str, tuple[int, ...]]) -> Windows:
    """Return the windows of consecutive parts, which are read when they are needed.

    Raise ValueError if an array of a part is missing.
    """
    for part in parts:
        for name in shapes:
            if not (path / FOLDER / part.name / name / "zarr.json").is_file():
                raise ValueError("windows are missing")
    return Windows(
        *(
            _PartRows(path, name, [(part.name, part.rows[k]) for part in parts], shapes[name])
            for k, name in enumerate(Windows._fields)
        )
    )


class _PartRows:
    """Rows of one array of all parts, one part after the other."""

    def __init__(
        self, path: Path, name: str, parts: Sequence[tuple[str, int]], shape: tuple[int, ...]
    ) -> None:
        self._path, self._name, self._shape = path, name, shape
        self._parts = [part for part, _ in parts]
        self._ends = np.cumsum([0, *(rows for _, rows in parts)])
        self._open: dict[int, Any] = {}

    def __len__(self) -> int:
        return int(self._ends[-1])

    def rows(self, start: int, stop: int) -> np.ndarray:
        """Rows of a range.

        Raise FileError if the store is damaged.
        """
        first = max(0, int(np.searchsorted(self._ends, start, side="right")) - 1)
        found = [np.empty((0, *self._shape))]
        while first < len(self._parts) and self._ends[first] < stop:
            low, high = (int(end) for end in self._ends[first : first + 2])
            if low < high:
                found.append(self._read(first, max(start, low) - low, min(stop, high) - low))
            first += 1
        return found[1] if len(found) == 2 else np.concatenate(found)

    def _read(self, place: int, start: int, stop: int) -> np.ndarray:
        try:
            if place not in self._open:
                self._open[place] = _array(self._path, self._parts[place], self._name)
            array = self._open[place]
            rows = int(self._ends[place + 1] - self._ends[place])
            if array.shape != (rows, *self._shape) or array.dtype != np.float64:
                raise ValueError(f"'{self._name}' is not of type float64 and {rows} rows")
            found = np.asarray(array[start:stop])
        except Exception as error:  # of any codec
            raise FileError(f"'{self._path}' is damaged: {one_line(error)}") from None
        if np.isnan(found).any():
            raise FileError(f"'{self._path}' is damaged: windows are missing")
        return found
