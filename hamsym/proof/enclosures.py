"""Symbolic expressions in ball arithmetic: what encloses H, J grad H and Hess without doubt.

Input:  a Hamiltonian, whose expressions are walked node by node, never turned into floating-point
        code: in 1/3*y**3 the third must stay a third.
Output: functions of balls (``arb``) or of truncated Taylor series with ball coefficients
        (``arb_series``).

Rationals, binary fractions, the float64 values of parameters, pi and e are exact, to the working
precision. A result contains the value, or each Taylor coefficient, for every choice of numbers in
the balls that went in. Where those reach a point at which a function is not smooth (a zero of a
divisor, the branch point of a root) there is no result at all: :class:`SingularityError` names the
subexpression.
"""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import Any

import sympy
from flint import arb, ctx, fmpq

from hamsym.errors import CertificationError
from hamsym.formula.parser import MAX_EXPONENT
from hamsym.formula.printer import Printer
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.balls import ball
from hamsym.proof.functions import (
    _FUNCTIONS,
    Enclosed,
    SingularityError,
    _general_power,
    _negative,
    _reciprocal,
    _reciprocal_root,
    _root,
)
from hamsym.symbolic import derivatives

__all__ = ["Enclosures", "Formulas"]


_LONGEST_TEXT = 60  # of a subexpression in a message


# -- functions of balls and of series -----------------------------------------------------------


# Kinks and jumps: the Taylor series that the proof rests on do not exist there.
_NOT_SMOOTH = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.DiracDelta)


# -- formulas -----------------------------------------------------------------------------------


