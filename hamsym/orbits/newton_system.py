"""Newton's linear system of a periodic orbit at an arc.

The unknowns are the states at the ends of the windows, the period and, for families, a parameter.
The states between the ends of the arc are eliminated (:mod:`hamsym.orbits.condensed`), so that the
effort is proportional to the number of windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy
import sympy

from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.condensed import CondensedWindows, solved
from hamsym.orbits.symmetry import Closing, SignedPermutation
from hamsym.orbits.window_maps import WindowMaps


@dataclass(frozen=True)
class Step:
    """The solution of Newton's linear system at an arc."""

    #: ends, values: Corrections of the states, shaped as those of the arc.
    ends: np.ndarray
    values: np.ndarray
    #: period, parameter: Corrections of the period and of the parameter.
    period: float
    parameter: float
    #: residual, size: Largest residual and correction, relative to the scales.
    residual: float
    size: float
    #: Whether the system has no unique solution.
    singular: bool
    #: Derivatives of the windows' flows, shape (k, dim, dim).
    maps: np.ndarray

    def applied(self, arc: Arc, share: float = 1.0) -> Arc:
        """Apply a share of the correction to the arc."""
        return replace(
            arc,
            ends=arc.ends + share * self.ends,
            values=arc.values + share * self.values,
            period=arc.period + share * self.period,
        )


