"""A limit on the effort of a computation that cannot be judged beforehand.

Effort is counted in function calls first of all: what is refused then is the same on a slow
machine, on a fast one, and on one that is busy. The clock is for calls that are slow themselves.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["CallLimitExceededError", "call_limit"]

_EVERY = 256  # events between looks at the clock


class CallLimitExceededError(BaseException):
    """The limit was reached; not an Exception, so that no handler on the way swallows it."""


@contextmanager
def call_limit(calls: int, seconds: float) -> Iterator[None]:
    """Stop the computation inside after so many calls, Python's and C's, or so much processor time.

    It works in any thread and needs no signals: the interpreter calls back at every call and
    return, so a single long operation on one giant integer is not stopped. Nor is anything under
    a profiler, whose place at the interpreter this takes.
    """
    if sys.getprofile() is not None:
        yield
        return
    events, end = 0, time.thread_time() + seconds
    exceeded = False

    def count(*_: Any) -> None:
        nonlocal events, exceeded
        events += 1
        if events > 2 * calls or (events % _EVERY == 0 and time.thread_time() > end):
            exceeded = True
            raise CallLimitExceededError  # which also ends the counting

    sys.setprofile(count)
    try:
        yield
    finally:
        sys.setprofile(None)
    if exceeded:  # and the error lost, as where the garbage collector was calling back
        raise CallLimitExceededError
