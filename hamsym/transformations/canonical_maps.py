"""Canonical maps z = Phi(Z, t), in symbols: completed, solved for, and decided.

Input:  formulas of old variables in new ones, or a generating function.
Output: :class:`CanonicalMap`, and the Hamiltonian of the new variables.

With M = dPhi/dZ, the map is canonical if and only if the Poisson brackets of the old variables in
the new ones are those of coordinates and momenta, M^T J M = J. The new Hamiltonian is

    K(Z, t) = H(Phi(Z, t), t) + R,    dR/dZ = M^T J dPhi/dt,

with R = 0 where the map does not depend on time (Goldstein, Poole & Safko, Classical Mechanics, 3rd
ed., chapter 9).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import sympy

from hamsym.codegen.functions import compile_observable
from hamsym.errors import CodeGenerationError, InputError
from hamsym.formula.effort_limit import CallLimitExceededError, call_limit
from hamsym.hamiltonian import Hamiltonian
from hamsym.symbolic import derivatives
from hamsym.symbolic.brackets import poisson_bracket
from hamsym.symbolic.rational_matrices import inverse_matrix
from hamsym.symbolic.variables import TIME

_TIME = sympy.Symbol(TIME, real=True)
# Function calls, most of them sympy's, and seconds of one search or decision.
_EFFORT, _SECONDS = 20_000_000, 20.0
#: Of each generating function: signs and arguments of the two halves of the equations.
GENERATING = {"F1": ("q", "Q"), "F2": ("q", "P"), "F3": ("p", "Q"), "F4": ("p", "P")}

Symbols = Sequence[sympy.Symbol]


@dataclass(frozen=True)
class CanonicalMap:
    """A canonical map, in real symbols.

    - old, new: The variables z = (q, p) and Z = (Q, P) of the pairs that change.
    - formulas: Phi, in the order of ``old``.
    - rest: R, which the map adds to H.
    """

    old: tuple[sympy.Symbol, ...]
    new: tuple[sympy.Symbol, ...]
    formulas: tuple[sympy.Expr, ...]
    rest: sympy.Expr


@contextmanager
def limited(what: str) -> Iterator[None]:
    """Stop a symbolic computation that takes too long, with an error that names it."""
    try:
        with call_limit(_EFFORT, _SECONDS):
            yield
    except CallLimitExceededError:
        raise InputError(f"{what} takes too long; give simpler formulas") from None
    except CodeGenerationError:
        raise InputError(f"the derivatives of {what} are too large") from None


def point_map(old: Symbols, new: Symbols, coordinates: Sequence[sympy.Expr]) -> CanonicalMap:
    """Complete a map of coordinates q = f(Q, t) by the momenta: p = (df/dQ)^-T P.

    Raise InputError if df/dQ is singular.

    Examples
    --------
    >>> x, p, s, r = sympy.symbols("x p s r", real=True)
    >>> point_map([x, p], [s, r], [s**3]).formulas
    (s**3, r/(3*s**2))
    """
    half = len(coordinates)
    places, momenta = new[:half], new[half:]
    with limited("the inverse of the transformation"):
        rows = [derivatives.gradient(f, places) for f in coordinates]
        entries, determinant = inverse_matrix(rows)
        if determinant is None:
            raise InputError(
                "the coordinates do not determine the new ones: the determinant of their "
                f"derivatives by {', '.join(s.name for s in places)} is zero"
            )
        # p_i = sum_j P_j (dQ_j/dq_i)
        found = [
            _sum_of_products(momenta, [shorter(entry / determinant) for entry in column])
            for column in zip(*entries, strict=True)
        ]
        rest = -_sum_of_products(found, [sympy.diff(f, _TIME) for f in coordinates])
    return _canonical(CanonicalMap(tuple(old), tuple(new), (*coordinates, *found), shorter(rest)))


def full_map(old: Symbols, new: Symbols, formulas: Sequence[sympy.Expr]) -> CanonicalMap:
    """A canonical map that is given for coordinates and momenta.

    Raise InputError if it is not canonical, or the term of its time is not found.
    """
    found = _canonical(CanonicalMap(tuple(old), tuple(new), tuple(formulas), sympy.Integer(0)))
    with limited("the term of the time"):
        return replace(found, rest=_integrated(_slopes_of_rest(formulas, new), new))


def generated_map(kind: str, function: sympy.Expr, old: Symbols, new: Symbols) -> CanonicalMap:
    """The map of a generating function: F1(q, Q), F2(q, P), F3(p, Q) or F4(p, P).

    Raise InputError if its equations have no solution for the old variables, or several.

    Examples
    --------
    >>> x, p, X, P = sympy.symbols("x p X P", real=True)
    >>> generated_map("F2", x*P + P**2/2, [x, p], [X, P]).formulas
    (-P + X, P)
    """
    half = len(old) // 2
    q, p, Q, P = old[:half], old[half:], new[:half], new[half:]
    of_old, of_new = GENERATING[kind]
    # p = dF/dq or q = -dF/dp, and P = -dF/dQ or Q = dF/dP
    first = [(p, q, 1), (q, p, -1)][of_old == "p"]
    second = [(P, Q, -1), (Q, P, 1)][of_new == "P"]
    equations = [
        value - sign * sympy.diff(function, argument)
        for values, arguments, sign in (first, second)
        for value, argument in zip(values, arguments, strict=True)
    ]
    with limited(f"the solution of the equations of {kind}"):
        try:
            solutions = sympy.solve(equations, list(old), dict=True)
        except NotImplementedError:
            solutions = []
        complete = [s for s in solutions if all(v in s for v in old) and not _is_complex(s)]
        if len(complete) != 1:
            count = "no solution" if not complete else f"{len(complete)} solutions"
            raise InputError(
                f"the equations of {kind} have {count} for {', '.join(s.name for s in old)}; give "
                "the map itself, as formulas of these in the new variables"
            )
        formulas = [shorter(complete[0][v]) for v in old]
        # K = H + dF/dt at fixed arguments
        rest = sympy.diff(function, _TIME).xreplace(dict(zip(old, formulas, strict=True)))
    return _canonical(CanonicalMap(tuple(old), tuple(new), tuple(formulas), shorter(rest)))


def _is_complex(solution: Mapping[sympy.Symbol, sympy.Expr]) -> bool:
    return any(value.has(sympy.I, sympy.Piecewise, sympy.RootOf) for value in solution.values())


def _canonical(found: CanonicalMap) -> CanonicalMap:
    """The map, which must be canonical: that is decided by its Poisson brackets in symbols.

    Raise InputError that names a pair with another bracket, or one that is not decided.
    """
    half = len(found.old) // 2
    pairs = itertools.combinations(range(len(found.old)), 2)
    for i, j in pairs:
        expected = sympy.Integer(int(j == i + half))
        with limited("the Poisson brackets of the transformation"):
            bracket = poisson_bracket(found.formulas[i], found.formulas[j], found.new)
            decided = derivatives.vanishes(_slowed(bracket - expected)[1])
        if not decided:
            names = f"{{{found.old[i].name}, {found.old[j].name}}}"
            with limited("the Poisson brackets of the transformation"):
                bracket = sympy.simplify(bracket)
            raise InputError(
                f"the transformation is not canonical: {names} is {bracket} in the new variables, "
                f"not {expected}"
            )
    return found


def _slopes_of_rest(formulas: Sequence[sympy.Expr], new: Symbols) -> list[sympy.Expr]:
    """M^T J dPhi/dt."""
    half = len(formulas) // 2
    rates = [sympy.diff(f, _TIME) for f in formulas]
    turned = [*rates[half:], *(-rate for rate in rates[:half])]
    return [shorter(_sum_of_products([sympy.diff(f, v) for f in formulas], turned)) for v in new]


def _sum_of_products(some: Sequence[sympy.Expr], others: Sequence[sympy.Expr]) -> sympy.Expr:
    return sympy.Add(*(a * b for a, b in zip(some, others, strict=True)))


def _integrated(slopes: Sequence[sympy.Expr], new: Symbols) -> sympy.Expr:
    """A function with given derivatives.

    Raise InputError if it is not found.
    """
    found = sympy.Integer(0)
    for slope, variable in zip(slopes, new, strict=True):
        missing = shorter(slope - sympy.diff(found, variable))
        found += sympy.integrate(missing, variable)
    for slope, variable in zip(slopes, new, strict=True):
        if found.has(sympy.Integral) or not derivatives.vanishes(
            sympy.diff(found, variable) - slope
        ):
            raise InputError(
                "the term that the time of this transformation adds to H is not found; give a "
                "generating function instead"
            )
    return shorter(found)


def shorter(expr: sympy.Expr) -> sympy.Expr:
    """The shortest of an expression, its expanded and its simplified form."""
    fastest, expr = _slowed(expr)
    forms = [expr, sympy.expand(expr), sympy.simplify(expr)]
    return min(forms, key=sympy.count_ops).xreplace({_TIME: fastest * _TIME})


def _slowed(expr: sympy.Expr) -> tuple[sympy.Expr, sympy.Expr]:
    """A number and the expression with the time divided by it, of which sympy is faster.

    sympy expands the sine of 1000 t in powers of those of t.
    """
    functions = expr.atoms(sympy.sin, sympy.cos, sympy.tan)
    rates = [function.args[0].coeff(_TIME) for function in functions]
    known = [rate for rate in rates if rate.is_Rational and rate != 0]
    fastest = functools.reduce(sympy.gcd, known) if known else sympy.Integer(1)
    return fastest, expr.xreplace({_TIME: _TIME / fastest})


def transformed(expr: sympy.Expr, found: CanonicalMap) -> sympy.Expr:
    """A function in the new variables; polynomials in momenta have short coefficients.

    Examples
    --------
    >>> x, y, p, q, r, a, R, A = sympy.symbols("x y p q r a R A", real=True)
    >>> polar = point_map([x, y, p, q], [r, a, R, A], [r*sympy.cos(a), r*sympy.sin(a)])
    >>> transformed((p**2 + q**2)/2, polar)
    A**2/(2*r**2) + R**2/2
    """
    half = len(found.new) // 2
    own = expr.xreplace(dict(zip(found.old, found.formulas, strict=True)))
    short = by_powers(own, found.new[half:], shorter)
    return shorter(own) if short is None else min(short, own, key=sympy.count_ops)


def by_powers(
    expr: sympy.Expr, momenta: Symbols, short: Callable[[sympy.Expr], sympy.Expr]
) -> sympy.Expr | None:
    """A polynomial in momenta with short coefficients; None if it is none."""
    try:
        powers = sympy.Poly(expr, *momenta)
    except sympy.PolynomialError:
        return None
    return sympy.Add(
        *(
            short(coefficient) * sympy.Mul(*(m**k for m, k in zip(momenta, degrees, strict=True)))
            for degrees, coefficient in powers.terms()
        )
    )


class OldVariables:
    """The variables of a Hamiltonian as functions of those of another: (z, t) -> (..., dim).

    - formulas: Of the variables that change; the others have the same name in both.
    """

    def __init__(
        self, original: Hamiltonian, H: Hamiltonian, formulas: Mapping[str, sympy.Expr]
    ) -> None:
        values = original.real_equations.fractions
        self.expressions = [
            formulas.get(name, sympy.Symbol(name, real=True)).xreplace(values)
            for name in original.names
        ]
        self._functions = [compile_observable(each, H.real_equations) for each in self.expressions]

    def __call__(self, z: np.ndarray, t: Any = 0.0) -> np.ndarray:
        with np.errstate(all="ignore"):
            columns = [np.broadcast_to(f(z, t), z.shape[:-1]) for f in self._functions]
        return np.stack(columns, axis=-1)