class Formulas:
    """Several expressions as one sequence of operations on balls or series.

    Parameters
    ----------
    expressions : sequence of sympy.Expr
    variables : sequence of sympy.Symbol
        What the formulas are called with, in this order.
    parameters : mapping of sympy.Symbol to float
        Values that are exact.

    Raises
    ------
    CertificationError
        If an expression contains something that has no enclosure here.

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
        parameters: dict[sympy.Symbol, float] | None = None,
    ) -> None:
        self._parameters = parameters or {}
        self._registers: dict[sympy.Expr, int] = {}
        self._powers: dict[tuple[int, int], int] = {}
        self._literals: list[tuple[int, Callable[[], arb]]] = []
        self._fixed: list[tuple[Callable[..., Enclosed], int, int, int]] = []
        self._steps: list[tuple[Callable[..., Enclosed], int, int, int]] = []
        self._texts: dict[int, sympy.Expr] = {}
        self._constant: set[int] = set()
        self._count = len(variables)
        for place, symbol in enumerate(variables):
            self._registers[symbol] = place
        self._variables = len(variables)
        lowered = [_smooth(expression) for expression in expressions]
        shared, reduced = derivatives.common_subexpressions(lowered, map(_Shared, _numbers()))
        for symbol, expression in shared:
            self._registers[symbol] = self._place(expression)
        self._results = [self._place(expression) for expression in reduced]
        self._values: dict[int, list[Enclosed]] = {}

    def __call__(self, arguments: Sequence[Enclosed]) -> list[Enclosed]:
        """The values of the expressions, in their order.

        Parameters
        ----------
        arguments : sequence of arb or of arb_series
            One for each variable.

        Raises
        ------
        SingularityError
            If the arguments reach a point where an expression is not smooth.
        """
        registers = self._constants()
        registers[: self._variables] = arguments
        self._run(self._steps, registers)
        return [registers[place] for place in self._results]

    def _constants(self) -> list[Enclosed]:
        """Registers with the constants at the present precision."""
        values = self._values.get(ctx.prec)
        if values is None:
            values = [None] * self._count
            for place, make in self._literals:
                values[place] = make()
            self._run(self._fixed, values)
            self._values[ctx.prec] = values
        return values.copy()

    def _run(
        self, steps: list[tuple[Callable[..., Enclosed], int, int, int]], registers: list[Enclosed]
    ) -> None:
        target = -1
        try:
            for function, target, first, second in steps:
                registers[target] = function(registers[first], registers[second])
        except (SingularityError, ZeroDivisionError, ValueError):
            text = str(self._texts.get(target, "a term"))
            if len(text) > _LONGEST_TEXT:
                text = text[: _LONGEST_TEXT - 3] + "..."
            raise SingularityError(text) from None

    # -- from a tree to operations ---------------------------------------------------------

    def _place(self, expression: sympy.Expr) -> int:
        """The register that holds an expression."""
        known = self._registers.get(expression)
        if known is None:
            known = self._registers[expression] = self._new_place(expression)
        return known

    def _new_place(self, expression: sympy.Expr) -> int:
        literal = self._literal(expression)
        if literal is not None:
            return self._new_literal(literal)
        if expression.is_Add:
            return self._sum(expression)
        if expression.is_Mul:
            return self._product(expression)
        if expression.is_Pow:
            return self._power(expression)
        function = _FUNCTIONS.get(type(expression))
        if function is None:
            raise _refusal(type(expression).__name__)
        return self._call(function, expression, *map(self._place, expression.args))

    def _literal(self, expression: sympy.Expr) -> Callable[[], arb] | None:
        """What makes the value of a number or a parameter at the present precision."""
        if expression.is_Rational:
            return lambda: arb(fmpq(int(expression.p), int(expression.q)))
        if expression.is_Float:
            number = _of_float(expression)
            return lambda: ball(number)
        if expression is sympy.pi:
            return arb.pi
        if expression is sympy.E:
            return arb.const_e
        if expression.is_Symbol:
            if expression not in self._parameters:
                raise CertificationError(f"'{expression}' has no value; give it one")
            value = Fraction(self._parameters[expression])
            return lambda: ball(value)
        return None

    def _new_literal(self, make: Callable[[], arb]) -> int:
        place = self._next_place()
        self._literals.append((place, make))
        self._constant.add(place)
        return place

    def _next_place(self) -> int:
        self._count += 1
        return self._count - 1

    def _call(
        self,
        function: Callable[..., Enclosed],
        expression: sympy.Expr | None,
        first: int,
        second: int | None = None,
    ) -> int:
        second = first if second is None else second
        place = self._next_place()
        constant = {first, second} <= self._constant
        (self._fixed if constant else self._steps).append((function, place, first, second))
        if constant:
            self._constant.add(place)
        if expression is not None:
            self._texts[place] = expression
        return place

    def _sum(self, expression: sympy.Expr) -> int:
        total: int | None = None
        for term in expression.args:
            negative = term.is_Mul and term.args[0].is_Rational and term.args[0] < 0
            place = self._place(-term if negative else term)
            if total is None:
                total = self._call(_negative, None, place) if negative else place
            else:
                total = self._call(operator.sub if negative else operator.add, None, total, place)
        assert total is not None
        return total

    def _product(self, expression: sympy.Expr) -> int:
        coefficient, rest = expression.as_coeff_Mul()
        if coefficient == -1:
            return self._call(_negative, None, self._place(rest))
        total: int | None = None
        for factor in expression.args:
            place = self._place(factor)
            total = place if total is None else self._call(operator.mul, None, total, place)
        assert total is not None
        return total

    def _power(self, expression: sympy.Expr) -> int:
        base, exponent = expression.args
        known = exponent.xreplace(
            {symbol: _rational(value) for symbol, value in self._parameters.items()}
        )
        if base is sympy.E:
            return self._call(_FUNCTIONS[sympy.exp], expression, self._place(exponent))
        place = self._place(base)
        if known.is_Float:
            known = sympy.Rational(*_of_float(known).as_integer_ratio())
        if known.is_Integer:
            if known < 0:
                # The reciprocal first: a power of a wide ball may reach zero where it does not.
                inverse = self._call(_reciprocal, expression, place)
                return self._integer_power(inverse, -int(known))
            return self._integer_power(place, int(known))
        if known.is_Rational and known.q == 2:
            root = self._call(_root if known > 0 else _reciprocal_root, expression, place)
            return self._integer_power(root, abs(int(known.p)))
        return self._call(_general_power, expression, place, self._place(exponent))

    def _integer_power(self, place: int, exponent: int) -> int:
        """By repeated multiplication: arb(0, 1)**2 is no ball at all."""
        if exponent == 0:
            return self._new_literal(lambda: arb(1))
        if exponent == 1:
            return place
        if (place, exponent) not in self._powers:
            half = self._integer_power(place, exponent // 2)
            result = self._call(operator.mul, None, half, half)
            if exponent % 2:
                result = self._call(operator.mul, None, result, place)
            self._powers[place, exponent] = result
        return self._powers[place, exponent]


class _Shared(sympy.Symbol):  # type: ignore[misc]
    """A common subexpression; of a class of its own, so that no variable has its name."""


def _numbers() -> Any:
    count = 0
    while True:
        yield f"shared{count}"
        count += 1


def _of_float(number: sympy.Float) -> Fraction:
    sign, mantissa, exponent, _ = number._mpf_
    value = Fraction(int(mantissa)) * Fraction(2) ** int(exponent)
    return -value if sign else value


def _fraction(number: sympy.Float) -> sympy.Rational:
    value = _of_float(number)
    return sympy.Rational(value.numerator, value.denominator)


def _rational(value: float) -> sympy.Rational:
    return sympy.Rational(*Fraction(value).as_integer_ratio())


def _with_whole_powers(expression: sympy.Expr, values: dict[sympy.Symbol, float]) -> sympy.Expr:
    """An expression with those exponents as numbers that parameters make whole.

    A derivative of x**n is smooth at x = 0 for n = 1, but n*(n - 1)*x**(n - 2) is not.
    """
    numbers = {symbol: _rational(value) for symbol, value in values.items()}

    def whole(power: sympy.Expr) -> sympy.Expr:
        exponent = power.exp.xreplace(numbers)
        known = exponent.is_Integer and abs(exponent) <= MAX_EXPONENT
        return power.base**exponent if known else power

    return expression.replace(lambda node: node.is_Pow and node.exp.free_symbols, whole)


def _smooth(expression: sympy.Expr) -> sympy.Expr:
    """An expression in the functions that have enclosures."""
    for kind in _NOT_SMOOTH:
        if expression.has(kind):
            raise _refusal(kind.__name__)
    return Printer({}).lower(expression)


def _refusal(name: str) -> CertificationError:
    shown = {"Abs": "abs", "Min": "min", "Max": "max"}.get(name, name)
    return CertificationError(
        f"H or its derivatives contain '{shown}', for which there is no enclosure of Taylor "
        "series; nothing can be proven unless H is written with smooth functions"
    )


class Enclosures:
    """H, its vector field and its Hessian in ball arithmetic.

    Parameters
    ----------
    H : Hamiltonian
        With a value for every parameter.

    Raises
    ------
    CertificationError
        If H contains a function that is not smooth or has no enclosure.

    Examples
    --------
    >>> H = Enclosures(Hamiltonian("p**2/2 + x**2/2 + x**4/4"))
    >>> rate = H.vector_field([arb(2), arb(1)], arb(0))
    >>> [entry.str(5) for entry in rate]
    ['1.0000', '-10.000']
    """

    def __init__(self, H: Hamiltonian) -> None:
        H.require_parameters()
        form = H.real_equations
        for kind in _NOT_SMOOTH:  # whose derivatives may have lost it
            if form.expr.has(kind):
                raise _refusal(kind.__name__)
        # Differentiating would round floating-point numbers; as fractions they stay what they are.
        exact: dict[sympy.Basic, sympy.Expr] = {
            number: _fraction(number) for number in form.expr.atoms(sympy.Float)
        }
        values = {symbol: value for symbol, value in form.parameters.values() if value is not None}
        expr = _with_whole_powers(form.expr.xreplace(exact), values)
        effort = derivatives.Effort(expr)
        slopes = derivatives.gradient(expr, form.z, effort)
        second = derivatives.hessian(slopes, form.z, effort)
        rates = [*slopes[form.dof :], *(-slope for slope in slopes[: form.dof])]
        time = form.time or sympy.Dummy("t")
        variables = (*form.z, time)
        self.dim, self.time_dependent = H.dim, H.time is not None
        self._energy = Formulas([expr], variables, values)
        self._vector_field = Formulas(rates, variables, values)
        self._places = [index for index in second if index[0] <= index[1]]
        self._hessian = Formulas([second[index] for index in self._places], variables, values)

    def energy(self, z: Sequence[Enclosed], t: Enclosed) -> Enclosed:
        """H at balls, or along series, of the components of z and of t."""
        return self._energy([*z, t])[0]

    def vector_field(self, z: Sequence[Enclosed], t: Enclosed) -> list[Enclosed]:
        """J grad H, dim entries."""
        return self._vector_field([*z, t])

    def hessian(self, z: Sequence[Enclosed], t: Enclosed) -> dict[tuple[int, int], Enclosed]:
        """The entries (i, j), i <= j, of the second derivatives that do not vanish."""
        return dict(zip(self._places, self._hessian([*z, t]), strict=True))
