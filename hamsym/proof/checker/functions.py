"""Equations of motion, functions of x on -1 <= x <= 1, and matrices of balls.

A function g of x is known by its first n Taylor coefficients at x = 0 and Cauchy's inequality for
the others, |c_k| <= M / R^k, where it is analytic and at most M for all complex |x| <= R: the disc
is covered by squares.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

from flint import acb, acb_poly, arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.proof.checker.formulas import Formulas, NotProvenError, ball

UNIT = arb(0, 1)  # all numbers up to 1 in size
COARSE = 53  # bits of values on discs
_DISCS, _DIVISIONS = (6, 5), 4  # of discs that are tried, and squares on a radius


class Equations:
    """Hamilton's equations with forces, dz/dt = f(t, z), their derivatives, and H, from text.

    Parameters without a value are components at rest behind q and p. So is the unit of time s, the
    last one: then dz/dx = s f.

    - H: "formula" and "forces" as {"formula", "floats"}, "q", "p" and "parameters".
    - free: Names of parameters without a value.
    - timed: Whether s is a component.
    """

    def __init__(
        self, H: Mapping[str, Any], free: Sequence[str] = (), *, timed: bool = False
    ) -> None:
        self.names = [*H["q"], *H["p"]]
        dof, forces = len(H["q"]), [H["forces"].get(name) for name in H["p"]]
        given = {name: Fraction(value) for name, value in H["parameters"].items()}
        # A name with spaces is in no formula.
        states = [*self.names, *free, *["unit of time"] * timed]
        time = "the time" if "t" in {*states, *given} else "t"
        self.dim = len(states)
        formulas = self.formulas = Formulas([*states, time], given)
        self.energy = formulas.read(H["formula"])
        *self.slopes, by_time = formulas.gradient(self.energy, self.dim + 1)
        self.rates = self.slopes[dof : 2 * dof]
        for slope, force in zip(self.slopes[:dof], forces, strict=True):
            pull = formulas.read(force) if force else formulas.number(0)
            self.rates.append(formulas.add(formulas.negative(slope), pull))
        if timed:
            unit = formulas.variable(self.dim - 1)
            self.rates = [formulas.multiply(unit, rate) for rate in self.rates]
        self.rates += [formulas.number(0)] * (self.dim - len(self.rates))
        #: Whether H is constant along every solution, as far as that is plain.
        self.conserved = not any(forces) and formulas.value(by_time) == 0
        rows = [formulas.gradient(rate, self.dim + 1) for rate in self.rates]
        #: Whether the rates do not contain the time, as far as that is plain.
        self.autonomous = all(formulas.value(row.pop()) == 0 for row in rows)
        places = [(i, j, place) for i, row in enumerate(rows) for j, place in enumerate(row)]
        places = [entry for entry in places if formulas.value(entry[2]) != 0]
        self._entries = [(i, j) for i, j, _ in places]
        #: Functions of the state and the time.
        self.run_rates = formulas.program(self.rates)
        self.run_energy = formulas.program([self.energy])
        #: The entries of Df that are not zero, and what must be smooth, too.
        self.run_slopes = formulas.program([*(e[2] for e in places), self.energy, *self.rates])

    def matrix(self, entries: Sequence[arb]) -> arb_mat:
        """Df from the values of its entries."""
        found = [arb(0)] * (self.dim * self.dim)
        for (i, j), value in zip(self._entries, entries, strict=False):
            found[i * self.dim + j] = value
        return arb_mat(self.dim, self.dim, found)

    def resting(self, zero: set[int]) -> set[int]:
        """Components that stay exactly zero, of those that are zero at the start."""
        value, nothing = self.formulas.value, dict.fromkeys(zero, self.formulas.number(0))
        still = {i for i in zero if value(self.formulas.replaced(self.rates[i], nothing)) == 0}
        return zero if still == zero else self.resting(still)


# -- functions of x -------------------------------------------------------------------------------


class Polynomial:
    """A polynomial in x, for real and complex numbers, and for x itself as a series."""

    def __init__(self, series: Sequence[arb]) -> None:
        self.real = arb_poly(list(series))
        self._complex = acb_poly(self.real)

    @cached_property
    def _slopes(self) -> arb_poly:
        return arb_poly([abs(c).abs_upper() for c in self.real.coeffs()]).derivative()

    def __call__(self, x: Any) -> Any:
        if isinstance(x, arb_series):
            return arb_series(self.real.coeffs(), x.prec)
        return self._around(x) if isinstance(x, acb) else self.real(x)

    def _around(self, x: acb) -> acb:
        """The values on a rectangle: those within |h| sum_k k |c_k| (|m| + |h|)^(k-1) of that at m.

        Products of rectangles would turn them, and grow each power by up to sqrt(2)^k.
        """
        middle = x.mid()
        change = abs(x - middle).abs_upper()
        spread = (change * self._slopes(abs(middle) + change)).abs_upper()
        return self._complex(middle) + acb(UNIT * spread, UNIT * spread)


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
    first = series_of(at, order)
    for R in _DISCS:
        with contextlib.suppress(NotProvenError), ctx.workprec(COARSE):
            values = [at(square) for square in squares(R)]
            # A NaN is not larger than any number: all are looked at before the largest is taken.
            if all(value.is_finite() for each in values for value in each):
                columns = zip(*values, strict=True)
                M = [max(abs(value).abs_upper() for value in each) for each in columns]
                return [Expansion(*pair, R) for pair in zip(first, M, strict=True)]
    raise NotProvenError("a function is not smooth there, or changes too fast")


def series_of(at: Callable[[Any], Sequence[Any]], order: int) -> list[list[arb]]:
    ctx.cap = order
    return [coefficients(value, order) for value in at(arb_series([0, 1], order))]


def coefficients(value: Any, count: int) -> list[arb]:
    """The first coefficients of a number, a polynomial or a series."""
    found = value.coeffs()[:count] if hasattr(value, "coeffs") else [arb(value)]
    return [*found, *[arb(0)] * (count - len(found))]


def chebyshev(y: Any, count: int) -> list[Any]:
    """The first Chebyshev polynomials of a polynomial or a power series."""
    found = [y * 0 + 1, y]
    while len(found) < count:
        found.append(2 * y * found[-1] - found[-2])
    return found[:count]


def squares(R: int) -> Iterator[acb]:
    """Squares that cover half a disc, which is enough for functions that are real for real x."""
    for j in range(_DIVISIONS):
        for i in range(-_DIVISIONS, _DIVISIONS):
            if min(i * i, (i + 1) ** 2) + j * j < _DIVISIONS**2:
                yield acb(*(arb(R) / _DIVISIONS * (k + arb(0.5, 0.5)) for k in (i, j)))


@dataclass(frozen=True)
class Interval:
    """Times t = middle + r x, -1 <= x <= 1."""

    middle: Fraction
    r: Fraction

    @cached_property
    def _balls(self) -> tuple[arb, arb]:
        return ball(self.middle), ball(self.r)

    def time(self, x: Any) -> Any:
        """t, with the precision at which this is called first."""
        middle, r = self._balls
        return middle + r * x

    def line(self, other: Interval) -> arb_poly:
        """x of this interval in terms of that of another one."""
        return arb_poly([ball((other.middle - self.middle) / self.r), ball(other.r / self.r)])


# -- matrices -------------------------------------------------------------------------------------


def sizes(matrix: arb_mat) -> arb_mat:
    """Bounds on the entries of a matrix."""
    entries = [entry.abs_upper() for entry in matrix.entries()]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def column(values: Sequence[arb]) -> arb_mat:
    return arb_mat(len(values), 1, list(values))


def identity(dim: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(dim)] for i in range(dim)])


def krawczyk(
    centre: Sequence[arb], box: Sequence[arb], values: arb_mat, slopes: arb_mat
) -> list[arb]:
    """Contain every zero of F in a box; where it is inside the box, this has exactly one.

    - values, slopes: F at the centre, and DF over the box.
    """
    C, spread = inverse(slopes), [b - c for b, c in zip(box, centre, strict=True)]
    rest = (identity(len(box)) - C * slopes) * column(spread)
    return (column(centre) - C * values + rest).entries()


def inverse(matrix: arb_mat) -> arb_mat:
    """Numbers about the inverse."""
    try:
        return matrix.mid().inv().mid()
    except ZeroDivisionError:
        raise NotProvenError("the equations are singular: their zero is not isolated") from None


def total(parts: Sequence[arb_mat]) -> arb_mat:
    return sum(parts[1:], parts[0])


def matrices(equations: Equations, rows: list[list[arb]], r: Fraction) -> list[arb_mat]:
    """Coefficients of r Df from those of its entries."""
    return [equations.matrix(entries) * ball(r) for entries in zip(*rows, strict=True)]


def end_of(series: list[arb_mat], x: int) -> arb_mat:
    """The value of a matrix of polynomials at x = 1 or -1."""
    return total([part if x > 0 or k % 2 == 0 else -part for k, part in enumerate(series)])


def roots(polynomial: arb_poly) -> list[tuple[acb, bool | None]]:
    """All roots, and whether they are real: None of one that is not known to be alone."""
    if polynomial.degree() < 1:
        return []
    try:
        found = acb_poly(polynomial).roots()
    except ValueError:  # they are not isolated
        return [(acb(arb.nan(), arb.nan()), None)]
    kinds: list[tuple[acb, bool | None]] = []
    for value in found:
        alone = sum(other.overlaps(value.conjugate()) for other in found) == 1
        real = value.overlaps(value.conjugate())
        kinds.append((value, real if alone or not real else None))
    return kinds
