"""Proven zeros of the gradient: enclosures are narrow whatever the box of the proof was."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym import Hamiltonian
from hamsym.proof.zeros.derivative_balls import DerivativeBalls
from hamsym.proof.zeros.roots import enclosed_root

H = Hamiltonian("(p_x**2 + p_y**2)/2 + cos(x - y) - 3*x/(2*(1 + y**2)) + atan(2*x)/2 + y**2")


@pytest.mark.parametrize("rounded", [False, True])
@pytest.mark.parametrize("size", [1.0, 4.0])
def test_the_enclosure_does_not_depend_on_the_box_in_which_it_was_proven(
    size: float, rounded: bool
) -> None:
    """The contraction from the wide box of size 4 is slower than by one half."""
    balls = DerivativeBalls(H, rounded=rounded)
    root = enclosed_root(balls, [-0.19, 0.32, 0.0, 0.0], [size] * 4)
    assert root is not None
    assert all(entry.rad() < 1e-14 for entry in root.enclosure)
    assert all(gradient.contains(0) for gradient in balls.gradient(root.enclosure))


def test_frequencies_in_a_box_are_those_of_the_hessian_at_the_equilibrium() -> None:
    found = H.equilibria(box=[(-2, 2), (-2, 2), (-1, 1), (-1, 1)])
    assert len(found) == 2
    assert found.complete
    matrix = np.kron([[0, 1], [-1, 0]], np.eye(2))
    hessian = H.compile("numpy").hessian
    for each in found:
        values = np.linalg.eigvals(matrix @ hessian(each.z))
        expected = sorted(v.imag for v in values if v.imag > 1e-9)
        np.testing.assert_allclose(each.frequencies, expected, rtol=1e-12)
