"""Products of powers of several variables, the terms of polynomials."""

from __future__ import annotations

import functools

import numpy as np


def monomials(x: np.ndarray, powers: np.ndarray) -> np.ndarray:
    """Evaluate products of powers of variables.

    - x: Values, real or complex, shape (..., n).
    - powers: At least 0, shape (terms, n).
    - returns: Shape (..., terms).

    Examples
    --------
    >>> monomials(np.array([[2.0, 3.0], [1.0, 5.0]]), np.array([[0, 0], [1, 2]]))
    array([[ 1., 18.],
           [ 1., 25.]])
    """
    # Each power of a variable is computed once, however many terms have it.
    table = np.asarray(x)[..., None] ** np.arange(powers.max() + 1)
    factors = (table[..., k, powers[:, k]] for k in range(powers.shape[1]))
    return np.asarray(functools.reduce(np.multiply, factors))
