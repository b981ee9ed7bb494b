"""Random sine features marched to a tolerance: a network of which only the readout is solved for.

On each window [t_a, t_a + h] the solution has the trial form z^ = z_a + f(s) N(s), s = (t - t_a)/h,
f(s) = 1 - exp(-s), where N is one hidden layer of sine neurons whose inner weights are random and
fixed (an extreme learning machine: Dong & Li 2021, Fabiani et al. 2023). Windows join exactly,
because the form reproduces z_a whatever the readout.

Stage 1  The basis f(s) sin(a s + b) is orthonormalised once (:class:`FeatureBasis`); it knows no H.
Stage 2  On a window, collocation at Chebyshev nodes is the fixed point Z = z_a + h S F(Z) with a
         precomputed integration matrix S; where that does not contract, Newton's method with the
         generated Hessian solves the same equation.
Stage 3  The residual between the nodes decides whether the window is accepted, and the next length
         (:func:`march`, and the loop over windows in :mod:`hamsym.march_loop`).
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import torch
from torch import Tensor

from hamsym import compiled, march_loop
from hamsym.tangent import chebyshev_points

__all__ = ["MAX_WINDOWS", "FeatureBasis", "FeatureTrial", "Flow", "March", "feature_basis", "march"]

_NEURONS = 60
_NODES = 24  # collocation points of a window
_BETWEEN = 27  # points at which the residual is judged
_TRUNCATION = 1e-14  # of singular values, relative
_DEGREE = 47  # of the Chebyshev series of the columns, which are entire functions
_INNER_RANGE = 10.0  # inner weights a are uniform within +- this
_NEWTON_ITERATIONS = 12
_SHORTEST = 1e-13  # window, relative to the times
_ROOM = 64  # windows for which there is room at first
MAX_WINDOWS = 200_000
_SURE = 5_000  # windows after which it is clear how many more are needed, within a factor of ten


@dataclass(frozen=True, eq=False)  # one object a seed, so that tables of it can be cached
class FeatureBasis:
    """Orthonormal combinations Q = f(s) sin(a s + b) W of the features, for s in [0, 1].

    Attributes
    ----------
    seed : int
        What a and b were drawn with.
    inner, shift : numpy.ndarray
        a and b, shape (M,).
    mixing : numpy.ndarray
        W, shape (M, m): raw readout weights of each orthonormal column.
    nodes, between : numpy.ndarray
        Chebyshev points of the first kind in (0, 1), and points in between, almost to both ends.
    fit : numpy.ndarray
        Values dz/ds at the nodes -> coefficients, shape (m, nodes).
    integration : numpy.ndarray
        Values dz/ds at the nodes -> z - z_a there, shape (nodes, nodes).
    to_between, rates_between : numpy.ndarray
        Q and dQ/ds at the points in between.
    end : numpy.ndarray
        Q at s = 1 in extended precision, shape (m,).
    tables : tuple of numpy.ndarray
        What :func:`~hamsym.march_loop.march_windows` takes, in its order.
    series, rate_series : numpy.ndarray
        Chebyshev series of N = sin(a s + b) W and dN/ds in 2 s - 1, shape (degree + 1, m). They
        are the same functions to the last bit or two, without the cancellation in that product.
    """

    seed: int
    inner: np.ndarray
    shift: np.ndarray
    mixing: np.ndarray
    nodes: np.ndarray
    between: np.ndarray
    fit: np.ndarray
    integration: np.ndarray
    to_between: np.ndarray
    rates_between: np.ndarray
    end: np.ndarray
    series: np.ndarray
    rate_series: np.ndarray

    @cached_property
    def tables(self) -> tuple[np.ndarray, ...]:
        end = self.end.astype(float)
        # The polynomial of degree 2 through the last rates of a window, in s - 1.
        tail = np.linalg.pinv(np.vander(self.nodes[-march_loop.TAIL :] - 1, 3, increasing=True))
        arrays = (
            self.nodes,
            self.integration,
            self.fit,
            self.between,
            self.to_between,
            self.rates_between,
            end,
            (self.end - end).astype(float),
            tail,
        )
        return tuple(np.ascontiguousarray(array) for array in arrays)

    def columns(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Q and dQ/ds at s of shape (n,); each of shape (n, m)."""
        values, rates = _columns(self.inner, self.shift, self.mixing, s)
        return values.astype(float), rates.astype(float)


