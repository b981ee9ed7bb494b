"""The residual of a trial solution, bounded on its windows instead of sampled.

The march judges a window by its residual at fixed places. A feature between them, for example a
pulse of the force that is narrower than their distance, leaves no trace there. Here the residual
dz^/dt - J grad H(z^) of a window is bounded, so that a feature of any width, in time or along the
orbit, shows: by bounds of the formulas in discs around it (:mod:`hamsym.bounds.discs`) or, where
these have none, by arithmetic of models (:mod:`hamsym.bounds.models`).

Where both bounds exceed the limit the window is halved. A part passes as soon as its bound, times
its length, cannot matter; it fails where its residual, at places of its own, does matter; and it
is halved again while neither is known. So a pulse is met after as many halvings as the logarithm
of its width, and what the trajectory does not reach costs nothing. A part that float64 cannot
divide any more fails.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import sympy

from hamsym.bounds.models import PLACES, residual_bounds
from hamsym.kernel.loops import Equations as Programs
from hamsym.symbolic.equations import Equations

#: Round-off that a limit has room for: of the residual, relative to the rates, and in changes of
#: the rates for one unit in the last place of states and times.
ROUND_OFF, NOISE = 256 * 2.0**-52, 80.0
#: Share of the limit of a window that a part may use, however short it is.
SHARE = 1 / 64
MOST_SHARES = 4.0  # of the limit, that all parts of a window may use
_MOST_PARTS = 256  # of one generation of halves
_AT_ONCE = 56  # parts in one evaluation of models: products so small are not spread over threads
_GENERATIONS = 60
_SHORT_POLYNOMIAL = 8  # degree of a vector field that hides nothing between the places of a march
_ULPS = 16.0  # of the time, below which a part is not divided
_EPS = 2.0**-52
_TINY = np.finfo(float).tiny


#: (z, t, window) -> F at points, shapes (n, dim), (n,), (n,) -> (n, dim).
Rates = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Places(NamedTuple):
    """A trial solution at the places of parts of windows."""

    #: z, rates: z^ and dz^/dt, shape (parts, PLACES, dim).
    z: np.ndarray
    rates: np.ndarray
    #: Shape (parts, PLACES).
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

    def places(self, x: np.ndarray) -> np.ndarray:
        """Map places in [-1, 1] into the windows, shape (parts, len(x))."""
        return np.asarray(self.start[:, None] + self.width[:, None] * (x + 1) / 2)

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
    """A window whose residual may exceed its limit: its number, a time, and the ratio.

    The width is that of the part around this time at which that was known, in window lengths.
    """

    window: int
    time: float
    ratio: float
    width: float


@dataclass
class ExcessSearch:
    """The search for windows whose residual may exceed its limit."""

    programs: Programs
    rates: Rates
    #: The trial solution, of polynomials of a degree up to that of models in each part.
    trial: Callable[[Parts], Places]
    #: Start and end of each window, shape (2, windows).
    edges: np.ndarray
    #: Allowed integrals of the residual over each window, shape (windows, dim).
    limits: np.ndarray
    #: Of H, or for each window, shape (k,) or (windows, k).
    parameters: np.ndarray
    #: Residual that is allowed as round-off, in changes of F by one unit in the last place.
    noise: float
    #: Whether to search for the first of them only.
    first_only: bool = False
    #: Whether a residual counts over the whole of each window, however short it is.
    whole: np.ndarray | bool = False
    #: Integral of the round-off of the formula over the parts of each window that passed, if it is
    #: counted instead of being a residual, shape (windows, dim).
    rounding: np.ndarray | None = None

    def __post_init__(self) -> None:
        self._lengths = np.abs(self.edges[1] - self.edges[0])
        self._resolution = _ULPS * _EPS * np.abs(self.edges).max(axis=0)
        self._spent = np.zeros(len(self.limits))  # by parts that passed, in limits
        self._found: list[Excess] = []

    def run(self) -> list[Excess]:
        """Return the windows in their order."""
        parts = Parts.whole(len(self.limits))
        most = max(_MOST_PARTS, len(parts))
        with np.errstate(all="ignore"):  # what overflows or has no value exceeds its limit
            for _ in range(_GENERATIONS):
                if not len(parts):
                    return self._found
                parts = self._undecided(parts)
                if len(parts) > most:
                    break
                parts = parts.halves()
            # Those with parts that stayed undecided, too.
            some = np.unique(parts.window, return_index=True)[1]
            middle = self.trial(parts[some]).t[:, PLACES // 2]
            rows = zip(parts[some].window, middle, parts[some].width, strict=True)
            self._add([Excess(int(w), float(t), math.inf, float(width)) for w, t, width in rows])
            return self._found

    def _undecided(self, parts: Parts) -> Parts:
        """Judge parts of one generation; return those that neither pass nor fail."""
        chunks = range(0, len(parts), _AT_ONCE)
        judged = [self._judged(parts[slice(first, first + _AT_ONCE)]) for first in chunks]
        found = (np.concatenate(columns) for columns in zip(*judged, strict=True))
        upper, lower, times, rounding = found
        window, count = parts.window, len(self.limits)
        passed = upper <= np.maximum(parts.width, SHARE)
        above = self._spent + np.bincount(window, upper, count)
        np.add.at(self._spent, window[passed], upper[passed])
        if self.rounding is not None:
            np.add.at(self.rounding, window[passed], rounding[passed])
        settled = above <= MOST_SHARES
        below = np.maximum(np.bincount(window, lower, count), self._spent)
        failed = ~settled & ~(below <= MOST_SHARES)
        # What cannot be divided any more fails too.
        smallest = ~passed & ~(self._lengths[window] * parts.width > self._resolution[window])
        failed[window[smallest & ~settled[window]]] = True
        failed &= np.bincount(window, minlength=count) > 0
        kept = ~(passed | settled[window])
        # The largest residual that was met, or the largest bound where none was.
        order = np.lexsort((upper, lower, window))
        last = dict(zip(window[order].tolist(), order.tolist(), strict=True))
        ratios = np.where(below > MOST_SHARES, below, above)
        self._add(
            [
                Excess(w, float(times[last[w]]), float(ratios[w]), float(parts.width[last[w]]))
                for w in np.flatnonzero(failed).tolist()
            ]
        )
        kept &= ~failed[window]
        if self.first_only and self._found:
            kept &= window < self._found[0].window
        return parts[kept]

    def _add(self, some: list[Excess]) -> None:
        self._found = sorted((*self._found, *some))
        if self.first_only:
            del self._found[1:]

    def _judged(self, parts: Parts) -> tuple[np.ndarray, ...]:
        """Bound the integral of the residual over each part, in limits of its window.

        - returns upper, lower: A bound and, where that matters, a sum over places, without
          round-off; shape (parts,).
        - returns times: At which the residual is largest, shape (parts,).
        - returns rounding: Integral of the round-off of the formula, shape (parts, dim).
        """
        places, limits = self.trial(parts), self.limits[parts.window]
        whole = np.broadcast_to(self.whole, self._lengths.shape)[parts.window]
        weight = self._lengths[parts.window] * np.where(whole, 1.0, parts.width)
        given = places, self.edges, parts, self.parameters
        bounds, _, formula = bounds_on_parts(self.programs, *given)
        upper = largest_ratios(bounds * weight[:, None], limits)
        lower, times = np.zeros(len(parts)), places.t[:, PLACES // 2].copy()
        large = np.flatnonzero(~(upper <= np.maximum(parts.width, SHARE)))
        if len(large):
            some, at = parts[large], Places(*(array[large] for array in places))
            rates, own = _rates_at(self.rates, at.z, at.t, some), weight[large, None]
            rounded = self.noise * _round_off(self.rates, at, some, rates)
            if self.rounding is not None:
                rounded = np.maximum(rounded, formula[large])
            rounded = np.where(rounded < math.inf, rounded, 0.0)  # infinite or NaN excuses nothing
            found = np.abs(at.rates - rates)
            upper[large] = largest_ratios(
                np.maximum(bounds[large] - rounded, 0.0) * own, limits[large]
            )
            met = np.where(whole[large, None], found.max(axis=1), found.mean(axis=1))
            lower[large] = largest_ratios(np.maximum(met - rounded, 0.0) * own, limits[large])
            peaks = largest_ratios(found, limits[large, None]).argmax(axis=1)
            times[large] = at.t[np.arange(len(large)), peaks]
        return upper, lower, times, formula * (self._lengths[parts.window] * parts.width)[:, None]


def bounds_on_parts(
    programs: Programs, places: Places, edges: np.ndarray, parts: Parts, parameters: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Bound the residual on each part, what its values at the places leave out of it, and the
    round-off in it, shape (parts, dim).
    """
    start, end = edges[:, parts.window]
    ends = start + (end - start) * parts.start, start + (end - start) * (parts.start + parts.width)
    given = parameters if parameters.ndim == 1 else parameters[parts.window]
    return residual_bounds(programs, *places, np.sort(np.stack(ends, axis=1), axis=1), given)


