"""Energy drift: by how much time steps change H, and how many steps keep it.

Input:  a Hamiltonian, states along trajectories.
Output: the change of H relative to the energy that the motion exchanges, and a number of steps.

The scale of the change is the energy that coordinates and momenta exchange: twice the standard
deviation over time of the integral of dH/dq_i dq_i, summed over the pairs i. For p^2/2 + V(q) that
is by how much V varies on the way; a short close encounter hardly adds to it. A constant in H, the
origin of q and the units do not matter. Where states are too far apart for the integral, twice the
root mean square of p_i dH/dp_i, which is twice a kinetic energy, limits it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.coefficients import RungeKutta, Scheme
from hamsym.numerics.symplectic import generators

__all__ = ["AIM", "COARSE", "Attempt", "Choice", "EnergyDrift", "choose"]

#: Drift for which steps are chosen; where H depends on time, change by halving the step.
AIM = 1e-9
#: Drift beyond which steps that were asked for draw another system.
COARSE = 0.01

_EPS = float(np.finfo(float).eps)
_HELD = 2_000_000  # numbers for which H is evaluated at once
_FEWEST = 1_000  # steps; others are these times a power of two
_ANGLE = 0.2  # radians of the fastest linear motion in a step, at most
_WORK = 2e9  # updates of a component in one run, at most
_HOPELESS = 10  # doublings without half the drift, after which no further one is tried
_FLAT = 3  # the same where steps resolve the motion: the rest is round-off
_JUDGED = 0.9  # of a trajectory that breaks off: beyond it no step is small enough
_SAMPLES = 4_000  # components of states at which the Hessian is looked at


class EnergyDrift:
    """The change of H along trajectories, taken in piece by piece.

    Parameters
    ----------
    H : Hamiltonian
        Without explicit time; otherwise there is nothing to take in, and the drift is nan.
    count : int
        Trajectories.
    """

    def __init__(self, H: Hamiltonian, count: int) -> None:
        self._H, self._system, self._count = H, H.compile("numpy"), count
        self._first = np.full(count, np.nan)
        #: max_t |H - H(start)| of each trajectory; infinite where H is not a number on the way.
        self.change = np.zeros(count)
        # Sums over the states of the energy exchanged so far, its square, and (p dH/dp)^2.
        self._exchanged, self._sum, self._squares, self._kinetic = np.zeros((4, count, H.dof))
        self._states, self._size = np.zeros(count), np.zeros(count)

    def add(self, path: np.ndarray) -> None:
        """Take in states of shape (count, n, dim), which begin where the piece before ended.

        States that are not finite are those after the end of a trajectory, and do not count.
        """
        if self._H.time is not None:
            return
        rows = max(2, _HELD // (self._count * self._H.dim))
        for first in range(0, max(path.shape[1] - 1, 1), rows - 1):
            with np.errstate(all="ignore"):
                self._add(path[:, first : first + rows])

    def _add(self, path: np.ndarray) -> None:
        dof, there = self._H.dof, np.isfinite(path).all(axis=-1)
        energy = np.asarray(self._system.energy(path), dtype=float)
        gradient = np.asarray(self._system.gradient(path), dtype=float)
        self._first = np.where(np.isnan(self._first), energy[:, 0], self._first)
        change = np.abs(energy - self._first[:, None])
        change = np.where(there, np.nan_to_num(change, nan=np.inf), 0.0)
        self.change = np.maximum(self.change, change.max(axis=1))
        q, p, force = path[..., :dof], path[..., dof:], gradient[..., :dof]
        work = _usable((force[:, 1:] + force[:, :-1]) / 2 * np.diff(q, axis=1))
        work = np.cumsum(np.concatenate((self._exchanged[:, None], work), axis=1), axis=1)
        self._exchanged = work[:, -1]
        work = np.where(there[..., None], work, 0.0)
        self._sum += work.sum(axis=1)
        self._squares += (work**2).sum(axis=1)
        self._kinetic += (_usable(p * gradient[..., dof:]) ** 2).sum(axis=1)
        self._states += there.sum(axis=1)
        size = _usable(np.abs(path * gradient)).sum(axis=-1) + _usable(np.abs(energy))
        self._size = np.maximum(self._size, size.max(axis=1))

    @property
    def scale(self) -> np.ndarray:
        """The energy that each trajectory exchanges, shape (count,)."""
        states = np.maximum(self._states, 1)[:, None]
        with np.errstate(all="ignore"):
            variance = np.maximum(self._squares / states - (self._sum / states) ** 2, 0.0)
            return 2 * np.sqrt(np.minimum(variance, self._kinetic / states)).sum(axis=1)

    def relative(self, steps: int) -> np.ndarray:
        """The change beyond the round-off of so many steps, over the scale, shape (count,).

        Infinite where it is not a number, nan if H depends on time.
        """
        if self._H.time is not None:
            return np.full(self._count, np.nan)
        with np.errstate(all="ignore"):
            excess = np.maximum(self.change - _round_off(steps) * self._size, 0.0)
            share = np.where(excess == 0, 0.0, excess / self.scale)
        return np.where(np.isfinite(share), share, np.inf)


def _usable(values: np.ndarray) -> np.ndarray:
    """The same with zero for what is not finite: a smaller scale is the stricter one."""
    return np.where(np.isfinite(values), values, 0.0)


def _round_off(steps: int) -> float:
    """What rounding makes of so many steps, relative to the size of what is rounded."""
    return 4 * _EPS * math.sqrt(1 + steps)


# -- how many steps ----------------------------------------------------------------------------


@dataclass(frozen=True)
class Attempt:
    """A run over the whole span with some number of steps.

    Attributes
    ----------
    times : numpy.ndarray
        Equally spaced, shape (n,); those of fewer steps are among those of twice as many.
    z : numpy.ndarray
        States, shape (batch, n, dim); nan after the end of a trajectory.
    interrupted : bool
    """

    times: np.ndarray
    z: np.ndarray
    interrupted: bool


AttemptT = TypeVar("AttemptT", bound=Attempt)


@dataclass(frozen=True)
class Choice(Generic[AttemptT]):
    """The last attempt, and what was found about it.

    Attributes
    ----------
    attempt : Attempt
    steps : int
    found : float
        Largest energy drift of a trajectory, or change by halving the step if H depends on time.
    met : bool
        Whether that is within :data:`AIM`, with steps that resolve the fastest linear motion.
    """

    attempt: AttemptT = field(repr=False)
    steps: int
    found: float
    met: bool


def choose(
    H: Hamiltonian,
    scheme: Scheme,
    states: np.ndarray,
    span: tuple[float, float],
    run: Callable[[int], AttemptT],
    fewest: int = _FEWEST,
) -> Choice[AttemptT]:
    """Double the number of steps until H is kept to :data:`AIM` by every trajectory.

    Where H depends on time, until halving the step changes no component by more than that part of
    its own range. Equal steps that are too long may keep a quadratic H exactly, so they also have
    to resolve the fastest linear motion on the way. A trajectory that breaks off is judged on
    nine tenths of what there is of it, and has to break off at the same time twice.

    Parameters
    ----------
    H : Hamiltonian
    scheme : Scheme
    states : numpy.ndarray
        Starts, shape (batch, dim).
    span : (float, float)
    run : callable
        A number of steps -> :class:`Attempt`.
    fewest : int
        Steps to begin with.

    Raises
    ------
    InputError
        If what resolves the motion at the start is out of reach already.
    """
    length, batch = abs(span[1] - span[0]), len(states)
    most = _WORK / (batch * _cost(scheme, H.dim))
    rate = _fastest_rate(H, *_sampled(states[:, None], np.array([span[0]])))
    steps = fewest
    while steps < length * rate / _ANGLE:
        steps *= 2
    if steps > max(most, fewest):
        raise InputError(
            f"the motion at the start asks for {steps:.0e} steps, too many to be chosen; give "
            "steps or dt, or a shorter span"
        )
    best, last_gain, doublings = math.inf, 0, 0
    previous: AttemptT | None = None
    while True:
        attempt = run(steps)
        judged = _judged(attempt.z)
        found = _found(H, attempt, previous, judged, steps)
        at = _fastest_rate(H, *_sampled(judged, attempt.times))
        resolved = at * length <= _ANGLE * steps
        met = found <= AIM and resolved and _same_ends(attempt, previous)
        if attempt.interrupted or met:
            break
        if found < best / 2:
            best, last_gain = found, doublings
        stuck = doublings - last_gain >= (_FLAT if resolved else _HOPELESS)
        if stuck or not 2 * steps <= most:
            break
        previous, steps, doublings = attempt, 2 * steps, doublings + 1
    return Choice(attempt, steps, found, met)


def _cost(scheme: Scheme, dim: int) -> float:
    """Of a step, in updates of a component; an implicit one solves linear equations."""
    return float((scheme.stages * dim) ** (3 if isinstance(scheme, RungeKutta) else 1))


def _judged(z: np.ndarray) -> np.ndarray:
    """States without the last ones of trajectories that break off."""
    counts = np.isfinite(z).all(axis=-1).sum(axis=1)
    ends = np.where(counts < z.shape[1], np.ceil(_JUDGED * counts), counts)
    return np.where((np.arange(z.shape[1]) < ends[:, None])[..., None], z, np.nan)


def _found(
    H: Hamiltonian, attempt: Attempt, previous: Attempt | None, judged: np.ndarray, steps: int
) -> float:
    if H.time is None:
        drift = EnergyDrift(H, len(judged))
        drift.add(judged)
        return float(drift.relative(steps).max())
    if previous is None:
        return math.inf
    return _change(H, attempt.times, judged, previous.z, steps)


def _change(
    H: Hamiltonian, times: np.ndarray, z: np.ndarray, coarse: np.ndarray, steps: int
) -> float:
    """Largest difference of two runs, each component relative to its range, beyond round-off."""
    stride = (z.shape[1] - 1) // (coarse.shape[1] - 1)
    there = np.isfinite(z).all(axis=-1, keepdims=True)
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        at, t = _sampled(z, times)
        matrices = np.abs(generators(np.asarray(system.hessian(*system.arguments(at, t)))))
        rates = np.abs(np.asarray(system.vector_field(*system.arguments(at, t))))
        rounded = _usable(np.einsum("nij,nj->ni", matrices, np.abs(at))).max(axis=0)
        size = np.where(there, np.abs(z), 0.0).max(axis=1)
        noise = _round_off(steps) * (size + abs(times[-1] - times[0]) / steps * rounded)
        noise += _EPS * np.abs(times).max() * _usable(rates).max(axis=0)
        high = np.where(there, z, -np.inf).max(axis=1)
        low = np.where(there, z, np.inf).min(axis=1)
        difference = np.abs(z[:, ::stride] - coarse)
        difference = np.where(there[:, ::stride], np.nan_to_num(difference, nan=np.inf), 0.0)
        excess = np.maximum(difference.max(axis=1) - noise, 0.0)
        share = np.where(excess == 0, 0.0, excess / (high - low))
    return float(np.where(np.isfinite(share), share, np.inf).max())


def _same_ends(attempt: Attempt, previous: Attempt | None) -> bool:
    """Whether all trajectories reach the end, or break off where they did with longer steps."""
    counts = np.isfinite(attempt.z).all(axis=-1).sum(axis=1)
    if counts.min() == len(attempt.times):
        return True
    if previous is None:
        return False
    ends = attempt.times[np.maximum(counts, 1) - 1]
    before = np.isfinite(previous.z).all(axis=-1).sum(axis=1)
    between = np.abs(ends - previous.times[np.maximum(before, 1) - 1])
    return bool(between.max() <= 2 * abs(previous.times[1] - previous.times[0]))


def _sampled(z: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Some of the finite states, shape (n, dim), and their times."""
    there = np.argwhere(np.isfinite(z).all(axis=-1))
    number = max(64, _SAMPLES // z.shape[-1])
    some = there[np.linspace(0, len(there) - 1, min(len(there), number)).astype(int)]
    return z[some[:, 0], some[:, 1]], times[some[:, 1]]


def _fastest_rate(H: Hamiltonian, states: np.ndarray, times: np.ndarray) -> float:
    """Largest spectral radius of J Hess where it is finite, per unit of time."""
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        matrices = generators(np.asarray(system.hessian(*system.arguments(states, times))))
    matrices = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    return float(np.abs(np.linalg.eigvals(matrices)).max(initial=0.0))
