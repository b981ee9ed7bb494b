"""Proofs of periodic orbits: existence, uniqueness nearby, and linear stability.

The orbit is divided into pieces of equal time. The states at the starts of the pieces and the
period are the unknowns X of a square system f(X) = 0: each piece ends where the next one starts,
the last one closes the orbit, the first state lies in a plane across the flow, and the energy or
the period is the given one. With the end of a piece and its derivatives enclosed for a whole ball
of states and periods (:func:`hamsym.enclose`), Krawczyk's operator

    K(X) = x - C f(x) + (1 - C Df(X)) (X - x),   C about the inverse of Df(x),

maps X into its interior only if X contains exactly one zero of f (Krawczyk 1969; Neumaier 1990).
The pieces run in units of their own time: T H is enclosed over a fixed time with the parameter T.

Where energy is conserved one component of the closing condition is left out, so that the system is
square: with equal energies and all other components equal, the two states are equal if the
derivative of H by the component has no zero in between.
"""

from __future__ import annotations

import math
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from flint import arb, arb_mat

from hamsym.errors import CertificationError
from hamsym.numerics.symplectic import poisson_matrix
from hamsym.orbits.arc import Problem
from hamsym.orbits.certificate import OrbitCertificate, orbit_digest, statement_of
from hamsym.orbits.orbit_check import check_orbit
from hamsym.orbits.period import exact_period, in_units_of_the_arc
from hamsym.orbits.proven_stability import proven_attraction, proven_stability
from hamsym.orbits.search import vector_field_at
from hamsym.orbits.symmetry import SignedPermutation, is_unchanged
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import above, float_balls, matrix_of, vector_of, working
from hamsym.proof.arithmetic.directed import UNDERFLOW, up
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.arithmetic.functions import BALLS, SingularityError
from hamsym.proof.arithmetic.generated import GeneratedFunctions
from hamsym.proof.limits import Deadline
from hamsym.proof.windows.enclose import Enclosure, enclosed
from hamsym.support.suggestions import checked_keywords

if TYPE_CHECKING:
    from hamsym.orbits.orbit import PeriodicOrbit

_BITS = 128
_WINDOWS = 2  # of the numerical arc in a piece, about
_MOST_PIECES = 32
_TRIES = 6  # at a ball around the numerical orbit
_WIDEST = 1e-1  # relative radius of balls that are tried for uniqueness
_TRIED = 1e-8  # and of the first one


@checked_keywords
def prove_orbit(orbit: PeriodicOrbit, *, time_limit: float | None = None) -> OrbitCertificate:
    """Prove that a true periodic orbit exists near a numerical one, and no other.

    Parameters
    ----------
    orbit : PeriodicOrbit
    time_limit : float, optional
        Seconds.

    Returns
    -------
    OrbitCertificate

    Raises
    ------
    CertificationError
        If there is no proof, with the reason.

    Examples
    --------
    >>> import hamsym
    >>> orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
    >>> certificate = orbit.certify()
    >>> certificate.bound < 1e-14, certificate.stability
    (True, 'parabolic')
    >>> abs(certificate.period.mid - 4.76802202910246) < 1e-13, certificate.period.radius < 1e-14
    (True, True)
    """
    require_float64()
    if not orbit.success:
        raise CertificationError(f"the orbit did not succeed: {orbit.message}")
    arc = orbit.arc
    if not all(np.isfinite(part).all() for part in (arc.ends, arc.values, arc.period)):
        raise CertificationError("the orbit has states or a period that are not finite")
    _require_symmetry(orbit.problem)
    return _Proof(orbit, Deadline.after(time_limit)).certificate()


@dataclass(frozen=True)
class _Set:
    """What is enclosed over a ball X of unknowns."""

    #: Of the pieces.
    ends: list[Ball]
    #: Derivatives of the ends by the starts.
    maps: list[list[list[arb]]]
    #: And by the period.
    rates: list[list[list[arb]]]


