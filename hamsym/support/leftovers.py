"""Temporary files and directories of writers, which the next writer removes after a kill.

Their names tell who writes them: the machine, with its namespace of processes, and the process.
Only those of processes of this machine that do not run any more are removed.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import re
import shutil
import uuid
from pathlib import Path

_NAME = re.compile(r"\.hamsym-(?P<machine>[0-9a-f]{12})-(?P<process>\d{1,10})-[0-9a-f]{32}")


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
