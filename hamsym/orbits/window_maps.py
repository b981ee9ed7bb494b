"""The equations of collocation in the windows of an arc, solved for the points of each window.

Residuals are evaluated with 106 bits: their round-off is what limits the accuracy of an orbit,
because close encounters multiply it by many thousands. Newton's matrix is needed in float64 only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation, precise_integration
from hamsym.numerics.linear_systems import solved
from hamsym.numerics.pairs import Pair, fraction, product
from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.integrals import gradients_from
from hamsym.orbits.precise_rates import in_extended_precision, precise_rates
from hamsym.parallel.threads import Threads
from hamsym.random_features.flow import flow_of
from hamsym.solution.parameters import ParameterForcing

_BLOCK = 1 << 22  # entries of the matrices of windows that are solved at once


class WindowMaps:
    """Corrections in windows by those at their start, of n numbers, plus constants.

    The numbers are the period, a parameter, and alpha of each integral.

    - inside, ends: At the points, shape (k, nodes, dim, dim + n + 1), and at the ends, shape (k,
      dim, dim + n + 1).
    - residual: Of the collocation equations, shape (k, nodes, dim).
    """

    def __init__(self, problem: Problem, arc: Arc, integrals: Sequence[Hamiltonian]) -> None:
        windows, nodes, dim = arc.values.shape
        self._precise = arc.precise
        self._integrals, columns = integrals, dim + 3 + len(integrals)
        self.inside = np.empty((windows, nodes, dim, columns))
        self.ends = np.empty((windows, dim, columns))
        self.residual = np.empty((windows, nodes, dim))
        self._problem, self._arc, self.scale = problem, arc, problem.scale_of(arc)
        count = max(1, _BLOCK // (nodes * dim) ** 2)
        blocks = [slice(first, first + count) for first in range(0, windows, count)]
        with Threads(len(blocks)) as threads:
            for _ in threads.results(self._solve, blocks):
                pass

    def _solve(self, block: slice) -> None:
        """Solve the equations in some of the windows."""
        problem, arc, scale = self._problem, self._arc, self.scale
        flow, values, edges = flow_of(problem.H), arc.values[block], arc.edges
        windows, nodes, dim = values.shape
        rule = collocation(nodes)
        widths = np.diff(edges)[block]
        share = widths[:, None, None] / problem.closing.parts  # of the period
        lengths = share * arc.period
        points = edges[:-1][block][:, None] + widths[:, None] * rule.nodes
        times = (problem.start + points / problem.closing.parts * arc.period).ravel()
        states = values.reshape(-1, dim)
        rates = flow.vector_field(states, times).reshape(windows, nodes, dim)
        pairs = self._precise.values[block]
        pairs = Pair(*(part.reshape(-1, dim) for part in (pairs.high, pairs.low)))
        # Small distances have few digits in float64.
        jacobians = in_extended_precision(flow.jacobian, pairs, times).astype(float)
        jacobians = jacobians.reshape(windows, nodes, dim, dim) * lengths[..., None]
        forcing = np.zeros((windows, nodes, dim, self.ends.shape[-1] - dim))
        forcing[..., 0] = rates * share
        if problem.parameter is not None:
            found = ParameterForcing(problem.H, (problem.parameter,))(states, times)
            forcing[..., 1] = found.reshape(windows, nodes, dim) * lengths
        for k, integral in enumerate(self._integrals):
            field = rates
            if integral != problem.H:
                field = flow_of(integral).vector_field(states, times).reshape(rates.shape)
            forcing[..., 2 + k] = gradients_from(field) * scale**2 * lengths
        inside, last = rule.integration[:-1], rule.integration[-1]
        residual, gaps = self._residuals(block, pairs, times)
        columns = np.zeros((windows, nodes, dim, self.ends.shape[-1]))
        columns[..., :dim] = np.eye(dim)
        columns[..., dim:] = _times(inside, forcing)
        columns[..., -1] = residual
        # In units of the components: pivots of coordinates and momenta are comparable in no others.
        scaled = jacobians * scale / scale[:, None]
        solution = _solved(inside, scaled, columns / scale[:, None]) * scale[:, None]
        driven = jacobians @ solution
        driven[..., dim:] += forcing
        ends = _times(last[None], driven)[:, 0]
        ends[..., :dim] += np.eye(dim)
        ends[..., -1] += gaps
        self.inside[block], self.ends[block], self.residual[block] = solution, ends, residual

    def _residuals(
        self, block: slice, states: Pair, times: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Residuals at the points and at the ends of some of the windows."""
        precise, edges = self._precise, self._arc.edges
        values, shape = precise.values[block], self._arc.values[block].shape
        rates = precise_rates(self._problem.H, states, times)
        moved = Pair(rates.high.reshape(shape), rates.low.reshape(shape))
        widths = Pair(edges[1:][block]) - edges[:-1][block]
        lengths = widths * precise.period * fraction(1, self._problem.closing.parts)
        moved = moved * lengths[:, None, None]
        integrals = product(precise_integration(shape[1]), moved)
        starts, stops = precise.ends[:-1][block], precise.ends[1:][block]
        residual = integrals[:, :-1] + starts[:, None] - values
        return residual.high, (integrals[:, -1] + starts - stops).high


def _times(matrix: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Multiply values at the points of windows, shape (k, nodes, ...), by a matrix."""
    windows, nodes, *rest = columns.shape
    return (matrix @ columns.reshape(windows, nodes, -1)).reshape(windows, len(matrix), *rest)


def _solved(inside: np.ndarray, jacobians: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Solve X = columns + S J X at the points of each window, S the integration matrix."""
    half = jacobians.shape[-1] // 2
    drift, force = jacobians[..., :half, half:], jacobians[..., half:, :half]
    others = jacobians[..., :half, :half], jacobians[..., half:, half:]
    if any(block.any() for block in others) or (drift != drift[:, :1]).any():
        return _each_solved(inside, jacobians, columns)
    # Coordinates alone, of an equation of half the size: H is quadratic in the momenta.
    moved = columns[..., :half, :] + _times(inside, drift @ columns[..., half:, :])
    coordinates = _each_solved(inside @ inside, drift @ force, moved)
    momenta = _times(inside, force @ coordinates) + columns[..., half:, :]
    return np.concatenate((coordinates, momenta), axis=2)


def _each_solved(inside: np.ndarray, jacobians: np.ndarray, columns: np.ndarray) -> np.ndarray:
    windows, nodes, dim, _ = columns.shape
    size = nodes * dim
    rows = jacobians.swapaxes(1, 2).reshape(windows, 1, dim, size)  # a, then j and b
    matrices = -np.repeat(inside, dim, axis=1)[:, None] * rows
    matrices = matrices.reshape(windows, size, size)
    matrices[:, np.arange(size), np.arange(size)] += 1
    found = solved(matrices, columns.reshape(windows, size, -1))
    return found.reshape(columns.shape)
