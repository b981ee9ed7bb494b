"""H in units of the arc of an orbit, exactly, and the exact period."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import sympy

from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.orbits.arc import Problem
from hamsym.proof.ball import Ball
from hamsym.symbolic import derivatives
from hamsym.symbolic.exact import rational, without_floats


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
    by_name = {symbol.name: symbol for symbol in _symbols(H)}
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


def _symbols(H: Hamiltonian) -> set[sympy.Symbol]:
    return H.expr.free_symbols.union(*(force.free_symbols for force in H.forces.values()))


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
