"""Export of a flow map to one module that needs only numpy."""

from __future__ import annotations

import base64
import importlib.resources
import json
import os
from typing import Any

import numpy as np

from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.support.atomic import write_file

_WIDTH = 100  # characters of a line of numbers


def export_flow_map(flow: Any, path: str | os.PathLike[str]) -> None:
    """Write a module with ``state(t, inputs)`` and ``jacobian(t, inputs)``; see FlowMap.export.

    Raise FileError if the file cannot be written.
    """
    write_file(path, module_text(flow).encode())


def module_text(flow: Any) -> str:
    """Return the text of the module of a FlowMap."""
    folder = importlib.resources.files("hamsym.flow_maps")
    code = folder.joinpath("expansion.py").read_text("utf-8").split("import numpy as np\n", 1)[1]
    numbers: list[np.ndarray] = []
    form = _form(flow.map, numbers)
    data = base64.b64encode(b"".join(array.tobytes() for array in numbers)).decode()
    lines = "\n".join(f'    "{data[k : k + _WIDTH]}"' for k in range(0, len(data), _WIDTH))
    start, end = flow.span
    head = "\n".join(flow.facts.header())
    return f'''"""Trajectories of a Hamiltonian system, for all starts in a box.

{head}

``state(t, inputs)`` returns ({", ".join(flow.H.names)}) at times t from {start!r} to {end!r},
shape (n,). The inputs have shape (n, {len(flow.inputs)}), with columns {", ".join(flow.inputs)}.

Made by hamsym {_version()}; needs only numpy.
"""

import base64

import numpy as np
{code}

def _array(shape, kind):
    global _place
    dtype = np.dtype("<f8" if kind == "f" else "u1")
    count = int(np.prod(shape))
    values = np.frombuffer(_DATA, dtype, count, _place).reshape(shape)
    _place += count * dtype.itemsize
    return values.astype(float if kind == "f" else int)


def _built(form):
    arrays = {{name: _array(*given) for name, given in form["arrays"]}}
    if form["form"] == "leg":
        pieces = [Piece(*(_array(*given) for given in piece)) for piece in form["pieces"]]
        return Leg(form["begin"], pieces=pieces, **arrays)
    parts = [_built(part) for part in form["parts"]]
    if form["form"] == "chain":
        return Chain(parts, **arrays)
    return Split(arrays["normal"], form["threshold"], *parts)


def state(t, inputs):
    """Return the states at times t, shape (n,) or (), for inputs of shape (n, d) or (d,)."""
    t, inputs = np.broadcast_arrays(np.asarray(t, float)[..., None], np.asarray(inputs, float))
    flat = inputs.reshape(-1, inputs.shape[-1])
    return MAP.evaluate(t[..., 0].ravel(), flat).reshape(*inputs.shape[:-1], -1)


def jacobian(t, inputs):
    """Return the derivatives of the states in the inputs, shape (n, dim, d) or (dim, d)."""
    t, inputs = np.broadcast_arrays(np.asarray(t, float)[..., None], np.asarray(inputs, float))
    flat = inputs.reshape(-1, inputs.shape[-1])
    found = MAP.derivatives(t[..., 0].ravel(), flat)[2]
    return found.reshape(*inputs.shape[:-1], *found.shape[1:])


_FORM = {json.dumps(form)}
_DATA = base64.b64decode(
{lines}
)
_place = 0
MAP = _built(_FORM)
del _DATA
'''


def _version() -> str:
    import hamsym

    return hamsym.__version__


def _form(map: Any, numbers: list[np.ndarray]) -> dict[str, Any]:
    """Return a description of a map; its arrays are appended to the numbers in order."""
    if isinstance(map, Leg):
        names = ("edges", "scaling", "shift", "selection", "offset", "start_degrees", "start")
        return {
            "form": "leg",
            "begin": map.begin,
            "arrays": [[name, _placed(getattr(map, name), numbers)] for name in names],
            "pieces": [
                [_placed(a, numbers) for a in (piece.degrees, piece.readouts, piece.columns)]
                for piece in map.pieces
            ],
        }
    if isinstance(map, Chain):
        arrays = [[name, _placed(getattr(map, name), numbers)] for name in ("joints", "kept")]
        parts = [_form(part, numbers) for part in map.maps]
        return {"form": "chain", "arrays": arrays, "parts": parts}
    assert isinstance(map, Split)
    arrays = [["normal", _placed(map.normal, numbers)]]
    parts = [_form(part, numbers) for part in (map.low, map.high)]
    return {"form": "split", "threshold": map.threshold, "arrays": arrays, "parts": parts}


def _placed(array: np.ndarray, numbers: list[np.ndarray]) -> list[Any]:
    whole = array.dtype.kind in "iu"
    numbers.append(np.ascontiguousarray(array, dtype="u1" if whole else "<f8"))
    return [list(array.shape), "i" if whole else "f"]
