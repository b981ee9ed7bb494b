"""Points of a cell and of a step, and polynomials through values at them.

Nothing here is proven: the polynomials are guesses, and exact as what they are.
"""

from __future__ import annotations

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.proof.arithmetic.taylor_models import Space, multi_indices

_FINE = 400  # intervals of the grid from which points are chosen


class Nodes:
    """The points of the time, with both ends, times a lattice in the inputs.

    - space: Of the models.
    - time_degree, degree: Of the polynomials in tau and in all inputs.
    - times, inputs: Shapes (time_degree + 1,) and (count, d).
    - rates, integral: Derivatives and integrals from -1 at the times, of values there.
    - series: Chebyshev coefficients in the time, of values at the times.
    """

    def __init__(self, space: Space, time_degree: int, degree: int) -> None:
        most = time_degree
        self.times = -np.cos(np.pi * np.arange(most + 1) / most)
        self.series = np.linalg.inv(chebyshev.chebvander(self.times, most))
        unit = np.eye(most + 1)
        slopes = chebyshev.chebvander(self.times, most - 1) @ chebyshev.chebder(unit)
        self.rates = slopes @ self.series
        primitive = chebyshev.chebint(unit, lbnd=-1)
        self.integral = chebyshev.chebvander(self.times, most + 1) @ primitive @ self.series
        # A lattice of points of a sequence, by sums of their places, determines polynomials of a
        # total degree.
        indices = np.array(multi_indices(space.inputs, degree))
        self.inputs = _leja_points(degree + 1)[indices]
        self.count = len(indices)
        table = chebyshev.chebvander(self.inputs, degree)  # (count, d, degree + 1)
        own = np.prod([table[:, k][:, indices[:, k]] for k in range(space.inputs)], axis=0)
        self._fit = np.linalg.inv(own)
        in_space = np.hypot(
            np.arange(most + 1)[:, None] / space.time_degree, indices.sum(axis=1) / space.degree
        )
        self._inside = in_space <= 1
        self._to_times = _to_powers(most)
        single = _to_powers(degree)
        self._to_inputs = np.prod(
            [single[np.ix_(indices[:, k], indices[:, k])] for k in range(space.inputs)], axis=0
        )
        place = {tuple(nu): i for i, nu in enumerate(indices.tolist())}
        chosen = [
            (i, a, place[tuple(nu)])
            for i, (a, *nu) in enumerate(space.exponents.tolist())
            if a <= most and sum(nu) <= degree
        ]
        self._places, self._powers, self._terms = np.array(chosen).T
        self._count = space.count
        self._at_inputs = np.prod(self.inputs[:, None] ** space.exponents[None, :, 1:], axis=-1)
        self._without_time = np.flatnonzero(space.exponents[:, 0] == 0)
        self._at_start = self._at_inputs[:, self._without_time]
        self._at_times = self.times[:, None] ** space.exponents[None, :, 0]

    def polynomial(self, values: np.ndarray) -> np.ndarray:
        """Coefficients near values of shape (cells, inputs, times), shape (terms, cells)."""
        series = np.matmul(self._fit, values) @ self.series.T
        series = np.where(self._inside.T, series, 0.0)
        powers = np.matmul(self._to_inputs, series) @ self._to_times.T
        found = np.zeros((self._count, len(values)))
        found[self._places] = powers[:, self._terms, self._powers].T
        return found

    def values(self, coefficients: np.ndarray) -> np.ndarray:
        """Values of polynomials of shape (terms, cells), shape (cells, inputs, times)."""
        terms = coefficients.T[:, :, None] * self._at_times.T
        return np.matmul(self._at_inputs, terms)

    def start_values(self, coefficients: np.ndarray) -> np.ndarray:
        """Values of polynomials without time, shape (cells, inputs)."""
        return (self._at_start @ coefficients[self._without_time]).T


def _to_powers(degree: int) -> np.ndarray:
    """The matrix from Chebyshev polynomials to powers."""
    found = np.zeros((degree + 1, degree + 1))
    for k, unit in enumerate(np.eye(degree + 1)):
        own = chebyshev.cheb2poly(unit)
        found[: len(own), k] = own
    return found


def _leja_points(count: int) -> np.ndarray:
    """Points in [-1, 1], each where the product of its distances from those before is largest."""
    grid = -np.cos(np.pi * np.arange(_FINE + 1) / _FINE)
    found = [0.0]
    for _ in range(count - 1):
        product = np.prod(np.abs(grid[:, None] - np.array(found)), axis=1)
        found.append(float(grid[np.argmax(product)]))
    return np.array(found)
