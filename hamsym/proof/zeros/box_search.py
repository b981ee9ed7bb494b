"""All zeros of the gradient of H in a box, by interval subdivision.

Input:  :class:`~hamsym.proof.zeros.derivative_balls.DerivativeBalls`, a box.
Output: :class:`Search`: all zeros in the box, with enclosures, and the parts of the box that could
        not be decided.

A box is decided in one of three ways: a component of g = grad H, or of its mean value form, or of Y
g for an approximate inverse Y of the Hessian, has no zero in it, or no value, as a root of negative
numbers; it lies in a box with exactly one known zero; or the test of existence
(:mod:`hamsym.proof.zeros.roots`) succeeds on a slightly larger box. Otherwise it is divided. Where
g is not smooth, its components that depend on that term are NaN and exclude nothing, and the others
still do. (Hansen & Walster, Global Optimization Using Interval Analysis, 2nd ed., 2004.)
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from flint import arb, arb_mat

from hamsym.hamiltonian import Hamiltonian
from hamsym.proof.arithmetic.balls import working
from hamsym.proof.arithmetic.directed import next_down, next_up
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.limits import Deadline
from hamsym.proof.zeros.derivative_balls import Balls, DerivativeBalls
from hamsym.proof.zeros.roots import (
    BITS,
    Block,
    Root,
    approximate_inverse,
    inside,
    krawczyk,
    newton,
    refined,
)

SINGULAR = "H is not smooth there"
DEGENERATE = "the Hessian is singular or nearly singular there"
UNFINISHED = "the limit was reached"
MANY = "too many zeros were found, of which there may be infinitely many"

_BITS = 64
_SPLIT = 0.4871  # not one half: zeros at the centre are frequent, and then on four edges
_INFLATION = 0.1  # of the width, by which a box grows for the test of existence
_MOST_ROOTS = 1_000  # after which the rest is undecided: each box is compared with all of them
_MOST_ROUGH = 1_000  # boxes where g is not smooth, after which they are not divided as finely
_ROUGHEST = 2.0**-6  # share of the box that is fine enough then
_EVERY = 3  # boxes: one of them is divided where its relative width is largest
_ROUNDS = 4  # contractions of a box before it is divided

_Box = tuple[list[float], list[float]]


@dataclass(frozen=True)
class Undecided:
    """A part of a box in which zeros were neither found nor excluded."""

    #: low, high: Its corners, in the components of the block.
    low: tuple[float, ...]
    high: tuple[float, ...]
    reason: str


@dataclass
class Search:
    """The result of :func:`search_box`."""

    #: Distinct zeros, each in the box or on its edge within the width of its enclosure.
    roots: list[Root] = field(default_factory=list)
    undecided: list[Undecided] = field(default_factory=list)
    #: boxes, rough: Boxes that were examined, and those among them where g is not smooth.
    boxes: int = 0
    rough: int = 0


def _ball(low: float, high: float) -> Any:
    middle = low + 0.5 * (high - low)
    return arb(middle, float(next_up(max(high - middle, middle - low))))


def _ends(ball: Any) -> tuple[float, float]:
    """Floats below and above all numbers of a ball."""
    return (
        float(next_down(float(ball.lower()))),
        float(next_up(float(ball.upper()))),
    )


class _Excluded(Exception):  # noqa: N818 - no error
    """A box contains no zero."""


class _Pruner:
    """Contraction of one box: bounds of its zeros by the components of g and of Y g."""

    def __init__(self, system: Block, box: _Box) -> None:
        self.system = system
        self.low, self.high = list(box[0]), list(box[1])
        self.balls = [_ball(a, b) for a, b in zip(*box, strict=True)]
        found = system.balls.gradient_inside(system.whole(self.balls))
        if found is None:
            raise _Excluded
        values = [found[i] for i in system.block]
        self.rough = [i for i, value in enumerate(values) if not value.is_finite()]
        for value in values:
            if value.is_finite() and not value.contains(0):
                raise _Excluded
        self.slopes = system.slopes(self.balls)
        self.centre = [ball.mid() for ball in self.balls]
        self.offsets = [ball - c for ball, c in zip(self.balls, self.centre, strict=True)]
        self.regular = False

    def contract(self) -> None:
        """Shrink the box; :class:`_Excluded` if nothing is left."""
        at_centre = self.system.values(self.centre)
        smooth = [
            i not in self.rough
            and at_centre[i].is_finite()
            and all(entry.is_finite() for entry in row)
            for i, row in enumerate(self.slopes)
        ]
        for i, row in enumerate(self.slopes):
            if smooth[i]:
                self._by_row(row, at_centre[i])
        Y = approximate_inverse(self.slopes) if all(smooth) else None
        if Y is None:
            return
        size = self.system.size
        product = Y * arb_mat(self.slopes)
        constant = Y * arb_mat(size, 1, at_centre)
        widths = [b - a for a, b in zip(self.low, self.high, strict=True)]
        rows = [[product[i, j] for j in range(size)] for i in range(size)]
        self.regular = all(
            bool(sum((abs(entry - int(i == j)) * widths[j] for j, entry in enumerate(row)), arb(0))
                 < 0.9 * widths[i])
            for i, row in enumerate(rows)
        )  # fmt: skip
        for i, row in enumerate(rows):
            self._by_row(row, constant[i, 0])

    def _by_row(self, row: Balls, constant: Any) -> None:
        """Use constant + row * (z - c) = 0, an equation that holds for every zero z."""
        terms = [entry * offset for entry, offset in zip(row, self.offsets, strict=True)]
        total = sum(terms, constant)
        if not total.contains(0):
            raise _Excluded
        for j, entry in enumerate(row):
            if entry.contains(0):
                continue
            rest = sum((term for k, term in enumerate(terms) if k != j), constant)
            low, high = _ends(self.centre[j] - rest / entry)
            if low > self.high[j] or high < self.low[j]:  # False for NaN
                raise _Excluded
            if low > self.low[j] or high < self.high[j]:
                self.low[j], self.high[j] = max(low, self.low[j]), min(high, self.high[j])
                self.offsets[j] = _ball(self.low[j], self.high[j]) - self.centre[j]
                terms[j] = entry * self.offsets[j]

    def scores(self, shares: Sequence[float]) -> list[float]:
        """For each component, how much its width contributes to that of g.

        Where a component of g is not smooth: the widths, as shares of the whole box, of the
        components of z that decide about it.
        """
        widths = [b - a for a, b in zip(self.low, self.high, strict=True)]
        if self.rough:
            rows = [self.slopes[i] for i in self.rough]
            involved = [
                j for j in range(self.system.size) if any(not row[j].is_zero() for row in rows)
            ]
            decisive = [j for j in involved if self._is_decisive(j)] or involved
            return [share * (j in decisive) for j, share in enumerate(shares)]
        found = [0.0] * self.system.size
        for row in self.slopes:
            effects = [float(abs(e).upper()) * w for e, w in zip(row, widths, strict=True)]
            total = sum(effects)
            if 0 < total < math.inf:
                found = [f + effect / total for f, effect in zip(found, effects, strict=True)]
        return found

    def _is_decisive(self, j: int) -> bool:
        """Whether g is smooth in more of its components at one end of component j."""
        for end in (self.low[j], self.high[j]):
            values = self.system.values(
                [arb(end) if k == j else z for k, z in enumerate(self.balls)]
            )
            if sum(not value.is_finite() for value in values) < len(self.rough):
                return True
        return False


def search_box(
    balls: DerivativeBalls,
    block: Sequence[int],
    low: Sequence[float],
    high: Sequence[float],
    *,
    most: int,
    deadline: Deadline,
    finest: float = 2.0**-32,
) -> Search:
    """Find all zeros of the gradient in a box, with proof.

    - block: The components of the box; the gradient in these must depend on them only.
    - low, high: Corners of the box.
    - most: Number of boxes after which the rest is undecided.
    - deadline: Time after which the rest is undecided.
    - finest: Width of boxes that are not divided further, as a share of the width of the whole.
    - returns: If its ``undecided`` is empty, ``roots`` are all zeros in the box.

    Examples
    --------
    >>> balls = DerivativeBalls(Hamiltonian("p**2/2 - cos(x)"))
    >>> found = search_box(balls, [0], [-10], [10], most=1000, deadline=Deadline.after(None))
    >>> [round(float(root.enclosure[0]) / math.pi, 9) + 0.0 for root in found.roots]
    [-3.0, -2.0, -1.0, 0.0, 1.0, 2.0, 3.0]
    >>> found.undecided
    []
    """
    system = Block(balls, block)
    scale = [b - a for a, b in zip(low, high, strict=True)]
    search = Search()
    queue: deque[_Box] = deque([(list(map(float, low)), list(map(float, high)))])
    with working(_BITS):
        while queue:
            many = len(search.roots) >= _MOST_ROOTS
            if many or search.boxes >= most or deadline.exceeded:
                reason = MANY if many else UNFINISHED
                search.undecided += [Undecided(tuple(a), tuple(b), reason) for a, b in queue]
                break
            search.boxes += 1
            rest = _examined(system, queue.popleft(), search, scale, finest)
            queue.extend(rest)
    with working(BITS):
        search.roots = [
            root
            for root in _distinct(search)
            if all(
                bool(entry.upper() >= a and entry.lower() <= b)
                for entry, a, b in zip(root.enclosure, low, high, strict=True)
            )
        ]
    search.roots.sort(key=lambda root: [float(entry.mid()) for entry in root.enclosure])
    return search


def _examined(
    system: Block, box: _Box, search: Search, scale: Sequence[float], finest: float
) -> list[_Box]:
    """Decide a box, or return the parts into which it is divided."""
    try:
        for _ in range(_ROUNDS):
            if _covered(box, search.roots):
                return []
            pruner = _Pruner(system, box)
            pruner.contract()
            if pruner.regular and (root := _root_of(system, pruner)):
                search.roots.append(root)
                return []
            before = [b - a for a, b in zip(*box, strict=True)]
            box = pruner.low, pruner.high
            after = [b - a for a, b in zip(*box, strict=True)]
            if not any(b < 0.7 * a for a, b in zip(before, after, strict=True)):
                break
    except _Excluded:
        return []
    if _covered(box, search.roots):
        return []
    shares = [(b - a) / s for a, b, s in zip(*box, scale, strict=True)]
    scores = pruner.scores(shares)
    if not pruner.rough and (search.boxes % _EVERY == 0 or not max(scores) > 0):
        scores = [(b - a) / (max(abs(a), abs(b)) or 1) for a, b in zip(*box, strict=True)]
    j = scores.index(max(scores))
    search.rough += bool(pruner.rough)
    many = search.rough > _MOST_ROUGH and bool(pruner.rough) and shares[j] <= _ROUGHEST
    if many or not shares[j] > finest:
        reason = SINGULAR if pruner.rough else DEGENERATE
        search.undecided.append(Undecided(tuple(box[0]), tuple(box[1]), reason))
        return []
    cut = box[0][j] + _SPLIT * (box[1][j] - box[0][j])
    return [
        (list(box[0]), [cut if k == j else b for k, b in enumerate(box[1])]),
        ([cut if k == j else a for k, a in enumerate(box[0])], list(box[1])),
    ]


def _covered(box: _Box, roots: Sequence[Root]) -> bool:
    """Whether a box lies in one that contains a single known zero."""
    return any(
        all(
            entry.contains(arb(a)) and entry.contains(arb(b))
            for entry, a, b in zip(root.unique, *box, strict=True)
        )
        for root in roots
    )


def _root_of(system: Block, pruner: _Pruner) -> Root | None:
    """The only zero in a slightly larger box, if the test of existence succeeds there."""
    grown = []
    for a, b in zip(pruner.low, pruner.high, strict=True):
        more = _INFLATION * (b - a) + 2.0**-44 * max(abs(a), abs(b)) + 1e-290
        grown.append(_ball(a - more, b + more))
    middle = newton(system, [ball.mid() for ball in grown], 8)
    if not all(g.contains(c) for g, c in zip(grown, middle, strict=True)):
        return None
    with working(BITS):
        found = krawczyk(system, middle, grown)
        if found is None or not inside(found, grown):
            return None
        return Root(refined(system, found, grown, middle), grown)


def _distinct(search: Search) -> list[Root]:
    """Zeros without repetitions: two enclosures in the box of one of them hold the same zero."""
    kept: list[Root] = []
    for root in search.roots:
        pairs = ((other, zip(root.enclosure, other.enclosure, strict=True)) for other in kept)
        near = [other for other, both in pairs if all(a.overlaps(b) for a, b in both)]
        same = [
            other
            for other in near
            if inside(root.enclosure, other.unique) or inside(other.enclosure, root.unique)
        ]
        if same:
            continue
        kept.append(root)
        if near:  # one zero or two
            ends = [_ends(entry) for entry in root.enclosure]
            low, high = zip(*ends, strict=True)
            search.undecided.append(Undecided(low, high, DEGENERATE))
    return kept


def singular_term(H: Hamiltonian, low: Sequence[float], high: Sequence[float]) -> str:
    """The term of H or its derivatives that is not smooth in a box; empty if none is found."""
    strict = GeneratedFunctions(H, BALLS)
    with working(_BITS):
        box = [_ball(a, b) for a, b in zip(low, high, strict=True)]
        try:
            for name in ("vector_field", "hessian"):
                strict(name, box, arb(0))
        except SingularityError as error:
            return str(error)
    return ""
