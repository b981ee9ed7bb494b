"""Progress bar of a training, drawn on terminals and in notebooks."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from hamsym.networks.record import TrainingState
from hamsym.support.progress import CellBar, is_shown, notebook_display

__all__ = ["training_progress"]


@contextmanager
def training_progress(
    iterations: int, show: bool | Callable[[TrainingState], None] | None = None
) -> Iterator[list[Callable[[TrainingState], None]]]:
    """Yield the callbacks that draw loss, ell_max and the time left on standard error.

    Parameters
    ----------
    iterations : int
        Largest number of iterations.
    show : bool or callable, optional
        By default the bar is drawn if standard error is a terminal, and in notebooks. A callable
        replaces the bar.
    """
    if callable(show):
        yield [show]
        return
    in_cell = notebook_display() if is_shown(show) else None
    if in_cell is not None:
        bar, done = CellBar(iterations, "training", in_cell), 0

        def advance(state: TrainingState) -> None:
            nonlocal done
            note = f"loss {state.best_loss:.1e}, ell_max {state.ell_max:.1e}"
            bar.advance(state.iteration - done, note)
            done = state.iteration

        with bar.running():
            yield [advance]
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
