"""Solutions in files: what a Solution is made of, as tensors and JSON, and back.

A solution is accepted only if it is exactly what is written: every type, shape, order and value is
looked at, of one that is loaded as of one that is saved or digested.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import sys
from collections.abc import Mapping
from dataclasses import fields
from itertools import pairwise
from typing import Any

import numpy as np
import sympy
import torch
from torch import Tensor

from hamsym.errors import FileError, HamsymError, InputError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.formula.parser import MAX_BITS, MAX_EFFORT, MAX_SECONDS, parse_expression
from hamsym.formula.printer import FormulaPrinter
from hamsym.hamiltonian import Hamiltonian
from hamsym.networks.training import History, Training
from hamsym.networks.trial import ComponentNetworks, Network, TrialSolution
from hamsym.random_features.error_estimate import MarchError
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.solution import Solution
from hamsym.support.tensor_files import one_line, read_tensors, write_tensors

__all__ = ["assembled", "digest", "load", "parts", "save"]

_KIND = "solution"
_METHODS = ("features", "adam", "lbfgs", "levenberg-marquardt")
_LARGEST_POWER = 1_100  # of two, in a number of the formula; float64 ends at 1,024
_MOST_COMPONENTS = 10_000  # a formula has no more parts
# Whatever a damaged value makes a part of this package raise.
_SENSELESS = (
    *(ArithmeticError, AssertionError, AttributeError, HamsymError, LookupError, RuntimeError),
    *(TypeError, ValueError),
)


def save(solution: Solution, path: str | os.PathLike[str]) -> None:
    """Write a solution; see :meth:`hamsym.Solution.save`."""
    try:
        _check(solution)
    except _SENSELESS as error:
        raise FileError(
            f"'{path}' is not written: the solution makes no sense: {one_line(error)}"
        ) from None
    write_tensors(path, _KIND, *parts(solution))


def parts(solution: Solution) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, and values that JSON can hold, from which :func:`assembled` makes it again."""
    tensors = {f"trial.{name}": tensor for name, tensor in solution.trial.state_dict().items()}
    values: dict[str, Any] = {
        "H": _hamiltonian_values(solution.H),
        "span": [float(time) for time in solution.span],
        "method": solution.method,
        "energy_weight": float(solution.energy_weight),
        "success": bool(solution.success),
        "message": solution.message,
        "trial": _trial_values(solution.trial),
    }
    tensors["z0"] = torch.from_numpy(solution.z0)
    record = solution.training
    if isinstance(record, Training):
        values["training"] = _numbers(record)
        tensors |= _arrays("history", record.history)
    else:
        values["march"] = _numbers(record)
        tensors["march.scale"] = torch.from_numpy(record.scale)  # the rest is in the trial solution
    if solution.march_error is not None:
        values["error"] = _numbers(solution.march_error)
        tensors |= _arrays("error", solution.march_error)
    return tensors, values


def load(path: str | os.PathLike[str]) -> Solution:
    """The solution that :meth:`hamsym.Solution.save` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, of another kind or of another version, or holds
        what is no solution.
    """
    tensors, values = read_tensors(path, _KIND)
    try:
        return assembled(tensors, values)
    except _SENSELESS as error:
        raise FileError(
            f"'{path}' holds a solution that makes no sense: {one_line(error)}"
        ) from None


