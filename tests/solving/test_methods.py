"""Methods of solution are data with checked options, and every row of their table works."""

from __future__ import annotations

import dataclasses
import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym import (
    LBFGS,
    Adam,
    Features,
    InputError,
    LevenbergMarquardt,
    NetworkChain,
    SSBroyden,
)
from hamsym.cli import solver_options
from hamsym.cli.commands import main
from hamsym.errors import KeywordError
from hamsym.problems.problem import InitialValueProblem
from hamsym.random_features.basis import DEGREE, basis_of_series
from hamsym.random_features.method import solve_by_march
from hamsym.solution.solution import Solution
from hamsym.solving.methods import METHODS, made_method, method_of, option_names
from hamsym.support.method_object import Method, documented

OSCILLATOR = "p**2/2 + x**2/2"
BRIEF: dict[str, dict[str, Any]] = {
    "adam": {"epochs": 40, "hidden": (6,)},
    "lbfgs": {"iterations": 10, "hidden": (6,)},
    "ssbroyden": {"iterations": 10, "hidden": (6,)},
    "levenberg-marquardt": {"iterations": 10, "hidden": (6,)},
}
#: Two options of each method, of which the second is its own.
TWO: dict[str, dict[str, Any]] = {
    "features": {"max_window": 0.5},
    "network-chain": {"hidden": (8, 30), "windows": 2},
    "levenberg-marquardt": {"points": 31, "restarts": 0},
    "ssbroyden": {"activation": "tanh", "iterations": 7},
    "lbfgs": {"dtype": "float32", "target_loss": 1e-6},
    "adam": {"betas": (0.8, 0.9), "noise": 0.0},
}


# -- methods as data -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", METHODS)
def test_text_of_a_method_makes_it_again(name: str) -> None:
    made = made_method(name, TWO[name])
    again = eval(repr(made), vars(hamsym) | {k.__name__: k for k in METHODS.values()})  # noqa: S307
    assert again == made
    assert hash(again) == hash(made)
    assert again.given == made.given
    assert set(made.given) == {*TWO[name]}
    assert pickle.loads(pickle.dumps(made)) == made
    assert made != made_method(name, {})
    assert repr(made_method(name, {})) == f"{METHODS[name].__name__}()"


@pytest.mark.parametrize("name", METHODS)
def test_methods_are_immutable(name: str) -> None:
    made = made_method(name, TWO[name])
    option, value = next(iter(TWO[name].items()))
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(made, option, value)
    assert dataclasses.replace(made, **TWO[name]) == made


def test_methods_of_other_classes_are_unequal() -> None:
    assert LBFGS(iterations=7) != SSBroyden(iterations=7)
    assert method_of("lbfgs") == LBFGS()


def test_options_mean_the_same_in_every_form() -> None:
    assert Adam(hidden=[8, 8]) == Adam(hidden=(8, 8)) == Adam(hidden=np.array([8, 8]))
    assert Adam(dtype=torch.float32) == Adam(dtype="float32")
    assert Adam(device=torch.device("cpu")) == Adam()


