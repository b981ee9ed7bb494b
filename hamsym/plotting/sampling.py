"""Times at which a motion is drawn: as many as its oscillations need."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager

import numpy as np

from hamsym.codegen.observable import Observable
from hamsym.facts.wording import evenly
from hamsym.plotting.style import SAMPLES

_MOST = 20_000  # times of a figure
_MOST_STATES = 500_000  # of all trajectories of a figure
#: Distance of a line from the curve, relative to the range of a component, up to which they look
#: the same: a circle has 22 lines then.
_BENT = 0.005
#: Where a curve is compared with a line; at a simple fraction whole turns would not be noticed.
_BETWEEN = (3 - 5**0.5) / 2
# Times that formulas alone are sampled again: a pole has no curve that more samples resolve.
_ROUNDS = 6
# Of a formula: values as many times beyond its usual range are near a pole, or of no shape to see.
_BEYOND = 10.0
# Of the usual size of a formula: between values that are so many times larger, of different signs,
# is a pole.
_POLE = 100.0


def with_formulas(
    z: np.ndarray,
    t: np.ndarray,
    formulas: Sequence[Observable],
    parameters: np.ndarray | None = None,
) -> np.ndarray:
    """Return states, shape (..., n, dim), followed by the values of formulas; nan for none.

    - parameters: Of each trajectory, shape (..., k); None for those of H.
    """
    if not formulas:
        return z
    own = None if parameters is None else parameters[..., None, :]
    columns = [np.broadcast_to(f.values(z, t, own), z.shape[:-1]) for f in formulas]
    return np.concatenate((z, np.stack(columns, axis=-1)), axis=-1)


@contextmanager
def _silence() -> Iterator[None]:
    """Give no warning of numpy, also of columns that are nan throughout."""
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        yield


def _broken_at_poles(z: np.ndarray, count: int) -> np.ndarray:
    """Return samples with gaps where one of the last columns passes through infinity."""
    if not count:
        return z
    values = z[..., -count:]
    with _silence():
        sizes = np.abs(values)
        usual = np.nanmedian(np.where(np.isfinite(values), sizes, np.nan), axis=-2, keepdims=True)
        large = np.minimum(sizes[..., :-1, :], sizes[..., 1:, :]) > _POLE * usual
        poles = large & (values[..., :-1, :] * values[..., 1:, :] < 0)
    z = z.copy()
    z[..., 1:, -count:][poles] = np.nan
    return z


def resolved(
    states: Callable[[np.ndarray], np.ndarray],
    times: np.ndarray,
    trajectories: int = 1,
    formulas: Sequence[Observable] = (),
    parameters: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, str]:
    """Sample a motion, and again where lines between the samples do not look like the curve.

    - states: Times, shape (n,) -> states, shape (..., n, dim).
    - times: The first samples.
    - trajectories: How many are drawn; of many fewer times are allowed.
    - formulas, parameters: As of :func:`with_formulas`; their values follow the states.
    - returns apart: The sentence for the caption if so many are too few, else "".

    Examples
    --------
    >>> def turns(t):
    ...     return np.stack([np.cos(t), np.sin(t)], axis=-1)
    >>> for count in (10, 500, 100_000):
    ...     t, _, apart = resolved(turns, np.linspace(0, 2 * np.pi * count, 2001))
    ...     print(len(t), apart)
    2001
    16001
    16001 Dots: 16,001 times, too few for lines between them
    """
    most = min(_MOST, max(SAMPLES, _MOST_STATES // max(trajectories, 1)))
    t = times[evenly(len(times), 2 * SAMPLES)]
    count, rounds = len(formulas), 0

    def sampled(t: np.ndarray) -> np.ndarray:
        return with_formulas(np.asarray(states(t)), t, formulas, parameters)

    z = sampled(t)
    while True:
        between = (1 - _BETWEEN) * t[:-1] + _BETWEEN * t[1:]
        curve = sampled(between)
        bent = _bent(z, curve, count, rounds < _ROUNDS)
        if not bent.any():
            return t, _broken_at_poles(z, count), ""
        if len(t) + bent.sum() > most:
            return t, z, f"Dots: {len(t):,} times, too few for lines between them"
        rounds += 1
        places = np.flatnonzero(bent)
        t = np.insert(t, places + 1, between[places])
        z = np.insert(z, places + 1, curve[..., places, :], axis=-2)


def _bent(z: np.ndarray, curve: np.ndarray, formulas: int, judged: bool) -> np.ndarray:
    """Return for each line between samples whether it does not look like the curve.

    - formulas: Number of last columns that are formulas, whose poles have no shape.
    - judged: Whether formulas count.
    """
    dim, edges = z.shape[-1] - formulas, np.zeros(z.shape[-2] - 1, dtype=bool)
    if formulas and judged:
        known = np.isfinite(z[..., dim:])
        change = known[..., :-1, :] != known[..., 1:, :]
        edges = np.asarray(change.any(axis=(*range(change.ndim - 2), -1)))
        with _silence():
            values = np.where(known, z[..., dim:], np.nan)
            low, high = np.nanquantile(values, (0.02, 0.98), axis=-2, keepdims=True)
            room = np.where(high > low, _BEYOND * (high - low), np.inf)
            ends = low - room, high + room
            z, curve = (
                np.concatenate((each[..., :dim], np.clip(each[..., dim:], *ends)), axis=-1)
                for each in (z, curve)
            )
    else:
        z, curve = z[..., :dim], curve[..., :dim]
    with _silence():
        lines = (1 - _BETWEEN) * z[..., :-1, :] + _BETWEEN * z[..., 1:, :]
        finite = np.where(np.isfinite(z), z, np.nan)
        extent = np.nanmax(finite, axis=-2) - np.nanmin(finite, axis=-2)
        # States that are not finite, and components at rest, are compared with nothing.
        far = np.abs(curve - lines) > _BENT * extent[..., None, :]
    far &= extent[..., None, :] > 0
    return edges | np.asarray(far.any(axis=(*range(far.ndim - 2), -1)))
