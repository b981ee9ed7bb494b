"""Formulas in ball arithmetic contain the values of mpmath to fifty digits."""

import functools
import math
from decimal import Decimal
from fractions import Fraction

import mpmath
import pytest
import sympy
from flint import arb, arb_series, fmpq
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hamsym import Hamiltonian
from hamsym.codegen.functions import compile_straight_line
from hamsym.errors import CertificationError
from hamsym.proof.arithmetic.balls import (
    above,
    at_least,
    at_most,
    ball,
    below,
    decimal,
    decimal_above,
    decimal_below,
    exact,
    working,
)
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions, evaluated

x, y = sympy.symbols("x y", real=True)
_TERMS = 5

# Functions that a formula may contain, and intervals on which they are smooth.
FORMULAS = {
    "sum": (x / 3 - 2 * y + sympy.pi, -5, 5),
    "product": (-x * y * sympy.Rational(1, 7), -5, 5),
    "cube": (x**3 / 3 - x**7, -2, 2),
    "reciprocal": (1 / x**3, 0.2, 5),
    "root": (sympy.sqrt(x), 0.2, 5),
    "reciprocal root": (x ** sympy.Rational(-3, 2), 0.2, 5),
    "five halves": (x ** sympy.Rational(5, 2), 0.2, 5),
    "power": (x**y, 0.2, 3),
    "irrational power": (x**sympy.pi, 0.2, 3),
    "third": (x ** sympy.Rational(1, 3), 0.2, 5),
    "exponential": (sympy.exp(-x * y), -3, 3),
    "float": (sympy.Float(0.1) * x, -5, 5),
    "constants": (sympy.sqrt(2) * x + sympy.exp(1) + sympy.sin(1), -5, 5),
    **{
        name: (getattr(sympy, name)(x), low, high)
        for name, low, high in (
            *((name, -5, 5) for name in "sin cos atan sinh cosh tanh asinh erf sech".split()),
            *((name, 0.2, 1.3) for name in "tan cot sec csc coth csch acot".split()),
            *((name, -0.85, 0.85) for name in "asin acos atanh".split()),
            *((name, 1.2, 5) for name in "acosh log acoth acsc asec acsch".split()),
            ("asech", 0.2, 0.85),
        )
    },
    "atan2": (sympy.atan2(y, x), 0.2, 5),
}


def _enclosed(expressions, symbols):
    function = compile_straight_line(expressions, symbols)
    return lambda arguments: evaluated(function, BALLS, *arguments)


@pytest.mark.parametrize("name", FORMULAS)
@given(data=st.data())
@settings(max_examples=12, deadline=None)
def test_values_and_taylor_coefficients_are_enclosed(name, data):
    formula, low, high = FORMULAS[name]
    number = st.integers(0, 997).map(lambda k: low + (high - low) * k / 997)
    a, b = data.draw(number), data.draw(number)
    radius = data.draw(st.sampled_from([0.0, 1e-12, 1e-3, 0.05]))
    inside = data.draw(st.floats(-0.99, 0.99)) * radius
    _check(formula, a, b, radius, inside)


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("inside", [-0.0495, 0.0, 0.0495])
def test_finite_on_widest_balls(name, inside):
    formula, low, high = FORMULAS[name]
    for a in (low, high):
        _check(formula, a, a, 0.05, inside)


@functools.cache
def _compiled(formula):
    """A formula over balls, and with mpmath."""
    function = sympy.lambdify((x, y), formula.xreplace(_exact_floats(formula)), "mpmath")
    return _enclosed([formula], [x, y]), function


def _check(formula, a, b, radius, inside):
    """One value and its Taylor coefficients at (a, b) in balls that contain it."""
    enclosed, function = _compiled(formula)
    with working(96, _TERMS):
        wide = [arb(a + inside, radius), arb(b, radius / 2)]
        slopes = arb(3) / 4, arb(-2)
        value = enclosed(wide)[0]
        series = enclosed([arb_series([z, slope]) for z, slope in zip(wide, slopes, strict=True)])[
            0
        ]
    with mpmath.workdps(50):
        truth = mpmath.taylor(
            lambda s: function(mpmath.mpf(a) + 3 * s / 4, mpmath.mpf(b) - 2 * s), 0, _TERMS - 1
        )
        assert _holds(value, function(mpmath.mpf(a), mpmath.mpf(b)))
    for k, coefficient in enumerate(truth):
        assert _holds(series[k], coefficient, slack=mpmath.mpf(10) ** -30)
    if radius == 0:
        assert above(abs(value - value.mid())) < 1e-20 * (1 + above(abs(value)))


