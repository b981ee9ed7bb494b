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

A function of x is bounded by its first n Taylor coefficients at x = 0 and Cauchy's inequality for
the others, |c_k| <= M / R^k, where it is analytic and at most M for all complex |x| <= R: the disc
is covered by squares.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import acb, acb_poly, arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.proof.checker.formulas import Formulas, NotProvenError, ball

UNIT = arb(0, 1)  # all numbers up to 1 in size
_COARSE = 53  # bits of values on discs
_RADII, _DIVISIONS = (6, 5), 4  # of discs that are tried, and squares on a radius
_SHORT = 14  # degree of V and W
_SHORTEST = Fraction(1, 2**40)  # step, of the span
_TINY = arb(2) ** -2_000
_TUBES, _NEWTON = 4, 12  # attempts at a tube, and corrections of y
_ROUGH, _CLOSE = 2.0**-30, 2.0**30  # correction that changes V and W; the last one, in accuracies


class Equations:
    """Hamilton's equations with forces, their derivatives, and H, from text.

    - H: "formula" and "forces" as {"formula", "floats"}, "q", "p" and "parameters".
    - free: Names of parameters without a value, variables after the time.
    """

    def __init__(self, H: Mapping[str, Any], free: Sequence[str] = ()) -> None:
        self.names = [*H["q"], *H["p"]]
        self.dim, dof = len(self.names), len(self.names) // 2
        forces = [H["forces"].get(name) for name in H["p"]]
        given = {name: Fraction(value) for name, value in H["parameters"].items()}
        time = "" if "t" in {*self.names, *given, *free} else "t"
        formulas = self.formulas = Formulas([*self.names, time, *free], given)
        energy = formulas.parse(H["formula"]["formula"], numbers=exact_numbers(H["formula"]))
        *self.slopes, by_time = formulas.gradient(energy, self.dim + 1)
        self.rates = self.slopes[dof:]
        for slope, force in zip(self.slopes[:dof], forces, strict=True):
            pull = formulas.number(0)
            if force:
                pull = formulas.parse(force["formula"], numbers=exact_numbers(force))
            self.rates.append(formulas.add(formulas.negative(slope), pull))
        #: Whether H is constant along every solution, as far as that is plain.
        self.conserved = not any(forces) and formulas.value(by_time) == 0
        rows = [formulas.gradient(rate, self.dim) for rate in self.rates]
        places = [(i, j, place) for i, row in enumerate(rows) for j, place in enumerate(row)]
        self.entries = [entry for entry in places if formulas.value(entry[2]) != 0]
        self.run_rates = formulas.program(self.rates)
        self.run_energy = formulas.program([energy])
        self.run_all = formulas.program([*(e[2] for e in self.entries), energy, *self.rates])

    def resting(self, zero: set[int]) -> set[int]:
        """Components that stay exactly zero, of those that are zero at the start."""
        at_zero, value = self.formulas.at_zero, self.formulas.value
        still = {i for i in zero if value(at_zero(self.rates[i], zero)) == 0}
        return zero if still == zero else self.resting(still)


def exact_numbers(formula: Mapping[str, Any]) -> dict[str, Fraction]:
    """The binary fractions of a formula, by the names that it has for them."""
    return {
        name: (-1) ** sign * int(digits) * Fraction(2) ** exponent
        for name, (sign, digits, exponent, _) in formula["floats"].items()
    }


# -- functions of x -------------------------------------------------------------------------------


class Polynomial:
    """A polynomial in x, for real and complex numbers, and for x itself as a series."""

    def __init__(self, series: Sequence[arb]) -> None:
        self.real = arb_poly(list(series))
        self._complex = acb_poly(self.real)

    def __call__(self, x: Any) -> Any:
        if isinstance(x, arb_series):
            return arb_series(self.real.coeffs(), x.prec)
        return self._complex(x) if isinstance(x, acb) else self.real(x)


@dataclass(frozen=True)
class Step:
    """A step on which |z_i - y_i(x)| <= tube_i, t = middle + r x."""

    middle: Fraction
    r: Fraction
    y: list[Polynomial]
    tube: list[arb]

    def line(self, middle: Fraction, r: Fraction) -> arb_poly:
        """x of this step in terms of that of another one."""
        return arb_poly([ball((middle - self.middle) / self.r), ball(r / self.r)])


