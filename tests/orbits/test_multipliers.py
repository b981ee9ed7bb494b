"""Trivial and other multipliers of matrices with known blocks, and the words for them."""

import math

import numpy as np
import pytest
import scipy.linalg

from hamsym.numerics.symplectic import poisson_matrix
from hamsym.orbits.multipliers import has_shear, reduced_map, stability_of

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


def reduced_eigenvalues(matrix, covectors, random):
    """Those of the reduced map after a random canonical change, with random combinations."""
    dof = len(matrix) // 2
    change = canonical(dof, random)
    covectors = random.normal(size=(len(covectors) + 1, len(covectors))) @ covectors
    units = 10.0 ** random.uniform(-3, 3, dof)
    scale = np.concatenate([units, 1 / units])
    moved = change @ matrix @ np.linalg.inv(change)
    gradients = covectors @ np.linalg.inv(change)
    reduced = reduced_map(moved * scale[:, None] / scale, gradients / scale, None, scale)
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
    assert stability_of(found) == word


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
    reduced = reduced_map(matrix, np.zeros((0, 4)), np.array([3.0, 0, 0, 0]), np.ones(4))
    np.testing.assert_allclose(np.sort(np.linalg.eigvals(reduced)), [0.2, 0.25, 0.5])


def test_integrals_of_all_directions_leave_no_multiplier():
    reduced = reduced_map(shear(2.0), np.array([[0.0, 1.0]]), None, np.ones(2))
    assert reduced.shape == (0, 0)
    assert stability_of(np.linalg.eigvals(reduced), shear=has_shear(shear(2.0), np.ones(2))) == (
        "parabolic"
    )


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
    ("slope", "word"), [(3.0, "parabolic"), (-1e-4, "parabolic"), (0.0, "elliptic")]
)
def test_shear_decides_where_no_multiplier_is_left(slope, word):
    assert stability_of(np.array([]), shear=has_shear(shear(slope), np.ones(2))) == word
