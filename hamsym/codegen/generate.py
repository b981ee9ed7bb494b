"""Generation of a module's text from the equations of a Hamiltonian, part by part.

Stage 1, names.      Output: an identifier for every symbol that differs from the language's names
         and from those in the templates (:class:`~hamsym.codegen.names.Names`).
Stage 2, printing.   Output: expressions as text in the backend's dialect, with common
         subexpressions extracted where that shortens the code
         (:class:`~hamsym.codegen.bodies.Bodies`); for balls, single operations
         (:class:`~hamsym.codegen.straight_line.StraightLines`).
Stage 3, rendering.  One Jinja2 template per backend has a macro for each part of a module; the
         loops of the integrators are plain Python, appended after the kernels.

:mod:`hamsym.codegen.system` executes exactly the text of a :class:`Source`.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import importlib.resources
import re
import textwrap
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jinja2
import sympy

from hamsym.codegen.backends import BACKENDS
from hamsym.codegen.bodies import Bodies, Body
from hamsym.codegen.names import Names
from hamsym.codegen.numba_cache import cached_text
from hamsym.codegen.printers import NUMPY_DEFINITIONS
from hamsym.codegen.straight_line import StraightLine, StraightLines
from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.grammar import GREEK
from hamsym.formula.printer import FormulaPrinter, rewritten_to
from hamsym.support.suggestions import unknown
from hamsym.symbolic.equations import Equations

_WIDTH = 96
# Up to this number of degrees of freedom, deriving the text is faster than reading it from a file.
_MAX_UNCACHED_DOF = 6
# Up to this dimension functions are written component by component, as in a textbook.
_TEXTBOOK_DIM = 6


@dataclass(frozen=True)
class _Part:
    """Dependencies of a part of a module, and the functions that it defines."""

    needs: tuple[str, ...] = ("head",)
    defines: tuple[str, ...] = ()


_LOOPS = "integrator_loops.py"
#: Parts in the order of the module. Those without a macro are sections of the loops.
_FUNCTION_PARTS = {
    "head": _Part(()),
    **{name: _Part(defines=(name,)) for name in ("energy", "gradient", "vector_field", "hessian")},
    **{name: _Part(defines=(name,)) for name in ("jacobian", "power")},
    "residual": _Part(("head", "vector_field"), ("residual",)),
    "loss": _Part(("head", "energy", "residual"), ("loss",)),
}
_STEP_PARTS = {
    "access": _Part(),
    "velocity": _Part(("head", "access")),
    "compensation": _Part(("head", "access")),
    "curvature": _Part(("head", "access")),
    "mixed_derivatives": _Part(),
    "rate_curvature": _Part(("head", "hessian")),
    "parameters": _Part(),
    "integrators": _Part(("head", "parameters")),
    "splitting": _Part(
        ("velocity", "compensation", "integrators"), ("splitting", "splitting_ensemble")
    ),
    "tangents": _Part(
        ("curvature", "integrators"), ("splitting_tangent", "splitting_tangent_ensemble")
    ),
    "linear equations": _Part(),
    "symplectic Euler": _Part(
        ("velocity", "hessian", "mixed_derivatives", "integrators", "linear equations"), ("euler",)
    ),
    "implicit Runge-Kutta": _Part(
        ("vector_field", "rate_curvature", "integrators", "linear equations"), ("implicit",)
    ),
    "doubled phase space": _Part(("gradient", "hessian", "integrators"), ("doubled",)),
}
_BALL_PARTS = {"third_derivatives": _Part(defines=("third_derivatives",))}
_PARTS = _FUNCTION_PARTS | _STEP_PARTS | _BALL_PARTS
# Backends of which each part has the values of parameters in one signature at most.
_VALUES_IN_SIGNATURES = frozenset(("numpy", "torch"))
_ONLY_SEPARABLE = frozenset(("compensation", "curvature", "splitting", "tangents"))
_NOT_SEPARABLE = frozenset(("mixed_derivatives", "symplectic Euler"))
# Parts that systems with forces lack.
_NOT_FORCED = frozenset((*_NOT_SEPARABLE, "doubled phase space"))


class Source:
    """The generated module of one Hamiltonian and backend, in parts.

    Each part is derived and rendered on first access.
    """

    def __init__(self, form: Equations, backend: str) -> None:
        self.form, self.backend, self.names = form, backend, Names(form, backend)
        self._row = BACKENDS[backend]
        self._parts: dict[str, str] = {}

    @property
    def text(self) -> str:
        """Text of the whole module."""
        parts = {"head", *self.functions}
        if self._row.has_loops:
            unused = _NOT_SEPARABLE if self.form.is_separable else _ONLY_SEPARABLE
            if self.form.forces:
                unused = unused | _NOT_FORCED
            parts |= _STEP_PARTS.keys() - unused
        return self._joined(parts)

    @property
    def functions(self) -> tuple[str, ...]:
        """Names of the functions of the module."""
        return (*self._row.functions, *(self._row.forced if self.form.forces else ()))

    def module(self, function: str) -> str:
        """Text of a module with one function and its dependencies."""
        return self._joined(self.needed(function))

    @property
    def is_looped(self) -> bool:
        """Whether the kernels of the integrators loop over terms, with q and p as arrays."""
        return "np.empty(DOF)" in self.part("access")

    def needed(self, function: str) -> list[str]:
        """Names of the part that defines a function and of its dependencies, in order."""
        wanted = [name for name, part in _PARTS.items() if function in part.defines]
        found: list[str] = []
        while wanted:
            name = wanted.pop()
            found = [name, *(other for other in found if other != name)]
            wanted += _PARTS[name].needs
        return found

    def function(self, name: str) -> str:
        """Text of one function of the module.

        Raise InputError if the module has no function of this name.
        """
        own = (*self.functions, *self._row.hidden)
        if self._row.extension == "py":
            return extract(self.part(name) if name in own else self.text, name)
        if name not in own:
            raise _unknown_function(name, own)
        return self.part(name)

    def part(self, name: str) -> str:
        """Text of one part.

        Raise CodeGenerationError if the backend lacks a function of H, or H is nested too deeply.
        """
        if name not in self._parts:
            if name in _sections():
                text = _sections()[name]
            elif self.backend in _VALUES_IN_SIGNATURES and self._free is not None:
                own, free = self.names.keywords, self._free.names.keywords
                text = self._free.part(name).replace(free, own, 1)
            elif self.form.dof <= _MAX_UNCACHED_DOF:
                text = self._rendered(name)
            else:
                text = cached_text(f"{self._key}\n{name}", lambda: self._rendered(name))
            self._parts[name] = text
        return self._parts[name]

    @cached_property
    def _free(self) -> Source | None:
        """The module without values of parameters, which is rendered once for all of them."""
        if all(value is None for _, value in self.form.parameters.values()):
            return None
        return generate(self.form.free, self.backend)

    def _joined(self, names: Iterable[str]) -> str:
        chosen = {*names}
        parts = (self.part(name) for name in _PARTS if name in chosen)
        return "\n\n\n".join(filter(None, parts)) + "\n"

    def _rendered(self, name: str) -> str:
        try:
            return str(getattr(self._template, name)()).strip("\n")
        except RecursionError:
            raise CodeGenerationError(
                "H is nested too deeply; write it with fewer nested functions"
            ) from None

    @cached_property
    def _key(self) -> str:
        """Key of the text cache: everything that determines the text."""
        form = self.form
        parts = (form.formulas, form.z, form.time, tuple(form.parameters.values()))
        return f"{_generator()}\n{self.backend}\n{sympy.srepr(parts)}"

    @cached_property
    def _template(self) -> Any:
        template = environment().get_template(f"{self.backend}.{self._row.extension}.jinja")
        return template.make_module({"m": _Page(self)})


class _Page:
    """Variables of the templates."""

    def __init__(self, source: Source) -> None:
        form, names = source.form, source.names
        self._form, self.backend, self._functions = form, source.backend, source.functions
        self.bodies: Any = (
            StraightLines(form, names)
            if source.backend == "balls"
            else Bodies(form, names, source.backend)
        )
        self.dof, self.dim = form.dof, 2 * form.dof
        self.z, self.dz = names.state, names.derivatives
        self.q, self.p = self.z[: self.dof], self.z[self.dof :]
        self.definitions = [
            definition
            for function, definition in NUMPY_DEFINITIONS.items()
            if form.has(function, *rewritten_to(function))
        ]
        self.conserved = form.conserves_energy
        self.forced = bool(form.forces)
        self.rates = "J grad H + (0, F)" if form.forces else "J grad H"
        self.rest = " - (0, F)" if form.forces else ""
        # Pieces of signatures and calls.
        self.parameters = [name for name, _ in names.parameters]
        self.values = names.parameters
        self.time = ", t" if names.time else ""
        self.at_time = "t" if names.time else "0.0"
        self.keywords = names.keywords
        self.passed = self.time + "".join(f", {name}={name}" for name in self.parameters)
        comma = "," if len(self.parameters) == 1 else ""
        self.as_tuple = f"({', '.join(self.parameters)}{comma})"

    @cached_property
    def formula(self) -> str:
        return self._text(self._form.expr)

    @cached_property
    def forces(self) -> list[tuple[str, str]]:
        """Momenta and their forces as text, in the user's names."""
        momenta = self._form.z[self.dof :]
        return [
            (momentum.name, self._text(force))
            for momentum, force in zip(momenta, self._form.forces, strict=False)
            if force != 0
        ]

    def positions(self, body: Body | StraightLine) -> list[int]:
        """Places of the entries of a matrix in its rows one after the other."""
        return [i * self.dim + j for i, j in body.indices]

    def targets(self, body: Body, mirrored: bool = False) -> list[str]:
        """Entries of a matrix at a point; with ``mirrored`` those of both triangles."""
        entry = "out[point, {}, {}]".format
        return [
            entry(i, j) + (f" = {entry(j, i)}" if mirrored and i != j else "")
            for i, j in body.indices
        ]

    @staticmethod
    def each(form: str, count: int) -> list[str]:
        """A text with each of some numbers."""
        return [form.format(k) for k in range(count)]

    @staticmethod
    def _text(formula: sympy.Expr) -> str:
        formula = FormulaPrinter()(formula)
        if not re.fullmatch(rf"[A-Za-z0-9_{GREEK} +\-*/().,]*", formula):
            # The formula is part of the module's docstrings and must not end them.
            raise CodeGenerationError(
                "the formula contains characters that cannot appear in generated code; use only "
                "letters, digits and underscores in names"
            )
        return formula

    @cached_property
    def identifiers(self) -> frozenset[str]:
        """All names in the expressions of all functions."""
        bodies = (getattr(self.bodies, name) for name in self._functions)
        return frozenset().union(*(body.identifiers for body in bodies))

    @cached_property
    def textbook(self) -> bool:
        """Whether functions are written component by component."""
        return self.dim <= _TEXTBOOK_DIM and not self.bodies.vector_field.temporaries

    @property
    def arithmetic(self) -> str:
        return self.bodies.arguments[0]

    @property
    def inserted(self) -> list[str]:
        return [f"{name} = {value!r}" for name, value in self.bodies.inserted.items()]

    @property
    def squares(self) -> list[str]:
        return [f"({row})**2" for row in self.bodies.residual.results]


