"""Proofs of periodic orbits: existence, uniqueness nearby, and linear stability.

The states at the starts of pieces of the orbit and the period are the unknowns X of a square system
f(X) = 0 (:mod:`hamsym.orbits.square_system`). With the end of a piece and its derivatives enclosed
for a whole ball of states and periods (:func:`hamsym.enclose`), Krawczyk's operator

    K(X) = x - C f(x) + (1 - C Df(X)) (X - x),   C about the inverse of Df(x),

maps X into its interior only if X contains exactly one zero of f (Krawczyk 1969; Neumaier 1990).
The pieces run in units of their own time: T H is enclosed over a fixed time with the parameter T.
"""

from __future__ import annotations

import math
import time
from functools import reduce
from operator import mul
from typing import TYPE_CHECKING

import numpy as np
from flint import arb

import hamsym
from hamsym.errors import CertificationError
from hamsym.orbits.arc import Problem
from hamsym.orbits.certificate import OrbitCertificate, orbit_digest, statement_of
from hamsym.orbits.orbit_check import check_orbit
from hamsym.orbits.proven_stability import proven_stability
from hamsym.orbits.quotients import Directions, ShiftDerivative, scaled
from hamsym.orbits.square_system import Enclosed, SquareSystem
from hamsym.orbits.symmetry import SignedPermutation, is_unchanged
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.arithmetic.balls import float_balls, matrix_of, vector_of, working
from hamsym.proof.arithmetic.directed import UNDERFLOW, UNIT, down, sum_up
from hamsym.proof.arithmetic.float64_arithmetic import require_float64
from hamsym.proof.arithmetic.functions import SingularityError
from hamsym.proof.limits import Deadline
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require

if TYPE_CHECKING:
    from hamsym.orbits.orbit import PeriodicOrbit

_BITS = 128
_CALM = (4.0, 1.0)  # places that pieces start at, see SquareSystem
_CORRECTIONS = 2  # of the numerical orbit, to the next float64 numbers
_CORRECTED = 1e-4  # largest one, relative to the components
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
    require(isinstance(orbit, hamsym.PeriodicOrbit), "orbit", orbit, "a PeriodicOrbit")
    if not orbit.success:
        raise CertificationError(f"the orbit did not succeed: {orbit.message}")
    arc = orbit.arc
    if not all(np.isfinite(part).all() for part in (arc.ends, arc.values, arc.period)):
        raise CertificationError("the orbit has states or a period that are not finite")
    _require_symmetry(orbit.problem)
    return _Proof(orbit, Deadline.after(time_limit)).certificate()


