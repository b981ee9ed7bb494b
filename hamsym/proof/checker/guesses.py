"""Guesses of a step: polynomials near the solution, and near derivatives of the flow.

Nothing here has to be trusted: a wrong guess makes a wide bound or none.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, arb_mat, arb_poly

from hamsym.proof.checker.formulas import NotProvenError, ball
from hamsym.proof.checker.functions import (
    Equations,
    Interval,
    Polynomial,
    coefficients,
    column,
    end_of,
    identity,
    matrices,
    series_of,
    total,
)

SHORT = 14  # degree of V and W, where no derivative of the flow is needed
_NEWTON = 12  # most corrections of y
# Correction of y that changes V and W, and that where derivatives are needed; the last correction,
# in accuracies.
_ROUGH, _FINE, _CLOSE = 2.0**-30, 2.0**-60, 2.0**30
# By how much a step may be longer, at most, and where the solution changes too fast for this one.
_LONGER, _TOO_LONG = 1.5, 0.8


@dataclass(frozen=True)
class Effort:
    """What makes a proof exact: numbers of Taylor coefficients, and the size of the last ones.

    - degree: Of V and W; derivatives of the flow are as exact as they are.
    - shortest: Step, of the span.
    - ways: See :func:`hamsym.proof.checker.motion.proven`.
    """

    order: int
    accuracy: float
    degree: int = SHORT
    shortest: Fraction = Fraction(1, 2**40)
    ways: int = 1


@dataclass(frozen=True)
class Guess:
    """About the solution, the derivative of the flow by the state at x = 0, and its inverse.

    - factor: By how much the next step may be longer.
    """

    part: Interval
    y: list[Polynomial]
    V: list[arb_mat]
    W: list[arb_mat]
    factor: float


def guess(
    equations: Equations,
    z: Sequence[arb],
    near: Sequence[arb_poly],
    part: Interval,
    effort: Effort,
    scales: list[arb],
) -> Guess:
    """Newton's method from polynomials near the solution, as those of the step before.

    - z: The state at the start of the step.
    - scales: Sizes of the components so far, which are updated.
    """
    change, r, y = 1.0, part.r, [Polynomial([c.mid() for c in each.coeffs()]) for each in near]

    def at(x: Any) -> list[Any]:
        return [*(each(x) for each in y), part.time(x)]

    for _ in range(_NEWTON):
        if change > (_ROUGH if effort.degree == SHORT else _FINE):
            rows = series_of(lambda x: equations.run_slopes(at(x)), effort.degree)
            A = matrices(equations, rows, r)
            W, V = _flow(A, True), _flow(A, False)
        rates = series_of(lambda x: equations.run_rates(at(x)), effort.order)
        defects = [
            arb_poly(rate) * ball(r) - each.real.derivative()
            for each, rate in zip(y, rates, strict=True)
        ]
        gaps = [a - each(arb(-1)) for a, each in zip(z, y, strict=True)]
        moved = along(V, W, defects, gaps, effort.order)
        change = 0.0
        for i, each in enumerate(moved):
            whole = [c.mid() for c in (y[i].real + each).coeffs()]
            size, moves = (sum(map(abs, row), arb(0)).mid() for row in (whole, each.coeffs()))
            if not size.is_finite():
                raise NotProvenError("no polynomial near the solution was found")
            scales[i] = max(scales[i], abs(z[i]).mid())
            change = max(change, float(moves / size) if size > 0 else 0.0)
            y[i] = Polynomial(whole)
        if change < effort.accuracy * _CLOSE:
            factor = _factor(y, effort, scales)
            if not factor > _TOO_LONG:
                raise NotProvenError("the solution changes too fast")
            return Guess(part, y, V, W, factor)
    raise NotProvenError("no polynomial near the solution was found")


def _factor(y: Sequence[Polynomial], effort: Effort, scales: Sequence[arb]) -> float:
    """By how much a step may be longer, from the last coefficients."""
    shares = [
        float((abs(c) / scale).mid())
        for each, scale in zip(y, scales, strict=True)
        for c in coefficients(each.real, effort.order + 1)[-2:]
        if scale > 0
    ]
    largest = max([*shares, effort.accuracy * 1e-30])
    return min((effort.accuracy / largest) ** (1 / effort.order), _LONGER)


def _flow(A: list[arb_mat], inverse: bool) -> list[arb_mat]:
    """About the solution of V' = A V, or of W' = -W A, with the identity at x = 0."""
    found = [identity(A[0].nrows())]
    for k in range(len(A)):
        pairs = zip(A[: k + 1], reversed(found), strict=True)
        products = [-(w * a) if inverse else a * w for a, w in pairs]
        found.append((total(products) / arb(k + 1)).mid())
    return found


def along(
    V: list[arb_mat], W: list[arb_mat], g: Sequence[arb_poly], start: Sequence[arb], order: int
) -> list[arb_poly]:
    """About the solution of e' = A e + g with a given start, where V' = A V and W = 1 / V.

    It is V times the integral of W g and a constant.
    """
    moved = [each.integral() for each in _applied(W, g, order)]
    own = (end_of(W, -1) * column(start)).entries()
    moved = [each + (value - each(arb(-1))) for each, value in zip(moved, own, strict=True)]
    return _applied(V, moved, order + 1)


def _applied(series: list[arb_mat], parts: Sequence[arb_poly], count: int) -> list[arb_poly]:
    """The first coefficients of a matrix of polynomials times a column of them."""
    found = []
    for i in range(len(parts)):
        rows = [arb_poly([m[i, j] for m in series]) * part for j, part in enumerate(parts)]
        found.append(sum(rows, arb_poly()).truncate(count))
    return found
