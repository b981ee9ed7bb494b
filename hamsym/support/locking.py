"""Locks of directories that one process at a time writes to."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from hamsym.errors import FileError

#: Name of the lock file in a directory; it is empty and is not deleted.
LOCK = ".lock"


@contextmanager
def exclusive(directory: str | os.PathLike[str], file: Path | None = None) -> Iterator[None]:
    """Lock a directory against other processes; the system releases the lock of a dead process.

    Raise FileError if another process has the lock, or the directory cannot be written.

    - file: The lock file, where it is not to be in the directory.
    """
    lock = FileLock(Path(directory) / LOCK if file is None else file)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        raise FileError(
            f"'{directory}' is in use by another process of hamsym; wait until it ends, or give "
            "another directory"
        ) from None
    except OSError as error:
        raise FileError(f"'{directory}' cannot be locked: {error.strerror or error}") from None
    try:
        yield
    finally:
        lock.release()
