"""Files of solutions, of one or of many, of flow maps and trajectories: save and load.

A file is accepted only if it describes exactly a solution that a solver returns: every type, shape,
order and value is checked when it is loaded and when it is saved.
"""

from __future__ import annotations

import math
import os
from dataclasses import fields
from typing import Any

import numpy as np

from hamsym.description import MALFORMED, described, hamiltonian_from
from hamsym.errors import FileError
from hamsym.families.solutions import Solutions
from hamsym.families.storage import KIND, is_store, open_store, read_solutions, write_solutions
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.flow_maps.storage import KIND as FLOW_MAP
from hamsym.flow_maps.storage import read_flow_map, write_flow_map
from hamsym.integrators.integrate import Trajectory
from hamsym.integrators.storage import KIND as TRAJECTORY
from hamsym.integrators.storage import read_trajectory, write_trajectory
from hamsym.methods import METHODS
from hamsym.random_features.error_estimate import MarchError
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.digest import check_definition
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution
from hamsym.suggestions import checked_keywords
from hamsym.support.checked_data import (
    arrays_of,
    checked_list,
    checked_mapping,
    checked_number,
    checked_record,
    checked_type,
    numbers_of,
    require_array,
    require_names,
    taken,
)
from hamsym.support.tensor_files import kind_of, one_line, read_tensors, write_tensors

_KIND = "solution"
# Arrays of a march that are also arrays of its trial solution, and are stored once.
_IN_TRIAL = ("edges", "states", "readouts")


@checked_keywords
def save(
    solution: Solution | Solutions | FlowMap | Trajectory, path: str | os.PathLike[str]
) -> None:
    """Write a solution, or many, a flow map or a trajectory to a file that :func:`load` reads.

    Parameters
    ----------
    solution : Solution, Solutions, FlowMap or Trajectory
    path : path-like
        File in the safetensors format, replaced in one step.

    Raises
    ------
    FileError
        If the file cannot be written, or the solution is invalid.
    InputError
        If its network is a module of the caller's, whose code is not data.

    Examples
    --------
    >>> import hamsym, tempfile
    >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(solution, folder + "/circle.hamsym")
    ...     again = load(folder + "/circle.hamsym")
    >>> bool((again([1.0, 2.0]) == solution([1.0, 2.0])).all())
    True
    """
    if isinstance(solution, Solutions):
        write_solutions(solution, path)
        return
    if isinstance(solution, FlowMap):
        write_flow_map(solution, path)
        return
    if isinstance(solution, Trajectory):
        write_trajectory(solution, path)
        return
    try:
        _check(solution)
    except MALFORMED as error:
        raise FileError(
            f"'{path}' was not written, because the solution is not valid: {one_line(error)}"
        ) from None
    arrays, values = parts(solution)
    try:
        same = hamiltonian_from(values["H"]) == solution.H
    except MALFORMED:
        same = False
    if not same:
        raise FileError(f"'{path}' is not written: H has no formula that is read back as it is")
    write_tensors(path, _KIND, arrays, values)


@checked_keywords
def load(path: str | os.PathLike[str]) -> Any:
    """Read what :func:`save`, or ``save`` of a result, wrote.

    Parameters
    ----------
    path : path-like
        A file, or a store of zarr of :func:`hamsym.solve_many`.

    Returns
    -------
    Solution, Solutions, FlowMap or Trajectory
        The windows of a store are read when they are needed.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, has another kind or version, or is not valid.
    """
    if is_store(path):
        return open_store(path)
    kind = kind_of(path)
    if kind == FLOW_MAP:
        return read_flow_map(path)
    if kind == TRAJECTORY:
        return read_trajectory(path)
    return read_solutions(path) if kind == KIND else load_solution(path)


def load_solution(path: str | os.PathLike[str]) -> Solution:
    """Read a file of one solution; see :func:`load`."""
    arrays, values = read_tensors(path, _KIND)
    try:
        solution = assembled(arrays, values)
        _check(solution)
    except MALFORMED as error:
        raise FileError(f"'{path}' is not a valid solution file: {one_line(error)}") from None
    return solution


