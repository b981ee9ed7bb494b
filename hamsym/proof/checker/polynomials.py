"""Bounds on polynomials in x and s, -1 <= x <= 1 and |s_k| <= 1."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import product

from flint import arb, arb_mat, ctx

from hamsym.proof.checker.formulas import FalseClaimError, NotProvenError
from hamsym.proof.checker.series import exponents

_BITS = 80
_HALVINGS = 50  # of a part

Exponents = tuple[int, ...]


class Polynomials:
    """Polynomials as matrices: terms of s in rows, powers of x in columns.

    They are bounded by the sums of their coefficients in products of Chebyshev polynomials, on
    parts that are halved until the bound is small enough.
    """

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
        """Prove |g| + distance <= bound."""
        with ctx.workprec(_BITS):
            for part, last in self._parts(whole, lambda size: size + distance <= bound):
                value = abs(part[0, 0])
                if value > bound + distance:
                    raise FalseClaimError(f"its claim about {name} is false: it is larger")
                if last or value + distance > bound:
                    raise NotProvenError(f"its claim about {name} is not proven")

    def reaches(self, whole: arb_mat, bound: arb) -> bool:
        """Whether g >= bound > 0 is proven somewhere, for a polynomial in x."""
        with ctx.workprec(_BITS):
            for part, _ in self._parts(whole, lambda size: size < bound):
                powers = part.entries()
                even, odd = sum(powers[2::2], powers[0]), sum(powers[1::2], arb(0))
                if any(value >= bound for value in (powers[0], even - odd, even + odd)):
                    return True
        return False

    def _parts(
        self, whole: arb_mat, is_done: Callable[[arb], bool]
    ) -> Iterator[tuple[arb_mat, bool]]:
        """Parts with a bound that is not good enough, and whether they are the smallest."""
        parts = [(whole, 0)]
        while parts:
            # A false claim is found where the polynomial is large.
            parts.sort(key=lambda each: float(abs(each[0][0, 0]).mid()))
            part, depth = parts.pop()
            series = (self._of_s * part * self._of_x).tolist()
            sizes = [[value.abs_upper() for value in row] for row in series]
            size = sum((value for row in sizes for value in row), arb(0))
            if is_done(size):
                continue
            last = depth == _HALVINGS or not size - sizes[0][0] > part[0, 0].rad()
            yield part, last
            if not last:
                k = self._axis(sizes)
                of_x = k == len(self._halves) - 1
                halves = [part * h if of_x else h * part for h in self._halves[k]]
                parts += [(half, depth + 1) for half in halves]

    def _axis(self, sizes: Sequence[Sequence[arb]]) -> int:
        """The variable in which a series with such terms changes most."""
        weights = [0.0] * len(self._halves)
        for nu, row in zip(self._exponents, sizes, strict=True):
            for b, size in enumerate(row):
                weights = [w + float(size) * n for w, n in zip(weights, (*nu, b), strict=True)]
        return max(range(len(weights)), key=weights.__getitem__)


@functools.lru_cache(maxsize=16)
def polynomials(inputs: int, degree: int, count: int) -> Polynomials:
    """Polynomials up to a degree in s and with some powers of x, whose matrices are kept."""
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
