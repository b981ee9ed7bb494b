"""Parser of formulas, safe for untrusted text.

Input:  a formula such as ``"p**2/2 + x**2/2 + x**4/4"``.
Output: a sympy expression in real symbols, built node by node.

Python's own parser makes a syntax tree, which is never compiled or run; a visitor with one
method per accepted node type rebuilds it from sympy's constructors. Everything else raises
:class:`~hamsym.errors.ParseError`. Decimal numbers are
exact: ``0.1`` is 1/10.
"""

from __future__ import annotations

import ast
import math
import re
import unicodedata
from collections.abc import Callable
from dataclasses import dataclass

import sympy
from sympy.core.evalf import PrecisionExhausted

from hamsym.errors import InputError, ParseError, VariableError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.formula.grammar import (
    GREEK,
    LAMBDA,
    LAMBDA_STAND_IN,
    REFUSED_NODES,
    REFUSED_OPERATORS,
    SPLIT,
    beginning,
    readable,
    syntax_tree,
)
from hamsym.support.suggestions import did_you_mean

MAX_LENGTH = 50_000  # characters
MAX_NODES = 10_000  # operands and operations
MAX_DEPTH = 60  # nesting; a sum or product of any length counts once
MAX_CALLS = 6  # functions inside functions; sympy needs 2**depth steps for some
MAX_EXPONENT = 1_000  # of a numerical power
MAX_EFFORT = 1_600_000  # function calls, most of them sympy's; under a second
MAX_SECONDS = 2.0  # of processor time, for the few calls that take long themselves
MAX_BITS = 5_000  # of an exact number
_LARGE = "build a sympy expression for something this large"

#: Terms of sums in the order in which they were written, by the sum.
Written = dict[sympy.Expr, tuple[sympy.Expr, ...]]


@dataclass(frozen=True)
class _Function:
    build: Callable[..., sympy.Expr]
    fewest: int = 1
    most: int = 1


_UNARY: dict[str, Callable[..., sympy.Expr]] = {
    name: getattr(sympy, name)
    for name in (
        *("sin", "cos", "tan", "cot", "sec", "csc"),
        *("asin", "acos", "atan", "acot", "asec", "acsc"),
        *("sinh", "cosh", "tanh", "coth", "sech", "csch"),
        *("asinh", "acosh", "atanh", "acoth", "asech", "acsch"),
        *("exp", "log", "sqrt", "sign", "erf"),
    )
}
_SPELLINGS = {"ln": "log"} | {
    "arc" + name[1:]: name for name in _UNARY if name.startswith("a") and name != "abs"
}

#: Every function name that a formula may call.
FUNCTIONS: dict[str, _Function] = {
    **{name: _Function(build) for name, build in _UNARY.items()},
    **{name: _Function(_UNARY[target]) for name, target in _SPELLINGS.items()},
    "abs": _Function(sympy.Abs),
    "atan2": _Function(sympy.atan2, 2, 2),
    "min": _Function(sympy.Min, 2, 16),
    "max": _Function(sympy.Max, 2, 16),
    "Heaviside": _Function(sympy.Heaviside),
}

_CONSTANTS = {"pi": sympy.pi, "π": sympy.pi}

_MAX_NAME = 50
_NAME = re.compile(rf"[A-Za-z{GREEK}][A-Za-z{GREEK}0-9_]*")


def check_name(name: str) -> None:
    """Raise unless a symbol name is a plain identifier in Latin and Greek letters.

    Raise VariableError if the name cannot be used in generated source.

    Examples
    --------
    >>> check_name("p_theta")
    >>> check_name("x; import os")
    Traceback (most recent call last):
    ...
    hamsym.errors.VariableError: 'x; import os' is not a usable name; ...
    """
    shown = name if len(name) <= 40 else name[:37] + "..."
    shown = shown if shown.isprintable() else ascii(shown)[1:-1]
    if not _NAME.fullmatch(name) or "__" in name or len(name) > _MAX_NAME:
        raise VariableError(
            f"'{shown}' is not a usable name; names are up to {_MAX_NAME} Latin or Greek letters, "
            "digits and single underscores, beginning with a letter"
        )
    if name in FUNCTIONS or name in _CONSTANTS:
        raise VariableError(f"'{name}' is a function or constant of formulas; rename the symbol")


