"""Stable and unstable manifolds, grown from their local parts as families of trajectories."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from hamsym.dynamics.equilibrium import Equilibrium
from hamsym.errors import InputError
from hamsym.families.solutions import Solutions
from hamsym.hamiltonian import Hamiltonian
from hamsym.invariant_manifolds.growth import Growth, Starts, arc_length, grow, path
from hamsym.invariant_manifolds.origins import Departure, Origin, departure
from hamsym.orbits.orbit import PeriodicOrbit
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.validation import require_positive, require_whole

LOCAL = 1e-3  # of the tolerance: error of the local manifold that is aimed at
_FOLDINGS = 6.0  # times that a manifold grows e times by default, beyond its local part
_DOUBLINGS = 6  # of the time, for a length


@suggest_attributes
@dataclass(frozen=True, eq=False)
class Manifold(Drawn, Shown):
    """The stable or the unstable manifold of an equilibrium or a periodic orbit.

    It is a family of trajectories that begin near the origin and move away from it, those of the
    stable manifold backwards in time. A branch of an equilibrium with one exponent is one
    trajectory; with two exponents or complex ones the starts are a ring about it. Near an orbit the
    starts have phases from 0 to 1: after the time ``phase*period`` each one is at the edge of
    the local manifold, that many turns along the orbit.

    ``plot()`` draws it in the plane of the first two coordinates, or of coordinate and momentum;
    two names draw another plane.

    Attributes
    ----------
    origin : Equilibrium or PeriodicOrbit
    kind : str
        "stable" or "unstable".
    trajectories : Solutions
        From the starts away from the origin, over the whole time.
    ends : numpy.ndarray
        Time at which each trajectory ends, because it has the length that was asked for, or is not
        accurate any more, shape (n,).
    starts : Starts
        Strands of the starts and their places along them, with the local manifold.
    tol : float
    gap : float
        Largest distance of neighbours at one time, relative to the extent of each component; 0
        without neighbours.
    success : bool
        Whether the local error and those of all trajectories, up to their ends, are within the
        tolerance, and the trajectories have the time or length that was asked for.
    message : str
    seconds : float
    """

    origin: Origin
    kind: str
    trajectories: Solutions = field(repr=False)
    ends: np.ndarray = field(repr=False)
    tol: float
    gap: float
    success: bool
    message: str
    seconds: float
    starts: Starts = field(repr=False)

    def __repr__(self) -> str:
        return (
            f"Manifold({self.kind}, {self.dimension}-dimensional, {len(self)} trajectories, "
            f"success={self.success})"
        )

    def __len__(self) -> int:
        return len(self.phases)

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian with its parameters."""
        return self.departure.H

    @property
    def departure(self) -> Departure:
        """The local manifold, and how trajectories leave it."""
        return self.starts.leaving

    @property
    def directions(self) -> np.ndarray:
        """Directions of the starts in the coordinates of the local manifold, length 1, (n, k)."""
        return self.starts.directions

    @property
    def phases(self) -> np.ndarray:
        """Phases of the starts along an orbit, shape (n,); 0 at an equilibrium."""
        return self.starts.phases

    @property
    def z0(self) -> np.ndarray:
        """The starts, shape (n, dim)."""
        return self.trajectories.z0

    @property
    def span(self) -> tuple[float, float]:
        """The time of the longest trajectory, from the start; backwards for a stable manifold."""
        return self.trajectories.span

    @property
    def dimension(self) -> int:
        """Dimension of the manifold: number of exponents, and one for the phase of an orbit."""
        return self.departure.local.dimension + (self.departure.period is not None)

    @property
    def rates(self) -> np.ndarray:
        """Exponents of an equilibrium, in units of 1/time, or multipliers of an orbit, complex."""
        rates = self.departure.rates
        if self.kind == "unstable":
            return rates
        return -rates if self.departure.period is None else 1 / rates

    @property
    def local_error(self) -> float:
        """Estimated distance of the starts from the true manifold, relative to their spread."""
        return self.departure.local.error

    @property
    def energy(self) -> float:
        """H of the origin."""
        return float(self.origin.energy)

    def __call__(self, t: Any) -> np.ndarray:
        """Return the states of all trajectories at times t, (n, len(t), dim), or (n, dim).

        They are nan after the end of a trajectory.

        Parameters
        ----------
        t : float or sequence
            Within ``span``.
        """
        states = self.trajectories(t)
        times = np.asarray(t, dtype=float)
        sign = self.departure.sign
        late = sign * times > sign * self.ends.reshape(-1, *(1,) * times.ndim)
        return np.where(late[..., None], np.nan, states)

    @cached_property
    def paths(self) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
        """Times and states of each trajectory up to its end, at points that resolve it."""
        return tuple(
            path(self.trajectories, k, float(end)) for k, end in enumerate(self.ends.tolist())
        )

    @property
    def lengths(self) -> np.ndarray:
        """Arc lengths of the trajectories, in the 2-norm of z in the units of H, shape (n,)."""
        ends = self.ends.tolist()
        return np.array([arc_length(self.trajectories, k, end) for k, end in enumerate(ends)])


