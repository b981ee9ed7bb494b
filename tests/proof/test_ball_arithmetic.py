"""Operations on balls contain the true values, or have a radius that no bound accepts."""

import itertools
import math
import re
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from flint import arb

import hamsym.kernel
from hamsym.kernel.enclosures import enclosures
from hamsym.proof.arithmetic.balls import number_of, working
from hamsym.proof.arithmetic.directed import MIDDLE, TINY
from tests.proof.kernel_calls import balls
from tests.proof.misses import (
    BINARY,
    UNARY,
    UNIT,
    applied,
    binary_misses,
    drawn_balls,
    drawn_pairs,
    inside,
    pairs,
    point,
    remainders,
    triples,
    unary_misses,
)

_LARGEST = 1.7976931348623157e308
#: Ends of the range of float64, and numbers between which products and sums cease to be exact.
_MAGNITUDES = [
    *(0.0, 5e-324, 1e-310, 2.0**-1022, 1e-300, 1e-290, 1e-170, 1e-154, 1e-30, 1.0),
    *(6.5, 1e10, 1e100, 1e150, 1e154, 1e155, 1e170, 1e292, 1e300, _LARGEST),
]
_SPECIAL = [sign * value for value in _MAGNITUDES for sign in (1.0, -1.0)]
_RADII = [0.0, 5e-324, 1e-300, 1e-20, 1.0, 1e150, 1e300]


@pytest.fixture(scope="module")
def L():
    return enclosures()


# -- functions of one ball -------------------------------------------------------------------------


@pytest.mark.parametrize("name", UNARY)
def test_function_contains_the_true_value(L, name):
    missed, refused = unary_misses(L, name, 2_000, seed=1)
    assert missed == []
    assert refused == []


@pytest.mark.slow
@pytest.mark.parametrize("name", UNARY)
def test_function_contains_the_true_value_at_very_many_arguments(L, name):
    missed, refused = unary_misses(L, name, 200_000, seed=2)
    assert missed == []
    assert refused == []


#: Largest radius relative to the value, or absolute, for exact arguments between 0.01 and 0.9.
_SHARP = {"error_function": 1e-28}


@pytest.mark.parametrize("name", UNARY)
def test_exact_argument_gives_thirty_digits(L, name):
    shift = 1.0 if name == "inverse_hyperbolic_cosine" else 0.0
    for value in np.linspace(0.01, 0.9, 50).tolist():
        high, low, radius = applied(L, name, (shift + value, 0.0, 0.0))
        assert radius <= _SHARP.get(name, 2e-29)
        assert abs(low) <= 2 * UNIT * abs(high)


def test_squares_of_sine_and_cosine_add_to_one(L):
    for value in triples(drawn_balls(np.random.default_rng(3), np.linspace(-1e6, 1e6, 200))):
        exact = (value[0], value[1], 0.0)
        squares = [applied(L, "multiply", *[applied(L, n, exact)] * 2) for n in ("sine", "cosine")]
        total = applied(L, "add", *squares)
        assert inside(total, arb(1))
        assert total[2] < 1e-23


@pytest.mark.parametrize("name", UNARY)
def test_function_at_the_ends_of_the_range_contains_the_value_or_is_refused(L, name):
    for high, radius in itertools.product(_SPECIAL, _RADII):
        found = applied(L, name, (high, 0.0, radius))
        if not found[2] < math.inf:
            continue
        with working(3000):
            for share in (-1.0, 0.0, 1.0):
                truth = UNARY[name].truth(point((high, 0.0, radius), share))
                assert isinstance(truth, arb)
                assert truth.is_finite()
                assert inside(found, truth), (high, radius, found)


def test_smallest_exponentials_contain_the_value(L):
    with working(300):
        for high in np.arange(-670.0, -664.0, 0.05).tolist():
            for radius in (0.0, 1.0):
                found = applied(L, "exponential", (high, 0.0, radius))
                truth = point((high, 0.0, radius), 1.0).exp()
                assert inside(found, truth), (high, radius, found)


