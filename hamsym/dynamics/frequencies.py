"""Fundamental frequencies of trajectories: amplitudes, frequencies, phases, and how they drift.

Input:  trajectories as functions of time, or at equal steps.
Output: :class:`Frequencies`, s(t) = sum_k a_k exp(i (omega_k t + phi_k)) for each signal s.

Numerical analysis of fundamental frequencies (Laskar 1990, Icarus 88, 266): omega_k maximises the
size of the mean of s exp(-i omega t) with the weight (1 + cos(pi x))^n over the span, -1 <= x <= 1;
all amplitudes are fitted again, and the next frequency is that of the rest. Neighbouring terms
shift each maximum. The same analysis of the sum that was found shows by how much, to first order,
and its shifts are subtracted (Sidlichovsky & Nesvorny 1996, Celest. Mech. 65, 137).
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
import scipy.fft

from hamsym.dynamics.sampled_signals import (
    BETWEEN,
    MISSED,
    MOST,
    Samples,
    Signal,
    Source,
    signal_of,
    source_of,
    window,
)
from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.trajectory import Trajectory
from hamsym.solution.solution import Solution
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import checked_numbers, require_whole

_NEWTON = 30
# Amplitudes below this part of the largest are round-off.
_SMALLEST = 1e-13
_ROUND_OFF = 1e-15
# Terms are known if their amplitude is larger than this many differences.
_KNOWN = 4.0
# Half of the width of a peak of the spectrum, in radians over half of the span, the places in it at
# which the rest is measured, and the largest error of a maximum in it, 3 pi over the span.
_PEAK, _PLACES, _RESOLUTION = 3 * math.pi, 25, 1.5 * math.pi
# What is left in a peak, relative to the largest rest elsewhere, that comes from there.
_LEAK = 0.1
# Two terms that leave the part r of a maximum are closer to it than 4 or 5 sqrt(r): with a margin.
_BLEND = 8.0


@suggest_attributes
@dataclass(frozen=True)
class Frequencies(Drawn, Shown):
    """Quasi-periodic approximations of signals, from :func:`hamsym.frequencies`.

    The shape ``...`` is that of an ensemble, () for one trajectory. Terms are in the order of their
    amplitudes; those that were not found are nan. ``plot()`` draws amplitudes over frequencies, of
    an ensemble the first frequencies of all trajectories with their drift.

    Attributes
    ----------
    signals : tuple of str
    frequency : numpy.ndarray
        Angular frequencies omega_k, radians per unit of time, shape (..., signals, count). Of real
        signals positive ones.
    amplitude, phase : numpy.ndarray
        a_k > 0 in the units of the signal, and phi_k at t = 0, of the same shape.
    error : numpy.ndarray
        Estimated errors of the frequencies, from errors of the states, shifts by neighbouring
        terms and the drift; up to 3 pi over the span where a peak may be two. Infinite where the
        error of the states is not known, and of terms too small for the distance of saved states.
    drift : numpy.ndarray
        Difference of each frequency between the halves of the span: about the error on a torus,
        more in chaos.
    rest : numpy.ndarray
        Root mean square of the rest, relative to that of the signal, shape (..., signals).
    H : Hamiltonian
    z0 : numpy.ndarray
        Starts, shape (..., dim).
    span : (float, float)
    seconds : float
    success : bool
        Whether every trajectory has at least one frequency with a finite error.
    message : str
    """

    signals: tuple[str, ...]
    frequency: np.ndarray = field(repr=False)
    amplitude: np.ndarray = field(repr=False)
    phase: np.ndarray = field(repr=False)
    error: np.ndarray = field(repr=False)
    drift: np.ndarray = field(repr=False)
    rest: np.ndarray = field(repr=False)
    H: Hamiltonian = field(repr=False)
    z0: np.ndarray = field(repr=False)
    span: tuple[float, float]
    seconds: float = field(repr=False)
    success: bool
    message: str

    def __call__(self, t: Any) -> np.ndarray:
        """Evaluate the sums of one trajectory at times t, shape (n,): shape (n, signals), complex.

        Raises
        ------
        InputError
            If there are several trajectories.
        """
        if self.frequency.ndim != 2:
            raise InputError("these are the frequencies of several trajectories; take one")
        times = checked_numbers("t", t)[..., None, None]
        with np.errstate(invalid="ignore"):
            terms = self.amplitude * np.exp(1j * (self.frequency * times + self.phase))
        return np.asarray(np.nansum(terms, axis=-1))


@checked_keywords
def frequencies(
    result: Solution | Trajectory | Solutions,
    *signals: Any,
    count: int = 6,
) -> Frequencies:
    """Find the frequencies of a trajectory, or of each trajectory of an ensemble.

    Parameters
    ----------
    result : Solution, Trajectory or Solutions
        Of a trajectory of :func:`hamsym.integrate` all saved states, at equal steps. Without
        ``tol`` its errors are not known, nor those of its frequencies.
    *signals : str, sympy.Expr, or pairs of these
        Components or formulas (:meth:`hamsym.Hamiltonian.observable`), of which a pair (f, g) is
        the complex signal f - i g. By default the pairs (q, c p) of H, with the ratio c of their
        sizes: a harmonic oscillator with H = omega (q^2 + p^2)/2 has one term, exp(i omega t).
    count : int
        Most terms of a signal.

    Returns
    -------
    Frequencies

    Raises
    ------
    InputError
        If the result is none of these, or its states are not at equal steps or too far apart.

    Examples
    --------
    >>> import hamsym, scipy.special
    >>> swing = hamsym.solve("p**2/2 - cos(x)", [1.0, 0.0], (0, 400))
    >>> found = hamsym.frequencies(swing, "x")
    >>> exact = np.pi / (2 * scipy.special.ellipk(np.sin(0.5) ** 2))
    >>> found.frequency[0, :3].round(6)  # the odd multiples of one frequency
    array([0.937792, 2.813377, 4.688961])
    >>> bool(abs(found.frequency[0, 0] - exact) <= found.error[0, 0] < 1e-9)
    True
    """
    require_whole("count", count, 1, MOST)
    began = time.perf_counter()
    source = source_of(result)
    names, dof = source.H.names, source.H.dof
    chosen = signals or tuple(zip(names[:dof], names[dof:], strict=True))
    read = [signal_of(source.H, entry, scaled=not signals) for entry in chosen]
    shape = source.shape
    arrays = np.full((5, *shape, len(read), count), np.nan)
    rest = np.full((*shape, len(read)), np.nan)
    for place in np.ndindex(*shape):
        for k, signal in enumerate(read):
            found, rest[(*place, k)] = _analysed(source, place, signal, count)
            arrays[(slice(None), *place, k, slice(0, found.shape[1]))] = found
    frequency, amplitude, phase, error, drift = arrays
    # A signal that is zero beside others, as that of a component at rest, has no frequency.
    known, is_zero = np.isfinite(error[..., 0]), np.isnan(frequency[..., 0]) & (rest == 0)
    good = (known | is_zero).all(axis=-1) & known.any(axis=-1)
    failed = int((~good).sum())
    message = f"up to {count} frequencies of {', '.join(s.text for s in read)}"
    if failed:
        message = (
            f"{failed} of {good.size} trajectories have no frequency with a known error; {message}"
        )
        if isinstance(result, Trajectory) and result.errors is None:
            message += "; errors of the states are not known; integrate with tol"
    return Frequencies(
        tuple(signal.text for signal in read),
        frequency,
        amplitude,
        phase,
        error,
        drift,
        rest,
        source.H,
        source.z0,
        source.span,
        time.perf_counter() - began,
        not failed,
        message,
    )


class Average(NamedTuple):
    """A time average and its estimated error."""

    value: float
    #: Infinite if those of the states are not known, and where no samples show all of the signal.
    error: float


@checked_keywords
def time_average(result: Solution | Trajectory, f: Any) -> Average:
    """Compute the time average of a component or formula, with the weight exp(-1/(x (1 - x))).

    On quasi-periodic motion the weighted average converges faster than any power of the span (Das,
    Sander & Yorke 2017, Nonlinearity 30, 4111); in chaos like its square root. The average rate of
    an angle is its rotation number. The error is estimated from the halves of the span, from other
    times, and from that of the states.

    Parameters
    ----------
    result : Solution or Trajectory
        One trajectory.
    f : str or sympy.Expr

    Examples
    --------
    >>> import hamsym
    >>> swing = hamsym.solve("p**2/2 - cos(x)", [0.0, 2.5], (0, 300))  # over the top
    >>> found = hamsym.time_average(swing, "p")  # the rate of the angle x
    >>> round(found.value, 8), bool(found.error < 1e-9)
    (1.96811775, True)
    """
    source = source_of(result)
    if source.shape:
        raise InputError("the average is that of one trajectory; take one of the ensemble")
    signal = signal_of(source.H, f, scaled=False)
    found, is_whole = source.followed((), signal, lambda samples: _average(samples).error)
    average = _average(found)
    return average if is_whole else average._replace(error=math.inf)


def _average(samples: Samples) -> Average:
    values, half = samples.values.real, len(samples.values) // 2
    whole = _weighted(values)
    parts = _weighted(values[: half + 1]), _weighted(values[len(values) - half - 1 :])
    away = np.abs([*parts, _weighted(samples.between.real, BETWEEN)] - np.array(whole)).max()
    error = float(away) + samples.error + _ROUND_OFF * abs(whole)
    return Average(whole, error if error >= 0 else math.inf)


def _weighted(values: np.ndarray, shift: float = 0.0) -> float:
    """The weighted mean of values at equal steps; with a shift, of all but the last beside it."""
    count = len(values) + (shift > 0)
    x = (np.arange(len(values)) + shift) / (count - 1)
    inside = (x > 0) & (x < 1)
    weights = np.exp(-1 / (x[inside] * (1 - x[inside])))
    return float(weights @ values[inside] / weights.sum())


# -- analysis --------------------------------------------------------------------------------------


def _analysed(
    source: Source, place: tuple[int, ...], signal: Signal, count: int
) -> tuple[np.ndarray, float]:
    """Rows frequency, amplitude, phase, error and drift of the terms found, and the rest."""
    samples, is_whole = source.followed(place, signal, _unresolved)
    times, values, of_states = samples.times, samples.values, samples.error
    missed = samples.missed if is_whole else math.inf
    if not np.isfinite(values).all():
        return np.empty((5, 0)), math.nan
    if times[0] > times[-1]:
        times, values = times[::-1], values[::-1]
    middle, half = (times[0] + times[-1]) / 2, abs(times[-1] - times[0]) / 2
    elapsed = (times - middle) / half
    values = values.astype(complex)
    terms = _Terms.of(values, elapsed, count, signal.is_real)
    if not len(terms.omega):
        return np.empty((5, 0)), math.inf if missed else 0.0
    again = _Terms.of(terms.sum(elapsed), elapsed, len(terms.omega), signal.is_real, terms.omega)
    shifts = terms.omega - again.omega
    omega = terms.omega + shifts
    corrected = _Terms.fitted(values, elapsed, omega, signal.is_real)
    rest = values - corrected.sum(elapsed)
    halves = np.array(
        [
            list(_halves(rest + corrected.term(k, elapsed), elapsed, omega[k]))
            for k in range(len(omega))
        ]
    )
    drift, away = np.ptp(halves, axis=1), np.abs(halves - omega[:, None]).max(axis=1)
    sizes = np.abs(corrected.amplitude)
    # Terms that are not found shift the maxima of the halves more than those of the whole. The
    # error of the states acts as a change of the phase over the span.
    error = np.abs(shifts) + away + of_states / sizes
    error += _ROUND_OFF * (1 + np.abs(omega))
    error = np.maximum(error, _blends(rest, corrected, elapsed, of_states))
    error[~(sizes > _KNOWN * missed)] = math.inf
    phase = np.angle(corrected.amplitude) - omega * middle / half
    rows = np.array(
        [
            omega / half,
            sizes * (2 if signal.is_real else 1),
            (phase + np.pi) % (2 * np.pi) - np.pi,
            error / half,
            drift / half,
        ]
    )
    rows[1, omega == 0] /= 2 if signal.is_real else 1
    order = np.argsort(-rows[1], kind="stable")
    spread = float(np.sqrt(np.mean(np.abs(values) ** 2))) or 1.0
    return rows[:, order], float(np.sqrt(np.mean(np.abs(rest) ** 2))) / spread


def _unresolved(samples: Samples) -> float:
    """What a feature between samples may change."""
    return max(MISSED * float(np.abs(samples.values).max()), samples.error)


def _blends(rest: np.ndarray, terms: _Terms, elapsed: np.ndarray, floor: float) -> np.ndarray:
    """Errors of frequencies whose peaks may be those of several terms, shape (terms,).

    Two terms closer than a peak is wide have one maximum, the same on all symmetric parts of the
    span. They differ from one term by what is left in the peak.

    - floor: What errors of the signal leave.
    """
    weights = window(len(rest))
    elsewhere = float(np.abs(scipy.fft.fft(rest * weights)).max())
    found = np.zeros(len(terms.omega))
    for k, omega in enumerate(terms.omega):
        near = np.flatnonzero(np.abs(terms.omega - omega) < _PEAK)
        others = [terms.term(int(j), elapsed) for j in near if j != k]
        left = rest + np.sum(others, axis=0)
        places = omega + np.linspace(-_PEAK, _PEAK, _PLACES)
        largest = float(np.abs(np.exp(-1j * places[:, None] * elapsed) @ (left * weights)).max())
        if largest > floor and (len(near) > 1 or largest > _LEAK * elsewhere):
            found[k] = _BLEND * np.sqrt(largest / np.abs(terms.amplitude[k]))
        if terms.is_real and 0 < 2 * abs(omega) < _PEAK:  # as close to its negative
            found[k] = _RESOLUTION
    return np.minimum(found, _RESOLUTION)


def _halves(values: np.ndarray, elapsed: np.ndarray, omega: float) -> Iterator[float]:
    """The frequency of the largest maximum near one, on the halves of the span."""
    half = len(values) // 2
    for part in (slice(0, half + 1), slice(len(values) - half - 1, None)):
        yield _maximum(values[part], elapsed[part], omega)


def _maximum(values: np.ndarray, elapsed: np.ndarray, omega: float) -> float:
    """The frequency near one at which the weighted mean of s exp(-i omega t) is largest."""
    weighted = values * window(len(values))
    width = np.pi / (elapsed[-1] - elapsed[0])
    for _ in range(_NEWTON):
        turned = weighted * np.exp(-1j * omega * elapsed)
        mean, first, second = (np.sum(turned * (-1j * elapsed) ** k) for k in range(3))
        # of the square of the size
        slope = 2 * (np.conj(mean) * first).real
        bend = 2 * (np.abs(first) ** 2 + (np.conj(mean) * second).real)
        if not bend < 0:
            break
        step = float(np.clip(-slope / bend, -width, width))
        omega += step
        if abs(step) <= 4e-16 * max(abs(omega), 1.0):
            break
    return float(omega)


@dataclass(frozen=True)
class _Terms:
    """Frequencies and complex amplitudes in the time from -1 to 1; real signals have both signs."""

    omega: np.ndarray
    amplitude: np.ndarray
    is_real: bool

    def term(self, k: int, x: np.ndarray) -> np.ndarray:
        wave = self.amplitude[k] * np.exp(1j * self.omega[k] * x)
        return np.asarray(2 * wave.real + 0j if self.is_real and self.omega[k] else wave)

    def sum(self, x: np.ndarray) -> np.ndarray:
        found = np.zeros(len(x), dtype=complex)
        for k in range(len(self.omega)):
            found += self.term(k, x)
        return found

    @classmethod
    def fitted(cls, values: np.ndarray, x: np.ndarray, omega: np.ndarray, is_real: bool) -> _Terms:
        """Amplitudes that fit best, in the mean with the weights of the window."""
        every = np.concatenate([omega, -omega[omega != 0]]) if is_real else omega
        waves = np.exp(1j * every[:, None] * x)
        weighted = np.conj(waves) * window(len(x))
        found = np.linalg.solve(weighted @ waves.T, weighted @ values)
        return cls(omega, found[: len(omega)], is_real)

    @classmethod
    def of(
        cls,
        values: np.ndarray,
        x: np.ndarray,
        count: int,
        is_real: bool,
        near: Sequence[float] | np.ndarray = (),
    ) -> _Terms:
        """The largest terms one after the other; with ``near``, those near given frequencies."""
        found = cls(np.empty(0), np.empty(0, dtype=complex), is_real)
        rest, first = values, 0.0
        for k in range(count):
            start = near[k] if len(near) else _peak(rest, x, is_real)
            omega = _maximum(rest, x, start) if start else 0.0
            apart = np.abs(found.omega - omega)
            # within the peak of another term: what is left of it
            if not len(near) and (apart < 1.5 * np.pi).any():
                break
            found = cls.fitted(values, x, np.append(found.omega, omega), is_real)
            rest = values - found.sum(x)
            size = float(np.abs(found.amplitude[k]))
            first = max(first, size)
            if not len(near) and not size > _SMALLEST * first:
                return cls.fitted(values, x, found.omega[:-1], is_real)
        return found


def _peak(values: np.ndarray, x: np.ndarray, is_real: bool) -> float:
    """The frequency of the largest value of the spectrum, on a grid of a quarter of its width."""
    spectrum = np.abs(scipy.fft.fft(values * window(len(values)), 4 * len(values)))
    omega = 2 * np.pi * scipy.fft.fftfreq(len(spectrum), (x[-1] - x[0]) / (len(x) - 1))
    if is_real:
        spectrum = np.where(omega < 0, 0, spectrum)
    best = float(omega[int(np.argmax(spectrum))])
    # A mean value has the frequency zero exactly.
    return 0.0 if abs(best) < 0.5 * np.pi else best
