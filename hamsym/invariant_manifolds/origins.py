"""What the manifolds of an equilibrium and of a periodic orbit begin with.

Input:  an equilibrium or a periodic orbit, and the direction of time in which its manifold leaves.
Output: a :class:`LocalManifold`, with what is needed to grow it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias

import numpy as np
import scipy

from hamsym.dynamics.equilibrium import Equilibrium
from hamsym.errors import InputError
from hamsym.families.many import solve_many
from hamsym.hamiltonian import Hamiltonian
from hamsym.invariant_manifolds.parameterization import (
    Flow,
    LocalManifold,
    PeriodMap,
    error_behind,
    parameterized,
)
from hamsym.numerics.scales import coupled_sizes
from hamsym.numerics.symplectic import symplectic_inverse
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.symbolic.derivatives import connected_blocks

Origin: TypeAlias = Equilibrium | PeriodicOrbit

_LEAST = 1.01  # size of a multiplier; nearer to 1 round-off moves trivial ones
_GROWTH = 2.0  # least multiplier of the map, which takes as many periods as that needs
_NONLINEAR = 0.3  # share of the linear force that others reach at the radius of an equilibrium
_DOUBLINGS = 200  # beyond which H is quadratic
_NOISE = 1e-13  # entries, relative to the largest in suitable units, that are round-off
_RESTING = 1e-6  # size of a component that is at rest, relative to a motion as far as others
_SHARE = 0.05  # of an orbit's scale, with which the search for its ball begins
_TOLERANCES = (1e-12, 1e-11, 1e-10, 1e-9, 1e-8)  # of the map, the first that is met


@dataclass(frozen=True, eq=False)
class Departure:
    """Where trajectories of a manifold begin, in coordinates of its fundamental domain.

    A trajectory has a direction d with |d| = 1 in the coordinates of W and, at an orbit, a phase
    theta: it begins at W(M^-theta d), and is at the boundary of the local manifold after theta
    periods, theta turns along the orbit. Directions and phases from 0 to 1 give each trajectory
    once; with a negative multiplier phases from 0 to 2 for one of the sides do, too.
    """

    H: Hamiltonian
    local: LocalManifold
    #: 1 or -1: the direction of time away from the origin.
    sign: int
    #: Time at the start.
    start: float
    #: Multipliers of one period, complex, shape (n,), or exponents per unit of time.
    rates: np.ndarray
    #: None at an equilibrium.
    period: float | None
    #: Time in which the local manifold grows e times.
    time: float
    #: The flow by which the past of starts is followed, and its multipliers, complex, shape (n,).
    around: PeriodMap = field(repr=False)
    multipliers: np.ndarray = field(repr=False)

    def coordinates(self, directions: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """Coordinates u of the starts, complex, (n, count) and (n,) -> (n, count)."""
        d = self.local.coordinates(directions)
        if self.period is None:
            return d
        return np.asarray(d * np.exp(-phases[:, None] * self._logarithms))

    def states(self, directions: np.ndarray, phases: np.ndarray) -> np.ndarray:
        """The starts, shape (n, dim)."""
        return self.local(self.coordinates(directions, phases))

    def followed(self, directions: np.ndarray, phases: np.ndarray, least: float) -> Departure:
        """Measure the error of the local manifold in the past of starts, too.

        - least: Share of the local manifold at which the past ends.
        """
        u = self.coordinates(directions, phases)
        error = error_behind(self.around, self.local, self.multipliers, u, least)
        return replace(
            self, local=replace(self.local, error=float(np.maximum(self.local.error, error)))
        )

    def by_phase(self, direction: np.ndarray, phase: float) -> np.ndarray:
        """Derivative of a start by its phase, shape (dim,)."""
        u = self.coordinates(direction[None], np.array([phase]))[0]
        return np.asarray((self.local.tangents(u) @ (-self._logarithms * u)).real)

    def by_direction(self, direction: np.ndarray, phase: float, change: np.ndarray) -> np.ndarray:
        """Derivative of a start along a change of its direction, shape (dim,)."""
        u = self.coordinates(direction[None], np.array([phase]))[0]
        moved = self.coordinates(change[None], np.array([phase]))[0]
        return np.asarray((self.local.tangents(u) @ moved).real)

    @property
    def _logarithms(self) -> np.ndarray:
        # A negative multiplier changes the side at the end of a turn, where phases begin again.
        angles = np.where(self.rates.imag == 0, 0.0, np.angle(self.rates))
        return np.asarray(np.log(np.abs(self.rates)) + 1j * angles)


def _field(H: Hamiltonian, t: float, sign: int = 1) -> Callable[[np.ndarray], np.ndarray]:
    """The rates at states, forwards or backwards in time."""
    system = H.compile("numpy")
    return lambda states: sign * system.at("vector_field", states, t)


def departure(origin: Origin, sign: int, wanted: float) -> Departure:
    """Find the local manifold of an equilibrium or an orbit, forwards or backwards in time.

    Raise InputError if there is none, or it cannot be computed.
    """
    if isinstance(origin, PeriodicOrbit):
        return _of_orbit(origin, sign, wanted)
    return _of_equilibrium(origin, sign, wanted)


# -- equilibria ------------------------------------------------------------------------------------


def _of_equilibrium(origin: Equilibrium, sign: int, wanted: float) -> Departure:
    H = origin.H
    if H is None or origin.linear is None or not np.isfinite(origin.z).all():
        raise InputError("a parameter of the equilibrium has no value; give each one a value")
    count = int((origin.eigenvalues.real > 0).sum())
    if not count:
        what = "a centre" if origin.stability == "elliptic" else f"{origin.type}"
        raise InputError(
            f"no trajectory leaves this equilibrium exponentially: it is {what}; manifolds need an "
            "eigenvalue with a real part"
        )
    z = origin.z
    matrix, coupling = _coupled(sign * H.compile("numpy").at("jacobian", z))
    rates, vectors = _eigenvectors(matrix, np.sort(origin.eigenvalues.real)[::-1][:count].min() / 2)
    if len(rates) != count:
        raise InputError("eigenvalues of the equilibrium are too near to zero to be told apart")
    slowest, vector_field = 1 / float(rates.real.min()), _field(H, 0.0, sign)
    flow = Flow(z, matrix, coupling, slowest, vector_field)
    radii = np.array([_radius(flow, vectors[:, k], rates[k]) for k in range(count)])
    for k in np.flatnonzero(rates.imag > 0):
        radii[k : k + 2] = radii[k : k + 2].min()
    local = parameterized(flow, rates, vectors * radii, 1.0, wanted)
    time = math.log(_GROWTH) * slowest
    derivative, image = scipy.linalg.expm(matrix * time), _map_of(H, (0.0, sign * time))
    around = PeriodMap(z, derivative, coupling, slowest, None, image, vector_field)
    return Departure(H, local, sign, 0.0, rates, None, slowest, around, np.exp(rates * time))


def _coupled(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A matrix without couplings that are round-off in units that balance it, and its sizes."""
    units = _balancing(matrix)
    balanced = np.abs(matrix * units / units[:, None])
    kept = np.where(balanced > _NOISE * balanced.max(), matrix, 0.0)
    return kept, np.abs(kept)


