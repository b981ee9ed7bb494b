"""What was asked of a solution is kept with it, as data, and checked when it is read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import FileError
from hamsym.solution.settings import Settings
from hamsym.support.tensor_files import read_tensors, write_tensors

DUFFING = "p**2/2 + x**2/2 + x**4/4"


def test_arguments_are_kept_in_files(tmp_path: Path) -> None:
    options: dict[str, Any] = {"tol": 1e-6, "atol": (0.0, 1e-8), "breakpoints": np.array([0.5])}
    solution = hamsym.solve(DUFFING, [1, 0], (0, 1), seed=3, **options)
    solution.save(tmp_path / "a")
    for found in (solution.settings, hamsym.load(tmp_path / "a").settings):
        assert found == Settings(
            span=(0.0, 1.0),
            seed=3,
            tol=1e-6,
            atol=(0.0, 1e-8),
            breakpoints=(0.5,),
            version=hamsym.__version__,
        )


def test_defaults_are_settings() -> None:
    settings = hamsym.solve(DUFFING, [1, 0], (0, 1), invariants=[DUFFING], prove=True).settings
    assert (settings.tol, settings.tol_given, settings.atol) == (1e-9, False, (0.0,))
    assert (settings.breakpoints, settings.options) == ((), {})
    assert (settings.invariants, settings.prove) == ((DUFFING,), True)


def test_allowed_errors_follow_the_sizes() -> None:
    solution = hamsym.solve(DUFFING, [1, 0], (0, 1), tol=1e-3, atol=[0, 2.0])
    allowed = solution.settings.allowed(np.array([10.0, 1.0]))
    np.testing.assert_allclose(allowed, [0.01, 2.001], rtol=1e-3)


def test_span_that_was_not_reached_is_kept(tmp_path: Path) -> None:
    solution = hamsym.solve("p**2/2 - x**4/4", [1.3, 1], (0, 5))
    assert not solution.success
    assert solution.span[1] < 2
    assert solution.settings.span == (0, 5)
    solution.save(tmp_path / "a")
    assert hamsym.load(tmp_path / "a").settings.span == (0, 5)


@pytest.mark.slow
def test_options_that_are_no_data_are_named(tmp_path: Path) -> None:
    network = torch.nn.Sequential(torch.nn.Linear(1, 4), torch.nn.Tanh(), torch.nn.Linear(4, 2))
    settings = hamsym.solve(
        DUFFING, [1, 0], (0, 1), method=hamsym.Adam(epochs=2, points=5, trial=network.double())
    ).settings
    assert settings.missing == ("trial",)
    assert settings.options == {"epochs": 2, "points": 5}


def test_member_of_a_family_keeps_its_tolerance() -> None:
    members = hamsym.solve_many(DUFFING, [[1, 0], [0.5, 0]], (0, 1), tol=1e-7)
    assert members[1].settings.tol == 1e-7
    assert members[1].settings.span == (0, 1)


def test_files_without_it_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a"
    hamsym.solve(DUFFING, [1, 0], (0, 1)).save(path)
    arrays, values = read_tensors(path, "solution")
    del values["settings"]
    write_tensors(path, "solution", arrays, values)
    with pytest.raises(FileError, match="not a valid file of a solution"):
        hamsym.load(path)


@pytest.mark.parametrize(
    "change",
    [
        {"seed": -1},
        {"seed": 1.5},
        {"tol": 0},
        {"tol": "1e-9"},
        {"atol": [0.0, 0.0, 0.0]},
        {"atol": [-1.0]},
        {"span": [0.0, 0.5]},
        {"span": [0.5, 1.0]},
        {"span": [0.0, float("nan")]},
        {"options": {"toll": 1e-9}},
        {"options": {"max_window": {"a": 1}}},
        {"options": {"max_window": [[1.0]]}},
        {"options": {"max_window": float("inf")}},
        {"missing": ["max_window", "max_window"]},
        {"breakpoints": [1.0]},
        {"breakpoints": 0.5},
        {"tol_given": 1},
        {"missing": [1]},
        {"prove": 1},
        {"version": None},
        {"invariants": "x"},
        {"extra": 1},
    ],
    ids=json.dumps,
)
def test_foreign_values_are_refused(change: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "a"
    hamsym.solve(DUFFING, [1, 0], (0, 1)).save(path)
    arrays, values = read_tensors(path, "solution")
    values["settings"] |= change
    write_tensors(path, "solution", arrays, values)
    with pytest.raises(FileError, match="not a valid file of a solution"):
        hamsym.load(path)
