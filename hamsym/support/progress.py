"""Progress bar of work in many steps, drawn on terminals only."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

__all__ = ["share_progress", "stepping_progress"]

_TICKS = 1_000


@contextmanager
def stepping_progress(
    steps: int, show: bool | None = None, text: str = "stepping"
) -> Iterator[Callable[[int], None]]:
    """Yield a function that takes a number of further steps and, after a second, draws a bar.

    Parameters
    ----------
    steps : int
        Number of all steps.
    show : bool, optional
        By default the bar is drawn if standard error is a terminal.
    text : str
        What is in progress, before the bar.
    """
    if not (sys.stderr.isatty() if show is None else show):
        yield lambda _: None
        return
    columns = (
        TextColumn(text),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TimeRemainingColumn(),
    )
    console = Console(stderr=True, force_terminal=show)
    progress = Progress(*columns, console=console, transient=True)
    task = progress.add_task("", total=steps)
    began = time.monotonic()

    def update(more: int) -> None:
        progress.update(task, advance=more)
        if time.monotonic() - began > 1 and not progress.live.is_started:
            progress.start()

    try:
        yield update
    finally:
        progress.stop()


@contextmanager
def share_progress(
    show: bool | None = None, text: str = "stepping"
) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the completed share of the work, from 0 to 1, and draws a bar."""
    with stepping_progress(_TICKS, show, text) as advance:
        done = 0

        def report(share: float) -> None:
            nonlocal done
            now = int(share * _TICKS)
            advance(now - done)
            done = now

        yield report