@functools.lru_cache(maxsize=256)
def generate(form: Equations, backend: str) -> Source:
    """Generate the module of a Hamiltonian for one backend; cached for equal Hamiltonians.

    Raise InputError if the backend is unknown.
    """
    if backend not in BACKENDS:
        raise InputError(unknown(backend, BACKENDS, "a backend"))
    return Source(form, backend)


def extract(source: str, part: str) -> str:
    """Extract one function of a generated module.

    Raise InputError if the module has no function of this name.
    """
    functions = {
        node.name: node for node in ast.parse(source).body if isinstance(node, ast.FunctionDef)
    }
    if part not in functions:
        raise _unknown_function(part, [name for name in functions if not name.startswith("_")])
    node = functions[part]
    first = min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])
    return "\n".join(source.splitlines()[first - 1 : node.end_lineno])


def _unknown_function(name: str, known: Iterable[str]) -> InputError:
    return InputError(unknown(name, known, "a function of the module"))


# -- templates -------------------------------------------------------------------------------


@functools.cache
def _generator() -> str:
    """Digest of the code generator, so that cached texts of other versions are not used."""
    digest = hashlib.sha256(sympy.__version__.encode())
    for package in ("codegen", "symbolic", "formula", "templates"):
        for file in sorted(importlib.resources.files(f"hamsym.{package}").iterdir(), key=str):
            if file.is_file():
                digest.update(file.read_bytes())
    return digest.hexdigest()


