"""Arithmetic of balls whose mid-points are sums of two float64 numbers, compiled.

A ball is a triple (h, l, r) and means the set of all x with |x - (h + l)| <= r.

*Rounding.* u = 2^-53; every operation rounds to nearest, no rounding mode is changed.

1. ``two_sum`` and ``two_product`` return a rounded result and its exact error (Knuth 1998, section
   4.2.2, theorem B; Boldo & Muller 2011, section 2), apart from underflow, which is below TINY.
2. With |l| <= 2u |h| for the arguments, the sum of two mid-points takes two further roundings of
   numbers below 5u (|a| + |b|), the product three of numbers below 6u |ab| and leaves out
   |l_a l_b| <= 4u^2 |ab|. So both errors are below MIDDLE (|a| + |b|) and MIDDLE |ab|, MIDDLE =
   32 u^2; Joldes, Muller & Popescu 2017 (theorems 3.1 and 5.1) have the sharp constants.
3. A radius is a sum of at most eight products of numbers >= 0; at most 16 roundings, each a factor
   in [1 - u, 1 + u], so that (1 + 64u) times the computed number, plus TINY, is an upper bound.
   Infinity and NaN remain what they are and pass no test ``r <= bound``.
4. Products that underflow are wrong by at most 2^-1075 each, so that UNDERFLOW bounds the error of
   thousands. It is added to factors of other products, which TINY would make too large: they may
   multiply a component in a unit of 10^200.

*Functions.* exp, sin and cos reduce their arguments with constants that are balls, and sum a Taylor
series whose remainder is added to the radius; nothing is assumed about the processor's or the
library's functions. log, atan and asin begin with the library's value y, an arbitrary number, and
enclose the difference by addition theorems: log(x) = y + log(x exp(-y)), and so on. An angle y of
more than 2 is refused, because the theorems tell angles only up to 2 pi.
"""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb
from numba import njit, types
from numba.extending import intrinsic

from hamsym.proof.balls import above, exact, float_above, working

UNIT = 2.0**-53
MIDDLE = 32 * UNIT * UNIT
TINY = 1e-290
# 2^-1060 by its bits, which no setting of the processor falsifies.
UNDERFLOW = np.array(1 << 14, dtype=np.uint64).view(np.float64).item()
_UP = 1 + 64 * UNIT
_BITS = 240  # of constants

#: Of functions that :mod:`hamsym.proof.compiled` keeps in its cache, and of those inside them.
compiled = njit(error_model="numpy", nogil=True)
inlined = njit(error_model="numpy", nogil=True)


def number_of(value: arb | Fraction) -> tuple[float, float, float]:
    """The ball around a ball of Arb or a fraction."""
    if not isinstance(value, Fraction) and not value.is_finite():
        return math.nan, math.nan, math.inf
    middle = value if isinstance(value, Fraction) else exact(value)
    try:
        high = float(middle)
        rest = middle - Fraction(high)
        low = float(rest)
    except OverflowError:
        return math.nan, math.nan, math.inf
    if not isinstance(value, Fraction):
        with working(_BITS):
            return high, low, above(abs(value - arb(high) - arb(low)))
    return high, low, float_above(abs(rest - Fraction(low)))


def _table(values: list[Any]) -> np.ndarray:
    return np.array([number_of(value) for value in values])


with working(_BITS):
    _LOG_2 = number_of(arb.const_log2())
    HALF_PI = number_of(arb.pi() / 2)
    _TWO_BY_ROOT_PI = number_of(2 / arb.pi().sqrt())
_INVERSE_FACTORIALS = _table([Fraction(1, math.factorial(k)) for k in range(32)])


@intrinsic  # type: ignore[misc]
def fma(_context: Any, a: Any, b: Any, c: Any) -> Any:
    """a b + c with one rounding."""

    def emit(_: Any, builder: Any, __: Any, arguments: Any) -> Any:
        return builder.fma(*arguments)

    return types.float64(types.float64, types.float64, types.float64), emit


@compiled
def basic_operations(a, b, c):
    """a + b, a b, a / b, sqrt(|a|) and a b + c with one rounding, for arrays of one length."""
    found = np.empty((5, len(a)))
    for k in range(len(a)):
        found[0, k], found[1, k], found[2, k] = a[k] + b[k], a[k] * b[k], a[k] / b[k]
        found[3, k], found[4, k] = math.sqrt(abs(a[k])), fma(a[k], b[k], c[k])
    return found


@inlined
def two_sum(a, b):
    s = a + b
    t = s - a
    return s, (a - (s - t)) + (b - t)


@inlined
def two_product(a, b):
    p = a * b
    return p, fma(a, b, -p)


@inlined
def _up(value):
    return value * _UP + TINY


@inlined
def checked(value, radius):
    """The radius, or infinity beside a mid-point that is not finite."""
    return radius if abs(value) < math.inf else math.inf


@inlined
def absolute(x):
    """An upper bound on the numbers of a ball."""
    return _up(abs(x[0]) + abs(x[1]) + x[2])


