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
         (:func:`march`).
"""

from __future__ import annotations

import functools
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

__all__ = ["FeatureBasis", "FeatureTrial", "March", "feature_basis", "march"]

_NEURONS = 60
_NODES = 24  # collocation points of a window
_BETWEEN = 27  # points at which the residual is judged
_TRUNCATION = 1e-14  # of singular values, relative
_DEGREE = 47  # of the Chebyshev series of the columns, which are entire functions
_INNER_RANGE = 10.0  # inner weights a are uniform within +- this
_ORDER = 18  # at which the residual falls with the length of the window, empirically
_ROUND_OFF = 256 * np.finfo(float).eps  # of the residual, relative to the rates
_SHRINK, _GROW = 0.6, 2.5
_FIXED_POINT_ITERATIONS, _NEWTON_ITERATIONS = 60, 12


@dataclass(frozen=True, eq=False)  # one object a seed, so that tables of it can be cached
class FeatureBasis:
    """Orthonormal combinations Q = f(s) sin(a s + b) W of the features, for s in [0, 1].

    Attributes
    ----------
    inner, shift : numpy.ndarray
        a and b, shape (M,).
    mixing : numpy.ndarray
        W, shape (M, m): raw readout weights of each orthonormal column.
    nodes, between : numpy.ndarray
        Chebyshev points of the first kind in (0, 1), and points in between, with both ends.
    fit : numpy.ndarray
        Values dz/ds at the nodes -> coefficients, shape (m, nodes).
    integration : numpy.ndarray
        Values dz/ds at the nodes -> z - z_a there, shape (nodes, nodes).
    to_between, rates_between : numpy.ndarray
        Q and dQ/ds at the points in between.
    end : numpy.ndarray
        Q at s = 1 in extended precision, shape (m,).
    series, rate_series : numpy.ndarray
        Chebyshev series of N = sin(a s + b) W and dN/ds in 2 s - 1, shape (degree + 1, m). They
        are the same functions to the last bit or two, without the cancellation in that product.
    """

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
    dense = _chebyshev(160)
    values, rates = _raw_columns(inner, shift, dense)
    _, sizes, right = np.linalg.svd(np.vstack((values, rates)), full_matrices=False)
    kept = sizes > _TRUNCATION * sizes[0]
    mixing = right[kept].T / sizes[kept]
    nodes = _chebyshev(_NODES)
    between = np.linspace(0.0, 1.0, _BETWEEN)

    at_nodes, rates_at_nodes = (c.astype(float) for c in _columns(inner, shift, mixing, nodes))
    fit = np.linalg.pinv(rates_at_nodes, rcond=1e-14)
    to_between, rates_between = (c.astype(float) for c in _columns(inner, shift, mixing, between))
    series, rate_series = _series(inner, shift, mixing)
    return FeatureBasis(
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


def _chebyshev(count: int) -> np.ndarray:
    return (1 - np.cos((2 * np.arange(count) + 1) * math.pi / (2 * count))) / 2


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
    scale : numpy.ndarray
        Largest magnitude of each component, shape (dim,).
    seconds, cpu_seconds : float
    """

    edges: np.ndarray = field(repr=False)
    states: np.ndarray = field(repr=False)
    readouts: np.ndarray = field(repr=False)
    reached: float
    reason: str
    evaluations: int
    newton_windows: int
    scale: np.ndarray = field(repr=False)
    seconds: float
    cpu_seconds: float

    @property
    def points(self) -> int:
        """Collocation points of all windows."""
        return _NODES * len(self.readouts)


def march(
    vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray],
    z0: np.ndarray,
    span: tuple[float, float],
    tolerance: float,
    basis: FeatureBasis,
    *,
    max_windows: int = 200_000,
) -> March:
    """March windows over a span, each to a local tolerance relative to the components' scales."""
    began, cpu_began = time.perf_counter(), time.process_time()
    start, end = span
    direction = math.copysign(1.0, end - start)
    t, z = start, z0.copy()
    edges, states = [t], [z]
    readouts: list[np.ndarray] = []
    reached_scale = np.abs(z)
    scale = _floored(reached_scale)
    rate = vector_field(z[None], np.array([t]))[0]
    length = _first_length(z, rate, abs(end - start))
    previous: np.ndarray | None = None
    evaluations, newton_windows, reason = 1, 0, ""
    smallest = 1e-13
    while direction * (end - t) > 0:
        length = min(length, abs(end - t))
        if length < smallest * max(abs(end - start), abs(t)):
            reason = "the windows became too short, as near a singularity or the end of a domain"
            break
        if len(readouts) >= max_windows:
            reason = f"more than {max_windows:,} windows"
            break
        h = direction * length
        times = t + h * basis.nodes
        found = _collocate(vector_field, jacobian, z, h, times, basis, previous, tolerance, scale)
        evaluations += found.evaluations
        if found.rates is None:
            length *= _SHRINK
            previous = None
            continue
        readout = h * (basis.fit @ found.rates)
        middle = z + basis.to_between @ readout
        ell = basis.rates_between @ readout / h - vector_field(middle, t + h * basis.between)
        evaluations += 1
        size = np.maximum(reached_scale, np.abs(middle).max(axis=0))
        scale_now = _floored(size)
        # No window is short enough to bring the residual below the round-off of the rates.
        allowed = tolerance * scale_now + _ROUND_OFF * length * np.abs(found.rates).max(axis=0)
        allowed = np.maximum(allowed, np.finfo(float).tiny)
        error = float((length * np.abs(ell).max(axis=0) / allowed).max())
        if not error <= 1:  # also where it is not a number
            factor = (0.3 / error) ** (1 / _ORDER) if math.isfinite(error) else 0.3
            length *= min(max(factor, 0.3), 0.9)
            previous = None
            continue
        newton_windows += found.newton
        # Rounding Q(1) would push every window the same way, and energies would drift.
        z = (z + basis.end @ readout).astype(float)
        t = end if length == abs(end - t) else t + h
        edges.append(t)
        states.append(z)
        readouts.append(readout)
        reached_scale, scale = size, scale_now
        growth = min(_GROW, (0.1 / max(error, 1e-30)) ** (1 / _ORDER))
        length *= growth
        previous = found.rates
    return March(
        edges=np.array(edges),
        states=np.array(states),
        readouts=np.array(readouts).reshape(-1, basis.mixing.shape[1], len(z0)),
        reached=t,
        reason=reason,
        evaluations=evaluations,
        newton_windows=newton_windows,
        scale=reached_scale,
        seconds=time.perf_counter() - began,
        cpu_seconds=time.process_time() - cpu_began,
    )


