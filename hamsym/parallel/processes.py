"""Processes: for tasks that are ended at any time, and for those that hold Python's lock.

Input:  functions of modules, with picklable arguments.
Output: their results.

A process imports the modules of its tasks, not the main script, which needs no guard. A task uses
one core. It does not notice Ctrl-C, which is for the program, and ends with the program, also if
that is killed. What it prints goes to standard error.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import pickle
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import IO, Any, TypeVar

from hamsym.errors import HamsymError
from hamsym.support.machine import one_core

Task = TypeVar("Task")
Result = TypeVar("Result")

_START = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from hamsym.parallel.processes import _serve; _serve()"
)
# Kinds of messages of a process.
_RESULT, _ERROR, _REPORT = range(3)


class ProcessEndedError(HamsymError):
    """The process of a task ended before the task did."""

    def __init__(self) -> None:
        super().__init__(
            "the process of the computation ended, perhaps for lack of memory; try again with a "
            "smaller problem"
        )


class OverTimeError(HamsymError):
    """A task took longer than its limit; its process was ended."""


class CancelledError(HamsymError):
    """The process of a task was ended by :meth:`Worker.cancel`."""


class Worker:
    """A process that carries out one task at a time; another one is started if it has ended.

    - quiet: Whether warnings are not shown.
    """

    def __init__(self, *, quiet: bool = True) -> None:
        self._options = ["-P", *(["-W", "ignore"] if quiet else [])]
        self._lock = threading.Lock()  # one task at a time
        self._state = threading.Lock()  # of the process, which other threads may end
        self._process: subprocess.Popen[bytes] | None = None
        self._messages: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
        self._cancelled = self._closed = False

    def start(self) -> None:
        """Start the process, so that a later task finds hamsym imported."""
        with self._state:
            self._started()

    def _started(self) -> subprocess.Popen[bytes]:
        if self._closed:
            raise CancelledError("the computation was closed")
        if self._process is None or self._process.poll() is not None:
            command = [sys.executable, *self._options, "-c", _START, json.dumps(sys.path)]
            pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
            # A session of its own receives no Ctrl-C, also while the process starts.
            self._process = subprocess.Popen(command, **pipes, start_new_session=True)
            self._messages = queue.SimpleQueue()
            arguments = self._process.stdout, self._messages.put
            threading.Thread(target=_pass_on, args=arguments, daemon=True).start()
        return self._process

    def run(
        self,
        function: Callable[..., Any],
        seconds: float,
        *arguments: Any,
        report: Callable[[Any], None] | None = None,
    ) -> Any:
        """Carry out a task and return its result.

        Raise the error of the task if it is one of hamsym, else a HamsymError that names it. Raise
        OverTimeError if the task took longer, CancelledError if :meth:`cancel` was called
        meanwhile, ProcessEndedError if the process ended by itself.

        - seconds: Time limit, which includes the start of a new process.
        - report: Called here with what the task reports, by its last argument.
        """
        task = pickle.dumps((function, arguments, report is not None))
        with self._lock:
            with self._state:
                self._cancelled = False
                process, messages = self._started(), self._messages
            deadline = time.monotonic() + seconds
            try:
                with contextlib.suppress(OSError):  # it has ended, as its messages will tell
                    _send(process.stdin, task)
                kind = _REPORT
                while kind == _REPORT:
                    left = None if math.isinf(seconds) else max(deadline - time.monotonic(), 0.0)
                    message = messages.get(timeout=left)
                    if message is None:
                        raise CancelledError("cancelled") if self._cancelled else ProcessEndedError
                    kind, found = pickle.loads(message)
                    if kind == _REPORT and report is not None:
                        report(found)
            except BaseException as error:  # also Ctrl-C: nobody waits for the result any more
                self._end()
                if isinstance(error, queue.Empty):
                    text = f"stopped after the time limit of {seconds:g} s"
                    raise OverTimeError(text) from None
                raise
        if kind == _ERROR:
            raise found
        return found

    def cancel(self) -> None:
        """End the process; a task that is running raises :class:`CancelledError`."""
        self._cancelled = True
        self._end()

    def close(self) -> None:
        """End the process for good."""
        self._closed = True
        self.cancel()

    def _end(self) -> None:
        with self._state:
            if self._process is not None:
                self._process.kill()
                self._process.wait()
                self._process = None


def in_processes(
    function: Callable[[Task, Callable[[Any], None]], Result],
    tasks: Iterable[Task],
    workers: int,
    report: Callable[[Any], None],
) -> Generator[tuple[Task, Result], None, None]:
    """Yield each task with its result, in the order in which they end.

    Errors are raised as by :meth:`Worker.run`. After one, and when the iterator is closed, the
    other tasks are ended.

    - function: ``function(task, report)``.
    - workers: Number of processes; with 1, tasks are carried out in this one.
    - report: Called in this process, by several threads, with what tasks report.
    """
    if workers == 1:
        for task in tasks:
            with one_core():
                result = function(task, report)
            yield task, result
        return
    crew = [Worker(quiet=False) for _ in range(workers)]
    free: queue.SimpleQueue[Worker] = queue.SimpleQueue()
    for worker in crew:
        free.put(worker)

    def carry_out(task: Task) -> Result:
        worker = free.get()
        try:
            found: Result = worker.run(function, math.inf, task, report=report)
        finally:
            free.put(worker)
        return found

    with ThreadPoolExecutor(workers) as pool:
        try:
            waiting = {pool.submit(carry_out, task): task for task in tasks}
            for future in as_completed(waiting):
                yield waiting[future], future.result()
        finally:
            # Ctrl-C once more does not reach a thread.
            closing = threading.Thread(target=lambda: deque(map(Worker.close, crew)))
            closing.start()
            closing.join()


def _send(stream: Any, content: bytes) -> None:
    pickle.dump(content, stream)
    stream.flush()


def _pass_on(stream: IO[bytes], put: Callable[[bytes | None], None]) -> None:
    """Pass on what the other process sends, and None when it has ended."""
    try:
        while True:
            put(pickle.load(stream))
    except (EOFError, OSError, ValueError, pickle.UnpicklingError):
        put(None)


# -- in the process --------------------------------------------------------------------------------


def _serve() -> None:
    """Carry out tasks until the program ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    source, out = os.fdopen(os.dup(0), "rb"), os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    tasks: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def put(task: bytes | None) -> None:
        if task is None:  # the program has ended, or does not want the result
            os._exit(1)
        tasks.put(task)

    threading.Thread(target=_pass_on, args=(source, put), daemon=True).start()
    while True:
        _send(out, _answer(tasks.get(), lambda value: _send(out, pickle.dumps((_REPORT, value)))))


def _answer(task: bytes, report: Callable[[Any], None]) -> bytes:
    """Carry out a task, and return the message with its result or its error."""
    try:
        function, arguments, reports = pickle.loads(task)
        with one_core():
            found = function(*arguments, *([report] if reports else []))
        return pickle.dumps((_RESULT, found))
    except HamsymError as error:
        problem = error
    except MemoryError:
        problem = HamsymError("the computation needs more memory than there is")
    except Exception as error:
        problem = HamsymError(f"the computation failed: {type(error).__name__}: {error}")
        problem.add_note(traceback.format_exc())
    return pickle.dumps((_ERROR, problem))
