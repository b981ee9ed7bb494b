"""Pairs of coordinates and momenta from their names."""

from __future__ import annotations

import pytest

from hamsym.errors import VariableError
from hamsym.symbolic.pairing import find_pairs


@pytest.mark.parametrize(
    ("names", "pairs"),
    [
        ("x p", [("x", "p")]),
        ("q p", [("q", "p")]),
        ("x px", [("x", "px")]),
        ("x p_x", [("x", "p_x")]),
        ("q1 p1 q2 p2", [("q1", "p1"), ("q2", "p2")]),
        ("q_1 p_1", [("q_1", "p_1")]),
        ("q1 p_1", [("q1", "p_1")]),
        ("x1 p1 x2 p2", [("x1", "p1"), ("x2", "p2")]),
        ("x1 px1 y1 py1", [("x1", "px1"), ("y1", "py1")]),
        ("x_1 p_x1", [("x_1", "p_x1")]),
        ("x1 p1x", [("x1", "p1x")]),
        ("theta p_theta", [("theta", "p_theta")]),
        ("theta ptheta", [("theta", "ptheta")]),
        ("theta p", [("theta", "p")]),
        ("theta1 theta2 p1 p2", [("theta1", "p1"), ("theta2", "p2")]),
        ("θ p_θ", [("θ", "p_θ")]),
        ("θ p_theta", [("θ", "p_theta")]),
        ("θ p", [("θ", "p")]),
        ("φ pφ", [("φ", "pφ")]),
        ("Q P", [("Q", "P")]),
        ("x p m k omega", [("x", "p")]),
        ("x px y py z pz", [("x", "px"), ("y", "py"), ("z", "pz")]),
        ("r p_r p_phi", [("phi", "p_phi"), ("r", "p_r")]),
        ("x p_x p_c", [("x", "p_x")]),
        ("x p phi0", [("x", "p")]),
        ("x p p0", [("x", "p")]),
        ("x psi p period", [("x", "p")]),
        ("x p_x q p", [("q", "p"), ("x", "p_x")]),
        ("p10 p2 p1 q1 q10 q2", [("q1", "p1"), ("q2", "p2"), ("q10", "p10")]),
    ],
)
def test_pairs_in_natural_order(names: str, pairs: list[tuple[str, str]]) -> None:
    assert find_pairs(names.split()) == pairs


@pytest.mark.parametrize(
    ("names", "mentions"),
    [
        ("q x p", ["'p'", "q or x"]),
        ("theta phi p", ["'p'", "phi or theta"]),
        ("x px p_x", ["px", "p_x", "both"]),
        ("q1 x1 p1", ["'p1'", "q1 or x1"]),
        ("x px p", ["px", "'p'", "both"]),
        ("q1 p1 p2", ["'p2'", "no coordinate", "p1, p2, q1"]),
        ("x m", ["no pair", "m, x"]),
        ("p m", ["'p'", "no coordinate"]),
        ("", ["no pair", "no names"]),
    ],
)
def test_ambiguous_names_are_rejected(names: str, mentions: list[str]) -> None:
    with pytest.raises(VariableError) as caught:
        find_pairs(names.split())
    for mention in [*mentions, "q=[...]"]:
        assert mention in str(caught.value)
