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
from typing import Any, Protocol

from flint import acb, acb_poly, arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.proof.checker.formulas import Formulas, NotProvenError, ball

UNIT = arb(0, 1)  # all numbers up to 1 in size
COARSE = 53  # bits of values on discs
DISCS, _DIVISIONS = (6, 5), 4  # of discs that are tried, and squares on a radius


class Rates(Protocol):
    """dz/dt = f(t, z): f from (z, t), and entries (i, j, ...) of Df that are not zero, before f."""

    dim: int
    entries: list[tuple[int, int, int]]

    def run_rates(self, variables: Sequence[Any], /) -> list[Any]: ...

    def run_all(self, variables: Sequence[Any], /) -> list[Any]: ...


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
        later = [formulas.gradient(rate, self.dim + 1)[self.dim] for rate in self.rates]
        #: Whether the rates do not contain the time, as far as that is plain.
        self.autonomous = all(formulas.value(rate) == 0 for rate in later)
        rows = [formulas.gradient(rate, self.dim) for rate in self.rates]
        places = [(i, j, place) for i, row in enumerate(rows) for j, place in enumerate(row)]
        self.entries = [entry for entry in places if formulas.value(entry[2]) != 0]
        self.run_rates = formulas.program(self.rates)
        self.run_energy = formulas.program([energy])
        self.run_all = formulas.program([*(e[2] for e in self.entries), energy, *self.rates])

    def resting(self, zero: set[int]) -> set[int]:
        """Components that stay exactly zero, of those that are zero at the start."""
        value, nothing = self.formulas.value, dict.fromkeys(zero, self.formulas.number(0))
        still = {i for i in zero if value(self.formulas.replaced(self.rates[i], nothing)) == 0}
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
    for R in DISCS:
        bounds = suprema(lambda R: [at(square) for square in squares(R)], R)
        if bounds is not None:
            return [Expansion(*pair, R) for pair in zip(first, bounds, strict=True)]
    raise NotProvenError("a function is not smooth there, or changes too fast")


def suprema(around: Callable[[Any], Sequence[Sequence[Any]]], place: Any) -> list[arb] | None:
    """Bounds on functions; None where they have no finite values.

    - around: A place -> the values of the functions on sets that cover it.
    """
    with contextlib.suppress(NotProvenError), ctx.workprec(COARSE):
        values = around(place)
        # A NaN is not larger than any number: all are looked at before the largest is taken.
        if all(value.is_finite() for each in values for value in each):
            return [max(abs(v).abs_upper() for v in each) for each in zip(*values, strict=True)]
    return None


def series_of(at: Callable[[Any], Sequence[Any]], order: int) -> list[list[arb]]:
    ctx.cap = order
    return [coefficients(value, order) for value in at(arb_series([0, 1], order))]


def coefficients(value: Any, count: int) -> list[arb]:
    """The first coefficients of a number, a polynomial or a series."""
    found = value.coeffs()[:count] if hasattr(value, "coeffs") else [arb(value)]
    return [*found, *[arb(0)] * (count - len(found))]


def squares(R: int) -> Iterator[acb]:
    """Squares that cover half a disc, which is enough for functions that are real for real x."""
    for j in range(_DIVISIONS):
        for i in range(-_DIVISIONS, _DIVISIONS):
            if min(i * i, (i + 1) ** 2) + j * j < _DIVISIONS**2:
                yield acb(*(arb(R) / _DIVISIONS * (k + arb(0.5, 0.5)) for k in (i, j)))


def clock(middle: Fraction, r: Fraction) -> Callable[[Any], Any]:
    """The time as a function of x."""
    start, slope = ball(middle), ball(r)
    return lambda x: start + slope * x


# -- matrices -------------------------------------------------------------------------------------


def sizes(matrix: arb_mat) -> arb_mat:
    """Bounds on the entries of a matrix."""
    entries = [entry.abs_upper() for entry in matrix.entries()]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def column(values: Sequence[arb]) -> arb_mat:
    return arb_mat(len(values), 1, list(values))


def identity(dim: int) -> arb_mat:
    return arb_mat([[int(i == j) for j in range(dim)] for i in range(dim)])


def total(parts: Sequence[arb_mat]) -> arb_mat:
    return sum(parts[1:], parts[0])


def matrices(equations: Rates, rows: list[list[arb]], r: Fraction) -> list[arb_mat]:
    """Coefficients of r Df from those of its entries."""
    n, found = equations.dim, []
    for k in range(len(rows[0])):
        entries = [arb(0)] * (n * n)
        for (i, j, _), row in zip(equations.entries, rows, strict=False):
            entries[i * n + j] = ball(r) * row[k]
        found.append(arb_mat(n, n, entries))
    return found


def end_of(series: list[arb_mat], x: int) -> arb_mat:
    """The value of a matrix of polynomials at x = 1 or -1."""
    return total([part if x > 0 or k % 2 == 0 else -part for k, part in enumerate(series)])
