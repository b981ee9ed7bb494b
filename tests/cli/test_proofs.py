"""Proofs at the command line: solve --prove, certify --bound and verify."""

from __future__ import annotations

import copy
import dataclasses
import json
from pathlib import Path

import pytest

import hamsym
from hamsym import Certificate
from hamsym.proof.windows.certificate import rounded_down
from hamsym.random_features.method import solve_by_features
from tests.cli.test_commands import Captured, run

SOLVE = ["p**2/2 + x**2/2", "--z0", "1,0", "--t-end", "3", "--tol", "1e-8"]


@pytest.fixture
def saved(capsys: Captured, tmp_path: Path) -> str:
    path = str(tmp_path / "orbit.hamsym")
    assert run(capsys, "solve", *SOLVE, "-o", path)[0] == 0
    return path


def test_solve_with_a_proof_writes_the_certificate(capsys: Captured, tmp_path: Path) -> None:
    path = str(tmp_path / "orbit.hamsym")
    status, out, _ = run(capsys, "solve", *SOLVE, "--prove", "-o", path)
    assert status == 0
    assert "proven: the error of" in " ".join(out.split())
    assert out.splitlines()[-2:] == [f"wrote {path}", f"wrote {path}.certificate"]
    certificate = Certificate.from_json(Path(f"{path}.certificate").read_text())
    assert certificate.asked == pytest.approx((1e-8, 1e-8), rel=1e-3)
    status, out, _ = run(capsys, "verify", path)
    assert status == 0
    assert out.startswith("verified: error of ")


def test_solve_with_a_proof_needs_no_file(capsys: Captured) -> None:
    status, out, _ = run(capsys, "solve", *SOLVE, "--prove")
    assert status == 0
    assert "proven" in out
    assert "wrote" not in out


def test_solve_without_a_proof_writes_no_certificate(saved: str) -> None:
    assert not Path(f"{saved}.certificate").exists()


