"""The limit of effort: reached, not reached, with a lost exception, under a profiler."""

from __future__ import annotations

import cProfile
import gc
import sys

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


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_lost_exception_is_raised_at_the_end() -> None:
    """In a callback of the garbage collector an exception is printed, not passed on."""

    def callback(phase: str, _: object) -> None:
        if phase == "start":
            busy(100_000)

    gc.callbacks.append(callback)
    try:
        with pytest.raises(CallLimitExceededError), call_limit(10_000, seconds=600):
            gc.collect()
    finally:
        gc.callbacks.remove(callback)
