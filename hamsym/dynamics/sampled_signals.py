"""Signals at equal times along trajectories, so many that they show the whole signal.

Input:  a result, and components or formulas.
Output: :class:`Samples` of each signal, with what is between them.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import scipy.fft

from hamsym.codegen.observable import Observable
from hamsym.dynamics.hidden_signals import follows
from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.trajectory import Trajectory
from hamsym.solution.solution import Solution

# Times at which a solution is evaluated: doubled until its spectrum ends before the highest
# frequency of that many samples.
_FEWEST, MOST = 2**11, 2**20
# Part of the spectrum, relative to its largest value, that may be left at its end.
_TAIL = 1e-10
# Power of the window 1 + cos: errors by neighbouring terms fall like T^-(2 n + 2).
_POWER = 2
#: Times between the samples, as a share of their distance, at which the signal is compared with the
#: one band-limited function through the samples: no multiple of it is close to a whole number.
BETWEEN = 0.381966
#: Largest difference there, relative to the signal, at which samples of a solution are enough.
MISSED = 1e-6
# Most samples at which features between them are looked for.
_MOST_SEARCHED = 2**16


class Signal(NamedTuple):
    """f, or the complex f - i c g where a pair is given, with c = 1 unless it is scaled."""

    text: str
    first: Observable
    second: Observable | None = None
    is_scaled: bool = False
    #: Values of the parameters of a trajectory, shape (k,).
    parameters: np.ndarray | None = None

    @property
    def parts(self) -> list[Observable]:
        return [self.first] if self.second is None else [self.first, self.second]

    @property
    def is_real(self) -> bool:
        return self.second is None

    def ratio(self, z: np.ndarray, t: np.ndarray) -> float:
        """c, for equal sizes."""
        if self.second is None or not self.is_scaled:
            return 1.0
        sizes = [np.ptp(part(z, t, self.parameters)) for part in self.parts]
        return float(sizes[0] / sizes[1]) if sizes[0] and sizes[1] else 1.0

    def value(self, z: np.ndarray, t: np.ndarray, ratio: float) -> np.ndarray:
        first, *second = [
            np.broadcast_to(np.asarray(part(z, t, self.parameters), dtype=float), t.shape)
            for part in self.parts
        ]
        return first - 1j * ratio * second[0] if second else first

    def error(self, z: np.ndarray, t: np.ndarray, ratio: float, errors: np.ndarray) -> float:
        """The largest change of the signal by errors of the components."""
        values, change = self.value(z, t, ratio), np.zeros(len(t))
        for component in np.eye(z.shape[1], dtype=bool):
            moved = np.where(component, z + errors, z)
            change += np.abs(self.value(moved, t, ratio) - values)
        return float(np.nan_to_num(change, nan=np.inf, posinf=np.inf).max())


def signal_of(H: Hamiltonian, entry: Any, scaled: bool) -> Signal:
    if not isinstance(entry, (tuple, list)):
        one = H.observable(entry)
        return Signal(one.text, one)
    if len(entry) != 2:
        raise InputError(f"{entry!r} is no pair; give (f, g) for the signal f - i g")
    first, second = (H.observable(part) for part in entry)
    sign = "- i c" if scaled else "- i"
    return Signal(f"{first.text} {sign} {second.text}", first, second, scaled)


class Samples(NamedTuple):
    """A signal at equal steps."""

    times: np.ndarray
    #: The states there, shape (n, dim).
    states: np.ndarray
    values: np.ndarray
    #: At the times :data:`BETWEEN` them, one fewer.
    between: np.ndarray
    #: Largest error of the values by that of the states.
    error: float
    #: Root mean square of what the values do not tell of those between, as with aliased terms.
    missed: float


@dataclass(frozen=True)
class Source:
    """Trajectories of a result."""

    H: Hamiltonian
    z0: np.ndarray
    span: tuple[float, float]
    shape: tuple[int, ...]
    #: count -> equal times, as many if there is a choice.
    times: Callable[[int], np.ndarray]
    #: (place, times) -> states.
    states: Callable[[tuple[int, ...], np.ndarray], np.ndarray]
    #: Largest error of each component at a place, shape (dim,).
    errors: Callable[[tuple[int, ...]], np.ndarray]
    #: Values of the parameters at a place, shape (k,).
    parameters: Callable[[tuple[int, ...]], np.ndarray]

    def followed(
        self, place: tuple[int, ...], signal: Signal, claimed: Callable[[Samples], float]
    ) -> tuple[Samples, bool]:
        """The signal at equal steps, and whether they show all that is between them.

        - claimed: What features that they do not show may change in the mean of the signal.
        """
        count, own = _FEWEST, self.parameters(place)
        signal = signal._replace(parameters=own)
        while True:
            found = self._sampled(place, signal, count)
            path = found.times, found.states, own
            if follows(self.H, signal.parts, *path, claimed(found)):
                return found, True
            count = 2 * len(found.times)
            if not (count <= _MOST_SEARCHED and len(self.times(count)) == count):
                return found, False

    def _sampled(self, place: tuple[int, ...], signal: Signal, count: int) -> Samples:
        """The signal at equal steps, as many as its spectrum needs."""
        errors = self.errors(place)
        while True:
            t = self.times(count)
            z = self.states(place, t)
            with np.errstate(all="ignore"):
                ratio = signal.ratio(z, t)
                values, error = signal.value(z, t, ratio), signal.error(z, t, ratio, errors)
                # Of times that float64 rounds, far from zero.
                rounding = np.spacing(np.abs(t).max()) - np.spacing(np.abs(t - t[0]).max())
                error += max(rounding, 0.0) * float(np.abs(np.diff(values) / np.diff(t)).max())
                later = t[:-1] + BETWEEN * np.diff(t)
                between = signal.value(self.states(place, later), later, ratio)
                missed = _missed(values, between)
            size = float(np.abs(values).max())
            is_resolved = _is_resolved(values, max(_TAIL * size, error))
            enough = is_resolved and missed <= max(MISSED * size, error)
            if len(t) != count or count >= MOST or enough or not np.isfinite(values).all():
                return Samples(t, z, values, between, error, missed)
            count *= 2


def _missed(values: np.ndarray, between: np.ndarray) -> float:
    """The difference, with the window, of values and the band-limited function through others."""
    count = len(values)
    turns = np.exp(2j * np.pi * scipy.fft.fftfreq(count) * BETWEEN)
    told = scipy.fft.ifft(scipy.fft.fft(values * window(count)) * turns)[:-1]
    away = np.abs(told - between * window(count, BETWEEN)[:-1])
    missed = np.sqrt(np.sum(away**2) / np.sum(window(count) ** 2))
    return float(missed) if missed >= 0 else math.inf


def _is_resolved(values: np.ndarray, tail: float) -> bool:
    """Whether the spectrum has ended before its highest frequencies."""
    spectrum = np.abs(scipy.fft.fft(values * window(len(values))))
    middle, width = len(values) // 2, len(values) // 16
    return bool(spectrum[middle - width : middle + width].max() <= tail)


def window(count: int, shift: float = 0.0) -> np.ndarray:
    """The weights of a mean, (1 + cos(pi x))^n; with a shift, beside the places by this share."""
    x = np.linspace(-1, 1, count)
    weights = (1 + np.cos(np.pi * x)) ** _POWER
    beside = (1 + np.cos(np.pi * (x + shift * (x[1] - x[0])))) ** _POWER if shift else weights
    return np.asarray(beside / weights.sum())


def source_of(result: Any) -> Source:
    if isinstance(result, Trajectory):
        return _source_of_trajectory(result)
    if isinstance(result, (Solution, Solutions)):

        @functools.lru_cache(maxsize=1)  # a member is made anew each time
        def member(place: tuple[int, ...]) -> Solution:
            return result[place] if isinstance(result, Solutions) else result

        return Source(
            result.H,
            np.asarray(result.z0),
            result.span,
            result.shape if isinstance(result, Solutions) else (),
            lambda count: np.linspace(*result.span, count),
            lambda place, t: np.asarray(member(place)(t)),
            lambda place: np.asarray(member(place).largest_error),
            lambda place: np.array([*member(place).H.parameters.values()], dtype=float),
        )
    raise InputError(
        f"frequencies are those of a Solution, a Trajectory or Solutions, not of a "
        f"{type(result).__name__}"
    )


def _source_of_trajectory(result: Trajectory) -> Source:
    t = np.asarray(result.t)
    steps = np.diff(t)
    if len(t) < 64 or not np.abs(steps - steps.mean()).max() <= 1e-9 * np.abs(steps).max():
        raise InputError(
            "the states are not at equal steps, or fewer than 64; integrate with saves= equal times"
        )
    z = np.asarray(result.z)
    between = np.asarray(result(t[:-1] + BETWEEN * steps))  # refused where they are too far apart
    errors = result.largest_error

    def states(place: tuple[int, ...], times: np.ndarray) -> np.ndarray:
        return np.asarray((z if len(times) == len(t) else between)[place])

    def of_states(place: tuple[int, ...]) -> np.ndarray:
        return np.full(z.shape[-1], math.inf) if errors is None else np.asarray(errors[place])

    def parameters(place: tuple[int, ...]) -> np.ndarray:
        return result.ensemble.parameters.reshape(*z.shape[:-2], -1)[place]

    span, shape = (float(t[0]), float(t[-1])), z.shape[:-2]
    return Source(result.H, z[..., 0, :], span, shape, lambda _: t, states, of_states, parameters)
