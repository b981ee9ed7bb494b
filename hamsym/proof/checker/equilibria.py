"""Equilibria: exactly one zero of grad H in a ball, and the type of the linear motion there.

With g = grad H and a matrix Y of numbers, K = c - Y g(c) + (1 - Y Hess H(X)) (X - c) contains every
zero of g in the box X around c; if it is in the interior of X there is exactly one (Krawczyk 1969).

The motion is linear in pairs of components that are coupled. Squares of its eigenvalues are the
roots of a polynomial. Where the Hessian of a block is definite, or diag(V, T) with V or T definite,
all of them are real, and Descartes' rule counts their signs exactly. Else balls isolate them.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat, arb_poly

from hamsym.proof.checker.formulas import NotProvenError, refusing_other_forms
from hamsym.proof.checker.functions import UNIT, Equations, column, inverse, krawczyk, roots

_BITS, _NEWTON, _CONTRACTIONS, _WIDER = 320, 8, 40, 4
_LEAST = arb(2) ** -200  # radius of the box


def check_equilibrium(H: Mapping[str, Any], claims: Mapping[str, Any]) -> None:
    """Prove that one equilibrium is in a ball, and its type; raise NotProvenError otherwise.

    - claims: "mid" and "radius" of the ball, "type" in words, "stable" and "definite".
    """
    with refusing_other_forms(_BITS):
        equations = Equations(H)
        if not equations.conserved:
            raise NotProvenError("equilibria with forces or with explicit time are not covered")
        middle = [arb(float(value)) for value in claims["mid"]]
        radius = [arb(float(value)) for value in claims["radius"]]
        sizes = zip(middle, radius, strict=True)
        if len(middle) != equations.dim or not all(m.is_finite() and r >= 0 for m, r in sizes):
            raise NotProvenError("the ball of the equilibrium is none")
        _check_words(_hessian(equations, _zero(equations, middle, radius)), claims)


def _of_energy(rates: Sequence[Any]) -> list[Any]:
    """The gradient of H, or rows of its Hessian, from J times them."""
    half = len(rates) // 2
    return [*(rate * -1 for rate in rates[half:]), *rates[:half]]


def _gradient(equations: Equations, state: Sequence[arb]) -> list[arb]:
    return _of_energy(equations.run_rates([*state, arb(0)]))


def _hessian(equations: Equations, state: Sequence[arb]) -> arb_mat:
    slopes = equations.run_slopes([*state, arb(0)])
    if not all(value.is_finite() for value in slopes):
        raise NotProvenError("H is not smooth near the equilibrium")
    rows = [arb_mat([row]) for row in equations.matrix(slopes).tolist()]
    return arb_mat([row.entries() for row in _of_energy(rows)])


def _zero(equations: Equations, middle: list[arb], radius: list[arb]) -> list[arb]:
    """A narrow box with the only equilibrium in the claimed one."""
    near = middle
    for _ in range(_NEWTON):
        step = inverse(_hessian(equations, near)) * column(_gradient(equations, near))
        near = [(a - b).mid() for a, b in zip(near, step.entries(), strict=True)]
    parts = zip(near, middle, radius, strict=True)
    box = [c + ((abs(c - m) + r) * 4 + _LEAST).abs_upper() * UNIT for c, m, r in parts]
    for _ in range(_WIDER):
        found = _contracted(equations, near, box, set())
        if _is_inside(found, box, set()):
            break
        # A component with a narrow ball may depend on one with a wide one.
        around = zip(found, near, box, strict=True)
        box = [b.union(c + (a - c) * 2) for a, c, b in around]
    else:
        raise NotProvenError("its claim that one equilibrium is in the ball is not proven")
    # Components that are claimed exactly: g vanishes there for all values of the others.
    fixed = {i for i, r in enumerate(radius) if r == 0}
    part = [middle[i] if i in fixed else value for i, value in enumerate(box)]
    slopes = _gradient(equations, part)
    fixed = fixed if all(slopes[i].is_zero() for i in fixed) else set()
    if fixed:
        found = _contracted(equations, [value.mid() for value in part], part, fixed)
        if not _is_inside(found, part, fixed):
            raise NotProvenError("its claim that one equilibrium is in the ball is not proven")
    for _ in range(_CONTRACTIONS):
        if all(abs(a - m) <= r for a, m, r in zip(found, middle, radius, strict=True)):
            return found
        found = _contracted(equations, [value.mid() for value in found], found, fixed)
    raise NotProvenError("its claim that the equilibrium is in the ball is not proven")


def _contracted(
    equations: Equations, centre: Sequence[arb], box: list[arb], fixed: set[int]
) -> list[arb]:
    """K, for the components that are not fixed."""
    slopes, values = _hessian(equations, box), column(_gradient(equations, centre))
    for i in fixed:
        values[i, 0] = arb(0)
        for j in range(equations.dim):
            slopes[i, j] = slopes[j, i] = arb(int(i == j))
    found = krawczyk(centre, box, values, slopes)
    return [box[i] if i in fixed else value for i, value in enumerate(found)]


def _is_inside(found: Sequence[arb], box: Sequence[arb], fixed: set[int]) -> bool:
    pairs = enumerate(zip(found, box, strict=True))
    return all(i in fixed or b.contains_interior(a) for i, (a, b) in pairs)


# -- the linear motion ----------------------------------------------------------------------------


def _check_words(hessian: arb_mat, claims: Mapping[str, Any]) -> None:
    if claims["type"] == "degenerate" and claims["stable"] is None and not claims["definite"]:
        return  # nothing is claimed
    counts: Counter[str] = Counter()
    definite = set()
    for block in _blocks(hessian):
        found, sign = _classified(block)
        counts.update(found)
        definite.add(sign)
    if not re.fullmatch(r"(\d+ x )?[a-z]+((-|, )(\d+ x )?[a-z]+)*", claims["type"]):
        raise NotProvenError("its type is not written in words of types")
    words = re.sub("focus-focus", "focus", claims["type"])
    claimed = Counter(re.findall("[a-z]+", re.sub(r"\d+ x [a-z]+", "", words)))
    claimed.update({name: int(n) for n, name in re.findall(r"(\d+) x ([a-z]+)", words)})
    if +counts != +claimed or claims["stable"] is not (not counts["saddle"] + counts["focus"]):
        raise NotProvenError(f"its claim about the type is not proven: it is {dict(+counts)}")
    if claims["definite"] not in ((0,) if len(definite) > 1 else (0, *definite)):
        raise NotProvenError("its claim that the Hessian is definite is not proven")


def _blocks(hessian: arb_mat) -> list[arb_mat]:
    """Hessians of pairs that are coupled with each other only."""
    dim = hessian.nrows()
    half, groups = dim // 2, [{i} for i in range(dim // 2)]
    for i in range(dim):
        for j in range(dim):
            if not hessian[i, j].is_zero():
                joined = [g for g in groups if i % half in g or j % half in g]
                groups = [g for g in groups if g not in joined] + [set().union(*joined)]
    places = [[*sorted(g), *(half + i for i in sorted(g))] for g in groups]
    return [arb_mat([[hessian[i, j] for j in own] for i in own]) for own in places]


def _classified(hessian: arb_mat) -> tuple[dict[str, int], int]:
    """Numbers of pairs of eigenvalues by type, and the sign of a definite Hessian or 0."""
    size = hessian.nrows()
    half = size // 2
    own = _signs(hessian.charpoly())
    if size in own:
        return {"centre": half}, 1 if own[0] == size else -1
    V, T, mixed = (
        arb_mat([[hessian[i + a, j + b] for j in range(half)] for i in range(half)])
        for a, b in ((0, 0), (half, half), (0, half))
    )
    rows = hessian.tolist()
    rates = arb_mat([*rows[half:], *((arb_mat([row]) * -1).entries() for row in rows[:half])])
    squares = arb_poly(rates.charpoly().coeffs()[::2])
    separate = all(entry.is_zero() for entry in mixed.entries())
    if separate and half in (*_signs(V.charpoly()), *_signs(T.charpoly())):
        positive, negative = _signs(squares)
        if positive + negative == half:
            return {"centre": negative, "saddle": positive}, 0
    found: Counter[str] = Counter()
    for value, real in roots(squares):
        if real is None or not (value.real < 0 or value.real > 0 or not real):
            raise NotProvenError("its claim about the type is not proven")
        found["focus" if not real else "saddle" if value.real > 0 else "centre"] += 1
    return {**found, "focus": found["focus"] // 2}, 0


def _signs(polynomial: arb_poly) -> tuple[int, int]:
    """Numbers of positive and negative roots, all of which are real; (0, 0) if unknown."""
    counts = []
    for sign in (1, -1):
        series = [c * sign**k for k, c in enumerate(polynomial.coeffs())]
        known = [c for c in series if not c.is_zero()]
        if series[0].is_zero() or not all(c > 0 or c < 0 for c in known):
            return 0, 0
        counts.append(sum((a > 0) != (b > 0) for a, b in pairwise(known)))
    return counts[0], counts[1]
