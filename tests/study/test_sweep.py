"""Sweeps: equal to solve, reused, and refused with invalid settings."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

import hamsym
from hamsym.study import runs
from hamsym.study.compare import measure
from hamsym.support.locking import LOCK

OSCILLATOR = hamsym.systems.nonlinear_oscillator()
H, Z0, SPAN = OSCILLATOR.H, OSCILLATOR.z0, (0.0, 2.0)
ADAM = hamsym.Adam(epochs=60, points=20, hidden=(8, 8))
T = np.linspace(*SPAN, 33)


def _sweep(folder, settings=None, **more):
    given = {"workers": 1, "seeds": 2} | more
    return hamsym.sweep(H, Z0, SPAN, settings or {"Adam": ADAM}, folder=folder, **given)


def _files(folder):
    return [path for path in folder.iterdir() if path.name != LOCK]


@pytest.mark.slow
def test_runs_in_other_processes_equal_solve(tmp_path):
    chain = {"method": hamsym.NetworkChain(windows=2), "tol": 1e-6}
    settings = {"Adam": {"method": ADAM}, "chain": chain, "to 1e-8": {"tol": 1e-8}}
    found = _sweep(tmp_path / "a" / "b", settings, workers=2, seeds=[3])
    assert found.seeds == (3,)
    for name, options in settings.items():
        alone = hamsym.solve(H, Z0, SPAN, seed=3, **options)
        assert (found.solutions[name][0](T) == alone(T)).all()


@pytest.mark.slow
def test_existing_runs_are_reused(tmp_path, monkeypatch):
    first = _sweep(tmp_path)
    files = {path: path.stat().st_mtime_ns for path in _files(tmp_path)}
    assert len(files) == 2
    with monkeypatch.context() as patch:
        patch.setattr(runs, "solve", None)
        again = _sweep(tmp_path)
    for one, other in zip(first.solutions["Adam"], again.solutions["Adam"], strict=True):
        assert (one(T) == other(T)).all()
    _sweep(tmp_path, {"Adam": replace(ADAM, epochs=61)})
    hamsym.sweep(H, [1.0, 0.0], SPAN, {"Adam": ADAM}, folder=tmp_path, workers=1, seeds=2)
    assert len(_files(tmp_path)) == 6
    assert all(path.stat().st_mtime_ns == changed for path, changed in files.items())


def test_interrupted_run_begins_again(tmp_path, monkeypatch):
    def interrupt(self, item):
        raise KeyboardInterrupt

    settings = {"Adam": replace(ADAM, epochs=50)}
    with monkeypatch.context() as patch:
        patch.setattr(runs, "_REPORT_EVERY", 0.0)
        patch.setattr(runs.Board, "put", interrupt)
        with pytest.raises(KeyboardInterrupt):
            _sweep(tmp_path, settings, seeds=1)
    assert _files(tmp_path) == []
    found = _sweep(tmp_path, settings, seeds=1)
    alone = hamsym.solve(H, Z0, SPAN, seed=0, method=settings["Adam"])
    assert (found.solutions["Adam"][0](T) == alone(T)).all()


@pytest.mark.slow
def test_settings_may_depend_on_the_seed(tmp_path):
    first = _sweep(tmp_path, seeds=[1, 2])
    begun = dict(zip(first.seeds, first.solutions["Adam"], strict=True))
    settings = {"on": lambda seed: replace(ADAM, initial=begun[seed], epochs=1)}
    longer = hamsym.sweep(H, Z0, (0, 4), settings, folder=tmp_path, workers=1, seeds=[1, 2])
    for seed, solution in zip(longer.seeds, longer.solutions["on"], strict=True):
        alone = hamsym.solve(H, Z0, (0, 4), seed=seed, method=settings["on"](seed))
        assert (solution(T) == alone(T)).all()


def test_rows_and_median_of_solutions(tmp_path):
    found = _sweep(tmp_path, seeds=3)
    rows = found.rows(OSCILLATOR.exact)["Adam"]
    t = np.linspace(*SPAN, 4_001)
    for row, solution in zip(rows, found.solutions["Adam"], strict=True):
        right = OSCILLATOR.exact(t)
        assert row.error == pytest.approx(np.linalg.norm(solution(t) - right, axis=-1).max())
    middle = found.median("Adam", OSCILLATOR.exact)
    errors = sorted(row.error for row in rows)
    assert errors[1] == measure(middle, OSCILLATOR.exact).error
    pair = replace(found, solutions={"Adam": found.solutions["Adam"][:2]})
    lower = measure(pair.median("Adam", OSCILLATOR.exact), OSCILLATOR.exact)
    assert lower.error == min(row.error for row in rows[:2])


@pytest.mark.slow
def test_progress_lines_without_a_terminal(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("hamsym.support.progress._BEGIN", 0.0)
    _sweep(tmp_path, progress=True)
    assert ", 2 of 2 runs\n" in capsys.readouterr().err
    _sweep(tmp_path / "other")
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"seeds": 0}, "seeds=0 cannot be used; give a whole number from 1"),
        ({"seeds": None}, "seeds=None"),
        ({"seeds": []}, "empty"),
        ({"settings": ["a"]}, r"settings=\['a'\] is not a mapping"),
        ({"settings": {3: ADAM}}, r"settings=\[3\] cannot be used; give names as text"),
        ({"settings": {"a": lambda seed: 1 / seed}}, "seed 0 cannot be made: division by zero"),
        ({"seeds": [1, 1]}, "repeats"),
        ({"seeds": [-1]}, "seeds=-1"),
        ({"workers": 0}, "workers=0"),
        ({"settings": {"a": {"seed": 3}}}, "'seed' in the settings 'a' is set by sweep"),
        ({"settings": {"a": replace(ADAM, initial=3)}}, "initial in the settings 'a'"),
        ({"settings": {"a": replace(ADAM, regularizers=[1])}}, "regularizers"),
        ({"settings": {"a": {"epochs": 3}}}, r"method=hamsym.Adam\(epochs=3\)"),
        ({"settings": {"a": {"toll": 3}}, "workers": 2}, "'toll' is not an argument of solve"),
        ({"settings": {"a": hamsym.Adam}}, r"give hamsym.Adam\(\)"),
        ({"settings": {"a": {"method": hamsym.Adam}}}, r"give hamsym.Adam\(\)"),
        ({"settings": {"a": {"tol": 3}}}, "tol=3"),
        ({"settings": {"a": {"tol": 3}}, "workers": 2}, "tol=3"),
    ],
)
def test_bad_input_is_rejected(tmp_path, change, message):
    with pytest.raises(hamsym.InputError, match=message):
        _sweep(tmp_path, **change)


def test_folder_that_cannot_be_created_is_rejected(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(hamsym.HamsymError, match="cannot be created"):
        _sweep(tmp_path / "file")


_HOLD = """
import sys
from hamsym.support.locking import exclusive
with exclusive(sys.argv[1]):
    print("held", flush=True)
    input()
