"""The program in a shell: interrupts, closed pipes, colours, width and completion."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from hamsym.cli.commands import cli, main
from hamsym.codegen.backends import BACKENDS
from hamsym.dynamics import sections
from hamsym.integrators.table import INTEGRATORS
from hamsym.networks import optimizers
from hamsym.solving.methods import METHODS
from hamsym.support import text_tables
from hamsym.systems import CATALOGUE

Captured = pytest.CaptureFixture[str]

PROGRAM = [sys.executable, "-m", "hamsym"]
OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
START = ["--z0", "1.3,1", "--t-end", "9"]


# -- interrupts, pipes, control codes --------------------------------------------------------------


@pytest.mark.parametrize("json", [False, True])
def test_ctrl_c_leaves_one_line(
    json: bool, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sections, "section", interrupted)
    arguments = ["section", OSCILLATOR, *START, "--at", "x = 0"]
    assert main([*arguments, *["--json"] * json]) == 130
    captured = capsys.readouterr()
    expected = ('{"error": "interrupted"}\n', "") if json else ("", "hamsym: interrupted\n")
    assert (captured.out, captured.err) == expected


def test_ctrl_c_prints_what_a_training_has(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    iterate = optimizers.Adam.iterate
    done = 0

    def interrupted(*arguments: object) -> tuple[float, float]:
        nonlocal done
        done += 1
        if done == 60:
            raise KeyboardInterrupt
        return iterate(*arguments)

    monkeypatch.setattr(optimizers.Adam, "iterate", interrupted)
    assert main(["solve", OSCILLATOR, *START, "--method", "adam"]) == 1
    captured = capsys.readouterr()
    assert captured.err == ""
    assert captured.out.startswith("interrupted; 59 epochs, ")
    assert "largest estimated error" in captured.out


@pytest.mark.slow_cases("arguments0", "arguments1")
@pytest.mark.parametrize("arguments", [["systems"], ["systems", "--json"], ["--help"]])
def test_closed_pipes_are_quiet(arguments: list[str]) -> None:
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as pipe:
        ended = subprocess.run(
            [*PROGRAM, *arguments], stdout=pipe, stderr=subprocess.PIPE, check=False
        )
    assert (ended.returncode, ended.stderr) == (141, b"")


def test_output_has_no_control_codes(capsys: Captured) -> None:
    for arguments in (["--help"], ["solve", "--help"], ["solve", OSCILLATOR, *START], ["derive"]):
        main(arguments)
        captured = capsys.readouterr()
        assert not re.search(r"[\x00-\x08\x0b-\x1f\x7f]", captured.out + captured.err)


@pytest.mark.slow
def test_progress_in_a_file_is_plain_lines() -> None:
    program = """
import time
from hamsym.support.progress import stepping_progress
with stepping_progress(10, True) as advance:
    time.sleep(1.1); advance(5); time.sleep(0.3); advance(5)
"""
    environment = {k: v for k, v in os.environ.items() if k != "NO_COLOR"}
    environment |= {"TERM": "xterm-256color"}
    command = [sys.executable, "-c", program]
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, check=True)
    assert ended.stdout == ""
    first, last = ended.stderr.splitlines()
    assert re.fullmatch(r"stepping: 50%, [\d.]+ s left", first)
    assert re.fullmatch(r"stepping: [\d.]+ s", last)


def test_text_is_as_wide_as_a_narrow_terminal(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(text_tables, "columns", lambda: 50)
    main(["solve", OSCILLATOR, *START])
    assert max(map(len, capsys.readouterr().out.splitlines()[:3])) <= 50


@pytest.mark.parametrize(("wide", "expected"), [(50, 50), (200, 80), (10, 40)])
def test_columns_are_those_of_the_terminal(
    wide: int, expected: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal:
        def isatty(self) -> bool:
            return True

    monkeypatch.setenv("COLUMNS", str(wide))
    with monkeypatch.context() as patched:
        patched.setattr(sys, "stdout", Terminal())
        found = text_tables.columns()
    assert found == expected
    assert text_tables.columns() == 80  # of captured output


# -- completion ------------------------------------------------------------------------------------


def offered(
    words: str, current: str, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """Return what bash would be offered after these words."""
    monkeypatch.setenv("_HAMSYM_COMPLETE", "bash_complete")
    monkeypatch.setenv("COMP_WORDS", f"{words} {current}")
    monkeypatch.setenv("COMP_CWORD", str(len(words.split())))
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    lines = capsys.readouterr().out.split()
    return [line.partition(",")[2] for line in lines]


@pytest.mark.parametrize(
    ("words", "current", "expected"),
    [
        ("hamsym", "", sorted(cli.commands)),
        ("hamsym", "so", ["solve", "source"]),
        ("hamsym systems", "ken", []),
        ("hamsym systems", "", sorted(CATALOGUE)),
        ("hamsym systems", "kep", ["kepler"]),
        ("hamsym solve H", "--targ", ["--target-loss", "--target-ell-max"]),
        ("hamsym solve H --method", "", list(METHODS)),
        ("hamsym solve H --activation", "s", ["sin", "sigmoid"]),
        ("hamsym integrate H --method", "gau", [f"gauss{n}" for n in (4, 6, 8, 10, 12)]),
        ("hamsym integrate H --method", "", [*INTEGRATORS, "yoshida4"]),
        (
            "hamsym compare H --with",
            "yoshida4,ga",
            [f"yoshida4,gauss{n}" for n in (4, 6, 8, 10, 12)],
        ),
        ("hamsym source H --backend", "", list(BACKENDS)),
        ("hamsym source H --part", "lo", ["loss"]),
        ("hamsym certify", "orb", ["orb"]),  # the shell completes files itself
    ],
)
def test_words_are_completed(
    words: str,
    current: str,
    expected: list[str],
    capsys: Captured,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert offered(words, current, capsys, monkeypatch) == expected


def completing(shell: str, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> str:
    """Return the script that completes in a shell."""
    monkeypatch.setenv("_HAMSYM_COMPLETE", f"{shell}_source")
    with pytest.raises(SystemExit) as ended:
        main([])
    assert ended.value.code == 0
    monkeypatch.delenv("_HAMSYM_COMPLETE")
    return capsys.readouterr().out


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_are_valid(
    shell: str, capsys: Captured, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    script = completing(shell, capsys, monkeypatch)
    assert f"_HAMSYM_COMPLETE={shell}_complete" in script
    program = shutil.which(shell)
    if program is None:
        pytest.skip(f"{shell} is not installed")
    path = tmp_path / "script"
    path.write_text(script)
    subprocess.run([program, "-n", str(path)], check=True)


@pytest.mark.slow
def test_bash_completes_with_the_script(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    bash = shutil.which("bash")
    if bash is None:
        pytest.skip("bash is not installed")
    (tmp_path / "script").write_text(completing("bash", capsys, monkeypatch))
    program = tmp_path / "hamsym"
    program.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m hamsym "$@"\n')
    program.chmod(0o755)
    command = """
. "$1/script"
COMP_WORDS=(hamsym systems kep); COMP_CWORD=2
_hamsym_completion hamsym
echo "${COMPREPLY[@]}"
"""
    ended = subprocess.run(
        [bash, "-c", command, "-", str(tmp_path)],
        env=os.environ | {"PATH": f"{tmp_path}:{os.environ['PATH']}"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert (ended.stdout, ended.stderr) == ("kepler\n", "")
