"""Isolation of the zeros of a function along a path, whatever their distance.

Input:  states and rates of a path at both ends of cells, and a function with bounds of its range
        and of its slope over parts of cells (:mod:`hamsym.numerics.intervals`).
Output: parts of cells with one zero each, and those that were not decided.

A part whose range excludes zero has no zero. Where the slope excludes zero there is at most one,
also in neighbouring parts together, and the signs at both ends tell. Other parts are halved, down
to a tangency. The path between two samples is bounded by the second differences of its rates.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from hamsym.numerics.intervals import Intervals, Ranges
from hamsym.numerics.roots import changes, refine

_SAFETY = 4  # of the second derivatives of the rates, which are differences
_HALVINGS = 36  # of a cell, to the distance at which a tangency is round-off
_MOST = 200_000  # parts at a time
_PAIRS = ("values", "states", "rates")  # of cells: at both ends
_TOUCHES = 1e-3  # size of a function at a tangency, relative to that at the ends of the cell


@dataclass(frozen=True)
class Cells:
    """Parts of the cells between two samples of a path."""

    #: Of the cell of each part, shape (k,).
    index: np.ndarray
    #: low, high: Ends of the part, as shares of the cell, shape (k,).
    low: np.ndarray
    high: np.ndarray
    #: Duration of the whole cell, shape (k,).
    width: np.ndarray
    #: Of the function at the ends of the part, shape (2, k).
    values: np.ndarray
    #: states, rates: Of the components of the path that the function depends on, there, shape (2,
    #: k, dim).
    states: np.ndarray
    rates: np.ndarray
    #: Bounds of the second derivatives of the rates, shape (k, dim).
    bends: np.ndarray
    #: Largest magnitude of the function at the ends of the cell, shape (k,).
    scale: np.ndarray

    @classmethod
    def whole(
        cls,
        width: np.ndarray,
        values: np.ndarray,
        states: np.ndarray,
        rates: np.ndarray,
        bends: np.ndarray,
    ) -> Cells:
        """All cells."""
        low = np.zeros(len(width))
        scale = np.abs(values).max(axis=0)
        return cls(np.arange(len(low)), low, low + 1, width, values, states, rates, bends, scale)

    def __len__(self) -> int:
        return len(self.index)

    def __getitem__(self, chosen: np.ndarray) -> Cells:
        parts = {field.name: getattr(self, field.name) for field in fields(self)}
        return Cells(**{n: a[:, chosen] if n in _PAIRS else a[chosen] for n, a in parts.items()})

    @classmethod
    def of_parts(cls, parts: Sequence[Cells]) -> Cells:
        """Several parts as one."""
        columns = {
            field.name: [getattr(part, field.name) for part in parts] for field in fields(cls)
        }
        return cls(**{n: np.concatenate(a, axis=int(n in _PAIRS)) for n, a in columns.items()})

    def halves(self, *between: np.ndarray) -> Cells:
        """Both halves of each part, by the values, states and rates in the middle."""
        middle = (self.low + self.high) / 2
        between_ends = zip(_PAIRS, between, strict=True)
        ends = {name: (*getattr(self, name), found) for name, found in between_ends}
        first = {name: np.stack((low, found)) for name, (low, _, found) in ends.items()}
        last = {name: np.stack((found, high)) for name, (_, high, found) in ends.items()}
        return Cells.of_parts(
            [replace(self, high=middle, **first), replace(self, low=middle, **last)]
        )


@dataclass(frozen=True)
class Isolated:
    """Zeros of a function along a path."""

    #: share, index: Of each zero: its place in its cell from 0 to 1, and the cell, in this order,
    #: shape (n,).
    share: np.ndarray
    index: np.ndarray
    #: The same of places where the function comes to zero within round-off without a sign change.
    touched: list[tuple[float, int]]
    #: Number of parts that may contain more zeros, because there were too many.
    undecided: int


def rate_bends(times: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Bound the second derivatives of rates between samples, shape (..., n, dim).

    Returns shape (..., n - 1, dim).
    """
    gaps = np.diff(times)[:, None]
    slopes = np.diff(rates, axis=-2) / gaps
    if slopes.shape[-2] == 1:
        return _SAFETY * np.abs(slopes / gaps)
    found = np.abs(np.diff(slopes, axis=-2) / (gaps[1:] + gaps[:-1])) * 2
    ends = np.concatenate((found[..., :1, :], found, found[..., -1:, :]), axis=-2)  # at all nodes
    around = np.concatenate((ends[..., :1, :], ends, ends[..., -1:, :]), axis=-2)
    pairs = np.maximum(around[..., 1:, :], around[..., :-1, :])
    return np.asarray(_SAFETY * np.maximum(pairs[..., 2:, :], pairs[..., :-2, :]))


