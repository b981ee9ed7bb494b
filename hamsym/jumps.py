"""Where a trajectory crosses a jump of H or of its gradient."""

from __future__ import annotations

import itertools
import math

import numpy as np
import scipy.optimize

from hamsym.solution import Solution

__all__ = ["first_jump"]


def first_jump(solution: Solution, times: np.ndarray) -> str | None:
    """What jumps, when, and what to do, where the trajectory first crosses a jump of H or grad H.

    The linear equation of the error knows nothing of what a jump of the force, such as that of
    abs(x), does to nearby trajectories; and where H itself jumps, as sign(x) does, there is a force
    that no derivative shows. Crossings are looked for between the given times.
    """
    H = solution.H
    if not H.switches:
        return None
    found: list[tuple[float, str]] = []
    system = H.compile("numpy")
    direction = math.copysign(1.0, times[-1] - times[0])
    z = solution(times)
    with np.errstate(all="ignore"):
        rates = np.abs(system.gradient(*system.arguments(z, times)))
        size = rates.reshape(len(times), 2, -1).max(axis=(0, 2)).repeat(H.dof)
        sizes = np.append(size, np.abs(system.energy(*system.arguments(z, times))).max())
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
                jumped = np.abs(jumps(solution(at), at)).ravel() > 1e-6 * sizes
                if jumped.any():
                    what = "H" if jumped[-1] else "the force"
                    found.append((direction * at, f"{what} jumps at t = {at:.6g}"))
                    break
    if not found:
        return None
    return (
        f"{min(found)[1]}, beyond which the error cannot be estimated; solve up to there, and on "
        "from there"
    )
