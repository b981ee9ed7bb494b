"""The loop over windows (:mod:`hamsym.random_features.window_loop`), compiled by numba."""

from __future__ import annotations

import functools
import importlib.resources
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hamsym.codegen.numba_cache import cache_directory, load_module, source_file
from hamsym.codegen.system import System

__all__ = ["compiled_loop", "compiled_rates", "cost"]


def cost() -> float:
    """Seconds that compiling a march may take; it pays where more than that is saved."""
    stem = source_file(_loop_source(), "window_loop").stem
    known = any((cache_directory() / "__pycache__").glob(f"{stem}.march_windows-*.nbc"))
    return 1.0 if known else 10.0


def _loop_source() -> str:
    folder = importlib.resources.files("hamsym.random_features")
    return folder.joinpath("window_loop.py").read_text("utf-8")


@functools.cache
def compiled_loop() -> Callable[..., int]:
    """``march_windows``, compiled; that takes seconds the first time on a machine."""
    import numba
    from numba import types

    module: Any = load_module(_loop_source(), "window_loop")
    options = {"cache": True, "error_model": "numpy"}
    module.column_sizes = numba.njit(**options)(module.column_sizes_in_loops)
    module.typical_sizes = numba.njit(**options)(module.typical_sizes)
    vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
    signature = types.int64(
        types.FunctionType(_rates_signature()),
        vector,  # nodes
        matrix,  # integration
        matrix,  # fit
        vector,  # between
        matrix,  # to_between
        matrix,  # rates_between
        vector,  # end
        vector,  # end_low
        matrix,  # tail_fit
        vector,  # stops
        types.float64,  # tolerance
        vector,  # floors
        matrix,  # signs
        types.float64,  # shortest
        types.float64,  # longest
        types.boolean,  # given
        matrix,  # found
        vector,  # clock
        types.int64[::1],  # counts
        vector,  # sizes
        matrix,  # tail
        vector,  # edges
        matrix,  # states
        cube,  # readouts
    )
    return _compiled(signature, module.march_windows)


@functools.lru_cache(maxsize=64)
def compiled_rates(system: System) -> Callable[..., None]:
    """``rates`` of a generated numba module, compiled for :func:`compiled_loop`."""
    assert system.rates is not None  # every parameter has a value
    rates: Any = system.rates
    return _compiled(_rates_signature(), rates.py_func)


def _compiled(signature: Any, function: Any) -> Any:
    """A function for one signature, from the cache or to it."""
    import numba

    compiler = numba.njit(signature, cache=True, error_model="numpy")
    try:
        return compiler(function)
    except Exception:
        # What is in the cache was damaged, or written by versions that are no longer there.
        path = Path(function.__code__.co_filename)
        for file in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb?"):
            file.unlink(missing_ok=True)
    try:
        return compiler(function)
    except Exception:  # a cache elsewhere, such as in $NUMBA_CACHE_DIR, that cannot be used
        return numba.njit(signature, error_model="numpy")(function)


def _rates_signature() -> Any:
    from numba import types

    matrix = types.float64[:, ::1]
    return types.void(matrix, types.float64[::1], matrix)
