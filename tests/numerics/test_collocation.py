"""Chebyshev polynomials by their recurrence."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

from hamsym.numerics.collocation import chebyshev_values


def test_values_against_exact_polynomials() -> None:
    x = np.array([-1.0, -0.999999, -0.3, 0.0, 0.7, 1.0])
    exact = [[float(mpmath.chebyt(n, mpmath.mpf(value))) for n in range(48)] for value in x]
    np.testing.assert_allclose(chebyshev_values(x, 48), exact, rtol=0, atol=1e-13)


@pytest.mark.parametrize("shape", [(), (3,), (2, 3)])
@pytest.mark.parametrize("count", [1, 2, 5])
def test_shape_of_values(shape: tuple[int, ...], count: int) -> None:
    values = chebyshev_values(np.full(shape, 0.5), count)
    np.testing.assert_allclose(
        values, np.broadcast_to([1, 0.5, -0.5, -1, -0.5][:count], values.shape)
    )
    assert values.shape == (*shape, count)