@pytest.mark.parametrize(
    ("kind", "option", "value", "message"),
    [
        (Features, "max_window", 0, "a number above 0"),
        (Features, "max_window", float("nan"), "a number above 0"),
        (NetworkChain, "windows", 1.5, "windows=1.5"),
        (NetworkChain, "train_hidden", 0, "True or False"),
        (NetworkChain, "activation", "tan", "did you mean 'tanh'"),
        (LevenbergMarquardt, "restarts", -1, "restarts=-1"),
        (LevenbergMarquardt, "patience", 0, "patience=0"),
        (LevenbergMarquardt, "hidden", (), "layer widths"),
        (SSBroyden, "dtype", "float32", "trains in float64 on the CPU"),
        (SSBroyden, "iterations", 0, "iterations=0"),
        (LBFGS, "iterations", 2.5, "iterations=2.5"),
        (LBFGS, "accuracy", float("nan"), "accuracy=nan"),
        (LBFGS, "time_limit", 0, "time_limit=0"),
        (Adam, "epochs", True, "epochs=True"),
        (Adam, "betas", (0.9, 1.0), "two numbers from 0 to below 1"),
        (Adam, "learning_rate", "fast", "learning_rate='fast'"),
    ],
)
def test_wrong_values_are_refused_when_a_method_is_made(
    kind: type[Method], option: str, value: Any, message: str
) -> None:
    with pytest.raises(InputError) as caught:
        kind(**{option: value})
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "option", "value", "call"),
    [
        ("features", "max_window", 0.5, "hamsym.Features(max_window=0.5)"),
        ("network-chain", "windows", 2, "hamsym.NetworkChain(windows=2)"),
        ("levenberg-marquardt", "points", 201, "hamsym.LevenbergMarquardt(points=201)"),
        ("ssbroyden", "iterations", 7, "hamsym.SSBroyden(iterations=7)"),
        ("lbfgs", "stages", 3, "hamsym.LBFGS(stages=3)"),
        ("adam", "epochs", 400, "hamsym.Adam(epochs=400)"),
    ],
)
def test_option_as_an_argument_is_answered_by_its_call(
    name: str, option: str, value: Any, call: str
) -> None:
    for method in (name, METHODS[name]()):
        with pytest.raises(KeywordError) as caught:
            hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=method, **{option: value})
        assert str(caught.value) == f"'{option}' is an option of a method; give method={call}"
        assert eval(call, {"hamsym": hamsym}) == METHODS[name](**{option: value})  # noqa: S307


@pytest.mark.parametrize("name", METHODS)
def test_unknown_options_are_refused_by_every_method(name: str) -> None:
    kind = METHODS[name]
    for option in ("tol", "zzz"):
        with pytest.raises(KeywordError, match=f"'{option}' is not an argument of {kind.__name__}"):
            kind(**{option: 1})
        with pytest.raises(InputError, match=f"'{option}' is not an option of method '{name}'"):
            made_method(name, {option: 1})


def test_classes_are_answered_by_a_call() -> None:
    with pytest.raises(InputError, match=r"method=Adam is a class; give hamsym.Adam\(\)"):
        hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=Adam)  # type: ignore[arg-type]


def test_options_select_no_other_method() -> None:
    assert not {*option_names(LevenbergMarquardt)} & {"windows", "max_window", "train_hidden"}
    joint = LevenbergMarquardt(points=201, iterations=3, hidden=(5,))
    solution = hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=joint)
    assert (solution.method, solution.points) == ("levenberg-marquardt", 201)
    assert solution.settings.tol == 1e-2
    brief = LevenbergMarquardt(hidden=(5,), time_limit=1e-6)  # options that a chain has too
    alone = hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=brief, tol=1e-6)
    assert alone.record.stopped == "time limit"  # of one training, without windows
    chain = hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=NetworkChain(hidden=(20, 20)), tol=1e-6)
    assert chain.method == "network-chain"
    assert len(chain.record.edges) > 2


# -- success is an error within the tolerance ------------------------------------------------------


@pytest.mark.slow_cases(
    *("None-lbfgs", "None-ssbroyden", "0.5-lbfgs", "0.5-ssbroyden", "0.5-levenberg-marquardt"),
    *("1e-06-adam", "1e-06-ssbroyden"),
)
@pytest.mark.parametrize("name", METHODS)
@pytest.mark.parametrize("tol", [None, 0.5, 1e-6])
def test_success_is_an_error_within_the_tolerance(name: str, tol: float | None) -> None:
    method = made_method(name, BRIEF.get(name, {}))
    solution = hamsym.solve(OSCILLATOR, [1, 0.3], (0, 1), method=method, tol=tol)
    assert solution.settings.tol == (method.usual_tol if tol is None else tol)
    largest = np.abs(solution(np.linspace(0, 1, 2001))).max(axis=0)
    share = solution.settings.tol / (
        1 + solution.settings.tol
    )  # so that it holds of the exact size
    np.testing.assert_allclose(solution.allowed_error, share * largest, rtol=1e-3)
    assert solution.success == bool((solution.largest_error <= solution.allowed_error).all())
    t = np.linspace(0, 1, 101)
    truth = np.stack((np.cos(t) + 0.3 * np.sin(t), 0.3 * np.cos(t) - np.sin(t)), axis=1)
    error = np.abs(solution(t) - truth).max(axis=0)
    assert not solution.success or (error <= solution.allowed_error).all()
    assert solution.success or name not in ("features", "network-chain")