def canonical_name(name: str) -> str:
    """Spell out Greek letters: ``θ`` and ``theta`` are one variable.

    Examples
    --------
    >>> canonical_name("p_θ1")
    'p_theta1'
    """
    return "".join(_spell_out(letter) for letter in name)


def _spell_out(letter: str) -> str:
    if letter not in GREEK:
        return letter
    word = unicodedata.name(letter).rsplit(" ", 1)[1].lower()
    word = "lambda" if word == "lamda" else word
    return word.capitalize() if letter.isupper() else word


def parse_expression(text: str) -> sympy.Expr:
    """Parse a formula into a sympy expression.

    - text: Numbers, ``pi``, names, ``+ - * / **``, parentheses, the functions in :data:`FUNCTIONS`,
      and sums ``sum(i, 1, 8, p[i]**2/2)`` over integers, in which ``p[i]`` is p1, ..., p8.
    - returns: In symbols with ``real=True``, with sympy's automatic simplification only.

    Raises
    ------
    ParseError
        Naming the token, its column and the remedy.

    Examples
    --------
    >>> parse_expression("p**2/2 + 0.1*x**4")
    p**2/2 + x**4/10
    >>> parse_expression("sum(i, 1, 2, sum(j, i + 1, 3, (x[i] - x[j])**2))")
    (x1 - x2)**2 + (x1 - x3)**2 + (x2 - x3)**2
    >>> parse_expression("x^2")
    Traceback (most recent call last):
    ...
    hamsym.errors.ParseError: '^' at column 2 is not a power; write ** for powers
    """
    return parse_written(text)[0]


def parse_written(text: str) -> tuple[sympy.Expr, Written]:
    """Parse a formula; return the terms of its sums in the order of the text too.

    Examples
    --------
    >>> parse_written("sqrt(1 + x) - 2")[1]
    {x + 1: (1, x), sqrt(x + 1) - 2: (sqrt(x + 1), -2)}
    """
    if not isinstance(text, str):
        raise InputError(f"a formula is a str, not {type(text).__name__}; give a str")
    visitor = _Visitor(text)
    return visitor.result(), visitor.written


def parse_number(text: str) -> float:
    """Evaluate a formula without variables, for example ``"4*pi"``.

    Raise ParseError if the text is not a formula or contains a variable.

    Examples
    --------
    >>> parse_number("4*pi")
    12.566370614359172
    """
    visitor = _Visitor(text)
    value = visitor.result()
    if value.free_symbols:
        name = min(symbol.name for symbol in value.free_symbols)
        raise ParseError(
            name, visitor.column_of(name), "is a variable", "give a number, for example 4*pi"
        )
    return float(value)


