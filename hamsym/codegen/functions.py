"""Compilation of expressions to one function, with numpy or for any arithmetic."""

from __future__ import annotations

import hashlib
import itertools
import linecache
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.names import Names
from hamsym.codegen.printers import NUMPY_DEFINITIONS, NumpyPrinter
from hamsym.codegen.straight_line import straight_line
from hamsym.errors import CodeGenerationError
from hamsym.symbolic.equations import Equations

_INFINITE = (sympy.nan, sympy.zoo, sympy.oo, -sympy.oo)


def compile_expressions(
    expressions: Sequence[sympy.Expr], equations: Equations
) -> Callable[..., np.ndarray]:
    """Compile expressions to a numpy function of states, times and values of the parameters.

    - expressions: In the real symbols of the equations and the time.
    - equations: Every parameter in the expressions must have a value.
    - returns: (z, t=0.0, parameters=None) of shapes (..., dim) and (...) -> (..., k); parameters of
      shape (..., parameters), in the order of those of the equations, replace their values.

    Examples
    --------
    >>> x, p, k = sympy.symbols("x p k", real=True)
    >>> equations = Equations(p**2/2 + k*x**2/2, [x, p], None, {"k": 3.0})
    >>> compile_expressions([k*x, p/2], equations)([2.0, 1.0])
    array([6. , 0.5])
    """
    function = _compiled(expressions_source(expressions, equations))
    keywords = [keyword for keyword, _ in Names(equations).parameters]
    columns = [(k, i) for i, k in enumerate(keywords) if k in (function.__kwdefaults__ or {})]

    def values(z: Any, t: Any = 0.0, parameters: np.ndarray | None = None) -> np.ndarray:
        if parameters is None:
            return np.asarray(function(z, t))
        return np.asarray(function(z, t, **{k: parameters[..., i] for k, i in columns}))

    return values


def compile_observable(expression: sympy.Expr, equations: Equations) -> Callable[..., np.ndarray]:
    """Compile an expression as :func:`compile_expressions` does, to values of shape (...)."""
    function = compile_expressions([expression], equations)
    return lambda z, t=0.0, parameters=None: function(z, t, parameters)[..., 0][()]


def compile_straight_line(
    expressions: Sequence[sympy.Expr], symbols: Sequence[sympy.Symbol]
) -> Callable[..., list[Any]]:
    """Compile expressions to a function of an arithmetic and of a value for each symbol.

    Raise CodeGenerationError if arithmetics lack a function of an expression, or a symbol is not
    given.

    - returns: (a, *values) -> list of results; see :mod:`hamsym.codegen.straight_line`.
    """
    names = {symbol: f"x{k}" for k, symbol in enumerate(symbols)}
    temporaries = (sympy.Symbol(f"u{k}") for k in itertools.count())
    line = straight_line(expressions, names, temporaries)
    return _compiled(
        f"def values({', '.join(('a', *names.values()))}):\n"
        f"{line.assignments}    return [{', '.join(line.results)}]\n"
    )


def _compiled(source: str) -> Callable[..., Any]:
    """The function ``values`` of a module."""
    namespace: dict[str, Any] = {}
    execute(source, "functions", namespace)
    return with_numbers_of_numpy(namespace["values"])


def execute(source: str, name: str, namespace: dict[str, Any]) -> None:
    """Execute a source without a file; tracebacks show it."""
    filename = f"<hamsym {name} {hashlib.sha256(source.encode()).hexdigest()[:12]}>"
    # An entry with mtime None is kept by linecache.checkcache.
    linecache.cache[filename] = (len(source), None, source.splitlines(keepends=True), filename)
    exec(compile(source, filename, "exec"), namespace)  # noqa: S102


def with_numbers_of_numpy(function: Callable[..., Any]) -> Callable[..., Any]:
    """Make the values of parameters numbers of numpy: Python's raise errors in 1/k and k**2."""
    defaults = function.__kwdefaults__ or {}
    for name, value in defaults.items():
        defaults[name] = np.float64(value) if isinstance(value, float) else value
    return function


def expressions_source(expressions: Sequence[sympy.Expr], equations: Equations) -> str:
    """Generate the module of :func:`compile_expressions`, with one function ``values``.

    Raise CodeGenerationError if numpy lacks a function of an expression, or an expression is nested
    too deeply.
    """
    # Strict: text, which sympy would evaluate, is not converted.
    expressions = [sympy.sympify(expression, strict=True) for expression in expressions]
    names = Names(equations)
    names.of.setdefault(sympy.Symbol("t", real=True), "t")
    try:
        temporaries, results = _texts(expressions, names)
    except RecursionError:
        raise CodeGenerationError(
            "the expression is nested too deeply; write it with fewer nested functions"
        ) from None
    used = {symbol.name for expression in expressions for symbol in expression.free_symbols}
    keywords = [
        f"{names.of[symbol]}={value!r}"
        for name, (symbol, value) in equations.parameters.items()
        if name in used
    ]
    dim = len(names.state)
    lines = [
        *temporaries,
        f"out = np.empty((*z.shape[:-1], {len(results)}), z.dtype)",
        *(f"out[..., {k}] = {text}" for k, text in enumerate(results)),
        "return out",
    ]
    body = "\n    ".join(lines)
    definitions = "\n".join(f"{name} = {text}" for name, text in NUMPY_DEFINITIONS.values())
    return f'''"""Functions of the state ({", ".join(names.state)}) with numpy."""

import math

import numpy as np

{definitions}


def values(z, t=0.0{", *, " if keywords else ""}{", ".join(keywords)}):
    """Values of {len(results)} expressions, (..., {dim}) -> (..., {len(results)})."""
    z = np.asarray(z)
    if z.shape[-1:] != ({dim},):
        raise ValueError(f"z has shape {{z.shape}}; its last axis must have length {dim}")
    z = z if z.dtype.kind == "f" else z.astype(float)
    {", ".join(names.state)} = np.moveaxis(z, -1, 0)
    {body}
'''


def _texts(expressions: Sequence[sympy.Expr], names: Names) -> tuple[list[str], list[str]]:
    """Print assignments of common subexpressions, and the results."""
    known = dict(names.of)
    printer = NumpyPrinter(known)
    lowered = [
        sympy.nan if expression.has(*_INFINITE) else printer.lower(expression)
        for expression in expressions
    ]
    shared, reduced = sympy.cse(lowered, symbols=names.temporaries(), order="none")
    assignments = []
    for symbol, expression in shared:
        assignments.append(f"{symbol.name} = {printer(expression)}")
        known[symbol] = symbol.name
    return assignments, ["np.nan" if e is sympy.nan else printer(e) for e in reduced]
