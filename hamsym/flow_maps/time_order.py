"""Order in time of the parts of a flow map: legs and their pieces, from the start of its span."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.flow_maps.compiled_piece import CompiledPiece
from hamsym.flow_maps.expansion import Chain, Leg, Split
from hamsym.numerics.collocation import chebyshev_values, collocation

_ROUND_OFF = 4e-16  # relative, of an end that is the sum of a start and a length


def require_order(map: Any, span: tuple[float, float]) -> None:
    """Require that every part of a map begins where the one before ends, and all in the span.

    Raises
    ------
    ValueError
        Naming what is not in order.
    """
    start, end = span
    direction = 1.0 if end > start else -1.0
    if not direction * (end - start) > 0:
        raise ValueError("its span is empty")
    if map.begin != start:
        raise ValueError("it does not begin with its span, or its legs do not follow each other")
    if isinstance(map, Chain):
        joints = np.asarray(map.joints, dtype=float)
        if len(map.maps) < 2 or joints.shape != (len(map.maps) - 1,):
            raise ValueError("its legs do not fit each other")
        edges = [start, *joints.tolist(), end]
        for part, low, high in zip(map.maps, edges[:-1], edges[1:], strict=True):
            if not direction * (high - low) > 0:
                raise ValueError("its legs are not in the order of its span")
            require_order(part, (low, high))
    elif isinstance(map, Split):
        for side in (map.low, map.high):
            require_order(side, span)
    else:
        _require_pieces(map, direction)
        if not abs(start + map.edges[-1] - end) <= _ROUND_OFF * max(abs(start), abs(end)):
            raise ValueError("a leg does not end where the next one starts, or with its span")


def legs_of(map: Any) -> list[Leg]:
    """The legs of all parts of a map."""
    if isinstance(map, Leg):
        return [map]
    parts = map.maps if isinstance(map, Chain) else [map.low, map.high]
    return [leg for part in parts for leg in legs_of(part)]


def require_inputs(map: Any, dim: int, count: int) -> None:
    """Raise ValueError unless chains keep the inputs that are no components of the state."""
    if isinstance(map, Chain):
        if not np.array_equal(map.kept, np.arange(dim, count)):
            raise ValueError("its legs do not fit each other")
        parts = map.maps
    else:
        parts = [map.low, map.high] if isinstance(map, Split) else []
    for part in parts:
        require_inputs(part, dim, count)


def _require_pieces(leg: Leg, direction: float) -> None:
    edges = np.asarray(leg.edges, dtype=float)
    if edges.shape != (len(leg.pieces) + 1,) or not leg.pieces:
        raise ValueError("the edges of its time do not fit its pieces")
    if not (edges[0] == 0 and np.isfinite(edges).all() and (direction * np.diff(edges) > 0).all()):
        raise ValueError("the pieces of its time are not in order")


def ended(map: Any, end: float) -> Any:
    """Return a map that ends earlier: the same function up to this time, without what follows.

    - end: After the start of the map, and not after its end.
    """
    if isinstance(map, Split):
        return Split(map.normal, map.threshold, ended(map.low, end), ended(map.high, end))
    if isinstance(map, Chain):
        direction = np.sign(end - map.begin)
        inner = map.joints[direction * map.joints < direction * end]
        last = ended(map.maps[len(inner)], end)
        if not len(inner):
            return last
        return Chain([*map.maps[: len(inner)], last], inner, map.kept)
    length, direction = end - map.begin, np.sign(end - map.begin)
    number = int(np.sum(direction * map.edges[1:-1] < direction * length))
    low, high = map.edges[number : number + 2]
    pieces = list(map.pieces[: number + 1])
    if high != length:
        pieces[-1] = _shortened(pieces[-1], 2 * (length - low) / (high - low))
    edges = np.append(map.edges[: number + 1], length)
    return Leg(
        *(map.begin, edges, map.scaling, map.shift, map.selection),
        *(map.offset, map.start_degrees, map.start, pieces),
    )


def _shortened(piece: CompiledPiece, length: float) -> CompiledPiece:
    """A piece over the scaled times from -1 to -1 + length."""
    terms = piece.columns.shape[1]
    table = collocation(terms)
    there = chebyshev_values(length * table.nodes - 1, terms)
    columns = np.einsum("mn,nk,rkc->rmc", table.to_series, there, piece.columns)
    return CompiledPiece(piece.degrees, piece.readouts, columns)
