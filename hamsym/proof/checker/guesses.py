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
    Polynomial,
    Rates,
    clock,
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


@dataclass(frozen=True)
class Guess:
    """About the solution, the derivative of the flow by the state at x = 0, and its inverse."""

    y: list[Polynomial]
    V: list[arb_mat]
    W: list[arb_mat]


def factor_of(y: Sequence[Polynomial], order: int, accuracy: float, scales: Sequence[arb]) -> float:
    """By how much a step may be longer, from the last coefficients."""
    shares = [
        float((abs(c) / scale).mid())
        for part, scale in zip(y, scales, strict=True)
        for c in coefficients(part.real, order + 1)[-2:]
        if scale > 0
    ]
    return min((accuracy / max([*shares, accuracy * 1e-30])) ** (1 / order), 1.5)


def guess(
    equations: Rates,
    z: Sequence[arb],
    near: Sequence[arb_poly],
    middle: Fraction,
    r: Fraction,
    order: int,
    accuracy: float,
    scales: list[arb],
    degree: int,
) -> Guess:
    """Newton's method from polynomials near the solution, as those of the step before.

    - z: The state at the start of the step, t = middle - r.
    - scales: Sizes of the components so far, which are updated.
    - degree: Of V and W.
    """
    change, y = 1.0, [Polynomial([c.mid() for c in part.coeffs()]) for part in near]

    time = clock(middle, r)

    def at(x: Any) -> list[Any]:
        return [*(part(x) for part in y), time(x)]

    for _ in range(_NEWTON):
        if change > (_ROUGH if degree == SHORT else _FINE):
            rows = series_of(lambda x: equations.run_all(at(x)), degree)
            A = matrices(equations, rows, r)
            W, V = _flow(A, True), _flow(A, False)
        rates = series_of(lambda x: equations.run_rates(at(x)), order)
        defects = [
            arb_poly(rate) * ball(r) - part.real.derivative()
            for part, rate in zip(y, rates, strict=True)
        ]
        moved = [part.integral() for part in applied(W, defects, order)]
        start = end_of(W, -1) * column([a - part(arb(-1)) for a, part in zip(z, y, strict=True)])
        moved = [part + (start[i, 0] - part(arb(-1))) for i, part in enumerate(moved)]
        change = 0.0
        for i, part in enumerate(applied(V, moved, order + 1)):
            whole = [c.mid() for c in (y[i].real + part).coeffs()]
            size, moves = (sum(map(abs, row), arb(0)).mid() for row in (whole, part.coeffs()))
            if not size.is_finite():
                raise NotProvenError("no polynomial near the solution was found")
            scales[i] = max(scales[i], abs(z[i]).mid())
            change = max(change, float(moves / size) if size > 0 else 0.0)
            y[i] = Polynomial(whole)
        if change < accuracy * _CLOSE:
            return Guess(y, V, W)
    raise NotProvenError("no polynomial near the solution was found")


def _flow(A: list[arb_mat], inverse: bool) -> list[arb_mat]:
    """About the solution of V' = A V, or of W' = -W A, with the identity at x = 0."""
    found = [identity(A[0].nrows())]
    for k in range(len(A)):
        pairs = zip(A[: k + 1], reversed(found), strict=True)
        products = [-(w * a) if inverse else a * w for a, w in pairs]
        found.append((total(products) / arb(k + 1)).mid())
    return found


def applied(series: list[arb_mat], parts: Sequence[arb_poly], count: int) -> list[arb_poly]:
    """The first coefficients of a matrix of polynomials times a column of them."""
    columns = list(enumerate(parts))
    return [
        sum((arb_poly([m[i, j] for m in series]) * p for j, p in columns), arb_poly())
        .truncate(count)
        for i in range(len(parts))
    ]  # fmt: skip
