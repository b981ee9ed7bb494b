"""Certificates of flow maps: the bound of each component is proven again, or refused.

The box is cut into cells, inputs = middle + half s with |s_k| <= 1. On a step t = m + r x of a cell
the solutions from all its starts are near one polynomial y(x, s), by the lemma of
:mod:`hamsym.proof.checker.motion` for each s: V and W are the same, D and A are bounded over all s.
The map is a polynomial in x and s, too. Its difference from y, in products of Chebyshev
polynomials, is compared with the bound, on parts of the step and of the cell.

Functions g of (x, s) are known by their terms with |nu| <= n and less than m powers of x. To these,
g differs at most by what is left of its series in x, for any s, and by Lagrange's theorem by

    sum over k < m, |nu| = n + 1 of |c|,    c the coefficients of x^k (s - a)^nu, for any a

in the cell. Cells without a proof are halved.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise, product
from typing import Any

from flint import arb, arb_poly, arb_series, ctx

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
    UNIT,
    Equations,
    Interval,
    Polynomial,
    coefficients,
    expanded,
)
from hamsym.proof.checker.guesses import Effort, Guess
from hamsym.proof.checker.map_polynomials import LegOnCell
from hamsym.proof.checker.motion import Step, march, proven
from hamsym.proof.checker.series import Series, exponents, term

_BITS, _ORDER = 128, 24
_EFFORT = Effort(_ORDER, 2.0**-60, _ORDER, Fraction(1, 2**20))
_PRODUCTS, _MOST = 1_001, 12  # of terms in a product of series; their largest degree
_MORE = 2  # degrees in s of dy/dx, above those of y
_SHARE = 4  # of a bound, that the distance of y from the solution may be at most
# Share of a bound, and of the states, that powers of x left out of a step may be.
_LATE, _LEAST = 2.0**-14, 2.0**-52
_TINY = 1e-300
_DEEPEST = 12  # halvings of cells
_TRIES = 4  # steps of one cell that are too long, one after the other

Box = tuple[tuple[Fraction, Fraction], ...]
#: Polynomials in x by the number of nu.
Terms = dict[int, arb_poly]


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
    with refusing_other_forms(_BITS):
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
        #: Inputs that are parameters.
        self._free = [name for name in self._inputs if name not in self.names]
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
        components = [self._start_of(name) for name in (*self.names, *self._free)]
        #: z0 as a function of the inputs.
        self.start = lambda inputs: [component(inputs) for component in components]

    def _start_of(self, name: str) -> Callable[[Sequence[Any]], Any]:
        """A component of z0 as a function of the inputs."""
        if name in self._inputs:
            k = self._inputs.index(name)
            return lambda values: values[k]
        if name in self._flow["fixed"]:
            number = ball(Fraction(self._flow["fixed"][name]))
            return lambda values: number
        formulas, others = self.equations.formulas, [arb("nan")] * len(self.names)
        run = formulas.program([formulas.read(self._flow["expressions"][name])])
        places = [self._inputs.index(name) for name in self._free]
        return lambda values: run([*others, *(values[k] for k in places), arb("nan")])[0]

    def run(self) -> None:
        r = (self.span[1] - self.span[0]) / 4
        for leg, box in _regions(self._flow["map"], self._box):
            cuts, waiting = _cuts(leg, self.span), [(box, 0)]
            while waiting:
                cell, depth = waiting.pop()
                proof = _Cell(self, leg, cell)
                try:
                    r = proof.run(cuts, r)
                except FalseClaimError:
                    raise
                except (NotProvenError, _WideCellError) as error:
                    if depth == _DEEPEST:
                        raise NotProvenError(f"{error}, in a small part of the box") from None
                    k = proof.axis(box)
                    low, high = cell[k]
                    for half in ((low, (low + high) / 2), ((low + high) / 2, high)):
                        waiting.append(((*cell[:k], half, *cell[k + 1 :]), depth + 1))


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


class _WideCellError(Exception):
    """There is no proof on a cell, for which shorter steps are no remedy."""


class _Cell:
    """The proof on a cell."""

    def __init__(self, check: _Check, leg: Mapping[str, Any], cell: Box) -> None:
        self._check, self._cell, self._dim = check, cell, check.equations.dim
        self._middles = [ball((low + high) / 2) for low, high in cell]
        self._halves = [ball((high - low) / 2) for low, high in cell]
        self._d, self._m = len(cell), check.degree
        self._n = self._m + _MORE  # degree of f in s
        self._exponents = exponents(self._d, self._n + 1)
        self._map = LegOnCell(leg, self._inputs, self._m, _ORDER)
        self._failed, self._weights = 0, [0.0] * self._d

    def _inputs(self, degree: int, around: arb | int = 0) -> list[Series]:
        """The inputs as functions of s - a, a in a ball."""
        pairs = enumerate(zip(self._middles, self._halves, strict=True))
        return [Series.line(self._d, degree, a + b * around, {k: b}) for k, (a, b) in pairs]

    def run(self, cuts: Sequence[Fraction], r: Fraction) -> Fraction:
        """Prove the bounds on the cell; return half of its longest step.

        - cuts: Times at which pieces of the map end.
        - r: Half of the first step.
        """
        check, starts = self._check, self._check.start(self._inputs(self._n))
        keys, last = self._keys(self._n), self._keys(self._n + 1, self._n + 1)
        self._ends = [{key: arb(term(start, key)) for key in keys} for start in starts]
        rests = check.start(self._inputs(self._n + 1, UNIT))
        self._loose = [sum((abs(term(value, key)) for key in last), arb(0)) for value in rests]
        self._step = Step.at([ends[0] for ends in self._ends])
        self._y: list[Terms] = [{0: each.real} for each in self._step.y]
        self._scales, longest = [abs(ends[0]) for ends in self._ends], Fraction(0)
        for step in march(check.span, r, _EFFORT.shortest, self._attempt, check.check_time):
            self._compare(step, cuts)
            longest = max(longest, step.part.r, key=abs)
        return longest

    def _keys(self, *degrees: int) -> list[int]:
        """Numbers of nu up to a degree, or between two."""
        low, high = degrees if len(degrees) > 1 else (0, *degrees)
        return [key for key, nu in self._exponents.items() if low <= sum(nu) <= high]

    def _attempt(self, part: Interval) -> tuple[Step, float]:
        """Prove a step."""
        z, bounds = [ends[0].mid() for ends in self._ends], self._check.bounds
        line, equations = self._step.part.line(part), self._check.equations
        near = [each[0](line) for each in self._y]
        found = guesses.guess(equations, z, near, part, _EFFORT, self._scales)
        y = self._family(found)
        ranges = [Polynomial(_range_of(each)) for each in y]
        wide = Guess(part, ranges, found.V, found.W, found.factor)
        try:
            D, gap = self._defect(y, wide), []
            for each, ends, loose in zip(y, self._ends, self._loose, strict=True):
                gap.append(sum((abs(end - _at(each, key, -1)) for key, end in ends.items()), loose))
            step = proven(equations, self._step, wide, D, gap)
        except NotProvenError as error:
            self._failed += 1
            if self._failed == _TRIES:
                raise _WideCellError(str(error)) from None
            raise
        if not all(_SHARE * gap <= ball(b) for gap, b in zip(step.tube, bounds, strict=False)):
            raise _WideCellError("no polynomial is near enough to the solutions")
        self._failed, self._step, self._y = 0, step, y
        self._ends = [{key: _at(each, key, 1) for key in self._keys(self._m)} for each in y]
        self._loose = [arb(0)] * self._dim
        return step, found.factor

    def _family(self, found: Guess) -> list[Terms]:
        """y of a step, degree by degree: with A = r Df for s = 0, dy_nu/dx = A y_nu + g_nu."""
        y = [{0: each.real} for each in found.y]
        for degree in range(1, self._m + 1):
            rates = self._rates(y, found.part, degree)
            for key in self._keys(degree, degree):
                ends = [ends[key] for ends in self._ends]
                g = [arb_poly(coefficients(term(rate, key), _ORDER)) for rate in rates]
                if any(part.degree() >= 0 for part in g) or any(end != 0 for end in ends):
                    g = [part * ball(found.part.r) for part in g]
                    own = guesses.along(found.V, found.W, g, ends, _ORDER)
                    for terms, each in zip(y, own, strict=True):
                        terms[key] = arb_poly([c.mid() for c in each.coeffs()])
        return y

    def _rates(self, y: Sequence[Terms], part: Interval, degree: int) -> list[Any]:
        """The terms of f(t, y) up to a degree."""
        ctx.cap, states = _ORDER, []
        for terms in y:
            series = {k: arb_series(c.coeffs(), _ORDER) for k, c in terms.items()}
            states.append(Series(self._d, degree, {k: c for k, c in series.items() if len(c)}))
        return self._check.equations.run_rates([*states, part.time(arb_series([0, 1], _ORDER))])

    def _defect(self, y: Sequence[Terms], wide: Guess) -> list[arb]:
        """Bounds on |dy/dx - r f|."""
        run, part, size, found = self._check.equations.run_rates, wide.part, ball(wide.part.r), []
        bounds = [*map(float, self._check.bounds), *[math.inf] * self._dim]
        late = expanded(lambda x: run([*(each(x) for each in wide.y), part.time(x)]), _ORDER)
        with ctx.workprec(COARSE):
            last = self._rates([self._around(terms) for terms in y], part, self._n + 1)
        self._weights = [0.0] * self._d
        for i, rate in enumerate(self._rates(y, part, self._n)):
            total = abs(size) * late[i].rest()
            if not (total <= _LATE * bounds[i] or total <= _LEAST * self._scales[i]):
                raise NotProvenError("a function changes too fast")
            for key, nu in self._exponents.items():
                value = term(rate if sum(nu) <= self._n else last[i], key)
                own = arb_poly(coefficients(value, _ORDER)) * size
                amount = _amount(y[i].get(key, arb_poly()).derivative() - own)
                total += amount
                share = float(amount.mid()) / max(bounds[i], _TINY)
                self._weights = [w + n * share for w, n in zip(self._weights, nu, strict=True)]
            found.append(total.abs_upper())
        return found

    def _around(self, terms: Terms) -> Terms:
        """The terms of a polynomial in s - a, for any a in the cell."""
        numbers = {nu: key for key, nu in self._exponents.items()}
        found = dict.fromkeys(terms, arb_poly())
        for key, c in terms.items():
            nu = self._exponents[key]
            for mu in product(*(range(n + 1) for n in nu)):
                factor = arb(math.prod(map(math.comb, nu, mu))) * (1 if mu == nu else UNIT)
                found[numbers[mu]] = found.get(numbers[mu], arb_poly()) + c * factor
        return found

    def _compare(self, step: Step, cuts: Sequence[Fraction]) -> None:
        """Compare the map with the bounds, on the parts of a step in its pieces."""
        sign = 1 if cuts[-1] > cuts[0] else -1
        ends = [sign * (step.part.middle - step.part.r), sign * (step.part.middle + step.part.r)]
        for number, (a, b) in enumerate(pairwise(sign * cut for cut in cuts)):
            low, high = max(a, ends[0]), min(b, ends[1])
            if low < high:
                self._check.check_time()
                part = Interval(sign * (low + high) / 2, sign * (high - low) / 2)
                pieces, line = self._map.states(number, part), step.part.line(part)
                pairs = zip(pieces, self._y, step.tube, self._check.bounds, strict=False)
                for i, (piece, terms, distance, bound) in enumerate(pairs):
                    gap = piece - self._map.matrix(terms, line)
                    name = f"the error of {self._check.names[i]}"
                    self._map.space.require_below(gap, ball(bound), distance, name)

    def axis(self, box: Box) -> int:
        """The input that the defect is due to, else that with the largest part of its interval."""
        lengths = [
            float((high - low) / (most - least)) if most > least else 0.0
            for (low, high), (least, most) in zip(self._cell, box, strict=True)
        ]
        unit = _LEAST * sum(self._weights) + _TINY
        weights = [w + unit * part for w, part in zip(self._weights, lengths, strict=True)]
        return max(range(self._d), key=weights.__getitem__)


def _amount(part: arb_poly) -> arb:
    """The sum of the sizes of the coefficients."""
    return sum(map(abs, part.coeffs()), arb(0))


def _at(part: Terms, key: int, x: int) -> arb:
    return part[key](arb(x)) if key in part else arb(0)


def _range_of(part: Terms) -> list[arb]:
    """The coefficients of a polynomial in x, for all s."""
    count = _ORDER + 1
    found = coefficients(part[0], count)
    for key, c in part.items():
        if key:
            found = [a + UNIT * abs(b) for a, b in zip(found, coefficients(c, count), strict=True)]
    return found
