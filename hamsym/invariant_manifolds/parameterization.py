"""Local stable and unstable manifolds as polynomials, by the parameterization method.

The unstable manifold of a fixed point z* is z = W(u) with a polynomial W of the coordinates u of
the unstable subspace, in which the dynamics is linear (Cabre, Fontich & de la Llave 2003):

    F(W(u)) = DW(u) Lambda u          at an equilibrium of z' = F(z), with its exponents Lambda,
    P(W(u)) = W(M u)                  at a fixed point of a map P, with its multipliers M.

W begins with z* and the eigenvectors. Its further coefficients come from Newton's method with the
derivative at z*: in both cases a matrix of shape (dim, dim) for each power of u. The map P is the
flow over the period of an orbit, or several, forwards or backwards.

The ball |u| <= 1 is made so small that W is accurate on it. The invariance error is the distance of
the left side from the manifold: the part of the defect that is not tangent to it, at other points
than those of the fit. Complex exponents come in pairs with conjugate coordinates.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from hamsym.errors import InputError
from hamsym.numerics.monomials import monomials
from hamsym.numerics.scales import coupled_sizes, paired_sizes

_TERMS, _DEGREE = 50, 10  # most terms of W, and its largest degree
_NEWTON = 12  # iterations
_SHRINKS, _PATIENCE = 60, 4  # attempts to find the size of the ball, and those without success
_ALIKE = 1e6  # condition of the eigenvectors above which they are not told apart
_POINTS = 40  # at which the error is measured
# Singular values, relative to the largest, of terms that no equation fixes: in general, and of
# linear ones, for which a derivative with round-off decides.
_RESONANT, _LINEAR = 1e-10, 1e-5
_PARALLEL = 1e-6  # singular values, relative to the largest, of one tangent direction
_ROUND_OFF = 1e-14  # entries of an inverse, relative to the largest
_ENOUGH = 1e-14  # relative change of the coefficients that ends the iteration


Function = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True, eq=False)
class Flow:
    """A vector field near an equilibrium; backwards in time it has the opposite sign."""

    #: The equilibrium, shape (dim,).
    point: np.ndarray
    #: Derivative of the vector field there.
    matrix: np.ndarray
    #: Its sizes, and the time of the slowest exponent, for the sizes of components.
    coupling: np.ndarray
    time: float
    #: (n, dim) -> (n, dim)
    field: Function
    units = None

    def factors(self, powers: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Of the terms of W on the right side of its equation."""
        return np.asarray(powers @ rates)

    def operator(self, factor: complex) -> np.ndarray:
        """Derivative of the defect by a term of W with this factor, at the equilibrium."""
        return (self.matrix - factor * np.eye(len(self.matrix))) * self.time

    def defect(self, table: np.ndarray, series: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Left side minus right side at points with a table of powers, shape (n, dim)."""
        states = self.point + (table @ series).real
        # In the unit of states: over the time of the slowest exponent.
        return (self.field(states) - (table @ (series * factors[:, None])).real) * self.time

    def along(self, states: np.ndarray) -> np.ndarray:
        """Further tangent vectors of the manifold at states, shape (n, dim, m)."""
        return np.zeros((*states.shape, 0))


@dataclass(frozen=True, eq=False)
class PeriodMap:
    """The flow over periods of an orbit, or over a time, near its start; methods as of a Flow."""

    point: np.ndarray
    matrix: np.ndarray
    #: Mean sizes of the derivative of the vector field along the orbit, its period, and the sizes
    #: of components along it; None at an equilibrium.
    coupling: np.ndarray
    time: float
    units: np.ndarray | None
    #: States, shape (n, dim), and the sizes of components that matter -> (n, dim); rows of NaN
    #: where it is not known.
    map: Callable[[np.ndarray, np.ndarray], np.ndarray]
    #: The vector field there, for an orbit without a clock.
    field: Function | None

    def factors(self, powers: np.ndarray, rates: np.ndarray) -> np.ndarray:
        return np.asarray(np.prod(rates**-powers, axis=1))

    def operator(self, factor: complex) -> np.ndarray:
        return factor * self.matrix - np.eye(len(self.matrix))

    def defect(self, table: np.ndarray, series: np.ndarray, factors: np.ndarray) -> np.ndarray:
        sources, moved = (table @ (series * factors[:, None])).real, (table @ series).real
        return self.map(self.point + sources, _sizes(self, moved)) - self.point - moved

    def along(self, states: np.ndarray) -> np.ndarray:
        if self.field is None:
            return np.zeros((*states.shape, 0))
        return np.asarray(self.field(states))[..., None]


Dynamics: TypeAlias = Flow | PeriodMap


@dataclass(frozen=True, eq=False)
class LocalManifold:
    """The polynomial W on the ball \\|u\\| <= 1.

    Attributes
    ----------
    point : numpy.ndarray
        The fixed point W(0), shape (dim,).
    rates : numpy.ndarray
        Exponents of an equilibrium, in units of 1/time, or multipliers of the map, away from the
        point; complex, shape (n,), conjugate ones one after the other.
    powers : numpy.ndarray
        Powers of the coordinates in each term, shape (terms, n).
    series : numpy.ndarray
        Coefficients of W, complex, shape (terms, dim).
    error : float
        Invariance error: the largest distance of the image of W from the manifold, relative to the
        size of each component on it.
    scale : numpy.ndarray
        These sizes, shape (dim,).
    """

    point: np.ndarray
    rates: np.ndarray
    powers: np.ndarray
    series: np.ndarray
    error: float
    scale: np.ndarray

    @property
    def dimension(self) -> int:
        """Number of coordinates."""
        return len(self.rates)

    def coordinates(self, real: np.ndarray) -> np.ndarray:
        """Complex coordinates u of real ones of the same length, shape (..., n)."""
        return _complex(np.asarray(real, dtype=float), self.rates)

    def __call__(self, u: np.ndarray) -> np.ndarray:
        """States W(u), shape (..., n) -> (..., dim)."""
        return np.asarray(self.point + (monomials(u, self.powers) @ self.series).real)

    def tangents(self, u: np.ndarray) -> np.ndarray:
        """Derivatives of W by the coordinates, complex, shape (..., n) -> (..., dim, n)."""
        return _tangents(u, self.powers, self.series)


def _complex(real: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Pairs of real coordinates to conjugate ones where the exponents are conjugate."""
    found = real.astype(complex)
    for k in np.flatnonzero(rates.imag > 0):
        found[..., k] = real[..., k] + 1j * real[..., k + 1]
        found[..., k + 1] = found[..., k].conj()
    return found


def _tangents(u: np.ndarray, powers: np.ndarray, series: np.ndarray) -> np.ndarray:
    columns = []
    for k in range(powers.shape[1]):
        lower = powers.copy()
        lower[:, k] = np.maximum(lower[:, k] - 1, 0)
        columns.append(monomials(u, lower) * powers[:, k] @ series)
    return np.stack(columns, axis=-1)


def parameterized(
    dynamics: Dynamics, rates: np.ndarray, vectors: np.ndarray, size: float, wanted: float
) -> LocalManifold:
    """Find W on the largest ball, up to a size, on which its error is small enough.

    Raise InputError if the eigenvectors are not independent.

    - rates: Exponents or multipliers, complex, shape (n,), conjugate ones adjacent.
    - vectors: Their eigenvectors, the columns, shape (dim, n).
    - size: The factor of the vectors with which the search begins.
    - wanted: Largest invariance error. If no ball has it, that with the least error is returned.
    """
    scaled = vectors / _sizes(dynamics, vectors.T)[:, None]
    if not np.linalg.cond(scaled / np.linalg.norm(scaled, axis=0)) <= _ALIKE:
        raise InputError(
            "the exponents coincide and have too few eigenvectors; change a parameter a little"
        )
    found = _on_largest_ball(dynamics, rates, vectors, size, wanted, free=2)
    if found is None or not found.error <= wanted:
        improved = _on_largest_ball(dynamics, rates, vectors, size, wanted, free=1)
        if found is None or (improved is not None and improved.error < found.error):
            found = improved
    if found is None:
        raise InputError("the motion near the fixed point is not finite")
    return found


def _on_largest_ball(
    dynamics: Dynamics,
    rates: np.ndarray,
    vectors: np.ndarray,
    size: float,
    wanted: float,
    free: int,
) -> LocalManifold | None:
    """W on the largest ball with the error that is wanted, or on that with the least.

    - free: The least degree of terms that are solved for: 2 with the eigenvectors as they are, 1
      where these are not accurate, as of an orbit on which neighbours move faster than itself.
    """
    powers, best, patience = _powers(len(rates)), None, _PATIENCE
    for _ in range(_SHRINKS):
        with np.errstate(all="ignore"):
            found = _on_ball(dynamics, rates, size * vectors, powers, free)
        if found is not None and (best is None or 2 * found.error < best.error):
            best, patience = found, _PATIENCE
        elif best is not None:
            patience -= 1
        if best is not None and (best.error <= wanted or not patience):
            break
        size /= 2
    return best


def _powers(count: int) -> np.ndarray:
    """Powers of all terms up to the degree of as many coordinates, the constant first."""
    degree = next(k for k in range(_DEGREE, 0, -1) if math.comb(count + k, k) <= _TERMS or k == 2)
    found = [p for p in itertools.product(range(degree + 1), repeat=count) if sum(p) <= degree]
    return np.array(sorted(found, key=lambda p: (sum(p), p[::-1])))


def _on_ball(
    dynamics: Dynamics, rates: np.ndarray, vectors: np.ndarray, powers: np.ndarray, free: int
) -> LocalManifold | None:
    """Solve for W; None if Newton's method does not come to finite numbers."""
    count, degrees = len(rates), powers.sum(axis=1)
    factors = dynamics.factors(powers, rates)
    series = np.zeros((len(powers), len(vectors)), complex)
    series[degrees == 1] = vectors.T[np.argmax(powers[degrees == 1], axis=1)]
    table = monomials(_complex(_ball(count, 2 * len(powers), seed=0), rates), powers)
    expansion, units = np.linalg.pinv(table), _sizes(dynamics, vectors.T)
    # Eigenvectors are not changed along themselves.
    solved = np.flatnonzero(degrees >= free)
    inverses = np.stack(
        [
            _inverse(
                dynamics.operator(factors[k]), units, _LINEAR if degrees[k] == 1 else _RESONANT
            )
            for k in solved
        ]
    )
    before = math.inf
    for _ in range(_NEWTON):
        terms = expansion @ dynamics.defect(table, series, factors)
        if not np.isfinite(terms).all():
            return None
        step = np.einsum("kij,kj->ki", inverses, terms[solved])
        series[solved] -= step
        change = float((np.abs(step) / units).max())
        if not change < 1e6:
            return None
        if change <= _ENOUGH or (change < 1e-9 and change > before / 2):
            break
        before = change
    u = _complex(_ball(count, _POINTS, seed=1), rates)
    return _judged(dynamics, rates, powers, series, u)


def error_behind(
    around: PeriodMap, local: LocalManifold, multipliers: np.ndarray, u: np.ndarray, least: float
) -> float:
    """Measure the error of W at starts and in their past; infinite where it is not known.

    A manifold's trajectories come from the fixed point: the map takes W(u/M) to W(u), W(u/M^2) to
    W(u/M), and so on. Its trajectories meet every feature of the force on that way, however narrow.

    - multipliers: M, shape (n,).
    - u: Complex coordinates of the starts, shape (count, n).
    - least: Length of coordinates at which the way ends.
    """
    farthest = np.abs(u).max(initial=0.0)
    turns = max(1, math.ceil(math.log(farthest / least) / math.log(np.abs(multipliers).min())))
    way = u * multipliers ** -np.arange(turns)[:, None, None]
    with np.errstate(all="ignore"):
        found = _judged(
            around, multipliers, local.powers, local.series, way.reshape(-1, u.shape[1])
        )
    return math.inf if found is None else found.error


def _judged(
    dynamics: Dynamics, rates: np.ndarray, powers: np.ndarray, series: np.ndarray, u: np.ndarray
) -> LocalManifold | None:
    """W with its error at points u, in its own sizes of the components."""
    table = monomials(u, powers)
    moved = (table @ series).real
    scale = _sizes(dynamics, moved)
    if not np.isfinite(scale).all():
        return None
    defect = dynamics.defect(table, series, dynamics.factors(powers, rates)) / scale
    tangents = _tangents(u, powers, series)
    parts = [tangents.real, tangents.imag, dynamics.along(dynamics.point + moved)]
    directions = np.concatenate(parts, axis=2) / scale[:, None]
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    directions = directions / np.where(lengths > 0, lengths, 1.0)
    if not (np.isfinite(defect).all() and np.isfinite(directions).all()):
        return None
    across = [
        rest - tangent @ np.linalg.lstsq(tangent, rest, rcond=_PARALLEL)[0]
        for tangent, rest in zip(directions, defect, strict=True)
    ]
    error = float(np.abs(across).max())
    return LocalManifold(dynamics.point, rates, powers, series, error, scale)


def _sizes(dynamics: Dynamics, rows: np.ndarray) -> np.ndarray:
    """Sizes of components with those that others move; as far as these where nothing moves.

    About an orbit they are at least the same share of the size of each component along it.
    """
    sizes = coupled_sizes(np.abs(rows).max(axis=0), dynamics.coupling, dynamics.time)
    if dynamics.units is not None:
        sizes = np.maximum(sizes, dynamics.units * (sizes / dynamics.units).max())
    sizes = np.where(sizes == 0, paired_sizes(sizes, dynamics.coupling, dynamics.time), sizes)
    return np.where(sizes == 0, 1.0, sizes)


def _inverse(operator: np.ndarray, units: np.ndarray, cut: float) -> np.ndarray:
    """The inverse of a matrix, or at a resonance that of least norm."""
    scaled = operator * units / units[:, None]
    found = np.linalg.pinv(scaled, rcond=cut)
    # Components that are not coupled stay exactly zero.
    found = np.where(np.abs(found) > _ROUND_OFF * np.abs(found).max(), found, 0.0)
    return np.asarray(found * units[:, None] / units)


def _ball(count: int, number: int, seed: int) -> np.ndarray:
    """Points of the ball |u| <= 1 in as many dimensions, denser at its boundary."""
    if count == 1:
        turns = (np.arange(number) + 0.5) / number
        return np.cos(np.pi * (turns if seed == 0 else turns * 0.97))[:, None]
    random = np.random.default_rng(seed)
    directions = random.normal(size=(number * count, count))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    radii = np.sin(np.pi / 2 * (np.arange(len(directions)) + 0.5) / len(directions))
    return np.asarray(directions * radii[:, None])