@functools.lru_cache(maxsize=8)
def feature_basis(seed: int = 0) -> FeatureBasis:
    """The basis of a seed; made once, since it depends on nothing else."""
    generator = np.random.default_rng(seed)
    inner = generator.uniform(-_INNER_RANGE, _INNER_RANGE, _NEURONS)
    shift = generator.uniform(-math.pi, math.pi, _NEURONS)
    dense = chebyshev_points(160)
    values, rates = _raw_columns(inner, shift, dense)
    _, sizes, right = np.linalg.svd(np.vstack((values, rates)), full_matrices=False)
    kept = sizes > _TRUNCATION * sizes[0]
    mixing = right[kept].T / sizes[kept]
    nodes = chebyshev_points(_NODES)
    # Just inside the window: at a breakpoint the equations of the next one may hold.
    between = np.clip(np.linspace(0.0, 1.0, _BETWEEN), 1e-9, 1 - 1e-9)

    at_nodes, rates_at_nodes = (c.astype(float) for c in _columns(inner, shift, mixing, nodes))
    fit = np.linalg.pinv(rates_at_nodes, rcond=1e-14)
    to_between, rates_between = (c.astype(float) for c in _columns(inner, shift, mixing, between))
    series, rate_series = _series(inner, shift, mixing)
    return FeatureBasis(
        seed=seed,
        inner=inner,
        shift=shift,
        mixing=mixing,
        nodes=nodes,
        between=between,
        fit=fit,
        integration=at_nodes @ fit,
        to_between=to_between,
        rates_between=rates_between,
        end=_columns(inner, shift, mixing, np.ones(1))[0][0],
        series=series,
        rate_series=rate_series,
    )


