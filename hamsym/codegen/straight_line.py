"""Straight-line text of expressions, for any arithmetic that the text is given.

Input:  expressions, the identifiers of their symbols, and that of the arithmetic, ``a`` below.
Output: assignments in order of evaluation, and the text of each result.

The text contains only ``+``, ``-``, ``*``, exact integers, ``a.number(p, q)`` for p/q, ``a.pi``,
``a.e`` and functions of ``a``, without branches. It is the same for balls, for Taylor series of
balls and for Taylor models. Four rules keep their results narrow, and finite wherever possible:

- An integer power is a product of squares: the series of exp(n log x) needs x > 0.
- The reciprocal comes before the power: a power of a wide ball may reach zero where the ball does
  not.
- Half-integer powers are those of a root or of a reciprocal root.
- Numbers are exact: in 1/3*y**3 the factor is 1/3, not a rounded floating-point number.

A function that is not smooth everywhere has a line of its own below a comment with the
subexpression, so that a failure can be described in the caller's symbols.
"""

from __future__ import annotations

import itertools
import linecache
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import sympy

from hamsym.codegen.names import Names
from hamsym.errors import CodeGenerationError
from hamsym.formula.printer import _ADD, _ATOM, _MUL, Printer, ordered_terms
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.exact import rational, without_floats

#: Functions of one or two arguments that an arithmetic has, smooth for all numbers.
_ENTIRE = "exp sin cos atan erf sinh cosh tanh asinh".split()
#: Those that are smooth for some numbers only.
_RESTRICTED = "log tan asin acos acosh atanh atan2".split()
#: Names in an arithmetic of the functions of sympy.
FUNCTIONS: dict[type, str] = {getattr(sympy, name): name for name in (*_ENTIRE, *_RESTRICTED)}

# Kinks and jumps: the Taylor series that proofs rest on do not exist there.
_NOT_SMOOTH = (sympy.Abs, sympy.sign, sympy.Min, sympy.Max, sympy.Heaviside, sympy.DiracDelta)
# Those that an arithmetic without series may have; Heaviside is written with sign.
_KINKED = {sympy.Abs: "abs", sympy.sign: "sign", sympy.Min: "min", sympy.Max: "max"}
_CONSTANTS = {sympy.pi: "pi", sympy.E: "e"}

_COMMENT = "    # "  # before a subexpression
_LONGEST_COMMENT = 60
_LONGEST_TEXT = 80  # of the right-hand side of an assignment
_SHOWN_NODES = 40  # of a subexpression in a comment


@dataclass(frozen=True)
class StraightLine:
    """Assignments and results."""

    #: Name, text and comment, which may be empty, of each assignment.
    lines: list[tuple[str, str, str]]
    results: list[str]
    #: Positions of the results that are entries of a matrix or a tensor.
    indices: list[tuple[int, ...]]

    @property
    def assignments(self) -> str:
        """The assignments as lines of a function's body."""
        parts = []
        for name, text, comment in self.lines:
            parts += [f"{_COMMENT}{comment}\n"] if comment else []
            parts.append(f"    {name} = {text}\n")
        return "".join(parts)

    @property
    def entries(self) -> list[str]:
        """The results as entries of a dictionary."""
        return [f"{index}: {text}" for index, text in zip(self.indices, self.results, strict=True)]


def described(filename: str, line: int) -> str:
    """The comment above a line of a generated function, or an empty text."""
    text = linecache.getline(filename, line - 1).rstrip("\n")
    return text.removeprefix(_COMMENT) if text.startswith(_COMMENT) else ""


