"""Steps with tangent vectors: their choice, the growth of the vectors, and what makes a run fail.

Input:  a Hamiltonian, an initial state, a time span; later the states that the steps reached, and
        the tangent vectors there.
Output: the number and size of the steps; orthonormal vectors of the same flags with the logarithms
        of their growth; the change of H, and why the run failed.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.energy_drift import COARSE, EnergyDrift
from hamsym.integrators.hidden_features import Path, hidden_features, passed_over
from hamsym.integrators.step_scales import fastest_rates
from hamsym.integrators.stepper import Stepper
from hamsym.integrators.table import resolved_angle, too_fast
from hamsym.numerics.scales import tangent_scales
from hamsym.problems.ensemble import Ensemble, ensemble_of
from hamsym.problems.problem import checked_steps

#: Points of a history.
KEPT = 2_000
#: Outcome where a step did not end in a finite state.
LOST = "the states overflowed, or a step could not be solved"

#: Default steps in a radian of the fastest linear motion.
STEPS_PER_RADIAN = 5
#: Times the rate for which the steps were chosen at which they no longer resolve the motion.
UNRESOLVED = 3.0
#: E-folds by which one vector may outgrow another until both are parallel.
PARALLEL = 30.0
#: Outcome where they did.
APART = (
    f"tangent vectors grew apart by more than exp({PARALLEL:g}) between renormalisations; reduce dt"
)

# Largest number of e-folds of the fastest linear motion between two renormalisations: float64
# overflows at 700, and several vectors become parallel to round-off before.
_GROWTH_OF_ONE, _GROWTH_OF_SEVERAL = 200.0, 5.0
_PILOT_STEPS, _PILOTS = 1_000, 8
_HELD = 1_000_000  # components of the states of a block of steps


@dataclass(frozen=True)
class TangentSteps:
    """Equal steps of one trajectory."""

    H: Hamiltonian
    method: str
    span: tuple[float, float]
    number: int
    #: Negative where time runs backward.
    size: float
    #: Fastest rate of the linear motion at the beginning of the trajectory, per unit of time.
    rate: float
    #: Whether the steps follow from the rate, not from the user.
    chosen: bool
    #: Units of tangent vectors, by :func:`hamsym.numerics.scales.tangent_scales`, shape (dim, 1).
    scales: np.ndarray = field(repr=False)

    @classmethod
    def choose(
        cls,
        H: Hamiltonian,
        method: str,
        state: np.ndarray,
        span: tuple[float, float],
        steps: int | None,
        dt: float | None,
    ) -> TangentSteps:
        """Choose the steps where neither their number nor their largest size is given.

        Raise InputError if the Hessian is not finite at the state, or steps or dt cannot be used.
        """
        rate, path, times = _fastest_rate(H, method, state, span)
        chosen = steps is None and dt is None
        if chosen:
            whole = abs(span[1] - span[0])
            dt = min(whole, 1 / (STEPS_PER_RADIAN * rate) if rate > 0 else whole / 20_000)
        number = checked_steps(span[1] - span[0], steps, dt)
        size = (span[1] - span[0]) / number
        jacobians = H.compile("numpy").at("jacobian", path, times)
        scales = tangent_scales(jacobians, abs(span[1] - span[0]))[:, None]
        return cls(H, method, span, number, size, rate, chosen, scales)

    def block(self, growth: float) -> int:
        """Return how many steps grow a tangent vector by no more than this number of e-folds.

        There are at least :data:`KEPT` blocks, where there are as many steps.
        """
        fits = int(growth / max(self.rate * abs(self.size), 1e-3))
        return max(1, min(self.number // KEPT, fits))

    def outcome(
        self, times: Sequence[float] | np.ndarray, path: np.ndarray, problem: str, began: float
    ) -> dict[str, Any]:
        """Return what every result of such steps tells, by the names of its fields.

        - times, path, problem: As of :meth:`_judged`.
        - began: Time of the start, of :func:`time.perf_counter`.
        """
        energy_error, problem = self._judged(times, path, problem)
        done = f"{self.method}: {self.number:,} steps to t = {self.span[1]:.6g}"
        return {
            "H": self.H,
            "z0": path[0],
            "span": self.span,
            "energy_error": energy_error,
            "method": self.method,
            "dt": self.size,
            "seconds": time.perf_counter() - began,
            "success": not problem,
            "message": problem or done,
        }

    def _judged(
        self, times: Sequence[float] | np.ndarray, path: np.ndarray, problem: str
    ) -> tuple[float, str]:
        """Return the largest change of H, and why the run failed, empty if it did not.

        - times: Times after the start, shape (n,).
        - path: States at the start and at these times, shape (n + 1, dim).
        - problem: What ended the run early, or an empty text.
        """
        H = self.H
        drift = EnergyDrift(H, 1)
        drift.add(path[None])
        change = float(drift.change[0]) if H.conserves_energy else math.nan
        if problem:
            return change, f"stopped after t = {times[-1]:.6g}: {problem}"
        share = float(drift.relative(self.number)[0])
        if H.conserves_energy and not share <= COARSE:
            return change, f"H changed by {change:.1e}, {share:.0%} of its scale: take a smaller dt"
        most = UNRESOLVED * max(self.rate, 1 / abs(self.size)) if self.chosen else math.inf
        if not H.conserves_energy:
            most = resolved_angle(self.method) / abs(self.size)
        if most < math.inf:
            fastest = fastest_rates(H, path, np.append(self.span[0], times)).max()
            if not fastest <= most:
                return change, too_fast(fastest, self.method)
        start = ensemble_of(H, path[0], None)
        passed = first_passed(start, self.method, self.span[0], self.size, self.number)[0]
        return change, "" if math.isnan(passed) else passed_over(passed)


def _fastest_rate(
    H: Hamiltonian, method: str, state: np.ndarray, span: tuple[float, float]
) -> tuple[float, np.ndarray, np.ndarray]:
    """Estimate the spectral radius of J Hess along the beginning of the trajectory.

    Return it with states and times of that part. Each pilot run uses steps from the rate that the
    previous one found, so that a slow start does not set the steps for the rest.
    """
    start, end = span
    rate = float(fastest_rates(H, state, start))
    path, times = state[None], np.array([start])
    if not math.isfinite(rate):
        raise InputError("the Hessian of H is not finite at z0; choose another initial state")
    whole = abs(end - start)
    length = whole / 1_000 if rate == 0 else min(whole, _PILOT_STEPS / (STEPS_PER_RADIAN * rate))
    for _ in range(_PILOTS):
        size = math.copysign(length / _PILOT_STEPS, end - start)
        stepper = Stepper(H, method, state[None], np.array([start]), np.array([size]))
        reached = stepper.advance(_PILOT_STEPS, show=False).states[0]
        if not np.isfinite(reached).all():
            length /= 30
            continue
        path, times = reached, start + size * np.arange(1, len(reached) + 1)
        found = float(fastest_rates(H, path, times).max())
        if not rate * 1.5 < found < math.inf:
            return rate if math.isinf(found) else max(rate, found), path, times
        rate = found
        length = min(length, _PILOT_STEPS / (STEPS_PER_RADIAN * rate))
    return rate, path, times


def first_passed(
    members: Ensemble, method: str, start: float, size: float, steps: int
) -> np.ndarray:
    """Return the time of the first feature that the steps of each member pass over, or nan.

    The steps are taken once more without tangent vectors, in blocks, because only some of their
    states are kept, and searched by :mod:`hamsym.integrators.hidden_features`. What all features
    together may change is the share of the sizes of the components that the energy may change, too.
    """
    count = len(members)
    found = np.full(count, np.nan)
    features, values = hidden_features(members.H), members.own_parameters()
    if features is None or not count:
        return found
    sizes = np.full(count, size)
    stepper = Stepper(
        *(members.H, method, members.states, np.full(count, start), sizes),
        parameters=members.parameters,
    )
    block = max(1, _HELD // members.states.size)
    for done in range(0, steps, block):
        taken = min(block, steps - done)
        path = stepper.advance(taken, show=False).path
        times = start + size * np.arange(done, done + taken + 1)
        new = features.passed(Path(path, times), values, COARSE * taken / steps)
        found = np.where(np.isnan(found), new, found)
    return found


# -- growth of tangent vectors ---------------------------------------------------------------------


def growth_limit(count: int) -> float:
    """Return how many e-folds may pass between renormalisations of this number of vectors."""
    return _GROWTH_OF_ONE if count == 1 else _GROWTH_OF_SEVERAL


def first_vectors(dim: int, count: int, seed: int) -> np.ndarray:
    """Return random orthonormal vectors, shape (dim, count)."""
    return np.linalg.qr(np.random.default_rng(seed).normal(size=(dim, count)))[0]


def orthonormal(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return orthonormal vectors of the same flags, and the logarithm of the growth of each.

    - vectors: Shape (..., dim, count), in units of ``tangent_scales``.

    Examples
    --------
    >>> q, growth = orthonormal(np.array([[2.0, 2.0], [0.0, 3.0]]))
    >>> q + 0.0, np.exp(growth).round(9)
    (array([[1., 0.],
           [0., 1.]]), array([2., 3.]))
    """
    if vectors.shape[-1] == 1:
        length = np.linalg.norm(vectors, axis=-2, keepdims=True)
        return vectors / length, np.log(length[..., 0, :])
    q, r = np.linalg.qr(vectors)
    diagonal = np.diagonal(r, axis1=-2, axis2=-1)
    return q * np.sign(diagonal)[..., None, :], np.log(np.abs(diagonal))
