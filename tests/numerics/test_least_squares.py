"""Least squares of many rows: each is the minimum that scipy finds."""

from __future__ import annotations

import numpy as np
import scipy.optimize

from hamsym.numerics.least_squares import are_minima, minimize_squares

T = np.linspace(0, 4, 41)
FREE = np.full(3, np.inf)


def decay(x: np.ndarray, data: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of x0 exp(-x1 t) + x2 and their derivatives."""
    falling = np.exp(-x[:, 1:2] * T)
    residuals = x[:, :1] * falling + x[:, 2:] - data
    slopes = (falling, -x[:, :1] * T * falling, np.ones_like(falling))
    return residuals, np.stack(slopes, axis=-1)


def unit(squares: np.ndarray, rows: np.ndarray) -> np.ndarray:
    return np.maximum(squares / (len(T) - 3), 1e-30)


def noisy(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    truth = rng.uniform([1, 0.5, -1], [3, 2, 1], (count, 3))
    return decay(truth, np.zeros(len(T)))[0] + rng.normal(0, 0.05, (count, len(T)))


def test_every_row_is_the_minimum_of_scipy() -> None:
    data = noisy(20)
    starts = np.tile([1.0, 1.0, 0.0], (20, 1))
    found = minimize_squares(lambda x, rows: decay(x, data[rows]), starts, -FREE, FREE, unit)
    assert found.converged.all()
    for row, values in enumerate(data):
        expected = scipy.optimize.least_squares(
            lambda x, values=values: decay(x[None], values)[0][0], [1, 1, 0], xtol=1e-15, ftol=1e-15
        )
        np.testing.assert_allclose(found.unknowns[row], expected.x, rtol=1e-4)
        assert (found.residuals[row] ** 2).sum() <= 2 * expected.cost * (1 + 1e-9)


def test_units_of_unknowns_change_nothing() -> None:
    # Powers of two, which round nothing: otherwise one iteration more or less would be right too.
    data, units = noisy(4), np.array([2.0**-30, 2.0**40, 2.0**-664])

    def scaled(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, slopes = decay(x / units, data[rows])
        return residuals, slopes / units

    starts = np.tile([1.0, 1.0, 0.1], (4, 1))
    plain = minimize_squares(lambda x, rows: decay(x, data[rows]), starts, -FREE, FREE, unit)
    other = minimize_squares(scaled, starts * units, -FREE, FREE, unit)
    np.testing.assert_allclose(other.unknowns / units, plain.unknowns, rtol=1e-6)
    np.testing.assert_array_equal(other.iterations, plain.iterations)


def test_bounds_hold_where_the_minimum_is_outside() -> None:
    data = noisy(1)
    high = np.array([np.inf, 0.3, np.inf])
    found = minimize_squares(
        lambda x, rows: decay(x, data[rows]), np.array([[1.0, 0.1, 0.0]]), -FREE, high, unit
    )
    expected = scipy.optimize.least_squares(
        lambda x: decay(x[None], data[0])[0][0], [1, 0.1, 0], bounds=(-FREE, high), xtol=1e-12
    )
    assert found.converged.all()
    assert found.unknowns[0, 1] == 0.3
    np.testing.assert_allclose((found.residuals**2).sum(), 2 * expected.cost, rtol=1e-6)


def test_rows_without_values_do_not_disturb_others() -> None:
    data = noisy(3)

    def broken(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals, slopes = decay(x, data[rows])
        residuals[rows == 1] = np.nan
        return residuals, slopes

    starts = np.tile([1.0, 1.0, 0.0], (3, 1))
    found = minimize_squares(broken, starts, -FREE, FREE, unit)
    np.testing.assert_array_equal(found.converged, [True, False, True])
    np.testing.assert_array_equal(found.unknowns[1], starts[1])
    alone = minimize_squares(lambda x, rows: decay(x, data[:1]), starts[:1], -FREE, FREE, unit)
    np.testing.assert_allclose(found.unknowns[0], alone.unknowns[0], rtol=1e-10)


def test_steps_where_there_are_no_values_are_refused() -> None:
    def root(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(invalid="ignore"):
            return np.sqrt(x) - 0.1, 0.5 / np.sqrt(x)[..., None]

    one = np.array([np.inf])
    found = minimize_squares(root, np.array([[4.0]]), -one, one, lambda s, rows: 1e-12 + 0 * s)
    assert found.converged.all()
    np.testing.assert_allclose(found.unknowns, 0.01, rtol=1e-4)


def test_the_limit_of_iterations_is_no_convergence() -> None:
    data = noisy(1)
    found = minimize_squares(
        lambda x, rows: decay(x, data), np.array([[9.0, 9.0, 9.0]]), -FREE, FREE, unit, iterations=1
    )
    assert not found.converged.any()


def test_minima_at_which_a_column_vanishes_converge() -> None:
    t = np.linspace(0.0, 1.0, 20)

    def square(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        residuals = x[:, :1] + x[:, 1:] ** 2 * t + t
        slopes = np.stack((np.ones((len(x), 20)), 2 * x[:, 1:] * t), axis=-1)
        return residuals, slopes

    free = np.full(2, np.inf)
    starts = np.array([[0.0, 0.5], [1.0, -2.0], [-1.0, 1e-3]])
    found = minimize_squares(square, starts, -free, free, lambda s, rows: 0.01 + 0 * s)
    assert found.converged.all()
    np.testing.assert_allclose(found.unknowns[:, 0], -0.5, atol=1e-3)
    np.testing.assert_allclose(found.unknowns[:, 1], 0.0, atol=1e-2)


def test_saddles_are_no_minima() -> None:
    t = np.linspace(0.0, 1.0, 20)

    def square(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        slopes = np.stack((np.ones((len(x), 20)), 2 * x[:, 1:] * t), axis=-1)
        return x[:, :1] + x[:, 1:] ** 2 * t - t, slopes

    free = np.full(2, np.inf)
    x = np.array([[0.5, 1e-9]])
    parts = square(x, np.zeros(1, dtype=int))
    one = np.ones(1)
    assert not are_minima(square, x, *parts, -free, free, 0.01 * one, np.ones((1, 2))).any()


def test_saddles_between_the_unknowns_are_no_minima() -> None:
    """The squares rise along each unknown, and fall where both change with opposite signs."""
    t = np.linspace(0.0, 1.0, 20)

    def mixed(x: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        mean, y, z = x.T[..., None]
        slopes = (np.ones((len(x), 20)), (2 * y + 4 * z) * t, (2 * z + 4 * y) * t)
        return mean + (y**2 + z**2 + 4 * y * z + 1) * t, np.stack(slopes, axis=-1)

    free = np.full(3, np.inf)
    x = np.array([[-0.5, 1e-9, 1e-9]])
    parts = mixed(x, np.zeros(1, dtype=int))
    one = np.ones(1)
    assert not are_minima(mixed, x, *parts, -free, free, 0.01 * one, np.ones((1, 3))).any()
