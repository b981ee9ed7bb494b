"""The map on a cell, as polynomials in x and s."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from flint import arb, arb_mat, arb_poly

from hamsym.proof.checker.formulas import ball
from hamsym.proof.checker.functions import Interval, chebyshev, coefficients
from hamsym.proof.checker.polynomials import polynomials
from hamsym.proof.checker.series import Series, exponents, term


class LegOnCell:
    """A leg z_a + (t - t_a) sum_r W_r(y) phi_r(t) as polynomials in x and s, exactly.

    T_nu(y) are products of Chebyshev polynomials in y = scaling @ inputs + shift, W_r(y) and parts
    of z_a are sums of them, and phi_r are Chebyshev series in the time of a piece.

    - inputs: A degree -> the inputs as series.
    - degree, powers: Of what is compared with the leg, in s and in x.
    """

    def __init__(
        self,
        leg: Mapping[str, Any],
        inputs: Callable[[int], list[Series]],
        degree: int,
        powers: int,
    ) -> None:
        self._leg, self._readouts = leg, dict[int, arb_mat]()
        degrees = [leg["start_degrees"], *(piece["degrees"] for piece in leg["pieces"])]
        degree = max([degree, *(sum(nu) for rows in degrees for nu in rows)])
        given = inputs(degree)
        self._keys = exponents(len(given), degree)
        # t - t_a is a factor of the series in time.
        self._count = 1 + max(powers, *(len(piece["columns"][0]) for piece in leg["pieces"]))
        self.space = polynomials(len(given), degree, self._count)
        y = [_affine(*row, given) for row in zip(leg["scaling"], leg["shift"], strict=True)]
        self._one, self._lines = y[0] * 0 + 1, [chebyshev(each, degree + 1) for each in y]
        self._products: dict[tuple[int, ...], list[Any]] = {}
        starts = zip(leg["selection"], leg["offset"], strict=True)
        self._start = arb_mat([self._row(_affine(*row, given)) for row in starts]).transpose()
        if leg["start"]:
            self._start += self._sums(leg["start_degrees"], leg["start"])

    def _row(self, series: Series) -> list[Any]:
        return [term(series, key) for key in self._keys]

    def _sums(
        self, degrees: Sequence[Sequence[int]], weights: Sequence[Sequence[float]]
    ) -> arb_mat:
        """Sums of weights[nu, r] T_nu(y): terms in rows, r in columns."""
        for nu in map(tuple, degrees):
            if nu not in self._products:
                factors = [T[n] for T, n in zip(self._lines, nu, strict=True) if n]
                self._products[nu] = self._row(math.prod(factors, start=self._one))
        rows = arb_mat([self._products[tuple(nu)] for nu in degrees])
        return rows.transpose() * arb_mat([list(row) for row in weights])

    def states(self, number: int, part: Interval) -> list[arb_mat]:
        """z^ on a part of a piece: terms of s in rows, powers of x in columns."""
        leg, piece = self._leg, self._leg["pieces"][number]
        if number not in self._readouts:
            self._readouts = {number: self._sums(piece["degrees"], piece["readouts"])}
        low, high = (Fraction(edge) for edge in leg["edges"][number : number + 2])
        elapsed = Interval(part.middle - Fraction(leg["begin"]), part.r)
        line = Interval((low + high) / 2, (high - low) / 2).line(elapsed)
        time = arb_poly([ball(elapsed.middle), ball(elapsed.r)])
        series = chebyshev(line, len(piece["columns"][0]))
        powers = arb_mat([coefficients(each * time, self._count) for each in series])
        found = []
        for i in range(self._start.ncols()):
            columns = arb_mat([[row[i] for row in own] for own in piece["columns"]])
            moved = self._readouts[number] * (columns * powers)
            first = [coefficients(self._start[k, i], self._count) for k in range(moved.nrows())]
            found.append(moved + arb_mat(first))
        return found

    def matrix(self, part: Mapping[int, arb_poly], line: arb_poly) -> arb_mat:
        """Polynomials in x by the number of nu as such a matrix, with a line for x."""
        zero = arb_poly()
        return arb_mat([coefficients(part.get(key, zero)(line), self._count) for key in self._keys])


def _affine(row: Sequence[float], shift: float, inputs: Sequence[Series]) -> Series:
    terms = [each * arb(factor) for factor, each in zip(row, inputs, strict=True)]
    return sum(terms[1:], terms[0]) + arb(shift)
