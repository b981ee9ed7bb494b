"""Ensembles: initial states and parameter values of many trajectories, broadcast to one shape."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from hamsym.errors import VariableError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.record_fields import Count, Limit, floats
from hamsym.symbolic.states import parameter_arrays, states_array


@dataclass(frozen=True)
class Ensemble:
    """Initial states and parameter values of many trajectories of one Hamiltonian."""

    #: With a value for every parameter; those of the first member where they differ.
    H: Hamiltonian
    #: Initial states.
    states: Annotated[np.ndarray, floats("members", "dim", finite=False)]
    #: Values in the order of ``H.parameter_names``.
    parameters: Annotated[np.ndarray, floats("members", "parameters")]
    #: Shape in which the caller arranged the members; () for one start.
    shape: Annotated[tuple[Count, ...], Limit(most=32)]
    #: Names of the parameters that were given as arguments.
    varied: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.states)

    def check(self) -> None:
        """Raise ValueError unless the members have its shape, and only known parameters vary."""
        self.H.require_parameters()
        names, varied = self.H.parameter_names, {*self.varied}
        if math.prod(self.shape) != len(self):
            raise ValueError("its shape differs from its number of members")
        if not varied <= {*names} or len(varied) != len(self.varied):
            raise ValueError("a parameter varies that H does not have")
        for name, column in zip(names, self.parameters.T, strict=True):
            if name not in varied and not (column == self.H.parameters[name]).all():
                raise ValueError(f"'{name[:40]}' differs from its value in H")

    def own_parameters(self, rows: Any = slice(None)) -> np.ndarray | None:
        """Return the parameters of some members, or None where all have those of H."""
        return self.parameters[rows] if self.varied else None

    def some(self, rows: np.ndarray) -> Ensemble:
        """Return members by their numbers, shape (n,), as an ensemble of that shape."""
        return replace(
            self, states=self.states[rows], parameters=self.parameters[rows], shape=(len(rows),)
        )

    @property
    def columns(self) -> dict[str, np.ndarray]:
        """Values of the parameters that vary, each of shape (count,)."""
        names = self.H.parameter_names
        return {name: self.parameters[:, names.index(name)] for name in self.varied}

    def flat(self, values: Any) -> np.ndarray:
        """Return an array of the shape of the ensemble and more axes with its members along one."""
        return np.asarray(values).reshape(len(self), *np.shape(values)[len(self.shape) :])

    def hamiltonian(self, index: int) -> Hamiltonian:
        """Return H with the parameter values of one member."""
        if not self.varied:
            return self.H
        values = dict(zip(self.H.parameter_names, self.parameters[index].tolist(), strict=True))
        return self.H.with_parameters(**values)


def ensemble_of(
    H: HamiltonianLike, z0: Any, parameters: Mapping[Any, Any] | None = None, *, finite: bool = True
) -> Ensemble:
    """Broadcast initial states and parameter values to one shape.

    Raise InputError if H is not a Hamiltonian, a parameter is unknown or has no value, a value is
    not a finite number, or the shapes do not broadcast.

    - z0: States of shape (..., dim) in the order of H.z, or a mapping to numbers and arrays.
    - parameters: Values that replace those of H, broadcast with the states.
    - finite: Require finite states.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + k*x**2/2")
    >>> members = ensemble_of(H, {"x": [[1.0], [2.0]], "p": 0.0}, {"k": [1.0, 2.0, 3.0]})
    >>> members.shape, members.states.shape, members.parameters[:, 0]
    ((2, 3), (6, 2), array([1., 2., 3., 1., 2., 3.]))
    """
    H = Hamiltonian.of(H, bound=False)
    given = parameter_arrays(parameters, H.parameter_names) if parameters else {}
    if given:
        H = H.with_parameters(**{name: float(values.flat[0]) for name, values in given.items()})
    H.require_parameters()
    states = states_array(z0, H.names, finite=finite)
    try:
        shape = np.broadcast_shapes(states.shape[:-1], *(v.shape for v in given.values()))
    except ValueError:
        shapes = ", ".join(str(v.shape) for v in (states[..., 0], *given.values()))
        raise VariableError(
            f"z0 and parameters have shapes {shapes}, which do not broadcast; give arrays of one "
            "shape, or numbers"
        ) from None
    columns = [
        np.broadcast_to(given.get(name, np.float64(H.parameters[name])), shape).ravel()
        for name in H.parameter_names
    ]
    count = int(np.prod(shape))
    return Ensemble(
        H,
        np.array(np.broadcast_to(states, (*shape, H.dim)).reshape(count, H.dim)),
        np.array(columns).T.copy() if columns else np.empty((count, 0)),
        shape,
        tuple(given),
    )
