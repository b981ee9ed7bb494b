"""Linear stability: against quadratic Hamiltonians with known normal forms."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from flint import arb
from scipy.linalg import expm

from hamsym.dynamics.linear_stability import DEGENERATE, LinearStability, linear_stability


def stability(hessian: np.ndarray, radius: float = 0.0) -> LinearStability:
    return linear_stability(
        [[arb(x, radius) if x else arb(0) for x in row] for row in np.asarray(hessian).tolist()]
    )


def poisson(half: int) -> np.ndarray:
    return np.kron([[0, 1], [-1, 0]], np.eye(half))


def random_symplectic(half: int, seed: int) -> np.ndarray:
    A = np.random.default_rng(seed).normal(size=(2 * half, 2 * half))
    return expm(0.3 * poisson(half) @ (A + A.T))


@pytest.mark.parametrize("seed", range(4))
def test_modes_of_a_normal_form_are_recovered(seed: int) -> None:
    """H = sum s w (Q^2 + P^2)/2 in random canonical variables."""
    frequencies, signs = np.array([0.7, 1.9, 3.1]), np.array([1, -1, 1])
    S = random_symplectic(3, seed)
    inverse = np.linalg.inv(S)
    H = inverse.T @ np.diag(np.tile(signs * frequencies, 2)) @ inverse
    H = (H + H.T) / 2
    found = stability(H, 1e-13)
    assert found.type == "centre-centre-centre"
    assert found.stable
    assert found.definite == 0
    np.testing.assert_allclose(found.frequencies, frequencies, rtol=1e-9)
    assert found.signatures.tolist() == signs.tolist()
    J = poisson(3)
    for w, sign, v in zip(found.frequencies, found.signatures, found.modes.T, strict=True):
        np.testing.assert_allclose(J @ H @ v, 1j * w * v, atol=1e-8 * np.abs(v).max())
        assert -1j * v.conj() @ J @ v == pytest.approx(sign)
        assert v.conj() @ H @ v == pytest.approx(sign * w)


def test_focus_focus_has_four_complex_exponents() -> None:
    """H = a (q1 p1 + q2 p2) + b (q1 p2 - q2 p1): eigenvalues +-a +-b i."""
    a, b = 0.3, 1.1
    H = np.array([[0, 0, a, b], [0, 0, -b, a], [a, -b, 0, 0], [b, a, 0, 0]])
    found = stability(H)
    assert found.type == "focus-focus"
    assert found.stable is False
    expected = [a - b * 1j, a + b * 1j, -a - b * 1j, -a + b * 1j]
    np.testing.assert_allclose(found.eigenvalues, expected, rtol=1e-14)
    assert len(found.frequencies) == 0
    assert found.modes.shape == (4, 0)


def test_types_are_joined_in_one_order() -> None:
    assert stability(np.diag([1.0, -1, 1, 1])).type == "saddle-centre"
    assert stability(np.diag([-1.0, -1, 1, 1])).type == "saddle-saddle"
    assert stability(np.diag([1.0] * 4 + [-1.0] + [1.0] * 5)).type == "1 x saddle, 4 x centre"


def test_equal_frequencies_of_one_sign_have_independent_modes() -> None:
    S = random_symplectic(2, 5)
    inverse = np.linalg.inv(S)
    found = stability(-(inverse.T @ inverse))
    assert found.definite == -1
    assert found.signatures.tolist() == [-1, -1]
    gram = -1j * found.modes.conj().T @ poisson(2) @ found.modes
    np.testing.assert_allclose(gram, -np.eye(2), atol=1e-12)


def test_units_do_not_matter() -> None:
    """x in 1e-12 and t in 1e12 of the units: entries between 1e-24 and 1e24."""
    found = stability(np.diag([-3e24, 2e-24]))
    assert found.type == "saddle"
    assert found.eigenvalues == pytest.approx([6**0.5, -(6**0.5)], rel=1e-14)


@pytest.mark.parametrize(
    "hessian",
    [
        np.diag([0.0, 1.0]),
        np.zeros((2, 2)),
        # Equal frequencies of different sign, coupled: any small change may make them complex.
        np.array([[0, 0, 0, 1.0], [0, 0, -1.0, 0], [0, -1.0, 0, 0], [1.0, 0, 0, 0]])
        + 0 * np.eye(4),
    ],
)
def test_what_small_changes_decide_is_degenerate(hessian: np.ndarray) -> None:
    found = stability(hessian, 1e-15)
    assert found.type == DEGENERATE
    assert found.stable is None
    assert found.definite == 0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("extra", [1, -1])
def test_a_soft_direction_beside_a_stiff_one_is_classified_in_exact_numbers(
    sign: int, extra: int
) -> None:
    """(p^2 + (a x + b y)^2 + extra y^2)/2: float64 loses the last term in the entry of y^2."""
    a, b = 10**9, 10**8 + 1
    matrix = [[a * a, a * b, 0, 0], [a * b, b * b + extra, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]
    found = linear_stability([[arb(sign * entry) for entry in row] for row in matrix])
    with mpmath.workdps(60):
        trace = mpmath.mpf(a * a + b * b + extra)
        fast = (trace + mpmath.sqrt(trace**2 - 4 * extra * a * a)) / 2
        slow = abs(extra * a * a / fast)
        expected = [float(mpmath.sqrt(slow)), float(mpmath.sqrt(fast))]
    if extra > 0:
        assert found.type == "centre-centre"
        np.testing.assert_allclose(found.frequencies, expected, rtol=1e-12)
    else:
        assert found.type == "saddle-centre"
        np.testing.assert_allclose(found.frequencies, expected[1:], rtol=1e-12)
        np.testing.assert_allclose(found.eigenvalues.real.max(), expected[0], rtol=1e-12)
    assert set(found.signatures.tolist()) == {sign}


def test_a_slow_block_beside_a_very_fast_one_keeps_its_part_of_the_type() -> None:
    found = stability(np.diag([1e32, -1.0, 1.0, 1.0]))
    assert found.type == "saddle-centre"
    np.testing.assert_array_equal(found.frequencies, [1e16])


@pytest.mark.parametrize("rate", [1e5, 1e8, 1e10])
def test_signatures_differ_close_to_a_collision_of_frequencies(rate: float) -> None:
    """(p^2 + q^2)/2 + rate (y p_x - x p_y): frequencies rate +- 1 with signs + and -."""
    H = np.eye(4)
    H[0, 3] = H[3, 0] = -rate
    H[1, 2] = H[2, 1] = rate
    found = stability(H)
    np.testing.assert_array_equal(found.frequencies, [rate - 1, rate + 1])
    assert found.signatures.tolist() == [-1, 1]
    areas = (found.modes.conj() * (poisson(2) @ found.modes)).sum(axis=0)
    np.testing.assert_allclose(-1j * areas, [-1, 1], atol=1e-6)
