"""Power series in x and in s_1 .. s_d: sums over nu of c_nu(x) s^nu with |nu| up to a degree.

The exponents nu are one number, the sum of nu_k (B^k + B^d): the sum of two of these numbers
belongs to the product, and the multiple of B^d is |nu|. Coefficients c_nu are numbers or power
series in x; those of products and of functions are exact, with everything beyond the degree left
out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import combinations_with_replacement
from typing import Any

from flint import arb

from hamsym.proof.checker.formulas import NotProvenError

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

    def _order(self, key: int) -> int:
        """|nu| of a term."""
        return int(key // _BASE**self.inputs)

    @property
    def real(self) -> arb:
        """The value at x = 0, s = 0."""
        return arb(0) + (self.start if isinstance(self.start, arb) else self.start[0])

    @property
    def start(self) -> Any:
        """c_0."""
        return self.terms.get(0, arb(0))

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
        """The product, up to the degree of the one that has the smaller one."""
        if not isinstance(other, Series):
            found = {key: c * other for key, c in self.terms.items()}
            return Series(self.inputs, self.degree, found)
        found, degree = {}, min(self.degree, other.degree)
        end = (degree + 1) * _BASE**self.inputs
        factors = sorted(other.terms.items())
        for first, a in self.terms.items():
            for second, b in factors:
                key = first + second
                if key >= end:
                    break
                found[key] = found[key] + a * b if key in found else a * b
        return Series(self.inputs, degree, found)

    __radd__, __rmul__ = __add__, __mul__

    # -- functions ----------------------------------------------------------------------------

    def _along(self, start: Any, slope: Callable[[Series], Series]) -> Series:
        """The function f(u) that is known for c_0, with its derivative f'.

        With E the sum of s_k d/ds_k, E f(u) = f'(u) E u, and E multiplies terms by |nu|, so that a
        degree less of f'(u) is enough.
        """
        found = {0: start}
        if self.degree:
            end = self.degree * _BASE**self.inputs
            lower = {key: c for key, c in self.terms.items() if key < end}
            factor = slope(Series(self.inputs, self.degree - 1, lower))
            moved = {key: self._order(key) * c for key, c in self.terms.items() if key}
            product = Series(self.inputs, self.degree, factor.terms) * Series(
                self.inputs, self.degree, moved
            )
            found |= {key: c / self._order(key) for key, c in product.terms.items()}
        return Series(self.inputs, self.degree, found)

    def __rtruediv__(self, other: Any) -> Series:
        return self._along(1 / self.start, _slope_of_inverse) * other

    def exp(self) -> Series:
        return self._along(self.start.exp(), Series.exp)

    def sin(self) -> Series:
        return self._along(self.start.sin(), Series.cos)

    def cos(self) -> Series:
        return self._along(self.start.cos(), lambda u: -u.sin())

    def log(self) -> Series:
        return self._along(self.start.log(), lambda u: 1 / u)

    def sqrt(self) -> Series:
        return (self.log() * arb(0.5)).exp()

    def rsqrt(self) -> Series:
        return (self.log() * arb(-0.5)).exp()

    def atan(self) -> Series:
        return self._along(self.start.atan(), lambda u: 1 / (u * u + 1))

    def asin(self) -> Series:
        return self._along(self.start.asin(), lambda u: (1 - u * u).rsqrt())

    def erf(self) -> Series:
        factor = 2 / arb.pi().sqrt()
        return self._along(self.start.erf(), lambda u: (-u * u).exp() * factor)


def _slope_of_inverse(u: Series) -> Series:
    inverse = 1 / u
    return -(inverse * inverse)


def term(value: Any, key: int) -> Any:
    """A term of a series, or of what has no other term than the first."""
    if isinstance(value, Series):
        return value.terms.get(key, arb(0))
    return arb(0) if key else value
