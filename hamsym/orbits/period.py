"""Periods, given as numbers or as formulas of the parameters, and H in units of an arc."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import sympy

from hamsym.errors import CertificationError, InputError
from hamsym.formula.parser import parse_expression
from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.ball import Ball
from hamsym.support.validation import require_positive
from hamsym.symbolic import derivatives
from hamsym.symbolic.equations import free_symbols
from hamsym.symbolic.exact import rational, without_floats

if TYPE_CHECKING:
    from hamsym.orbits.arc import Problem


@dataclass(frozen=True)
class Period:
    """A period, in the units of H."""

    value: float
    #: The exact value, in the parameters of H.
    formula: sympy.Expr


def period_of(H: Hamiltonian, period: Any) -> Period | None:
    """Convert the argument ``period`` of :func:`hamsym.periodic_orbit`.

    Raise InputError if it is not a positive number, nor a formula of one in the parameters of H.
    """
    if period is None:
        return None
    if not isinstance(period, (str, sympy.Expr)):
        require_positive("period", period)
        return Period(float(period), rational(float(period)))
    given = parse_expression(period) if isinstance(period, str) else period
    own = H.real_equations.parameters
    formula = given.xreplace(
        {symbol: own[symbol.name][0] for symbol in given.free_symbols if symbol.name in own}
    )
    unknown = sorted(s.name for s in formula.free_symbols if s.name not in own)
    if unknown:
        raise InputError(
            f"the period contains '{unknown[0]}', which is not a parameter of H; give a formula of "
            "its parameters"
        )
    value = formula.evalf(30, subs=dict(own.values()))
    if not value.is_Float or not value > 0:
        raise InputError(f"the period {period} is not a positive number; give another one")
    return Period(float(value), formula)


# -- units of an arc -------------------------------------------------------------------------------


def exact_period(problem: Problem) -> Ball:
    """The given period."""
    if problem.exact_period is None:
        raise CertificationError("the orbit has no exact period; find it with period=")
    own = problem.H.real_equations.parameters
    exact = without_floats(problem.exact_period.formula).xreplace(
        {symbol: rational(value) for symbol, value in own.values() if value is not None}
    )
    middle = float(exact.evalf(40))
    known = exact.is_Rational and exact == rational(middle)
    return Ball(middle, 0.0 if known else math.ulp(middle))


def in_units_of_the_arc(problem: Problem, parts: int) -> tuple[Hamiltonian, str | None]:
    """T H / parts, whose unit of time is the arc, and the name of T if it is a parameter."""
    H = problem.H
    if problem.autonomous and problem.period is None:
        name = "T"
        while name in {*H.names, *H.parameter_names}:
            name += "_"
        return _moved(H, sympy.Symbol(name, real=True) / parts, {}, {name: 1.0}), name
    assert problem.exact_period is not None
    exact = without_floats(problem.exact_period.formula)
    if problem.autonomous:
        return _moved(H, exact / parts, {}, {}), None
    symbols = free_symbols((H.expr, *H.forces.values()))
    by_name = {symbol.name: symbol for symbol in symbols}
    exact = exact.xreplace({s: by_name[s.name] for s in exact.free_symbols if s.name in by_name})
    later = {H.time: H.time + exact}
    for formula in map(without_floats, (H.expr, *H.forces.values())):
        if not derivatives.vanishes(sympy.expand(formula.xreplace(later) - formula)):
            raise CertificationError(
                f"H is not shown to have the period {problem.exact_period.formula} in time; give "
                'the exact period, such as "2*pi/omega"'
            )
    start = rational(problem.start)
    return _moved(H, exact, {H.time: start + exact * H.time}, {}), None


def _moved(
    H: Hamiltonian, factor: sympy.Expr, times: Mapping[Any, Any], parameters: Mapping[str, float]
) -> Hamiltonian:
    """H and its forces times a factor, with other times and further parameters."""
    return Hamiltonian(
        factor * without_floats(H.expr).xreplace(times),
        q=H.q,
        p=H.p,
        parameters={**H.parameters, **parameters},
        forces={
            name: factor * without_floats(force).xreplace(times) for name, force in H.forces.items()
        },
    )
