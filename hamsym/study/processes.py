"""Runs of a sweep side by side, in processes, with their progress."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from typing import TYPE_CHECKING, TypeAlias

from hamsym.errors import HamsymError
from hamsym.parallel.processes import ProcessEndedError, in_processes
from hamsym.study.runs import Run
from hamsym.support.progress import share_progress

if TYPE_CHECKING:
    from hamsym.networks.record import TrainingState

_REPORT_EVERY = 0.5  # seconds between two reports of a run

# Label of a run, share of its iterations, best loss.
_Report: TypeAlias = tuple[str, float, float]


class Board:
    """The shares of the runs that go on, and the run that reported last, drawn as a bar.

    - total: Number of runs.
    - draw: (share of all runs, note) -> None.
    """

    def __init__(self, total: int, draw: Callable[[float, str], None]) -> None:
        self._total, self._draw = total, draw
        self._shares, self._finished = dict[str, float](), set[str]()
        self._lock = threading.Lock()  # several threads report

    def put(self, item: _Report) -> None:
        """Show the report of a run."""
        label, share, loss = item
        if label not in self._finished:  # else the report was delayed
            self._show(label, share, f"{label}: loss {loss:.1e}")

    def ended(self, label: str) -> None:
        """Count a run that has ended."""
        self._finished.add(label)
        self._show(label, 1.0, f"{len(self._finished)} of {self._total} runs")

    def _show(self, label: str, share: float, note: str) -> None:
        with self._lock:
            self._shares[label] = share
            self._draw(sum(self._shares.values()) / self._total, note)


def carry_out(runs: Sequence[Run], workers: int, progress: bool | None) -> None:
    """Carry out runs in this process or in several.

    Raise HamsymError if a run fails in another process, or its process ended.

    - workers: Processes; 1 for this process.
    - progress: As of :func:`hamsym.support.progress.stepping_progress`.
    """
    with share_progress(progress, "sweep") as draw:
        board = Board(len(runs), draw)
        with closing(in_processes(_reporting, runs, workers, board.put)) as done:
            try:
                for run, _ in done:
                    board.ended(run.label)
            except ProcessEndedError:
                raise HamsymError(
                    "a process ended before its run: give fewer workers if memory was short; "
                    "finished runs are kept"
                ) from None


def _reporting(run: Run, report: Callable[[_Report], None]) -> None:
    """Carry out a run, with regular reports of its progress."""
    reported = -math.inf

    def tell(state: TrainingState) -> None:
        nonlocal reported
        if time.monotonic() - reported > _REPORT_EVERY:
            reported = time.monotonic()
            report((run.label, state.iteration / state.iterations, state.best_loss))

    run.carry_out(tell)
