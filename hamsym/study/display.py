"""Progress displays of runs."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from hamsym.support.progress import is_shown, stepping_progress


class Display:
    """The shares of the runs that go on, and the run that reported last, drawn as a bar.

    - total: Number of runs.
    - advance: (completed runs since the last call, note) -> None.
    """

    def __init__(self, total: int, advance: Callable[[float, str], None]) -> None:
        self.total, self.count = total, 0
        self._advance, self._drawn = advance, 0.0
        self._shares, self._finished = dict[str, float](), set[str]()

    def put(self, item: tuple[str, float, float]) -> None:
        """Show label, share of the iterations and best loss of a run."""
        label, share, loss = item
        if label in self._finished:  # its report was delayed in the queue
            return
        self._shares[label] = share
        self._draw(f"{label}: loss {loss:.1e}")

    def ended(self, label: str) -> None:
        """Count a run that has ended."""
        self.count += 1
        self._shares.pop(label, None)
        self._finished.add(label)
        self._draw(f"{self.count} of {self.total} runs")

    def _draw(self, note: str) -> None:
        completed = self.count + sum(self._shares.values())
        self._advance(completed - self._drawn, note)
        self._drawn = completed


class _Lines(Display):
    """A line on standard error for each run that has ended."""

    def __init__(self, total: int) -> None:
        super().__init__(total, lambda more, note: None)
        self._began = time.monotonic()

    def ended(self, label: str) -> None:
        super().ended(label)
        minutes = (time.monotonic() - self._began) / 60
        line = f"{self.count}/{self.total} after {minutes:.1f} min: {label}"
        print(line, file=sys.stderr, flush=True)


@contextmanager
def display(total: int, show: bool | None) -> Iterator[Display]:
    """Yield a bar on a terminal or in a notebook, or lines elsewhere if ``show`` is true.

    - total: Number of runs.
    - show: False for no bar, True for lines.
    """
    if show and not is_shown(None):
        yield _Lines(total)
        return
    with stepping_progress(total, show, "sweep") as advance:
        yield Display(total, advance)
