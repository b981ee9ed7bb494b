"""What a file contains for the closed form of a flow map."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np

from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.numerics.lower_sets import MOST_DEGREE
from hamsym.support.record_fields import Array, As, OneOf, check_also, declare, floats

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
