"""Progress bars: in the cell of a notebook, on terminals, and not elsewhere."""

from __future__ import annotations

import html
import sys
from types import SimpleNamespace
from typing import Any

import pytest

from hamsym.networks.progress import training_progress
from hamsym.networks.record import TrainingState
from hamsym.study.runs import Board
from hamsym.support import progress
from hamsym.support.progress import notebook_display, share_progress, stepping_progress


class Cell:
    """What a cell of a notebook displays, in the order of time."""

    def __init__(self) -> None:
        self.shown: list[dict[str, str]] = []

    def display(self, data: dict[str, str], *, raw: bool, display_id: bool) -> Cell:
        assert raw
        assert display_id
        assert not self.shown  # one display, which is updated
        self.shown.append(data)
        return self

    def update(self, data: dict[str, str], *, raw: bool) -> None:
        assert raw
        self.shown.append(data)

    @property
    def lines(self) -> list[str]:
        return [data["text/plain"] for data in self.shown]


class Clock:
    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def cell(monkeypatch: pytest.MonkeyPatch) -> Cell:
    found = Cell()
    monkeypatch.setattr(progress, "notebook_display", lambda: found.display)
    return found


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    found = Clock()
    monkeypatch.setattr(progress, "time", found)
    return found


def test_a_bar_becomes_one_line(cell: Cell, clock: Clock) -> None:
    with stepping_progress(100, text="proving") as advance:
        for _ in range(4):
            clock.now += 1.0
            advance(25)
    assert cell.lines == [
        "proving: 25%, 3.0 s left",
        "proving: 50%, 2.0 s left",
        "proving: 75%, 1.0 s left",
        "proving: 100%, 0.0 s left",
        "proving: 4.0 s",
    ]
    assert "<progress" in cell.shown[0]["text/html"]
    assert cell.shown[-1]["text/html"] == "proving: 4.0 s"


def test_short_work_shows_nothing(cell: Cell, clock: Clock) -> None:
    with share_progress() as report:
        clock.now += 0.9
        report(1.0)
    assert not cell.shown


def test_bars_are_drawn_a_few_times_a_second(cell: Cell, clock: Clock) -> None:
    with stepping_progress(10_000) as advance:
        for _ in range(10_000):
            clock.now += 0.001
            advance(1)
    assert 40 < len(cell.shown) < 60


def test_work_that_ends_early_says_where(cell: Cell, clock: Clock) -> None:
    def work() -> None:
        with share_progress() as report:
            clock.now += 200.0
            report(0.4)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert cell.lines[-1] == "stepping: ended at 40% after 3 min 20 s"


def test_false_shows_nothing(cell: Cell, clock: Clock) -> None:
    with stepping_progress(2, show=False) as advance:
        clock.now += 5.0
        advance(1)
    with training_progress(10, False) as tell:
        clock.now += 5.0
        tell(TrainingState(5, 10, 1e-3, 1e-4, 2e-2, clock.now))
    assert not cell.shown


def test_a_training_leaves_its_loss(cell: Cell, clock: Clock) -> None:
    with training_progress(10) as tell:
        for iteration in (5, 10):
            clock.now += 3.0
            tell(TrainingState(iteration, 10, 1e-3, 1e-4, 2e-2, clock.now))
    assert cell.lines[0] == "training: 50%, 3.0 s left, loss 1.0e-04, ell_max 2.0e-02"
    assert cell.lines[-1] == "training: 6.0 s, loss 1.0e-04, ell_max 2.0e-02"


def test_a_sweep_counts_its_runs(cell: Cell, clock: Clock) -> None:
    label = "<b>adam</b> 0"
    with share_progress(text="sweep") as draw:
        shown = Board(2, draw)
        clock.now += 2.0
        shown.put((label, 0.5, 1e-3))
        clock.now += 2.0
        shown.ended(label)
        shown.put((label, 0.9, 1e-3))  # a late report
        clock.now += 2.0
        shown.ended("adam 1")
    assert cell.lines[0] == f"sweep: 25%, 6.0 s left, {label}: loss 1.0e-03"
    assert html.escape(label) in cell.shown[0]["text/html"]
    assert cell.lines[-1] == "sweep: 6.0 s, 2 of 2 runs"


@pytest.mark.parametrize("shell", [None, SimpleNamespace(), SimpleNamespace(kernel=None)])
def test_other_shells_are_no_notebooks(shell: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "IPython", SimpleNamespace(get_ipython=lambda: shell))
    assert notebook_display() is None


def test_files_get_no_bar(capsys: pytest.CaptureFixture[str], clock: Clock) -> None:
    with stepping_progress(2) as advance:
        clock.now += 5.0
        advance(1)
    assert capsys.readouterr() == ("", "")


def test_files_get_lines_if_asked(capsys: pytest.CaptureFixture[str], clock: Clock) -> None:
    with stepping_progress(40, show=True, text="sweep") as advance:
        for run in range(40):
            clock.now += 1.0
            advance(1, f"run {run}")
    assert capsys.readouterr() == (
        "",
        "sweep: 2%, 39 s left, run 0\n"
        "sweep: 28%, 29 s left, run 10\n"
        "sweep: 52%, 19 s left, run 20\n"
        "sweep: 78%, 9.0 s left, run 30\n"
        "sweep: 40 s, run 39\n",
    )


def test_a_terminal_has_one_line_which_disappears(
    capsys: pytest.CaptureFixture[str], clock: Clock, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    monkeypatch.setenv("COLUMNS", "24")
    with stepping_progress(4, text="proving") as advance:
        for _ in range(2):
            clock.now += 2.0
            advance(1, "a long note")
    drawn = capsys.readouterr().err.split("\r\x1b[K")
    assert drawn == ["", "proving: 25%, 6.0 s lef", "proving: 50%, 4.0 s lef", ""]