@dataclass(frozen=True)
class Expansion:
    """A function of x, |x| <= 1: first Taylor coefficients, and |c_k| <= M / R^k for all."""

    first: list[arb]
    M: arb
    R: int

    def rest(self) -> arb:
        """A bound on the sum of all other terms."""
        return self.M / (arb(self.R) ** (len(self.first) - 1) * (self.R - 1))

    def rest_of_derivative(self) -> arb:
        n, q = len(self.first), 1 / arb(self.R)
        return self.M * q**n * (n - (n - 1) * q) / (1 - q) ** 2


def expanded(at: Callable[[Any], Sequence[Any]], order: int) -> list[Expansion]:
    """Expand functions of x.

    - at: x -> values of the functions, for x as a power series or as a ball of complex numbers.
    """
    found = series_of(at, order)
    for R in _RADII:
        with contextlib.suppress(NotProvenError):
            with ctx.workprec(_COARSE):
                values = [at(square) for square in _squares(R)]
            # A NaN is not larger than any number: all are looked at before the largest is taken.
            if all(value.is_finite() for each in values for value in each):
                bounds = [
                    max(abs(v).abs_upper() for v in each) for each in zip(*values, strict=True)
                ]
                return [Expansion(*pair, R) for pair in zip(found, bounds, strict=True)]
    raise NotProvenError("a function is not smooth there, or changes too fast")


def series_of(at: Callable[[Any], Sequence[Any]], order: int) -> list[list[arb]]:
    ctx.cap = order
    return [coefficients(value, order) for value in at(arb_series([0, 1], order))]


def coefficients(value: Any, count: int) -> list[arb]:
    """The first coefficients of a number, a polynomial or a series."""
    found = value.coeffs()[:count] if hasattr(value, "coeffs") else [arb(value)]
    return [*found, *[arb(0)] * (count - len(found))]


def _squares(R: int) -> Iterator[acb]:
    """Squares that cover half a disc, which is enough for functions that are real for real x."""
    for j in range(_DIVISIONS):
        for i in range(-_DIVISIONS, _DIVISIONS):
            if min(i * i, (i + 1) ** 2) + j * j < _DIVISIONS**2:
                yield acb(*(arb(R) / _DIVISIONS * (k + arb(0.5, 0.5)) for k in (i, j)))


def time_at(middle: Fraction, r: Fraction, x: Any) -> Any:
    return ball(middle) + ball(r) * x


# -- matrices -------------------------------------------------------------------------------------


def sizes(matrix: arb_mat) -> arb_mat:
    """Bounds on the entries of a matrix."""
    entries = [entry.abs_upper() for entry in matrix.entries()]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def column(values: Sequence[arb]) -> arb_mat:
    return arb_mat(len(values), 1, list(values))


def identity(dim: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(dim)] for i in range(dim)])


def _total(parts: Sequence[arb_mat]) -> arb_mat:
    return sum(parts[1:], parts[0])


def _matrices(equations: Equations, rows: list[list[arb]], r: Fraction) -> list[arb_mat]:
    """Coefficients of r Df from those of its entries."""
    n, found = equations.dim, []
    for k in range(len(rows[0])):
        entries = [arb(0)] * (n * n)
        for (i, j, _), row in zip(equations.entries, rows, strict=False):
            entries[i * n + j] = ball(r) * row[k]
        found.append(arb_mat(n, n, entries))
    return found


def _flow(A: list[arb_mat], inverse: bool) -> list[arb_mat]:
    """About the solution of V' = A V, or of W' = -W A, with the identity at x = 0."""
    found = [identity(A[0].nrows())]
    for k in range(_SHORT):
        pairs = zip(A[: k + 1], reversed(found), strict=True)
        products = [-(w * a) if inverse else a * w for a, w in pairs]
        found.append((_total(products) / arb(k + 1)).mid())
    return found


