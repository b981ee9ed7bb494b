"""Files of solutions, of one or of many, of flow maps and trajectories: save and load.

A file is accepted only if it describes exactly a solution that a solver returns: every type, shape,
order and value is checked when it is loaded and when it is saved.
"""

from __future__ import annotations

import math
import os
from types import SimpleNamespace
from typing import Any

import numpy as np

from hamsym.description import described, hamiltonian_from, read_result, write_result
from hamsym.families.solutions import Solutions
from hamsym.families.storage import KIND, is_store, open_store, read_solutions, write_solutions
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.flow_maps.storage import KIND as FLOW_MAP
from hamsym.flow_maps.storage import read_flow_map, write_flow_map
from hamsym.integrators.integrate import Trajectory
from hamsym.integrators.storage import KIND as TRAJECTORY
from hamsym.integrators.storage import read_trajectory, write_trajectory
from hamsym.methods import METHODS, option_names
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
    checked_record,
    checked_values,
    numbers_of,
    require_array,
    taken,
)
from hamsym.support.tensor_files import kind_of

_KIND = "solution"
_PLAIN = {
    "span": "tuple[float, float]",
    "method": "str",
    "energy_weight": "float",
    "success": "bool",
    "message": "str",
}
_TYPES = _PLAIN | dict.fromkeys(("H", "trial"), "Mapping[str, Any]")
_OPTIONAL = dict.fromkeys(("error", "settings"), "Mapping[str, Any]")
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
    write_result(path, _KIND, solution.H, lambda: _check(solution), lambda: parts(solution))


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
    return read_result(path, _KIND, _checked)


def _checked(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Solution:
    solution = assembled(arrays, values)
    _check(solution)
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
    values["settings"] = solution.settings.described()
    return arrays, values


def assembled(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Solution:
    """Build a solution from its :func:`parts`."""
    record_name = next((name for name in ("training", "chain") if name in values), "march")
    present = {name: kind for name, kind in _OPTIONAL.items() if name in values}
    types = _TYPES | {record_name: "Mapping[str, Any]"} | present
    found = checked_values("values", values, types)
    given = dict(arrays)
    z0 = given.pop("z0")
    formula = found["H"]
    dim = len(checked_list("q", formula["q"])) + len(checked_list("p", formula["p"]))
    # The numbers of components and names are compared before anything is built from them.
    require_array("z0", z0, (dim,))
    form, own = found["trial"], taken(given, "trial")
    if form["form"] == "features":
        trial: Any = FeatureTrial.from_description(form, own, dim)
    else:
        networks = _of_networks()
        kind = networks.Chain if form["form"] == "chain" else networks.TrialSolution
        trial = kind.from_description(form, own, dim)
    error = None
    if "error" in found:
        kind = _of_networks().ChainError if record_name == "chain" else MarchError
        error = checked_record(kind, found["error"], taken(given, "error"))
    if record_name == "training":
        history = checked_record(_of_networks().History, {}, taken(given, "history"))
        record: Any = checked_record(
            _of_networks().Training, found[record_name], {"history": history}
        )
    elif record_name == "chain":
        record = checked_record(
            _of_networks().ChainTraining, found[record_name], taken(given, "chain")
        )
    else:
        march = {name: own[name] for name in _IN_TRIAL} | taken(given, "march")
        record = checked_record(March, found["march"], march)
    if given:
        raise ValueError(f"'{min(given)[:40]}' is not a part of a solution")
    settings = Settings.from_description(found["settings"], dim)
    return Solution(
        H=hamiltonian_from(formula),
        z0=z0,
        trial=trial,
        record=record,
        error=error,
        settings=settings,
        **{name: found[name] for name in _PLAIN},
    )


def _of_networks() -> Any:
    """Return the classes of networks, whose modules import torch, which marches do not need."""
    from hamsym.networks.chain import Chain, ChainTraining
    from hamsym.networks.chain_error import ChainError
    from hamsym.networks.record import History, Training
    from hamsym.networks.trial import TrialSolution

    kinds = (Chain, ChainTraining, ChainError, History, Training, TrialSolution)
    return SimpleNamespace(**{kind.__name__: kind for kind in kinds})


def _check(solution: Solution) -> None:
    """Raise ValueError unless a solution is valid."""
    check_definition(solution)
    trial, record, error = solution.trial, solution.record, solution.error
    if not isinstance(solution.success, (bool, np.bool_)):
        raise ValueError("its success is not a bool")
    if not 0 <= solution.energy_weight < math.inf:
        raise ValueError("its energy_weight is negative or not finite")
    marched = isinstance(trial, FeatureTrial)
    if marched != isinstance(record, March):
        raise ValueError("its record does not belong to its trial solution")
    method = METHODS.get(solution.method)
    if method is None or method.marches != marched:
        raise ValueError(f"method '{solution.method}' does not return such a trial solution")
    solution.settings.check({*option_names(method)}, solution.span)
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
