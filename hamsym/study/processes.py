"""Runs in processes side by side, on this machine or on a cluster."""

from __future__ import annotations

import math
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
import time
import uuid
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import torch

from hamsym.errors import HamsymError
from hamsym.parallel.cluster import Task, cluster_results
from hamsym.study.display import display
from hamsym.study.runs import Run

if TYPE_CHECKING:
    from distributed import Client

    from hamsym.networks.record import TrainingState

_REPORT_EVERY = 0.5  # seconds between two reports of a run


class _Queue(Protocol):
    def put(self, item: tuple[str, float, float]) -> None: ...


def carry_out(runs: Sequence[Run], workers: int, progress: bool | None) -> None:
    """Carry out runs in this process or in several.

    Raise HamsymError if a process ended before its run.

    - workers: Processes; 1 for this process.
    - progress: As in :func:`hamsym.study.display.display`.
    """
    with display(len(runs), progress) as board:
        if workers == 1:
            threads = torch.get_num_threads()
            torch.set_num_threads(1)
            try:
                for run in runs:
                    _reporting(run, board)
                    board.ended(run.label)
            finally:
                torch.set_num_threads(threads)
            return
        context = multiprocessing.get_context("spawn")
        queue: Any = context.Queue()
        pool = ProcessPoolExecutor(workers, context, initializer=_prepare, initargs=(queue,))
        try:
            with _interrupts_blocked():
                waiting = {pool.submit(_in_process, run): run for run in runs}
            while waiting:
                done = [future for future in waiting if future.done()]
                for future in done:
                    run = waiting.pop(future)
                    future.result()
                    board.ended(run.label)
                while not queue.empty():
                    board.put(queue.get())
                if not done:
                    time.sleep(0.1)
        except BrokenProcessPool:
            raise HamsymError(
                "a process ended before its run: give fewer workers if memory was short, and guard "
                "the script that calls sweep by if __name__ == '__main__'; finished runs are kept"
            ) from None
        except BaseException:
            for process in list((pool._processes or {}).values()):
                process.terminate()
            raise
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def carry_out_on(client: Client, runs: Sequence[Run], progress: bool | None, retries: int) -> None:
    """Carry out runs on the workers of a cluster, which reach the same folder.

    Raise HamsymError if a run fails, or the folder is not there for a worker.
    """
    topic = f"hamsym-{uuid.uuid4().hex}"
    tasks = [Task(np.array([k]), (run,)) for k, run in enumerate(runs)]
    with display(len(runs), progress) as board:
        client.subscribe_topic(topic, lambda event: board.put(tuple(event[1])))
        results = cluster_results(client, _on_worker, topic, tasks, retries=retries)
        try:
            with closing(results):
                for task, _, _ in results:
                    run: Run = task.arguments[0]
                    if not run.is_done:
                        raise HamsymError(
                            f"the files of '{run.label}' are not in '{run.base.parent}'; give a "
                            "folder that all machines reach"
                        )
                    board.ended(run.label)
        finally:
            client.unsubscribe_topic(topic)


class _Topic:
    """Reports of a worker to the client."""

    def __init__(self, name: str) -> None:
        self._name = name

    def put(self, item: tuple[str, float, float]) -> None:
        from distributed import get_worker

        get_worker().log_event(self._name, item)


def _on_worker(topic: str, run: Run) -> None:
    """Carry out a run on a worker of a cluster."""
    torch.set_num_threads(1)
    _reporting(run, _Topic(topic))


@contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Block SIGINT, so that processes started meanwhile never receive it."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


_queue: _Queue | None = None


def _prepare(queue: _Queue) -> None:
    """Prepare a new process: one thread, Ctrl-C ignored, an exit with the parent."""
    global _queue
    _queue = queue
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    threading.Thread(target=_exit_with_parent, daemon=True).start()


def _exit_with_parent() -> None:
    """Exit when the parent process dies."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        multiprocessing.connection.wait([parent.sentinel])
        os._exit(1)


def _in_process(run: Run) -> None:
    """Carry out a run in a worker process."""
    assert _queue is not None
    _reporting(run, _queue)


def _reporting(run: Run, queue: _Queue) -> None:
    """Carry out a run, with regular reports of its progress."""
    reported = -math.inf

    def report(state: TrainingState) -> None:
        nonlocal reported
        if time.monotonic() - reported > _REPORT_EVERY:
            reported = time.monotonic()
            queue.put((run.label, state.iteration / state.iterations, state.best_loss))

    run.carry_out(report)
