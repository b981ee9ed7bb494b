"""Balls of derivatives: singular terms, rounded numbers, refusals."""

from __future__ import annotations

import math

import pytest
from flint import arb

from hamsym import Hamiltonian
from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.zeros.derivative_balls import DerivativeBalls


def test_singular_terms_spoil_only_their_components() -> None:
    balls = DerivativeBalls(
        Hamiltonian("(p_x**2 + p_y**2)/2 + y*p_x - x*p_y - 1/sqrt(x**2 + y**2)")
    )
    slopes = balls.gradient([arb(0, 1), arb(0, 1), arb(2), arb(3)])
    assert [slope.is_finite() for slope in slopes] == [False, False, True, True]
    assert slopes[2].contains(1)
    assert slopes[2].contains(3)
    assert not slopes[2].contains(0.5)


def test_rounded_numbers_cover_their_neighbours() -> None:
    H = Hamiltonian("a*x**2/2 + p**2/2", parameters={"a": 0.1})
    with working(128):
        entry = DerivativeBalls(H, rounded=True).hessian([arb(0), arb(0)])[0][0]
        for a in (math.nextafter(0.1, 0), 0.1, math.nextafter(0.1, 1)):
            assert entry.contains(arb(a))
        assert entry.rad() < 1e-16
        whole = DerivativeBalls(H.with_parameters(a=3.0), rounded=True).hessian([arb(0), arb(0)])
        assert whole[0][0].is_exact()


def test_functions_without_enclosure_are_refused() -> None:
    with pytest.raises(CertificationError, match="'abs'"):
        DerivativeBalls(Hamiltonian("p**2/2 + abs(x)"))