def test_reached_target_is_no_success_beyond_the_tolerance() -> None:
    method = LBFGS(hidden=(6,), points=20, target_loss=1.0, iterations=200)
    solution = hamsym.solve(OSCILLATOR, [1, 0], (0, 1), method=method, tol=1e-6)
    assert solution.record.stopped == "target loss"
    assert solution.record.best_loss <= 1.0
    assert (solution.largest_error > solution.allowed_error).any()
    assert not solution.success
    assert "target loss 1.0 reached" in solution.message
    assert "tol 1.0e-06 met only until" in solution.message


def test_given_tolerance_stops_a_training() -> None:
    method = LevenbergMarquardt(hidden=(8,), points=20, stages=1)
    loose = hamsym.solve(OSCILLATOR, [1, 0], (0, 0.5), method=method, tol=0.1)
    assert loose.success
    assert loose.record.stopped == "tolerance"
    assert loose.record.iterations < method.iterations
    done = loose.record.iterations + 1
    usual = hamsym.solve(
        OSCILLATOR, [1, 0], (0, 0.5), method=dataclasses.replace(method, iterations=done)
    )
    assert usual.record.stopped == "iterations"
    assert (loose.settings.tol_given, usual.settings.tol_given) == (True, False)


# -- every row of the table ------------------------------------------------------------------------


@documented
@dataclass(frozen=True, kw_only=True, repr=False)
class Chebyshev(Features):
    """Windows of polynomials, orthonormal with their derivatives, in place of features."""

    name = "chebyshev"

    def solve(self, problem: InitialValueProblem) -> Solution:
        s = (1 - np.cos(np.linspace(0, np.pi, 200))) / 2
        series = np.eye(DEGREE + 1)[:, :20]
        values, rates = basis_of_series(0, series).columns(s)
        triangle = np.linalg.qr(np.vstack((values, rates)), mode="r")
        basis = basis_of_series(problem.seed, np.linalg.solve(triangle.T, series.T).T)
        return solve_by_march(problem, self, basis)


@pytest.fixture(params=[*METHODS, "chebyshev"])
def method(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    monkeypatch.setitem(METHODS, "chebyshev", Chebyshev)
    solver_options._solver_parameters.cache_clear()  # options of the command line
    yield request.param
    solver_options._solver_parameters.cache_clear()


@pytest.mark.slow_cases("features", "levenberg-marquardt", "adam", "lbfgs", "ssbroyden")
def test_command_line_solves_and_saves(
    method: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [
        f"--{name}={value if isinstance(value, int) else ','.join(map(str, value))}"
        for name, value in BRIEF.get(method, {}).items()
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
    settings = {name: made_method(name, BRIEF.get(name, {})) for name in METHODS}
    done = hamsym.sweep(
        "p**2/2 + x**2/2", [1, 0], (0, 1), settings, folder=tmp_path, seeds=1, workers=1
    )
    assert {name for name, found in done.solutions.items() if found} == set(METHODS)


@pytest.mark.parametrize("given", ["chebyshev", Chebyshev(max_window=2.0)])
def test_added_method_meets_its_tolerance(given: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "chebyshev", Chebyshev)
    problem = hamsym.systems.pendulum()
    solution = hamsym.solve(problem.H, problem.z0, (0, 20), method=given, tol=1e-8)
    assert solution.success
    t = np.linspace(0, 20, 201)
    assert (np.abs(solution(t) - problem.exact(t)) <= 1e-8 * solution.scale).all()
