"""Checks of windows at times that the march did not use.

The march judges a window by its residual at fixed places. A feature between them, for example a
pulse of the force that is narrower than their distance, leaves no trace there. Three further checks
follow:

1. *Places from the formula.* Pulses, steps and poles of H have their places where the argument of
   exp, tanh, erf or a similar function, or the base of a negative or fractional power, is zero or
   extreme. These arguments vary slowly along the trajectory, so that samples of them give the
   times; the residual is taken there and around them, up to the width of the feature.
2. *Random places*, seeded: the residual there.
3. *Energy.* Where H does not depend on time, it may change over a window by no more than the local
   error that the tolerance allows. A step of the potential between the sampled times changes it.

A pulse that restores H, for example a narrow bump of the potential, is not detected if its place
cannot be read from the formula in this way and no sampled time meets it.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from hamsym.numerics.collocation import collocation
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.error_loop import SLACK
from hamsym.random_features.flow import Flow
from hamsym.random_features.member_loop import BRIEF, UNSETTLED
from hamsym.random_features.window_loop import EPS, NOISE, ROUND_OFF, TINY, Windows
from hamsym.symbolic.derivatives import Narrow

__all__ = ["Failure", "WindowChecks"]

_NODES, _DENSE = 32, 400  # places where arguments are sampled, of which the first make a series
_ENDS = np.array([0.0, 1e-9, 1e-8, 1e-7, 1e-6])  # before the first node, less for the last
_AT_ONCE = 1e-7  # of a window
_AROUND = np.array([-1.5, -0.7, 0.0, 0.7, 1.5])  # places of the residual, in widths
_LASTING = 200.0  # widths: what is missed adds a tenth of the local tolerance at most
_RANDOM = 2  # places in each window
_BISECTIONS = 40
_SECTIONS, _HALVINGS = 70, 40  # of the interval of a zero or a turning point
_TOUCHING = 1e-10  # extremum of an argument, relative to its neighbours, that counts as zero
_GOLDEN = (3 - 5**0.5) / 2


class Failure(NamedTuple):
    """The first window that failed: suspicious times, the excess over the limit, and its cause."""

    window: int
    times: list[float]
    excess: float
    cause: str


@dataclass
class WindowChecks:
    """The checks of one march.

    Attributes
    ----------
    flow : Flow
    basis : FeatureBasis
    tolerance : float
        Local tolerance of the march.
    """

    flow: Flow
    basis: FeatureBasis
    tolerance: float
    _generator: np.random.Generator = field(init=False)

    def __post_init__(self) -> None:
        self._generator = np.random.default_rng(self.basis.seed)

    def first_failure(self, windows: Windows, sizes: np.ndarray) -> Failure | None:
        """Check windows with components of these sizes; return None if all pass."""
        worst, place = self._residuals(windows, sizes)
        by_energy: set[int] = set()
        if self.flow.energy is not None:
            changes = self._energy_changes(windows, sizes)
            by_energy = set(np.flatnonzero(changes > worst).tolist())
            worst = np.maximum(worst, changes)
        failed = np.flatnonzero(worst > 1)
        if not len(failed):
            return None
        first = int(failed[0])
        if first in by_energy:
            return Failure(first, [self._energy_jump(windows, first)], float(worst[first]), "H")
        return Failure(first, place[first], float(worst[first]), "the residual")

    def _residuals(
        self, windows: Windows, sizes: np.ndarray
    ) -> tuple[np.ndarray, dict[int, list[float]]]:
        """Return the largest residual of each window, in units of the limit, and its times."""
        count = len(windows.edges) - 1
        lengths = np.abs(np.diff(windows.edges))
        window = np.repeat(np.arange(count), _RANDOM)
        s = self._generator.random(len(window))
        width = np.ones(len(window))
        if self.flow.narrow_arguments is not None:
            found = self._narrow_places(windows)
            window, s, width = (
                np.concatenate(pair) for pair in zip((window, s, width), found, strict=True)
            )
        z, dz, t = self._at(windows, window, s)
        rates = self.flow.vector_field(z, t)
        length = lengths[window, None]
        defect = np.minimum(length, width[:, None] * length) * np.abs(dz - rates)
        # The rate may be zero at one place: its size elsewhere in the window counts.
        largest = np.zeros((count, z.shape[1]))
        np.maximum.at(largest, window, np.abs(dz))
        allowed = self.tolerance * sizes + ROUND_OFF * length * largest[window]
        excess = _excess(defect, SLACK * allowed)
        suspect = np.flatnonzero(excess > 1)
        if len(suspect):
            more = NOISE * length[suspect] * self._round_off(windows, window[suspect])
            excess[suspect] = _excess(defect[suspect], SLACK * (allowed[suspect] + more))
        worst = np.zeros(count)
        np.maximum.at(worst, window, excess)
        places: dict[int, list[float]] = {}
        for index in np.flatnonzero(excess > 1):
            places.setdefault(int(window[index]), []).append(float(t[index]))
        return worst, places

    def _round_off(self, windows: Windows, window: np.ndarray) -> np.ndarray:
        """Measure the change of the rates for one unit in the last place of states and times.

        It is the median over the window, since at a narrow feature the rates change by far more;
        shape (n, dim).
        """
        used, index = np.unique(window, return_inverse=True)
        s = self.basis.nodes
        z, _, t = self._at(windows, np.repeat(used, len(s)), np.tile(s, len(used)))
        disturbed = z * (1 + EPS * self._generator.choice((-1.0, 1.0), size=z.shape))
        late = t * (1 + EPS * self._generator.choice((-1.0, 1.0), size=t.shape))
        noise = np.abs(self.flow.vector_field(disturbed, late) - self.flow.vector_field(z, t))
        return np.asarray(np.median(noise.reshape(len(used), len(s), -1), axis=1)[index])

    def _narrow_places(self, windows: Windows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Locate possible narrow features: windows, places s and widths, in window lengths."""
        count = len(windows.edges) - 1
        s = _places(_NODES)
        g, kinds = self._arguments(windows, np.arange(count), s)
        inner = slice(len(_ENDS), -len(_ENDS))
        series = np.abs(
            collocation(_NODES).to_series @ g[:, inner].transpose(2, 1, 0)
        )  # (argument, degree, window)
        tails = series[:, -4:].max(axis=1)
        # An argument that oscillates within the window is sampled more densely.
        fast = np.flatnonzero(~(tails <= UNSETTLED * series.max(axis=1)).all(axis=0))
        found = [
            self._candidates(np.delete(np.arange(count), fast), s, np.delete(g, fast, 0), kinds)
        ]
        if len(fast):
            s = _places(_DENSE)
            dense, _ = self._arguments(windows, fast, s)
            found.append(self._candidates(fast, s, dense, kinds))
        low, high, window, which, turns = (
            np.concatenate(parts) for parts in zip(*found, strict=True)
        )
        if not len(window):
            return np.empty(0, dtype=int), np.empty(0), np.empty(0)
        place, width, touches = self._located(windows, low, high, window, which, turns, kinds)
        # A switch or a pole acts at once and lastingly; a base may also touch zero.
        switched = (kinds[which] != Narrow.FUNCTION) & ((turns == 0) | touches)
        lasting = np.where(switched, 1.0, np.minimum(_LASTING * width, 1.0))
        width = np.where(switched, _AT_ONCE, width)
        narrow = width < BRIEF
        place, width, window = place[narrow], width[narrow], window[narrow]
        # Inside the window: at a breakpoint the equations of the next window may hold.
        around = np.clip(place[:, None] + width[:, None] * _AROUND, 1e-9, 1 - 1e-9)
        lasting = np.repeat(lasting[narrow], len(_AROUND))
        return np.repeat(window, len(_AROUND)), around.ravel(), lasting

    def _arguments(
        self, windows: Windows, window: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the arguments at places s of windows, shape (windows, places, arguments)."""
        assert self.flow.narrow_arguments is not None
        z = self._sampled(windows, window, s)
        t = windows.edges[window, None] + np.diff(windows.edges)[window, None] * s
        arguments, kinds = self.flow.narrow_arguments(z.reshape(-1, z.shape[-1]), t.ravel())
        return arguments.reshape(*t.shape, -1), kinds

    def _candidates(
        self, window: np.ndarray, s: np.ndarray, g: np.ndarray, kinds: np.ndarray
    ) -> tuple[np.ndarray, ...]:
        """Find intervals with zeros and turning points of arguments that are steep there.

        Returns
        -------
        tuple of numpy.ndarray
            Both ends of the interval, the window, the argument, and the sign of a maximum or
            minimum, 0 for a zero; shape (n,) each.
        """
        changes = np.diff(g, axis=1)
        # Within a tenth of a window the argument must change by 1, or a base by its size, between
        # two samples or between their neighbours.
        steps = np.diff(s)[:, None]
        steep = np.abs(changes) * BRIEF > steps
        acts = steep | (kinds != Narrow.FUNCTION)
        crosses = (g[:, :-1] * g[:, 1:] <= 0) & acts
        ratio = np.minimum(BRIEF / (steps[:-1] + steps[1:]), 1.0) ** 2
        drop = np.maximum(np.abs(changes[:, :-1]), np.abs(changes[:, 1:])) * 2 * ratio
        unit = np.where(kinds == Narrow.FUNCTION, 1.0, np.abs(g[:, 1:-1]))
        turns = (changes[:, :-1] * changes[:, 1:] <= 0) & (drop > unit)
        w, i, k = np.nonzero(crosses)
        v, j, m = np.nonzero(turns)
        return (
            np.concatenate((s[i], s[j])),
            np.concatenate((s[i + 1], s[j + 2])),
            window[np.concatenate((w, v))],
            np.concatenate((k, m)),
            np.concatenate((np.zeros(len(w)), np.sign(changes[v, j, m]))),
        )

    def _located(
        self,
        windows: Windows,
        low: np.ndarray,
        high: np.ndarray,
        window: np.ndarray,
        which: np.ndarray,
        turns: np.ndarray,
        kinds: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Locate candidates to round-off: place, distance of a change by 1, and whether it is zero.

        Bisection locates a zero and golden sections a turning point, both of the argument itself:
        a series loses its digits near a multiple zero.
        """
        narrow_arguments = self.flow.narrow_arguments
        assert narrow_arguments is not None

        def values(s: np.ndarray) -> np.ndarray:
            z, _, t = self._at(windows, window, s)
            return np.asarray(narrow_arguments(z, t)[0][np.arange(len(s)), which])

        span, at_low = high - low, values(low)
        beside = np.maximum(np.abs(at_low), np.abs(values(high)))
        sign = np.where(turns == 0, 1.0, turns)
        for _ in range(_SECTIONS):
            inner, outer = low + _GOLDEN * (high - low), high - _GOLDEN * (high - low)
            at_inner, at_outer = values(inner), values(outer)
            # The zero or the peak lies beyond the inner point.
            beyond = np.where(turns == 0, at_low * at_inner > 0, sign * at_inner < sign * at_outer)
            low = np.where(beyond, inner, low)
            high = np.where(beyond, high, np.where(turns == 0, inner, outer))
        place = (low + high) / 2
        at_place = np.where(turns == 0, 0.0, values(place))
        unit = np.where(kinds[which] == Narrow.FUNCTION, 1.0, np.abs(at_place))
        width = np.ones(len(place))
        for halvings in range(_HALVINGS):
            distance = span * 2.0**-halvings
            near = [np.clip(place + side * distance, 0.0, 1.0) for side in (-1, 1)]
            change = np.max([np.abs(values(s) - at_place) for s in near], axis=0)
            # Where the argument is NaN, the residual decides.
            width = np.where(change < unit, width, distance)
        return place, width, np.abs(at_place) <= _TOUCHING * beside

    def _energy_changes(self, windows: Windows, sizes: np.ndarray) -> np.ndarray:
        """Return the change of H over each window, in units of the limit."""
        assert self.flow.energy is not None
        z, t = windows.states, windows.edges
        energies = self.flow.energy(z, t)
        # The gradient of H is the vector field with its halves exchanged, up to signs.
        half = z.shape[1] // 2
        slopes = np.abs(np.roll(self.flow.vector_field(z, t), half, axis=1))
        slopes = np.maximum(slopes[:-1], slopes[1:])
        size = np.maximum(np.abs(z[:-1]), np.abs(z[1:]))
        rounding = ROUND_OFF * (np.abs(energies[:-1]) + (slopes * size).sum(axis=1))
        allowed = self.tolerance * (slopes * sizes).sum(axis=1) + rounding
        return _excess(np.abs(np.diff(energies))[:, None], SLACK * allowed[:, None])

    def _energy_jump(self, windows: Windows, index: int) -> float:
        """Locate the time in a window at which H changes fastest."""
        assert self.flow.energy is not None
        energy = self.flow.energy

        def values(s: np.ndarray) -> np.ndarray:
            z, _, t = self._at(windows, np.full(len(s), index), s)
            return energy(z, t)

        s = np.concatenate(([0.0], collocation(_NODES).nodes, [1.0]))
        h = values(s)
        widest = int(np.argmax(np.nan_to_num(np.abs(np.diff(h)), nan=np.inf)))
        low, high, at_low, at_high = s[widest], s[widest + 1], h[widest], h[widest + 1]
        for _ in range(_BISECTIONS):
            middle = (low + high) / 2
            at_middle = values(np.array([middle]))[0]
            if abs(at_middle - at_low) > abs(at_high - at_middle):
                high, at_high = middle, at_middle
            else:
                low, at_low = middle, at_middle
        start, end = windows.edges[index : index + 2]
        return float(start + (end - start) * (low + high) / 2)

    def _sampled(self, windows: Windows, window: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Evaluate z^ at the same places s of windows, shape (windows, places, dim)."""
        values = _columns(self.basis, len(s))
        return np.asarray(windows.states[window, None] + values @ windows.readouts[window])

    def _at(
        self, windows: Windows, window: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate z^, dz^/dt and t at places s of windows, shapes (n, dim), (n, dim) and (n,)."""
        values, rates = self.basis.columns(s)
        readouts, lengths = windows.readouts[window], np.diff(windows.edges)[window]
        z = windows.states[window] + np.einsum("nm,nmd->nd", values, readouts)
        dz = np.einsum("nm,nmd->nd", rates, readouts) / lengths[:, None]
        return z, dz, windows.edges[window] + lengths * s


def _places(count: int) -> np.ndarray:
    """Return nodes of a rule and places near both ends of a window."""
    return np.concatenate((_ENDS, collocation(count).nodes, 1 - _ENDS[::-1]))


@functools.lru_cache(maxsize=16)
def _columns(basis: FeatureBasis, places: int) -> np.ndarray:
    """Return the columns at the places of a rule."""
    return basis.columns(_places(places - 2 * len(_ENDS)))[0]


def _excess(values: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """Return the largest ratio in each row, infinite where it is NaN or a limit is infinite."""
    with np.errstate(all="ignore"):
        ratios = np.where(allowed < np.inf, values / np.maximum(allowed, TINY), np.inf)
        largest = ratios.max(axis=1)
    return np.where(np.isnan(largest), np.inf, largest)
