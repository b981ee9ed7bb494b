"""States completed to a given energy, one component of which is missing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hamsym.codegen.generate import generate
from hamsym.codegen.system import load
from hamsym.errors import InputError, VariableError
from hamsym.formula.parser import canonical_name
from hamsym.support.validation import checked_mapping, require_number
from hamsym.symbolic.checks import name_of
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.states import states_array


def states_at_energy(
    equations: Equations,
    energy: Any,
    z0: Mapping[Any, Any],
    t: Any,
    given: Mapping[str, np.ndarray],
    raises: bool,
) -> np.ndarray:
    """Complete states with the smallest number >= 0 for which H has an energy.

    Raise VariableError and InputError as :meth:`hamsym.Hamiltonian.state_at_energy`.

    - given: Values of parameters that replace those of the equations, which lack no other.
    - raises: Whether to raise VariableError where no number gives the energy; nan otherwise.
    - returns: Shape (..., dim), where all arguments are broadcast to (...).
    """
    from hamsym.numerics.roots import first_zeros  # imports scipy.optimize, which is slow

    names, dim = [symbol.name for symbol in equations.z], len(equations.z)
    system = load(generate(equations, "numpy"))
    z0 = checked_mapping("z0", z0, f'{{"{names[0]}": 0.0}}')
    components = {canonical_name(name_of(name)) for name in z0}
    lacking = [name for name in names if canonical_name(name) not in components]
    if len(lacking) != 1:
        listed = ", ".join(lacking) or "none"
        raise VariableError(
            f"z0 must lack exactly one component, which the energy determines; missing: {listed}"
        )
    energies, times = _finite("energy", energy), _finite("t", t)
    states, where = states_array({**z0, lacking[0]: 0.0}, names), names.index(lacking[0])
    numbers = (energies, times, *given.values())
    try:
        shape = np.broadcast_shapes(states.shape[:-1], *(array.shape for array in numbers))
    except ValueError:
        shapes = ", ".join(str(array.shape) for array in (states[..., 0], *numbers))
        raise VariableError(
            f"z0, energy, t and parameters have shapes {shapes}, which do not broadcast; give "
            "arrays of one shape, or numbers"
        ) from None
    energies, times, *values = (np.broadcast_to(array, shape).ravel() for array in numbers)
    found = np.array(np.broadcast_to(states, (*shape, dim)).reshape(-1, dim))
    columns: dict[str, Any] = {name: value for name, (_, value) in equations.parameters.items()}
    columns |= dict(zip(given, values, strict=True))
    every = [np.broadcast_to(column, len(found)) for column in columns.values()]
    rows = np.array(every).T if given else None

    def excess(value: np.ndarray, index: np.ndarray) -> np.ndarray:
        z = np.empty((dim, *np.broadcast_shapes(value.shape, index.shape)))
        z[:] = found.T[:, index]
        z[where] = value
        of = system.keywords(None if rows is None else rows[index])
        with np.errstate(all="ignore"):
            at = system.arguments(np.moveaxis(z, 0, -1), times[index])
            return np.asarray(system.energy(*at, **of)) - energies[index]

    found[:, where] = first_zeros(excess, len(found))
    none = np.isnan(found[:, where])
    if raises and none.any():
        first = int(np.argmax(none))
        which = f"the energy {energies[first]:g}; give another energy or start"
        if shape:
            index = ", ".join(map(str, np.unravel_index(first, shape)))
            which = (
                f"the energy of {none.sum():,} of {none.size:,} states, the first of them "
                f"[{index}] with energy {energies[first]:g}; give other energies or starts, or "
                'missing="nan"'
            )
        raise VariableError(f"no {lacking[0]} >= 0 gives {which}")
    found[none] = np.nan
    return found.reshape(*shape, dim)


def _finite(name: str, value: Any) -> np.ndarray:
    """Convert a finite number, or an array of finite numbers, to an array."""
    if np.ndim(value) == 0:
        require_number(name, value)
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        array = np.array([])
    if not (array.size and np.isfinite(array).all()):
        raise InputError(f"{name} contains a value that is not a finite number; give numbers")
    return array
