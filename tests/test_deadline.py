"""The limit of processor time: reached, not reached, and lost on the way."""

from __future__ import annotations

import gc
import sys

import pytest

from hamsym.deadline import ProcessorTimeExceededError, processor_time_limit


def busy(calls: int) -> int:
    return sum(abs(i) for i in range(calls))


def test_a_long_computation_is_stopped() -> None:
    with pytest.raises(ProcessorTimeExceededError), processor_time_limit(0.02):
        busy(10**8)
    assert sys.getprofile() is None


def test_a_short_one_is_not() -> None:
    with processor_time_limit(10.0):
        assert busy(10_000) == sum(range(10_000))
    assert sys.getprofile() is None


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_an_exception_that_is_lost_is_raised_at_the_end() -> None:
    """In a callback of the garbage collector an exception is printed, not passed on."""

    def callback(phase: str, _: object) -> None:
        if phase == "start":
            busy(3_000_000)

    gc.callbacks.append(callback)
    try:
        with pytest.raises(ProcessorTimeExceededError), processor_time_limit(0.01):
            gc.collect()
    finally:
        gc.callbacks.remove(callback)
