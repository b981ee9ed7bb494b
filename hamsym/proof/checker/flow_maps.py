"""Certificates of flow maps: the bound of each component is proven again, or refused.

The box is cut into cells, inputs = middle + half s with |s_k| <= 1. On a step t = m + r x of a cell
the solutions from all its starts are near one polynomial y(x, s), by the lemma of
:mod:`hamsym.proof.checker.motion` for each s: V and W are the same, D and A are bounded over all s.
The map is a polynomial in x and s, too. Its difference from y, in products of Chebyshev
polynomials, is compared with the bound, on parts of the step and of the cell.

Functions of (x, s) are known by their terms with |nu| <= n and less than m powers of x. By Cauchy's
inequality the others add at most

    M sum over |nu| > n of the product of 1 / R_k^nu_k,    |g| <= M for -1 <= x <= 1, |s_k| <= R_k,
    N M / (R^(m - 1) (R - 1)),                             |g| <= M for |x| <= R, |s_k| <= 1,

with N the number of nu. Cells without a proof are halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import acb, arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.proof.checker import guesses
from hamsym.proof.checker.formulas import (
    FalseClaimError,
    NotProvenError,
    ball,
    exact,
    refusing_other_forms,
)
from hamsym.proof.checker.functions import (
    COARSE,
    DISCS,
    UNIT,
    Equations,
    Polynomial,
    clock,
    coefficients,
    column,
    end_of,
    exact_numbers,
    identity,
    squares,
    suprema,
)
from hamsym.proof.checker.map_polynomials import LegOnCell, WideCellError
from hamsym.proof.checker.motion import End, Step, march, proven
from hamsym.proof.checker.series import Series, exponents, term

# Bits, Taylor coefficients, and the size of the last ones.
_BITS, _ORDER, _ACCURACY = 128, 24, 2.0**-60
_PRODUCTS, _MOST = 1_001, 12  # of terms in a product of series; their largest degree
_MORE = 2  # degrees in s of dy/dx, above those of y
_SHARE = 4  # of a bound, that the distance of y from the solution may be at most
# Share of a bound, and of the states, that powers of x left out of a step may be.
_LATE, _LEAST = 2.0**-14, 2.0**-52
_TINY = 1e-300
_TRIES = 4  # steps of one cell that are too long, one after the other
_SHORTEST = Fraction(1, 2**20)  # step, of the span
# Parts of -1 <= x <= 1, radii of discs of s that are tried, and the largest share of one.
_PARTS, _RADII, _MOST_SHARE = 8, (*(1.5**k for k in range(2, 24)), 2.0**20, 2.0**40), 1e3

Interval = tuple[Fraction, Fraction]
Box = tuple[Interval, ...]


def check_flow_map(
    H: Mapping[str, Any],
    flow: Mapping[str, Any],
    claims: Mapping[str, Any],
    check_time: Callable[[], None],
) -> None:
    """Prove the bounds of a certificate of a flow map; raise NotProvenError if one fails.

    - H: See :class:`Equations`; parameters that are inputs have any value.
    - flow: "span", "inputs", "fixed" and "expressions" by component, and the "map": "leg" with its
      arrays, or "split" with "normal", "threshold", "low" and "high".
    - claims: "bound" and "box" of its JSON.
    """
    with refusing_other_forms(), ctx.workprec(_BITS):
        _Check(H, flow, claims, check_time).run()


class _Check:
    """What is the same for all cells.

    - bounds: Those of the claim.
    - degree: Of y in s.
    """

    def __init__(
        self,
        H: Mapping[str, Any],
        flow: Mapping[str, Any],
        claims: Mapping[str, Any],
        check_time: Callable[[], None],
    ) -> None:
        self._flow, self.check_time = flow, check_time
        self._inputs, self.names = list(flow["inputs"]), [*H["q"], *H["p"]]
        self._free = [name for name in self._inputs if name not in self.names]
        #: Inputs that are parameters.
        self.places = [self._inputs.index(name) for name in self._free]
        known = {name: v for name, v in H["parameters"].items() if name not in self._free}
        self.equations = Equations({**H, "parameters": known}, self._free)
        self.span = [Fraction(time) for time in flow["span"]]
        self.bounds = [exact(bound) for bound in claims["bound"]]
        if not all(bound >= 0 for bound in self.bounds) or len(self.bounds) != len(self.names):
            raise FalseClaimError("the certificate does not have one bound for each component")
        ends = [[exact(end) for end in claims["box"][name]] for name in self._inputs]
        self._box = tuple((low, high) for low, high in ends)
        if not all(low < high for low, high in self._box) or len(claims["box"]) != len(ends):
            raise FalseClaimError("the certificate does not have one interval for each input")
        d = len(ends)
        degrees = (n for n in range(2, _MOST + 1) if math.comb(n + 2 * d, n) <= _PRODUCTS)
        self.degree = max(degrees, default=2)
        self.starts = [self._start_of(name) for name in self.names]

    def _start_of(self, name: str) -> Callable[[Sequence[Any]], Any]:
        """A component of z0 as a function of the inputs."""
        if name in self._inputs:
            k = self._inputs.index(name)
            return lambda values: values[k]
        if name in self._flow["fixed"]:
            number = ball(Fraction(self._flow["fixed"][name]))
            return lambda values: number
        text, formulas = self._flow["expressions"][name], self.equations.formulas
        place = formulas.parse(text["formula"], numbers=exact_numbers(text))
        run, others = formulas.program([place]), [arb("nan")] * (self.equations.dim + 1)
        return lambda values: run([*others, *self.parameters(values)])[0]

    def parameters(self, values: Sequence[Any]) -> list[Any]:
        return [values[k] for k in self.places]

    def run(self) -> None:
        r = (self.span[1] - self.span[0]) / 4
        for leg, box in _regions(self._flow["map"], self._box):
            cuts, waiting = _cuts(leg, self.span), [(box, 0.0)]
            while waiting:
                cell, spent = waiting.pop()
                proof = _Cell(self, leg, cell)
                try:
                    r = proof.run(cuts, r)
                except WideCellError as error:
                    spent += error.cost
                    if not spent < 1:
                        raise NotProvenError(f"{error}, in a small part of the box") from None
                    k = proof.axis(box)
                    low, high = cell[k]
                    for half in ((low, (low + high) / 2), ((low + high) / 2, high)):
                        waiting.append(((*cell[:k], half, *cell[k + 1 :]), spent))


def _regions(map: Mapping[str, Any], box: Box) -> Iterator[tuple[Mapping[str, Any], Box]]:
    """The legs of a map, and parts of the box that cover where each is used."""
    if map["kind"] == "leg":
        yield map, box
        return
    axes = [k for k, factor in enumerate(map["normal"]) if factor] if map["kind"] == "split" else []
    if len(axes) != 1:
        raise NotProvenError(
            "the map has several legs, or is split along a slanted plane, which is not covered"
        )
    (k,) = axes
    cut = Fraction(map["threshold"]) / Fraction(map["normal"][k])
    sides = (map["low"], map["high"]) if map["normal"][k] > 0 else (map["high"], map["low"])
    low, high = box[k]
    for side, a, b in zip(sides, (low, max(low, cut)), (min(high, cut), high), strict=True):
        if a <= b:
            yield from _regions(side, (*box[:k], (a, b), *box[k + 1 :]))


def _cuts(leg: Mapping[str, Any], span: Sequence[Fraction]) -> list[Fraction]:
    """The times at which the pieces of a leg end, the last one with the span."""
    begin, edges = Fraction(leg["begin"]), [Fraction(edge) for edge in leg["edges"]]
    cuts = [*(begin + edge for edge in edges[:-1]), span[1]]
    forward = span[1] > span[0]
    in_order = all(a != b and (b > a) == forward for a, b in pairwise(cuts))
    if not (in_order and cuts[0] == span[0] and len(edges) == len(leg["pieces"]) + 1):
        raise FalseClaimError("the pieces of the map are not in order")
    return cuts


# -- cells ----------------------------------------------------------------------------------------


class _WithParameters:
    """Equations of motion with values of the parameters."""

    def __init__(self, equations: Equations, parameters: Sequence[arb]) -> None:
        self.dim, self.entries = equations.dim, equations.entries
        self._equations, self._parameters = equations, parameters

    def run_rates(self, variables: Sequence[Any], /) -> list[Any]:
        return self._equations.run_rates([*variables, *self._parameters])

    def run_all(self, variables: Sequence[Any], /) -> list[Any]:
        return self._equations.run_all([*variables, *self._parameters])


class _Cell:
    """The proof on a cell."""

    def __init__(self, check: _Check, leg: Mapping[str, Any], cell: Box) -> None:
        self._check, self._cell, self._dim = check, cell, check.equations.dim
        self._middles = [ball((low + high) / 2) for low, high in cell]
        self._halves = [ball((high - low) / 2) for low, high in cell]
        self._d, self._m = len(cell), check.degree
        self._exponents = exponents(self._d, self._m)
        self._more = exponents(self._d, self._m + _MORE)  # of f
        self._map = LegOnCell(leg, self._inputs, self._m, _ORDER)
        around = [a + UNIT * b for a, b in zip(self._middles, self._halves, strict=True)]
        self._parameters = check.parameters(self._inputs(self._m + _MORE))
        self._middle = _WithParameters(check.equations, check.parameters(self._middles))
        self._whole = _WithParameters(check.equations, check.parameters(around))
        self._failed, self._weights = 0, [0.0] * self._d
        #: y of the last step: for each component polynomials in x, by the number of nu.
        self._y: list[dict[int, arb_poly]] = []

    def _inputs(self, degree: int) -> list[Series]:
        pairs = enumerate(zip(self._middles, self._halves, strict=True))
        return [Series.line(self._d, degree, a, {k: b}) for k, (a, b) in pairs]

    def _discs(self, radii: Sequence[float]) -> list[acb]:
        """The inputs for all |s_k| <= radii[k]."""
        inputs = zip(self._middles, self._halves, radii, strict=True)
        return [_disc(acb(a), b * R) for a, b, R in inputs]

    def run(self, cuts: Sequence[Fraction], r: Fraction) -> Fraction:
        """Prove the bounds on the cell; return half of its longest step.

        - cuts: Times at which pieces of the map end.
        - r: Half of the first step.
        """
        check, zeros, one = self._check, arb_mat(self._dim, 1), identity(self._dim)
        starts = [start(self._inputs(self._m + _MORE)) for start in check.starts]
        self._ends = [{key: arb(term(start, key)) for key in self._more} for start in starts]
        self._loose = self._beyond(
            lambda R: [[start(self._discs([R] * self._d)) for start in check.starts]],
            [1.0] * self._d,
        )
        self._end = End([ends[0] for ends in self._ends], zeros, one, one, one, zeros)
        self._before = [arb_poly([z]) for z in self._end.z], Fraction(0), Fraction(1)
        self._scales, longest = [abs(z) for z in self._end.z], Fraction(0)
        for step in march(check.span, r, _SHORTEST, self._attempt, check.check_time):
            self._compare(step, cuts)
            longest = max(longest, step.r, key=abs)
        return longest

    def _attempt(self, middle: Fraction, r: Fraction) -> tuple[Step, float]:
        """Prove a step."""
        before, place, own = self._before
        line = arb_poly([ball((middle - place) / own), ball(r / own)])
        near, z = [part(line) for part in before], [ends[0].mid() for ends in self._ends]
        found = guesses.guess(
            self._middle, z, near, middle, r, _ORDER, _ACCURACY, self._scales, _ORDER
        )
        factor = guesses.factor_of(found.y, _ORDER, _ACCURACY, self._scales)
        if not factor > 0.8:
            raise NotProvenError("the solutions change too fast")
        self._y = y = self._family(found, middle, r)
        try:
            D, gap = self._defect(middle, r), []
            for part, ends, loose in zip(y, self._ends, self._loose, strict=True):
                sizes = [abs(end - _at(part, key, -1)) for key, end in ends.items()]
                gap.append(sum(sizes, loose))
            wide = guesses.Guess([Polynomial(_range_of(part)) for part in y], found.V, found.W)
            step = proven(self._whole, self._end, middle, r, wide, D, gap)
        except WideCellError:
            raise
        except NotProvenError as error:
            self._failed += 1
            if self._failed == _TRIES:
                raise WideCellError(str(error)) from None
            raise
        limits = zip(step.tube, self._check.bounds, strict=True)
        if not all(_SHARE * distance <= ball(bound) for distance, bound in limits):
            raise WideCellError("no polynomial is near enough to the solutions")
        self._failed, self._end = 0, step.end
        self._before = [part[0] for part in y], middle, r
        self._ends = [{key: _at(part, key, 1) for key in self._exponents} for part in y]
        self._loose = [arb(0)] * self._dim
        return step, factor

    def _family(
        self, found: guesses.Guess, middle: Fraction, r: Fraction
    ) -> list[dict[int, arb_poly]]:
        """y of a step, degree by degree: with A = r Df for s = 0, dy_nu/dx = A y_nu + g_nu."""
        y = [{0: part.real} for part in found.y]
        start, origin, nothing = end_of(found.W, -1), arb(-1), arb_mat(self._dim, 1)
        for degree in range(1, self._m + 1):
            rates = self._rates(y, middle, r, degree)
            for key, nu in self._exponents.items():
                if sum(nu) != degree:
                    continue
                g = [arb_poly(coefficients(term(rate, key), _ORDER)) * ball(r) for rate in rates]
                moved = [part.integral() for part in guesses.applied(found.W, g, _ORDER)]
                ends = column([ends[key] for ends in self._ends])
                if not any(part.degree() >= 0 for part in g) and ends == nothing:
                    continue
                own = start * ends
                moved = [part + (own[i, 0] - part(origin)) for i, part in enumerate(moved)]
                for i, part in enumerate(guesses.applied(found.V, moved, _ORDER + 1)):
                    y[i][key] = arb_poly([c.mid() for c in part.coeffs()])
        return y

    def _rates(
        self, y: Sequence[Mapping[int, arb_poly]], middle: Fraction, r: Fraction, degree: int
    ) -> list[Any]:
        """The terms of f(t, y) up to a degree."""
        ctx.cap = _ORDER
        states = []
        for part in y:
            terms = {k: arb_series(c.coeffs(), _ORDER) for k, c in part.items() if c.degree() >= 0}
            states.append(Series(self._d, degree, terms))
        time = clock(middle, r)(arb_series([0, 1], _ORDER))
        known = [parameter.limited(degree) for parameter in self._parameters]
        return self._check.equations.run_rates([*states, time, *known])

    def _defect(self, middle: Fraction, r: Fraction) -> list[arb]:
        """Bounds on |dy/dx - r f|."""
        y, time, run = self._y, clock(middle, r), self._check.equations.run_rates
        parts = [{key: Polynomial(c.coeffs()) for key, c in part.items()} for part in y]

        def around(places: Sequence[_Near], R: float, shares: Sequence[float]) -> list[list[Any]]:
            known = self._check.parameters(self._discs([R * share for share in shares]))
            return [run([*place.states(R), time(place.x), *known]) for place in places]

        ones, known = [1.0] * self._d, self._exponents

        def rests(shares: Sequence[float]) -> list[arb]:
            with ctx.workprec(COARSE):
                places = [acb((arb(2 * k + 1) + UNIT) / _PARTS - 1) for k in range(_PARTS)]
                real = [_Near(parts, x, known, shares) for x in places]
            return self._beyond(lambda R: around(real, R, shares), shares)

        beyond = rests(ones)
        if self._d > 1:
            beyond = [min(pair) for pair in zip(beyond, rests(self._shares()), strict=True)]
        late = self._late(
            lambda R: around([_Near(parts, x, known, ones) for x in squares(R)], 1, ones), r
        )
        found, size = [], ball(r)
        self._weights = [0.0] * self._d
        for i, rate in enumerate(self._rates(y, middle, r, self._m + _MORE)):
            total = abs(size) * (beyond[i] + late[i])
            for key, nu in self._more.items():
                own = arb_poly(coefficients(term(rate, key), _ORDER)) * size
                amount = _amount(y[i].get(key, arb_poly()).derivative() - own)
                total += amount
                share = float(amount.mid()) / max(float(self._check.bounds[i]), _TINY)
                self._weights = [w + n * share for w, n in zip(self._weights, nu, strict=True)]
            found.append(total.abs_upper())
        return found

    def _beyond(
        self, around: Callable[[float], list[list[Any]]], shares: Sequence[float]
    ) -> list[arb]:
        """Bounds on the sums of the terms of functions with |nu| > n, for |s_k| <= 1.

        - around: R -> values of the functions on sets that cover |s_k| <= R shares[k].
        """
        found = [arb("inf")] * self._dim
        for R in _RADII:
            largest = suprema(around, R)
            if largest is None:
                break
            rest, before = self._rest([R * share for share in shares]), found
            found = [min(a, (M * rest).abs_upper()) for a, M in zip(found, largest, strict=True)]
            if found == before:
                break
        if not all(bound.is_finite() for bound in found):
            raise WideCellError("a function is not smooth there, or changes too fast")
        return found

    def _rest(self, radii: Sequence[float]) -> arb:
        """The sum over |nu| > n of the product of 1 / R_k^nu_k."""
        whole, sums = arb(1), [arb(1), *[arb(0)] * (self._m + _MORE)]
        for R in radii:
            q = 1 / arb(R)
            whole /= 1 - q
            for n in range(self._m + _MORE):
                sums[n + 1] += q * sums[n]
        return (whole - sum(sums, arb(0))).abs_upper()

    def _shares(self) -> list[float]:
        """How much larger discs of an input may be than those of the input that y follows most."""
        weights = [1e-9] * self._d
        for part in self._y:
            for key, nu in self._exponents.items():
                if sum(nu) == 1 and key in part:
                    size = _amount(part[0]) + _amount(part[key])
                    weights[nu.index(1)] += float((_amount(part[key]) / size).mid())
        for k in self._check.places:
            weights[k] += float((self._halves[k] / (abs(self._middles[k]) + self._halves[k])).mid())
        return [min(max(weights) / weight, _MOST_SHARE) for weight in weights]

    def _late(self, around: Callable[[int], list[list[Any]]], r: Fraction) -> list[arb]:
        """Bounds on the sums of the terms with |nu| <= n and too many powers of x."""
        for R in DISCS:
            largest = suprema(around, R)
            if largest is not None:
                share = len(self._more) / (arb(R) ** (_ORDER - 1) * (R - 1))
                found = [M * share for M in largest]
                limits = zip(found, self._check.bounds, self._scales, strict=True)
                if all(abs(ball(r) * a) <= max(_LATE * ball(b), _LEAST * c) for a, b, c in limits):
                    return found
        raise NotProvenError("a function is not smooth there, or changes too fast")

    def _compare(self, step: Step, cuts: Sequence[Fraction]) -> None:
        """Compare the map with the bounds, on the parts of a step in its pieces."""
        sign = 1 if cuts[-1] > cuts[0] else -1
        ends = [sign * (step.middle - step.r), sign * (step.middle + step.r)]
        for number, (a, b) in enumerate(pairwise(sign * cut for cut in cuts)):
            low, high = max(a, ends[0]), min(b, ends[1])
            if low < high:
                self._check.check_time()
                middle, r = sign * (low + high) / 2, sign * (high - low) / 2
                line = step.line(middle, r)
                pieces = self._map.states(number, middle, r)
                pairs = zip(pieces, self._y, step.tube, self._check.bounds, strict=True)
                for i, (piece, part, distance, bound) in enumerate(pairs):
                    gap = piece - self._map.matrix(part, line)
                    self._map.space.require_below(gap, ball(bound), distance, self._check.names[i])

    def axis(self, box: Box) -> int:
        """The input that the defect is due to, else that with the largest part of its interval."""
        lengths = [
            float((high - low) / (most - least)) if most > least else 0.0
            for (low, high), (least, most) in zip(self._cell, box, strict=True)
        ]
        unit = _LEAST * sum(self._weights) + _TINY
        weights = [w + unit * part for w, part in zip(self._weights, lengths, strict=True)]
        return max(range(self._d), key=weights.__getitem__)


class _Near:
    """The values of y for a set of x and |s_k| <= R shares[k]."""

    def __init__(
        self,
        y: Sequence[Mapping[int, Polynomial]],
        x: acb,
        exponents: Mapping[int, tuple[int, ...]],
        shares: Sequence[float],
    ) -> None:
        self.x, self._rows = x, []
        powers = [[arb(share) ** n for n in range(_MOST + 1)] for share in shares]
        for part in y:
            sizes = [arb(0)] * (_MOST + 1)
            for key, c in part.items():
                nu = exponents[key]
                size = math.prod((powers[k][n] for k, n in enumerate(nu) if n), start=arb(1))
                sizes[sum(nu)] += size * abs(c(x)).abs_upper()
            self._rows.append((part[0](x), sizes[1:]))

    def states(self, R: float) -> list[acb]:
        powers = [arb(R) ** n for n in range(1, _MOST + 1)]
        return [
            _disc(middle, sum((a * b for a, b in zip(sizes, powers, strict=True)), arb(0)))
            for middle, sizes in self._rows
        ]


def _disc(middle: acb, radius: arb) -> acb:
    return middle + acb(UNIT * radius, UNIT * radius)


def _amount(part: arb_poly) -> arb:
    """The sum of the sizes of the coefficients."""
    return sum(map(abs, part.coeffs()), arb(0))


def _at(part: Mapping[int, arb_poly], key: int, x: int) -> arb:
    return part[key](arb(x)) if key in part else arb(0)


def _range_of(part: Mapping[int, arb_poly]) -> list[arb]:
    """The coefficients of a polynomial in x, for all s."""
    count = _ORDER + 1
    found = coefficients(part[0], count)
    for key, c in part.items():
        if key:
            found = [a + UNIT * abs(b) for a, b in zip(found, coefficients(c, count), strict=True)]
    return found
