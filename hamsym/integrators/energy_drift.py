"""Energy drift: the change of H by time steps, and the number of steps that limits it.

Input:  a Hamiltonian, states along trajectories.
Output: the change of H relative to the energy that the motion exchanges, and a number of steps.

The scale of the change is the energy that coordinates and momenta exchange: twice the standard
deviation over time of the integral of dH/dq_i dq_i, summed over the pairs i. For p^2/2 + V(q) that
is the variation of V along the trajectory, to which a short close encounter contributes little. The
scale does not depend on a constant in H, the origin of q or the units. It is limited by twice the
root mean square of p_i dH/dp_i, twice a kinetic energy, which matters when the states are too far
apart to resolve the integral.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np
from scipy.interpolate import make_interp_spline

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.coefficients import RungeKutta, Scheme

#: Target drift of the choice of steps; where H is not conserved, target change by halving the step.
AIM = 1e-9
#: Drift above which the given steps do not represent the system.
COARSE = 0.01

_EPS = float(np.finfo(float).eps)
_MAX_COMPONENTS = 2_000_000  # components of the states in one evaluation of H
_MIN_STEPS = 1_000  # smallest number of steps; larger ones are this times a power of two
_ANGLE = 0.2  # largest phase of the fastest linear motion in a step, radians
_MAX_UPDATES = 2e9  # largest number of component updates in one run
_MAX_STALLED = 10  # doublings without halving the drift, after which the search ends
_MAX_STALLED_RESOLVED = 3  # the same once the steps resolve the motion: the rest is round-off
_TESTED_SHARE = 0.9  # tested part of a trajectory that ends early; no step resolves the rest
_SAMPLES = 4_000  # components of the states at which the Hessian is evaluated


class EnergyDrift:
    """Accumulator of the change of H along trajectories, given in pieces.

    - H: If it is not conserved, by explicit time or forces, the drift is nan.
    - count: Number of trajectories.
    - parameters: Values of each trajectory, shape (count, k); by default those of H.
    """

    def __init__(self, H: Hamiltonian, count: int, parameters: np.ndarray | None = None) -> None:
        self._H, self._system, self._count = H, H.compile("numpy"), count
        self._values = self._system.keywords(None if parameters is None else parameters[:, None])
        self._first = np.full(count, np.nan)
        #: max_t |H - H(start)| of each trajectory; infinite where H is nan or infinite.
        self.change = np.zeros(count)
        # Energy exchanged so far; sums over the states of it, of its square and of (p dH/dp)^2.
        self._exchanged, self._sum, self._squares, self._kinetic = np.zeros((4, count, H.dof))
        self._states, self._size = np.zeros(count), np.zeros(count)

    def add(self, path: np.ndarray) -> None:
        """Add states of shape (count, n, dim), beginning with the last state of the piece before.

        States after the end of a trajectory are not finite and are ignored.
        """
        if not self._H.conserves_energy:
            return
        rows = max(2, _MAX_COMPONENTS // (self._count * self._H.dim))
        for first in range(0, max(path.shape[1] - 1, 1), rows - 1):
            with np.errstate(all="ignore"):
                self._add(path[:, first : first + rows])

    def _add(self, path: np.ndarray) -> None:
        dof, there = self._H.dof, np.isfinite(path).all(axis=-1)
        energy = np.asarray(self._system.energy(path, **self._values), dtype=float)
        gradient = np.asarray(self._system.gradient(path, **self._values), dtype=float)
        self._first = np.where(np.isnan(self._first), energy[:, 0], self._first)
        change = np.abs(energy - self._first[:, None])
        change = np.where(there, np.nan_to_num(change, nan=np.inf), 0.0)
        self.change = np.maximum(self.change, change.max(axis=1))
        q, p, force = path[..., :dof], path[..., dof:], gradient[..., :dof]
        work = _finite_or_zero((force[:, 1:] + force[:, :-1]) / 2 * np.diff(q, axis=1))
        work = np.cumsum(np.concatenate((self._exchanged[:, None], work), axis=1), axis=1)
        self._exchanged = work[:, -1]
        work = np.where(there[..., None], work, 0.0)
        self._sum += work.sum(axis=1)
        self._squares += (work**2).sum(axis=1)
        self._kinetic += (_finite_or_zero(p * gradient[..., dof:]) ** 2).sum(axis=1)
        self._states += there.sum(axis=1)
        size = _finite_or_zero(np.abs(path * gradient)).sum(axis=-1) + _finite_or_zero(
            np.abs(energy)
        )
        self._size = np.maximum(self._size, size.max(axis=1))

    @property
    def scale(self) -> np.ndarray:
        """Energy that each trajectory exchanges, shape (count,)."""
        states = np.maximum(self._states, 1)[:, None]
        with np.errstate(all="ignore"):
            variance = np.maximum(self._squares / states - (self._sum / states) ** 2, 0.0)
            return 2 * np.sqrt(np.minimum(variance, self._kinetic / states)).sum(axis=1)

    def relative(self, steps: int) -> np.ndarray:
        """Change of H in excess of round-off, divided by the scale, shape (count,).

        Infinite where the quotient is not finite, nan if H is not conserved.

        - steps: Steps of the run, from which the round-off is estimated.
        """
        if not self._H.conserves_energy:
            return np.full(self._count, np.nan)
        with np.errstate(all="ignore"):
            excess = np.maximum(self.change - _round_off(steps) * self._size, 0.0)
            share = np.where(excess == 0, 0.0, excess / self.scale)
        return np.where(np.isfinite(share), share, np.inf)


def _finite_or_zero(values: np.ndarray) -> np.ndarray:
    """Replace non-finite values by zero: a smaller scale gives a stricter test."""
    return np.where(np.isfinite(values), values, 0.0)


def _round_off(steps: int) -> float:
    """Relative round-off error that accumulates over a number of steps."""
    return 4 * _EPS * math.sqrt(1 + steps)


def work_of(t: np.ndarray, power: np.ndarray) -> np.ndarray:
    """Integrate power over time by splines, from the first time to each.

    - t: Times in order, shape (n,).
    - power: Shape (..., n); nan from the end of a trajectory on.
    - returns: Shape (..., n); nan where the power is.

    Examples
    --------
    >>> t = np.linspace(0, 2, 21)
    >>> float(work_of(t, t**4)[-1].round(12))
    6.4
    """
    rows = power.reshape(-1, len(t))
    work = np.full(rows.shape, np.nan)
    elapsed, sign = np.abs(t - t[0]), np.sign(t[-1] - t[0])
    for row, found in zip(rows, work, strict=True):
        count = int(np.logical_and.accumulate(np.isfinite(row)).sum())
        degree = 5 if count > 5 else 3 if count > 3 else 1
        if count > 1:
            spline = make_interp_spline(elapsed[:count], row[:count], k=degree)
            found[:count] = sign * spline.antiderivative()(elapsed[:count])
        elif count:
            found[0] = 0.0
    return work.reshape(power.shape)


# -- number of steps ---------------------------------------------------------------------------


@dataclass(frozen=True)
class Attempt:
    """Result of a run over the whole span with a given number of steps."""

    #: Equally spaced, shape (n,); a run with twice the steps has these times among its own.
    times: np.ndarray
    #: States, shape (batch, n, dim); nan after the end of a trajectory.
    z: np.ndarray
    interrupted: bool


AttemptT = TypeVar("AttemptT", bound=Attempt)


@dataclass(frozen=True)
class Choice(Generic[AttemptT]):
    """The last attempt, with its drift and whether the target is met."""

    attempt: AttemptT = field(repr=False)
    steps: int
    #: Largest energy drift of a trajectory; for H that is not conserved, change by halving the
    #: step.
    found: float
    #: Whether ``found`` is at most :data:`AIM` and the steps resolve the fastest linear motion.
    met: bool


def choose(
    H: Hamiltonian,
    scheme: Scheme,
    states: np.ndarray,
    span: tuple[float, float],
    run: Callable[[int], AttemptT],
    fewest: int = _MIN_STEPS,
    parameters: np.ndarray | None = None,
) -> Choice[AttemptT]:
    """Double the number of steps until every trajectory conserves H to :data:`AIM`.

    Where H is not conserved, double until halving the step changes no component by more than this
    fraction of its range. Equal steps that are too long can conserve a quadratic H exactly, so the
    steps must also resolve the fastest linear motion along the trajectories. For a trajectory that
    ends early, the first nine tenths are tested, and two successive runs must end at the same time.

    Raise InputError if resolving the motion at the start needs more steps than the limit.

    - states: Starts, shape (batch, dim).
    - run: (steps) -> :class:`Attempt`.
    - fewest: Initial number of steps.
    - parameters: Values of each trajectory, shape (batch, k); by default those of H.
    """
    length, batch = abs(span[1] - span[0]), len(states)
    most = _MAX_UPDATES / (batch * _cost(scheme, H.dim))
    rate = _fastest_rate(H, *_sampled(states[:, None], np.array([span[0]]), parameters))
    steps = fewest
    while steps < length * rate / _ANGLE:
        steps *= 2
    if steps > max(most, fewest):
        raise InputError(
            f"resolving the motion at the start needs {steps:.0e} steps, above the limit of "
            "automatic steps; give steps or dt, or a shorter span"
        )
    best, last_gain, doublings = math.inf, 0, 0
    previous: AttemptT | None = None
    while True:
        attempt = run(steps)
        tested = _tested_part(attempt.z)
        found = _deviation(H, attempt, previous, tested, steps, parameters)
        at = _fastest_rate(H, *_sampled(tested, attempt.times, parameters))
        resolved = at * length <= _ANGLE * steps
        met = found <= AIM and resolved and _same_ends(attempt, previous)
        if attempt.interrupted or met:
            break
        if found < best / 2:
            best, last_gain = found, doublings
        stuck = doublings - last_gain >= (_MAX_STALLED_RESOLVED if resolved else _MAX_STALLED)
        if stuck or not 2 * steps <= most:
            break
        previous, steps, doublings = attempt, 2 * steps, doublings + 1
    return Choice(attempt, steps, found, met)


def _cost(scheme: Scheme, dim: int) -> float:
    """Cost of a step in component updates; implicit steps solve linear equations."""
    return float((scheme.stages * dim) ** (3 if isinstance(scheme, RungeKutta) else 1))


def _tested_part(z: np.ndarray) -> np.ndarray:
    """States, with nan for the last tenth of each trajectory that ends early."""
    counts = np.isfinite(z).all(axis=-1).sum(axis=1)
    ends = np.where(counts < z.shape[1], np.ceil(_TESTED_SHARE * counts), counts)
    return np.where((np.arange(z.shape[1]) < ends[:, None])[..., None], z, np.nan)


def _deviation(
    H: Hamiltonian,
    attempt: Attempt,
    previous: Attempt | None,
    tested: np.ndarray,
    steps: int,
    parameters: np.ndarray | None,
) -> float:
    if H.conserves_energy:
        drift = EnergyDrift(H, len(tested), parameters)
        drift.add(tested)
        return float(drift.relative(steps).max())
    if previous is None:
        return math.inf
    return _change(H, attempt.times, tested, previous.z, steps, parameters)


def _change(
    H: Hamiltonian,
    times: np.ndarray,
    z: np.ndarray,
    coarse: np.ndarray,
    steps: int,
    parameters: np.ndarray | None,
) -> float:
    """Largest difference of two runs in excess of round-off, relative to each component's range."""
    stride = (z.shape[1] - 1) // (coarse.shape[1] - 1)
    there = np.isfinite(z).all(axis=-1, keepdims=True)
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        at, t, values = _sampled(z, times, parameters)
        given = system.keywords(values)
        matrices = np.abs(system.jacobian(*system.arguments(at, t), **given))
        rates = np.abs(np.asarray(system.vector_field(*system.arguments(at, t), **given)))
        rounded = _finite_or_zero(np.einsum("nij,nj->ni", matrices, np.abs(at))).max(axis=0)
        size = np.where(there, np.abs(z), 0.0).max(axis=1)
        noise = _round_off(steps) * (size + abs(times[-1] - times[0]) / steps * rounded)
        noise += _EPS * np.abs(times).max() * _finite_or_zero(rates).max(axis=0)
        high = np.where(there, z, -np.inf).max(axis=1)
        low = np.where(there, z, np.inf).min(axis=1)
        difference = np.abs(z[:, ::stride] - coarse)
        difference = np.where(there[:, ::stride], np.nan_to_num(difference, nan=np.inf), 0.0)
        excess = np.maximum(difference.max(axis=1) - noise, 0.0)
        share = np.where(excess == 0, 0.0, excess / (high - low))
    return float(np.where(np.isfinite(share), share, np.inf).max())


