"""From a symbolic Hamiltonian to the source of a module, and from source to callables.

Stage 1, expressions.  Input: H in real symbols. Output: the symbolic derivatives each generated
         function needs (:class:`_Expressions` of the Hamiltonian).
Stage 2, names.        Output: an identifier for every symbol, clear of Python's own names and of
         those that the templates use (:class:`_Names`).
Stage 3, printing.     Output: expressions as text in the backend's dialect, with common
         subexpressions taken out where that shortens the code (:class:`Body`).
Stage 4, rendering.    One Jinja2 template per backend puts the text into a module.
Stage 5, loading.      The text is registered for tracebacks, executed, and its functions
         collected in a :class:`~hamsym.system.System`.

What :func:`generate` returns is exactly what :func:`load` runs.
"""

from __future__ import annotations

import ast
import builtins
import functools
import hashlib
import importlib.resources
import inspect
import keyword
import linecache
import re
import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import jinja2
import sympy

from hamsym import compiled, derivatives
from hamsym.errors import CodeGenerationError, InputError
from hamsym.printing import PRINTERS, FormulaPrinter, Printer, TorchPrinter
from hamsym.realform import RealForm
from hamsym.syntax import GREEK
from hamsym.system import System

__all__ = ["BACKENDS", "extract", "generate", "load"]

BACKENDS = tuple(PRINTERS)
_WIDTH = 96
# Up to here a function is written out component by component, as in a textbook.
_TEXTBOOK_DIM = 6
# Common subexpressions are taken out of a function with more operations than this, if that saves
# at least a third of them; smaller functions read better without temporaries.
_CSE_OPERATIONS = 30
_CSE_SAVING = 0.67

_FUNCTIONS = ("energy", "gradient", "vector_field", "hessian", "residual", "loss")
_STEP_LOOPS = (
    *(f"splitting{kind}" for kind in ("", "_compensated", "_ensemble", "_ensemble_compensated")),
    *("splitting_tangent", "symplectic_euler", "symplectic_euler_p", "implicit", "doubled"),
)
# Every name that a template assigns, imports or takes as an argument.
_TEMPLATE_NAMES = frozenset(
    """
    torch np math njit z dz t z0 out value matrix entries positions rows zero point points times
    energy_0 energy_weight energy_error rates states
    low columns done starts sizes first saves save_every stages terms trajectory save step step_size
    elapsed stage drift kick kicks change moved lanes low_lanes base count lane component curvature
    column row size pivot pivots old correction attempt previous scale converged between second
    right left entry factor block tangents coefficients weights weight nodes continued increments
    slopes state stale half largest at over point others fresh coupling other vectors angle
    cosine sine splitting splitting_compensated splitting_ensemble
    splitting_ensemble_compensated
    splitting_tangent symplectic_euler symplectic_euler_p implicit doubled
    """.split()
) | frozenset(_FUNCTIONS)


@dataclass(frozen=True)
class Body:
    """Text of a function's computation: temporaries in order, then the results."""

    temporaries: list[tuple[str, str]]
    results: list[str]


def generate(form: RealForm, backend: str) -> str:
    """The source of the module that evaluates a Hamiltonian with one backend.

    Raises
    ------
    InputError
        If the backend is unknown.
    CodeGenerationError
        If H contains a function that the backend lacks.
    """
    if backend not in PRINTERS:
        raise InputError(f"'{backend}' is not a backend; choose one of {', '.join(BACKENDS)}")
    formula = FormulaPrinter()(form.expr)
    if not re.fullmatch(rf"[A-Za-z0-9_{GREEK} +\-*/().,]*", formula):
        # The formula stands in docstrings of the module; nothing else may get into them.
        raise CodeGenerationError("the formula holds more than names, numbers and functions")
    names = _Names(form)
    try:
        bodies = _Bodies(form, names, backend)
    except RecursionError:
        raise CodeGenerationError("the Hamiltonian is nested too deeply; split it") from None
    dim, indices = len(form.z), list(form.hessian)
    textbook = dim <= _TEXTBOOK_DIM and not bodies.vector_field.temporaries
    keywords = [name if value is None else f"{name}={value!r}" for name, value in names.parameters]
    parameter_names = [name for name, _ in names.parameters]
    time = [] if form.time is None else ["t"]
    return (
        _environment()
        .get_template(f"{backend}_system.py.jinja")
        .render(
            dim=dim,
            dof=form.dof,
            formula=formula,
            z=names.state,
            lows=names.low_parts,
            dz=names.derivatives,
            time=", t" if time else "",
            keywords=", *, " + ", ".join(keywords) if keywords else "",
            positional="".join(f", {name}" for name in parameter_names),
            bound=_bound(names),
            passed="".join([", t" for _ in time] + [f", {n}={n}" for n in parameter_names]),
            textbook=textbook,
            separable=form.is_separable if backend == "numba" else None,
            squares=[f"({row})**2" for row in bodies.residual],
            component_targets=[f", {i}" for i in range(dim)],
            hessian_indices=indices,
            hessian_positions=[i * dim + j for i, j in indices],
            hessian_targets=[f", {i}, {j}" for i, j in indices],
            hessian_rows=_matrix_rows(indices, bodies.hessian.results, dim) if textbook else [],
            uses_erf=form.expr.has(sympy.erf),
            **bodies.by_name(),
        )
    )