def parts(solution: Solution) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Return the arrays and JSON values from which :func:`assembled` builds the solution."""
    record, error = solution.record, solution.error
    arrays = {f"trial.{name}": array for name, array in solution.trial.arrays().items()}
    arrays["z0"] = solution.z0
    values: dict[str, Any] = {
        "H": described(solution.H),
        "span": [float(time) for time in solution.span],
        "method": solution.method,
        "energy_weight": float(solution.energy_weight),
        "success": bool(solution.success),
        "message": solution.message,
        "trial": solution.trial.describe(),
    }
    if isinstance(record, March):
        values["march"] = numbers_of(record)
        own = arrays_of("march", record)
        arrays |= {n: a for n, a in own.items() if n.partition(".")[2] not in _IN_TRIAL}
    elif record.history is record:
        values["chain"] = numbers_of(record)
        arrays |= arrays_of("chain", record)
    else:
        values["training"] = numbers_of(record)
        arrays |= arrays_of("history", record.history)
    if error is not None:
        values["error"] = numbers_of(error)
        arrays |= arrays_of("error", error)
    if solution.settings is not None:
        values["settings"] = solution.settings.described()
    return arrays, values


def assembled(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Solution:
    """Build a solution from its :func:`parts`."""
    record_name = next((name for name in ("training", "chain") if name in values), "march")
    names = {"H", "span", "method", "energy_weight", "success", "message", "trial", record_name}
    has_error = "error" in values
    require_names("values", values, names | ({"error", "settings"} & values.keys()))
    start, end = (checked_number("span", time) for time in checked_list("span", values["span"], 2))
    given = dict(arrays)
    z0 = given.pop("z0")
    formula = checked_mapping("H", values["H"])
    dim = len(checked_list("q", formula["q"])) + len(checked_list("p", formula["p"]))
    # The numbers of components and names are compared before anything is built from them.
    require_array("z0", z0, (dim,))
    form, own = checked_mapping("trial", values["trial"]), taken(given, "trial")
    if form["form"] == "features":
        trial: Any = FeatureTrial.from_description(form, own, dim)
    else:
        trial = _network_trial(form, own, dim)
    error = None
    if has_error:
        kind = _error_of_chain() if record_name == "chain" else MarchError
        error = checked_record(kind, values["error"], taken(given, "error"))
    if record_name == "training":
        record: Any = _training(values["training"], taken(given, "history"))
    elif record_name == "chain":
        record = _training_of_chain(values["chain"], taken(given, "chain"))
    else:
        march = {name: own[name] for name in _IN_TRIAL} | taken(given, "march")
        record = checked_record(March, values["march"], march)
    if given:
        raise ValueError(f"'{min(given)[:40]}' is not a part of a solution")
    method = checked_type("method", values["method"], "str")
    settings = Settings.from_description(values["settings"], dim) if "settings" in values else None
    return Solution(
        H=hamiltonian_from(formula),
        z0=z0,
        span=(start, end),
        trial=trial,
        method=method,
        record=record,
        error=error,
        energy_weight=checked_number("energy_weight", values["energy_weight"]),
        success=checked_type("success", values["success"], "bool"),
        message=checked_type("message", values["message"], "str"),
        settings=settings,
    )


def _network_trial(form: dict[str, Any], arrays: dict[str, np.ndarray], dim: int) -> Any:
    # Imports torch, which marches do not need.
    from hamsym.networks.chain import Chain
    from hamsym.networks.trial import TrialSolution

    kind = Chain if form["form"] == "chain" else TrialSolution
    return kind.from_description(form, arrays, dim)


def _training(numbers: Any, history: dict[str, np.ndarray]) -> Any:
    from hamsym.networks.record import History, Training

    return checked_record(Training, numbers, {"history": checked_record(History, {}, history)})


def _training_of_chain(numbers: Any, arrays: dict[str, np.ndarray]) -> Any:
    from hamsym.networks.chain import ChainTraining

    return checked_record(ChainTraining, numbers, arrays)


def _error_of_chain() -> type:
    from hamsym.networks.chain_error import ChainError

    return ChainError


def _check(solution: Solution) -> None:
    """Raise ValueError unless a solution is valid."""
    check_definition(solution)
    trial, record, error = solution.trial, solution.record, solution.error
    if not isinstance(solution.success, (bool, np.bool_)):
        raise ValueError("its success is not a bool")
    if not 0 <= solution.energy_weight < math.inf:
        raise ValueError("its energy_weight is not a finite number from 0")
    marched = isinstance(trial, FeatureTrial)
    if marched != isinstance(record, March):
        raise ValueError("its record does not belong to its trial solution")
    method = METHODS.get(solution.method)
    if method is None or method.marches != marched:
        raise ValueError(f"method '{solution.method}' does not return such a trial solution")
    if solution.settings is not None:
        solution.settings.check({entry.name for entry in fields(method.options)}, solution.span)
    record.check(trial)
    windows = record.edges is not None
    if error is not None:
        if not windows or marched != isinstance(error, MarchError):
            raise ValueError("its error estimate is that of another method")
        error.check(trial, finite=solution.success)
    elif windows and solution.success:
        raise ValueError("its error estimate is missing")
    if solution.success:
        for part in (record, error):
            for name, value in numbers_of(part).items() if part is not None else ():
                if isinstance(value, float) and not math.isfinite(value):
                    raise ValueError(f"its success is true, but its {name} is not finite")
