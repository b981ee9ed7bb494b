"""Atomic writing of files."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

__all__ = ["write_atomically"]


def write_atomically(path: Path, content: bytes) -> None:
    """Write a file so that it has either the old or the new content at any time.

    A symbolic link is followed, and a file keeps its permissions. Devices and pipes, which cannot
    be replaced, are appended to.
    """
    try:
        status = os.stat(path)
    except FileNotFoundError:
        status = None
    if status is not None and not _is_replaceable(status):
        with open(path, "ab") as file:
            file.write(content)
        return
    target = Path(os.path.realpath(path))
    handle, temporary = tempfile.mkstemp(dir=target.parent, prefix=".hamsym-")
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, _new_mode() if status is None else stat.S_IMODE(status.st_mode))
        os.replace(temporary, target)
    except BaseException:
        os.unlink(temporary)
        raise


def _is_replaceable(status: os.stat_result) -> bool:
    """Return whether a file is a regular file other than the output of this process."""
    return stat.S_ISREG(status.st_mode) and not any(
        os.path.samestat(status, own) for own in _outputs()
    )


def _outputs() -> list[os.stat_result]:
    """Return the status of standard output and standard error."""
    found = []
    for descriptor in (1, 2):
        try:
            found.append(os.fstat(descriptor))
        except OSError:  # it is closed
            continue
    return found


def _new_mode() -> int:
    umask = os.umask(0)  # the umask can be read only by setting it
    os.umask(umask)
    return 0o666 & ~umask
