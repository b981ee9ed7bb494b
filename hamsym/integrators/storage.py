"""Files of trajectories."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from hamsym.description import described, hamiltonian_from, read_result, write_result
from hamsym.ensemble import Ensemble
from hamsym.integrators.table import INTEGRATORS
from hamsym.integrators.trajectory import Tolerated, Trajectory
from hamsym.support.checked_data import checked_values, require_array, require_names

#: Kind of the file.
KIND = "trajectory"

_PLAIN = {
    "method": "str",
    "steps": "int",
    "dt": "float",
    "evaluations": "int",
    "seconds": "float",
    "message": "str",
    "interrupted": "bool",
    "drift": "float",
}
_TYPES = _PLAIN | {
    "H": "Mapping[str, Any]",
    "shape": "tuple[int, ...]",
    "varied": "tuple[str, ...]",
}
_TYPES_OF_TOLERANCE = {"problems": "Mapping[str, str]", "tol": "float"}
_ARRAYS = {"t", "z", "starts", "parameters", "success"}
_ARRAYS_OF_TOLERANCE = {"error_estimate", "largest", "steps"}
_MOST_MEMBERS = 2**40


def write_trajectory(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a trajectory, or those of an ensemble, to one file; see :func:`hamsym.save`."""
    H = trajectory.ensemble.H
    write_result(path, KIND, H, lambda: _check(trajectory), lambda: _parts(trajectory))


def _parts(trajectory: Trajectory) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    members, found = trajectory.ensemble, trajectory.verdicts
    count = len(members)
    success = np.array(np.broadcast_to(trajectory.success, members.shape), dtype=np.uint8)
    arrays = {
        "t": trajectory.t,
        "z": trajectory.z.reshape(count, len(trajectory.t), -1),
        "starts": members.states,
        "parameters": members.parameters,
        "success": success.reshape(-1),
    }
    values: dict[str, Any] = {
        "H": described(members.H),
        "shape": list(members.shape),
        "varied": list(members.varied),
        **{name: _json(getattr(trajectory, name)) for name in _PLAIN},
    }
    if found is not None and trajectory.errors is not None:
        arrays["error_estimate"] = trajectory.errors.reshape(arrays["z"].shape)
        arrays["largest"], arrays["steps"] = found.largest, found.steps.astype(np.int64)
        values["tol"] = float(found.tol)
        values["problems"] = {str(index): text for index, text in found.problems.items()}
    return arrays, values