@inlined
def ball_of(value):
    return value, 0.0, 0.0


@inlined
def negative(x):
    return -x[0], -x[1], x[2]


@inlined
def add(x, y):
    s, e = two_sum(x[0], y[0])
    high, low = two_sum(s, e + (x[1] + y[1]))
    return high, low, checked(high + low, _up(x[2] + y[2] + MIDDLE * (abs(x[0]) + abs(y[0]))))


@inlined
def multiply(x, y):
    p, e = two_product(x[0], y[0])
    high, low = two_sum(p, e + (x[0] * y[1] + x[1] * y[0]))
    a, b = abs(x[0]) + abs(x[1]), abs(y[0]) + abs(y[1])
    return high, low, checked(high + low, _up(a * y[2] + x[2] * (b + y[2]) + MIDDLE * (a * b)))


@inlined
def scaled(x, factor):
    """The product with a power of two."""
    return x[0] * factor, x[1] * factor, x[2] * factor + TINY


@inlined
def widened(x, radius):
    return x[0], x[1], _up(x[2] + radius)


@inlined
def invalid():
    return math.nan, math.nan, math.inf


@compiled
def divide(x, y):
    """x / y, from y q = 1 - e: x / y = x q (1 + e / (1 - e))."""
    first = ball_of(1 / y[0])
    rest = add(ball_of(1.0), negative(multiply(y, first)))
    q = add(first, ball_of(first[0] * rest[0]))
    q = (q[0], q[1], 0.0)
    rest = add(ball_of(1.0), negative(multiply(y, q)))
    error = absolute(rest)
    if not error < 0.5:
        return invalid()
    product = multiply(x, q)
    return widened(product, absolute(product) * error / (1 - error))


@compiled
def root(x):
    """The square root, from q^2 = x - e: |sqrt(x) - q| <= |e| / q."""
    if not x[0] - abs(x[1]) - x[2] > 0:
        return invalid()
    first = math.sqrt(x[0])
    rest = add(x, negative(multiply(ball_of(first), ball_of(first))))
    high, low = two_sum(first, 0.5 * rest[0] / first)
    q = (high, low, 0.0)
    rest = add(x, negative(multiply(q, q)))
    return widened(q, absolute(rest) / (high - abs(low)) * (1 + 8 * UNIT))


@compiled
def exponential(x):
    if not (x[2] <= 1 and abs(x[0]) <= 1e5):
        return invalid()
    k = math.floor(x[0] / _LOG_2[0] + 0.5)
    if k > 1000:
        return invalid()
    if k < -960:  # exp(x) < 2^-960 exp(2) < 1e-287, because x < (k + 1) log(2) + r
        return 0.0, 0.0, 1e-287
    middle = (x[0], x[1], 0.0)
    y = scaled(add(middle, negative(multiply(ball_of(k), _LOG_2))), 2.0**-8)
    size = absolute(y)
    if not size <= 0.01:
        return invalid()
    total = ball_of(0.0)
    for j in range(12, 0, -1):
        c = _INVERSE_FACTORIALS[j]
        total = multiply(y, add((c[0], c[1], c[2]), total))
    total = widened(total, size**13 * 1e-9)  # 1/13! < 2e-10, and the tail is below twice its first
    for _ in range(8):  # (1 + p)^2 - 1
        total = add(scaled(total, 2.0), multiply(total, total))
    total = scaled(add(ball_of(1.0), total), math.ldexp(1.0, k))
    # |exp(m + d) - exp(m)| <= exp(m) (exp(r) - 1) <= exp(m) 2 r, because r <= 1.
    return widened(total, absolute(total) * 2 * x[2])


@compiled
def sine_cosine(x):
    k = math.floor(x[0] / HALF_PI[0] + 0.5)
    if not abs(k) <= 2.0**40:
        return invalid(), invalid()
    middle = (x[0], x[1], 0.0)
    y = add(middle, negative(multiply(ball_of(k), HALF_PI)))
    size = absolute(y)
    if not size <= 0.8:
        return invalid(), invalid()
    square = multiply(y, y)
    sine, cosine = ball_of(0.0), ball_of(0.0)
    for j in range(14, 0, -1):
        c, s = _INVERSE_FACTORIALS[2 * j], _INVERSE_FACTORIALS[2 * j + 1]
        sign = 1.0 if j % 2 == 0 else -1.0
        cosine = multiply(square, add((sign * c[0], sign * c[1], c[2]), cosine))
        sine = multiply(square, add((sign * s[0], sign * s[1], s[2]), sine))
    # The terms decrease with alternating signs: the rest is below 0.8^30/30! < 1e-35.
    cosine = widened(add(ball_of(1.0), cosine), 1e-35 + x[2])
    sine = widened(add(y, multiply(y, sine)), 1e-35 + x[2])
    quarter = int(k) % 4
    if quarter == 0:
        return sine, cosine
    if quarter == 1:
        return cosine, negative(sine)
    if quarter == 2:
        return negative(sine), negative(cosine)
    return negative(cosine), sine


