"""Taylor series integrator of high precision for the references; it shares no code with hamsym.

sympy differentiates the formula, and python-flint evaluates power series of its gradient. Each
evaluation gives one more coefficient of the solution. The step length follows from the last
coefficients. Balls are replaced by their midpoints after each step, so the result is not rigorous.
Its accuracy is measured by a second computation with another order and precision.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import sympy
from flint import arb, arb_series, ctx, fmpq
from sympy.parsing.sympy_parser import parse_expr, rationalize, standard_transformations

_FUNCTIONS = {
    "sin": "{0}.sin()",
    "cos": "{0}.cos()",
    "tan": "{0}.tan()",
    "exp": "{0}.exp()",
    "log": "{0}.log()",
    "atan": "{0}.atan()",
    "asin": "{0}.asin()",
    "erf": "{0}.erf()",
    "sinh": "(({0}).exp() - (-{0}).exp()) / 2",
    "cosh": "(({0}).exp() + (-{0}).exp()) / 2",
    "tanh": "1 - 2 / ((2 * {0}).exp() + 1)",
    "sech": "2 / (({0}).exp() + (-{0}).exp())",
}


_LAST = 6  # last terms of a series, which determine the step
_NOTHING = 400.0  # log2 of the size relative to the largest of its half that is ignored


class StoppedError(Exception):
    """The integration cannot continue beyond a point."""


def formula(text: str, names: Sequence[str]) -> sympy.Expr:
    """Parse a formula, with decimals as exact rationals."""
    symbols = {name: sympy.Symbol(name, real=True) for name in names}
    transformations = (*standard_transformations, rationalize)
    return sympy.sympify(parse_expr(text, local_dict=symbols, transformations=transformations))


class Equations:
    """Right-hand side of z' = J grad H(z, t) for power series, lists of arb_series.

    Parameters
    ----------
    text : str
        H, with ``s1``, ``s2``, ... for the signs of the switches.
    q, p : sequences of str
    parameters : mapping
        float64 values.
    switches : sequence of str
        Expressions with the signs s1, s2, ...
    focus : sequence of (str, float)
        Expressions and widths. In each step such an expression changes at most by the width or by
        half its value.
    forces : mapping of momentum to str
    """

    def __init__(
        self,
        text: str,
        q: Sequence[str],
        p: Sequence[str],
        parameters: Mapping[str, float] | None = None,
        switches: Sequence[str] = (),
        focus: Sequence[tuple[str, float]] = (),
        forces: Mapping[str, str] | None = None,
    ) -> None:
        self.names = (*q, *p)
        self.dim, self.signs = len(self.names), [f"s{k + 1}" for k in range(len(switches))]
        parameters = dict(parameters or {})
        names = [*self.names, "t", *self.signs, *parameters]
        exact = {
            sympy.Symbol(name, real=True): sympy.Rational(*float(value).as_integer_ratio())
            for name, value in parameters.items()
        }
        H = formula(text, names)
        z = [sympy.Symbol(name, real=True) for name in self.names]
        half = len(q)
        rates = [H.diff(z[half + k]) for k in range(half)] + [-H.diff(z[k]) for k in range(half)]
        for name, force in (forces or {}).items():
            rates[self.names.index(name)] += formula(force, names)
        looked = [formula(one, names) for one in (*switches, *(one for one, _ in focus))]
        # Values are inserted after differentiation, which is slow with long rationals.
        self._rates = self._compiled([rate.subs(exact) for rate in rates])
        self._looked = self._compiled([one.subs(exact) for one in looked])
        self.switches, self.widths = len(switches), [width for _, width in focus]

    def _compiled(self, expressions: list[sympy.Expr]) -> Callable[..., list[arb_series]]:
        replaced, reduced = sympy.cse(expressions, order="none")
        writer = _Writer()
        lines = [f"{name} = {writer.of(value)}" for name, value in replaced]
        results = ", ".join(writer.of(value) for value in reduced)
        head = ", ".join(("t", *self.names, *self.signs))
        body = "\n    ".join((*lines, f"return [{results}]"))
        space: dict[str, Any] = {"c": writer.constants, "power": power}
        exec(f"def series({head}):\n    {body}\n", space)  # noqa: S102
        return lambda *arguments: space["series"](*arguments)

    def rates(self, t: arb, coefficients: list[list[arb]], signs: list[int], order: int) -> None:
        """Append coefficients 1 to order to those of order 0."""
        for k in range(order):
            ctx.cap = k + 1
            time = arb_series([t, 1], prec=k + 1)
            z = [arb_series(one, prec=k + 1) for one in coefficients]
            for one, rate in zip(coefficients, self._rates(time, *z, *signs), strict=True):
                last = rate[k] if isinstance(rate, arb_series) else arb(rate if k == 0 else 0)
                one.append(last / (k + 1))

    def looked(self, t: arb, z: list[arb], signs: list[int]) -> list[arb]:
        """Values of the switches and of the expressions in focus."""
        ctx.cap = 1
        series = [arb_series([value], prec=1) for value in z]
        values = self._looked(arb_series([t], prec=1), *series, *signs)
        return [v[0] if isinstance(v, arb_series) else arb(v) for v in values]


class _Writer:
    """Printer of expressions as Python for arb_series, with exact constants in a list ``c``."""

    def __init__(self) -> None:
        self.constants: list[Callable[[], arb]] = []

    def of(self, expr: sympy.Expr) -> str:
        if expr.is_Symbol:
            return expr.name
        if expr.is_Integer and abs(int(expr)) < 2**60:
            return f"({int(expr)})"
        if not expr.free_symbols:
            return self._constant(expr)
        if expr.is_Add:
            return "(" + " + ".join(self.of(one) for one in expr.args) + ")"
        if expr.is_Mul:
            over, under = expr.as_numer_denom() if expr.args[0].is_Rational else (expr, None)
            above, below = [], []
            for one in expr.args:
                if one.is_Pow and one.exp.is_Rational and one.exp < 0:
                    below.append(self.of(one.base**-one.exp))
                else:
                    above.append(self.of(one))
            del over, under
            top = " * ".join(above) or "1"
            return f"({top} / ({' * '.join(below)}))" if below else f"({top})"
        if expr.is_Pow:
            return self._power(expr)
        name = type(expr).__name__
        if name not in _FUNCTIONS:
            raise StoppedError(f"{name} is no function of this integrator")
        return "(" + _FUNCTIONS[name].format(self.of(expr.args[0])) + ")"

    def _power(self, expr: sympy.Expr) -> str:
        base, power = self.of(expr.base), expr.exp
        if power.is_Rational and power < 0:
            return f"(1 / {self.of(expr.base**-power)})"
        if power.is_Integer:
            return f"_power({base}, {int(power)})".replace("_power", "power")
        if power.is_Rational and power.q == 2:
            root = f"{base}.sqrt()"
            return f"({root})" if power.p == 1 else f"power({root}, {power.p})"
        return f"(({base}).log() * {self.of(power)}).exp()"

    def _constant(self, expr: sympy.Expr) -> str:
        self.constants.append(_constant(expr))
        return f"c[{len(self.constants) - 1}]()"


def _constant(expr: sympy.Expr) -> Callable[[], arb]:
    known: dict[int, arb] = {}

    def value() -> arb:
        if ctx.prec not in known:
            if expr.is_Rational:
                known[ctx.prec] = arb(fmpq(int(expr.p), int(expr.q)))
            else:
                known[ctx.prec] = arb(str(sympy.N(expr, int(ctx.prec / 3) + 5)))
        return known[ctx.prec].mid()

    return value


def power(base: arb_series, exponent: int) -> arb_series:
    """base**exponent by repeated squares, for an exponent of 1 or more."""
    result: arb_series | None = None
    while exponent:
        if exponent & 1:
            result = base if result is None else result * base
        exponent >>= 1
        if exponent:
            base = base * base
    assert result is not None
    return result


@dataclass
class Orbit:
    """Result of :func:`integrate`.

    Attributes
    ----------
    states : list of list of arb
        At the given times; the radii of the balls are not bounds.
    scales : list of float
        Largest magnitude of each component.
    steps : int
    reached : float
    events, starts : list of float
        Times of switches, and start times of the steps.
    """

    states: list[list[arb]]
    scales: list[float]
    steps: int = 0
    reached: float = 0.0
    events: list[float] = field(default_factory=list)
    starts: list[float] = field(default_factory=list)


def integrate(
    equations: Equations,
    z0: Sequence[arb | float],
    start: float,
    times: Sequence[float],
    *,
    order: int = 34,
    bits: int = 128,
    digits: float = 30,
    most: int = 200_000,
    longest: float = math.inf,
) -> Orbit:
    """Integrate and return states at times, given in the direction of integration.

    Parameters
    ----------
    equations : Equations
    z0 : sequence
        Exact float64 values, or balls.
    start : float
    times : sequence of float
        The last one is the end of the integration.
    order, bits, digits
        Order of the series, precision in bits, and relative accuracy of a step in digits.
    most : int
        Largest number of steps.
    longest : float
        Largest step.
    """
    before = ctx.prec, ctx.cap
    try:
        ctx.prec = bits
        return _integrate(equations, z0, start, times, order, digits, most, longest)
    finally:
        ctx.prec, ctx.cap = before


def _integrate(
    equations: Equations,
    z0: Sequence[arb | float],
    start: float,
    times: Sequence[float],
    order: int,
    digits: float,
    most: int,
    longest: float,
) -> Orbit:
    direction = 1 if times[-1] >= start else -1
    t, z, end = arb(start), [arb(value) for value in z0], arb(times[-1])
    signs = [1] * equations.switches
    for k in range(equations.switches):
        signs[k] = 1 if float(equations.looked(t, z, signs)[k]) > 0 else -1
    orbit = Orbit([], [abs(float(value)) for value in z])
    waiting = list(times)
    while waiting and float(direction * (arb(waiting[0]) - t)) <= 0:
        orbit.states.append(list(z))
        waiting.pop(0)
    while waiting:
        orbit.steps += 1
        if orbit.steps > most:
            raise StoppedError(f"more than {most} steps before t = {float(t)}")
        coefficients = [[value] for value in z]
        equations.rates(t, coefficients, signs, order)
        coefficients = [[c.mid() for c in one] for one in coefficients]
        if not all(c.is_finite() for one in coefficients for c in one):
            raise StoppedError(f"not finite at t = {float(t)}")
        h = min(_step(coefficients, digits), longest)
        h = min(h, (1 + 1e-10) * abs(float(end - t)))
        while equations.widths and not _in_focus(equations, t, coefficients, signs, direction * h):
            h /= 2
        if not h > 1e-25 * max(1e-300, abs(float(end - arb(start)))):
            raise StoppedError(f"steps of {h} at t = {float(t)}")
        step = (direction * arb(h)).mid()
        final = float(direction * (end - t - step)) <= 0
        if final:
            step = (end - t).mid()
        flipped = None
        if equations.switches:
            step, flipped = _until_switch(equations, t, coefficients, signs, step)
            final = final and flipped is None
        # The last step may end before the end by a rounding error.
        while waiting and (final or float(direction * (arb(waiting[0]) - t - step)) <= 0):
            orbit.states.append([_at(one, arb(waiting[0]) - t) for one in coefficients])
            waiting.pop(0)
        for part in (0.25, 0.5, 0.75, 1.0):
            for k, one in enumerate(coefficients):
                orbit.scales[k] = max(orbit.scales[k], abs(float(_at(one, step * part))))
        z = [_at(one, step) for one in coefficients]
        orbit.starts.append(float(t))
        t = (t + step).mid()
        orbit.reached = float(t)
        if flipped is not None:
            signs[flipped] = -signs[flipped]
            orbit.events.append(float(t))
    return orbit


def _at(coefficients: list[arb], s: arb) -> arb:
    value = arb(0)
    for c in reversed(coefficients):
        value = value * s + c
    return value.mid()


def _log(value: arb) -> float:
    """Compute log2 of a magnitude, -inf for zero."""
    signed, exponent = value.mid().man_exp()
    mantissa = abs(int(signed))
    if not mantissa:
        return -math.inf
    shift = max(mantissa.bit_length() - 53, 0)
    return math.log2(mantissa >> shift) + shift + int(exponent)


def _step(coefficients: list[list[arb]], digits: float) -> float:
    """Longest step with the last terms below 10**-digits of the largest, for each component.

    Several terms are tested, because every second or more may be zero.
    """
    order, lost = len(coefficients[0]) - 1, digits * math.log2(10)
    shortest = math.inf
    starts = [_log(one[0]) for one in coefficients]
    half = len(starts) // 2
    for n, one in enumerate(coefficients):
        logs = [_log(c) for c in one]
        # Values this small are tails of functions, exp(-1e6), and are negligible.
        nearby = starts[:half] if n < half else starts[half:]
        least = max(*nearby, -_NOTHING) - _NOTHING
        last = [(k, log) for k, log in enumerate(logs) if k > order - _LAST and log > -math.inf]
        if not last:
            continue
        low, high = -1100.0, 1000.0
        for _ in range(60):
            middle = (low + high) / 2
            top = max(least, *(log + k * middle for k, log in enumerate(logs[:-_LAST])))
            if all(log + k * middle <= top - lost * k / order for k, log in last):
                low = middle
            else:
                high = middle
        shortest = min(shortest, low)
    return 2.0 ** min(shortest, 1000.0)


def _in_focus(
    equations: Equations, t: arb, coefficients: list[list[arb]], signs: list[int], step: float
) -> bool:
    """Whether the expressions in focus change within their limits in a step."""
    rows = []
    for k in range(9):
        s = arb(step) * k / 8
        rows.append(equations.looked(t + s, [_at(one, s) for one in coefficients], signs))
    for k, width in enumerate(equations.widths, equations.switches):
        values = [float(row[k]) for row in rows]
        allowed = max(width, abs(values[0]) / 2)
        if not max(abs(value - values[0]) for value in values) <= allowed:
            return False
    return True


def _until_switch(
    equations: Equations, t: arb, coefficients: list[list[arb]], signs: list[int], step: arb
) -> tuple[arb, int | None]:
    """The step, or the step to the first change of sign in it, and the index of this sign."""

    def values(s: arb) -> list[float]:
        z = [_at(one, s) for one in coefficients]
        return [
            float(v) * sign
            for v, sign in zip(equations.looked(t + s, z, signs), signs, strict=False)
        ]

    parts = 16
    last = arb(0)
    for k in range(1, parts + 1):
        s = step * k / parts
        found = [n for n, value in enumerate(values(s)) if value < 0]
        # Immediately after a switch the value is round-off of either sign.
        if found and k > 1:
            low, high, which = last, s, found[0]
            for _ in range(ctx.prec):
                middle = ((low + high) / 2).mid()
                if values(middle)[which] < 0:
                    high = middle
                else:
                    low = middle
            return high, which
        if found:
            return _first_part(values, s, found[0], t)
        last = s
    return step, None


def _first_part(
    values: Callable[[arb], list[float]], s: arb, which: int, t: arb
) -> tuple[arb, int | None]:
    """Find a change of sign in the first part, which is real if the value is positive in it."""
    for k in range(1, 64):
        low = (s * k / 64).mid()
        if values(low)[which] > 0:
            high = s
            for _ in range(ctx.prec):
                middle = ((low + high) / 2).mid()
                low, high = (low, middle) if values(middle)[which] < 0 else (middle, high)
            return high, which
    raise StoppedError(f"a switch is grazed at t = {float(t)}")
