"""Known invariants are part of the judgement of a solution."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

import hamsym
from hamsym.errors import InputError
from hamsym.problems.conservation import KnownInvariants
from hamsym.solution.acceptance import judged_by_invariants

KEPLER = "(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)"
MOMENTUM = "x*p_y - y*p_x"
START = [1.0, 0.0, 0.0, 1.2]


def solved(**options: object) -> hamsym.Solution:
    return hamsym.solve(KEPLER, START, (0, 10), **options)  # type: ignore[arg-type]


@pytest.mark.parametrize("tol", [1e-4, 1e-12])
def test_an_accurate_solution_is_accepted(tol: float) -> None:
    H = hamsym.Hamiltonian(KEPLER)
    found = [own for own in H.invariants(3) if own.independent]
    solution = solved(tol=tol, invariants=[*found, MOMENTUM])
    assert solution.success
    assert solution.message == solved(tol=tol).message
    t = np.linspace(0, 10, 501)
    x, y, p_x, p_y = solution(t).T
    change = np.abs(x * p_y - y * p_x - 1.2).max()
    assert 0.9 * change <= solution.invariant_drift[MOMENTUM] + 1e-15  # the round-off of z^
    assert solution.invariant_drift[MOMENTUM] < 3 * tol
    assert len(solution.invariant_drift) == 3
    assert pickle.loads(pickle.dumps(solution)).invariant_drift == solution.invariant_drift


def test_a_drift_that_errors_do_not_explain_refuses() -> None:
    solution = solved(tol=1e-8)
    known = KnownInvariants(solution.H, [MOMENTUM])
    assert judged_by_invariants(solution, known).success
    states = solution.trial.states.copy()  # type: ignore[attr-defined]
    states[3:, 3] *= 1 + 1e-6  # a jump of p_y that the error estimate does not contain
    wrong = replace(solution, trial=replace(solution.trial, states=states))  # type: ignore[type-var]
    judged = judged_by_invariants(wrong, known)
    assert not judged.success
    assert judged.message.startswith(f"the invariant {MOMENTUM} changes by")
    assert judged.message.endswith(solution.message)
    states[3:] = np.nan
    lost = replace(solution, trial=replace(solution.trial, states=states))  # type: ignore[type-var]
    assert not judged_by_invariants(lost, known).success


def test_zero_invariants_and_functions_of_them_are_accepted() -> None:
    H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2")
    names = [MOMENTUM, f"({MOMENTUM})**2", "p_x**2 + x**2", "p_x*p_y + x*y"]
    for start in ([1, 1, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]):
        solution = hamsym.solve(H, start, (0, 10), invariants=names)
        assert solution.success, solution.message


def test_false_invariants_are_refused_before_the_work() -> None:
    with pytest.raises(InputError, match="'p_x' is not an invariant"):
        solved(invariants=["p_x"])
    with pytest.raises(
        InputError, match="'invariant_weight' is an option of a method; give method=hamsym."
    ):
        solved(invariants=[MOMENTUM], invariant_weight=1.0)
