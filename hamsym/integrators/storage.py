"""Files of trajectories."""

from __future__ import annotations

import math
import os
from typing import Any

import numpy as np

from hamsym.description import MALFORMED, described, hamiltonian_from
from hamsym.ensemble import Ensemble
from hamsym.errors import FileError
from hamsym.integrators.integrate import Trajectory
from hamsym.integrators.table import INTEGRATORS
from hamsym.integrators.tolerance import Tolerated
from hamsym.support.checked_data import (
    checked_list,
    checked_mapping,
    checked_number,
    checked_type,
    require_array,
    require_names,
)
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors

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
_ARRAYS = {"t", "z", "starts", "parameters", "success"}
_OF_TOLERANCE = {"error_estimate", "largest", "steps"}
_MOST_MEMBERS = 2**40


def write_trajectory(trajectory: Trajectory, path: str | os.PathLike[str]) -> None:
    """Write a trajectory, or those of an ensemble, to one file; see :func:`hamsym.save`.

    Raise FileError if the file cannot be written, or the trajectory is not valid.
    """
    try:
        _check(trajectory)
        same = hamiltonian_from(described(trajectory.ensemble.H)) == trajectory.ensemble.H
    except MALFORMED as error:
        raise FileError(
            f"'{path}' was not written, because the trajectory is not valid: {one_line(error)}"
        ) from None
    if not same:
        raise FileError(f"'{path}' is not written: H has no formula that is read back as it is")
    members, found = trajectory.ensemble, trajectory.verdicts
    count = len(members)
    arrays = {
        "t": trajectory.t,
        "z": trajectory.z.reshape(count, len(trajectory.t), -1),
        "starts": members.states,
        "parameters": members.parameters,
        "success": np.array(
            np.broadcast_to(trajectory.success, members.shape), dtype=np.uint8
        ).reshape(-1),
    }
    values: dict[str, Any] = {
        "H": described(members.H),
        "shape": list(members.shape),
        "varied": list(members.varied),
        **{name: _json(getattr(trajectory, name)) for name in _PLAIN},
    }
    if found is not None and trajectory.error_estimate is not None:
        arrays["error_estimate"] = trajectory.error_estimate.reshape(arrays["z"].shape)
        arrays["largest"], arrays["steps"] = found.largest, found.steps.astype(np.int64)
        values["tol"] = float(found.tol)
        values["problems"] = {str(index): text for index, text in found.problems.items()}
    write_tensors(path, KIND, arrays, values)


def _json(value: Any) -> Any:
    return value.item() if isinstance(value, np.generic) else value


def read_trajectory(path: str | os.PathLike[str]) -> Trajectory:
    """Read a file that :func:`write_trajectory` wrote.

    Raise FileError if the file cannot be read, is damaged or not valid.
    """
    arrays, values = read_tensors(path, KIND)
    try:
        trajectory = _assembled(arrays, values)
        _check(trajectory)
    except MALFORMED as error:
        raise FileError(
            f"'{path}' is not a valid file of a trajectory: {one_line(error)}"
        ) from None
    return trajectory


def _assembled(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Trajectory:
    toleranced = "problems" in values
    require_names("arrays", arrays, _ARRAYS | _OF_TOLERANCE if toleranced else _ARRAYS)
    own = {"H", "shape", "varied", *_PLAIN}
    require_names("values", values, own | {"problems", "tol"} if toleranced else own)
    plain = {name: checked_type(name, values[name], kind) for name, kind in _PLAIN.items()}
    H = hamiltonian_from(checked_mapping("H", values["H"]))
    shape = tuple(checked_type("shape", n, "int") for n in checked_list("shape", values["shape"]))
    if not all(0 <= n < _MOST_MEMBERS for n in shape) or len(shape) > 32:
        raise ValueError("its shape is not that of an array")
    count, times = math.prod(shape), arrays["t"].size
    varied = tuple(
        checked_type("varied", name, "str") for name in checked_list("varied", values["varied"])
    )
    require_array("success", arrays["success"], (count,), np.uint8)
    if not (arrays["success"] <= 1).all():
        raise ValueError("its success is neither true nor false")
    success = arrays["success"].astype(bool)
    members = Ensemble(H, arrays["starts"], arrays["parameters"], shape, varied)
    path_shape = (count, times, H.dim)
    require_array("z", arrays["z"], path_shape, finite=False)
    found = errors = None
    if toleranced:
        errors = arrays["error_estimate"]
        require_array("error_estimate", errors, path_shape, finite=False)
        require_array("largest", arrays["largest"], (count,), finite=False)
        require_array("steps", arrays["steps"], (count,), np.int64)
        texts = checked_mapping("problems", values["problems"])
        problems = {int(index): checked_type("problem", t, "str") for index, t in texts.items()}
        found = Tolerated(
            z=arrays["z"],
            errors=errors,
            success=success,
            steps=arrays["steps"],
            largest=arrays["largest"],
            problems=problems,
            evaluations=plain["evaluations"],
            interrupted=plain["interrupted"],
            tol=checked_number("tol", values["tol"]),
        )
        errors = errors.reshape(*shape, times, H.dim)
    # Without tol success is one verdict of all trajectories.
    one = None if toleranced and shape else bool(success.all())
    return Trajectory(
        t=arrays["t"],
        z=arrays["z"].reshape(*shape, times, H.dim),
        names=H.names,
        success=success.reshape(shape) if one is None else one,
        ensemble=members,
        error_estimate=errors,
        verdicts=found,
        **plain,
    )


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
    if (found is None) != (trajectory.error_estimate is None):
        raise ValueError("its error estimate does not belong to its verdicts")
    if found is not None and trajectory.error_estimate is not None:
        require_array("error_estimate", trajectory.error_estimate, trajectory.z.shape, finite=False)
        errors = trajectory.error_estimate.reshape(z.shape)
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
