"""Records of a march that is proven on its own windows; see ``followed.c``."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.kernel.enclosures import Models, pointer, points_of, require_fit
from hamsym.kernel.loops import Record, arrays, counts, numbers


class Prepared(Record):
    """A program with its models and with values at points, shape (registers, points).

    - registers: ``step`` and ``still_step``, rows (operation, target, first, second);
      ``constant``, ``place`` and ``result``, registers of numbers, of what is still, of results;
      and the ``number`` of each constant, a ball.
    - values_of: Of the terms of models at the points, shape (terms, points).
    """

    _fields_ = [
        *counts("steps still constants places points"),
        *arrays("step still_step constant place result number rows values_of values"),
    ]

    def __init__(
        self, models: Models, values_of: np.ndarray, values: np.ndarray, **registers: np.ndarray
    ) -> None:
        for name, array in registers.items():
            pointer(array, "p" if name == "number" else "n")
        sizes = [len(registers[name]) for name in ("step", "still_step", "constant", "place")]
        names = ("steps", "still", "constants", "places")
        super().__init__(
            **dict(zip(names, sizes, strict=True)),
            points=points_of(values),
            **registers,
            rows=models,
            values_of=values_of,
            values=values,
        )


class MarchProof(Record):
    """A march and the state of its proof, which the library changes.

    - rates, jacobian, energy: Programs, each a :class:`Prepared`.
    - entry, placed: Rows (i, j, place) with results and with registers; ``signs`` beside them.
    - integral: At the points of y; ``fewer_steps`` are those of V; see :meth:`Enclosures.tangents`.
    - fewer: From values at the points of y to those at the points of V.
    - features: Models of the features on a window, and readouts, shape (windows, dim, features).
    - states, edges: Of the windows, shapes (windows + 1, dim) and (windows + 1,).
    - most: Columns of the set.
    """

    _fields_ = [
        *counts("dim entries inner most orders"),
        *arrays("rates jacobian energy entry placed signs integral fewer_steps fewer"),
        *arrays("features trial"),
        *arrays("readouts states edges"),
        *numbers("origin"),
        *arrays("sizes couplings centre centre_low G R"),
        *counts("columns"),
    ]

    def __init__(self, features: Models, most: int, **given: Any) -> None:
        readouts, states, edges = given["readouts"], given["states"], given["edges"]
        windows, dim, inner = readouts.shape
        require_fit(states.shape == (windows + 1, dim) and edges.shape == (windows + 1,))
        for name in ("readouts", "states", "edges", "entry"):
            pointer(given[name], "n" if name == "entry" else "p")
        (high, low), length = np.zeros((2, dim, features.terms)), np.ones(dim, dtype=np.int64)
        tables = features["values"], features["series"]
        super().__init__(
            dim=dim,
            entries=len(given["entry"]),
            inner=inner,
            most=most,
            orders=given["fewer_steps"].shape[2],
            features=features,
            trial=Models(*tables, high, low, np.zeros(dim), length),
            sizes=np.zeros(dim),
            couplings=np.zeros((dim, dim)),
            centre=states[0].copy(),
            centre_low=np.zeros(dim),
            G=np.zeros((dim, most)),
            R=np.zeros(most),
            columns=0,
            **given,
        )
