"""Atomic writing of files and directories, by way of temporary ones.

Names of temporary ones tell who writes them: the machine, with its namespace of processes, and the
process. The next writer removes those of processes of this machine that do not run any more.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import re
import shutil
import stat
import uuid
from collections.abc import Callable
from pathlib import Path

from hamsym.errors import FileError

_NAME = re.compile(r"\.hamsym-(?P<machine>[0-9a-f]{12})-(?P<process>\d{1,10})-[0-9a-f]{32}")


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
    remove_leftovers(target.parent)
    temporary = target.parent / temporary_name()
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
    remove_leftovers(path.parent)
    aside = path.parent / temporary_name()
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


# -- temporary files -------------------------------------------------------------------------------


def temporary_name() -> str:
    """Return a new name for a temporary file or directory of this process."""
    return f".hamsym-{_machine()}-{os.getpid()}-{uuid.uuid4().hex}"


@functools.lru_cache(maxsize=1_024)
def remove_leftovers(folder: Path) -> None:
    """Remove what writers that were killed left in a folder; once in a process."""
    try:
        names = os.listdir(folder)
    except OSError:
        return
    for name in names:
        found = _NAME.fullmatch(name)
        if found and found["machine"] == _machine() and not _runs(int(found["process"])):
            path = folder / name
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)


@functools.cache
def _machine() -> str:
    try:
        space = os.readlink("/proc/self/ns/pid")  # containers share names of hosts
    except OSError:
        space = ""
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:12]


def _runs(process: int) -> bool:
    """Whether a process runs, or it cannot be told."""
    if os.name != "posix":  # there a signal would end it
        return True
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):
        return True
    return True