def is_short_polynomial(form: Equations) -> bool:
    """Return whether the rates are polynomials of low degree, resolved wherever z^ is."""
    return _is_short_polynomial(form.free)


@functools.lru_cache(maxsize=64)
def _is_short_polynomial(form: Equations) -> bool:
    variables = [*form.z, *([] if form.time is None else [form.time])]
    if not all(rate.is_polynomial(*variables) for rate in form.vector_field):
        return False
    return all(
        sum(sympy.Poly(term, *variables).degree_list()) <= _SHORT_POLYNOMIAL
        for rate in form.vector_field
        for term in sympy.Add.make_args(rate)
        if term.free_symbols & set(variables)
    )


def _rates_at(rates: Rates, z: np.ndarray, t: np.ndarray, parts: Parts) -> np.ndarray:
    """Evaluate the rates at places of parts, shape (parts, PLACES, dim)."""
    window = np.repeat(parts.window, PLACES)
    return rates(z.reshape(-1, z.shape[2]), t.ravel(), window).reshape(z.shape)


def _round_off(rates: Rates, places: Places, parts: Parts, known: np.ndarray) -> np.ndarray:
    """Measure the change of known rates for one unit in the last place of states and times.

    It is the median over each part, since at a narrow feature the rates change by far more; shape
    (parts, dim).
    """
    generator = np.random.default_rng(0)
    z, t = (
        part * (1 + _EPS * generator.choice((-1.0, 1.0), size=part.shape))
        for part in (places.z, places.t)
    )
    return np.asarray(np.median(np.abs(_rates_at(rates, z, t, parts) - known), axis=1))


def largest_ratios(values: np.ndarray, limits: np.ndarray) -> np.ndarray:
    """Return the largest ratio of each row, infinite where it is NaN or a limit is infinite."""
    with np.errstate(all="ignore"):
        ratios = np.where(limits < np.inf, values / np.maximum(limits, _TINY), np.inf)
        largest = ratios.max(axis=-1)
    return np.where(np.isnan(largest), np.inf, largest)
