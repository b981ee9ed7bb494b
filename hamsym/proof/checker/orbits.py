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

The derivative N over one shift has the multiplier 1, by the flow; the others come in pairs m, 1/m
if H is conserved, so that 1 is a double one. Without these its characteristic polynomial is one of
m + 1/m, whose roots are isolated: pairs are on the unit circle where it is real and below 2.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from typing import Any

from flint import acb, acb_poly, arb, arb_mat, arb_poly, ctx

from hamsym.proof.checker.formulas import (
    FalseClaimError,
    Formulas,
    NotProvenError,
    ball,
    refusing_other_forms,
)
from hamsym.proof.checker.functions import UNIT, Equations, column, exact_numbers, identity
from hamsym.proof.checker.invariants import vanishes
from hamsym.proof.checker.motion import Step, steps

# Bits, Taylor coefficients, the size of the last ones, and those of derivatives, of attempts.
_ATTEMPTS = ((256, 58, 2.0**-188, 34), (420, 96, 2.0**-312, 60))
# Of the box, and of the part of it in which the orbit is, relative to the sizes of components.
_RADIUS, _NARROW = arb(2) ** -90, arb(2) ** -96
_NEWTON = 5  # boxes that are tried
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

    Not proven is that no other orbit is within a distance.

    - H: See :class:`Equations`.
    - orbit: "shift", the map S as (places, signs) of components, and "reversing", none or two such
      maps, with S the second one after the first; "energy", or "period" as "formula" and "floats",
      or none; "edges" and "ends", fractions of the arc and states there; the
      "sizes" of the components to which the bound is relative.
    - claims: The values of its JSON, each exactly.
    """
    failure = NotProvenError("there is no proof")
    for bits, order, accuracy, degree in _ATTEMPTS:
        with ctx.workprec(bits):
            try:
                with refusing_other_forms():
                    found = _Orbit(H, orbit)
                    proof = found.proven(claims, order, accuracy, degree, check_time)
                    return _Check(found, claims, *proof).run(orbit)
            except FalseClaimError:
                raise
            except NotProvenError as error:
                failure = error
    raise failure


class _Map:
    """(S z)_i = signs_i z_(places_i), which is canonical, or reverses time."""

    def __init__(self, places: Sequence[int], signs: Sequence[int]) -> None:
        self.places, self.signs, dim = [*places], [*signs], len(places)
        if sorted(places) != list(range(dim)) or not all(s in (1, -1) for s in signs):
            raise NotProvenError("the symmetry of the orbit is no permutation with signs")
        J, half = [[0] * dim for _ in range(dim)], dim // 2
        for i in range(half):
            J[i][i + half], J[i + half][i] = 1, -1
        moved = [
            [s * t * J[i][k] for t, k in zip(signs, places, strict=True)]
            for s, i in zip(signs, places, strict=True)
        ]
        #: 1 if it is canonical, -1 if it reverses time.
        self.direction = 1 if moved == J else -1
        if moved != [[self.direction * value for value in row] for row in J]:
            raise NotProvenError("the symmetry of the orbit is not canonical")

    def __call__(self, state: Sequence[arb]) -> list[arb]:
        return [s * state[i] for i, s in zip(self.places, self.signs, strict=True)]

    def matrix(self) -> arb_mat:
        units = [column.entries() for column in _columns(identity(len(self.places)))]
        return arb_mat([self(unit) for unit in units]).transpose()

    def after(self, other: _Map) -> _Map:
        signs = [s * other.signs[i] for i, s in zip(self.places, self.signs, strict=True)]
        return _Map([other.places[i] for i in self.places], signs)

    def is_one(self) -> bool:
        return self.places == list(range(len(self.places))) and {*self.signs} == {1}

    def order(self) -> int:
        found, k = self, 1
        while not found.is_one():
            found, k = self.after(found), k + 1
        return k

    def pairs(self, sign: int) -> list[list[int]]:
        """Columns that span all z with S z = sign z, of an involution."""
        found = []
        for i, (k, s) in enumerate(zip(self.places, self.signs, strict=True)):
            if k > i or (k == i and s == sign):
                found.append([0] * len(self.places))
                found[-1][k] = sign * s
                found[-1][i] = 1
        return found

    def keeps(self, H: Mapping[str, Any], formulas: Formulas) -> bool:
        """Whether H is the same function after the map."""
        energy = formulas.parse(H["formula"]["formula"], numbers=exact_numbers(H["formula"]))
        variables = map(formulas.variable, self.places)
        images = {
            i: place if sign > 0 else formulas.negative(place)
            for i, (place, sign) in enumerate(zip(variables, self.signs, strict=True))
        }
        moved = formulas.negative(formulas.replaced(energy, images))
        return vanishes(formulas, formulas.add(energy, moved))


class _Timed:
    """Equations of the state and the time s of an arc, dz/dx = s f(z)."""

    def __init__(self, equations: Equations) -> None:
        self._own, self.dim = equations, equations.dim + 1
        self.entries = [*equations.entries, *((i, equations.dim, 0) for i in range(equations.dim))]

    def run_rates(self, variables: Sequence[Any]) -> list[Any]:
        *state, s, time = variables
        return [*(s * rate for rate in self._own.run_rates([*state, time])), arb(0)]

    def run_all(self, variables: Sequence[Any]) -> list[Any]:
        *state, s, time = variables
        found = self._own.run_all([*state, time])
        rates, count = found[-len(state) :], len(self._own.entries)
        return [*(s * slope for slope in found[:count]), *rates]


class _Orbit:
    """The conditions of an orbit."""

    def __init__(self, H: Mapping[str, Any], orbit: Mapping[str, Any]) -> None:
        equations = self.equations = Equations(H)
        formulas, dim = equations.formulas, equations.dim
        if not equations.autonomous:
            raise NotProvenError("orbits of an H or of forces with explicit time are not covered")
        self.shift, self.reversing = _Map(*orbit["shift"]), None
        maps = [self.shift]
        if orbit["reversing"] is not None:
            first, last = (_Map(*each) for each in orbit["reversing"])
            self.reversing, maps, shift = (first, last), [first, last], last.after(first)
            fits = first.after(first).is_one() and last.after(last).is_one()
            fits = fits and first.direction == last.direction == -1
            if not fits or (shift.places, shift.signs) != (self.shift.places, self.shift.signs):
                raise NotProvenError("the symmetries of the orbit do not close it")
        if self.shift.direction != 1 or any(len(each.places) != dim for each in maps):
            raise NotProvenError("the symmetries of the orbit do not close it")
        #: Arcs in a period.
        self.parts = self.shift.order() * len(maps)
        if self.parts > 1 and not equations.conserved:
            raise NotProvenError("orbits with forces and a symmetry are not covered")
        if not all(each.is_one() or each.keeps(H, formulas) for each in maps):
            raise NotProvenError("that H is the same after the symmetry of the orbit is not proven")
        energy, period = orbit["energy"], orbit["period"]
        self.energy = None if energy is None else ball(energy)
        self.period = None
        if period is not None:
            place = formulas.parse(period["formula"], numbers=exact_numbers(period))
            (self.period,) = formulas.program([place])([None] * (dim + 1))
        if equations.conserved != ((energy is None) != (period is None)):
            raise NotProvenError("the orbit has no energy and no period that isolate it")
        self.sizes = [ball(size) for size in orbit["sizes"]]
        self.start = [ball(value) for value in orbit["ends"][0]]
        if len(self.sizes) != dim or not all(size > 0 for size in self.sizes):
            raise NotProvenError("the sizes of the components are none")
        basis = identity(dim).tolist() if self.reversing is None else self.reversing[0].pairs(1)
        self.basis = arb_mat(basis).transpose()
        #: The component that is each unknown.
        self.own = [next(i for i, v in enumerate(row) if v != 0) for row in basis]
        self.slopes = formulas.program(equations.slopes)

    def field(self, state: Sequence[arb]) -> list[arb]:
        return self.equations.run_rates([*state, arb(0)])

    def gradient(self, state: Sequence[arb]) -> list[arb]:
        if not self.equations.run_energy([*state, arb(0)])[0].is_finite():
            raise NotProvenError("H is not smooth where the orbit closes")
        return self.slopes([*state, arb(0)])

    def states(self, unknowns: Sequence[arb]) -> list[arb]:
        """The state at the start, and the time of the arc."""
        *own, s = unknowns
        return [*(self.basis * column(own)).entries(), s]

    # -- existence ----------------------------------------------------------------------------

    def proven(
        self,
        claims: Mapping[str, Any],
        order: int,
        accuracy: float,
        degree: int,
        check_time: Callable[[], None],
    ) -> tuple[list[arb], list[arb], list[Step], arb_mat]:
        """A box with exactly one orbit, its centre, steps, and the derivatives at their end."""
        middle, s = [ball(float(v)) for v in claims["z0"][0]], ball(float(claims["period"][0]))
        if len(middle) != len(self.sizes) or not s > 0:
            raise NotProvenError("the start of the orbit or its period is none")
        centre = [*(middle[i] for i in self.own), (s / self.parts).mid()]
        units = [*(self.sizes[i] for i in self.own), s / self.parts]
        failure = NotProvenError("no box around the orbit is mapped into itself")
        proven = None
        for _ in range(_NEWTON):
            radii = [(unit * _RADIUS).abs_upper() for unit in units]
            *around, r = self.states([radius * UNIT for radius in radii])
            found = [*steps(
                _Timed(self.equations), self.states(centre), (0, 1), order, accuracy, check_time,
                [*(value.abs_upper() for value in around), r.abs_upper()], degree,
            )]  # fmt: skip
            box = [c + radius * UNIT for c, radius in zip(centre, radii, strict=True)]
            last = found[-1]
            end = [part(arb(1)) + t * UNIT for part, t in zip(last.y, last.tube, strict=True)]
            DZ = last.end.derivative()
            values, slopes = self._system(centre, box, last.end.state().entries(), end, DZ)
            try:
                C = slopes.mid().inv().mid()
            except ZeroDivisionError:
                raise NotProvenError(
                    "the orbit is not isolated: H has further integrals, which are not covered, or "
                    "it is at a bifurcation"
                ) from None
            step, spread = C * values, identity(len(box)) - C * slopes
            spread *= column([b - c for b, c in zip(box, centre, strict=True)])
            if not all(abs(s) < radius for s, radius in zip(spread.entries(), radii, strict=True)):
                raise failure  # whatever the centre is
            image = column(centre) - step + spread
            near = [abs(a - c) for a, c in zip(image.entries(), centre, strict=True)]
            if all(b.contains_interior(a) for a, b in zip(image.entries(), box, strict=True)):
                proven = image.entries(), centre, found, DZ
                if all(a < unit * _NARROW for a, unit in zip(near, units, strict=True)):
                    break
            centre = [value.mid() for value in (column(centre) - step).entries()]
            if not all(value.is_finite() for value in centre) or not centre[-1] > 0:
                raise failure
        if proven is None:
            raise failure
        return proven

    def _system(
        self,
        centre: Sequence[arb],
        box: Sequence[arb],
        end_of_centre: list[arb],
        end: list[arb],
        DZ: arb_mat,
    ) -> tuple[arb_mat, arb_mat]:
        """F at the centre and DF over the box."""
        dim, count = len(self.sizes), len(box)
        start, starts = self.states(centre)[:-1], self.states(box)[:-1]
        ends = arb_mat([row[:dim] for row in DZ.tolist()[:dim]]) * self.basis
        values, rows = end_of_centre[:dim], [
            [*row, DZ[i, dim]] for i, row in enumerate(ends.tolist())
        ]  # fmt: skip
        if self.reversing is not None:
            conditions = arb_mat(self.reversing[1].pairs(-1))
            values = (conditions * column(values)).entries()
            rows = (conditions * arb_mat(rows)).tolist()
        else:
            turned = [self.shift(part.entries()) for part in _columns(self.basis)]
            values = [a - b for a, b in zip(values, self.shift(start), strict=True)]
            rows = [
                [*(a - t[i] for a, t in zip(row, turned, strict=False)), row[-1]]
                for i, row in enumerate(rows)
            ]
            if self.equations.conserved:
                k = self._left_out(end[:dim], self.shift(starts))
                del values[k], rows[k]
            plane = [
                f / size**2 for f, size in zip(self.field(self.start), self.sizes, strict=True)
            ]
            values.append(_product(plane, [a - b for a, b in zip(start, self.start, strict=True)]))
            rows.append([*plane, arb(0)])
        if self.period is not None:
            values.append(centre[-1] * self.parts - self.period)
            rows.append([*[arb(0)] * (count - 1), arb(self.parts)])
        elif self.energy is not None:
            values.append(self.equations.run_energy([*start, arb(0)])[0] - self.energy)
            slopes = arb_mat([self.gradient(starts)]) * self.basis
            rows.append([*slopes.entries(), arb(0)])
        return column(values), arb_mat(rows)

    def _left_out(self, a: list[arb], b: list[arb]) -> int:
        """A component of two states that H determines by the others, between both."""
        slopes = self.gradient([x.union(y) for x, y in zip(a, b, strict=True)])
        shares = [abs(v).abs_lower() * size for v, size in zip(slopes, self.sizes, strict=True)]
        k = max(range(len(shares)), key=lambda i: shares[i].mid())
        if not shares[k] > 0:
            raise NotProvenError("H may be stationary where the orbit closes")
        return k


# -- claims ---------------------------------------------------------------------------------------


class _Check:
    """The claims about the only orbit in a box."""

    def __init__(
        self,
        orbit: _Orbit,
        claims: Mapping[str, Any],
        box: list[arb],
        centre: list[arb],
        steps_of_arc: list[Step],
        DZ: arb_mat,
    ) -> None:
        self._orbit, self._claims, self._steps = orbit, claims, steps_of_arc
        near = [(a - c).abs_upper() * UNIT for a, c in zip(box, centre, strict=True)]
        # of the orbit around the solution from the centre
        self._shares = column([arb(1), *(abs(v).abs_upper() for v in orbit.states(near))])
        *self._start, self._s = orbit.states(box)
        dim = len(self._start)
        through = arb_mat([row[:dim] for row in DZ.tolist()[:dim]])
        if orbit.reversing is None:
            self._shift = orbit.shift.matrix().transpose() * through
        else:
            units = identity(dim).tolist()
            J = arb_mat([*units[dim // 2 :], *([-v for v in row] for row in units[: dim // 2])])
            first, last = (each.matrix() for each in orbit.reversing)
            self._shift = first * (-J * through.transpose() * J) * last * through

    def run(self, orbit: Mapping[str, Any]) -> None:
        """Require every claim about the orbit."""
        period = self._s * self._orbit.parts if self._orbit.period is None else self._orbit.period
        field = self._orbit.field(self._start)
        if not self._s > 0 or not any(value > 0 or value < 0 for value in field):
            raise NotProvenError("the orbit may be an equilibrium")
        names = self._orbit.equations.names
        if [*self._claims["components"]] != names:
            raise NotProvenError("the certificate has other components")
        self._require("start", self._start, *self._claims["z0"])
        self._require("period", [period], *([value] for value in self._claims["period"]))
        flat = [[v for row in part for v in row] for part in self._claims["monodromy"]]
        self._require("derivative over one shift", self._shift.entries(), *flat)
        self._require_bound(orbit)
        self._require_word(self._claims["stability"])

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

    def _require_bound(self, orbit: Mapping[str, Any]) -> None:
        """The bound holds at the start and at as many places in the arc as it says."""
        edges, ends = [Fraction(edge) for edge in orbit["edges"]], orbit["ends"]
        bound, pieces, k = self._claims["bound"], self._claims["pieces"], 0
        if not bound >= 0 or not 1 <= pieces < len(edges):
            raise FalseClaimError("its bound or its number of pieces is none")
        limit, held = arb(bound), []  # which may be infinite
        for edge, state in zip(edges, ends, strict=True):
            while k + 1 < len(self._steps) and self._steps[k].middle + self._steps[k].r < edge:
                k += 1
            step = self._steps[k]
            x = ball((edge - step.middle) / step.r)
            tube = (step.end.tube * self._shares).entries()
            gaps = [
                (abs(part(x) - ball(value)) + t) / size
                for part, t, value, size in zip(
                    step.y, tube, state, self._orbit.sizes, strict=False
                )
            ]
            held.append(all(gap <= limit for gap in gaps))
        rising = edges[0] == 0 and edges[-1] == 1 and edges == sorted({*edges})
        parts = zip(self._start, self._orbit.start, self._orbit.sizes, strict=True)
        gaps = [abs(a - b) / s for a, b, s in parts]
        if any(gap > limit for gap in gaps):
            raise FalseClaimError("its bound on the distance from the computed start is false")
        if not rising or not all(gap <= limit for gap in gaps):
            raise NotProvenError("its bound on the distance from the computed start is not proven")
        if not (held[0] and sum(held[:-1]) >= pieces):
            raise NotProvenError("its bound on the distance from the computed states is not proven")

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
                    for m in _roots(arb_poly(left))]  # fmt: skip
        n = dim // 2 - 1
        powers = [arb_poly([2]), arb_poly([0, 1])]  # m^j + m^-j in terms of m + 1/m
        for _ in range(n - 1):
            powers.append(arb_poly([0, 1]) * powers[-1] - powers[-2])
        found = _roots(sum((left[n + j] * powers[j] for j in range(1, n + 1)), arb_poly([left[n]])))
        words = []
        for value in found:
            own = [other.overlaps(value.conjugate()) for other in found]
            real = sum(own) == 1 and value.overlaps(value.conjugate())
            size = abs(value.real)
            word = ("circle" if size < 2 else "real" if size > 2 else "?") if real else "?"
            words.append("complex" if value.imag > 0 or value.imag < 0 else word)
        return words


def _roots(polynomial: arb_poly) -> list[acb]:
    """All roots, each simple; one that is unknown if they are not isolated."""
    if polynomial.degree() < 1:
        return []
    try:
        return [*acb_poly(polynomial).roots()]
    except ValueError:
        return [acb(arb.nan(), arb.nan())]


def _columns(matrix: arb_mat) -> list[arb_mat]:
    return [column(row) for row in matrix.transpose().tolist()]


def _product(a: Sequence[arb], b: Sequence[arb]) -> arb:
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))
