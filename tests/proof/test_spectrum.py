"""Proven kinds of eigenvalues: against closed forms, and undecided where balls allow several."""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb

from hamsym.proof.zeros.spectrum import block_spectra


def balls(matrix: object, radius: float = 0.0) -> list[list[arb]]:
    return [
        [arb(x, radius) if x else arb(0) for x in row] for row in np.asarray(matrix, float).tolist()
    ]


def gyroscopic(k: float, rate: float) -> np.ndarray:
    """p^2/2 + rate (y p_x - x p_y) - k q^2/2 in the plane."""
    H = np.eye(4)
    H[0, 0] = H[1, 1] = -k
    H[0, 3] = H[3, 0] = -rate
    H[1, 2] = H[2, 1] = rate
    return H


def test_uncoupled_oscillators_of_one_frequency_are_separate() -> None:
    found = block_spectra(balls(np.diag([1, -1, 1, -1])))
    assert [block.components for block in found] == [[0, 2], [1, 3]]
    assert [block.definite for block in found] == [1, -1]


@pytest.mark.parametrize("sign", [1, -1])
def test_definite_matrices_are_proven_so(sign: int) -> None:
    A = np.random.default_rng(0).normal(size=(6, 6))
    [found] = block_spectra(balls(sign * (A @ A.T + np.eye(6)), 1e-12))
    assert found.definite == sign
    assert not found.unstable


def test_inertia_decides_for_natural_systems() -> None:
    """Equal exponents +-2, which are not isolated: T V = -4; a saddle beside a centre."""
    T, zero = np.array([[2.0, 0.5], [0.5, 1.0]]), np.zeros((2, 2))
    for V in (-4 * np.linalg.inv(T), np.array([[0.0, 1], [1, 0]])):
        for first, second in ((V, T), (T, V)):
            H = np.block([[first, zero], [zero, second]])
            [found] = block_spectra(balls(H, 1e-14))
            assert found.natural != 0
            assert found.unstable


def test_gyroscopic_stabilisation_is_told_from_instability() -> None:
    """A charge on a hill of curvature k: stable in a field of Larmor rate^2 > k, complex below."""
    for k, rate, stable in ((1.0, 1.2, True), (1.0, 0.8, False)):
        [found] = block_spectra(balls(gyroscopic(k - rate**2, rate), 1e-13))
        assert found.eigenvalues is not None
        assert found.unstable is not stable


def test_collision_of_eigenvalues_is_undecided() -> None:
    """s^2 + a s + b = 0 for s = k^2 with a^2 = 4 b."""
    H = np.array([[0, 0, 0, 1.0], [0, 0, -1.0, 0], [0, -1.0, 1, 0], [1.0, 0, 0, 1]])
    [found] = block_spectra(balls(H, 1e-14))
    assert not found.decided
    assert not found.unstable


def test_zero_eigenvalues_are_undecided_and_saddles_beside_them_unstable() -> None:
    K = np.array([[1.0, 1.0], [1.0, 1.0]])
    H = np.block([[K, np.zeros((2, 2))], [np.zeros((2, 2)), np.eye(2)]])
    [found] = block_spectra(balls(H))
    assert not found.decided
    assert not found.unstable
    H[0, 0] = H[1, 1] = -1.0  # eigenvalues 0 and -2 of the potential
    [found] = block_spectra(balls(H))
    assert not found.decided
    assert found.unstable


def test_saddle_among_frequencies_of_other_sizes_is_unstable() -> None:
    # the smallest eigenvalue of V is negative and below the round-off of the largest
    V = np.array(
        [
            [-1.0151438161066253e-06, -38113.159764245785, 6.956095597678674e-06],
            [-38113.159764245785, 4.170458080343219e16, 191585.30445920586],
            [6.956095597678674e-06, 191585.30445920586, 0.00019951129131110762],
        ]
    )
    hessian = np.zeros((6, 6))
    hessian[:3, :3], hessian[3:, 3:] = V, np.eye(3)
    [found] = block_spectra(balls(hessian))
    assert found.unstable
    assert found.centres == 2


def test_parts_of_eigenvalues_below_the_smallest_float_are_undecided() -> None:
    """a (x p + y q) + c (x q - y p): a focus with exponents +-a +- i c."""
    a, c, zero = arb((1, -1100)), arb((1, -1060)), arb(0)
    two = [[zero, zero, a, c], [zero, zero, -c, a], [a, -c, zero, zero], [c, a, zero, zero]]
    # beside a centre, to which it is coupled
    weak = arb((1, -1090))
    three = [[zero] * 6 for _ in range(6)]
    for i, row in enumerate(two):
        for j, value in enumerate(row):
            three[i + i // 2][j + j // 2] = value
    three[2][2] = three[5][5] = 10 * c
    for i, j in ((0, 2), (1, 5)):
        three[i][j] = three[j][i] = weak
    for hessian in (two, three):
        for scale, decided in ((1, False), (arb((1, 800)), True)):
            [found] = block_spectra([[scale * value for value in row] for row in hessian])
            assert found.decided is decided
            assert found.unstable is decided
