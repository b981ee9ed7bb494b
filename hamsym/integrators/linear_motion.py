"""Rates of the linear motion around states, which say how short steps must be."""

from __future__ import annotations

import numpy as np

from hamsym.hamiltonian import Hamiltonian


def fastest_rates(
    H: Hamiltonian,
    states: np.ndarray,
    times: np.ndarray | float,
    parameters: np.ndarray | None = None,
) -> np.ndarray:
    """Spectral radius of J Hess at states, per unit of time; it does not depend on units of z.

    - states: Shape (..., dim).
    - times: Broadcast with the states, shape (...).
    - parameters: Values for each state, shape (..., k), by default those of H.
    - returns: Shape (...), infinite where the Hessian is not finite.

    Examples
    --------
    >>> fastest_rates(Hamiltonian("p**2/2 + 9*x**2/2"), np.zeros((1, 2)), 0.0).round(9)
    array([3.])
    """
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        arguments = system.arguments(states, times)
        matrices = np.asarray(system.jacobian(*arguments, **system.keywords(parameters)))
    known = np.isfinite(matrices).all(axis=(-2, -1))
    usable = np.where(known[..., None, None], matrices, 0.0)
    return np.where(known, np.abs(np.linalg.eigvals(usable)).max(axis=-1), np.inf)