@suggest_attributes
@dataclass(frozen=True, eq=False)
class Manifolds(Drawn, Shown):
    """The stable and the unstable manifold of an equilibrium or a periodic orbit.

    ``plot()`` draws both in the plane of the first two coordinates, or of coordinate and momentum;
    two names draw another plane.

    Attributes
    ----------
    origin : Equilibrium or PeriodicOrbit
    unstable, stable : Manifold
    """

    origin: Origin
    unstable: Manifold
    stable: Manifold

    def __repr__(self) -> str:
        return f"Manifolds({self.unstable!r}, {self.stable!r})"

    def __iter__(self) -> Iterator[Manifold]:
        return iter((self.unstable, self.stable))

    @property
    def H(self) -> Hamiltonian:
        """Hamiltonian with its parameters."""
        return self.unstable.H

    @property
    def success(self) -> bool:
        """Whether both are accurate and complete."""
        return self.unstable.success and self.stable.success

    @property
    def message(self) -> str:
        """Outcome of both."""
        return f"unstable: {self.unstable.message}; stable: {self.stable.message}"

    @property
    def seconds(self) -> float:
        """Run time."""
        return self.unstable.seconds + self.stable.seconds


@checked_keywords
def manifolds(
    origin: Origin,
    *,
    duration: float | None = None,
    length: float | None = None,
    count: int = 24,
    spacing: float = 0.1,
    tol: float = 1e-9,
) -> Manifolds:
    """Compute the stable and the unstable manifold of an equilibrium or a periodic orbit.

    Near its origin a manifold is a polynomial, the solution of its invariance equation
    (:mod:`hamsym.invariant_manifolds.parameterization`), so that starts need not be close to the
    origin to be accurate. From there trajectories are solved to the tolerance, and new ones are
    inserted where neighbours part.

    Parameters
    ----------
    origin : Equilibrium or PeriodicOrbit
        With eigenvalues that have real parts, or multipliers off the unit circle.
    duration : float, optional
        Time from the local manifold on, in the units of H. By default that in which it grows
        e^6 times in its slowest direction.
    length : float, optional
        Arc length at which each trajectory ends, in the 2-norm of z in the units of H. Without
        ``duration`` the time is extended until all have it, up to 64 times.
    count : int
        Number of starts on a ring, or of phases on each side of an orbit, before insertions.
    spacing : float
        Distance of neighbours, relative to the extent of each component, above which a trajectory
        is inserted between them; at most 8 times ``count`` trajectories are computed.
    tol : float
        Tolerance of trajectories, as in :func:`hamsym.solve`, and of the local manifold.

    Returns
    -------
    Manifolds

    Raises
    ------
    InputError
        If an argument is not valid, or there is no manifold, as of a centre.

    Examples
    --------
    The separatrix of a pendulum, on which the energy is 1:

    >>> import hamsym
    >>> saddle = hamsym.equilibria("p**2/2 - cos(x)")[1]
    >>> found = manifolds(saddle)
    >>> found.success, found.unstable.local_error < 1e-12
    (True, True)
    >>> bool(abs(found.unstable.trajectories.energy([0, 3, 6]) - 1).max() < 1e-12)
    True
    """
    if not isinstance(origin, Equilibrium | PeriodicOrbit):
        raise InputError(
            f"{type(origin).__name__} has no manifolds; give an Equilibrium or a PeriodicOrbit"
        )
    for name, value in (("duration", duration), ("length", length)):
        if value is not None:
            require_positive(name, value)
    require_whole("count", count)
    require_positive("spacing", spacing)
    require_positive("tol", tol)
    parts = [
        _grown(origin, sign, duration, length, max(int(count), 3), spacing, tol) for sign in (1, -1)
    ]
    return Manifolds(origin, *parts)


def _grown(
    origin: Origin,
    sign: int,
    duration: float | None,
    length: float | None,
    count: int,
    spacing: float,
    tol: float,
) -> Manifold:
    """Grow one manifold."""
    began = time.perf_counter()
    leaving = departure(origin, sign, LOCAL * tol)
    elapsed = _FOLDINGS * leaving.time if duration is None else duration
    for _ in range(_DOUBLINGS + 1):
        found = grow(Starts.first(leaving, count), elapsed, length, spacing, tol)
        short = ~found.long & ~found.failed
        if length is None or duration is not None or not short.any():
            break
        elapsed *= 2
    incomplete = short if length is not None and duration is None else np.zeros_like(short)
    starts, many = found.starts, found.many
    leaving = leaving.followed(starts.directions, starts.phases, tol)
    starts = replace(starts, leaving=leaving)
    problem = _problem(leaving, found, tol, length, incomplete)
    return Manifold(
        origin,
        "unstable" if sign > 0 else "stable",
        many,
        found.ends,
        tol,
        found.gap,
        not problem,
        problem or f"{len(many)} trajectories, over a time of {elapsed:.6g}",
        time.perf_counter() - began,
        starts,
    )


def _problem(
    leaving: Departure, found: Growth, tol: float, length: float | None, short: np.ndarray
) -> str:
    """Why a manifold is not accurate or complete, or an empty text."""
    failed, number = found.failed, len(found.ends)
    if not leaving.local.error <= tol:
        return (
            f"the local manifold has an error of {leaving.local.error:.1e} of its size, because of "
            "round-off, a resonance of exponents or a narrow feature of the force"
        )
    if failed.any():
        k = int(np.argmax(failed))
        return (
            f"{int(failed.sum())} of {number} trajectories end early, for example number {k} at "
            f"t = {found.ends[k]:.6g}: {str(found.many.message[k]).split(';')[0]}"
        )
    if short.any():
        return f"{int(short.sum())} of {number} trajectories do not reach the length {length:g}"
    return ""
