"""Number of processor cores."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

_own = threading.local()


def available_cores() -> int:
    """Return the number of cores that this process may use; 1 within :func:`one_core`."""
    if getattr(_own, "alone", False):
        return 1
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def one_core() -> Iterator[None]:
    """Let work of this thread use one core, because other threads use the others."""
    before = getattr(_own, "alone", False)
    _own.alone = True
    try:
        yield
    finally:
        _own.alone = before
