"""A limit on the effort of a computation that cannot be judged beforehand.

Effort is counted in function calls, not in seconds: what is refused then is the same on a slow
machine, on a fast one, and on one that is busy.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

__all__ = ["CallLimitExceededError", "call_limit"]


class CallLimitExceededError(BaseException):
    """The limit was reached; not an Exception, so that no handler on the way swallows it."""


@contextmanager
def call_limit(calls: int) -> Iterator[None]:
    """Stop the computation inside after so many calls of functions, Python's and C's.

    It works in any thread and needs no signals: the interpreter calls back at every call and
    return, so a single long operation on one giant integer is not stopped. Nor is anything under
    a profiler, whose place at the interpreter this takes.
    """
    if sys.getprofile() is not None:
        yield
        return
    events, most = 0, 2 * calls

    def count(*_: Any) -> None:
        nonlocal events
        events += 1
        if events > most:
            raise CallLimitExceededError  # which also ends the counting

    sys.setprofile(count)
    try:
        yield
    finally:
        sys.setprofile(None)
    if events > most:  # and the error lost, as where the garbage collector was calling back
        raise CallLimitExceededError