@functools.cache
def _sections() -> dict[str, str]:
    """Sections of the integrators' loops by heading."""
    pieces = re.split(r"^# -- (.+?) -+\n", _read(_LOOPS), flags=re.MULTILINE)[1:]
    ruler = "-" * 84
    return {
        heading: f"# -- {heading} {ruler[len(heading) :]}\n{text}".strip("\n")
        for heading, text in zip(pieces[::2], pieces[1::2], strict=True)
    }


def _read(name: str) -> str:
    return importlib.resources.files("hamsym.templates").joinpath(name).read_text("utf-8")


@functools.cache
def environment() -> jinja2.Environment:
    """Return the environment that renders the templates of code."""
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(_read),
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the output is code, with checked names
    )
    filters = (_filled, _wrapped, _listed, _tupled, _unpacked)
    environment.filters |= {each.__name__[1:]: each for each in filters}
    return environment


def _filled(text: str, indent: int) -> str:
    """Wrap prose of docstrings to the line width."""
    lines = textwrap.wrap(text, _WIDTH - indent, break_long_words=False, break_on_hyphens=False)
    return ("\n" + " " * indent).join(lines)


def _wrapped(text: str, indent: int, before: int = 0) -> str:
    """Break an expression between terms, in parentheses, if the line would be too long."""
    if indent + before + len(text) <= _WIDTH:
        return text
    terms = []
    for term in _pieces(text, (" + ", " - ")):
        fits = indent + 4 + len(term) <= _WIDTH
        terms += [term] if fits else _pieces(term, ("/(", "*("))
    if len(terms) == 1 and indent + 4 + len(text) > _WIDTH:
        return text
    lines, line = [], terms[0]
    for term in terms[1:]:
        blank = " " * (term[0] not in "/*")
        if indent + 4 + len(line + blank + term) > _WIDTH:
            lines.append(line)
            line = term
        else:
            line += blank + term
    inner = ("\n" + " " * (indent + 4)).join([*lines, line])
    return f"(\n{' ' * (indent + 4)}{inner}\n{' ' * indent})"


