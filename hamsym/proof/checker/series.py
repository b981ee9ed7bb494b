"""Power series in x and in s_1 .. s_d: sums over nu of c_nu(x) s^nu with |nu| up to a degree.

The exponents nu are one number, the sum of nu_k (B^k + B^d): the sum of two of these numbers
belongs to the product, and the multiple of B^d is |nu|. Coefficients c_nu are numbers or power
series in x; those of products and of functions are exact, with everything beyond the degree left
out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import combinations_with_replacement
from typing import Any

from flint import arb

from hamsym.proof.checker.formulas import NotProvenError, ball

_BASE = 64  # above all degrees


def exponents(inputs: int, degree: int) -> dict[int, tuple[int, ...]]:
    """nu by its number, with |nu| up to a degree, in the order of |nu|."""
    if degree >= _BASE:
        raise NotProvenError(f"polynomials of degree {degree} are not covered")
    found = {}
    for n in range(degree + 1):
        for chosen in combinations_with_replacement(range(inputs), n):
            nu = tuple(chosen.count(k) for k in range(inputs))
            found[sum(part * _key(inputs, k) for k, part in enumerate(nu))] = nu
    return found


def _key(inputs: int, k: int) -> int:
    """The number of s_k."""
    return int(_BASE**k + _BASE**inputs)


class Series:
    """A power series.

    - terms: c_nu by the number of nu; those that are left out vanish.
    """

    def __init__(self, inputs: int, degree: int, terms: Mapping[int, Any]) -> None:
        self.inputs, self.degree, self.terms = inputs, degree, terms

    @classmethod
    def line(cls, inputs: int, degree: int, middle: Any, slopes: Mapping[int, Any]) -> Series:
        """middle + sum_k slopes[k] s_k."""
        found = {_key(inputs, k): slope for k, slope in slopes.items()}
        return cls(inputs, degree, {0: middle} | (found if degree else {}))

    def order(self, key: int) -> int:
        """|nu| of a term."""
        return int(key // _BASE**self.inputs)

    def limited(self, degree: int) -> Series:
        found = {key: c for key, c in self.terms.items() if self.order(key) <= degree}
        return Series(self.inputs, degree, found)

    @property
    def real(self) -> arb:
        """The value at x = 0, s = 0."""
        start = self.terms.get(0, arb(0))
        return start if isinstance(start, arb) else start[0]

    # -- arithmetic ---------------------------------------------------------------------------

    def __add__(self, other: Any) -> Series:
        added = other.terms if isinstance(other, Series) else {0: other}
        found = dict(self.terms)
        for key, value in added.items():
            found[key] = found[key] + value if key in found else value
        return Series(self.inputs, self.degree, found)

    def __neg__(self) -> Series:
        return self * -1

    def __sub__(self, other: Any) -> Series:
        return self + -other

    def __rsub__(self, other: Any) -> Series:
        return -self + other

    def __mul__(self, other: Any) -> Series:
        if not isinstance(other, Series):
            return self._with({key: c * other for key, c in self.terms.items()})
        return self._times(other, self.degree)

    __radd__, __rmul__ = __add__, __mul__

    def _times(self, other: Series, degree: int) -> Series:
        """The terms of a product up to a degree."""
        found: dict[int, Any] = {}
        end = (degree + 1) * _BASE**self.inputs
        factors = sorted(other.terms.items())
        for first, a in self.terms.items():
            for second, b in factors:
                key = first + second
                if key >= end:
                    break
                found[key] = found[key] + a * b if key in found else a * b
        return self._with(found)

    def _with(self, terms: Mapping[int, Any]) -> Series:
        return Series(self.inputs, self.degree, terms)

    def __rtruediv__(self, other: Any) -> Series:
        return self._power(Fraction(-1), 1 / self._start()) * other

    # -- functions ----------------------------------------------------------------------------

    def _start(self) -> Any:
        """c_0, on which functions of the others are expanded."""
        return self.terms.get(0, arb(0))

    def _sum(self, factors: Callable[[int], Any]) -> Series:
        """The sum of factors(k) v^k, v the series without c_0."""
        rest = self._with({key: c for key, c in self.terms.items() if key})
        found = self._with({0: factors(self.degree)})
        for k in range(self.degree - 1, -1, -1):
            found = found._times(rest, self.degree - k) + factors(k)
        return found

    def _power(self, exponent: Fraction, start: Any) -> Series:
        """The power whose value for c_0 is known."""
        factors, inverse = [start], 1 / self._start()
        for k in range(self.degree):
            factors.append(factors[-1] * inverse * ball((exponent - k) / (k + 1)))
        return self._sum(lambda k: factors[k])

    def _along(self, start: Any, slope: Series) -> Series:
        """The function that is known for c_0, with its derivative on the series.

        With E the sum of s_k d/ds_k, E f(u) = f'(u) E u, and E multiplies terms by |nu|.
        """
        moved = self._with({key: self.order(key) * c for key, c in self.terms.items() if key})
        product = (slope * moved).terms
        found = {key: c * ball(Fraction(1, self.order(key))) for key, c in product.items()}
        return self._with({0: start} | found)

    def _cycle(self, derivatives: Sequence[Any]) -> Series:
        """The function whose derivatives at c_0 repeat."""
        shares = [arb(1)]
        for k in range(self.degree):
            shares.append(shares[-1] / (k + 1))
        return self._sum(lambda k: derivatives[k % len(derivatives)] * shares[k])

    def exp(self) -> Series:
        return self._cycle([self._start().exp()])

    def sin(self) -> Series:
        sine, cosine = self._start().sin(), self._start().cos()
        return self._cycle([sine, cosine, -sine, -cosine])

    def cos(self) -> Series:
        sine, cosine = self._start().sin(), self._start().cos()
        return self._cycle([cosine, -sine, -cosine, sine])

    def sqrt(self) -> Series:
        return self._power(Fraction(1, 2), self._start().sqrt())

    def rsqrt(self) -> Series:
        return self._power(Fraction(-1, 2), self._start().rsqrt())

    def log(self) -> Series:
        return self._along(self._start().log(), 1 / self)

    def atan(self) -> Series:
        return self._along(self._start().atan(), 1 / (self * self + 1))

    def asin(self) -> Series:
        return self._along(self._start().asin(), (1 - self * self).rsqrt())

    def erf(self) -> Series:
        slope = (-self * self).exp() * (2 / arb.pi().sqrt())
        return self._along(self._start().erf(), slope)


def term(value: Any, key: int) -> Any:
    """A term of a series, or of what has no other term than the first."""
    if isinstance(value, Series):
        return value.terms.get(key, arb(0))
    return arb(0) if key else value
