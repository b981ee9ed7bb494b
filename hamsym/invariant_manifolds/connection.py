"""Connections: trajectories from one equilibrium or periodic orbit to another, or back to it."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.invariant_manifolds.crossings import Cut, cut_of, nearby
from hamsym.invariant_manifolds.manifold import Manifold
from hamsym.invariant_manifolds.meeting import Met, Side, meet
from hamsym.invariant_manifolds.origins import Origin
from hamsym.problems.surface import Surface, parse_surface
from hamsym.solution.solution import Solution
from hamsym.solution.times import times_in_span
from hamsym.support.shown import Drawn, Listed, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import require_positive, require_whole

_PERIOD = 1e-12  # relative difference of periods of H that are the same
_ENERGY = 1e-9  # difference of energies, relative to what the manifolds exchange, that is none
_CANDIDATES = 48  # places at which Newton's method begins
_SAME = 1e-6  # relative difference of states and times of connections that are the same
_ACCURATE = 1e-6  # error of the state on the section, relative to the sizes of components
_TRANSVERSAL = 1e-10  # singular values, relative to the largest, of a tangency within round-off


@suggest_attributes
@dataclass(frozen=True, eq=False)
class Connection(Drawn, Shown):
    """A trajectory from an unstable manifold to a stable one, on both within its mismatch.

    Call it with times from ``span``: it is on the section at 0, at the time ``clock`` of an H that
    depends on time. It begins and ends on the local manifolds; before and after that it stays near
    the origins for ever.

    ``plot()`` draws it in the plane of the first two coordinates, or of coordinate and momentum,
    with both origins; two names draw another plane.

    Attributes
    ----------
    origins : (Equilibrium or PeriodicOrbit, Equilibrium or PeriodicOrbit)
        Where it comes from, and where it goes.
    surface : str
        The section on which both parts meet.
    z : numpy.ndarray
        The state there, shape (dim,).
    mismatch : float
        Largest difference of both parts on the section, relative to the size of each component.
    error : float
        Estimated error of the state on the section, relative to that size: of both trajectories and
        of both local manifolds.
    transversality : float
        How far the manifolds are from a tangency: the smallest singular value of the derivative of
        the equations by the unknowns, with columns of length 1, relative to the largest.
    success : bool
        Whether the mismatch is within the tolerance, and the error within 1e-6.
    message : str
    met : Met
        Both parts: their starts, solutions, mismatch and transversality.
    """

    origins: tuple[Origin, Origin]
    surface: str
    z: np.ndarray
    mismatch: float
    error: float
    transversality: float
    success: bool
    message: str
    met: Met = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"Connection(on {self.surface!r}, mismatch {self.mismatch:.1e}, success={self.success})"
        )

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian with its parameters."""
        return self.met.sides[0].leaving.H

    @property
    def span(self) -> tuple[float, float]:
        """Times on the unstable and on the stable local manifold; 0 is on the section."""
        return -self.met.sides[0].time, self.met.sides[1].time

    @property
    def clock(self) -> float:
        """Time of H on the section; up to periods of the orbits."""
        return float(self.met.solutions[0].span[1])

    @property
    def energy(self) -> float:
        """H of the origins."""
        return float(self.origins[0].energy)

    def family(self, **target: Any) -> tuple[Connection, ...]:
        """Continue the connection; see :func:`hamsym.connection_family`."""
        return hamsym.connection_family(self, **target)

    def __call__(self, t: Any) -> np.ndarray:
        """Return states at times t, shape (n, dim), or (dim,) for a scalar.

        Raises
        ------
        InputError
            If a time is outside the span.
        """
        times = np.asarray(times_in_span(t, self.span))
        flat = np.atleast_1d(times)
        found = np.empty((len(flat), self.H.dim))
        before, after = self.met.solutions
        for solution, own in ((before, flat <= 0), (after, flat > 0)):
            if own.any():
                found[own] = _at(solution, flat[own])
        return found[0] if times.ndim == 0 else found


def _at(solution: Solution, times: np.ndarray) -> np.ndarray:
    """States of a trajectory whose end has the time 0."""
    low, high = sorted(solution.span)
    return np.asarray(solution(np.clip(solution.span[1] + times, low, high)))


