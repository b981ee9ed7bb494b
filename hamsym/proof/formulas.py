"""Symbolic expressions as straight-line programs on balls and Taylor series of balls.

Rationals, binary fractions, the float64 values of parameters, pi and e are exact up to the working
precision: in 1/3*y**3 the factor is the ball of 1/3, not a rounded float64 number.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from functools import partial

import sympy
from flint import arb, ctx, fmpq

from hamsym.errors import CertificationError
from hamsym.formula.printer import Printer
from hamsym.proof.balls import ball
from hamsym.proof.functions import (
    ELEMENTARY,
    Enclosed,
    SingularityError,
    general_power,
    reciprocal,
    reciprocal_root,
    root,
)
from hamsym.symbolic import derivatives
from hamsym.symbolic.exact import fraction

__all__ = ["Formulas", "require_smooth"]

_LONGEST_TEXT = 60  # of a subexpression in a message

# Kinks and jumps: the Taylor series that the proof rests on do not exist there.
_NOT_SMOOTH = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.DiracDelta)

#: A function, the register of its result, and the registers of its one or two arguments.
Step = tuple[Callable[..., Enclosed], int, int, int | None]


class Formulas:
    """Several expressions as one straight-line program.

    Parameters
    ----------
    expressions : sequence of sympy.Expr
    variables : sequence of sympy.Symbol
        Arguments of the formulas, in this order.
    parameters : mapping of sympy.Symbol to float
        Exact values.

    Raises
    ------
    CertificationError
        If an expression contains a function without an enclosure, or a symbol without a value.

    Examples
    --------
    >>> x, y = sympy.symbols("x y", real=True)
    >>> value, = Formulas([x**2 + y/3], [x, y])([arb(2), arb(1)])
    >>> value.contains(arb(13) / 3)
    True
    """

    def __init__(
        self,
        expressions: Sequence[sympy.Expr],
        variables: Sequence[sympy.Symbol],
        parameters: Mapping[sympy.Symbol, float] | None = None,
    ) -> None:
        for expression in expressions:
            require_smooth(expression)
        lower = Printer({}).lower
        lowered = [lower(expression) for expression in expressions]
        shared, reduced = derivatives.common_subexpressions(lowered, _shared_symbols())
        self._program = _Program(variables, parameters or {})
        for symbol, expression in shared:
            self._program.assign(symbol, expression)
        self._results = [self._program.register(expression) for expression in reduced]
        self._variables = len(variables)
        self._constants: dict[int, list[Enclosed]] = {}  # registers by precision

    def __call__(
        self, arguments: Sequence[Enclosed], apply: Callable[..., Enclosed] | None = None
    ) -> list[Enclosed]:
        """The values of the expressions, in their order.

        Parameters
        ----------
        arguments : sequence of arb or of arb_series
            One for each variable; anything else if ``apply`` is given.
        apply : callable, optional
            (function, *arguments) -> result, in place of ``function(*arguments)``.

        Raises
        ------
        SingularityError
            If the arguments contain a point where an expression is not smooth.
        """
        if ctx.prec not in self._constants:
            self._constants[ctx.prec] = self._program.constants()
        registers = self._constants[ctx.prec].copy()
        registers[: self._variables] = arguments
        steps = self._program.steps
        if apply is not None:
            steps = [(partial(apply, function), *rest) for function, *rest in steps]  # type: ignore[misc]
        self._program.run(steps, registers)
        return [registers[place] for place in self._results]


class _Program:
    """Registers and the steps that fill them, built from expressions.

    Attributes
    ----------
    steps : list of Step
        Steps that depend on the variables, whose registers are the first.
    """

    def __init__(
        self, variables: Sequence[sympy.Symbol], parameters: Mapping[sympy.Symbol, float]
    ) -> None:
        self.steps: list[Step] = []
        self._constant_steps: list[Step] = []
        self._literals: list[tuple[int, Callable[[], arb]]] = []
        self._parameters = {symbol: Fraction(value) for symbol, value in parameters.items()}
        self._registers: dict[sympy.Expr, int] = {s: k for k, s in enumerate(variables)}
        self._count = len(variables)
        self._constant: set[int] = set()
        self._powers: dict[tuple[int, int], int] = {}
        self._expressions: dict[int, sympy.Expr] = {}  # for messages

    # -- evaluation ------------------------------------------------------------------------

    def constants(self) -> list[Enclosed]:
        """Registers with the constants at the present precision."""
        registers: list[Enclosed] = [None] * self._count
        for place, make in self._literals:
            registers[place] = make()
        self.run(self._constant_steps, registers)
        return registers

    def run(self, steps: list[Step], registers: list[Enclosed]) -> None:
        """Fill registers step by step."""
        target = -1
        try:
            for function, target, first, second in steps:
                if second is None:
                    registers[target] = function(registers[first])
                else:
                    registers[target] = function(registers[first], registers[second])
        except (SingularityError, ZeroDivisionError, ValueError):
            text = str(self._expressions.get(target, "a term"))
            if len(text) > _LONGEST_TEXT:
                text = text[: _LONGEST_TEXT - 3] + "..."
            raise SingularityError(text) from None

    # -- translation -----------------------------------------------------------------------

    def assign(self, symbol: sympy.Symbol, expression: sympy.Expr) -> None:
        """Use a symbol for an expression from here on."""
        self._registers[symbol] = self.register(expression)

    def register(self, expression: sympy.Expr) -> int:
        """The register of an expression, with the steps that fill it."""
        known = self._registers.get(expression)
        if known is None:
            known = self._registers[expression] = self._translate(expression)
        return known

    def _translate(self, expression: sympy.Expr) -> int:
        literal = self._literal(expression)
        if literal is not None:
            return self._add_literal(literal)
        if expression.is_Add:
            return self._sum(expression)
        if expression.is_Mul:
            return self._product(expression)
        if expression.is_Pow:
            return self._power(expression)
        function = ELEMENTARY.get(type(expression))
        if function is None:
            raise _refusal(type(expression).__name__)
        return self._add(function, *map(self.register, expression.args), expression=expression)

    def _literal(self, expression: sympy.Expr) -> Callable[[], arb] | None:
        """A function that returns a number or a parameter at the present precision."""
        if expression.is_Rational:
            return lambda: arb(fmpq(int(expression.p), int(expression.q)))
        if expression.is_Float:
            exact = fraction(expression)
            return lambda: arb(fmpq(int(exact.p), int(exact.q)))
        if expression is sympy.pi:
            return arb.pi
        if expression is sympy.E:
            return arb.const_e
        if expression.is_Symbol:
            if expression not in self._parameters:
                raise CertificationError(f"'{expression}' has no value; give it one")
            value = self._parameters[expression]
            return lambda: ball(value)
        return None

    def _add_literal(self, make: Callable[[], arb]) -> int:
        place = self._new_register()
        self._literals.append((place, make))
        self._constant.add(place)
        return place

    def _new_register(self) -> int:
        self._count += 1
        return self._count - 1

    def _add(
        self,
        function: Callable[..., Enclosed],
        *arguments: int,
        expression: sympy.Expr | None = None,
    ) -> int:
        """Append a step; return the register of its result."""
        place = self._new_register()
        first, second = arguments[0], arguments[1] if len(arguments) == 2 else None
        constant = self._constant.issuperset(arguments)
        if constant:
            self._constant.add(place)
        (self._constant_steps if constant else self.steps).append((function, place, first, second))
        if expression is not None:
            self._expressions[place] = expression
        return place

    def _sum(self, expression: sympy.Expr) -> int:
        total: int | None = None
        for term in expression.args:
            negative = term.is_Mul and term.args[0].is_Rational and term.args[0] < 0
            place = self.register(-term if negative else term)
            if total is None:
                total = self._add(operator.neg, place) if negative else place
            else:
                total = self._add(operator.sub if negative else operator.add, total, place)
        assert total is not None
        return total

    def _product(self, expression: sympy.Expr) -> int:
        coefficient, rest = expression.as_coeff_Mul()
        if coefficient == -1:
            return self._add(operator.neg, self.register(rest))
        total: int | None = None
        for factor in expression.args:
            place = self.register(factor)
            total = place if total is None else self._add(operator.mul, total, place)
        assert total is not None
        return total

    def _power(self, expression: sympy.Expr) -> int:
        base, exponent = expression.args
        if base is sympy.E:
            exponential = ELEMENTARY[sympy.exp]
            return self._add(exponential, self.register(exponent), expression=expression)
        place, known = self.register(base), self._value(exponent)
        if known.is_Integer:
            if known < 0:
                # The reciprocal first: a power of a wide ball may reach zero where it does not.
                place = self._add(reciprocal, place, expression=expression)
            return self._integer_power(place, abs(int(known)))
        if known.is_Rational and known.q == 2:
            half = root if known > 0 else reciprocal_root
            return self._integer_power(
                self._add(half, place, expression=expression), abs(int(known.p))
            )
        return self._add(general_power, place, self.register(exponent), expression=expression)

    def _value(self, exponent: sympy.Expr) -> sympy.Expr:
        """An exponent with the exact values of its parameters and floating-point numbers."""
        values: dict[sympy.Basic, sympy.Expr] = {
            symbol: sympy.Rational(value.numerator, value.denominator)
            for symbol, value in self._parameters.items()
        }
        values |= {number: fraction(number) for number in exponent.atoms(sympy.Float)}
        return exponent.xreplace(values)

    def _integer_power(self, place: int, exponent: int) -> int:
        """A power by repeated multiplication: ``arb(0, 1)**2`` is not finite."""
        if exponent == 0:
            return self._add_literal(lambda: arb(1))
        if exponent == 1:
            return place
        if (place, exponent) not in self._powers:
            half = self._integer_power(place, exponent // 2)
            result = self._add(operator.mul, half, half)
            if exponent % 2:
                result = self._add(operator.mul, result, place)
            self._powers[place, exponent] = result
        return self._powers[place, exponent]


class _Shared(sympy.Symbol):  # type: ignore[misc]
    """A common subexpression; a class of its own keeps it distinct from every variable."""


def _shared_symbols() -> Iterator[sympy.Symbol]:
    count = 0
    while True:
        yield _Shared(f"shared{count}")
        count += 1


def require_smooth(expression: sympy.Expr) -> None:
    """Refuse an expression with a function that is not smooth.

    Raises
    ------
    CertificationError
        Naming the function.
    """
    for kind in _NOT_SMOOTH:
        if expression.has(kind):
            raise _refusal(kind.__name__)


def _refusal(name: str) -> CertificationError:
    shown = {"Abs": "abs", "Min": "min", "Max": "max"}.get(name, name)
    return CertificationError(
        f"H or its derivatives contain '{shown}', which has no enclosure by Taylor series; "
        "a proof needs H in smooth functions"
    )