def _exact_floats(formula):
    tenth = sympy.Rational(*(0.1).as_integer_ratio())
    return dict.fromkeys(formula.atoms(sympy.Float), tenth)


def _holds(enclosure, number, slack=0):
    """Whether a number is in a ball, up to how well it is known itself."""
    assert enclosure.is_finite()
    with mpmath.workdps(50):
        low, high = (mpmath.mpf(end.numerator) / end.denominator for end in _ends(enclosure))
        slack = slack * (1 + abs(number)) + mpmath.mpf(10) ** -45 * abs(number)
        return low - slack <= mpmath.re(number) <= high + slack


def _ends(enclosure):
    with working(400):
        return exact(enclosure.lower()), exact(enclosure.upper())


@pytest.mark.parametrize(
    ("formula", "place"),
    [
        (1 / x, 0.0),
        (sympy.sqrt(x), 0.0),
        (x ** sympy.Rational(5, 2), 0.0),
        (sympy.log(x), 0.05),
        (sympy.log(x), -3.0),
        (sympy.tan(x), math.pi / 2),
        (sympy.asin(x), 1.0),
        (sympy.acosh(x), 1.0),
        (sympy.atanh(x), -1.0),
        (sympy.atan2(y, x), -1.0),
        (x ** sympy.Rational(1, 3), 0.0),
    ],
)
@pytest.mark.parametrize("as_series", [False, True])
def test_singularities_raise(formula, place, as_series):
    with working(96, 4):
        arguments = [arb(place, 0.1), arb(0, 0.1)]
        if as_series:
            arguments = [arb_series([argument, 1]) for argument in arguments]
        with pytest.raises(SingularityError):
            _enclosed([formula], [x, y])(arguments)


def test_squares_around_zero_are_finite():
    with working(96):
        square = _enclosed([x**2], [x])([arb(0, 1)])[0]
    assert square.is_finite()
    assert square.contains(1)
    assert square.contains(0)


@pytest.mark.parametrize(
    "formula", ["p**2/2 + abs(x)", "p**2/2 + max(x, 1)", "p**2/2 + x*sign(x)", "p**2/2 + min(x, p)"]
)
def test_functions_with_kinks_are_rejected(formula):
    name = next(word for word in ("abs", "max", "sign", "min") if word in formula)
    with pytest.raises(CertificationError, match=name):
        GeneratedFunctions(Hamiltonian(formula), BALLS)


def test_unknown_functions_are_rejected():
    p = sympy.Symbol("p")
    with pytest.raises(CertificationError, match="gamma"):
        GeneratedFunctions(Hamiltonian(p**2 / 2 + sympy.gamma(x), q=[x], p=[p]), BALLS)


@pytest.mark.parametrize("n", [1.0, 2.0, 3.0, 4.0])
@pytest.mark.parametrize("formula", ["p**2/2 + x**n", "p**2/2 + ((x**2 + p**2)**(n/2) + 1)**n"])
def test_powers_of_zero_with_integer_parameter(formula, n):
    n = 2 * n if "n/2" in formula else n
    found = GeneratedFunctions(Hamiltonian(formula, parameters={"n": n}), BALLS)
    right = GeneratedFunctions(Hamiltonian(formula.replace("n", str(int(n)))), BALLS)
    with working(96, 3):
        for place in (arb(0), arb(0, 0.1), arb(-0.5)):
            state = [place, arb(1)]
            rates = found("vector_field", state, arb(0)), right("vector_field", state, arb(0))
            assert all(mine.overlaps(other) for mine, other in zip(*rates, strict=True))
            other = right("hessian", state, arb(0))
            assert all(
                value.overlaps(other[k]) for k, value in found("hessian", state, arb(0)).items()
            )


