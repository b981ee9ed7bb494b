"""The number of equal steps that conserves H, where the user gives none.

Input:  an ensemble, a method with fixed steps, a span.
Output: :class:`Choice`: the run with the smallest number of steps that meets the target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.integrators.coefficients import RungeKutta, Scheme
from hamsym.integrators.energy_drift import EnergyDrift, finite_or_zero, round_off
from hamsym.integrators.step_scales import fastest_rates
from hamsym.integrators.stepper import Run, run_steps
from hamsym.integrators.table import INTEGRATORS
from hamsym.problems.ensemble import Ensemble

#: Target drift; where H is not conserved, target change by halving the step. Errors of the states
#: are often a hundred times larger, which a picture does not show.
AIM = 1e-9

_EPS = float(np.finfo(float).eps)
# Smallest number of steps, to see the motion; larger ones are this times a power of two.
_MIN_STEPS = 1_000
# Largest numbers of saved states and of their components, which a user can still hold and draw.
_MAX_SAVED, _MAX_SAVED_COMPONENTS = 16_000, 20_000_000
# Largest phase of the fastest linear motion in a step, in radians.
_ANGLE = 0.2
# Largest number of component updates in one run, some minutes.
_MAX_UPDATES = 2e9
# Doublings without halving the drift, after which the search ends; fewer once the steps resolve the
# motion, since the rest is round-off then.
_MAX_STALLED, _MAX_STALLED_RESOLVED = 10, 3
# Part of a trajectory that ends early which is tested; no step resolves the rest.
_TESTED_SHARE = 0.9
# Components of the states at which the Hessian is evaluated: milliseconds.
_SAMPLES = 4_000


@dataclass(frozen=True)
class Choice:
    """The last run, with its drift and whether the target is met."""

    #: Its evaluations are those of all runs.
    run: Run = field(repr=False)
    steps: int
    #: Largest energy drift of a trajectory; for H that is not conserved, change by halving the
    #: step.
    found: float
    #: Whether ``found`` is at most :data:`AIM` and the steps resolve the fastest linear motion.
    met: bool


def choose_steps(
    members: Ensemble,
    method: str,
    span: tuple[float, float],
    save_every: int | None = None,
    **options: Any,
) -> Choice:
    """Double the number of steps until every trajectory conserves H to :data:`AIM`.

    Where H is not conserved, double until halving the step changes no component by more than this
    fraction of its range. Equal steps that are too long can conserve a quadratic H exactly, so the
    steps must also resolve the fastest linear motion along the trajectories. For a trajectory that
    ends early, the first nine tenths are tested, and two successive runs must end at the same time.

    Raise InputError if resolving the motion at the start needs more steps than the limit.

    - save_every: Steps between saved states, by default few enough for the limits of saved states.
    - options: Of :func:`hamsym.integrators.stepper.run_steps`.
    """
    scheme = INTEGRATORS[method].scheme
    assert isinstance(scheme, Scheme)
    length, batch, each = abs(span[1] - span[0]), len(members), save_every or 1
    # Component updates of a step; implicit steps solve linear equations.
    cost = (scheme.stages * members.H.dim) ** (3 if isinstance(scheme, RungeKutta) else 1)
    most = _MAX_UPDATES / (batch * cost)
    steps = fewest = each * math.ceil(_MIN_STEPS / each)
    rate = fastest_rate(members, members.states[:, None], np.array([span[0]]))
    while steps < length * rate / _ANGLE:
        steps *= 2
    if steps > max(most, fewest):
        raise InputError(
            f"resolving the motion at the start needs {steps:.0e} steps, above the limit of "
            "automatic steps; give steps or dt, or a shorter span"
        )
    best, last_gain, doublings, evaluations = math.inf, 0, 0, 0
    previous: Run | None = None
    while True:
        every = save_every or _saved_every(steps, members.states.size)
        run = run_steps(members, method, span, steps, every, **options)
        evaluations += run.evaluations
        tested = _tested_part(run.z)
        found = _deviation(members, run, previous, tested, steps)
        resolved = fastest_rate(members, tested, run.times) * length <= _ANGLE * steps
        met = found <= AIM and resolved and _same_ends(run, previous)
        if run.interrupted or met:
            break
        if found < best / 2:
            best, last_gain = found, doublings
        stuck = doublings - last_gain >= (_MAX_STALLED_RESOLVED if resolved else _MAX_STALLED)
        if stuck or not 2 * steps <= most:
            break
        previous, steps, doublings = run, 2 * steps, doublings + 1
    return Choice(replace(run, evaluations=evaluations), steps, found, met)


def _saved_every(steps: int, components: int) -> int:
    """Number of steps between saved states of this many components within the limits."""
    saves = steps
    while saves > _MIN_STEPS and (saves > _MAX_SAVED or saves * components > _MAX_SAVED_COMPONENTS):
        saves //= 2
    return steps // saves


def _tested_part(z: np.ndarray) -> np.ndarray:
    """States, with nan for the last tenth of each trajectory that ends early."""
    counts = np.isfinite(z).all(axis=-1).sum(axis=1)
    ends = np.where(counts < z.shape[1], np.ceil(_TESTED_SHARE * counts), counts)
    return np.where((np.arange(z.shape[1]) < ends[:, None])[..., None], z, np.nan)


def _deviation(
    members: Ensemble, run: Run, previous: Run | None, tested: np.ndarray, steps: int
) -> float:
    """Largest energy drift of a run; where H is not conserved, its change by halving the step."""
    if members.H.conserves_energy:
        drift = EnergyDrift(members.H, len(tested), members.own_parameters())
        drift.add(tested)
        return float(drift.relative(steps).max())
    if previous is None:
        return math.inf
    return _change(members, run.times, tested, previous.z, steps)


def _change(
    members: Ensemble, times: np.ndarray, z: np.ndarray, coarse: np.ndarray, steps: int
) -> float:
    """Largest difference of two runs in excess of round-off, relative to each component's range."""
    stride = (z.shape[1] - 1) // (coarse.shape[1] - 1)
    there = np.isfinite(z).all(axis=-1, keepdims=True)
    system = members.H.compile("numpy")
    with np.errstate(all="ignore"):
        at, t, values = _sampled(members, z, times)
        matrices = np.abs(system.at("jacobian", at, t, values))
        rates = np.abs(system.at("vector_field", at, t, values))
        rounded = finite_or_zero(np.einsum("nij,nj->ni", matrices, np.abs(at))).max(axis=0)
        size = np.where(there, np.abs(z), 0.0).max(axis=1)
        noise = round_off(steps) * (size + abs(times[-1] - times[0]) / steps * rounded)
        noise += _EPS * np.abs(times).max() * finite_or_zero(rates).max(axis=0)
        high = np.where(there, z, -np.inf).max(axis=1)
        low = np.where(there, z, np.inf).min(axis=1)
        difference = np.abs(z[:, ::stride] - coarse)
        difference = np.where(there[:, ::stride], np.nan_to_num(difference, nan=np.inf), 0.0)
        excess = np.maximum(difference.max(axis=1) - noise, 0.0)
        share = np.where(excess == 0, 0.0, excess / (high - low))
    return float(np.where(np.isfinite(share), share, np.inf).max())