def assembled(tensors: dict[str, Tensor], values: dict[str, Any]) -> Solution:
    """The solution of which these are the :func:`parts`."""
    record_name = "training" if "training" in values else "march"
    names = {"H", "span", "method", "energy_weight", "success", "message", "trial", record_name}
    has_error = "error" in values
    _require_names("values", values, names | {"error"} if has_error else names)
    start, end = (_number("span", time) for time in _list("span", values["span"], 2))
    given = dict(tensors)
    z0 = given.pop("z0").numpy()
    formula = _mapping("H", values["H"])
    dim = len(_list("q", formula["q"])) + len(_list("p", formula["p"]))
    # Of components there are as many as of names, before anything is made of either.
    _require_array("z0", z0, (dim,))
    trial = _trial(values["trial"], _part(given, "trial"), dim)
    error = None
    if has_error:
        error = _record(MarchError, values["error"], _taken(given, "error"))
    record: Training | March
    if record_name == "training":
        history = _record(History, {}, _taken(given, "history"))
        record = _record(Training, values["training"], {"history": history})
    else:
        if not isinstance(trial, FeatureTrial):
            raise ValueError("a network was not marched")
        arrays = {
            "edges": trial.edges.numpy(),
            "states": trial.states.numpy(),
            "readouts": trial.readouts.numpy(),
            **_taken(given, "march"),
        }
        record = _record(March, values["march"], arrays)
    if given:
        raise ValueError(f"'{min(given)[:40]}' is no part of a solution")
    solution = Solution(
        _hamiltonian(formula),
        z0,
        (start, end),
        trial,
        method=_typed("method", values["method"], "str"),
        training=record,
        energy_weight=_number("energy_weight", values["energy_weight"]),
        march_error=error,
    )
    solution.success = _typed("success", values["success"], "bool")
    solution.message = _typed("message", values["message"], "str")
    _check(solution)
    return solution


def digest(solution: Solution) -> str:
    """SHA-256 of what defines a solution as a function: H, z0, the span and the trial solution.

    How it was found, when, and what it said of itself are not part of it. Of the numbers it takes
    the types, the shapes and the bytes as they are.

    Raises
    ------
    InputError
        If the solution is none that a solver makes: a part of it has another type, shape or order,
        is not finite, or contradicts another part.
    """
    try:
        _check_function(solution)
    except _SENSELESS as error:
        raise InputError(f"the solution makes no sense: {one_line(error)}") from None
    values = {
        "version": 2,
        "H": _hamiltonian_values(solution.H),
        "span": [float(time).hex() for time in solution.span],
        "trial": _trial_values(solution.trial),
    }
    text = json.dumps(values, sort_keys=True)
    found = hashlib.sha256(text.encode())
    tensors = {"z0": torch.from_numpy(solution.z0), **solution.trial.state_dict()}
    for name, tensor in sorted(tensors.items()):
        numbers = tensor.detach().contiguous().numpy()
        found.update(f"{name} {numbers.dtype.name} {list(numbers.shape)} ".encode())
        found.update((numbers if sys.byteorder == "little" else numbers.byteswap()).tobytes())
    return found.hexdigest()


# -- what a solution must be -----------------------------------------------------------------------


def _check_function(solution: Solution) -> None:
    """Refuse what does not define a function, with all its parts as a solver makes them."""
    H, z0, trial = solution.H, solution.z0, solution.trial
    start, end = solution.span
    if not (math.isfinite(start) and math.isfinite(end) and start != end):
        raise ValueError("its span is none")
    H.require_parameters()
    _require_array("z0", z0, (H.dim,))
    if isinstance(trial, FeatureTrial):
        state = {name: tensor.numpy() for name, tensor in trial.state_dict().items()}
        _check_windows(state, H.dim)
        origin, edges = state["origin"], state["edges"]
        if origin not in (0, start) or (start, end) != (origin + edges[0], origin + edges[-1]):
            raise ValueError("its span is not that of its windows")
        first = state["states"][0]
    else:
        _check_network(trial, H.dim)
        if trial.t0 != start or not math.copysign(1.0, end - start) * trial.tau > 0:
            raise ValueError("its span is not that of its network")
        first = trial.z0.numpy()
    with np.errstate(over="ignore"):
        if first.tobytes() != z0.astype(first.dtype).tobytes():
            raise ValueError("it does not start at its z0")


