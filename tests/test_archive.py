"""Files give back what was saved to the last bit, and say what is wrong with them."""

from __future__ import annotations

import copy
import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy
import torch

import hamsym
from hamsym import Hamiltonian, InputError
from hamsym.errors import FileError
from hamsym.systems import Problem

METHODS = {
    "features": {},
    "adam": {"epochs": 30, "points": 10, "energy_weight": 0.5},
    "lbfgs": {"iterations": 20, "points": 10, "shared_weights": False},
    "levenberg-marquardt": {"iterations": 10, "points": 20, "hidden": (8,), "activation": "tanh"},
    "float32": {"method": "adam", "epochs": 20, "points": 10, "dtype": "float32"},
}


def same_everywhere(one: hamsym.Solution, other: hamsym.Solution) -> None:
    t = np.linspace(*one.span, 301)
    for name in ("__call__", "derivative", "residual", "energy", "error_estimate"):
        np.testing.assert_array_equal(getattr(one, name)(t), getattr(other, name)(t), name)
    for name in ("H", "span", "method", "success", "message", "energy_weight", "ell_max", "points"):
        assert getattr(one, name) == getattr(other, name), name
    np.testing.assert_array_equal(one.z0, other.z0)
    np.testing.assert_array_equal(one.largest_error, other.largest_error)
    for name, value in vars(one.history).items():
        np.testing.assert_array_equal(value, getattr(other.history, name), name)


@pytest.mark.parametrize("method", METHODS)
def test_exact_to_the_last_bit(method: str, tmp_path: Path) -> None:
    problem = hamsym.systems.nonlinear_oscillator()
    settings = {"method": method, **METHODS[method]}
    solution = hamsym.solve(problem.H, problem.z0, (0.0, 2.0), **settings)
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    same_everywhere(solution, again)
    assert again.plot() is not None
    again.save(tmp_path / "b")
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_the_whole_catalogue(problem: Problem, tmp_path: Path) -> None:
    solution = hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-6)
    solution.save(tmp_path / "a")
    same_everywhere(solution, hamsym.load(tmp_path / "a"))


def test_the_users_own_symbols_and_binary_fractions(tmp_path: Path) -> None:
    x, p, k = sympy.symbols("x p k", positive=True)
    expr = p**2 / 2 + 0.1 * x**2 + k * x**4 * sympy.Float("0.3", 30) + sympy.sqrt(x)
    H = Hamiltonian(expr, q=[x], p=[p], parameters={"k": 1 / 3})
    solution = hamsym.solve(H, [1.0, 0.5], (1.0, 0.5), breakpoints=[0.7])
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    assert again.H == H
    assert again.H.parameters["k"] == 1 / 3
    same_everywhere(solution, again)


def test_a_failure_is_saved_as_one(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2/2 - x**4/4"), [1.0, 1.0], (0, 5))
    solution.save(tmp_path / "a")
    again = hamsym.load(tmp_path / "a")
    assert not again.success
    assert again.message == solution.message


def test_files_that_cannot_be_used(tmp_path: Path) -> None:
    path = tmp_path / "a"
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.load(path)
    hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1)).save(path)
    whole = path.read_bytes()
    for content in (whole[:200], b"", b"\x80\x04pickle", whole[:-8]):
        path.write_bytes(content)
        with pytest.raises(FileError, match="damaged"):
            hamsym.load(path)
    length = struct.unpack("<Q", whole[:8])[0]

    def changed(**values: object) -> None:
        header = json.loads(whole[8 : 8 + length])
        metadata = json.loads(header["__metadata__"]["hamsym"])
        header["__metadata__"]["hamsym"] = json.dumps({**metadata, **values})
        text = json.dumps(header).encode()
        path.write_bytes(struct.pack("<Q", len(text)) + text + whole[8 + length :])

    for values, message in (
        ({"version": 99}, "version 99; this hamsym reads version 1"),
        ({"kind": "checkpoint"}, "holds a checkpoint, not a solution"),
        ({"span": "long"}, "makes no sense"),
        ({"H": {"formula": "__import__('os')", "floats": {}}}, "makes no sense"),
        ({"trial": {"form": "network"}}, "makes no sense"),
        ({"H": {"formula": "p**2 + x**2", "floats": [1]}}, "makes no sense"),
    ):
        changed(**values)
        with pytest.raises(FileError, match=message):
            hamsym.load(path)


@pytest.mark.parametrize("path", [5, None, "a\0b"])
def test_paths_that_are_none(path: object) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(path)
    with pytest.raises(FileError, match="cannot be read"):
        hamsym.load(path)


