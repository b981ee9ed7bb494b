"""Proven zeros of the gradient of H near given points.

Input:  :class:`~hamsym.proof.zeros.derivative_balls.DerivativeBalls`, approximate zeros.
Output: :class:`Root`, with an enclosure in balls.

Lemma 29 of examples/guide/how_proofs_work.md, with outward rounding in Arb.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

import sympy
from flint import arb, arb_mat

from hamsym.proof.arithmetic.balls import interval, working
from hamsym.proof.zeros.derivative_balls import Balls, DerivativeBalls

BITS = 192  # of enclosures
_NEWTON = 60  # most steps
_RADII = 60  # trial radii, each 2**-_STEP times the one before
_STEP = 6
_SHRINKS = (2.0**-40, 2.0**-20, 2.0**-8, 2.0**-4, 2.0**-2)
_CONTRACTIONS = 40


@dataclass(frozen=True)
class Root:
    """A proven zero of the gradient."""

    #: Contains the zero.
    enclosure: Balls
    #: Contains the enclosure, and no other zero.
    unique: Balls


class Block:
    """The gradient as a function of some components, which the other components do not enter."""

    def __init__(self, balls: DerivativeBalls, block: Sequence[int]) -> None:
        self.balls, self.block, self.size = balls, list(block), len(block)

    def whole(self, part: Sequence[Any]) -> Balls:
        # NaN, so that nothing is concluded from terms of the other components alone.
        state = [arb.nan()] * self.balls.dim
        for i, value in zip(self.block, part, strict=True):
            state[i] = value
        return state

    def values(self, part: Sequence[Any]) -> Balls:
        found = self.balls.gradient(self.whole(part))
        return [found[i] for i in self.block]

    def slopes(self, part: Sequence[Any]) -> list[Balls]:
        rows = self.balls.hessian(self.whole(part))
        return [[rows[i][j] for j in self.block] for i in self.block]


def approximate_inverse(rows: list[Balls]) -> arb_mat | None:
    """An approximate inverse without radii, or None."""
    matrix = arb_mat([[entry.mid() for entry in row] for row in rows])
    try:
        found = matrix.inv().mid()
    except ZeroDivisionError:
        return None
    return found if all(entry.is_finite() for entry in found.entries()) else None


def krawczyk(system: Block, middle: Balls, box: Balls) -> Balls | None:
    """K = c - Y g(c) + (1 - Y J) (Z - c); None where g is not smooth in the box Z."""
    if not all(value.is_finite() for value in system.values(box)):
        return None
    slopes = system.slopes(box)
    if not all(entry.is_finite() for row in slopes for entry in row):
        return None
    Y = approximate_inverse(slopes)
    if Y is None:
        return None
    size = system.size
    step = Y * arb_mat(size, 1, system.values(middle))
    spread = (arb_mat(size, size, [int(i == j) for i in range(size) for j in range(size)])
              - Y * arb_mat(slopes)) * arb_mat(
        size, 1, [z - c for z, c in zip(box, middle, strict=True)]
    )  # fmt: skip
    return [c - step[i, 0] + spread[i, 0] for i, c in enumerate(middle)]


def inside(inner: Balls, outer: Balls) -> bool:
    return all(b.contains_interior(a) for a, b in zip(inner, outer, strict=True))


def newton(system: Block, point: Balls, rounds: int = _NEWTON) -> Balls:
    """Newton's iteration on mid-points, until steps no longer shrink."""
    last = None
    for _ in range(rounds):
        values, slopes = system.values(point), system.slopes(point)
        if not all(entry.is_finite() for entry in [*values, *(e for row in slopes for e in row)]):
            break
        Y = approximate_inverse(slopes)
        if Y is None:
            break
        step = (Y * arb_mat(system.size, 1, values)).mid()
        size = sum((abs(entry) for entry in step.entries()), arb(0)).mid()
        if size.is_zero() or (last is not None and not size < last):
            break
        last = size
        point = [(c - step[i, 0]).mid() for i, c in enumerate(point)]
    return point


