"""Trivial and other multipliers of matrices with known blocks, and the words for them."""

import math

import numpy as np
import pytest
import scipy.linalg

from hamsym.numerics.symplectic import poisson_matrix
from hamsym.orbits.multipliers import (
    differ_from_one,
    multiplier_error,
    reduced_map,
    shear_of,
    stability_of,
)
from hamsym.orbits.symmetry import Closing, SignedPermutation

ROTATION = scipy.linalg.expm(np.array([[0.0, 0.7], [-0.7, 0.0]]))
SADDLE = np.diag([3.0, 1 / 3])
REFLECTED = np.diag([-3.0, -1 / 3])


def blocks(*parts):
    """A symplectic matrix of 2 by 2 blocks, one for each pair."""
    found = np.zeros((2 * len(parts), 2 * len(parts)))
    for i, part in enumerate(parts):
        found[i :: len(parts), i :: len(parts)] = part
    return found


def shear(slope):
    return np.array([[1.0, slope], [0.0, 1.0]])


def canonical(dof, random):
    """A random linear canonical change of coordinates."""
    J = poisson_matrix(dof)
    found = np.eye(2 * dof)
    for _ in range(2):
        part = random.normal(size=(2 * dof, 2 * dof)) / (2 * dof)
        found = found @ scipy.linalg.expm(J @ (part + part.T))
    return found


def reduced_at_rest(matrix, gradients, rate=None, scale=None):
    """The reduced map of one window whose ends have the same gradients."""
    closing = Closing(SignedPermutation.identity(len(matrix)))
    rates = None if rate is None else np.array([rate, rate])
    scale = np.ones(len(matrix)) if scale is None else scale
    return reduced_map(closing, matrix[None], np.array([gradients, gradients]), rates, scale)


def reduced_eigenvalues(matrix, covectors, random):
    """Those of the reduced map after a random canonical change, with random combinations."""
    dof = len(matrix) // 2
    change = canonical(dof, random)
    covectors = random.normal(size=(len(covectors) + 1, len(covectors))) @ covectors
    units = 10.0 ** random.uniform(-3, 3, dof)
    scale = np.concatenate([units, 1 / units])
    moved = change @ matrix @ np.linalg.inv(change)
    gradients = covectors @ np.linalg.inv(change)
    reduced = reduced_at_rest(moved * scale[:, None] / scale, gradients / scale, scale=scale)
    return np.sort_complex(np.linalg.eigvals(reduced))


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize(
    ("rest", "word"),
    [
        ((ROTATION,), "elliptic"),
        ((SADDLE, REFLECTED), "hyperbolic"),
        ((ROTATION, SADDLE), "mixed"),
        ((shear(0.0),), "parabolic"),
    ],
)
def test_commuting_integrals_leave_the_other_multipliers(seed, rest, word):
    random = np.random.default_rng(seed)
    trivial = [shear(slope) for slope in random.normal(size=3) * 10]
    matrix = blocks(*trivial, *rest)
    dof = len(matrix) // 2
    momenta = np.eye(2 * dof)[dof : dof + 3]
    found = reduced_eigenvalues(matrix, momenta, random)
    expected = np.sort_complex(np.linalg.eigvals(blocks(*rest)).astype(complex))
    np.testing.assert_allclose(found, expected, atol=1e-7 if word == "parabolic" else 1e-9)
    assert stability_of(found, error=1e-7) == word


@pytest.mark.parametrize("seed", range(5))
def test_integrals_that_do_not_commute_leave_the_others(seed):
    # As two angular momenta do, whose brackets are the third one: a pair of coordinates.
    random = np.random.default_rng(seed)
    matrix = blocks(np.eye(2), shear(2.0), ROTATION, SADDLE)
    covectors = np.eye(8)[[0, 4, 5]]
    found = reduced_eigenvalues(matrix, covectors, random)
    expected = [1 / 3, np.exp(-0.7j), np.exp(0.7j), 3]
    np.testing.assert_allclose(found, np.sort_complex(expected), atol=1e-9)


