"""Polynomials in several variables with complex balls as coefficients, truncated by degree.

Input:  numbers and variables.
Output: :class:`BallPolynomial`: sums, products, quotients, powers, functions, Poisson brackets.

The part of each degree is (a + i b) 2**e with integer polynomials a, b, and a bound of the error in
the norm |f| = sum of |Re| + |Im| over the coefficients. The norm of a product is at most the
product of the norms, and |{f, g}| <= deg f deg g |f| |g|, because the norms of all derivatives of a
homogeneous f add up to deg f |f|. FLINT multiplies the integer polynomials.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Callable, Iterable, Mapping
from functools import reduce
from typing import Any

from flint import Ordering, acb, arb, arb_series, ctx, fmpz_mpoly, fmpz_mpoly_ctx

from hamsym.proof.arithmetic.functions import SingularityError

Powers = tuple[int, ...]


class _Part:
    """A homogeneous polynomial (re + i im) 2**exponent with an error of at most ``error``."""

    __slots__ = ("error", "exponent", "im", "re", "size")

    def __init__(self, re: fmpz_mpoly, im: fmpz_mpoly, exponent: int, error: arb) -> None:
        size = sum(map(abs, (*re.coeffs(), *im.coeffs())), start=0)
        shift = int(size).bit_length() - ctx.prec
        if shift > 0:
            # Each coefficient changes by less than one unit, also if nothing is left of it. One
            # below zero may be rounded away from zero: the size may grow by as much.
            count, exponent = len(re) + len(im), exponent + shift
            re, im = re // 2**shift, im // 2**shift
            error = error + arb((count, exponent))
            size = (int(size) >> shift) + count
        self.re, self.im, self.exponent = re, im, exponent
        self.error = error.upper() if not error.is_zero() else error
        self.size = arb((int(size), exponent))

    def __bool__(self) -> bool:
        return len(self.re) + len(self.im) > 0 or not self.error.is_zero()

    def __add__(self, other: _Part) -> _Part:
        high, low = (self, other) if self.exponent >= other.exponent else (other, self)
        shift, error = high.exponent - low.exponent, high.error + low.error
        if high.size.is_zero():
            return _Part(low.re, low.im, low.exponent, error)
        if shift > 2 * ctx.prec:
            return _Part(high.re, high.im, high.exponent, error + low.size)
        factor = 2**shift
        return _Part(high.re * factor + low.re, high.im * factor + low.im, low.exponent, error)

    def __neg__(self) -> _Part:
        return _Part(-self.re, -self.im, self.exponent, self.error)

    def __mul__(self, other: _Part) -> _Part:
        re, im = _product((self.re, self.im), (other.re, other.im))
        return _Part(re, im, self.exponent + other.exponent, self.error_with(other))

    def error_with(self, other: _Part) -> arb:
        """The norm of a product minus that of the middles."""
        return self.error * (other.size + other.error) + self.size * other.error

    def derivative(self, k: int) -> tuple[fmpz_mpoly, fmpz_mpoly]:
        """The integer polynomials of the derivative by variable k."""
        return self.re.derivative(k), self.im.derivative(k)

    def coefficient(self, powers: Powers) -> acb:
        """The ball of one coefficient."""
        radius = arb(0, self.error)
        re, im = (arb((int(one[powers]), self.exponent)) + radius for one in (self.re, self.im))
        return acb(re, im)

    def powers(self) -> list[Powers]:
        """The powers whose coefficients are not zero in the middle."""
        return list(dict.fromkeys((*self.re.monoms(), *self.im.monoms())))

    def without(self, removed: Iterable[Powers], error: arb) -> _Part:
        """The polynomial with coefficients set to zero, and an error."""
        gone = set(removed)
        re, im = (
            one.context().from_dict({p: v for p, v in one.to_dict().items() if p not in gone})
            for one in (self.re, self.im)
        )
        return _Part(re, im, self.exponent, error)

    def cleaned(self) -> _Part:
        """The polynomial without coefficients that may be zero, which go into the error."""
        small = {p: c for p in self.powers() if (c := self.coefficient(p)).contains(0)}
        error = sum((c.abs_upper() for c in small.values()), self.error)
        return self.without(small, 2 * error) if small else self


def _product(
    f: tuple[fmpz_mpoly, fmpz_mpoly], g: tuple[fmpz_mpoly, fmpz_mpoly]
) -> tuple[fmpz_mpoly, fmpz_mpoly]:
    """A complex product by three real ones."""
    real, imaginary = f[0] * g[0], f[1] * g[1]
    return real - imaginary, (f[0] + f[1]) * (g[0] + g[1]) - real - imaginary


class BallPolynomial:
    """A polynomial up to a degree: a homogeneous part for each degree that is not zero."""

    def __init__(self, parts: Mapping[int, _Part], degree: int, ring: fmpz_mpoly_ctx) -> None:
        self.parts = {n: part for n, part in parts.items() if part}
        self.degree = degree
        self._ring = ring

    @classmethod
    def of(cls, terms: Mapping[Powers, Any], degree: int) -> BallPolynomial:
        """The polynomial with given coefficients, at least one; all powers have one length."""
        count = len(next(iter(terms)))
        ring = fmpz_mpoly_ctx.get([f"x{k}" for k in range(count)], Ordering.lex)
        by_degree: dict[int, dict[Powers, acb]] = {}
        for powers, value in terms.items():
            by_degree.setdefault(sum(powers), {})[powers] = acb(value)
        return cls({n: _part(ring, part) for n, part in by_degree.items()}, degree, ring)

    def coefficient(self, powers: Powers) -> acb:
        """The ball of one coefficient."""
        part = self.parts.get(sum(powers))
        return part.coefficient(powers) if part else acb(0)

    def terms(self, degree: int | None = None) -> dict[Powers, acb]:
        """The coefficients of one degree, or all, that are not zero."""
        parts = [part for n, part in self.parts.items() if degree is None or n == degree]
        return {powers: part.coefficient(powers) for part in parts for powers in part.powers()}

    def _with(self, parts: Mapping[int, _Part]) -> BallPolynomial:
        return BallPolynomial(parts, self.degree, self._ring)

    def _of(self, value: Any) -> BallPolynomial:
        if isinstance(value, BallPolynomial):
            return value
        return self._with({0: _part(self._ring, {(0,) * self._ring.nvars(): acb(value)})})

    def __add__(self, other: Any) -> BallPolynomial:
        parts = dict(self.parts)
        for n, part in self._of(other).parts.items():
            parts[n] = parts[n] + part if n in parts else part
        return self._with(parts)

    __radd__ = __add__

    def __neg__(self) -> BallPolynomial:
        return self._with({n: -part for n, part in self.parts.items()})

    def __sub__(self, other: Any) -> BallPolynomial:
        return self + (-self._of(other))

    def __rsub__(self, other: Any) -> BallPolynomial:
        return (-self) + other

    def __mul__(self, other: Any) -> BallPolynomial:
        parts: dict[int, _Part] = {}
        pairs = itertools.product(self.parts.items(), self._of(other).parts.items())
        for (j, first), (k, second) in pairs:
            if j + k <= self.degree:
                product = first * second
                parts[j + k] = parts[j + k] + product if j + k in parts else product
        return self._with(parts)

    __rmul__ = __mul__

    def __truediv__(self, other: Any) -> BallPolynomial:
        if isinstance(other, BallPolynomial):
            return self * (1 / other)
        return self * (1 / acb(other))

    def __rtruediv__(self, other: Any) -> BallPolynomial:
        return self.applied(lambda s: 1 / s) * other

    def __pow__(self, power: int) -> BallPolynomial:
        if power < 0:
            return 1 / self ** (-power)
        return reduce(operator.mul, [self] * power, self._of(1))

    def applied(self, function: Callable[[arb_series], arb_series]) -> BallPolynomial:
        """A function of the polynomial, whose constant is real, by its Taylor series there.

        The series needs ``degree + 1`` coefficients: the working length of Arb's series.
        """
        point = self.coefficient((0,) * self._ring.nvars()).real
        try:
            series = function(arb_series([point, arb(1)]))
        except (ValueError, ZeroDivisionError) as error:
            raise SingularityError("a division by what may be zero") from error
        small = self.from_degree(1)
        found = self._of(series[self.degree])
        for k in range(self.degree - 1, -1, -1):
            found = found * small + series[k]
        return found

    def bracket(self, generator: BallPolynomial) -> BallPolynomial:
        """The Poisson bracket {self, g} = sum_k df/dx_k dg/dy_k - df/dy_k dg/dx_k, truncated.

        The variables are x_1, ..., x_d, y_1, ..., y_d.
        """
        half = self._ring.nvars() // 2
        parts: dict[int, _Part] = {}
        for (j, f), (k, g) in itertools.product(self.parts.items(), generator.parts.items()):
            if not (j and k and j + k - 2 <= self.degree):
                continue
            re = im = self._ring.constant(0)
            for i in range(half):
                first = _product(f.derivative(i), g.derivative(half + i))
                second = _product(f.derivative(half + i), g.derivative(i))
                re, im = re + first[0] - second[0], im + first[1] - second[1]
            found = _Part(re, im, f.exponent + g.exponent, j * k * f.error_with(g))
            n = j + k - 2
            parts[n] = parts[n] + found if n in parts else found
        return self._with(parts)

    def flowed(self, generator: BallPolynomial) -> BallPolynomial:
        """exp(L_g) f with L_g f = {f, g}, of a generator g without terms below degree three."""
        found = term = self
        for k in range(1, self.degree + 1):
            term = term.bracket(generator) / k
            if not term.parts:
                break
            found = found + term
        return found

    def from_degree(self, lowest: int) -> BallPolynomial:
        """The parts of at least a degree."""
        return self._with({n: part for n, part in self.parts.items() if n >= lowest})

    def cleaned(self, degree: int) -> BallPolynomial:
        """The polynomial whose part of a degree has no coefficients that may be zero."""
        part = self.parts.get(degree)
        return self._with({**self.parts, degree: part.cleaned()}) if part else self

    def split(
        self, degree: int, divisors: Mapping[Powers, acb], smallest: arb
    ) -> tuple[BallPolynomial, BallPolynomial]:
        """The terms of one degree that have a divisor, each over it, and the other terms.

        - divisors: Of the terms that are not zero in the middle; real or imaginary.
        - smallest: A lower bound of all divisors, also of those of terms that are in the error
          alone: the error is one of all terms together.
        """
        part = self.parts[degree]
        middles = {powers: part.coefficient(powers).mid() for powers in divisors}
        over = _part(self._ring, {p: middles[p] / divisor for p, divisor in divisors.items()})
        error = over.error + part.error / smallest
        return (
            self._with({degree: _Part(over.re, over.im, over.exponent, error)}),
            self._with({degree: part.without(divisors, part.error)}),
        )

    def with_part(self, degree: int, other: BallPolynomial) -> BallPolynomial:
        """The polynomial whose part of a degree is that of another polynomial."""
        parts = {n: part for n, part in self.parts.items() if n != degree}
        return self._with({**parts, **{n: p for n, p in other.parts.items() if n == degree}})


def _part(ring: fmpz_mpoly_ctx, terms: Mapping[Powers, acb]) -> _Part:
    """A homogeneous part with given coefficients, rounded to the working precision."""
    if not all(value.is_finite() for value in terms.values()):
        raise SingularityError("a coefficient that is not finite")
    numbers = {
        powers: tuple(tuple(map(int, x.mid().man_exp())) for x in (value.real, value.imag))
        for powers, value in terms.items()
    }
    tops = [m.bit_length() + e for pair in numbers.values() for m, e in pair if m]
    exponent = max(tops, default=0) - ctx.prec
    error = sum((v.real.rad() + v.imag.rad() for v in terms.values()), arb(0))
    lost = sum(m % (1 << max(exponent - e, 0)) != 0 for pair in numbers.values() for m, e in pair)
    error = error + arb((lost, exponent))  # by shifting, below one unit
    re, im = (
        ring.from_dict({p: _shifted(pair[k], exponent) for p, pair in numbers.items()})
        for k in range(2)
    )
    return _Part(re, im, exponent, error)


def _shifted(number: tuple[int, ...], unit: int) -> int:
    """A number, mantissa and exponent, in units of 2**unit, rounded down."""
    mantissa, exponent = number
    shift = exponent - unit
    return mantissa << shift if shift >= 0 else mantissa >> -shift
