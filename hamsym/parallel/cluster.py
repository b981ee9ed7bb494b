"""Tasks on the workers of a dask cluster: a laptop, a SLURM cluster, machines in a cloud.

Input:  a function, a set-up that all tasks share, and arguments of each task.
Output: the results, as they come.

A task is sent the set-up as bytes, which a worker unpickles once, so that nothing is lost with a
worker. Compiled functions are not sent: a machine compiles what a task needs into its cache
directory. A task uses one thread; the threads of the workers set how many run side by side.
"""

from __future__ import annotations

import functools
import math
import pickle
import time
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import hamsym
from hamsym.errors import HamsymError, InputError
from hamsym.support.machine import one_core
from hamsym.support.tables import optional_package
from hamsym.support.validation import require_whole

if TYPE_CHECKING:  # an optional package
    from distributed import Client, Future

_COUNTED_EVERY = 1.0  # seconds between two looks at the number of workers
_WAITING = 2  # tasks for each thread of the cluster, so that no worker waits for the scheduler


class Task(NamedTuple):
    """Arguments of a task."""

    #: Numbers of the members on which it works, by which an error names it.
    members: np.ndarray
    #: Of the function, after the set-up; picklable.
    arguments: tuple[Any, ...]


def require_client(client: Any) -> None:
    """Raise InputError unless the argument is a connected client of dask.distributed."""
    Client = _distributed().Client
    if not isinstance(client, Client) or client.asynchronous:
        raise InputError(
            f"client={client!r} cannot be used; give a dask.distributed.Client that is not "
            "asynchronous"
        )
    if client.status != "running":
        raise InputError("the client is not connected to a scheduler; make a new one")


class ThreadCount:
    """Number of threads of all workers, which may change; read at most once a second."""

    def __init__(self, client: Client) -> None:
        self._client, self._count, self._read = client, 1, -math.inf

    def __call__(self) -> int:
        """Return the number, at least 1: workers may still be starting."""
        if time.monotonic() - self._read > _COUNTED_EVERY:
            self._count = max(1, sum(self._client.nthreads().values()))
            self._read = time.monotonic()
        return self._count


def cluster_results(
    client: Client,
    function: Callable[..., Any],
    setup: Any,
    tasks: Iterable[Task],
    *,
    retries: int = 3,
) -> Generator[tuple[Task, Any, float], None, None]:
    """Yield each task with its result and its seconds, in the order in which they end.

    Closing the iterator cancels what is not finished.

    Raise HamsymError if a task fails, or kills its workers even when it runs alone.

    - function: ``function(setup, *arguments)``, importable on the workers.
    - setup: Picklable.
    - tasks: Read when workers are free, so that tasks may depend on earlier results.
    - retries: Times that a task is repeated after an error on a worker that is not of hamsym. A
      task whose worker dies is repeated by the scheduler
      (``distributed.scheduler.allowed-failures``).
    """
    run = _Tasks(client, function, setup, retries)
    pending, threads = iter(tasks), ThreadCount(client)
    try:
        while True:
            room = _WAITING * threads() - len(run.waiting)
            for task in (next(pending, None) for _ in range(room)):
                if task is None:
                    break
                run.submit(task)
            if not run.waiting:
                break
            yield from run.next()
        # Each of these was on a worker that died. One at a time shows which of them killed it.
        for task in run.suspects:
            run.submit(task, alone=True)
            yield from run.next()
    finally:
        client.cancel(list(run.waiting), force=True)


class _Tasks:
    """Tasks that are submitted and not finished."""

    def __init__(
        self, client: Client, function: Callable[..., Any], setup: Any, retries: int
    ) -> None:
        from cloudpickle import dumps  # a part of distributed

        distributed = _distributed()
        require_client(client)
        require_whole("retries", retries, 0)
        self._client, self._retries = client, retries
        self._killed = distributed.KilledWorker
        self._work = functools.partial(_on_worker, function, dumps(setup), hamsym.__version__)
        self._name = f"hamsym-{function.__name__.strip('_')}"
        self._finished = distributed.as_completed(
            with_results=True, raise_errors=False, loop=client.loop
        )
        self.waiting: dict[Future, Task] = {}
        self.suspects: list[Task] = []
        self._alone = False

    def submit(self, task: Task, *, alone: bool = False) -> None:
        self._alone = alone
        future = self._client.submit(
            self._work,
            *task.arguments,
            key=f"{self._name}-{uuid.uuid4().hex}",
            retries=self._retries,
            pure=False,
        )
        self.waiting[future] = task
        self._finished.add(future)

    def next(self) -> Iterator[tuple[Task, Any, float]]:
        """Yield the next result; nothing if the workers of a task died."""
        future, result = next(self._finished)
        task = self.waiting.pop(future)
        if future.status == "finished":
            found, seconds = result
            if isinstance(found, HamsymError):
                raise found
            yield task, found, seconds
            return
        if future.status != "error":
            raise HamsymError(
                f"{_named(task)} were cancelled, or the scheduler was lost; call again"
            )
        error = future.exception()
        if not isinstance(error, self._killed):
            text = " ".join(f"{type(error).__name__}: {error}".split())[:300]
            raise HamsymError(f"{_named(task)} failed on a worker: {text}") from error
        if self._alone:
            raise HamsymError(
                f"{_named(task)} ended the worker that computed them, each time and alone; give "
                "workers more memory, or leave these members out"
            ) from None
        self.suspects.append(task)


def _named(task: Task) -> str:
    first, last = int(task.members[0]), int(task.members[-1])
    return f"member {first}" if first == last else f"members {first} to {last}"


def _on_worker(
    function: Callable[..., Any], content: bytes, version: str, *arguments: Any
) -> tuple[Any, float]:
    """Carry out a task and measure it; errors of hamsym, which would come again, are returned."""
    if version != hamsym.__version__:
        problem = (
            f"a worker has hamsym {hamsym.__version__}, this process has {version}; install one "
            "version on all machines"
        )
        return InputError(problem), 0.0
    with one_core():
        began = 0.0
        try:
            setup = _unpickled(content)
            began = time.perf_counter()
            found = function(setup, *arguments)
        except HamsymError as error:
            found = error
        return found, max(time.perf_counter() - began, 1e-6)


@functools.lru_cache(maxsize=8)
def _unpickled(content: bytes) -> Any:
    """Return the set-up, the same object for all tasks of a process."""
    return pickle.loads(content)


def _distributed() -> Any:
    return optional_package("distributed", "a client", '"hamsym[distributed]"')
