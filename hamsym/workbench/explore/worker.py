"""Worker: a process that computes for the page and can be stopped at any time.

Compiled loops hold Python's lock and cannot be interrupted, so that a thread would neither keep the
page alive nor be cancelled. A process is ended instead, and the next call starts another one.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import signal
import threading
import warnings
from collections.abc import Callable
from typing import Any

from hamsym.errors import HamsymError, ParseError


class TaskError(HamsymError):
    """A task that failed; the message is one sentence for the user.

    - token: The invalid part of a formula, if that was the reason; else empty.
    - column: Its first column, counted from 1; 0 if there is none.
    """

    def __init__(self, message: str, token: str = "", column: int = 0) -> None:
        self.token, self.column = token, column
        super().__init__(message)


class TimeLimitError(TaskError):
    """A task that took longer than its limit; its process was ended."""


class CancelledError(TaskError):
    """A task whose process was ended by :meth:`Worker.cancel`."""


class Worker:
    """A process that carries out one task at a time.

    - module: Name of a module whose ``TASKS`` has the functions by name.
    """

    def __init__(self, module: str) -> None:
        self._module = module
        self._lock = threading.Lock()  # one task at a time
        self._state = threading.Lock()  # of the process, which other threads may end
        self._process: Any = None
        self._connection: Any = None
        self._cancelled = self._closed = False

    def start(self) -> None:
        """Start the process, so that a later task finds hamsym imported."""
        with self._state:
            self._start()

    def _start(self) -> None:
        if self._closed:
            raise CancelledError("the page was closed")
        if self._process is not None and self._process.is_alive():
            return
        context = multiprocessing.get_context("spawn")
        ours, theirs = context.Pipe()
        # Daemonic: it ends with the program.
        self._process = context.Process(target=_serve, args=(theirs, self._module), daemon=True)
        self._process.start()
        theirs.close()
        self._connection = ours

    def run(self, task: str, seconds: float, *arguments: Any) -> Any:
        """Carry out a task and return its result.

        Raise TimeLimitError if the task took longer. Raise CancelledError if :meth:`cancel` was
        called meanwhile. Raise TaskError if the task raised an error.

        - seconds: Time limit, which includes the start of a new process.
        - *arguments: Of the task; they are pickled.
        """
        with self._lock:
            with self._state:
                self._cancelled = False
                self._start()
                connection = self._connection
            try:
                connection.send((task, arguments))
                if not connection.poll(seconds):
                    self._end()
                    raise TimeLimitError(f"stopped after the time limit of {seconds:g} s")
                succeeded, found = connection.recv()
            except (EOFError, OSError):
                self._end()
                if self._cancelled:
                    raise CancelledError("cancelled") from None
                raise TaskError(
                    "the process of the computation ended, perhaps for lack of memory; try again "
                    "with a smaller problem"
                ) from None
        if not succeeded:
            raise TaskError(*found)
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
                self._process.join()
                self._process = None


def _serve(connection: multiprocessing.connection.Connection, module: str) -> None:
    """Carry out tasks until the connection is closed."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the program, which ends this one
    warnings.simplefilter("ignore")
    import importlib

    tasks: dict[str, Callable[..., Any]] = importlib.import_module(module).TASKS
    while True:
        try:
            name, arguments = connection.recv()
        except (EOFError, OSError):
            return
        answer: tuple[bool, Any]
        try:
            answer = True, tasks[name](*arguments)
        except ParseError as error:
            answer = False, (str(error), error.token, error.column)
        except HamsymError as error:
            answer = False, (str(error),)
        except MemoryError:
            answer = False, ("the computation needs more memory than there is",)
        except Exception as error:
            answer = False, (f"the computation failed: {type(error).__name__}: {error}",)
        connection.send(answer)
