"""Pairs of float64 numbers, against mpmath with 60 digits."""

import mpmath
import numpy as np
import pytest

import hamsym
from hamsym.numerics.collocation import precise_integration
from hamsym.numerics.pairs import PAIRS, Pair, as_pair, product
from hamsym.proof.arithmetic.generated import GeneratedFunctions

RANDOM = np.random.default_rng(4)


def exact(pair, place=()):
    high, low = np.broadcast_arrays(pair.high, pair.low)
    return mpmath.mpf(float(high[place])) + mpmath.mpf(float(low[place]))


@pytest.fixture(autouse=True)
def digits():
    with mpmath.workdps(60):
        yield


def numbers():
    high = RANDOM.uniform(0.5, 2, 50)
    return Pair(high, high * RANDOM.uniform(-1, 1, 50) * 2.0**-54)


@pytest.mark.parametrize(
    "function",
    [
        lambda a, b, one: a + b,
        lambda a, b, one: a - 3 * b,
        lambda a, b, one: 2 - a * b,
        lambda a, b, one: one.reciprocal(a),
        lambda a, b, one: one.root(a) * one.reciprocal_root(b),
        lambda a, b, one: one.number(1, 3) * a + one.pi,
    ],
)
def test_arithmetic_has_a_hundred_bits(function):
    class Exact:
        reciprocal, root = staticmethod(lambda x: 1 / x), staticmethod(mpmath.sqrt)
        number, pi = staticmethod(lambda p, q=1: mpmath.mpf(p) / q), mpmath.pi
        reciprocal_root = staticmethod(lambda x: 1 / mpmath.sqrt(x))

    a, b = numbers(), numbers()
    found = function(a, b, PAIRS)
    for k in range(50):
        expected = function(exact(a, k), exact(b, k), Exact)
        assert abs(exact(found, k) - expected) < mpmath.mpf(2) ** -100


def test_small_differences_of_large_numbers_are_kept():
    one = Pair(1.0, 2.0**-70)
    assert exact(one - 1) == mpmath.mpf(2) ** -70
    assert exact(as_pair(2.0**-80) + one - one) == mpmath.mpf(2) ** -80


def test_root_of_zero_is_zero():
    assert exact(PAIRS.root(0.0)) == 0


def test_other_functions_have_the_digits_of_extended_precision():
    x = numbers()
    for name in ("sin", "exp", "log", "atan", "tanh", "asinh", "erf"):
        found = getattr(PAIRS, name)(x)
        function = getattr(mpmath, name)
        allowed = 2.0**-50 if name == "erf" else 8 * float(np.finfo(np.longdouble).eps)
        assert all(abs(exact(found, k) - function(exact(x, k))) < allowed for k in range(50))


def test_rates_of_a_hamiltonian_are_precise():
    H = hamsym.Hamiltonian("p**2/(2*m) - 3/(10*sqrt(x**2 + 1/7))", parameters={"m": 0.7})
    x, p = numbers(), numbers()
    rates = GeneratedFunctions(H, PAIRS)("vector_field", [x, p], Pair(0.0))
    seventh = mpmath.mpf(1) / 7
    for k in range(50):
        position, momentum = exact(x, k), exact(p, k)
        force = -3 * position / (10 * (position**2 + seventh) ** mpmath.mpf(1.5))
        assert abs(exact(rates[0], k) - momentum / mpmath.mpf(0.7)) < 1e-30
        assert abs(exact(rates[1], k) - force) < 1e-30


def test_product_of_matrices_is_precise():
    table, columns = numbers(), RANDOM.normal(size=(2, 25, 3))
    table = Pair(table.high.reshape(2, 25), table.low.reshape(2, 25))
    columns = Pair(columns, columns * RANDOM.uniform(-1, 1, columns.shape) * 2.0**-54)
    found = product(table, columns)
    for place in np.ndindex(2, 2, 3):
        k, i, c = place
        terms = [exact(table, (i, j)) * exact(columns, (k, j, c)) for j in range(25)]
        assert abs(exact(found, place) - mpmath.fsum(terms)) < mpmath.mpf(2) ** -60


@pytest.mark.parametrize("count", [3, 20])
def test_integration_is_exact_for_polynomials(count):
    table = precise_integration(count)
    nodes = [-mpmath.cospi(mpmath.mpf(2 * j + 1) / (2 * count)) for j in range(count)]
    for degree in range(count):
        for i, end in enumerate([*nodes, mpmath.mpf(1)]):
            found = mpmath.fsum(exact(table, (i, j)) * x**degree for j, x in enumerate(nodes))
            expected = (end ** (degree + 1) - (-1) ** (degree + 1)) / (2 * (degree + 1))
            assert abs(found - expected) < 1e-30
