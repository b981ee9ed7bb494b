"""What a sweep over a grid computes at each of its points, as named arrays.

Input:  members of an ensemble, a span, options of the task.
Output: :data:`Columns`, whose arrays have the members along their first axis.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hamsym.dynamics.lyapunov import lyapunov
from hamsym.dynamics.sections import section
from hamsym.errors import HamsymError, InputError, StepSizeWarning
from hamsym.families.many import solve_many
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.observed import observed
from hamsym.problems.problem import checked_span
from hamsym.solution.times import times_in_span
from hamsym.support.suggestions import did_you_mean, unknown

#: Name -> names of the axes after that of the members, and values.
Columns = dict[str, tuple[tuple[str, ...], np.ndarray]]

#: Options of each task.
OPTIONS = {
    "solve": ("t", "tol", "atol", "max_window", "seed", "values"),
    "lyapunov": ("method", "steps", "dt", "count", "seed"),
    "section": ("surface", "method", "steps", "dt", "direction", "crossings"),
}


def checked_options(
    task: Any, options: Mapping[str, Any], span: tuple[float, float], H: Hamiltonian
) -> dict[str, Any]:
    """Return the options of a task with their defaults; formulas in the names of H as text.

    Raise InputError if there is no such task or option, or a formula cannot be used.
    """
    found = dict(options)
    if callable(task):
        name = getattr(task, "__qualname__", "<")
        if "<" in name:  # a lambda, or a function within a function
            raise InputError(
                f"task={task!r} has no name by which a store recognises it; give a function of a "
                "module"
            )
        return found
    if task not in TASKS:
        hint = did_you_mean(task, TASKS)
        raise InputError(f"task={task!r} is unknown{hint}; give {', '.join(TASKS)}, or a function")
    for name in found:
        if name not in OPTIONS[task]:
            kind = f"an option of the task {task!r}"
            raise InputError(unknown(name, OPTIONS[task], kind, "it has"))
    if task == "solve":
        times = np.atleast_1d(found.get("t", checked_span(span)[1]))
        found["t"] = np.atleast_1d(times_in_span(times, checked_span(span)))
        if "values" in found:
            found["values"] = _formulas(H, found["values"])
    if task == "section" and "surface" not in found:
        raise InputError("the task 'section' needs a surface; give surface='x = 0, p_x > 0'")
    return found


def _formulas(H: Hamiltonian, values: Any) -> dict[str, str]:
    """Return named formulas as text."""
    if not isinstance(values, Mapping):
        raise InputError(
            f"values={values!r} is not a mapping; give names with formulas, for example "
            f'{{"kinetic": "{H.names[H.dof]}**2/2"}}'
        )
    for name in values:
        if not (isinstance(name, str) and name.isidentifier()):
            raise InputError(f"{name!r} in values is no name of letters and digits; give one")
    return {name: H.observable(formula).text for name, formula in values.items()}


def computed(
    task: str | Callable[..., Mapping[str, Any]],
    members: Ensemble,
    span: tuple[float, float],
    options: Mapping[str, Any],
) -> Columns:
    """Return the results of members, with ``success``, ``message`` and their starts ``z0``.

    Raises
    ------
    KeyboardInterrupt
        After Ctrl-C.
    """
    function = TASKS[task] if isinstance(task, str) else _called(task)
    found = function(members, span, dict(options))
    return {**found, "z0": (("component",), members.states)}


def _solve(members: Ensemble, span: tuple[float, float], options: dict[str, Any]) -> Columns:
    times, formulas = options.pop("t"), options.pop("values", {})
    many = solve_many(
        members.H, members.states, span, parameters=members.columns, progress=False, **options
    )
    if many.table.stopped == "interrupted":
        raise KeyboardInterrupt
    states, own = many(times), many.own_parameters
    along = () if len(times) == 1 else ("time",)  # one time gives one number for each point
    columns: Columns = {}
    for name, formula in formulas.items():
        (values,) = observed(members.H, [formula], states, times, own).values()
        columns[name] = along, values if along else values[:, 0]
    return columns | {
        "state": (("time", "component"), states),
        "largest_error": (("component",), many.largest_error),
        "excess": ((), many.excess),
        "success": ((), many.success),
        "message": ((), many.message),
    }


def _lyapunov(members: Ensemble, span: tuple[float, float], options: dict[str, Any]) -> Columns:
    found: Any = lyapunov(
        members.H, members.states, span, parameters=members.columns, progress=False, **options
    )
    if found.interrupted:
        raise KeyboardInterrupt
    return {
        "exponent": (("rank",), found.exponents),
        "energy_error": ((), found.energy_error),
        "steps": ((), found.steps),
        "success": ((), found.success),
        "message": ((), found.message),
    }


def _section(members: Ensemble, span: tuple[float, float], options: dict[str, Any]) -> Columns:
    """Find the crossings of each member by itself: steps are chosen for each."""
    found: list[Any] = []
    for k in range(len(members)):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", StepSizeWarning)  # the message has it
                one = section(
                    members.hamiltonian(k), members.states[k], span, progress=False, **options
                )
        except InputError as error:
            if np.isfinite(members.states[k]).all():
                raise
            found.append(str(error))
            continue
        if one.message.endswith("interrupted"):
            raise KeyboardInterrupt
        found.append(one)
    counts = [0 if isinstance(one, str) else len(one.t) for one in found]
    most = options["crossings"]
    t, z = np.full((len(found), most), np.nan), np.full((len(found), most, members.H.dim), np.nan)
    for k, one in enumerate(found):
        if counts[k]:
            t[k, : counts[k]], z[k, : counts[k]] = one.t, one.z
    return {
        "count": ((), np.array(counts)),
        "t": (("crossing",), t),
        "z": (("crossing", "component"), z),
        "drift": ((), np.array([np.nan if isinstance(one, str) else one.drift for one in found])),
        "success": ((), np.array([not isinstance(one, str) and one.success for one in found])),
        "message": (
            (),
            np.array([one if isinstance(one, str) else one.message for one in found], object),
        ),
    }


def _called(task: Callable[..., Mapping[str, Any]]) -> Callable[..., Columns]:
    """Return the task of a function ``(H, z0, span, **options) -> mapping of numbers, arrays``."""

    def called(members: Ensemble, span: tuple[float, float], options: dict[str, Any]) -> Columns:
        found: list[Mapping[str, Any] | str] = []
        for k in range(len(members)):
            try:
                result = task(members.hamiltonian(k), members.states[k], span, **options)
            except HamsymError as error:
                found.append(str(error))
                continue
            if not isinstance(result, Mapping):
                raise InputError(
                    f"the function returned {result!r}; return a mapping of names to numbers or "
                    "arrays"
                )
            found.append({name: np.asarray(value, dtype=float) for name, value in result.items()})
        good = [one for one in found if not isinstance(one, str)]
        columns: Columns = {}
        for name, like in (good[0] if good else {}).items():
            values = np.full((len(found), *like.shape), np.nan)
            for k, one in enumerate(found):
                if not isinstance(one, str):
                    values[k] = one[name]
            columns[name] = tuple(f"{name}_{axis}" for axis in range(like.ndim)), values
        failed = np.array([isinstance(one, str) for one in found])
        messages = np.array([one if isinstance(one, str) else "" for one in found], object)
        return {**columns, "success": ((), ~failed), "message": ((), messages)}

    return called


TASKS: dict[str, Callable[..., Columns]] = {
    "solve": _solve,
    "lyapunov": _lyapunov,
    "section": _section,
}
