"""Files of flow maps."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from hamsym.description import described, hamiltonian_from, read_result, write_result
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.flow_maps.judging import Judgement
from hamsym.flow_maps.time_order import require_order
from hamsym.numerics.lower_sets import MOST_DEGREE
from hamsym.support.checked_data import (
    arrays_of,
    checked_list,
    checked_mapping,
    checked_number,
    checked_record,
    checked_type,
    checked_values,
    numbers_of,
    require_array,
    require_names,
    taken,
)

#: Kind of the file.
KIND = "flow map"

_DEEPEST = 64  # splits and chains inside each other
_PIECES = 1_000_000


_OF_MAP = {
    "span": "tuple[float, float]",
    "tol": "float",
    "success": "bool",
    "message": "str",
    "excess": "float",
    "solutions": "int",
    "seconds": "float",
}
_TYPES = _OF_MAP | {
    "names": "tuple[str, ...]",
    "fixed": "Mapping[str, float]",
    "expressions": "Mapping[str, str]",
    **dict.fromkeys(("H", "judgement", "map"), "Mapping[str, Any]"),
}


def write_flow_map(flow: FlowMap, path: str | os.PathLike[str]) -> None:
    """Write a flow map to one file; see :func:`hamsym.save`."""
    write_result(path, KIND, flow.region.H, flow.region.check, lambda: _parts(flow))


def _parts(flow: FlowMap) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    box, judgement = flow.region, flow.judgement
    arrays = {f"map.{name}": _stored(array) for name, array in flow.map.arrays().items()}
    arrays |= {"low": box.low, "high": box.high, "error_estimate": flow.largest_error}
    arrays |= arrays_of("judgement", judgement)
    return arrays, {
        "H": described(box.H),
        "names": list(box.names),
        "fixed": dict(box.fixed),
        "expressions": dict(box.expressions),
        "judgement": numbers_of(judgement),
        "map": flow.map.describe(),
        **{name: getattr(flow, name) for name in _OF_MAP},
    }


def read_flow_map(path: str | os.PathLike[str]) -> FlowMap:
    """Read a file of a flow map; see :func:`hamsym.load`."""
    return read_result(path, KIND, _assembled)


def _assembled(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> FlowMap:
    found = checked_values("values", values, _TYPES)
    plain = {name: found[name] for name in _OF_MAP}
    H, names = hamiltonian_from(found["H"]), found["names"]
    d, dim = len(names), H.dim
    low, high = arrays.pop("low"), arrays.pop("high")
    for name, array in (("low", low), ("high", high)):
        require_array(name, array, (d,))
    box = Box(H, names, low, high, found["fixed"], found["expressions"])
    box.check()
    error = arrays.pop("error_estimate")
    require_array("error_estimate", error, (dim,), finite=plain["success"])
    judgement = checked_record(Judgement, found["judgement"], taken(arrays, "judgement"))
    for name, shape in (("error", (dim,)), ("linear", (dim,)), ("worst_inputs", (d,))):
        require_array(name, getattr(judgement, name), shape, finite=name == "worst_inputs")
    given = taken(arrays, "map")
    if arrays or len(given) > _PIECES:
        raise ValueError("it has an array that is not a part of a flow map")
    map = _map(found["map"], given, d, dim, _DEEPEST)
    if given:
        raise ValueError(f"'{min(given)[:40]}' is not a part of a flow map")
    require_order(map, plain["span"])
    if plain["success"] and not plain["excess"] <= 1:
        raise ValueError("its success is true, but its error is not within the tolerance")
    return FlowMap(region=box, map=map, largest_error=error, judgement=judgement, **plain)


def _map(form: dict[str, Any], arrays: dict[str, np.ndarray], d: int, dim: int, depth: int) -> Any:
    """Build a map from its description and its arrays, which are removed."""
    if not depth:
        raise ValueError("its map has too many parts inside each other")
    kind = form.get("form")
    if kind == "leg":
        require_names("leg", form, {"form", "begin", "pieces"})
        return _leg(form, arrays, d, dim)
    if kind == "chain":
        require_names("chain", form, {"form", "maps"})
        forms = checked_list("maps", form["maps"])
        joints, kept = arrays.pop("joints"), arrays.pop("kept").astype(int)
        require_array("joints", joints, (len(forms) - 1,))
        if not np.array_equal(kept, np.arange(dim, d)) or len(forms) < 2:
            raise ValueError("its legs do not fit each other")
        maps = [
            _map(checked_mapping("map", part), taken(arrays, str(k)), d, dim, depth - 1)
            for k, part in enumerate(forms)
        ]
        return Chain(maps, joints, kept)
    if kind == "split":
        require_names("split", form, {"form", "threshold", "low", "high"})
        normal = arrays.pop("normal")
        require_array("normal", normal, (d,))
        sides = [
            _map(checked_mapping(side, form[side]), taken(arrays, side), d, dim, depth - 1)
            for side in ("low", "high")
        ]
        return Split(normal, checked_number("threshold", form["threshold"]), *sides)
    raise ValueError(f"its map has the unknown form {str(kind)[:40]}")


def _leg(form: dict[str, Any], arrays: dict[str, np.ndarray], d: int, dim: int) -> Leg:
    count = checked_type("pieces", form["pieces"], "int")
    edges = arrays.pop("edges")
    require_array("edges", edges, (count + 1,))
    own = _domain(arrays, d, dim)
    pieces = []
    for number in range(count):
        piece = taken(arrays, str(number))
        require_names("piece", piece, {"degrees", "readouts", "columns"})
        readouts, columns = piece["readouts"], piece["columns"]
        require_array("readouts", readouts, (len(piece["degrees"]), len(columns)))
        require_array("columns", columns, (len(columns), *columns.shape[1:2], dim))
        pieces.append(CompiledPiece(_degrees(piece["degrees"], d), readouts, columns))
        if not min(*readouts.shape, *columns.shape):
            raise ValueError("a piece of its map is empty")
    return Leg(checked_number("begin", form["begin"]), edges, pieces=pieces, **own)


def _domain(arrays: dict[str, np.ndarray], d: int, dim: int) -> dict[str, np.ndarray]:
    """Remove and return the arrays of scaling and start."""
    shapes = {"scaling": (d, d), "shift": (d,), "selection": (dim, d), "offset": (dim,)}
    own = {name: arrays.pop(name) for name in (*shapes, "start", "start_degrees")}
    for name, shape in shapes.items():
        require_array(name, own[name], shape)
    own["start_degrees"] = _degrees(own["start_degrees"], d)
    require_array("start", own["start"], (len(own["start_degrees"]), dim))
    return own


def _degrees(array: np.ndarray, d: int) -> np.ndarray:
    require_array("degrees", array, (len(array), d), np.uint8)
    if array.size and int(array.max()) > MOST_DEGREE:
        raise ValueError("a degree is too high")
    return array.astype(int)


def _stored(array: np.ndarray) -> np.ndarray:
    """Return whole numbers, which are small, as bytes."""
    return array.astype(np.uint8) if array.dtype.kind == "i" else array