class NewtonSystem:
    """Newton's linear system at an arc, of its first and last state, the period and a parameter.

    - anchor: A state and the vector field there: the orbit starts in the plane normal to the field.
    - units: Of all unknowns: states at the ends of windows, period, alpha, parameter.
    """

    def __init__(self, problem: Problem, arc: Arc, anchor: tuple[np.ndarray, np.ndarray]) -> None:
        self._arc, self._windows = arc, WindowMaps(problem, arc)
        dim, self.scale = problem.H.dim, arc.scale
        self._dim = dim
        self._rows: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        closing = problem.closing
        if closing.first is not None and closing.last is not None:
            self._reflect(closing.first, 0)
            self._reflect(closing.last, -1)
        else:
            self._close(closing)
            if problem.autonomous:
                normal = anchor[1] / self.scale**2
                self._add(normal, float(normal @ (arc.ends[0] - anchor[0])))
        if problem.period is not None and problem.autonomous:
            row = np.zeros((1, 2 * dim + 3))
            row[0, 2 * dim] = 1 / arc.period
            self._rows.append(row)
            self._right.append(np.array([problem.period / arc.period - 1]))
        if problem.energy is not None:
            system = problem.H.compile("numpy")
            excess = float(system.energy(arc.ends[0])) - problem.energy
            by_parameter = 0.0
            if problem.parameter is not None:
                by_parameter = _energy_slope(problem.H, problem.parameter, arc.ends[0])
            self._add(np.asarray(system.gradient(arc.ends[0])), excess, by_parameter)
        self._unknown = np.ones(2 * dim + 3, dtype=bool)
        self._unknown[-3] = problem.autonomous
        self._unknown[-2] = problem.conservative and not closing.reversing
        self._unknown[-1] = problem.parameter is not None
        self._condense()

    # -- equations ----------------------------------------------------------------------------

    def _condense(self) -> None:
        """Eliminate the states between the first and the last one."""
        arc, dim, scale = self._arc, self._dim, self.scale
        rows, right = np.vstack(self._rows), np.concatenate(self._right)
        windows = self._windows.ends / scale[:, None]
        free = windows[..., dim : dim + 3]
        largest = np.vstack([free.reshape(-1, 3), rows[:, -3:]])
        units = np.concatenate([[arc.period], _largest(largest[:, 1:])])
        self.units = np.concatenate([np.tile(scale, len(arc.ends)), units])
        self._condensed = CondensedWindows(
            windows[..., :dim] * scale, free * units, -windows[..., dim + 3]
        )
        rows = rows * np.concatenate([scale, scale, units])
        self._matrix = np.vstack([self._condensed.matrix, rows])[:, self._unknown]
        self._small_right = np.concatenate([self._condensed.right, right])
        self._residual = float(
            max(
                np.abs(right).max(),
                np.abs(windows[..., dim + 3]).max(),
                (np.abs(self._windows.residual) / scale).max(),
            )
        )

    def _close(self, closing: Closing) -> None:
        arc, dim = self._arc, self._dim
        row = np.zeros((dim, 2 * dim + 3))
        row[:, :dim] = -closing.shift.matrix
        row[:, dim : 2 * dim] = np.eye(dim)
        self._rows.append(row / self.scale[:, None])
        self._right.append((closing.shift(arc.ends[0]) - arc.ends[-1]) / self.scale)

    def _reflect(self, symmetry: SignedPermutation, place: int) -> None:
        """Add the conditions of a reversing symmetry at the first or the last (-1) state."""
        conditions, dim = symmetry.conditions, self._dim
        row = np.zeros((len(conditions), 2 * dim + 3))
        row[:, dim : 2 * dim] = conditions
        if place == 0:
            row = np.roll(row, -dim, axis=1)
        weights = np.abs(conditions) @ self.scale
        self._rows.append(row / weights[:, None])
        self._right.append(-(conditions @ self._arc.ends[place]) / weights)

    def _add(self, slope: np.ndarray, excess: float, by_parameter: float = 0.0) -> None:
        """Add the equation of the first state: slope . correction + by_parameter ... = -excess."""
        row = np.zeros((1, 2 * self._dim + 3))
        row[0, : len(slope)], row[0, -1] = slope, by_parameter
        weight = float(np.abs(slope) @ self.scale) or 1.0
        self._rows.append(row / weight)
        self._right.append(np.array([-excess / weight]))

    # -- solutions ----------------------------------------------------------------------------

    def solved(self, across: np.ndarray | None = None) -> Step:
        """Solve for the corrections.

        - across: A direction of all scaled unknowns, to which the correction is orthogonal: the one
          more equation of a family.
        """
        solution, singular = solved(self._matrix, self._small_right)
        whole = self._whole(solution)
        if across is not None and np.isfinite(whole).all():
            along = self._null_vector()
            whole = whole - (across @ whole) / (across @ along) * along
        return self._step(whole, singular)

    def direction(self, before: np.ndarray | None) -> np.ndarray:
        """Return the unit vector along the family, in the sense of a direction before.

        States count as their root mean square, so that windows do not matter.
        """
        found = self._null_vector()
        count = self._arc.ends.size
        found[count + 1] = 0.0
        weights = np.ones(len(found))
        weights[:count] = self._dim / count
        found *= weights
        found /= np.sqrt(np.sum(found**2 / weights))
        if before is not None and found @ (before / weights) < 0:
            found = -found
        return found

    def _null_vector(self) -> np.ndarray:
        """Scaled unknowns that solve the equations without their right-hand sides."""
        return self._whole(scipy.linalg.svd(self._matrix)[2][-1], homogeneous=True)

    def _whole(self, solution: np.ndarray, *, homogeneous: bool = False) -> np.ndarray:
        """All scaled unknowns from those of the small system."""
        small = np.zeros(len(self._unknown))
        small[self._unknown] = solution
        if not np.isfinite(small).all():
            return np.full(len(self.units), math.nan)
        states = self._condensed.states(small, homogeneous=homogeneous)
        return np.concatenate([states.ravel(), small[-3:]])

    def _step(self, whole: np.ndarray, singular: bool) -> Step:
        windows, dim, count = self._windows, self._dim, self._arc.ends.size
        size = float(np.abs(np.delete(whole, count + 1)).max())
        whole = whole * self.units
        ends = whole[:count].reshape(-1, dim)
        inside = windows.inside
        values = np.einsum("kjac,kc->kja", inside[..., :dim], ends[:-1])
        values += inside[..., dim : dim + 3] @ whole[count:] + inside[..., dim + 3]
        return Step(
            ends,
            values,
            float(whole[count]),
            float(whole[count + 2]),
            self._residual,
            max(size, float((np.abs(values) / self.scale).max())),
            singular,
            windows.ends[..., :dim],
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