"""


@pytest.mark.slow
def test_folder_is_locked_against_other_processes(tmp_path):
    _sweep(tmp_path)
    longer = {"Adam": replace(ADAM, epochs=61)}
    run = [sys.executable, "-c", _HOLD, str(tmp_path)]
    with subprocess.Popen(run, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "held\n"
        with pytest.raises(hamsym.FileError, match=f"'{tmp_path}' is in use by another process"):
            _sweep(tmp_path, longer)
        assert len(_files(tmp_path)) == 2
        assert _sweep(tmp_path).seeds == (0, 1)  # existing runs are read without the lock
        other.kill()
    _sweep(tmp_path, longer)  # the lock of a dead process is released
    assert len(_files(tmp_path)) == 4


@pytest.mark.parametrize("folder", [5, "a\0b"])
def test_invalid_folder_is_rejected(folder):
    with pytest.raises(hamsym.FileError, match="cannot be created"):
        _sweep(folder)


@pytest.mark.slow
def test_death_of_a_worker_is_reported(tmp_path):
    with pytest.raises(hamsym.HamsymError, match="ended before its run"):
        _sweep(tmp_path, {"a": _Dies()}, workers=2)


class _Dies:
    """Settings whose values kill the process that unpickles them."""

    def __call__(self, seed):
        return replace(ADAM, device=_Deadly())


class _Deadly:
    def __reduce__(self):
        return os._exit, (3,)

    def __repr__(self):
        return "deadly"


def test_file_of_another_problem_is_refused(tmp_path):
    given = ("p**2/2 + x**2/2", [1, 0], (0, 1), {"a": {}})
    hamsym.sweep(*given, folder=tmp_path, seeds=1, workers=1)
    [file] = tmp_path.glob("*.hamsym")
    hamsym.solve("p**2/2 + 9*x**2/2", [2, 0], (0, 1)).save(file)
    with pytest.raises(hamsym.FileError, match="another problem"):
        hamsym.sweep(*given, folder=tmp_path, seeds=1, workers=1)


@pytest.mark.parametrize("other", [{"tol": 1e-3}, {"tol": 1e-9, "method": hamsym.NetworkChain()}])
def test_file_with_other_settings_is_refused(tmp_path, other):
    given = ("p**2/2 + x**2/2", [1, 0], (0, 1), {"a": {"tol": 1e-9}})
    hamsym.sweep(*given, folder=tmp_path, seeds=1, workers=1)
    [file] = tmp_path.glob("*.hamsym")
    hamsym.solve(*given[:3], **other).save(file)
    with pytest.raises(hamsym.FileError, match="other settings"):
        hamsym.sweep(*given, folder=tmp_path, seeds=1, workers=1)
