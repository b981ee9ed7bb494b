"""Progress displays of runs."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from hamsym.support.progress import CellBar, notebook_display

__all__ = ["Display", "display"]


class Display:
    """A progress display that shows nothing."""

    def __init__(self, total: int) -> None:
        self.total, self.count = total, 0

    def put(self, item: tuple[str, float, float]) -> None:
        """Show label, share of the iterations and best loss of a run."""

    def ended(self, label: str) -> None:
        """Count a run that has ended."""
        self.count += 1


class _Lines(Display):
    """A line on standard error for each run that has ended."""

    def __init__(self, total: int) -> None:
        super().__init__(total)
        self.began = time.monotonic()

    def ended(self, label: str) -> None:
        super().ended(label)
        minutes = (time.monotonic() - self.began) / 60
        line = f"{self.count}/{self.total} after {minutes:.1f} min: {label}"
        print(line, file=sys.stderr, flush=True)


class _Shares(Display):
    """What bars show: the shares of the runs that go on, and the run that reported last."""

    def __init__(self, total: int) -> None:
        super().__init__(total)
        self.shares, self.finished = dict[str, float](), set[str]()

    def put(self, item: tuple[str, float, float]) -> None:
        label, share, loss = item
        if label in self.finished:  # its report was delayed in the queue
            return
        self.shares[label] = share
        self.draw(self._completed, f"{label}: loss {loss:.1e}")

    def ended(self, label: str) -> None:
        super().ended(label)
        self.shares.pop(label, None)
        self.finished.add(label)
        self.draw(self._completed, self.note)

    @property
    def _completed(self) -> float:
        return self.count + sum(self.shares.values())

    @property
    def note(self) -> str:
        """The text after a run has ended."""
        return ""

    def draw(self, completed: float, note: str) -> None:
        """Show how many runs are completed, with a text."""
        raise NotImplementedError


class _Bar(_Shares):
    """A progress bar in a terminal."""

    def __init__(self, total: int, progress: Progress) -> None:
        super().__init__(total)
        self.progress = progress
        self.task = progress.add_task("", total=total, of=total, ended=0, now="")

    def draw(self, completed: float, note: str) -> None:
        self.progress.update(self.task, completed=completed, ended=self.count, now=note)


class _Cell(_Shares):
    """A progress bar in the cell of a notebook."""

    def __init__(self, total: int, bar: CellBar) -> None:
        super().__init__(total)
        self.bar, self.drawn = bar, 0.0

    @property
    def note(self) -> str:
        return f"{self.count} of {self.total} runs"

    def draw(self, completed: float, note: str) -> None:
        self.bar.advance(completed - self.drawn, note)
        self.drawn = completed


@contextmanager
def display(total: int, show: bool | None) -> Iterator[Display]:
    """Yield a bar on a terminal or in a notebook, or lines elsewhere if ``show`` is true.

    Parameters
    ----------
    total : int
        Number of runs.
    show : bool, optional
        False for no bar, True for lines.
    """
    in_cell = notebook_display() if show is not False else None
    if in_cell is not None:
        bar = CellBar(total, "sweep", in_cell)
        with bar.running():
            yield _Cell(total, bar)
        return
    console = Console(stderr=True)
    if console.is_terminal and show is not False:
        columns = (
            TextColumn("{task.fields[ended]} of {task.fields[of]} runs"),
            BarColumn(bar_width=16),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(elapsed_when_finished=False),
            TextColumn("{task.fields[now]}"),
        )
        with Progress(*columns, console=console, transient=True) as progress:
            yield _Bar(total, progress)
    else:
        yield _Lines(total) if show else Display(total)
