"""The command line: output, files, exit status, and one line for invalid input."""

from __future__ import annotations

import dataclasses
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import hamsym
from hamsym import Certificate, Hamiltonian
from hamsym.cli.commands import main
from hamsym.codegen.backends import BACKENDS
from hamsym.integrators import stepper
from hamsym.integrators.table import listing
from hamsym.solving.methods import METHODS, option_names

OSCILLATOR = "p**2/2 + x**2/2 + x**4/4"
HENON_HEILES = "(p_x**2+p_y**2)/2 + (x**2+y**2)/2 + x**2*y - y**3/3"
SOLVE = [OSCILLATOR, "--z0", "x=1.3,p=1", "--t-end", "pi/8", "--method", "adam", "--points", "20"]
QUICK = ["--epochs", "40", "--seed", "0"]

Captured = pytest.CaptureFixture[str]


def run(capsys: Captured, *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    assert "Traceback" not in captured.err
    return status, captured.out, captured.err


def test_rows_are_left_out_unless_all_are_asked_for(capsys: Captured) -> None:
    formula = " + ".join(f"p{i}**2/2 + q{i}**2/2" for i in range(7))
    start = ["--z0", ",".join(["1"] * 14), "--t-end", "0.1", "--tol", "1e-3"]
    status, out, _ = run(capsys, "solve", formula, *start)
    assert status == 0
    assert "and 2 components with smaller errors" in " ".join(out.split())
    assert "smaller errors" not in run(capsys, "solve", formula, *start, "--full")[1]


def test_derive_shows_everything(capsys: Captured) -> None:
    status, out, err = run(capsys, "derive", HENON_HEILES)
    assert (status, err) == (0, "")
    for line in (
        "H = p_x**2/2 + p_y**2/2 + x**2/2 + y**2/2 + x**2*y - y**3/3",
        "z = (x, y, p_x, p_y)",
        "  dx/dt   = p_x",
        "  dy/dt   = p_y",
        "  dp_x/dt = -x - 2*x*y",
        "  dp_y/dt = -y - x**2 + y**2",
        "  [1 + 2*y      2*x  0  0]",
        "  [    2*x  1 - 2*y  0  0]",
        "separable: yes",
        "  T = p_x**2/2 + p_y**2/2",
        "cyclic coordinates: none",
        "sigma_min: min(1, abs(2*sqrt(x**2 + y**2) - 1))",
    ):
        assert line in out.splitlines()


@pytest.mark.slow
def test_formula_that_begins_with_a_minus_sign_follows_two_dashes(capsys: Captured) -> None:
    formula = "-cos(x) + p**2/2"
    status, out, err = run(capsys, "derive", formula)
    assert (status, out) == (2, "")
    assert err.startswith(f"hamsym: {formula!r} begins as an option does; give the options first")
    status, out, _ = run(capsys, "derive", "--", formula)
    assert status == 0
    assert out.startswith(f"H = {formula}\n")


def test_derive_with_options_and_long_output(capsys: Captured) -> None:
    _, out, _ = run(capsys, "derive", "p_r**2/2 + p_phi**2/(2*r**2) - k/r", "--param", "k=2")
    assert "cyclic coordinates: phi" in out
    assert "parameters: k = 2" in out
    assert "separable: no" in out
    _, out, _ = run(capsys, "derive", "u**2/2 + v**2", "--q", "v", "--p", "u")
    assert "dv/dt = u" in out
    long = " + ".join(f"p{i}**2/2 + q{i}**4*cos(q{i})" for i in range(1, 9))
    _, out, _ = run(capsys, "derive", long)
    assert max(map(len, out.splitlines())) <= 80
    assert "d2H/dq1 dq1 = " in out


def test_derive_of_a_lagrangian_shows_momenta(capsys: Captured) -> None:
    text = "m*(rdot**2 + r**2*dphi**2)/2 + k/r"
    status, out, err = run(capsys, "derive", "--lagrangian", text, "-P", "m=2")
    assert (status, err) == (0, "")
    for line in (
        "L = m*(rdot**2 + dphi**2*r**2)/2 + k/r",
        "H = -k/r + p_phi**2/(2*m*r**2) + p_r**2/(2*m)",
        "  p_phi = dphi*m*r**2",
        "  p_r   = m*rdot",
        "  dphi/dt   = p_phi/(m*r**2)",
        "parameters: k, m = 2",
        "cyclic coordinates: phi",
    ):
        assert line in out.splitlines()
    names = ["--q", "a", "--velocities", "u", "--p", "w"]
    status, out, _ = run(capsys, "derive", "--lagrangian", "u**2/2 - a**2/2", *names)
    assert "H = a**2/2 + w**2/2" in out.splitlines()


@pytest.mark.parametrize(
    ("arguments", "mention"),
    [
        (["--lagrangian", "m*xdot - x"], "no term is quadratic in xdot"),
        (["--lagrangian", "m*v**2"], "no velocity such as xdot"),
        (["p**2/2 + x**2/2", "--velocities", "x"], "add --lagrangian"),
    ],
)
def test_unusable_lagrangians_end_in_one_line(
    capsys: Captured, arguments: list[str], mention: str
) -> None:
    status, out, err = run(capsys, "derive", *arguments)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert mention in err


@pytest.mark.slow_cases("arguments1", "arguments2")
@pytest.mark.parametrize(
    "arguments",
    [
        [HENON_HEILES],
        ["--lagrangian", "m*xdot**2/2 + θ*dθ*B*cos(t) + dθ**2*I_θ/2 - abs(x) - min(x, θ)/3"],
        [" + ".join(f"p{i}**2/2 + cos(q{i})*x_max" for i in range(6))],
    ],
)
def test_latex_can_be_typeset(capsys: Captured, arguments: list[str]) -> None:
    """Each side of each equation, and each entry of the matrix, by matplotlib's parser of TeX."""
    from matplotlib.mathtext import MathTextParser

    status, out, err = run(capsys, "derive", "--latex", *arguments)
    assert (status, err) == (0, "")
    assert out.isascii()
    body = re.fullmatch(r"\\begin\{align\}\n(.*)\.\n\\end\{align\}\n", out, re.DOTALL)
    assert body
    parser = MathTextParser("path")
    matrix = re.search(r"\\begin\{pmatrix\}(.*)\\end\{pmatrix\}", body[1])
    rows = body[1].replace(matrix[0], "M") if matrix else body[1]
    cells = re.split(r"\\\\|&", rows.replace(",\n", "\n")) + re.split(
        r"\\\\|&", matrix[1] if matrix else ""
    )
    assert len(cells) > 10
    for cell in filter(str.strip, cells):
        parser.parse(f"${cell.strip().replace(chr(10), ' ')}$")


def test_latex_equals_the_equations(capsys: Captured) -> None:
    _, out, _ = run(capsys, "derive", "--latex", "p_x1**2/(2*m) - cos(x1)")
    assert out.splitlines() == [
        r"\begin{align}",
        r"H(x_{1}, p_{x1}) &= \frac{p_{x1}^{2}}{2 m} - \cos{\left(x_{1} \right)}, \\",
        r"\dot{x}_{1} &= \frac{p_{x1}}{m}, \\",
        r"\dot{p}_{x1} &= - \sin{\left(x_{1} \right)}, \\",
        r"\nabla^{2} H &= \begin{pmatrix} \cos{\left(x_{1} \right)} & 0 \\"
        r" 0 & \frac{1}{m} \end{pmatrix}.",
        r"\end{align}",
    ]


def test_source_equals_that_of_the_library(capsys: Captured) -> None:
    H = Hamiltonian(OSCILLATOR)
    assert run(capsys, "source", OSCILLATOR)[1] == H.source("torch")
    _, out, _ = run(capsys, "source", OSCILLATOR, "--part", "loss")
    assert out == H.source("torch", part="loss") + "\n"
    for backend in BACKENDS:
        _, out, _ = run(capsys, "source", OSCILLATOR, "--backend", backend)
        assert out == H.source(backend)


def test_source_to_a_file(capsys: Captured, tmp_path: Path) -> None:
    path = tmp_path / "f.py"
    status, out, _ = run(capsys, "source", OSCILLATOR, "-o", str(path))
    assert (status, out) == (0, f"wrote {path}\n")
    assert path.read_text() == Hamiltonian(OSCILLATOR).source("torch")
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_solve_reports_and_draws(capsys: Captured, tmp_path: Path) -> None:
    figure = tmp_path / "s.png"
    status, out, err = run(capsys, "solve", *SOLVE, *QUICK, "--plot", str(figure), "--full")
    assert status == 1
    assert err == ""
    assert out.startswith("tol 1.0e-02 met only until t = ")
    assert "40 epochs, loss" in " ".join(out.split())
    assert "ell_max" in out
    assert "bound ell_max/sigma_min" in out
    assert "ms of CPU per epoch" in out
    assert figure.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.slow
def test_solve_exits_with_success(capsys: Captured) -> None:
    settings = ["--epochs", "600", "--tau", "1/4", "--noise", "0", "--schedule", "cosine"]
    settings += ["--learning-rate", "0.02"]
    status, out, _ = run(capsys, "solve", *SOLVE, *settings, "--hidden", "20,20")
    assert status == 0, out
    first, second = out.splitlines()[:2]
    assert first.startswith("converged: largest estimated error ")
    assert second.startswith("tol 1.0e-02 met: 600 epochs, loss ")


@pytest.mark.slow
def test_solve_by_least_squares_saves(capsys: Captured, tmp_path: Path) -> None:
    saved = str(tmp_path / "s.hamsym")
    settings = ["--method", "levenberg-marquardt", "--hidden", "10,10", "--points", "40"]
    settings += ["--tol", "1e-2", "-o", saved]
    status, out, err = run(capsys, "solve", *SOLVE, *settings)
    assert (status, err) == (0, "")
    assert out.startswith("converged: largest estimated error ")
    assert out.splitlines()[1].startswith("tol 1.0e-02 met: ")
    assert f"wrote {saved}" in out
    solution = hamsym.load(saved)
    assert solution.relative_error <= 1e-2


def test_solve_with_breakpoints(capsys: Captured) -> None:
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "1", "--breakpoints", "1/4,0.5"]
    status, out, _ = run(capsys, "solve", *arguments)
    assert status == 0, out