def _check(solution: Solution) -> None:
    """Refuse a solution that is not what a solver makes, or whose parts contradict each other."""
    _check_function(solution)
    trial, record, error = solution.trial, solution.training, solution.march_error
    if solution.method not in _METHODS or not isinstance(solution.success, (bool, np.bool_)):
        raise ValueError("its method or its verdict is unknown")
    if not 0 <= solution.energy_weight < math.inf:
        raise ValueError("its energy_weight is no weight")
    if isinstance(record, March):
        if not isinstance(trial, FeatureTrial) or solution.method != "features":
            raise ValueError("a network was not marched")
        _check_march(record, trial)
    else:
        if isinstance(trial, FeatureTrial) or solution.method == "features":
            raise ValueError("windows were not trained")
        _check_training(record)
    if error is not None:
        if not isinstance(trial, FeatureTrial):
            raise ValueError("a network has no error of a march")
        _check_error(error, trial, finite=solution.success)
    elif isinstance(trial, FeatureTrial) and solution.success:
        raise ValueError("its error is missing")
    if solution.success:
        for part in (record, error):
            for name, value in _numbers(part).items() if part is not None else ():
                if isinstance(value, float) and not math.isfinite(value):
                    raise ValueError(f"it is called a success, and its {name} is not finite")


def _check_windows(state: Mapping[str, np.ndarray], dim: int) -> None:
    _require_names("windows", state, {"edges", "states", "readouts", "series", "origin"})
    if state["edges"].size < 2 or not state["series"].size:
        raise ValueError("it has no windows")
    count, columns = state["edges"].size - 1, state["series"].size // FeatureTrial.terms
    _require_array("edges", state["edges"], (count + 1,))
    _require_array("states", state["states"], (count + 1, dim))
    _require_array("readouts", state["readouts"], (count, columns, dim))
    _require_array("series", state["series"], (FeatureTrial.terms, columns))
    _require_array("origin", state["origin"], ())
    with np.errstate(over="ignore"):
        steps = np.diff(state["edges"])
    if not (np.isfinite(steps).all() and ((steps > 0).all() or (steps < 0).all())):
        raise ValueError("its windows are not in order")


def _check_network(trial: TrialSolution, dim: int) -> None:
    parts = _networks(trial)
    outputs = [dim] if isinstance(trial.network, Network) else [1] * dim
    if [part.sizes[-1] for part in parts] != outputs:
        raise ValueError("its networks do not fit together")
    if {(part.sizes[:-1], part.activation, part.frequency) for part in parts} != {
        (parts[0].sizes[:-1], parts[0].activation, parts[0].frequency)
    }:
        raise ValueError("its networks are not alike")
    dtype = trial.z0.numpy().dtype
    if dtype not in (np.float32, np.float64):
        raise ValueError(f"its weights are of type {dtype}")
    _require_array("z0 of the network", trial.z0.numpy(), (dim,), dtype)
    for part in parts:
        _require_array("theta", part.theta.detach().numpy(), (_weights(part.sizes),), dtype)
    if not (math.isfinite(trial.t0) and math.isfinite(trial.tau)):
        raise ValueError("its unit of time is not finite")


def _check_march(record: March, trial: FeatureTrial) -> None:
    for name in ("edges", "states", "readouts"):
        if not np.array_equal(getattr(record, name), getattr(trial, name).numpy()):
            raise ValueError(f"its march has other {name}")
    _require_array("scale", record.scale, record.states[0].shape)
    if (record.scale < 0).any():
        raise ValueError("its scale is below zero")
    if record.origin != trial.origin or record.reached != record.origin + record.edges[-1]:
        raise ValueError("its march reached another time")
    _check_counts(record)


def _check_training(record: Training) -> None:
    history = record.history
    checks = len(history.iteration)
    # A loss that was not finite is part of the record, also of a training that began again.
    for name, dtype, count in (
        ("loss", np.float64, record.iterations),
        ("iteration", np.int64, checks),
        ("fixed_loss", np.float64, checks),
        ("ell_max", np.float64, checks),
        ("seconds", np.float64, checks),
    ):
        _require_array(name, getattr(history, name), (count,), dtype, finite=False)
    _check_counts(record)


