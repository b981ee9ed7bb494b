"""Elimination of the states between windows, against dense systems."""

import math

import numpy as np
import pytest

from hamsym.orbits.condensed import SINGULAR, CondensedWindows, solved
from hamsym.orbits.orbit import _same_condition


@pytest.mark.parametrize("stretch", [1.0, 30.0])
@pytest.mark.parametrize("windows", [1, 2, 9])
def test_condensed_system_has_the_dense_solution(windows, stretch):
    random = np.random.default_rng(windows)
    dim, count = 4, (windows + 1) * 4
    maps = random.normal(size=(windows, dim, dim))
    maps[:, 0] *= stretch
    numbers, right = random.normal(size=(windows, dim, 2)), random.normal(size=(windows, dim))
    border, rest = random.normal(size=(dim + 2, 2 * dim + 2)), random.normal(size=dim + 2)
    dense = np.zeros((count + 2, count + 2))
    for k in range(windows):
        rows = slice(k * dim, (k + 1) * dim)
        dense[rows, rows], dense[rows, (k + 1) * dim : (k + 2) * dim] = maps[k], -np.eye(dim)
        dense[rows, count:] = numbers[k]
    dense[windows * dim :, :dim] = border[:, :dim]
    dense[windows * dim :, windows * dim :] = border[:, dim:]
    expected = np.linalg.solve(dense, np.concatenate([right.ravel(), rest]))
    condensed = CondensedWindows(maps, numbers, right)
    small, condition = solved(
        np.vstack([condensed.matrix, border]), np.concatenate([condensed.right, rest])
    )
    assert condition > SINGULAR
    np.testing.assert_allclose(small[2 * dim :], expected[count:], rtol=1e-8)
    states = condensed.states(small)
    np.testing.assert_allclose(states.ravel(), expected[:count], rtol=1e-7, atol=1e-9)


def test_growth_beyond_float64_is_solved():
    # z_(k+1) = 100 z_k, z_(k+1) = z_k / 100 over 30 windows: powers of 1e60.
    maps = np.tile(np.diag([100.0, 0.01]), (30, 1, 1))
    condensed = CondensedWindows(maps, np.zeros((30, 2, 0)), np.zeros((30, 2)))
    border = np.array([[0, 0, 1.0, 0], [0, 1.0, 0, 0]])  # the growing one at the end
    small, condition = solved(
        np.vstack([condensed.matrix, border]), np.concatenate([condensed.right, [1.0, 1.0]])
    )
    assert condition > SINGULAR
    states = condensed.states(small)
    np.testing.assert_allclose(states[::10, 0], [1e-60, 1e-40, 1e-20, 1], atol=1e-15)
    np.testing.assert_allclose(states[::10, 1], [1, 1e-20, 1e-40, 1e-60], atol=1e-15)


def test_singular_system_is_said():
    matrix = np.array([[1.0, 1.0], [1.0, 1.0]])
    solution, condition = solved(matrix, np.array([2.0, 2.0]))
    assert condition < 1e-15
    np.testing.assert_allclose(solution, [1.0, 1.0])


def test_condition_is_known_where_two_computations_agree_beyond_round_off():
    assert _same_condition(3e-12, 2.5e-12)
    assert not _same_condition(1e-12, 3e-12)
    assert not _same_condition(2e-16, 2e-16)
    assert not _same_condition(1e-12, math.nan)
    assert not _same_condition(math.nan, 1e-12)
