"""Crossings of a section by trajectories of a manifold, and curves of them between neighbours."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hamsym.invariant_manifolds.manifold import Manifold
from hamsym.numerics.roots import refine, sign_changes
from hamsym.problems.surface import Surface

_NEAR = 0.25  # of the lengths of two segments: distance at which curves may cross
_USUAL = (0.1, 0.9)  # shares of the crossings below and above which some may have escaped
_LEAST = 1e-6  # extent, relative to the size of a component, that is not round-off
_BESIDE = 0.04  # of the extent: distance of places from which Newton's method goes to one solution


@dataclass(frozen=True, eq=False)
class Cut:
    """Crossings in the order of trajectories and, along each, from the origin.

    Attributes
    ----------
    t : numpy.ndarray
        Times, shape (n,).
    z : numpy.ndarray
        States, shape (n, dim).
    trajectory : numpy.ndarray
        Number of the trajectory of each, shape (n,).
    number : numpy.ndarray
        How often the trajectory crossed before, shape (n,).
    rising : numpy.ndarray
        Whether the left side of the surface rises in the direction of time, shape (n,).
    """

    t: np.ndarray
    z: np.ndarray
    trajectory: np.ndarray
    number: np.ndarray
    rising: np.ndarray

    def segments(self, pairs: np.ndarray) -> np.ndarray:
        """Pairs of crossings of neighbours with the same number and direction, shape (m, 2).

        A crossing without neighbours is a pair with itself.

        - pairs: Trajectories that are neighbours, shape (k, 2).
        """
        place = {
            (int(k), int(j)): i
            for i, (k, j) in enumerate(zip(self.trajectory, self.number, strict=True))
        }
        found = []
        for (a, j), i in place.items():
            for _, b in pairs[pairs[:, 0] == a]:
                other = place.get((int(b), j))
                if other is not None and self.rising[i] == self.rising[other]:
                    found.append((i, other))
        joined = {i for pair in found for i in pair}
        found += [(i, i) for i in range(len(self.t)) if i not in joined]
        return np.array(found, dtype=int).reshape(-1, 2)


def cut_of(manifold: Manifold, surface: Surface, most: int) -> Cut:
    """Find the first crossings of each trajectory, between points that resolve its windows.

    - most: Of one trajectory.
    """
    rows: list[tuple[float, np.ndarray, int, int, bool]] = []
    sign, many = manifold.departure.sign, manifold.trajectories
    for k, (times, states) in enumerate(manifold.paths):
        values = np.asarray(surface.value(states, times), dtype=float)
        (places,) = sign_changes(values)
        if not len(places):
            continue

        def value(t: np.ndarray, _: np.ndarray, k: int = k) -> np.ndarray:
            return np.asarray(surface.value(many[[k]](np.asarray(t))[0], t), dtype=float)

        low, high = times[places], times[places + 1]
        t = refine(value, np.minimum(low, high), np.maximum(low, high))
        found = np.isfinite(t)
        t, places = t[found], places[found]
        z = many[[k]](t)[0] if len(t) else np.empty((0, manifold.H.dim))
        kept = np.flatnonzero(surface.holds(z, t))[:most]
        rises = sign * (values[places + 1] - values[places]) > 0
        rows += [(float(t[i]), z[i], k, j, bool(rises[i])) for j, i in enumerate(kept.tolist())]
    dim = manifold.H.dim
    return Cut(
        np.array([row[0] for row in rows], dtype=float),
        np.array([row[1] for row in rows], dtype=float).reshape(len(rows), dim),
        np.array([row[2] for row in rows], dtype=int),
        np.array([row[3] for row in rows], dtype=int),
        np.array([row[4] for row in rows], dtype=bool),
    )


class Nearby(NamedTuple):
    """A place where curves of two cuts come near each other."""

    #: Of both, the crossings between which it is, and the share of the way from one to the other.
    pairs: tuple[tuple[int, int], tuple[int, int]]
    shares: tuple[float, float]


def nearby(
    cuts: tuple[Cut, Cut],
    segments: Sequence[np.ndarray],
    scale: np.ndarray,
    period: float | None,
    most: int,
) -> list[Nearby]:
    """Places where segments cross, and where others, far apart, come near in their own lengths.

    Points without neighbours are compared in units of the extent of both cuts, without those that
    escaped.

    - scale: Sizes of the components on the local manifolds.
    - period: Of H in time, if it depends on it: crossings at other phases of it are apart.
    """
    first, second = cuts
    if not (len(first.t) and len(second.t)):
        return []
    low, high = np.quantile(np.concatenate([first.z, second.z]), _USUAL, axis=0)
    units = np.maximum(high - low, _LEAST * scale)
    places = [np.concatenate([cut.z / units, _phases(cut.t, period)], axis=1) for cut in cuts]
    a, b = (place[pair] for place, pair in zip(places, segments, strict=True))
    rising = first.rising[segments[0][:, 0]][:, None] == second.rising[segments[1][:, 0]]
    rows, columns = np.nonzero(rising)
    p, q, u, v = a[rows, 0], b[columns, 0], a[rows, 1] - a[rows, 0], b[columns, 1] - b[columns, 0]
    s, t, crossing = _closest(p - q, u, v)
    apart = np.linalg.norm(p - q + s[:, None] * u - t[:, None] * v, axis=1)
    lengths = np.linalg.norm(u, axis=1) + np.linalg.norm(v, axis=1)
    distance = apart / np.where(lengths > 0, lengths, 1.0)
    middles = np.stack([p + s[:, None] * u, q + t[:, None] * v], axis=1)
    numbers = np.stack([first.number[segments[0][rows, 0]], second.number[segments[1][columns, 0]]])
    left = np.flatnonzero(distance <= _NEAR)
    left = left[np.lexsort((distance[left], ~crossing[left]))]
    found: list[Nearby] = []
    while len(left) and len(found) < most:
        k = int(left[0])
        one, other = segments[0][rows[k]].tolist(), segments[1][columns[k]].tolist()
        found.append(Nearby(((one[0], one[1]), (other[0], other[1])), (float(s[k]), float(t[k]))))
        same = (numbers[:, left] == numbers[:, [k]]).all(axis=0)
        beside = np.abs(middles[left] - middles[k]).max(axis=(1, 2)) <= _BESIDE
        left = left[~(same & beside & ~crossing[left])]
        left = left[left != k]
    return found


def _phases(t: np.ndarray, period: float | None) -> np.ndarray:
    """Times on a circle, shape (n, 2); without columns if there is no period."""
    if period is None:
        return np.empty((len(t), 0))
    turns = 2 * np.pi * t / period
    return np.stack([np.cos(turns), np.sin(turns)], axis=1)


def _closest(
    w: np.ndarray, u: np.ndarray, v: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares s, t from 0 to 1 that nearly minimise |w + s u - t v|, for rows of vectors.

    - returns inside: Whether the minimum without the bounds is within them.
    """
    uu, vv, uv = (u * u).sum(1), (v * v).sum(1), (u * v).sum(1)
    uw, vw = (u * w).sum(1), (v * w).sum(1)
    with np.errstate(all="ignore"):
        determinant = uu * vv - uv * uv
        s = np.where(determinant > 1e-12 * uu * vv, (uv * vw - vv * uw) / determinant, np.nan)
        t = (vw + s * uv) / vv
        inside = (s >= 0) & (s <= 1) & (t >= 0) & (t <= 1)
        s = np.clip(np.nan_to_num(s), 0.0, 1.0)
        t = np.clip(np.nan_to_num((vw + s * uv) / vv), 0.0, 1.0)
        s = np.clip(np.nan_to_num((t * uv - uw) / uu), 0.0, 1.0)
    return s, t, inside