@pytest.mark.parametrize(
    ("name", "outside"),
    [
        ("root", [(-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (1e-30, 0.0, 1e-29)]),
        ("logarithm", [(-1.0, 0.0, 0.0), (0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (2.0, -1e-16, 2.0)]),
        ("arcsine", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.5, 0.0, 0.6), (7.0, 0.0, 0.0)]),
        ("arccosine", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.5, 0.0, 0.6), (-7.0, 0.0, 0.0)]),
        ("inverse_hyperbolic_cosine", [(1.0, 0.0, 0.0), (0.5, 0.0, 0.0), (-2.0, 0.0, 0.0)]),
        ("inverse_hyperbolic_cosine", [(1.5, 0.0, 0.6), (0.0, 0.0, 3.0)]),
        ("inverse_hyperbolic_tangent", [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.5, 0.0, 0.6)]),
        ("inverse_hyperbolic_tangent", [(2.0, 0.0, 0.0), (0.0, 0.0, 3.0)]),
    ],
)
def test_balls_that_leave_the_domain_are_refused(L, name, outside):
    for ball in outside:
        assert not applied(L, name, ball)[2] < math.inf


@pytest.mark.parametrize("divisor", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (1e-9, 0.0, 1e-8)])
def test_division_by_a_ball_with_zero_is_refused(L, divisor):
    assert not applied(L, "divide", (1.0, 0.0, 0.0), divisor)[2] < math.inf


# -- operations on two balls -----------------------------------------------------------------------


def _many(L, name, count, seed, size):
    """Operands, also with negative radii: the other end of the same ball, and results."""
    x, y = drawn_pairs(name, count, seed, size)
    found = balls(L, name, x, y)
    rng = np.random.default_rng(seed)
    for part in (x, y):
        part[:, 2] *= rng.choice([-1.0, 1.0], count)
    return x, y, found


@pytest.mark.slow_cases("multiply-55.0")
@pytest.mark.parametrize(("name", "size"), [("add", 250.0), ("multiply", 55.0)])
def test_a_million_sums_and_products_contain_the_exact_ones(L, name, size):
    missed = 0
    for seed in range(10):
        x, y, found = _many(L, name, 100_000, seed, size)
        missed += int((~(remainders(name, x, y, found) <= found[:, 2])).sum())
    assert missed == 0


@pytest.mark.parametrize(("name", "size"), [("add", 250.0), ("multiply", 55.0)])
def test_distances_by_error_free_transformations_are_those_of_fractions(L, name, size):
    x, y, found = _many(L, name, 2_000, 11, size)
    distances = remainders(name, x, y, found)
    for row in range(len(x)):
        a, b = (sum(map(Fraction, part[row].tolist())) for part in (x, y))
        exact = a + b if name == "add" else a * b
        exact = abs(exact - Fraction(found[row, 0]) - Fraction(found[row, 1]))
        assert float(abs(Fraction(distances[row]) - exact)) <= 1e-3 * found[row, 2]


@pytest.mark.parametrize("name", BINARY)
def test_operation_contains_the_true_value(L, name):
    missed, refused = binary_misses(L, name, pairs(drawn_pairs(name, 6_000, seed=4)))
    assert missed == []
    assert refused == []


@pytest.mark.slow
@pytest.mark.parametrize("name", BINARY)
def test_operation_contains_the_true_value_at_a_million_pairs(L, name):
    missed, refused = binary_misses(L, name, pairs(drawn_pairs(name, 1_000_000, seed=5)))
    assert missed == []
    assert refused == []


@pytest.mark.parametrize("name", BINARY)
def test_radius_of_exact_operands_is_a_few_units_of_the_second_float(L, name):
    for x, y in pairs(drawn_pairs(name, 500, seed=6, size=30.0)):
        a, b = (x[0], x[1], 0.0), (y[0], y[1], 0.0)
        high, low, radius = applied(L, name, a, b)
        size = abs(a[0]) + abs(b[0]) if name == "add" else abs(high)
        assert radius <= (1.001 if name != "divide" else 8) * MIDDLE * size + 8 * TINY * (
            1 + abs(x[0])
        )
        assert abs(low) <= 2 * UNIT * abs(high)


def special_pairs():
    for a, b in itertools.product(_SPECIAL, repeat=2):
        for radius in (0.0, 1e-300, 1.0, 1e300):
            yield (a, 0.0, radius), (b, 0.0, 0.0)
            yield (a, 0.0, 0.0), (b, 0.0, radius)
    for a in (1e-300, 1.0, 1e150):
        for b in (1e-300, 1e-150, 1.0, 1e155):
            yield (a, a * UNIT / 2, 0.0), (-b, b * UNIT / 2, 0.0)


@pytest.mark.parametrize("name", BINARY)
def test_operation_at_the_ends_of_the_range_contains_the_value_or_is_refused(L, name):
    missed, _ = binary_misses(L, name, list(special_pairs()), bits=4500)
    assert missed == []


