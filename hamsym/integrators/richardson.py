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
import importlib.resources
import math
from dataclasses import dataclass
from types import ModuleType

import numpy as np

_PERTURBATION = 1e-11  # of a component, above its round-off and below all nonlinear effects


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
    number, times, dim = fine.shape
    sizes, errors, round_off = np.empty((number, dim)), np.empty((number, times)), np.empty(number)
    # A perturbation stands for the independent rounding errors of several steps.
    unit = _PERTURBATION / (rounding * math.sqrt(steps / count))
    _loops().extrapolate_rows(
        coarse,
        perturbed,
        unit,
        middle,
        (middle.shape[1] - 1) // (times - 1),
        fine,
        np.zeros((number, dim)) if least is None else least,
        order,
        next_order,
        steps,
        sizes,
        errors,
        round_off,
    )
    return Extrapolation(fine, sizes, errors, round_off)


def perturb(states: np.ndarray, coarse: np.ndarray, number: int) -> None:
    """Perturb states, shape (n, dim), relative to the sizes of components on a coarse path.

    - states: Shape (n, dim), changed in place.
    - coarse: Shape (n, times, dim).
    - number: Number of the perturbation, which determines its direction.
    """
    _loops().perturb_rows(states, coarse, _changes(number, states.shape[1]))


@functools.lru_cache(maxsize=256)
def _changes(number: int, dim: int) -> np.ndarray:
    """Changes of the components of different signs and sizes, shape (dim,)."""
    generator = np.random.default_rng(number)
    signs = generator.choice((-1.0, 1.0), dim)
    return np.asarray(_PERTURBATION * signs * generator.uniform(0.5, 1.0, dim))


@functools.cache
def _loops() -> ModuleType:
    """The loops, each of which takes about a second to compile the first time on a machine."""
    from hamsym.codegen.checked_cache import load_compiled  # imports numba

    file = importlib.resources.files("hamsym.templates").joinpath("extrapolation_loops.py")
    return load_compiled(file.read_text("utf-8"), "extrapolation_loops")
