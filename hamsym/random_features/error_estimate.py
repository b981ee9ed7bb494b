"""Error estimate of a march: truncation and round-off, to the limits of float64.

The error delta = z - z^ obeys delta' = J Hess(z^) delta - r(t) with r the residual (the paper's
eq. ell), up to terms of second order. Inside a window r oscillates about as often as there are
columns in the basis, so it is sampled at twice as many nodes as the solution used, and carried to
the ends of the windows by their tangent maps: delta(t) = Phi(t) (delta_a - integral of Phi^-1 r).
The residual r contains only another sample of the round-off: random perturbations of its size are
moved by the same maps, one batch at every joint. Its size is measured as the change of F when the
states change by one unit in the last place. Numbers of H that float64 cannot represent, for example
pi, push every window the same way; a perturbation in the direction of the motion represents them.

The estimate is infinite from the time at which the errors reach the size of the motion, or J Hess
is not finite: the linear equation is not valid there.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.numerics.collocation import Collocation, collocation
from hamsym.numerics.scales import SMALLEST, coupled_sizes
from hamsym.numerics.tangent_maps import TangentMaps
from hamsym.numerics.windows import locate
from hamsym.random_features.basis import FeatureBasis, basis_of_series
from hamsym.random_features.flow import Flow, flow_of
from hamsym.random_features.windows import March
from hamsym.support.checked_data import require_array

__all__ = ["RESOLUTIONS", "Estimate", "MarchError", "estimate_error"]

#: Nodes for the residual, two or three times those of the march, and for the tangent maps: of the
#: estimate, and of its check.
RESOLUTIONS = ((48, 28), (72, 40))
_PERTURBATIONS = 4  # random vectors that represent round-off
_EPS = float(np.finfo(float).eps)
_RESOLVED = 1e-3  # residual, relative to the rates, that a smooth force leaves at most
_LOST = 1.0  # error, in units of the motion, beyond which the linear equation is not valid
_SCALE_SAMPLES = 256  # windows at which the coupling of the components is averaged
_ACCURACY = 1e-5  # of the maps of all windows together
_CHUNK = 2_000_000  # numbers in the tangent maps of one batch


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
    scale : numpy.ndarray
        Sizes of the components to which tolerances are relative, shape (dim,): the largest |z^_i|,
        or 1e-8 of its coupled size (:mod:`hamsym.numerics.scales`).
    origin : numpy.ndarray
        Time from which the edges are counted, shape ().
    """

    edges: np.ndarray = field(repr=False)
    series: np.ndarray = field(repr=False)
    floors: np.ndarray = field(repr=False)
    largest: np.ndarray
    scale: np.ndarray
    origin: np.ndarray = field(repr=False)

    def check(self, trial: Any, *, finite: bool) -> None:
        """Raise ValueError unless it is the error of the trial solution."""
        count, _, dim = trial.readouts.shape
        require_array("edges of the error", self.edges, (count + 1,))
        if not np.array_equal(self.edges, trial.edges):
            raise ValueError("the windows of its error differ from those of its trial solution")
        if not self.series.size:
            raise ValueError("its error has no series")
        shape = (count, self.series.size // (count * dim), dim)
        require_array("series of the error", self.series, shape, finite=finite)
        require_array("floors of the error", self.floors, (count, dim), finite=finite)
        require_array("largest error", self.largest, (dim,), finite=finite)
        require_array("scale of the error", self.scale, (dim,))
        require_array("origin of the error", self.origin, ())
        if self.origin != trial.origin:
            raise ValueError("the origin of its error differs from that of its trial solution")
        if any((sizes < 0).any() for sizes in (self.floors, self.largest, self.scale)):
            raise ValueError("its error has a negative size")

    def refined(self, path: Any) -> MarchError:
        """Estimate the error of the same march with half as many nodes again."""
        basis = basis_of_series(path.record.seed, path.trial.series)
        return estimate_error(path.record, basis, flow_of(path.H), resolution=1).error

    def __call__(self, t: np.ndarray) -> np.ndarray:
        """Estimated z - z^ at times t, shape (*t.shape, dim)."""
        window, s = locate(self.edges, t - self.origin)
        degrees = np.arange(self.series.shape[1])
        basis = np.cos(np.multiply.outer(np.arccos(np.clip(2 * s - 1, -1, 1)), degrees))
        with np.errstate(invalid="ignore"):
            values = np.einsum("...l,...ld->...d", basis, self.series[window])
        return np.nan_to_num(values, nan=np.inf, posinf=np.inf, neginf=np.inf)

    def floor(self, t: np.ndarray) -> np.ndarray:
        """Estimated size of the accumulated round-off at times t, shape (*t.shape, dim)."""
        return self.floors[locate(self.edges, t - self.origin)[0]]

    def until(self, allowed: np.ndarray) -> float:
        """Return the end of the last window before estimate and floor exceed the allowed error."""
        with np.errstate(invalid="ignore"):
            peaks = np.abs(_dense(self.series.shape[1]) @ self.series).max(axis=1)
        good = (peaks + self.floors <= allowed).all(axis=1)
        end = self.edges[-1] if good.all() else self.edges[int(np.argmin(good))]
        return float(self.origin + end)

    def excess(self, allowed: np.ndarray) -> float:
        """Return the largest ratio of estimate and floor to the allowed error, or infinity."""
        with np.errstate(all="ignore"):
            ratios = np.where(self.largest == 0, 0.0, self.largest / allowed)
        return float(np.nan_to_num(ratios, nan=np.inf, posinf=np.inf).max())


class Estimate(NamedTuple):
    """The error of a march, with the reason where it is infinite and the unresolved windows.

    Attributes
    ----------
    error : MarchError
    limit : str
        Reason why the error is infinite in the last windows, "" if it is finite.
    unresolved : list of (float, float)
        Windows whose residual is large relative to the rates: the force may jump there.
    """

    error: MarchError
    limit: str
    unresolved: list[tuple[float, float]]


def estimate_error(
    windows: March, basis: FeatureBasis, flow: Flow, resolution: int = 0
) -> Estimate:
    """Estimate the error of a march from its residual and its tangent maps.

    ``resolution`` is an index of :data:`RESOLUTIONS`.
    """
    return _Estimation(windows, basis, flow, *RESOLUTIONS[resolution]).result


class _Estimation:
    """Error estimate in batches of windows, carried from joint to joint."""

    def __init__(
        self, windows: March, basis: FeatureBasis, flow: Flow, nodes: int, tangent_nodes: int
    ) -> None:
        self._rule, self._tangent_rule = collocation(nodes), collocation(tangent_nodes)
        self._windows, self._basis, self._flow = windows, basis, flow
        self._lengths = np.diff(windows.edges)
        count, _, dim = windows.readouts.shape
        # Of each window's map: the errors of consecutive maps add up.
        self._accuracy = _ACCURACY / max(count, 100)
        scale = _scales(windows, flow)
        self._scale = np.where(scale > 0, scale, 1.0)
        # The rounding of the state at each joint is deterministic, and therefore known.
        jumps = windows.states[:-1] + np.einsum("m,wmd->wd", basis.end, windows.readouts)
        self._jumps = np.asarray(jumps - windows.states[1:], dtype=float) / self._scale
        self._generator = np.random.default_rng(0)
        self._unresolved: list[int] = []
        # Expected length of the window that contains a random time.
        self._usual_length = float((self._lengths**2).sum() / np.abs(self._lengths).sum())
        series, floors = np.full((count, nodes, dim), np.inf), np.full((count, dim), np.inf)
        # Column 0 is the error, the last one the effect of rounded numbers of H; the others are
        # perturbations of the size of round-off.
        joint = np.zeros((dim, 2 + _PERTURBATIONS))
        step = max(1, _CHUNK // (nodes * dim * dim))
        largest, limit, first = np.zeros(dim), "", 0
        while first < count and not limit:
            part = slice(first, min(first + step, count))
            joint, limit, reached = self._across(part, joint, series, floors, largest)
            first = reached
        if limit:
            largest = np.full(dim, np.inf)
        ends = (windows.origin + windows.edges).tolist()
        self.result = Estimate(
            MarchError(windows.edges, series, floors, largest, scale, np.array(windows.origin)),
            limit,
            [(ends[w], ends[w + 1]) for w in self._unresolved],
        )

    def _across(
        self,
        part: slice,
        joint: np.ndarray,
        all_series: np.ndarray,
        all_floors: np.ndarray,
        largest: np.ndarray,
    ) -> tuple[np.ndarray, str, int]:
        """Estimate the error of a batch of windows.

        Parameters
        ----------
        part : slice
            Its windows.
        joint : numpy.ndarray
            Errors at its start, in units of the scale, shape (dim, columns).
        all_series, all_floors, largest : numpy.ndarray
            Of the whole march; updated.

        Returns
        -------
        joint : numpy.ndarray
            Errors at its end.
        limit : str
            Reason for ending early, or "".
        first : int
            First window that was not estimated.
        """
        lengths, count, dim = self._lengths[part], part.stop - part.start, len(self._scale)
        z, dz, times = self._sampled(part, self._rule)
        rates = self._flow.vector_field(z.reshape(-1, dim), times.ravel()).reshape(z.shape)
        residual = self._residual(part, dz, rates)
        self._note_unresolved(part, residual, rates)
        z_coarse, _, times_coarse = self._sampled(part, self._tangent_rule)
        jacobians = self._flow.jacobian(z_coarse.reshape(-1, dim), times_coarse.ravel())
        jacobians = jacobians.reshape(*z_coarse.shape, dim)
        maps = TangentMaps(jacobians, lengths, self._scale, self._accuracy)
        fine = maps.at(self._rule.nodes)
        forcing = maps.inverse_applied(fine, (residual / self._scale).transpose(2, 1, 0))
        drift = -lengths * (self._rule.integration @ forcing)

        signs = self._generator.choice((-1.0, 1.0), size=(count, dim, _PERTURBATIONS))
        kicks = np.empty((count, dim, 1 + _PERTURBATIONS))
        kicks[:, :, :-1] = (self._round_off(part, z, dz, times, rates) / self._scale)[
            :, :, None
        ] * signs
        kicks[:, :, -1] = self._constants(part) / self._scale
        starts = np.empty((count, dim, 2 + _PERTURBATIONS))
        done, limit = count, ""
        for w in range(count):
            starts[w] = joint
            starts[w, :, 1:] += kicks[w]
            joint = starts[w].copy()
            joint[:, 0] += drift[:, -1, w]
            joint = maps.ends[w] @ joint
            joint[:, 0] += self._jumps[part.start + w]
            if not np.abs(joint).max() <= _LOST:
                done, limit = w, self._reason(part.start + w, jacobians[w])
                break

        kept = slice(part.start, part.start + done)
        error = np.einsum("inaw,anw->win", fine, starts[:, :, 0].T[:, None] + drift[:, :-1])[:done]
        series = self._rule.to_series @ (error * self._scale[:, None]).transpose(0, 2, 1)
        perturbed = np.einsum("inaw,wac->winc", maps.inside, starts[:, :, 1:])[:done]
        # Three standard deviations, at worst in the window, and the rounding of z^ itself.
        deviations = np.sqrt((perturbed[..., :-1] ** 2).mean(axis=3)).max(axis=2)
        pushed = np.abs(perturbed[..., -1]).max(axis=2)
        floors = self._scale * (3 * deviations + pushed) + _EPS / 2 * np.abs(z[:done]).max(axis=1)
        all_series[kept], all_floors[kept] = series, floors
        if done:
            # A scan this fine misses a few percent of a peak at most.
            between = 1.05 * np.abs(_dense(series.shape[1]) @ series).max(axis=1)
            np.maximum(largest, (between + floors).max(axis=0), out=largest)
        return joint, limit, part.start + done

    def _residual(self, part: slice, dz: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Return dz^/dt - F at the nodes of a batch of windows, shape (windows, nodes, dim)."""
        return dz - rates

    def _note_unresolved(self, part: slice, residual: np.ndarray, rates: np.ndarray) -> None:
        left, sizes = np.abs(residual).max(axis=1), np.abs(rates).max(axis=1)
        # The rates of components that are nothing but round-off are noise.
        good = (left <= _RESOLVED * sizes) | (self._usual_length * left <= _RESOLVED * self._scale)
        self._unresolved.extend(part.start + np.flatnonzero(~good.all(axis=1)))

    def _round_off(
        self, part: slice, z: np.ndarray, dz: np.ndarray, times: np.ndarray, rates: np.ndarray
    ) -> np.ndarray:
        """Estimate the effect of round-off on the end of each window, shape (windows, dim)."""
        signs = self._generator.choice((-1.0, 1.0), size=z.shape)
        disturbed = (z * (1 + _EPS / 2 * signs)).reshape(-1, z.shape[-1])
        late = times.ravel() * (1 + _EPS / 2 * self._generator.choice((-1.0, 1.0), times.size))
        noise = self._flow.vector_field(disturbed, late).reshape(z.shape) - rates
        noise = np.sqrt((noise**2).mean(axis=1)) + _EPS * np.abs(dz).max(axis=1)
        # The nodes average it.
        return np.abs(self._lengths[part])[:, None] * noise / math.sqrt(z.shape[1])

    def _constants(self, part: slice) -> np.ndarray:
        """Estimate the effect of rounded numbers in H on each window, shape (windows, dim)."""
        if not self._flow.rounded:
            return np.zeros((part.stop - part.start, len(self._scale)))
        return _EPS / 2 * np.diff(self._windows.states[part.start : part.stop + 1], axis=0)

    def _reason(self, window: int, jacobians: np.ndarray) -> str:
        t = float(self._windows.origin + self._windows.edges[window])
        if not np.isfinite(jacobians).all():
            return f"the Hessian of H is not finite near t = {t:.6g}"
        return f"round-off errors grow to the size of the motion by t = {t:.6g}"

    def _sampled(self, part: slice, rule: Collocation) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Evaluate z^ and dz^/dt at nodes of a rule, shape (windows, nodes, dim), and the times."""
        values, rates, lost = _columns(self._basis, len(rule.nodes))
        readouts, lengths = self._windows.readouts[part], self._lengths[part]
        z = self._windows.states[part][:, None] + values @ readouts
        # A rounded table would push every window the same way.
        dz = (rates @ readouts + lost @ readouts) / lengths[:, None, None]
        return z, dz, self._windows.edges[part][:, None] + lengths[:, None] * rule.nodes


def _scales(windows: March, flow: Flow) -> np.ndarray:
    """Return the size of each component in its own units, shape (dim,)."""
    count = len(windows.readouts)
    some = np.unique(np.linspace(0, count, min(count + 1, _SCALE_SAMPLES)).astype(int))
    edges = windows.edges[some]
    coupling = np.abs(flow.jacobian(windows.states[some], edges))
    shares = np.abs(np.gradient(edges)) / np.abs(np.gradient(edges)).sum()
    mean = np.einsum("k,kij->ij", shares, coupling)
    coupled = coupled_sizes(windows.scale, mean, abs(float(windows.edges[-1] - windows.edges[0])))
    return np.asarray(np.maximum(windows.scale, SMALLEST * coupled))


@functools.lru_cache(maxsize=8)
def _columns(basis: FeatureBasis, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Evaluate Q and dQ/ds at the nodes of a rule, and the rounding error of dQ/ds."""
    values, rates = basis.columns(collocation(count).nodes.astype(np.longdouble))
    rounded = rates.astype(float)
    return values.astype(float), rounded, (rates - rounded).astype(float)


@functools.cache
def _dense(count: int) -> np.ndarray:
    """Return the matrix from Chebyshev series of ``count`` terms to values that show peaks."""
    return chebyshev.chebvander(np.linspace(-1, 1, 4 * count), count - 1)