def _check_counts(record: March | Training) -> None:
    for name, value in _numbers(record).items():
        if isinstance(value, int) and not 0 <= value < 2**63:
            raise ValueError(f"'{name}' is out of range")


def _check_error(error: MarchError, trial: FeatureTrial, *, finite: bool) -> None:
    """Refuse what is no error of these windows; that of a failure need not be finite."""
    count, _, dim = trial.readouts.shape
    _require_array("edges of the error", error.edges, (count + 1,))
    if not np.array_equal(error.edges, trial.edges.numpy()):
        raise ValueError("its error has other windows")
    if not error.series.size:
        raise ValueError("its error has no series")
    shape = (count, error.series.size // (count * dim), dim)
    _require_array("series of the error", error.series, shape, finite=finite)
    _require_array("floors of the error", error.floors, (count, dim), finite=finite)
    _require_array("largest error", error.largest, (dim,), finite=finite)
    _require_array("scale of the error", error.scale, (dim,))
    _require_array("origin of the error", error.origin, ())
    if error.origin != trial.origin.numpy():
        raise ValueError("its error counts the time from elsewhere")
    if any((sizes < 0).any() for sizes in (error.floors, error.largest, error.scale)):
        raise ValueError("its error has a size below zero")


def _require_names(what: str, found: Mapping[str, Any], wanted: set[str]) -> None:
    different = sorted({*found} ^ wanted)
    if different:
        how = "are missing" if different[0] in wanted else "are not known"
        raise ValueError(f"'{different[0][:40]}' in its {what}: such {how}")


def _require_array(
    name: str,
    array: np.ndarray,
    shape: tuple[int, ...],
    dtype: Any = np.float64,
    *,
    finite: bool = True,
) -> None:
    if not isinstance(array, np.ndarray) or array.dtype != dtype:
        raise ValueError(f"'{name}' is not of type {np.dtype(dtype)}")
    if array.shape != shape:
        raise ValueError(f"its parts do not fit together: '{name}' has shape {array.shape}")
    if finite and not np.isfinite(array).all():
        raise ValueError(f"'{name}' is not finite")


# -- values ----------------------------------------------------------------------------------------

_TYPES: dict[str, tuple[type, ...]] = {
    "bool": (bool,),
    "int": (int,),
    "float": (int, float),
    "str": (str,),
    "None": (type(None),),
}


def _typed(name: str, value: Any, wanted: str) -> Any:
    """A value of JSON, if it has one of the types of an annotation such as ``int | None``."""
    for kind in wanted.split(" | "):
        if isinstance(value, _TYPES.get(kind, ())) and isinstance(value, bool) == (kind == "bool"):
            if kind == "float" and isinstance(value, int) and abs(value) >= 2**1_023:
                raise ValueError(f"'{name}' is too large a number")
            return float(value) if kind == "float" else value  # type: ignore[arg-type]
    raise ValueError(f"'{name}' is no {wanted}")


def _number(name: str, value: Any) -> float:
    number: float = _typed(name, value, "float")
    if not math.isfinite(number):
        raise ValueError(f"'{name}' is not finite")
    return number


def _list(name: str, value: Any, count: int | None = None) -> list[Any]:
    if not isinstance(value, (list, tuple)) or len(value) > _MOST_COMPONENTS:
        raise ValueError(f"'{name}' is no list, or a long one")
    if count is not None and len(value) != count:
        raise ValueError(f"'{name}' has not {count} entries")
    return list(value)


def _mapping(name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ValueError(f"'{name}' is no mapping")
    return value


def _record(kind: type, numbers: Any, arrays: Mapping[str, Any]) -> Any:
    """A dataclass from its numbers, each of the type that its field has, and its arrays."""
    types = {field.name: field.type for field in fields(kind)}
    _mapping(kind.__name__, numbers)
    _require_names(kind.__name__, {**numbers, **arrays}, {*types})
    typed = {name: _typed(name, value, str(types[name])) for name, value in numbers.items()}
    return kind(**typed, **arrays)


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    """Tensors whose names begin so, taken out."""
    start = prefix + "."
    names = [name for name in tensors if name.startswith(start)]
    return {name.removeprefix(start): tensors.pop(name) for name in names}


def _taken(tensors: dict[str, Tensor], prefix: str) -> dict[str, np.ndarray]:
    return {name: tensor.numpy() for name, tensor in _part(tensors, prefix).items()}


def _numbers(record: Any) -> dict[str, Any]:
    """Fields of a dataclass that JSON can hold."""
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    plain = {n: v.item() if isinstance(v, np.generic) else v for n, v in known.items()}
    return {n: v for n, v in plain.items() if isinstance(v, (bool, int, float, str, type(None)))}


def _arrays(prefix: str, record: Any) -> dict[str, Tensor]:
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    return {
        f"{prefix}.{name}": torch.from_numpy(v)
        for name, v in known.items()
        if isinstance(v, np.ndarray)
    }


# -- the trial solution ----------------------------------------------------------------------


def _networks(trial: TrialSolution) -> list[Network]:
    whole = trial.network
    parts = list(whole.networks) if isinstance(whole, ComponentNetworks) else [whole]
    if not parts or not all(isinstance(part, Network) for part in parts):
        raise ValueError("its networks are none")
    return [part for part in parts if isinstance(part, Network)]


def _weights(sizes: tuple[int, ...]) -> int:
    return sum((inputs + 1) * neurons for inputs, neurons in pairwise(sizes))


def _trial_values(trial: TrialSolution | FeatureTrial) -> dict[str, Any]:
    if isinstance(trial, FeatureTrial):
        return {"form": "features"}
    first = _networks(trial)[0]
    return {
        "form": "network",
        "shared": isinstance(trial.network, Network),
        "sizes": first.sizes,
        "activation": first.activation,
        "frequency": None if first.frequency is None else float(first.frequency),
        "t0": trial.t0,
        "tau": trial.tau,
        "envelope": trial.envelope,
    }


def _trial(
    values: dict[str, Any], state: dict[str, Tensor], dim: int
) -> TrialSolution | FeatureTrial:
    """The trial solution, whose sizes are compared with what is stored before it is built."""
    if values["form"] == "features":
        _require_names("trial solution", values, {"form"})
        _check_windows({name: tensor.numpy() for name, tensor in state.items()}, dim)
        return FeatureTrial(**state)
    names = {"form", "shared", "sizes", "activation", "frequency", "t0", "tau", "envelope"}
    _require_names("trial solution", values, names)
    shared = _typed("shared", values["shared"], "bool")
    sizes = tuple(_typed("sizes", size, "int") for size in _list("sizes", values["sizes"]))
    frequency = _typed("frequency", values["frequency"], "float | None")
    if frequency is not None and not 0 < frequency < math.inf:
        raise ValueError("its frequency is none")
    outputs = dim if shared else 1
    keys = ["network.theta"] if shared else [f"network.networks.{k}.theta" for k in range(dim)]
    _require_names("network", state, {"z0", *keys})
    if len(sizes) < 3 or min(sizes) < 1 or sizes[0] != 1 or sizes[-1] != outputs:
        raise ValueError("its networks do not fit together")
    z0, weights = state["z0"], _weights(sizes)
    for key in keys:
        if state[key].shape != (weights,) or state[key].dtype != z0.dtype:
            raise ValueError(f"its networks do not fit together: {key} is not what its sizes say")

    def network() -> Network:
        return Network(
            outputs,
            sizes[1:-1],
            values["activation"],
            frequency=frequency,
            generator=torch.Generator(),
            dtype=z0.dtype,
        )

    if z0.dtype not in (torch.float32, torch.float64) or z0.shape != (dim,):
        raise ValueError("its networks are of another type or dimension")
    trial = TrialSolution(
        network() if shared else ComponentNetworks([network() for _ in range(dim)]),
        z0,
        t0=_number("t0", values["t0"]),
        tau=_number("tau", values["tau"]),
        envelope=values["envelope"],
    )
    trial.load_state_dict(state)
    trial.requires_grad_(False)
    return trial


# -- the Hamiltonian -------------------------------------------------------------------------


def _hamiltonian_values(H: Hamiltonian) -> dict[str, Any]:
    """H as text. Binary fractions stand apart, since text is read as exact decimals."""
    taken = {symbol.name for symbol in H.expr.free_symbols} | set(H.names)
    floats, names = sorted(H.expr.atoms(sympy.Float), key=str), []
    for position in range(len(floats)):
        name = f"number{position}"
        while name in taken:
            name += "_"
        names.append(name)
    marked = H.expr.xreplace(dict(zip(floats, map(sympy.Symbol, names), strict=True)))
    values = {
        "formula": FormulaPrinter()(marked),
        "floats": {
            name: [int(number._mpf_[0]), str(number._mpf_[1]), int(number._mpf_[2]), number._prec]
            for name, number in zip(names, floats, strict=True)
        },
        "q": [symbol.name for symbol in H.q],
        "p": [symbol.name for symbol in H.p],
        "parameters": dict(H.parameters),
    }
    try:
        same = _hamiltonian(values) == H
    except _SENSELESS:
        same = False
    if not same:
        raise FileError("this Hamiltonian cannot be written as text; it cannot be saved")
    return values


def _hamiltonian(values: dict[str, Any]) -> Hamiltonian:
    _require_names("H", values, {"formula", "floats", "q", "p", "parameters"})
    floats, parameters = (_mapping(name, values[name]) for name in ("floats", "parameters"))
    expr = parse_expression(values["formula"])
    symbols = {symbol.name: symbol for symbol in expr.free_symbols}
    if not floats.keys() <= symbols.keys():
        raise ValueError("its formula lacks one of its numbers")
    numbers = {symbols[name]: _float(*_list(name, number, 4)) for name, number in floats.items()}
    try:
        with call_limit(MAX_EFFORT, MAX_SECONDS):
            expr = _with_numbers(expr, numbers)
    except CallLimitExceededError:
        raise ValueError("its formula takes too long to read") from None
    names = [[_typed("name", name, "str") for name in _list(of, values[of])] for of in ("q", "p")]
    numbers_of = {name: _number(name, value) for name, value in parameters.items()}
    return Hamiltonian(expr, q=names[0], p=names[1], parameters=numbers_of)


def _float(sign: Any, mantissa: Any, exponent: Any, precision: Any) -> sympy.Float:
    """A binary fraction from what it is made of, none of it large enough to take long."""
    plain = isinstance(mantissa, str) and mantissa.isascii() and mantissa.isdigit()
    if _typed("sign", sign, "int") not in (0, 1) or not plain or len(mantissa) > MAX_BITS:
        raise ValueError("a number of its formula is none")
    digits = int(mantissa)
    size = digits.bit_length()
    if not (
        0 < _typed("precision", precision, "int") <= MAX_BITS
        and size <= MAX_BITS
        and abs(_typed("exponent", exponent, "int") + size) <= _LARGEST_POWER
    ):
        raise ValueError("a number of its formula is out of range")
    return sympy.Float((sign, digits, exponent, size), precision=precision)


def _with_numbers(expr: sympy.Expr, numbers: Mapping[sympy.Symbol, sympy.Float]) -> sympy.Expr:
    """``expr.xreplace(numbers)``, each constant of it checked before the next is made of it.

    As in the parser: a tower such as exp(exp(exp(9.5))) would be evaluated otherwise.
    """
    if expr in numbers:
        return numbers[expr]
    replaced = [_with_numbers(argument, numbers) for argument in expr.args]
    if all(new is old for new, old in zip(replaced, expr.args, strict=True)):
        return expr
    expr = expr.func(*replaced)
    for part in (expr, *expr.args):
        if not part.free_symbols:
            value = part.evalf(17)
            if (not value.is_Float and not value.is_Rational) or abs(value) > 1e308:
                raise ValueError("a number of its formula is not finite")
    return expr
