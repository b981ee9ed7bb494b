"""What every method of solution is given: a Hamiltonian, a checked start, a checked span."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators import checked_span
from hamsym.settings import require_whole

__all__ = ["InitialValueProblem"]


@dataclass(frozen=True)
class InitialValueProblem:
    """Hamilton's equations with an initial state and a time span.

    Attributes
    ----------
    H : Hamiltonian
    z0 : numpy.ndarray
        Shape (dim,).
    span : (float, float)
    energy_0 : float
        H at z0 and the start of the span.
    seed : int
    progress : bool or callable, optional
    """

    H: Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    energy_0: float
    seed: int
    progress: bool | Callable[[Any], None] | None

    @classmethod
    def checked(
        cls,
        H: HamiltonianLike,
        z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
        span: tuple[float, float],
        seed: int,
        progress: bool | Callable[[Any], None] | None,
    ) -> InitialValueProblem:
        """A problem from what the user gave.

        Raises
        ------
        InputError
            If H is no Hamiltonian, a parameter has no value, or the state, the span or the seed
            cannot be used.
        """
        H = Hamiltonian.of(H)
        state = H.state_from(z0)
        times = checked_span(span)
        energy_0 = _initial_energy(H, state, times[0])
        require_whole("seed", seed, 0)
        return cls(H, state, times, energy_0, int(seed), progress)


def _initial_energy(H: Hamiltonian, state: np.ndarray, start: float) -> float:
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        energy = float(system.energy(*system.arguments(state, start)))
        rates = system.vector_field(*system.arguments(state, start))
    if not (math.isfinite(energy) and np.all(np.isfinite(rates))):
        raise InputError("H or its gradient is not finite at z0; start elsewhere")
    return energy