@dataclass
class _Collocated:
    rates: np.ndarray | None
    evaluations: int
    newton: bool = False


def _collocate(
    vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray],
    z: np.ndarray,
    h: float,
    times: np.ndarray,
    basis: FeatureBasis,
    guess: np.ndarray | None,
    tolerance: float,
    scale: np.ndarray,
) -> _Collocated:
    """F at the nodes of a window that satisfies Z = z_a + h S F(Z), or None."""
    integration = h * basis.integration
    rates = guess if guess is not None else vector_field(np.tile(z, (len(times), 1)), times)
    Z = z + integration @ rates
    last = math.inf
    enough = max(0.01 * tolerance, 4e-16)
    for count in range(1, _FIXED_POINT_ITERATIONS + 1):
        rates = vector_field(Z, times)
        moved = z + integration @ rates
        change = float((np.abs(moved - Z) / scale).max())
        Z = moved
        if change <= enough or (change < 1e-12 and change >= last):
            return _Collocated(rates, count)
        if not change < 1e6 or (count > 8 and change > 0.9 * last):
            break
        last = change
    return _newton(vector_field, jacobian, z, h, times, basis, enough, scale, count)


def _newton(
    vector_field: Callable[[np.ndarray, np.ndarray], np.ndarray],
    jacobian: Callable[[np.ndarray, np.ndarray], np.ndarray],
    z: np.ndarray,
    h: float,
    times: np.ndarray,
    basis: FeatureBasis,
    enough: float,
    scale: np.ndarray,
    spent: int,
) -> _Collocated:
    """The same equation by Newton's method, from the constant state."""
    count, dim = len(times), len(z)
    integration = h * basis.integration
    Z = np.tile(z, (count, 1))
    last = math.inf
    for step in range(1, _NEWTON_ITERATIONS + 1):
        rates = vector_field(Z, times)
        defect = z + integration @ rates - Z
        matrix = np.eye(count * dim) - np.einsum(
            "kl,lij->kilj", integration, jacobian(Z, times)
        ).reshape(count * dim, count * dim)
        try:
            correction = np.linalg.solve(matrix, defect.ravel()).reshape(count, dim)
        except np.linalg.LinAlgError:
            break
        Z = Z + correction
        change = float((np.abs(correction) / scale).max())
        if change <= enough or (change < 1e-11 and change >= last):
            return _Collocated(vector_field(Z, times), spent + step + 1, newton=True)
        if not change < 1e6:
            break
        last = change
    return _Collocated(None, spent + _NEWTON_ITERATIONS)


def _first_length(z: np.ndarray, rate: np.ndarray, span: float) -> float:
    """A tenth of the time in which the coordinates or the momenta would change by their size."""
    sizes, speeds = (np.abs(v).reshape(2, -1).max(axis=1) for v in (z, rate))
    known = (sizes > 0) & (speeds > 0)
    return min(span, 0.1 * float((sizes[known] / speeds[known]).min(initial=math.inf)))


def _floored(scale: np.ndarray) -> np.ndarray:
    """Scales with the floor of 1e-8 of the largest of their half; 1 where a half is zero so far."""
    halves = scale.reshape(2, -1)
    largest = halves.max(axis=1, keepdims=True)
    largest = np.where(largest > 0, largest, 1.0)
    return np.maximum(halves, 1e-8 * largest).ravel()


class FeatureTrial(torch.nn.Module):
    """The solution of a march as a function of time, with its derivative; one network a window."""

    def __init__(self, windows: March, basis: FeatureBasis) -> None:
        super().__init__()
        for name, array in (
            ("edges", windows.edges),
            ("states", windows.states),
            ("readouts", windows.readouts),
            ("series", basis.series),
            ("rate_series", basis.rate_series),
        ):
            self.register_buffer(name, torch.tensor(array))
        self.direction = math.copysign(1.0, windows.edges[-1] - windows.edges[0])

    edges: Tensor
    states: Tensor
    readouts: Tensor
    series: Tensor
    rate_series: Tensor

    def forward(self, t: Tensor) -> tuple[Tensor, Tensor]:
        """z^ and dz^/dt at times t of shape (K,); each of shape (K, dim)."""
        window = torch.searchsorted(self.direction * self.edges, self.direction * t, right=True) - 1
        window = window.clamp(0, len(self.readouts) - 1)
        start, length = self.edges[window], (self.edges[1:] - self.edges[:-1])[window]
        s = (t - start) / length
        polynomials = _chebyshev_values(2 * s - 1)
        f = -torch.expm1(-s).unsqueeze(-1)
        network, slopes = polynomials @ self.series, polynomials @ self.rate_series
        readout = self.readouts[window]
        z = self.states[window] + torch.einsum("km,kmd->kd", f * network, readout)
        dz = torch.einsum("km,kmd->kd", (1 - f) * network + f * slopes, readout)
        return z, dz / length.unsqueeze(-1)


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