def _bound(names: _Names) -> str | None:
    """The parameters' values as further arguments, if all of them have one."""
    values = [value for _, value in names.parameters]
    return None if None in values else "".join(f", {value!r}" for value in values)


def _matrix_rows(indices: list[tuple[int, int]], texts: list[str], dim: int) -> list[list[str]]:
    entries = dict(zip(indices, texts, strict=True))
    return [[entries.get((i, j), "zero") for j in range(dim)] for i in range(dim)]


def extract(source: str, part: str) -> str:
    """One function of a generated module.

    Raises
    ------
    InputError
        If the module has no function of this name.
    """
    functions = {
        node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)
    }
    if part not in functions:
        known = ", ".join(name for name in functions if not name.startswith("_"))
        raise InputError(f"'{part}' is not a part of the source; choose one of {known}")
    node = functions[part]
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    return "\n".join(source.splitlines()[first - 1 : node.end_lineno])


@functools.lru_cache(maxsize=256)
def load(source: str, backend: str, names: tuple[str, ...]) -> System:
    """Run a generated module and collect its functions; the same text is loaded once."""
    module = compiled.load_module(source, backend) if backend == "numba" else _run(source, backend)
    functions: dict[str, Any] = {name: getattr(module, name) for name in _FUNCTIONS}
    loops = {name: getattr(module, name) for name in _STEP_LOOPS if hasattr(module, name)}
    return System(
        backend=backend,
        names=names,
        source=source,
        step_loops=loops,
        rates=getattr(module, "rates", None),
        time_dependent="t" in inspect.signature(functions["energy"]).parameters,
        **functions,
    )


def _run(source: str, backend: str) -> ModuleType:
    """A module without a file; tracebacks show its source all the same."""
    digest = hashlib.sha256(source.encode()).hexdigest()[:12]
    filename = f"<hamsym {backend} {digest}>"
    # With mtime None the entry outlives linecache.checkcache.
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
    module = ModuleType(f"hamsym_{backend}_{digest}")
    exec(compile(source, filename, "exec"), module.__dict__)
    return module


# -- names -----------------------------------------------------------------------------------


class _Names:
    """Identifiers: the user's names, with an underscore where they mean something in the code."""

    def __init__(self, form: RealForm) -> None:
        self._taken = set(_TEMPLATE_NAMES) | set(dir(builtins)) | set(keyword.kwlist)
        self.of: dict[sympy.Symbol, str] = {}
        if form.time is not None:
            self.of[form.time] = "t"  # reserved for the time, which is what this symbol is
        self.time = form.time is not None
        self.state = [self._claim(symbol) for symbol in form.z]
        self.parameters = [
            (self._claim(symbol), value) for symbol, value in form.parameters.values()
        ]
        self.derivatives = [self.unused("d" + name) for name in self.state]
        self.low_parts = [self.unused(name + "_low") for name in self.state]

    def _claim(self, symbol: sympy.Symbol) -> str:
        self.of[symbol] = self.unused(symbol.name)
        return self.of[symbol]

    def unused(self, name: str) -> str:
        while name in self._taken:
            name += "_"
        self._taken.add(name)
        return name

    def temporaries(self) -> Iterator[sympy.Symbol]:
        """Endless symbols u0, u1, ... that no name of the user's collides with."""
        for number in range(10**9):
            if f"u{number}" not in self._taken:
                yield sympy.Symbol(f"u{number}", real=True)
        raise AssertionError("unreachable")


# -- expressions to text ---------------------------------------------------------------------