class StraightLines:
    """The straight-line functions of a Hamiltonian, each derived on first access.

    Raise CodeGenerationError if no arithmetic has a function of H or of a force; the message names
    it.
    """

    def __init__(self, form: Equations, names: Names) -> None:
        lacking = next(filter(None, map(without_arithmetic, form.formulas)), None)
        if lacking is not None:
            raise CodeGenerationError(
                f"'{lacking}' cannot be generated for balls, because it is not smooth or has no "
                "Taylor series there; use another backend"
            )
        self._form, self._names = form, names
        self.inserted = inserted_parameters(form)
        parameters = [
            keyword
            for name, (keyword, _) in zip(form.parameters, names.parameters, strict=True)
            if name not in self.inserted
        ]
        self.arguments = [names.arithmetic, *names.state, "t"]
        self.arguments += ["*", *parameters] if parameters else []

    @property
    def energy(self) -> StraightLine:
        return self._line([self._exact(self._form.exact.expr)])

    @property
    def gradient(self) -> StraightLine:
        return self._line([self._exact(entry) for entry in self._form.exact.gradient])

    @property
    def vector_field(self) -> StraightLine:
        slopes, d = [self._exact(entry) for entry in self._form.exact.slopes], self._form.dof
        return self._line([*slopes[d:], *(-slope for slope in slopes[:d])])

    @property
    def jacobian(self) -> StraightLine:
        """Derivatives of the rates by the state that do not vanish, by (i, j)."""
        return self._tensor(self._form.exact.jacobian)

    @property
    def hessian(self) -> StraightLine:
        """Entries (i, j), i <= j, that do not vanish."""
        entries = self._form.exact.hessian
        return self._tensor({index: e for index, e in entries.items() if index[0] <= index[1]})

    @property
    def third_derivatives(self) -> StraightLine:
        """Entries (i, j, k), i <= j <= k, that do not vanish."""
        return self._tensor(self._form.exact.third_derivatives)

    def _tensor(self, entries: Mapping[Any, sympy.Expr]) -> StraightLine:
        exact = {index: self._exact(entry) for index, entry in entries.items()}
        exact = {index: entry for index, entry in exact.items() if entry != 0}
        return self._line(list(exact.values()), list(exact))

    def _exact(self, entry: sympy.Expr) -> sympy.Expr:
        return self._form.exact.with_fractions(entry, self._form.values)

    def _line(
        self, entries: Sequence[sympy.Expr], indices: Sequence[tuple[int, ...]] = ()
    ) -> StraightLine:
        """Write entries without floating-point numbers."""
        names = self._names
        inserted = {self._form.parameters[name][0]: v for name, v in self.inserted.items()}
        return straight_line(
            entries,
            {s: name for s, name in names.of.items() if s not in inserted},
            names.temporaries(),
            names.arithmetic,
            {s: rational(v) for s, v in inserted.items()},
            indices,
        )


def inserted_parameters(form: Equations) -> dict[str, float]:
    """Parameters that are numbers in the text instead of arguments, with their values.

    They occur in exponents, whose values decide between integer, half-integer and general powers.
    """
    in_exponents = {
        symbol
        for formula in form.formulas
        for power in formula.atoms(sympy.Pow)
        for symbol in power.exp.free_symbols
    }
    return {
        name: value
        for name, (symbol, value) in form.parameters.items()
        if value is not None and symbol in in_exponents
    }


def without_arithmetic(expression: sympy.Expr) -> str | None:
    """The name of a function or constant in an expression that arithmetics lack, or None."""
    for kind in _NOT_SMOOTH:
        if expression.has(kind):
            return _KINKED.get(kind, kind.__name__)
    lowered = Printer({}).lower(expression)
    found = {type(node) for node in lowered.atoms(sympy.Function, sympy.NumberSymbol)}
    known = FUNCTIONS.keys() | {type(constant) for constant in _CONSTANTS}
    return min((kind.__name__ for kind in found - known), default=None)


def straight_line(
    expressions: Sequence[sympy.Expr],
    names: Mapping[sympy.Symbol, str],
    temporaries: Iterator[sympy.Symbol],
    arithmetic: str = "a",
    values: Mapping[sympy.Symbol, sympy.Rational] | None = None,
    indices: Sequence[tuple[int, ...]] = (),
) -> StraightLine:
    """Write expressions as straight-line text.

    Raise CodeGenerationError if arithmetics lack a function of an expression, or a symbol has
    neither name nor value.

    - names: Identifiers of the symbols.
    - temporaries: Names of the assignments.
    - arithmetic: Identifier of the arithmetic.
    - values: Symbols that are numbers in the text.
    - indices: Positions of the expressions in a matrix or a tensor.

    Examples
    --------
    >>> x, y = sympy.symbols("x y", real=True)
    >>> found = straight_line([x**3/3 - 2*x*y], {x: "x", y: "y"}, iter(sympy.symbols("u0:9")))
    >>> found.results
    ['a.number(1, 3)*(x*x*x) - 2*x*y']
    """
    lower = Printer({}).lower
    exact = [lower(without_floats(expression)) for expression in expressions]
    symbols = (_Shared(f"shared{count}", real=True) for count in itertools.count())
    shared, reduced = sympy.cse(exact, symbols=symbols, order="none")
    graph = Graph(names, values or {}, arithmetic)
    for symbol, expression in shared:
        graph.assign(symbol, expression)
    results = [graph.place(expression) for expression in reduced]
    return graph.text(results, temporaries, list(indices))


