"""The exact solution of the equations of motion near polynomials, by one lemma.

On a step t = m + r x, -1 <= x <= 1, and z is the solution of dz/dx = r f(t, z). Let y be any
polynomial with D = dy/dx - r f(t, y), and V, W any polynomial matrices, about the derivative of the
flow and its inverse. For e = z - y, as long as |e_i| < T_i,

    de/dx = A e - D,    with A(x) an average of r Df(t, y + c) over |c_i| <= T_i,

because f(y + e) - f(y) is such an average, times e. With matrices P, Q of numbers and u = P W e,

    du/dx = P ((dW/dx + W A) e - W D),
    e = V (Q u + (1 - Q P) W e) + (1 - V W) e.

So |u| <= U + 2 |P| (sup|dW/dx + W A| T + sup|W| sup|D|) where U bounds |u| at the start, and

    |e| <= sup|V| (|Q| |u| + |1 - Q P| sup|W| T) + sup|1 - V W| T,

in every component. If the right-hand side is below T, then |e| < T never ends within the step, and
the solution exists there. P, about the inverse of the derivative by the initial state, makes u
nearly constant over all steps, so that errors are added and never wrapped.

The difference of two solutions within the tube has the same equation without D, times their
difference at the start. So for all starts within radii of one of them, the bounds are found column
by column, one of e and one for each component of the start, where u begins as a unit vector. For
differences from one solution, A is the average over n parts of the way, where they are at most k/n
of the whole difference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeVar

from flint import arb, arb_mat

from hamsym.proof.checker import guesses
from hamsym.proof.checker.formulas import NotProvenError, ball
from hamsym.proof.checker.functions import (
    UNIT,
    Equations,
    Expansion,
    Interval,
    Polynomial,
    coefficients,
    column,
    end_of,
    expanded,
    identity,
    matrices,
    sizes,
    total,
)
from hamsym.proof.checker.guesses import Effort, Guess

_TINY = arb(2) ** -2_000
_TUBES = 4  # attempts at a tube
_NEAR = arb(1) / 64  # see proven

Found = TypeVar("Found")


@dataclass(frozen=True)
class Step:
    """A step on which |z_i - y_i(x)| <= tube_i, and what is known at its end.

    - radii: Of the starts around z0.
    - widths: Bounds on e, and on differences of solutions for one of the starts in each component.
    - U: Bounds on u, and on its change for these differences.
    - F, S: About the derivative by the initial state, and its inverse.
    """

    part: Interval
    y: list[Polynomial]
    radii: Sequence[arb]
    widths: arb_mat
    U: arb_mat
    S: arb_mat
    F: arb_mat
    PW: arb_mat

    @classmethod
    def at(cls, z0: Sequence[arb], radii: Sequence[arb] = ()) -> Step:
        """Before the first step, at exact numbers; by default with no starts around them."""
        one, zero = identity(len(z0)), [arb(0)] * len(z0)
        start, widths = Interval(Fraction(0), Fraction(1)), _beside(zero, one)
        y = [Polynomial([z]) for z in z0]
        return cls(start, y, radii or zero, widths, 0 * widths, one, one, one)

    @property
    def tube(self) -> list[arb]:
        found = self.widths * column([arb(1), *self.radii])
        return [value.abs_upper() for value in found.entries()]

    def states(self, x: arb, radii: Sequence[arb]) -> list[arb]:
        """The solutions from all starts within radii."""
        tube = self.widths * column([arb(1), *radii])
        return [each(x) + T * UNIT for each, T in zip(self.y, tube.entries(), strict=True)]

    def derivative(self) -> arb_mat:
        """All derivatives of the end by the start, and averages of them."""
        changes = arb_mat([row[1:] for row in self.U.tolist()]) * UNIT
        try:
            return self.PW.inv() * (identity(len(self.y)) + changes)
        except ZeroDivisionError:
            raise NotProvenError("the derivative of the flow is not bounded") from None


def _distance(X: list[arb_mat], Y: list[arb_mat], Z: list[arb_mat]) -> arb_mat:
    """A bound on |X Y - Z|, for polynomials X, Y of one degree and Z of a smaller one."""
    n, parts = len(X) - 1, []
    for k in range(n):
        product = total([X[i] * Y[k - i] for i in range(k + 1)])
        parts.append(sizes(product - Z[k] if k < len(Z) else product))
    tails = [sizes(Y[n])]  # of Y from degree n on, n - 1 on, ...
    for part in reversed(Y[:n]):
        tails.append(tails[-1] + sizes(part))
    return total([*parts, *(sizes(x) * tails[i] for i, x in enumerate(X))])


def _beside(left: Sequence[arb], columns: arb_mat) -> arb_mat:
    return arb_mat([[a, *b] for a, b in zip(left, columns.tolist(), strict=True)])


def steps(
    equations: Equations,
    z0: Sequence[float | arb],
    span: Sequence[float | Fraction],
    effort: Effort,
    check_time: Callable[[], None],
    radii: Sequence[arb] = (),
) -> Iterator[Step]:
    """The steps of a proof from z0, exact numbers, over a span.

    - radii: Of the starts around z0 for which the steps hold too; by default none.
    """
    step = Step.at([arb(value) for value in z0], radii)
    scales = [abs(each(arb(0))) for each in step.y]

    def attempt(part: Interval) -> tuple[Step, float]:
        nonlocal step
        z, line = [each(arb(1)) for each in step.y], step.part.line(part)
        near = [each.real(line) for each in step.y]
        guess = guesses.guess(equations, z, near, part, effort, scales)
        y = guess.y
        rates = expanded(
            lambda x: equations.run_rates([*(each(x) for each in y), part.time(x)]), effort.order
        )
        D = [_defect(each, part.r, f) for each, f in zip(y, rates, strict=True)]
        gap = [a - each(arb(-1)) for a, each in zip(z, y, strict=True)]
        step = proven(equations, step, guess, D, gap, effort.ways)
        return step, guess.factor

    length = Fraction(span[1]) - Fraction(span[0])
    yield from march(span, length / 64, effort.shortest, attempt, check_time)


def march(
    span: Sequence[float | Fraction],
    r: Fraction,
    shortest: Fraction,
    attempt: Callable[[Interval], tuple[Found, float]],
    check_time: Callable[[], None],
) -> Iterator[Found]:
    """What is found on steps that cover a span.

    - r: Half of the first step.
    - shortest: Step, of the span.
    - attempt: A step -> what is found there, and by how much the next one may be longer.
    """
    time, end = (Fraction(value) for value in span)
    length, longest = end - time, 1.5
    while time != end:
        check_time()
        rest = (end - time) / 2
        r = rest if abs(r) >= abs(rest) else min(r, rest / 2, key=abs)
        try:
            found, factor = attempt(Interval(time + r, r))
        except NotProvenError as error:
            if not abs(r) > abs(length) * shortest:
                raise NotProvenError(f"no proof beyond t = {float(time)}: {error}") from None
            r, longest = r * 3 / 4, 1.0  # of the next steps, where this one is too long
        else:
            yield found
            time, r, longest = time + 2 * r, Fraction(float(r) * min(factor, longest)), 1.5


def _defect(y: Polynomial, r: Fraction, f: Expansion) -> arb:
    """A bound on |y' - r f|."""
    slopes = coefficients(y.real.derivative(), len(f.first))
    gaps = [abs(a - ball(r) * b) for a, b in zip(slopes, f.first, strict=True)]
    return sum(gaps, abs(ball(r)) * f.rest()).abs_upper()


