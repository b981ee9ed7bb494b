"""Sizes of the components of a state, each in its own units."""

from __future__ import annotations

import numpy as np

__all__ = ["SMALLEST", "coupled_sizes"]

#: A component below this part of its coupled size counts as having that size: at tolerances of
#: 1e-8 less could not be told from the round-off of the terms in its own equation.
SMALLEST = 1e-8


def coupled_sizes(sizes: np.ndarray, coupling: np.ndarray, time: float) -> np.ndarray:
    """Sizes that the terms of its own equation give each component, at least its own.

    Small changes obey delta' = A delta with A = J Hess. In the time tau = 1/rho, with rho the
    spectral radius of |A|, other components of sizes s move component i by up to
    tau sum_j |A_ij| s_j. That is done dim times, so that it reaches components which are coupled
    through others. Nothing in it compares components of different units.

    Parameters
    ----------
    sizes : numpy.ndarray
        Largest |z_i|, shape (dim,).
    coupling : numpy.ndarray
        |A|, its mean along the trajectory, shape (dim, dim).
    time : float
        The longest tau: the span, beyond which no weak coupling acts.

    Examples
    --------
    >>> coupled_sizes(np.array([2.0, 0.0]), np.array([[0.0, 1.0], [9.0, 0.0]]), 100.0)
    array([2., 6.])
    """
    if not np.isfinite(coupling).all():
        return sizes
    radius = float(np.abs(np.linalg.eigvals(coupling)).max(initial=0.0))
    tau = min(time, 1 / radius) if radius > 0 else time
    found = sizes
    for _ in range(len(sizes)):
        found = np.maximum(found, tau * coupling @ found)
    return found