@pytest.mark.slow
def test_solve_to_a_tolerance(capsys: Captured, tmp_path: Path) -> None:
    arguments = [OSCILLATOR, "--z0", "x=1.3,p=1", "--t-end", "4*pi", "--tol", "1e-9"]
    figure = tmp_path / "s.pdf"
    status, out, err = run(capsys, "solve", *arguments, "--plot", str(figure))
    assert (status, err) == (0, "")
    assert out.startswith("converged: largest estimated error ")
    assert "% of the 2.0e-09 asked" in out.splitlines()[0]
    assert out.splitlines()[1].startswith("tol 1.0e-09 met: ")
    assert figure.read_bytes()[:4] == b"%PDF"
    status, out, _ = run(capsys, "solve", "p**2/2 - x**4/4", "--z0", "1,1", "--t-end", "5")
    assert status == 1
    assert out.startswith("stopped at t = 1.31103: ")


@pytest.mark.slow
def test_compare_prints_the_table(capsys: Captured, tmp_path: Path) -> None:
    figure = tmp_path / "c.svg"
    status, out, _ = run(capsys, "compare", *SOLVE, *QUICK, "--plot", str(figure))
    assert status == 1
    assert re.search(r"stormer_verlet +2,000 +2,000 ", out)
    assert "for the network's error" in out
    assert max(map(len, out.splitlines()[:-1])) <= 80
    assert b"<svg" in figure.read_bytes()


