"""The audit of solve: no success that is not true, no estimate that misleads."""

from __future__ import annotations

import pytest

from .judging import complaints, judged
from .systems import SYSTEMS, System

_CASES = [
    pytest.param(
        system,
        tol,
        id=f"{system.name}-{tol:.0e}",
        marks=() if tol in system.fast else pytest.mark.slow,
    )
    for system in SYSTEMS
    for tol in system.tols
]


@pytest.mark.parametrize(("system", "tol"), _CASES)
def test_success_and_estimate_are_true(system: System, tol: float) -> None:
    assert complaints(system, tol, judged(system, tol)) == []


def test_every_class_has_a_fast_case() -> None:
    kinds = {system.kind for system in SYSTEMS}
    assert {system.kind for system in SYSTEMS if system.fast} == kinds


def test_fast_and_owed_tolerances_are_solved_at() -> None:
    for system in SYSTEMS:
        listed = {*system.fast, *system.must_succeed, *system.must_refuse}
        assert listed <= set(system.tols), system.name
        assert not set(system.must_succeed) & set(system.must_refuse), system.name
        assert system.word or not system.must_refuse, system.name
