"""Drifts of known invariants: what allowed errors explain, and what they do not."""

from __future__ import annotations

import numpy as np
import pytest
import sympy

from hamsym import Hamiltonian
from hamsym.errors import InputError
from hamsym.problems.conservation import KnownInvariants

KEPLER = "(p_x**2 + p_y**2)/2 - k/sqrt(x**2 + y**2)"
MOMENTUM = "x*p_y - y*p_x"
START = np.array([[1.0, 0.0, 0.1, 1.2]])
RUNGE = f"p_y*({MOMENTUM}) - k*x/sqrt(x**2 + y**2)"


def kepler(k: float = 1.0) -> Hamiltonian:
    return Hamiltonian(KEPLER, parameters={"k": k})


def test_errors_within_the_allowed_ones_are_explained() -> None:
    random = np.random.default_rng(1)
    known = KnownInvariants(kepler(), [MOMENTUM, RUNGE, f"({MOMENTUM})**2"])
    for size in (1e-10, 1e-6, 1e-2):
        allowed = size * random.uniform(0.2, 1, 4)
        signs = random.choice([-1.0, 1.0], (200, 4))
        change, explained = known.drifts(START, 0.0, START + signs * allowed, 0.0, allowed)
        assert (change <= explained * (1 + size)).all()
        # The bound is attained by the worst signs.
        assert (change.max(axis=1) > 0.9 * explained[:, 0]).all()
        assert known.verdict(change, explained * (1 + size)) == ""


def test_larger_errors_are_not_explained() -> None:
    known = KnownInvariants(kepler(), [MOMENTUM])
    allowed = 1e-6 * np.ones(4)
    change, explained = known.drifts(START, 0.0, START + 3e-6 * np.eye(4)[3], 0.0, allowed)
    assert MOMENTUM in known.verdict(change, explained / 2)
    for step in (1e-4, -1e-4):
        far = START + step * np.eye(4)[3]
        assert "changes by 1.0e-04" in known.verdict(*known.drifts(START, 0.0, far, 0.0, allowed))


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_states_that_are_not_finite_are_refused(value: float) -> None:
    known = KnownInvariants(kepler(), [MOMENTUM])
    change, explained = known.drifts(START, 0.0, np.full((2, 4), value), 0.0, np.ones(4))
    assert known.verdict(change, explained) != ""
    assert known.largest(change) == {MOMENTUM: np.inf}


def test_an_invariant_without_gradient_is_explained_to_second_order() -> None:
    # At a state of rest at the origin every quadratic invariant has gradient zero.
    H = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2")
    known = KnownInvariants(H, ["x**2 + p_x**2"])
    change, explained = known.drifts(
        np.zeros((1, 4)), 0.0, 1e-5 * np.ones((1, 4)), 0.0, np.full(4, 1e-5)
    )
    # The slopes at the state explain 4e-10, the curvature 2e-10.
    assert change[0, 0] == pytest.approx(2e-10)
    assert explained[0, 0] == pytest.approx(6e-10)


def test_parameters_of_each_row_are_used() -> None:
    known = KnownInvariants(kepler(), [RUNGE], ["k"])
    states, values = np.repeat(START, 2, axis=0), np.array([[1.0], [3.0]])
    change, _ = known.drifts(states, 0.0, states, 0.0, np.zeros(4), values)
    assert (change == 0).all()
    one = known.drifts(START, 0.0, 1.01 * START, 0.0, np.zeros(4), values[1:])[0]
    alone = KnownInvariants(kepler(3.0), [RUNGE]).drifts(START, 0.0, 1.01 * START, 0.0, np.zeros(4))
    assert one == alone[0]


def test_time_in_an_invariant_is_used() -> None:
    H = Hamiltonian("p**2/2 + x**2/2 - x*t")
    known = KnownInvariants(H, ["(p - 1)**2 + (x - t)**2"])
    t = np.linspace(0, 5, 11)
    states = np.stack((t + np.cos(t), 1 - np.sin(t)), axis=1)  # the exact motion
    change, explained = known.drifts(states[:1], 0.0, states, t, np.zeros(2))
    assert known.verdict(change, explained) == ""


def test_values_of_parameters_count_unless_they_vary() -> None:
    H = Hamiltonian(
        "(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y + c*y**3", parameters={"c": 2.0}
    )
    (found,) = H.invariants(4)
    assert len(KnownInvariants(H, [found])) == 1
    assert len(KnownInvariants(H, found.expr)) == 1
    with pytest.raises(InputError, match="is not an invariant"):
        KnownInvariants(H, [found], ["c"])
    with pytest.raises(InputError, match="is not an invariant"):
        KnownInvariants(H.with_parameters(c=1.0), [found])


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["p_x"], "'p_x' is not an invariant"),
        ([MOMENTUM, f"{MOMENTUM} + 1e-9*x"], "1e-9"),
        ("k", "does not depend on the state"),
        (["u"], "'u' does not occur in H"),
        ([sympy.Symbol("p_y")], "'p_y' is not an invariant"),
        (3, "give a list of formulas"),
        ({"p_x": 1}, "give a list of formulas"),
    ],
)
def test_unusable_invariants_are_refused_by_name(given: object, sentence: str) -> None:
    with pytest.raises(InputError, match=sentence):
        KnownInvariants(kepler(), given)  # type: ignore[arg-type]