def _series(
    inner: np.ndarray, shift: np.ndarray, mixing: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Chebyshev coefficients of sin(a s + b) W and of its derivative, in extended precision."""
    count = _DEGREE + 1
    angles = (2 * np.arange(count, dtype=np.longdouble) + 1) * np.longdouble(math.pi) / (2 * count)
    phase = np.multiply.outer((1 + np.cos(angles)) / 2, inner.astype(np.longdouble)) + shift
    cosines = 2 * np.cos(np.multiply.outer(np.arange(count), angles)) / count
    cosines[0] /= 2
    values, rates = np.sin(phase) @ mixing, (np.cos(phase) * inner) @ mixing
    return (cosines @ values).astype(float), (cosines @ rates).astype(float)


def _columns(
    inner: np.ndarray, shift: np.ndarray, mixing: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    # The features are nearly dependent and W is large: a table made in float64 would carry errors
    # into every window, each time the same.
    extended = [np.asarray(array, dtype=np.longdouble) for array in (inner, shift, s)]
    values, rates = _raw_columns(*extended)
    return values @ mixing, rates @ mixing


def _raw_columns(
    inner: np.ndarray, shift: np.ndarray, s: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    phase = np.multiply.outer(s, inner) + shift
    features, slopes = np.sin(phase), np.cos(phase) * inner
    f = -np.expm1(-s)[:, None]
    return f * features, (1 - f) * features + f * slopes


@dataclass(frozen=True)
class Flow:
    """The equation z' = F(z, t), as the march takes it.

    Attributes
    ----------
    vector_field : callable
        (z, t) -> F, shapes (n, dim), (n,) -> (n, dim).
    jacobian : callable
        (z, t) -> dF/dz, shape (n, dim, dim).
    rates : callable
        (z, t, out), F written to out.
    loop : callable
        :func:`~hamsym.march_loop.march_windows`, or the same compiled.
    compiled : callable, optional
        Compiles, and returns the same with compiled ``rates`` and ``loop``; None where they are.
    """

    vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray]
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray]
    rates: Callable[[np.ndarray, np.ndarray, np.ndarray], None]
    loop: Callable[..., int] = march_loop.march_windows
    compiled: Callable[[], Flow] | None = None


@dataclass(frozen=True)
class March:
    """Windows of a solution, and what they cost.

    Attributes
    ----------
    edges : numpy.ndarray
        Ends of the windows, shape (n + 1,).
    states : numpy.ndarray
        z at the edges, shape (n + 1, dim).
    readouts : numpy.ndarray
        Coefficients of the orthonormal columns, shape (n, m, dim).
    reached : float
        The time up to which there are windows.
    reason : str
        Why it ended before the end of the span; "" if it did not.
    evaluations : int
        Calls of the vector field, each at all points of a window.
    newton_windows : int
        Windows for which Newton's method was needed.
    compiled : bool
        Whether compiled code marched.
    scale : numpy.ndarray
        Largest magnitude of each component, shape (dim,).
    seconds, cpu_seconds : float
    seed : int
        Of the basis.
    """

    edges: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)
    readouts: np.ndarray = field(repr=False)
    reached: float
    reason: str
    evaluations: int
    newton_windows: int
    compiled: bool
    scale: np.ndarray = field(repr=False)
    seconds: float
    cpu_seconds: float
    seed: int

    points_per_window = _NODES

    @property
    def points(self) -> int:
        """Collocation points of all windows."""
        return self.points_per_window * len(self.readouts)

    def times(self, per_window: int) -> np.ndarray:
        """So many equally spaced times in each window, its start among them, and the end."""
        inside = np.linspace(0, 1, per_window, endpoint=False)
        within = self.edges[:-1, None] + np.diff(self.edges)[:, None] * inside
        return np.append(within.ravel(), self.edges[-1])


def march(
    flow: Flow,
    z0: np.ndarray,
    span: tuple[float, float],
    tolerance: float,
    basis: FeatureBasis,
    *,
    breakpoints: Sequence[float] = (),
    longest: float = math.inf,
    max_windows: int = MAX_WINDOWS,
) -> March:
    """March windows over a span, each to a local tolerance relative to the components' scales.

    Parameters
    ----------
    flow : Flow
    z0 : numpy.ndarray
        Shape (dim,).
    span : (float, float)
    tolerance : float
    basis : FeatureBasis
    breakpoints : sequence of float
        Times inside the span, in its direction, at which a window must end.
    longest : float
        Length that no window exceeds, but for a millionth of it.
    max_windows : int
        The march also ends early where more than ten times as many will clearly be needed.
    """
    began, cpu_began = time.perf_counter(), time.process_time()
    start, end = span
    dim, columns = len(z0), basis.mixing.shape[1]
    rate = np.empty((1, dim))
    flow.rates(z0[None], np.array([start]), rate)
    sizes = np.abs(z0)
    clock = np.array([start, _first_length(z0, rate[0], abs(end - start))])
    counts = np.array([0, 1, 0])
    tail = np.vstack((rate, np.zeros((2, dim))))
    stops = np.array([*breakpoints, end], dtype=float)
    shortest = _SHORTEST * max(abs(end - start), abs(start), abs(end))
    room = min(_ROOM, max_windows)
    edges, states = np.empty(room + 1), np.empty((room + 1, dim))
    readouts = np.empty((room, columns, dim))
    edges[0], states[0] = start, z0
    given, found = False, np.empty((len(basis.nodes), dim))
    newton_windows, reason = 0, ""
    while True:
        status = flow.loop(
            flow.rates,
            *basis.tables,
            stops,
            tolerance,
            shortest,
            longest,
            given,
            found,
            clock,
            counts,
            sizes,
            tail,
            edges,
            states,
            readouts,
        )
        count, given = int(counts[0]), False
        if status == march_loop.FINISHED:
            break
        if status == march_loop.TOO_SHORT:
            reason = "the windows became too short, as near a singularity or the end of a domain"
            if max(abs(start), abs(end)) > 100 * abs(end - start):
                reason += ", or for float64 to resolve t; let the time begin nearer to 0"
            break
        if status == march_loop.FULL:
            spent, done = time.perf_counter() - began, abs(clock[0] - start)
            needed = count * abs(end - start) / done
            if count >= max_windows or (count >= _SURE and needed > 10 * max_windows):
                reason = f"the span needs about {needed:.0e} windows, more than {max_windows:,}"
                break
            room = min(2 * count, max_windows) - count
            edges, states, readouts = (
                np.concatenate((array, np.empty((room, *array.shape[1:]))))
                for array in (edges, states, readouts)
            )
            if flow.compiled and spent * (abs(end - start) / done - 1) > compiled.cost():
                flow = flow.compiled()
            continue
        rates, spent = _newton(flow, basis, states[count], clock, end, tolerance, sizes)
        counts[1] += spent
        if rates is None:
            clock[1] *= march_loop.SHRINK
        else:
            given, found = True, rates
            newton_windows += 1
    return March(
        edges=edges[: count + 1].copy(),
        states=states[: count + 1].copy(),
        readouts=readouts[:count].copy(),
        reached=float(clock[0]),
        reason=reason,
        evaluations=int(counts[1]),
        newton_windows=newton_windows,
        compiled=flow.compiled is None,
        scale=sizes,
        seconds=time.perf_counter() - began,
        cpu_seconds=time.process_time() - cpu_began,
        seed=basis.seed,
    )


def _newton(
    flow: Flow,
    basis: FeatureBasis,
    z: np.ndarray,
    clock: np.ndarray,
    end: float,
    tolerance: float,
    sizes: np.ndarray,
) -> tuple[np.ndarray | None, int]:
    """F at the nodes of a window by Newton's method from the constant state, and evaluations."""
    t, length = clock
    h = math.copysign(length, end - t)
    times, integration = t + h * basis.nodes, h * basis.integration
    count, dim = len(times), len(z)
    scale, enough = march_loop.floored(sizes), max(0.01 * tolerance, 4e-16)
    Z, rates = np.tile(z, (count, 1)), np.empty((count, dim))
    last = math.inf
    for step in range(1, _NEWTON_ITERATIONS + 1):
        flow.rates(Z, times, rates)
        defect = z + integration @ rates - Z
        matrix = np.eye(count * dim) - np.einsum(
            "kl,lij->kilj", integration, flow.jacobian(Z, times)
        ).reshape(count * dim, count * dim)
        try:
            correction = np.linalg.solve(matrix, defect.ravel()).reshape(count, dim)
        except np.linalg.LinAlgError:
            return None, step
        Z = Z + correction
        change = float((np.abs(correction) / scale).max())
        if change <= enough or (change < 1e-11 and change >= last):
            flow.rates(Z, times, rates)
            return rates, step + 1
        if not change < 1e6:
            return None, step
        last = change
    return None, _NEWTON_ITERATIONS


def _first_length(z: np.ndarray, rate: np.ndarray, span: float) -> float:
    """A tenth of the time in which the coordinates or the momenta would change by their size."""
    sizes, speeds = (np.abs(v).reshape(2, -1).max(axis=1) for v in (z, rate))
    known = (sizes > 0) & (speeds > 0)
    return min(span, 0.1 * float((sizes[known] / speeds[known]).min(initial=math.inf)))


class FeatureTrial(torch.nn.Module):
    """The solution of a march as a function of time, with its derivative; one network a window."""

    def __init__(
        self,
        edges: Tensor,
        states: Tensor,
        readouts: Tensor,
        series: Tensor,
        rate_series: Tensor,
    ) -> None:
        super().__init__()
        self.register_buffer("edges", edges)
        self.register_buffer("states", states)
        self.register_buffer("readouts", readouts)
        self.register_buffer("series", series)
        self.register_buffer("rate_series", rate_series)
        self.direction = math.copysign(1.0, float(edges[-1] - edges[0]))

    @classmethod
    def of_march(cls, windows: March, basis: FeatureBasis) -> FeatureTrial:
        """The trial solution of windows that were marched with a basis."""
        return cls(
            *(
                torch.tensor(array)
                for array in (
                    windows.edges,
                    windows.states,
                    windows.readouts,
                    basis.series,
                    basis.rate_series,
                )
            )
        )

    edges: Tensor
    states: Tensor
    readouts: Tensor
    series: Tensor
    rate_series: Tensor

    def forward(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        window, length, s, polynomials = self._place(t)
        f = -torch.expm1(-s).unsqueeze(-1)
        network, slopes = polynomials @ self.series, polynomials @ self.rate_series
        readout = self.readouts[window]
        z = self.states[window] + torch.einsum("km,kmd->kd", f * network, readout)
        dz = torch.einsum("km,kmd->kd", (1 - f) * network + f * slopes, readout)
        return z, dz / length.unsqueeze(-1)

    def value(self, t: Tensor) -> Tensor:
        """z^ alone, the same numbers in half the time."""
        window, _, s, polynomials = self._place(t)
        columns = -torch.expm1(-s).unsqueeze(-1) * (polynomials @ self.series)
        return self.states[window] + torch.einsum("km,kmd->kd", columns, self.readouts[window])

    def _place(self, t: Tensor) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Which window t is in, the window's length, s there, and Chebyshev polynomials of s."""
        window = torch.searchsorted(self.direction * self.edges, self.direction * t, right=True) - 1
        window = window.clamp(0, len(self.readouts) - 1)
        start, length = self.edges[window], (self.edges[1:] - self.edges[:-1])[window]
        s = (t - start) / length
        return window, length, s, _chebyshev_values(2 * s - 1)


def _chebyshev_values(x: Tensor) -> Tensor:
    """T_0 .. T_degree at x of shape (K,), shape (K, degree + 1)."""
    if not x.requires_grad:
        angles = torch.arccos(x.clamp(-1, 1)).unsqueeze(-1)
        return torch.cos(angles * torch.arange(_DEGREE + 1, dtype=x.dtype))
    # The arc cosine has no derivative at the ends of a window; the recurrence has.
    values = [torch.ones_like(x), x]
    for _ in range(_DEGREE - 1):
        values.append(2 * x * values[-1] - values[-2])
    return torch.stack(values, dim=-1)
