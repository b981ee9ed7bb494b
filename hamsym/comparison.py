"""The network beside symplectic Euler: the table that says how many steps a network is worth."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from hamsym.errors import InputError
from hamsym.integrators import Trajectory, integrate, reference
from hamsym.solution import Solution

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Comparison", "Row", "StepsToMatch", "compare"]

MAX_STEPS = 100_000_000
_SAMPLES = 4_000  # intervals at which errors are measured, at most


@dataclass(frozen=True)
class Row:
    """Errors of one method against the reference, over the whole span.

    Attributes
    ----------
    label : str
    points : int
        Collocation points of the network, steps of an integrator.
    error : float
        max_t |delta z|, the 2-norm.
    component_errors : numpy.ndarray
        max_t |delta z_i| of each component, shape (dim,).
    energy_error : float
        max_t |H(z(t)) - H(exact(t))|.
    seconds : float
        Training time of the network, stepping time of an integrator once compiled.
    """

    label: str
    points: int
    error: float
    component_errors: np.ndarray = field(repr=False)
    energy_error: float
    seconds: float


@dataclass(frozen=True)
class StepsToMatch:
    """How many Euler steps reach the network's error.

    Attributes
    ----------
    steps : int, optional
        Found by search, to 1 %; None if more than the limit would be needed.
    error : float
        Euler's error at these steps, or at the most steps that were tried.
    extrapolated : float, optional
        Beyond the limit: steps extrapolated from there, the error falling as 1/steps.
    limit : int
        The most steps that were allowed.
    """

    steps: int | None
    error: float
    extrapolated: float | None = None
    limit: int = MAX_STEPS

    def __str__(self) -> str:
        if self.steps is not None:
            return f"{self.steps:,}"
        limit = f"{self.limit:.0e}".replace("e+0", "e")
        return f"> {limit} (extrapolated: {self.extrapolated:.1e})"


@dataclass(frozen=True)
class Comparison:
    """What :func:`compare` found; printing it shows the table.

    Attributes
    ----------
    rows : tuple of Row
        The network, then symplectic Euler with K, 10 K and 100 K steps.
    steps_to_match : StepsToMatch
    solution : Solution
    trajectories : tuple of Trajectory
        The Euler trajectories behind the rows.
    reference : callable
        t -> states, what the errors are measured against.
    reference_error : float
        How far the reference itself may be off; 0 for an exact solution.
    """

    rows: tuple[Row, ...]
    steps_to_match: StepsToMatch
    solution: Solution = field(repr=False)
    trajectories: tuple[Trajectory, ...] = field(repr=False)
    reference: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    reference_error: float = 0.0

    def __str__(self) -> str:
        header = f"{'method':<20}{'points':>12}{'max |dz|':>12}{'max |dE|':>12}{'time s':>10}"
        lines = [header, "-" * len(header)]
        lines += [
            f"{row.label:<20}{row.points:>12,}{row.error:>12.2e}{row.energy_error:>12.2e}"
            f"{row.seconds:>10.2g}"
            for row in self.rows
        ]
        if self.reference_error > 0.01 * self.rows[0].error:
            lines.append(f"reference: DOP853, itself good to about {self.reference_error:.0e}")
        lines.append(f"Euler steps for the network's error: {self.steps_to_match}")
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Errors and energies of the network and of symplectic Euler, as a figure."""
        from hamsym.plotting import plot_comparison  # matplotlib is slow to import

        return plot_comparison(self)


