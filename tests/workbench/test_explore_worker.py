"""Tests of the processes that compute for the page."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

from hamsym.workbench.explore.worker import CancelledError, TaskError, TimeLimitError, Worker


@pytest.fixture(scope="module")
def worker() -> Iterator[Worker]:
    worker = Worker("tests.workbench.sample_tasks")
    yield worker
    worker.close()


def test_result_of_a_task_returns(worker):
    assert worker.run("double", 30.0, 21.0) == 42.0


def test_errors_keep_sentence_and_place(worker):
    with pytest.raises(TaskError, match="^this cannot be used; give another$") as caught:
        worker.run("refuse", 30.0)
    assert caught.value.column == 0
    with pytest.raises(TaskError, match="is not a power") as caught:
        worker.run("misread", 30.0)
    assert (caught.value.token, caught.value.column) == ("^", 2)


def test_unexpected_errors_become_sentences(worker):
    with pytest.raises(TaskError, match="the computation failed: ZeroDivisionError"):
        worker.run("fail", 30.0)
    assert worker.run("double", 30.0, 1.0) == 2.0


def test_process_that_ends_is_replaced(worker):
    with pytest.raises(TaskError, match="the process of the computation ended"):
        worker.run("vanish", 30.0)
    assert worker.run("double", 30.0, 1.0) == 2.0


def test_time_limit_ends_a_task(worker):
    with pytest.raises(TimeLimitError, match="time limit of 0.2 s"):
        worker.run("sleep", 0.2, 60.0)
    assert worker.run("double", 30.0, 1.0) == 2.0


def test_cancel_ends_a_task(worker):
    worker.run("double", 30.0, 1.0)
    canceller = threading.Timer(0.2, worker.cancel)
    canceller.start()
    with pytest.raises(CancelledError):
        worker.run("sleep", 60.0, 50.0)
    canceller.join()
    assert worker.run("double", 30.0, 1.0) == 2.0


def test_closed_worker_starts_nothing():
    worker = Worker("tests.workbench.sample_tasks")
    worker.close()
    with pytest.raises(CancelledError):
        worker.run("double", 30.0, 1.0)
