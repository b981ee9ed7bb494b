"""The command `hamsym fit`: tables of data, estimates, files, and one line for invalid input."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hamsym.cli.commands import main

Captured = pytest.CaptureFixture[str]
T = np.linspace(0, 10, 41)
TRACK = "t,x\n" + "".join(
    f"{t:.6g},{1.2 * np.cos(2 * t) + noise:.9f}\n"
    for t, noise in zip(T, np.random.default_rng(0).normal(0, 0.05, 41), strict=True)
)


def run(capsys: Captured, path: Path, text: str, *options: str) -> tuple[int, str, str]:
    path.write_text(text, encoding="utf-8")
    status = main(["fit", "p**2/2 + k*x**2/2", str(path), *options])
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return status, captured.out, captured.err


@pytest.mark.slow
def test_estimates_and_files(capsys: Captured, tmp_path: Path) -> None:
    table, figure = tmp_path / "fitted.csv", tmp_path / "fitted.png"
    arguments = ["--free", "k=3.8,x=1", "--z0", "p=0", "--sigma", "x=0.05"]
    files = ["-o", str(table), "--plot", str(figure)]
    status, out, err = run(capsys, tmp_path / "d.csv", TRACK, *arguments, *files)
    assert (status, err) == (0, "")
    assert out.startswith("converged in ")
    k = float(next(line for line in out.splitlines() if line.startswith("k ")).split()[1])
    assert k == pytest.approx(4.0, abs=0.05)
    columns = np.genfromtxt(table, delimiter=",", names=True)
    np.testing.assert_allclose(columns["x"], columns["model_x"] + columns["residual_x"])
    assert figure.stat().st_size > 1000


def test_missing_cells_formulas_and_bounds(capsys: Captured, tmp_path: Path) -> None:
    rows = TRACK.replace("t,x", "t,x*cos(t)/cos(t)").splitlines()
    rows[5] = rows[5].split(",")[0] + ","
    arguments = ["--free", "k=3.8,x=1", "--z0", "p=0", "--bounds", "k=0:3.9,x=:5", "--t-end", "12"]
    status, out, _ = run(capsys, tmp_path / "d.csv", "\n".join(rows), *arguments)
    assert status == 1
    assert "k is at its bound 3.9" in out
    assert "38 degrees of freedom" in out


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("x\n1\n", [], "has no column t"),
        ("t,x\n", [], "has no data"),
        ("", [], "has no data"),
        ("t,x,x\n1,2,3\n", [], "column 3 of"),
        ("t,x\n1,2,3\n", [], "row 2 of"),
        ("t,x\n1,a\n", [], "'a' in row 2"),
        (TRACK, ["--sigma", "0"], "sigma is not above 0"),
        (TRACK, ["--bounds", "k=3"], "is not NAME=LOW:HIGH"),
        (TRACK, ["--z0", "k=3"], "'k' in z0 is unknown"),
        (TRACK, ["--t-end", "5"], "outside the span"),
        (TRACK.replace("t,x", "t,y"), [], "'y' does not occur in H"),
    ],
)
def test_invalid_input_is_one_line(
    capsys: Captured, tmp_path: Path, text: str, options: list[str], message: str
) -> None:
    arguments = ["--free", "k=3.8,x=1,p=0", *options]
    status, out, err = run(capsys, tmp_path / "d.csv", text, *arguments)
    assert (status, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1


def test_files_that_are_no_tables_are_one_line(capsys: Captured, tmp_path: Path) -> None:
    path = tmp_path / "d.csv"
    path.write_bytes(b"t,x\n\xff\xfe\x00")
    assert main(["fit", "p**2/2 + x**2/2", str(path), "--free", "x=1"]) == 2
    assert "is not a .csv file" in capsys.readouterr().err
    assert main(["fit", "p**2/2 + x**2/2", str(tmp_path / "none.csv"), "--free", "x=1"]) == 2
    assert "No such file" in capsys.readouterr().err
