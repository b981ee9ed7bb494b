"""The command orbit."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.test_commands import Captured, run

PENDULUM = ["p**2/2 - cos(x)", "--z0", "x=2,p=0"]


def test_orbit_is_printed_with_its_stability(capsys: Captured) -> None:
    status, out, _ = run(capsys, "orbit", *PENDULUM, "--symmetry", "p=-p")
    assert status == 0
    # 4 K(sin(1)^2)
    assert "period 8.34975292691" in out
    assert "stability: parabolic" in out


@pytest.mark.slow
def test_orbit_with_family_proof_and_figure(capsys: Captured, tmp_path: Path) -> None:
    figure = str(tmp_path / "family.png")
    options = ["--energy", "0.4", "--to-energy", "0.5", "--prove", "--plot", figure]
    status, out, _ = run(capsys, "orbit", *PENDULUM, *options)
    assert status == 0
    assert "energy 0.5 reached" in out
    assert "has a periodic orbit of energy 0.4" in " ".join(out.split())
    assert Path(figure).stat().st_size > 10_000
    *lines, wrote = out.splitlines()
    assert wrote == f"wrote {figure}"
    assert max(map(len, lines)) <= 80


def test_driven_orbit_takes_a_period(capsys: Captured) -> None:
    H = "p**2/2 + x**2/2 - x*cos(w*t)"
    options = ["--param", "w=2", "--z0", "-0.3,0", "--period", "2*pi/w"]
    status, out, _ = run(capsys, "orbit", H, *options)
    assert status == 0
    assert " -0.333333333333333" in next(li for li in out.splitlines() if li.startswith("x "))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--symmetry", "x"], "not NAME=VALUE"),
        (["--symmetry", "x=y"], "not a component"),
        (["--energy", "0.4", "--period", "8"], "not both"),
        (["--near", "-1"], "period of the guess"),
        (["--plot", "nowhere/orbit.png"], "does not exist"),
    ],
)
def test_bad_input_is_refused_in_one_line(
    capsys: Captured, options: list[str], message: str
) -> None:
    status, out, err = run(capsys, "orbit", *PENDULUM, *options)
    assert status == 2
    assert message in err
    assert (out, err.count("\n")) == ("", 1)


def test_failed_search_exits_with_1(capsys: Captured) -> None:
    status, out, _ = run(capsys, "orbit", *PENDULUM, "--near", "8", "--energy", "1.5")
    assert status == 1
    assert "converged" not in out
