"""Switches of H in time: steps in place of Piecewise, and the times at which H is not smooth.

A switch is a function whose argument depends on the time and on parameters alone, as
``Heaviside(t - t1)`` and ``sign(sin(t))``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
import sympy

from hamsym.errors import InputError
from hamsym.symbolic.derivatives import switch_arguments

if TYPE_CHECKING:
    from hamsym.symbolic.equations import Equations

_SAMPLES = 20_000  # of a span, between which an argument has one zero or one extremum at most
_MOST = 5_000  # switches in a span
_DIGITS = 40  # of the arithmetic that locates them


def with_steps(expr: sympy.Expr) -> sympy.Expr:
    """Replace Piecewise by Heaviside functions of the bounds of its conditions.

    Raise InputError if a condition is not a comparison, or no condition holds somewhere.

    Examples
    --------
    >>> x, t = sympy.symbols("x t", real=True)
    >>> with_steps(sympy.Piecewise((x, t < 1), (0, True)))
    x*Heaviside(1 - t)
    """
    if not expr.has(sympy.Piecewise):
        return expr
    return expr.replace(sympy.Piecewise, _as_steps)


def _as_steps(*pieces: tuple[sympy.Expr, sympy.Basic]) -> sympy.Expr:
    total, before = sympy.S.Zero, sympy.S.One  # and 1 where no condition has held so far
    for value, condition in pieces:
        holds = _indicator(condition)
        total += value * holds * before
        before *= 1 - holds
        if condition == True:  # noqa: E712  a condition is an object of sympy
            return total
    raise InputError(
        f"'{sympy.Piecewise(*pieces)}' has no value where no condition holds; end it with (0, True)"
    )


def _indicator(condition: sympy.Basic) -> sympy.Expr:
    if condition == True:  # noqa: E712
        return sympy.S.One
    if condition == False:  # noqa: E712
        return sympy.S.Zero
    if isinstance(condition, (sympy.StrictGreaterThan, sympy.GreaterThan)):
        return sympy.Heaviside(condition.lhs - condition.rhs)
    if isinstance(condition, (sympy.StrictLessThan, sympy.LessThan)):
        return sympy.Heaviside(condition.rhs - condition.lhs)
    if isinstance(condition, sympy.And):
        return sympy.Mul(*map(_indicator, condition.args))
    if isinstance(condition, sympy.Or):
        return 1 - sympy.Mul(*(1 - _indicator(part) for part in condition.args))
    if isinstance(condition, sympy.Not):
        return 1 - _indicator(condition.args[0])
    raise InputError(
        f"the condition '{condition}' is not a comparison by <, <=, > or >=; write Piecewise with "
        "those"
    )


def switch_times(equations: Equations, span: tuple[float, float]) -> list[float]:
    """Times inside a span at which an argument of a switch is zero, ascending.

    Raise InputError if there are more than 5000.

    - equations: With a value for every parameter.

    Examples
    --------
    >>> x, p, t = sympy.symbols("x p t", real=True)
    >>> from hamsym.symbolic.equations import Equations
    >>> H = Equations(p**2/2 + x*sympy.Heaviside(t - 1) + x*sympy.sign(sympy.sin(t)), [x, p], t, {})
    >>> [round(time, 9) for time in switch_times(H, (0, 7))]
    [1.0, 3.141592654, 6.283185307]
    """
    if equations.time is None:
        return []
    values = {symbol: sympy.Float(value) for symbol, value in equations.values.items()}
    low, high = min(span), max(span)
    found: set[float] = set()
    for argument in switch_arguments(
        sympy.Tuple(*equations.formulas), {equations.time}, {*equations.z}
    ):
        zeros = _zeros(argument.xreplace(values), equations.time, low, high)
        found |= {time for time in zeros if low < time < high}
    if len(found) > _MOST:
        raise InputError(
            f"H is switched {len(found):,} times in the span, more than {_MOST:,}; solve shorter "
            "spans"
        )
    times = sorted(found)
    apart = 1e-12 * max(abs(low), abs(high))
    return [t for i, t in enumerate(times) if i == 0 or t - times[i - 1] > apart]


def _zeros(argument: sympy.Expr, time: sympy.Symbol, low: float, high: float) -> Iterator[float]:
    slope = sympy.diff(argument, time)
    if not slope.free_symbols:
        if slope != 0:
            yield float(-argument.xreplace({time: sympy.S.Zero}) / slope)
        return
    from hamsym.numerics.roots import suspects, zeros  # import scipy.optimize, which is slow

    function = sympy.lambdify(time, argument, ["scipy", "numpy"])
    rate = sympy.lambdify(time, slope, ["scipy", "numpy"])
    correction = sympy.lambdify(time, argument / slope, "mpmath")
    times, spacing = np.linspace(low, high, _SAMPLES + 1), (high - low) / _SAMPLES
    with np.errstate(all="ignore"):
        values = np.broadcast_to(np.asarray(function(times), dtype=float), times.shape)
        yield from times[values == 0].tolist()
        try:
            rates = np.broadcast_to(np.asarray(rate(times), dtype=float), times.shape)
        except (NameError, TypeError, ValueError):  # the slope of a step is no function
            rates = np.zeros(times.shape)
        (first,), dips = suspects(values, rates)
        share, index = zeros(
            lambda x, k: np.asarray(function(times[first[k]] + x * spacing)) + 0.0 * x,
            *(values[first], values[first + 1], dips),
        )
        for at in (times[first[index]] + share * spacing).tolist():
            yield _nearest(correction, at, spacing)


def _nearest(correction: Callable[[Any], Any], at: float, spacing: float) -> float:
    """The float64 number nearest to a zero: jumps there count to the last bit."""
    import mpmath

    with mpmath.workdps(_DIGITS):
        try:
            exact = mpmath.mpf(at)
            for _ in range(2):
                exact -= correction(exact)
            found = float(exact)
        except (ArithmeticError, NameError, TypeError, ValueError):  # or the slope of a step
            return at
    return found if abs(found - at) <= 1e-6 * spacing else at