@pytest.mark.slow
def test_compare_with_any_integrators(capsys: Captured) -> None:
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "2", "--tol", "1e-4"]
    status, out, _ = run(capsys, "compare", *arguments, "--with", "yoshida4,usual")
    assert status == 0
    for name in ("forest_ruth", "stormer_verlet", "blanes_moan6", "dop853"):
        assert out.count(name) == 4
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.parametrize("method", ["symplectic_euler", "dop853"])
def test_integrate_prints_ends_and_writes_states(
    capsys: Captured, tmp_path: Path, method: str
) -> None:
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "pi/2", "--method", method]
    for ending in ("csv", "npz"):
        path = tmp_path / f"states.{ending}"
        status, out, _ = run(
            capsys, "integrate", *arguments, "--steps", "100", "--save-every", "10", "-o", str(path)
        )
        assert status == 0
        assert "energy error" in out
        if ending == "csv":
            assert path.read_text().splitlines()[0] == "t,x,p,H"
            table = np.loadtxt(path, delimiter=",", skiprows=1)
        else:
            stored = np.load(path)
            table = np.column_stack((stored["t"], stored["z"], stored["energy"]))
        assert table.shape == (11, 4)
        assert table[0].tolist() == [0.0, 1.3, 1.0, pytest.approx(2.059025, rel=1e-14)]


def test_integrate_chooses_method_and_steps(capsys: Captured) -> None:
    arguments = ["integrate", OSCILLATOR, "--z0", "1.3,1", "--t-end", "4*pi"]
    status, out, err = run(capsys, *arguments)
    assert (status, err) == (0, "")
    assert out.startswith("blanes_moan6: 1,000 steps to t = 12.5664, H kept to ")
    change = next(line for line in out.splitlines() if line.startswith("energy error "))
    assert float(change.split()[2].rstrip(",")) < 1e-9


def test_integrate_to_a_tolerance(capsys: Captured, tmp_path: Path) -> None:
    path = tmp_path / "states.npz"
    kepler = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
    arguments = [kepler, "--z0", "1,0,0,1", "--t-end", "2*pi", "--tol", "1e-9", "--saves", "1"]
    status, out, err = run(capsys, "integrate", *arguments, "-o", str(path))
    assert (status, err) == (0, "")
    assert "estimated error" in out
    stored = np.load(path)
    np.testing.assert_allclose(stored["z"], [[1, 0, 0, 1]] * 2, atol=1e-9)
    assert stored["errors"].shape == (2, 4)
    status, out, _ = run(capsys, "integrate", *arguments, "--z0", "1,0,0,0", "-o", str(path))
    assert status == 1  # the second falls to the centre
    assert out.startswith("1 of 2 trajectories failed, number 1 first")
    assert np.load(path)["success"].tolist() == [True, False]
    status, _, err = run(capsys, "integrate", *arguments, "--steps", "9")
    assert status == 2
    assert "steps and tol exclude each other" in err