def test_long_products_are_enclosed():
    """The values are those of the factors, multiplied one after the other."""
    n = 9
    H = Hamiltonian("*".join(f"(q{i} + p{i})" for i in range(n)))
    numbers = [Fraction(k + 3, 7) for k in range(2 * n)]
    sums = [a + b for a, b in zip(numbers[:n], numbers[n:], strict=True)]
    with working(128):
        found = GeneratedFunctions(H, BALLS)
        state = [ball(value) for value in numbers]
        for i, rate in enumerate(found("vector_field", state, arb(0))[:n]):
            assert rate.contains(_quotient(math.prod(sums) / sums[i]))
        for (i, j), entry in found("hessian", state, arb(0)).items():
            assert entry.contains(_quotient(math.prod(sums) / sums[i % n] / sums[j % n]))


def _quotient(value):
    return fmpq(value.numerator, value.denominator)


def test_parameters_are_exact_binary_fractions():
    H = Hamiltonian("p**2/2 + k*x**2/2 + x/3", parameters={"k": 0.1})
    with working(200):
        rate = GeneratedFunctions(H, BALLS)("vector_field", [arb(1), arb(0)], arb(0))[1]
        assert rate.contains(ball(-Fraction(0.1) - Fraction(1, 3)))
        assert above(rate.rad()) < 1e-58


def test_hessian_agrees_with_generated_code():
    H = Hamiltonian("exp(-x*p)/3 + p**2*x**3 + t*x")
    system = H.compile("numpy")
    with working(96):
        found = GeneratedFunctions(H, BALLS)("hessian", [arb(0.3), arb(1.2)], arb(0.7))
    expected = system.hessian([0.3, 1.2], 0.7)
    for (i, j), entry in found.items():
        assert abs(above(entry) - expected[i, j]) < 1e-14


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=1e-290), st.integers(1, 10**6))
@settings(deadline=None)
def test_conversions_round_outward(value, parts):
    number = Fraction(value) / parts
    with working(64):
        enclosed = ball(number)
    assert below(enclosed) <= number <= above(enclosed)
    assert math.nextafter(above(enclosed), 0) <= number * (1 + Fraction(1, 2**50))
    for sign in (1, -1):
        text = decimal_above(sign * value)
        assert Decimal(text) >= Decimal(sign * value)
        assert Decimal(decimal_below(sign * value)) <= Decimal(sign * value)
        assert decimal(float(text)) == text or math.isinf(float(text))
        if math.isinf(float(text)):
            continue
        assert Fraction(at_most(float(text))) <= Fraction(decimal(float(text)))
        assert Fraction(at_least(float(text))) >= Fraction(decimal(float(text)))


@given(st.floats(-1e-290, 1e-290))
@example(4 * math.ulp(0.0))  # nine digits are finer than floats there
def test_tiny_decimals_round_outward(value):
    upper, lower = decimal_above(value), decimal_below(value)
    assert Decimal(lower) <= Decimal(value) <= Decimal(upper)
    assert decimal(float(upper)) == upper
    assert decimal(float(lower)) == lower
    if value == 0:
        assert upper == lower == "0"


@pytest.mark.parametrize("exponent", [2**40, 2**60])
def test_bounds_of_numbers_beyond_floats(exponent):
    """Without their digits, which no memory would hold."""
    with working(64):
        large = arb(2) ** exponent
        small = 1 / large
    assert (above(large), below(large)) == (math.inf, math.nextafter(math.inf, 0))
    assert (above(-large), below(-large)) == (-math.nextafter(math.inf, 0), -math.inf)
    assert (above(small), below(small)) == (math.ulp(0.0), 0.0)
    assert (above(-small), below(-small)) == (0.0, -math.ulp(0.0))


def test_precision_is_restored_after_errors():
    from flint import ctx

    before = ctx.prec, ctx.cap
    with pytest.raises(ZeroDivisionError), working(333, 17):
        raise ZeroDivisionError
    assert (ctx.prec, ctx.cap) == before
