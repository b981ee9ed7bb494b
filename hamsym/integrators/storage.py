"""What a trajectory must fulfil to be written to a file, and to be read."""

from __future__ import annotations

import math

import numpy as np

from hamsym.integrators.table import INTEGRATORS
from hamsym.integrators.trajectory import Trajectory


def require_trajectory(trajectory: Trajectory) -> None:
    """Raise ValueError unless a trajectory is one that :func:`hamsym.integrate` returns."""
    members, t, found = trajectory.ensemble, trajectory.t, trajectory.verdicts
    if trajectory.method not in INTEGRATORS:
        raise ValueError(f"'{trajectory.method[:40]}' is not a method")
    if trajectory.names != members.H.names:
        raise ValueError("its names are not those of H")
    if len(members) and members.hamiltonian(0) != members.H:
        raise ValueError("H does not have the parameters of the first trajectory")
    direction = math.copysign(1.0, trajectory.dt)
    if not len(t) or not (np.diff(t) * direction > 0).all():
        raise ValueError("its times are not in order")
    if trajectory.drift < 0:
        raise ValueError("its drift is negative")
    if trajectory.z.shape[:-2] != members.shape:
        raise ValueError("its states do not have the shape of its members")
    z = trajectory.z.reshape(len(members), len(t), -1)
    there = np.isfinite(z).all(axis=-1)
    if not (there[:, 1:] <= there[:, :-1]).all():
        raise ValueError("a state is finite after one that is not")
    if not np.array_equal(z[:, 0], members.states, equal_nan=True):
        raise ValueError("it does not begin at its starts")
    # Without tol success is one verdict of all trajectories.
    if isinstance(trajectory.success, bool) != (found is None or not members.shape):
        raise ValueError("its success is not that of its trajectories")
    success = np.broadcast_to(trajectory.success, members.shape).reshape(-1)
    if not there[success].all():
        raise ValueError("its success is true, but a state is not finite")
    if (found is None) != (trajectory.errors is None):
        raise ValueError("its error estimate does not belong to its verdicts")
    if found is None or trajectory.errors is None:
        return
    errors = trajectory.errors.reshape(z.shape)
    if not (errors >= 0).all() or not np.isfinite(errors[success]).all():
        raise ValueError("its error estimate is negative, not a number, or not finite")
    if len(found.largest) != len(members) or not found.problems.keys() <= set(range(len(members))):
        raise ValueError("a verdict belongs to no trajectory")
    if success.tolist() != [index not in found.problems for index in range(len(members))]:
        raise ValueError("its success contradicts its messages")
    if not found.tol > 0 or not (found.largest[success] <= found.tol).all():
        raise ValueError("its success is true, but an error is above its tolerance")
