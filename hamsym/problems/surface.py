"""Surfaces in phase space, from text like "x = 0, p_x > 0".

Input:  a Hamiltonian and the text of an equation with inequalities.
Output: a :class:`Surface`, whose functions vanish on it or are positive.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_straight_line
from hamsym.codegen.observable import Observable
from hamsym.codegen.straight_line import without_arithmetic
from hamsym.errors import InputError
from hamsym.formula.separation import separated
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.intervals import RangeArithmetic, Ranges
from hamsym.symbolic.exact import rational
from hamsym.symbolic.variables import TIME


@dataclass(frozen=True)
class Surface:
    """A hypersurface g(z, t) = 0 with inequality constraints c_k(z, t) > 0."""

    text: str
    #: Components of z that occur in the equation.
    names: frozenset[str]
    #: (z, t, parameters=None) -> g, shape (...); see :meth:`hamsym.Hamiltonian.observable`.
    value: Observable = field(repr=False)
    #: (z, t, parameters=None) -> c_k, shape (...).
    conditions: tuple[Observable, ...] = field(repr=False)
    #: (component, t, parameter=None) -> g over intervals, from the
    #: :class:`~hamsym.numerics.intervals.Ranges` of each component by its place in ``components``,
    #: of the time, and of each parameter by its number if values are not those of H; None if g is
    #: not smooth.
    enclosed: Callable[..., Ranges] | None = field(repr=False)
    #: Numbers of the components of z in g.
    components: list[int] = field(repr=False)

    def holds(
        self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None = None
    ) -> np.ndarray:
        """Return whether states, shape (n, dim), satisfy the constraints; shape (n,)."""
        found = np.ones(len(z), dtype=bool)
        for condition in self.conditions:
            found &= condition(z, t, parameters) > 0
        return found


def surface_text(H: Hamiltonian, surface: Any) -> str:
    """Return a surface as text; a sympy expression is zero on it, an ``Eq`` is an equation.

    Raise InputError if it is neither.

    Examples
    --------
    >>> x, p = sympy.symbols("x p")
    >>> H = Hamiltonian("p**2/2 - cos(x)")
    >>> surface_text(H, sympy.Eq(p**2, 2 * x)), surface_text(H, x - 1)
    ('p**2 = 2*x', 'x - 1 = 0')
    """
    if isinstance(surface, sympy.Eq):
        sides = surface.lhs, surface.rhs
    elif isinstance(surface, sympy.Expr):
        sides = surface, sympy.Integer(0)
    elif isinstance(surface, str):
        return surface
    else:
        raise InputError(
            f"a surface is a str, not {type(surface).__name__}; write for example 'x = 0, p_x > 0'"
        )
    return " = ".join(H.observable(side).text for side in sides)


def parse_surface(H: Hamiltonian, surface: Any) -> Surface:
    """Parse an equation and any number of inequalities, separated by commas.

    - surface: Text, or what :func:`surface_text` takes.

    Raise InputError if there is not exactly one equation, or a comparison other than ``=``, ``<``
    and ``>``. Raise ParseError, VariableError if a side is not a formula, or has a symbol that H
    does not have.

    Examples
    --------
    >>> surface = parse_surface(Hamiltonian("p_x**2 + p_y**2 + x*y"), "x = 1, p_x > p_y")
    >>> surface.value([[1.5, 0, 0, 0]], 0.0)
    array([0.5])
    """
    text = surface_text(H, surface)
    equations, conditions = [], []
    for part in separated(text):
        left, sign, right = _comparison(part)
        if sign == "=":
            equations.append(_difference(H, left, right))
        else:
            larger, smaller = (left, right) if sign == ">" else (right, left)
            conditions.append(_difference(H, larger, smaller))
    if len(equations) != 1:
        number = "no equation" if not equations else "two equations"
        raise InputError(
            f"'{text}' has {number}; give one equation, x = 0, and inequalities, p_x > 0"
        )
    expr = equations[0]
    value = H.observable(expr)
    symbols = {symbol.name for symbol in expr.free_symbols}
    names = frozenset(name for name in H.names if name in symbols)
    if not names and "t" not in symbols:
        raise InputError(
            f"'{text}' does not depend on the state; use a component of z in the equation"
        )
    observed = tuple(H.observable(condition) for condition in conditions)
    components = [i for i, name in enumerate(H.names) if name in names]
    return Surface(text, names, value, observed, _enclosed(H, expr, components), components)


def _difference(H: Hamiltonian, left: str, right: str) -> sympy.Expr:
    """Return the difference of two formulas in real symbols."""
    return H.observable(left).function - H.observable(right).function


def _enclosed(
    H: Hamiltonian, expr: sympy.Expr, components: Sequence[int]
) -> Callable[..., Ranges] | None:
    """Compile a function for ranges over intervals; None if it is not smooth."""
    function, form = H.function(expr), H.real_equations
    if without_arithmetic(function) is not None:
        return None
    bound = {symbol: value for symbol, value in form.parameters.values() if value is not None}
    parameters = [symbol for symbol, _ in form.parameters.values()]
    time = sympy.Symbol(TIME, real=True)

    @functools.cache
    def program(varied: bool) -> tuple[Callable[..., list[Any]], list[int]]:
        """The text with arguments for parameters or with their values, and which it takes."""
        # A number in an exponent decides between a product and a power.
        exact = (
            function if varied else function.xreplace({s: rational(v) for s, v in bound.items()})
        )
        given = [i for i, symbol in enumerate(parameters) if symbol in exact.free_symbols]
        symbols = [*(form.z[i] for i in components), *(parameters[i] for i in given), time]
        return compile_straight_line([exact], symbols), given

    def enclosed(
        component: Callable[[int], Ranges],
        t: Ranges,
        parameter: Callable[[int], Ranges] | None = None,
    ) -> Ranges:
        run, given = program(parameter is not None)
        own = [parameter(i) for i in given] if parameter else []
        found: Ranges = run(RangeArithmetic(), *map(component, range(len(components))), *own, t)[0]
        return found

    return enclosed


def _comparison(part: str) -> tuple[str, str, str]:
    pieces = re.split("([<>=!]+)", part)
    if len(pieces) != 3 or pieces[1] not in ("=", "<", ">"):
        raise InputError(
            f"'{part.strip()}' is not an equation or inequality; write for example x = 0, p_x > 0"
        )
    return pieces[0].strip(), pieces[1], pieces[2].strip()
