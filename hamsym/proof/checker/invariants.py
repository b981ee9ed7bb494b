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
        #: Roots of an argument by their index, and functions of one, with the sine of a cosine.
        self._roots: dict[str, dict[int, _Quotient]] = {}
        self._known: dict[tuple[str, str, str], _Quotient] = {}

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
        roots, m = self._roots.setdefault(str(base), {}), exponent.denominator
        index = next((n for n in roots if n % m == 0), None)
        if index is None:
            index = math.lcm(m, 2)  # of square roots and others of one base
            roots[index] = self._generators[k], self._one
            self._relations.append((k, index, base))
        return self._power(roots[index], exponent.numerator * (index // m))

    def _function(self, k: int, name: str, argument: _Quotient) -> _Quotient:
        """A generator, or the image of one: exp(-a) = 1/exp(a), sin(-a) = -sin(a)."""
        a, b = argument
        turned = name in ("exp", "sin", "cos") and str(a).startswith("-")
        key = "sin" if name == "cos" else name, str(-a if turned else a), str(b)
        if key not in self._known:
            self._known[key] = self._generators[k], self._generators[len(self._operations) + k]
            if key[0] == "sin":
                cosine, place = self._generators[k], len(self._operations) + k
                self._relations.append((place, 2, (1 - cosine**2, self._one)))
        found, sine = self._known[key]
        if name == "sin":
            found = -sine if turned else sine
        return self._power((found, self._one), -1 if name == "exp" and turned else 1)

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
