"""Conversion of states and parameter values from sequences and mappings to arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.errors import ParameterError, VariableError
from hamsym.formula.parser import canonical_name
from hamsym.support.suggestions import unknown
from hamsym.support.validation import checked_mapping
from hamsym.symbolic.checks import name_of


def state_array(
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray, names: Sequence[str]
) -> np.ndarray:
    """Convert a state, given in order or by name, to an array of shape (dim,)."""
    states = states_array(z0, names)
    if states.ndim != 1:
        raise VariableError(
            f"z0 has shape {states.shape}; give the {len(names)} numbers {', '.join(names)}"
        )
    return states


def states_array(z0: Any, names: Sequence[str], *, finite: bool = True) -> np.ndarray:
    """Convert a state or several states to an array of shape (..., dim).

    In a mapping, numbers and arrays are broadcast to one shape.

    Raise VariableError if a component is missing, unknown, not a number, or, with ``finite``, not
    finite.
    """
    order = ", ".join(names)
    try:
        if isinstance(z0, Mapping):
            values = [np.array(value, dtype=float) for value in by_component(z0, names).values()]
            z0 = np.stack(_alike(values, order), axis=-1)
        states = np.array(z0, dtype=float)
    except VariableError:
        raise
    except (TypeError, ValueError, OverflowError, RuntimeError):  # the last from a tensor of torch
        raise VariableError(f"z0 contains a value that is not a number; give {order}") from None
    if states.shape[-1:] != (len(names),) or not states.size:
        raise VariableError(f"z0 has shape {states.shape}; give the {len(names)} numbers {order}")
    if finite and not np.isfinite(states).all():
        name = names[int(np.argwhere(~np.isfinite(states))[0, -1])]
        raise VariableError(f"'{name}' is not finite in z0; give finite numbers")
    return states


def _alike(values: list[np.ndarray], order: str) -> tuple[np.ndarray, ...]:
    try:
        return np.broadcast_arrays(*values)
    except ValueError:
        shapes = ", ".join(str(value.shape) for value in values)
        raise VariableError(
            f"z0 has arrays of shapes {shapes}; give {order} with one shape"
        ) from None


def by_component(z0: Mapping[Any, Any], names: Sequence[str]) -> dict[str, Any]:
    """Return the entries of a state by component, in the order of the names.

    Raise VariableError if a component is missing or unknown.
    """
    given = {canonical_name(name_of(key)): value for key, value in z0.items()}
    wanted = [canonical_name(name) for name in names]
    others = [name for name in given if name not in wanted]
    missing = [name for name, key in zip(names, wanted, strict=True) if key not in given]
    if others:
        raise VariableError(unknown(others[0], names, "a component of z", "z0 has"))
    if missing:
        raise VariableError(f"'{missing[0]}' is missing in z0; give all of {', '.join(names)}")
    return {name: given[key] for name, key in zip(names, wanted, strict=True)}


def parameter_arrays(parameters: Mapping[Any, Any], names: Sequence[str]) -> dict[str, np.ndarray]:
    """Convert values of parameters, numbers or arrays, to finite arrays by name.

    Raise InputError if the argument is not a mapping. Raise ParameterError if a name is not among
    ``names``, or a value is empty or not finite.
    """
    known = {canonical_name(name): name for name in names}
    found = {}
    for key, value in checked_mapping("parameters", parameters, '{"k": [1.0, 2.0]}').items():
        name = known.get(canonical_name(name_of(key)))
        if name is None:
            raise ParameterError(unknown(name_of(key), names, "a parameter of H", "it has"))
        try:
            values = np.array(value, dtype=float)
        except (TypeError, ValueError, OverflowError, RuntimeError):
            values = np.array(np.nan)
        if not (values.size and np.isfinite(values).all()):
            raise ParameterError(
                f"the values of parameter '{name}' are not finite numbers; give a number or an "
                "array of finite numbers"
            )
        found[name] = values
    return found
