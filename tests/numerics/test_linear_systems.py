"""Systems of linear equations, and the threads of BLAS."""

import threading

import numpy as np
import pytest
import threadpoolctl

from hamsym.numerics.linear_systems import _SMALL, blas_on_one_core, solved
from hamsym.support.machine import one_core

SYSTEMS = np.random.default_rng(0).standard_normal((3, 20, 20)) + 9 * np.eye(20)


def threads() -> set[int]:
    return {entry["num_threads"] for entry in threadpoolctl.threadpool_info()} or {1}


@pytest.fixture
def two_threads():
    with threadpoolctl.threadpool_limits(2, user_api="blas"):
        if threads() != {2}:
            pytest.skip("BLAS has one thread")
        yield


def test_systems_are_solved():
    columns = np.arange(180.0).reshape(3, 20, 3)
    np.testing.assert_allclose(SYSTEMS @ solved(SYSTEMS, columns), columns, atol=1e-12)


def test_singular_systems_have_no_solution():
    matrices = SYSTEMS.copy()
    matrices[1] = 0
    assert np.isnan(solved(matrices, np.ones((3, 20, 1)))).all()


@pytest.mark.parametrize(("size", "expected"), [(_SMALL, 1), (_SMALL + 1, 2)])
def test_small_systems_are_solved_on_one_core(two_threads, monkeypatch, size, expected):
    found = []
    monkeypatch.setattr(np.linalg, "solve", lambda _, b: found.append(threads()) or b)
    solved(np.empty((size, size)), np.empty((size, 1)))
    assert found == [{expected}]
    assert threads() == {2}


def test_limit_ends_with_the_last_thread(two_threads):
    inside, leave = threading.Event(), threading.Event()

    def other():
        with one_core():
            inside.set()
            leave.wait(10)

    with blas_on_one_core():
        thread = threading.Thread(target=other)
        thread.start()
        inside.wait(10)
    assert threads() == {1}
    leave.set()
    thread.join()
    assert threads() == {2}


def test_limit_ends_with_an_error(two_threads):
    with pytest.raises(ZeroDivisionError), blas_on_one_core(), one_core():
        raise ZeroDivisionError
    assert threads() == {2}
