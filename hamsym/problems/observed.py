"""Components and formulas along trajectories, as columns of tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.support.tables import data_set

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


def dataset_of_states(
    H: Hamiltonian,
    axes: Sequence[str],
    t: np.ndarray,
    states: np.ndarray,
    columns: Columns,
    variables: Mapping[str, Any],
    coordinates: Mapping[str, Any],
    attributes: Mapping[str, Any],
) -> Any:
    """Make an ``xarray.Dataset`` of states, with formulas as the variable ``value`` if there are.

    - axes: Of the members; the others are ``time``, ``component`` and ``quantity``.
    - columns: The formulas, as of :func:`observed`.
    - variables, coordinates: Further ones.
    """
    along, value, quantity = [*axes, "time"], {}, {}
    if columns:
        values = np.stack(list(columns.values()), axis=-1)
        value, quantity = {"value": ([*along, "quantity"], values)}, {"quantity": [*columns]}
    return data_set(
        {"state": ([*along, "component"], states), **variables, **value},
        {"time": t, "component": list(H.names), **coordinates, **quantity},
        attributes,
    )
