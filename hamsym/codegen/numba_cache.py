"""The cache on disk: sources as real files, so that numba can cache, and texts slow to derive.

numba keeps what it has compiled beside the source, as pickles; who can write there can run code.
Everything is therefore kept in one directory that only the user can write, and what was not used
for long is removed from it. Nothing is compiled unless somebody asks for it
(``compiled=True``, an integrator) or it saves time (:mod:`hamsym.random_features.march`).
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

__all__ = ["cache_directory", "cached_text", "load_module"]

_VARIABLE = "HAMSYM_CACHE_DIR"
_DAY = 86_400.0  # seconds
_UNUSED = 90 * _DAY  # after which a file is removed
_LARGEST = 512 * 2**20  # bytes that are kept, but for what was used within a day
_SLOW = 0.05  # seconds that making a text takes, from which on it is kept


@functools.cache
def cache_directory() -> Path:
    """The directory of compiled sources: $HAMSYM_CACHE_DIR, or hamsym in the user's cache.

    Where that cannot be made, or others could write it, a temporary directory of this process
    takes its place, and what is compiled is compiled again by the next one.
    """
    chosen = os.environ.get(_VARIABLE)
    try:
        path = Path(chosen).expanduser() if chosen else _user_cache() / "hamsym"
        # numba would make the second one open to whomever the user's umask lets in.
        for folder in (path, path / "__pycache__"):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        private = _is_private(path) and _is_private(path / "__pycache__")
    except (OSError, RuntimeError):  # such as a user without a home
        private = False
    if private:
        return path.resolve()
    temporary = tempfile.mkdtemp(prefix="hamsym-")  # made for this user alone
    atexit.register(shutil.rmtree, temporary, ignore_errors=True)
    return Path(temporary)


def _user_cache() -> Path:
    if sys.platform == "win32":
        return Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")


def _is_private(path: Path) -> bool:
    """Whether the user owns a directory that nobody else can write."""
    try:
        status = path.lstat()
    except OSError:
        return False
    if not stat.S_ISDIR(status.st_mode) or not os.access(path, os.W_OK):
        return False
    if not hasattr(os, "getuid"):  # elsewhere the user's own folders are private by default
        return True
    return status.st_uid == os.getuid() and not status.st_mode & (stat.S_IWGRP | stat.S_IWOTH)


def load_module(source: str, name: str) -> ModuleType:
    """A module of the given source, which is also a file of the cache directory.

    What runs is this text: neither the file nor bytecode that lies beside it.
    """
    path = source_file(source, name)
    if not _is_there(path, source):
        write_atomically(path, source.encode())
        _prune(path.parent)
    module = ModuleType(f"hamsym_{path.stem}")
    module.__file__ = str(path)
    sys.modules[module.__name__] = module  # numba looks there for what it loads from its cache
    exec(compile(source, str(path), "exec", dont_inherit=True), module.__dict__)  # noqa: S102
    return module


def cached_text(key: str, make: Callable[[], str]) -> str:
    """A text from the cache, or a new one, which is kept if it was slow to make.

    The file begins with a digest of the key and the text. A file whose digest differs, because it
    was damaged or edited, is not used and is replaced.
    """
    path = cache_directory() / f"text_{hashlib.sha256(key.encode()).hexdigest()[:32]}.txt"
    try:
        digest, _, text = path.read_text("utf-8").partition("\n")
        if digest == _digest(key, text):
            os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
            return text
    except (OSError, ValueError):  # there is none, or it is not text
        pass
    began = time.process_time()
    text = make()
    if time.process_time() - began > _SLOW:
        write_atomically(path, f"{_digest(key, text)}\n{text}".encode())
        _prune(path.parent)
    return text


def _digest(key: str, text: str) -> str:
    return hashlib.sha256(f"{key}\n{text}".encode()).hexdigest()


# -- what the cache may keep -----------------------------------------------------------------------


def _is_there(path: Path, source: str) -> bool:
    """Whether a file has this source; that it is used now is noted as its time of access.

    The time of its last change stays, by which numba judges what it has compiled.
    """
    try:
        os.utime(path, ns=(time.time_ns(), path.stat().st_mtime_ns))
        return path.read_bytes() == source.encode()
    except OSError:
        return False


def _prune(folder: Path) -> None:
    """Once a day remove what was not used for long, and the oldest where all is too much.

    What was used within the last day stays, so that no process loses a file between looking at it
    and loading it. Two processes that do this at the same time do each other no harm.
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
            # A source and what was compiled of it are one entry, as old as its last use.
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
    except OSError:  # such as a file that another process has removed
        return


def source_file(source: str, name: str) -> Path:
    digest = hashlib.sha256(source.encode()).hexdigest()[:16]
    return cache_directory() / f"{name}_{digest}.py"