@suggest_attributes
@dataclass(frozen=True, eq=False)
class Connections(Drawn, Shown, Listed[Connection]):
    """The connections that were found on a section; a sequence, the most transversal first.

    ``plot()`` draws the cuts of both manifolds with the section, and the connections in them.

    Attributes
    ----------
    found : tuple of Connection
    unstable, stable : Manifold
    surface : str
    cuts : (Cut, Cut)
        Crossings of the section by the unstable and by the stable manifold: ``t``, ``z``,
        ``trajectory``.
    success : bool
        Whether both local manifolds are accurate and at least one connection was found; each has
        its own success. Where trajectories of a manifold end early, as at a collision, others may
        be missed, and ``message`` says so.
    message : str
    seconds : float
    """

    found: tuple[Connection, ...]
    unstable: Manifold
    stable: Manifold
    surface: str
    cuts: tuple[Cut, Cut] = field(repr=False)
    success: bool
    message: str
    seconds: float

    def __repr__(self) -> str:
        return f"Connections({self.H.formulas!r}, on {self.surface!r}: {self.message})"

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian with its parameters."""
        return self.unstable.H


@checked_keywords
def connections(
    unstable: Manifold,
    stable: Manifold,
    surface: Any,
    *,
    crossings: int = 4,
    tol: float = 1e-10,
) -> Connections:
    """Find trajectories on the unstable manifold of one origin and the stable one of another.

    Both manifolds are cut with a section. Where curves of crossings come near each other, Newton's
    method solves for a trajectory on both, with derivatives from the variational equation.

    Parameters
    ----------
    unstable, stable : Manifold
        Of :func:`hamsym.manifolds`, of one Hamiltonian and one energy. Of one origin, connections
        are homoclinic, of two heteroclinic.
    surface : str, sympy.Expr or sympy.Eq
        As in :func:`hamsym.section`, for example ``"x = 0, p_x > 0"``.
    crossings : int
        Number of crossings of each trajectory that are used.
    tol : float
        Largest mismatch, relative to the size of each component on both manifolds.

    Returns
    -------
    Connections

    Raises
    ------
    InputError
        If the arguments do not fit: other Hamiltonians, energies, or kinds of manifolds; or, where
        H depends on time, orbits of other periods.

    Examples
    --------
    Both loops of the Duffing oscillator, from its saddle back to it:

    >>> import hamsym
    >>> found = hamsym.equilibria("p**2/2 - x**2/2 + x**4/4")[2].manifolds()
    >>> loops = connections(found.unstable, found.stable, "p = 0")
    >>> sorted(round(float(loop.z[0]), 9) for loop in loops)
    [-1.414213562, 1.414213562]
    """
    began = time.perf_counter()
    _require_fitting(unstable, stable)
    require_whole("crossings", crossings)
    require_positive("tol", tol)
    where = parse_surface(unstable.H, surface)
    cuts = cut_of(unstable, where, int(crossings)), cut_of(stable, where, int(crossings))
    found = _Search((unstable, stable), where, cuts, tol).connections()
    accurate = unstable.local_error <= unstable.tol and stable.local_error <= stable.tol
    problems = [
        f"{each.kind} manifold: {each.message}" for each in (unstable, stable) if not each.success
    ]
    kinds = f"{len(cuts[0].t)} and {len(cuts[1].t)} crossings"
    message = f"{len(found)} connections between {kinds}"
    return Connections(
        tuple(found),
        unstable,
        stable,
        where.text,
        cuts,
        bool(found) and accurate,
        "; ".join([message, *problems]),
        time.perf_counter() - began,
    )


def _require_fitting(unstable: Manifold, stable: Manifold) -> None:
    for each, kind in ((unstable, "unstable"), (stable, "stable")):
        if not isinstance(each, Manifold):
            raise InputError(f"{type(each).__name__} is not a manifold; give manifolds(...).{kind}")
        if each.kind != kind:
            raise InputError(f"a connection goes from an unstable to a stable manifold; give the "
                             f"{kind} one of the origin, not the {each.kind} one")  # fmt: skip
    if unstable.H != stable.H:
        raise InputError("the manifolds are of two Hamiltonians; give manifolds of one")
    periods = [each.departure.period for each in (unstable, stable)]
    if unstable.H.time is not None and not _alike(periods):
        raise InputError("H depends on time; give manifolds of orbits of one period")
    if not unstable.H.conserves_energy:
        return
    exchanged = max(_exchanged(unstable), _exchanged(stable))
    if not abs(unstable.energy - stable.energy) <= _ENERGY * exchanged:
        raise InputError(
            f"a connection keeps its energy, but the energies of the origins are "
            f"{unstable.energy:.10g} and {stable.energy:.10g}; give origins of one energy"
        )


def _alike(periods: Sequence[float | None]) -> bool:
    first, second = periods
    if first is None or second is None:
        return False
    return abs(first - second) <= _PERIOD * first


def _exchanged(manifold: Manifold) -> float:
    """A size of the energy near the origin: |grad H| times the size of the local manifold."""
    states, scale = manifold.z0, manifold.departure.local.scale
    slopes = np.abs(manifold.H.compile("numpy").at("gradient", states))
    return float((slopes * np.maximum(scale, np.abs(states).max(axis=0))).max())


@dataclass(frozen=True)
class _Search:
    """Newton's method from places where the cuts of two manifolds come near each other."""

    manifolds: tuple[Manifold, Manifold]
    where: Surface
    cuts: tuple[Cut, Cut]
    tol: float

    def connections(self) -> list[Connection]:
        """The different connections, the most transversal first."""
        (first, second), cuts = self.manifolds, self.cuts
        segments = tuple(
            cut.segments(each.starts.neighbours())
            for cut, each in zip(cuts, self.manifolds, strict=True)
        )
        found: list[Connection] = []
        known: list[Met] = []
        clock = None if first.H.time is None else first.departure.period
        scale = np.maximum(first.departure.local.scale, second.departure.local.scale)
        for place in nearby(cuts, segments, scale, clock, _CANDIDATES):
            sides = [
                self._side(n, own, share)
                for n, own, share in zip((0, 1), place.pairs, place.shares, strict=True)
            ]
            met = meet((sides[0], sides[1]), self.where, self.tol, known)
            if met is None or not met.mismatch <= self.tol:
                continue
            known.append(met)
            one = connection_of((first.origin, second.origin), self.where, met, self.tol)
            if one.success and not any(self._same(one, other) for other in found):
                found.append(one)
        return sorted(found, key=lambda one: -one.transversality)

    def _same(self, one: Connection, other: Connection) -> bool:
        """Whether they are one trajectory, which may meet on the section several times."""
        (low, high), (start, end) = one.span, other.span
        long = end - start
        if not abs(high - low - long) <= _SAME * long:
            return False
        apart = np.abs(np.array([one(low) - other(start), one(high) - other(end)]))
        return bool((apart <= _SAME * one.met.scale).all())

    def _side(self, n: int, pair: tuple[int, int], share: float) -> Side:
        """A guess between two crossings of neighbours."""
        each, cut = self.manifolds[n], self.cuts[n]
        a, b = (int(cut.trajectory[k]) for k in pair)
        direction = (1 - share) * each.directions[a] + share * each.directions[b]
        t = (1 - share) * cut.t[pair[0]] + share * cut.t[pair[1]]
        return Side(
            each.departure,
            direction / np.linalg.norm(direction),
            float((1 - share) * each.phases[a] + share * each.phases[b]),
            abs(float(t) - each.departure.start),
        )


def connection_of(
    origins: tuple[Origin, Origin], where: Surface, met: Met, tol: float
) -> Connection:
    """Judge a solution of the boundary-value problem."""
    first, _ = met.solutions
    ends = [np.asarray(solution.error_estimate(solution.span[1])) for solution in met.solutions]
    at_section = (np.abs(np.array(ends)) / met.scale).max()
    error = float(np.max([at_section, *(side.local_error(tol) for side in met.sides)]))
    success, message = True, f"both parts meet to {met.mismatch:.1e}"
    if not met.mismatch <= tol:
        success, message = False, f"both parts miss each other by {met.mismatch:.1e}"
    elif not error <= _ACCURATE:
        success, message = False, f"both parts meet, but have an error of {error:.1e}"
    elif not met.transversality > _TRANSVERSAL:
        message += "; one of a continuum, or a tangency"
    return Connection(
        origins,
        where.text,
        first(first.span[1]),
        met.mismatch,
        error,
        met.transversality,
        success,
        message,
        met,
    )
