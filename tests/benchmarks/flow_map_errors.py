"""Flow maps to be measured, and a search for their true worst error."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import hamsym
from hamsym.flow_maps.box import checked_box

_CHUNK = 5_000  # starts at once
_EXACT, _LEAST = 1e-3, 1e-12  # tolerance of the reference, of that of the map, and the smallest
_SEED = 9  # other features than those of the solutions of which the map is made
_UNIFORM, _FACES = 0.5, 0.2  # of all starts; the others are near the worst ones found
_AT_END = 0.3  # probability that an input of a start on a face is an end of its interval
_WIDTHS = (0.1, 0.03, 0.01)  # of the search near the worst starts, in scaled inputs
_ELITE = 20


@dataclass(frozen=True)
class MapCase:
    """A flow map: arguments of :func:`hamsym.flow_map`."""

    label: str
    H: Any
    z0: Any
    span: tuple[float, float]
    tol: float
    parameters: Mapping[str, Any] | None = None
    options: Mapping[str, Any] = field(default_factory=dict)

    def build(self) -> hamsym.FlowMap:
        return hamsym.flow_map(
            self.H,
            self.z0,
            self.span,
            self.parameters,
            tol=self.tol,
            progress=False,
            **self.options,
        )

    def compile(self) -> None:
        """Compile the code of H, which is not timed."""
        box = checked_box(self.H, self.z0, self.parameters)
        inputs = box.at(np.zeros((1, len(box))))
        hamsym.solve_many(
            box.H,
            box.states(inputs),
            self.span,
            tol=1e-3,
            parameters=box.values(inputs) or None,
            progress=False,
        )


#: The paper's oscillator over a box of starts.
OSCILLATOR = MapCase(
    "oscillator",
    "p**2/2 + x**2/2 + x**4/4",
    {"x": (1.0, 1.6), "p": (0.7, 1.3)},
    (0.0, 4 * np.pi),
    5e-9,
)


@dataclass
class TrueError:
    """Largest errors found.

    Attributes
    ----------
    largest, scale : numpy.ndarray
        Largest error and largest value of each component, shape (dim,).
    starts : int
        Starts that were compared.
    failed : int
        Starts without a reference.
    """

    largest: np.ndarray
    scale: np.ndarray
    starts: int = 0
    failed: int = 0


def queries_of(flow: hamsym.FlowMap, inputs: np.ndarray) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return z0 and parameters, as a call of the map takes them, of inputs of shape (..., d)."""
    values = {name: inputs[..., k] for k, name in enumerate(flow.inputs)}
    z0 = {name: value for name, value in values.items() if name in flow.H.names}
    return z0, {name: value for name, value in values.items() if name not in z0}


def search(flow: hamsym.FlowMap, count: int, times: int, *, seed: int = 1) -> TrueError:
    """Compare a map with solutions from many starts of its box, and from others near the worst.

    The starts, their times and the features of the solutions are not those of the map's own
    estimate. The times differ between chunks of starts, and contain the end of the span.

    Parameters
    ----------
    flow : FlowMap
    count, times : int
        Starts, and times of each.
    """
    random, d = np.random.default_rng(seed), len(flow.inputs)
    found = TrueError(np.zeros(flow.H.dim), np.zeros(flow.H.dim))
    faces = int(_FACES * count)
    y = random.uniform(-1, 1, (int(_UNIFORM * count) + faces, d))
    at_end = random.random((faces, d)) < _AT_END
    y[:faces] = np.where(at_end, np.sign(y[:faces]), y[:faces])
    ratios = _compared(flow, y, times, random, found)
    for width in _WIDTHS:
        worst = y[np.argsort(-ratios)[:_ELITE]]
        children = max(1, (count - len(y)) // (_ELITE * (len(_WIDTHS) - _WIDTHS.index(width))))
        near = worst.repeat(children, axis=0)
        near = np.clip(near + width * random.standard_normal(near.shape), -1, 1)
        ratios = np.append(ratios, _compared(flow, near, times, random, found))
        y = np.concatenate((y, near))
    return found


def _compared(
    flow: hamsym.FlowMap, y: np.ndarray, times: int, random: np.random.Generator, found: TrueError
) -> np.ndarray:
    """Compare from scaled inputs; return the largest error of each start, of the scale so far."""
    start, end = flow.span
    box, ratios = flow.region, []
    for first in range(0, len(y), _CHUNK):
        inputs = box.at(y[first : first + _CHUNK])
        t = start + (end - start) * (np.arange(times) + random.random(times)) / times
        t[-1] = end
        many = hamsym.solve_many(
            box.H,
            box.states(inputs),
            flow.span,
            tol=max(_EXACT * flow.tol, _LEAST),
            parameters=box.values(inputs) or None,
            seed=_SEED,
            progress=False,
        )
        exact = many(t)
        error = np.abs(flow(t, *queries_of(flow, inputs[:, None, :])) - exact)
        error[~many.success] = 0.0
        # An error that is not a number counts as infinite.
        error = np.where(np.isnan(error), np.inf, error)
        found.starts += len(inputs)
        found.failed += int(np.sum(~many.success))
        found.largest = np.maximum(found.largest, error.max(axis=(0, 1)))
        if many.success.any():
            sizes = many.table.sizes[many.members[many.success]]  # over the whole span
            found.scale = np.maximum(found.scale, sizes.max(axis=0))
        with np.errstate(all="ignore"):
            scaled = np.where(found.scale > 0, error / found.scale, 0.0)
        ratios.append(scaled.max(axis=(1, 2)))
    return np.concatenate(ratios)