def test_solution_that_is_not_proven_exits_with_1(
    capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    def altered(problem, method):  # type: ignore[no-untyped-def]
        solution = solve_by_features(problem, method)
        trial = copy.deepcopy(solution.trial)
        trial.readouts[3, 5, 1] += 1e-3
        return dataclasses.replace(solution, trial=trial)

    monkeypatch.setattr("hamsym.random_features.method.solve_by_features", altered)
    status, out, _ = run(capsys, "solve", *SOLVE, "--prove")
    assert status == 1
    assert "not proven: the error of" in " ".join(out.split())
    assert "converged" not in out


def test_solution_without_a_proof_is_saved_without_a_certificate(
    capsys: Captured, tmp_path: Path
) -> None:
    path = str(tmp_path / "kink.hamsym")
    arguments = ["p**2/2 + abs(x)", "--z0", "2,0", "--t-end", "1", "--prove", "-o", path]
    status, out, _ = run(capsys, "solve", *arguments)
    assert status == 1
    assert "not proven: H or its derivatives contain 'abs'" in " ".join(out.split())
    assert out.endswith(f"wrote {path}\n")
    assert not Path(f"{path}.certificate").exists()


def test_file_that_is_no_text_is_no_certificate(
    capsys: Captured, saved: str, tmp_path: Path
) -> None:
    path = tmp_path / "junk"
    path.write_bytes(bytes(range(128, 256)))
    status, out, err = run(capsys, "verify", saved, "--certificate", str(path))
    assert (status, out) == (2, "")
    assert err.endswith("junk' is not a certificate\n")


def test_certify_with_a_bound(capsys: Captured, saved: str) -> None:
    status, out, _ = run(capsys, "certify", saved, "--bound", "1e-7")
    assert status == 0
    assert "As asked" in " ".join(out.split())
    certificate = Certificate.from_json(Path(f"{saved}.certificate").read_text())
    assert certificate.asked == (1e-7, 1e-7)
    assert json.loads(certificate.to_json())["version"] == 4
    assert run(capsys, "verify", saved)[0] == 0


def test_bound_below_the_error_exits_with_1(capsys: Captured, saved: str) -> None:
    status, out, err = run(capsys, "certify", saved, "--bound", "1e-17")
    assert (status, out) == (1, "")
    assert "proven to be at least" in err
    assert err.count("\n") == 1
    assert not Path(f"{saved}.certificate").exists()


@pytest.mark.parametrize("bound", ["0", "-1", "nan", "inf", "small"])
def test_invalid_bounds_get_one_line_and_status_2(capsys: Captured, saved: str, bound: str) -> None:
    status, out, err = run(capsys, "certify", saved, f"--bound={bound}")
    assert (status, out) == (2, "")
    assert "bound" in err
    assert err.count("\n") == 1


def test_forged_certificate_exits_with_1(capsys: Captured, saved: str) -> None:
    assert run(capsys, "certify", saved)[0] == 0
    path = Path(f"{saved}.certificate")
    proven = Certificate.from_json(path.read_text())
    low = tuple(rounded_down(0.9 * value) for value in proven.component_lowers)
    forged = dataclasses.replace(
        proven, component_bounds=low, component_lowers=(0.0, 0.0), asked=low
    )
    path.write_text(forged.to_json())
    status, out, err = run(capsys, "verify", saved)
    assert (status, out) == (1, "")
    assert "its claim about" in err
    values = json.loads(proven.to_json()) | {"asked": ["1e-30", "1e-30"]}
    path.write_text(json.dumps(values))
    status, _, err = run(capsys, "verify", saved)
    assert status == 2
    assert "not a certificate" in err


@pytest.mark.slow
def test_certificate_of_a_flow_map_is_verified(capsys: Captured, tmp_path: Path) -> None:
    box = {"x": (1, 1.1), "p": (0, 0.1)}
    flow = hamsym.flow_map("p**2/2 + x**2/2", box, (0, 1), tol=1e-6)
    flow.save(tmp_path / "map.hamsym")
    path, proven = tmp_path / "map.hamsym.certificate", flow.certify()
    path.write_text(proven.to_json())
    status, out, _ = run(capsys, "verify", str(tmp_path / "map.hamsym"))
    assert status == 0
    assert out.startswith("verified: errors at most x ")
    path.write_text(dataclasses.replace(proven, bound=(1e-30, 1e-30)).to_json())
    status, out, err = run(capsys, "verify", str(tmp_path / "map.hamsym"))
    assert (status, out) == (1, "")
    assert "is not proven" in err
    path.write_text(proven.to_json().replace("e-", "e-1"))
    assert run(capsys, "verify", str(tmp_path / "map.hamsym"))[0] == 2


def test_time_limit_exits_with_1(capsys: Captured, saved: str) -> None:
    status, out, err = run(capsys, "certify", saved, "--bound", "1e-7", "--time-limit", "1e-9")
    assert (status, out) == (1, "")
    assert "time limit of 1e-09 s" in err


def test_certificate_of_another_solution_is_refused(capsys: Captured, saved: str) -> None:
    assert run(capsys, "certify", saved)[0] == 0
    path = Path(f"{saved}.certificate")
    forged = dataclasses.replace(Certificate.from_json(path.read_text()), digest="0" * 64)
    path.write_text(forged.to_json())
    status, _, err = run(capsys, "verify", saved)
    assert status == 1
    assert "does not belong" in err


def test_every_bound_of_an_orbit_is_proven_by_the_independent_checker(
    capsys: Captured, tmp_path: Path
) -> None:
    path = str(tmp_path / "orbit.hamsym")
    orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    orbit.save(path)
    orbit.certify().save(f"{path}.certificate")
    status, out, _ = run(capsys, "verify", path)
    assert (status, " ".join(out.split()[-5:])) == (0, "of the certificate is proven")
    status, out, _ = run(capsys, "verify", path, "--checker", "independent")
    assert status == 0
    assert " ".join(out.split()).endswith(
        "every bound of the certificate is proven by the independent checker"
    )