@pytest.mark.parametrize(("command", "expected"), [("integrate", 0), ("section", 1)])
def test_energy_drift_warns_and_a_section_is_refused(
    capsys: Captured, command: str, expected: int
) -> None:
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "40", "--dt", "1/5"]
    arguments += ["--method", "symplectic_euler"] + ["--at", "x = 0"] * (command == "section")
    status, out, err = run(capsys, command, *arguments)
    assert status == expected
    assert err.startswith("hamsym: warning: ")
    assert err.count("\n") == 1
    assert "of its scale: take " in err
    assert "of its scale: take " in " ".join(out.split())
    assert max(map(len, out.splitlines())) <= 80


def test_nan_energy_is_reported(capsys: Captured) -> None:
    arguments = ["p**2/2 + log(x)", "--z0", "-1,1", "--t-end", "0.5", "--steps", "100"]
    status, out, err = run(capsys, "integrate", *arguments)
    assert status == 1
    assert "energy error nan" in out
    assert "H is not finite on the trajectory: take more steps" in err


def test_integrate_lists_its_methods(capsys: Captured) -> None:
    status, out, _ = run(capsys, "integrate", "--list")
    assert status == 0
    assert out.strip() == listing()
    assert max(map(len, out.splitlines())) <= 80


@pytest.mark.slow
def test_integrate_an_ensemble(capsys: Captured, tmp_path: Path) -> None:
    path, figure = tmp_path / "many.csv", tmp_path / "many.png"
    arguments = [OSCILLATOR, "--z0", "x=1.3,p=1", "--z0", "x=0.5,p=0", "--t-end", "1"]
    arguments += ["--method", "yoshida4", "--dt", "pi/100", "--compensated"]
    status, out, _ = run(capsys, "integrate", *arguments, "-o", str(path), "--plot", str(figure))
    assert status == 0
    assert "2 trajectories, number 0 of them" in out
    assert path.read_text().splitlines()[0] == "trajectory,t,x,p,H"
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert table.shape == (2 * 33, 5)
    assert figure.read_bytes()[1:4] == b"PNG"


def test_columns_of_one_name_are_distinguished(capsys: Captured, tmp_path: Path) -> None:
    path = tmp_path / "states.csv"
    arguments = ["H**2/2 + t**2/2", "--q", "t", "--p", "H", "--z0", "1,2", "--t-end", "1"]
    assert run(capsys, "integrate", *arguments, "--steps", "4", "-o", str(path))[0] == 0
    assert path.read_text().splitlines()[0] == "t,t_,H,H_"
    assert np.loadtxt(path, delimiter=",", skiprows=1)[0].tolist() == [0.0, 1.0, 2.0, 2.5]


@pytest.mark.slow
def test_lyapunov_prints_its_statement(capsys: Captured, tmp_path: Path) -> None:
    path, figure = tmp_path / "history.csv", tmp_path / "history.png"
    arguments = [HENON_HEILES, "--z0", "0.3,-0.3,0.3,0.15", "--t-end", "1e4", "--count", "2"]
    status, out, _ = run(capsys, "lyapunov", *arguments, "-o", str(path), "--plot", str(figure))
    assert status == 0
    assert "falling like log(t)/t" in " ".join(out.split())
    assert "blanes_moan6: " in out
    assert max(map(len, out.splitlines()[:-2])) <= 80
    assert path.read_text().splitlines()[0] == "t,exponent 1,exponent 2"
    assert np.loadtxt(path, delimiter=",", skiprows=1)[-1, 0] == 1e4
    assert figure.read_bytes()[1:4] == b"PNG"


@pytest.mark.slow
def test_lyapunov_prints_indicators(capsys: Captured, tmp_path: Path) -> None:
    path, figure = tmp_path / "history.csv", tmp_path / "history.png"
    arguments = [HENON_HEILES, "--z0", "0.3,-0.3,0.3,0.15", "--t-end", "1e3", "--indicators"]
    status, out, _ = run(capsys, "lyapunov", *arguments, "-o", str(path), "--plot", str(figure))
    assert status == 0
    assert "indistinguishable from a regular one" in " ".join(out.split())
    assert ["t", "megno", "mean", "megno", "sali"] in map(str.split, out.splitlines())
    assert max(map(len, out.splitlines()[:-2])) <= 80
    assert path.read_text().splitlines()[0] == "t,megno,mean megno,sali"
    assert np.loadtxt(path, delimiter=",", skiprows=1)[-1, 0] == 1e3
    assert figure.read_bytes()[1:4] == b"PNG"
    status, out, _ = run(
        capsys, "lyapunov", *arguments, "--method", "symplectic_euler", "--dt", "1"
    )
    assert status == 1
    assert "However, the run failed" in " ".join(out.split())


