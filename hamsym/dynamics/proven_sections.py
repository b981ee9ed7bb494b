"""Proven crossings of a surface, and the derivative of the Poincare map.

Input:  a Hamiltonian, starts that may be balls, and a surface g(z, t) = 0.
Output: :class:`SectionCertificate`: every crossing in the span, in balls.

The solution is enclosed (:func:`hamsym.enclose`), and the span is divided until on each part [a, b]

    g has no zero, or dg/dt = grad g . F + g_t has none.

In a stretch of parts of the second kind g is monotone, and it begins and ends beside a part without
a zero. So it has one crossing if the signs at its ends differ, and none if they are equal. States
over a part with the middle m and half of the length d lie in

    Z = z(m) + [-d, d] F(Z),

if the right side, for a trial Z, is inside of it (Lohner 1992). The time of a crossing is then
narrowed by Newton's method for intervals, T = m - g(z(m)) / (dg/dt)(Z). With M = dz(T)/dz0, which
is enclosed over T in the same way, the derivative of the Poincare map P is

    DP = M - F (grad g M) / (dg/dt).

Of a start that is a ball, crossings are those of its middle c, moved by the mean value theorem:
P(z0) in P(c) + DP (z0 - c), and the time likewise with -(grad g M) / (dg/dt).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import sympy
from flint import arb, arb_mat

from hamsym.codegen.functions import compile_straight_line
from hamsym.errors import CertificationError
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.surface import Surface, parse_surface
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import above, below, float_balls, matrix_of, vector_of, working
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions, evaluated, require_smooth
from hamsym.proof.windows.enclose import Enclosure, enclosed
from hamsym.proof.windows.public_windows import check_enclosure
from hamsym.support.record_fields import Limit, Size, counts
from hamsym.support.shown import Shown
from hamsym.symbolic.variables import TIME

if TYPE_CHECKING:
    from hamsym.dynamics.sections import Section

_BITS = 128
# Shortest part of a span that is divided, relative to the span.
_SHORTEST = 2.0**-36
# Trials of a set Z over a part, each wider than the last.
_TRIALS = 3
# Distance of crossings from the proven ones, of a step and of the largest size of a component.
_NEAR = 0.01
# Steps of Newton's method, which end when one no longer halves the time.
_NEWTON = 12

_Vector = list[arb]


@dataclass(frozen=True, eq=False)
class SectionCertificate(Shown):
    """Proven crossings of a surface, in the order of the :class:`Section` that has them.

    Between the balls of the times there is no other crossing in the span, or none in the asked
    direction: all are transversal.

    Attributes
    ----------
    statement : str
        What is proven, as a sentence.
    starts : Ball
        Of the starts, shape (trajectories, dim).
    direction, limit : float, int or None
        The arguments ``direction`` and ``crossings`` of :func:`section`.
    t : Ball
        Times, shape (n,).
    z : Ball
        States, shape (n, dim), for all starts in the balls that were given.
    derivative : Ball
        Derivatives of the states at the crossings by the start, shape (n, dim, dim): those of the
        Poincare map, which moves along the surface.
    rising : numpy.ndarray
        Whether the left side of the surface rises through it, 1 or 0, shape (n,).
    seconds : float
        Run time.
    """

    statement: str
    starts: Ball
    direction: float
    limit: Annotated[int, Limit(1)] | None
    t: Ball
    z: Ball
    derivative: Ball
    rising: Annotated[np.ndarray, counts("crossings")] = field(repr=False)
    seconds: Size

    def check(self) -> None:
        """Raise ValueError unless all parts have the same number of crossings."""
        count, dim = len(self.rising), np.shape(self.z.mid)[-1]
        shapes = [np.shape(part.mid) for part in (self.t, self.z, self.derivative)]
        if shapes != [(count,), (count, dim), (count, dim, dim)] or not (self.rising <= 1).all():
            raise ValueError("its parts have different numbers of crossings")

    def __repr__(self) -> str:
        return f"SectionCertificate({self.statement!r})"

    def verify(self, section: Section) -> None:
        """Prove a section again, and require that the crossings lie in these balls.

        Raises
        ------
        CertificationError
            If a claim is not proven.
        """
        if self.starts.mid.tolist() != section.z0.tolist():
            raise CertificationError("the certificate has other starts than the section")
        again = prove_section(section, self.starts, self.direction, self.limit)
        if again.statement != self.statement or again.rising.tolist() != self.rising.tolist():
            raise CertificationError(f"'{self.statement}' is not proven: {again.statement}")
        for name in ("t", "z", "derivative"):
            if not _inside(getattr(again, name), getattr(self, name)):
                raise CertificationError(f"the balls of {name} are narrower than the proof gives")


def _inside(inner: Ball, outer: Ball) -> bool:
    """Whether balls lie in others, entry by entry."""
    if np.shape(inner.mid) != np.shape(outer.mid):
        return False
    pairs = zip(_flat(inner), _flat(outer), strict=True)
    with working(_BITS):
        return all(bool(b.contains(a)) for a, b in pairs)


def prove_section(
    section: Section, starts: Ball, direction: float, limit: int | None
) -> SectionCertificate:
    """Prove that the crossings of a section are all, and enclose them.

    Raise CertificationError if there is no proof, with the reason, or the crossings are not those
    of the section.

    - starts: Shape (trajectories, dim).
    - direction, limit: As the arguments ``direction`` and ``crossings`` of :func:`section`.
    """
    began = time.monotonic()
    if not section.success:
        raise CertificationError(f"the section did not succeed: {section.message}")
    found: list[_Crossing] = []
    for number, start in enumerate(zip(starts.mid, starts.radius, strict=True)):
        values = {name: float(column[number]) for name, column in section.parameters.items()}
        H = section.H.with_parameters(**values) if values else section.H
        mine = np.flatnonzero(section.trajectory == number)
        span = _span_of(section, section.t[mine], limit)
        own = _crossings(H, section.surface, Ball(*start), span, direction)[:limit]
        _require_same(section, H, mine, own, number)
        found += own
    dim = section.H.dim
    return SectionCertificate(
        _statement(section, starts, len(found), direction, limit),
        starts,
        float(direction),
        limit,
        _stacked([crossing.t for crossing in found], ()),
        _stacked([crossing.z for crossing in found], (dim,)),
        _stacked([crossing.derivative for crossing in found], (dim, dim)),
        np.array([int(crossing.rising) for crossing in found], dtype=np.int64),
        time.monotonic() - began,
    )


def _statement(
    section: Section, starts: Ball, count: int, direction: float, limit: int | None
) -> str:
    low, high = map(float, section.span)
    many = len(starts.mid) > 1
    all_found = limit is not None and count == limit * len(starts.mid)
    until = "" if all_found else f" for t from {low!r} to {high!r}"
    who = "every start in the ball" if starts.radius.any() else "the start" + "s" * many
    times = "once" if count == 1 else f"{count:,} times"
    first = "first " if limit is not None else ""
    how = "transversally" if count else "that is, never"
    if direction:
        how = ("rising, " if direction > 0 else "falling, ") + how
    return (
        f"the exact solution{'s' * many} of {who} {first}cross{'' if many else 'es'} "
        f"{section.surface} {times} after the start{until}, {how}, at times and states in the balls"
    )


def _span_of(section: Section, times: np.ndarray, limit: int | None) -> tuple[float, float]:
    """The span of the proof: it ends a step after the last crossing if the limit is reached."""
    begin, end = section.span
    if limit and len(times) == limit:
        last = float(times[-1]) + section.dt
        end = min(end, last) if end > begin else max(end, last)
    return begin, end


def _require_same(
    section: Section, H: Hamiltonian, rows: np.ndarray, proven: Sequence[_Crossing], number: int
) -> None:
    if len(rows) != len(proven):
        raise CertificationError(
            f"trajectory {number} has {len(proven)} crossings by the proof and {len(rows)} in the "
            "section: one is within round-off of an end of the span, or the steps are too large"
        )
    begin, end = section.span
    room = _NEAR * min(abs(section.dt), abs(end - begin))
    sizes = np.abs(section.z).max(axis=0, initial=0.0)
    for row, crossing in zip(rows, proven, strict=True):
        apart = abs(float(crossing.t.mid()) - float(section.t[row]))
        middle, radius = (np.array(part) for part in float_balls(crossing.z))
        moves = np.abs(H.compile("numpy").at("vector_field", middle, float(crossing.t.mid())))
        near = np.abs(section.z[row] - middle) <= radius + _NEAR * sizes + room * moves
        if not (apart <= room + float(crossing.t.rad()) and near.all()):
            raise CertificationError(
                f"the section has a crossing at t = {float(section.t[row])!r}, at z = "
                f"{section.z[row].tolist()}, the proof at {float(crossing.t.mid())!r}, at "
                f"{middle.tolist()}; give smaller steps"
            )


# -- crossings of one start ------------------------------------------------------------------------


@dataclass(frozen=True)
class _Crossing:
    """A crossing: ``derivative`` is DP, ``slope`` the derivative of the time by the start."""

    t: arb
    z: _Vector
    derivative: list[_Vector]
    slope: _Vector
    rising: bool


def _crossings(
    H: Hamiltonian, surface: str, start: Ball, span: tuple[float, float], direction: float
) -> list[_Crossing]:
    """All crossings in a span that satisfy the conditions, in the direction of time."""
    where = parse_surface(H, surface)
    found = _Path(H, where, start, span).crossings()
    if np.any(start.radius):
        middle = Ball(start.mid, np.zeros_like(start.radius))
        thin = _Path(H, where, middle, span).crossings()
        if len(thin) != len(found):
            raise CertificationError("the crossings of the ball and of its middle do not match")
        spread = [arb(0, r) for r in start.radius.tolist()]
        found = [_narrowed(*pair, spread) for pair in zip(found, thin, strict=True)]
    with working(_BITS):
        formulas = _Formulas(H, where)
        chosen = [one for one in found if not direction or one.rising == (direction > 0)]
        return [one for one in chosen if formulas.holds(one.z, one.t)]


def _narrowed(whole: _Crossing, thin: _Crossing, spread: _Vector) -> _Crossing:
    """A crossing of a ball of starts, from that of its middle by the mean value theorem."""
    with working(_BITS):
        t = (thin.t + _dot(whole.slope, spread)).intersection(whole.t)
        moved = [a + _dot(row, spread) for a, row in zip(thin.z, whole.derivative, strict=True)]
        z = [a.intersection(b) for a, b in zip(moved, whole.z, strict=True)]
    return _Crossing(t, z, whole.derivative, whole.slope, whole.rising)


class _Formulas:
    """The surface, its rate along the flow, the flow and its slopes, at balls."""

    def __init__(self, H: Hamiltonian, where: Surface) -> None:
        own = H.real_equations
        self._where = where
        surface, *conditions = (
            each.function.xreplace(own.fractions) for each in (where.value, *where.conditions)
        )
        for formula in (surface, *conditions):
            require_smooth(formula, "the surface contains")
        symbols = [*own.z, sympy.Symbol(TIME, real=True)]
        slopes = [sympy.diff(surface, symbol) for symbol in symbols]
        self._surface = compile_straight_line([surface, *slopes], symbols)
        self._conditions = compile_straight_line(conditions, symbols) if conditions else None
        self._functions = GeneratedFunctions(H, BALLS)

    def rates(self, z: _Vector, t: arb) -> _Vector:
        """F(z, t)."""
        return [arb(rate) for rate in self._functions("vector_field", z, t)]

    def slopes(self, z: _Vector, t: arb) -> arb_mat:
        """DF(z, t)."""
        found = arb_mat(len(z), len(z))
        for place, entry in self._functions("jacobian", z, t).items():
            found[place] = entry
        return found

    def surface(self, z: _Vector, t: arb) -> tuple[arb, arb, _Vector]:
        """g, g_t and grad g."""
        value, *slopes = map(arb, evaluated(self._surface, BALLS, *z, t))
        return value, slopes[-1], slopes[:-1]

    def holds(self, z: _Vector, t: arb) -> bool:
        """Whether the conditions hold at a crossing, for all numbers in the balls."""
        if self._conditions is None:
            return True
        values = list(map(arb, evaluated(self._conditions, BALLS, *z, t)))
        if any(value <= 0 for value in values):
            return False
        if all(value > 0 for value in values):
            return True
        raise CertificationError(
            f"whether the crossing at t = {float(t.mid()):.6g} satisfies {self._where.text} is "
            "not decided by the balls"
        )


@dataclass(frozen=True)
class _Part:
    """States and the surface over times: ``value`` is g, ``rate`` is dg/dt."""

    middle: float
    time: arb
    elapsed: arb
    before: _Vector
    z: _Vector
    flow: _Vector
    at_middle: arb
    value: arb
    rate: arb
    normal: _Vector


class _Path:
    """The enclosed solutions from a ball of starts, and the surface along them."""

    def __init__(
        self, H: Hamiltonian, where: Surface, start: Ball, span: tuple[float, float]
    ) -> None:
        balls = [Ball(m, r) for m, r in zip(start.mid.tolist(), start.radius.tolist(), strict=True)]
        self._enclosure: Enclosure = enclosed(H, balls, span, None, None)
        check_enclosure(self._enclosure)
        self._span, self._text = span, where.text
        with working(_BITS):
            self._formulas = _Formulas(H, where)
            # From the exact start, which may lie on the surface.
            self._at_start = self._formulas.surface(vector_of(start), arb(span[0]))[0]

    def crossings(self) -> list[_Crossing]:
        """All crossings, in the direction of time."""
        with working(_BITS):
            found = [
                self._crossing(low, high, sign)
                for low, high, sign in self._stretches()
                if self._sign(low) != self._sign(high)
            ]
        return found if self._span[1] > self._span[0] else found[::-1]

    def _sign(self, t: float) -> int:
        """The sign of g at an end of a stretch; 0 at a start on the surface."""
        value = self._at_start if t == self._span[0] else self._value(t)
        if value > 0 or value < 0:
            return 1 if value > 0 else -1
        if t == self._span[0]:
            if value == 0:
                return 0
            raise CertificationError(
                f"the ball of the start meets {self._text}; give a start on it or beside it"
            )
        raise CertificationError(
            f"{self._text} may be crossed at t = {t!r}; choose another end of the span"
        )

    def _value(self, t: float) -> arb:
        return self._formulas.surface(vector_of(self._enclosure(t)), arb(t))[0]

    def _edges(self) -> list[float]:
        """The ends of the windows of the enclosure, ascending."""
        begin, end = self._span
        sign = 1 if end > begin else -1
        inner = [begin + sign * float(window.end) for window in self._enclosure.windows[:-1]]
        return sorted({begin, *inner, end})

    def _stretches(self) -> list[tuple[float, float, int]]:
        """Times between which g is monotone, with the sign of its rate, and has a zero at most."""
        found: list[tuple[float, float, int]] = []
        for low, high, sign in self._decided():
            if sign and found and found[-1][1:] == (low, sign):
                found[-1] = (found[-1][0], high, sign)
            elif sign:
                found.append((low, high, sign))
        # A start on the surface is not a crossing, and g is monotone after it.
        on_surface = bool(self._at_start == 0)
        return [one for one in found if not (on_surface and self._span[0] in one[:2])]

    def _decided(self) -> Iterator[tuple[float, float, int]]:
        """Parts of the span: with 0 where g has no zero, else with the sign of its rate."""
        waiting = list(pairwise(self._edges()))[::-1]
        shortest = _SHORTEST * abs(self._span[1] - self._span[0])
        while waiting:
            low, high = waiting.pop()
            part = self._part(low, high)
            if part is not None and not part.value.contains(0):
                yield low, high, 0
            elif part is not None and not part.rate.contains(0):
                yield low, high, 1 if part.rate > 0 else -1
            elif high - low > shortest:
                middle = low + (high - low) / 2
                waiting += [(middle, high), (low, middle)]
            else:
                raise CertificationError(
                    f"{self._text} may be touched, or crossed along it, near t = {low:.6g}"
                )

    def _part(self, low: float, high: float) -> _Part | None:
        """The solutions over times; None if they are not enclosed at once."""
        middle = low + (high - low) / 2
        time = arb(low).union(arb(high))
        elapsed = time - arb(middle)
        before = vector_of(self._enclosure(middle))
        try:
            around = before
            for _ in range(_TRIALS):
                moved = [2 * elapsed * rate for rate in self._formulas.rates(around, time)]
                around = [a + b + arb(0, 1e-300) for a, b in zip(before, moved, strict=True)]
                flow = self._formulas.rates(around, time)
                z = [a + elapsed * rate for a, rate in zip(before, flow, strict=True)]
                if all(a.contains_interior(b) for a, b in zip(around, z, strict=True)):
                    break
            else:
                return None
            flow = self._formulas.rates(z, time)
            value, later, normal = self._formulas.surface(z, time)
            at_middle = self._formulas.surface(before, arb(middle))[0]
        except SingularityError:
            return None
        rate = _dot(normal, flow) + later
        by_rate = at_middle + elapsed * rate
        if not (value.is_finite() and by_rate.is_finite()):
            return None
        value = value if by_rate.rad() > value.rad() else by_rate
        return _Part(middle, time, elapsed, before, z, flow, at_middle, value, rate, normal)

    def _crossing(self, low: float, high: float, sign: int) -> _Crossing:
        """The one crossing between two times."""
        part = self._crossed(low, high, sign)
        for _ in range(_NEWTON):
            newton = arb(part.middle) - part.at_middle / part.rate
            both = newton.intersection(part.time)
            ends = max(low, below(both)), min(high, above(both))
            if not ends[1] - ends[0] <= (high - low) / 2:
                break
            low, high = ends
            narrower = self._part(low, high)
            if narrower is None:
                break
            part = narrower
        derivative = self._derivative(part)
        slope = arb_mat([part.normal]) * derivative / -part.rate
        projected = derivative + arb_mat([[rate] for rate in part.flow]) * slope
        rising = (sign > 0) == (self._span[1] > self._span[0])
        return _Crossing(part.time, part.z, projected.tolist(), slope.entries(), rising)

    def _crossed(self, low: float, high: float, sign: int) -> _Part:
        """A part of a stretch with the crossing, over which the rate has no zero."""
        while True:
            part = self._part(low, high)
            if part is not None and not part.rate.contains(0):
                return part
            begin, end = low, high
            for share in (0.25, 0.5, 0.75):
                t = begin + share * (end - begin)
                value = sign * self._value(t)
                if value < 0:
                    low = t
                elif value > 0:
                    high = t
                    break
            if (low, high) == (begin, end):
                raise CertificationError(
                    f"the ball of starts crosses {self._text} over too long a time near "
                    f"t = {begin:.6g}; give a narrower one"
                )

    def _derivative(self, part: _Part) -> arb_mat:
        """dz/dz0 over the times of a part: M in M(m) + [-d, d] DF(Z) M."""
        before = arb_mat(matrix_of(self._enclosure.derivative(part.middle)))
        moves = self._formulas.slopes(part.z, part.time) * part.elapsed
        tiny = arb_mat(len(part.z), len(part.z), [arb(0, 1e-300)] * len(part.z) ** 2)
        around = before
        for _ in range(_TRIALS):
            around = before + moves * around * 2 + tiny
            found = before + moves * around
            pairs = zip(around.entries(), found.entries(), strict=True)
            if all(a.contains_interior(b) for a, b in pairs):
                return found
        raise CertificationError(
            f"the derivatives near t = {part.middle:.6g} are not enclosed; give narrower balls"
        )


def _dot(row: Sequence[arb], column: Sequence[arb]) -> arb:
    return sum((a * b for a, b in zip(row, column, strict=True)), arb(0))


def _flat(ball: Ball) -> _Vector:
    return vector_of(Ball(np.ravel(ball.mid), np.ravel(ball.radius)))


def _stacked(entries: Sequence[Any], shape: tuple[int, ...]) -> Ball:
    """Balls of float64 around nested lists of balls, shape (n, *shape)."""
    flat: list[arb] = np.array(entries, dtype=object).ravel().tolist()
    with working(_BITS):
        middle, radius = float_balls(flat)
    form = (len(entries), *shape)
    return Ball(np.array(middle, dtype=float).reshape(form), np.array(radius).reshape(form))
