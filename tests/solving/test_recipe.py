"""Lines of Python that compute a solution again give it to the last bit."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import sympy
import torch

import hamsym
from hamsym import Hamiltonian
from hamsym.solution.digest import digest
from hamsym.solving.recipe import omissions, python_lines

CASES: dict[str, tuple[Any, Any, tuple[float, float], dict[str, Any]]] = {
    "defaults": ("p**2/2 + x**4/4", [1 / 3, -0.1], (0, 1), {}),
    "backwards": ("p**2/2 + x**4/4", [1, 0], (2, -0.1), {"tol": 1e-6, "seed": 5}),
    "leading minus": ("-x*p", [-1e-3, -0.1], (0.1, 0.3), {}),
    "own pairs": (
        Hamiltonian("b**2/2 + a**2/2 + c**2 + d**2", q=["d", "a"], p=["c", "b"]),
        [1, 2, 3, 4],
        (0, 0.5),
        {"atol": [0, 1e-9, 0, 0], "breakpoints": [0.1, 0.2]},
    ),
    "units": (
        Hamiltonian(
            "p**2/(2*m) + k*x**2/2",
            parameters={"m": 9.1e-31, "k": 1e-10},
            units={"x": "m", "p": "kg*m/s", "m": "kg", "k": "N/m"},
        ),
        [1e-9, 1e-24],
        (0, 1e-10),
        {"invariants": ["p**2/(2*m) + k*x**2/2"]},
    ),
    "force": (
        Hamiltonian("p**2/2 + x**2/2", forces={"p": "-c*p + sin(t)"}, parameters={"c": 0.1}),
        [1, 0],
        (0, 1),
        {"method": hamsym.Features(max_window=0.3)},
    ),
    "many components": (
        Hamiltonian("+".join(f"p{i}**2/2 + (x{i} - x{(i + 1) % 9})**2/2" for i in range(9))),
        np.linspace(0, 1, 18),
        (0, 1),
        {},
    ),
    "network": (
        "p**2/2 + x**2/2",
        [1, 0],
        (0, 1),
        {
            "method": hamsym.Adam(
                epochs=3,
                points=8,
                hidden=(4, 3),
                betas=(0.8, 0.9),
                shared_weights=False,
                dtype=torch.float32,
            ),
            "seed": 2,
        },
    ),
    "chain": ("p**2/2 + x**2/2", [1, 0], (0, 1), {"method": hamsym.NetworkChain(windows=2)}),
}


def solved(name: str) -> hamsym.Solution:
    H, z0, span, options = CASES[name]
    return hamsym.solve(H, z0, span, **options)


@pytest.mark.slow_cases("network")
@pytest.mark.parametrize("name", CASES)
def test_lines_of_python_give_the_same_solution(name: str) -> None:
    solution = solved(name)
    session: dict[str, Any] = {}
    exec(python_lines(solution), session)  # noqa: S102
    assert digest(session["solution"]) == digest(solution)
    assert session["solution"].settings == solution.settings
    assert session["H"].units == solution.H.units


def test_complete_lines_omit_nothing() -> None:
    assert omissions(solved("force")) == []


@pytest.mark.slow
def test_omissions_are_named() -> None:
    network = torch.nn.Sequential(torch.nn.Linear(1, 4), torch.nn.Tanh(), torch.nn.Linear(4, 2))
    method = hamsym.LevenbergMarquardt(iterations=2, points=3, patience=None, trial=network)
    x, p = sympy.symbols("x p")
    H = Hamiltonian(p**2 / 2 + sympy.Float("0.3", 30) * x**2)
    solution = hamsym.solve(H, [1, 0], (0, 1), method=method)
    text = " ".join(omissions(solution))
    assert "trial" in text
    assert "binary fractions" in text
