"""The rates and the energy of H at states in pairs of float64 numbers.

Their round-off is what limits the accuracy of an orbit: close encounters multiply it, by 1e9 and
more in published orbits of three bodies.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from hamsym.errors import CertificationError, CodeGenerationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.pairs import PAIRS, Pair, as_pair, rounded, stacked
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.random_features.flow import flow_of


def precise_rates(H: Hamiltonian, states: Pair, times: np.ndarray) -> Pair:
    """Evaluate the vector field, shapes (n, dim) and (n,) -> (n, dim)."""
    functions = _functions(H)
    if functions is None:
        return rounded(in_extended_precision(flow_of(H).vector_field, states, times))
    components = [states[:, k] for k in range(H.dim)]
    return stacked(functions("vector_field", components, Pair(times)), times.shape)


def precise_energy(H: Hamiltonian, state: Pair) -> Pair:
    """Evaluate an H that is conserved at one state, shape (dim,)."""
    functions = _functions(H)
    if functions is None:
        return rounded(in_extended_precision(H.compile("numpy").energy, state))
    return as_pair(functions("energy", [state[k] for k in range(H.dim)], Pair(0.0)))


def in_extended_precision(function: Callable[..., Any], states: Pair, *times: np.ndarray) -> Any:
    """Evaluate a function of arrays as numpy.longdouble, where its functions have that."""
    longer = states.high.astype(np.longdouble) + states.low
    try:
        return function(longer, *(t.astype(np.longdouble) for t in times))
    except TypeError:
        return function(states.high, *times)


@functools.lru_cache(maxsize=64)
def _functions(H: Hamiltonian) -> GeneratedFunctions | None:
    try:
        return GeneratedFunctions(H, PAIRS)
    except (CertificationError, CodeGenerationError):  # it has kinks, or other functions
        return None
