"""Ball: numbers and texts become balls that contain them; membership is decided exactly."""

import math
import pickle
from decimal import Decimal
from fractions import Fraction

import numpy as np
import pytest
import sympy

from hamsym import Ball
from hamsym.errors import InputError


def contains_exactly(ball, value):
    return abs(Fraction(value) - Fraction(ball.mid)) <= Fraction(ball.radius)


# -- Ball.of ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", [0, 1, -2.5, 5e-324, 1.7976931348623157e308, True])
def test_number_is_an_exact_ball(value):
    ball = Ball.of(value)
    assert (ball.mid, ball.radius) == (float(value), 0.0)


@pytest.mark.parametrize("value", [np.float64(0.1), np.float32(0.1), np.int64(3), Fraction(1, 4)])
def test_other_kinds_of_numbers_are_exact(value):
    ball = Ball.of(value)
    assert (ball.mid, ball.radius) == (float(value), 0.0)


@pytest.mark.parametrize(
    ("value", "exact"),
    [
        (Fraction(1, 3), Fraction(1, 3)),
        (Decimal("0.1"), Fraction(1, 10)),
        (sympy.Rational(1, 3), Fraction(1, 3)),
        (2**53 + 1, Fraction(2**53 + 1)),
    ],
)
def test_number_that_float64_rounds_is_in_its_ball(value, exact):
    assert contains_exactly(Ball.of(value), exact)


@pytest.mark.parametrize(
    ("text", "middle", "radius"),
    [
        ("9.81 +- 0.01", "9.81", "0.01"),
        ("9.81 +/- 0.01", "9.81", "0.01"),
        ("9.81±0.01", "9.81", "0.01"),
        ("  -1e-3 +- 1e-6  ", "-0.001", "0.000001"),
        ("0.1", "0.1", "0"),
        ("1/3", "1/3", "0"),
        ("1/3 +- 1/7", "1/3", "1/7"),
        ("0.1 +- 0", "0.1", "0"),
        ("1e-320 +- 1e-322", "1e-320", "1e-322"),
        ("1e30 +- 1e-30", "1e30", "1e-30"),
    ],
)
def test_text_contains_the_ends_of_its_decimals(text, middle, radius):
    ball, middle, radius = Ball.of(text), Fraction(middle), Fraction(radius)
    assert contains_exactly(ball, middle + radius)
    assert contains_exactly(ball, middle - radius)
    slack = abs(middle) / 2**52 + radius / 2**52 + Fraction(1, 2**1073)
    assert Fraction(ball.radius) <= radius + slack


def test_text_of_a_binary_fraction_is_exact():
    for text in ("0.5", "-3", "1.25e2", "3/8"):
        assert Ball.of(text).radius == 0.0


@pytest.mark.parametrize(
    "pair", [(0.1, 0.3), (-1, 1), (1.0, 1.0), ("0.1", "0.3"), [2, 5], (-1e308, 1e308), (0, 5e-324)]
)
def test_pair_contains_both_ends(pair):
    ball = Ball.of(pair)
    low, high = (Fraction(part) for part in pair)
    assert contains_exactly(ball, low)
    assert contains_exactly(ball, high)
    assert Fraction(ball.radius) <= (high - low) / 2 * (1 + Fraction(1, 2**50)) + abs(
        high + low
    ) / 2**53 + Fraction(1, 2**1073)


def test_ball_is_returned_unchanged():
    ball = Ball(1.0, 0.5)
    assert Ball.of(ball) is ball


def test_random_texts_contain_their_decimals():
    rng = np.random.default_rng(0)
    for _ in range(500):
        middle = f"{rng.normal() * 10.0 ** rng.integers(-300, 300):.17e}"
        radius = f"{abs(rng.normal()) * 10.0 ** rng.integers(-300, 300):.5e}"
        ball = Ball.of(f"{middle} +- {radius}")
        for sign in (-1, 1):
            assert contains_exactly(ball, Fraction(middle) + sign * Fraction(radius))


@pytest.mark.parametrize(
    "value",
    [
        *("", "x", "1 +-", "+- 1", "1 +- 2 +- 3", "1 +- -1", "nan", "inf", "1 +- inf", "1 +- nan"),
        *("1/0", "1e400", "1e9999999999", "1 +- 1e400", "9" * 200),
        *((2, 1), (1, 2, 3), (), (math.nan, 1), (0, math.inf), ("a", 1), [1]),
        *(math.nan, math.inf, -math.inf, None, 1j, object(), {"mid": 1}, np.array([1.0, 2.0])),
        *(10**400, Fraction(10) ** 400),
        Ball([1.0, 2.0], [0.0, 0.0]),
    ],
)
def test_what_is_no_ball_is_refused_in_one_sentence(value):
    with pytest.raises(InputError) as refused:
        Ball.of(value)
    text = str(refused.value)
    assert text
    assert ". " not in text


