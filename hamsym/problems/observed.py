"""Components and formulas along trajectories, as columns of tables."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hamsym.hamiltonian import Hamiltonian

Columns = dict[str, np.ndarray]


def observed(
    H: Hamiltonian,
    names: Sequence[Any],
    z: np.ndarray,
    t: np.ndarray,
    parameters: np.ndarray | None = None,
) -> Columns:
    """Return components or formulas at states, by their texts; without names all components.

    A formula is nan where it is no finite real number.

    - z, t: Of shapes (..., n, dim) and (n,).
    - parameters: Of each trajectory, shape (..., k); None for those of H.

    Examples
    --------
    >>> observed(Hamiltonian("p**2/2 + x**2/2"), ["p", "H"], np.array([[1.0, 2.0]]), np.zeros(1))
    {'p': array([2.]), 'H': array([2.5])}
    """
    if not names:
        return dict(zip(H.names, np.moveaxis(z, -1, 0), strict=True))
    own = None if parameters is None else parameters[..., None, :]
    return {found.text: found.values(z, t, own) for found in map(H.observable, names)}


def observed_variable(
    names: Sequence[Any], axes: Sequence[str], columns: Callable[[Sequence[Any]], Columns]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the variable ``value`` of a dataset and the coordinate ``quantity``, if any are named.

    - axes: Of the arrays of the columns.
    - columns: As :func:`observed`.
    """
    if not names:
        return {}, {}
    found = columns(names)
    values = np.stack(list(found.values()), axis=-1)
    return {"value": ([*axes, "quantity"], values)}, {"quantity": list(found)}
