"""Invariants: df/dt = 0 along every trajectory, as an identity of rational functions.

So f is constant as long as it is smooth along the trajectory: the arc tangent of p/x jumps where x
is zero.

The variables, parameters and pi, each function of an argument, and each root are generators of a
polynomial ring over the rational numbers, with the relations sin^2 + cos^2 = 1, exp(a) exp(-a) = 1
and (a^(1/m))^m = a. If the numerator of df/dt becomes zero by these relations, the identity is
proven; if not, nothing is concluded.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from flint import fmpq, fmpq_mpoly, fmpq_mpoly_ctx

from hamsym.proof.checker.formulas import Formulas, NotProvenError, refusing_other_forms
from hamsym.proof.checker.functions import Equations

_BITS = 64  # of numbers that are not used
_Quotient = tuple[fmpq_mpoly, fmpq_mpoly]


def check_invariant(H: Mapping[str, Any], free: Sequence[str], f: Mapping[str, Any]) -> None:
    """Prove that f is constant along every trajectory on which it is smooth, or raise.

    - H: Its parameters are those that have a value.
    - free: All other parameters.
    - f: "formula" and "floats".

    Raises
    ------
    NotProvenError
    """
    with refusing_other_forms(_BITS):
        equations = Equations(H, free)
        formulas, dim = equations.formulas, equations.dim
        place = formulas.read(f)
        *slopes, rate = formulas.gradient(place, dim + 1)
        for slope, velocity in zip(slopes, equations.rates, strict=True):
            rate = formulas.add(rate, formulas.multiply(slope, velocity))
        if not vanishes(formulas, rate):
            raise NotProvenError("its claim that the invariant is conserved is not proven")


def vanishes(formulas: Formulas, place: int) -> bool:
    """Whether an operation is proven to be zero for all values of the variables."""
    return _Ring(formulas, place).vanishes()


class _Ring:
    """Quotients of polynomials in generators, one for each operation that may need one."""

    def __init__(self, formulas: Formulas, place: int) -> None:
        self._operations = formulas.operations[: place + 1]
        self._needed = formulas.needed([place])
        self._place = place
        names = [f"g{k}" for k in range(2 * (place + 1))]
        self._context = fmpq_mpoly_ctx.get(tuple(names), "lex")
        self._generators = self._context.gens()
        self._one = self._context.constant(1)
        #: Generator, its power, and what that power is, in the order in which they were made.
        self._relations: list[tuple[int, int, _Quotient]] = []
        self._known: list[tuple[str, _Quotient, Any]] = []

    def vanishes(self) -> bool:
        values: dict[int, _Quotient] = {}
        for k in sorted(self._needed):
            name, *arguments = self._operations[k]
            if name == "number":
                value = fmpq(arguments[0].numerator, arguments[0].denominator)
                values[k] = self._context.constant(value), self._one
            elif name in ("variable", "pi"):
                values[k] = self._generators[k], self._one
            elif name in ("+", "*"):
                (a, b), (c, d) = (values[i] for i in arguments)
                found = (a * d + b * c, b * d) if name == "+" else (a * c, b * d)
                values[k] = self._lowest(found)
            elif name == "**":
                values[k] = self._root(k, values[arguments[0]], arguments[1])
            else:
                values[k] = self._function(k, name, values[arguments[0]])
        return self._reduced(values[self._place][0]).is_zero()

    def _lowest(self, value: _Quotient) -> _Quotient:
        common = value[0].gcd(value[1])
        return value[0] / common, value[1] / common

    def _power(self, value: _Quotient, exponent: int) -> _Quotient:
        a, b = value if exponent > 0 else value[::-1]
        if self._reduced(b).is_zero():
            raise NotProvenError("the invariant has a denominator that is zero")
        return a ** abs(exponent), b ** abs(exponent)

    def _root(self, k: int, base: _Quotient, exponent: Fraction) -> _Quotient:
        if exponent.denominator == 1:
            return self._power(base, int(exponent))
        m = exponent.denominator
        for name, known, found in self._known:
            if known == base and name.startswith("root") and int(name[4:]) % m == 0:
                return self._power(found, exponent.numerator * (int(name[4:]) // m))
        m = math.lcm(m, 2)  # of square roots and others of one base
        self._relations.append((k, m, base))
        found = self._generators[k], self._one
        self._known.append((f"root{m}", base, found))
        return self._power(found, exponent.numerator * (m // exponent.denominator))

    def _function(self, k: int, name: str, argument: _Quotient) -> _Quotient:
        if name == "cos":  # before sin, whose square is 1 - cos^2
            return self._pair(k, argument)[0]
        if name == "sin":
            return self._pair(k, argument)[1]
        for known, other, found in self._known:
            if known == name and other == argument:
                return found
            if known == name == "exp" and (-other[0], other[1]) == argument:
                return self._power(found, -1)
        found = self._generators[k], self._one
        self._known.append((name, argument, found))
        return found

    def _pair(self, k: int, argument: _Quotient) -> tuple[_Quotient, _Quotient]:
        """The cosine and the sine of an argument, or of minus one that is known."""
        for known, other, (c, s) in self._known:
            if known == "cos" and other == argument:
                return c, s
            if known == "cos" and (-other[0], other[1]) == argument:
                return c, (-s[0], s[1])
        c, s = self._generators[k], self._generators[len(self._operations) + k]
        self._relations.append((len(self._operations) + k, 2, (1 - c**2, self._one)))
        found = (c, self._one), (s, self._one)
        self._known.append(("cos", argument, found))
        return found

    def _reduced(self, polynomial: fmpq_mpoly) -> fmpq_mpoly:
        """The polynomial by the relations, times a denominator that is not zero."""
        for g, m, (a, b) in reversed(self._relations):
            parts: dict[int, dict[tuple[int, ...], fmpq]] = {}
            for powers, c in polynomial.to_dict().items():
                rest = (*powers[:g], powers[g] % m, *powers[g + 1 :])
                parts.setdefault(powers[g] // m, {})[rest] = c
            most = max(parts, default=0)
            rows = [self._context.from_dict(p) * a**n * b ** (most - n) for n, p in parts.items()]
            polynomial = sum(rows, self._context.constant(0))
        return polynomial
