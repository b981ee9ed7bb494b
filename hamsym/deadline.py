"""A limit on the processor time of a computation that cannot be judged beforehand."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["ProcessorTimeExceededError", "processor_time_limit"]

_EVERY = 256  # events of the profiler between looks at the clock


class ProcessorTimeExceededError(BaseException):
    """The limit was reached; not an Exception, so that no handler on the way swallows it."""


@contextmanager
def processor_time_limit(seconds: float) -> Iterator[None]:
    """Stop the computation inside once this thread has used so much processor time.

    It works in any thread and needs no signals: the interpreter calls back at function calls, so
    a single long operation on one giant integer is not stopped.
    """
    end = time.thread_time() + seconds
    previous = sys.getprofile()
    events, exceeded = 0, False

    def look(*_: Any) -> None:
        nonlocal events, exceeded
        events += 1
        if events % _EVERY == 0 and time.thread_time() > end:
            exceeded = True
            raise ProcessorTimeExceededError  # which also ends the profiling

    sys.setprofile(look)
    try:
        yield
    finally:
        sys.setprofile(previous)
    if exceeded:  # and lost, as where the garbage collector was calling back
        raise ProcessorTimeExceededError
