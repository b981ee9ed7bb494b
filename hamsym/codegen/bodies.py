"""Bodies of the generated functions: expressions as text, with common subexpressions."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import sympy

from hamsym.codegen import common_parts
from hamsym.codegen.names import Names
from hamsym.codegen.printers import PRINTERS
from hamsym.formula.printer import Printer
from hamsym.symbolic import derivatives
from hamsym.symbolic.equations import Equations

# Common subexpressions are extracted from a function with more operations than this, if that saves
# at least a third of them; smaller functions read better without temporaries.
_CSE_OPERATIONS = 30
_CSE_SAVING = 0.67
# Number of repeated costly terms from which loops are faster to compile.
_MIN_LOOPED_TERMS = 24
_IDENTIFIER = re.compile(r"[^\W\d]\w*")

Index = tuple[int, int]
_Half = tuple[Sequence[sympy.Symbol], list[common_parts.Alike], sympy.Expr]


@dataclass(frozen=True)
class Body:
    """Text of a function's computation: temporaries in order of evaluation, and results."""

    temporaries: list[tuple[str, str]]
    results: list[str]
    names: Names
    #: Positions in the matrix of the results that are matrix entries.
    indices: list[Index]

    @cached_property
    def identifiers(self) -> frozenset[str]:
        """All names in the text."""
        texts = [*(text for _, text in self.temporaries), *self.results]
        return frozenset(name for text in texts for name in _IDENTIFIER.findall(text))

    @property
    def used(self) -> list[str]:
        """Components of the state that occur in the text."""
        return [name for name in self.names.state if name in self.identifiers]

    @property
    def unpacked(self) -> list[str]:
        """Targets to unpack a state: component names, or "_" for those that are not needed."""
        needed = {*self.used, self.like}
        return [name if name in needed else "_" for name in self.names.state]

    def used_of(self, names: Sequence[str]) -> list[str]:
        """The given names, with "_" for those that do not occur."""
        return [name if name in self.identifiers else "_" for name in names]

    @property
    def used_parameters(self) -> bool:
        """Whether any parameter occurs."""
        return any(name in self.identifiers for name, _ in self.names.parameters)

    @property
    def unpacked_parameters(self) -> list[str]:
        """Targets to unpack parameters: names, or "_" for those that do not occur."""
        return self.used_of([name for name, _ in self.names.parameters])

    @property
    def uses_time(self) -> bool:
        """Whether the time occurs."""
        return self.names.time and "t" in self.identifiers

    @property
    def like(self) -> str:
        """Name of an unpacked component, as a template for the shape of tensors."""
        return (self.used or self.names.state)[0]


@dataclass(frozen=True)
class Loop:
    """Derivatives of terms with a common template, computed by a loop over an index table."""

    #: Indices of each term's variables in its half of the state, as text.
    table: list[str]
    #: Factor of each term, as text; empty if the results contain a common factor.
    weights: list[str]
    #: places, indices: Names of the template's variables and of their indices.
    places: list[str]
    indices: list[str]
    #: Derivatives of the template with respect to its variables.
    body: Body


@dataclass(frozen=True)
class Looped:
    """Gradient with respect to one half of the state: loops, and the remaining terms."""

    loops: list[Loop]
    rest: Body


def _body_of(expressions: Callable[[Equations], Sequence[sympy.Expr]]) -> Any:
    """An attribute of bodies: that of some expressions of the equations."""
    return cached_property(lambda bodies: bodies._body(expressions(bodies._form)))


