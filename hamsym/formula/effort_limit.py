"""A limit on the effort of a computation whose cost cannot be predicted.

Effort is counted in function calls, so that the limit is the same on slow, fast and busy machines.
The clock limits calls that are slow themselves.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

_EVERY = 256  # events between readings of the clock


class CallLimitExceededError(BaseException):
    """The limit was reached; not an Exception, so that no handler on the way swallows it."""


@contextmanager
def call_limit(calls: int, seconds: float) -> Iterator[None]:
    """Stop the computation inside after a number of calls, Python's and C's, or processor seconds.

    It works in any thread and needs no signals: the interpreter calls back at every call and
    return. A single long operation on one giant integer is therefore not stopped. Under a profiler,
    which uses the same hook of the interpreter, there is no limit.
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
            raise CallLimitExceededError  # this also ends the counting

    sys.setprofile(count)
    try:
        yield
    finally:
        sys.setprofile(None)
    if exceeded:  # the error is lost if it was raised during garbage collection
        raise CallLimitExceededError
