"""From a symbolic Hamiltonian to the source of a module, and from source to callables.

Stage 1, expressions.  Input: H in real symbols. Output: the symbolic derivatives each generated
         function needs (:class:`_Expressions` of the Hamiltonian).
Stage 2, names.        Output: an identifier for every symbol, clear of Python's own names and of
         those that the templates use (:class:`Names`).
Stage 3, printing.     Output: expressions as text in the backend's dialect, with common
         subexpressions taken out where that shortens the code (:class:`Body`).
Stage 4, rendering.    One Jinja2 template per backend puts the text into a module.
Stage 5, loading.      The text is registered for tracebacks, executed, and its functions
         collected in a :class:`~hamsym.codegen.system.System`.

What :func:`generate` returns is exactly what :func:`load` runs.
"""

from __future__ import annotations

import ast
import functools
import importlib.resources
import re
import textwrap
from collections.abc import Sequence

import jinja2
import sympy

from hamsym.codegen.bodies import Bodies
from hamsym.codegen.names import Names
from hamsym.codegen.printers import PRINTERS
from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.grammar import GREEK
from hamsym.formula.printer import FormulaPrinter
from hamsym.symbolic.equations import Equations

__all__ = ["BACKENDS", "extract", "generate"]

BACKENDS = tuple(PRINTERS)
_WIDTH = 96
# Up to here a function is written out component by component, as in a textbook.
_TEXTBOOK_DIM = 6


def generate(form: Equations, backend: str) -> str:
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
    names = Names(form)
    try:
        bodies = Bodies(form, names, backend)
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


def _bound(names: Names) -> str | None:
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


# -- names -----------------------------------------------------------------------------------


# -- expressions to text ---------------------------------------------------------------------


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