@pytest.mark.parametrize(
    ("middle", "radius"),
    [
        *((1.0, -1.0), (math.nan, 1.0), (math.inf, 1.0), (1.0, math.nan), ("x", 1.0)),
        *(([1.0, 2.0], 1.0), ([1.0], [1.0, 2.0]), ([1.0, 2.0], [0.0, -1e-300]), (1j, 0.0)),
        *((None, None), ([[1.0], [1.0, 2.0]], 0.0)),
    ],
)
def test_bad_middles_and_radii_are_refused(middle, radius):
    with pytest.raises(InputError):
        Ball(middle, radius)


# -- bounds and membership -------------------------------------------------------------------------


def test_bounds_are_outside_of_the_ball():
    rng = np.random.default_rng(1)
    middle = rng.normal(size=300) * 10.0 ** rng.integers(-20, 20, 300)
    radius = np.abs(middle) * 10.0 ** rng.integers(-20, 3, 300)
    ball = Ball(middle, radius)
    for m, r, low, high in zip(middle, radius, ball.lower, ball.upper, strict=True):
        assert Fraction(low) <= Fraction(m) - Fraction(r)
        assert Fraction(high) >= Fraction(m) + Fraction(r)
        assert ball.width >= 2 * Fraction(r)


def test_width_is_the_largest_of_the_entries():
    assert Ball([1.0, 2.0], [0.25, 1.0]).width == pytest.approx(2.0, abs=1e-15)
    assert Ball(1.0, 0.0).width <= 5e-16


def test_membership_is_decided_exactly():
    tenth = Ball.of((0.1, 0.3))
    assert tenth.contains(0.1)
    assert tenth.contains(0.3)
    ball = Ball(1.0, 2.0**-60)  # mid + radius rounds to mid
    assert ball.contains(1.0)
    assert not ball.contains(math.nextafter(1.0, 2.0))
    assert not Ball(1.0, 0.0).contains(math.nextafter(1.0, 0.0))
    wide = Ball(1e16, 1.0)
    assert wide.contains(1e16)
    assert not wide.contains(1e16 + 2)


def test_membership_of_arrays_is_that_of_all_entries():
    ball = Ball([[1.0, 2.0], [3.0, 4.0]], [[0.1, 0.1], [0.1, 0.1]])
    assert ball.contains([[1.05, 2.0], [3.0, 3.95]])
    assert not ball.contains([[1.05, 2.0], [3.0, 3.8]])
    assert Ball([1.0, 1.0], [0.5, 2.0]).contains(1.2)
    assert not Ball([1.0, 1.0], [0.5, 2.0]).contains(2.0)


@pytest.mark.parametrize("radius", [1.0, math.inf])
@pytest.mark.parametrize("value", [math.nan, None, math.inf, -math.inf])
def test_infinity_and_nan_are_in_no_ball(value, radius):
    assert not Ball(0.0, radius).contains(value)
    assert not Ball([0.0, 0.0], [radius, radius]).contains([0.0, value])


def test_infinite_radius_contains_all_numbers():
    ball = Ball(0.0, math.inf)
    assert ball.contains(1e308)
    assert ball.width == math.inf


def test_pickle_keeps_the_ball():
    copy = pickle.loads(pickle.dumps(Ball([1.0, 2.0], [0.1, 0.0])))
    assert copy.contains([1.05, 2.0])
    assert not copy.contains([1.05, 2.1])


@pytest.mark.parametrize("shape", [(3,), (1, 2), (2, 2, 2)])
def test_ball_may_have_any_shape(shape):
    ball = Ball(np.zeros(shape), np.ones(shape))
    assert ball.contains(np.ones(shape))
    assert ball.lower.shape == ball.upper.shape == shape


@pytest.mark.parametrize(
    "values", [[1.0, 2.0, 3.0], [[1.0], [1.0, 2.0]], "a", ["a", "b"], 1j, object(), {}, 10**400]
)
def test_values_that_are_no_numbers_or_do_not_fit_are_refused(values):
    with pytest.raises(InputError):
        Ball([1.0, 2.0], [0.0, 0.0]).contains(values)
