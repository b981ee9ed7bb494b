"""Cache of compiled functions whose files are checked by their digests before they are loaded.

numba's own cache trusts whatever lies in its folder, which an environment variable may choose, and
notices no damaged file. Here a file belongs to one text of a module, one signature, one processor
and one set of versions, and begins with a digest of all of these and of what it contains. The
folder is one that only the user can write (:mod:`hamsym.codegen.numba_cache`).
"""

from __future__ import annotations

import contextlib
import hashlib
import pickle
import platform
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba.core.caching import FunctionCache, NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

from hamsym.codegen.numba_cache import load_module
from hamsym.support.atomic import write_atomically

_DIGEST = hashlib.sha256
_VERSIONS = (
    *(platform.python_implementation(), platform.python_version()),
    *(numba.__version__, llvmlite.__version__, np.__version__),
)


def load_compiled(source: str, name: str) -> ModuleType:
    """Execute a source as a module, whose functions marked with ``cache=True`` are cached here.

    The arguments are those of :func:`hamsym.codegen.numba_cache.load_module`. The files lie in the
    folder ``__pycache__`` beside that of the module.
    """
    module = load_module(source, name)
    place = Path(str(module.__file__))
    stamp = repr((_DIGEST(source.encode()).hexdigest(), *_VERSIONS))
    for key, function in vars(module).items():
        if type(getattr(function, "_cache", None)) is FunctionCache:
            stem = place.parent / "__pycache__" / f"{place.stem}.{key}"
            function._cache = _CheckedCache(stem, f"{stamp} {key}")
    return module


class _CheckedCache(NullCache):  # type: ignore[misc]
    """The cache of one function, with one file for each signature."""

    def __init__(self, stem: Path, stamp: str) -> None:
        self._stem, self._stamp = stem, stamp

    @property
    def cache_path(self) -> str:
        return str(self._stem.parent)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The compiled function for a signature; None if there is no file with its digest."""
        context.refresh()
        path, key = self._place(signature, context.codegen())
        try:
            content = path.read_bytes()
        except OSError:
            return None
        size = _DIGEST().digest_size
        digest, payload = content[:size], content[size:]
        if digest != _digest(key, payload):
            return None
        return CompileResult._rebuild(context, *pickle.loads(payload))

    def save_overload(self, signature: Any, result: Any) -> None:
        """Write the file of a signature."""
        if result.library.has_dynamic_globals or not all(x.can_cache for x in result.lifted):
            return
        path, key = self._place(signature, result.codegen)
        payload = dumps(result._reduce())
        with contextlib.suppress(OSError):  # compiled again in the next process
            write_atomically(path, _digest(key, payload) + payload)

    def _place(self, signature: Any, codegen: Any) -> tuple[Path, str]:
        key = f"{self._stamp} {signature!r} {codegen.magic_tuple()!r}"
        name = f"{self._stem.name}.{_DIGEST(key.encode()).hexdigest()[:32]}.nbc"
        return self._stem.with_name(name), key


def _digest(key: str, payload: bytes) -> bytes:
    return _DIGEST(f"{key}\n".encode() + payload).digest()