class _Shared(sympy.Symbol):  # type: ignore[misc]
    """A common subexpression; a class of its own keeps it distinct from every variable."""


@dataclass(frozen=True)
class _Node:
    """An operation on earlier nodes."""

    #: ``"+"``, ``"-"``, ``"*"``, ``"negative"``, the name of a function, ``"integer"`` or
    #: ``"atom"``.
    kind: str
    arguments: tuple[int, ...] = ()
    #: Of an atom or an integer.
    text: str = ""


class Graph:
    """Operations without repetitions, in order of evaluation."""

    def __init__(
        self,
        names: Mapping[sympy.Symbol, str],
        values: Mapping[sympy.Symbol, sympy.Rational],
        arithmetic: str,
    ) -> None:
        self._arithmetic, self._values = arithmetic, values
        self._places: dict[_Node, int] = {}
        self._comments: dict[int, str] = {}
        self._known = {symbol: self._add("atom", text=name) for symbol, name in names.items()}
        self._shown: dict[sympy.Symbol, sympy.Expr] = {}

    # -- operations ----------------------------------------------------------------------------

    def assign(self, symbol: sympy.Symbol, expression: sympy.Expr) -> None:
        """Use a symbol for an expression from here on."""
        self._known[symbol] = self.place(expression)
        self._shown[symbol] = self._brief(expression)

    def place(self, expression: sympy.Expr) -> int:
        """The node of an expression."""
        if expression not in self._known:
            self._known[expression] = self._translated(expression)
        return self._known[expression]

    def _add(self, kind: str, *arguments: int, text: str = "") -> int:
        return self._places.setdefault(_Node(kind, arguments, text), len(self._places))

    def _call(self, name: str, *arguments: int, of: sympy.Expr | None = None) -> int:
        """A function; ``of`` is its subexpression if the function is not smooth everywhere."""
        place = self._add(name, *arguments)
        if of is not None and place not in self._comments:
            text = str(of)
            fits = len(text) <= _LONGEST_COMMENT
            self._comments[place] = text if fits else text[: _LONGEST_COMMENT - 3] + "..."
        return place

    def _translated(self, expression: sympy.Expr) -> int:
        if expression.is_Rational:
            return self._number(expression)
        if expression in _CONSTANTS:
            return self._add("atom", text=f"{self._arithmetic}.{_CONSTANTS[expression]}")
        if expression.is_Symbol:
            if expression not in self._values:
                raise CodeGenerationError(f"'{expression}' has no value; give it one")
            return self._add("atom", text=self._literal(self._values[expression]))
        if expression.is_Add:
            return self._sum(expression)
        if expression.is_Mul:
            return self._product(expression)
        if expression.is_Pow and expression.base is not sympy.E:
            return self._power(expression)
        known = FUNCTIONS | _KINKED
        name = "exp" if expression.is_Pow else known.get(type(expression))
        if name is None:
            raise CodeGenerationError(
                f"'{type(expression).__name__}' cannot be generated for balls; use functions that "
                "have Taylor series"
            )
        arguments = [expression.exp] if expression.is_Pow else expression.args
        places = map(self.place, arguments)
        if name in _ENTIRE:
            return self._call(name, *places)
        return self._call(name, *places, of=expression.func(*map(self._brief, arguments)))

    def _number(self, value: sympy.Rational) -> int:
        return self._add("integer" if value.is_Integer else "atom", text=self._literal(value))

    def _literal(self, value: sympy.Rational) -> str:
        digits = str(value.p) if value.q == 1 else f"{value.p}, {value.q}"
        return f"{self._arithmetic}.number({digits})"

    def _sum(self, expression: sympy.Expr) -> int:
        total: int | None = None
        for term in ordered_terms(expression):
            coefficient = term.as_coeff_Mul()[0]
            negative = coefficient.is_Rational and coefficient < 0
            place = self.place(-term if negative else term)
            if total is None:
                total = self._add("negative", place) if negative else place
            else:
                total = self._add("-" if negative else "+", total, place)
        assert total is not None
        return total

    def _product(self, expression: sympy.Expr) -> int:
        coefficient, rest = expression.as_coeff_Mul()
        if coefficient == -1:
            return self._add("negative", self.place(rest))
        total = None if coefficient == 1 else self._number(coefficient)
        for factor in rest.as_ordered_factors():
            place = self.place(factor)
            total = place if total is None else self._add("*", total, place)
        assert total is not None
        return total

    def _power(self, expression: sympy.Expr) -> int:
        base, exponent = expression.args
        place, shown = self.place(base), self._brief(base)
        known = self._brief(exponent).xreplace(self._values)
        if known.is_Integer:
            if known < 0:
                of = sympy.Pow(shown, -1, evaluate=False)
                place = self._call("reciprocal", place, of=of)
            return self._integer_power(place, abs(int(known)))
        if known.is_Rational and known.q == 2:
            sign = 1 if known > 0 else -1
            half = self._call(
                "root" if known > 0 else "reciprocal_root",
                place,
                of=sympy.Pow(shown, sympy.Rational(sign, 2), evaluate=False),
            )
            return self._integer_power(half, abs(int(known.p)))
        of = sympy.Pow(shown, self._brief(exponent), evaluate=False)
        return self._call("general_power", place, self.place(exponent), of=of)

    def _integer_power(self, place: int, exponent: int) -> int:
        if exponent == 0:
            return self._number(sympy.Integer(1))
        if exponent == 1:
            return place
        half = self._integer_power(place, exponent // 2)
        square = self._add("*", half, half)
        return self._add("*", square, place) if exponent % 2 else square

    def _brief(self, expression: sympy.Expr) -> sympy.Expr:
        """An expression in the caller's symbols, or dots if it is long."""
        found = expression.xreplace(self._shown)
        nodes = itertools.islice(sympy.preorder_traversal(found), _SHOWN_NODES + 1)
        return found if sum(1 for _ in nodes) <= _SHOWN_NODES else sympy.Symbol("...", real=True)

    # -- text ----------------------------------------------------------------------------------

    def text(
        self,
        results: Sequence[int],
        temporaries: Iterator[sympy.Symbol],
        indices: list[tuple[int, ...]],
    ) -> StraightLine:
        """Write the operations, with a line for each that has a comment or several uses."""
        nodes = list(self._places)
        uses = [0] * len(nodes)
        for place in (*results, *(place for node in nodes for place in node.arguments)):
            uses[place] += 1
        lines: list[tuple[str, str, str]] = []
        texts: list[tuple[str, int]] = []  # with precedence

        def assign(place: int) -> None:
            name = next(temporaries).name
            lines.append((name, texts[place][0], self._comments.get(place, "")))
            texts[place] = name, _ATOM

        for place, node in enumerate(nodes):
            written = self._written(node, nodes, texts)
            while len(written[0]) > _LONGEST_TEXT:
                compound = [k for k in node.arguments if "(" in texts[k][0] or " " in texts[k][0]]
                if not compound:
                    break
                assign(max(compound, key=lambda k: len(texts[k][0])))
                written = self._written(node, nodes, texts)
            texts.append(written)
            repeated = uses[place] > 1 and not (
                node.kind == "integer" or written[0].replace(".", "").isidentifier()
            )
            if repeated or place in self._comments:
                assign(place)
        return StraightLine(lines, [texts[place][0] for place in results], indices)

    def _written(
        self, node: _Node, nodes: Sequence[_Node], texts: Sequence[tuple[str, int]]
    ) -> tuple[str, int]:
        def operand(k: int, precedence: int) -> str:
            place, others = node.arguments[k], node.arguments[:k] + node.arguments[k + 1 :]
            if nodes[place].kind == "integer" and any(nodes[o].kind != "integer" for o in others):
                return nodes[place].text.partition("(")[2].rstrip(")")  # an exact Python number
            text, own = texts[place]
            return text if own >= precedence else f"({text})"

        if node.kind in ("atom", "integer"):
            return node.text, _ATOM
        if node.kind == "negative":
            return f"-{operand(0, _MUL)}", _ADD
        if node.kind in ("+", "-"):
            return f"{operand(0, _ADD)} {node.kind} {operand(1, _MUL)}", _ADD
        if node.kind == "*":
            return f"{operand(0, _MUL)}*{operand(1, _ATOM)}", _MUL
        arguments = ", ".join(texts[place][0] for place in node.arguments)
        return f"{self._arithmetic}.{node.kind}({arguments})", _ATOM
