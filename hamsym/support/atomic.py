"""Atomic writing of files and directories, by way of temporary ones."""

from __future__ import annotations

import os
import shutil
import stat
import uuid
from collections.abc import Callable
from pathlib import Path

from hamsym.errors import FileError


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
    temporary = target.parent / _temporary_name()
    handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
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


def write_file(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file as :func:`write_atomically` does; raise FileError if that fails."""
    try:
        write_atomically(Path(path), content)
    except (OSError, ValueError, TypeError) as error:
        reason = getattr(error, "strerror", None) or error
        raise FileError(f"'{path}' cannot be written: {reason}") from None


def create_atomically(path: Path, fill: Callable[[Path], None]) -> None:
    """Create a directory so that it has either all of its first content or does not exist.

    - path: Must not exist.
    - fill: Creates the directory at the path that it is given.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    aside = path.parent / _temporary_name()
    try:
        fill(aside)
        os.rename(aside, path)
    except BaseException:
        shutil.rmtree(aside, ignore_errors=True)
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


def _temporary_name() -> str:
    return f".hamsym-{uuid.uuid4().hex}"
