"""Known invariants in the judgement of the members of an ensemble."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hamsym
from hamsym.errors import InputError
from hamsym.random_features.members import Batch, MemberSolver

KEPLER = "(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)"
MOMENTUM = "x*p_y - y*p_x"
STARTS = {"x": [1.0, 1.1, 1.2], "y": 0.0, "p_x": 0.0, "p_y": 1.1}
VALUES = {"k": [1.0, 1.1, 1.2]}


def test_accurate_members_are_not_changed() -> None:
    plain = hamsym.solve_many(KEPLER, STARTS, (0, 10), parameters=VALUES)
    found = hamsym.solve_many(KEPLER, STARTS, (0, 10), parameters=VALUES, invariants=[MOMENTUM])
    assert found.success.all()
    assert (found(np.linspace(0, 10, 11)) == plain(np.linspace(0, 10, 11))).all()


def test_a_wrong_member_is_solved_again(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = hamsym.solve_many(KEPLER, STARTS, (0, 10), parameters=VALUES)
    true = MemberSolver.solve

    def wrong(self: MemberSolver, *arguments: object, **options: object) -> Batch:
        batch = true(self, *arguments, **options)  # type: ignore[arg-type]
        states = batch.states.copy()
        first = int(batch.counts[0]) + 1
        states[first + 4 : first + int(batch.counts[1]) + 1, 3] *= 1 + 1e-6
        return replace(batch, states=states)

    monkeypatch.setattr(MemberSolver, "solve", wrong)
    t = np.linspace(0, 10, 11)
    unchecked = hamsym.solve_many(KEPLER, STARTS, (0, 10), parameters=VALUES)
    assert not np.allclose(unchecked(t)[1], plain(t)[1], rtol=1e-8)
    found = hamsym.solve_many(KEPLER, STARTS, (0, 10), parameters=VALUES, invariants=[MOMENTUM])
    assert found.success.all()
    assert np.allclose(found(t), plain(t), rtol=0, atol=1e-8)
    assert (found(t)[[0, 2]] == plain(t)[[0, 2]]).all()


def test_unusable_arguments_are_refused(tmp_path: object) -> None:
    with pytest.raises(InputError, match="'p_x' is not an invariant"):
        hamsym.solve_many(KEPLER, STARTS, (0, 1), parameters=VALUES, invariants=["p_x"])
    with pytest.raises(InputError, match="leave out store and client"):
        hamsym.solve_many(
            KEPLER, STARTS, (0, 1), parameters=VALUES, invariants=[MOMENTUM], store=f"{tmp_path}/a"
        )