def test_vector_field_is_left_out_without_integrals():
    matrix = np.diag([1.0, 0.5, 0.25, 0.2])
    reduced = reduced_at_rest(matrix, np.zeros((0, 4)), np.array([3.0, 0, 0, 0]))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(reduced)), [0.2, 0.25, 0.5])


def test_integrals_of_all_directions_leave_no_multiplier():
    reduced = reduced_at_rest(shear(2.0), np.array([[0.0, 1.0]]))
    assert reduced.shape == (0, 0)
    size = shear_of(shear(2.0), np.eye(2), np.ones(2))
    assert size == 2.0
    assert stability_of(np.linalg.eigvals(reduced), shear=size) == "parabolic"


@pytest.mark.parametrize(
    ("multipliers", "word"),
    [
        (np.exp([0.3j, -0.3j, 1.0j, -1.0j]), "elliptic"),
        ([2.0, 0.5, -3.0, -1 / 3], "hyperbolic"),
        (np.exp([0.2 + 0.3j, 0.2 - 0.3j, -0.2 + 0.3j, -0.2 - 0.3j]), "complex unstable"),
        ([1.0, 1.0], "parabolic"),
        ([-1.0, -1.0, 1.0, 1.0], "parabolic"),
        ([2.0, 0.5, 1j, -1j], "mixed"),
        ([1.0, 1.0, 1j, -1j], "mixed"),
        ([math.nan, 1.0], "unknown"),
    ],
)
def test_words_for_pairs_of_multipliers(multipliers, word):
    assert stability_of(np.array(multipliers)) == word


@pytest.mark.parametrize(
    ("slope", "error", "word"),
    [
        (3.0, 0.0, "parabolic"),
        (-1e-4, 1e-6, "parabolic"),
        (0.0, 1e-12, "elliptic"),
        (2e-12, 1e-12, "elliptic"),
        (1e-11, 1e-12, "unknown"),
        (1e-5, 1e-4, "unknown"),
    ],
)
def test_shear_decides_where_no_multiplier_is_left(slope, error, word):
    size = shear_of(shear(slope), np.eye(2), np.ones(2))
    assert stability_of(np.array([]), error=error, shear=size) == word


@pytest.mark.parametrize(
    ("multipliers", "allowed"),
    [
        (np.exp([1e-6j, -1e-6j]), "elliptic"),
        (np.exp([1e-6, -1e-6]), "hyperbolic"),
        (-np.exp([1e-7j, -1e-7j]), "elliptic"),
        (np.exp([3e-7 + 1j, 3e-7 - 1j, -3e-7 + 1j, -3e-7 - 1j]), "complex unstable"),
        (
            2.0 ** np.array([1, 1, -1, -1]) * np.exp([3e-6j, -3e-6j, 3e-6j, -3e-6j]),
            "complex unstable",
        ),
    ],
)
def test_words_do_not_contradict_a_small_error(multipliers, allowed):
    for error in (1e-15, 1e-10, 1e-8):
        assert stability_of(multipliers, error=error) in {allowed, "unknown"}
    assert stability_of(multipliers, error=1e-5) in {"parabolic", "unknown", allowed}


KINDS = {
    "elliptic": lambda m: np.exp([1j * m, -1j * m]),
    "hyperbolic": lambda m: np.array([math.exp(m), math.exp(-m)]),
    "complex unstable": lambda m: np.exp([m + 1j, m - 1j, -m + 1j, -m - 1j]),
}


def realised(multipliers):
    """A symplectic matrix with given eigenvalues, a pair or four."""
    if len(multipliers) == 2:  # a companion matrix
        return np.real([[0, 1], [-np.prod(multipliers), np.sum(multipliers)]])
    growth, angle = math.log(abs(multipliers[0])), 1.0
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    found = np.zeros((4, 4))
    found[:2, :2], found[2:, 2:] = math.exp(growth) * turn, math.exp(-growth) * turn
    return found


