"""Equilibria: exactly one zero of grad H in a ball, and the type of the linear motion there.

With g = grad H and a matrix Y of numbers, K = c - Y g(c) + (1 - Y Hess H(X)) (X - c) contains every
zero of g in the box X around c; if it is in the interior of X there is exactly one (Krawczyk 1969).

The motion is linear in pairs of components that are coupled. Where the Hessian of a block is
definite, all eigenvalues are imaginary. Where it is diag(V, T), with V or T definite, squares of
eigenvalues are those of -T V, all real, and Descartes' rule counts their signs exactly. Else
eigenvalues k are isolated by balls: k is imaginary if -conj(k) can be no other one, since that is
an eigenvalue, too, and real if conj(k) can be no other one.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from flint import acb_mat, arb, arb_mat, ctx

from hamsym.proof.checker.formulas import NotProvenError, refusing_other_forms
from hamsym.proof.checker.functions import UNIT, Equations, column, identity

_BITS, _NEWTON, _CONTRACTIONS, _WIDER = 320, 8, 40, 4
_LEAST = arb(2) ** -200  # radius of the box


def check_equilibrium(H: Mapping[str, Any], claims: Mapping[str, Any]) -> None:
    """Prove that one equilibrium is in a ball, and its type; raise NotProvenError otherwise.

    - claims: "mid" and "radius" of the ball, "type" in words, "stable" and "definite".
    """
    with ctx.workprec(_BITS), refusing_other_forms():
        system = _System(Equations(H))
        middle = [arb(float(value)) for value in claims["mid"]]
        radius = [arb(float(value)) for value in claims["radius"]]
        sizes = zip(middle, radius, strict=True)
        if len(middle) != system.dim or not all(m.is_finite() and r >= 0 for m, r in sizes):
            raise NotProvenError("the ball of the equilibrium is none")
        _check_words(system.hessian(_zero(system, middle, radius)), claims)


class _System:
    def __init__(self, equations: Equations) -> None:
        if not equations.conserved:
            raise NotProvenError("equilibria with forces or with explicit time are not covered")
        formulas, self.dim = equations.formulas, equations.dim
        rows = [formulas.gradient(slope, self.dim) for slope in equations.slopes]
        self._gradient = formulas.program(equations.slopes)
        self._hessian = formulas.program([place for row in rows for place in row])
        self._energy = equations.run_energy

    def gradient(self, state: Sequence[arb]) -> arb_mat:
        return column(self._gradient([*state, arb(0)]))

    def hessian(self, state: Sequence[arb]) -> arb_mat:
        if not self._energy([*state, arb(0)])[0].is_finite():
            raise NotProvenError("H is not smooth near the equilibrium")
        return arb_mat(self.dim, self.dim, self._hessian([*state, arb(0)]))


def _inverse(matrix: arb_mat) -> arb_mat:
    try:
        return matrix.mid().inv().mid()
    except ZeroDivisionError:
        raise NotProvenError("the Hessian is singular, the equilibrium not isolated") from None


def _zero(system: _System, middle: list[arb], radius: list[arb]) -> list[arb]:
    """A narrow box with the only equilibrium in the claimed one."""
    near = column(middle)
    for _ in range(_NEWTON):
        state = near.entries()
        near = (near - _inverse(system.hessian(state)) * system.gradient(state)).mid()
    parts = zip(near.entries(), middle, radius, strict=True)
    box = [c + ((abs(c - m) + r) * 4 + _LEAST).abs_upper() * UNIT for c, m, r in parts]
    for _ in range(_WIDER):
        found = _krawczyk(system, near, box, set())
        if all(b.contains_interior(a) for a, b in zip(found, box, strict=True)):
            break
        # A component with a narrow ball may depend on one with a wide one.
        around = zip(found, near.entries(), box, strict=True)
        box = [b.union(c + (a - c) * 2) for a, c, b in around]
    else:
        raise NotProvenError("its claim that one equilibrium is in the ball is not proven")
    # Components that are claimed exactly: g vanishes there for all values of the others.
    fixed = {i for i, r in enumerate(radius) if r == 0}
    part = [middle[i] if i in fixed else value for i, value in enumerate(box)]
    slopes = system.gradient(part).entries()
    if fixed and all(slopes[i].is_zero() for i in fixed):
        centre = column([value.mid() for value in part])
        found = _krawczyk(system, centre, part, fixed)
        others = [
            (a, b) for i, (a, b) in enumerate(zip(found, part, strict=True)) if i not in fixed
        ]
        if not all(b.contains_interior(a) for a, b in others):
            raise NotProvenError("its claim that one equilibrium is in the ball is not proven")
    else:
        fixed = set()
    for _ in range(_CONTRACTIONS):
        if all(abs(a - m) <= r for a, m, r in zip(found, middle, radius, strict=True)):
            return found
        found = _krawczyk(system, column([value.mid() for value in found]), found, fixed)
    raise NotProvenError("its claim that the equilibrium is in the ball is not proven")


def _krawczyk(system: _System, centre: arb_mat, box: list[arb], fixed: set[int]) -> list[arb]:
    """K, for the components that are not fixed."""
    slopes, values = system.hessian(box), system.gradient(centre.entries())
    for i in fixed:
        values[i, 0] = arb(0)
        for j in range(system.dim):
            slopes[i, j] = slopes[j, i] = arb(int(i == j))
    Y = _inverse(slopes)
    spread = (identity(system.dim) - Y * slopes) * (column(box) - centre)
    found = (centre - Y * values + spread).entries()
    return [box[i] if i in fixed else value for i, value in enumerate(found)]


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
    own = _signs(hessian)
    if size in own:
        return {"centre": half}, 1 if own[0] == size else -1
    V, T, mixed, _ = (
        arb_mat([[hessian[i + a, j + b] for j in range(half)] for i in range(half)])
        for a, b in ((0, 0), (half, half), (0, half), (half, 0))
    )
    if all(entry.is_zero() for entry in mixed.entries()) and half in (*_signs(V), *_signs(T)):
        positive, negative = _signs(T * V)
        if positive + negative == half:
            return {"centre": positive, "saddle": negative}, 0
    rows = [[hessian[(i + half) % size, j] * (1 if i < half else -1) for j in range(size)]
            for i in range(size)]  # fmt: skip
    try:
        values = acb_mat(rows).eig()
    except (ValueError, ZeroDivisionError):
        raise NotProvenError("its claim about the type is not proven") from None
    found: Counter[str] = Counter()
    for value in values:
        mirrored = [other.overlaps(-value.conjugate()) for other in values]
        conjugate = [other.overlaps(value.conjugate()) for other in values]
        if sum(mirrored) != 1 or sum(conjugate) != 1:
            raise NotProvenError("its claim about the type is not proven")
        own_image, real = value.overlaps(-value.conjugate()), value.overlaps(value.conjugate())
        name = "centre" if own_image else "saddle" if real else "focus"
        found[name] += 1
    pairs = {"centre": 2, "saddle": 2, "focus": 4}
    return {name: count // pairs[name] for name, count in found.items()}, 0


def _signs(matrix: arb_mat) -> tuple[int, int]:
    """Numbers of positive and negative eigenvalues, all of which are real; (0, 0) if unknown."""
    polynomial, counts = matrix.charpoly(), []
    for sign in (1, -1):
        series = [c * sign**k for k, c in enumerate(polynomial.coeffs())]
        known = [c for c in series if not c.is_zero()]
        if series[0].is_zero() or not all(c > 0 or c < 0 for c in known):
            return 0, 0
        counts.append(sum((a > 0) != (b > 0) for a, b in pairwise(known)))
    return counts[0], counts[1]
