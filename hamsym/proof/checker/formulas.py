"""Formulas as lists of operations, with their derivatives, for balls and for power series of balls.

Text is parsed with Python's own ``ast`` and a whitelist. Each operation is stored once. Derivatives
are made by reverse accumulation, which appends operations, so that they can be differentiated
again. Numbers are exact fractions, so that what is zero is known to be zero.

Values are those of real numbers, of power series, or of complex numbers; where every operation has
a finite value in a ball of arguments, all of them are analytic there.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from decimal import Decimal
from fractions import Fraction
from typing import Any

from flint import acb, arb, arb_series, ctx, fmpq

# A keyword of Python that is a name in physics, and the name under which it is parsed.
_KEYWORD, _STAND_IN = "lambda", "lambda__"
_LARGEST_POWER = 1_000
# Power of ten of a number that is written out, and bits of a power of a number.
_LARGEST, _LONGEST = 1_000, 2**20
# Functions in terms of those that are evaluated, and the derivatives of these.
_DEFINED = {
    "sqrt": "x**(1/2)", "acos": "pi/2 - asin(x)", "tan": "sin(x)/cos(x)",
    "cot": "cos(x)/sin(x)", "sec": "1/cos(x)", "csc": "1/sin(x)", "acot": "atan(1/x)",
    "asec": "acos(1/x)", "acsc": "asin(1/x)", "sinh": "(exp(x) - exp(-x))/2",
    "cosh": "(exp(x) + exp(-x))/2", "tanh": "1 - 2/(exp(2*x) + 1)",
    "coth": "1 + 2/(exp(2*x) - 1)", "sech": "1/cosh(x)", "csch": "1/sinh(x)",
    "asinh": "log(x + sqrt(x**2 + 1))", "acosh": "log(x + sqrt(x**2 - 1))",
    "atanh": "log((1 + x)/(1 - x))/2", "acoth": "atanh(1/x)", "asech": "acosh(1/x)",
    "acsch": "asinh(1/x)",
}  # fmt: skip
_SLOPES = {
    "exp": "exp(x)", "log": "1/x", "sin": "cos(x)", "cos": "-sin(x)", "atan": "1/(1 + x**2)",
    "asin": "1/sqrt(1 - x**2)", "erf": "2*exp(-x**2)/sqrt(pi)",
}  # fmt: skip


class NotProvenError(Exception):
    """A claim is not proven, or what it is about is not covered."""


class FalseClaimError(NotProvenError):
    """A claim is proven to be false."""


@contextmanager
def refusing_other_forms(bits: int) -> Iterator[None]:
    """Set the precision; turn errors of data that have not the form of a claim into refusals."""
    try:
        with ctx.workprec(bits):
            yield
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as error:
        raise FalseClaimError(f"the data have another form: {error!r:.200}") from None


def attempt(attempts: Sequence[tuple[Any, ...]], proof: Callable[..., None]) -> None:
    """Run a proof with more and more bits and effort until it succeeds.

    - attempts: Bits, and further arguments of the proof.
    """
    for bits, *effort in attempts:
        try:
            with refusing_other_forms(bits):
                return proof(*effort)
        except FalseClaimError:
            raise
        except NotProvenError as error:
            failure = error
    raise failure


class Formulas:
    """Operations on numbers, the variables and earlier operations.

    An operation is a tuple: ("number", fraction), ("pi",), ("variable", k), ("+", a, b),
    ("*", a, b), ("**", a, fraction), or (name of a function, a); a and b are places of operations.

    - variables: Names of the variables.
    - values: Exact values of all other names.
    """

    def __init__(self, variables: Sequence[str], values: Mapping[str, Fraction]) -> None:
        self.operations: list[tuple[Any, ...]] = []
        self._places: dict[tuple[Any, ...], int] = {}
        self._names = {name: self._of("variable", k) for k, name in enumerate(variables)}
        self._names |= {name: self.number(value) for name, value in values.items()}
        self._constants = dict.fromkeys(("pi", "π"), self._of("pi"))

    def _of(self, *operation: Any) -> int:
        if operation not in self._places:
            self._places[operation] = len(self.operations)
            self.operations.append(operation)
        return self._places[operation]

    def number(self, value: Fraction | int) -> int:
        return self._of("number", Fraction(value))

    def variable(self, k: int) -> int:
        return self._of("variable", k)

    def value(self, place: int) -> Fraction | None:
        """The value of a number; None of another operation."""
        operation = self.operations[place]
        return operation[1] if operation[0] == "number" else None

    def add(self, a: int, b: int) -> int:
        x, y = self.value(a), self.value(b)
        if x is not None and y is not None:
            return self.number(x + y)
        return b if x == 0 else a if y == 0 else self._of("+", *sorted((a, b)))

    def multiply(self, a: int, b: int) -> int:
        x, y = self.value(a), self.value(b)
        if x is not None and y is not None:
            return self.number(x * y)
        if 0 in (x, y):
            return self.number(0)
        return b if x == 1 else a if y == 1 else self._of("*", *sorted((a, b)))

    def negative(self, a: int) -> int:
        return self.multiply(self.number(-1), a)

    def power(self, a: int, exponent: Fraction) -> int:
        if abs(exponent) > _LARGEST_POWER:
            raise NotProvenError(f"the power {exponent} is too large")
        base = self.value(a)
        if exponent in (0, 1):
            return a if exponent == 1 else self.number(1)
        if base is not None and exponent.denominator == 1 and (base or exponent > 0):
            size = max(base.numerator.bit_length(), base.denominator.bit_length())
            if size * abs(exponent) > _LONGEST:
                raise NotProvenError("a power of a number is too long")
            return self.number(base ** int(exponent))
        return self._of("**", a, exponent)

    # -- text ---------------------------------------------------------------------------------

    def read(self, formula: Mapping[str, Any]) -> int:
        """The place of a formula with the binary fractions "floats" by names in its text."""
        floats = {
            name: self.number((-1) ** sign * int(digits) * Fraction(2) ** exponent)
            for name, (sign, digits, exponent, _) in formula["floats"].items()
        }
        return self.parse(formula["formula"], self._names | floats)

    def parse(self, text: str, names: Mapping[str, int] | None = None) -> int:
        """The place of a formula; numbers in it are the exact numbers written there.

        - names: Places of names, by default the variables and values.
        """
        names = self._constants | dict(self._names if names is None else names)
        text = re.sub(rf"\b{_KEYWORD}\b", _STAND_IN, text.strip())
        try:
            return self._node(ast.parse(text, mode="eval").body, text, names)
        except (ArithmeticError, MemoryError, RecursionError, SyntaxError, ValueError) as error:
            raise NotProvenError(f"the formula cannot be parsed: {error}") from None

    def _node(self, node: ast.expr, text: str, names: Mapping[str, int]) -> int:
        match node:
            case ast.Constant(value=int() | float()) if type(node.value) is not bool:
                written = ast.get_source_segment(text, node) or ""
                return self.number(exact(written.replace("_", "")))
            case ast.Name(id=name):
                name = _KEYWORD if name == _STAND_IN else name
                if name in names:
                    return names[name]
                raise NotProvenError(f"the name '{name}' in the formula has no value")
            case ast.UnaryOp(op=ast.USub() | ast.UAdd() as sign, operand=inner):
                place = self._node(inner, text, names)
                return self.negative(place) if isinstance(sign, ast.USub) else place
            case ast.BinOp(left=left, op=operator, right=right):
                a, b = (self._node(part, text, names) for part in (left, right))
                return self._binary(operator, a, b)
            case ast.Call(func=ast.Name(id=name), args=[inner], keywords=[]):
                place = self._node(inner, text, names)
                if name in _DEFINED:
                    return self.parse(_DEFINED[name], {"x": place})
                if name in _SLOPES:
                    return self._of(name, place)
        raise NotProvenError(f"'{ast.unparse(node)[:40]}' is not covered")

    def _binary(self, operator: ast.operator, a: int, b: int) -> int:
        exponent = self.value(b)
        match operator:
            case ast.Add() | ast.Sub():
                return self.add(a, b if isinstance(operator, ast.Add) else self.negative(b))
            case ast.Mult() | ast.Div():
                divides = isinstance(operator, ast.Div)
                return self.multiply(a, self.power(b, Fraction(-1)) if divides else b)
            case ast.Pow() if exponent is not None:
                return self.power(a, exponent)
            case ast.Pow():
                return self._of("exp", self.multiply(b, self._of("log", a)))
        raise NotProvenError(f"the operator {type(operator).__name__} is not covered")

    # -- derivatives --------------------------------------------------------------------------

    def gradient(self, place: int, variables: int) -> list[int]:
        """The derivatives of an operation by the first variables."""
        zero, slopes = self.number(0), {place: self.number(1)}
        found = [zero] * variables
        for k in range(place, -1, -1):
            slope = slopes.pop(k, zero)
            name, *arguments = self.operations[k]
            if slope == zero or name in ("number", "pi"):
                continue
            if name == "variable":
                if arguments[0] < variables:
                    found[arguments[0]] = slope
                continue
            for a, factor in self._slopes(name, *arguments):
                slopes[a] = self.add(slopes.get(a, zero), self.multiply(slope, factor))
        return found

    def _slopes(self, name: str, a: int, b: Any = None) -> list[tuple[int, int]]:
        """Arguments of an operation and its derivatives by them."""
        if name == "+":
            return [(a, self.number(1)), (b, self.number(1))]
        if name == "*":
            return [(a, b), (b, a)]
        if name == "**":
            return [(a, self.multiply(self.number(b), self.power(a, b - 1)))]
        return [(a, self.parse(_SLOPES[name], {"x": a}))]

    def replaced(self, place: int, values: Mapping[int, int]) -> int:
        """The operation with other ones for some variables."""
        found: list[int] = []
        rules: dict[str, Callable[..., int]] = {
            "+": self.add, "*": self.multiply, "**": self.power
        }  # fmt: skip
        for name, *arguments in self.operations[: place + 1]:
            if name in ("number", "pi", "variable"):
                own = self._of(name, *arguments)
                found.append(values.get(arguments[0], own) if name == "variable" else own)
                continue
            moved = [found[a] if isinstance(a, int) else a for a in arguments]
            found.append(rules[name](*moved) if name in rules else self._of(name, *moved))
        return found[place]

    # -- values -------------------------------------------------------------------------------

    def needed(self, places: Sequence[int]) -> set[int]:
        """The operations that some operations need."""
        found: set[int] = set()
        stack = list(places)
        while stack:
            k = stack.pop()
            if k not in found:
                found.add(k)
                name, *arguments = self.operations[k]
                stack += [a for a in arguments if type(a) is int and name != "variable"]
        return found

    def program(self, places: Sequence[int]) -> Callable[[Sequence[Any]], list[Any]]:
        """A function from the variables to the values of operations.

        Numbers have the precision at which it is made.
        """
        known, steps = {}, []
        for k in sorted(self.needed(places)):
            name, *arguments = self.operations[k]
            if name in ("number", "pi"):
                known[k] = ball(arguments[0]) if arguments else arb.pi()
            else:
                rule = name if name in ("variable", "+", "*", "**") else _EVALUATED[name]
                steps.append((k, rule, arguments[0], arguments[-1]))

        def run(variables: Sequence[Any]) -> list[Any]:
            values: dict[int, Any] = dict(known)
            try:
                for k, rule, a, b in steps:
                    if rule == "+":
                        values[k] = values[a] + values[b]
                    elif rule == "*":
                        values[k] = values[a] * values[b]
                    elif rule == "**":
                        values[k] = _power(values[a], b)
                    elif rule == "variable":
                        values[k] = variables[a]
                    else:
                        values[k] = rule(values[a])
            except (ValueError, ZeroDivisionError):  # of series that begin with zero
                raise NotProvenError("a quotient is not finite there") from None
            return [values[k] for k in places]

        return run


def exact(value: str | float) -> Fraction:
    """The number that is written, unless writing it as a fraction would take too long."""
    number = Decimal(value)
    if abs(number.adjusted()) > _LARGEST:
        raise NotProvenError("a number is too large or too small")
    return Fraction(number)


def ball(value: Fraction | float) -> arb:
    """An exact number as a ball of the working precision."""
    exact = Fraction(value)
    return arb(fmpq(exact.numerator, exact.denominator))


def _start(value: Any) -> arb:
    """The real part of a number, or of the first coefficient of a series."""
    return value[0] if isinstance(value, arb_series) else arb(value.real)


def _power(base: Any, exponent: Fraction) -> Any:
    if exponent.denominator == 1:
        base = base if exponent.numerator > 0 else 1 / base
    elif exponent.denominator == 2:
        base = _within(base, _start(base) > 0)
        base = base.sqrt() if exponent.numerator > 0 else base.rsqrt()
    else:
        return (ball(exponent) * _EVALUATED["log"](base)).exp()
    found = base
    for bit in f"{abs(exponent.numerator):b}"[1:]:
        found = found * found
        found = found * base if bit == "1" else found
    return found


def _within(value: Any, inside: bool) -> Any:
    """A value, in a part of the plane where the function is analytic."""
    if not inside:
        raise NotProvenError("a function is not smooth there")
    return value


def _arctangent(value: Any) -> Any:
    return _within(value, not isinstance(value, acb) or abs(value.imag) < 1).atan()


_EVALUATED: dict[str, Callable[..., Any]] = {
    "exp": lambda a: a.exp(),
    "log": lambda a: _within(a, _start(a) > 0).log(),
    "sin": lambda a: a.sin(),
    "cos": lambda a: a.cos(),
    "atan": _arctangent,
    "asin": lambda a: _within(a, abs(_start(a)) < 1).asin(),
    "erf": lambda a: a.erf(),
}
