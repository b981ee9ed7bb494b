"""References of comparisons, with their errors.

Input:  H, a start and a span, and the error that is to be judged.
Output: :class:`ReferenceSolution`: t -> states.

DOP853 at tolerance 1e-13 takes a tenth of a second, and its error is often above 1e-12. Where that
is more than a hundredth of the error to be judged, the middle of an enclosure of the exact solution
(:func:`hamsym.enclose`) takes its place, whose error is a few units in the last place of float64.
So it does where the solution is further from DOP853 than both errors allow.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np

from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.adaptive import reference
from hamsym.numerics.collocation import chebyshev_values
from hamsym.proof.windows.enclose import Enclosure, enclose
from hamsym.support.validation import require

SAMPLES = 4_000  # largest number of intervals at whose ends errors are measured
_BETTER = 0.01  # the error of a good reference, in units of the error to be judged
_ENOUGH = 10.0  # the smallest error that can be judged, in units of the reference's
# Distance of a solution from DOP853, in units of both estimated errors, at which one is wrong.
_DISAGREES = 2.0
_ENCLOSURE_SECONDS = 5.0
_TESTED = 256  # times at which the error of an enclosure's middle is measured


@dataclass(frozen=True)
class ReferenceSolution:
    """States of a motion at any times of its span, which stand for the exact ones."""

    #: t of shape (n,) -> states of shape (n, dim).
    states: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    #: About the largest 2-norm of its error; 0 for an exact solution.
    error: float
    #: What it is, with its error.
    text: str

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Return the states at times t, shape (len(t), dim)."""
        return self.states(t)

    def judges(self, error: float) -> bool:
        """Whether an error measured with it is known to 10 %.

        Steps that reach it are then known to 20 % or better, by the order of the method.
        """
        return _ENOUGH * self.error <= error

    @classmethod
    def exact(cls, states: Callable[[np.ndarray], np.ndarray]) -> ReferenceSolution:
        """Return an exact solution as a reference."""
        require(callable(states), "exact", states, "a function of times")
        return cls(states, 0.0, "the exact solution")


def reference_for(
    H: Hamiltonian,
    z0: np.ndarray,
    span: tuple[float, float],
    judged: Callable[[np.ndarray], np.ndarray],
    estimated: float = math.inf,
) -> ReferenceSolution:
    """Return a reference that is a hundred times better than the states it judges, if it can.

    Raise InputError if DOP853 stops before the end of the span.

    - estimated: 2-norm of the estimated error of these states; infinite if it is unknown.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> def judged(t):
    ...     return np.stack((np.cos(t), -np.sin(t)), axis=-1) + 1e-6
    >>> found = reference_for(H, np.array([1.0, 0.0]), (0.0, 5.0), judged)
    >>> found.text.startswith("DOP853, whose error is about "), found.error < 1e-8
    (True, True)
    """
    times = np.linspace(*span, SAMPLES + 1)
    first, second = reference(H, z0, span), reference(H, z0, span, tolerance=1e-12)
    states = first(times)
    error = largest(np.linalg.norm(second(times) - states, axis=-1))
    apart = largest(np.linalg.norm(judged(times) - states, axis=-1))
    # Steps of DOP853 at any tolerance pass over a pulse that is narrower than they are.
    agrees = estimated == math.inf or apart <= _DISAGREES * (estimated + error)
    if not error <= _BETTER * apart or not agrees:
        try:
            return _enclosed(H, z0, span)
        except CertificationError:  # H is not smooth, or the span is too long
            pass
    if not agrees:
        text = f"DOP853, whose error is not known: it is {apart:.0e} away from the solution, whose "
        return ReferenceSolution(first, math.inf, f"{text}estimated error is {estimated:.0e}")
    return ReferenceSolution(first, error, f"DOP853, whose error is about {error:.0e}")


def largest(values: np.ndarray) -> float:
    """Return the maximum, infinite if a value is not a number."""
    return float(np.nan_to_num(values, nan=np.inf, posinf=np.inf).max())


def _enclosed(H: Hamiltonian, z0: np.ndarray, span: tuple[float, float]) -> ReferenceSolution:
    enclosure = enclose(H, z0, span, time_limit=_ENCLOSURE_SECONDS)
    states = _middle(enclosure)
    times = np.linspace(*span, _TESTED + 1)
    balls = enclosure(times)
    error = largest(np.linalg.norm(np.abs(states(times) - balls.mid) + balls.radius, axis=-1))
    return ReferenceSolution(states, error, f"the exact solution, enclosed to {error:.0e}")


def _middle(enclosure: Enclosure) -> Callable[[np.ndarray], np.ndarray]:
    """Return the polynomials of an enclosure as a function of many times, in float64."""
    windows, (start, end) = enclosure.windows, enclosure.span
    direction = 1 if end > start else -1
    starts = [Fraction(start) + direction * window.start for window in windows]
    # In twice float64, so that differences of times have no errors of the size of the times.
    high = np.array([float(value) for value in starts])
    low = np.array([float(v - Fraction(float(v))) for v in starts])
    halves = direction * np.array([float(window.half) for window in windows])

    def states(t: np.ndarray) -> np.ndarray:
        t = np.asarray(t, dtype=float)
        number = np.searchsorted(direction * high, direction * t, side="right") - 1
        number = np.clip(number, 0, None)
        x = ((t - high[number]) - low[number]) / halves[number] - 1
        found = np.empty((len(t), enclosure.H.dim))
        for k in np.unique(number):
            basis = chebyshev_values(x[number == k], windows[k].high.shape[1])
            found[number == k] = basis @ windows[k].high.T + basis @ windows[k].low.T
        return found

    return states
