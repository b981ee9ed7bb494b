"""The network beside time stepping: how many steps of which method a network is worth."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import InputError, StepSizeWarning
from hamsym.integrators.integrate import Trajectory, integrate, reference, usable_method
from hamsym.integrators.table import INTEGRATORS
from hamsym.solution.solution import Solution
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Comparison", "Match", "Row", "compare", "measure"]

MAX_STEPS = 100_000_000
_SAMPLES = 4_000  # intervals at which errors are measured, at most
_FACTORS = (1, 10, 100)  # times K, as in the paper
_TOLERANCES = (1e-3, 1e-6, 1e-9)  # at which adaptive methods are shown
_RUN_LIMIT = 10.0  # seconds that one run of the search may take, as predicted from those before


@dataclass(frozen=True)
class Row:
    """Errors of one method against the reference, over the whole span.

    Attributes
    ----------
    label : str
        "network", or the name of an integrator.
    points : int
        Collocation points of the network, steps of an integrator (outputs of an adaptive one).
    evaluations : int
        Evaluations of the vector field at a point, or of the force or gradient if that is all that
        a method needs.
    error : float
        max_t |delta z|, the 2-norm.
    component_errors : numpy.ndarray
        max_t |delta z_i| of each component, shape (dim,).
    energy_error : float
        max_t |H(z(t)) - H(exact(t))|.
    seconds : float
        Training time of the network, stepping time of an integrator once compiled.
    tolerance : float, optional
        rtol and atol of an adaptive method.
    """

    label: str
    points: int
    evaluations: int
    error: float
    component_errors: np.ndarray = field(repr=False)
    energy_error: float
    seconds: float
    tolerance: float | None = None


@dataclass(frozen=True)
class Match:
    """What a method needs for the network's error.

    Attributes
    ----------
    steps : int, optional
        Found by search, to 1 %; None if it was not reached. For an adaptive method the number of
        steps is its own, and this is None too.
    evaluations : int
    error : float
        At what was found, or the smallest that was.
    seconds : float
    tolerance : float, optional
        For an adaptive method, to a factor of 1.8 the largest that suffices.
    extrapolated : float, optional
        Steps extrapolated beyond the most that were tried, the error falling with the order.
    reason : str
        Why it was not reached; "" if it was.
    """

    steps: int | None
    evaluations: int
    error: float
    seconds: float
    tolerance: float | None = None
    extrapolated: float | None = None
    reason: str = ""

    def __str__(self) -> str:
        if self.reason:
            far = "" if self.extrapolated is None else f" (extrapolated: {self.extrapolated:.1e})"
            return f"{self.reason}{far}"
        if self.tolerance is not None:
            return f"rtol {self.tolerance:.0e}"
        return f"{self.steps:,}"


@dataclass(frozen=True)
class Comparison:
    """What :func:`compare` found; printing it shows the tables.

    Attributes
    ----------
    rows : tuple of Row
        The network, then each integrator with K, 10 K and 100 K steps, or at three tolerances.
    matches : mapping
        Name of an integrator -> :class:`Match`.
    solution : Solution
    trajectories : tuple of Trajectory
        Those behind the rows after the first.
    reference : callable
        t -> states, what the errors are measured against.
    reference_error : float
        How far the reference itself may be off; 0 for an exact solution.
    """

    rows: tuple[Row, ...]
    matches: Mapping[str, Match]
    solution: Solution = field(repr=False)
    trajectories: tuple[Trajectory, ...] = field(repr=False)
    reference: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    reference_error: float = 0.0

    def __str__(self) -> str:
        width = max(18, *(len(name) for name in self.matches))
        header = (
            f"{'method':<{width}}{'points':>10}{'evaluations':>13}"
            f"{'max |dz|':>11}{'max |dE|':>11}{'time s':>10}"
        )
        lines = [header, "-" * len(header)]
        for row in self.rows:
            points = f"{row.points:,}" if row.tolerance is None else f"rtol {row.tolerance:.0e}"
            lines.append(
                f"{row.label:<{width}}{points:>10}{row.evaluations:>13,}"
                f"{row.error:>11.2e}{row.energy_error:>11.2e}{row.seconds:>10.2g}"
            )
        if not self.reference_error <= 0.01 * self.rows[0].error:
            lines.append(f"reference: DOP853, itself good to about {self.reference_error:.0e}")
        lines += ["", f"for the network's error, {self.rows[0].error:.2e}:"]
        for name, match in self.matches.items():
            line = f"{name:<{width}}{match!s:>10}"
            if not match.reason:
                line += f"{match.evaluations:>13,}{match.error:>11.2e}{match.seconds:>21.2g}"
            lines.append(line)
        return "\n".join(lines)

    def plot(self) -> Figure:
        """Errors and energies of the network and of the integrators, as a figure."""
        return hamsym.plot(self)


def compare(
    solution: Solution,
    methods: str | Sequence[str] = ("symplectic_euler",),
    *,
    points: int | None = None,
    exact: Callable[[np.ndarray], np.ndarray] | None = None,
    max_steps: int = MAX_STEPS,
) -> Comparison:
    """Compare a network with integrators at K, 10 K and 100 K steps (the paper's tables).

    Errors are 2-norms against the exact solution, or against DOP853 at tolerance 1e-13, at up to
    4,001 times over the span. The steps that each method needs for the network's error are searched
    for up to ``max_steps``, or to what ten seconds allow; beyond that they are extrapolated, and
    called so.

    Parameters
    ----------
    solution : Solution
    methods : str or sequence of str
        Names in :data:`hamsym.integrators.table.INTEGRATORS`.
    points : int, optional
        K; by default the network's collocation points.
    exact : callable, optional
        t -> states of shape (len(t), dim).
    max_steps : int

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a name is unknown, or a method cannot be used for this H.
    """
    if not isinstance(solution, Solution):
        raise InputError(
            f"compare takes a Solution, not {type(solution).__name__}; call solve first"
        )
    given = [methods] if isinstance(methods, str) else methods
    names = list(dict.fromkeys(usable_method(solution.H, method) for method in given))
    if not names:
        raise InputError("methods is empty; name at least one integrator")
    require_whole("max_steps", max_steps)
    if points is not None:
        require_whole("points", points)
    for name in names:  # compiles, so that the times are those of stepping
        if not INTEGRATORS[name].adaptive:
            _trajectory(solution, name, steps=1)
    H, z0, span = solution.H, solution.z0, solution.span
    count = solution.points if points is None else points
    truth = exact or reference(H, z0, span)
    times = np.linspace(*span, _SAMPLES + 1)
    doubt = 0.0
    if exact is None:
        second = reference(H, z0, span, tolerance=1e-12)
        doubt = _largest(np.linalg.norm(second(times) - truth(times), axis=-1))
    network = measure(solution, truth)
    rows, trajectories, matches = [network], [], {}
    for name in names:
        adaptive = INTEGRATORS[name].adaptive
        for amount in _TOLERANCES if adaptive else [factor * count for factor in _FACTORS]:
            trajectory = _run(solution, name, amount)
            trajectories.append(trajectory)
            rows.append(_trajectory_row(trajectory, truth, solution, amount if adaptive else None))
        if adaptive:
            matches[name] = _tolerance_to_match(solution, name, network.error, truth)
        else:
            matches[name] = _steps_to_match(
                solution, name, network.error, trajectories[-1], truth, max_steps
            )
    return Comparison(
        rows=tuple(rows),
        matches=matches,
        solution=solution,
        trajectories=tuple(trajectories),
        reference=truth,
        reference_error=doubt,
    )


def measure(
    solution: Solution,
    truth: Callable[[np.ndarray], np.ndarray],
    label: str = "network",
) -> Row:
    """Errors of a solution against an exact solution or a reference, at 4,001 times.

    Parameters
    ----------
    solution : Solution
    truth : callable
        t -> states of shape (len(t), dim).
    label : str

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 6), tol=1e-9)
    >>> row = measure(solution, lambda t: np.column_stack((np.cos(t), -np.sin(t))))
    >>> row.error < 1e-8
    True
    """
    times = np.linspace(*solution.span, _SAMPLES + 1)
    return _row(label, times, solution(times), truth, solution)


def _run(solution: Solution, name: str, amount: float) -> Trajectory:
    """A trajectory with so many steps, or of an adaptive method with this tolerance."""
    if INTEGRATORS[name].adaptive:
        return _trajectory(solution, name, steps=_SAMPLES, rtol=amount)
    # At most _SAMPLES states are kept; where no divisor is near, a few steps more are taken.
    steps = int(amount)
    fewest = math.ceil(steps / _SAMPLES)
    divisors = (n for n in range(fewest, 2 * fewest) if steps % n == 0)
    save_every = next(divisors, fewest)
    steps = math.ceil(steps / save_every) * save_every
    return _trajectory(solution, name, steps=steps, save_every=save_every)


def _trajectory(solution: Solution, name: str, **options: Any) -> Trajectory:
    with warnings.catch_warnings():
        # Steps that are too long are part of the comparison, and their errors are measured.
        warnings.simplefilter("ignore", StepSizeWarning)
        trajectory = integrate(solution.H, solution.z0, solution.span, name, **options)
    if trajectory.interrupted:  # a search that went on would be none
        raise KeyboardInterrupt
    return trajectory


def _error(trajectory: Trajectory, truth: Callable[[np.ndarray], np.ndarray]) -> float:
    """max |z - truth|, infinite for a trajectory that broke off."""
    if not trajectory.success:
        return math.inf
    return _largest(np.linalg.norm(trajectory.z - truth(trajectory.t), axis=-1))


def _largest(values: np.ndarray) -> float:
    """The maximum, infinite where a value is not a number."""
    return float(np.nan_to_num(values, nan=np.inf, posinf=np.inf).max())


def _row(
    label: str,
    t: np.ndarray,
    z: np.ndarray,
    truth: Callable[[np.ndarray], np.ndarray],
    solution: Solution,
    **more: Any,
) -> Row:
    system = solution.H.compile("numpy")
    right = truth(t)
    with np.errstate(all="ignore"):  # steps that are far too long lead beyond the range of H
        energies = system.energy(*system.arguments(z, t))
        energy_error = _largest(np.abs(energies - system.energy(*system.arguments(right, t))))
    reached = t[-1] == solution.span[1]
    settings: dict[str, Any] = {
        "points": solution.points,
        "evaluations": solution.evaluations,
        "seconds": solution.record.seconds,
    }
    return Row(
        label,
        error=_largest(np.linalg.norm(z - right, axis=-1)) if reached else math.inf,
        component_errors=np.nan_to_num(np.abs(z - right), nan=np.inf, posinf=np.inf).max(axis=0),
        energy_error=energy_error if reached else math.inf,
        **(settings | more),
    )


def _trajectory_row(
    trajectory: Trajectory,
    truth: Callable[[np.ndarray], np.ndarray],
    solution: Solution,
    tolerance: float | None,
) -> Row:
    return _row(
        trajectory.method,
        trajectory.t,
        trajectory.z,
        truth,
        solution,
        points=trajectory.steps,
        evaluations=trajectory.evaluations,
        seconds=trajectory.seconds,
        tolerance=tolerance,
    )


def _tolerance_to_match(
    solution: Solution, name: str, target: float, truth: Callable[[np.ndarray], np.ndarray]
) -> Match:
    best = math.inf
    for quarter in range(8, 55):
        tolerance = max(10 ** (-quarter / 4), 2.3e-14)
        trajectory = _run(solution, name, tolerance)
        error = _error(trajectory, truth)
        best = min(best, error)
        if error <= target:
            return Match(
                None, trajectory.evaluations, error, trajectory.seconds, tolerance=tolerance
            )
        if trajectory.seconds > _RUN_LIMIT:
            break
    return Match(None, 0, best, 0.0, reason=f"not reached, {best:.1e} at best")


def _steps_to_match(
    solution: Solution,
    name: str,
    target: float,
    start: Trajectory,
    truth: Callable[[np.ndarray], np.ndarray],
    max_steps: int,
) -> Match:
    """The smallest number of steps, to 1 %, whose error is at most the target.

    The error falls as steps**-order once steps are small, so each guess is scaled by that, kept
    inside the bracket found so far.
    """
    order = INTEGRATORS[name].order
    # Above it, an error that no longer falls is not yet one of round-off.
    round_off = 1e-8 * float(np.linalg.norm(solution.scale))
    too_few, enough, best = 1, None, math.inf
    trajectory = start
    for attempt in range(100):
        steps, error = trajectory.steps, _error(trajectory, truth)
        if error <= target:
            enough, error_enough = trajectory, error
        elif steps >= max_steps:
            return _beyond(steps, error, target, order, f"> {_short(max_steps)} steps")
        elif enough is None and steps > 2 * too_few and 0.9 * best < error < round_off:
            return Match(None, 0, best, 0.0, reason=f"not reached: round-off leaves {best:.1e}")
        else:
            too_few = max(too_few, steps)
        best = min(best, error)
        if enough is not None and enough.steps <= max(1.01 * too_few, too_few + 1):
            return Match(enough.steps, enough.evaluations, error_enough, enough.seconds)
        usable = math.isfinite(error) and target > 0
        ratio = (error / target) ** (1 / order) if usable else 10.0
        # Aim a little to the side that closes the bracket.
        guess = steps * min(ratio, 1e4) * (1.004 if error > target else 0.998)
        if enough is not None and (attempt % 2 or not too_few < guess < enough.steps):
            guess = math.sqrt(too_few * enough.steps)  # where round-off hides the order
        more = min(max(math.ceil(guess), too_few + 1), max_steps)
        if enough is None and max(trajectory.seconds, 1e-4) * more / steps > _RUN_LIMIT:
            return _beyond(steps, error, target, order, f"> {_short(steps)} steps")
        trajectory = _run(solution, name, more)
    return _beyond(steps, error, target, order, f"> {_short(too_few)} steps")


def _beyond(steps: int, error: float, target: float, order: int, reason: str) -> Match:
    usable = math.isfinite(error) and target > 0
    far = steps * (error / target) ** (1 / order) if usable else None
    return Match(None, 0, error, 0.0, extrapolated=far, reason=reason)


def _short(steps: int) -> str:
    return f"{steps:.0e}".replace("e+0", "e") if steps >= 10**6 else f"{steps:,}"
