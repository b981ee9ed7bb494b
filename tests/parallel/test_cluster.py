"""Clusters of dask: results of a local run to the last bit, nothing lost with a worker."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hamsym
from hamsym import FileError, Hamiltonian, HamsymError, InputError
from hamsym.families import many as many_module
from hamsym.families.distributed import StorePlace
from hamsym.parallel.cluster import Task, _on_worker, cluster_results
from hamsym.systems import henon_heiles

distributed = pytest.importorskip("distributed")

HENON = henon_heiles().H
SPAN = (0.0, 6 * np.pi)
# Cubic forces let states with much energy escape in finite time.
CUBIC = Hamiltonian("p**2/2 + k*x**2/2 + x**3/3", parameters={"k": 1.0})


def random_starts(count: int) -> np.ndarray:
    return np.random.default_rng(0).uniform(-0.2, 0.2, (count, 4))


@pytest.fixture(scope="module")
def client() -> Iterator[Any]:
    """Two workers in this process, which start at once."""
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(**options, processes=False, silence_logs=50) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.fixture(scope="module")
def processes() -> Iterator[Any]:
    """Two processes, which are started again after they are killed."""
    options = {"n_workers": 2, "threads_per_worker": 1, "dashboard_address": ":0"}
    with (
        distributed.LocalCluster(**options, silence_logs=50) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


def same_solutions(one: hamsym.Solutions, other: hamsym.Solutions) -> None:
    t = np.linspace(*one.span, 7)
    np.testing.assert_array_equal(one(t), other(t))
    for name in ("success", "message", "largest_error", "excess", "z0"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), name)
    assert one.shape == other.shape


@contextmanager
def after_members(count: int, action: Callable[[], None]) -> Iterator[list[int]]:
    """Act once, in the report of progress; yield the numbers of members that are reported."""
    reports: list[int] = []

    @contextmanager
    def progress(*_: object) -> Iterator[Callable[[int], None]]:
        def report(more: int) -> None:
            before = sum(reports)
            reports.append(more)
            if before < count <= sum(reports):
                action()

        yield report

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(many_module, "stepping_progress", progress)
        yield reports


def interrupt() -> None:
    raise KeyboardInterrupt


# -- solve_many ------------------------------------------------------------------------------------


def test_members_equal_those_of_a_local_run(client: Any) -> None:
    starts = {"x": [[0.1, -3.0, 0.2, np.nan, 0.5]], "p": [[0.0], [0.3]]}
    options = {"parameters": {"k": [[1.0], [2.0]]}}
    here = hamsym.solve_many(CUBIC, starts, (0, 10), **options)
    there = hamsym.solve_many(CUBIC, starts, (0, 10), client=client, **options)
    same_solutions(there, here)
    assert not here.success.all()
    assert (there[0, 0](3.0) == here[0, 0](3.0)).all()


@pytest.mark.parametrize("chunk", [1, 7, 200])
def test_size_of_chunks_changes_no_bit(
    client: Any, chunk: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hamsym.families.distributed._FIRST", chunk)
    monkeypatch.setattr("hamsym.families.distributed._MOST", chunk)
    monkeypatch.setattr("hamsym.families.distributed._SHARES", 0.01)
    count = min(30 * chunk, 200)
    starts = random_starts(200)[:count]
    here = hamsym.solve_many(HENON, starts, SPAN)
    same_solutions(hamsym.solve_many(HENON, starts, SPAN, client=client), here)


@pytest.mark.slow  # a worker is started again
def test_killed_worker_loses_nothing(processes: Any, tmp_path: Path) -> None:
    starts = random_starts(600)

    def kill() -> None:
        os.kill(next(iter(processes.run(os.getpid).values())), 9)

    with after_members(100, kill) as reports:
        found = hamsym.solve_many(HENON, starts, SPAN, client=processes, store=tmp_path / "a")
    assert sum(reports) == 600
    here = hamsym.solve_many(HENON, starts, SPAN)
    same_solutions(found, here)
    same_solutions(hamsym.load(tmp_path / "a"), here)


@pytest.mark.slow
def test_interrupted_store_is_completed(processes: Any, tmp_path: Path) -> None:
    starts, path = random_starts(600), tmp_path / "a"
    with after_members(150, interrupt):
        part = hamsym.solve_many(HENON, starts, SPAN, client=processes, store=path)
    done = part.success
    assert 0 < done.sum() < 600
    assert set(part.message[~done]) == {"interrupted"}
    parts = {entry: entry.stat().st_mtime_ns for entry in (path / "parts").glob("*.table")}
    with after_members(10_000, interrupt) as reports:
        found = hamsym.solve_many(HENON, starts, SPAN, client=processes, store=path)
    assert reports[0] >= done.sum()  # members that are not solved again
    assert sum(reports) == 600
    again = {entry: entry.stat().st_mtime_ns for entry in (path / "parts").glob("*.table")}
    assert parts.items() <= again.items()
    here = hamsym.solve_many(HENON, starts, SPAN)
    same_solutions(found, here)
    same_solutions(hamsym.load(path), here)
    with pytest.raises(FileError, match="or the arguments with which this one was begun"):
        hamsym.solve_many(HENON, starts, SPAN, tol=1e-8, client=processes, store=path)


@pytest.mark.slow
def test_store_that_workers_do_not_reach(
    client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Windows then come through the client, which writes them."""
    starts = random_starts(100)
    elsewhere = StorePlace(tmp_path / "none", "")
    monkeypatch.setattr(many_module.WindowStore, "place", elsewhere)
    found = hamsym.solve_many(HENON, starts, SPAN, client=client, store=tmp_path / "a")
    same_solutions(found, hamsym.solve_many(HENON, starts, SPAN))


