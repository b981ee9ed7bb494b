"""Pseudo-arclength continuation of periodic orbits, with bifurcations on the way.

The orbits of a conservative H with one symmetry form curves. From an orbit, the next one is looked
for at a given distance along the tangent of its curve, in the space of states and period (and a
parameter), where the curve has no folds (Keller 1977). The distance grows after an orbit that was
found and shrinks after one that was not, or that is too unlike its neighbour. Bifurcations are sign
changes of test functions between neighbours, located by Brent's method. Where the parabola through
three neighbours comes near zero and turns, the extremum is searched: two changes may be beside it.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.integrals import slice_of
from hamsym.orbits.multipliers import differ_from_one
from hamsym.orbits.newton_system import NewtonSystem
from hamsym.orbits.orbit import PeriodicOrbit, solved_orbit
from hamsym.orbits.period import period_of
from hamsym.support.record_fields import Count, Size

_FIRST, _SMALLEST = 0.02, 1e-6  # steps in scaled unknowns
_GROWTH, _CUT = 1.4, 0.4  # of a step after an easy and after a failed orbit
_MOST_CHANGE = 0.5  # of m + 1/m of the multipliers m between neighbours
_TURN = 0.9  # cosine of the largest angle between neighbouring tangents
_CONSTANT = 1e-10  # relative change of a period that is round-off, per distance along the family
_SHRUNK = 1e-7  # extent of an orbit, relative to the first one, that counts as an equilibrium
_LOOSE = 1e-6  # tolerance of orbits that only enclose a bifurcation
_LOCATED = 1e-9  # distance along the family up to which a bifurcation is located
# Least value of a parabola, relative to its points, at which its extremum is searched, and up to
# which part of the distance of these.
_DIP, _EXTREMUM = 0.25, 1e-5
_REAL = 1e-4  # imaginary part of a multiplier on the unit circle that may be round-off

# Kinds: one that is no bifurcation of the orbits with given energies, and one with forces.
_PERIOD_FOLD, _TORUS = "fold of the period", "Neimark-Sacker"
# Kinds at which a multiplier meets 1, or -1.
_MEETINGS = {"branching": 1, "period doubling": -1, "symmetry breaking": -1}


class _LostError(Exception):
    """No orbit was found between neighbours."""


@dataclass(frozen=True, eq=False)
class Bifurcation:
    """A bifurcation along a family."""

    #: "fold" of the energy, the period or the parameter that is named; "branching", where a pair of
    #: multipliers meets at 1; "period doubling", where one meets at -1; "symmetry breaking", where
    #: one of a shift of even order does; or "collision", where two pairs meet and leave the unit
    #: circle, or come back to it. With forces also "Neimark-Sacker", where a complex pair crosses
    #: the unit circle and a torus leaves. Multipliers that touch 1 or -1 and stay on the unit
    #: circle, as those of integrable systems do, are not reported.
    kind: str
    #: The orbit next to the bifurcation.
    orbit: PeriodicOrbit
    #: Number of the orbit of the family before it.
    after: Count
    #: Distance along the family, in states relative to their sizes, between the two orbits that
    #: enclose it. At a fold the energy or the parameter is accurate to its square.
    uncertainty: Size

    def __repr__(self) -> str:
        return (
            f"Bifurcation({self.kind}, energy {self.orbit.energy:.10g}, period "
            f"{self.orbit.period:.10g})"
        )


@dataclass(frozen=True)
class Aim:
    """A function of orbits and the value at which a family ends."""

    name: str
    value: float
    of: Callable[[PeriodicOrbit], float]

    def excess(self, orbit: PeriodicOrbit) -> float:
        return self.of(orbit) - self.value


@dataclass
class _Point:
    """An orbit with the tangent of the family there."""

    orbit: PeriodicOrbit
    system: NewtonSystem
    tangent: np.ndarray
    #: Functions that change sign at bifurcations.
    tests: dict[str, float] = field(default_factory=dict)
    #: Distance from the first orbit, along the family.
    place: float = 0.0


#: Two points of a family, and their distances from another one.
_Ends = tuple[tuple[float, _Point], tuple[float, _Point]]


class Continuation:
    """A family in the making."""

    def __init__(
        self, orbit: PeriodicOrbit, problem: Problem, aim: Aim, longest: float, tol: float
    ) -> None:
        self._problem, self._aim, self._longest, self._tol = problem, aim, longest, tol
        self._step = min(_FIRST, longest)
        self.orbits = [orbit]
        #: Bifurcations with their places.
        self._found: list[tuple[float, Bifurcation]] = []
        self.problem = ""
        self.open = aim.excess(orbit) != 0
        self._here = self._point(orbit, None)
        #: The neighbour before, and its distance.
        self._before: tuple[_Point, float] | None = None
        if self.open:
            self._face_the_aim()

    def _face_the_aim(self) -> None:
        """Turn the tangent towards the target."""
        here = self._here
        found = self._neighbour(here, 1e-4)
        if found is None:
            return
        change = self._aim.of(found) - self._aim.of(here.orbit)
        if change * self._aim.excess(here.orbit) > 0:
            here.tangent = -here.tangent
            here.tests = _tests(here, self._problem)

    @property
    def bifurcations(self) -> list[Bifurcation]:
        """Bifurcations in their order along the family."""
        return [found for _, found in sorted(self._found, key=lambda pair: pair[0])]

    def advance(self) -> None:
        """Compute the next orbit; shorten the step until it succeeds."""
        here, aim = self._here, self._aim
        while self._step > _SMALLEST:
            orbit = self._neighbour(here, self._step)
            there = None if orbit is None else self._point(orbit, here)
            if there is None or not (_aligned(here, there) and _close(here, there)):
                self._step *= _CUT
                continue
            step, excess = self._step, aim.excess(there.orbit)
            self.open = aim.excess(here.orbit) * excess > 0
            if not self.open and excess != 0:
                ends = (0.0, here), (step, there)
                (step, there), _ = self._zero(here, ends, lambda each: aim.excess(each.orbit))
            if not self.open and self._before is None:  # the only step, in two halves
                middle = self._neighbour(here, step / 2)
                if middle is not None:
                    step /= 2
                    self._before, here = (here, step), self._point(middle, here)
                    here.place = step
                    self._locate(self._before[0], here, step)
            there.place = here.place + step
            self._locate(here, there, step)
            self._search_pairs(here, there, step)
            if not self.open:
                if (exact := self._aimed(there.orbit)) is not None:
                    self.orbits.append(exact)
                else:
                    self.problem = f"no orbit at {aim.name} {aim.value:.10g}"
                return
            self.orbits.append(there.orbit)
            shrunk = not (_extent(there.orbit) > _SHRUNK * _extent(self.orbits[0])).any()
            if shrunk and self._problem.autonomous:
                self.open, self.problem = False, "the family ends at an equilibrium"
                return
            self._here, self._before = there, (here, step)
            self._step = min(self._step * _GROWTH, self._longest)
            return
        self.open = False
        self.problem = (
            f"the family ends, or could not be followed, beyond {aim.name} "
            f"{aim.of(here.orbit):.10g}: no orbit nearby"
        )

    def _problem_of(self, orbit: PeriodicOrbit) -> Problem:
        return replace(self._problem, H=orbit.H)

    def _point(self, orbit: PeriodicOrbit, before: _Point | None) -> _Point:
        problem = self._problem_of(orbit)
        system = NewtonSystem(problem, orbit.arc, slice_of(problem, orbit.arc))
        earlier = None if before is None else _carried(before, orbit.arc)
        point = _Point(orbit, system, system.direction(earlier))
        point.tests = _tests(point, problem)
        return point

    def _neighbour(
        self, here: _Point, distance: float, tol: float | None = None
    ) -> PeriodicOrbit | None:
        """The orbit at a distance along the tangent, or None."""
        orbit, system = here.orbit, here.system
        change = distance * _unweighted(here.tangent, orbit.arc) * system.units
        along = here.tangent, system.units
        return orbit_beside(
            self._problem_of(orbit), orbit.arc, system, change, along, tol or self._tol
        )

    def _locate(self, here: _Point, there: _Point, step: float) -> None:
        """Add the bifurcations between neighbours, a step from each other."""
        kinds = [
            kind
            for kind, value in here.tests.items()
            if value * there.tests.get(kind, math.nan) < 0
        ]
        self._add(kinds, here, ((0.0, here), (step, there)), len(self.orbits) - 1)

    def _add(self, kinds: list[str], base: _Point, ends: _Ends, after: int) -> None:
        """Add a bifurcation of each kind between two points, at distances from a base."""
        # A pair of multipliers meets at 1 where the energy or the parameter has a fold.
        if any(kind.startswith("fold") and kind != _PERIOD_FOLD for kind in kinds):
            kinds = [kind for kind in kinds if kind != "branching"]
        for kind in kinds:
            (place, point), width = self._zero(
                base,
                ends,
                lambda point, kind=kind: point.tests[kind],  # type: ignore[misc]
            )
            if kind != _TORUS or _complex_pair(point.orbit.shift_multipliers):
                found = Bifurcation(kind, point.orbit, after, width)
                self._found.append((base.place + place, found))

    def _search_pairs(self, here: _Point, there: _Point, step: float) -> None:
        """Add pairs of bifurcations that leave no change of a sign between neighbours.

        Each extremum is searched once, from the one of its neighbours that is nearest to zero.
        """
        if self._before is None or not step > 0:
            return
        (before, length), after = self._before, len(self.orbits) - 1
        points = before, here, there
        if len({len(point.orbit.shift_multipliers) for point in points}) > 1:
            return
        for kind in {*_MEETINGS, _TORUS} & here.tests.keys():
            values = [point.tests[kind] for point in points]
            turn = _turn(np.abs(values), length, step)
            if turn is None or not (min(values) > 0 or max(values) < 0):
                continue
            near = np.argmin(np.abs(values))
            if near == 1 or (near == 0 and after <= 1) or (near == 2 and not self.open):
                self._search_pair(kind, points, (length, step))

    def _search_pair(
        self,
        kind: str,
        points: tuple[_Point, _Point, _Point],
        lengths: tuple[float, float],
    ) -> None:
        """Add the bifurcations beside an extremum of a test function, if it changes its sign."""
        before, here, there = points
        sign = math.copysign(1.0, here.tests[kind])
        found: tuple[float, _Point] | None = None

        def value(place: float) -> float:
            nonlocal found
            base, distance = (before, lengths[0] + place) if place < 0 else (here, place)
            orbit = self._neighbour(base, distance)
            if orbit is None:
                raise _LostError
            point = self._point(orbit, base)
            meeting = _MEETINGS.get(kind, 0) * orbit.shift_multipliers
            if not (differ_from_one(meeting, orbit.multiplier_error) and point.tests[kind] != 0):
                raise _LostError  # a touch, as far as float64 shows
            tested = sign * point.tests[kind]
            if tested < 0:
                found = float(place), point
                raise _LostError
            return tested

        with contextlib.suppress(_LostError):
            minimize_scalar(
                value,
                bounds=(-lengths[0], lengths[1]),
                method="bounded",
                options={"xatol": _EXTREMUM * sum(lengths)},
            )
        if found is None:
            return
        place, middle = found
        first, after = place < 0, len(self.orbits) - 1
        left, right = (before, here) if first else (here, there)
        whole = lengths[0] if first else lengths[1]
        inner = (place + whole if first else place), middle
        kinds = [
            each
            for each, test in middle.tests.items()
            if (each == kind or each.startswith("fold"))
            and test * left.tests[each] < 0
            and test * right.tests[each] < 0
        ]
        for ends in (((0.0, left), inner), (inner, (whole, right))):
            self._add(kinds, left, ends, max(after - first, 0))

    def _zero(
        self, base: _Point, ends: _Ends, function: Callable[[_Point], float]
    ) -> tuple[tuple[float, _Point], float]:
        """The point nearest to the zero of a function between two, with its distance from a base,
        and the distance of two orbits that enclose the zero.
        """
        closest = min(ends, key=lambda end: abs(function(end[1])))
        known = {distance: function(point) for distance, point in ends}

        def value(distance: float) -> float:
            nonlocal closest
            if distance not in known:
                orbit = self._neighbour(base, distance)
                exact = orbit is not None
                if orbit is None:  # Next to a fold round-off is large, but the sign is known.
                    orbit = self._neighbour(base, distance, max(self._tol, _LOOSE))
                if orbit is None:
                    raise _LostError
                point = self._point(orbit, base)
                known[distance] = function(point)
                if exact and abs(known[distance]) <= abs(function(closest[1])):
                    closest = distance, point
            return known[distance]

        with contextlib.suppress(_LostError):
            low, high = (distance for distance, _ in ends)
            brentq(value, low, high, xtol=_LOCATED, rtol=1e-12, maxiter=60, disp=False)
        places = sorted(known)
        signs = [known[place] > 0 for place in places]
        change = next(k for k in range(1, len(places)) if signs[k] != signs[0])
        return closest, places[change] - places[change - 1]

    def _aimed(self, orbit: PeriodicOrbit) -> PeriodicOrbit | None:
        """The orbit exactly at the target, from one nearby."""
        problem, value = orbit.problem, self._aim.value
        if self._problem.parameter is not None:
            H = problem.H.with_parameters(**{self._problem.parameter: value})
            problem = replace(problem, H=H)
        elif self._aim.name == "energy":
            problem = replace(problem, energy=value, period=None, exact_period=None)
        else:
            exact = period_of(problem.H, value)
            problem = replace(problem, energy=None, period=value, exact_period=exact)
        found = solved_orbit(problem, orbit.arc, self._tol)
        return found if found.success else None


def _turn(values: np.ndarray, before: float, after: float) -> float | None:
    """Where the parabola through three values nearly falls to zero and turns, between them."""
    left, right = np.diff(values) / (before, after)
    curvature = (right - left) / (before + after)
    if not curvature > 0:
        return None
    slope = (left * after + right * before) / (before + after)
    place = -slope / (2 * curvature)
    least = values[1] + slope * place / 2
    near = -before < place < after and least <= _DIP * values.max()
    return float(place) if near else None


def _products(multipliers: np.ndarray) -> np.ndarray:
    """Products of two of the multipliers, of which one is 1 where a pair crosses the circle."""
    rows, columns = np.triu_indices(len(multipliers), 1)
    return multipliers[rows] * multipliers[columns]


def _complex_pair(multipliers: np.ndarray) -> bool:
    """Whether the pair of multipliers whose product is nearest to 1 is no real one."""
    rows, _ = np.triu_indices(len(multipliers), 1)
    k = int(np.argmin(np.abs(_products(multipliers) - 1)))
    return bool(abs(multipliers[rows[k]].imag) > _REAL)


def _extent(orbit: PeriodicOrbit) -> np.ndarray:
    return np.asarray(np.ptp(orbit.arc.ends, axis=0))


def _pinned(problem: Problem, arc: Arc) -> Problem:
    """The problem of one orbit of a family."""
    if problem.energy is not None or problem.period is not None:
        return replace(problem, parameter=None)
    energy = float(problem.H.compile("numpy").energy(arc.ends[0]))
    return replace(problem, energy=energy, parameter=None)


def _varied(problem: Problem, change: float) -> Problem:
    name = problem.parameter
    assert name is not None
    return replace(
        problem, H=problem.H.with_parameters(**{name: problem.H.parameters[name] + change})
    )


def orbit_beside(
    problem: Problem,
    arc: Arc,
    system: NewtonSystem,
    change: np.ndarray,
    along: tuple[np.ndarray, np.ndarray],
    tol: float,
) -> PeriodicOrbit | None:
    """Move an arc by a solution of its linear system to another orbit, or None.

    - along: Direction across which Newton's method follows, and its units.
    """
    count = arc.ends.size
    ends = arc.ends + change[:count].reshape(arc.ends.shape)
    values = arc.values + system.inside(change)
    if problem.parameter is not None:
        problem = _varied(problem, float(change[count + 1]))
    period = arc.period + float(change[count])
    if not period > 0:
        return None
    found = _converged_across(problem, Arc(arc.edges, ends, values, period), *along)
    if found is None:
        return None
    made = solved_orbit(_pinned(*found), found[1], tol)
    return made if made.success else None


def _converged_across(
    problem: Problem, arc: Arc, tangent: np.ndarray, units: np.ndarray
) -> tuple[Problem, Arc] | None:
    """Newton's method across the tangent, or None."""
    planes = slice_of(problem, arc)
    before = math.inf
    for _ in range(12):
        system = NewtonSystem(problem, arc, planes)
        step = system.solved(tangent * system.units / units)
        if not math.isfinite(step.size) or step.size > 0.5 or step.size > 2 * before:
            return None
        arc = step.applied(arc)
        if problem.parameter is not None:
            problem = _varied(problem, step.parameter)
        if not arc.period > 0:
            return None
        if step.size < 1e-9:
            return problem, arc
        before = step.size
    return None