@pytest.mark.parametrize("name", [*UNARY, *BINARY, "absolute"])
@pytest.mark.parametrize("place", [0, 2])
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan])
def test_infinity_and_nan_pass_no_bound(L, name, place, value):
    if place == 2 and value == -math.inf:
        value = math.nan
    for other in (0.0, 0.5, 1.5, -3.0, 1e300):
        ball = [other, 0.0, 0.25]
        ball[place] = value
        if name in BINARY:
            results = [applied(L, name, tuple(ball), (other, 0.0, 0.0))]
            results.append(applied(L, name, (other, 0.0, 0.0), tuple(ball)))
        elif name == "absolute":
            results = [(0.0, 0.0, applied(L, name, tuple(ball))[0])]
        else:
            results = [applied(L, name, tuple(ball))]
        for found in results:
            assert not found[2] <= _LARGEST


def test_scaled_contains_also_subnormal_numbers(L):
    for high in (1.0, 3e-320, 5e-324, 1e300):
        for power in (-60, -8, 0, 8):
            found = applied(L, "scaled", (high, 0.0, high), (2.0**power, 0.0, 0.0))
            assert abs(Fraction(high) * 2 * Fraction(2) ** power - Fraction(found[0])) <= Fraction(
                found[2]
            )


# -- balls of exact numbers ------------------------------------------------------------------------


@pytest.mark.parametrize(
    "value",
    [
        *(Fraction(1, 3), Fraction(0), Fraction(-22, 7), Fraction(2) ** 1000 / 3),
        *(Fraction(2) ** -1060, Fraction(1, 3) / 2**1050, Fraction(1, 10**400)),
        *(Fraction(1, 3) + Fraction(1, 10**30), Fraction(_LARGEST)),
        Fraction(5e-324) / 2 + Fraction(1e-300),  # whose low part underflows
    ],
)
def test_ball_of_a_fraction_contains_it(value):
    high, low, radius = number_of(value)
    assert abs(value - Fraction(high) - Fraction(low)) <= Fraction(radius)
    assert Fraction(radius) <= abs(value) / 2**100 + Fraction(5e-324)


def test_ball_of_a_wide_ball_contains_its_ends():
    with working(240):
        value = arb(1) / 3 + arb("0 +/- 1e-20")
    high, low, radius = number_of(value)
    with working(300):
        assert abs(value.upper() - arb(high) - arb(low)) <= arb(radius)
        assert abs(value.lower() - arb(high) - arb(low)) <= arb(radius)
    assert radius < 1.001e-20


@pytest.mark.parametrize("value", [Fraction(10) ** 400, -(Fraction(10) ** 309)])
def test_number_beyond_float64_has_no_ball(value):
    assert not number_of(value)[2] < math.inf


def test_ball_without_bound_has_no_ball():
    with working(240):
        assert not number_of(arb("nan"))[2] < math.inf
        assert not number_of(arb("inf"))[2] < math.inf


@pytest.mark.parametrize("value", [Fraction(0), Fraction(0.1), Fraction(1e8) + Fraction(2) ** -70])
def test_sum_of_two_numbers_has_no_radius(value):
    high, low, radius = number_of(value)
    assert radius == 0
    assert Fraction(high) + Fraction(low) == value


def test_constants_of_the_library_contain_their_numbers():
    text = (Path(hamsym.kernel.__path__[0]) / "balls.c").read_text("utf-8")
    with working(300):
        truths = {
            "LOG_2": [arb.const_log2()],
            "HALF_PI": [arb.pi() / 2],
            "TWO_BY_ROOT_PI": [2 / arb.pi().sqrt()],
            "INVERSE_FACTORIAL[]": [1 / arb(math.factorial(k)) for k in range(32)],
        }
        for name, numbers in truths.items():
            rows = re.findall(r"{([^{}]+)}", text.split(f"ball {name} = ")[1].split(";")[0])
            balls = [tuple(map(float.fromhex, row.split(", "))) for row in rows]
            assert all(inside(ball, truth) for ball, truth in zip(balls, numbers, strict=True))
            assert all(radius <= 1e-32 for _, _, radius in balls)
            # No radius is larger than it has to be.
            for (high, low, radius), truth in zip(balls, numbers, strict=True):
                assert not radius or not inside((high, low, 0.99 * radius), truth)
