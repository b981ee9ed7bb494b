"""Checks of windows at times that the march did not use.

The march judges a window by its residual at fixed places. What happens between them, such as a
pulse of the force that is narrower than their distance, leaves no trace there. Three checks look
again:

1. *Places from the formula.* Pulses, steps and poles of H have their places where the argument of
   exp, tanh, erf and the like, or the base of a negative or broken power, is zero or extreme.
   These arguments are smooth along the trajectory, so the times are found from their Chebyshev
   series, with the width of what happens there, and the residual is taken at and around them.
2. *Random places*, seeded: the residual again.
3. *Energy.* Where H does not depend on time, it may change over a window by no more than the local
   error that the tolerance allows. A step of the potential that was passed over unseen changes it.

Not detectable is a pulse that leaves H as it was, such as a narrow bump of the potential, whose
place cannot be read from the formula in this way, and which no sampled time meets.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.features import FeatureBasis
from hamsym.flow import Flow
from hamsym.march_loop import EPS, NOISE, ROUND_OFF, TINY
from hamsym.tangent import collocation

__all__ = ["Failure", "WindowChecks"]

_NODES = 32  # of the series of the arguments
_NARROW = 0.1  # of a window: what is wider is seen by the march
_AROUND = np.array([-1.5, -0.7, 0.0, 0.7, 1.5])  # places of the residual, in widths
_RANDOM = 2  # places in each window
_SLACK = 10.0  # of what the march allows at its own places
_BISECTIONS = 40
_NEWTON = 3  # steps, each of which doubles the digits


class Failure(NamedTuple):
    """The first window that failed, times to look at, by how much it failed, and what did."""

    window: int
    times: list[float]
    excess: float
    cause: str


class Windows(NamedTuple):
    """Consecutive windows: edges (n + 1,), states (n + 1, dim) and readouts (n, m, dim)."""

    edges: np.ndarray
    states: np.ndarray
    readouts: np.ndarray


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
        """Check windows of which the components have these sizes; None if all pass."""
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
        """The largest residual of each window, in units of what is allowed, and where it is."""
        count = len(windows.readouts)
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
        # At one place the rate may be zero: what it is elsewhere in the window counts.
        largest = np.zeros((count, z.shape[1]))
        np.maximum.at(largest, window, np.abs(dz))
        allowed = self.tolerance * sizes + ROUND_OFF * length * largest[window]
        excess = _excess(defect, _SLACK * allowed)
        suspect = np.flatnonzero(excess > 1)
        if len(suspect):
            more = NOISE * length[suspect] * self._round_off(windows, window[suspect])
            excess[suspect] = _excess(defect[suspect], _SLACK * (allowed[suspect] + more))
        worst = np.zeros(count)
        np.maximum.at(worst, window, excess)
        places: dict[int, list[float]] = {}
        for index in np.flatnonzero(excess > 1):
            places.setdefault(int(window[index]), []).append(float(t[index]))
        return worst, places

    def _round_off(self, windows: Windows, window: np.ndarray) -> np.ndarray:
        """What a unit in the last place of the states changes in the rates, shape (n, dim).

        As is usual in the window: where something narrow happens the rates change by far more.
        """
        used, index = np.unique(window, return_inverse=True)
        s = self.basis.nodes
        z, _, t = self._at(windows, np.repeat(used, len(s)), np.tile(s, len(used)))
        disturbed = z * (1 + EPS * self._generator.choice((-1.0, 1.0), size=z.shape))
        noise = np.abs(self.flow.vector_field(disturbed, t) - self.flow.vector_field(z, t))
        return np.asarray(np.median(noise.reshape(len(used), len(s), -1), axis=1)[index])

    def _narrow_places(self, windows: Windows) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where something narrow may happen: windows, places s and widths, in window lengths."""
        assert self.flow.narrow_arguments is not None
        rule, count = collocation(_NODES), len(windows.readouts)
        s = np.concatenate(([0.0], rule.nodes, [1.0]))
        window = np.repeat(np.arange(count), len(s))
        z, _, t = self._at(windows, window, np.tile(s, count))
        arguments, bases = self.flow.narrow_arguments(z, t)
        g = arguments.reshape(count, len(s), -1)
        steps = np.diff(s)[:, None]
        slopes = np.diff(g, axis=1) / steps
        curvatures = 2 * np.diff(slopes, axis=1) / (steps[1:] + steps[:-1])
        # Twice as wide as wanted, since differences are coarse.
        coarse = 2 * _NARROW
        crosses = (g[:, :-1] * g[:, 1:] <= 0) & (np.abs(slopes) * coarse > 1) & ~bases
        turns = (slopes[:, :-1] * slopes[:, 1:] <= 0) & (
            np.abs(curvatures) * coarse**2 > 2 * np.where(bases, np.abs(g[:, 1:-1]), 1.0)
        )
        places: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
        for found, order in ((crosses, 0), (turns, 1)):
            w, i, k = np.nonzero(found)
            if not len(w):
                continue
            series = np.einsum("ln,wn->lw", rule.to_series, g[:, 1:-1][w, :, k])
            low, high = s[i], s[i + 1 + order]
            guesses = 2 * (s[i + order] if order else (low + high) / 2) - 1
            x = _newton(chebyshev.chebder(series, order), guesses, 2 * low - 1, 2 * high - 1)
            rate = np.abs(_values(chebyshev.chebder(series, 2 if order else 1), x))
            with np.errstate(all="ignore"):
                if order:
                    unit = np.where(bases[k], np.abs(_values(series, x)), 1.0)
                    width = np.sqrt(2 * unit / (4 * rate))
                else:
                    width = 1 / (2 * rate)
            narrow = width < _NARROW
            places.append((w[narrow], (x[narrow] + 1) / 2, width[narrow]))
        if not places:
            return np.empty(0, dtype=int), np.empty(0), np.empty(0)
        w, s, width = (np.concatenate(parts) for parts in zip(*places, strict=True))
        # Inside the window: at a breakpoint the equations of the next one may hold.
        around = np.clip(s[:, None] + width[:, None] * _AROUND, 1e-9, 1 - 1e-9)
        return (
            np.repeat(w, len(_AROUND)),
            around.ravel(),
            np.repeat(np.minimum(4 * width, 1.0), len(_AROUND)),
        )

    def _energy_changes(self, windows: Windows, sizes: np.ndarray) -> np.ndarray:
        """The change of H over each window, in units of what is allowed."""
        assert self.flow.energy is not None
        z, t = windows.states, windows.edges
        energies = self.flow.energy(z, t)
        # The gradient of H is the vector field turned by a right angle.
        half = z.shape[1] // 2
        slopes = np.abs(np.roll(self.flow.vector_field(z, t), half, axis=1))
        slopes = np.maximum(slopes[:-1], slopes[1:])
        size = np.maximum(np.abs(z[:-1]), np.abs(z[1:]))
        rounding = ROUND_OFF * (np.abs(energies[:-1]) + (slopes * size).sum(axis=1))
        allowed = self.tolerance * (slopes * sizes).sum(axis=1) + rounding
        return _excess(np.abs(np.diff(energies))[:, None], _SLACK * allowed[:, None])

    def _energy_jump(self, windows: Windows, index: int) -> float:
        """The time in a window at which H changes fastest."""
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

    def _at(
        self, windows: Windows, window: np.ndarray, s: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z^, dz^/dt and t at places s of windows, shapes (n, dim), (n, dim) and (n,)."""
        values, rates = self.basis.columns(s)
        readouts, lengths = windows.readouts[window], np.diff(windows.edges)[window]
        z = windows.states[window] + np.einsum("nm,nmd->nd", values, readouts)
        dz = np.einsum("nm,nmd->nd", rates, readouts) / lengths[:, None]
        return z, dz, windows.edges[window] + lengths * s


def _excess(values: np.ndarray, allowed: np.ndarray) -> np.ndarray:
    """The largest ratio in each row, infinite where it is not a number."""
    with np.errstate(all="ignore"):
        ratios = values / np.maximum(allowed, TINY)
    return np.asarray(np.nan_to_num(ratios, nan=np.inf).max(axis=1))


def _newton(series: np.ndarray, x: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Zeros of Chebyshev series, one in each column, near x and between low and high."""
    slope = chebyshev.chebder(series)
    for _ in range(_NEWTON):
        with np.errstate(all="ignore"):
            moved = x - _values(series, x) / _values(slope, x)
        x = np.clip(np.where(np.isfinite(moved), moved, x), low, high)
    return x


def _values(series: np.ndarray, x: np.ndarray) -> np.ndarray:
    degrees = np.arange(len(series))[:, None]
    return np.asarray((series * np.cos(degrees * np.arccos(np.clip(x, -1, 1)))).sum(axis=0))
