"""Pieces of flow maps, evaluated by compiled code, and what files contain of the maps."""

from __future__ import annotations

import ctypes
from typing import Annotated, Any

import numpy as np

from hamsym.flow_maps.expansion import Chain, Leg, Piece, Split
from hamsym.kernel.loops import Record, arrays, counts, library, require_memory
from hamsym.numerics.lower_sets import MOST_DEGREE
from hamsym.support.record_fields import Array, As, OneOf, check_also, declare, floats


class _Form(Record):
    """A piece in the library."""

    _fields_ = [*counts("count inputs rank terms dim"), *arrays("degree readout column")]


class CompiledPiece(Piece):
    """A piece whose values with numpy come from compiled code, equal up to round-off."""

    def __init__(self, degrees: np.ndarray, readouts: np.ndarray, columns: np.ndarray) -> None:
        super().__init__(degrees, readouts, columns)
        parts, terms, dim = columns.shape
        self._form = _Form(
            count=degrees.shape[0],
            inputs=degrees.shape[1],
            rank=parts,
            terms=terms,
            dim=dim,
            degree=np.ascontiguousarray(degrees, dtype=np.int64),
            readout=readouts.T,
            column=columns.transpose(0, 2, 1).reshape(-1, terms),
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
        given = np.ascontiguousarray(time, dtype=float), np.ascontiguousarray(y, dtype=float)
        done = library().hamsym_piece(
            *(ctypes.byref(self._form), len(time), *(array.ctypes.data for array in given)),
            *(slope, rate, out.ctypes.data),
        )
        require_memory(done)
        return out


# -- files -----------------------------------------------------------------------------------------

MAPS = OneOf(leg=Leg, chain=Chain, split=Split)

_MAP = Annotated[Any, MAPS]


def _whole(*shape: str, most: int = 255) -> Any:
    return Annotated[np.ndarray, Array(shape, (np.int64,), least=0, most=most, stored=np.uint8)]


declare(
    CompiledPiece,
    degrees=_whole("products", "inputs", most=MOST_DEGREE),
    readouts=Annotated[np.ndarray, floats("products", "rank")],
    columns=Annotated[np.ndarray, floats("rank", "terms", "dim")],
)
declare(
    Leg,
    begin=float,
    edges=Annotated[np.ndarray, floats("pieces + 1")],
    scaling=Annotated[np.ndarray, floats("inputs", "inputs")],
    shift=Annotated[np.ndarray, floats("inputs")],
    selection=Annotated[np.ndarray, floats("dim", "inputs")],
    offset=Annotated[np.ndarray, floats("dim")],
    start_degrees=_whole("starts", "inputs", most=MOST_DEGREE),
    start=Annotated[np.ndarray, floats("starts", "dim")],
    pieces=Annotated[Any, As(tuple[CompiledPiece, ...], tuple)],
)
declare(
    Chain,
    maps=Annotated[Any, As(tuple[_MAP, ...], tuple)],
    joints=Annotated[np.ndarray, floats("joints")],
    kept=_whole("kept"),
)
declare(
    Split,
    normal=Annotated[np.ndarray, floats("inputs")],
    threshold=float,
    low=_MAP,
    high=_MAP,
)


def _require_numbers(piece: CompiledPiece) -> None:
    if not min(*piece.readouts.shape, *piece.columns.shape):
        raise ValueError("a piece of its map is empty")


check_also(CompiledPiece, _require_numbers)