@compiled
def logarithm(x):
    if not x[0] - abs(x[1]) - x[2] > 0:
        return invalid()
    y = ball_of(math.log(x[0]))
    z = add(multiply((x[0], x[1], 0.0), exponential(negative(y))), ball_of(-1.0))
    size = absolute(z)
    if not size <= 1e-3:
        return invalid()
    # z - z^2/2 + z^3/3 - ..., the rest below |z|^4
    square = multiply(z, z)
    cube = multiply(multiply(square, z), (1 / 3, 0.0, UNIT))
    found = add(add(y, z), add(scaled(square, -0.5), cube))
    found = widened((found[0], found[1], abs(found[2])), size**4)
    # |log(m + d) - log(m)| <= r / (m - r)
    low = x[0] - abs(x[1]) - x[2]
    return widened(found, x[2] / low * (1 + 16 * UNIT) if x[2] > 0 else 0.0)


@inlined
def guessed_angle(value):
    """The number as a ball; NaN, which no test admits, unless it is within [-2, 2]."""
    return ball_of(value if abs(value) <= 2 else math.nan)


@compiled
def arctangent(x):
    y = guessed_angle(math.atan(x[0]))
    middle = (x[0], x[1], 0.0)
    sine, cosine = sine_cosine(y)
    below = add(cosine, multiply(middle, sine))
    # A positive cosine means that atan(x) - y is between -pi/2 and pi/2: it is within 3 pi/2,
    # because |y| <= 2.
    if not below[0] - abs(below[1]) - below[2] > 0:
        return invalid()
    z = divide(add(multiply(middle, cosine), negative(sine)), below)
    size = absolute(z)
    if not size <= 1e-3:
        return invalid()
    return widened(add(y, z), size**3 + x[2])


@compiled
def arcsine(x):
    if not abs(x[0]) + abs(x[1]) + x[2] < 1 - 4 * UNIT:
        return invalid()
    middle = (x[0], x[1], 0.0)
    y = guessed_angle(math.asin(x[0]))
    sine, cosine = sine_cosine(y)
    beside = root(add(ball_of(1.0), negative(multiply(middle, middle))))
    inner = add(multiply(beside, cosine), multiply(middle, sine))  # as in arctangent
    if not inner[0] - abs(inner[1]) - inner[2] > 0:
        return invalid()
    z = add(multiply(middle, cosine), negative(multiply(beside, sine)))
    size = absolute(z)
    if not size <= 1e-3:
        return invalid()
    found = widened(add(y, z), size**3)
    if x[2] > 0:  # the derivative is largest at the outer end
        outer = abs(x[0]) + abs(x[1]) + x[2]
        room = (1 - outer) * (1 - 8 * UNIT)
        found = widened(found, x[2] / math.sqrt(room) * (1 + 16 * UNIT))
    return found


@compiled
def arccosine(x):
    return add(HALF_PI, negative(arcsine(x)))


@compiled
def inverse_hyperbolic_sine(x):
    if x[0] < 0:
        return negative(inverse_hyperbolic_sine_positive(negative(x)))
    return inverse_hyperbolic_sine_positive(x)


@compiled
def inverse_hyperbolic_sine_positive(x):
    middle = (x[0], x[1], 0.0)
    beside = root(add(ball_of(1.0), multiply(middle, middle)))
    return widened(logarithm(add(middle, beside)), x[2])


@compiled
def inverse_hyperbolic_cosine(x):
    product = multiply(add(x, ball_of(1.0)), add(x, ball_of(-1.0)))
    return logarithm(add(x, root(product)))


@compiled
def inverse_hyperbolic_tangent(x):
    above_one = logarithm(add(ball_of(1.0), x))
    return scaled(add(above_one, negative(logarithm(add(ball_of(1.0), negative(x))))), 0.5)


@compiled
def error_function(x):
    if not abs(x[0]) <= 1e100:
        return invalid()
    if abs(x[0]) > 6:  # 1 - erf(|x|) < exp(-x^2) < 2^-51 2^-(|x| - 6)
        sign = 1.0 if x[0] > 0 else -1.0
        return sign, 0.0, _up(2.0 ** -min(45 + math.floor(abs(x[0])), 960.0) + 2 * x[2])
    middle = (x[0], x[1], 0.0)
    square = multiply(middle, middle)
    power, total = middle, middle
    count = 0
    while True:
        count += 1
        power = divide(multiply(power, negative(square)), ball_of(float(count)))
        term = divide(power, ball_of(2.0 * count + 1))
        total = add(total, term)
        size = absolute(term)
        # From |x|^2 < n / 2 on each term is below half of the one before.
        if count > 2 * absolute(square) and size < 1e-34:
            return widened(multiply(widened(total, size), _TWO_BY_ROOT_PI), 2 * x[2])
        if not count < 400:
            return invalid()
