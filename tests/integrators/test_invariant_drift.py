"""Known invariants in the judgement of time stepping."""

from __future__ import annotations

import numpy as np
import pytest

import hamsym
from hamsym.errors import InputError, StepSizeWarning
from hamsym.integrators.to_tolerance import ToleranceSearch, Tolerated

KEPLER = "(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)"
MOMENTUM = "x*p_y - y*p_x"
RUNGE = f"p_y*({MOMENTUM}) - k*x/sqrt(x**2 + y**2)"
STARTS = {"x": [1.0, 1.1], "y": 0.0, "p_x": 0.0, "p_y": 1.1}


def test_drifts_of_an_ensemble_are_those_of_its_states() -> None:
    found = hamsym.integrate(
        KEPLER,
        STARTS,
        (0, 10),
        tol=1e-8,
        parameters={"k": [1.0, 1.2]},
        invariants=[MOMENTUM, RUNGE],
    )
    assert found.success.all()  # type: ignore[union-attr]
    x, y, p_x, p_y = np.moveaxis(found.z, -1, 0)
    momentum = x * p_y - y * p_x
    k = np.array([[1.0], [1.2]])
    for name, values in (
        (MOMENTUM, momentum),
        (RUNGE, p_y * momentum - k * x / np.hypot(x, y)),
    ):
        change = np.abs(values - values[:, :1]).max(axis=1)
        assert np.allclose(found.invariant_drift[name], change, rtol=1e-6, atol=1e-14)


def test_a_wrong_trajectory_fails_and_the_other_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    true = ToleranceSearch.run

    def wrong(search: ToleranceSearch, progress: bool | None) -> Tolerated:
        found = true(search, progress)
        found.z[1, 50:, 3] *= 1 + 1e-5
        return found

    monkeypatch.setattr(ToleranceSearch, "run", wrong)
    options = {"tol": 1e-8, "parameters": {"k": 1.0}}
    assert hamsym.integrate(KEPLER, STARTS, (0, 10), **options).success.all()  # type: ignore[arg-type, union-attr]
    found = hamsym.integrate(KEPLER, STARTS, (0, 10), invariants=[MOMENTUM], **options)  # type: ignore[arg-type]
    assert found.success.tolist() == [True, False]  # type: ignore[union-attr]
    assert f"the invariant {MOMENTUM} changes by" in found.messages[1]


def test_a_drift_with_given_steps_is_a_warning() -> None:
    # The method turns the ellipse: the Runge-Lenz vector drifts while H hardly does.
    arguments = ([1.0, 0.0, 0.0, 0.8], (0, 200), "stormer_verlet")
    H = hamsym.Hamiltonian(KEPLER, parameters={"k": 1.0})
    with pytest.warns(StepSizeWarning, match="changes by more than errors of 1 % explain"):
        found = hamsym.integrate(H, *arguments, steps=2_000, invariants=[RUNGE])
    assert found.drift < 0.01
    assert found.success
    (drift,) = found.invariant_drift.values()
    assert isinstance(drift, float)


def test_false_invariants_are_refused() -> None:
    with pytest.raises(InputError, match="'p_x' is not an invariant"):
        hamsym.integrate(KEPLER, STARTS, (0, 1), parameters={"k": 1.0}, invariants=["p_x"])
    cubic = "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y + c*y**3"
    own = hamsym.Hamiltonian(cubic, parameters={"c": 2.0}).invariants(4)
    for values in ({"c": 2.0}, {"c": [2.0, 3.0]}):
        with pytest.raises(InputError, match="is not an invariant"):
            hamsym.integrate(cubic, [0.1] * 4, (0, 1), parameters=values, invariants=own)
