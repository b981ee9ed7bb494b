"""Certificates of solutions: every bound is proven again, or refused.

The largest value of |g|, g a tuple of functions with known Taylor coefficients, is compared with
the two numbers that a certificate claims: |g|^2 is a polynomial with balls as coefficients, whose
values are bounded on parts of -1 <= x <= 1, which are halved until the bound is small enough.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import arb, arb_poly, ctx

from hamsym.proof.checker.formulas import NotProvenError, ball
from hamsym.proof.checker.motion import (
    UNIT,
    Equations,
    Polynomial,
    Step,
    expanded,
    steps,
    time_at,
)
from hamsym.proof.checker.trials import Window, windows

# Bits, Taylor coefficients, and the size of the last ones, of attempts.
_ATTEMPTS = ((208, 46, 2.0**-150), (400, 88, 2.0**-286))
_HALVINGS = 50  # of -1 <= x <= 1
_DEPTH = 14  # of divisions of a part of the span, where z^ is not resolved
_COARSE = 80  # bits of sums of squares
_NEGLIGIBLE = arb(2) ** -60


class FalseClaimError(NotProvenError):
    """A claim is proven to be false."""


def check_solution(
    H: Mapping[str, Any],
    z0: Sequence[float],
    span: Sequence[float],
    trial: Mapping[str, Any],
    claims: Mapping[str, Any],
    check_time: Callable[[], None],
) -> None:
    """Prove every claim of the certificate of a solution; raise NotProvenError if one fails."""
    failure: NotProvenError | None = None
    for bits, order, accuracy in _ATTEMPTS:
        with ctx.workprec(bits):
            try:
                _Check(H, z0, span, trial, claims, order).run(accuracy, check_time)
                return
            except FalseClaimError:
                raise
            except NotProvenError as error:
                failure = failure or error
    raise failure or NotProvenError("there is no proof")


class _Check:
    def __init__(
        self,
        H: Mapping[str, Any],
        z0: Sequence[float],
        span: Sequence[float],
        trial: Mapping[str, Any],
        claims: Mapping[str, Any],
        order: int,
    ) -> None:
        self._equations, self._z0, self._order = Equations(H), z0, order
        self._times, self._span = span, [Fraction(value) for value in span]
        self._sign = 1 if self._span[1] > self._span[0] else -1
        dim = self._equations.dim
        self._windows = windows(trial, dim)
        names = ["the norm", *(f"the error of {name}" for name in (*H["q"], *H["p"]))]
        self._names = [*names, "the energy", "ell_max"]
        keys = "bound", "component_bounds", "energy_bound", "ell_max_bound"
        self._uppers = _row(claims, keys)
        self._lowers = _row(claims, [key.replace("bound", "lower") for key in keys])
        self._edges = [Fraction(edge) for edge in claims["edges"]]
        self._pieces = [float(value) for value in claims["piece_bounds"]]
        if (
            [*self._edges[:: len(self._edges) - 1]] != self._span
            or not len(self._uppers) == len(self._lowers) == dim + 3
            or not len(self._pieces) == len(self._edges) - 1
            or not all(self._sign * a < self._sign * b for a, b in pairwise(self._edges))
        ):
            raise FalseClaimError("the certificate does not fit the solution")
        pairs = zip(self._lowers, self._uppers, strict=True)
        if not all(low >= 0 and math.isfinite(low) and high >= 0 for low, high in pairs):
            raise FalseClaimError("the certificate has numbers that are no bounds")
        #: Claims of lower bounds that are not proven yet.
        self._open = {k for k, lower in enumerate(self._lowers) if lower > 0}
        used = [k for k in (dim + 1, dim + 2) if self._uppers[k] < math.inf or k in self._open]
        self._used = [*range(dim + 1), *used]
        zero = {i for i, value in enumerate(z0) if value == 0 and _is_zero(trial, i)}
        self._resting = self._equations.resting(zero)
        start = [arb(value) for value in z0]
        self._energy = self._equations.run_energy([*start, ball(self._span[0])])[0]

    def run(self, accuracy: float, check_time: Callable[[], None]) -> None:
        edges = {*self._edges, *(w.start for w in self._windows), *(w.end for w in self._windows)}
        ordered = sorted(self._sign * edge for edge in edges)
        starts = [self._sign * window.start for window in self._windows]
        if (
            starts != sorted({*starts})
            or any(a.end != b.start for a, b in pairwise(self._windows))
            or [self._windows[0].start, self._windows[-1].end] != self._span
        ):
            raise FalseClaimError("the windows of the solution do not cover the span")
        claimed = [self._sign * edge for edge in self._edges]
        found = steps(self._equations, self._z0, self._times, self._order, accuracy, check_time)
        for step in found:
            low, high = (self._sign * (step.middle + side * step.r) for side in (-1, 1))
            first, last = bisect_right(ordered, low), bisect_right(ordered, high)
            inner = [edge for edge in ordered[first:last] if edge < high]
            for a, b in pairwise([low, *inner, high]):
                check_time()
                window = self._windows[bisect_right(starts, a) - 1]
                piece = self._pieces[bisect_right(claimed, a) - 1]
                self._part(step, window, piece, self._sign * a, self._sign * b, _DEPTH)
        if self._open:
            name = self._names[min(self._open)]
            raise NotProvenError(f"its claim about {name} is not proven: it is not so large")

    def _part(
        self, step: Step, window: Window, piece: float, a: Fraction, b: Fraction, depth: int
    ) -> None:
        """Compare claims with a part of a step, in one window and in one piece of the claims."""
        try:
            series = self._series(step, window, (a + b) / 2, (b - a) / 2)
            dim = self._equations.dim
            groups = [series[:dim], *([one] for one in series[: dim + 1]), series[dim + 1 :]]
            squares = {k: _square(groups[k]) for k in self._used}
            for k, square in squares.items():
                upper = self._uppers[k]
                _require_below(square, min(upper, piece) if k == 0 else upper, self._names[k])
        except FalseClaimError:
            raise
        except NotProvenError:
            if not depth:
                raise
            for low, high in ((a, (a + b) / 2), ((a + b) / 2, b)):
                self._part(step, window, piece, low, high, depth - 1)
            return
        self._open -= {k for k in self._open if _reaches(squares[k], self._lowers[k])}

    def _series(self, step: Step, window: Window, middle: Fraction, r: Fraction) -> list[list[arb]]:
        """Taylor coefficients of the errors, of the energy error and of the residual."""
        equations, dim = self._equations, self._equations.dim
        line = step.line(middle, r)
        near = [part.real(line) for part in step.y]
        trial, inverse = window.on(middle, r), ball(1 / r)
        whole = max(self._used) > dim

        def at(x: Any) -> list[Any]:
            states = trial(x)
            if not whole:
                return states
            full = [*states, time_at(middle, r, x)]
            energy = equations.run_energy(full)[0]
            if equations.conserved:
                energy = energy - self._energy
            else:
                true = [p(x) + t * UNIT for p, t in zip(own, step.tube, strict=True)]
                energy = energy - equations.run_energy([*true, full[-1]])[0]
            return [*states, energy, *equations.run_rates(full)]

        own = [Polynomial(part.coeffs()) for part in near]
        found = expanded(at, self._order)
        rows = []
        for i, (state, part, tube) in enumerate(zip(found, near, step.tube, strict=False)):
            if i in self._resting:
                rows.append([arb(0)])
                continue
            row = [-c for c in part.coeffs()]
            row += [arb(0)] * (self._order - len(row))
            for k, c in enumerate(state.first):
                row[k] += c
            rows.append(_with_rest(row, state.rest() + tube))
        if whole:
            energy, *rates = found[dim:]
            rows.append(_with_rest(energy.first, energy.rest()))
            for state, rate in zip(found, rates, strict=False):
                slopes = [inverse * (k + 1) * c for k, c in enumerate(state.first[1:])]
                row = [a - b for a, b in zip(slopes, rate.first, strict=False)]
                last = abs(rate.first[-1])
                rest = rate.rest() + last + abs(inverse) * state.rest_of_derivative()
                rows.append(_with_rest(row, rest))
        return rows


# -- claims ---------------------------------------------------------------------------------------


def _row(claims: Mapping[str, Any], keys: Sequence[str]) -> list[float]:
    """Claims for the norm, the components, the energy and the residual."""
    first, components, *others = (claims[key] for key in keys)
    return [float(value) for value in (first, *components, *others)]


def _is_zero(trial: Mapping[str, Any], i: int) -> bool:
    """Whether a component of z^ vanishes identically."""
    return trial["kind"] == "features" and not any(
        [
            *(state[i] for state in trial["states"]),
            *(row[i] for readout in trial["readouts"] for row in readout),
        ]
    )


def _with_rest(series: list[arb], rest: arb) -> list[arb]:
    return [series[0] + UNIT * rest, *series[1:]]


def _square(rows: Sequence[Sequence[arb]]) -> arb_poly:
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
    return total


def _halves(square: arb_poly) -> tuple[arb_poly, arb_poly]:
    half = arb(0.5)
    return square(arb_poly([-half, half])), square(arb_poly([half, half]))


def _spread(part: arb_poly) -> arb:
    """How much the values of a polynomial differ from that at x = 0, at most."""
    return sum(map(abs, part.coeffs()[1:]), arb(0)).abs_upper()


def _require_below(square: arb_poly, limit: float, name: str) -> None:
    """Prove |g|^2 <= limit^2 for -1 <= x <= 1."""
    if limit == math.inf:
        return
    with ctx.workprec(_COARSE):
        squared, parts = arb(limit) * arb(limit), [(square, 0)]
        while parts:
            part, depth = parts.pop()
            spread = _spread(part)
            if part[0] + spread <= squared:
                continue
            if part[0] > squared:
                raise FalseClaimError(f"its claim about {name} is false: it is larger")
            if depth == _HALVINGS or not spread > part[0].rad():
                raise NotProvenError(f"its claim about {name} is not proven")
            parts += [(half, depth + 1) for half in _halves(part)]


def _reaches(square: arb_poly, limit: float) -> bool:
    """Whether |g| >= limit is proven somewhere."""
    with ctx.workprec(_COARSE):
        squared, parts = arb(limit) * arb(limit), [(square, 0)]
        while parts:
            part, depth = parts.pop()
            if any(part(arb(x)) >= squared for x in (-1, 0, 1)):
                return True
            spread = _spread(part)
            if depth < _HALVINGS and spread > part[0].rad() and not part[0] + spread < squared:
                parts += [(half, depth + 1) for half in _halves(part)]
    return False