def _end(series: list[arb_mat], x: int) -> arb_mat:
    """The value of a matrix of polynomials at x = 1 or -1."""
    return _total([part if x > 0 or k % 2 == 0 else -part for k, part in enumerate(series)])


def _applied(series: list[arb_mat], parts: Sequence[arb_poly], count: int) -> list[arb_poly]:
    """The first coefficients of a matrix of polynomials times a column of them."""
    columns = list(enumerate(parts))
    return [
        sum((arb_poly([m[i, j] for m in series]) * p for j, p in columns), arb_poly())
        .truncate(count)
        for i in range(len(parts))
    ]  # fmt: skip


def _distance(X: list[arb_mat], Y: list[arb_mat], Z: list[arb_mat]) -> arb_mat:
    """A bound on |X Y - Z|, for polynomials X, Y of one degree and Z of a smaller one."""
    n, parts = len(X) - 1, []
    for k in range(n):
        product = _total([X[i] * Y[k - i] for i in range(k + 1)])
        parts.append(sizes(product - Z[k] if k < len(Z) else product))
    tails = [sizes(Y[n])]  # of Y from degree n on, n - 1 on, ...
    for part in reversed(Y[:n]):
        tails.append(tails[-1] + sizes(part))
    return _total([*parts, *(sizes(x) * tails[i] for i, x in enumerate(X))])


# -- steps ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _State:
    """What is known at the end of a step: balls of y(1), and the bounds."""

    z: list[arb]
    U: arb_mat
    S: arb_mat  # about the inverse of the derivative by the initial state, F
    F: arb_mat
    PW: arb_mat
    tube: arb_mat


def steps(
    equations: Equations,
    z0: Sequence[float],
    span: Sequence[float],
    order: int,
    accuracy: float,
    check_time: Callable[[], None],
) -> Iterator[Step]:
    """The steps of a proof from z0 over a span."""
    time, end = map(Fraction, span)
    zeros, one, total = arb_mat(equations.dim, 1), identity(equations.dim), end - time
    state = _State([arb(value) for value in z0], zeros, one, one, one, zeros)
    step, r = Step(time, total, [Polynomial([value]) for value in state.z], []), total / 64
    scales = [abs(value) for value in state.z]
    while time != end:
        check_time()
        rest = (end - time) / 2
        r = rest if abs(r) >= abs(rest) else min(r, rest / 2, key=abs)
        try:
            guess = _guess(equations, state.z, step, time + r, r, order, accuracy, scales)
            factor = _factor(guess.y, order, accuracy, scales)
            if not factor > 0.8:
                raise NotProvenError("the solution changes too fast")
            step, state = _proven(equations, state, time + r, r, guess, order)
        except NotProvenError as error:
            if not abs(r) > abs(total) * _SHORTEST:
                raise NotProvenError(f"no proof beyond t = {float(time)}: {error}") from None
            r = r * 3 / 4
        else:
            yield step
            time, r = time + 2 * r, Fraction(float(r) * factor)


@dataclass(frozen=True)
class _Guess:
    """About the solution, the derivative of the flow by the state at x = 0, and its inverse."""

    y: list[Polynomial]
    V: list[arb_mat]
    W: list[arb_mat]


def _factor(y: Sequence[Polynomial], order: int, accuracy: float, scales: Sequence[arb]) -> float:
    """By how much a step may be longer, from the last coefficients."""
    shares = [
        float((abs(c) / scale).mid())
        for part, scale in zip(y, scales, strict=True)
        for c in coefficients(part.real, order + 1)[-2:]
        if scale > 0
    ]
    return min((accuracy / max([*shares, accuracy * 1e-30])) ** (1 / order), 1.5)