@pytest.mark.slow
def test_lyapunov_of_several_starts(capsys: Captured, tmp_path: Path) -> None:
    path, figure = tmp_path / "exponents.csv", tmp_path / "exponents.png"
    arguments = [HENON_HEILES, "--z0", "0.3,-0.3,0.3,0.15", "--z0", "x=0,y=0.1,p_x=0.4,p_y=0"]
    arguments += ["--t-end", "100", "--count", "2", "-o", str(path), "--plot", str(figure)]
    status, out, _ = run(capsys, "lyapunov", *arguments)
    assert status == 0
    assert out.startswith("2 of 2 trajectories reached t = 100; their largest exponents run")
    lines = out.splitlines()
    assert max(map(len, lines[:-2])) <= 80
    assert "trajectory  exponent 1  exponent 2" in lines
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    assert path.read_text().splitlines()[0] == "x,y,p_x,p_y,exponent 1,exponent 2"
    np.testing.assert_allclose(table[:, 0], [0.3, 0.0])
    assert figure.read_bytes()[1:4] == b"PNG"
    status, out, _ = run(capsys, "lyapunov", *arguments[:3], "--z0", "0,9,0,1", "--t-end", "50")
    assert status == 1
    assert "the states overflowed" in " ".join(out.split())


@pytest.mark.slow
def test_section_of_an_ensemble(capsys: Captured, tmp_path: Path) -> None:
    path, figure = tmp_path / "section.npz", tmp_path / "section.png"
    arguments = [HENON_HEILES, "--z0", "x=0,y=-0.15,p_y=0", "--z0", "x=0,y=0.1,p_y=0"]
    arguments += ["--energy", "1/8", "--t-end", "1e4", "--dt", "0.1", "--crossings", "50"]
    arguments += ["--at", "x = 0, p_x > 0", "-o", str(path), "--plot", str(figure)]
    status, out, _ = run(capsys, "section", *arguments)
    assert status == 0
    assert out.startswith("100 crossings of x = 0, p_x > 0, blanes_moan6 with dt = 0.1")
    stored = np.load(path)
    assert stored["z"].shape == (100, 4)
    assert np.abs(stored["z"][:, 0]).max() < 1e-15
    energy = Hamiltonian(HENON_HEILES).compile("numpy").energy(stored["z"])
    np.testing.assert_allclose(energy, 1 / 8, atol=1e-10)
    assert figure.read_bytes()[1:4] == b"PNG"


@pytest.mark.slow
def test_certify_and_verify(capsys: Captured, tmp_path: Path) -> None:
    path = str(tmp_path / "orbit.hamsym")
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "3", "--tol", "1e-6", "-o", path]
    assert run(capsys, "solve", *arguments)[0] == 0
    status, out, _ = run(capsys, "certify", path)
    assert status == 0
    assert out.startswith("proven: error of ")
    assert "Proven: the largest |z^(t) - z(t)|" in out
    rows = {line.split()[0]: line.split()[1:] for line in out.splitlines() if "e-" in line}
    lower, upper = map(float, rows["|z|"])
    assert 0.98 * upper < lower < upper < 1e-6
    assert set(rows) >= {"x", "p", "H", "ell_max"}
    certificate = tmp_path / "orbit.hamsym.certificate"
    status, out, _ = run(capsys, "verify", path)
    assert status == 0
    assert out.startswith("verified: error of ")
    assert out.endswith("every bound of the certificate is proven\n")
    proven = Certificate.from_json(certificate.read_text())
    # A bound slightly below the proven one.
    forged = dataclasses.replace(proven, bound=0.99 * lower, lower=0.5 * lower)
    certificate.write_text(forged.to_json())
    status, out, err = run(capsys, "verify", path)
    assert (status, out) == (1, "")
    assert "does not hold" in err
    values = json.loads(proven.to_json()) | {"bound": "1e-30"}
    certificate.write_text(json.dumps(values))
    status, _, err = run(capsys, "verify", path)
    assert status == 2
    assert "not a certificate" in err
    certificate.write_text("{}")
    status, _, err = run(capsys, "verify", path)
    assert status == 2
    assert "not a certificate" in err


def test_refused_proof_exits_with_1(capsys: Captured, tmp_path: Path) -> None:
    path = str(tmp_path / "kink.hamsym")
    arguments = ["p**2/2 + abs(x)", "--z0", "2,0", "--t-end", "1", "-o", path]
    assert run(capsys, "solve", *arguments)[0] == 0
    status, out, err = run(capsys, "certify", path)
    assert (status, out) == (1, "")
    assert "abs" in err
    assert err.count("\n") == 1
    assert not (tmp_path / "kink.hamsym.certificate").exists()


