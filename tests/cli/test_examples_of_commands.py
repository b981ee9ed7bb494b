"""Every example of a command runs."""

from __future__ import annotations

import shlex
from pathlib import Path

import pytest

from hamsym.cli.commands import cli, main

pytestmark = pytest.mark.page

#: Examples that train for long, or write elsewhere.
_LONG = ("reproduce", "report", "explore")
EXAMPLES = [
    example
    for name, command in cli.commands.items()
    for example in getattr(command, "examples", ())
    if name not in _LONG
]


@pytest.mark.slow_cases(
    'hamsym integrate "p**2/2 - cos(x)" --z0 1,0 --t-end 9 --meth',
    'hamsym compare "p**2/2 + x**2/2" --z0 1,0 --t-end 10 --with 0',
    'hamsym compare "p**2/2 + x**2/2" --z0 1,0 --t-end 10 --with 1',
)
@pytest.mark.parametrize("example", EXAMPLES, ids=lambda text: text[:60])
def test_examples_succeed(
    example: str, capsys: pytest.CaptureFixture[str], folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    arguments = shlex.split(example)[1:]
    status = main(arguments)
    captured = capsys.readouterr()
    # 200 epochs are a short training.
    assert status == (1 if "adam" in arguments else 0), captured.err
    assert captured.err == ""
    assert captured.out
    assert max(map(len, captured.out.splitlines())) <= 90
