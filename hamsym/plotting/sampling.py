"""Times at which a motion is drawn: as many as its oscillations need."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from hamsym.plotting.style import SAMPLES

_MOST = 20_000  # times of a figure
_MOST_STATES = 500_000  # of all trajectories of a figure
#: Distance of a line from the curve, relative to the range of a component, up to which they look
#: the same: a circle has 22 lines then.
_BENT = 0.005
#: Where a curve is compared with a line; at a simple fraction whole turns would not be noticed.
_BETWEEN = (3 - 5**0.5) / 2


def resolved(
    states: Callable[[np.ndarray], np.ndarray], times: np.ndarray, trajectories: int = 1
) -> tuple[np.ndarray, np.ndarray, str]:
    """Sample a motion, and again where lines between the samples do not look like the curve.

    - states: Times, shape (n,) -> states, shape (..., n, dim).
    - times: The first samples.
    - trajectories: How many are drawn; of many fewer times are allowed.
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
    t = thinned(times, 2 * SAMPLES)
    z = np.asarray(states(t))
    while True:
        between = (1 - _BETWEEN) * t[:-1] + _BETWEEN * t[1:]
        curve = np.asarray(states(between))
        bent = _bent(z, curve)
        if not bent.any():
            return t, z, ""
        if len(t) + bent.sum() > most:
            return t, z, f"Dots: {len(t):,} times, too few for lines between them"
        places = np.flatnonzero(bent)
        t = np.insert(t, places + 1, between[places])
        z = np.insert(z, places + 1, curve[..., places, :], axis=-2)


def thinned(times: np.ndarray, most: int) -> np.ndarray:
    """Return at most this number of times, evenly chosen, with the first and the last."""
    if len(times) <= most:
        return times
    return times[np.linspace(0, len(times) - 1, most).round().astype(int)]


def _bent(z: np.ndarray, curve: np.ndarray) -> np.ndarray:
    """Return for each line between samples whether it does not look like the curve."""
    with np.errstate(all="ignore"):
        lines = (1 - _BETWEEN) * z[..., :-1, :] + _BETWEEN * z[..., 1:, :]
        finite = np.where(np.isfinite(z), z, np.nan)
        extent = np.nanmax(finite, axis=-2) - np.nanmin(finite, axis=-2)
        # States that are not finite, and components at rest, are compared with nothing.
        far = np.abs(curve - lines) > _BENT * extent[..., None, :]
    far &= extent[..., None, :] > 0
    return np.asarray(far.any(axis=(*range(far.ndim - 2), -1)))
