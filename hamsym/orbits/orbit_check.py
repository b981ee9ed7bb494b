"""Comparison of a periodic orbit as users evaluate it with the states that a proof is about."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hamsym.errors import CertificationError
from hamsym.numerics.collocation import chebyshev_values, collocation
from hamsym.orbits.arc import Arc, vector_field_at
from hamsym.proof.public_check import require_same

if TYPE_CHECKING:
    from hamsym.orbits.orbit import PeriodicOrbit

_UNIT = 2.0**-53
_TIMES = 40  # at random, beside those of the states that are proven
_MOST = 64  # of those
_NEAR = 8 * 2.0**-52  # fractions of an arc beside the one that is meant


def check_orbit(orbit: PeriodicOrbit, known: np.ndarray, states: np.ndarray) -> None:
    """Require that an orbit evaluates its proven states, and its stored ones in between.

    Raise CertificationError if it does not.

    - known, states: Fractions of the arc, shape (n,), and what the proof is about there, shape (n,
      dim).
    """
    arc, closing, start = orbit.arc, orbit.problem.closing, orbit.problem.start
    if not (np.array_equal(orbit.z0, arc.ends[0]) and orbit.period == arc.period):
        raise CertificationError("the start or the period of the orbit is not that of its arc")
    random = np.random.default_rng(len(states))
    fractions = np.concatenate((known, random.random(_TIMES)))
    parts = np.concatenate((np.zeros(len(states)), random.integers(closing.parts, size=_TIMES)))
    along = np.where(closing.reversing & (parts % 2 == 1), 1 - fractions, fractions)
    times = start + (parts + along) * (orbit.period / closing.parts)
    shown = np.unique(np.linspace(0, len(times) - 1, _MOST).astype(int))
    fractions, parts, times = fractions[shown], parts[shown].astype(int), times[shown]
    # At the ends of windows and of the arc the evaluation may use the one beside.
    found = np.array([_stored(arc, fractions + near) for near in (0.0, -_NEAR, _NEAR)])
    own = shown < len(states)
    found[0, own] = states[shown[own]]
    nodes = arc.values.shape[1]
    clock = 32 * _UNIT * (2 * orbit.period + np.abs(times) + abs(start))
    rates = [np.abs(vector_field_at(orbit.H, z, t)) for z, t in zip(found[0], times, strict=True)]
    allowed = clock[:, None] * np.array(rates) + 8 * _UNIT * nodes**3 * orbit.problem.scale_of(arc)
    turned = [
        [closing.unfolded(int(k), z[None])[0] for k, z in zip(parts, row, strict=True)]
        for row in found
    ]
    bounds = [
        np.abs(closing.unfolded(int(k), z[None])[0]) for k, z in zip(parts, allowed, strict=True)
    ]
    require_same(
        "orbit",
        orbit.H.names,
        orbit(times),
        np.array(turned),
        np.broadcast_to(np.array(bounds), found.shape),
        lambda n: f"t = {float(times[n])!r}",
    )


def _stored(arc: Arc, fractions: np.ndarray) -> np.ndarray:
    """The polynomials of the stored states of an arc at fractions of it, shape (n, dim)."""
    within = np.clip(fractions, 0.0, 1.0)
    windows = np.clip(np.searchsorted(arc.edges, within, side="right") - 1, 0, len(arc.values) - 1)
    low, high = arc.edges[windows], arc.edges[windows + 1]
    rule = collocation(arc.values.shape[1])
    table = chebyshev_values(2 * (within - low) / (high - low) - 1, len(rule.nodes))
    series = np.einsum("ij,kjd->kid", rule.to_series, arc.values)
    return np.asarray(np.einsum("nk,nkd->nd", table, series[windows]))
