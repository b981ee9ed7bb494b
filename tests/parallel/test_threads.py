"""Threads: results in order, errors and Ctrl-C in all of them alike, one core for each task."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import torch

from hamsym.parallel.threads import Threads, slices
from hamsym.support import machine
from hamsym.support.machine import available_cores, one_core


@pytest.fixture(autouse=True)
def three(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Three cores, on every machine."""
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 3)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: range(3), raising=False)
    monkeypatch.setattr(machine, "_PROCESSORS", ())
    machine._container_cores.cache_clear()
    yield
    machine._container_cores.cache_clear()


def test_results_have_the_order_of_the_tasks() -> None:
    def square(number: int) -> int:
        time.sleep(0.001 * (number % 5))
        return number**2

    with Threads() as threads:
        assert list(threads.results(square, range(20))) == [(n, n * n) for n in range(20)]


def test_later_tasks_may_depend_on_earlier_results() -> None:
    read, done = [], []

    def tasks() -> Iterator[int]:
        for number in range(12):
            read.append(len(done))
            yield number

    with Threads() as threads:
        for task, _ in threads.results(lambda number: number, tasks(), 2):
            done.append(task)
    # Two for each of three threads are read before the first result.
    assert read == [0] * 6 + [1, 2, 3, 4, 5, 6]


def test_error_ends_the_work() -> None:
    began: list[int] = []

    def work(number: int) -> None:
        began.append(number)
        time.sleep(0.01)
        if number == 4:
            raise ZeroDivisionError(f"task {number}")

    before = threading.active_count()
    with pytest.raises(ZeroDivisionError, match="task 4"), Threads() as threads:
        list(threads.results(work, range(1_000)))
    assert len(began) < 100
    assert threading.active_count() == before


def test_ctrl_c_keeps_what_had_begun() -> None:
    began, kept = [], []

    def work(number: int) -> int:
        began.append(number)
        time.sleep(0.01)
        if number == 4:
            signal.raise_signal(signal.SIGINT)  # for the main thread
        return -number

    def all_kept() -> None:
        for task, _ in threads.results(work, range(1_000), 2):
            kept.append(task)

    with Threads() as threads:
        with pytest.raises(KeyboardInterrupt):
            all_kept()
        kept += [task for task, result in threads.begun() if result == -task]
    assert kept == list(range(len(kept))) == sorted(began)
    assert 3 <= len(kept) < 100


def test_long_task_may_end_early() -> None:
    began, ended = threading.Event(), threading.Event()

    def work(number: int) -> None:
        if number == 0:
            began.wait(60)
            raise ValueError("the first one")
        began.set()
        while not threads.is_stopped:
            time.sleep(0.001)
        ended.set()

    with pytest.raises(ValueError, match="the first one"), Threads() as threads:
        list(threads.results(work, range(2)))
    assert ended.is_set()


def test_a_task_uses_one_core() -> None:
    def inside(_: int) -> tuple[int, int, int]:
        with Threads() as nested:
            return available_cores(), torch.get_num_threads(), nested.cores

    with Threads() as threads:
        assert threads.cores == 3
        assert {found for _, found in threads.results(inside, range(6))} == {(1, 1, 1)}
    with Threads(1) as threads:
        assert [found for _, found in threads.results(inside, [0])] == [(1, 1, 1)]


def test_one_core_is_this_thread() -> None:
    threads_before, torch_before = threading.active_count(), torch.get_num_threads()
    with one_core(), Threads() as threads:
        found = threads.results(lambda _: threading.current_thread(), range(3))
        assert {thread for _, thread in found} == {threading.main_thread()}
        assert threading.active_count() == threads_before
    assert torch.get_num_threads() == torch_before
    assert Threads(0).cores == 1


def test_slices_divide_all_rows() -> None:
    for count, parts in ((10, 3), (2, 5), (0, 1)):
        found = [np.arange(count)[part] for part in slices(count, parts)]
        assert len(found) == parts
        assert np.concatenate(found).tolist() == list(range(count))
        assert max(map(len, found)) - min(map(len, found)) <= 1


@pytest.mark.parametrize(
    ("texts", "cores"),
    [
        (["200000 100000"], 2),
        (["50000 100000"], 1),
        (["150000 100000"], 2),
        (["max 100000"], 64),
        (["150000", "100000"], 2),
        (["-1", "100000"], 64),
        (["text"], 64),
        ([], 64),
    ],
)
def test_container_limits_the_cores(
    texts: list[str], cores: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = [tmp_path / str(number) for number in range(len(texts) or 1)]
    for file, text in zip(files, texts, strict=False):
        file.write_text(f"{text}\n")
    monkeypatch.setattr(machine, "_PROCESSORS", (files,))
    monkeypatch.setattr(machine.os, "cpu_count", lambda: 64)
    monkeypatch.setattr(machine.os, "sched_getaffinity", lambda _: range(64), raising=False)
    machine._container_cores.cache_clear()
    assert available_cores() == cores
