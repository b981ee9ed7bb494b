"""Printer of sympy expressions: as formulas, or as code for one backend.

One printer traverses the expression; a backend is a table of function names and a few rules. Code
printers fold symbol-free parts into float literals, because ``sqrt(2)*x`` must neither call a
tensor function on a Python number nor evaluate the root at every call.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping

import sympy

from hamsym.errors import CodeGenerationError
from hamsym.formula.parser import MAX_EXPONENT

_ADD, _MUL, _POW, _ATOM = range(4)  # precedences
_READABLE = 1_000  # fractions up to here stay fractions in code


# Functions that no backend has, in terms of those that all have. The derivative of sign is zero
# almost everywhere.
_REWRITES: dict[type, Callable[..., sympy.Expr]] = {
    sympy.cot: lambda u: 1 / sympy.tan(u),
    sympy.sec: lambda u: 1 / sympy.cos(u),
    sympy.csc: lambda u: 1 / sympy.sin(u),
    sympy.coth: lambda u: 1 / sympy.tanh(u),
    sympy.sech: lambda u: 1 / sympy.cosh(u),
    sympy.csch: lambda u: 1 / sympy.sinh(u),
    sympy.acot: lambda u: sympy.atan(1 / u),
    sympy.asec: lambda u: sympy.acos(1 / u),
    sympy.acsc: lambda u: sympy.asin(1 / u),
    sympy.acoth: lambda u: sympy.atanh(1 / u),
    sympy.asech: lambda u: sympy.acosh(1 / u),
    sympy.acsch: lambda u: sympy.asinh(1 / u),
    sympy.Heaviside: lambda u, *_: (1 + sympy.sign(u)) / 2,
    sympy.DiracDelta: lambda *_: sympy.Integer(0),
}


def rewritten_to(function: type) -> tuple[type, ...]:
    """Functions that are printed in terms of a given one."""
    x = sympy.Symbol("x")
    return tuple(kind for kind, rewrite in _REWRITES.items() if rewrite(x).has(function))


_COMMON = tuple(
    "sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh exp log sign erf atan2".split()
)


def _table(form: str, **special: str) -> dict[type, str]:
    names = {name: form.format(name) for name in _COMMON} | special
    by_name = {"abs": sympy.Abs, "min": sympy.Min, "max": sympy.Max}
    return {by_name.get(name) or getattr(sympy, name): text for name, text in names.items()}


class Printer:
    """Text of an expression; subclasses define how functions, numbers and powers are written.

    - names: The identifier of each symbol.
    - state: Symbols that depend on the state.
    - like: Identifier of a component of the state, whose shape is that of the batch.
    """

    backend = ""
    functions: Mapping[type, str] = {}
    sqrt = "sqrt"
    raised = "**"  # the operator of powers

    def __init__(
        self,
        names: Mapping[sympy.Symbol, str],
        state: frozenset[sympy.Symbol] = frozenset(),
        like: str = "",
    ) -> None:
        self.names, self.state, self.like = names, state, like

    def __call__(self, expr: sympy.Expr) -> str:
        """Return the text of one expression."""
        return self._render(self.lower(expr))[0]

    def result(self, expr: sympy.Expr) -> str:
        """Return the text of a result of a function."""
        return self(expr)

    def lower(self, expr: sympy.Expr) -> sympy.Expr:
        """Rewrite functions that the backend lacks.

        Raise CodeGenerationError if a function cannot be rewritten; the message names it.
        """
        for _ in range(10):  # a rewritten argument can turn f(-u) into f(u) again
            present = {type(node) for node in expr.atoms(sympy.Function)} & _REWRITES.keys()
            if not present:
                break
            for function in present:
                expr = expr.replace(function, _REWRITES[function])
        return expr

    # -- numbers ---------------------------------------------------------------------------

    def integer(self, value: int) -> str:
        """Print a small integer, which may be the numerator or denominator of a fraction."""
        return str(value)

    def number(self, value: sympy.Expr) -> tuple[str, int]:
        """Print a symbol-free expression as a short fraction or a float literal."""
        if value.is_Rational and max(abs(value.p), value.q) <= _READABLE:
            text = self.integer(value.p)
            text += "" if value.q == 1 else f"/{self.integer(value.q)}"
            return text, _ADD if value.p < 0 else (_ATOM if value.q == 1 else _MUL)
        digits = value if value.is_Rational else value.evalf(30)
        if not (digits.is_Rational or digits.is_Float):
            raise CodeGenerationError(f"'{value}' is not a real number; rewrite the Hamiltonian")
        try:
            number = float(digits)
        except OverflowError:
            number = float("inf")
        if abs(number) == float("inf") or (number == 0 and digits != 0):
            raise CodeGenerationError(
                "a coefficient exceeds the range of floating-point numbers; choose other units"
            )
        return repr(number), _ADD if number < 0 else _ATOM

    # -- nodes -----------------------------------------------------------------------------

    def _render(self, expr: sympy.Expr) -> tuple[str, int]:
        if expr.is_Symbol:
            return self.names[expr], _ATOM
        if self.is_constant(expr):
            return self.number(expr)
        if expr.is_Add:
            return self._sum(expr), _ADD
        if expr.is_Mul:
            return self._product(expr)
        if expr.is_Pow:
            return self._product(expr) if self._is_reciprocal(expr) else self._power(expr)
        return self._call(expr), _ATOM

    def is_constant(self, expr: sympy.Expr) -> bool:
        return not expr.free_symbols

    def _wrapped(self, expr: sympy.Expr, precedence: int) -> str:
        text, own = self._render(expr)
        return text if own >= precedence else f"({text})"

    def _sum(self, expr: sympy.Expr) -> str:
        terms = [self._render(term)[0] for term in self.terms(expr)]
        text = terms[0]
        for term in terms[1:]:
            text += f" - {term[1:]}" if term.startswith("-") else f" + {term}"
        return text

    def terms(self, expr: sympy.Expr) -> list[sympy.Expr]:
        """Terms of a sum in the order in which they are printed."""
        return ordered_terms(expr)

    @staticmethod
    def _splits(factor: sympy.Expr) -> bool:
        """Whether a number is printed in front of a fraction with this factor below its line."""
        # 2/3/(x + y): sympy would multiply a number in front of the sum into it when parsing.
        return bool(factor.as_base_exp()[0].is_Add)

    def _product(self, expr: sympy.Expr) -> tuple[str, int]:
        constants: list[sympy.Expr] = []
        others: list[sympy.Expr] = []
        for factor in expr.as_ordered_factors():
            (constants if self.is_constant(factor) else others).append(factor)
        constant = sympy.Mul(*constants)
        above = [factor for factor in others if not self._is_reciprocal(factor)]
        below = [1 / factor for factor in others if self._is_reciprocal(factor)]
        sign = ""
        if constant.could_extract_minus_sign():
            sign, constant = "-", -constant
        numerator, denominator = self._fraction(constant)
        tops = ([numerator] if numerator else []) + [self._wrapped(f, _MUL) for f in above]
        bottoms = ([denominator] if denominator else []) + [self._wrapped(f, _POW) for f in below]
        if denominator and any(map(self._splits, below)):
            tops = [f"{numerator or self.integer(1)}/{denominator}", *tops[bool(numerator) :]]
            bottoms = bottoms[1:]
        text = sign + ("*".join(tops) or self.integer(1))
        if bottoms:
            text += "/" + (bottoms[0] if len(bottoms) == 1 else f"({'*'.join(bottoms)})")
        return text, _ADD if sign else _MUL

    def _fraction(self, constant: sympy.Expr) -> tuple[str, str]:
        """Return numerator and denominator of a positive coefficient, "" for 1."""
        if constant.is_Rational and max(constant.p, constant.q) <= _READABLE:
            return ("" if constant.p == 1 else self.integer(constant.p)), (
                "" if constant.q == 1 else self.integer(constant.q)
            )
        text, precedence = self.number(constant)
        return (text if precedence >= _MUL else f"({text})"), ""

    @staticmethod
    def _is_reciprocal(expr: sympy.Expr) -> bool:
        return bool(expr.is_Pow and expr.base is not sympy.E and expr.exp.is_Rational) and bool(
            expr.exp < 0
        )

    def _power(self, expr: sympy.Expr) -> tuple[str, int]:
        base, exponent = expr.as_base_exp()
        if base is sympy.E:
            return self._call(sympy.exp(exponent, evaluate=False)), _ATOM
        if exponent == sympy.Rational(1, 2):
            return f"{self.sqrt}({self.argument(base)})", _ATOM
        return self.power(base, exponent)

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        """Print ``base**exponent`` for an exponent other than 1/2 or a negative number."""
        if exponent.is_Rational and not exponent.is_Integer:
            return f"{self._wrapped(base, _ATOM)}{self.raised}{float(exponent)!r}", _POW
        return f"{self._wrapped(base, _ATOM)}{self.raised}{self._wrapped(exponent, _ATOM)}", _POW

    def _call(self, expr: sympy.Expr) -> str:
        if isinstance(expr, (sympy.Min, sympy.Max)):
            return self.extremum(expr, self.functions[type(expr)])
        form = self.functions.get(type(expr))
        if form is None:
            raise CodeGenerationError(
                f"'{type(expr).__name__}' cannot be generated for {self.backend}; "
                "rewrite the Hamiltonian with elementary functions"
            )
        return f"{form}({', '.join(self.argument(argument) for argument in expr.args)})"

    def argument(self, expr: sympy.Expr) -> str:
        """Return the text of an argument of a function."""
        return self._render(expr)[0]

    def extremum(self, expr: sympy.Expr, form: str) -> str:
        """Print the minimum or maximum of two or more arguments by a function of two."""
        texts = [self.argument(a) for a in sorted(expr.args, key=sympy.default_sort_key)]
        while len(texts) > 1:  # in pairs, so that many arguments nest only a little
            pairs = [texts[i : i + 2] for i in range(0, len(texts), 2)]
            texts = [f"{form}({', '.join(pair)})" if len(pair) == 2 else pair[0] for pair in pairs]
        return texts[0]


def ordered_terms(expr: sympy.Expr) -> list[sympy.Expr]:
    """Sort terms by degree, non-polynomial terms last; x - 1, not -1 + x."""

    def degree(term: sympy.Expr) -> float:
        total = 0
        for factor in sympy.Mul.make_args(term):
            base, exponent = factor.as_base_exp()
            if base.is_Number or base.is_NumberSymbol:
                continue
            if not (base.is_Symbol and exponent.is_Integer):
                return float("inf")
            total += max(int(exponent), 0)
        return total

    long = len(expr.args) > 64  # sympy's own ordering is slow on long sums
    terms = sorted(expr.args if long else expr.as_ordered_terms(order="lex"), key=degree)
    if len(terms) == 2 and terms[0].could_extract_minus_sign():
        return terms[::-1] if not terms[1].could_extract_minus_sign() else terms
    return terms


def exact_decimal(value: sympy.Rational) -> str:
    """Return the decimal that equals a long fraction, "" of a short one or if there is none.

    Examples
    --------
    >>> exact_decimal(sympy.Rational("0.12345")), exact_decimal(sympy.Rational(1, 3))
    ('0.12345', '')
    """
    if value.q == 1 or max(abs(value.p), value.q) <= _READABLE:
        return ""
    decimal = repr(float(value))
    return decimal if sympy.Rational(decimal) == value else ""


class FormulaPrinter(Printer):
    """Text that :func:`hamsym.formula.parser.parse_expression` reads back, up to rearrangement.

    Examples
    --------
    >>> x, p = sympy.symbols("x p", real=True)
    >>> FormulaPrinter()(x**4/4 + x**2/2 + p**2/2)
    'p**2/2 + x**2/2 + x**4/4'
    >>> FormulaPrinter()(0.5 * p**2 + 0.1 * x)
    '3602879701896397/2**55*x + 0.5*p**2'
    """

    backend = "text"
    exact = True  # whether parsing gives the same floating-point numbers
    functions = _table("{}", abs="abs", min="min", max="max")

    def __init__(self) -> None:
        super().__init__({})

    def lower(self, expr: sympy.Expr) -> sympy.Expr:
        return expr

    def is_constant(self, expr: sympy.Expr) -> bool:
        return bool(expr.is_Rational or expr.is_Float)

    def number(self, value: sympy.Expr) -> tuple[str, int]:
        if value.is_Float:
            return self.floating(value)
        if decimal := exact_decimal(value):
            return decimal, _ADD if value < 0 else _ATOM
        text = str(value.p) if value.q == 1 else f"{value.p}/{value.q}"
        return text, _ADD if value.p < 0 else (_ATOM if value.q == 1 else _MUL)

    def floating(self, value: sympy.Float) -> tuple[str, int]:
        """Print a floating-point number, as a binary fraction if no short decimal is equal to it.

        Proofs take the number that it is, and parsing takes decimals exactly.
        """
        decimal = repr(float(value))
        finite = math.isfinite(float(value))
        if not self.exact or (finite and sympy.Rational(decimal) == sympy.Rational(value)):
            return decimal, _ADD if value < 0 else _ATOM
        sign, mantissa, exponent, _ = value._mpf_
        operator, left = ("*" if exponent > 0 else "/"), abs(int(exponent))
        text = "-" * int(sign) + str(int(mantissa))
        while left:
            step = min(left, MAX_EXPONENT)
            text, left = f"{text}{operator}2**{step}", left - step
        return text, _ADD if sign else _MUL

    def _render(self, expr: sympy.Expr) -> tuple[str, int]:
        if expr.is_Symbol:
            return expr.name, _ATOM
        if expr.is_NumberSymbol:
            names = {sympy.E: "exp(1)", sympy.pi: "pi"}
            return names.get(expr) or repr(float(expr)), _ATOM
        return super()._render(expr)

    def power(self, base: sympy.Expr, exponent: sympy.Expr) -> tuple[str, int]:
        return f"{self._wrapped(base, _ATOM)}**{self._wrapped(exponent, _ATOM)}", _POW

    def _call(self, expr: sympy.Expr) -> str:
        if type(expr) in self.functions:
            return super()._call(expr)
        name = expr.func.__name__
        if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name):
            raise CodeGenerationError(f"{name!r} is not the name of a function; rename it")
        # The second argument of Heaviside is its value at zero.
        arguments = expr.args[:1] if isinstance(expr, sympy.Heaviside) else expr.args
        return f"{name}({', '.join(self.argument(argument) for argument in arguments)})"