def component_ranges(cells: Cells, component: int) -> Ranges:
    """A component of the path over parts of cells."""
    ends, rates = cells.states[..., component], cells.rates[..., component]
    width = np.abs(cells.width) * (cells.high - cells.low)
    beyond = cells.bends[..., component] * width**2 / 8
    slope = Intervals(np.minimum(*rates) - beyond, np.maximum(*rates) + beyond)
    return Ranges.of_slopes(ends, slope, width)


def isolated_zeros(
    cells: Cells,
    enclosed: Callable[[Cells], Ranges],
    sample: Callable[[np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]],
    value: Callable[[np.ndarray, np.ndarray], np.ndarray],
    direction: float = 0.0,
) -> Isolated:
    """Locate all zeros with a change of sign.

    - cells: Whole ones.
    - enclosed: Parts of cells -> the function over them.
    - sample: (share, index) -> values of the function, states and rates of the path, shape (n,
      dim).
    - value: (share, index) -> values of the function alone.
    - direction: Above zero, only zeros at which the function rises in the order of the samples;
      below zero, falls.
    """
    touched: list[tuple[float, int]] = []
    monotonic, slopes, undecided, most = [], [], 0, _MOST + len(cells)
    with np.errstate(all="ignore"):
        for depth in range(_HALVINGS + 1):
            ranges = enclosed(cells)
            # Next to a zero at an end the values, which neighbours share, decide over round-off.
            outside = (ranges.within.low > 0) | (ranges.within.high < 0)
            without = outside & ~changes(*cells.values)
            slope = 1 * (ranges.slope.low > 0) - (ranges.slope.high < 0)
            # A whole cell has no neighbours, so that only its own signs count.
            of_interest = (slope != 0) & (changes(*cells.values) | (depth > 0))
            monotonic.append(cells[np.flatnonzero(of_interest)])
            slopes.append(slope[of_interest])
            cells = cells[np.flatnonzero(~without & (slope == 0))]
            if not len(cells) or len(cells) > most or depth == _HALVINGS:
                break
            middle = (cells.low + cells.high) / 2
            cells = cells.halves(*sample(middle, cells.index))
    if len(cells) > most:
        undecided = len(cells)
    elif len(cells):
        cells, touched = _joined(cells)
    monotonous = _crossed(Cells.of_parts(monotonic), np.concatenate(slopes))
    both = Cells.of_parts([monotonous, cells])
    crossed = both[changes(both.values[0], both.values[1], direction)]
    share = refine(lambda x, k: value(x, crossed.index[k]), crossed.low, crossed.high)
    order = np.lexsort((share, crossed.index))
    order = order[np.isfinite(share[order])]
    return Isolated(share[order], crossed.index[order], touched, undecided)


def _crossed(cells: Cells, slopes: np.ndarray) -> Cells:
    """Parts with the zeros of monotonic ones: one at most where slopes of neighbours have one sign.

    Next to a tangency the values are round-off and change their sign several times. The function
    is monotonic over all neighbours, so that the signs at the ends of their row tell.
    """
    order = np.lexsort((cells.low, cells.index))
    cells = cells[order]
    first, last = _rows(cells, slopes[order])
    row = np.repeat(np.arange(len(first)), last - first + 1)
    across = changes(cells.values[0, first], cells.values[1, last])
    crossed = np.flatnonzero(changes(*cells.values) & across[row])
    return cells[crossed[np.unique(row[crossed], return_index=True)[1]]]


def _rows(cells: Cells, kind: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last of each row of neighbouring parts of one kind, which are in order."""
    apart = (np.diff(cells.index) != 0) | (cells.low[1:] != cells.high[:-1]) | (np.diff(kind) != 0)
    first = np.flatnonzero(np.concatenate((np.ones(min(len(cells), 1), dtype=bool), apart)))
    return first, np.append(first, len(cells))[1:] - 1


def _joined(cells: Cells) -> tuple[Cells, list[tuple[float, int]]]:
    """Neighbouring parts as one, of which round-off decides: only signs at its ends count.

    Also the places of those whose ends have one sign, where the function is as small as at a
    tangency, not large as at a pole.
    """
    cells = cells[np.lexsort((cells.low, cells.index))]
    first, last = _rows(cells, np.zeros(len(cells)))
    joined = {
        name: np.stack((getattr(cells, name)[0, first], getattr(cells, name)[1, last]))
        for name in _PAIRS
    }
    others = {name: getattr(cells, name)[first] for name in ("index", "low", "width", "bends")}
    groups = Cells(**joined, **others, high=cells.high[last], scale=cells.scale[first])
    size = np.abs(groups.values).max(axis=0)
    continuous = ~(size > _TOUCHES * groups.scale)  # no pole and no jump
    touches = continuous & ~changes(*groups.values)
    places = zip(groups.low[touches].tolist(), groups.index[touches].tolist(), strict=True)
    return groups[continuous], list(places)
