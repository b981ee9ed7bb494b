"""Loops of the Richardson extrapolation over trajectories, which are the same for every H.

See :mod:`hamsym.integrators.richardson`, which has the method.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

_EPS = 2.0**-52
_SHARE = 1 / 16  # of the difference of the last two columns
_STALLED = 0.8  # ratio of successive differences from which they do not converge


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def perturb_rows(states: np.ndarray, coarse: np.ndarray, changes: np.ndarray) -> None:
    """Add changes, shape (dim,), relative to the sizes of components on a path, to the states.

    - states: Shape (count, dim).
    - coarse: Shape (count, times, dim).
    - changes: Shape (dim,).
    """
    for row in range(coarse.shape[0]):
        for component in range(coarse.shape[2]):
            size = 0.0
            for time in range(coarse.shape[1]):
                size = max(size, abs(coarse[row, time, component]))
            states[row, component] += changes[component] * size


@njit(error_model="numpy", nogil=True, cache=True, no_cfunc_wrapper=True)
def extrapolate_rows(
    coarse: np.ndarray,
    perturbed: np.ndarray,
    perturbation: float,
    middle: np.ndarray,
    every: int,
    fine: np.ndarray,
    least: np.ndarray,
    order: int,
    next_order: int,
    steps: int,
    sizes: np.ndarray,
    errors: np.ndarray,
    round_off: np.ndarray,
) -> None:
    """Extrapolate each trajectory in place of ``fine``.

    - coarse, perturbed, fine: States of the runs with n, n and 4n steps, shape (count, times, dim).
    - perturbation: Size of the perturbations whose effect is that of rounding errors of one unit in
      the last place, relative to the sizes of the components.
    - middle: Every ``every``-th state is that of the run with 2n steps at these times.
    - least, sizes: Least and resulting sizes of the components, shape (count, dim).
    - errors: Shape (count, times).
    - round_off: Shape (count,).
    """
    count, times, dim = fine.shape
    weight, next_weight = 1 / (2.0**order - 1), 1 / (2.0**next_order - 1)
    before, after, change = np.empty(times), np.empty(times), np.empty(times)
    growth = np.empty(times)
    for row in range(count):
        for component in range(dim):
            size = least[row, component]
            for time in range(middle.shape[1]):
                size = max(size, abs(middle[row, time, component]))
            sizes[row, component] = size
        lost = times
        for time in range(times):
            before[time] = after[time] = change[time] = growth[time] = 0.0
            for component in range(dim):
                first = middle[row, time * every, component] - coarse[row, time, component]
                second = fine[row, time, component] - middle[row, time * every, component]
                parted = perturbed[row, time, component] - coarse[row, time, component]
                if not math.isfinite(first + second + parted):
                    lost = min(lost, time)
                column = (1 + weight) * second - weight * first
                size = sizes[row, component]
                if parted != 0.0:
                    growth[time] = max(growth[time], abs(parted) / size)
                if first != 0.0:
                    before[time] = max(before[time], abs(first) / size)
                if second != 0.0:
                    after[time] = max(after[time], abs(second) / size)
                if column != 0.0:
                    change[time] = max(change[time], abs(column) / size)
                if lost > time:
                    fine[row, time, component] += weight * second + next_weight * column
        highest, lowest = 0.0, 0.0
        for time in range(times):
            highest, lowest = max(highest, after[time]), max(lowest, before[time])
        ratio = 0.0 if highest == 0.0 else highest / lowest
        worst, factor = 0.0, 1.0
        for time in range(times):
            if ratio <= 2.0 ** (-0.6 * order):
                error = max(_SHARE * change[time], weight / 4 * after[time])
            elif ratio < _STALLED:
                error = max(1.0, 2 * ratio / (1 - ratio)) * after[time]
            else:  # or nan
                error = 10 * max(before[time], after[time])
            worst = max(worst, error)
            factor = max(factor, growth[time] / perturbation)
            round_off[row] = _EPS * (factor + steps)
            errors[row, time] = worst + round_off[row] if time < lost else math.inf
            if math.isnan(errors[row, time]):
                errors[row, time] = math.inf