def compare(
    solution: Solution,
    *,
    points: int | None = None,
    exact: Callable[[np.ndarray], np.ndarray] | None = None,
    max_steps: int = MAX_STEPS,
) -> Comparison:
    """Compare a network with symplectic Euler at K, 10 K and 100 K steps (the paper's tables).

    Errors are 2-norms against the exact solution, or against DOP853 at tolerance 1e-13, at up to
    4,001 times over the span. The steps that Euler needs for the network's error are searched
    for up to ``max_steps``; beyond that they are extrapolated, and called so.

    Parameters
    ----------
    solution : Solution
    points : int, optional
        K; by default the network's collocation points.
    exact : callable, optional
        t -> states of shape (len(t), dim).
    max_steps : int

    Returns
    -------
    Comparison
    """
    if not isinstance(solution, Solution):
        raise InputError(
            f"compare takes a Solution, not {type(solution).__name__}; call solve first"
        )
    H, z0, span = solution.H, solution.z0, solution.span
    count = solution.points if points is None else points
    truth = exact or reference(H, z0, span)
    times = np.linspace(*span, _SAMPLES + 1)
    doubt = 0.0
    if exact is None:
        second = reference(H, z0, span, tolerance=1e-12)
        doubt = float(np.linalg.norm(second(times) - truth(times), axis=-1).max())
    rows = [_row("network", solution.points, times, solution(times), truth, solution, None)]
    integrate(H, z0, span, steps=1)  # compiles, so that the times are those of stepping
    trajectories = []
    for factor in (1, 10, 100):
        trajectory = _euler(solution, factor * count)
        trajectories.append(trajectory)
        rows.append(
            _row(
                "symplectic Euler",
                trajectory.steps,
                trajectory.t,
                trajectory.z,
                truth,
                solution,
                trajectory.seconds,
            )
        )
    return Comparison(
        rows=tuple(rows),
        steps_to_match=_steps_to_match(solution, rows[0].error, rows[-1], truth, max_steps),
        solution=solution,
        trajectories=tuple(trajectories),
        reference=truth,
        reference_error=doubt,
    )


def _euler(solution: Solution, steps: int) -> Trajectory:
    # At most _SAMPLES states are kept; where no divisor is near, a few steps more are taken.
    fewest = math.ceil(steps / _SAMPLES)
    divisors = (n for n in range(fewest, 2 * fewest) if steps % n == 0)
    save_every = next(divisors, fewest)
    steps = math.ceil(steps / save_every) * save_every
    return integrate(solution.H, solution.z0, solution.span, steps=steps, save_every=save_every)


def _error(
    t: np.ndarray, z: np.ndarray, truth: Callable[[np.ndarray], np.ndarray], complete: bool = True
) -> float:
    """max |z - truth|, infinite for a trajectory that broke off."""
    return float(np.linalg.norm(z - truth(t), axis=-1).max()) if complete else math.inf


def _row(
    label: str,
    points: int,
    t: np.ndarray,
    z: np.ndarray,
    truth: Callable[[np.ndarray], np.ndarray],
    solution: Solution,
    seconds: float | None,
) -> Row:
    system = solution.H.compile("numpy")
    right = truth(t)
    energies = system.energy(*system.arguments(z, t))
    energy_error = np.abs(energies - system.energy(*system.arguments(right, t))).max()
    reached = t[-1] == solution.span[1]
    return Row(
        label,
        points,
        _error(t, z, truth, reached),
        np.abs(z - right).max(axis=0),
        float(energy_error) if reached else math.inf,
        solution.training.seconds if seconds is None else seconds,
    )


def _steps_to_match(
    solution: Solution,
    target: float,
    known: Row,
    truth: Callable[[np.ndarray], np.ndarray],
    max_steps: int,
) -> StepsToMatch:
    """The smallest number of steps, to 1 %, whose error is at most the target.

    The error of a first-order method falls as 1/steps once steps are small, so each guess is
    scaled by error/target, kept inside the bracket found so far.
    """

    def error_at(steps: int) -> float:
        trajectory = _euler(solution, steps)
        return _error(trajectory.t, trajectory.z, truth, trajectory.success)

    too_few, enough = 1, None
    steps, error = known.points, known.error
    error_enough = math.inf
    for _ in range(60):
        if error <= target:
            enough, error_enough = steps, error
        else:
            too_few = steps
            if steps >= max_steps:
                return StepsToMatch(None, error, steps * error / target, max_steps)
        if enough is not None and enough <= max(1.01 * too_few, too_few + 1):
            break
        guess = steps * min(error / target, 1e4) if math.isfinite(error) else 10.0 * steps
        # Aim a little to the side that closes the bracket.
        guess *= 1.004 if error > target else 0.998
        if enough is not None and not too_few < guess < enough:
            guess = math.sqrt(too_few * enough)
        steps = min(max(math.ceil(guess), too_few + 1), max_steps)
        error = error_at(steps)
    return StepsToMatch(enough, error_enough)
