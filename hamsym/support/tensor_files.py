"""Files of tensors and JSON in the safetensors format, which contain nothing to execute.

Numbers are stored exactly. A file is replaced in one step, so that at any moment either the old one
or the new one exists. It contains the SHA-256 of all its bytes, with zeros in place of the checksum
itself, so that damage to any byte is detected. Arrays with the same numbers are stored once.
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
from hamsym.support.atomic import write_file

Arrays = dict[str, np.ndarray]

_VERSION = 3
_KEY = "hamsym"
_NO_CHECKSUM = "0" * 64
_SMALL = 256  # bytes; a smaller array is not longer than the note that it is repeated
_DTYPES = {"F64", "F32", "I64", "U8"}  # as safetensors names them
_LARGEST_HEADER = 4_000_000  # bytes; a formula has 50,000 characters at most
_LARGEST_FILE = 2**34  # bytes, more than a solution with the largest number of windows


def write_tensors(
    path: str | os.PathLike[str],
    kind: str,
    arrays: Mapping[str, np.ndarray],
    values: Mapping[str, Any],
) -> None:
    """Write named arrays and JSON values as a file of the given kind.

    Raise FileError if the file cannot be written; an existing file is left unchanged.
    """
    # The checksum comes first, so that the first run of zeros of its length is its place.
    own, same = _once(arrays)
    head = {"sha256": _NO_CHECKSUM, "version": _VERSION, "kind": kind, "same": same}
    try:
        text = json.dumps({**head, "values": values})
        content = safetensors.numpy.save(own, metadata={_KEY: text})
    except (TypeError, ValueError) as error:
        raise FileError(f"'{path}' cannot be written: {one_line(error)}") from None
    (header,) = struct.unpack("<Q", content[:8])
    if header > _LARGEST_HEADER or len(content) > _LARGEST_FILE:
        raise FileError(
            f"'{path}' cannot be written: it would be larger than the largest file that "
            "hamsym reads"
        )
    place = content.index(_NO_CHECKSUM.encode())
    content = content[:place] + _checksum(content, place).encode() + content[place + 64 :]
    write_file(path, content)


def read_tensors(
    path: str | os.PathLike[str], kind: str
) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays and values of a file that :func:`write_tensors` wrote.

    Raise FileError if the file cannot be read, is damaged, of another kind or of another version.
    """
    try:
        size = _size(Path(path))
        with open(path, "rb") as file:
            header, head = _header(file, size)
            version, found = head.pop("version", None), head.pop("kind", None)
            if found != kind:
                raise FileError(f"'{path}' is a file of kind {_shown(found)}, not {kind}")
            if version != _VERSION:
                raise FileError(
                    f"'{path}' has file version {_shown(version)}; this hamsym reads version "
                    f"{_VERSION}; solve again"
                )
            file.seek(0)
            content = file.read(size)
    except _DamagedError:
        raise FileError(f"'{path}' is damaged or not a file of hamsym") from None
    except (OSError, ValueError, TypeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"'{path}' cannot be read: {reason}") from None
    claimed = head.pop("sha256", None)
    place = content.find(claimed.encode()) if isinstance(claimed, str) else -1
    if place < 0 or claimed != _checksum(content, place):
        raise FileError(f"'{path}' is damaged: its checksum does not match its content")
    try:
        for name, entry in header.items():
            if entry["dtype"] not in _DTYPES:
                raise ValueError(f"'{name[:40]}' is of type {_shown(entry['dtype'])}")
        # Copies, since the loaded arrays share one read-only buffer.
        own = {name: array.copy() for name, array in safetensors.numpy.load(content).items()}
        if {*head} != {"same", "values"} or not isinstance(head["values"], dict):
            raise ValueError("it has no values")
        return _all(own, head["same"]), head["values"]
    except (
        *(safetensors.SafetensorError, AssertionError, KeyError, RuntimeError),
        *(AttributeError, OverflowError, TypeError, ValueError),
    ) as error:
        raise FileError(f"'{path}' is damaged: {one_line(error)}") from None


def kind_of(path: str | os.PathLike[str]) -> str | None:
    """Return the kind that a file states, or None if it states none that can be read."""
    try:
        size = _size(Path(path))
        with open(path, "rb") as file:
            kind = _header(file, size)[1].get("kind")
    except (_DamagedError, OSError, ValueError, TypeError):
        return None
    return kind if isinstance(kind, str) else None


def one_line(error: Exception) -> str:
    """Return the message of an error as part of one sentence."""
    return " ".join(str(error).split())[:200]


class _DamagedError(Exception):
    """The header cannot be read."""


def _once(arrays: Mapping[str, np.ndarray]) -> tuple[Arrays, dict[str, list[Any]]]:
    """Return arrays without repetitions, and of each repetition the first name and its shape."""
    own, same = {}, {}
    known: dict[tuple[str, bytes], str] = {}
    for name, array in arrays.items():
        whole = np.array(array, order="C")
        key = (whole.dtype.name, hashlib.sha256(whole.tobytes()).digest())
        first = known.setdefault(key, name)
        if first == name or whole.nbytes < _SMALL:
            own[name] = whole
        else:
            same[name] = [first, [*whole.shape]]
    return own, same


def _all(own: Arrays, same: Any) -> Arrays:
    """Return the arrays of :func:`_once`.

    Raise ValueError if the names or shapes do not fit.
    """
    found = dict(own)
    for name, (first, shape) in same.items():
        if name in own or not all(type(length) is int and length >= 0 for length in shape):
            raise ValueError(f"'{name[:40]}' is stored twice, or has no shape")
        found[name] = own[first].reshape(shape)
    return found


def _size(path: Path) -> int:
    status = os.stat(path)
    if not stat.S_ISREG(status.st_mode):  # reading a pipe or a device may never end
        raise ValueError("it is not a regular file")
    if status.st_size > _LARGEST_FILE:
        raise ValueError("it is larger than any file that hamsym writes")
    return status.st_size


def _header(file: BinaryIO, size: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the description of the tensors, and the values; only the header is read."""
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
    return str(value)[:40] if isinstance(value, (str, int, float)) else type(value).__name__


def _checksum(content: bytes, place: int) -> str:
    """Return the SHA-256 of the content, with zeros for the checksum at ``place``."""
    whole = memoryview(content)
    found = hashlib.sha256(whole[:place])
    found.update(_NO_CHECKSUM.encode())
    found.update(whole[place + len(_NO_CHECKSUM) :])
    return found.hexdigest()
