"""The option --json: one strict JSON object on standard output, also of errors."""

from __future__ import annotations

import importlib
import json
import math
import re
from pathlib import Path
from typing import Any

import pytest

import hamsym
from hamsym.cli.commands import cli, main

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
KEPLER = "(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)"
START = ["--z0", "x=1.3,p=1", "--t-end", "2"]

#: A command line of each command, in the folder of the fixture.
COMMANDS: dict[str, list[str]] = {
    "derive": [OSCILLATOR],
    "source": [OSCILLATOR, "--part", "loss"],
    "systems": ["kepler"],
    "solve": [OSCILLATOR, *START],
    "integrate": [OSCILLATOR, *START, "--tol", "1e-6"],
    "compare": [OSCILLATOR, *START, "--tol", "1e-4"],
    "fit": ["p**2/2 - g*cos(theta)", "swing.csv", "--free", "g=1.4", "--z0", "theta=0.9,p=0"],
    "lyapunov": [OSCILLATOR, "--z0", "1,0", "--t-end", "50"],
    "section": [OSCILLATOR, "--z0", "1,0", "--t-end", "20", "--at", "x = 0, p > 0"],
    "invariants": [KEPLER],
    "equilibria": ["p**2/2 - x**2/2 + x**4/4", "--box", "x=-2:2,p=-1:1"],
    "orbit": [OSCILLATOR, "--z0", "1,0"],
    "certify": ["orbit.hamsym", "-o", "second.certificate"],
    "verify": ["orbit.hamsym"],
}
#: Commands that take minutes or write pages.
WITHOUT = {"reproduce", "report", "export", "explore"}

Captured = pytest.CaptureFixture[str]


def parsed(text: str) -> Any:
    def refuse(name: str) -> None:
        raise AssertionError(f"{name} is not JSON")

    assert text.count("\n") == 1
    return json.loads(text, parse_constant=refuse)


def run(capsys: Captured, *arguments: str) -> tuple[int, Any, str]:
    status = main([*arguments, "--json"])
    captured = capsys.readouterr()
    return status, parsed(captured.out), captured.err


def test_every_command_is_tested() -> None:
    assert cli.commands.keys() - WITHOUT == COMMANDS.keys()


@pytest.mark.slow_cases("fit")
@pytest.mark.parametrize("command", COMMANDS)
def test_results_are_one_object(
    command: str, capsys: Captured, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    status, values, err = run(capsys, command, *COMMANDS[command])
    assert (status, err) == (0, "")
    assert values["success"] is True
    assert documented(command) >= values.keys()


def documented(command: str) -> set[str]:
    """Return the keys that the page lists for a command."""
    page = Path(__file__).parents[2] / "examples" / "guide" / "command_line.md"
    row = re.search(rf"^\| `{command}` \| (.*) \|$", page.read_text(encoding="utf-8"), re.MULTILINE)
    assert row is not None
    return {*re.findall(r"`(\w+)`", row[1]), "success", "files"}


def test_solution_has_numbers(capsys: Captured, tmp_path: Path) -> None:
    path = str(tmp_path / "orbit.hamsym")
    status, values, _ = run(capsys, "solve", OSCILLATOR, *START, "-o", path)
    assert status == 0
    assert values["files"] == [path]
    solution = hamsym.load(path)
    assert list(values["error"].values()) == solution.largest_error.tolist()
    assert list(values["end"].values()) == solution(2.0).tolist()
    assert values["asked"]["x"] == pytest.approx(1e-9 * solution.scale[0], rel=1e-6)
    assert values["span"] == [0, 2]


def test_failed_solution_is_an_object_with_status_1(capsys: Captured) -> None:
    status, values, _ = run(capsys, "solve", "p**2/2 - x**4/4", "--z0", "1,1", "--t-end", "5")
    assert status == 1
    assert values["success"] is False
    assert values["message"].startswith("stopped at t = 1.31103")


def test_infinite_bound_is_text(capsys: Captured) -> None:
    status, values, _ = run(capsys, "solve", KEPLER.replace("1/", "0/"), "--z0", "1,0,0,1",
                            "--t-end", "1")  # fmt: skip
    assert status == 0
    assert values["error_bound"] == "inf"
    assert float(values["error_bound"]) == math.inf


def test_crossings_are_those_of_python(capsys: Captured) -> None:
    _, values, _ = run(capsys, "section", *COMMANDS["section"])
    found = hamsym.section(OSCILLATOR, [1, 0], (0, 20), "x = 0, p > 0")
    assert values["t"] == found.t.tolist()
    assert values["z"]["p"] == found.z[:, 1].tolist()


def test_reproduced_experiments_are_one_object(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Tables of the experiments, which are progress, go to standard error."""
    for script in ("oscillator", "page"):
        module = importlib.import_module(f"hamsym.paper.{script}")
        monkeypatch.setattr(module, "main", lambda options, name=script: print(f"table of {name}"))
    status, values, err = run(capsys, "reproduce", "oscillator", "--quick", "--out", str(tmp_path))
    assert (status, err) == (0, "table of oscillator\ntable of page\n")
    assert values.pop("minutes") >= 0
    assert values == {
        "experiments": ["oscillator"],
        "folder": str(tmp_path / "quick"),
        "success": True,
    }
    assert documented("reproduce") >= values.keys()


def test_several_trajectories_have_a_verdict_each(capsys: Captured) -> None:
    arguments = [KEPLER, "--z0", "1,0,0,1", "--z0", "1,0,0,0", "--t-end", "6", "--tol", "1e-6"]
    status, values, _ = run(capsys, "integrate", *arguments)
    assert status == 1
    assert [one["success"] for one in values["trajectories"]] == [True, False]
    assert values["trajectories"][0]["error"]["x"] < 1e-6


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["derive", "p^2"], 2, "write ** for powers"),
        (["solve", OSCILLATOR], 2, "--t-end is missing"),
        (["solve", OSCILLATOR, *START, "--methd", "adam"], 2, "--methd"),
        (["solve", OSCILLATOR, *START, "--method", "adma"], 2, "did you mean 'adam'"),
        (["integral"], 2, "No such command 'integral'"),
        (["certify", "no/such/file"], 2, "no/such/file"),
        (["systems", "keppler"], 2, "did you mean 'kepler'"),
        (["fit", OSCILLATOR, "no.csv", "--free", "x=1"], 2, "no.csv"),
    ],
)
def test_errors_are_objects(
    arguments: list[str], status: int, message: str, capsys: Captured
) -> None:
    found, values, err = run(capsys, *arguments)
    assert (found, err) == (status, "")
    assert values.keys() == {"error"}
    assert message in values["error"]


def test_refused_proof_is_an_object_with_status_1(
    capsys: Captured, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    status, values, err = run(capsys, "certify", "orbit.hamsym", "--bound", "1e-30")
    assert (status, err) == (1, "")
    assert values.keys() == {"error"}


def test_warnings_stay_on_standard_error(capsys: Captured) -> None:
    arguments = [OSCILLATOR, *START[:2], "--t-end", "40", "--dt", "1/5"]
    status, values, err = run(capsys, "integrate", *arguments, "--method", "symplectic_euler")
    assert status == 0
    assert err.startswith("hamsym: warning: ")
    assert values["message"].startswith("symplectic_euler")


def test_after_two_hyphens_json_is_an_argument(capsys: Captured) -> None:
    assert main(["derive", "--", "p^2", "--json"]) == 2
    assert capsys.readouterr().err.startswith("hamsym: ")
