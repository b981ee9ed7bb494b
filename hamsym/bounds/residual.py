"""The residual of a trial solution, bounded on its windows instead of sampled.

The march judges a window by its residual at fixed places. A feature between them, for example a
pulse of the force that is narrower than their distance, leaves no trace there. Here the residual
dz^/dt - J grad H(z^) of a window is bounded by arithmetic of models
(:mod:`hamsym.bounds.models`), so that a feature of any width, in time or along the orbit, shows.

Where the bound exceeds the limit the window is halved. A part passes as soon as its bound, times
its length, cannot matter; it fails where its residual, at places of its own, does matter; and it
is halved again while neither is known. So a pulse is met after as many halvings as the logarithm
of its width, and what the trajectory does not reach costs nothing. A part that float64 cannot
divide any more fails.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hamsym.bounds.models import NODES, PLACES, Models
from hamsym.bounds.vector_field import ModelField

__all__ = ["Excess", "Parts", "Places", "first_excess"]

_SHARE = 1 / 64  # of the limit of a window that a part may use, however short it is
_MOST_SHARES = 4.0  # of the limit, that all parts of a window may use
_MOST_PARTS = 4_096  # of one generation of halves
_AT_ONCE = 256  # parts in one evaluation of models
_GENERATIONS = 60
_ULPS = 16.0  # of the time, below which a part is not divided
_EPS = 2.0**-52


class Places(NamedTuple):
    """A trial solution at the places of parts of windows.

    Attributes
    ----------
    z, rates : numpy.ndarray
        z^ and dz^/dt, shape (parts, PLACES, dim).
    t : numpy.ndarray
        Shape (parts, PLACES).
    """

    z: np.ndarray
    rates: np.ndarray
    t: np.ndarray


@dataclass(frozen=True)
class Parts:
    """Parts of windows: the window, the start and the width of each, in window lengths."""

    window: np.ndarray
    start: np.ndarray
    width: np.ndarray

    @classmethod
    def whole(cls, count: int) -> Parts:
        """Each window as a whole."""
        return cls(np.arange(count), np.zeros(count), np.ones(count))

    @property
    def s(self) -> np.ndarray:
        """Places in the windows, shape (parts, PLACES)."""
        return np.asarray(self.start[:, None] + self.width[:, None] * (NODES + 1) / 2)

    def halves(self) -> Parts:
        """Both halves of each part, in order."""
        half = self.width / 2
        start = np.stack((self.start, self.start + half), axis=1).ravel()
        return Parts(np.repeat(self.window, 2), start, np.repeat(half, 2))

    def __getitem__(self, chosen: np.ndarray | slice) -> Parts:
        return Parts(self.window[chosen], self.start[chosen], self.width[chosen])

    def __len__(self) -> int:
        return len(self.window)


class Excess(NamedTuple):
    """The first window whose residual exceeds its limit: its number, times, and the ratio."""

    window: int
    times: list[float]
    ratio: float


def first_excess(
    field: ModelField,
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray],
    trial: Callable[[Parts], Places],
    noise: Callable[[Places, Parts], np.ndarray],
    edges: np.ndarray,
    limits: np.ndarray,
    parameters: np.ndarray,
) -> Excess | None:
    """Find the first window whose residual may exceed its limit.

    Parameters
    ----------
    field : ModelField
    rates : callable
        (z, t, window) -> F at points, shapes (n, dim), (n,), (n,) -> (n, dim).
    trial : callable
        The trial solution, of polynomials of a degree up to that of models in each part.
    noise : callable
        The round-off of F that is allowed on each part, shape (parts, dim).
    edges : numpy.ndarray
        Start and end of each window, shape (2, windows).
    limits : numpy.ndarray
        Allowed integrals of the residual over each window, shape (windows, dim).
    parameters : numpy.ndarray
        Of H, or for each window, shape (k,) or (windows, k).

    Returns
    -------
    Excess or None
        None if every window passes.
    """
    lengths = np.abs(edges[1] - edges[0])
    resolution = _ULPS * _EPS * np.maximum(np.abs(edges[0]), np.abs(edges[1]))
    spent = np.zeros(len(lengths))  # by parts that pass, in shares of the limit
    worst: Excess | None = None
    parts = Parts.whole(len(lengths))
    for _ in range(_GENERATIONS):
        undecided: list[Parts] = []
        for first in range(0, len(parts), _AT_ONCE):
            some = parts[slice(first, first + _AT_ONCE)]
            if worst is not None:
                some = some[some.window < worst.window]
            if not len(some):
                continue
            places = trial(some)
            weight = lengths[some.window] * some.width
            bounds = _bounds(field, places, edges, some, parameters) * weight[:, None]
            ratio = _ratios(bounds, limits[some.window])
            passed = ratio <= np.maximum(some.width, _SHARE)
            np.add.at(spent, some.window[passed], ratio[passed])
            some, weight, bounds = some[~passed], weight[~passed], bounds[~passed]
            if not len(some):
                continue
            at = Places(*(array[~passed] for array in places))
            limit = limits[some.window] * np.maximum(some.width, _SHARE)[:, None]
            limit = limit + noise(at, some) * weight[:, None]
            passed = _ratios(bounds, limit) <= 1
            found = _residuals(rates, at, some)
            real = _ratios(found.mean(axis=1) * weight[:, None], limit)
            failed = ~(real <= 1) | ~(passed | (weight > resolution[some.window]))
            if failed.any():
                index = int(np.argmin(np.where(failed, some.window, len(lengths))))
                peak = int(np.argmax(_ratios(found[index], limits[some.window[index]])))
                size = max(float(real[index]), float(_ratios(bounds[index], limit[index])))
                worst = Excess(int(some.window[index]), [float(at.t[index, peak])], size)
            undecided.append(some[~(failed | passed)])
        parts = _joined(undecided)
        if worst is not None:
            parts = parts[parts.window < worst.window]
        if not len(parts):
            break
        if len(parts) > _MOST_PARTS:
            parts = parts[np.argsort(parts.window, kind="stable")]
            last = parts[slice(0, 1)]
            return Excess(int(last.window[0]), [float(trial(last).t[0, PLACES // 2])], np.inf)
        parts = parts.halves()
    else:
        if len(parts):
            return Excess(int(parts.window[0]), [float(trial(parts[:1]).t[0, 0])], np.inf)
    overspent = np.flatnonzero(~(spent <= _MOST_SHARES))
    if len(overspent) and (worst is None or overspent[0] < worst.window):
        first = int(overspent[0])
        return Excess(first, [float(edges[:, first].mean())], float(spent[first]))
    return worst


def _joined(parts: list[Parts]) -> Parts:
    if not parts:
        return Parts.whole(0)
    return Parts(
        np.concatenate([part.window for part in parts]),
        np.concatenate([part.start for part in parts]),
        np.concatenate([part.width for part in parts]),
    )


def _bounds(
    field: ModelField,
    places: Places,
    edges: np.ndarray,
    parts: Parts,
    parameters: np.ndarray,
) -> np.ndarray:
    """Bound the residual of each component on each part, shape (parts, dim)."""
    components = [Models.of_polynomials(values) for values in np.moveaxis(places.z, 2, 0)]
    start, end = edges[:, parts.window]
    ends = start + (end - start) * parts.start, start + (end - start) * (parts.start + parts.width)
    t = Models.of_polynomials(places.t, np.minimum(*ends), np.maximum(*ends))
    given = parameters if parameters.ndim == 1 else parameters[parts.window]
    found = field(components, t, given)
    slopes = np.moveaxis(places.rates, 2, 0)
    return np.stack(
        [
            (Models.of_polynomials(slope) - rate).magnitude
            for slope, rate in zip(slopes, found, strict=True)
        ],
        axis=1,
    )


def _residuals(
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray], places: Places, parts: Parts
) -> np.ndarray:
    """Evaluate the residual at the places, shape (parts, PLACES, dim)."""
    count, _, dim = places.z.shape
    window = np.repeat(parts.window, PLACES)
    found = rates(places.z.reshape(-1, dim), places.t.ravel(), window)
    return np.asarray(np.abs(places.rates - found.reshape(count, PLACES, dim)))


def _ratios(values: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the largest ratio of each row, infinite where it is NaN or a limit is infinite."""
    ratios = np.where(limits < np.inf, values / np.maximum(limits, np.finfo(float).tiny), np.inf)
    largest = ratios.max(axis=-1)
    return np.where(np.isnan(largest), np.inf, largest)