def refined(system: Block, proven: Balls, unique: Balls, start: Balls) -> Balls:
    """A narrower enclosure of the only zero in a box, by repeated contraction.

    - proven: Contains the zero.
    - unique: Contains the zero, and no other one.
    - start: Approximation of the zero.
    """
    current = _near(system, unique, start) or proven
    for _ in range(_CONTRACTIONS):
        middle = [entry.mid() for entry in current]
        found = krawczyk(system, middle, current)
        if found is None or not all(a.overlaps(b) for a, b in zip(found, current, strict=True)):
            break
        both = [a.intersection(b) for a, b in zip(found, current, strict=True)]
        narrower = any(a.rad() < 0.9 * b.rad() for a, b in zip(both, current, strict=True))
        current = both
        if not narrower:
            break
    return current


def _near(system: Block, unique: Balls, start: Balls) -> Balls | None:
    """An enclosure from the smallest trial box around the start that is proven to hold the zero.

    In a wide box a contraction may be too slow to be worth repeating.
    """
    for shrink in _SHRINKS:
        box = [c + arb(0, entry.rad() * shrink) for c, entry in zip(start, unique, strict=True)]
        if all(b.contains(a) for a, b in zip(box, unique, strict=True)):
            found = krawczyk(system, start, box)
            if found is not None and inside(found, box):
                return found
    return None


def enclosed_root(
    balls: DerivativeBalls, point: Sequence[float], sizes: Sequence[float]
) -> Root | None:
    """Prove that the gradient has exactly one zero near a point.

    - sizes: Radii of the largest box, in the units of the components. Smaller ones are tried as
      long as the proof fails.
    - returns: None if nothing is proven, for example where the Hessian is singular.

    Examples
    --------
    >>> from hamsym import Hamiltonian
    >>> balls = DerivativeBalls(Hamiltonian("p**2/2 + x**4/4 - x"))
    >>> root = enclosed_root(balls, [0.9, 0.1], [1.0, 1.0])
    >>> root.enclosure[0].contains(1), bool(root.enclosure[0].rad() < 1e-50)
    (True, True)
    """
    system = Block(balls, range(balls.dim))
    with working(BITS):
        middle = newton(system, [arb(value) for value in point])
        shrink = 1
        for _ in range(_RADII):
            box = [c + arb(0, arb(s) / shrink) for c, s in zip(middle, sizes, strict=True)]
            found = krawczyk(system, middle, box)
            if found is not None and inside(found, box) and balls.energy(box).is_finite():
                return Root(refined(system, found, box, middle), box)
            shrink *= 2**_STEP
    return None


def polynomial_roots(
    slope: sympy.Expr, symbol: sympy.Symbol, low: float, high: float
) -> list[Root]:
    """All real zeros of a polynomial in an interval, whatever their multiplicity.

    They are isolated in exact arithmetic of fractions (Sturm, Collins & Akritas, by sympy).

    - slope: With rational coefficients, and not zero.

    Examples
    --------
    >>> import sympy
    >>> x = sympy.Symbol("x", real=True)
    >>> found = polynomial_roots(x**3 * (x**2 - 2) * (x - 9), x, -1.0, 2.0)
    >>> [root.enclosure[0].str(10, radius=False) for root in found]
    ['0', '1.414213562']
    """
    polynomial = sympy.Poly(slope, symbol, domain="QQ").sqf_part()
    first, last = Fraction(low), Fraction(high)
    finest = (last - first) / 2**BITS
    if polynomial.degree() < 1:
        return []
    found = polynomial.intervals(eps=sympy.Rational(finest.numerator, finest.denominator))
    ends = [[Fraction(int(end.p), int(end.q)) for end in pair] for pair, _ in found]
    if not ends:
        return []
    gaps = [Fraction(1), *(a - b for (_, b), (a, _) in pairwise(ends)), Fraction(1)]
    rooms = [min(pair) / 2 for pair in pairwise(gaps)]
    with working(BITS):
        return [
            Root([interval(a, b)], [interval(a - room, b + room)])
            for (a, b), room in zip(ends, rooms, strict=True)
            if b >= first and a <= last
        ]
