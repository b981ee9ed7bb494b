"""The limit of effort: reached, not reached, with a lost exception, under a profiler."""

from __future__ import annotations

import cProfile
import gc
import sys
import threading
from collections.abc import Callable

import pytest

from hamsym.formula.effort_limit import CallLimitExceededError, call_limit


def busy(calls: int) -> int:
    return sum(abs(i) for i in range(calls))


def test_long_computation_is_stopped() -> None:
    with pytest.raises(CallLimitExceededError), call_limit(10_000, seconds=600):
        busy(10**8)
    assert sys.getprofile() is None


def test_slow_calls_are_stopped_by_the_clock() -> None:
    with pytest.raises(CallLimitExceededError), call_limit(10**9, seconds=0.02):
        busy(10**8)
    assert sys.getprofile() is None


def test_short_computation_completes() -> None:
    with call_limit(100_000, seconds=600):
        assert busy(10_000) == sum(range(10_000))
    assert sys.getprofile() is None


def test_the_limit_is_counted_in_calls() -> None:
    """``busy`` makes two calls for each number: abs, and the generator's next step."""
    with call_limit(2_020, seconds=600):
        busy(1_000)
    with pytest.raises(CallLimitExceededError), call_limit(1_980, seconds=600):
        busy(1_000)


def test_no_limit_under_a_profiler() -> None:
    profiler = cProfile.Profile()
    profiler.enable()
    with call_limit(10, seconds=600):
        busy(1_000)
    profiler.disable()
    called = {entry.code for entry in profiler.getstats()}
    assert busy.__code__ in called


class Deleted:
    def __del__(self) -> None:
        busy(100_000)


def collected() -> None:
    def callback(phase: str, _: object) -> None:
        if phase == "start":
            busy(100_000)

    gc.callbacks.append(callback)
    try:
        gc.collect()
    finally:
        gc.callbacks.remove(callback)


@pytest.mark.parametrize("lose", [Deleted, collected])
@pytest.mark.filterwarnings("error")
def test_lost_exception_is_raised_again(lose: Callable[[], object]) -> None:
    """While objects are deleted the interpreter prints errors and drops them."""
    hook, reached = sys.unraisablehook, []

    def go_on() -> None:
        lose()
        for _ in range(10**5):
            reached.append(1)

    with pytest.raises(CallLimitExceededError), call_limit(10_000, seconds=600):
        go_on()
    assert len(reached) < 10
    assert sys.unraisablehook is hook
    assert sys.getprofile() is None


def test_other_errors_are_reported() -> None:
    class Broken:
        def __del__(self) -> None:
            raise ValueError("of a deleted object")

    found = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sys, "unraisablehook", found.append)
        with call_limit(10_000, seconds=600):
            Broken()
    assert [error.exc_type for error in found] == [ValueError]


def test_threads_end_their_own_computations() -> None:
    ended = []

    def lose_and_go_on() -> None:
        Deleted()
        busy(10**8)

    def work() -> None:
        with pytest.raises(CallLimitExceededError), call_limit(10_000, seconds=600):
            lose_and_go_on()
        ended.append(sys.getprofile())

    threads = [threading.Thread(target=work) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert ended == [None] * 3
