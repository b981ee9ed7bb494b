"""The command ``hamsym systems``."""

from __future__ import annotations

import inspect
import shlex

import pytest

from hamsym.cli.catalogue import solving_command
from hamsym.cli.commands import main
from hamsym.systems import CATALOGUE, arenstorf, driven_oscillator, henon_heiles, pleiades


@pytest.mark.slow
def test_table_lists_all_systems_in_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["systems"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1 : len(CATALOGUE) + 1]] == sorted(CATALOGUE)
    assert max(map(len, lines)) <= 80
    (row,) = (line for line in lines if line.startswith("kepler "))
    assert row.split()[-3:] == ["+", "+", "3"]
    (row,) = (line for line in lines if line.startswith("henon_heiles "))
    assert row.split()[1:] == ["2", "Henon-Heiles", "-", "-", "-"]


def test_one_system_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["systems", "arenstorf", "--start", "period 11.12"]) == 0
    text = capsys.readouterr().out
    problem = arenstorf("period 11.12")
    for part in ("mu = 0.012277471", "start: period 11.12: x = 0.994", "source: Arenstorf 1963"):
        assert part in text
    assert f"period: {problem.period!r}" in text
    assert all(value in text for value in problem.reference.z)


@pytest.mark.slow_cases("arenstorf")
@pytest.mark.parametrize("make", [henon_heiles, driven_oscillator, arenstorf])
def test_shown_command_solves_the_problem(make, capsys: pytest.CaptureFixture[str]) -> None:
    command = solving_command(make())
    program, *arguments = shlex.split(command.replace("\\\n", " "))
    assert program == "hamsym"
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert out.startswith("converged: largest estimated error ")
    assert "tol 1.0e-09 met" in out


def test_shown_command_has_all_numbers() -> None:
    problem = pleiades()
    arguments = shlex.split(solving_command(problem).replace("\\\n", " "))
    (z0,) = (one.removeprefix("--z0=") for one in arguments if one.startswith("--z0="))
    assert tuple(map(float, z0.split(","))) == problem.z0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["keppler"],
            "'keppler' is not a system (did you mean 'kepler'?)",
        ),
        (["kepler", "--start", "a"], "'kepler' has one start only; leave --start out"),
        (["henon_heiles", "--start", "a"], "start='a' cannot be used; give one of 'E = 0.128"),
        (["--start", "a"], "--start needs the name of a system"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["systems", *arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("hamsym: ")
    assert message in captured.err
    assert captured.err.count("\n") == 1


@pytest.mark.slow
def test_every_system_with_starts_takes_one() -> None:
    for make in CATALOGUE.values():
        assert ("start" in inspect.signature(make).parameters) == bool(make().starts)
