"""Cache on disk: source files of compiled modules, with their compiled code, and derived texts.

Compiled code is stored next to the source as pickles (:mod:`hamsym.codegen.checked_cache`), so
anybody with write access there can run code. The cache is therefore one directory that only the
user can write. Entries that were not used for a long time are removed. Integrators and proofs
compile code, and so do functions of the backend "numba".
"""

from __future__ import annotations

import atexit
import functools
import hashlib
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

from hamsym.support.atomic import write_atomically

_VARIABLE = "HAMSYM_CACHE_DIR"
_DAY = 86_400.0  # seconds
_UNUSED = 90 * _DAY  # age since the last use at which a file is removed
_LARGEST = 512 * 2**20  # size limit in bytes; files used within a day are kept beyond it
_SLOW = 0.05  # seconds of derivation above which a text is cached


@functools.cache
def cache_directory() -> Path:
    """Directory of the cache: $HAMSYM_CACHE_DIR, or hamsym in the user's cache directory.

    If it cannot be created, or other users can write to it, a temporary directory of this process
    is used instead; the next process then compiles again.
    """
    chosen = os.environ.get(_VARIABLE)
    try:
        path = Path(chosen).expanduser() if chosen else _user_cache() / "hamsym"
        # numba would create the second one with the permissions of the user's umask.
        for folder in (path, path / "__pycache__"):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        private = _is_private(path) and _is_private(path / "__pycache__")
    except (OSError, RuntimeError):  # RuntimeError: no home directory
        private = False
    if private:
        return path.resolve()
    temporary = tempfile.mkdtemp(prefix="hamsym-")  # created with mode 0o700
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return Path(temporary)


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _is_private(path: Path) -> bool:
    """Whether the user owns a directory and no other user can write to it."""
    try:
        status = path.lstat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode) or not os.access(path, os.W_OK):
        return False
    if not hasattr(os, "getuid"):  # not POSIX: the user's folders are private by default
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def load_module(source: str, name: str) -> ModuleType:
    """Execute a source as a module, and store it as a file in the cache directory.

    The given text is executed, never the stored file or bytecode next to it.
    """
    digest = hashlib.sha256(source.encode()).hexdigest()[:16]
    path = cache_directory() / f"{name}_{digest}.py"
    if not _is_stored(path, source):
        write_atomically(path, source.encode())
        _prune(path.parent)
    module = ModuleType(f"hamsym_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # numba imports functions of its cache from there
    exec(compile(source, str(path), "exec", dont_inherit=True), module.__dict__)  # noqa: S102
    return module


def cached_text(key: str, make: Callable[[], str]) -> str:
    """Read a text from the cache, or make it and store it if that was slow.

    The file begins with a digest of the key and the text. A file with another digest, damaged or
    edited, is replaced.
    """
    path = cache_directory() / f"text_{hashlib.sha256(key.encode()).hexdigest()[:32]}.txt"
    try:
        digest, _, text = path.read_text("utf-8").partition("\n")
        if digest == _digest(key, text):
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
            return text
    except (OSError, ValueError):  # missing, or not text
        pass
    began = time.process_time()
    text = make()
    if time.process_time() - began > _SLOW:
        write_atomically(path, f"{_digest(key, text)}\n{text}".encode())
        _prune(path.parent)
    return text


def _digest(key: str, text: str) -> str:
    return hashlib.sha256(f"{key}\n{text}".encode()).hexdigest()


# -- pruning ---------------------------------------------------------------------------------------


def _is_stored(path: Path, source: str) -> bool:
    """Whether a file contains this source; its access time is set to now.

    The modification time is unchanged: it is that of the content.
    """
    try:
        os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
        return path.read_bytes() == source.encode()
    except OSError:
        return False


def _prune(folder: Path) -> None:
    """Once a day, remove old entries, and the oldest ones while the size limit is exceeded.

    Entries used within the last day are kept, so that no process loses a file between checking and
    loading it. Two processes can prune at the same time.
    """
    now, stamp = time.time(), folder / "pruned"
    try:
        if stamp.exists() and now - stamp.stat().st_mtime < _DAY:
            return
        stamp.touch()
        used, files = dict[str, float](), dict[str, list[tuple[Path, int]]]()
        for file in (
            *folder.glob("*.py"),
            *folder.glob("*.txt"),
            *folder.glob("__pycache__/*"),
            *folder.glob(".hamsym-*"),
        ):
            # A source and its compiled files are one entry; its age counts from the last use.
            status, entry = file.stat(), file.name.partition(".")[0] or file.name
            latest = status.st_atime if file.suffix in (".py", ".txt") else status.st_mtime
            used[entry] = max(used.get(entry, 0.0), latest)
            files.setdefault(entry, []).append((file, status.st_size))
        total = sum(size for entry in files.values() for _, size in entry)
        for entry in sorted(used, key=used.__getitem__):
            age = now - used[entry]
            if age < _DAY or (age < _UNUSED and total <= _LARGEST):
                break
            for file, size in files[entry]:
                file.unlink(missing_ok=True)
                total -= size
    except OSError:  # for example: another process has removed a file
        return
