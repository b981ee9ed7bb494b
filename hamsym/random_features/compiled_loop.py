"""Compilation of the loop over windows (:mod:`hamsym.random_features.window_loop`) by numba."""

from __future__ import annotations

import functools
import importlib.resources
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hamsym.codegen.numba_cache import cache_directory, load_module, source_file
from hamsym.codegen.system import System
from hamsym.random_features import window_loop

__all__ = ["compiled_loop", "compiled_rates", "cost"]


def cost() -> float:
    """Return the seconds that compiling a march may take: 1 from the cache, 10 without."""
    stem = source_file(_loop_source(), "window_loop").stem
    cached = any((cache_directory() / "__pycache__").glob(f"{stem}.march_windows-*.nbc"))
    return 1.0 if cached else 10.0


def _loop_source() -> str:
    folder = importlib.resources.files("hamsym.random_features")
    return folder.joinpath("window_loop.py").read_text("utf-8")


@functools.cache
def compiled_loop() -> Callable[..., int]:
    """Compile ``march_windows``, which takes seconds the first time on a machine."""
    import numba
    from numba import types

    module: Any = load_module(_loop_source(), "window_loop")
    options = {"cache": True, "error_model": "numpy"}
    module.column_sizes = numba.njit(**options)(module.column_sizes_in_loops)
    for name in ("typical_sizes", "iterate", "judge"):
        setattr(module, name, numba.njit(**options)(getattr(module, name)))
    vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
    number, counts = types.float64, types.int64[::1]
    arguments = {
        window_loop.Tables: (
            *(vector, matrix, matrix, vector, matrix, matrix),
            *(vector, vector, matrix),
        ),
        window_loop.Settings: (vector, number, vector, matrix, number, number),
        window_loop.Progress: (vector, counts, vector, matrix, matrix),
        window_loop.Windows: (vector, matrix, cube),
    }
    tuples = [types.BaseTuple.from_types(parts, kind) for kind, parts in arguments.items()]
    signature = types.int64(types.FunctionType(_rates_signature()), *tuples, types.boolean)
    return _compiled(signature, module.march_windows)


@functools.lru_cache(maxsize=64)
def compiled_rates(system: System) -> Callable[..., None]:
    """Compile ``rates`` of a generated numba module for :func:`compiled_loop`."""
    assert system.rates is not None  # every parameter has a value
    rates: Any = system.rates
    return _compiled(_rates_signature(), rates.py_func)


def _compiled(signature: Any, function: Any) -> Any:
    """Compile a function for one signature, or load it from the cache."""
    import numba

    compiler = numba.njit(signature, cache=True, error_model="numpy")
    try:
        return compiler(function)
    except Exception:
        # The cached files are damaged, or were written by other versions.
        path = Path(function.__code__.co_filename)
        for file in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb?"):
            file.unlink(missing_ok=True)
    try:
        return compiler(function)
    except Exception:  # an unusable cache directory, e.g. in $NUMBA_CACHE_DIR
        return numba.njit(signature, error_model="numpy")(function)


def _rates_signature() -> Any:
    from numba import types

    matrix = types.float64[:, ::1]
    return types.void(matrix, types.float64[::1], matrix)
