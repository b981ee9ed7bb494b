"""Models contain their functions on [-1, 1], at the ends too, or have an infinite radius."""

import math
from fractions import Fraction

import numpy as np
import pytest

from hamsym.kernel.enclosures import enclosures
from tests.proof import kernel_calls
from tests.proof.misses import (
    FORMULAS,
    Model,
    distance,
    end_misses,
    fractions,
    model_misses,
    product_of,
    program_of,
    ran,
    series_misses,
)

_SERIES = ["multiply_series", "integrate_series", "differentiate_series"]


@pytest.fixture(scope="module")
def L():
    return enclosures()


def model(*coefficients, radius=0.0):
    high = np.array(coefficients, dtype=float)
    return Model(high, np.zeros(len(high)), radius)


# -- functions -------------------------------------------------------------------------------------


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", FORMULAS)
def test_model_contains_its_function(L, name, double):
    missed, refused = model_misses(L, name, double, 32, seed=1)
    assert missed == []
    assert refused <= 2  # a swing that 32 terms do not resolve


@pytest.mark.slow
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", FORMULAS)
def test_model_contains_its_function_for_very_many_polynomials(L, name, double):
    missed, _ = model_misses(L, name, double, 2_000, seed=2)
    assert missed == []


@pytest.mark.parametrize(("double", "bound"), [(False, 1e-12), (True, 5e-28)])
@pytest.mark.parametrize("name", FORMULAS)
def test_resolved_function_has_a_radius_of_the_size_of_roundings(L, name, double, bound):
    formula = FORMULAS[name]
    gentle = model(np.mean(formula.middles), 0.1 * formula.swing, 0.02 * formula.swing)
    found = ran(L, program_of(formula), [gentle] * formula.variables, double)
    assert found.radius <= bound


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", FORMULAS)
def test_radius_of_the_argument_enters_with_the_slope(L, name, double):
    formula = FORMULAS[name]
    gentle = model(np.mean(formula.middles), 0.01 * formula.swing, radius=1e-6)
    found = ran(L, program_of(formula), [gentle] * formula.variables, double)
    assert found.radius <= 1e-4


_LEAVING = [
    ("reciprocal", model(1.0, 1.0)),
    ("reciprocal", model(0.3, 1.0)),
    ("reciprocal", model(1.0, 0.5, radius=0.6)),
    ("reciprocal", model(0.0)),
    ("reciprocal_root", model(1.0, 1.0)),
    ("reciprocal_root", model(1.0, 2.0)),
    ("reciprocal_root", model(-2.0, 0.1)),
    ("reciprocal_root", model(1.0, 0.5, radius=0.6)),
    ("root", model(0.0)),
    ("log", model(1.0, 1.0)),
    ("log", model(-2.0, 0.5)),
    ("log", model(1.0, 0.5, radius=0.6)),
    ("asin", model(0.5, 0.6)),
    ("asin", model(1.0)),
    ("asin", model(2.0, 0.1)),
    ("asin", model(0.5, 0.1, radius=0.5)),
    ("acos", model(-0.5, 0.6)),
    ("acosh", model(1.5, 0.6)),
    ("acosh", model(-2.0, 0.1)),
    ("acosh", model(1.5, 0.1, radius=0.5)),
    ("atanh", model(0.5, 0.6)),
    ("atanh", model(-2.0, 0.1)),
    ("atanh", model(0.5, 0.1, radius=0.5)),
    ("tan", model(1.5, 0.2)),
    ("exp", model(1000.0, 1.0)),
    ("exp", model(0.0, 1.0, radius=1.5)),
    ("exp", model(0.0, 2000.0)),
    ("sin", model(1e14, 1.0)),
]


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize(("name", "argument"), _LEAVING)
def test_argument_outside_the_domain_has_no_radius(L, name, argument, double):
    assert ran(L, program_of(FORMULAS[name]), [argument], double).radius == math.inf


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("angle", [model(0.0, 0.0), model(0.1, 0.5), model(0.0, radius=1e-3)])
def test_angle_at_the_cut_has_no_radius(L, angle, double):
    found = ran(L, program_of(FORMULAS["atan2"]), [angle, model(-1.0, 0.1)], double)
    assert found.radius == math.inf


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("value", [math.inf, math.nan])
@pytest.mark.parametrize("name", sorted(set(FORMULAS) - {"sum", "difference", "negative"}))
def test_argument_that_is_not_finite_has_no_radius(L, name, value, double):
    formula = FORMULAS[name]
    coefficients, radius = model(value, 0.1), model(np.mean(formula.middles), 0.1, radius=value)
    for argument in (coefficients, radius):
        found = ran(L, program_of(formula), [argument] * formula.variables, double)
        assert not found.radius < math.inf


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", ["sum", "difference", "negative"])
def test_infinite_radius_stays_infinite(L, name, double):
    for value in (math.inf, math.nan):
        arguments = [model(1.0, 0.1, radius=value)] * FORMULAS[name].variables
        assert ran(L, program_of(FORMULAS[name]), arguments, double).radius == math.inf


