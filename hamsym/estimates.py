"""The error of a marched solution, estimated to where float64 ends.

The error delta = z - z^ obeys delta' = J Hess(z^) delta - r(t) with r the residual (the paper's
eq. ell), up to terms of second order. Inside a window r oscillates about as often as there are
columns in the basis, so it is sampled at twice as many nodes as the solution itself used, and
carried to the ends of the windows by their tangent maps: delta(t) = Phi(t) (delta_a - integral of
Phi^-1 r). Round-off is not in r: random perturbations of its size are sent along the same maps,
one batch at every joint.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.features import FeatureBasis, Flow, March
from hamsym.tangent import Collocation, TangentMaps, collocation, poisson

__all__ = ["RESOLUTIONS", "MarchError", "estimate_error"]

#: Nodes for the residual, twice those of the march or thrice, and for the tangent maps: of the
#: estimate, and of its check.
RESOLUTIONS = ((48, 28), (72, 40))
_PERTURBATIONS = 4  # random vectors that stand for round-off
_ROUND_OFF = 2 * np.finfo(float).eps  # of a window, relative to the state and its change there
_ACCURACY = 1e-5  # of the maps of all windows together
_CHUNK = 2_000_000  # numbers in the tangent maps held at once


@dataclass(frozen=True)
class MarchError:
    """Estimated error of a march: z - z^ and the round-off floor, as functions of time.

    Attributes
    ----------
    edges : numpy.ndarray
        Ends of the windows, shape (n + 1,).
    series : numpy.ndarray
        Chebyshev series of z - z^ on each window, shape (n, degree + 1, dim).
    floors : numpy.ndarray
        Size of the accumulated round-off in each window, shape (n, dim).
    largest : numpy.ndarray
        Largest magnitude of both together, shape (dim,).
    """

    edges: np.ndarray = field(repr=False)
    series: np.ndarray = field(repr=False)
    floors: np.ndarray = field(repr=False)
    largest: np.ndarray

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Estimated z - z^ at times t, shape (*t.shape, dim)."""
        window, s = self._place(t)
        degrees = np.arange(self.series.shape[1])
        basis = np.cos(np.multiply.outer(np.arccos(np.clip(2 * s - 1, -1, 1)), degrees))
        return np.einsum("...l,...ld->...d", basis, self.series[window])

    def floor(self, t: np.ndarray) -> np.ndarray:
        """Estimated size of the accumulated round-off at times t, shape (*t.shape, dim)."""
        return self.floors[self._place(t)[0]]

    def until(self, allowed: np.ndarray) -> float:
        """The end of the last window before estimate and floor exceed what is allowed."""
        sizes = np.abs(self(self.edges[1:] - 1e-9 * np.diff(self.edges))) + self.floors
        bad = (sizes > allowed).any(axis=1)
        return float(self.edges[int(np.argmax(bad))] if bad.any() else self.edges[-1])

    def _place(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        direction = math.copysign(1.0, self.edges[-1] - self.edges[0])
        window = np.searchsorted(direction * self.edges, direction * t, side="right") - 1
        window = np.clip(window, 0, len(self.series) - 1)
        return window, (t - self.edges[window]) / np.diff(self.edges)[window]


def estimate_error(
    windows: March, basis: FeatureBasis, flow: Flow, resolution: int = 0
) -> MarchError:
    """The error of a march with this basis, from the equations once more.

    ``resolution`` is an index of :data:`RESOLUTIONS`.
    """
    return _Estimation(windows, basis, flow, *RESOLUTIONS[resolution]).result


class _Estimation:
    """The errors of one run of windows after the other, carried from joint to joint."""

    def __init__(
        self, windows: March, basis: FeatureBasis, flow: Flow, nodes: int, tangent_nodes: int
    ) -> None:
        self._rule, self._tangent_rule = collocation(nodes), collocation(tangent_nodes)
        self._windows, self._basis, self._flow = windows, basis, flow
        self._lengths = np.diff(windows.edges)
        count, _, dim = windows.readouts.shape
        # Of each window's map, since all of them follow each other.
        self._accuracy = _ACCURACY / max(count, 100)
        scale = windows.scale.reshape(2, -1).max(axis=1)
        self._scale = np.repeat(np.where(scale > 0, scale, 1.0), dim // 2)
        # What rounding did to the state at each joint, the same way every time, is known.
        jumps = windows.states[:-1] + np.einsum("m,wmd->wd", basis.end, windows.readouts)
        self._jumps = np.asarray(jumps - windows.states[1:], dtype=float) / self._scale
        self._generator = np.random.default_rng(0)
        self.result = MarchError(
            windows.edges, np.empty((count, nodes, dim)), np.empty((count, dim)), np.zeros(dim)
        )
        # Column 0 is the error, the others are perturbations of the size of round-off.
        joint = np.zeros((dim, 1 + _PERTURBATIONS))
        step = max(1, _CHUNK // (nodes * dim * dim))
        for first in range(0, count, step):
            joint = self._across(slice(first, min(first + step, count)), joint)

    def _across(self, part: slice, joint: np.ndarray) -> np.ndarray:
        """Estimate a run of windows; from and to the errors at its ends, in units of the scale."""
        lengths, count, dim = self._lengths[part], part.stop - part.start, len(self._scale)
        z, dz, times = self._sampled(part, self._rule)
        residual = dz - self._flow.vector_field(z.reshape(-1, dim), times.ravel()).reshape(z.shape)
        z_coarse, _, times_coarse = self._sampled(part, self._tangent_rule)
        jacobians = self._flow.jacobian(z_coarse.reshape(-1, dim), times_coarse.ravel())
        maps = TangentMaps(
            jacobians.reshape(*z_coarse.shape, dim), lengths, self._scale, self._accuracy
        )
        fine = maps.at(self._rule.nodes)
        # The maps are symplectic: Phi^-1 = -J Phi^T J.
        forcing = poisson((residual / self._scale).transpose(2, 1, 0))
        forcing = -poisson(np.einsum("inaw,inw->anw", fine, forcing))
        drift = -lengths * (self._rule.integration @ forcing)

        size = np.abs(z).max(axis=1) + np.abs(lengths)[:, None] * np.abs(dz).max(axis=1)
        signs = self._generator.choice((-1.0, 1.0), size=(count, dim, _PERTURBATIONS))
        kicks = _ROUND_OFF * (size / self._scale)[:, :, None] * signs
        starts = np.empty((count, dim, 1 + _PERTURBATIONS))
        for w in range(count):
            starts[w] = joint
            starts[w, :, 1:] += kicks[w]
            joint = starts[w].copy()
            joint[:, 0] += drift[:, -1, w]
            joint = maps.ends[w] @ joint
            joint[:, 0] += self._jumps[part.start + w]

        error = np.einsum("inaw,anw->win", fine, starts[:, :, 0].T[:, None] + drift[:, :-1])
        series = self._rule.to_series @ (error * self._scale[:, None]).transpose(0, 2, 1)
        perturbed = np.einsum("inaw,wac->winc", maps.inside, starts[:, :, 1:])
        # Three standard deviations, at worst in the window.
        deviations = np.sqrt((perturbed**2).mean(axis=3)).max(axis=2)
        floors = 3 * self._scale * deviations
        self.result.series[part], self.result.floors[part] = series, floors
        # A scan this fine misses a few percent of a peak at most.
        between = 1.05 * np.abs(_dense(series.shape[1]) @ series).max(axis=1)
        np.maximum(self.result.largest, (between + floors).max(axis=0), out=self.result.largest)
        return joint

    def _sampled(self, part: slice, rule: Collocation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z^ and dz^/dt at the nodes of a rule, both (windows, nodes, dim), and the times."""
        values, rates = _columns(self._basis, len(rule.nodes))
        readouts, lengths = self._windows.readouts[part], self._lengths[part]
        z = self._windows.states[part][:, None] + values @ readouts
        dz = rates @ readouts / lengths[:, None, None]
        return z, dz, self._windows.edges[part][:, None] + lengths[:, None] * rule.nodes


@functools.lru_cache(maxsize=8)
def _columns(basis: FeatureBasis, count: int) -> tuple[np.ndarray, np.ndarray]:
    return basis.columns(collocation(count).nodes)


@functools.cache
def _dense(count: int) -> np.ndarray:
    """A Chebyshev series of so many terms -> values at points dense enough to show its peaks."""
    return chebyshev.chebvander(np.linspace(-1, 1, 4 * count), count - 1)
