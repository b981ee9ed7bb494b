"""Narrow features that a march steps over unless it looks for them: no success is false."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
import pytest

import hamsym

from .decoys import DECOYS, Decoy, truths

_MATTERS = 20  # change of the end by a feature, in units of the allowed error
_ACCURACY = 0.02  # of the truth, in units of the allowed error
_CHAINED = ("gauss_1e-5", "fugacity", "barrier", "sheet_of_friction")
_FAST = (  # each takes less than a second
    ("gauss_1e-5", 1e-6),
    ("doublet", 1e-6),
    ("backwards", 1e-6),
    ("pendulum_pulse", 1e-6),
    ("fugacity", 1e-6),
    ("arctangents", 1e-4),
    ("coincidence", 1e-4),
    ("force", 1e-4),
    ("pulse_of_friction", 1e-6),
    ("sheet_of_friction", 1e-4),
    ("sheet_of_friction", 1e-6),
)


def _march(H: hamsym.Hamiltonian, decoy: Decoy, tol: float) -> tuple[bool, np.ndarray]:
    solution = hamsym.solve(H, decoy.z0, decoy.span, tol=tol)
    return solution.success, solution(solution.span[1])


def _many(H: hamsym.Hamiltonian, decoy: Decoy, tol: float) -> tuple[bool, np.ndarray]:
    starts = np.array([decoy.z0, decoy.z0])
    starts[0] *= 1.1
    solution = hamsym.solve_many(H, starts, decoy.span, tol=tol)[1]
    return solution.success, solution(solution.span[1])


def _chain(H: hamsym.Hamiltonian, decoy: Decoy, tol: float) -> tuple[bool, np.ndarray]:
    solution = hamsym.solve(
        H, decoy.z0, decoy.span, tol=tol, method=hamsym.NetworkChain(time_limit=20)
    )
    return solution.success, solution(solution.span[1])


def _steps(H: hamsym.Hamiltonian, decoy: Decoy, tol: float) -> tuple[bool, np.ndarray]:
    trajectory = hamsym.integrate(H, decoy.z0, decoy.span, tol=tol)
    return bool(trajectory.success), np.asarray(trajectory.z)[-1]


_WAYS: dict[str, Callable[[hamsym.Hamiltonian, Decoy, float], tuple[bool, np.ndarray]]] = {
    "march": _march,
    "many": _many,
    "integrate": _steps,
    "chain": _chain,
}

_CASES = [
    pytest.param(
        decoy,
        tol,
        way,
        id=f"{decoy.name}-{tol:.0e}-{way}",
        marks=() if way == "march" and (decoy.name, tol) in _FAST else pytest.mark.slow,
    )
    for decoy in DECOYS
    for tol in decoy.tols
    for way in _WAYS
    if way != "chain" or decoy.name in _CHAINED
]


@pytest.mark.slow_cases(
    "coincidence-1e-04-march", "sheet_of_friction-1e-06-march", "sheet_of_friction-1e-04-march"
)
@pytest.mark.parametrize(("decoy", "tol", "way"), _CASES)
def test_success_means_the_feature_was_met(decoy: Decoy, tol: float, way: str) -> None:
    truth = truths()[decoy.name]
    H = hamsym.Hamiltonian(
        decoy.formula,
        q=decoy.q.split(),
        p=decoy.p.split(),
        parameters=decoy.parameters,
        forces=decoy.forces,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        success, end = _WAYS[way](H, decoy, tol)
    if success:
        errors = np.abs(end - truth["z"]) / (tol * np.array(truth["sizes"]))
        assert errors.max() <= 1


def test_stored_truths_are_accurate_and_matter() -> None:
    stored = truths()
    assert set(stored) == {decoy.name for decoy in DECOYS}
    for decoy in DECOYS:
        row = stored[decoy.name]
        assert row["of"] == decoy.fingerprint, decoy.name
        assert row["accuracy"] <= _ACCURACY * min(decoy.tols), decoy.name
        assert row["change"] >= _MATTERS * max(decoy.tols), decoy.name


def test_cases_of_the_fast_tests_exist() -> None:
    known = {(decoy.name, tol) for decoy in DECOYS for tol in decoy.tols}
    assert known >= set(_FAST)
    assert {decoy.name for decoy in DECOYS} >= set(_CHAINED)
