"""Periodic orbits: hamsym.periodic_orbit."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, cast

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.numerics.collocation import collocation
from hamsym.numerics.pairs import Pair
from hamsym.numerics.symplectic import symplectic_inverse
from hamsym.orbits.arc import Arc, Problem, vector_field_at
from hamsym.orbits.condensed import SINGULAR
from hamsym.orbits.force_between import missed_feature
from hamsym.orbits.integrals import integrals_of
from hamsym.orbits.multipliers import (
    differ_from_one,
    gradients_of_integrals,
    multiplier_error,
    reduced_map,
    shear_of,
    stability_of,
)
from hamsym.orbits.period import ROUNDED, Period, has_period, period_of
from hamsym.orbits.search import check, converged, first_arc, first_return, refined, shot
from hamsym.orbits.symmetry import closing_of
from hamsym.random_features.flow import flow_of
from hamsym.solution.discontinuities import first_jump, has_switches
from hamsym.solution.solution import Solution
from hamsym.support.record_fields import AnyFloat, Limit, Size, floats
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import checked_numbers, require_number, require_positive

_REPETITIONS = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31)
_SAME = 1e-6  # distance of states that are the same, relative to the motion
# Reciprocal condition numbers that are more than round-off, and a ratio of two that are the same.
_ROUND_OFF, _ALIKE = 1e-13, 1.5
_POINTS = 400  # of an arc, for its extent
_LARGE = 1e3  # multiplier whose inverse is more accurate than the computed one


@suggest_attributes
@dataclass(frozen=True, eq=False)
class PeriodicOrbit(Drawn, Saved):
    """A periodic orbit, from :func:`hamsym.periodic_orbit`.

    ``plot()`` draws the orbit in the plane of its first two coordinates, or in space and seen along
    each axis if they are x, y and z, and its multipliers; ``plot("energies")`` its energies; one
    component draws it over a period, two in their plane, three in their space, and
    ``plot("multipliers")`` these alone.

    Attributes
    ----------
    problem : Problem
        H, the symmetry, and what was given.
    arc : Arc
        States along the part of the period that its symmetry leaves.
    success : bool
        Whether the estimated error is within the tolerance.
    message : str
    relative_error : float
        Estimated error of the states, also at the times in a period, and of the period, relative
        to the largest size of each component and to the period.
    is_isolated : bool
        Whether the orbit is the only one near it with its energy or period and its symmetry, up to
        the motions that the integrals of H generate, as rotations. If not, H has more integrals
        than :meth:`hamsym.Hamiltonian.invariants` finds, or the orbit is at a bifurcation, or as
        near one as float64 shows.
    repetitions : int
        Number of times that the orbit is run through in its period.
    multiplier_error : float
        Estimated error of ``shift_multipliers``, relative where they are larger than 1, or of the
        monodromy matrix if there are none: the difference of two computations with other points in
        each window.
    seconds : float
        Run time.
    """

    problem: Problem
    arc: Arc
    success: bool
    message: str
    relative_error: AnyFloat
    is_isolated: bool
    repetitions: Annotated[int, Limit(1)]
    _maps: Annotated[np.ndarray, floats("maps", "dim", "dim", finite=False)] = field(repr=False)
    multiplier_error: AnyFloat = math.inf
    seconds: Size = 0.0

    def check(self) -> None:
        """Raise ValueError unless a successful orbit has states, and a period."""
        arc = self.arc
        finite = np.isfinite(arc.ends).all() and np.isfinite(arc.values).all()
        if self.success and not (finite and 0 < arc.period < math.inf and self.relative_error >= 0):
            raise ValueError("its success is true, but its states or its period are not finite")

    def __repr__(self) -> str:
        return (
            f"PeriodicOrbit({self.H.formula!r}, period {self.period:.10g}, energy "
            f"{self.energy:.10g}, {self.stability}, success={self.success})"
        )

    # -- what it is ---------------------------------------------------------------------------

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian of the orbit, with its parameters."""
        return self.problem.H

    @property
    def z0(self) -> np.ndarray:
        """The state at the start, shape (dim,)."""
        return self.arc.ends[0].copy()

    @property
    def span(self) -> tuple[float, float]:
        """One period from the start."""
        return self.problem.start, self.problem.start + self.period

    @property
    def period(self) -> float:
        """Period, in the unit of time of H."""
        return self.arc.period

    @cached_property
    def energy(self) -> float:
        """H at the start."""
        system = self.H.compile("numpy")
        return float(system.energy(*system.arguments(self.z0, self.problem.start)))

    def __call__(self, t: Any) -> np.ndarray:
        """Evaluate the orbit at any times.

        Parameters
        ----------
        t : float or array
            In the units of H; the orbit starts at 0, or at the time ``start`` of the search.

        Returns
        -------
        numpy.ndarray
            Shape (dim,) for a scalar, else (n, dim).

        Examples
        --------
        >>> import hamsym
        >>> orbit = hamsym.periodic_orbit("p**2/2 + x**2/2 + x**4/4", [1.0, 0.0])
        >>> bool(np.allclose(orbit(3 * orbit.period), orbit.z0))
        True
        """
        times = checked_numbers("t", t)
        if times.ndim > 1 or not np.isfinite(times).all():
            raise InputError("t must be a number or a sequence of numbers")
        closing, period = self.problem.closing, self.period
        # Pairs, because the motion may be fast within the rounding of a fraction of the period.
        since = Pair(np.atleast_1d(times)) - self.problem.start
        since = np.fmod(since.high, period) + Pair(since.low)  # exact
        since = since + np.where(since.high < 0, period, 0.0)
        place = closing.parts * since
        part = np.clip((place.high / period).astype(int), 0, closing.parts - 1)
        place = place - part.astype(float) * Pair(period)
        found = np.empty((len(part), self.H.dim))
        for k in np.unique(part):
            rows = part == k
            along = period - place[rows] if closing.reversing and k % 2 else place[rows]
            found[rows] = closing.unfolded(int(k), self.arc.at_shares(along))
        return found[0] if times.ndim == 0 else found

    # -- stability ----------------------------------------------------------------------------

    @cached_property
    def shift_map(self) -> np.ndarray:
        """Derivative of the flow over one shift of the symmetry, and back by it, (dim, dim).

        Its power ``problem.closing.order`` is the monodromy matrix.
        """
        closing, through = self.problem.closing, np.eye(self.H.dim)
        for window in self._maps:
            through = window @ through
        if closing.last is not None:
            last = closing.last.matrix
            through = last @ symplectic_inverse(through) @ last @ through
        return np.asarray(closing.shift.matrix.T @ through)

    @cached_property
    def monodromy(self) -> np.ndarray:
        """dz(period)/dz0, shape (dim, dim)."""
        return np.linalg.matrix_power(self.shift_map, self.problem.closing.order)

    @cached_property
    def _reduced(self) -> np.ndarray:
        """The shift map without the directions of integrals and of their symmetries."""
        problem, ends, scale = self.problem, self.arc.ends, self.problem.scale_of(self.arc)
        gradients = gradients_of_integrals(self.H, ends, scale, problem.closing.shift)
        rates = None
        if problem.autonomous and not problem.conservative:  # else it is that of H
            rates = flow_of(self.H).vector_field(ends, np.full(len(ends), problem.start))
        return reduced_map(problem.closing, self._maps, gradients, rates, scale)

    @cached_property
    def shift_multipliers(self) -> np.ndarray:
        """Eigenvalues of ``shift_map`` other than the trivial ones, complex."""
        if not np.isfinite(self._reduced).all():
            return np.full(len(self._reduced), math.nan, dtype=complex)
        found = np.linalg.eigvals(self._reduced).astype(complex)
        if self.H.forces:
            return found
        # Round-off of the large multipliers exceeds the small ones, which are their inverses.
        found = found[np.argsort(-np.abs(found), kind="stable")]
        large = np.flatnonzero(np.abs(found[: len(found) // 2]) > _LARGE)
        found[-1 - large] = 1 / found[large]
        return found

    @cached_property
    def multipliers(self) -> np.ndarray:
        """Eigenvalues of the monodromy matrix, the largest first, shape (dim,), complex.

        The trivial ones, which integrals of H and the flow imply, are set to 1: if H has no
        explicit time one, two if energy is conserved, and up to two more for each further integral
        that :meth:`hamsym.Hamiltonian.invariants` finds.
        """
        found = self.shift_multipliers**self.problem.closing.order
        found = np.append(found, np.ones(self.H.dim - len(found)))
        return found[np.argsort(-np.abs(found), kind="stable")]

    @cached_property
    def stability(self) -> str:
        """Linear stability, from the multipliers other than the trivial ones.

        "elliptic", "hyperbolic", "complex unstable", "parabolic" or "mixed", and "unknown" where a
        failed orbit is not finite or the estimated error of the multipliers leaves more than one
        of these; with forces "attracting", "repelling" or "mixed". The page Words of the
        documentation defines them.
        """
        multipliers = self.shift_multipliers
        return stability_of(
            multipliers,
            order=self.problem.closing.order,
            error=self.multiplier_error,
            conservative=not self.H.forces,
            shear=shear_of(self.monodromy, np.eye(self.H.dim), self.problem.scale_of(self.arc)),
        )

    # -- consumers ----------------------------------------------------------------------------

    def solution(self, *, tol: float = 1e-9, periods: float = 1.0, **options: Any) -> Solution:
        """Compute the neural trajectory from ``z0`` over a number of periods (hamsym.solve)."""
        require_positive("periods", periods)
        start = self.problem.start
        return hamsym.solve(
            self.H, self.z0, (start, start + periods * self.period), tol=tol, **options
        )

    def family(self, **target: Any) -> hamsym.OrbitFamily:
        """Continue the orbit along its family; see :func:`hamsym.orbit_family`."""
        return hamsym.orbit_family(self, **target)

    def manifolds(self, **options: Any) -> hamsym.Manifolds:
        """Compute the stable and the unstable manifold; see :func:`hamsym.manifolds`."""
        return hamsym.manifolds(self, **options)

    def certify(self, *, time_limit: float | None = None) -> hamsym.OrbitCertificate:
        """Prove that a true periodic orbit exists, the only one nearby.

        See :func:`hamsym.prove_orbit`.
        """
        return hamsym.prove_orbit(self, time_limit=time_limit)

    def animate(self, *names: Any, **options: Any) -> hamsym.Animation:
        """Animate one period, in a picture that names or options choose; :func:`hamsym.animate`."""
        return hamsym.animate(self, *names, **options)


@checked_keywords
def periodic_orbit(
    H: HamiltonianLike,
    guess: Any,
    *,
    energy: float | None = None,
    period: float | str | None = None,
    symmetry: Any = None,
    tol: float = 1e-10,
    start: float = 0.0,
) -> PeriodicOrbit:
    """Find a periodic orbit near a guess.

    The orbit, its period and, where it is not given, its energy solve one boundary-value problem by
    Newton's method with the symbolic Hessian; see :mod:`hamsym.orbits.arc`. Windows are refined
    until they resolve the orbit to round-off.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    guess : sequence, mapping or pair
        A state near the orbit, in the order of H.z or by name; or a pair (state, period). Without
        a period the first near return of the trajectory gives it.
    energy : float, optional
        The energy of the orbit; by default that of the guess.
    period : float or str, optional
        The period, in place of the energy. If H depends on time it must be given, as a multiple
        of the period of H; proofs need the exact value, for example "2*pi/omega" with a
        parameter omega.
    symmetry : mapping or pair of mappings, optional
        Components to components, with signs; the others are unchanged. A symplectic map S makes
        orbits with z(T/k) = S z(0), where k is the order of S; a map R that reverses time makes
        orbits that start in the set z = R z and meet it again at T/2, and of a pair the orbit
        meets the set of the second one. H must not change under them. The states of the guess
        should satisfy them nearly.
    tol : float
        Tolerance of the estimated error, relative to the largest size of each component, and of
        the period.
    start : float
        Time at the start, for an H that depends on it.

    Returns
    -------
    PeriodicOrbit
        ``success`` is false if Newton's method does not converge, the estimated error is above
        the tolerance, H or its gradient jumps on the way, the force has a feature between the
        points of the windows, or an H that depends on time is not shown to have the period;
        ``message`` says why.

    Raises
    ------
    InputError
        If an argument is not valid, or the guess has no near return.

    Examples
    --------
    >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 + (x**2 + y**2)/2 + x**2*y - y**3/3")
    >>> z0 = H.state_at_energy(1 / 12, {"x": 0, "y": 0, "p_y": 0})
    >>> orbit = periodic_orbit(H, z0, energy=1 / 12, symmetry={"x": "-x", "p_y": "-p_y"})
    >>> orbit.success, orbit.stability, round(orbit.period, 6)
    (True, 'hyperbolic', 6.715956)
    """
    began = time.perf_counter()
    H = Hamiltonian.of(H)
    require_positive("tol", tol)
    require_number("start", start)
    if energy is not None:
        require_number("energy", energy)
    closing = closing_of(H, symmetry)
    exact = period_of(H, period)
    conservative = H.conserves_energy
    if not conservative and energy is not None:
        raise InputError("H does not conserve energy; leave energy out")
    if H.time is not None and exact is None:
        raise InputError("H depends on time; give period=, a multiple of the period of H")
    if H.forces and H.time is None and exact is not None:
        raise InputError(
            "with forces an orbit has a period of its own; give it as a guess: (state, period)"
        )
    if energy is not None and exact is not None:
        raise InputError("give energy or period, not both: one follows from the other")
    state, duration = _guess(H, guess)
    if closing.first is not None:
        state = (state + closing.first(state)) / 2
    if exact is not None:
        duration = exact.value
    elif duration is None:
        duration = first_return(H, closing, state)
    if conservative and energy is None and exact is None:
        energy = float(H.compile("numpy").energy(state))
        if not math.isfinite(energy):
            raise InputError("H is not finite at the guess; give another guess")
    fixed = None if exact is None else exact.value
    problem = Problem(H, closing, energy, fixed, start, exact_period=exact)
    arc = first_arc(problem, state, duration)
    return solved_orbit(problem, arc, tol, began, marched=True)


def solved_orbit(
    problem: Problem,
    arc: Arc,
    tol: float,
    began: float | None = None,
    *,
    marched: bool = False,
    reduce: bool = True,
) -> PeriodicOrbit:
    """Solve a problem from a first arc, estimate the error, and judge.

    - marched: Whether the arc is a solution from its start, which may be corrected first.
    - reduce: Solve an orbit that is run through several times again once.
    """
    start = time.perf_counter() if began is None else began
    found = refined(problem, arc)
    if found.failure and marched:
        better = shot(problem, arc)
        if better is not arc:
            found = refined(problem, better)
    finer, step, error = check(problem, found.arc)
    if not (found.failure or error <= tol):  # unstable orbits multiply what windows leave out
        found = converged(problem, finer)
        finer, step, error = check(problem, found.arc)
    finer = finer.rounded()
    if problem.closing.first is not None:  # exactly in its fixed set, for signed zeros too
        finer.ends[0] = (finer.ends[0] + problem.closing.first(finer.ends[0])) / 2 + 0.0
    isolated = step.condition > SINGULAR
    orbit = PeriodicOrbit(problem, finer, False, "", error, isolated, 1, step.maps)
    coarser = replace(orbit, _maps=found.step.maps)
    with np.errstate(all="ignore"):
        spread = multiplier_error(
            orbit._reduced, coarser._reduced, conservative=not problem.H.forces
        )
        if not len(orbit._reduced):
            spread = shear_of(orbit.monodromy, coarser.monodromy, problem.scale_of(finer))
    if not isolated and problem.period is None:
        # Newton's matrix of an unstable orbit may be singular up to round-off only. Orbits of one
        # energy are isolated if no multiplier is 1; with further integrals the matrix, too, has to
        # be regular: what round-off alone leaves of it differs from computation to computation.
        known = len(integrals_of(problem.H)) <= 1
        known = known or _same_condition(found.step.condition, step.condition)
        isolated = known and differ_from_one(orbit.shift_multipliers, spread)
        orbit = replace(orbit, is_isolated=isolated)
    failure = found.failure or _degenerate(problem, finer)
    if not failure and not error <= tol:
        failure = f"the estimated error {error:.1e} is above tol {tol:.1e}"
    failure = failure or _jump(problem, finer) or _other_period(problem)
    failure = failure or missed_feature(problem, finer, tol)
    seconds = time.perf_counter() - start
    elapsed = "" if began is None else f" in {seconds:.2g} s"
    count = len(found.arc.edges) - 1
    message = failure or f"{count} windows, estimated error {error:.1e}{elapsed}"
    if not failure and not orbit.is_isolated:
        message += (
            "; not isolated, as far as float64 shows: H has more conserved quantities, or a "
            "bifurcation is near"
        )
    repetitions = 1 if failure else _repetitions(problem, finer)
    if repetitions > 1 and problem.period is None and reduce:
        once = solved_orbit(problem, _first_part(finer, repetitions), tol, began, reduce=False)
        if once.success and once.repetitions == 1:
            return once
    if repetitions > 1:
        message += f"; the period is {repetitions} times the shortest one"
    return replace(
        orbit,
        success=not failure,
        message=message,
        repetitions=repetitions,
        multiplier_error=spread,
        seconds=seconds,
    )


def _same_condition(one: float, other: float) -> bool:
    """Whether two reciprocal condition numbers are the same, and more than round-off leaves."""
    low, high = sorted((one, other))
    return low > _ROUND_OFF and high <= _ALIKE * low


def _guess(H: Hamiltonian, guess: Any) -> tuple[np.ndarray, float | None]:
    """The state of a guess, and its period if there is one."""
    if isinstance(guess, PeriodicOrbit):
        if guess.H.names != H.names:
            raise InputError("the guess is an orbit of another Hamiltonian; give a state")
        return guess.z0, guess.period
    if (
        isinstance(guess, (tuple, list))
        and len(guess) == 2
        and (isinstance(guess[0], (Mapping, Sequence, np.ndarray)))
        and not isinstance(guess[0], str)
    ):
        state, duration = guess
        require_positive("the period of the guess", duration)
        return H.state_from(state), float(duration)
    return H.state_from(guess), None


def _first_part(arc: Arc, repetitions: int) -> Arc:
    """The first of several equal parts of an arc, on windows of its own."""
    edges = arc.edges / repetitions
    points = edges[:-1, None] + np.diff(edges)[:, None] * collocation(arc.values.shape[1]).nodes
    values = arc.at(points.ravel()).reshape(arc.values.shape)
    return Arc(arc.edges, arc.at(edges), values, arc.period / repetitions)


def _degenerate(problem: Problem, arc: Arc) -> str:
    """Why a solution of the equations is no periodic orbit, or an empty text."""
    rate = vector_field_at(problem.H, arc.ends[0], problem.start)
    scale = problem.scale_of(arc)
    moves = np.abs(rate) * abs(arc.period) / scale
    if not arc.period > 0:
        return "the period became zero"
    extent = np.ptp(arc.at(np.linspace(0, 1, _POINTS)), axis=0)
    if problem.autonomous and not (moves.max() > _SAME and (extent / scale).max() > _SAME):
        return "Newton's method ended at an equilibrium; give a guess farther from it"
    return ""


def _unjudged(problem: Problem, arc: Arc) -> PeriodicOrbit:
    dim = problem.H.dim
    return PeriodicOrbit(problem, arc, True, "", 0.0, True, 1, np.zeros((0, dim, dim)))


def _jump(problem: Problem, arc: Arc) -> str:
    """Where H or its gradient jumps along an orbit, or an empty text.

    The equations then lack a pulse, or the multipliers and Newton's method the jump of the force.
    """
    if not has_switches(problem.H):
        return ""
    orbit = cast(Solution, _unjudged(problem, arc))  # for its H and its values
    # Beyond the period, because the start may be at a jump.
    times = problem.start + arc.period * np.linspace(0, 1.01, 4 * _POINTS)
    found = first_jump(orbit, times, [])
    return "" if found is None else f"not a smooth orbit: {found.split(',')[0]}"


def _other_period(problem: Problem, parts: int = 1) -> str:
    """Why H does not have a part of the given period in time, or an empty text."""
    if problem.autonomous:
        return ""
    exact = cast(Period, problem.exact_period)
    if has_period(problem.H, exact.formula / parts, ROUNDED):
        return ""
    return (
        f"H is not shown to have the period {exact.value / parts:.10g} in time; give a multiple of "
        'its own with all digits, such as "2*pi/omega"'
    )


def _repetitions(problem: Problem, arc: Arc) -> int:
    """The number of times that the orbit, and H in time, close in the period."""
    orbit = _unjudged(problem, arc)
    times = problem.start + np.linspace(0, arc.period, _POINTS)
    states = orbit(times)
    units = problem.floored(np.ptp(states, axis=0), arc, _SAME)
    found, shortest = 1, arc.period
    # Most orbits are at another state after these parts of the period.
    firsts = orbit(times[0] + shortest / np.array(_REPETITIONS))
    near = (np.abs((firsts - states[0]) / units) < _SAME).all(axis=1)
    for prime in itertools.compress(_REPETITIONS, near):
        # Near an equilibrium states are the same for long, elsewhere they are not.
        while np.abs((orbit(times + shortest / prime) - states) / units).max() < _SAME:
            if _other_period(problem, found * prime):
                break
            found, shortest = found * prime, shortest / prime
            if found > 100:
                return found
    return found
