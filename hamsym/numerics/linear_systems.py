"""Systems of linear equations, of one or many windows, and the threads of BLAS that solve them.

The threads of BLAS wait for each other busily. Where other processes compute, each of its many
products may wait for a turn of the processor: a system of 216 unknowns, solved in half a
millisecond by one thread, was seen to take 200 with two.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext

import numpy as np
import threadpoolctl

from hamsym.numerics.shared_state import Shared

_SMALL = 600  # unknowns, up to which one thread is as good as two


def solved(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Solve systems, shapes (..., n, n) and (..., n, m); all are nan if one of them is singular."""
    try:
        with blas_on_one_core() if columns.shape[-2] <= _SMALL else nullcontext():
            return np.asarray(np.linalg.solve(matrices, columns))
    except np.linalg.LinAlgError:
        return np.full(columns.shape, np.nan)


def blas_on_one_core() -> AbstractContextManager[None]:
    """Let BLAS use one core, in all threads of this process, until the last of them leaves."""
    return _limited.entered()


def _limit() -> Callable[[], None]:
    _release()
    limit = _libraries().limit(limits=1, user_api="blas")

    def end() -> None:
        _release()  # another thread may have begun
        limit.restore_original_limits()
        _release()

    return end


def _release() -> None:
    """Let any thread set the limit; since threadpoolctl 3.8 the first that did so keeps it."""
    for library in _libraries().lib_controllers:
        if hasattr(library, "clear_controlling_thread"):
            library.clear_controlling_thread(force=True)


@functools.cache
def _libraries() -> threadpoolctl.ThreadpoolController:
    # Only what is loaded is found, and scipy has a BLAS of its own.
    importlib.import_module("scipy.linalg")
    return threadpoolctl.ThreadpoolController()


_limited = Shared(_limit)
