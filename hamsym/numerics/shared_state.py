"""A state of the process that several threads need at the same time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


class Shared:
    """A state of the process, from the first thread that enters it to the last that leaves.

    - begin: Sets the state, and returns the function that ends it.
    """

    def __init__(self, begin: Callable[[], Callable[[], Any]]) -> None:
        self._begin, self._lock, self._inside = begin, threading.Lock(), 0
        self._end: Callable[[], Any] = begin

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Be in this state."""
        with self._lock:
            if not self._inside:
                self._end = self._begin()
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if not self._inside:
                    self._end()
