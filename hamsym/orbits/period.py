"""Periods, given as numbers or as formulas of the parameters, and H in units of an arc."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import sympy
from sympy.functions.elementary.trigonometric import TrigonometricFunction

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


# -- periods of H in time --------------------------------------------------------------------------

#: Part of an angle over a period that is no more than the rounding of the period and of
#: frequencies.
ROUNDED = 1e-14


def has_period(H: Hamiltonian, period: sympy.Expr, rounding: float) -> bool:
    """Whether the equations of motion are shown to be the same a period later, at every state.

    - rounding: Part of the angle by which the argument of a sine grows in the period that may miss
      a multiple of a right angle.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2 - x*cos(0.3*t)")
    >>> exact, nearest = sympy.pi * 20 / 3, rational(20 * math.pi / 3)
    >>> has_period(H, exact, ROUNDED), has_period(H, nearest, ROUNDED), has_period(H, nearest, 0)
    (True, True, False)
    """
    form = H.real_equations
    if form.time is None:
        return True
    duration, energy, *forces = (
        without_floats(formula).xreplace(form.fractions) for formula in (period, *form.formulas)
    )
    changes = [_later(f, form.time, duration, rounding) - f for f in (energy, *forces)]
    # A change of the energy that is the same at all states acts on none.
    slopes = [sympy.diff(changes[0], symbol) for symbol in form.z]
    return all(derivatives.vanishes(change) for change in (*slopes, *changes[1:]))


def _later(expr: sympy.Expr, time: sympy.Symbol, period: sympy.Expr, rounding: float) -> Any:
    """A formula at t + T, in which angles grow by multiples of right angles up to rounding."""
    if expr == time:
        return time + period
    if not expr.has(time):
        return expr
    args = [_later(arg, time, period, rounding) for arg in expr.args]
    if isinstance(expr, TrigonometricFunction):
        quarters = sympy.expand(args[0] - expr.args[0]) * 2 / sympy.pi
        if quarters.is_number:
            turned = sympy.Integer(round(quarters.evalf(40)))
            if abs((quarters - turned).evalf(40)) <= rounding * abs(turned):
                args = [expr.args[0] + turned * sympy.pi / 2]
    return expr.func(*args)


# -- units of an arc -------------------------------------------------------------------------------


def exact_period(problem: Problem) -> Ball:
    """The given period."""
    if problem.exact_period is None:
        raise CertificationError("the orbit has no exact period; find it with period=")
    values = problem.H.real_equations.fractions
    exact = without_floats(problem.exact_period.formula).xreplace(values)
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
    if not has_period(H, exact, 0.0):
        raise CertificationError(
            f"H is not shown to have the period {problem.exact_period.formula} in time; give "
            'the exact period, such as "2*pi/omega"'
        )
    by_name = {symbol.name: symbol for symbol in free_symbols((H.expr, *H.forces.values()))}
    exact = exact.xreplace({s: by_name[s.name] for s in exact.free_symbols if s.name in by_name})
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
