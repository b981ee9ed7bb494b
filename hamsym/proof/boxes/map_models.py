"""Taylor models of a flow map z^ on cells of its box and steps of its time.

A leg of a map is z^ = z_a + (t - t_a) sum_r W_r(y) phi_r(t), with Chebyshev polynomials in the
scaled inputs y = scaling @ inputs + shift and in the time (:mod:`hamsym.flow_maps.expansion`). Its
numbers are taken as the exact binary fractions that they are. On a cell, inputs = middle + half s
with |s_k| <= 1, and y_k = c_k + v_k with an exact number c_k and a model v_k.

1. *Inputs.* T_n(c_k + v_k) = sum_j b_nj v_k^j is exact with j <= n; b is computed in ball
   arithmetic. Products of the powers with |j| = j_1 + .. + j_d <= m_y give models of W_r; the
   others are at most the sum over nu of |readouts_nu,r| times the products of |b| |v|^j left out.
2. *Time.* With t - t_a = m + h tau in a step, (m + h tau) T_n(alpha + beta tau) and its derivative
   are polynomials in tau, computed in ball arithmetic, too.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np
from flint import arb, arb_poly

from hamsym.flow_maps.expansion import Leg, Piece
from hamsym.proof.arithmetic.balls import ball, working
from hamsym.proof.arithmetic.directed import UNIT, sum_down, sum_up
from hamsym.proof.arithmetic.taylor_models import (
    BITS,
    Model,
    Space,
    float_with_radius,
    multi_indices,
    space_of,
)

_TABLE_BITS = 400  # the tables of Chebyshev polynomials cancel
_ROUND_OFF = 2.0**-100  # above the radii of their balls

Cells = list[tuple[tuple[Fraction, Fraction], ...]]  # intervals of the inputs, for each cell


class Step:
    """A step of the time within a piece of a leg.

    - number: Of the piece.
    - middle, half: Elapsed time t - t_a = middle + half tau.
    """

    def __init__(self, number: int, low: Fraction, high: Fraction) -> None:
        self.number, self.low, self.high = number, low, high
        self.middle, self.half = (low + high) / 2, (high - low) / 2

    @property
    def halves(self) -> tuple[Step, Step]:
        return Step(self.number, self.low, self.middle), Step(self.number, self.middle, self.high)

    def clock(self, space: Space, begin: Fraction, cells: int) -> Model:
        """The time t."""
        return _line(space, [(begin + self.middle, self.half)] * cells, (1, *[0] * space.inputs))


def affine_models(space: Space, cells: Cells) -> list[Model]:
    """The inputs as models."""
    found = []
    for k in range(space.inputs):
        term = [0] * (1 + space.inputs)
        term[1 + k] = 1
        lines = [((cell[k][0] + cell[k][1]) / 2, (cell[k][1] - cell[k][0]) / 2) for cell in cells]
        found.append(_line(space, lines, tuple(term)))
    return found


def _line(space: Space, lines: Sequence[tuple[Fraction, Fraction]], term: tuple[int, ...]) -> Model:
    """middle + half x for each cell, with x the variable of a term."""
    values = np.array([[_rounded(middle), _rounded(half)] for middle, half in lines]).reshape(-1, 4)
    coefficients = np.zeros((space.count, len(lines)))
    coefficients[0] = values[:, 0]
    coefficients[space.places[term]] += values[:, 2]
    return Model(space, coefficients, sum_up(values[:, 1] + values[:, 3]))


def _rounded(value: Fraction) -> tuple[float, float]:
    with working(BITS):
        return float_with_radius(ball(value))


class LegModels:
    """Models of one leg on cells.

    - inputs: The inputs of the leg.
    """

    def __init__(self, leg: Leg, space: Space, inputs: list[Model]) -> None:
        self._leg, self._space, self._inputs = leg, space, inputs
        self._indices = multi_indices(space.inputs, space.degree)
        self._places = np.array([space.places[(0, *nu)] for nu in self._indices])
        self._targets = np.array(
            [
                [space.places.get((a, *nu), -1) for nu in self._indices]
                for a in range(1 + max(piece.columns.shape[1] for piece in leg.pieces))
            ]
        )
        self._readouts: tuple[int, np.ndarray, np.ndarray] | None = None

    @cached_property
    def _scaled(self) -> tuple[np.ndarray, list[Model]]:
        """The numbers c, shape (d, cells), and the models v."""
        centres, rest = [], []
        for row, shift in zip(self._leg.scaling, self._leg.shift, strict=True):
            y = combined(row, self._inputs).plus(float(shift))
            centre = y.coefficients[0].copy()
            y.coefficients[0] = 0
            centres.append(centre)
            rest.append(Model(self._space, y.coefficients, y.radius))
        return np.array(centres), rest

    @cached_property
    def _sizes(self) -> np.ndarray:
        """Bounds on |v_k|, shape (d, cells)."""
        return np.array([model.largest() for model in self._scaled[1]])

    @cached_property
    def _powers(self) -> tuple[np.ndarray, np.ndarray]:
        """Coefficients of the products of powers of v, (products, n, cells), and their radii."""
        space = space_of(self._space.inputs, 1, self._space.degree)  # v is without time
        places = [space.places[(0, *nu)] for nu in self._indices]
        factors = []
        for model in self._scaled[1]:
            coefficients = np.zeros((space.count, len(model.radius)))
            coefficients[places] = model.coefficients[self._places]
            factors.append(Model(space, coefficients, model.radius))
        found = {self._indices[0]: space.constant(np.ones(self._sizes.shape[1]))}
        for nu in self._indices[1:]:
            k = next(k for k, power in enumerate(nu) if power)
            lower = (*nu[:k], nu[k] - 1, *nu[k + 1 :])
            found[nu] = found[lower] * factors[k]
        models = [found[nu] for nu in self._indices]
        return (
            np.array([model.coefficients[places] for model in models]),
            np.array([model.radius for model in models]),
        )

    @cached_property
    def _tables(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """b of each variable, (d, degrees, m_y + 1, cells), its radii, and sum_j |b| |v|^j."""
        degrees = [piece.degrees for piece in self._leg.pieces]
        if len(self._leg.start):
            degrees.append(self._leg.start_degrees)
        most = max(int(array.max()) for array in degrees)
        centres, sizes = self._scaled[0], self._sizes
        found = [
            [_table(c, size, most, self._space.degree) for c, size in zip(*row, strict=True)]
            for row in zip(centres.tolist(), sizes.tolist(), strict=True)
        ]
        tables, radii, sums = (
            np.moveaxis(np.array([[cell[part] for cell in row] for row in found]), 1, -1)
            for part in range(3)
        )
        return tables, radii, sums

    def _expansions(
        self, degrees: np.ndarray, readouts: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """sum_nu readouts[nu, r] T_nu(y): coefficients (n, r, cells), and radii (r, cells)."""
        table, radii, sums = self._tables
        indices = np.array(self._indices)
        d, cells = self._sizes.shape
        powers, power_radii = self._powers
        powers_of_size = _lower_powers(self._sizes, self._space.degree)
        n, rank = readouts.shape
        found = np.empty((len(indices), rank, cells))
        rest = np.empty((rank, cells))
        weights = np.abs(readouts)
        for cell in range(cells):
            factors = np.ones((len(indices), n))
            errors, bounds = np.zeros_like(factors), np.ones_like(factors)
            wholes = np.ones(n)
            sizes = np.ones(len(indices))
            for k in range(d):
                values = table[k, :, :, cell][degrees[:, k]].T[indices[:, k]]
                spread = radii[k, :, :, cell][degrees[:, k]].T[indices[:, k]]
                errors = sum_up(errors * (np.abs(values) + spread) + bounds * spread)
                factors = factors * values
                bounds = sum_up(bounds * (np.abs(values) + spread))
                wholes = sum_up(wholes * sums[k, degrees[:, k], cell])
                sizes = sum_down(sizes * powers_of_size[k, indices[:, k], cell])
            errors = sum_up(errors + 2 * d * UNIT * bounds)
            # What is kept is rounded down, which makes the part that is left out larger.
            shares = sum_down(np.maximum(np.abs(factors) - errors, 0) * sizes[:, None])
            kept = sum_down(shares.sum(axis=0), len(indices))
            left_out = sum_up(np.maximum(wholes - kept, 0), n)
            q = factors @ readouts
            q_errors = sum_up(
                errors @ weights + 2 * (n + 4) * UNIT * (np.abs(factors) @ weights), 2 * n
            )
            found[:, :, cell] = powers[:, :, cell].T @ q
            q_sizes = np.abs(q)
            lengths = sum_up(np.abs(powers[:, :, cell]).sum(axis=1), len(indices))
            rest[:, cell] = sum_up(
                left_out @ weights
                + (lengths + power_radii[:, cell]) @ q_errors
                + power_radii[:, cell] @ q_sizes
                + 2 * (len(indices) + 4) * UNIT * (lengths @ q_sizes),
                2 * max(n, len(indices)),
            )
        return found, rest

    def start(self) -> list[Model]:
        """z_a."""
        leg, found = self._leg, []
        for row, offset in zip(leg.selection, leg.offset, strict=True):
            found.append(combined(row, self._inputs).plus(float(offset)))
        if not len(leg.start):
            return found
        values, radii = self._expansions(leg.start_degrees, leg.start)
        for i, model in enumerate(found):
            coefficients = np.zeros_like(model.coefficients)
            coefficients[self._places] = values[:, i]
            found[i] = model + Model(self._space, coefficients, radii[i])
        return found

    def states(self, step: Step, start: list[Model]) -> tuple[list[Model], list[Model]]:
        """z^ and dz^/dtau on a step."""
        piece = self._leg.pieces[step.number]
        if self._readouts is None or self._readouts[0] != step.number:
            self._readouts = step.number, *self._expansions(piece.degrees, piece.readouts)
        value, rate = self._tables_in_time(step, piece)
        found = [self._contracted(*value, i) for i in range(len(start))]
        rates = [self._contracted(*rate, i) for i in range(len(start))]
        return [a + b for a, b in zip(start, found, strict=True)], rates

    def _tables_in_time(self, step: Step, piece: Piece) -> list[tuple[np.ndarray, np.ndarray]]:
        """Coefficients in tau of (t - t_a) phi_r and of the derivative, (r, a, i), and radii."""
        edges = self._leg.edges
        low, high = (Fraction(float(edge)) for edge in edges[step.number : step.number + 2])
        terms = piece.columns.shape[1]
        tables = _table_in_time(terms, low, high, step.middle, step.half)
        found = []
        weights = np.abs(piece.columns)
        for table in tables:
            value = np.einsum("rni,na->rai", piece.columns, table[:, :, 0])
            spread = np.abs(table[:, :, 0]) * (2 * (terms + 4) * UNIT) + table[:, :, 1]
            found.append((value, sum_up(np.einsum("rni,na->rai", weights, spread), 2 * terms)))
        return found

    def _contracted(self, psi: np.ndarray, spread: np.ndarray, i: int) -> Model:
        """sum_r W_r psi_r for component i."""
        assert self._readouts is not None
        _, values, radii = self._readouts
        rank, most = psi.shape[:2]
        full = np.einsum("ra,nrc->anc", psi[:, :, i], values, optimize=True)
        sizes = sum_up(np.abs(values).sum(axis=0), len(values))
        amounts = sum_up(np.abs(psi[:, :, i]).sum(axis=1), most)
        spreads = sum_up(spread[:, :, i].sum(axis=1), most)
        coefficients = np.zeros((self._space.count, values.shape[2]))
        targets = self._targets[:most]
        inside = targets >= 0
        coefficients[targets[inside]] = full[inside]
        left_out = np.abs(full[~inside]).sum(axis=0)
        rest = (
            left_out
            + (amounts + spreads) @ radii
            + (spreads + 2 * (rank + 4) * UNIT * amounts) @ sizes
        )
        return Model(self._space, coefficients, sum_up(rest, rank + full[:, :, 0].size))


@functools.lru_cache(maxsize=4_096)
def _table(
    centre: float, size: float, most: int, degree: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """b, (degrees, m_y + 1), its radii, and bounds on sum_j |b| |v|^j, for |v| up to a size."""
    shape = most + 1, degree + 1
    found, radii, sums = np.zeros(shape), np.zeros(shape), np.zeros(most + 1)
    with working(_TABLE_BITS):
        width = arb(size)
        for n, polynomial in enumerate(_chebyshev(arb_poly([arb(centre), 1]), most)):
            entries = polynomial.coeffs()
            value, radius = float_with_radius(arb_poly([abs(entry) for entry in entries])(width))
            sums[n] = sum_up(value + radius)
            for j, entry in enumerate(entries[: degree + 1]):
                found[n, j] = value = float(entry.mid())
                known = entry.rad() < _ROUND_OFF
                radii[n, j] = 2 * UNIT * abs(value) + 2 * _ROUND_OFF if known else np.inf
    return found, radii, sums


@functools.lru_cache(maxsize=1_024)
def _table_in_time(
    terms: int, low: Fraction, high: Fraction, middle: Fraction, half: Fraction
) -> np.ndarray:
    """Coefficients in tau of (t - t_a) T_n(time) and of its derivative, and their radii."""
    tables = np.zeros((2, terms, terms + 1, 2))
    with working(_TABLE_BITS):
        line = arb_poly(
            [ball((2 * middle - low - high) / (high - low)), ball(2 * half / (high - low))]
        )
        time = arb_poly([ball(middle), ball(half)])
        for n, polynomial in enumerate(_chebyshev(line, terms - 1)):
            product = polynomial * time
            for place, entries in enumerate((product, product.derivative())):
                for a, entry in enumerate(entries.coeffs()):
                    tables[place, n, a] = float_with_radius(entry)
    return tables


def _lower_powers(sizes: np.ndarray, degree: int) -> np.ndarray:
    """Lower bounds on the powers of numbers >= 0, by products: shape (d, degree + 1, cells)."""
    found = [np.ones_like(sizes)]
    for _ in range(degree):
        found.append(sum_down(found[-1] * sizes))
    return np.stack(found, axis=1)


def combined(row: np.ndarray, models: list[Model]) -> Model:
    """row @ models."""
    found = models[0].times(float(row[0]))
    for factor, model in zip(row[1:], models[1:], strict=True):
        if factor:
            found = found + model.times(float(factor))
    return found


def _chebyshev(line: arb_poly, most: int) -> Any:
    """T_0 .. T_most of a polynomial."""
    before, last = arb_poly([1]), line
    yield before
    if most:
        yield last
    for _ in range(most - 1):
        before, last = last, 2 * line * last - before
        yield last