def _balancing(matrix: np.ndarray) -> np.ndarray:
    """Units of the components in which entries of a matrix are of one size."""
    with np.errstate(invalid="ignore"):  # scipy takes the units for numbers of a permutation
        return np.diag(scipy.linalg.matrix_balance(matrix, permute=False)[1])


def _eigenvectors(matrix: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues with real parts above a bound, the fastest first, conjugate ones adjacent."""
    size = len(matrix)
    values, vectors = np.empty(size, complex), np.zeros((size, size), complex)
    pairs = [*((i, j) for i, j in np.argwhere(matrix).tolist()), *((k, k) for k in range(size))]
    for block in connected_blocks(pairs, size):  # so that what is not coupled stays zero
        values[block], vectors[np.ix_(block, block)] = np.linalg.eig(matrix[np.ix_(block, block)])
    scaled = np.abs(vectors / _balancing(matrix)[:, None])
    vectors[scaled < _NOISE * scaled.max(axis=0)] = 0.0
    chosen = [k for k in range(size) if values[k].real > least and values[k].imag >= 0]
    return _paired(values, vectors, chosen)


def _paired(
    values: np.ndarray, vectors: np.ndarray, chosen: list[int]
) -> tuple[np.ndarray, np.ndarray]:
    if not chosen:
        return np.empty(0, complex), np.empty((len(vectors), 0), complex)
    rates, columns = [], []
    for k in sorted(chosen, key=lambda k: -abs(values[k])):
        vector = vectors[:, k] / vectors[np.argmax(np.abs(vectors[:, k])), k]
        if values[k].imag == 0:
            rates.append(values[k])
            columns.append(vector.real.astype(complex))
        else:
            rates += [values[k], values[k].conj()]
            columns += [vector / 2, vector.conj() / 2]
    return np.array(rates), np.array(columns).T


def _radius(flow: Flow, vector: np.ndarray, rate: complex) -> float:
    """The factor of an eigenvector at which the force is no more nearly linear, to a power of 2."""
    sizes = coupled_sizes(np.abs(vector), flow.coupling, flow.time)
    units = np.where(sizes > 0, sizes, 1.0)
    steps = np.array([vector.real, -vector.real, vector.imag, -vector.imag])

    def bends(factor: float) -> bool:
        with np.errstate(all="ignore"):
            states = flow.point + factor * steps
            rest = flow.field(states) - (states - flow.point) @ flow.matrix.T
            share = np.abs(rest / units).max() / (factor * abs(rate))
        return not share < _NONLINEAR

    _, exponent = math.frexp(float(np.abs(flow.point / units).max()) or 1.0)
    factor = math.ldexp(1.0, exponent)
    if bends(factor):
        while factor > 1e-290 and bends(factor):
            factor /= 2
        return factor
    for _ in range(_DOUBLINGS):
        if bends(2 * factor):
            return factor
        factor *= 2
    return math.ldexp(1.0, exponent)  # a quadratic H


# -- periodic orbits -------------------------------------------------------------------------------


def _of_orbit(orbit: PeriodicOrbit, sign: int, wanted: float) -> Departure:
    if not orbit.success:
        raise InputError(f"the orbit is not accurate: {orbit.message}")
    H, matrix = orbit.H, orbit.monodromy
    if sign < 0:
        matrix = np.linalg.inv(matrix) if H.forces else symplectic_inverse(matrix)
    times = orbit.problem.start + orbit.period * np.linspace(0, 1, 65)[:-1]
    jacobians = H.compile("numpy").at("jacobian", orbit(times), times)
    coupling = _coupled(np.abs(jacobians).mean(axis=0))[1]
    scale = coupled_sizes(_extents(orbit), coupling, orbit.period)
    rates, vectors = _away(matrix * scale / scale[:, None])
    if not len(rates):
        largest = float(np.abs(orbit.multipliers).max())
        raise InputError(
            f"no trajectory leaves this orbit exponentially: it is {orbit.stability}; manifolds "
            f"need a multiplier above {_LEAST:g} in size, and the largest is {largest:.6g}"
        )
    turns = math.ceil(math.log(_GROWTH) / math.log(float(np.abs(rates).min())))
    period, start = orbit.period, orbit.problem.start
    point, time = orbit.z0, turns * period
    around = PeriodMap(
        point,
        np.linalg.matrix_power(matrix, turns),
        coupling,
        period,
        scale,
        _map_of(H, (start, start + sign * time)),
        _field(H, start) if H.time is None else None,
    )
    # The eigenvectors are the columns in units of the orbit.
    multipliers = rates**turns
    local = parameterized(around, multipliers, scale[:, None] * vectors, _SHARE, wanted)
    folding = period / math.log(float(np.abs(rates).min()))
    return Departure(H, local, sign, start, rates, period, folding, around, multipliers)


def _extents(orbit: PeriodicOrbit) -> np.ndarray:
    """Sizes of components along an orbit; for those at rest, as if they moved as far as others."""
    scale = orbit.problem.scale_of(orbit.arc)
    largest = orbit.problem.paired(scale, orbit.arc)
    return np.where(scale > _RESTING * largest, scale, largest)


def _away(matrix: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues off the unit circle and eigenvectors of a monodromy matrix."""
    if not np.isfinite(matrix).all():
        raise InputError("the monodromy matrix of the orbit is not finite")
    values, vectors = np.linalg.eig(matrix)
    values, vectors = values.astype(complex), vectors.astype(complex)
    vectors[np.abs(vectors) < _NOISE * np.abs(vectors).max(axis=0)] = 0.0
    chosen = [k for k, m in enumerate(values) if abs(m) > _LEAST and m.imag >= 0]
    return _paired(values, vectors, chosen)


def _map_of(H: Hamiltonian, span: tuple[float, float]) -> Callable[..., np.ndarray]:
    """The flow over a span, to the smallest tolerance that all its members meet."""
    tolerances: list[Any] = list(_TOLERANCES)

    def image(states: np.ndarray, sizes: np.ndarray) -> np.ndarray:
        while True:
            tol, last = tolerances[0], len(tolerances) == 1
            # One of them first, because failures take a hundred times as long.
            for chosen in (states[:1], states):
                many = solve_many(H, chosen, span, tol=tol, atol=tol * sizes, progress=False)
                if not (many.success.all() or last):
                    break
            else:
                return np.where(many.success[:, None], many(span[1]), np.nan)
            tolerances.pop(0)

    return image
