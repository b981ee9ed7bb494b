"""Dataclasses as arrays and JSON values: only what is written is read."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
import pytest

from hamsym.support.record_fields import (
    UNSAVED,
    AnyFloat,
    AsText,
    Count,
    Limit,
    Size,
    counts,
    flags,
    floats,
)
from hamsym.support.records import digest_of, packed, unpacked


@dataclass(frozen=True, eq=False)
class Part:
    edges: Annotated[np.ndarray, floats("windows + 1")]
    states: Annotated[np.ndarray, floats("windows + 1", "dim")]


@dataclass(frozen=True, eq=False)
class Whole:
    z0: Annotated[np.ndarray, floats("dim")]
    parts: tuple[Part, ...]
    span: tuple[float, float]
    one: float | Annotated[np.ndarray, floats("members")]
    success: Annotated[np.ndarray, flags("members")]
    steps: Annotated[np.ndarray, counts("members")]
    few: Annotated[tuple[Size, ...], Limit(most=2)]
    notes: Annotated[dict[int, str], AsText]
    seed: Count = 0
    excess: AnyFloat = math.inf
    name: str | None = None
    cached: Any = field(default=None, metadata=UNSAVED)


def part(windows: int, dim: int = 2) -> Part:
    return Part(np.arange(windows + 1.0), np.zeros((windows + 1, dim)))


def whole(**changed: Any) -> Whole:
    given = {
        "z0": np.zeros(2),
        "parts": (part(1), part(3)),
        "span": (0.0, 1.0),
        "one": np.zeros(2),
        "success": np.array([True, False]),
        "steps": np.array([1, 2]),
        "few": (1.0,),
        "notes": {1: "lost"},
    }
    return Whole(**given | changed)


def test_records_are_read_back() -> None:
    arrays, values = packed(whole(cached=3))
    assert arrays.keys() == {
        *("z0", "one", "success", "steps", "notes"),
        *(f"parts.{k}.{name}" for k in range(2) for name in ("edges", "states")),
    }
    again = unpacked(Whole, arrays, json.loads(json.dumps(values)))
    assert (again.span, again.few, again.notes, again.cached) == (
        (0.0, 1.0),
        (1.0,),
        {1: "lost"},
        None,
    )
    assert again.success.tolist() == [True, False]
    assert digest_of(again) == digest_of(whole())
    assert digest_of(again) != digest_of(whole(span=(0.0, 2.0)))


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"parts": (part(1, 3),)}, "'parts.0.states' has shape"),
        ({"steps": np.array([1])}, "'steps' has shape"),
        ({"steps": np.array([1, -2])}, "'steps' has numbers out of range"),
        ({"success": np.array([1, 0])}, "'success' is not of type bool"),
        ({"z0": np.array([0.0, math.nan])}, "'z0' is not finite"),
        ({"span": (0.0, math.inf)}, "'span.1' is not finite"),
        ({"span": (0.0,)}, "'span' has 1 entries, not 2"),
        ({"few": (1.0, 2.0, 3.0)}, "at most 2 entries"),
        ({"few": (-1.0,)}, "'few.0' is out of range"),
        ({"seed": -1}, "'seed' is out of range"),
        ({"seed": 2**63}, "'seed' is out of range"),
        ({"seed": True}, "'seed' is not of type int"),
        ({"name": 3}, "'name' is not of type str"),
    ],
)
def test_invalid_records_are_not_written(changed: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        packed(whole(**changed))


@pytest.mark.parametrize(
    ("arrays", "values", "message"),
    [
        ({"more": np.zeros(1)}, {}, "'more' of its arrays is unknown"),
        ({"success": np.array([2, 0], np.uint8)}, {}, "'success' has numbers out of range"),
        ({"success": np.array([1, 0])}, {}, "'success' is not of type uint8"),
        ({"z0": np.zeros(2, np.float32)}, {}, "'z0' is not of type float64"),
        ({"notes": np.frombuffer(b'{"01": "x"}', np.uint8)}, {}, "keys that are not numbers"),
        ({"notes": np.frombuffer(b"[" * 100_000, np.uint8)}, {}, "."),
        ({}, {"more": 1}, "'more' of its values is unknown"),
        ({}, {"span": [0, 1.0]}, "'span.0' is not of type float"),
        ({}, {"z0": [0.0, 0.0]}, "'z0' of its arrays is missing"),
        ({}, {"one": 1.0}, "'one' of its arrays is unknown"),
        ({}, {"parts": [{"edges": None}]}, "'states' of its parts.0 is missing"),
        ({}, {"parts": {}}, "'parts' is not a list"),
    ],
)
def test_other_data_are_not_read(
    arrays: dict[str, np.ndarray], values: dict[str, Any], message: str
) -> None:
    own, given = packed(whole())
    with pytest.raises((ValueError, RecursionError), match=message):
        unpacked(Whole, own | arrays, given | values)