@pytest.mark.parametrize(
    ("name", "double", "size"),
    [
        ("sum", False, 1.5e308),
        ("sum", True, 1.5e308),
        ("product", False, 1e155),
        ("product", True, 1e155),
        ("product", False, 1e200),
        ("product", True, 1e200),
    ],
)
def test_overflow_has_no_radius(L, name, double, size):
    found = ran(L, program_of(FORMULAS[name]), [model(size, size)] * 2, double)
    assert found.radius == math.inf


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("shape", [1, 2, 5, 32])
def test_sums_of_models_of_all_lengths(L, shape, double):
    short, long = model(1.0), model(*(0.5 ** np.arange(shape)))
    for first, second in ((short, long), (long, short)):
        for name, sign in (("sum", 1), ("difference", -1)):
            found = ran(L, program_of(FORMULAS[name]), [first, second], double)
            exact = [Fraction(0)] * shape
            for part, weight in ((first, 1), (second, sign)):
                for k, value in enumerate(fractions(part.high)):
                    exact[k] += weight * value
            assert distance(fractions(found.high, found.low), exact) <= found.radius


@pytest.mark.parametrize("double", [False, True])
def test_terms_beyond_the_rows_go_to_the_radius(L, double):
    last = np.zeros(32)
    last[31] = 1.0
    found = ran(L, program_of(FORMULAS["product"]), [model(*last), model(*last)], double)
    exact = product_of(fractions(last), fractions(last))  # (1 + T_62)/2
    assert distance(fractions(found.high, found.low), exact) <= found.radius < 0.51


# -- series ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", _SERIES)
def test_bound_on_roundings_of_a_series_holds_in_fractions(L, name, double):
    assert series_misses(L, name, double, 150, seed=1) == []


@pytest.mark.slow
@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", _SERIES)
def test_bound_on_roundings_holds_for_many_series(L, name, double):
    assert series_misses(L, name, double, 2_000, seed=2) == []


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize("name", _SERIES)
def test_bound_on_roundings_is_small(L, name, double):
    rng = np.random.default_rng(3)
    high, low = rng.normal(size=32) * 0.5 ** np.arange(32), np.zeros(32)
    oh, ol = np.zeros((2, 66))
    factors = [(high, low)] * (2 if name == "multiply_series" else 1)
    bound = getattr(kernel_calls, name)(L, *factors, (oh, ol), double)
    assert bound <= (5e-29 if double else 1e-13)


@pytest.mark.parametrize("double", [False, True])
@pytest.mark.parametrize(
    ("a", "b"),
    [
        (5e-324, 1e300),
        (1.5e-323, 1e300),
        (1e-300, 1e300),
        (1e300, 5e-324),
        (2.3e-308, 1e300),
        (1e-200, 1e-200),
    ],
)
def test_products_with_subnormal_numbers_are_covered(L, a, b, double):
    oh, ol = np.zeros((2, 4))
    zero = np.zeros(1)
    bound = kernel_calls.multiply_series(
        L, (np.array([a]), zero), (np.array([b]), zero), (oh, ol), double
    )
    assert abs(Fraction(a) * Fraction(b) - Fraction(oh[0]) - Fraction(ol[0])) <= Fraction(bound)


def test_size_is_an_upper_bound(L):
    rng = np.random.default_rng(4)
    for count in (1, 7, 32):
        for _ in range(50):
            high = rng.normal(size=count) * 10.0 ** rng.uniform(-5, 5, count)
            low = high * rng.uniform(-1, 1, count) * 2.0**-53
            size = sum(abs(Fraction(a)) + abs(Fraction(b)) for a, b in zip(high, low, strict=True))
            assert size <= Fraction(float(L.norms(high, low))) <= size * (1 + Fraction(1, 2**44))


def test_end_values_contain_the_exact_ones(L):
    assert end_misses(L, 300, seed=1) == []


def test_end_value_of_exact_sums_has_thirty_digits(L):
    high = 0.5 ** np.arange(32)
    for end in (-1, 1):
        assert L.end_values(high, None, end)[2] < 1e-29


def test_derivative_of_the_integral_is_the_series(L):
    rng = np.random.default_rng(5)
    high = rng.normal(size=20)
    oh, ol, back, back_low = np.zeros((4, 40))
    first = kernel_calls.integrate_series(L, (high, np.zeros(20)), (oh, ol), twice=True)
    second = L.differentiate_series((oh[:21], ol[:21]), (back, back_low), twice=True)
    apart = distance(fractions(back[:20], back_low[:20]), fractions(high))
    assert apart <= Fraction(second) + 21**2 * Fraction(first)  # Markov's inequality