def _json(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a file that :func:`write_trajectory` wrote; see :func:`hamsym.load`."""
    return read_result(path, KIND, _assembled)


def _assembled(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Trajectory:
    toleranced = "problems" in values
    require_names("arrays", arrays, _ARRAYS | (_ARRAYS_OF_TOLERANCE if toleranced else set()))
    types = _TYPES | (_TYPES_OF_TOLERANCE if toleranced else {})
    given = checked_values("values", values, types)
    H, shape = hamiltonian_from(given["H"]), given["shape"]
    if not all(0 <= n < _MOST_MEMBERS for n in shape) or len(shape) > 32:
        raise ValueError("its shape is not that of an array")
    count, times = math.prod(shape), arrays["t"].size
    require_array("success", arrays["success"], (count,), np.uint8)
    if not (arrays["success"] <= 1).all():
        raise ValueError("its success is neither true nor false")
    success = arrays["success"].astype(bool)
    path_shape = (count, times, H.dim)
    require_array("z", arrays["z"], path_shape, finite=False)
    found = errors = None
    if toleranced:
        errors = arrays["error_estimate"]
        require_array("error_estimate", errors, path_shape, finite=False)
        require_array("largest", arrays["largest"], (count,), finite=False)
        require_array("steps", arrays["steps"], (count,), np.int64)
        found = Tolerated(
            z=arrays["z"],
            errors=errors,
            success=success,
            steps=arrays["steps"],
            largest=arrays["largest"],
            problems={int(index): text for index, text in given["problems"].items()},
            evaluations=given["evaluations"],
            interrupted=given["interrupted"],
            tol=given["tol"],
        )
        errors = errors.reshape(*shape, times, H.dim)
    # Without tol success is one verdict of all trajectories.
    one = None if toleranced and shape else bool(success.all())
    trajectory = Trajectory(
        t=arrays["t"],
        z=arrays["z"].reshape(*shape, times, H.dim),
        names=H.names,
        success=success.reshape(shape) if one is None else one,
        ensemble=Ensemble(H, arrays["starts"], arrays["parameters"], shape, given["varied"]),
        errors=errors,
        verdicts=found,
        **{name: given[name] for name in _PLAIN},
    )
    _check(trajectory)
    return trajectory


def _check(trajectory: Trajectory) -> None:
    """Raise ValueError unless a trajectory is one that :func:`hamsym.integrate` returns."""
    members, t = trajectory.ensemble, trajectory.t
    H, count, found = members.H, len(members.states), trajectory.verdicts
    H.require_parameters()
    if trajectory.method not in INTEGRATORS:
        raise ValueError(f"'{trajectory.method[:40]}' is not a method")
    if trajectory.names != H.names:
        raise ValueError("its names are not those of H")
    if t.ndim != 1 or not len(t):
        raise ValueError("'t' is not a list of times")
    require_array("t", t, t.shape)
    direction = math.copysign(1.0, trajectory.dt)
    if not (np.diff(t) * direction > 0).all() or not math.isfinite(trajectory.dt * direction):
        raise ValueError("its times are not in order")
    for name in ("steps", "evaluations"):
        if not 0 <= getattr(trajectory, name) < 2**63:
            raise ValueError(f"'{name}' is out of range")
    if not 0 <= trajectory.seconds < math.inf or trajectory.drift < 0:
        raise ValueError("its run time or its drift is out of range")
    if count != math.prod(members.shape):
        raise ValueError("its starts do not have its shape")
    require_array("starts", members.states, (count, H.dim), finite=False)
    require_array("parameters", members.parameters, (count, len(H.parameter_names)))
    _check_parameters(members)
    require_array("z", trajectory.z, (*members.shape, len(t), H.dim), finite=False)
    z = trajectory.z.reshape(count, len(t), H.dim)
    there = np.isfinite(z).all(axis=-1)
    if not (there[:, 1:] <= there[:, :-1]).all():
        raise ValueError("a state is finite after one that is not")
    if not np.array_equal(z[:, 0], members.states, equal_nan=True):
        raise ValueError("it does not begin at its starts")
    success = np.broadcast_to(trajectory.success, members.shape).reshape(-1)
    if not there[success].all():
        raise ValueError("its success is true, but a state is not finite")
    if (found is None) != (trajectory.errors is None):
        raise ValueError("its error estimate does not belong to its verdicts")
    if found is not None and trajectory.errors is not None:
        require_array("error_estimate", trajectory.errors, trajectory.z.shape, finite=False)
        errors = trajectory.errors.reshape(z.shape)
        if not (errors >= 0).all() or not np.isfinite(errors[success]).all():
            raise ValueError("its error estimate is negative, not a number, or not finite")
        if success.tolist() != [index not in found.problems for index in range(count)]:
            raise ValueError("its success contradicts its messages")
        if not (found.steps >= 0).all() or not np.isfinite(found.largest[success]).all():
            raise ValueError("its steps or largest errors are out of range")
        if not 0 < found.tol < math.inf or not (found.largest[success] <= found.tol).all():
            raise ValueError("its success is true, but an error is above its tolerance")
        if not found.problems.keys() <= set(range(count)):
            raise ValueError("a message belongs to no trajectory")


def _check_parameters(members: Ensemble) -> None:
    """Raise ValueError unless H has the parameters of the first member, and only some vary."""
    H, columns = members.H, members.parameters
    if not set(members.varied) <= set(H.parameter_names) or len(set(members.varied)) != len(
        members.varied
    ):
        raise ValueError("a parameter varies that H does not have")
    for k, name in enumerate(H.parameter_names):
        own = columns[:, k] if name not in members.varied else columns[:1, k]
        if not (own == H.parameters[name]).all():
            raise ValueError(f"'{name[:40]}' differs from its value in H")
