"""Straight-line programs over rows, which the library of :mod:`hamsym.kernel` runs.

Input:  expressions and their symbols.
Output: a :class:`~hamsym.kernel.loops.Program`. The row of an intermediate value is used again
        as soon as the value is no longer needed.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence

import sympy

from hamsym.codegen.straight_line import Graph
from hamsym.errors import CodeGenerationError
from hamsym.formula.printer import Printer
from hamsym.kernel.loops import Equations as Programs
from hamsym.kernel.loops import Program
from hamsym.symbolic.equations import Equations
from hamsym.symbolic.exact import without_floats

#: Operations of the library, in its order (program.h), by the names of straight-line code.
_OPERATIONS = (
    *("copy", "negative", "+", "-", "*", "reciprocal", "root", "abs", "sign", "min", "max"),
    *("sin", "cos", "tan", "exp", "log", "asin", "acos", "atan", "sinh", "cosh", "tanh"),
    *("asinh", "acosh", "atanh", "erf", "general_power", "atan2"),
)
_NUMBER_OF = {name: number for number, name in enumerate(_OPERATIONS)}


def programs_of(form: Equations) -> Programs:
    """Write equations as programs, once for all values of their parameters.

    Raise CodeGenerationError if the library lacks a function of a formula; the message names it.
    """
    return _programs(form.free)


@functools.lru_cache(maxsize=64)
def _programs(form: Equations) -> Programs:
    dof, parameters = form.dof, [symbol for symbol, _ in form.parameters.values()]
    parts = {
        "velocity": form.slopes[dof:],
        "force": [-slope for slope in form.slopes[:dof]],
        "hessian": list(form.stored_curvature.values()),
    }
    if form.has_conserved_values:
        parts["energy"] = [form.expr]
    made = {name: program_of(part, form.z, form.time, parameters) for name, part in parts.items()}
    return Programs(
        dim=len(form.z), separable=form.is_separable, linear=form.has_linear_velocity, **made
    )


def program_of(
    expressions: Sequence[sympy.Expr],
    state: Sequence[sympy.Symbol],
    time: sympy.Symbol | None,
    parameters: Sequence[sympy.Symbol],
) -> Program:
    """Write expressions as a program."""
    lower = Printer({}).lower
    shared = (sympy.Dummy(real=True) for _ in itertools.count())
    exact = [lower(without_floats(expression)) for expression in expressions]
    temporaries, reduced = sympy.cse(exact, symbols=shared, order="none")
    graph = _Steps([*state, time or sympy.Dummy(), *parameters])
    for symbol, expression in temporaries:
        graph.assign(symbol, expression)
    results = [graph.place(expression) for expression in reduced]
    intermediates, steps = graph.steps(results)
    return Program(
        len(state),
        len(parameters),
        len(results),
        numbers=graph.numbers,
        rests=graph.rests,
        intermediates=intermediates,
        steps=steps,
    )


class _Steps(Graph):
    """Operations on rows."""

    def __init__(self, inputs: Sequence[sympy.Symbol]) -> None:
        super().__init__({symbol: str(k) for k, symbol in enumerate(inputs)}, {}, "")
        self._inputs = len(inputs)
        self._numbers: dict[int, tuple[float, float]] = {}

    @property
    def numbers(self) -> list[float]:
        return [number for number, _ in self._numbers.values()]

    @property
    def rests(self) -> list[float]:
        """Exact numbers less those of float64."""
        return [rest for _, rest in self._numbers.values()]

    def _translated(self, expression: sympy.Expr) -> int:
        if not expression.free_symbols:
            return self._constant(expression)
        return super()._translated(expression)

    def _call(self, name: str, *arguments: int, of: sympy.Expr | None = None) -> int:
        if name == "reciprocal_root":
            return self._add("reciprocal", self._add("root", *arguments))
        if len(arguments) > 2:  # the smallest or largest of several
            return self._call(name, self._call(name, *arguments[:-1]), arguments[-1])
        return super()._call(name, *arguments)

    def _number(self, value: sympy.Rational) -> int:
        return self._constant(value)

    def _constant(self, expression: sympy.Expr) -> int:
        """A number, correctly rounded."""
        place = self._add("number", text=str(expression))
        if place not in self._numbers:
            exact = expression if expression.is_Rational else expression.evalf(30)
            try:
                number = int(exact.p) / int(exact.q) if exact.is_Rational else float(exact)
                self._numbers[place] = number, float(exact - sympy.Rational(number))
            except (TypeError, OverflowError) as error:
                raise CodeGenerationError(f"{expression} is not a number of float64") from error
        return place

    def steps(self, results: Sequence[int]) -> tuple[int, list[tuple[int, int, int, int]]]:
        """Return how many rows of intermediate values there are, and the steps."""
        nodes = list(self._places)
        first = self._inputs + len(self._numbers)
        row_of = {place: self._inputs + k for k, place in enumerate(self._numbers)}
        row_of |= {place: int(node.text) for place, node in enumerate(nodes) if node.kind == "atom"}
        # A result has a row of its own; the same value again, an input or a number is copied there.
        own: dict[int, int] = {}
        copies = []
        for k, place in enumerate(results):
            if place in row_of or place in own:
                copies.append((place, first + k))
            else:
                own[place] = first + k
        order = [place for place in self._order(nodes, results) if place not in row_of]
        last = {argument: place for place in order for argument in nodes[place].arguments}
        free: list[int] = []
        rows = itertools.count(first + len(results))
        steps, most = [], first + len(results)
        for place in order:
            node = nodes[place]
            arguments = [row_of[argument] for argument in node.arguments]
            row = own.get(place)
            if row is None:
                row = free.pop() if free else next(rows)
                most = max(most, row + 1)
            row_of[place] = row
            for argument in set(node.arguments):
                if last[argument] == place and row_of[argument] >= first + len(results):
                    free.append(row_of[argument])
            steps.append((_NUMBER_OF[node.kind], row, arguments[0], arguments[-1]))
        steps += [(_NUMBER_OF["copy"], row, row_of[place], row_of[place]) for place, row in copies]
        return most - first - len(results), steps

    @staticmethod
    def _order(nodes: Sequence, results: Sequence[int]) -> list[int]:
        """The places that results are computed from; a sine and its cosine together."""
        found, waiting = set(), list(results)
        while waiting:
            place = waiting.pop()
            if place not in found:
                found.add(place)
                waiting += nodes[place].arguments
        turned: dict[tuple[int, ...], int] = {}  # the first of both
        keys = {}
        for place in sorted(found):
            kind, arguments = nodes[place].kind, nodes[place].arguments
            first = turned.setdefault(arguments, place) if kind in ("sin", "cos") else place
            keys[place] = first, kind == "cos"
        return sorted(found, key=keys.__getitem__)