def _same_ends(attempt: Attempt, previous: Attempt | None) -> bool:
    """Whether all trajectories reach the end, or end where they did with longer steps."""
    counts = np.isfinite(attempt.z).all(axis=-1).sum(axis=1)
    if counts.min() == len(attempt.times):
        return True
    if previous is None:
        return False
    ends = attempt.times[np.maximum(counts, 1) - 1]
    before = np.isfinite(previous.z).all(axis=-1).sum(axis=1)
    between = np.abs(ends - previous.times[np.maximum(before, 1) - 1])
    return bool(between.max() <= 2 * abs(previous.times[1] - previous.times[0]))


def _sampled(
    z: np.ndarray, times: np.ndarray, parameters: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """A sample of the finite states, shape (n, dim), their times and parameters."""
    there = np.argwhere(np.isfinite(z).all(axis=-1))
    number = max(64, _SAMPLES // z.shape[-1])
    some = there[np.linspace(0, len(there) - 1, min(len(there), number)).astype(int)]
    values = None if parameters is None else parameters[some[:, 0]]
    return z[some[:, 0], some[:, 1]], times[some[:, 1]], values


def _fastest_rate(
    H: Hamiltonian, states: np.ndarray, times: np.ndarray, parameters: np.ndarray | None
) -> float:
    """Largest spectral radius of J Hess over the states where it is finite, per unit of time."""
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        arguments, given = system.arguments(states, times), system.keywords(parameters)
        matrices = np.asarray(system.jacobian(*arguments, **given))
    matrices = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    return float(np.abs(np.linalg.eigvals(matrices)).max(initial=0.0))
