"""Formulas as polynomials in generators: symbols, roots, inverses, exponentials, angles and logs.

Sums in exponents and angles are taken apart, so that exp(x - y) and exp(y - z) have the generators
exp(x), exp(y) and exp(z), and cos(a - b) those of a and b.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from hamsym.errors import InputError
from hamsym.symbolic.exact import fraction

_MOST_MULTIPLE = 24  # of an angle or an exponent
_MOST_EXPANDED = 20_000  # terms of a rewritten formula
_FREE = (*(sympy.erf, sympy.asin, sympy.acos, sympy.atan), *(sympy.asinh, sympy.acosh, sympy.atanh))
_HYPERBOLIC = (sympy.sinh, sympy.cosh, sympy.tanh, sympy.coth)


class UnsupportedFunctionError(InputError):
    """A formula with a function that has no exact rules here."""


@dataclass(frozen=True)
class Generator:
    """A generator: its kind, and what its relation and its derivative are made of.

    ``parts`` are formulas in earlier generators: the radicand of a root, the inverted element, the
    argument of a function, and for a free function also its derivative.
    """

    kind: str
    parts: tuple[sympy.Expr, ...] = ()
    order: int = 1
    partner: sympy.Symbol | None = None


class Generators:
    """The generators of given formulas, and the formulas in terms of them.

    Raise UnsupportedFunctionError if a formula has a function without exact rules.

    - z: The state, which has the first generators.
    - of: In an order in which relations contain earlier generators only.
    - formulas: The formulas, with a symbol for each generator.

    Examples
    --------
    >>> x, y, p = sympy.symbols("x y p", real=True)
    >>> found = Generators((x, p), None, [p / sympy.sqrt(x**2 + y**2)])
    >>> [generator.kind for generator in found.of.values()]
    ['state', 'state', 'parameter', 'root', 'inverse']
    >>> found.formula(found.formulas[0])
    p/sqrt(x**2 + y**2)
    """

    def __init__(
        self, z: Sequence[sympy.Symbol], time: sympy.Symbol | None, formulas: Iterable[sympy.Expr]
    ) -> None:
        wanted = list(formulas)
        self._units: dict[sympy.Expr, int] = {}
        self._names: dict[tuple[Any, ...], sympy.Symbol] = {}  # the same in both passes
        # The first pass finds the units of angles and exponents, the second one uses them.
        for _ in range(2):
            self.of: dict[sympy.Symbol, Generator] = {symbol: Generator("state") for symbol in z}
            if time is not None:
                self.of[time] = Generator("time")
            self._found: dict[tuple[Any, ...], sympy.Symbol] = {}
            self._rewritten: dict[sympy.Expr, sympy.Expr] = {}
            self.formulas = [self._rewrite(expr) for expr in wanted]

    def named(self, kind: str, parts: tuple[sympy.Expr, ...]) -> sympy.Symbol:
        """The symbol of a generator that exists."""
        return self._found[kind, parts, 1, None]

    def _rewrite(self, expr: sympy.Expr) -> sympy.Expr:
        """Return the formula with a symbol for each generator."""
        if expr not in self._rewritten:
            self._rewritten[expr] = self._rewritten_node(expr)
        return self._rewritten[expr]

    def _rewritten_node(self, expr: sympy.Expr) -> sympy.Expr:
        if expr.is_Symbol:
            if expr not in self.of:
                self.of[expr] = Generator("parameter")
            return expr
        if expr.is_Rational:
            return expr
        if expr.is_Float:
            return fraction(expr)
        if expr.is_Add or expr.is_Mul:
            return expr.func(*(self._rewrite(part) for part in expr.args))
        if expr.is_Pow and expr.base is not sympy.E:
            return self._power(expr.base, expr.exp)
        if isinstance(expr, sympy.exp) or expr.is_Pow:
            return self._exponential(self._rewrite(expr.exp))
        if isinstance(expr, sympy.Abs):
            return self._root(self._rewrite(expr.args[0]) ** 2, 2)
        if isinstance(expr, sympy.log):
            return self._logarithm(expr.args[0])
        if isinstance(expr, sympy.sin | sympy.cos):
            return self._circular(expr.args[0])[isinstance(expr, sympy.sin)]
        if isinstance(expr, sympy.tan):
            cos, sin = self._circular(expr.args[0])
            return sin * self.inverse(cos)
        if isinstance(expr, _HYPERBOLIC):
            return self._rewrite(expr.rewrite(sympy.exp))
        if isinstance(expr, _FREE):
            slope = self._rewrite(expr.fdiff())
            return self._generator("free", (self._rewrite(expr.args[0]), slope), mark=expr.func)
        if isinstance(expr, sympy.NumberSymbol):
            return self._generator("constant", (), mark=expr)
        raise UnsupportedFunctionError(
            f"'{str(expr)[:40]}' has no exact rules here; use polynomials, powers, exp, log and "
            "trigonometric or hyperbolic functions"
        )

    def _generator(
        self,
        kind: str,
        parts: tuple[sympy.Expr, ...],
        order: int = 1,
        mark: object = None,
        partner: sympy.Symbol | None = None,
    ) -> sympy.Symbol:
        key = (kind, parts, order, mark)
        if key not in self._found:
            symbol = self._names.setdefault(key, sympy.Dummy(kind, real=True))
            self._found[key] = symbol
            self.of[symbol] = Generator(kind, parts, order, partner)
        return self._found[key]

    def _power(self, base: sympy.Expr, exponent: sympy.Expr) -> sympy.Expr:
        rational, rest = exponent.as_coeff_Add()
        if rational.is_Float:
            rational = fraction(rational)
        if not rational.is_Rational:
            rational, rest = sympy.Integer(0), exponent
        factor = sympy.Integer(1)
        if rest != 0:
            factor = self._exponential(sympy.expand(self._rewrite(rest) * self._logarithm(base)))
        if max(abs(rational.p), rational.q) > _MOST_MULTIPLE:
            raise UnsupportedFunctionError(
                f"the exponent {rational} is too large for an exact search; use one with a "
                f"numerator and a denominator of at most {_MOST_MULTIPLE}"
            )
        own = self._root(self._rewrite(base), rational.q)
        if rational < 0:
            own = self.inverse(own)
        return factor * own ** abs(rational.p)

    def _root(self, element: sympy.Expr, order: int) -> sympy.Expr:
        element = self._expanded(element)
        if order == 1 or element in (0, 1):
            return element
        while order % 2 == 0 and order > 2:
            element, order = self._root(element, 2), order // 2
        symbol = self._generator("root", (element,), order)
        self.inverse(symbol)  # in the derivative
        return symbol

    def inverse(self, element: sympy.Expr) -> sympy.Expr:
        """Return the inverse, of each factor by itself."""
        if element.is_Rational:
            return 1 / element
        if element.is_Mul:
            return sympy.Mul(*(self.inverse(factor) for factor in element.args))
        if element.is_Pow and element.exp.is_Integer:
            return self.inverse(element.base) ** element.exp
        content, primitive = self._expanded(element).primitive()
        if primitive.could_extract_minus_sign():
            content, primitive = -content, -primitive
        if not primitive.is_Add and not primitive.is_Symbol:
            return self.inverse(primitive) / content
        kind = self.of.get(primitive)
        if kind is not None and kind.kind == "inverse":
            return kind.parts[0] / content
        return self._generator("inverse", (primitive,)) / content

    def _logarithm(self, base: sympy.Expr) -> sympy.Expr:
        if base.is_Pow and base.exp.is_Rational:
            return base.exp * self._logarithm(base.base)
        element = self._expanded(self._rewrite(base))
        if element == 1:
            return sympy.Integer(0)
        self.inverse(element)  # in the derivative
        return self._generator("log", (element,))

    def _multiples(self, argument: sympy.Expr) -> list[tuple[sympy.Expr, int, int]]:
        """Return the terms of an argument: (term, multiple, unit), in units of term/unit."""
        found = []
        for summand in sympy.Add.make_args(self._expanded(argument)):
            number, term = summand.as_coeff_Mul()
            unit = self._units[term] = math.lcm(self._units.get(term, 1), int(number.q))
            multiple = int(number * unit)
            if max(abs(multiple), unit) > _MOST_MULTIPLE:
                raise UnsupportedFunctionError(
                    f"the multiple {number} in an exponent or an angle is too large for an exact "
                    "search; use small integers and fractions, or parameters"
                )
            found.append((term, multiple, unit))
        return found

    def _exponential(self, argument: sympy.Expr) -> sympy.Expr:
        value = sympy.Integer(1)
        for term, multiple, unit in self._multiples(argument) if argument != 0 else ():
            symbol = self._generator("exp", (term / unit,))
            value *= (symbol if multiple > 0 else self.inverse(symbol)) ** abs(multiple)
        return value

    def _circular(self, argument: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr]:
        """Return the cosine and the sine of an argument, by the angles of its terms."""
        cos, sin = sympy.Integer(1), sympy.Integer(0)
        own = self._rewrite(argument)
        for term, multiple, unit in self._multiples(own) if own != 0 else ():
            c = self._generator("cos", (term / unit,))
            s = self._generator("sin", (term / unit,), partner=c)
            for _ in range(abs(multiple)):
                side = s if multiple > 0 else -s
                cos, sin = cos * c - sin * side, sin * c + cos * side
                cos, sin = self._expanded(cos), self._expanded(sin)
        return cos, sin

    def _expanded(self, element: sympy.Expr) -> sympy.Expr:
        found = sympy.expand(element)
        if len(sympy.Add.make_args(found)) > _MOST_EXPANDED:
            raise UnsupportedFunctionError(
                f"a part of the formula has more than {_MOST_EXPANDED:,} terms when multiplied "
                "out; use a simpler formula"
            )
        return found

    def with_fractions(self, element: sympy.Expr) -> sympy.Expr:
        """Return an expression in generators with fractions in place of inverses."""
        values: dict[sympy.Symbol, sympy.Expr] = {}
        for symbol, generator in self.of.items():
            if generator.kind == "inverse":
                values[symbol] = 1 / generator.parts[0].xreplace(values)
        return element.xreplace(values)

    def formula(self, element: sympy.Expr) -> sympy.Expr:
        """Return an expression in generators as a formula."""
        values: dict[sympy.Symbol, sympy.Expr] = {}
        for symbol, generator in self.of.items():
            parts = [part.xreplace(values) for part in generator.parts]
            match generator.kind:
                case "root":
                    values[symbol] = parts[0] ** sympy.Rational(1, generator.order)
                case "inverse":
                    values[symbol] = 1 / parts[0]
                case "exp" | "cos" | "sin" | "log":
                    values[symbol] = getattr(sympy, generator.kind)(parts[0])
                case "free" | "constant":
                    mark = next(key[3] for key, own in self._found.items() if own == symbol)
                    values[symbol] = mark(parts[0]) if parts else mark
        return element.xreplace(values)
