"""Solutions in files: what a Solution is made of, as tensors and JSON, and back."""

from __future__ import annotations

import hashlib
import json
import os
from dataclasses import fields
from typing import Any

import numpy as np
import sympy
import torch
from torch import Tensor

from hamsym.errors import FileError, InputError
from hamsym.estimates import MarchError
from hamsym.features import FeatureTrial, March
from hamsym.files import read_tensors, write_tensors
from hamsym.hamiltonian import Hamiltonian
from hamsym.parsing import parse_expression
from hamsym.printing import FormulaPrinter
from hamsym.solution import Solution
from hamsym.training import History, Training
from hamsym.trial import ComponentNetworks, Network, TrialSolution

__all__ = ["assembled", "digest", "load", "parts", "save"]

_KIND = "solution"


def save(solution: Solution, path: str | os.PathLike[str]) -> None:
    """Write a solution; see :meth:`hamsym.Solution.save`."""
    write_tensors(path, _KIND, *parts(solution))


def parts(solution: Solution) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Tensors, and values that JSON can hold, from which :func:`assembled` makes it again."""
    tensors = {f"trial.{name}": tensor for name, tensor in solution.trial.state_dict().items()}
    values: dict[str, Any] = {
        "H": _hamiltonian_values(solution.H),
        "span": solution.span,
        "method": solution.method,
        "energy_weight": solution.energy_weight,
        "success": solution.success,
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
        tensors |= _arrays("error", solution.march_error)
    return tensors, values


def load(path: str | os.PathLike[str]) -> Solution:
    """The solution that :meth:`hamsym.Solution.save` wrote.

    Raises
    ------
    FileError
        If the file cannot be read, is damaged, of another kind or of a later version.
    """
    tensors, values = read_tensors(path, _KIND)
    try:
        return assembled(tensors, values)
    except (KeyError, TypeError, ValueError, IndexError, RuntimeError, AttributeError) as error:
        raise FileError(f"'{path}' holds a solution that makes no sense: {error}") from None


def assembled(tensors: dict[str, Tensor], values: dict[str, Any]) -> Solution:
    """The solution of which these are the :func:`parts`."""
    state = _part(tensors, "trial")
    start, end = (float(time) for time in values["span"])
    error = None
    if any(name.startswith("error.") for name in tensors):
        error = MarchError(**{k: v.numpy() for k, v in _part(tensors, "error").items()})
    record: Training | March
    if "training" in values:
        history = {k: v.numpy() for k, v in _part(tensors, "history").items()}
        record = Training(history=History(**history), **values["training"])
    else:
        record = March(
            edges=state["edges"].numpy(),
            states=state["states"].numpy(),
            readouts=state["readouts"].numpy(),
            scale=tensors["march.scale"].numpy(),
            **values["march"],
        )
    solution = Solution(
        _hamiltonian(values["H"]),
        tensors["z0"].numpy(),
        (start, end),
        _trial(values["trial"], state),
        method=str(values["method"]),
        training=record,
        energy_weight=float(values["energy_weight"]),
        march_error=error,
    )
    if solution.z0.shape != (solution.H.dim,) or solution(start).shape != solution.z0.shape:
        raise ValueError("its parts are of different dimensions")
    solution.success, solution.message = bool(values["success"]), str(values["message"])
    return solution


def digest(solution: Solution) -> str:
    """SHA-256 of what defines a solution as a function: H, z0, the span and the trial solution.

    How it was found, when, and what it said of itself are not part of it.
    """
    values = {
        "H": _hamiltonian_values(solution.H),
        "span": [float(time).hex() for time in solution.span],
        "trial": _trial_values(solution.trial),
    }
    text = json.dumps(values, sort_keys=True)
    found = hashlib.sha256(text.encode())
    tensors = {"z0": torch.from_numpy(solution.z0), **solution.trial.state_dict()}
    for name, tensor in sorted(tensors.items()):
        shape = list(tensor.shape)
        found.update(f"{name} {tensor.dtype} {shape} ".encode())
        found.update(tensor.detach().contiguous().numpy().astype(">f8").tobytes())
    return found.hexdigest()


def _part(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    start = prefix + "."
    return {
        name.removeprefix(start): tensor
        for name, tensor in tensors.items()
        if name.startswith(start)
    }


def _numbers(record: Any) -> dict[str, Any]:
    """Fields of a dataclass that JSON can hold."""
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    return {name: v for name, v in known.items() if isinstance(v, (bool, int, float, str))}


def _arrays(prefix: str, record: Any) -> dict[str, Tensor]:
    known = {field.name: getattr(record, field.name) for field in fields(record)}
    return {
        f"{prefix}.{name}": torch.from_numpy(v)
        for name, v in known.items()
        if isinstance(v, np.ndarray)
    }


# -- the trial solution ----------------------------------------------------------------------


def _trial_values(trial: TrialSolution | FeatureTrial) -> dict[str, Any]:
    if isinstance(trial, FeatureTrial):
        return {"form": "features"}
    network = trial.network
    parts = list(network.networks) if isinstance(network, ComponentNetworks) else [network]
    first = parts[0]
    assert isinstance(first, Network)
    return {
        "form": "network",
        "shared": isinstance(network, Network),
        "sizes": first.sizes,
        "activation": first.activation,
        "frequency": first.frequency,
        "t0": trial.t0,
        "tau": trial.tau,
        "envelope": trial.envelope,
    }


def _trial(values: dict[str, Any], state: dict[str, Tensor]) -> TrialSolution | FeatureTrial:
    if values["form"] == "features":
        count, _, dim = state["readouts"].shape
        edges, states = state["edges"].shape, state["states"].shape
        if edges != (count + 1,) or states != (count + 1, dim):
            raise ValueError("its windows do not fit together")
        return FeatureTrial(**state)
    z0 = state["z0"]

    def network(outputs: int) -> Network:
        hidden = tuple(int(width) for width in values["sizes"][1:-1])
        return Network(
            outputs,
            hidden,
            values["activation"],
            frequency=values["frequency"],
            generator=torch.Generator(),
            dtype=z0.dtype,
        )

    whole = (
        network(len(z0))
        if values["shared"]
        else ComponentNetworks([network(1) for _ in range(len(z0))])
    )
    trial = TrialSolution(
        whole, z0, t0=values["t0"], tau=values["tau"], envelope=values["envelope"]
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
    except InputError:
        same = False
    if not same:
        raise FileError("this Hamiltonian cannot be written as text; it cannot be saved")
    return values


def _hamiltonian(values: dict[str, Any]) -> Hamiltonian:
    expr = parse_expression(values["formula"])
    numbers = {}
    for name, (sign, mantissa, exponent, precision) in values["floats"].items():
        digits = int(mantissa)
        numbers[name] = sympy.Float(
            (int(sign), digits, int(exponent), digits.bit_length()), precision=int(precision)
        )
    known = {symbol: numbers[symbol.name] for symbol in expr.free_symbols if symbol.name in numbers}
    return Hamiltonian(
        expr.xreplace(known),
        q=values["q"],
        p=values["p"],
        parameters=values["parameters"],
    )
