"""Clocks and statistics of the benchmarks: CPU time, runs in turns, medians and power laws."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

median = statistics.median


def cpu(function: Callable[[], Any]) -> tuple[float, Any]:
    """CPU seconds of a call in all threads of this process, and its result."""
    began = time.process_time()
    result = function()
    return time.process_time() - began, result


def wall(function: Callable[[], Any]) -> float:
    """Seconds of a call by the wall clock, for code that runs on several cores."""
    began = time.perf_counter()
    function()
    return time.perf_counter() - began


def short_cpu(function: Callable[[], Any]) -> float:
    """Least CPU seconds of the calls that fit into 20 ms, because the first call is slower."""
    least = spent = cpu(function)[0]
    while spent < 0.02:
        value = cpu(function)[0]
        least, spent = min(least, value), spent + value
    return least


def in_turns(
    functions: Mapping[str, Callable[[], Any]],
    turns: int,
    clock: Callable[[Callable[[], Any]], float] = short_cpu,
) -> dict[str, list[float]]:
    """Seconds of each function in each turn, after one call of each that may compile."""
    for function in functions.values():
        function()
    times = [{name: clock(function) for name, function in functions.items()} for _ in range(turns)]
    return {name: [turn[name] for turn in times] for name in functions}


def median_ratio(above: Sequence[float], below: Sequence[float]) -> float:
    """Median of the ratios within a turn: a slow phase of the machine cancels in each of them."""
    return median(a / b for a, b in zip(above, below, strict=True))


def exponent(sizes: Sequence[float], values: Sequence[float]) -> float:
    """Return b of the power law a n^b that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def largest_error(states: np.ndarray, truth: np.ndarray) -> float:
    """Largest 2-norm of the error over the times; infinite where a state is not finite.

    ``states`` may be given at every k-th of the times of ``truth``.
    """
    every = max(1, (len(truth) - 1) // max(1, len(states) - 1))
    if states.shape != truth[::every].shape or not np.isfinite(states).all():
        return float("inf")
    return float(np.linalg.norm(states - truth[::every], axis=1).max())


@contextmanager
def on_one_core() -> Iterator[None]:
    """Restrict this process to one core, where the system can do so."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    cores = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {max(cores)})
    try:
        yield
    finally:
        os.sched_setaffinity(0, cores)
