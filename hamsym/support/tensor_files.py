"""Files that hold data and nothing to execute: tensors and JSON in one safetensors file.

Numbers are kept to the last bit. A file is replaced in one step, so that at any moment there is
either the old one or the new one. It holds the SHA-256 of all its bytes, with zeros in the place
of the checksum itself: damage anywhere in it is found.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import safetensors
import safetensors.numpy

from hamsym.errors import FileError
from hamsym.support.atomic import write_atomically

__all__ = ["one_line", "read_tensors", "write_tensors"]

_VERSION = 2
_KEY = "hamsym"
_NO_CHECKSUM = "0" * 64
_DTYPES = {"F64", "F32", "I64", "U8"}  # as safetensors names them
_LARGEST_HEADER = 4_000_000  # bytes; a formula has 50,000 characters at most
_LARGEST_FILE = 2**34  # bytes, more than a solution of the most windows has


def write_tensors(
    path: str | os.PathLike[str],
    kind: str,
    arrays: Mapping[str, np.ndarray],
    values: Mapping[str, Any],
) -> None:
    """Write named arrays, and values that JSON can hold, as a file of the given kind.

    Raises
    ------
    FileError
        If the file cannot be written; what was there before is still there.
    """
    # The checksum comes first, so that the first zeros like it in the file are its place.
    text = json.dumps({"sha256": _NO_CHECKSUM, "version": _VERSION, "kind": kind, **values})
    content = safetensors.numpy.save(
        {name: np.array(array, order="C") for name, array in arrays.items()},
        metadata={_KEY: text},
    )
    (header,) = struct.unpack("<Q", content[:8])
    if header > _LARGEST_HEADER or len(content) > _LARGEST_FILE:
        raise FileError(f"'{path}' cannot be written: it would be too large to be read again")
    place = content.index(_NO_CHECKSUM.encode())
    content = content[:place] + _checksum(content, place).encode() + content[place + 64 :]
    try:
        write_atomically(Path(path), content)
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"'{path}' cannot be written: {_reason(error)}") from None


def read_tensors(
    path: str | os.PathLike[str], kind: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Arrays and values of a file that :func:`write_tensors` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, of another kind or of another version.
    """
    try:
        size = _size(Path(path))
        with open(path, "rb") as file:
            header, values = _header(file, size)
            version, found = values.pop("version", None), values.pop("kind", None)
            if found != kind:
                raise FileError(f"'{path}' holds a {_shown(found)}, not a {kind}")
            if version != _VERSION:
                without = ", which has no checksum" if version == 1 else ""
                raise FileError(
                    f"'{path}' is of version {_shown(version)}{without}; this hamsym reads version "
                    f"{_VERSION}, so solve again with it"
                )
            file.seek(0)
            content = file.read(size)
    except _DamagedError:
        raise FileError(f"'{path}' is damaged or no file of hamsym") from None
    except (OSError, ValueError, TypeError) as error:
        raise FileError(f"'{path}' cannot be read: {_reason(error)}") from None
    claimed = values.pop("sha256", None)
    place = content.find(claimed.encode()) if isinstance(claimed, str) else -1
    if place < 0 or claimed != _checksum(content, place):
        raise FileError(f"'{path}' is damaged: its checksum is not that of what it holds")
    try:
        for name, entry in header.items():
            if entry["dtype"] not in _DTYPES:
                raise ValueError(f"'{name[:40]}' is of type {_shown(entry['dtype'])}")
        # Copies, since what is loaded shares one buffer that cannot be written.
        arrays = safetensors.numpy.load(content)
        return {name: array.copy() for name, array in arrays.items()}, values
    except (
        *(safetensors.SafetensorError, AssertionError, KeyError, RuntimeError),
        *(OverflowError, TypeError, ValueError),
    ) as error:
        raise FileError(f"'{path}' is damaged: {one_line(error)}") from None


def one_line(error: Exception) -> str:
    """What an error says, as part of one sentence."""
    return " ".join(str(error).split())[:200]


class _DamagedError(Exception):
    """The header cannot be read."""


def _size(path: Path) -> int:
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):  # reading another might never end
        raise ValueError("it is no regular file")
    if status.st_size > _LARGEST_FILE:
        raise ValueError("it is larger than any file that hamsym writes")
    return status.st_size


def _header(file: BinaryIO, size: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """What the header says of the tensors, and the values; nothing else is read."""
    length = int.from_bytes(file.read(8), "little")
    if not 0 < length <= min(_LARGEST_HEADER, size - 8):
        raise _DamagedError
    try:
        header = json.loads(file.read(length))
        values = json.loads(header.pop("__metadata__")[_KEY])
        ends = [entry["data_offsets"][1] for entry in header.values()]
        if not isinstance(values, dict) or max(ends) != size - 8 - length:
            raise _DamagedError
    except (AttributeError, LookupError, RecursionError, TypeError, ValueError):
        raise _DamagedError from None
    return header, values


def _shown(value: object) -> str:
    return str(value)[:40] if isinstance(value, (str, int, float)) else "thing of no name"


def _checksum(content: bytes, place: int) -> str:
    """SHA-256 of the content, with zeros for the checksum that is at this place in it."""
    whole = memoryview(content)
    found = hashlib.sha256(whole[:place])
    found.update(_NO_CHECKSUM.encode())
    found.update(whole[place + len(_NO_CHECKSUM) :])
    return found.hexdigest()


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or str(error)
