"""Machine: the cores and the memory that this process may use."""

from __future__ import annotations

import functools
import math
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hamsym.numerics.linear_systems import blas_on_one_core

# Limits of a container (cgroups 2 and 1): bytes of memory, and microseconds of the processors in a
# period, both in one file or in two.
_MEMORY = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")
_PROCESSORS = (
    ("/sys/fs/cgroup/cpu.max",),
    ("/sys/fs/cgroup/cpu/cpu.cfs_quota_us", "/sys/fs/cgroup/cpu/cpu.cfs_period_us"),
)

_own = threading.local()


def available_cores() -> int:
    """Return the number of cores that this process may use; 1 within :func:`one_core`."""
    if getattr(_own, "alone", False):
        return 1
    cores = os.cpu_count() or 1
    if hasattr(os, "sched_getaffinity"):
        cores = len(os.sched_getaffinity(0))
    return min(cores, _container_cores())


@functools.cache
def _container_cores() -> int:
    """Return the cores whose time the container may use, or a large number."""
    for files in _PROCESSORS:
        try:
            texts = [Path(file).read_text(encoding="ascii") for file in files]
            quota, period = map(int, " ".join(texts).split())
        except (OSError, ValueError):  # there is no limit, or no such file
            continue
        if quota > 0:
            return math.ceil(quota / period)
    return sys.maxsize


@contextmanager
def one_core() -> Iterator[None]:
    """Let work of this thread use one core, also that of torch and BLAS: others use the others."""
    torch = sys.modules.get("torch")  # what has not imported it does not use it
    before, threads = getattr(_own, "alone", False), torch.get_num_threads() if torch else 1
    _own.alone = True
    if threads > 1:
        torch.set_num_threads(1)  # type: ignore[union-attr]
    try:
        with blas_on_one_core():
            yield
    finally:
        _own.alone = before
        if threads > 1:
            torch.set_num_threads(threads)  # type: ignore[union-attr]


def memory_size() -> float:
    """Return the bytes of memory that this process may use, or infinity if they are unknown."""
    size = math.inf
    if hasattr(os, "sysconf"):
        size = float(os.sysconf("SC_PHYS_PAGES")) * os.sysconf("SC_PAGE_SIZE")
    for path in _MEMORY:
        try:
            size = min(size, float(Path(path).read_text(encoding="ascii")))
        except (OSError, ValueError):  # there is no limit, or no such file
            continue
    return size
