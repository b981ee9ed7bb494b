"""Periods that are given as numbers or as formulas of the parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import sympy

from hamsym.errors import InputError
from hamsym.formula.parser import parse_expression
from hamsym.hamiltonian import Hamiltonian
from hamsym.support.validation import require_positive
from hamsym.symbolic.exact import rational


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
