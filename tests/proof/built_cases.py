"""Arguments built to meet the bounds of the kernel: one search for each of its constants.

Random arguments rarely come near a bound, which adds the worst of each rounding. These are made so
that roundings are as large as they can be and have the same sign: numbers just above a power of two
whose error is half a unit, sums that lose the same part at every step, radii that are rounded down.

``CASES`` says for each constant to which value it must be shrunk until its search finds a miss;
``PROVEN`` why no argument shows a constant: it stands before a larger bound, or chooses an
algorithm.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from hamsym.kernel.enclosures import ADD
from hamsym.kernel.enclosures import Models as Rows
from hamsym.numerics.collocation import chebyshev_tables
from hamsym.proof.arithmetic.balls import working
from tests.proof import kernel_calls
from tests.proof.misses import (
    UNIT,
    all_applied,
    derivative_of,
    distance,
    fractions,
    inside,
    integral_of,
    point,
    product_of,
    remainders,
    triples,
)

#: Files of the kernel with bounds; that of the elementary functions has none.
SOURCES = (
    "balls.h",
    "series.h",
    "enclosures.h",
    "balls.c",
    "series.c",
    "enclosures.c",
    "flow.c",
    "tangents.c",
    "sets.c",
    "followed.c",
)

Misses = list[Any]
Search = Callable[[Any], Misses]


@dataclass(frozen=True)
class Case:
    """A constant, as it is and shrunk, and a search that notices."""

    value: float
    shrunk: float
    search: Search


def _exact(ball: tuple[float, ...], share: int = 0) -> Fraction:
    return Fraction(ball[0]) + Fraction(ball[1]) + share * Fraction(ball[2])


# -- balls -----------------------------------------------------------------------------------------


def _loose_pairs(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Exact balls with high parts just above a power of two and low parts of up to 3 u."""
    rng = np.random.default_rng(7)
    balls = []
    for _ in range(2):
        high = 1 + rng.integers(0, 2**30, count) * 2.0**-52 * 2.0 ** rng.integers(-29, 20, count)
        high *= 2.0 ** -rng.integers(0, 3, count)
        low = (3 - 2.0 ** -rng.integers(1, 40, count)) * UNIT * high * rng.choice([-1, 1], count)
        balls.append(np.stack([high, low, np.zeros(count)], axis=1))
    return balls[0], balls[1]


def middles(name: str) -> Search:
    """Sums or products of mid-points whose low parts are rounded as badly as possible."""

    def search(L: Any) -> Misses:
        x, y = _loose_pairs(60_000)
        found = kernel_calls.balls(L, name, x, y)
        size = np.abs(x[:, 0]) + np.abs(y[:, 0]) if name == "add" else np.abs(x[:, 0] * y[:, 0])
        worst = np.argsort(remainders(name, x, y, found) / size)[-30:]
        missed = []
        for a, b, c in zip(*(triples(part[worst]) for part in (x, y, found)), strict=True):
            exact = _exact(a) + _exact(b) if name == "add" else _exact(a) * _exact(b)
            if not abs(exact - _exact(c)) <= Fraction(c[2]):
                missed.append((a, b, c))
        return missed

    return search


def rounded_radii(L: Any) -> Misses:
    """Radii of products of balls around one, in which each operation is rounded down."""
    rng, missed = np.random.default_rng(1), []
    radius = 1 + rng.integers(0, 2**20, (2, 4_000)) * 2.0**-52
    x, y = (np.stack([np.ones(4_000), np.zeros(4_000), r], axis=1) for r in radius)
    for a, b, c in zip(*map(triples, (x, y, kernel_calls.balls(L, "multiply", x, y))), strict=True):
        if not _exact(a, 1) * _exact(b, 1) - _exact(c) <= Fraction(c[2]):
            missed.append((a, b, c))
    return missed


def underflows(L: Any) -> Misses:
    """Products that underflow."""
    numbers = [(3e-162 * k, 0.0, 0.0) for k in range(1, 40)]
    found = all_applied(L, "multiply", np.array(numbers), np.array(numbers))
    pairs = zip(numbers, found, strict=True)
    return [a for a, c in pairs if not abs(_exact(a) ** 2 - _exact(c)) <= Fraction(c[2])]


