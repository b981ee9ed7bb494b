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
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from flint import arb, arb_series

from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.balls import above, working
from hamsym.proof.arithmetic.directed import TINY, UNIT, sum_up
from hamsym.proof.arithmetic.functions import Arithmetic, SingularityError, general_power

BITS = 160  # of constants, tables and elementary functions
_ORDERS = 26  # of the series of an elementary function
_NEGLIGIBLE = 2.0**-58


def float_with_radius(number: arb) -> tuple[float, float]:
    """A float64 near a ball, and a bound on its distance from every number in the ball."""
    value = float(number.mid()) if number.is_finite() else math.nan
    if not math.isfinite(value):
        return math.nan, math.inf
    return value, above(abs(number - arb(value)))


def _known(number: arb | int) -> tuple[float, float]:
    return float_with_radius(number if isinstance(number, arb) else arb(number))


@functools.lru_cache(maxsize=16)
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
        self.exponents = np.array(own)
        self.places = {term: place for place, term in enumerate(own)}
        self.count = len(own)
        pairs = []
        left_out = np.ones((self.count, self.count))
        counts = np.zeros(self.count, dtype=int)
        for i, term in enumerate(own):
            sums = [tuple(row) for row in (self.exponents + term).tolist()]
            known = [
                (j, self.places[total]) for j, total in enumerate(sums) if total in self.places
            ]
            seconds, targets = (np.array(part) for part in zip(*known, strict=True))
            pairs.append((np.full(len(seconds), i), seconds, targets))
            left_out[i, seconds] = 0
            counts[targets] += 1
        self._pairs = [np.concatenate(part) for part in zip(*pairs, strict=True)]
        self._left_out = left_out
        self.most = int(counts.max())
        self._integral, self._beyond = self._integration()
        self._ends = {end: self._evaluation(end) for end in (-1, 1)}
        self._rate = self._differentiation()
        self.series = self._conversion()

    def _integration(self) -> tuple[np.ndarray, np.ndarray]:
        """The matrix of the integral from tau = -1, and the share that is left out."""
        matrix, beyond = np.zeros((self.count, self.count)), np.zeros(self.count)
        for i, (a, *nu) in enumerate(self.exponents.tolist()):
            target = self.places.get((a + 1, *nu))
            if target is None:
                beyond[i] = 1 / (a + 1)
            else:
                matrix[target, i] += 1 / (a + 1)
            matrix[self.places[(0, *nu)], i] += (-1) ** a / (a + 1)
        return matrix, beyond

    def _evaluation(self, end: int) -> np.ndarray:
        """The matrix of the value at tau = -1 or 1."""
        matrix = np.zeros((self.count, self.count))
        for i, (a, *nu) in enumerate(self.exponents.tolist()):
            matrix[self.places[(0, *nu)], i] = end**a
        return matrix

    def _differentiation(self) -> np.ndarray:
        """The matrix of the derivative in tau."""
        matrix = np.zeros((self.count, self.count))
        for i, (a, *nu) in enumerate(self.exponents.tolist()):
            if a:
                matrix[self.places[(a - 1, *nu)], i] = a
        return matrix

    def _conversion(self) -> np.ndarray:
        """The matrix from powers of the variables to products of Chebyshev polynomials.

        Its entries are binary fractions of few bits and >= 0, so that they are exact.
        """
        matrix = np.zeros((self.count, self.count))
        for i, term in enumerate(self.exponents.tolist()):
            for degrees in itertools.product(*(range(a % 2, a + 1, 2) for a in term)):
                share = math.prod(map(_chebyshev_share, term, degrees))
                matrix[self.places[degrees], i] = share
        return matrix

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
        tail = (size * (self._left_out @ other)).sum(axis=0)
        rounding = 2 * (self.most + 4) * UNIT * first.amount() * second.amount()
        rest = (
            first.radius * (second.size() + second.radius)
            + first.size() * second.radius
            + tail
            + rounding
        )
        return Model(self, found, sum_up(rest, 2 * self.count))

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

    def at_end(self, model: Model, end: int) -> Model:
        """The model at tau = -1 or 1."""
        found = self._ends[end] @ model.coefficients
        rest = model.radius + 2 * (self.time_degree + 2) * UNIT * model.amount()
        return Model(self, found, sum_up(rest))


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


def _chebyshev_share(power: int, degree: int) -> float:
    """The coefficient of T_degree(x) in x**power, of the same parity."""
    share = math.comb(power, (power - degree) // 2) * 2.0 ** (1 - power)
    return share if degree else share / 2


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
