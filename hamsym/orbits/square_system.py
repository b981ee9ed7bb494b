"""The square system f(X) = 0 of a periodic orbit, enclosed over balls of unknowns.

The unknowns X are the states at the starts of pieces of the arc, and the period. Each piece
ends where the next one starts, the last one closes the orbit, the first state lies in planes across
the flow and the symmetries of the integrals, and the energy or the period is the given one.

Each integral implies one closing condition, which is left out: integrals have the same values at
the two states that are equal when the orbit closes. With all other components of their difference
zero, those that were left out are zero if the gradients of the integrals by them are independent
in between (:meth:`SquareSystem.require_closed`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from flint import arb, arb_mat

from hamsym.errors import CertificationError
from hamsym.orbits.arc import Arc, Problem
from hamsym.orbits.integrals import directions, gradients_from, slice_of
from hamsym.orbits.period import exact_period, in_units_of_the_arc
from hamsym.orbits.symmetry import SignedPermutation
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import float_balls, vector_of
from hamsym.proof.arithmetic.directed import TINY, UNIT, up
from hamsym.proof.arithmetic.functions import BALLS
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.enclose import enclosed
from hamsym.random_features.flow import flow_of

_WINDOWS, _FEWEST = 2, 8  # of the numerical arc in a piece, about; pieces of a short arc
_MOST_UNKNOWNS = 4_000


@dataclass(frozen=True)
class Enclosed:
    """What is enclosed over a ball X of unknowns."""

    #: Of the pieces, each plus numbers below its round-off.
    ends: list[tuple[Ball, np.ndarray]]
    #: Derivatives of the ends by the starts.
    maps: list[Ball]
    #: And by the period.
    rates: list[Ball]

    def end(self, k: int) -> list[arb]:
        """The ends of a piece."""
        ball, low = self.ends[k]
        return [
            value + arb(rest) for value, rest in zip(vector_of(ball), low.tolist(), strict=True)
        ]


class SquareSystem:
    """The system of an orbit, around its numerical states.

    Raise CertificationError if the start is no place for planes, or the period is not positive.

    - edges: Ends of the pieces, in fractions of the arc, shape (pieces + 1,).
    - numerical: States of the arc at the starts of the pieces, shape (pieces, dim).
    - states: Those around which the system is enclosed: corrected ones.
    - units: Of the unknowns, shape (n,).
    - calm: Pieces start where the motion is slower than so many times its median.
    """

    def __init__(self, problem: Problem, arc: Arc, deadline: Deadline, calm: float) -> None:
        self._problem, self._deadline, closing = problem, deadline, problem.closing
        self._H, self._name = in_units_of_the_arc(problem, closing.parts)
        #: Whether the period is an unknown.
        self._free = self._name is not None
        chosen = _chosen_edges(problem, arc, calm)
        self.pieces = len(chosen) - 1
        self.edges, self.numerical = arc.edges[chosen], arc.ends[chosen[:-1]]
        self.states = self.numerical.copy()
        self.scale, self._dim = problem.scale_of(arc), problem.H.dim
        # the first state is basis @ y
        self._basis, self._origin = np.eye(self._dim), self.numerical[0]
        if closing.first is not None:
            self._basis = closing.first.fixed_basis
            self._origin = self._basis.T @ self.states[0] / np.abs(self._basis).sum(axis=0)
        self._first = len(self._origin)
        self._start = self._origin
        self.states[0] = self._basis @ self._start  # exact: one entry in each row
        planes = slice_of(problem, arc)
        self._normals = planes.normals @ self._basis
        moves = problem.autonomous and closing.first is None
        if not np.isfinite(self._normals).all() or (moves and not self._normals.any()):
            raise CertificationError(
                "the start of the orbit is an equilibrium, or H is not finite there"
            )
        self.given = None if self._free else exact_period(problem)
        self.middle_period = float(arc.period) if self.given is None else self.given.mid
        if not self.middle_period > 0:
            raise CertificationError("the period of the orbit is not positive")
        self._functions = GeneratedFunctions(problem.H, BALLS)
        self._integrals = [
            self._functions if each == problem.H else GeneratedFunctions(each, BALLS)
            for each in planes.integrals
        ]
        # of a pair of components that move together the smaller one, for both
        inside = np.where(self._basis != 0, self.scale[:, None], math.inf).min(axis=0)
        units = [inside, *[self.scale] * (self.pieces - 1), [self.middle_period] * self._free]
        self.units = np.concatenate(units)
        # closing conditions, those that the integrals imply apart
        conditions = np.eye(self._dim) if closing.last is None else closing.last.conditions
        place = self.states[0] if closing.last is None else arc.ends[-1]
        slopes = gradients_from(directions(planes.integrals, place)) * self.scale @ conditions.T
        slopes /= np.maximum(np.abs(slopes).max(axis=1, keepdims=True), TINY)
        order = scipy.linalg.qr(slopes, mode="economic", pivoting=True)[2]
        implied = np.isin(np.arange(len(conditions)), order[: len(slopes)])
        self._conditions, self._left_out = conditions[~implied], conditions[implied]

    def correct(self, correction: np.ndarray) -> None:
        """Add a correction to the unknowns around which the system is enclosed."""
        self._start = self._start + correction[: self._first]
        self.states[0] = self._basis @ self._start
        for k in range(1, self.pieces):
            self.states[k] += correction[self._columns(k)]
        if self._free:
            self.middle_period += float(correction[-1])

    def distance(self, radii: np.ndarray) -> float:
        """The largest distance of unknowns within radii from numerical states, in their sizes."""
        apart = np.abs(self.states - self.numerical)
        shares = [(row + self.start(k, radii).radius) / self.scale for k, row in enumerate(apart)]
        return float(up(np.max(shares)))

    # -- enclosures ------------------------------------------------------------------------------

    def enclosed(self, radii: np.ndarray, derivatives_too: bool) -> Enclosed:
        """Enclose ends of pieces, with derivatives, for all unknowns within radii."""
        found = Enclosed([], [], [])
        period = Ball(self.middle_period, float(radii[-1]) if self._free else 0.0)
        parameters = None if self._name is None else {self._name: period}
        for k in range(self.pieces):
            self._deadline.check("the orbit was proven")
            span = (float(self.edges[k]), float(self.edges[k + 1]))
            start = self.start(k, radii)
            enclosure = enclosed(self._H, start, span, parameters, self._deadline.left)
            end = enclosure.span[1]
            found.ends.append(enclosure.end_states())
            if derivatives_too:
                found.maps.append(enclosure.derivative(end))
                if self._free:
                    found.rates.append(enclosure.parameter_derivative(end))
        return found

    def start(self, k: int, radii: np.ndarray) -> Ball:
        """The starts of a piece for all unknowns within radii."""
        if k:
            return Ball(self.states[k], radii[self._columns(k)])
        return Ball(self.states[0], up(np.abs(self._basis) @ radii[: self._first]))

    def period(self, radii: np.ndarray) -> Ball:
        """The periods of all unknowns within radii."""
        return Ball(self.middle_period, float(radii[-1])) if self.given is None else self.given

    def _columns(self, k: int) -> slice:
        """The unknowns of a piece."""
        first = self._first + (k - 1) * self._dim
        return slice(first, first + self._dim) if k else slice(self._first)

    # -- the system ------------------------------------------------------------------------------

    def values(self, found: Enclosed) -> list[arb]:
        """f(x) at the numerical orbit, from what is enclosed at it alone."""
        rows: list[arb] = []
        starts = [[arb(v) for v in state] for state in self.states.tolist()]
        for k, start in enumerate(starts[1:]):
            rows += [a - b for a, b in zip(found.end(k), start, strict=True)]
        closing, last = self._problem.closing, found.end(-1)
        if closing.last is None:
            turned = turned_by(closing.shift, starts[0])
            last = [a - b for a, b in zip(last, turned, strict=True)]
        rows += _products(self._conditions, last)
        apart = [arb(a) - arb(b) for a, b in zip(self._start, self._origin, strict=True)]
        for normal in self._normals.tolist():  # planes through the numerical start
            rows.append(sum((arb(c) * v for c, v in zip(normal, apart, strict=True)), arb(0)))
        if self._has_energy:
            energy = self._functions("energy", starts[0], arb(0))
            rows.append(energy - arb(self._problem.energy))
        return rows

    @property
    def _has_energy(self) -> bool:
        return self._problem.conservative and self._problem.energy is not None

    def derivatives(self, found: Enclosed, radii: np.ndarray) -> Ball:
        """Df(X), shape (n, n)."""
        count, dim, closing = len(self.units), self._dim, self._problem.closing
        rows = [_Rows(dim, count) for _ in range(self.pieces)]
        for k, (row, matrix) in enumerate(zip(rows, found.maps, strict=True)):
            row.add(self._columns(k), matrix.mid, matrix.radius, self._basis if k == 0 else None)
            if self._free:
                row.add(slice(count - 1, count), found.rates[k].mid, found.rates[k].radius)
            if k + 1 < self.pieces:
                row.add(self._columns(k + 1), -np.eye(dim))
        if closing.last is None:
            rows[-1].add(self._columns(0), -closing.shift.matrix @ self._basis)
        rows[-1] = rows[-1].combined(self._conditions)
        rows.append(_Rows(len(self._normals), count))
        rows[-1].add(self._columns(0), self._normals)
        if self._has_energy:
            slope = gradients([self._functions], vector_of(self.start(0, radii))).entries()
            middle, radius = (np.array([part]) for part in float_balls(slope))
            rows.append(_Rows(1, count))
            rows[-1].add(self._columns(0), middle, radius, self._basis)
        return Ball(
            np.concatenate([row.middle for row in rows]),
            np.concatenate([row.radius for row in rows]),
        )

    # -- what is left out ------------------------------------------------------------------------

    def require_closed(self, found: Enclosed, radii: np.ndarray) -> None:
        """Require that the closing conditions that were left out hold too.

        The mean gradient of the integrals between the two states, times the components of their
        difference that were left out, is zero.
        """
        if not self._integrals:
            return
        closing, end = self._problem.closing, found.end(-1)
        other = turned_by(closing.last or closing.shift, end)
        if closing.last is None:
            other = turned_by(closing.shift, vector_of(self.start(0, radii)))
        between = [a.union(b) for a, b in zip(end, other, strict=True)]
        try:
            (gradients(self._integrals, between) * arb_mat(self._left_out.T.tolist())).inv()
        except ZeroDivisionError:
            raise CertificationError(
                "the gradients of the integrals of H where the orbit closes may be dependent"
            ) from None

    def require_motion(self, radii: np.ndarray) -> None:
        """Require a positive period and a start that is no equilibrium."""
        if self._free and not radii[-1] < self.middle_period:
            raise CertificationError("the period of the orbit may be zero")
        if self._problem.autonomous:
            field = self._functions("vector_field", vector_of(self.start(0, radii)), arb(0))
            if all(not value.is_finite() or value.contains(0) for value in field):
                raise CertificationError("the orbit may be an equilibrium")


def _chosen_edges(problem: Problem, arc: Arc, calm: float) -> np.ndarray:
    """Ends of windows at which pieces start and end.

    States in a close encounter determine the rest of the orbit badly.
    """
    times = problem.start + arc.edges * (arc.period / problem.closing.parts)
    scale = problem.scale_of(arc)
    rates = flow_of(problem.H).jacobian(arc.ends, times) * scale / scale[:, None]
    sizes = np.linalg.norm(rates, axis=(1, 2))
    slow = np.flatnonzero(sizes <= calm * np.median(sizes))
    count = max(math.ceil(len(slow) / _WINDOWS), _FEWEST)
    count = min(count, _MOST_UNKNOWNS // arc.ends.shape[1])
    inner = slow[np.linspace(0, len(slow) - 1, count + 1).astype(int)] if len(slow) else []
    return np.unique([0, *inner, len(arc.edges) - 1])


class _Rows:
    """Rows of a matrix of balls in the making."""

    def __init__(self, count: int, columns: int) -> None:
        self.middle, self.radius = np.zeros((count, columns)), np.zeros((count, columns))

    def add(
        self,
        columns: slice,
        middle: np.ndarray,
        radius: np.ndarray | float = 0.0,
        basis: np.ndarray | None = None,
    ) -> None:
        """Add a matrix of balls, times a basis with entries 0, 1 and -1, to some columns."""
        radius = np.broadcast_to(radius, middle.shape)
        if basis is not None:
            radius = radius @ np.abs(basis) + _rounding(np.abs(middle) @ np.abs(basis))
            middle = middle @ basis
        total = self.middle[:, columns] + middle
        self.radius[:, columns] += radius + _rounding(np.abs(total))
        self.middle[:, columns] = total

    def combined(self, weights: np.ndarray) -> _Rows:
        """Sums of rows with weights 0, 1 and -1."""
        found = _Rows(len(weights), self.middle.shape[1])
        rounded = _rounding(np.abs(weights) @ np.abs(self.middle))
        found.middle = weights @ self.middle
        found.radius = up(np.abs(weights) @ self.radius + rounded)
        return found


def _rounding(sizes: np.ndarray) -> np.ndarray:
    """A bound on the roundings of sums of two numbers whose sizes have these sums."""
    return 4 * UNIT * sizes


def gradients(integrals: list[GeneratedFunctions], states: list[arb]) -> arb_mat:
    """Return the gradients of integrals over a ball of states, one in a row."""
    half, rows = len(states) // 2, []
    for integral in integrals:
        field = integral("vector_field", states, arb(0))
        rows.append([*(-value for value in field[half:]), *field[:half]])
    return arb_mat(rows) if rows else arb_mat(0, len(states))


def turned_by(symmetry: SignedPermutation, states: list[arb]) -> list[arb]:
    """Return states after a symmetry."""
    return [sign * states[i] for i, sign in zip(symmetry.places, symmetry.signs, strict=True)]


def _products(rows: np.ndarray, vector: list[arb]) -> list[arb]:
    """Products of rows with entries 0, 1 and -1."""
    return [
        sum((int(c) * v for c, v in zip(row, vector, strict=True) if c), arb(0))
        for row in rows.tolist()
    ]