def _unweighted(tangent: np.ndarray, arc: Arc) -> np.ndarray:
    found = tangent.copy()
    found[: arc.ends.size] *= len(arc.ends)
    return found


def _carried(before: _Point, arc: Arc) -> np.ndarray:
    """The tangent of a point on the windows of another arc, for its sense only."""
    old = before.orbit.arc
    count = old.ends.size
    change = _unweighted(before.tangent, old)[:count].reshape(old.ends.shape)
    moved = np.stack(
        [np.interp(arc.edges, old.edges, column) for column in change.T], axis=1
    ).ravel() / len(arc.ends)
    return np.concatenate([moved, before.tangent[count:]])


def _aligned(here: _Point, there: _Point) -> bool:
    """Whether the tangents of neighbours differ little."""
    earlier, arc = _carried(here, there.orbit.arc), there.orbit.arc
    weights = np.ones(len(earlier))
    weights[: arc.ends.size] = 1 / len(arc.ends)

    def product(a: np.ndarray, b: np.ndarray) -> float:
        return float(np.sum(a * b / weights))

    sizes = math.sqrt(product(earlier, earlier) * product(there.tangent, there.tangent))
    return product(earlier, there.tangent) >= _TURN * sizes


def _close(here: _Point, there: _Point) -> bool:
    """Whether the multipliers of neighbours differ little."""
    sums = []
    for point in (here, there):
        multipliers = point.orbit.shift_multipliers
        with np.errstate(all="ignore"):
            sums.append(np.sort_complex(multipliers + 1 / multipliers))
    if len(sums[0]) != len(sums[1]):  # an integral, as the angular momentum, is zero for one
        return True
    change = np.abs(sums[1] - sums[0])
    return bool((change <= _MOST_CHANGE * np.maximum(1.0, np.abs(sums[0]))).all())