def _guess(
    equations: Equations,
    z: Sequence[arb],
    before: Step,
    middle: Fraction,
    r: Fraction,
    order: int,
    accuracy: float,
    scales: list[arb],
) -> _Guess:
    """Newton's method from the polynomials of the step before."""
    line, change = before.line(middle, r), 1.0
    y = [Polynomial([c.mid() for c in part.real(line).coeffs()]) for part in before.y]

    def near(x: Any) -> list[Any]:
        return [*(part(x) for part in y), time_at(middle, r, x)]

    for _ in range(_NEWTON):
        if change > _ROUGH:
            rows = series_of(lambda x: equations.run_all(near(x)), _SHORT)
            A = _matrices(equations, rows, r)
            W, V = _flow(A, True), _flow(A, False)
        rates = series_of(lambda x: equations.run_rates(near(x)), order)
        defects = [
            arb_poly(rate) * ball(r) - part.real.derivative()
            for part, rate in zip(y, rates, strict=True)
        ]
        moved = [part.integral() for part in _applied(W, defects, order)]
        start = _end(W, -1) * column([a - part(arb(-1)) for a, part in zip(z, y, strict=True)])
        moved = [part + (start[i, 0] - part(arb(-1))) for i, part in enumerate(moved)]
        change = 0.0
        for i, part in enumerate(_applied(V, moved, order + 1)):
            whole = [c.mid() for c in (y[i].real + part).coeffs()]
            size, moves = (sum(map(abs, row), arb(0)).mid() for row in (whole, part.coeffs()))
            if not size.is_finite():
                raise NotProvenError("no polynomial near the solution was found")
            scales[i] = max(scales[i], abs(z[i]).mid())
            change = max(change, float(moves / size) if size > 0 else 0.0)
            y[i] = Polynomial(whole)
        if change < accuracy * _CLOSE:
            return _Guess(y, V, W)
    raise NotProvenError("no polynomial near the solution was found")


def _defect(y: Polynomial, r: Fraction, f: Expansion) -> arb:
    """A bound on |y' - r f|."""
    slopes = coefficients(y.real.derivative(), len(f.first))
    gaps = [abs(a - ball(r) * b) for a, b in zip(slopes, f.first, strict=True)]
    return sum(gaps, abs(ball(r)) * f.rest()).abs_upper()


def _proven(
    equations: Equations, before: _State, middle: Fraction, r: Fraction, guess: _Guess, order: int
) -> tuple[Step, _State]:
    """Prove a step by the lemma of the module's docstring."""
    y, V, W, one = guess.y, guess.V, guess.W, identity(equations.dim)

    def rates(x: Any) -> list[Any]:
        return equations.run_rates([*(part(x) for part in y), time_at(middle, r, x)])

    def around(x: Any) -> list[Any]:
        near = [part(x) + T * UNIT for part, T in zip(y, tube.entries(), strict=True)]
        return equations.run_all([*near, time_at(middle, r, x)])

    D = column([_defect(part, r, f) for part, f in zip(y, expanded(rates, order), strict=True)])
    slope = [-(part * arb(k)) for k, part in enumerate(W)][1:]  # of -W
    P, Q = (before.S * _end(V, -1)).mid(), (_end(W, -1) * before.F).mid()
    start = P * _end(W, -1)
    gap = column([a - part(arb(-1)) for a, part in zip(before.z, y, strict=True)])
    U = before.U + sizes(start - before.PW) * before.tube + sizes(start) * sizes(gap)
    P_size, Q_size, two = sizes(P), sizes(Q), arb(2)
    V_size, W_size = _total([sizes(v) for v in V]), _total([sizes(w) for w in W])
    inverse, rest = sizes(one - Q * P), _distance(V, W, [one])
    found = V_size * (Q_size * (U + P_size * (W_size * D) * two))
    for _ in range(_TUBES):
        tube = column([arb(3) / 2 * value.abs_upper() + _TINY for value in found.entries()])
        rows = [[*e.first, e.rest()] for e in expanded(around, _SHORT)]
        E = _distance(W, _matrices(equations, rows, r), slope)
        u = U + P_size * (E * tube + W_size * D) * two
        found = V_size * (Q_size * u + inverse * (W_size * tube)) + rest * tube
        if all(a < b for a, b in zip(found.entries(), tube.entries(), strict=True)):
            step = Step(middle, r, y, [value.abs_upper() for value in found.entries()])
            z, PW = [part(arb(1)) for part in y], P * _end(W, 1)
            F = (_end(V, 1) * Q).mid()
            return step, _State(z, sizes(u), PW.mid(), F, PW, sizes(found))
    raise NotProvenError("the bound on the distance of the solution does not close")
