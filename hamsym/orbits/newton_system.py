"""Newton's linear system of a periodic orbit at an arc.

The unknowns are the states at the ends of the windows, the period and, for families, a parameter.
The states between the ends of the arc are eliminated (:mod:`hamsym.orbits.condensed`), so that the
effort is proportional to the number of windows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
import sympy

from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.condensed import CondensedWindows, solved
from hamsym.orbits.integrals import Slice
from hamsym.orbits.precise_rates import precise_energy
from hamsym.orbits.symmetry import Closing, SignedPermutation
from hamsym.orbits.window_maps import WindowMaps

_NO_EFFECT = 1e7  # relative change of a parameter that changes an orbit by its size


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
    #: Reciprocal condition number of the system.
    condition: float
    #: Derivatives of the windows' flows, shape (k, dim, dim).
    maps: np.ndarray

    def applied(self, arc: Arc, share: float = 1.0) -> Arc:
        """Apply a share of the correction to the arc."""
        return arc.moved(share * self.ends, share * self.values, share * self.period)


class NewtonSystem:
    """Newton's linear system at an arc, of its first and last state, the period and a parameter.

    Along a solution of the equations dz/dt = J grad H + sum alpha_I grad I, which close, all alpha
    vanish, because those of the integrals dI/dt = 0; they make the system square.

    - slice: Planes in which the orbit starts, and the integrals.
    - units: Of the unknowns of a family: states at the ends of windows, period, parameter.
    """

    def __init__(self, problem: Problem, arc: Arc, slice: Slice) -> None:
        self._arc, self._windows = arc, WindowMaps(problem, arc, slice.integrals)
        dim, self.scale = problem.H.dim, self._windows.scale
        self._dim, self._numbers = dim, 2 + len(slice.integrals)
        self._rows: list[np.ndarray] = []
        self._right: list[np.ndarray] = []
        self._parameter = problem.parameter_size
        if problem.parameter is not None:
            self._parameter = max(self._parameter, abs(problem.H.parameters[problem.parameter]))
        closing = problem.closing
        if closing.first is not None and closing.last is not None:
            self._reflect(closing.first, 0)
            self._reflect(closing.last, -1)
        else:
            self._close(closing)
        low = arc.precise.ends.low[0]
        for normal in slice.normals:
            self._add(normal, float(normal @ (arc.ends[0] - slice.state + low)))
        if problem.period is not None and problem.autonomous:
            row = np.zeros((1, 2 * dim + self._numbers))
            row[0, 2 * dim] = 1 / arc.period
            self._rows.append(row)
            self._right.append(np.array([problem.period / arc.period - 1]))
        if problem.energy is not None:
            system = problem.H.compile("numpy")
            excess = precise_energy(problem.H, arc.precise.ends[0]) - problem.energy
            by_parameter = 0.0
            if problem.parameter is not None:
                real = problem.H.real_equations
                slope = sympy.diff(real.expr, real.parameters[problem.parameter][0])
                by_parameter = float(problem.H.observable(slope)(arc.ends[0]))
            slope = np.asarray(system.gradient(arc.ends[0]))
            self._add(slope, float(excess.high), by_parameter)
        self._unknown = np.ones(2 * dim + self._numbers, dtype=bool)
        self._unknown[2 * dim] = problem.autonomous
        self._unknown[2 * dim + 1] = problem.parameter is not None
        self._condense()

    # -- equations ----------------------------------------------------------------------------

    def _condense(self) -> None:
        """Eliminate the states between the first and the last one."""
        arc, dim, scale = self._arc, self._dim, self.scale
        rows, right = np.vstack(self._rows), np.concatenate(self._right)
        windows = self._windows.ends / scale[:, None]
        free = windows[..., dim:-1]
        largest = np.vstack([free.reshape(-1, self._numbers), rows[:, 2 * dim :]])
        units = np.concatenate([[arc.period], _largest(largest[:, 1:])])
        # what is left of its effect is round-off
        if units[1] > _NO_EFFECT * self._parameter or not largest[:, 1].any():
            units[1] = self._parameter
        self._number_units = units
        self.units = np.concatenate([np.tile(scale, len(arc.ends)), units[:2]])
        self._condensed = CondensedWindows(
            windows[..., :dim] * scale, free * units, -windows[..., -1]
        )
        rows = rows * np.concatenate([scale, scale, units])
        self._matrix = np.vstack([self._condensed.matrix, rows])[:, self._unknown]
        self._small_right = np.concatenate([self._condensed.right, right])
        self._residual = float(
            max(
                np.abs(right).max(),
                np.abs(windows[..., -1]).max(),
                (np.abs(self._windows.residual) / scale).max(),
            )
        )

    def _close(self, closing: Closing) -> None:
        ends, dim = self._arc.precise.ends, self._dim
        # Differences of nearly equal numbers are exact.
        gaps = sum(closing.shift(part[0]) - part[-1] for part in (ends.high, ends.low))
        row = np.zeros((dim, 2 * dim + self._numbers))
        row[:, :dim] = -closing.shift.matrix
        row[:, dim : 2 * dim] = np.eye(dim)
        self._rows.append(row / self.scale[:, None])
        self._right.append(gaps / self.scale)

    def _reflect(self, symmetry: SignedPermutation, place: int) -> None:
        """Add the conditions of a reversing symmetry at the first or the last (-1) state."""
        conditions, dim = symmetry.conditions, self._dim
        row = np.zeros((len(conditions), 2 * dim + self._numbers))
        row[:, dim : 2 * dim] = conditions
        if place == 0:
            row = np.roll(row, -dim, axis=1)
        weights = np.abs(conditions) @ self.scale
        self._rows.append(row / weights[:, None])
        ends = self._arc.precise.ends
        gaps = sum(conditions @ part[place] for part in (ends.high, ends.low))
        self._right.append(-gaps / weights)

    def _add(self, slope: np.ndarray, excess: float, by_parameter: float = 0.0) -> None:
        """Add the equation of the first state: slope . correction + by_parameter ... = -excess."""
        row = np.zeros((1, 2 * self._dim + self._numbers))
        row[0, : len(slope)], row[0, 2 * self._dim + 1] = slope, by_parameter
        weight = float(np.abs(slope) @ self.scale) or 1.0
        self._rows.append(row / weight)
        self._right.append(np.array([-excess / weight]))

    # -- solutions ----------------------------------------------------------------------------

    def solved(self, across: np.ndarray | None = None) -> Step:
        """Solve for the corrections.

        - across: A direction of all scaled unknowns, to which the correction is orthogonal: the one
          more equation of a family.
        """
        solution, condition = solved(self._matrix, self._small_right)
        whole = self._whole(solution)
        if across is not None and np.isfinite(whole).all():
            along, count = self._null_vector(), len(across)
            whole = whole - (across @ whole[:count]) / (across @ along[:count]) * along
        return self._step(whole, condition)

    def direction(self, before: np.ndarray | None) -> np.ndarray:
        """Return the unit vector along the family, in the sense of a direction before.

        States count as their root mean square, so that windows do not matter.
        """
        found = self._null_vector()[: len(self.units)]
        count = self._arc.ends.size
        weights = np.ones(len(found))
        weights[:count] = self._dim / count
        found *= weights
        found /= np.sqrt(np.sum(found**2 / weights))
        if before is not None and found @ (before / weights) < 0:
            found = -found
        return found

    def inside(self, change: np.ndarray) -> np.ndarray:
        """Return the changes at the points of windows that follow, shape (k, nodes, dim).

        - change: Of the states at the ends of windows, the period and the parameter, shape (n,).
        """
        dim, maps = self._dim, self._windows.inside
        starts = change[:-2].reshape(-1, dim)[:-1]
        moved = np.einsum("kjac,kc->kja", maps[..., :dim], starts)
        return np.asarray(moved + maps[..., dim : dim + 2] @ change[-2:])

    def null_vectors(self, gap: float) -> np.ndarray | None:
        """Return two scaled solutions of the equations without right-hand sides, shape (2, n).

        None if the equations of a family have one solution only.

        - gap: Smallest ratio of singular values at which the second one counts as no zero.
        """
        if not np.isfinite(self._matrix).all():
            return None
        _, sizes, right = scipy.linalg.svd(self._matrix)
        if not sizes[-1] <= gap * sizes[-2]:
            return None
        whole = [self._whole(row, homogeneous=True)[: len(self.units)] for row in right[-2:]]
        return np.array(whole)

    def _null_vector(self) -> np.ndarray:
        """Scaled unknowns that solve the equations without their right-hand sides."""
        return self._whole(scipy.linalg.svd(self._matrix)[2][-1], homogeneous=True)

    def _whole(self, solution: np.ndarray, *, homogeneous: bool = False) -> np.ndarray:
        """All scaled unknowns from those of the small system."""
        small = np.zeros(len(self._unknown))
        small[self._unknown] = solution
        if not np.isfinite(small).all():
            return np.full(self._arc.ends.size + self._numbers, math.nan)
        states = self._condensed.states(small, homogeneous=homogeneous)
        return np.concatenate([states.ravel(), small[2 * self._dim :]])

    def _step(self, whole: np.ndarray, condition: float) -> Step:
        windows, dim, count = self._windows, self._dim, self._arc.ends.size
        size = float(np.abs(whole[: len(self.units)]).max())
        numbers = whole[count:] * self._number_units
        whole = whole[:count] * self.units[:count]
        ends = whole.reshape(-1, dim)
        free = np.tile(np.append(numbers, 1.0), (len(ends) - 1, 1))
        columns = np.concatenate([ends[:-1], free], axis=1)
        values = (windows.inside @ columns[:, None, :, None])[..., 0]
        return Step(
            ends,
            values,
            float(numbers[0]),
            float(numbers[1]),
            self._residual,
            max(size, float((np.abs(values) / self.scale).max())),
            condition,
            windows.ends[..., :dim],
        )


def _largest(rows: np.ndarray) -> np.ndarray:
    """Return units in which columns have entries up to one."""
    found = np.abs(rows).max(axis=0)
    return np.where(found > 0, 1 / np.where(found > 0, found, 1.0), 1.0)