def _tests(point: _Point, problem: Problem) -> dict[str, float]:
    """Functions of an orbit that change sign at bifurcations."""
    orbit, tangent = point.orbit, _unweighted(point.tangent, point.orbit.arc)
    count = orbit.arc.ends.size
    tests = {}
    if problem.parameter is not None:
        tests[f"fold of {problem.parameter}"] = float(tangent[count + 1])
    else:
        slope = np.asarray(orbit.H.compile("numpy").gradient(orbit.z0))
        change = (tangent * point.system.units)[: orbit.H.dim]
        tests["fold of the energy"] = float(slope @ change)
        change_of_period = float(tangent[count])
        tests[_PERIOD_FOLD] = change_of_period if abs(change_of_period) > _CONSTANT else 0.0
    multipliers = orbit.shift_multipliers
    tests["branching"] = float(np.prod(multipliers - 1).real)
    odd = orbit.problem.closing.order % 2
    meeting = "period doubling" if odd else "symmetry breaking"
    tests[meeting] = float(np.prod(multipliers + 1).real)
    if orbit.H.forces:
        if len(multipliers) > 1:
            products = _products(multipliers)
            # Forces that keep areas leave round-off alone.
            known = differ_from_one(products, 2 * orbit.multiplier_error, least=0.0)
            tests[_TORUS] = float(np.prod(products - 1).real) if known else 0.0
    elif len(multipliers) >= 4:
        sums = multipliers + 1 / multipliers
        real = np.abs(sums.imag) <= 1e-4 * np.abs(sums).max()
        tests["collision"] = 1.0 if real.all() else -1.0
    return tests