# -- failures --------------------------------------------------------------------------------------


def _fails_once(folder: str, number: int) -> int:
    flag = Path(folder) / str(number)
    if not flag.exists():
        flag.touch()
        raise OSError("the disk is not there")
    return number


def _fails_at_three(_: None, number: int) -> int:
    if number == 3:
        raise OSError("the disk is not there")
    return number


def _dies_at_three(_: None, number: int) -> int:
    if number == 3:
        os._exit(1)
    return number


def _refuses(_: None, number: int) -> int:
    raise InputError(f"{number} cannot be used")


def _numbers(count: int) -> list[Task]:
    return [Task(np.array([10 * k, 10 * k + 9]), (k,)) for k in range(count)]


def test_errors_on_workers_are_repeated(client: Any, tmp_path: Path) -> None:
    found = cluster_results(client, _fails_once, str(tmp_path), _numbers(5), retries=1)
    assert sorted(result for _, result, _ in found) == [0, 1, 2, 3, 4]
    with pytest.raises(HamsymError, match="members 30 to 39 failed on a worker: OSError: the disk"):
        list(cluster_results(client, _fails_at_three, None, _numbers(5), retries=1))
    with pytest.raises(InputError, match="cannot be used"):
        list(cluster_results(client, _refuses, None, _numbers(1)))


@pytest.mark.slow  # workers are started again
def test_members_that_kill_workers_are_named(processes: Any) -> None:
    """Members that were on the same worker are not blamed."""
    processes.run_on_scheduler(
        lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0)
    )
    with pytest.raises(HamsymError, match="members 30 to 39 ended the worker .* each time"):
        list(cluster_results(processes, _dies_at_three, None, _numbers(5)))
    processes.run_on_scheduler(
        lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 3)
    )


@pytest.mark.slow
def test_closing_cancels_what_is_left(processes: Any) -> None:
    tasks = [Task(np.array([k]), (k,)) for k in range(20)]
    results = cluster_results(processes, _slow, None, tasks)
    next(results)
    results.close()
    assert not processes.futures


def _slow(_: None, number: int) -> int:
    return number


def test_other_version_of_a_worker_is_refused() -> None:
    problem, _ = _on_worker(_slow, b"", "0.0.0")
    assert isinstance(problem, InputError)
    assert "this process has 0.0.0; install one version" in str(problem)


def test_invalid_clients_are_refused(client: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match=r"client=3 cannot be used; give a dask\.distributed"):
        hamsym.solve_many(HENON, random_starts(2), SPAN, client=3)
    with pytest.raises(InputError, match="retries=-1"):
        hamsym.solve_many(HENON, random_starts(2), SPAN, client=client, retries=-1)
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(InputError, match=r'pip install "hamsym\[distributed\]"'):
        hamsym.solve_many(HENON, random_starts(2), SPAN, client=client)
