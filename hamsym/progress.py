"""Progress on a terminal, silence elsewhere."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

if TYPE_CHECKING:  # torch is slow to import, and time stepping does without it
    from hamsym.training import TrainingState

__all__ = ["stepping_progress", "training_progress"]


@contextmanager
def training_progress(
    iterations: int, show: bool | Callable[[TrainingState], None] | None = None
) -> Iterator[list[Callable[[TrainingState], None]]]:
    """Callbacks that draw loss, ell_max and the time left on standard error.

    Parameters
    ----------
    iterations : int
    show : bool or callable, optional
        By default only where standard error is a terminal. A callable takes its place.
    """
    if callable(show):
        yield [show]
        return
    console = Console(stderr=True, force_terminal=show)
    if not (console.is_terminal if show is None else show):
        yield []
        return
    columns = (
        TextColumn("training"),
        BarColumn(bar_width=16),
        TaskProgressColumn(),
        TextColumn("loss {task.fields[loss]:.1e}  ell_max {task.fields[ell_max]:.1e}  left"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=iterations, loss=float("nan"), ell_max=float("nan"))

        def update(state: TrainingState) -> None:
            progress.update(
                task, completed=state.iteration, loss=state.best_loss, ell_max=state.ell_max
            )

        yield [update]


@contextmanager
def stepping_progress(steps: int, show: bool | None = None) -> Iterator[Callable[[int], None]]:
    """A function that takes the number of steps done and, after a second, draws how far it is.

    Parameters
    ----------
    steps : int
    show : bool, optional
        By default only where standard error is a terminal.
    """
    if not (sys.stderr.isatty() if show is None else show):
        yield lambda _: None
        return
    columns = (
        TextColumn("stepping"),
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
