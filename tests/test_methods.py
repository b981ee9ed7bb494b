"""Every row of the table of methods works everywhere; so does a row that is added to it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import hamsym
from hamsym.cli import solver_options
from hamsym.cli.commands import main
from hamsym.methods import METHODS, Method
from hamsym.problem import InitialValueProblem
from hamsym.random_features.basis import DEGREE, basis_of_series
from hamsym.random_features.method import solve_by_march
from hamsym.random_features.options import FeatureOptions
from hamsym.solution.solution import Solution

_BRIEF = {
    "adam": {"epochs": 40, "hidden": (6,)},
    "lbfgs": {"iterations": 10, "hidden": (6,)},
    "ssbroyden": {"iterations": 10, "hidden": (6,)},
    "levenberg-marquardt": {"iterations": 10, "hidden": (6,)},
}


def _chebyshev(problem: InitialValueProblem, options: FeatureOptions) -> Solution:
    """March windows of polynomials, orthonormal with their derivatives, in place of features."""
    s = (1 - np.cos(np.linspace(0, np.pi, 200))) / 2
    series = np.eye(DEGREE + 1)[:, :20]
    values, rates = basis_of_series(0, series).columns(s)
    triangle = np.linalg.qr(np.vstack((values, rates)), mode="r")
    basis = basis_of_series(problem.seed, np.linalg.solve(triangle.T, series.T).T)
    return solve_by_march(problem, options, basis, "chebyshev")


@pytest.fixture(params=[*METHODS, "chebyshev"])
def method(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    row = Method(FeatureOptions, _chebyshev, marches=True)
    monkeypatch.setitem(METHODS, "chebyshev", row)
    solver_options._solver_parameters.cache_clear()  # options of the command line
    yield request.param
    solver_options._solver_parameters.cache_clear()


@pytest.mark.slow_cases("features", "levenberg-marquardt", "adam", "lbfgs", "ssbroyden")
def test_command_line_solves_and_saves(
    method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [
        f"--{name}={value if isinstance(value, int) else ','.join(map(str, value))}"
        for name, value in _BRIEF.get(method, {}).items()
    ]
    path = tmp_path / "a.hamsym"
    arguments = ["p**2/2 + x**2/2", "--z0", "1,0", "--t-end", "1", "--method", method]
    assert main(["solve", *arguments, *options, "-o", str(path)]) in (0, 1)
    assert "ell_max" in capsys.readouterr().out
    solution = hamsym.load(path)
    assert solution.method == method
    assert np.isfinite(solution.error_estimate_check(np.linspace(0, 1, 5))).all()
    certificate = hamsym.certify(solution)
    error = np.linalg.norm(solution(1.0) - [np.cos(1.0), -np.sin(1.0)])
    assert error <= certificate.bound + 1e-15


@pytest.mark.slow
def test_sweep_runs_every_method(tmp_path: Path) -> None:
    settings = {method: {"method": method, **_BRIEF.get(method, {})} for method in METHODS}
    done = hamsym.sweep(
        "p**2/2 + x**2/2", [1, 0], (0, 1), settings, folder=tmp_path, seeds=1, workers=1
    )
    assert {name for name, found in done.solutions.items() if found} == set(METHODS)


def test_added_method_meets_its_tolerance(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "chebyshev", Method(FeatureOptions, _chebyshev, marches=True))
    problem = hamsym.systems.pendulum()
    solution = hamsym.solve(problem.H, problem.z0, (0, 20), method="chebyshev", tol=1e-8)
    assert solution.success
    t = np.linspace(0, 20, 201)
    assert (np.abs(solution(t) - problem.exact(t)) <= 1e-8 * solution.scale).all()
