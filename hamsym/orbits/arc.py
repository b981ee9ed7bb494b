"""The boundary-value problem of a periodic orbit: collocation over its arc, and Newton's method.

The arc, the part of the period after which the closing condition holds, is divided into windows
with Chebyshev points. All values at the points, the period and, for families, the energy or a
parameter are unknowns of one Newton iteration. Values inside a window are eliminated, so that the
linear system has only the states at the ends of windows.

Where energy is conserved the equations dz/dt = J grad H + alpha grad H make the system square
(Munoz-Almaraz, Freire, Galan, Doedel & Vanderbauwhede 2003): along a periodic orbit alpha = 0,
because dH/dt = alpha |grad H|^2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg
import sympy

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import floored_sizes
from hamsym.numerics.windows import locate
from hamsym.orbits.period import Period
from hamsym.orbits.symmetry import Closing, SignedPermutation
from hamsym.random_features.flow import flow_of
from hamsym.solution.parameters import ParameterForcing

__all__ = ["Arc", "NewtonSystem", "Problem", "Step"]

_SINGULAR = 1e-11  # reciprocal condition number of a system without a unique solution
_RANK = 1e-8  # singular values relative to the largest that count as zero
_FLOOR = 1e-8  # scale of a component relative to the largest of its kind


@dataclass(frozen=True)
class Arc:
    """States along an arc, from t = start to start + period/parts.

    Attributes
    ----------
    edges : numpy.ndarray
        Ends of the windows as fractions of the arc, shape (k + 1,).
    ends : numpy.ndarray
        States there, shape (k + 1, dim).
    values : numpy.ndarray
        States at the Chebyshev points, shape (k, nodes, dim).
    period : float
    """

    edges: np.ndarray
    ends: np.ndarray
    values: np.ndarray
    period: float

    @property
    def scale(self) -> np.ndarray:
        """Largest size of each component, with a floor for components that are nearly zero."""
        sizes = np.maximum(np.abs(self.ends).max(axis=0), np.abs(self.values).max(axis=(0, 1)))
        return floored_sizes(sizes, _FLOOR)

    def at(self, fraction: np.ndarray) -> np.ndarray:
        """Evaluate states at fractions of the arc, shape (n,) -> (n, dim)."""
        window, s = locate(self.edges, fraction)
        rule = collocation(self.values.shape[1])
        found = np.empty((len(fraction), self.ends.shape[1]))
        for k in np.unique(window):
            rows = window == k
            found[rows] = rule.interpolation(s[rows]) @ self.values[k]
        return found

    def tails(self) -> np.ndarray:
        """Size of the last Chebyshev coefficients of each window, relative to the scales."""
        series = np.einsum("ij,kjd->kid", collocation(self.values.shape[1]).to_series, self.values)
        return np.asarray((np.abs(series[:, -3:]) / self.scale).max(axis=(1, 2)))

    def on(self, edges: np.ndarray, nodes: int) -> Arc:
        """Interpolate to other windows with another number of points."""
        points = edges[:-1, None] + np.diff(edges)[:, None] * collocation(nodes).nodes
        values = self.at(points.ravel()).reshape(*points.shape, -1)
        return Arc(edges, self.at(edges), values, self.period)


@dataclass(frozen=True)
class Step:
    """The solution of Newton's linear system at an arc.

    Attributes
    ----------
    ends, values : numpy.ndarray
        Corrections of the states, shaped as those of the arc.
    period, parameter : float
        Corrections of the period and of the parameter.
    residual, size : float
        Largest residual and correction, relative to the scales.
    singular : bool
        Whether the system has no unique solution.
    maps : numpy.ndarray
        Derivatives of the windows' flows, shape (k, dim, dim).
    """

    ends: np.ndarray
    values: np.ndarray
    period: float
    parameter: float
    residual: float
    size: float
    singular: bool
    maps: np.ndarray

    def applied(self, arc: Arc, share: float = 1.0) -> Arc:
        """Apply a share of the correction to the arc."""
        return replace(
            arc,
            ends=arc.ends + share * self.ends,
            values=arc.values + share * self.values,
            period=arc.period + share * self.period,
        )


@dataclass(frozen=True)
class Problem:
    """Conditions on a periodic orbit.

    Attributes
    ----------
    H : Hamiltonian
    closing : Closing
    energy, period : float or None
        What is given. Without both, a conservative H has a family of orbits.
    start : float
        Time at the start of the arc.
    parameter : str or None
        A parameter that is unknown.
    exact_period : Period or None
        The period as a formula, if it is given.
    """

    H: Hamiltonian
    closing: Closing
    energy: float | None = None
    period: float | None = None
    start: float = 0.0
    parameter: str | None = None
    exact_period: Period | None = None

    @property
    def autonomous(self) -> bool:
        return self.H.time is None

    @property
    def conservative(self) -> bool:
        """Whether energy is conserved, so that orbits come in families."""
        return self.H.conserves_energy


class NewtonSystem:
    """Newton's linear system at an arc, of the states at the ends of windows and the period.

    Parameters
    ----------
    problem : Problem
    arc : Arc
    anchor : (numpy.ndarray, numpy.ndarray)
        A state and the vector field there: the orbit starts in the plane normal to the field.

    Attributes
    ----------
    matrix, right : numpy.ndarray
        Of the scaled unknowns that are not known, shapes (m, n) and (m,).
    units : numpy.ndarray
        Of all unknowns: states, period, alpha, parameter.
    """

    def __init__(self, problem: Problem, arc: Arc, anchor: tuple[np.ndarray, np.ndarray]) -> None:
        self._arc, self._windows = arc, _WindowMaps(problem, arc)
        dim, self.scale = problem.H.dim, arc.scale
        self._count = arc.ends.size
        self._rows: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        self._join_windows()
        closing = problem.closing
        if closing.first is not None and closing.last is not None:
            self._reflect(closing.first, 0)
            self._reflect(closing.last, len(arc.ends) - 1)
        else:
            self._close(closing)
            if problem.autonomous:
                normal = anchor[1] / self.scale**2
                self._add(normal, float(normal @ (arc.ends[0] - anchor[0])))
        if problem.period is not None and problem.autonomous:
            row = np.zeros((1, self._count + 3))
            row[0, self._count] = 1 / arc.period
            self._rows.append(row)
            self._right.append(np.array([problem.period / arc.period - 1]))
        if problem.energy is not None:
            system = problem.H.compile("numpy")
            excess = float(system.energy(arc.ends[0])) - problem.energy
            by_parameter = 0.0
            if problem.parameter is not None:
                by_parameter = _energy_slope(problem.H, problem.parameter, arc.ends[0])
            self._add(np.asarray(system.gradient(arc.ends[0])), excess, by_parameter)
        unknown = np.ones(self._count + 3, dtype=bool)
        unknown[self._count] = problem.autonomous
        unknown[self._count + 1] = problem.conservative and not closing.reversing
        unknown[self._count + 2] = problem.parameter is not None
        rows = np.vstack(self._rows)
        self.units = np.concatenate(
            [np.tile(self.scale, len(arc.ends)), [arc.period], _largest(rows[:, -2:])]
        )
        self.matrix = (rows * self.units)[:, unknown]
        self.right = np.concatenate(self._right)
        self._unknown, self._dim = unknown, dim

    # -- equations ----------------------------------------------------------------------------

    def _join_windows(self) -> None:
        arc, maps = self._arc, self._windows.ends
        dim = arc.ends.shape[1]
        for k, window in enumerate(maps):
            row = np.zeros((dim, self._count + 3))
            row[:, k * dim : (k + 1) * dim] = window[:, :dim]
            row[:, (k + 1) * dim : (k + 2) * dim] -= np.eye(dim)
            row[:, self._count :] = window[:, dim : dim + 3]
            self._rows.append(row / self.scale[:, None])
            self._right.append(-window[:, dim + 3] / self.scale)

    def _close(self, closing: Closing) -> None:
        arc = self._arc
        dim = arc.ends.shape[1]
        row = np.zeros((dim, self._count + 3))
        row[:, :dim] = -closing.shift.matrix
        row[:, self._count - dim : self._count] += np.eye(dim)
        self._rows.append(row / self.scale[:, None])
        self._right.append((closing.shift(arc.ends[0]) - arc.ends[-1]) / self.scale)

    def _reflect(self, symmetry: SignedPermutation, place: int) -> None:
        conditions, state = symmetry.conditions, self._arc.ends[place]
        dim = len(state)
        row = np.zeros((len(conditions), self._count + 3))
        row[:, place * dim : (place + 1) * dim] = conditions
        weights = np.abs(conditions) @ self.scale
        self._rows.append(row / weights[:, None])
        self._right.append(-(conditions @ state) / weights)

    def _add(self, slope: np.ndarray, excess: float, by_parameter: float = 0.0) -> None:
        """Add the equation of the first state: slope . correction + by_parameter ... = -excess."""
        row = np.zeros((1, self._count + 3))
        row[0, : len(slope)], row[0, self._count + 2] = slope, by_parameter
        weight = float(np.abs(slope) @ self.scale) or 1.0
        self._rows.append(row / weight)
        self._right.append(np.array([-excess / weight]))

    # -- solutions ----------------------------------------------------------------------------

    def solved(self, across: np.ndarray | None = None) -> Step:
        """Solve for the corrections.

        Parameters
        ----------
        across : numpy.ndarray, optional
            A direction of all scaled unknowns, to which the correction is orthogonal: the one more
            equation of a family.
        """
        matrix, right = self.matrix, self.right
        if across is not None:
            matrix = np.vstack([matrix, across[self._unknown]])
            right = np.append(right, 0.0)
        solution, singular = _solved(matrix, right)
        return self._step(solution, singular)

    def direction(self, before: np.ndarray | None) -> np.ndarray:
        """Return the unit vector along the family, in the sense of a direction before.

        States count as their root mean square, so that windows do not matter.
        """
        null = scipy.linalg.svd(self.matrix)[2][-1]
        found = np.zeros(len(self.units))
        found[self._unknown] = null
        found[self._count + 1] = 0.0
        weights = np.ones(len(found))
        weights[: self._count] = self._dim / self._count
        found *= weights
        found /= np.sqrt(np.sum(found**2 / weights))
        if before is not None and found @ (before / weights) < 0:
            found = -found
        return found

    def _step(self, solution: np.ndarray, singular: bool) -> Step:
        windows, dim, count = self._windows, self._dim, self._count
        whole = np.zeros(len(self.units))
        whole[self._unknown] = solution
        whole[~np.isfinite(whole)] = math.nan
        size = float(np.abs(np.delete(whole, count + 1)).max())
        whole *= self.units
        ends = whole[:count].reshape(-1, dim)
        inside = windows.inside
        values = np.einsum("kjac,kc->kja", inside[..., :dim], ends[:-1])
        values += inside[..., dim : dim + 3] @ whole[count:] + inside[..., dim + 3]
        residual = np.abs(windows.residual) / self.scale
        return Step(
            ends,
            values,
            float(whole[count]),
            float(whole[count + 2]),
            max(float(np.abs(self.right).max()), float(residual.max())),
            max(size, float((np.abs(values) / self.scale).max())),
            singular,
            windows.ends[..., :dim],
        )


class _WindowMaps:
    """Corrections in windows by those at their start, of T, alpha and a parameter, plus constants.

    Attributes
    ----------
    inside, ends : numpy.ndarray
        At the points, shape (k, nodes, dim, dim + 4), and at the ends, shape (k, dim, dim + 4).
    residual : numpy.ndarray
        Of the collocation equations, shape (k, nodes, dim).
    """

    def __init__(self, problem: Problem, arc: Arc) -> None:
        flow = flow_of(problem.H)
        windows, nodes, dim = arc.values.shape
        rule = collocation(nodes)
        share = np.diff(arc.edges)[:, None, None] / problem.closing.parts  # of the period
        lengths = share * arc.period
        points = arc.edges[:-1, None] + np.diff(arc.edges)[:, None] * rule.nodes
        times = (problem.start + points / problem.closing.parts * arc.period).ravel()
        states = arc.values.reshape(-1, dim)
        rates = flow.vector_field(states, times).reshape(windows, nodes, dim)
        jacobians = flow.jacobian(states, times).reshape(windows, nodes, dim, dim)
        jacobians = jacobians * lengths[..., None]
        half = dim // 2
        slopes = np.concatenate([-rates[..., half:], rates[..., :half]], axis=-1)  # grad H
        forcing = np.zeros((windows, nodes, dim, 4))
        forcing[..., 0], forcing[..., 1] = rates * share, slopes * lengths
        if problem.parameter is not None:
            found = ParameterForcing(problem.H, (problem.parameter,))(states, times)
            forcing[..., 2] = found.reshape(windows, nodes, dim) * lengths
        inside, last = rule.integration[:-1], rule.integration[-1]
        moved = lengths * rates
        starts = arc.ends[:-1, None]
        self.residual = starts + np.einsum("ij,kjd->kid", inside, moved) - arc.values
        columns = np.zeros((windows, nodes, dim, dim + 4))
        columns[..., :dim] = np.eye(dim)
        columns[..., dim:] = np.einsum("ij,kjdc->kidc", inside, forcing)
        columns[..., dim + 3] = self.residual
        size = nodes * dim
        # In units of the components: pivots of coordinates and momenta are comparable in no others.
        scale = arc.scale
        scaled = jacobians * scale / scale[:, None]
        matrix = np.einsum("ij,kjab->kiajb", inside, scaled).reshape(windows, size, size)
        right = (columns / scale[:, None]).reshape(windows, size, dim + 4)
        found = _each_solved(np.eye(size) - matrix, right).reshape(columns.shape)
        self.inside = found * scale[:, None]
        driven = np.einsum("kjab,kjbc->kjac", jacobians, self.inside)
        driven[..., dim:] += forcing
        self.ends = np.einsum("j,kjac->kac", last, driven)
        self.ends[..., :dim] += np.eye(dim)
        self.ends[..., dim + 3] += (
            arc.ends[:-1] - arc.ends[1:] + np.einsum("j,kjd->kd", last, moved)
        )


def _energy_slope(H: Hamiltonian, parameter: str, state: np.ndarray) -> float:
    """The derivative of H by a parameter."""
    real = H.real_equations
    slope = sympy.diff(real.expr, real.parameters[parameter][0])
    return float(H.observable(slope)(state))


def _largest(rows: np.ndarray) -> np.ndarray:
    """Return units in which columns have entries up to one."""
    found = np.abs(rows).max(axis=0)
    return np.where(found > 0, 1 / np.where(found > 0, found, 1.0), 1.0)


def _each_solved(matrices: np.ndarray, columns: np.ndarray) -> np.ndarray:
    try:
        return np.linalg.solve(matrices, columns)
    except np.linalg.LinAlgError:
        return np.full(columns.shape, math.nan)


def _solved(matrix: np.ndarray, right: np.ndarray) -> tuple[np.ndarray, bool]:
    """Solve a system, by least squares of least norm where it is singular."""
    if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
        return np.full(matrix.shape[1], math.nan), True
    if matrix.shape[0] == matrix.shape[1]:
        factors = scipy.linalg.lu_factor(matrix, check_finite=False)
        rcond, _ = scipy.linalg.lapack.dgecon(factors[0], np.abs(matrix).sum(axis=0).max())
        if rcond > _SINGULAR:
            return scipy.linalg.lu_solve(factors, right, check_finite=False), False
    return scipy.linalg.lstsq(matrix, right, cond=_RANK, lapack_driver="gelsy")[0], True
