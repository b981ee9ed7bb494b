"""Progress of work in many steps: in a line of a terminal or the cell of a notebook, else lines."""

from __future__ import annotations

import html
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

_TICKS = 1_000
_BEGIN = 1.0  # seconds without a bar
_PAUSE = 0.2  # seconds between two drawings
_LINE_PAUSE = 10.0  # and between two lines


@contextmanager
def stepping_progress(
    steps: int, show: bool | None = None, text: str = "stepping"
) -> Iterator[Callable[..., None]]:
    """Yield a function that takes further steps, and a note, and draws a bar after a second.

    In a notebook the bar is in the cell and becomes one line with the time that the work took; on
    a terminal it disappears. Several threads may call the function.

    - steps: Number of all steps.
    - show: By default the bar is drawn if standard error is a terminal, and in notebooks. True
      prints lines where there is neither.
    - text: What is in progress, before the bar.
    """
    if not is_shown(show):
        yield lambda more, note="": None
        return
    if (display := notebook_display()) is None:
        display = _Terminal if sys.stderr.isatty() else _Lines
    bar = _Bar(steps, text, display, _LINE_PAUSE if display is _Lines else _PAUSE)
    with bar.running():
        yield bar.advance


@contextmanager
def share_progress(
    show: bool | None = None, text: str = "stepping"
) -> Iterator[Callable[..., None]]:
    """Yield a function that takes the completed share of the work, from 0 to 1, and a note."""
    with stepping_progress(_TICKS, show, text) as advance:
        done = 0

        def report(share: float, note: str = "") -> None:
            nonlocal done
            now = int(share * _TICKS)
            advance(now - done, note)
            done = now

        yield report


def advance_in_blocks(
    steps: int, block: int, show: bool | None, advance: Callable[[int, int], bool]
) -> bool:
    """Advance block by block to the last step, and return whether Ctrl-C interrupted.

    - steps, block: Number of steps, in total and in a block.
    - show: Show progress; by default on a terminal.
    - advance: (steps done before, steps of this block) -> whether to continue.
    """
    with stepping_progress(steps, show) as report:
        try:
            for done in range(0, steps, block):
                count = min(block, steps - done)
                goes_on = advance(done, count)
                report(count)
                if not goes_on:
                    break
        except KeyboardInterrupt:
            return True
    return False


def is_shown(show: bool | None) -> bool:
    """Whether progress is drawn: as asked, or by default on a terminal and in a notebook."""
    if show is not None:
        return show
    return sys.stderr.isatty() or notebook_display() is not None


def notebook_display() -> Callable[..., Any] | None:
    """Return the function that displays in the cell of a notebook, or None outside of one.

    IPython is not imported: a process with a kernel has it already.
    """
    module = sys.modules.get("IPython")
    shell = module.get_ipython() if module is not None else None
    if shell is None or getattr(shell, "kernel", None) is None:
        return None
    from IPython.display import display

    found: Callable[..., Any] = display
    return found


class _Lines:
    """Lines on standard error, with the methods of a display of IPython."""

    def __init__(self, data: dict[str, str], **_: object) -> None:
        self.update(data)

    def update(self, data: dict[str, str], **_: object) -> None:
        """Write a line."""
        print(data["text/plain"], file=sys.stderr, flush=True)


class _Terminal(_Lines):
    """A line on a terminal, which is written anew and disappears at the end."""

    def update(self, data: dict[str, str], **_: object) -> None:
        """Write the line."""
        line = data["text/plain"][: shutil.get_terminal_size().columns - 1]
        print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)


class _Bar:
    """A bar on a display, which becomes one line at the end.

    - steps: Number of all steps.
    - text: What is in progress.
    - display: IPython's ``display``, :class:`_Lines` or :class:`_Terminal`.
    - pause: Seconds between two drawings.
    """

    def __init__(self, steps: int, text: str, display: Callable[..., Any], pause: float) -> None:
        self._pause = pause
        self._steps, self._text, self._display = max(steps, 1), text, display
        self._done, self._note = 0.0, ""
        self._began = time.monotonic()
        self._drawn = -float("inf")
        self._handle: Any = None
        self._lock = threading.Lock()  # several threads may report

    @contextmanager
    def running(self) -> Iterator[None]:
        """Leave the line at the end, if there was a bar."""
        try:
            yield
        finally:
            if self._handle is not None:
                gone = self._display is _Terminal
                self._handle.update({"text/plain": ""} if gone else self._last(), raw=True)

    def advance(self, more: float, note: str = "") -> None:
        """Add completed steps; draw after the first second, a few times a second."""
        with self._lock:
            self._done += more
            self._note = note
            now = time.monotonic()
            if now - self._began < _BEGIN or now - self._drawn < self._pause:
                return
            self._drawn = now
            if self._handle is None:
                self._handle = self._display(self._bar(now), raw=True, display_id=True)
            else:
                self._handle.update(self._bar(now), raw=True)

    def _share(self) -> float:
        return min(max(self._done / self._steps, 0.0), 1.0)

    def _bar(self, now: float) -> dict[str, str]:
        share, elapsed = self._share(), now - self._began
        left = f", {_time(elapsed * (1 - share) / share)} left" if share > 0 else ""
        line = f"{self._text}: {share:.0%}{left}{', ' if self._note else ''}{self._note}"
        return {
            "text/plain": line,
            "text/html": (
                f'<progress max="1" value="{share:.3f}" style="width: 16em; vertical-align: '
                f'middle"></progress> {html.escape(line)}'
            ),
        }

    def _last(self) -> dict[str, str]:
        elapsed = _time(time.monotonic() - self._began)
        early = f"ended at {self._share():.0%} after " if self._share() < 0.995 else ""
        line = f"{self._text}: {early}{elapsed}{', ' if self._note else ''}{self._note}"
        return {"text/plain": line, "text/html": html.escape(line)}


def _time(seconds: float) -> str:
    """A time in words: 4.2 s, 3 min 20 s, 2 h 5 min."""
    if seconds < 60:
        return f"{seconds:.1f} s" if seconds < 10 else f"{seconds:.0f} s"
    minutes, rest = divmod(round(seconds), 60)
    if minutes < 60:
        return f"{minutes} min {rest} s"
    return f"{minutes // 60} h {minutes % 60} min"
