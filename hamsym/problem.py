"""The initial-value problem that every method solves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.validation import require_positive, require_whole

MAX_STEPS = 2**53


@dataclass(frozen=True)
class InitialValueProblem:
    """Hamilton's equations with an initial state and a time span."""

    H: Hamiltonian
    #: Shape (dim,).
    z0: np.ndarray
    span: tuple[float, float]
    #: H at z0 and the start of the span.
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
        """Make a problem from checked arguments.

        Raise InputError if H is not a Hamiltonian, a parameter has no value, or the state, the span
        or the seed is invalid.
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
        raise InputError("H or its gradient is not finite at z0; choose another initial state")
    return energy


def checked_span(span: tuple[float, float]) -> tuple[float, float]:
    """Return start and end of a time span as floats.

    Raise InputError if the span is not two finite numbers with a finite distance.
    """
    try:
        start, end = (float(value) for value in span)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"span={span!r} is not a pair of times; give (t_start, t_end)") from None
    # A division by a shorter span would overflow.
    distinct = 1e-300 < abs(end - start) < math.inf
    if not (math.isfinite(start) and math.isfinite(end)) or not distinct:
        raise InputError(
            f"span={span!r} cannot be used; give two finite times, from 1e-300 to 1e308 apart"
        )
    return start, end


def checked_steps(length: float, steps: int | None, dt: float | None, default: int = 20_000) -> int:
    """Return the number of equal steps in a span of this length.

    Raise InputError if both are given, one is invalid, or the step is longer than the span.
    """
    if dt is None:
        steps = default if steps is None else steps
        require_whole("steps", steps, 1, MAX_STEPS)
        return int(steps)
    if steps is not None:
        raise InputError(f"steps={steps!r} and dt={dt!r} exclude each other; give one of them")
    require_positive("dt", dt)
    count = abs(length) / float(dt)
    if not count <= MAX_STEPS:
        raise InputError(f"dt={dt!r} would take {count:.0e} steps; give a larger one")
    if not count >= 1 - 1e-12:
        raise InputError(
            f"dt={dt!r} is longer than the span, {abs(length):.6g}; give a shorter one"
        )
    # A dt that divides the span up to round-off counts as dividing it.
    return max(1, math.ceil(count * (1 - 1e-12)))