class _Proof:
    """The proof of an orbit."""

    def __init__(self, orbit: PeriodicOrbit, deadline: Deadline) -> None:
        self._orbit, self._deadline, self._began = orbit, deadline, time.monotonic()

    def certificate(self) -> OrbitCertificate:
        with working(_BITS):
            try:
                for calm in _CALM:
                    try:
                        return self._certificate(calm)
                    except CertificationError as error:
                        self._deadline.check("the orbit was proven")
                        failure = error
                        if not self._orbit.is_isolated:
                            raise CertificationError(
                                f"{error}; as far as float64 shows the orbit is not isolated, up "
                                "to the motions that the integrals of H generate: H has more "
                                "integrals than those that are found, or a bifurcation is near; "
                                "give a symmetry that leaves one orbit"
                            ) from error
            except SingularityError as error:
                raise CertificationError(f"H is not smooth along the orbit: {error}") from None
        raise failure

    def _certificate(self, calm: float) -> OrbitCertificate:
        problem, arc = self._orbit.problem, self._orbit.arc
        self._system = SquareSystem(problem, arc, self._deadline, calm)
        system = self._system
        units = system.units
        radii = 1e-13 * units
        middle = system.derivatives(system.enclosed(radii, True), radii).mid
        if middle.shape[0] != middle.shape[1]:
            raise CertificationError("the system of the orbit is not square")
        row_units = np.abs(middle * units).max(axis=1)
        try:
            inverse = np.linalg.inv(middle * units / row_units[:, None])
        except np.linalg.LinAlgError:
            inverse = np.full(middle.shape, math.nan)
        C = inverse * units[:, None] / row_units
        if not np.isfinite(C).all():
            raise CertificationError("the equations of the orbit are singular: it is not isolated")
        gaps, correction = self._gaps(C)
        for _ in range(_CORRECTIONS):
            if not 1e-16 < np.abs(correction / units).max() <= _CORRECTED:
                break
            system.correct(correction)
            gaps, correction = self._gaps(C)
        found, radii, image = self._mapped_into_itself(C, gaps)
        system.require_closed(found, radii)
        system.require_motion(radii)
        check_orbit(self._orbit, system.edges[:-1], system.numerical)
        unique = self._unique(C, gaps, radii, image)
        return self._stated(found, np.minimum(image, radii), unique)

    def _mapped_into_itself(
        self, C: np.ndarray, gaps: np.ndarray
    ) -> tuple[Enclosed, np.ndarray, np.ndarray]:
        """What is enclosed over a ball X with K(X) inside X, and the radii of X and of K(X)."""
        system = self._system
        radii, least = np.maximum(2 * gaps, 1e-15 * system.units), math.inf
        for _ in range(_TRIES):
            found = system.enclosed(radii, True)
            image = self._image(C, gaps, found, radii)
            if (image < radii).all():
                return found, radii, image
            share = float((image / radii).max())
            if not share < least:
                break
            radii, least = np.maximum(2 * image, radii), share
        raise CertificationError(
            "no ball around the numerical orbit is mapped into itself; the orbit may be too "
            "unstable, or near a bifurcation"
        )

    def _gaps(self, C: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bounds on |C f(x)|, and Newton's correction."""
        system = self._system
        values = system.values(system.enclosed(np.zeros(len(C)), False))
        middle, radius = map(np.array, float_balls(values))
        return _sizes(C, middle, radius), -C @ middle

    def _image(
        self, C: np.ndarray, gaps: np.ndarray, found: Enclosed, radii: np.ndarray
    ) -> np.ndarray:
        """Radii of K(X) around the numerical orbit."""
        slopes = self._system.derivatives(found, radii)
        rest = _sizes(C, slopes.mid, slopes.radius, np.eye(len(radii)))
        return np.asarray(sum_up(gaps + rest @ radii, len(radii)) + UNDERFLOW)

    def _unique(
        self, C: np.ndarray, gaps: np.ndarray, least: np.ndarray, image: np.ndarray
    ) -> float:
        """The largest relative distance that was found in which there is no other orbit."""
        units, proven, size = self._system.units, least, _TRIED
        for _ in range(_TRIES):
            radii = size * units
            if not (radii >= least).all():
                break
            try:
                found = self._system.enclosed(radii, True)
                share = float((self._image(C, gaps, found, radii) / radii).max())
            except (CertificationError, SingularityError):
                self._deadline.check("the orbit was proven")
                share = math.inf
            # The share grows in proportion to the radius.
            if share < 1:
                proven = radii
                size, before = min(0.7 * size / share, _WIDEST), size
                if size < 2 * before:
                    break
            else:
                size = max(0.5 * size / share, size / 1000)
                if proven is not least and not size > proven[0] / units[0]:
                    break
        return float(down(((proven - image) / units).min()))

    # -- the statement ------------------------------------------------------------------------

    def _stated(self, found: Enclosed, radii: np.ndarray, unique: float) -> OrbitCertificate:
        orbit, system = self._orbit, self._system
        problem = orbit.problem
        z0, period = system.start(0, radii), system.period(radii)
        # in units of the components, powers of two, which round nothing
        units = [arb(2) ** round(math.log2(size)) for size in system.scale.tolist()]
        places = [vector_of(system.start(k, radii)) for k in range(system.pieces)]
        places.append(found.end(-1))
        maps = [scaled(matrix_of(matrix), units) for matrix in found.maps]
        derivative = ShiftDerivative(problem.closing, maps, units)
        whole = derivative.whole()
        try:
            across = Directions(problem, system.states[0], system.scale).at(places, units)
            reduced = derivative.across(across)
            power = reduce(mul, [whole] * problem.closing.order)
            stability = proven_stability(reduced, power, forced=bool(orbit.H.forces))
        except ZeroDivisionError:  # which multipliers are trivial is not proven
            stability = "undecided"
        monodromy = scaled(whole.tolist(), [1 / unit for unit in units]).entries()
        bound = system.distance(radii)
        statement = statement_of(problem, period, bound, unique, stability, system.pieces)
        return OrbitCertificate(
            z0,
            period,
            bound,
            unique,
            Ball(*(np.array(part).reshape(whole.nrows(), -1) for part in float_balls(monodromy))),
            stability,
            system.pieces,
            time.monotonic() - self._began,
            statement,
            orbit_digest(orbit),
            orbit.H.names,
        )


def _sizes(
    C: np.ndarray, middle: np.ndarray, radius: np.ndarray, less: np.ndarray | float = 0.0
) -> np.ndarray:
    """Upper bounds on |C B - less| for all B in a ball, entry by entry.

    The computed product differs from C times the mid-points by less than n u |C| |mid-points| / (1
    - n u), in whatever order it is summed (Higham 2002, 3.13).
    """
    terms, sizes = len(C), np.abs(C)
    rounded = (terms + 32) * UNIT * (sizes @ np.abs(middle))
    return np.asarray(sum_up(np.abs(C @ middle - less) + rounded + sizes @ radius, terms))


def _require_symmetry(problem: Problem) -> None:
    """Require that H is unchanged by the maps of the closing condition, and that they close it."""
    H, closing = problem.H, problem.closing
    if H.forces and closing.parts > 1:
        raise CertificationError("forces may not share the symmetry of the orbit; leave it out")
    try:
        closing.check()
        fits = problem.autonomous or closing.parts == 1
    except ValueError:
        fits = False
    if not fits:
        raise CertificationError("the symmetry of the orbit does not close an orbit")
    maps = {one for one in (closing.first, closing.last) if one is not None} or {closing.shift}
    if not all(is_unchanged(H, one) for one in maps - {SignedPermutation.identity(H.dim)}):
        raise CertificationError("H changes under the symmetry of the orbit")
