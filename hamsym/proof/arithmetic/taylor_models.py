"""Taylor models: polynomials of a time and of inputs with float64 coefficients and a radius.

A model of a function f on the cube |tau| <= 1, |s_k| <= 1 is a polynomial P and a number R with

    |f(tau, s) - P(tau, s)| <= R   everywhere on the cube.

All operations work on many cubes, the cells, at once: the coefficients of P have the shape
(terms, cells), the radii the shape (cells,).

*Terms.* tau^a s^nu with (a/m_t)^2 + (|nu|/m_y)^2 <= 1. What a product has beyond them goes to the
radius: it is at most the sum of |A_i B_j| over the pairs of terms that are left out.

*Rounding* and *functions*: lemma 26 of examples/guide/how_proofs_work.md.

References: Makino & Berz 2003 (Taylor models); Revol, Makino & Berz 2005 (their rounding).
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb, arb_series
from scipy.sparse import coo_array, csr_array

from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.balls import above, working
from hamsym.proof.arithmetic.directed import TINY, UNIT, sum_up
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError, general_power

BITS = 160  # of constants, tables and elementary functions
_ORDERS = 26  # of the series of an elementary function
_NEGLIGIBLE = 2.0**-58

_Term = tuple[int, ...]


def float_with_radius(number: arb) -> tuple[float, float]:
    """A float64 near a ball, and a bound on its distance from every number in the ball."""
    value = float(number.mid()) if number.is_finite() else math.nan
    if not math.isfinite(value):
        return math.nan, math.inf
    return value, above(abs(number - arb(value)))


def _known(number: arb | int) -> tuple[float, float]:
    return float_with_radius(number if isinstance(number, arb) else arb(number))


@functools.lru_cache(maxsize=32)
def space_of(inputs: int, time_degree: int, degree: int) -> Space:
    """The terms of Taylor models, whose tables are made once."""
    return Space(inputs, time_degree, degree)


class Space:
    """The terms of Taylor models.

    - inputs: Number d of the variables s.
    - time_degree, degree: m_t and m_y.
    - exponents: Of tau and s in each term, shape (n, 1 + d); the constant term is the first.
    """

    def __init__(self, inputs: int, time_degree: int, degree: int) -> None:
        self.inputs, self.time_degree, self.degree = inputs, time_degree, degree
        own = [
            (a, *nu)
            for nu in multi_indices(inputs, degree)
            for a in range(time_degree + 1)
            if math.hypot(a / time_degree, sum(nu) / degree) <= 1
        ]
        own.sort(key=lambda term: (sum(term[1:]), term[0]))
        self.exponents = np.array(own)
        self.places = {term: place for place, term in enumerate(own)}
        self.count = len(own)
        # Whether a product of two terms is left out depends on their degrees (a, |nu|) alone.
        degrees = np.stack([self.exponents[:, 0], self.exponents[:, 1:].sum(axis=1)], axis=1)
        kinds, self._starts = np.unique(degrees[:, ::-1], axis=0, return_index=True)
        kinds = kinds[:, ::-1]
        sums = kinds[:, None] + kinds[None]
        inside = np.hypot(sums[..., 0] / time_degree, sums[..., 1] / degree) <= 1
        self._left_out = 1.0 - inside
        kind = np.repeat(np.arange(len(kinds)), np.diff([*self._starts, self.count]))
        pairs = []
        for i, term in enumerate(own):
            seconds = np.flatnonzero(inside[kind[i]][kind])
            sums = (self.exponents[seconds] + term).tolist()
            targets = np.array([self.places[tuple(row)] for row in sums])
            pairs.append((np.full(len(seconds), i), seconds, targets))
        self._pairs = [np.concatenate(part) for part in zip(*pairs, strict=True)]
        counts = np.bincount(self._pairs[2])
        self.most = int(counts.max())
        self._halves: dict[tuple[int, int], csr_array] = {}
        self._lower: dict[Space, tuple[csr_array, np.ndarray, csr_array]] = {}
        self._without_time = np.array([self.places[(0, *nu)] for _, *nu in own])
        # Of the integral from tau = -1, and the shares that it leaves out.
        self._integral = self._matrix(self._integrated)
        beyond = [0.0 if (a + 1, *nu) in self.places else 1 / (a + 1) for a, *nu in own]
        self._beyond = np.array(beyond)
        # Of the values at tau = -1 and 1, and of the derivative in tau.
        self._ends = {
            end: self._matrix(lambda a, *nu, end=end: [((0, *nu), end**a)]) for end in (-1, 1)
        }
        self._rate = self._matrix(lambda a, *nu: [((a - 1, *nu), a)] if a else [])
        self.series = self._matrix(_in_chebyshev)

    def _matrix(self, rule: Callable[..., Iterable[tuple[_Term, float]]]) -> csr_array:
        """The matrix of a linear map, by the terms and factors that it makes of each term."""
        entries = [
            (factor, self.places[target], i)
            for i, term in enumerate(self.exponents.tolist())
            for target, factor in rule(*term)
        ]
        factors, rows, columns = zip(*entries, strict=True)
        matrix = coo_array((factors, (rows, columns)), shape=(self.count, self.count))
        return csr_array(matrix)

    def _integrated(self, a: int, *nu: int) -> Iterator[tuple[_Term, float]]:
        if (a + 1, *nu) in self.places:
            yield (a + 1, *nu), 1 / (a + 1)
        yield (0, *nu), (-1) ** a / (a + 1)

    # -- models ------------------------------------------------------------------------------------

    def constant(self, values: np.ndarray, radius: np.ndarray | float = 0.0) -> Model:
        """A number for each cell."""
        coefficients = np.zeros((self.count, len(values)))
        coefficients[0] = values
        return Model(self, coefficients, np.zeros(len(values)) + radius)

    def product(self, first: Model, second: Model) -> Model:
        a, b = first.coefficients, second.coefficients
        found = np.zeros(a.shape)
        enclosures().add_products(found, a, b, *self._pairs)
        size, other = np.abs(a), np.abs(b)
        tail = (self._by_degrees(size) * (self._left_out @ self._by_degrees(other))).sum(axis=0)
        rounding = 2 * (self.most + 4) * UNIT * first.amount() * second.amount()
        rest = (
            first.radius * (second.size() + second.radius)
            + first.size() * second.radius
            + tail
            + rounding
        )
        return Model(self, found, sum_up(rest, 2 * self.count))

    def _by_degrees(self, sizes: np.ndarray) -> np.ndarray:
        """Sums over the terms of equal degrees."""
        return np.asarray(np.add.reduceat(sizes, self._starts, axis=0))

    def integral(self, model: Model) -> Model:
        """The integral over tau from -1."""
        size = np.abs(model.coefficients)
        rest = 2 * model.radius + self._beyond @ size
        rest = rest + 2 * 2 * (self.count + 4) * UNIT * size.sum(axis=0)
        found = self._integral @ model.coefficients
        return Model(self, found, sum_up(rest, 2 * self.count))

    def rate(self, model: Model) -> Model:
        """The derivative in tau of a polynomial, whose radius must be 0."""
        if model.radius.any():
            raise ValueError("a Taylor model with a radius has no derivative")
        found = self._rate @ model.coefficients
        return Model(self, found, sum_up(2 * UNIT * np.abs(found).sum(axis=0), self.count))

    def parts_of(self, model: Model, parts: Parts) -> Model:
        """A model without time on parts of its cells."""
        found = model.coefficients[:, parts.parents]
        rest = model.radius[parts.parents]
        rounding = 2 * (self.degree + 4) * UNIT * model.amount()
        rest = rest + rounding[parts.parents] * parts.halved
        for k in range(self.inputs):
            for side in (-1, 1):
                chosen = parts.halved & (parts.axes == k) & (parts.sides == side)
                if chosen.any():
                    found[:, chosen] = self._half(k, side) @ found[:, chosen]
        return Model(self, found, np.asarray(sum_up(rest)))

    def _half(self, k: int, side: int) -> csr_array:
        """The matrix of the substitution of (side + s_k)/2 for s_k; its entries are exact."""

        def halved(*term: int) -> Iterator[tuple[_Term, float]]:
            power = term[1 + k]
            for j in range(power + 1):
                share = math.comb(power, j) * 0.5**power * side ** (power - j)
                yield (*term[: 1 + k], j, *term[2 + k :]), share

        if (k, side) not in self._halves:
            self._halves[k, side] = self._matrix(halved)
        return self._halves[k, side]

    def lowered(self, model: Model, lower: Space) -> Model:
        """A model in a space of lower degrees, without the Chebyshev polynomials beyond them."""
        if lower is self:
            return model
        if lower not in self._lower:
            self._lower[lower] = self._lowering(lower)
        matrix, growth, beyond = self._lower[lower]
        rest = np.abs(beyond @ model.coefficients).sum(axis=0)
        # The entries of a column of the matrix to Chebyshev polynomials sum up to 1.
        rounding = 2 * (self.count + 4) * UNIT * ((growth + 1) @ np.abs(model.coefficients))
        found = matrix @ model.coefficients
        return Model(lower, found, sum_up(model.radius + rest + rounding, 2 * self.count))

    def _lowering(self, lower: Space) -> tuple[csr_array, np.ndarray, csr_array]:
        """The matrix to a space of lower degrees, the sums of its columns, and what it leaves out.

        Its entries are binary fractions of few bits, so that they are exact.
        """
        matrix, kept = np.zeros((lower.count, self.count)), np.full(self.count, False)
        for term in lower.places:
            kept[self.places[term]] = True
            row = self.series[[self.places[term]]].toarray()[0]
            for degrees in itertools.product(*(range(a % 2, a + 1, 2) for a in term)):
                share = math.prod(map(_power_share, term, degrees))
                matrix[lower.places[degrees]] += share * row
        return csr_array(matrix), np.abs(matrix).sum(axis=0), self.series[np.flatnonzero(~kept)]

    def at(self, model: Model, x: Fraction) -> Model:
        """The model at tau = x."""
        powers = np.array([float(x**a) for a in range(self.time_degree + 1)])
        scaled = model.coefficients * powers[self.exponents[:, 0]][:, None]
        found = np.zeros_like(scaled)
        np.add.at(found, self._without_time, scaled)
        rest = np.abs(scaled).sum(axis=0) * (2 * (self.time_degree + 6) * UNIT)
        return Model(self, found, sum_up(model.radius + rest, self.count))

    def moved(self, model: Model, start: Model) -> Model:
        """The polynomial of a model, plus one without time, so that at tau = -1 it is ``start``."""
        shift = start.coefficients - self._ends[-1] @ model.coefficients
        return Model(self, model.coefficients + shift, np.zeros_like(model.radius))

    def at_end(self, model: Model, end: int) -> Model:
        """The model at tau = -1 or 1."""
        found = self._ends[end] @ model.coefficients
        rest = model.radius + 2 * (self.time_degree + 2) * UNIT * model.amount()
        return Model(self, found, sum_up(rest))


@dataclass(frozen=True, eq=False)
class Parts:
    """Cells that are halved, or go on as they are.

    - parents: The cell of each part.
    - halved, axes, sides: Whether it is a half; of which input, and the lower one (-1) or not (1).
    """

    parents: np.ndarray
    halved: np.ndarray
    axes: np.ndarray
    sides: np.ndarray

    @classmethod
    def chosen(cls, cells: Sequence[int] | np.ndarray) -> Parts:
        """Some cells as they are."""
        same = np.zeros(len(cells), dtype=int)
        return cls(np.array(cells, dtype=int), same > 0, same, same)

    @classmethod
    def halving(cls, wide: np.ndarray, axes: np.ndarray) -> Parts:
        """Halves of the cells that are too wide, and the others; in the order of the cells."""
        own = np.repeat(np.arange(len(wide)), 1 + wide)
        sides = np.ones(len(own), dtype=int)
        sides[np.flatnonzero(np.diff(own, append=-1) == 0)] = -1
        return cls(own, wide[own], axes[own], sides)


class Model:
    """A polynomial and a radius for each cell.

    - coefficients: Shape (terms, cells).
    - radius: Shape (cells,).
    """

    def __init__(self, space: Space, coefficients: np.ndarray, radius: np.ndarray) -> None:
        self.space, self.coefficients, self.radius = space, coefficients, radius
        self._size: np.ndarray | None = None
        self._amount: np.ndarray | None = None

    def amount(self) -> np.ndarray:
        """The sum of |coefficients| for each cell, rounded up."""
        if self._amount is None:
            self._amount = sum_up(np.abs(self.coefficients).sum(axis=0), self.space.count)
        return self._amount

    def size(self) -> np.ndarray:
        """A bound on |P| for each cell: the sum of |coefficients| of Chebyshev polynomials."""
        if self._size is None:
            space = self.space
            series = np.abs(space.series @ self.coefficients).sum(axis=0)
            # The entries of a column of the matrix sum up to 1.
            rounding = 2 * (space.count + 4) * UNIT * self.amount()
            self._size = np.minimum(sum_up(series + rounding, space.count), self.amount())
        return self._size

    def range(self) -> tuple[np.ndarray, np.ndarray]:
        """The middle and the radius of a ball around the values, for each cell."""
        series = self.space.series @ self.coefficients
        rest = np.abs(series[1:]).sum(axis=0) + self.radius
        rest = rest + 2 * (self.space.count + 4) * UNIT * self.amount()
        return series[0], sum_up(rest, self.space.count)

    def largest(self) -> np.ndarray:
        """A bound on |f| for each cell."""
        return np.asarray(sum_up(self.size() + self.radius))

    def __neg__(self) -> Model:
        return Model(self.space, -self.coefficients, self.radius)

    def __add__(self, other: Model | arb | int) -> Model:
        if not isinstance(other, Model):
            return self.plus(*_known(other))
        found = self.coefficients + other.coefficients
        rest = self.radius + other.radius + UNIT * np.abs(found).sum(axis=0)
        return Model(self.space, found, sum_up(rest, self.space.count))

    def __sub__(self, other: Model | arb | int) -> Model:
        return self + (-other)

    def __mul__(self, other: Model | arb | int) -> Model:
        if not isinstance(other, Model):
            return self.times(*_known(other))
        return self.space.product(self, other)

    __radd__, __rmul__ = __add__, __mul__

    def __rsub__(self, other: arb | int) -> Model:
        return -self + other

    def times(self, factor: Any, radius: Any = 0.0) -> Model:
        """The product with a number, or one for each cell, known up to a radius."""
        found = self.coefficients * factor
        rest = np.abs(factor) * self.radius + radius * self.largest()
        rest = rest + UNIT * np.abs(found).sum(axis=0)
        return Model(self.space, found, sum_up(rest, self.space.count))

    def plus(self, number: Any, radius: Any = 0.0) -> Model:
        """The sum with a number, or one for each cell, known up to a radius."""
        found = self.coefficients.copy()
        found[0] += number
        return Model(self.space, found, sum_up(self.radius + radius + UNIT * np.abs(found[0])))

    def widened(self, radius: Any) -> Model:
        """The model with a larger radius."""
        return Model(self.space, self.coefficients, sum_up(self.radius + radius))

    def polynomial(self) -> Model:
        """The polynomial alone."""
        return Model(self.space, self.coefficients, np.zeros_like(self.radius))

    def composed(self, function: Callable[[Any], Any]) -> Model:
        """An elementary function of the model."""
        centre, rest = self.coefficients[0].copy(), self.coefficients.copy()
        rest[0] = 0
        argument = Model(self.space, rest, self.radius)
        half = argument.largest()
        values = np.full((_ORDERS + 1, len(centre)), np.nan)
        errors = np.full_like(values, np.inf)
        ranges = np.full_like(values, np.inf)
        with working(BITS, _ORDERS + 1):
            for cell, (middle, width) in enumerate(
                zip(centre.tolist(), half.tolist(), strict=True)
            ):
                if not (math.isfinite(middle) and math.isfinite(width)):
                    continue
                around = arb(middle) + arb(width) * arb(0, 1)
                try:
                    exact = _padded(function(arb_series([arb(middle), 1])))
                    wide = _padded(function(arb_series([around, 1])))
                except (SingularityError, ZeroDivisionError, ValueError):
                    continue
                for k in range(_ORDERS + 1):
                    values[k, cell], errors[k, cell] = float_with_radius(exact[k])
                    ranges[k, cell] = above(abs(wide[k]))
        with np.errstate(all="ignore"):
            factors = np.repeat(half[None], _ORDERS + 1, axis=0)
            factors[0] = 1
            powers = sum_up(np.multiply.accumulate(factors), 4 * _ORDERS)
            remainders = sum_up(ranges * powers)
            small = np.abs(values) * powers <= _NEGLIGIBLE * np.nanmax(
                np.abs(values) * powers, axis=0, initial=TINY
            )
            order = _ORDERS - 1
            valid = np.isfinite(remainders).any(axis=0)
            for k in range(1, _ORDERS - 1):
                if small[k:, valid].all() and valid.any():
                    order = k
                    break
            # The best of the orders up to there, for all cells together.
            costs = np.where(
                np.isfinite(remainders[1 : order + 2]), remainders[1 : order + 2], 1e300
            )
            order = int(np.argmin(costs[:, valid].max(axis=1))) if valid.any() else 0
            found = self.space.constant(values[order], errors[order])
            for k in range(order - 1, -1, -1):
                found = (found * argument).plus(values[k], errors[k])
            return found.widened(remainders[order + 1])


def _padded(series: Any) -> list[arb]:
    if isinstance(series, arb):
        return [series] + [arb(0)] * _ORDERS
    return [series[k] for k in range(_ORDERS + 1)]


def _applied(function: Callable[..., Any], *arguments: Any) -> Any:
    """A function of balls, of models, or of both.

    Raise SingularityError if the function has no model.
    """
    if not any(isinstance(argument, Model) for argument in arguments):
        return function(*arguments)
    if len(arguments) == 1:
        return arguments[0].composed(function)
    if function is general_power:
        base, exponent = arguments
        return MODELS.exp(exponent * MODELS.log(base))  # type: ignore[attr-defined]
    raise SingularityError


#: The arithmetic of Taylor models, with balls as constants.
MODELS = Arithmetic(_applied)


def _in_chebyshev(*term: int) -> Iterator[tuple[_Term, float]]:
    """A term in products of Chebyshev polynomials.

    The factors are binary fractions of few bits and >= 0, so that they are exact.
    """
    for degrees in itertools.product(*(range(a % 2, a + 1, 2) for a in term)):
        yield degrees, math.prod(map(_chebyshev_share, term, degrees))


def _chebyshev_share(power: int, degree: int) -> float:
    """The coefficient of T_degree(x) in x**power, of the same parity."""
    share = math.comb(power, (power - degree) // 2) * 2.0 ** (1 - power)
    return share if degree else share / 2


@functools.cache
def _chebyshev_powers(degree: int) -> list[float]:
    """Coefficients of the powers in T_degree."""
    return np.polynomial.chebyshev.cheb2poly([0.0] * degree + [1.0]).tolist()


def _power_share(degree: int, power: int) -> float:
    """The coefficient of x**power in T_degree(x)."""
    return _chebyshev_powers(degree)[power]


def multi_indices(count: int, degree: int) -> list[tuple[int, ...]]:
    """All multi-indices of a total degree up to a limit, by degree."""
    found = [nu for nu in itertools.product(range(degree + 1), repeat=count) if sum(nu) <= degree]
    return sorted(found, key=sum)


def total(models: Sequence[Model]) -> Model:
    """The sum of models."""
    found = models[0]
    for model in models[1:]:
        found = found + model
    return found