def smallest_exponentials(L: Any) -> Misses:
    """Exponentials of balls below -665, at their upper end."""
    places = [(x, 0.0, 1.0) for x in np.arange(-668.0, -665.5, 0.01).tolist()]
    with working(300):
        found = all_applied(L, "exponential", np.array(places))
        pairs = zip(places, found, strict=True)
        return [x for x, own in pairs if not inside(own, point(x, 1.0).exp())]


def edge_of_arcsine(L: Any) -> Misses:
    """Balls that reach almost to 1, where both roundings of their upper end are half a unit."""
    low = np.nextafter(UNIT / 2, 0)
    places = [(1 - k * UNIT, low * a, low) for k in (1, 2, 3, 4) for a in (0.5, 1.0)]
    with working(300):
        found = all_applied(L, "arcsine", np.array(places))
        pairs = zip(places, found, strict=True)
        return [x for x, own in pairs if not inside(own, point(x, 1.0).asin())]


# -- series ----------------------------------------------------------------------------------------


def sum_of_radii(L: Any) -> Misses:
    """A sum of two constant models whose radii are rounded down."""
    high, low = np.zeros((2, 3, 8))
    radius, length = np.array([1.0, 2.0**-54, 0.0]), np.ones(3, dtype=np.int64)
    using = chebyshev_tables(8)
    models = Rows(using.values, using.series, high, low, radius, length)
    L.run_models(np.array([[ADD, 2, 0, 1]]), models, twice=True)
    exact = Fraction(radius[0]) + Fraction(radius[1])
    return [] if exact <= Fraction(radius[2]) else [radius]


def _product(L: Any, a: Any, b: Any, twice: bool) -> Misses:
    oh, ol = np.zeros((2, len(a[0]) + len(b[0]) + 1))
    bound = kernel_calls.multiply_series(L, a, b, (oh, ol), twice)
    exact = product_of(fractions(*a), fractions(*b))
    size = len(exact)
    apart = distance(fractions(oh[:size], ol[:size]), exact)
    return [] if apart <= Fraction(bound) else [(a, b, bound)]


def losing_products(L: Any) -> Misses:
    """A product in which sums from 32 to 64 lose almost half a unit at each of their terms."""
    n = 64
    none = np.zeros(n)
    b = np.full(n, 1 + 0.97 * 2.0**-47)
    return _product(L, (np.ones(n), none), (b, none), False)


def single_products(L: Any) -> Misses:
    """Products of a number and a series, rounded by almost half a unit."""
    a, b = _half_units(16)
    return _product(L, (a[:1], np.zeros(1)), (b, np.zeros(16)), False)


def _half_units(count: int) -> tuple[np.ndarray, np.ndarray]:
    """A number, and numbers whose product with it is just above one and loses half a unit."""
    a = 1 + 2.0**-26
    k = np.arange(1, 200_000, dtype=np.int64)
    # (1 + 2^-26)(1 + k 2^-52) = 1 + 2^-26 + k 2^-52 + k 2^-78
    share = (k * 2.0**-26) % 1.0
    chosen = k[np.argsort(np.abs(share - 0.4999))[:count]]
    return np.full(count, a), 1 + chosen * 2.0**-52


def single_products_twice(L: Any) -> Misses:
    """Products of one number and one other in two floats, all of whose parts are rounded."""
    missed = []
    for a, b in zip(*_loose_pairs(400), strict=True):
        pair = (a[:1].copy(), a[1:2].copy()), (b[:1].copy(), b[1:2].copy())
        missed += _product(L, *pair, True)
    return missed


def halves(L: Any) -> Misses:
    """Many subnormal numbers times a huge one: half of the smallest is lost each time."""
    a = np.full(64, 5e-324)
    return _product(L, (a, np.zeros(64)), (np.array([1e300]), np.zeros(1)), False)


def _climbed(error: Callable[[np.ndarray], float], start: np.ndarray, rounds: int) -> np.ndarray:
    """Numbers near a start at which an error is large, by changes of single ones."""
    rng, best = np.random.default_rng(3), start.copy()
    value = error(best)
    for _ in range(rounds):
        trial = best.copy()
        place = tuple(rng.integers(0, size) for size in best.shape)
        trial[place] = start[place] * (1 + rng.integers(-(2**20), 2**20) * 2.0**-52)
        found = error(trial)
        if found >= value:
            best, value = trial, found
    return best