def _pieces(text: str, operators: Sequence[str]) -> list[str]:
    """Split an expression before operators outside parentheses."""
    depth, start, pieces = 0, 0, []
    for i, character in enumerate(text):
        depth += (character in "([") - (character in ")]")
        power = text[i - 1 : i + 1] == "**"  # its second half is no product
        if i > start and text.startswith(tuple(operators), i) and depth == 0 and not power:
            pieces.append(text[start:i].strip())
            start = i
    return [*pieces, text[start:].strip()]


def _listed(items: Sequence[str], indent: int, before: int = 0) -> str:
    """Join items with commas: on one line if they fit, else in parentheses."""
    line = ", ".join(items)
    if indent + before + len(line) <= _WIDTH:
        return line
    inner = textwrap.fill(line, _WIDTH - indent - 4, break_long_words=False)
    return f"(\n{textwrap.indent(inner + ',', ' ' * (indent + 4))}\n{' ' * indent})"


def _tupled(text: str, indent: int) -> str:
    """Put results in parentheses unless they already are."""
    tupled = text.startswith("(") and text.endswith((",)", "\n" + " " * indent + ")"))
    return text if tupled else f"({text})"


def _unpacked(names: Sequence[str], indent: int) -> str:
    """Left side of an assignment from a tuple."""
    return f"({names[0]},)" if len(names) == 1 else _listed(names, indent, 15)