def test_windows_that_do_not_fit_together(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    solution.trial.states = solution.trial.states[:, :1]
    solution.save(tmp_path / "a")
    with pytest.raises(FileError, match="do not fit together"):
        hamsym.load(tmp_path / "a")


def test_what_was_there_stays_if_writing_fails(tmp_path: Path) -> None:
    solution = hamsym.solve(Hamiltonian("p**2 + x**2"), [1, 0], (0, 1))
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(tmp_path / "no" / "folder")
    (tmp_path / "folder").mkdir()
    with pytest.raises(FileError, match="cannot be written"):
        solution.save(tmp_path / "folder")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


# -- how nearby solutions move --------------------------------------------------------------------


@pytest.mark.parametrize("name", ["henon_heiles", "kepler", "charged_particle", "double_pendulum"])
def test_sensitivity_against_finite_differences(name: str) -> None:
    problem = hamsym.systems.CATALOGUE[name]()
    span = (0.0, 5.0)
    solution = hamsym.solve(problem.H, problem.z0, span, tol=1e-11)
    t = np.array([0.0, 0.3, 2.0, 5.0])
    found = solution.sensitivity(t)
    np.testing.assert_allclose(found[0], np.eye(problem.H.dim), atol=1e-14)
    for i, unit in enumerate(np.eye(problem.H.dim)):
        h = 1e-4
        ends = [
            hamsym.solve(problem.H, solution.z0 + side * h * unit, span, tol=1e-12)(t)
            for side in (-2, -1, 1, 2)
        ]
        slope = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * h)
        np.testing.assert_allclose(found[:, :, i], slope, atol=2e-6 * np.abs(found).max())
    J = np.array(problem.H.poisson_matrix, dtype=float)
    np.testing.assert_allclose(
        found[-1].T @ J @ found[-1], J, atol=1e-7 * np.abs(found[-1]).max() ** 2
    )


def test_gradients_reach_the_initial_state() -> None:
    problem = hamsym.systems.henon_heiles()
    solution = hamsym.solve(problem.H, problem.z0, (0, 10), tol=1e-10)
    z0 = torch.tensor(problem.z0, dtype=torch.float64, requires_grad=True)
    t = torch.tensor([1.0, 7.5], dtype=torch.float64)
    z = solution(t, z0=z0)
    torch.testing.assert_close(z.detach(), solution(t))
    (gradient,) = torch.autograd.grad(z[1, 2], z0)
    np.testing.assert_allclose(gradient, solution.sensitivity(7.5)[2], rtol=1e-12)
    with pytest.raises(InputError, match="z0 is not the initial state"):
        solution(t, z0=z0 + 1)
    with pytest.raises(InputError, match="both tensors"):
        solution([1.0], z0=z0)


def test_sensitivity_of_a_trained_network() -> None:
    H = Hamiltonian("p**2/2 + x**2/2")
    solution = hamsym.solve(
        H, [1, 0], (0, 6), method="levenberg-marquardt", iterations=60, points=50, hidden=(20, 20)
    )
    t = np.linspace(0, 6, 7)
    exact = np.array([[np.cos(t), np.sin(t)], [-np.sin(t), np.cos(t)]]).transpose(2, 0, 1)
    np.testing.assert_allclose(solution.sensitivity(t), exact, atol=1e-8)


@pytest.mark.parametrize("method", ["features", "levenberg-marquardt", "adam"])
@pytest.mark.parametrize("copied", [copy.deepcopy, lambda s: pickle.loads(pickle.dumps(s))])
def test_solutions_are_copied_and_pickled(method: str, copied: Callable[[Any], Any]) -> None:
    few = {"features": {}, "levenberg-marquardt": {"iterations": 3}, "adam": {"epochs": 3}}[method]
    solution = hamsym.solve("p**2/2 - cos(x)", [1, 0], (0, 5), method=method, **few)
    again = copied(solution)
    t = np.linspace(0, 5, 101)
    np.testing.assert_array_equal(again(t), solution(t))
    np.testing.assert_array_equal(again.error_estimate(t), solution.error_estimate(t))
    assert (again.success, again.message) == (solution.success, solution.message)
    assert (again.H, again.span, again.method) == (solution.H, solution.span, method)
    assert again.evaluations == solution.evaluations


@pytest.mark.parametrize("backend", ["numpy", "torch", "numba"])
def test_generated_functions_are_pickled(backend: str) -> None:
    system = hamsym.Hamiltonian("p**2/2 - cos(x)*t").compile(backend)
    again = pickle.loads(pickle.dumps(system))
    assert again.source == system.source
    z = torch.tensor([0.3, 0.2], dtype=torch.float64)
    z = z if backend == "torch" else z.numpy()
    assert (again.vector_field(z, 2.0) == system.vector_field(z, 2.0)).all()
