"""The command that finds equilibria."""

from __future__ import annotations

import pytest

from hamsym.cli.commands import main


@pytest.mark.slow
def test_complete_table_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["equilibria", "p**2/2 - cos(x)", "--box", "x=-4:4,p=-1:1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "all 3 equilibria in the box, proven"
    assert lines[2].split() == ["type", "x", "p", "energy", "linearly", "stable"]
    assert lines[3].split() == ["1", "centre", "0", "0", "-1", "yes"]


def test_undecided_boxes_give_status_one(capsys: pytest.CaptureFixture[str]) -> None:
    box = ["--box", "r=-1:1", "--box", "p=-1:1"]
    assert main(["equilibria", "p**2/2 + 1/r**2 + r", "--q", "r", "--p", "p", *box]) == 1
    assert "1/r is not smooth there" in capsys.readouterr().out


def test_guesses_are_read(capsys: pytest.CaptureFixture[str]) -> None:
    guesses = ["--guess", "x=3,p=0", "--guess", "0.1,0"]
    assert main(["equilibria", "p**2/2 - k*cos(x)", "-P", "k=4", *guesses]) == 0
    out = capsys.readouterr().out
    assert "frequencies 2 (+)" in out
    assert "2 equilibria from 2 guesses" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--box", "x=1"], "--box: 'x=1' is not NAME=LOW:HIGH"),
        (["--box", "x=0:1,x=0:1"], "'x' occurs twice"),
        (["--box", "x=0:1"], "no interval for p"),
        (["--box", "x=1:0,p=0:1"], "low < high"),
        (["--box", "x=0:1,p=0:1", "--guess", "x=0,p=0"], "give one of them"),
        (["--box", "x=0:1,p=0:1", "--max-boxes", "0"], "max_boxes=0"),
    ],
)
def test_unusable_options_are_rejected(
    options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["equilibria", "p**2/2 - cos(x)", *options]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1
