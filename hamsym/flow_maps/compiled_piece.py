"""Pieces of flow maps, evaluated by compiled code."""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
from collections.abc import Callable
from typing import Any

import numpy as np

from hamsym.codegen.numba_cache import load_module
from hamsym.flow_maps.expansion import Piece

_CHUNK = 8_192  # queries at once


class CompiledPiece(Piece):
    """A piece whose values with numpy come from compiled code, equal up to round-off."""

    def __init__(self, degrees: np.ndarray, readouts: np.ndarray, columns: np.ndarray) -> None:
        super().__init__(degrees, readouts, columns)
        self.chunk = _CHUNK
        self._form = (
            np.ascontiguousarray(degrees, dtype=np.int64),
            np.ascontiguousarray(readouts.T),
            np.ascontiguousarray(columns.transpose(0, 2, 1).reshape(-1, columns.shape[1])),
        )

    def states(self, time: Any, y: Any, xp: Any) -> Any:
        return self._values(time, y, -1, False) if xp is np else super().states(time, y, xp)

    def derivatives(
        self, time: np.ndarray, y: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        slopes = [self._values(time, y, k, False) for k in range(y.shape[1])]
        found = self._values(time, y, -1, False), self._values(time, y, -1, True)
        return *found, np.stack(slopes, axis=-1)

    def _values(self, time: np.ndarray, y: np.ndarray, slope: int, rate: bool) -> np.ndarray:
        out = np.empty((len(time), self.columns.shape[2]))
        queries = np.ascontiguousarray(time), np.ascontiguousarray(y)
        _compiled()(*self._form, *queries, slope, rate, out)
        return out


@functools.cache
def _compiled() -> Callable[..., None]:
    """Compile the loop; a second on the first call on a machine."""
    import numba

    from hamsym.random_features.vector_products import products

    text = importlib.resources.files("hamsym.flow_maps").joinpath("piece_loop.py").read_text()
    called = importlib.resources.files("hamsym.random_features").joinpath("vector_products.py")
    digest = hashlib.sha256(called.read_bytes()).hexdigest()
    module: Any = load_module(f"{text}\n# {digest}\n", "piece_loop")
    for name in ("fill_table", "fill_slopes"):
        setattr(module, name, numba.njit(error_model="numpy")(getattr(module, name)))
    module.products = products
    f, i = numba.types.float64, numba.types.int64
    signature = numba.types.void(
        *(i[:, ::1], f[:, ::1], f[:, ::1], f[::1], f[:, ::1], i, numba.types.boolean),
        f[:, ::1],
    )
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}}
    return numba.njit(signature, nogil=True, cache=True, **options)(module.evaluate_piece)