def _same_ends(run: Run, previous: Run | None) -> bool:
    """Whether all trajectories reach the end, or end where they did with longer steps."""
    counts = np.isfinite(run.z).all(axis=-1).sum(axis=1)
    if counts.min() == len(run.times):
        return True
    if previous is None:
        return False
    ends = run.times[np.maximum(counts, 1) - 1]
    before = np.isfinite(previous.z).all(axis=-1).sum(axis=1)
    between = np.abs(ends - previous.times[np.maximum(before, 1) - 1])
    return bool(between.max() <= 2 * abs(previous.times[1] - previous.times[0]))


def _sampled(
    members: Ensemble, z: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """A sample of the finite states, shape (n, dim), their times and parameters."""
    there = np.argwhere(np.isfinite(z).all(axis=-1))
    number = max(64, _SAMPLES // z.shape[-1])
    some = there[np.linspace(0, len(there) - 1, min(len(there), number)).astype(int)]
    values = members.own_parameters(some[:, 0])
    return z[some[:, 0], some[:, 1]], times[some[:, 1]], values


def fastest_rate(members: Ensemble, z: np.ndarray, times: np.ndarray) -> float:
    """Fastest rate at a sample of the states where it is finite, per unit of time."""
    rates = fastest_rates(members.H, *_sampled(members, z, times))
    return float(rates[np.isfinite(rates)].max(initial=0.0))
