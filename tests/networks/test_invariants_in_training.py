"""Penalties on invariants, and cyclic momenta that are exactly constant."""

from __future__ import annotations

import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import hamsym
from hamsym.errors import InputError
from hamsym.networks.method import _objective, _penalties
from hamsym.networks.objective import Objective
from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.problem import InitialValueProblem
from hamsym.solving.methods import made_method

KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
MOMENTUM = "x*p_y - y*p_x"
START = [1.0, 0.0, 0.0, 1.2]
POLAR = "p_r**2/2 + p_phi**2/(2*r**2) - 1/r"
Z0 = {"r": 1.3, "phi": 0.1, "p_r": 0.1, "p_phi": 1.1}
QUICK: dict[str, dict[str, Any]] = {
    "adam": {"epochs": 5},
    "lbfgs": {"iterations": 5},
    "ssbroyden": {"iterations": 5},
    "levenberg-marquardt": {"iterations": 5},
}


def objective(energy_weight: float, weight: float) -> Objective:
    problem = InitialValueProblem.checked(
        KEPLER, START, (0, 1), invariants=KnownInvariants(hamsym.Hamiltonian(KEPLER), [MOMENTUM])
    )
    method = hamsym.Adam(energy_weight=energy_weight, invariant_weight=weight)
    return _objective(problem.H, _penalties(problem, method), ())


@pytest.mark.parametrize("energy_weight", [0.0, 0.3])
def test_the_penalty_is_the_weighted_square_of_the_change(energy_weight: float) -> None:
    generator = torch.Generator().manual_seed(0)
    z, dz = torch.rand(2, 7, 4, generator=generator, dtype=torch.float64) + 0.5
    t = torch.linspace(0, 1, 7, dtype=torch.float64)
    plain, penalised = objective(energy_weight, 0.0), objective(energy_weight, 2.5)
    x, y, p_x, p_y = z.unbind(-1)
    change = x * p_y - y * p_x - 1.2
    expected = plain(t, z, dz) + 2.5 * change.square().mean()
    assert torch.isclose(penalised(t, z, dz), expected, rtol=1e-13)
    assert penalised.rows is not None
    rows = penalised.rows(t, z, dz)
    assert torch.isclose(rows.square().sum(-1).mean(), expected, rtol=1e-13)


def test_slopes_of_rows_are_their_derivatives() -> None:
    generator = torch.Generator().manual_seed(1)
    z, dz = torch.rand(2, 5, 4, generator=generator, dtype=torch.float64) + 0.5
    t = torch.linspace(0, 1, 5, dtype=torch.float64)
    own = objective(0.3, 2.5)
    assert own.rows is not None
    assert own.slopes is not None
    for found, which in zip(own.slopes(t, z, dz), (0, 1), strict=True):
        for k in range(5):

            def row(v: torch.Tensor, k: int = k, which: int = which) -> torch.Tensor:
                pair = [z[k : k + 1], dz[k : k + 1]]
                pair[which] = v.unsqueeze(0)
                assert own.rows is not None
                return own.rows(t[k : k + 1], *pair)[0]

            exact = torch.autograd.functional.jacobian(row, (z, dz)[which][k])
            assert torch.allclose(found[k], exact, rtol=1e-12, atol=1e-13)


@pytest.mark.slow_cases("adam", "ssbroyden", "lbfgs")
@pytest.mark.parametrize("method", QUICK)
def test_every_method_takes_the_penalty(method: str) -> None:
    options = {"hidden": (6,), "points": 10, **QUICK[method]}
    with_penalty, without = (
        hamsym.solve(
            KEPLER, START, (0, 1), method=made_method(method, own | options), invariants=[MOMENTUM]
        )
        for own in ({"invariant_weight": 4.0}, {})
    )
    assert with_penalty.history.loss[0] != without.history.loss[0]
    assert set(with_penalty.invariant_drift) == {MOMENTUM}


@pytest.mark.slow_cases("adam", "ssbroyden", "levenberg-marquardt")
@pytest.mark.parametrize("method", QUICK)
def test_cyclic_momenta_are_constant_to_the_last_bit(method: str, tmp_path: Path) -> None:
    solution = hamsym.solve(
        POLAR,
        Z0,
        (0, 2),
        method=made_method(method, {"hidden": (6,), "points": 10, **QUICK[method]}),
    )
    t = np.linspace(0, 2, 101)
    z, dz = solution.evaluate(t)
    assert (z[:, 2] == 1.1).all()
    assert (dz[:, 2] == 0).all()
    assert np.ptp(z[:, 0]) > 0
    solution.save(tmp_path / "a")
    assert (hamsym.load(tmp_path / "a")(t) == z).all()
    assert (pickle.loads(pickle.dumps(solution))(t) == z).all()
    assert (solution(torch.tensor(t)).numpy()[:, 2] == 1.1).all()


@pytest.mark.slow_cases("options0")
@pytest.mark.parametrize("options", [{"shared_weights": False}, {"envelope": "linear"}])
def test_cyclic_momenta_are_constant_in_every_layout(options: dict[str, Any]) -> None:
    solution = hamsym.solve(
        POLAR, Z0, (0, 2), method=hamsym.Adam(epochs=5, hidden=(6, 6), points=10, **options)
    )
    assert (solution(np.linspace(0, 2, 21))[:, 2] == 1.1).all()


@pytest.mark.slow_cases("adam")
@pytest.mark.parametrize("method", ["adam", "levenberg-marquardt"])
def test_cyclic_momenta_of_an_own_network_are_constant(method: str) -> None:
    module = torch.nn.Sequential(torch.nn.Linear(1, 6), torch.nn.Tanh(), torch.nn.Linear(6, 4))
    solution = hamsym.solve(
        POLAR,
        Z0,
        (0, 2),
        method=made_method(method, {"trial": module, "points": 5, **QUICK[method]}),
    )
    again = pickle.loads(pickle.dumps(solution))
    for own in (solution, again):
        assert (own(np.linspace(0, 2, 21))[:, 2] == 1.1).all()


def test_cyclic_momenta_of_a_march_are_constant() -> None:
    solution = hamsym.solve(POLAR, Z0, (0, 10))
    assert (solution(np.linspace(0, 10, 301))[:, 2] == 1.1).all()


@pytest.mark.parametrize(
    ("weight", "invariants", "sentence"),
    [
        (1.0, [], "needs invariants"),
        (-1.0, [MOMENTUM], "give 0 or more"),
        (1.0, ["p_x"], "'p_x' is not an invariant"),
    ],
)
def test_unusable_penalties_are_refused(
    weight: float, invariants: list[str], sentence: str
) -> None:
    def solve() -> None:
        method = hamsym.Adam(epochs=1, invariant_weight=weight)
        hamsym.solve(KEPLER, START, (0, 1), method=method, invariants=invariants)

    with pytest.raises(InputError, match=sentence):
        solve()
