"""Where a trajectory crosses a jump of H or of its gradient.

The linear equation of the error does not describe what a jump of the force, such as that of abs(x),
does to nearby trajectories; and where H itself jumps, as sign(x) does, there is a force that no
derivative shows. The estimate of the error ends there.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
import scipy.optimize

from hamsym.solution.path import Path

__all__ = ["first_jump", "unresolved"]

_RESOLVED = 1e-2  # residual, relative to the largest rate of the component
_MOST_PLACES = 20  # that are looked at for a jump in a trained network
_SAMPLES = 400  # of the rates where a jump is suspected
_STEEP = 0.05  # change between samples, relative to all of them, that no resolved force shows
_BISECTIONS = 24


def first_jump(
    solution: Path, times: np.ndarray, suspects: Sequence[tuple[float, float]]
) -> str | None:
    """What jumps, when, and what to do, where the trajectory first crosses a jump of H or grad H.

    Parameters
    ----------
    solution : Path
    times : numpy.ndarray
        Jumps of abs, sign, Min and Max are found from their arguments, which change their signs
        between these times.
    suspects : sequence of (float, float)
        Where the residual is not small beside the rates, as at other jumps, such as that of
        sqrt((x - 1)**2), and at steps that are too steep for the tolerance: the rates are sampled
        there.
    """
    direction = math.copysign(1.0, times[-1] - times[0])
    # Those that have an argument are found twice.
    found = list(_symbolic_jumps(solution, times)) or list(_hidden_jumps(solution, suspects))
    if not found:
        return None
    time, what = min(found, key=lambda entry: direction * entry[0])
    remedy = "solve up to there, and on from there"
    if solution.H.time is not None:
        remedy += ", or give such times as breakpoints where the time switches it"
    return f"{what} at t = {time:.6g}, beyond which the error cannot be estimated; {remedy}"


def unresolved(solution: Path) -> list[tuple[float, float]]:
    """Pairs of times between which the residual of a solution is not small beside the rates.

    Of many the few where it is largest: a function without jumps follows one nowhere near it.
    """
    times = solution.scan_times
    z, dz = solution.evaluate(times)
    system = solution.H.compile("numpy")
    with np.errstate(all="ignore"):
        rates = np.asarray(system.vector_field(*system.arguments(z, times)))
        ratios = (np.abs(dz - rates) / np.abs(rates).max(axis=0))[:-1].max(axis=1)
    ratios = np.where(np.isnan(ratios), np.inf, ratios)
    places = np.argsort(ratios)[-_MOST_PLACES:]
    places = np.sort(places[ratios[places] > _RESOLVED])
    return list(zip(times[np.maximum(places - 1, 0)], times[places + 1], strict=True))


def _symbolic_jumps(solution: Path, times: np.ndarray) -> Iterator[tuple[float, str]]:
    H = solution.H
    if not H.switches:
        return
    system = H.compile("numpy")
    z = solution(times)
    with np.errstate(all="ignore"):
        # Jumps are compared with the size of the same component's rate.
        sizes = np.abs(system.gradient(*system.arguments(z, times))).max(axis=0)
        sizes = np.append(sizes, np.abs(system.energy(*system.arguments(z, times))).max())
        for argument, jumps in H.switches:
            values = np.broadcast_to(argument(z, times), times.shape)
            signed = np.flatnonzero(values)
            for before, after in itertools.pairwise(signed):
                if not values[before] * values[after] < 0:
                    continue
                at = scipy.optimize.brentq(
                    lambda t, argument=argument: float(argument(solution(t), t)),
                    *times[[before, after]],
                    xtol=1e-12 * abs(times[after] - times[before]) + 1e-300,
                )
                # A jump of H is one however large H is: its zero is arbitrary.
                allowed = np.append(1e-6 * sizes[:-1], 1e-14 * sizes[-1])
                small = np.abs(jumps(solution(at), at)).ravel() <= allowed
                if not small.all():
                    yield at, "the force jumps" if small[-1] else "H jumps"
                    break


def _hidden_jumps(
    solution: Path, suspects: Sequence[tuple[float, float]]
) -> Iterator[tuple[float, str]]:
    """The first jump of the rates that no function of H announces."""
    system = solution.H.compile("numpy")

    def rates(t: Any) -> np.ndarray:
        return np.asarray(system.vector_field(*system.arguments(solution(t), t)))

    with np.errstate(all="ignore"):
        for start, end in suspects:
            # Inside: at a joint of windows the equations may be switched.
            t = np.linspace(start, end, _SAMPLES + 2)[1:-1]
            values = rates(t)
            for component in range(values.shape[1]):
                at = _steepest(rates, t, values, component)
                if at is not None:
                    yield at, "the force jumps, or is too steep for this accuracy,"
                    return


def _steepest(
    function: Callable[[float], np.ndarray], t: np.ndarray, samples: np.ndarray, component: int
) -> float | None:
    """Where a component changes by much from one of these times to the next, or is not finite."""
    values = samples[:, component]
    spread = np.abs(values - values.mean()).max()
    changes = np.abs(np.diff(values))
    place = int(np.argmax(np.nan_to_num(changes, nan=np.inf)))
    if changes[place] <= _STEEP * spread:
        return None
    low, high = float(t[place]), float(t[place + 1])
    at_low, at_high = float(values[place]), float(values[place + 1])
    for _ in range(_BISECTIONS):
        middle = (low + high) / 2
        at_middle = float(function(middle)[component])
        if abs(at_middle - at_low) <= abs(at_high - at_middle):
            low, at_low = middle, at_middle
        else:
            high, at_high = middle, at_middle
    return (low + high) / 2