@pytest.mark.parametrize("size", [1e-13, 1e-9, 1e-6, 1e-4])
@pytest.mark.parametrize("kind", KINDS)
def test_words_are_right_or_unknown_whatever_the_error(kind, size):
    random = np.random.default_rng(7)
    said = []
    for exponent in np.repeat([-5.0, -4.0, -3.0, -2.0, -1.0, 0.0], 10):
        exact = realised(KINDS[kind](10**exponent))
        change = canonical(len(exact) // 2, random)
        exact = change @ exact @ np.linalg.inv(change)
        maps = [exact + size * random.normal(size=exact.shape) for _ in "12"]
        one, error = np.linalg.eigvals(maps[0]).astype(complex), multiplier_error(*maps)
        word = stability_of(one, error=error)
        # Up to 1e-5 from 1 multipliers are called 1, whatever their error.
        near = exponent == -5
        assert word in {kind, "unknown", *(["parabolic"] if near else [])}, (exponent, one, error)
        said.append(word == kind)
    assert sum(said) >= (40 if size <= 1e-9 else 20 if size <= 1e-6 else 5)


def test_one_multiplier_alone_is_on_the_circle_and_two_may_have_left_it():
    near = np.exp([1.0001j, -1.0001j, 1j, -1j])
    assert stability_of(near * 1.00002, error=1e-5) == "elliptic"
    assert stability_of(near * 1.00002, error=4e-5) == "unknown"


def test_powers_of_multipliers_of_a_shift_are_judged():
    third = np.exp([2j * np.pi / 3, -2j * np.pi / 3])
    assert stability_of(third) == "elliptic"
    assert stability_of(third, order=3) == "parabolic"
    assert stability_of(third, order=3, error=1e-4) == "unknown"


@pytest.mark.parametrize(
    ("sizes", "error", "word"),
    [
        ([0.9, 0.5], 1e-4, "attracting"),
        ([0.9999, 0.5], 1e-4, "unknown"),
        ([1.5, 0.5], 1e-4, "mixed"),
        ([1.5, 1.0001], 1e-4, "unknown"),
        ([0.9, 0.5], 0.1, "unknown"),
        ([0.9, 0.5], math.nan, "unknown"),
    ],
)
def test_words_with_forces_leave_room_for_the_error(sizes, error, word):
    assert stability_of(np.array(sizes), error=error, conservative=False) == word


def test_errors_of_multipliers_are_relative_to_large_ones_and_infinite_without_a_map():
    matrix = np.diag([1e6, 1e-6, 2.0, 0.5])
    assert multiplier_error(matrix, matrix) < 1e-9
    moved = matrix + np.diag([1e3, 0, 0, 0])
    assert multiplier_error(matrix, moved) == pytest.approx(1e-3)
    # A shear between multipliers of different size moves none of them to first order.
    moved = matrix + 1e-3 * np.eye(4, k=2)
    assert multiplier_error(matrix, moved) < 1e-9
    assert multiplier_error(matrix, matrix[:2, :2]) == math.inf
    assert multiplier_error(matrix, matrix * math.nan) == math.inf
    # The inverse of 1e13 is round-off of the matrix, of which some processors make zero.
    matrix = np.diag([1e13, 0.0])
    assert multiplier_error(matrix, matrix * (1 + 1e-5)) == pytest.approx(1e-5)
    assert multiplier_error(np.zeros((2, 2)), np.zeros((2, 2))) == math.inf


@pytest.mark.parametrize("size", [1e-14, 1e-10, 1e-6])
def test_errors_of_a_jordan_block_are_square_roots(size):
    exact = shear(3.0)
    other = exact + size * np.array([[0, 0], [1.0, 0]])
    found = multiplier_error(exact, other)
    assert math.sqrt(3 * size) / 3 < found < 20 * math.sqrt(3 * size)


def test_multipliers_differ_from_one_by_more_than_their_error():
    assert differ_from_one(np.array([1e9, 1e-9]), 1e-6)
    assert not differ_from_one(np.array([1.01, 1 / 1.01]), 0.01)
    assert not differ_from_one(np.array([2.0, 0.5]), math.inf)
