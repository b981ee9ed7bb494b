"""Locks of folders that only one process at a time may write into."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from hamsym.errors import FileError

__all__ = ["LOCK", "exclusive"]

#: Name of the lock file in a folder; it stays there, and is empty.
LOCK = ".lock"


@contextmanager
def exclusive(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Keep other processes from writing into a folder; the system ends the lock of a dead process.

    Raises
    ------
    FileError
        If another process holds the lock, or the folder cannot be written.
    """
    lock = FileLock(Path(folder) / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise FileError(
            f"'{folder}' is in use by another process of hamsym that writes there; wait until it "
            "ends, or give another folder"
        ) from None
    except OSError as error:
        raise FileError(f"'{folder}' cannot be locked: {error.strerror or error}") from None
    try:
        yield
    finally:
        lock.release()
