"""Threads: one for each core, for functions that leave Python's lock while they compute.

Input:  a function, and its tasks.
Output: the results, in the order of the tasks.

A function uses one core. An error in a thread is raised where the results are read. After that, and
after Ctrl-C, tasks that have not begun are cancelled, and those that have are waited for: compiled
loops cannot be interrupted, so tasks are short, or ask :attr:`Threads.is_stopped`.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import islice
from typing import Any, TypeVar

from hamsym.support.machine import available_cores, one_core

Task = TypeVar("Task")
Result = TypeVar("Result")


class Threads:
    """Threads that work until the end of a ``with`` statement; for one core this thread.

    - most: Number of tasks at most that run side by side; by default that of the cores.
    """

    def __init__(self, most: float = math.inf) -> None:
        self.cores = int(max(1, min(available_cores(), most)))
        self._pool = ThreadPoolExecutor(self.cores) if self.cores > 1 else None
        self._waiting: deque[tuple[Any, Future]] = deque()
        #: Whether functions that run are to end early: their results are not read.
        self.is_stopped = False

    def __enter__(self) -> Threads:
        return self

    def __exit__(self, *_: object) -> None:
        self.is_stopped = True
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def results(
        self, function: Callable[[Task], Result], tasks: Iterable[Task], ahead: int | None = None
    ) -> Iterator[tuple[Task, Result]]:
        """Yield each task with its result, in the order of the tasks.

        - ahead: Tasks for each core that are read before their results are; by default all. The
          next ones may then depend on the results so far.
        """

        def run(task: Task) -> Result:
            with one_core():
                return function(task)

        if self._pool is None:
            yield from ((task, run(task)) for task in tasks)
            return
        pending, waiting = iter(tasks), self._waiting
        while True:
            room = None if ahead is None else ahead * self.cores - len(waiting)
            for task in islice(pending, room):
                waiting.append((task, self._pool.submit(run, task)))
            if not waiting:
                return
            result = waiting[0][1].result()
            yield waiting.popleft()[0], result

    def begun(self) -> Iterator[tuple[Any, Any]]:
        """Yield, after an interruption, the tasks that had begun with their results."""
        while self._waiting:
            task, future = self._waiting.popleft()
            if not future.cancel():
                yield task, future.result()


def slices(count: int, parts: int) -> list[slice]:
    """Divide a number of rows into parts of nearly equal size.

    Examples
    --------
    >>> slices(5, 2)
    [slice(0, 2, None), slice(2, 5, None)]
    """
    edges = [count * part // parts for part in range(parts + 1)]
    return list(map(slice, edges[:-1], edges[1:]))
