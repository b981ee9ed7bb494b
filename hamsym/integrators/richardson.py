"""Richardson extrapolation of three runs with n, 2n and 4n steps, and its error estimate.

A method of order p has the error c h^p + d h^r + ..., with r = p + 2 for a symmetric method and
r = p + 1 for others. The runs C, B and A (the finest) give B + (B - C)/(2^p - 1) and
A + (A - B)/(2^p - 1), of order r; from these two the last column follows, which is the result. The
difference of the two is about the error of the first, a large multiple of that of the result. The
estimate, a sixteenth of it, holds if the differences of the runs fall as the order says. Where they
fall more slowly, the runs have not reached the order, H is not smooth or round-off dominates, and
the estimate is made from the differences themselves.

The round-off of the runs is part of their differences only where it dominates. It is estimated from
the effect of small perturbations of the coarse run, which represent the rounding errors of its
part of the span.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass

import numpy as np

_PERTURBATION = 1e-11  # of a component, above its round-off and below all nonlinear effects
_SHARE = 1 / 16  # of the difference of the last two columns
_STALLED = 0.8  # ratio of successive differences from which they do not converge
_EPS = 2.0**-52


@dataclass(frozen=True)
class Extrapolation:
    """Extrapolated states of trajectories and their estimated errors."""

    #: Shape (n, times, dim); those of the finest run where another run is not finite.
    states: np.ndarray
    #: Largest magnitude of each component in the middle run, shape (n, dim).
    sizes: np.ndarray
    #: Estimated largest error of a component, relative to its size, up to each time, shape (n,
    #: times); infinite where a run is not finite.
    errors: np.ndarray
    #: The part of the last errors that is round-off, shape (n,).
    round_off: np.ndarray

    def add_round_off(self, sizes: np.ndarray) -> None:
        """Add round-off that all runs share, relative to the sizes of components, shape (n,)."""
        np.add(self.errors, sizes[:, None], out=self.errors)
        np.add(self.round_off, sizes, out=self.round_off)


def extrapolate(
    coarse: np.ndarray,
    middle: np.ndarray,
    fine: np.ndarray,
    perturbed: np.ndarray,
    count: int,
    order: int,
    next_order: int,
    steps: int,
    rounding: float,
    least: np.ndarray | None = None,
) -> Extrapolation:
    """Extrapolate three runs, the first states of which are the exact start.

    - coarse, middle, fine: States of runs with n, 2n and 4n steps, shape (n, times, dim); the
      middle run may have further states at equal distances between those times. The finest run is
      overwritten.
    - perturbed: The same for a run with n steps and ``count`` calls of :func:`perturb` at equal
      intervals.
    - order, next_order: Order of the method, and the next power of the step in its error.
    - steps: Number of steps of the finest run.
    - rounding: Rounding errors of a step, in units of the last place of the components.
    - least: Smallest sizes of the components to which errors are relative, shape (n, dim).
    """
    weight, next_weight = 1 / (2.0**order - 1), 1 / (2.0**next_order - 1)
    # A perturbation stands for the independent rounding errors of several steps.
    unit = _PERTURBATION / (rounding * math.sqrt(steps / count))
    sizes = np.fmax.reduce(np.abs(middle), axis=1, initial=0.0)
    if least is not None:
        sizes = np.maximum(sizes, least)
    middle = middle[:, :: (middle.shape[1] - 1) // (fine.shape[1] - 1)]

    def largest(change: np.ndarray) -> np.ndarray:
        """Largest change of a component relative to its size, shape (n, times)."""
        relative = np.where(change == 0, 0.0, np.abs(change) / sizes[:, None])
        return np.asarray(np.fmax.reduce(relative, axis=2, initial=0.0))

    with np.errstate(all="ignore"):
        first, second, parted = middle - coarse, fine - middle, perturbed - coarse
        column = (1 + weight) * second - weight * first
        finite = np.isfinite(first + second + parted).all(axis=2)
        there = np.logical_and.accumulate(finite, axis=1)
        fine += np.where(there[..., None], weight * second + next_weight * column, 0.0)
        before, after = largest(first), largest(second)
        highest, lowest = after.max(axis=1, keepdims=True), before.max(axis=1, keepdims=True)
        ratio = np.where(highest == 0, 0.0, highest / lowest)
        found = 10 * np.maximum(before, after)  # where the ratio is not a number, too
        slow = np.maximum(1.0, 2 * ratio / (1 - ratio)) * after
        found = np.where(ratio < _STALLED, slow, found)
        # Runs that differ by the size of a component can have any ratio by chance.
        share = np.maximum(weight / 4, np.minimum(lowest, 1.0) ** 2)
        fast = np.maximum(_SHARE * largest(column), share * after)
        found = np.where(ratio <= 2.0 ** (-0.6 * order), fast, found)
        grown = np.maximum.accumulate(largest(parted), axis=1) / unit
        round_off = _EPS * (np.maximum(1.0, grown) + steps)
        errors = np.where(there, np.fmax.accumulate(found, axis=1) + round_off, np.inf)
    errors[np.isnan(errors)] = np.inf
    return Extrapolation(fine, sizes, errors, round_off[:, -1].copy())


def perturb(states: np.ndarray, sizes: np.ndarray, number: int) -> None:
    """Perturb states in place, relative to the sizes of their components, shape (n, dim) both.

    - number: Number of the perturbation, which determines its direction.
    """
    states += sizes * _changes(number, states.shape[1])


@functools.lru_cache(maxsize=256)
def _changes(number: int, dim: int) -> np.ndarray:
    """Changes of the components of different signs and sizes, shape (dim,)."""
    generator = np.random.default_rng(number)
    signs = generator.choice((-1.0, 1.0), dim)
    return np.asarray(_PERTURBATION * signs * generator.uniform(0.5, 1.0, dim))
