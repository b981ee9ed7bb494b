"""The map on a cell, and bounds on polynomials in x and s."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

from flint import arb, arb_mat, arb_poly, ctx

from hamsym.proof.checker.formulas import FalseClaimError, ball
from hamsym.proof.checker.functions import COARSE, Interval, coefficients
from hamsym.proof.checker.series import Series, exponents, term

_HALVINGS = 40  # of parts of a step and a cell
# Most halvings of cells, and of those in which only the claim is not proven.
DEEPEST, _CLOSEST = 24, 8

Exponents = tuple[int, ...]


class WideCellError(Exception):
    """A cell has no proof, but parts of it may have one.

    - cost: The share that this is of the reasons for which a part of the box is given up.
    """

    def __init__(self, text: str, cost: float = 1 / DEEPEST) -> None:
        super().__init__(text)
        self.cost = cost


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
        self.space = _polynomials(len(given), degree, self._count)
        self._y = [_affine(*row, given) for row in zip(leg["scaling"], leg["shift"], strict=True)]
        self._lines = [[y * 0 + 1, y] for y in self._y]
        self._products = {(0,) * len(self._y): self._y[0] * 0 + 1}
        starts = zip(leg["selection"], leg["offset"], strict=True)
        self._start = self._rows([_affine(*row, given) for row in starts]).transpose()
        if leg["start"]:
            self._start += self._sums(leg["start_degrees"], leg["start"])

    def _chebyshev(self, nu: tuple[int, ...]) -> Series:
        """T_nu(y)."""
        if nu not in self._products:
            k = max(k for k, power in enumerate(nu) if power)
            known = self._lines[k]
            while len(known) <= nu[k]:
                known.append(2 * self._y[k] * known[-1] - known[-2])
            lower = self._chebyshev((*nu[:k], 0, *nu[k + 1 :]))
            self._products[nu] = lower * known[nu[k]]
        return self._products[nu]

    def _rows(self, series: Sequence[Series]) -> arb_mat:
        return arb_mat([[term(each, key) for key in self._keys] for each in series])

    def _sums(
        self, degrees: Sequence[Sequence[int]], weights: Sequence[Sequence[float]]
    ) -> arb_mat:
        """Sums of weights[nu, r] T_nu(y): terms in rows, r in columns."""
        return self._rows([self._chebyshev(tuple(nu)) for nu in degrees]).transpose() * arb_mat(
            [list(row) for row in weights]
        )

    def states(self, number: int, part: Interval) -> list[arb_mat]:
        """z^ on a part of a piece: terms of s in rows, powers of x in columns."""
        leg, piece = self._leg, self._leg["pieces"][number]
        if number not in self._readouts:
            self._readouts = {number: self._sums(piece["degrees"], piece["readouts"])}
        low, high = (Fraction(edge) for edge in leg["edges"][number : number + 2])
        elapsed = Interval(part.middle - Fraction(leg["begin"]), part.r)
        line = Interval((low + high) / 2, (high - low) / 2).line(elapsed)
        series = [arb_poly([1]), line]
        while len(series) < len(piece["columns"][0]):
            series.append(2 * line * series[-1] - series[-2])
        time = arb_poly([ball(elapsed.middle), ball(elapsed.r)])
        powers = arb_mat([coefficients(part * time, self._count) for part in series])
        found = []
        for i in range(self._start.ncols()):
            columns = [[row[i] for row in own] for own in piece["columns"]]
            columns = [[*row, *[0.0] * (len(series) - len(row))] for row in columns]
            moved = self._readouts[number] * (arb_mat(columns) * powers)
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


class Polynomials:
    """Polynomials in x and s as matrices: terms of s in rows, powers of x in columns."""

    def __init__(self, inputs: int, degree: int, count: int) -> None:
        self._exponents = [*exponents(inputs, degree).values()]
        self._of_x = arb_mat([[_share(n, b) for b in range(count)] for n in range(count)])
        self._of_s = self._matrix(
            lambda nu: (
                (mu, math.prod(map(_share, nu, mu), start=arb(1)))
                for mu in product(*(range(n % 2, n + 1, 2) for n in nu))
            )
        )
        #: Substitutions of (side + x)/2 for each variable; x is the last one.
        self._halves = [
            [self._matrix(functools.partial(_half, k, side)) for side in (-1, 1)]
            for k in range(inputs)
        ]
        powers = range(count)
        self._halves.append(
            [arb_mat([[_halved(n, j, x) for j in powers] for n in powers]) for x in (-1, 1)]
        )

    def _matrix(self, terms: Callable[[Exponents], Iterable[tuple[Exponents, arb]]]) -> arb_mat:
        """The matrix of what replaces each s^nu."""
        rows = {nu: k for k, nu in enumerate(self._exponents)}
        table = [[arb(0)] * len(rows) for _ in rows]
        for nu, k in rows.items():
            for mu, factor in terms(nu):
                table[rows[mu]][k] = factor
        return arb_mat(table)

    def require_below(self, whole: arb_mat, bound: arb, distance: arb, name: str) -> None:
        """Prove |g| + distance <= bound for a polynomial."""
        with ctx.workprec(COARSE):
            parts = [(whole, 0)]
            while parts:
                # A false claim is found where the polynomial is large.
                parts.sort(key=lambda each: float(abs(each[0][0, 0]).mid()))
                part, depth = parts.pop()
                series = (self._of_s * part * self._of_x).tolist()
                sizes = [[value.abs_upper() for value in row] for row in series]
                if sum(map(sum, sizes), distance) <= bound:
                    continue
                if abs(part[0, 0]) > bound + distance:
                    raise FalseClaimError(
                        f"its claim about the error of {name} is false: it is larger"
                    )
                if depth == _HALVINGS:
                    text = f"its claim about the error of {name} is not proven"
                    raise WideCellError(text, 1 / _CLOSEST)
                k = self._axis(sizes)
                for half in self._halves[k]:
                    other = half * part if k < len(self._halves) - 1 else part * half
                    parts.append((other, depth + 1))

    def _axis(self, sizes: Sequence[Sequence[arb]]) -> int:
        """The variable in which a series with such terms changes most."""
        weights = [0.0] * len(self._halves)
        for nu, row in zip(self._exponents, sizes, strict=True):
            for b, size in enumerate(row):
                weights = [w + float(size) * n for w, n in zip(weights, (*nu, b), strict=True)]
        return max(range(len(weights)), key=weights.__getitem__)


@functools.lru_cache(maxsize=4)
def _polynomials(inputs: int, degree: int, count: int) -> Polynomials:
    return Polynomials(inputs, degree, count)


def _half(k: int, side: int, nu: Exponents) -> Iterator[tuple[Exponents, arb]]:
    """What replaces s^nu where (side + s_k)/2 replaces s_k."""
    for j in range(nu[k] + 1):
        yield (*nu[:k], j, *nu[k + 1 :]), _halved(nu[k], j, side)


def _share(n: int, b: int) -> arb:
    """The coefficient of T_b in x^n."""
    if b > n or (n - b) % 2:
        return arb(0)
    return arb(math.comb(n, (n - b) // 2) * (2 if b else 1)) / 2**n


def _halved(n: int, j: int, side: int) -> arb:
    """The coefficient of x^j in ((side + x)/2)^n."""
    return arb(math.comb(n, j) * side ** (n - j) if j <= n else 0) / 2**n
