"""Processes: results, errors in one sentence, limits, Ctrl-C, and their end with the program."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from hamsym.errors import HamsymError, InputError, ParseError
from hamsym.parallel.processes import (
    CancelledError,
    OverTimeError,
    ProcessEndedError,
    Worker,
    in_processes,
)

from . import sample_tasks as tasks


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    worker = Worker()
    yield worker
    worker.close()


def test_result_of_a_task_returns(worker: Worker) -> None:
    assert worker.run(tasks.double, 60.0, 21.0) == 42.0


def test_errors_keep_class_and_place(worker: Worker) -> None:
    with pytest.raises(InputError, match="^this cannot be used; give another$"):
        worker.run(tasks.refuse, 60.0)
    with pytest.raises(ParseError, match="is not a power; write") as caught:
        worker.run(tasks.misread, 60.0)
    assert (caught.value.token, caught.value.column) == ("^", 2)


def test_unexpected_errors_become_sentences(worker: Worker) -> None:
    with pytest.raises(HamsymError, match="the computation failed: ZeroDivisionError") as caught:
        worker.run(tasks.fail, 60.0)
    assert "in fail" in caught.value.__notes__[0]
    with pytest.raises(HamsymError, match="the computation failed: .*pickle"):
        worker.run(tasks.unsendable, 60.0)
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0


def test_tasks_use_one_core_and_no_console(
    worker: Worker, capfd: pytest.CaptureFixture[str]
) -> None:
    with closing(Worker()) as own:  # one with the files of this test
        assert own.run(tasks.talk, 60.0) == (1, "nothing")
    assert capfd.readouterr() == ("", "to the reader\n")


def test_process_that_ends_is_replaced(worker: Worker) -> None:
    with pytest.raises(ProcessEndedError, match="the process of the computation ended"):
        worker.run(tasks.vanish, 60.0)
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0


def test_time_limit_ends_a_task(worker: Worker) -> None:
    with pytest.raises(OverTimeError, match="time limit of 0.2 s"):
        worker.run(tasks.sleep, 0.2, 60.0)
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0


def test_result_that_nobody_waits_for_is_dropped(worker: Worker) -> None:
    def refuse(_: object) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        worker.run(tasks.squared, 60.0, 3, report=refuse)
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0


def test_cancel_ends_a_task(worker: Worker) -> None:
    worker.run(tasks.double, 60.0, 1.0)
    canceller = threading.Timer(0.2, worker.cancel)
    canceller.start()
    with pytest.raises(CancelledError):
        worker.run(tasks.sleep, 60.0, 50.0)
    canceller.join()
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0


def test_closed_worker_starts_nothing() -> None:
    worker = Worker()
    worker.close()
    with pytest.raises(CancelledError):
        worker.run(tasks.double, 60.0, 1.0)


@pytest.mark.parametrize("workers", [1, 2])
def test_many_tasks_return_and_report(workers: int) -> None:
    reports: list[str] = []
    found = dict(in_processes(tasks.squared, [3, 0, 1, 2], workers, reports.append))
    assert found == {0: 0, 1: 1, 2: 4, 3: 9}
    assert sorted(reports) == [f"begun {number}" for number in range(4)]


@pytest.mark.parametrize("workers", [1, 2])
def test_error_of_a_task_ends_the_others(workers: int) -> None:
    reports: list[str] = []
    with pytest.raises(InputError, match="-1 is negative"):
        list(in_processes(tasks.squared, [0, -1, *[6_000] * 9], workers, reports.append))
    assert len(reports) <= 4  # the others would take minutes


def test_ctrl_c_ends_the_processes(tmp_path: Path) -> None:
    """The tasks do not see it: they are ended by the program that does."""
    file = tmp_path / "beat"
    reports = []

    def interrupt(report: object) -> None:
        reports.append(report)
        if len(reports) == 1:
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        list(in_processes(tasks.beating, [file, tmp_path / "other"], 2, interrupt))
    assert _is_still(file)


@pytest.mark.skipif(os.name != "posix", reason="no signals to a group of processes")
def test_ctrl_c_of_the_terminal_reaches_no_worker() -> None:
    """Also while it starts, when it would print a traceback."""
    worker = Worker()
    worker.start()
    assert worker._process is not None
    assert os.getpgid(worker._process.pid) != os.getpgid(0)
    assert worker.run(tasks.double, 60.0, 1.0) == 2.0
    worker._process.send_signal(signal.SIGINT)
    assert worker.run(tasks.double, 60.0, 2.0) == 4.0
    worker.close()


def test_process_ends_with_a_killed_program(tmp_path: Path) -> None:
    """A main script without a guard, which is killed."""
    script, file = tmp_path / "script.py", tmp_path / "beat"
    script.write_text(
        "from pathlib import Path\n"
        "from hamsym.parallel.processes import Worker\n"
        "from tests.parallel.sample_tasks import beating\n"
        f"Worker().run(beating, 600.0, Path({str(file)!r}), report=print)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.getcwd(), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, script], stdout=subprocess.PIPE, env=environment
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"begun\n"
        program.kill()
    assert _is_still(file)


def _is_still(file: Path) -> bool:
    """Whether a file is not changed any more, after a while."""
    for _ in range(200):
        before = file.read_text() if file.exists() else ""
        time.sleep(0.3)
        if before == (file.read_text() if file.exists() else ""):
            return True
    return False