class _Proof:
    """The square system of an orbit."""

    def __init__(self, orbit: PeriodicOrbit, deadline: Deadline) -> None:
        self._orbit, self._deadline, self._began = orbit, deadline, time.monotonic()
        problem = orbit.problem
        self._problem, self._closing, self._dim = problem, problem.closing, orbit.H.dim
        if not orbit.is_isolated:
            raise CertificationError(
                "the orbit is not isolated: H has more conserved quantities, or the orbit is at a "
                "bifurcation; give a symmetry that leaves one orbit"
            )
        self._H, self._name = in_units_of_the_arc(problem, self._closing.parts)
        #: Whether the period is an unknown.
        self._free = self._name is not None
        count = 2 ** round(math.log2(max((len(orbit.arc.edges) - 1) / _WINDOWS, 1)))
        self.pieces = min(count, _MOST_PIECES)
        self._states = orbit.arc.at(np.arange(self.pieces) / self.pieces)
        self._states[0] = orbit.arc.ends[0]
        self._scale = orbit.arc.scale
        dim, closing = self._dim, self._closing
        # the first state is basis @ y
        self._basis = np.eye(dim)
        if closing.first is not None:
            first = closing.first
            self._basis = first.fixed_basis
            weights = np.abs(self._basis).sum(axis=0)
            self._first = self._basis.T @ self._states[0] / weights
        else:
            self._first = self._states[0].copy()
        self._states[0] = self._basis @ self._first  # exact: one entry in each row
        self._anchor = _field(orbit)
        if self._free:
            self._given, self._period = None, float(orbit.period)
        else:
            self._given = exact_period(problem)
            self._period = self._given.mid
        if not self._period > 0:
            raise CertificationError("the period of the orbit is not positive")
        with working(_BITS):
            self._functions = GeneratedFunctions(orbit.H, BALLS)
        # of a pair of components that move together the smaller one, for both
        inside = np.where(self._basis != 0, self._scale[:, None], math.inf)
        units = [inside.min(axis=0)]
        units += [self._scale] * (self.pieces - 1)
        if self._free:
            units.append(np.array([self._period]))
        self._units = np.concatenate(units)
        if problem.conservative and closing.first is None:
            gradient = np.asarray(orbit.H.compile("numpy").gradient(self._states[0]))
            self._left_out = int(np.argmax(np.abs(gradient) * self._scale))

    # -- enclosures -----------------------------------------------------------------------------

    def _enclosed(self, radii: np.ndarray, derivatives_too: bool) -> _Set:
        """Ends of pieces, with derivatives, for all unknowns within radii."""
        dim = self._dim
        first = len(self._first)
        period = Ball(self._period, float(radii[-1]) if self._free else 0.0)
        found = _Set([], [], [])
        for k in range(self.pieces):
            self._deadline.check("the orbit was proven")
            after = radii[first + (k - 1) * dim : first + k * dim]
            radius = after if k else self._spread(radii)
            enclosure = self._piece(k, Ball(self._states[k], radius), period)
            end = enclosure.span[1]
            found.ends.append(enclosure(end))
            if derivatives_too:
                found.maps.append(matrix_of(enclosure.derivative(end)))
                if self._free:
                    found.rates.append(matrix_of(enclosure.parameter_derivative(end)))
        return found

    def _piece(self, k: int, start: Ball, period: Ball) -> Enclosure:
        span = (k / self.pieces, (k + 1) / self.pieces)  # exact: a power of two
        parameters = None if self._name is None else {self._name: period}
        return enclosed(self._H, start, span, parameters, self._deadline.left)

    # -- the system ---------------------------------------------------------------------------

    def _values(self, found: _Set) -> list[arb]:
        """f(x) for the numerical orbit."""
        rows: list[arb] = []
        for k in range(self.pieces - 1):
            rows += _difference(found.ends[k], self._states[k + 1])
        rows += self._closed(vector_of(found.ends[-1]), [arb(v) for v in self._states[0].tolist()])
        if self._closing.first is None and self._problem.autonomous:
            rows.append(arb(0))  # the plane goes through the numerical start
        if self._problem.conservative and self._problem.energy is not None:
            energy = self._functions("energy", [arb(v) for v in self._states[0].tolist()], arb(0))
            rows.append(energy - arb(self._problem.energy))
        return rows

    def _closed(self, end: list[arb], start: list[arb]) -> list[arb]:
        """The closing condition, of states or of columns of derivatives."""
        closing = self._closing
        if closing.last is not None:
            return [
                sum((arb(c) * v for c, v in zip(row, end, strict=True) if c), arb(0))
                for row in closing.last.conditions.tolist()
            ]
        turned = _turned(closing.shift, start)
        rows = [a - b for a, b in zip(end, turned, strict=True)]
        if self._problem.conservative:
            del rows[self._left_out]
        return rows

    def _derivatives(self, found: _Set, radii: np.ndarray) -> list[list[arb]]:
        """Df(X), row by row."""
        dim, first, count = self._dim, len(self._first), len(self._units)
        rows: list[list[arb]] = []

        def columns_of(k: int) -> tuple[int, int]:
            return (0, first) if k == 0 else (first + (k - 1) * dim, first + k * dim)

        moved = [_product(found.maps[0], self._basis), *found.maps[1:]]
        for k in range(self.pieces - 1):
            low, high = columns_of(k)
            after, _ = columns_of(k + 1)
            for i in range(dim):
                row = [arb(0)] * count
                row[low:high] = moved[k][i]
                row[after + i] = row[after + i] - 1
                if self._free:
                    row[-1] = found.rates[k][i][0]
                rows.append(row)
        # the closing condition, column by column
        zero = [arb(0)] * dim
        closing: list[list[arb]] = [[arb(0)] * count for _ in self._closed(zero, zero)]
        low, high = columns_of(self.pieces - 1)
        for c in range(count):
            end = [moved[-1][i][c - low] for i in range(dim)] if low <= c < high else zero
            if self._free and c == count - 1:
                end = [found.rates[-1][i][0] for i in range(dim)]
            start = [arb(v) for v in self._basis[:, c].tolist()] if c < first else zero
            for row, value in zip(closing, self._closed(end, start), strict=True):
                row[c] = value
        rows += closing
        if self._closing.first is None and self._problem.autonomous:
            rows.append([arb(v) for v in self._anchor.tolist()] + [arb(0)] * (count - first))
        if self._problem.conservative and self._problem.energy is not None:
            slope = self._gradient(self._start(radii))
            inner = [
                sum((arb(b) * s for b, s in zip(column, slope, strict=True) if b), arb(0))
                for column in self._basis.T.tolist()
            ]
            rows.append(inner + [arb(0)] * (count - first))
        return rows

    def _spread(self, radii: np.ndarray) -> np.ndarray:
        """Radii of the first state."""
        return np.asarray(up(np.abs(self._basis) @ radii[: len(self._first)]))

    def _start(self, radii: np.ndarray) -> list[arb]:
        """The first states of all unknowns within radii."""
        return vector_of(Ball(self._states[0], self._spread(radii)))

    def _gradient(self, states: list[arb]) -> list[arb]:
        """grad H over a ball of states, where energy is conserved."""
        field, half = self._functions("vector_field", states, arb(0)), self._dim // 2
        return [-value for value in field[half:]] + list(field[:half])

    # -- Krawczyk -----------------------------------------------------------------------------

    def certificate(self) -> OrbitCertificate:
        with working(_BITS):
            try:
                return self._certificate()
            except SingularityError as error:
                raise CertificationError(f"H is not smooth along the orbit: {error}") from None

    def _certificate(self) -> OrbitCertificate:
        count = len(self._units)
        values = self._values(self._enclosed(np.zeros(count), False))
        radii = 1e-13 * self._units
        found = self._enclosed(radii, True)
        rows = self._derivatives(found, radii)
        middle = np.array([[float(v.mid()) for v in row] for row in rows])
        if middle.shape[0] != middle.shape[1]:
            raise CertificationError("the system of the orbit is not square")
        row_units = np.abs(middle * self._units).max(axis=1)
        try:
            inverse = np.linalg.inv(middle * self._units / row_units[:, None])
        except np.linalg.LinAlgError:
            inverse = np.full(middle.shape, math.nan)
        inverse = inverse * self._units[:, None] / row_units
        if not np.isfinite(inverse).all():
            raise CertificationError("the equations of the orbit are singular: it is not isolated")
        C = arb_mat(inverse.tolist())
        gap = C * arb_mat([[v] for v in values])
        gaps = np.array([above(abs(gap[i, 0])) for i in range(count)])
        radii = np.maximum(2 * gaps, 1e-15 * self._units)
        for _ in range(_TRIES):
            found = self._enclosed(radii, True)
            image = self._image(C, gaps, found, radii)
            if (image < radii).all():
                break
            if not np.isfinite(image).all():
                raise CertificationError("the enclosure of the orbit became infinite")
            radii = np.maximum(2 * image, radii)
        else:
            raise CertificationError(
                "no ball around the numerical orbit is mapped into itself; the orbit may be too "
                "unstable, or near a bifurcation"
            )
        self._require_closed(found, radii)
        self._require_motion(radii)
        check_orbit(self._orbit, self._states)
        unique = self._unique(C, gaps, radii)
        return self._stated(found, np.minimum(image, radii), unique)

    def _image(self, C: arb_mat, gaps: np.ndarray, found: _Set, radii: np.ndarray) -> np.ndarray:
        """Radii of K(X) around the numerical orbit."""
        count = len(radii)
        identity = arb_mat([[int(i == j) for j in range(count)] for i in range(count)])
        rest = identity - C * arb_mat(self._derivatives(found, radii))
        sizes = np.array([[above(abs(rest[i, j])) for j in range(count)] for i in range(count)])
        return np.asarray(up(gaps + sizes @ radii) + UNDERFLOW)

    def _require_closed(self, found: _Set, radii: np.ndarray) -> None:
        """Require that the component that was left out is equal too."""
        if not self._problem.conservative or self._closing.first is not None:
            return
        turned = _turned(self._closing.shift, self._start(radii))
        between = [a.union(b) for a, b in zip(turned, vector_of(found.ends[-1]), strict=True)]
        slope = self._gradient(between)[self._left_out]
        if not (slope.is_finite() and not slope.contains(0)):
            raise CertificationError("the derivative of H across the orbit may be zero")

    def _require_motion(self, radii: np.ndarray) -> None:
        """Require a positive period and a start that is no equilibrium."""
        if self._free and not radii[-1] < self._period:
            raise CertificationError("the period of the orbit may be zero")
        if self._problem.autonomous:
            field = self._functions("vector_field", self._start(radii), arb(0))
            if all(not value.is_finite() or value.contains(0) for value in field):
                raise CertificationError("the orbit may be an equilibrium")

    def _unique(self, C: arb_mat, gaps: np.ndarray, least: np.ndarray) -> float:
        """The largest relative radius that was found in which the orbit is the only one."""
        proven = float((least / self._units).min())
        size = _TRIED
        for _ in range(_TRIES):
            radii = size * self._units
            if not (radii >= least).all():
                break
            try:
                found = self._enclosed(radii, True)
                shares = self._image(C, gaps, found, radii) / radii
            except (CertificationError, SingularityError):
                self._deadline.check("the orbit was proven")
                shares = np.array([math.inf])
            if (shares < 1).all():
                proven = max(proven, size)
                # The share grows in proportion to the radius.
                grown = min(0.7 * size / float(shares.max()), _WIDEST)
                if grown < 2 * size:
                    break
                size = grown
            else:
                size /= 10 if size <= _TRIED or not proven >= _TRIED else 3
                if size <= proven:
                    break
        return proven

    # -- the statement ------------------------------------------------------------------------

    def _stated(self, found: _Set, radii: np.ndarray, unique: float) -> OrbitCertificate:
        orbit, problem, closing = self._orbit, self._problem, self._closing
        dim = self._dim
        z0 = Ball(self._states[0], self._spread(radii))
        period = Ball(self._period, float(radii[-1])) if self._given is None else self._given
        through = arb_mat(np.eye(dim).tolist())
        for matrix in found.maps:
            through = arb_mat(matrix) * through
        if closing.last is not None:
            J = arb_mat(poisson_matrix(dim // 2).tolist())
            last = arb_mat(closing.last.matrix.tolist())
            inverse = -J * through.transpose() * J  # of a symplectic matrix
            through = last * inverse * last * through
        through = arb_mat(closing.shift.matrix.T.tolist()) * through
        # in units of the components, powers of two, which round nothing
        units = [arb(2) ** round(math.log2(size)) for size in self._scale.tolist()]
        rows = [[through[i, j] * units[j] / units[i] for j in range(dim)] for i in range(dim)]
        if orbit.H.forces:
            stability = proven_attraction(arb_mat(rows), problem.autonomous)
        else:
            stability = proven_stability(arb_mat(rows), problem.autonomous)
        bound = float((radii / self._units).max())
        statement = statement_of(problem, period, bound, unique, stability, self.pieces)
        return OrbitCertificate(
            z0,
            period,
            bound,
            unique,
            _ball(through),
            stability,
            self.pieces,
            time.monotonic() - self._began,
            statement,
            orbit_digest(orbit),
            orbit.H.names,
        )


def _require_symmetry(problem: Problem) -> None:
    """Require that H is unchanged by the maps of the closing condition, and that they close it."""
    H, closing = problem.H, problem.closing
    if H.forces and closing.parts > 1:
        raise CertificationError("forces may not share the symmetry of the orbit; leave it out")
    identity = SignedPermutation.identity(H.dim)
    if closing.first is not None and closing.last is not None:
        maps = {closing.first, closing.last}
        fits = all(one.time_direction == -1 and one.order == 2 for one in maps)
        fits = fits and closing.shift == closing.last.after(closing.first)
    else:
        maps = {closing.shift} - {identity}
        fits = closing.first is closing.last and closing.shift.time_direction == 1
    if not (fits and (problem.autonomous or closing.parts == 1)):
        raise CertificationError("the symmetry of the orbit does not close an orbit")
    if not all(is_unchanged(H, one) for one in maps):
        raise CertificationError("H changes under the symmetry of the orbit")


def _field(orbit: PeriodicOrbit) -> np.ndarray:
    """The normal of the plane across the flow, in scaled components."""
    rate = vector_field_at(orbit.H, orbit.z0, orbit.problem.start)
    weight = rate / orbit.arc.scale**2
    if not (np.isfinite(weight).all() and weight.any()):
        raise CertificationError(
            "the start of the orbit is an equilibrium, or H is not finite there"
        )
    return np.asarray(weight / np.abs(weight).max())


def _turned(shift: SignedPermutation, states: list[arb]) -> list[arb]:
    return [sign * states[i] for i, sign in zip(shift.places, shift.signs, strict=True)]


def _difference(end: Ball, state: np.ndarray) -> list[arb]:
    return [a - arb(b) for a, b in zip(vector_of(end), state.tolist(), strict=True)]


def _product(matrix: list[list[arb]], basis: np.ndarray) -> list[list[arb]]:
    found = arb_mat(matrix) * arb_mat(basis.tolist())
    return [[found[i, j] for j in range(basis.shape[1])] for i in range(len(matrix))]


def _ball(matrix: arb_mat) -> Ball:
    shape = matrix.nrows(), matrix.ncols()
    middle, radius = float_balls(matrix.entries())
    return Ball(np.array(middle).reshape(shape), np.array(radius).reshape(shape))