class Bodies:
    """Bodies of all generated functions, each generated on first access."""

    def __init__(self, form: Equations, names: Names, backend: str) -> None:
        self._form, self._names, self._backend = form, names, backend

    # -- functions of the state --------------------------------------------------------------

    energy = _body_of(lambda form: [form.expr])
    gradient = _body_of(lambda form: form.gradient)
    vector_field = _body_of(lambda form: form.vector_field)
    power = _body_of(lambda form: [form.power])  # dH/dt along trajectories

    @cached_property
    def hessian(self) -> Body:
        """Upper triangle of the Hessian."""
        return self._matrix([], {(i, j): e for (i, j), e in self._form.hessian.items() if i <= j})

    @property
    def hessian_rows(self) -> list[list[str]]:
        """Rows of the full Hessian, with ``zero`` for entries that vanish."""
        entries = dict(zip(self.hessian.indices, self.hessian.results, strict=True))
        return self._rows(entries | {(j, i): text for (i, j), text in entries.items()})

    @cached_property
    def jacobian(self) -> Body:
        """Derivatives of the rates by the state."""
        return self._matrix([], self._form.jacobian)

    @property
    def jacobian_rows(self) -> list[list[str]]:
        """Rows of the derivatives of the rates, with ``zero`` for entries that vanish."""
        return self._rows(dict(zip(self.jacobian.indices, self.jacobian.results, strict=True)))

    def _rows(self, entries: Mapping[Index, str]) -> list[list[str]]:
        dim = range(len(self._form.z))
        return [[entries.get((i, j), "zero") for j in dim] for i in dim]

    @cached_property
    def residual(self) -> Body:
        """Components of the residual, derivative first: ``"dp + x + x**3"``."""
        printer = self._printer(self._form.z, self._names.of)
        rows = []
        for name, rate in zip(self._names.derivatives, self._form.vector_field, strict=True):
            text = printer(-rate) if rate != 0 else ""
            if text.startswith("-"):
                text = f" - {text[1:]}"
            elif text:
                text = f" + {text}"
            rows.append(name + text)
        return Body([], rows, self._names, [])

    # -- kernels of the integrators ----------------------------------------------------------

    velocity = _body_of(lambda form: form.gradient[form.dof :])  # dH/dp
    slope = _body_of(lambda form: form.slopes[: form.dof])  # dH/dq - F
    force = _body_of(lambda form: form.vector_field[form.dof :])  # -dH/dq + F

    @cached_property
    def curvature(self) -> Body:
        """Derivatives of dH/dq - F and dH/dp; the upper triangle of the Hessian without forces."""
        return self._matrix([], self._form.stored_curvature) if self._form.forces else self.hessian

    @cached_property
    def is_looped(self) -> bool:
        """Whether repeated costly terms are computed by loops instead of being written out."""
        return any(
            sum(len(group.rows) - 1 for group in groups) >= _MIN_LOOPED_TERMS
            for _, groups, _ in self._halves
        )

    @property
    def velocity_loops(self) -> Looped:
        """dH/dp, with loops over costly terms that have a common template."""
        return self._looped(*self._halves[1])

    @property
    def slope_loops(self) -> Looped:
        """dH/dq, with loops over costly terms that have a common template."""
        return self._looped(*self._halves[0])

    @cached_property
    def _halves(self) -> list[_Half]:
        """Coordinates and momenta of a separable H, each with the terms that contain them."""
        form, d = self._form, self._form.dof
        if (
            form.forces
            or not form.is_separable
            or len(sympy.Add.make_args(form.expr)) < _MIN_LOOPED_TERMS
        ):
            return []
        found: list[_Half] = []
        for half in (form.z[:d], form.z[d:]):
            terms = [e for e in sympy.Add.make_args(form.expr) if e.free_symbols & set(half)]
            # Polynomials are faster written out than in a loop.
            cheap = [term for term in terms if term.is_polynomial(*half)]
            costly = [term for term in terms if term not in cheap]
            groups, rest = common_parts.alike_terms(sympy.Add(*costly), half)
            found.append((half, groups, sympy.Add(rest, *cheap)))
        return found

    def _looped(
        self, half: Sequence[sympy.Symbol], groups: Sequence[common_parts.Alike], rest: sympy.Expr
    ) -> Looped:
        position = {symbol: i for i, symbol in enumerate(half)}
        loops = [self._loop(group, position) for group in groups]
        return Looped(loops, self._body(derivatives.gradient(rest, half)))

    def _loop(self, group: common_parts.Alike, position: Mapping[sympy.Symbol, int]) -> Loop:
        places = list(itertools.islice(self._names.temporaries("a"), len(group.places)))
        names = {symbol: symbol.name for symbol in places}
        template = group.template.xreplace(dict(zip(group.places, places, strict=True)))
        rows = [[position[symbol] for symbol in row] for row in group.rows]
        order = sorted(range(len(rows)), key=rows.__getitem__)
        weights = [self._printer([], {})(group.factors[k]) for k in order]
        if len(set(weights)) == 1:
            template, weights = template * group.factors[0], []
        return Loop(
            [f"({', '.join(map(str, rows[k]))},)" for k in order],
            weights,
            list(names.values()),
            [s.name for s in itertools.islice(self._names.temporaries("i"), len(places))],
            self._body(derivatives.gradient(template, places), more=names),
        )

    @cached_property
    def velocity_curvature(self) -> Body:
        """dH/dp and its derivatives with respect to p."""
        d = self._form.dof
        kinetic = {(i - d, j - d): e for (i, j), e in self._form.hessian.items() if min(i, j) >= d}
        return self._matrix(self._form.gradient[d:], kinetic)

    @cached_property
    def slope_curvature(self) -> Body:
        """dH/dq - F and its derivatives with respect to q."""
        d = self._form.dof
        potential = {index: e for index, e in self._form.curvature.items() if max(index) < d}
        return self._matrix(self._form.slopes[:d], potential)

    @cached_property
    def velocity_jacobian(self) -> Body:
        """dH/dp and the mixed second derivatives."""
        return self._matrix(self._form.gradient[self._form.dof :], self._mixed)

    @cached_property
    def slope_jacobian(self) -> Body:
        """dH/dq and the mixed second derivatives."""
        return self._matrix(self._form.gradient[: self._form.dof], self._mixed)

    @property
    def _mixed(self) -> dict[Index, sympy.Expr]:
        d = self._form.dof
        return {(i - d, j): e for (i, j), e in self._form.hessian.items() if j < d <= i}

    # -- text --------------------------------------------------------------------------------

    def _printer(self, state: Iterable[sympy.Symbol], names: dict[sympy.Symbol, str]) -> Printer:
        return PRINTERS[self._backend](names, frozenset(state), self._names.state[0])

    def _matrix(self, first: Sequence[sympy.Expr], entries: Mapping[Index, sympy.Expr]) -> Body:
        return self._body([*first, *entries.values()], list(entries))

    def _body(
        self,
        exprs: Sequence[sympy.Expr],
        indices: Sequence[Index] = (),
        more: Mapping[sympy.Symbol, str] | None = None,
    ) -> Body:
        names, state = {**self._names.of, **(more or {})}, set(self._form.z)
        printer = self._printer(state, names)
        exprs = [printer.lower(expr) for expr in exprs]
        replacements, exprs = _common_subexpressions(exprs, self._names.temporaries())
        temporaries = []
        for symbol, expr in replacements:
            temporaries.append((symbol.name, printer(expr)))
            names[symbol] = symbol.name
            if expr.free_symbols & state:
                state.add(symbol)
            printer = self._printer(state, names)
        results = [printer.result(expr) for expr in exprs]
        return Body(temporaries, results, self._names, list(indices))


def _common_subexpressions(
    exprs: list[sympy.Expr], symbols: Iterator[sympy.Symbol]
) -> tuple[list[tuple[sympy.Symbol, sympy.Expr]], list[sympy.Expr]]:
    if not _has_operations(exprs, _CSE_OPERATIONS + 1):
        return [], exprs
    # The canonical order is slow to find for large expressions.
    replacements, shorter = sympy.cse(exprs, symbols=symbols, order="none")
    after = sum(int(sympy.count_ops(expr)) for _, expr in replacements)
    after += sum(int(sympy.count_ops(expr)) for expr in shorter)
    saved = _has_operations(exprs, after / _CSE_SAVING)
    return (replacements, shorter) if saved else ([], exprs)


def _has_operations(exprs: Sequence[sympy.Expr], count: float) -> bool:
    """Whether expressions have at least ``count`` operations; counting stops there."""
    total = 0
    for expr in exprs:
        total += int(sympy.count_ops(expr))
        if total >= count:
            return True
    return False