class _Visitor:
    """Translation of a syntax tree to sympy's constructors; one ``visit_`` method per node type."""

    def __init__(self, text: str) -> None:
        if len(text) > MAX_LENGTH:
            raise beginning(text, f"of {len(text)} characters, more than {MAX_LENGTH}", _LARGE)
        self._text = readable(text)
        self.written: Written = {}
        self._symbols: dict[str, str] = {}  # canonical name -> name as typed
        self._depth = self._calls = 0
        self._indices: dict[str, int] = {}  # of the sums around the present node
        self._index_names: set[str] = set()  # of all sums
        self._parts = 0  # operands and operations in the terms of sums

    def result(self) -> sympy.Expr:
        tree = syntax_tree(self._text)
        count = sum(isinstance(node, ast.expr) for node in ast.walk(tree))
        if count > MAX_NODES:
            raise beginning(self._text, f"of {count} parts, more than {MAX_NODES}", _LARGE)
        try:
            with call_limit(MAX_EFFORT, MAX_SECONDS):
                found = self.visit(tree.body)
        except CallLimitExceededError:
            raise beginning(self._text.strip(), "that takes too long to read", SPLIT) from None
        for name in sorted(self._index_names & set(self._symbols.values())):
            raise ParseError(
                name,
                self.column_of(name),
                "is the index of a sum and a variable",
                "use another letter for the index",
            )
        return found

    def visit(self, node: ast.AST) -> sympy.Expr:
        method = getattr(self, f"visit_{type(node).__name__}", None)
        if method is None:
            problem, remedy = REFUSED_NODES.get(
                type(node), ("is not part of a formula", "use numbers, names and + - * / **")
            )
            raise self._error(node, problem, remedy)
        self._depth += 1
        if self._depth > MAX_DEPTH:
            raise self._error(node, f"is nested more than {MAX_DEPTH} deep", "split the formula")
        try:
            expr: sympy.Expr = self._checked(method(node), node)
        except InputError:
            raise
        except (ArithmeticError, AttributeError, TypeError, ValueError, RecursionError):
            # sympy raises these when it decides whether an expression is real or smaller
            raise self._error(
                node, "cannot be evaluated as a real expression", "simplify or split it"
            ) from None
        self._depth -= 1
        return expr

    def visit_Constant(self, node: ast.Constant) -> sympy.Expr:
        value = node.value
        if type(value) is int:
            return self._number(sympy.Integer(value), node)
        if type(value) is float:
            if not math.isfinite(value):
                raise self._error(node, "is too large a number", "stay below 1e308")
            if value == 0 and re.search(r"[1-9]", self._text_of(node).lower().split("e")[0]):
                raise self._error(node, "is too small a number", "stay above 1e-308")
            return sympy.Rational(self._text_of(node).replace("_", ""))
        if isinstance(value, complex):
            raise self._error(node, "is a complex number", "a Hamiltonian is real")
        if isinstance(value, (str, bytes)):
            raise self._error(node, "is a string", "write the formula without quotation marks")
        raise self._error(node, "is a constant of Python", "use numbers and pi")

    def visit_Name(self, node: ast.Name) -> sympy.Expr:
        name = LAMBDA if node.id == LAMBDA_STAND_IN else node.id
        if name in self._indices:
            return sympy.Integer(self._indices[name])
        if name in _CONSTANTS:
            return _CONSTANTS[name]
        if name in FUNCTIONS:
            raise self._error(node, "is a function", f"write {name}(...)")
        self._check_name(name, node)
        return self._symbol(name, node)

    def _symbol(self, name: str, node: ast.AST) -> sympy.Symbol:
        first = self._symbols.setdefault(canonical_name(name), name)
        if first != name:
            raise self._error(node, f"is '{first}' in another spelling", "use one of the two")
        return sympy.Symbol(name, real=True)

    def visit_Subscript(self, node: ast.Subscript) -> sympy.Expr:
        """An element inside a sum: ``x[i + 1]`` is x4 for i = 3."""
        if not self._indices:
            raise self._error(node, *REFUSED_NODES[ast.Subscript])
        if not isinstance(node.value, ast.Name) or isinstance(node.slice, (ast.Slice, ast.Tuple)):
            raise self._error(node, "is not an element", "write x[i] with one index")
        index = self._whole(node.slice)
        if index < 0:
            raise self._error(node, f"has the index {index}", "use indices from 0")
        stem = LAMBDA if node.value.id == LAMBDA_STAND_IN else node.value.id
        self._check_name(stem, node)
        self._check_name(f"{stem}{index}", node)
        if stem in self._indices:
            raise self._error(node, "is an element of an index", "use another letter")
        return self._symbol(f"{stem}{index}", node)

    def _check_name(self, name: str, node: ast.AST) -> None:
        try:
            check_name(name)
        except VariableError as error:
            remedy = str(error).split("; ", 1)[1]
            raise self._error(node, "is not a usable name", remedy) from None

    def _whole(self, node: ast.expr) -> int:
        """The value of an integer, or of an expression in the indices of sums."""
        value = self.visit(node)
        if not value.is_Integer:
            raise self._error(
                node, "is not an integer", "write numbers and indices of sums, for example i + 1"
            )
        if abs(value) > MAX_NODES:
            raise self._error(node, "is too large an index", f"stay below {MAX_NODES}")
        return int(value)

    def _sum(self, node: ast.Call) -> sympy.Expr:
        """Expand ``sum(i, first, last, term)``, bounds included."""
        if len(node.args) != 4 or node.keywords:
            raise self._error(
                node.func, f"has {len(node.args)} arguments", "write sum(i, 1, 8, p[i]**2/2)"
            )
        index, first, last, term = node.args
        if not isinstance(index, ast.Name):
            raise self._error(
                index, "is not an index", "begin with a name, as in sum(i, 1, 8, ...)"
            )
        name = index.id
        if name in self._indices:
            raise self._error(index, "is the index of the sum around it", "use another letter")
        if name in FUNCTIONS or name in _CONSTANTS or name == LAMBDA_STAND_IN:
            raise self._error(index, "cannot be an index", "use a letter such as i")
        low, high = self._whole(first), self._whole(last)
        self._index_names.add(name)
        size = sum(isinstance(part, ast.expr) for part in ast.walk(term))
        self._parts += size * max(high - low + 1, 0)
        if self._parts > MAX_NODES:
            raise self._error(node, f"has more than {MAX_NODES} parts", "build a sympy expression")
        terms = []
        for value in range(low, high + 1):
            self._indices[name] = value
            terms.append(self.visit(term))
        self._indices.pop(name, None)
        return self._total(terms)

    def _total(self, parts: list[sympy.Expr]) -> sympy.Expr:
        total = sympy.Add(*parts)
        terms = [t for part in parts for t in self.written.get(part, sympy.Add.make_args(part))]
        if total.is_Add and len(terms) == len(total.args) and set(terms) == set(total.args):
            self.written[total] = tuple(terms)
        return total

    def visit_UnaryOp(self, node: ast.UnaryOp) -> sympy.Expr:
        if isinstance(node.op, ast.USub):
            return -self.visit(node.operand)
        if isinstance(node.op, ast.UAdd):
            return self.visit(node.operand)
        raise self._operator_error(node.op, self._column(node))

    def visit_BinOp(self, node: ast.BinOp) -> sympy.Expr:
        if isinstance(node.op, ast.Pow):
            return self._power(node)
        if isinstance(node.op, (ast.Add, ast.Sub)):
            return self._total(self._chain(node, (ast.Add, ast.Sub)))
        if isinstance(node.op, (ast.Mult, ast.Div)):
            return sympy.Mul(*self._chain(node, (ast.Mult, ast.Div)))
        self.visit(node.left)  # an error further to the left comes first
        before = self._text_of(node.left)
        column = self._column(node.left) + len(before)
        symbol = REFUSED_OPERATORS[type(node.op)][0]
        raise self._operator_error(node.op, self._text.find(symbol, column - 1) + 1)

    def visit_Call(self, node: ast.Call) -> sympy.Expr:
        if isinstance(node.func, ast.Attribute):
            raise self._error(node.func, *REFUSED_NODES[ast.Attribute])
        if not isinstance(node.func, ast.Name):
            raise self._error(node.func, "is not a function name", "write * between factors")
        name = node.func.id
        if name == "sum":
            return self._sum(node)
        if name not in FUNCTIONS:
            known = ", ".join(sorted((set(FUNCTIONS) | {"sum"}) - set(_SPELLINGS)))
            raise self._error(
                node.func,
                f"is not a known function{did_you_mean(name, FUNCTIONS)}",
                f"write * for products, for example x*(1 + y); known functions: {known}",
            )
        if node.keywords:
            token = node.keywords[0].arg or "**"
            raise ParseError(
                token, self._column(node.keywords[0]), "is a keyword", f"write {name}(x)"
            )
        function = FUNCTIONS[name]
        if not function.fewest <= len(node.args) <= function.most:
            allowed = " to ".join(map(str, sorted({function.fewest, function.most})))
            raise self._error(
                node.func,
                f"has {len(node.args)} arguments",
                f"give {name} {allowed}, separated by commas",
            )
        self._calls += 1
        if self._calls > MAX_CALLS:
            raise self._error(
                node.func, f"is inside more than {MAX_CALLS} other functions", "split the formula"
            )
        arguments = [self.visit(argument) for argument in node.args]
        self._calls -= 1
        if name == "exp":
            self._refuse_giant_log(arguments[0], node)
        return function.build(*arguments)

    def _chain(self, node: ast.BinOp, operators: tuple[type, ...]) -> list[sympy.Expr]:
        """Return the terms of a sum or the factors of a product, without recursion."""
        links = []
        left: ast.expr = node
        while isinstance(left, ast.BinOp) and isinstance(left.op, operators):
            links.append(left)
            left = left.left
        operands = [self.visit(left)]
        for link in reversed(links):
            operand = self.visit(link.right)
            if isinstance(link.op, ast.Sub):
                operand = -operand
            elif isinstance(link.op, ast.Div):
                if _is_zero(operand):
                    raise self._error(link.right, "is zero", "use a nonzero divisor")
                operand = 1 / operand
            operands.append(operand)
        return operands

    def _power(self, node: ast.BinOp) -> sympy.Expr:
        base, exponent = self.visit(node.left), self.visit(node.right)
        if exponent.is_Rational:
            if abs(exponent) > MAX_EXPONENT:
                raise self._error(
                    node.right, "is too large an exponent", f"stay below {MAX_EXPONENT}"
                )
            if exponent < 0 and _is_zero(base):
                raise self._error(node.left, "is zero", "use a nonzero divisor")
            # sympy takes numbers out of products, (2*x)**n = 2**n*x**n: all of them count.
            whole = [part for n in base.atoms(sympy.Rational) for part in (n.p, n.q)]
            bits = max((abs(number).bit_length() for number in whole), default=0)
            if bits * abs(exponent) > MAX_BITS:
                raise self._error(node, "is too large a number", "stay below 1e308")
        self._refuse_giant_log(exponent, node)
        if base.is_number and not exponent.is_number and not base.is_positive:
            raise self._error(node.left, "is not positive", "its powers are not real")
        power = base**exponent
        for part in (power, *power.args):
            _, total = part.as_base_exp()
            if total.is_Rational and abs(total) > MAX_EXPONENT:
                raise self._error(node, "is too high a power", f"stay below {MAX_EXPONENT}")
        return power

    def _refuse_giant_log(self, exponent: sympy.Expr, node: ast.AST) -> None:
        """Raise for giant exponents of logarithms: sympy expands exp(c*log(b)) to b**c."""
        if exponent.has(sympy.log) and any(
            abs(number) > MAX_EXPONENT for number in exponent.atoms(sympy.Rational)
        ):
            raise self._error(node, "is too large a power", f"stay below {MAX_EXPONENT}")

    def _checked(self, expr: sympy.Expr, node: ast.AST) -> sympy.Expr:
        """Raise unless an expression is real and finite.

        Checking every constant as it arises also prevents sympy from evaluating towers like
        ``exp(exp(exp(9)))``, which exceed any memory.
        """
        if expr.is_Rational:
            return self._number(expr, node)
        for part in expr.args:
            if part.is_Rational:
                self._number(part, node)
        if expr.has(sympy.I, sympy.zoo, sympy.nan, sympy.oo):
            raise self._error(node, "is not a finite real number", "a Hamiltonian is real")
        if not expr.free_symbols:
            value = expr.evalf(17)
            if not value.is_Float or abs(value) > 1e308:
                raise self._error(
                    node, "is not a finite real number", "a Hamiltonian is real and below 1e308"
                )
        return expr

    def _number(self, number: sympy.Rational, node: ast.AST) -> sympy.Rational:
        # The rational itself is compared: a giant one takes too long to convert to decimal.
        if abs(number) > 10**308 or number.q.bit_length() > MAX_BITS:
            raise self._error(node, "is too large a number", "stay below 1e308")
        return number

    def column_of(self, name: str) -> int:
        """Return the column of a name, counted from 1."""
        match = re.search(rf"(?<!\w){re.escape(name)}(?!\w)", self._text)
        return match.start() + 1 if match else 1

    def _column(self, node: ast.AST) -> int:
        offset = getattr(node, "col_offset", 0)
        return len(self._text.encode()[:offset].decode()) + 1

    def _text_of(self, node: ast.AST) -> str:
        return ast.get_source_segment(self._text, node) or self._text

    def _error(self, node: ast.AST, problem: str, remedy: str) -> ParseError:
        token = self._text_of(node).replace(LAMBDA_STAND_IN, LAMBDA)
        return ParseError(token, self._column(node), problem, remedy)

    @staticmethod
    def _operator_error(operator: ast.AST, column: int) -> ParseError:
        symbol, problem, remedy = REFUSED_OPERATORS[type(operator)]
        return ParseError(symbol, column, problem, remedy)


def _is_zero(expr: sympy.Expr) -> bool:
    """Return whether a divisor, or its constant factor, is zero."""
    if symbols := expr.free_symbols:
        # sympy's own is_zero takes longer than all the rest of a formula.
        expr, _ = expr.as_independent(*symbols, as_Add=False)
    if expr.is_Rational:
        return bool(expr == 0)
    try:
        return bool(abs(expr.evalf(17, strict=True)) < 1e-100)
    except PrecisionExhausted:
        return True
