"""Smallest zeros of several functions."""

from __future__ import annotations

import numpy as np

from hamsym.numerics.roots import first_zeros


def test_smallest_zeros_are_found() -> None:
    """Zeros at 0 and over all magnitudes, after poles and gaps, or nowhere."""
    expected = np.array([0.0, 1e-200, 3e-9, 2.0, 7.0, 4.0, np.nan, 5e200, np.nan])

    def function(x: np.ndarray, index: np.ndarray) -> np.ndarray:
        x, index = np.broadcast_arrays(x, index)
        with np.errstate(all="ignore"):
            kinds = [
                x,
                x - 1e-200,
                x - 3e-9,
                (x - 2.0) * (x - 3.0),
                1 / (x - 5.0) - 0.5,  # its sign changes at the pole, too
                np.where(x < 3.0, np.nan, 4.0 - x),
                np.exp(-x) + 1.0,
                x - 5e200,
                1 / (x - 6.0),
            ]
        return np.choose(index, kinds)

    np.testing.assert_allclose(first_zeros(function, len(expected)), expected, rtol=1e-15)


def test_zeros_of_many_functions_are_those_of_each() -> None:
    shifts = np.random.default_rng(0).uniform(0, 30, 1_200)

    def function(x: np.ndarray, index: np.ndarray) -> np.ndarray:
        return x**3 + x - shifts[index]

    found = first_zeros(function, len(shifts))
    np.testing.assert_allclose(found**3 + found, shifts, rtol=2e-15)
    for i in (0, 17, 1_199):
        alone = first_zeros(lambda x, index, at=i: function(x, index + at), 1)
        assert alone[0] == found[i]