def proven(
    equations: Equations,
    before: Step,
    guess: Guess,
    D: Sequence[arb],
    gap: Sequence[arb],
    ways: int = 1,
) -> Step:
    """Prove a step by the lemma of the module's docstring.

    - guess: Its y may have balls as coefficients: the step then holds for each y in them that has
      these bounds.
    - D, gap: Bounds on the defect of y, and on what y(-1) differs from the end of the step before.
    - ways: If more than one, A is the average over so many parts of the way from one solution,
      whose start is within 1/64 of the radii, to another one within 63/64 of them from it. Where
      the derivative of the flow is meant it is 1.
    """
    part, y, V, W, one = guess.part, guess.y, guess.V, guess.W, identity(equations.dim)

    def around(x: Any) -> list[Any]:
        found, middle = [], [each(x) for each in y]
        for n in range(1, ways + 1):
            share = arb(1) if n == ways else arb(n) / ways + _NEAR
            T = tube * column([arb(1), *(radius * share for radius in before.radii)])
            near = [a + t * UNIT for a, t in zip(middle, T.entries(), strict=True)]
            found.append(equations.run_slopes([*near, part.time(x)]))
        if ways == 1:
            return found[0]
        return [sum(each, arb(0)) / ways for each in zip(*found, strict=True)]

    added, units = _beside(D, 0 * one), _beside([arb(0)] * equations.dim, one)
    slope = [-(each * arb(k)) for k, each in enumerate(W)][1:]  # of -W
    P, Q = (before.S * end_of(V, -1)).mid(), (end_of(W, -1) * before.F).mid()
    start = P * end_of(W, -1)
    U = before.U + sizes(start - before.PW) * before.widths
    U += _beside((sizes(start) * sizes(column(gap))).entries(), 0 * one)
    P_size, Q_size, two = sizes(P), sizes(Q), arb(2)
    V_size, W_size = total([sizes(v) for v in V]), total([sizes(w) for w in W])
    inverse, rest = sizes(one - Q * P), _distance(V, W, [one])
    found = V_size * (Q_size * (U + units + P_size * (W_size * added) * two))
    for _ in range(_TUBES):
        wider = [arb(3) / 2 * value.abs_upper() + _TINY for value in found.entries()]
        tube = arb_mat(equations.dim, 1 + equations.dim, wider)
        rows = [[*e.first, e.rest()] for e in expanded(around, len(V) - 1)]
        E = _distance(W, matrices(equations, rows, part.r), slope)
        u = U + P_size * (E * tube + W_size * added) * two
        found = V_size * (Q_size * (u + units) + inverse * (W_size * tube)) + rest * tube
        if all(a < b for a, b in zip(found.entries(), tube.entries(), strict=True)):
            PW, F = P * end_of(W, 1), (end_of(V, 1) * Q).mid()
            return Step(part, y, before.radii, sizes(found), sizes(u), PW.mid(), F, PW)
    raise NotProvenError("the bound on the distance of the solution does not close")
