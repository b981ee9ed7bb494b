"""A limit on the effort of a computation whose cost cannot be predicted.

Effort is counted in function calls, so that the limit is the same on slow, fast and busy machines.
The clock limits calls that are slow themselves.
"""

from __future__ import annotations

import functools
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from hamsym.numerics.shared_state import Shared

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
    events, looked_at, end = 0, min(_EVERY, 2 * calls), time.thread_time() + seconds

    def count(frame: Any, event: str, argument: Any) -> None:
        nonlocal events, looked_at
        events += 1
        if events <= looked_at:  # most events end here, in a fraction of a microsecond
            return
        if frame.f_code is _found.__code__:  # an error raised there is lost again
            return
        if events > 2 * calls or time.thread_time() > end:
            looked_at = 0  # exceeded from now on, also by the clock
            raise CallLimitExceededError  # this also ends the counting
        looked_at = min(events + _EVERY, 2 * calls)

    _own.count = count
    with _regained.entered():
        sys.setprofile(count)
        try:
            yield
        finally:
            sys.setprofile(None)


def _regain_lost_errors() -> Callable[[], None]:
    """Count again after an error that was lost; return what ends this.

    The interpreter drops errors that are raised while an object is deleted.
    """
    others = sys.unraisablehook
    sys.unraisablehook = functools.partial(_found, others)
    return functools.partial(setattr, sys, "unraisablehook", others)


def _found(others: Callable[[Any], Any], error: Any) -> None:
    if error.exc_type is CallLimitExceededError:
        sys.setprofile(_own.count)  # the next event raises it again
    else:
        others(error)


_own = threading.local()
_regained = Shared(_regain_lost_errors)
