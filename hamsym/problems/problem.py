"""The initial-value problem that every method solves."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.support.validation import require, require_positive, require_whole, shown
from hamsym.symbolic.switching import switch_times

MAX_STEPS = 2**53
_USUAL_STEPS = 20_000


@dataclass(frozen=True)
class InitialValueProblem:
    """Hamilton's equations with an initial state, a time span, and what is asked of a solution."""

    H: Hamiltonian
    #: Shape (dim,).
    z0: np.ndarray
    span: tuple[float, float]
    seed: int = 0
    progress: bool | Callable[[Any], None] | None = None
    #: Relative tolerance, and whether it was given: a training then stops when it is met.
    tol: float = 1e-9
    tol_given: bool = False
    #: Absolute tolerance, one or one for each component, in the units of the components.
    atol: tuple[float, ...] = (0.0,)
    #: Times at which a window ends, in the direction of the span.
    breakpoints: tuple[float, ...] = ()
    #: Whether errors are proven to be within the tolerance.
    prove: bool = False
    #: A :class:`~hamsym.problems.conservation.KnownInvariants`; empty without any.
    invariants: Any = ()

    @classmethod
    def checked(
        cls,
        H: HamiltonianLike,
        z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
        span: tuple[float, float],
        seed: int = 0,
        *,
        tol: float = 1e-9,
        atol: float | Sequence[float] = 0.0,
        breakpoints: Sequence[float] = (),
        finite: bool = True,
        **further: Any,
    ) -> InitialValueProblem:
        """Make a problem from checked arguments; further fields are taken as they are.

        Raise InputError if H is not a Hamiltonian, a parameter has no value, or another argument is
        invalid.

        - finite: Whether H and its gradient must be finite at z0; otherwise the caller requires it.
        """
        H = Hamiltonian.of(H)
        state = H.state_from(z0)
        times = checked_span(span)
        require_whole("seed", seed, 0)
        problem = cls(
            H,
            state,
            times,
            int(seed),
            tol=checked_tol(tol),
            atol=checked_atol(atol, H.dim),
            breakpoints=checked_breakpoints(breakpoints, times),
            **further,
        )
        if finite:
            problem.require_finite()
        return problem

    @cached_property
    def energy_0(self) -> float:
        """H at z0 and the start of the span.

        Raise InputError if H or its gradient is not finite there.
        """
        system, given = self.H.compile("numpy"), (self.z0, self.span[0])
        energy, rates = float(system.at("energy", *given)), system.at("vector_field", *given)
        if not (math.isfinite(energy) and np.isfinite(rates).all()):
            raise InputError("H or its gradient is not finite at z0; choose another initial state")
        return energy

    def require_finite(self) -> None:
        """Raise InputError if H or its gradient is not finite at z0."""
        _ = self.energy_0

    def window_ends(self) -> list[float]:
        """Return breakpoints and the times at which t switches H, in the direction of the span."""
        apart = 1e-12 * max(map(abs, self.span))
        times = switch_times(self.H.real_equations, self.span)
        given = self.breakpoints
        found = [t for t in times if all(abs(t - stop) > apart for stop in given)]
        return sorted([*given, *found], reverse=bool(self.span[1] < self.span[0]))


def checked_span(span: tuple[float, float]) -> tuple[float, float]:
    """Return start and end of a time span as floats.

    Raise InputError if the span is not two finite numbers with a finite distance.
    """
    try:
        start, end = (float(value) for value in span)
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"span={shown(span)} is not a pair of times; give (t_start, t_end)"
        ) from None
    # A division by a shorter span would overflow.
    distinct = 1e-300 < abs(end - start) < math.inf
    finite = math.isfinite(start) and math.isfinite(end) and distinct
    require(finite, "span", span, "two finite times, from 1e-300 to 1e308 apart")
    return start, end


def checked_steps(length: float, steps: int | None, dt: float | None) -> int:
    """Return the number of equal steps in a span of this length.

    Raise InputError if both are given, one is invalid, or the step is longer than the span.
    """
    if dt is None:
        steps = _USUAL_STEPS if steps is None else steps
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


def checked_tol(tol: Any, least: float = 1e-12) -> float:
    """Return a relative tolerance.

    Raise InputError if it is not a number from ``least``, by default what float64 allows, to below
    1.
    """
    number = isinstance(tol, (int, float, np.floating)) and least <= tol < 1
    require(bool(number), "tol", tol, f"a number from {least:g} to below 1")
    return float(tol)


def checked_atol(atol: float | Sequence[float], dim: int) -> tuple[float, ...]:
    """Return absolute tolerances, one or one for each of ``dim`` components."""
    try:
        values = np.atleast_1d(np.asarray(atol, dtype=float))
    except (TypeError, ValueError, OverflowError):
        values = np.array([math.nan])
    found = tuple(values.tolist())
    valid = values.shape in ((1,), (dim,)) and all(0 <= value < math.inf for value in found)
    require(valid, "atol", atol, f"a number from 0, or a list of {dim}")
    return found


def checked_window(
    max_window: float | None, span: tuple[float, float], default: float, most: int
) -> float:
    """Return the length of the longest window; a span may have ``most`` windows."""
    if max_window is None:
        return default
    require_positive("max_window", max_window)
    if (shortest := abs(span[1] - span[0]) / most) > max_window:
        raise InputError(
            f"max_window={max_window!r} needs more than {most:,} windows; give "
            f"{shortest:.3g} or more, or a shorter span"
        )
    return float(max_window)


def checked_breakpoints(
    breakpoints: Sequence[float], span: tuple[float, float]
) -> tuple[float, ...]:
    """Return the breakpoints in the direction of the span, without repetitions."""
    try:
        times = sorted({float(stop) for stop in breakpoints})
    except (TypeError, ValueError, OverflowError):
        raise InputError(
            f"breakpoints={shown(breakpoints)} is not a list of times; give a list of numbers"
        ) from None
    for stop in times:
        if not min(span) < stop < max(span):
            raise InputError(
                f"breakpoint {stop:.6g} is not inside the span from {min(span):.6g} to "
                f"{max(span):.6g}; leave it out"
            )
    return tuple(times if span[0] < span[1] else times[::-1])
