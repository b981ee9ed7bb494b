"""Systems of linear equations, of one or many windows, and the threads of BLAS that solve them.

The threads of BLAS wait for each other busily. Where other processes compute, each of its many
products may wait for a turn of the processor: a system of 216 unknowns, solved in half a
millisecond by one thread, was seen to take 200 with two.
"""

from __future__ import annotations

import functools
import importlib
import threading
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

import numpy as np
import threadpoolctl

_SMALL = 600  # unknowns, up to which one thread is as good as two


def solved(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Solve systems, shapes (..., n, n) and (..., n, m); all are nan if one of them is singular."""
    try:
        with blas_on_one_core() if columns.shape[-2] <= _SMALL else nullcontext():
            return np.asarray(np.linalg.solve(matrices, columns))
    except np.linalg.LinAlgError:
        return np.full(columns.shape, np.nan)


@contextmanager
def blas_on_one_core() -> Iterator[None]:
    """Let BLAS use one core, in all threads of this process, until the last of them leaves."""
    _limit.enter()
    try:
        yield
    finally:
        _limit.leave()


class _Limit:
    """The limit of the threads of BLAS, and the number of those who asked for it."""

    def __init__(self) -> None:
        self._lock, self._asked = threading.Lock(), 0
        self._limit: Any = None

    def enter(self) -> None:
        with self._lock:
            if not self._asked:
                self._limit = _libraries().limit(limits=1, user_api="blas")
            self._asked += 1

    def leave(self) -> None:
        with self._lock:
            self._asked -= 1
            if not self._asked:
                self._limit.restore_original_limits()


@functools.cache
def _libraries() -> threadpoolctl.ThreadpoolController:
    importlib.import_module(
        "scipy.linalg"
    )  # it has a BLAS of its own; only what is loaded is found
    return threadpoolctl.ThreadpoolController()


_limit = _Limit()
