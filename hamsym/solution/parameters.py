"""Parameters in which a trajectory is differentiated: their names, values and forcing."""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hamsym.codegen.functions import compile_expressions
from hamsym.errors import InputError, ParameterError
from hamsym.formula.parser import canonical_name
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.suggestions import did_you_mean
from hamsym.symbolic.checks import as_list, name_of


def parameter_names(H: Hamiltonian, parameters: Any) -> tuple[str, ...]:
    """Return the names in H of one or several parameters, given by name or as symbols.

    Raise InputError if none is given. Raise ParameterError if one is not a parameter of H.
    """
    given = [name_of(entry) for entry in as_list(parameters, "parameters")]
    if not given:
        raise InputError(
            f"parameters={parameters!r} names no parameter; give for example "
            f'parameters=["{(*H.parameter_names, "k")[0]}"]'
        )
    known = {canonical_name(name): name for name in H.parameter_names}
    for name in given:
        if canonical_name(name) not in known:
            listed = ", ".join(H.parameter_names) or "none"
            hint = did_you_mean(name, H.parameter_names)
            raise ParameterError(f"'{name}' is not a parameter of H{hint}; it has {listed}")
    return tuple(known[canonical_name(name)] for name in given)


class ParameterForcing:
    """Derivatives of the rates by some parameters k; its length is their number.

    Without forces they are J d(grad H)/dk.

    Examples
    --------
    >>> H = Hamiltonian("p**2/(2*m) + k*x**2/2", parameters={"m": 2.0, "k": 4.0})
    >>> ParameterForcing(H, ("k", "m"))(np.array([[3.0, 4.0]]), np.array([0.0]))
    array([[[ 0., -1.],
            [-3.,  0.]]])
    """

    def __init__(self, H: Hamiltonian, names: Sequence[str]) -> None:
        self._H, self._names = H, tuple(names)
        self._function = _compiled(H, self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __call__(self, z: np.ndarray, t: np.ndarray) -> np.ndarray:
        """Evaluate at states (n, dim) and times (n,), shape (n, dim, parameters).

        Raise ParameterError if a derivative is not finite.
        """
        values = np.asarray(self._function(z, t), dtype=float)
        values = values.reshape(len(z), len(self), self._H.dim)
        lost = np.argwhere(~np.isfinite(values))
        if len(lost):
            name = self._names[lost[0, 1]]
            raise ParameterError(
                f"the derivative of the force in '{name}' is not finite at t = {t[lost[0, 0]]:.6g} "
                f"with {name} = {self._H.parameters[name]:.6g}; use another value or parameter"
            )
        return values.swapaxes(1, 2)


@functools.lru_cache(maxsize=64)
def _compiled(H: Hamiltonian, names: tuple[str, ...]) -> Callable[..., np.ndarray]:
    equations, rates = H.real_equations, []
    for name in names:
        slopes = equations.slopes_in(name)
        rates += [*slopes[H.dof :], *(-slope for slope in slopes[: H.dof])]
    return compile_expressions(rates, equations)
