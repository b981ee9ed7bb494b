"""Observations of trajectories: functions of the state with measured values and their errors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_expressions
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import checked_numbers, outside_span, shown
from hamsym.symbolic import derivatives
from hamsym.symbolic.brackets import phase_function
from hamsym.symbolic.variables import TIME


class Observables:
    """Functions of state, time and parameters, with their derivatives.

    - H: With a value for every parameter.
    - expressions: In real symbols, by label.
    - parameters: Parameters in which they are differentiated.
    """

    def __init__(
        self, H: Hamiltonian, expressions: Mapping[str, sympy.Expr], parameters: Sequence[str]
    ) -> None:
        self.labels = tuple(expressions)
        equations = H.real_equations
        variables = [*equations.z, *(equations.parameters[name][0] for name in parameters)]
        slopes = [
            slope.replace(sympy.DiracDelta, lambda *_: sympy.Integer(0))
            for expression in expressions.values()
            for slope in derivatives.gradient(expression, variables)
        ]
        self._function = compile_expressions([*expressions.values(), *slopes], equations)
        self._dim, self._columns = H.dim, len(variables)

    def __call__(
        self, states: np.ndarray, t: np.ndarray, parameters: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate at states (n, times, dim) with the parameters of H, shape (n, k).

        - returns values: Shape (n, observables, times).
        - returns in_state, in_parameters: Derivatives, shapes (n, observables, times, dim) and (n,
          observables, times, k).
        """
        with np.errstate(all="ignore"):
            found = np.moveaxis(self._function(states, t, parameters[:, None]), -1, 1)
        count = len(self.labels)
        slopes = found[:, count:].reshape(len(states), count, self._columns, -1)
        slopes = np.moveaxis(slopes, 2, 3)
        return found[:, :count], slopes[..., : self._dim], slopes[..., self._dim :]


@dataclass(frozen=True)
class Observations:
    """Measured values of observables."""

    #: The observables in real symbols, by label.
    expressions: dict[str, sympy.Expr]
    #: Times, shape (times,).
    t: np.ndarray
    #: Shape (sets, observables, times); nan where a value is missing.
    data: np.ndarray
    #: Standard deviations of the data, in their shape; ones if they are unknown.
    sigma: np.ndarray
    #: Whether they were given.
    known: bool
    #: Whether there is one set, given without an axis of sets.
    single: bool

    @property
    def present(self) -> np.ndarray:
        """Where there are data, in their shape."""
        return np.isfinite(self.data)

    @property
    def counts(self) -> np.ndarray:
        """Numbers of data, shape (sets,)."""
        return np.asarray(self.present.sum(axis=(1, 2)))


def checked_times(t: Any, span: tuple[float, float]) -> np.ndarray:
    """Return the times of observations, inside the span.

    Raises
    ------
    InputError
    """
    times = checked_numbers("t", t)
    if times.ndim != 1 or not times.size:
        raise InputError(f"t has shape {times.shape}; give a list of times")
    if not np.isfinite(times).all():
        raise InputError(f"t[{np.argmin(np.isfinite(times))}] is not finite; give finite times")
    low, high = min(span), max(span)
    outside = outside_span(times, span)
    if outside.any():
        raise InputError(
            f"t[{np.argmax(outside)}] = {times[outside][0]:.16g} is outside the span from "
            f"{low:.16g} to {high:.16g}; give a longer span, or leave the time out"
        )
    return np.clip(times, low, high)


def checked_observations(
    H: Hamiltonian, t: np.ndarray, observations: Any, sigma: Any
) -> Observations:
    """Check observables, their data and their standard deviations.

    Raise InputError if they are not a mapping of functions of the state to arrays of real numbers
    with the length of t, or a standard deviation is not a number above 0.
    """
    if not isinstance(observations, Mapping) or not observations:
        raise InputError(
            f"observations={shown(observations)} is not a mapping of observables to data; give "
            f'for example {{"{H.names[0]}": data}}'
        )
    names = (*H.names, *H.parameter_names, TIME)
    expressions, arrays = {}, {}
    for key, values in observations.items():
        label = str(key)
        if not isinstance(key, (str, sympy.Expr)) or label in expressions:
            problem = "occurs twice" if label in expressions else "is not a formula"
            raise InputError(f"the observable {label!r} {problem}; name each once, as text")
        energy = label == "H" and "H" not in names
        expressions[label] = phase_function(H.expr if energy else key, names)
        arrays[label] = _data(label, values, t)
    sets = {array.shape[0] for array in arrays.values() if array.ndim == 2}
    if len(sets) > 1:
        shapes = ", ".join(str(array.shape) for array in arrays.values())
        raise InputError(f"data have shapes {shapes}; give the same number of sets for each")
    shape = (sets.pop() if sets else 1, len(t))
    data = np.stack([np.broadcast_to(array, shape) for array in arrays.values()], axis=1)
    single = all(array.ndim == 1 for array in arrays.values())
    if not np.isfinite(data).any():
        raise InputError("all data are nan; give at least one number")
    deviations = np.ones(data.shape)
    if isinstance(sigma, Mapping):
        given = {str(key): value for key, value in sigma.items()}
        if unknown := [key for key in given if key not in expressions]:
            raise InputError(
                f"sigma has '{unknown[0]}', which is not observed; give {', '.join(expressions)}"
            )
        for k, label in enumerate(expressions):
            if label not in given:
                raise InputError(f"'{label}' is missing in sigma; give a number or an array")
            deviations[:, k] = _deviations(f"sigma of '{label}'", given[label], shape)
    elif sigma is not None:
        for k in range(len(expressions)):
            deviations[:, k] = _deviations("sigma", sigma, shape)
    return Observations(expressions, t, data.astype(float), deviations, sigma is not None, single)


def _data(label: str, values: Any, t: np.ndarray) -> np.ndarray:
    array = checked_numbers(f"data of '{label}'", values)
    if array.ndim not in (1, 2) or array.shape[-1] != len(t) or not array.size:
        raise InputError(
            f"data of '{label}' have shape {array.shape}; give one number for each of the "
            f"{len(t)} times, shape ({len(t)},), or (sets, {len(t)})"
        )
    if np.isinf(array).any():
        raise InputError(f"data of '{label}' have an infinite value; give nan if it is missing")
    return array


def _deviations(name: str, values: Any, shape: tuple[int, int]) -> np.ndarray:
    array = checked_numbers(name, values)
    try:
        array = np.broadcast_to(array, shape)
    except ValueError:
        raise InputError(
            f"{name} has shape {array.shape}; give a number, or an array of shape ({shape[1]},)"
        ) from None
    # Weights beyond these sizes overflow when they are squared.
    if not ((array > 1e-140) & (array < 1e140)).all():
        raise InputError(f"{name} is not above 0 and finite everywhere; give standard deviations")
    return array
