"""A limit on the effort of a computation whose cost cannot be predicted.

Effort is counted in function calls, so that the limit is the same on slow, fast and busy machines.
The clock limits calls that are slow themselves.
"""

from __future__ import annotations

import sys
import threading
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

    def count(frame: Any, *_: Any) -> None:
        nonlocal events
        events += 1
        if frame.f_code is _FOUND:  # an error raised there is lost again
            return
        if events > 2 * calls or (events % _EVERY == 0 and time.thread_time() > end):
            events = 2 * calls
            raise CallLimitExceededError  # this also ends the counting

    with _lost_errors.counted_again(count):
        sys.setprofile(count)
        try:
            yield
        finally:
            sys.setprofile(None)


class _LostErrors:
    """Errors that are raised while an object is deleted, where the interpreter drops them."""

    def __init__(self) -> None:
        self._lock, self._own, self._inside = threading.Lock(), threading.local(), 0
        self._others: Any = None

    @contextmanager
    def counted_again(self, count: Any) -> Iterator[None]:
        """Go on with counting after an error that was lost: the next event raises it again."""
        self._own.count = count
        with self._lock:
            if not self._inside:
                self._others, sys.unraisablehook = sys.unraisablehook, self._found
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if not self._inside:
                    sys.unraisablehook = self._others

    def _found(self, error: Any) -> None:
        if error.exc_type is CallLimitExceededError:
            sys.setprofile(self._own.count)
        else:
            self._others(error)


_lost_errors = _LostErrors()
_FOUND = _LostErrors._found.__code__
