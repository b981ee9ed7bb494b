"""Certificates of solutions: every bound is proven again, or refused.

The largest value of |g|, g a tuple of functions with known Taylor coefficients, is compared with
the two numbers that a certificate claims: |g|^2 is a polynomial with balls as coefficients, whose
values are bounded on parts of -1 <= x <= 1, which are halved until the bound is small enough.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat, arb_poly, ctx

from hamsym.proof.checker.formulas import (
    FalseClaimError,
    NotProvenError,
    attempt,
    ball,
    exact,
)
from hamsym.proof.checker.functions import (
    UNIT,
    Equations,
    Interval,
    Polynomial,
    coefficients,
    expanded,
)
from hamsym.proof.checker.guesses import Effort
from hamsym.proof.checker.motion import Step, steps
from hamsym.proof.checker.polynomials import Polynomials, polynomials
from hamsym.proof.checker.trials import Window, windows

_ATTEMPTS = ((208, Effort(46, 2.0**-150)), (400, Effort(88, 2.0**-286)))
_COUNTS = 16  # numbers of coefficients are multiples of it
_DEPTH = 14  # of divisions of a part of the span, where z^ is not resolved
_COARSE = 80  # bits of sums of squares
_NEGLIGIBLE = arb(2) ** -60

Bound = Fraction | float  # a float is infinite


def check_solution(
    H: Mapping[str, Any],
    z0: Sequence[float],
    span: Sequence[float],
    trial: Mapping[str, Any],
    claims: Mapping[str, Any],
    check_time: Callable[[], None],
) -> None:
    """Prove every claim of the certificate of a solution; raise NotProvenError if one fails.

    - H, trial: See :class:`Equations` and :func:`windows`.
    - claims: The values of its JSON; bounds count as the decimals that they are, edges as the
      binary fractions next to them.
    """

    def proof(effort: Effort) -> None:
        check = _Check(H, z0, trial, claims, [Fraction(value) for value in span])
        check.run(effort, check_time)

    attempt(_ATTEMPTS, proof)


class _Check:
    def __init__(
        self,
        H: Mapping[str, Any],
        z0: Sequence[float],
        trial: Mapping[str, Any],
        claims: Mapping[str, Any],
        span: list[Fraction],
    ) -> None:
        self._equations, self._z0, self._span = Equations(H), z0, span
        self._sign = 1 if span[1] > span[0] else -1
        dim, names = self._equations.dim, self._equations.names
        self._names = ["the norm", *(f"the error of {n}" for n in names), "the energy", "ell_max"]
        keys = ("bound", "component_bounds", "energy_bound", "ell_max_bound")
        self._uppers = _row(claims[key] for key in keys)
        self._lowers = _row(claims[key.replace("bound", "lower")] for key in keys)
        self._pieces = _row([claims["piece_bounds"]])
        #: Signed, in the order of the span.
        self._edges = [self._sign * Fraction(float(edge)) for edge in claims["edges"]]
        self._windows = windows(trial, dim)
        self._starts = [self._sign * window.start for window in self._windows]
        begin, end = (self._sign * value for value in span)
        for rising in (self._edges, [*self._starts, self._sign * self._windows[-1].end]):
            if len(rising) < 2 or not all(a < b for a, b in pairwise(rising)):
                raise FalseClaimError("times are not in order")
            if not rising[0] <= begin < end <= rising[-1]:
                raise FalseClaimError("the span is not covered")
        sizes = [len(self._uppers), len(self._lowers), len(self._pieces)]
        ends = [self._edges[0], self._edges[-1]]
        if sizes != [dim + 3, dim + 3, len(self._edges) - 1] or ends != [begin, end]:
            raise FalseClaimError("the certificate does not fit the solution")
        if not all(value >= 0 for value in (*self._uppers, *self._lowers, *self._pieces)):
            raise FalseClaimError("the certificate has numbers that are no bounds")
        #: Claims of lower bounds that are not proven yet, and what has to be bounded.
        self._open = {k for k, lower in enumerate(self._lowers) if lower > 0}
        least = [min([self._uppers[0], *self._pieces]), *self._uppers[1:]]
        self._used = [k for k, v in enumerate(least) if v < math.inf or k in self._open]
        zero = {i for i, value in enumerate(z0) if value == 0 and _is_zero(trial, i)}
        self._resting = self._equations.resting(zero)
        start = [*map(arb, z0), ball(span[0])]
        self._energy = self._equations.run_energy(start)[0]

    def run(self, effort: Effort, check_time: Callable[[], None]) -> None:
        ordered = sorted({*self._edges, *self._starts})
        for step in steps(self._equations, self._z0, self._span, effort, check_time):
            low, high = (self._sign * (step.part.middle + side * step.part.r) for side in (-1, 1))
            inner = ordered[bisect_right(ordered, low) : bisect_right(ordered, high)]
            for a, b in pairwise([low, *(edge for edge in inner if edge < high), high]):
                check_time()
                self._part(step, self._sign * a, self._sign * b, effort.order, _DEPTH)
        if self._open:
            name = self._names[min(self._open)]
            raise NotProvenError(f"its claim about {name} is not proven: it is not so large")

    def _part(self, step: Step, a: Fraction, b: Fraction, order: int, depth: int) -> None:
        """Compare claims with a part of a step, in one window and in one piece of the claims."""
        place = min(self._sign * a, self._sign * b)
        window = self._windows[bisect_right(self._starts, place) - 1]
        piece = self._pieces[bisect_right(self._edges, place) - 1]
        try:
            groups = self._groups(step, window, Interval((a + b) / 2, (b - a) / 2), order)
            for k, (space, square) in groups.items():
                limit = min(self._uppers[k], piece) if k == 0 else self._uppers[k]
                if limit < math.inf:
                    space.require_below(square, ball(limit) ** 2, arb(0), self._names[k])
        except FalseClaimError:
            raise
        except NotProvenError:
            if not depth:
                raise
            for low, high in ((a, (a + b) / 2), ((a + b) / 2, b)):
                self._part(step, low, high, order, depth - 1)
        else:
            for k in self._open & {k for k in self._open if self._lowers[k] < math.inf}:
                space, square = groups[k]
                if space.reaches(square, ball(self._lowers[k]) ** 2):
                    self._open.remove(k)

    def _groups(
        self, step: Step, window: Window, part: Interval, order: int
    ) -> dict[int, tuple[Polynomials, arb_mat]]:
        """|g|^2 for each of the errors, the energy error and the residual that has a claim."""
        equations, dim, inverse = self._equations, self._equations.dim, ball(1 / part.r)
        line, trial = step.part.line(part), window.on(part)
        y = [Polynomial(each.real(line).coeffs()) for each in step.y]

        def at(x: Any) -> list[Any]:
            states, time = trial(x), part.time(x)
            found = list(states)
            if dim + 1 in self._used:
                true = self._energy
                if not equations.conserved:
                    near = [each(x) + t * UNIT for each, t in zip(y, step.tube, strict=True)]
                    (true,) = equations.run_energy([*near, time])
                found += [energy - true for energy in equations.run_energy([*states, time])]
            return found + (equations.run_rates([*states, time]) if dim + 2 in self._used else [])

        found, rows = expanded(at, order), []
        for i, (state, own, tube) in enumerate(zip(found, y, step.tube, strict=False)):
            row = (arb_poly(state.first) - own.real).coeffs() or [arb(0)]
            rows.append([arb(0)] if i in self._resting else _with_rest(row, state.rest() + tube))
        groups = {0: rows[:], **{i + 1: [row] for i, row in enumerate(rows)}}
        if dim + 1 in self._used:
            groups[dim + 1] = [_with_rest(found[dim].first, found[dim].rest())]
        if dim + 2 in self._used:
            groups[dim + 2] = []
            for state, rate in zip(found, found[-dim:], strict=False):
                slopes = [inverse * (k + 1) * c for k, c in enumerate(state.first[1:])]
                row = [a - b for a, b in zip(slopes, rate.first, strict=False)]
                rest = rate.rest() + abs(rate.first[-1])
                rest += abs(inverse) * state.rest_of_derivative()
                groups[dim + 2].append(_with_rest(row, rest))
        return {k: _square(groups[k]) for k in self._used}


# -- claims ---------------------------------------------------------------------------------------


def _row(values: Iterable[Any]) -> list[Bound]:
    """Numbers, and the elements of sequences of them, exactly as they are written."""
    flat: list[Any] = []
    for value in values:
        flat += value if isinstance(value, list | tuple) else [value]
    return [exact(v) if math.isfinite(float(v)) else float(v) for v in flat]


def _is_zero(trial: Mapping[str, Any], i: int) -> bool:
    """Whether a component of z^ vanishes identically."""
    if trial["kind"] != "features":
        return False
    rows = [*trial["states"], *(row for readout in trial["readouts"] for row in readout)]
    return not any(row[i] for row in rows)


def _with_rest(series: list[arb], rest: arb) -> list[arb]:
    return [series[0] + UNIT * rest, *series[1:]]


def _square(rows: Sequence[Sequence[arb]]) -> tuple[Polynomials, arb_mat]:
    """|g|^2 from the Taylor coefficients of g; small ones become radii."""
    total = arb_poly()
    with ctx.workprec(_COARSE):
        for row in rows:
            sizes = [abs(c).abs_upper() for c in row]
            least, last = max(sizes) * _NEGLIGIBLE, len(row)
            while last > 1 and sizes[last - 1] <= least:
                last -= 1
            part = arb_poly(_with_rest(list(row[:last]), sum(sizes[last:], arb(0))))
            total += part * part
    count = -(-max(len(total), 1) // _COUNTS) * _COUNTS
    return polynomials(0, 0, count), arb_mat([coefficients(total, count)])