def series_search(name: str, twice: bool, start: list[float], rounds: int = 1_500) -> Search:
    """Series whose integral, derivative or value at an end has large roundings."""

    def search(L: Any) -> Misses:
        count = len(start)

        def rows(numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            low = numbers[1] * (3 * UNIT) if twice else np.zeros(count)
            return np.ascontiguousarray(numbers[0]), low

        def error(numbers: np.ndarray) -> float:
            return _apart(L, name, rows(numbers), twice)

        given = np.array([start, [0.9 * value for value in start]])
        own = rows(_climbed(error, given, rounds))
        return [] if error_within(L, name, own, twice) else [own]

    return search


def _results(L: Any, name: str, c: Any, twice: bool) -> tuple[Fraction, Fraction]:
    """The true error and its bound."""
    if name == "end_values":
        high, low, radius = L.end_values(*c, 1)
        exact = sum(fractions(*c), Fraction(0))
        return abs(exact - Fraction(high.item()) - Fraction(low.item())), Fraction(radius.item())
    oh, ol = np.zeros((2, len(c[0]) + 2))
    bound = getattr(kernel_calls, name)(L, c, (oh, ol), twice)
    exact = (integral_of if name == "integrate_series" else derivative_of)(fractions(*c))
    size = len(exact)
    return distance(fractions(oh[:size], ol[:size]), exact), Fraction(bound)


def _apart(L: Any, name: str, c: Any, twice: bool) -> float:
    return float(_results(L, name, c, twice)[0] / sum(map(abs, fractions(c[0]))))


def error_within(L: Any, name: str, c: Any, twice: bool) -> bool:
    error, bound = _results(L, name, c, twice)
    return error <= bound


# -- windows and sets ------------------------------------------------------------------------------


def _norm(L: Any, jacobian: np.ndarray, entries: Any, units: np.ndarray) -> Fraction:
    dim, terms = len(units), jacobian.shape[1]
    none, V = np.zeros(dim), np.zeros((dim, dim, terms))
    count = len(jacobian)
    length, signed = np.full(count, terms, dtype=np.int64), (np.array(entries), np.ones(count))
    sizes = np.zeros((dim, dim))
    flow = L.flow_defects(jacobian, length, *signed, V, sizes, 1.0)
    found = L.transport(
        *(jacobian, np.zeros(count), length, *signed, none, none, sizes, *flow, none, 1.0, units)
    )
    return Fraction(found[3])


def circles(L: Any) -> Misses:
    """A circle that loses almost half a unit at each of many terms."""
    jacobian = _losing(64)[None]
    exact = sum(fractions(jacobian[0]), Fraction(0))
    found = _norm(L, jacobian, [(0, 0, 0)], np.ones(2))
    return [] if exact <= found else [found]


def underflowing_ratios(L: Any) -> Misses:
    """Half of 1e304 1e-170/1e155, between two components that are not coupled otherwise."""
    units = np.array([1e155, 1e-170])
    found = _norm(L, np.array([[1e304, 0.0, 0.0, 0.0]]), [(0, 1, 0)], units)
    exact = Fraction(1e304) * Fraction(units[1]) / Fraction(units[0]) / 2
    return [] if exact <= found else [found]


def entries(L: Any) -> Misses:
    """Entries of a product of matrices that are one product each, rounded by half a unit."""
    a, b = _half_units(16)
    missed = []
    for x, y in zip(a.tolist(), b.tolist(), strict=True):
        J, C = np.array([[x]]), np.array([[y]])
        found, rest = L.moved_set(J, np.zeros((1, 1)), C, np.ones((1, 1)))
        if not abs(Fraction(x) * Fraction(y) - Fraction(found.item())) <= Fraction(rest.item()):
            missed.append((x, y))
    return missed


def _losing(count: int) -> np.ndarray:
    """Numbers whose sums lose almost half a unit whenever one is added."""
    found, total = [], 0.0
    for _ in range(count):
        unit = np.spacing(total) if total else 0.0
        found.append(1 + 0.484375 * unit)
        total += found[-1]
    return np.array(found)


def layers(L: Any) -> Misses:
    """A sum of many inputs of a layer, rounded in the same sense."""
    missed = []
    for n in (64, 400):
        high, low = np.zeros((2, n, 8))
        high[:, 0] = _losing(n)
        low[:, 0] = high[:, 0] * UNIT * 0.97
        length = np.ones(n, dtype=np.int64)
        out = L.dense(np.ones((1, n)), np.zeros(1), high, low, np.zeros(n), length)
        exact = sum(fractions(high[:, 0], low[:, 0]), Fraction(0))
        if not abs(exact - Fraction(out[0][0, 0]) - Fraction(out[1][0, 0])) <= Fraction(out[2][0]):
            missed.append((n, out[2]))
    return missed


_SECOND = UNIT * UNIT
CASES: dict[str, Case] = {
    "MIDDLE, sums": Case(32 * _SECOND, 0.11 * 32 * _SECOND, middles("add")),
    "MIDDLE, products": Case(32 * _SECOND, 0.6 * 32 * _SECOND, middles("multiply")),
    "OUTWARD": Case(64 * UNIT, 0.9 * UNIT, rounded_radii),
    "SMALL": Case(1e-290, 0.0, underflows),
    "UNDERFLOW_ERROR": Case(2.0**-1060, 0.0, underflowing_ratios),
    "LEAST_EXPONENTIAL": Case(1e-287, 0.018 * 1e-287, smallest_exponentials),
    "EDGE": Case(4 * UNIT, 0.4 * UNIT, edge_of_arcsine),
    "SECOND_ORDER": Case(2.0**-20, 0.0, sum_of_radii),
    "HALVING": Case(1e-321, 3e-322, halves),
    "PER_SUM": Case(3.0, 0.4, losing_products),
    "PRODUCT_TWICE": Case(80 * _SECOND, 16 * _SECOND, single_products_twice),
    "INTEGRAL": Case(
        10 * UNIT, 1.4 * UNIT, series_search("integrate_series", False, [1.0, 0.1, -1.0])
    ),
    "INTEGRAL_TWICE": Case(
        128 * _SECOND, 3.8 * _SECOND, series_search("integrate_series", True, [1.0, 0.4, -1.0, 0.3])
    ),
    "DERIVATIVE": Case(
        4 * UNIT, 0.28 * UNIT, series_search("differentiate_series", False, [0.0, 0.0, 0.0, 0.34])
    ),
    "DERIVATIVE_TWICE": Case(
        64 * _SECOND,
        0.6 * _SECOND,
        series_search("differentiate_series", True, [0.0, 0.2, 0.0, 0.34]),
    ),
    "AT_END": Case(2.0, -2.3, series_search("end_values", True, [0.26, 1.0, 0.3])),
    "CIRCLES": Case(64.0, -114.0, circles),
    "PER_ENTRY": Case(2.0, -1.0, entries),
    "PER_LAYER": Case(8 * _SECOND, 0.016 * _SECOND, layers),
}
#: Constants that no argument shows, or that are no bounds, and why.
PROVEN = {
    "UNIT": "the rounding of float64 itself, in which the other constants are written",
    "GUARD": "at most three roundings, each time before OUTWARD or SECOND_ORDER, which are larger",
    "SLOPE": "three roundings before OUTWARD",
    "HALF": "one rounding before SECOND_ORDER",
    "PER_PRODUCT": "PER_SUM counts a first sum of each product, which is exact",
    "MORE": "inputs of a sum: PER_LAYER is for any number of them",
    "REST_EXPONENTIAL": "times 0.002^13 it is below 1e-44; roundings of the sum are 1e-31",
    "REST_SINE": "roundings of the sum are above 1e-31",
    "REST_ERROR_FUNCTION": "the term at which a series ends, whose size is the bound",
    "TUBES": "attempts",
    "SWEEPS": "of guesses",
    "TOGETHER": "order of computation",
    "TILE": "order of computation",
    "MOST_VECTORS": "order of computation",
    "ENOUGH": "of guesses",
    "AROUND": "with APART, the roundings of a half length before SECOND_ORDER",
    "APART": "with AROUND, and of a difference before SECOND_ORDER",
    "MOST_TERMS": "room for coefficients",
    "MOST": "room for coefficients",
}
