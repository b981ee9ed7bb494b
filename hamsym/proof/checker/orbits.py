"""Periodic orbits: existence, a bound on their distance from computed states, and stability.

The unknowns are the state at the start and the time s of an arc, after which a symmetry closes the
orbit. With s as a further component of the state, dz/dx = s f(z) and ds/dx = 0 for 0 <= x <= 1, so
that one enclosure of the flow contains all derivatives. The conditions F = 0 are

- z(1) = S z(0), for a symplectic S that keeps H; or z(0) = R z(0) and z(1) = R' z(1) for two maps
  that keep H and reverse time. The period is as many arcs as maps give the identity;
- z(0) in the plane across the flow through the computed start, unless time is reversed;
- the energy or the period that is given, if H is conserved. Then one component of z(1) = S z(0) is
  left out: H has the same value on both sides, and all others are equal, so that this one is equal
  where its derivative of H does not vanish in between.

For a box X around x, K = x - C F(x) + (1 - C DF(X)) (X - x) is in the interior of X only if X
contains exactly one zero of F (Krawczyk 1969).

Another orbit within a distance of this one, at several places of the arc, would be another zero of
the equations for the states at all of these. So there is none if the matrix B of these equations,
averaged on the way to any state within the distance, is regular: if |1 - C B| v < v for a C and a
v > 0.

The derivative N over one shift has the multiplier 1, by the flow; the others come in pairs m, 1/m
if H is conserved, so that 1 is a double one. Without these its characteristic polynomial is one of
m + 1/m, whose roots are isolated: pairs are on the unit circle where it is real and below 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, arb_mat, arb_poly, ctx, fmpz_mat

from hamsym.proof.checker.formulas import FalseClaimError, NotProvenError, attempt, ball
from hamsym.proof.checker.functions import (
    UNIT,
    Equations,
    column,
    identity,
    inverse,
    krawczyk,
    roots,
    sizes,
)
from hamsym.proof.checker.guesses import Effort
from hamsym.proof.checker.invariants import vanishes
from hamsym.proof.checker.motion import Step, steps

# Bits, and what is done for the orbit and for its distance from others.
_SHORTEST = Fraction(1, 2**13)
_ATTEMPTS = (
    (256, Effort(58, 2.0**-188, 34), Effort(14, 2.0**-70, 12, _SHORTEST, 4)),
    (420, Effort(96, 2.0**-312, 60), Effort(20, 2.0**-110, 18, _SHORTEST, 12)),
)
# Of the box, and of the part of it in which the orbit is, relative to the sizes of components.
_RADIUS, _NARROW = arb(2) ** -90, arb(2) ** -96
_NEWTON = 5  # boxes that are tried
# Bits, the least distance, and the largest power of a matrix, for distances from other orbits.
_BITS, _LEAST, _POWERS = 128, arb(2) ** -60, 60
_KINDS = {
    "elliptic": {"circle"}, "hyperbolic": {"real"}, "mixed": {"circle", "real"},
    "complex unstable": {"complex"}, "attracting": {"inside"}, "repelling": {"outside"},
}  # fmt: skip


def check_orbit(
    H: Mapping[str, Any],
    orbit: Mapping[str, Any],
    claims: Mapping[str, Any],
    check_time: Callable[[], None],
) -> None:
    """Prove the claims of the certificate of a periodic orbit; raise NotProvenError if one fails.

    - H: See :class:`Equations`.
    - orbit: "shift", the map S as (places, signs) of components, and "reversing", none or two such
      maps, with S the second one after the first; "energy", or "period" as "formula" and "floats",
      or none; "edges" and "ends", fractions of the arc and states there; the
      "sizes" of the components to which the bound is relative.
    - claims: The values of its JSON, each exactly. Its pieces start at the first of the edges, and
      at others that are chosen here.
    """

    def proof(effort: Effort, rough: Effort) -> None:
        found = _Orbit(H, orbit, check_time)
        _Check(found, orbit, claims, found.proven(claims, effort)).run(rough)

    attempt(_ATTEMPTS, proof)


# -- maps, as matrices ----------------------------------------------------------------------------


def _map(places: Sequence[int], signs: Sequence[int]) -> fmpz_mat:
    """(S z)_i = signs_i z_(places_i)."""
    rows = [[0] * len(places) for _ in places]
    for row, place, sign in zip(rows, places, signs, strict=True):
        row[place] = sign
    S = fmpz_mat(rows)
    if not (S * S.transpose()).is_one():
        raise NotProvenError("the symmetry of the orbit is no permutation with signs")
    return S


def _poisson(dim: int) -> fmpz_mat:
    """J, with dz/dt = J grad H."""
    half, n = dim // 2, range(dim)
    return fmpz_mat([[(j == i + half) - (i == j + half) for j in n] for i in n])


def _direction(S: fmpz_mat) -> int:
    """1 if a map is canonical, -1 if it reverses time."""
    J = _poisson(S.nrows())
    moved = S * J * S.transpose()
    if moved not in (J, -J):
        raise NotProvenError("the symmetry of the orbit is not canonical")
    return 1 if moved == J else -1


def _space(S: fmpz_mat, sign: int) -> list[list[int]]:
    """A basis of all z with S z = sign z, of an involution, one in a row."""
    rows = [[int(v) for v in row] for row in S.tolist()]
    chosen = [i for i, row in enumerate(rows) if row[i] == sign or any(row[i + 1 :])]
    return [[1 if j == i else sign * v for j, v in enumerate(rows[i])] for i in chosen]


def _keeps(S: fmpz_mat, equations: Equations) -> bool:
    """Whether H is the same function after a map."""
    formulas, images = equations.formulas, {}
    for i, row in enumerate(S.tolist()):
        ((place, sign),) = [(j, int(v)) for j, v in enumerate(row) if v != 0]
        images[i] = formulas.multiply(formulas.number(sign), formulas.variable(place))
    moved = formulas.replaced(equations.energy, images)
    return vanishes(formulas, formulas.add(equations.energy, formulas.negative(moved)))


#: Matrices L, M of conditions L z(1) = M z(0).
_Closing = tuple[arb_mat, arb_mat]


@dataclass(frozen=True)
class _Proof:
    """A box with exactly one orbit, around a centre.

    - steps, DZ: From the centre, and the derivatives of all orbits from the box at their end.
    """

    box: list[arb]
    centre: list[arb]
    steps: list[Step]
    DZ: arb_mat
    closing: _Closing


class _Orbit:
    """The conditions of an orbit."""

    def __init__(
        self, H: Mapping[str, Any], orbit: Mapping[str, Any], check_time: Callable[[], None]
    ) -> None:
        equations = self.equations = Equations(H, timed=True)
        self._check_time, dim = check_time, len(equations.names)
        if not equations.autonomous:
            raise NotProvenError("orbits of an H or of forces with explicit time are not covered")
        self.shift, self.reversing = _map(*orbit["shift"]), orbit["reversing"]
        maps, order = [self.shift], 1
        if self.reversing is not None:
            first, last = self.reversing = maps = [_map(*each) for each in self.reversing]
            fits = all((each * each).is_one() and _direction(each) == -1 for each in maps)
            if not fits or last * first != self.shift:
                raise NotProvenError("the symmetries of the orbit do not close it")
        if self.shift.nrows() != dim or _direction(self.shift) != 1:
            raise NotProvenError("the symmetries of the orbit do not close it")
        while not (self.shift**order).is_one():
            order += 1
        #: Arcs in a period.
        self.parts = order * len(maps)
        if self.parts > 1 and not equations.conserved:
            raise NotProvenError("orbits with forces and a symmetry are not covered")
        if not all(each.is_one() or _keeps(each, equations) for each in maps):
            raise NotProvenError("that H is the same after the symmetry of the orbit is not proven")
        energy, period = orbit["energy"], orbit["period"]
        self._energy = None if energy is None else ball(energy)
        self.period = None
        if period is not None:
            run = equations.formulas.program([equations.formulas.read(period)])
            (self.period,) = run([None] * (dim + 2))
        if equations.conserved != ((energy is None) != (period is None)):
            raise NotProvenError("the orbit has no energy and no period that isolate it")
        self.sizes = [ball(size) for size in orbit["sizes"]]
        self.start = [ball(value) for value in orbit["ends"][0]]
        if len(self.sizes) != dim or not all(size > 0 for size in self.sizes):
            raise NotProvenError("the sizes of the components are none")
        basis = identity(dim).tolist() if self.reversing is None else _space(first, 1)
        self._basis = arb_mat(basis).transpose()
        #: The component that is each unknown, and the smaller one of a pair that moves together.
        self.own = [next(i for i, v in enumerate(row) if v != 0) for row in basis]
        moving = [[s for v, s in zip(row, self.sizes, strict=True) if v != 0] for row in basis]
        self.units = [min(each) for each in moving]
        self._slopes = equations.formulas.program(equations.slopes[:dim])

    def field(self, state: Sequence[arb]) -> list[arb]:
        return self.equations.run_rates([*state, arb(1), arb(0)])[:-1]

    def _gradient(self, state: Sequence[arb]) -> list[arb]:
        if not self.equations.run_energy([*state, arb(1), arb(0)])[0].is_finite():
            raise NotProvenError("H is not smooth where the orbit closes")
        return self._slopes([*state, arb(1), arb(0)])

    def states(self, unknowns: Sequence[arb]) -> list[arb]:
        """The state at the start, and the time of the arc."""
        *own, s = unknowns
        return [*(self._basis * column(own)).entries(), s]

    # -- existence ----------------------------------------------------------------------------

    def proven(self, claims: Mapping[str, Any], effort: Effort) -> _Proof:
        """Prove that there is an orbit near the claimed one."""
        middle, s = [ball(float(v)) for v in claims["z0"][0]], ball(float(claims["period"][0]))
        if len(middle) != len(self.sizes) or not s > 0:
            raise NotProvenError("the start of the orbit or its period is none")
        centre = [*(middle[i] for i in self.own), (s / self.parts).mid()]
        units, proven = [*self.units, s / self.parts], None
        for _ in range(_NEWTON):
            around = [(unit * _RADIUS).abs_upper() * UNIT for unit in units]
            box = [c + each for c, each in zip(centre, around, strict=True)]
            radii = [value.abs_upper() for value in self.states(around)]
            found = self.steps(self.states(centre), (0, 1), effort, radii)
            last, DZ, starts = found[-1], found[-1].derivative(), self.states(box)[:-1]
            closing = self._closing(last.states(arb(1), radii)[:-1], starts)
            end = last.states(arb(1), [arb(0)] * len(radii))
            values = self._values(closing, self.states(centre), end)
            image = krawczyk(centre, box, values, self.matrix(closing, [DZ], starts))
            near = [abs(a - c) for a, c in zip(image, centre, strict=True)]
            if all(b.contains_interior(a) for a, b in zip(image, box, strict=True)):
                proven = _Proof(image, centre, found, DZ, closing)
                if all(a < unit * _NARROW for a, unit in zip(near, units, strict=True)):
                    break
            centre = [value.mid() for value in image]
            if not all(value.is_finite() for value in centre) or not centre[-1] > 0:
                break
        if proven is None:
            raise NotProvenError("no box around the orbit is mapped into itself")
        return proven

    def steps(
        self, state: Sequence[arb], span: Sequence[Any], effort: Effort, radii: Sequence[arb]
    ) -> list[Step]:
        """Steps around a state and the time of the arc, on a part of it."""
        return [*steps(self.equations, state, span, effort, self._check_time, radii)]

    def _closing(self, end: Sequence[arb], start: Sequence[arb]) -> _Closing:
        """The conditions of boxes of states."""
        units = identity(len(start)).tolist()
        if self.reversing is not None:
            conditions = arb_mat(_space(self.reversing[1], -1))
            return conditions, 0 * conditions
        if self.equations.conserved:  # one is implied, between both states
            turned = (arb_mat(self.shift) * column(start)).entries()
            slopes = self._gradient([x.union(y) for x, y in zip(end, turned, strict=True)])
            shares = [abs(v).abs_lower() * size for v, size in zip(slopes, self.sizes, strict=True)]
            k = max(range(len(shares)), key=lambda i: shares[i].mid())
            if not shares[k] > 0:
                raise NotProvenError("H may be stationary where the orbit closes")
            del units[k]
        return arb_mat(units), arb_mat(units) * arb_mat(self.shift)

    def _plane(self) -> list[arb]:
        field = self.field(self.start)
        return [f / size**2 for f, size in zip(field, self.sizes, strict=True)]

    def _values(self, closing: _Closing, start: list[arb], end: list[arb]) -> arb_mat:
        """F of a solution."""
        *start, s = start
        values = (closing[0] * column(end[:-1]) - closing[1] * column(start)).entries()
        if self.reversing is None:
            apart = [a - b for a, b in zip(start, self.start, strict=True)]
            values += (arb_mat([self._plane()]) * column(apart)).entries()
        if self.period is not None:
            values.append(s * self.parts - self.period)
        elif self._energy is not None:
            values.append(self.equations.run_energy([*start, arb(1), arb(0)])[0] - self._energy)
        return column(values)

    def matrix(self, closing: _Closing, maps: Sequence[arb_mat], starts: Sequence[arb]) -> arb_mat:
        """DF, by the states at the starts of pieces, the first one in the basis, and by the time.

        - maps: Derivatives of the states at the ends of the pieces, and of the time.
        - starts: A box of states at the start.
        """
        dim, first = len(self.sizes), self._basis.ncols()
        count = first + (len(maps) - 1) * dim + 1
        table, top, left = [[arb(0)] * count for _ in range(count)], 0, 0

        def add(column: int, matrix: arb_mat) -> None:
            for i, row in enumerate(matrix.tolist()):
                for j, value in enumerate(row):
                    table[top + i][column + j] += value

        for k, DZ in enumerate(maps):
            by_state = arb_mat([row[:dim] for row in DZ.tolist()[:dim]])
            by_time = column([row[dim] for row in DZ.tolist()[:dim]])
            if k == 0:
                by_state *= self._basis
            if k == len(maps) - 1:
                by_state, by_time = closing[0] * by_state, closing[0] * by_time
                add(0, -closing[1] * self._basis)
            else:
                add(left + by_state.ncols(), -identity(dim))
            add(left, by_state)
            add(count - 1, by_time)
            top, left = top + by_state.nrows(), left + by_state.ncols()
        if self.reversing is None:
            add(0, arb_mat([self._plane()]) * self._basis)
            top += 1
        if self.period is not None:
            add(count - 1, arb_mat([[self.parts]]))
        elif self._energy is not None:
            add(0, arb_mat([self._gradient(starts)]) * self._basis)
        return arb_mat(table)


# -- claims ---------------------------------------------------------------------------------------


class _Check:
    """The claims about the only orbit in a box."""

    def __init__(
        self,
        found: _Orbit,
        orbit: Mapping[str, Any],
        claims: Mapping[str, Any],
        proof: _Proof,
    ) -> None:
        self._orbit, self._claims, self._proof = found, claims, proof
        self._edges, self._ends = [Fraction(edge) for edge in orbit["edges"]], orbit["ends"]
        apart = zip(proof.box, proof.centre, strict=True)
        near = [(a - c).abs_upper() * UNIT for a, c in apart]
        #: Of the orbit around the solution from the centre.
        self._radii = [abs(value).abs_upper() for value in found.states(near)]
        *self._start, self._s = found.states(proof.box)
        dim = len(self._start)
        through = arb_mat([row[:dim] for row in proof.DZ.tolist()[:dim]])
        if found.reversing is None:
            self._shift = arb_mat(found.shift.transpose()) * through
        else:
            J, first, last = map(arb_mat, (_poisson(dim), *found.reversing))
            self._shift = first * (-J * through.transpose() * J) * last * through

    def run(self, effort: Effort) -> None:
        """Require every claim about the orbit.

        - effort: For its distance from others.
        """
        orbit, claims = self._orbit, self._claims
        period = self._s * orbit.parts if orbit.period is None else orbit.period
        field = orbit.field(self._start)
        if not self._s > 0 or not any(value > 0 or value < 0 for value in field):
            raise NotProvenError("the orbit may be an equilibrium")
        if [*claims["components"]] != orbit.equations.names:
            raise NotProvenError("the certificate has other components")
        self._require("start", self._start, *claims["z0"])
        self._require("period", [period], *([value] for value in claims["period"]))
        flat = [[v for row in part for v in row] for part in claims["monodromy"]]
        self._require("derivative over one shift", self._shift.entries(), *flat)
        self._require_bound()
        self._require_word(claims["stability"])
        if not claims["unique_within"] >= 0:
            raise FalseClaimError("its distance from other orbits is none")
        try:
            with ctx.workprec(_BITS):
                self._require_unique(ball(claims["unique_within"]), effort)
        except NotProvenError as error:
            text = f"its distance from other orbits is not proven: {error}"
            raise NotProvenError(text) from None

    def _require(
        self, name: str, found: list[arb], middle: Sequence[float], radius: Sequence[float]
    ) -> None:
        for value, m, r in zip(found, middle, radius, strict=True):
            if not math.isfinite(m) or not r >= 0:
                raise FalseClaimError(f"its claim about the {name} is none")
            if r < math.inf and abs(value - ball(m)) > ball(r):
                raise FalseClaimError(f"its claim about the {name} is false")
            if not (r == math.inf or abs(value - ball(m)) <= ball(r)):
                raise NotProvenError(f"its claim about the {name} is not proven")

    def _require_bound(self) -> None:
        """The bound holds at the start and at as many places in the arc as it says."""
        bound, pieces, edges = self._claims["bound"], self._claims["pieces"], self._edges
        rising = edges[0] == 0 and edges[-1] == 1 and edges == sorted({*edges})
        if not bound >= 0 or not rising or not 1 <= pieces < len(edges):
            raise FalseClaimError("its bound, its number of pieces or their edges are none")
        limit = arb(bound)  # which may be infinite

        def gaps(state: Sequence[arb], other: Sequence[float]) -> list[arb]:
            rows = zip(state, other, self._orbit.sizes, strict=True)
            return [abs(value - ball(v)) / size for value, v, size in rows]

        start = gaps(self._start, self._ends[0])
        if any(gap > limit for gap in start):
            raise FalseClaimError("its bound on the distance from the computed start is false")
        if not all(gap <= limit for gap in start):
            raise NotProvenError("its bound on the distance from the computed start is not proven")
        pairs = zip(edges, self._ends, strict=True)
        held = [all(gap <= limit for gap in gaps(self._at(edge), end)) for edge, end in pairs]
        if not (held[0] and sum(held[:-1]) >= pieces):
            raise NotProvenError("its bound on the distance from the computed states is not proven")

    def _at(self, edge: Fraction) -> list[arb]:
        """The state of the orbit at a fraction of the arc."""
        step = next(step for step in self._proof.steps if step.part.middle + step.part.r >= edge)
        x = ball((edge - step.part.middle) / step.part.r)
        return step.states(x, self._radii)[:-1]

    def _require_unique(self, within: arb, effort: Effort) -> None:
        """No other orbit is within a distance at the starts of all pieces, and in the period."""
        orbit, pieces, edges = self._orbit, self._claims["pieces"], self._edges
        within = within.max(_LEAST) * 64 / 63
        places = [edges[k * (len(edges) - 1) // pieces] for k in range(pieces + 1)]
        units = [*orbit.units, *orbit.sizes * (pieces - 1), self._s.mid()]
        start = orbit.states([unit * within * UNIT for unit in (*orbit.units, self._s.mid())])
        maps: list[arb_mat] = []
        for k in range(pieces):
            near = [*(self._at(places[k]) if k else self._start), self._s]
            radii = [(size * within).abs_upper() for size in (*orbit.sizes, self._s.mid())]
            if k == 0:
                radii = [value.abs_upper() for value in start]
            middle = [value.mid() for value in near]
            rows = zip(near, middle, radii, strict=True)
            if not all(abs(a - b) * 64 <= radius for a, b, radius in rows):
                raise NotProvenError("the orbit is not known so well")
            found = orbit.steps(middle, places[k : k + 2], effort, radii)
            maps.append(found[-1].derivative())
        box = [a + b for a, b in zip(self._start, start, strict=False)]
        whole = orbit.matrix(self._proof.closing, maps, box)
        whole = arb_mat([[v * u for v, u in zip(r, units, strict=True)] for r in whole.tolist()])
        rest = sizes(identity(len(units)) - inverse(whole) * whole)
        v = column([arb(1)] * len(units))
        for _ in range(_POWERS):
            moved = rest * v
            if all(a < b for a, b in zip(moved.entries(), v.entries(), strict=True)):
                return
            largest = max(moved.entries())
            v = column([(value / largest + 2.0**-20).mid() for value in moved.entries()])
        raise NotProvenError("the equations may be singular")

    # -- stability ----------------------------------------------------------------------------

    def _require_word(self, word: str) -> None:
        if word == "undecided":
            return
        kinds = self._kinds()
        if word == "parabolic":
            rest = self._shift - identity(self._shift.nrows())
            holds = not kinds and any(value > 0 or value < 0 for value in rest.entries())
        elif word == "unstable":
            holds = bool({*kinds} & {"real", "complex", "outside"})
        else:
            holds = {*kinds} == _KINDS.get(word)
            holds = holds and (word != "complex unstable" or len(kinds) == 2)
        if not holds:
            raise NotProvenError(f"its claim that the orbit is {word} is not proven")

    def _kinds(self) -> list[str]:
        """A word for each pair of multipliers, or for each multiplier with forces."""
        sizes, dim = self._orbit.sizes, len(self._start)
        scaled = [
            [value * b / a for value, b in zip(row, sizes, strict=True)]
            for row, a in zip(self._shift.tolist(), sizes, strict=True)
        ]
        left = arb_mat(scaled).charpoly().coeffs()
        conserved = self._orbit.equations.conserved
        for _ in range(2 if conserved else 1):  # without the factor m - 1, which it has
            for k in range(len(left) - 2, 0, -1):
                left[k] += left[k + 1]
            left = left[1:]
        if not conserved:
            return ["inside" if abs(m) < 1 else "outside" if abs(m) > 1 else "?"
                    for m, _ in roots(arb_poly(left))]  # fmt: skip
        n = dim // 2 - 1
        powers = [arb_poly([2]), arb_poly([0, 1])]  # m^j + m^-j in terms of m + 1/m
        for _ in range(n - 1):
            powers.append(arb_poly([0, 1]) * powers[-1] - powers[-2])
        terms = [left[n + j] * powers[j] for j in range(1, n + 1)]
        words = []
        for value, real in roots(sum(terms, arb_poly([left[n]]))):
            size = abs(value.real)
            word = "circle" if size < 2 else "real" if size > 2 else "?"
            words.append(word if real else "?" if real is None else "complex")
        return words
