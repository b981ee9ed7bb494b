"""Derivatives along a polynomial by Taylor series, beside those that are known."""

from __future__ import annotations

import numpy as np
import pytest

from hamsym.kernel.enclosures import enclosures
from hamsym.numerics.collocation import chebyshev_tables


def test_steps_are_taylor_series_between_the_points() -> None:
    tables = chebyshev_tables(16)
    starts = np.append(tables.points[1:], -1.0)
    h, m = (tables.points - starts)[:, None], np.arange(6)
    factorials = np.array([1, 1, 2, 6, 24, 120])
    exact = h * np.exp(starts)[:, None] * h**m / factorials
    found = np.exp(tables.points) @ tables.steps[:, :, :6]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize(
    ("terms", "enough", "error"), [(16, 1e-8, 1e-6), (32, 2.0**-53, 1e-13), (48, 2.0**-53, 1e-13)]
)
@pytest.mark.parametrize("pairs", [1, 2, 5, 12])
def test_derivatives_of_rotations(terms: int, enough: float, error: float, pairs: int) -> None:
    # w A turns each pair (x, y) at the rate w f(t), and a constant moves it in its own plane by
    # w f(t) times that to which x is turned. Momenta have another unit.
    tables, w, unit = chebyshev_tables(terms), 3.0, 2.0**10
    dim, x = 2 * pairs, tables.points
    speeds = (np.arange(pairs)[:, None] + 1) / pairs
    angles = x + 1 + 0.3 / speeds * (np.sin(speeds * x) + np.sin(speeds))
    rates = 1 + 0.3 * np.cos(speeds * x)
    rows = np.concatenate([rates / unit, rates * unit])
    entries = [(k, pairs + k, k) for k in range(pairs)]
    entries += [(pairs + k, k, pairs + k) for k in range(pairs)] + [(0, dim, 0)]
    signs = np.array([*[1.0] * pairs, *[-1.0] * pairs, unit])
    units = np.array([*[1.0] * pairs, *[unit] * pairs])
    given = rows, np.array(entries), signs, dim, dim + 1, tables.steps, tables.series
    found = enclosures().tangents(*given, w, units, enough) @ tables.values
    exact, turned = np.zeros((dim, dim + 1, terms)), w * angles
    for k in range(pairs):
        exact[k, k] = exact[pairs + k, pairs + k] = np.cos(turned[k])
        exact[k, pairs + k] = np.sin(turned[k]) / unit
        exact[pairs + k, k] = -np.sin(turned[k]) * unit
    exact[0, dim], exact[pairs, dim] = np.sin(turned[0]), (np.cos(turned[0]) - 1) * unit
    apart = np.abs(found - exact) / units[:, None, None]
    apart[:, pairs:dim] *= unit
    assert apart.max() < error