class _Bodies:
    """The computation of every generated function, as text."""

    def __init__(self, form: RealForm, names: _Names, backend: str) -> None:
        self._names, self._backend = names, backend
        self._state = frozenset(form.z)
        d, gradient = form.dof, form.gradient
        self.energy = self._body([form.expr])
        self.gradient = self._body(gradient)
        self.vector_field = self._body(form.vector_field)
        self.hessian = self._body(list(form.hessian.values()))
        self.residual = self._residual_rows(form.vector_field)
        if backend != "numba":
            return
        # The step loops: dH/dp and dH/dq, by themselves and with what their derivatives need.
        kinetic = {
            (i - d, j - d): entry for (i, j), entry in form.hessian.items() if min(i, j) >= d
        }
        potential = {index: entry for index, entry in form.hessian.items() if max(index) < d}
        mixed = {(i - d, j): entry for (i, j), entry in form.hessian.items() if j < d <= i}
        self.kinetic_indices, self.potential_indices = list(kinetic), list(potential)
        self.mixed_indices = list(mixed)
        self.velocity = self._body(gradient[d:])
        self.force = self._body(gradient[:d])
        if form.is_separable:
            self.velocity_curvature = self._body([*gradient[d:], *kinetic.values()])
            self.force_curvature = self._body([*gradient[:d], *potential.values()])
        else:
            self.velocity_jacobian = self._body([*gradient[d:], *mixed.values()])
            self.force_jacobian = self._body([*gradient[:d], *mixed.values()])

    def by_name(self) -> dict[str, Any]:
        return {name: value for name, value in vars(self).items() if not name.startswith("_")}

    def _printer(self, state: Iterable[sympy.Symbol], names: dict[sympy.Symbol, str]) -> Printer:
        if self._backend == "torch":
            return TorchPrinter(names, frozenset(state), self._names.state[0])
        return PRINTERS[self._backend](names)

    def _body(self, exprs: Sequence[sympy.Expr]) -> Body:
        names, state = dict(self._names.of), set(self._state)
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
        text = printer.spread if isinstance(printer, TorchPrinter) else printer
        return Body(temporaries, [text(expr) for expr in exprs])

    def _residual_rows(self, vector_field: Sequence[sympy.Expr]) -> list[str]:
        """Rows of the residual with the derivative first, such as ``"dp + x + x**3"``."""
        printer = self._printer(self._state, self._names.of)
        rows = []
        for name, rate in zip(self._names.derivatives, vector_field, strict=True):
            text = printer(-rate)
            if rate == 0:
                text = ""
            elif text.startswith("-"):
                text = f" - {text[1:]}"
            else:
                text = f" + {text}"
            rows.append(name + text)
        return rows


def _common_subexpressions(
    exprs: list[sympy.Expr], symbols: Iterator[sympy.Symbol]
) -> tuple[list[tuple[sympy.Symbol, sympy.Expr]], list[sympy.Expr]]:
    if not _has_operations(exprs, _CSE_OPERATIONS + 1):
        return [], exprs
    replacements, shorter = derivatives.common_subexpressions(exprs, symbols)
    after = sum(int(sympy.count_ops(expr)) for _, expr in replacements)
    after += sum(int(sympy.count_ops(expr)) for expr in shorter)
    saved = _has_operations(exprs, after / _CSE_SAVING)
    return (replacements, shorter) if saved else ([], exprs)


def _has_operations(exprs: Sequence[sympy.Expr], count: float) -> bool:
    """Whether expressions have so many operations; counting further would cost as much again."""
    total = 0
    for expr in exprs:
        total += int(sympy.count_ops(expr))
        if total >= count:
            return True
    return False


# -- templates -------------------------------------------------------------------------------


@functools.cache
def _environment() -> jinja2.Environment:
    def read(name: str) -> str:
        return importlib.resources.files("hamsym.templates").joinpath(name).read_text("utf-8")

    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(read),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the output is Python, and every name in it has been checked
    )
    environment.filters["filled"] = _filled
    environment.filters["wrapped"] = _wrapped
    environment.filters["listed"] = _listed
    return environment


def _filled(text: str, indent: int) -> str:
    """Prose wrapped to the width of the page, for docstrings."""
    lines = textwrap.wrap(text, _WIDTH - indent, break_long_words=False, break_on_hyphens=False)
    return ("\n" + " " * indent).join(lines)


def _wrapped(text: str, indent: int, before: int = 0) -> str:
    """An expression, broken between its terms and in parentheses if the line would be too long."""
    if indent + before + len(text) <= _WIDTH:
        return text
    depth, start, terms = 0, 0, []
    for i, character in enumerate(text):
        depth += (character in "([") - (character in ")]")
        if depth == 0 and i > start and text[i : i + 3] in (" + ", " - "):
            terms.append(text[start:i])
            start = i + 1
    terms.append(text[start:])
    if len(terms) == 1:
        return text
    lines, line = [], terms[0]
    for term in terms[1:]:
        if indent + 4 + len(line) + len(term) + 1 > _WIDTH:
            lines.append(line)
            line = term
        else:
            line += " " + term
    inner = ("\n" + " " * (indent + 4)).join([*lines, line])
    return f"(\n{' ' * (indent + 4)}{inner}\n{' ' * indent})"


def _listed(items: Sequence[str], indent: int, before: int = 0) -> str:
    """Items separated by commas: on one line if they fit, else in parentheses."""
    line = ", ".join(items)
    if indent + before + len(line) <= _WIDTH:
        return line
    inner = textwrap.fill(line, _WIDTH - indent - 4, break_long_words=False)
    return f"(\n{textwrap.indent(inner + ',', ' ' * (indent + 4))}\n{' ' * indent})"