def test_ctrl_c_prints_partial_result(capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    original, calls = stepper.Stepper._run, []

    def interrupted(self: object, *arguments: object) -> object:
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return original(self, *arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(stepper, "_PIECE_WORK", 1_000)
    monkeypatch.setattr(stepper.Stepper, "_run", interrupted)
    arguments = [OSCILLATOR, "--z0", "1.3,1", "--t-end", "10", "--steps", "5000"]
    status, out, _ = run(capsys, "integrate", *arguments, "--method", "symplectic_euler")
    assert status == 1
    assert out.startswith("stopped after t = 3: interrupted")
    assert "energy error" in out


def test_failed_integration_exits_with_1(capsys: Captured) -> None:
    arguments = ["p**2/2 - x**4/4", "--z0", "1,1", "--t-end", "5", "--steps", "1000"]
    status, out, _ = run(capsys, "integrate", *arguments)
    assert status == 1
    assert "stopped after t = " in out


BAD = [
    (["derive", "p^2"], "'^' at column 2 is not a power; write ** for powers"),
    (["derive", "x + m"], "no pair such as"),
    (["derive", "p**2", "--q", "x"], "q is given without p; give both or neither"),
    (["derive", OSCILLATOR, "--param", "k=1"], "'k' does not occur in H"),
    (["derive", "p**2 + k*x**2", "--param", "k"], "--param: 'k' is not NAME=VALUE"),
    (["derive", "p**2 + k*x**2", "--param", "k=one"], "is a variable"),
    (["derive", "p**2 + k*x**2", "-P", "k=1", "-P", "k=2"], "'k' occurs twice"),
    (["derive"], "Missing argument 'H'"),
    (["derive", OSCILLATOR, "--colour"], "--colour is not an option of derive; 'hamsym derive"),
    (
        ["section", OSCILLATOR, "--surface", "x = 0"],
        "--surface is not an option of section; give --at",
    ),
    (["section", OSCILLATOR, "--where", "x = 0"], "give --at"),
    (["solve", OSCILLATOR, "--z0", "1,1", "--tmax", "1"], "give --t-end"),
    (["solve", OSCILLATOR, "--z0", "1,1", "--t_end", "1"], "give --t-end"),
    (["solve", OSCILLATOR, "--t-end", "1"], "give a value of each component, e.g. --z0 x=1,p=0"),
    (["solve", OSCILLATOR, "--z0", "1,1"], "--t-end is missing"),
    (["solve", OSCILLATOR, "1,1"], "'1,1' is one argument too many; give it as --z0 1,1"),
    (["verify", "a.hamsym", "a.certificate"], "give it as --certificate a.certificate"),
    (["source", "p**2/2", "+ x"], "'+ x' is one argument too many; quotes keep a formula in one"),
    (["integral"], "No such command 'integral'"),
    (["source", OSCILLATOR, "--part", "lagrangian"], "'lagrangian' is not a function"),
    (["source", OSCILLATOR, "--backend", "rust"], "rust"),
    (["source", OSCILLATOR, "--backend", "c", "--part", "loss"], "'loss' is not a function"),
    (["source", OSCILLATOR, "-o", "no/such/folder/f.py"], "no/such/folder"),
    (["solve", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--epochs", "5"], "'epochs' is not"),
    (["solve", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--tol", "0"], "tol=0.0"),
    (["solve", OSCILLATOR, "--z0", "1", "--t-end", "1", "--method", "adam"], "shape"),
    (["solve", OSCILLATOR, "--z0", "x=1", "--t-end", "1", "--method", "adam"], "'p' is missing"),
    (["solve", OSCILLATOR, "--z0", "x=1,p=y", "--t-end", "1", "--method", "adam"], "'y'"),
    (["solve", OSCILLATOR, "--z0", "1,1", "--t-end", "0", "--method", "adam"], "span="),
    (["solve", OSCILLATOR, "--z0", "1,1", "--t-end", "2**", "--method", "adam"], "too early"),
    (
        ["solve", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--breakpoints", "9"],
        "breakpoint 9 is not inside the span",
    ),
    (["solve", *SOLVE, "-o", "/no/such/folder/s"], "does not exist; create it first"),
    (["solve", *SOLVE, "--method", "lbfgs", "--iterations", "0"], "iterations=0"),
    (["solve", *SOLVE, "--method", "lbfgs", "--accuracy", "-1"], "accuracy=-1.0"),
    (["solve", *SOLVE, "--method", "lbfgs", "--device", "nowhere"], "is not a device of torch"),
    (["solve", *SOLVE, "--epochs", "0"], "epochs=0"),
    (["solve", *SOLVE, "--hidden", "50,x"], "--hidden: 'x' is not a whole number"),
    (["solve", *SOLVE, "--seed", "-1"], "seed=-1"),
    (["solve", *SOLVE, "--plot", "figure.doc"], "figure.doc' has another ending"),
    (["solve", *SOLVE, "--plot", "no/such/f.png"], "does not exist; create it first"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--method", "rk4"], "'rk4'"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "-o", "x.txt"], "with .csv or"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--dt", "2"], "longer than the span"),
    (["integrate", "p**2/m", "--q", "x", "--p", "p", "--z0", "1,1", "--t-end", "1"], "m has no"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--z0", "1", "--t-end", "1"], "shape"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--dt", "0"], "dt=0.0"),
    (["integrate", "x*p", "--z0", "1,1", "--t-end", "1", "--method", "ruth3"], "not separable"),
    (["integrate", OSCILLATOR, "--z0", "1,1", "--t-end", "9", "--steps", "9" * 14], "save_every"),
    (["certify", "no/such/file"], "no/such/file"),
    (["verify", "no/such/file"], "no/such/file"),
    (["lyapunov", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--count", "3"], "count=3"),
    (
        ["lyapunov", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--count", "2", "--indicators"],
        "--count 2 has no meaning with --indicators; leave one of them out",
    ),
    (
        ["lyapunov", OSCILLATOR, *["--z0", "1,1"] * 2, "--t-end", "1", "--indicators"],
        "z0 has the shape (2, 2); give one start",
    ),
    (["lyapunov", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "-o", "h.txt"], "with .csv or"),
    (["lyapunov", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--seed", "-1"], "seed=-1"),
    (["lyapunov", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--dt", "1e-30"], "would take"),
    (["section", OSCILLATOR, "--z0", "1,1", "--t-end", "1"], "Missing option '--at'"),
    (
        ["section", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--at", "x == 0"],
        "is not an equation",
    ),
    (["section", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--at", "y = 0"], "'y' does not occ"),
    (
        ["section", OSCILLATOR, "--z0", "1", "--t-end", "1", "--at", "x = 0", "--energy", "1"],
        "--energy needs states by name",
    ),
    (
        ["section", OSCILLATOR, "--z0", "x=9", "--t-end", "1", "--at", "x = 0", "--energy", "1"],
        "no p >= 0 gives the energy 1",
    ),
    (
        ["compare", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--with", "rk4"],
        "'rk4' is not a method",
    ),
    (
        ["compare", OSCILLATOR, "--z0", "1,1", "--t-end", "1", "--method", "adam", "--tol", "1"],
        "tol=1.0",
    ),
]


def test_a_system_of_the_catalogue_takes_the_place_of_h(capsys: Captured) -> None:
    status, out, err = run(capsys, "solve", "harmonic_oscillator", "--t-end", "2")
    assert (status, err) == (0, "")
    assert out.startswith(
        "harmonic_oscillator: system of the catalogue; usual are --z0 x=1,p=0 and"
    )
    assert "\nH = p**2/2" in out
    status, out, _ = run(capsys, "solve", "harmonic_oscillator", "--t-end", "2", "--json")
    values = json.loads(out)
    assert (values["H"][:6], values["span"]) == ("p**2/2", [0.0, 2.0])
    status, out, _ = run(capsys, "integrate", "kepler", "--steps", "50")
    assert "50 steps to t = 6.28319" in out


@pytest.mark.parametrize(("arguments", "message"), BAD, ids=[" ".join(b[0])[:50] for b in BAD])
def test_bad_input_gets_one_line_and_status_2(
    capsys: Captured, arguments: list[str], message: str
) -> None:
    status, out, err = run(capsys, *arguments)
    assert status == 2
    assert out == ""
    assert err.startswith("hamsym: ")
    assert message in err
    assert err.count("\n") == 1


def test_every_option_of_solve_is_offered(capsys: Captured) -> None:
    _, out, _ = run(capsys, "solve", "--help")
    offered = {word.rstrip(",") for word in out.split() if word.startswith("--")}
    names = {name for kind in METHODS.values() for name in option_names(kind)}
    names |= {"tol", "atol", "breakpoints", "seed", "prove", "invariant"}  # of all methods
    names -= {"regularizers", "trial"}
    assert {f"--{name.replace('_', '-')}" for name in names} <= offered


def test_options_of_solve_are_passed_on(capsys: Captured, tmp_path: Path) -> None:
    """Options of every type."""
    path = tmp_path / "orbit"
    options = {"hidden": (5, 4), "tau": 0.5, "frequency": 2.0, "shared_weights": False}
    options |= {"betas": (0.8, 0.9), "points": 7, "schedule": "constant", "energy_weight": 0.25}
    options |= {"epochs": 3, "dtype": "float32"}
    arguments = (
        "--hidden 5,4 --tau 1/2 --frequency 2 --no-shared-weights --betas 0.8 0.9 --points 7"
    )
    arguments += " --schedule constant --energy-weight 1/4 --epochs 3 --dtype float32"
    state = ["--z0", "1.3,1", "--t-end", "2", "--method", "adam"]
    state += ["--output", str(path)]
    assert run(capsys, "solve", OSCILLATOR, *state, *arguments.split())[0] == 1
    alone = hamsym.solve(OSCILLATOR, [1.3, 1], (0, 2), method=hamsym.Adam(**options))
    assert hamsym.load(path).settings.options == alone.settings.options
    assert alone.record.iterations == 3


@pytest.mark.parametrize(
    ("arguments", "options"),
    [
        ("--atol 1e-3 --tol 1e-5", {"atol": 1e-3, "tol": 1e-5}),
        (
            "--atol 1e-3,1e-2 --max-window 1/8",
            {"atol": [1e-3, 1e-2], "method": hamsym.Features(max_window=0.125)},
        ),
    ],
)
def test_options_of_features_are_passed_on(
    capsys: Captured, tmp_path: Path, arguments: str, options: dict[str, object]
) -> None:
    path = tmp_path / "orbit"
    state = ["--z0", "1.3,1", "--t-end", "2"]
    assert run(capsys, "solve", OSCILLATOR, *state, *arguments.split(), "-o", str(path))[0] == 0
    expected = hamsym.solve(OSCILLATOR, [1.3, 1], (0, 2), **options)
    t = np.linspace(0, 2, 9)
    np.testing.assert_array_equal(hamsym.load(path)(t), expected(t))


@pytest.mark.parametrize(
    "command",
    "derive source solve integrate lyapunov section compare certify verify".split(),
)
def test_every_command_has_help(capsys: Captured, command: str) -> None:
    status, out, _ = run(capsys, command, "--help")
    assert status == 0
    assert out.startswith(f"Usage: hamsym {command}")
    assert max(map(len, out.splitlines())) <= 80


def test_help_without_a_command(capsys: Captured) -> None:
    status, out, _ = run(capsys)
    assert status == 0
    assert "derive" in out


def test_failed_write_leaves_nothing_behind(
    capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", "f.py")

    monkeypatch.setattr(os, "replace", full)
    status, _, err = run(capsys, "source", OSCILLATOR, "-o", str(tmp_path / "f.py"))
    assert status == 2
    assert "No space left" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_as_a_program() -> None:
    result = subprocess.run(
        [sys.executable, "-m", "hamsym", "derive", "p**2/2 + x**2/2"],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "dx/dt = p" in result.stdout


@pytest.mark.slow
def test_closed_pipe_is_not_an_error() -> None:
    command = f'"{sys.executable}" -m hamsym source "{OSCILLATOR}" | head -1'
    result = subprocess.run(command, shell=True, capture_output=True, text=True, check=True)
    assert result.stderr == ""


@pytest.mark.slow
def test_initial_weights_from_a_file(tmp_path, capsys):
    first, second = str(tmp_path / "first"), str(tmp_path / "second")
    settings = ["--method", "adam", "--hidden", "6,6", "--points", "20", "--target-loss", "1e9"]
    state = ["p**2/2 + x**2/2", "--z0", "x=1,p=0"]
    assert main(["solve", *state, "--t-end", "2", *settings, "-o", first]) == 1  # untrained
    begun = ["solve", *state, "--t-end", "3", *settings, "--initial"]
    assert main([*begun, first, "-o", second]) == 1
    one, two = hamsym.load(first), hamsym.load(second)
    assert one.trial.network.sizes == two.trial.network.sizes
    capsys.readouterr()
    assert main([*begun, first, "--hidden", "7,6"]) == 2
    assert "initial has 1-6-6-2 sin" in capsys.readouterr().err
    assert main([*begun, str(tmp_path / "none")]) == 2
    assert "none" in capsys.readouterr().err


@pytest.mark.slow
def test_closed_pipe_keeps_the_saved_solution(tmp_path: Path) -> None:
    file = tmp_path / "orbit.hamsym"
    command = [sys.executable, "-u", "-m", "hamsym", "solve", "p**2/2 + x**2/2", "--z0", "1,0"]
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb") as pipe:
        options = ["--t-end", "1", "-o", str(file)]
        ended = subprocess.run([*command, *options], stdout=pipe, check=False, timeout=60)
    assert ended.returncode != 0
    assert hamsym.load(file).success


def test_invariants_are_listed_with_those_that_depend(capsys: Captured) -> None:
    kepler = "(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)"
    status, out, err = run(capsys, "invariants", kepler, "--degree", "3")
    assert (status, err) == (0, "")
    assert out.splitlines() == [
        "     degree  independent  formula",
        "I_1       2          yes  p_x*y - p_y*x",
        "I_2       3          yes  p_x**2*y - p_x*p_y*x - y/sqrt(x**2 + y**2)",
        "I_3       3           no  p_x*p_y*y - p_y**2*x + x/sqrt(x**2 + y**2)",
        "",
        "each is proven in exact arithmetic, {f, H} = 0; others may exist beyond degree 3",
    ]
    polar = ["p_r**2/2 + p_phi**2/(2*r**2) - 1/r", "--degree", "4"]
    _, out, _ = run(capsys, "invariants", *polar, "--basis", "cos(phi)", "--basis", "sin(phi)")
    assert len(out.splitlines()) > 3


def test_no_invariant_is_said_to_prove_nothing(capsys: Captured) -> None:
    status, out, _ = run(capsys, "invariants", HENON_HEILES)
    assert status == 0
    assert "no proof of chaos" in " ".join(out.split())
    assert run(capsys, "invariants", HENON_HEILES, "--degree", "0")[0] == 2


def test_solve_prints_drifts_of_invariants(capsys: Captured) -> None:
    kepler = ["(p_x**2+p_y**2)/2 - 1/sqrt(x**2+y**2)", "--z0", "1,0,0,1", "--t-end", "2"]
    status, out, _ = run(capsys, "solve", *kepler, "--invariant", "x*p_y - y*p_x")
    assert status == 0
    assert "largest change of x*p_y - y*p_x: " in out
    status, _, err = run(capsys, "solve", *kepler, "--invariant", "p_x")
    assert status == 2
    assert "'p_x' is not an invariant" in err
