"""Comparison of a network with integrators: errors at equal points, steps at equal error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.description import attributes_of
from hamsym.errors import InputError
from hamsym.integrators.integrate import Trajectory, reference, usable_method
from hamsym.integrators.table import INTEGRATORS
from hamsym.solution.solution import Solution
from hamsym.study.matching import (
    SAMPLES,
    Match,
    largest,
    run,
    steps_to_match,
    tolerance_to_match,
    trajectory,
)
from hamsym.suggestions import checked_keywords, suggest_attributes
from hamsym.support.shown import Shown
from hamsym.support.tables import data_frame
from hamsym.support.text_tables import wrapped
from hamsym.support.validation import require_whole

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure

__all__ = ["Comparison", "Match", "Row", "compare", "measure"]

MAX_STEPS = 100_000_000
_FACTORS = (1, 10, 100)  # multiples of K, as in the paper
_TOLERANCES = (1e-3, 1e-6, 1e-9)  # of adaptive methods


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
        Evaluations of the vector field at a point, or of the force or gradient if a method needs
        no more.
    error : float
        max_t |delta z|, the 2-norm.
    component_errors : numpy.ndarray
        max_t |delta z_i| of each component, shape (dim,).
    energy_error : float
        max_t |H(z(t)) - H(exact(t))|.
    seconds : float
        Training time of the network, stepping time of a compiled integrator.
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


@suggest_attributes
@dataclass(frozen=True)
class Comparison(Shown):
    """Result of :func:`compare`; its text is two tables.

    Attributes
    ----------
    rows : tuple of Row
        The network, then each integrator with K, 10 K and 100 K steps, or at three tolerances.
    matches : mapping
        Name of an integrator -> :class:`Match`.
    solution : Solution
    trajectories : tuple of Trajectory
        Trajectories of the rows after the first.
    reference : callable
        t -> states; the exact solution or the reference of the errors.
    reference_error : float
        Estimated error of the reference; 0 for an exact solution.
    """

    rows: tuple[Row, ...]
    matches: Mapping[str, Match]
    solution: Solution = field(repr=False)
    trajectories: tuple[Trajectory, ...] = field(repr=False)
    reference: Callable[[np.ndarray], np.ndarray] = field(repr=False)
    reference_error: float = 0.0

    def __repr__(self) -> str:
        methods = ", ".join(dict.fromkeys(row.label for row in self.rows[1:]))
        return f"Comparison(network with error {self.rows[0].error:.2e}, with {methods})"

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
            lines.append(f"reference: DOP853, with an error of about {self.reference_error:.0e}")
        lines += ["", f"for the network's error, {self.rows[0].error:.2e}:"]
        for name, match in self.matches.items():
            line = f"{name:<{width}}{match!s:>10}"
            if not match.reason:
                line += f"{match.evaluations:>13,}{match.error:>11.2e}{match.seconds:>21.2g}"
            lines.append(line)
        return "\n".join(lines)

    def summary(self) -> str:
        """Describe the outcome in text: the error of the network, then the two tables."""
        network, solution = self.rows[0], self.solution
        worst = int(np.argmax(network.component_errors))
        name = solution.H.names[worst]
        against = "the exact solution"
        if self.reference_error:
            against = f"DOP853, whose error is about {self.reference_error:.0e}"
        verdict = "converged: " if solution.success else "not converged: "
        first = (
            f"{verdict}error {network.error:.2e} (2-norm) against {against}; largest in {name}, "
            f"{solution.H.quantity(name, network.component_errors[worst])}, where "
            f"{solution.H.quantity(name, float(solution.largest_error[worst]))} was estimated"
        )
        if solution.allowed_error is not None:
            first += f" and {solution.H.quantity(name, float(solution.allowed_error[worst]))} asked"
        return "\n".join([wrapped(first), wrapped(solution.message), "", str(self)])

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the rows as a table of pandas, with the errors of each component.

        H, parameters and units are in ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
        >>> def exact(t):
        ...     return np.stack([np.cos(t), -np.sin(t)], axis=-1)
        >>> compare(solution, "stormer_verlet", exact=exact).to_dataframe()["points"].nunique()
        3
        """
        columns: dict[str, Any] = {
            "method": [row.label for row in self.rows],
            **{
                name: [getattr(row, name) for row in self.rows]
                for name in ("points", "evaluations", "error", "energy_error", "seconds")
            },
            "tolerance": np.array([row.tolerance for row in self.rows], dtype=float),
        }
        errors = np.array([row.component_errors for row in self.rows]).T
        names = self.solution.H.names
        columns |= {f"error of {name}": own for name, own in zip(names, errors, strict=True)}
        attributes = {
            **attributes_of(self.solution.H),
            "span": list(self.solution.span),
            "reference_error": self.reference_error,
        }
        return data_frame(columns, None, attributes)

    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw errors of the network and of the integrators.

        Four panels: the 2-norm of the error and the energy error over time, the errors in the first
        phase plane of the network and of the integrator that is nearest to it, and errors against
        evaluations. Of one integrator all runs are drawn, of several the middle one of each.

        Parameters
        ----------
        *names : {"error", "energy", "plane", "work"}
            One panel alone.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.

        Raises
        ------
        InputError
            If there is no such panel, or ``ax`` is given for all of them.
        """
        return hamsym.plot(self, *names, ax=ax)


@checked_keywords
def compare(
    solution: Solution,
    methods: str | Sequence[str] | None = None,
    *,
    points: int | None = None,
    exact: Callable[[np.ndarray], np.ndarray] | None = None,
    max_steps: int = MAX_STEPS,
) -> Comparison:
    """Compare a network with integrators at K, 10 K and 100 K steps (the paper's tables).

    Errors are 2-norms against the exact solution, or against DOP853 at tolerance 1e-13, at up to
    4,001 times over the span. The number of steps with which each method reaches the network's
    error is searched up to ``max_steps`` and ten seconds per run; larger numbers are extrapolated,
    and marked as such.

    Parameters
    ----------
    solution : Solution
    methods : str or sequence of str
        Names in :data:`hamsym.integrators.table.INTEGRATORS`; by default ``symplectic_euler``, or
        ``implicit_midpoint`` if a force depends on momenta.
    points : int, optional
        Number K, by default that of the network's collocation points.
    exact : callable, optional
        t -> states of shape (len(t), dim).
    max_steps : int
        Largest number of steps in the search.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a name is unknown, or a method cannot be used for this H.
    """
    if not isinstance(solution, Solution):
        raise InputError(f"expected a Solution, not {type(solution).__name__}; call solve first")
    if methods is None:
        general = solution.H.forces and not solution.H.is_separable
        methods = "implicit_midpoint" if general else "symplectic_euler"
    given = [methods] if isinstance(methods, str) else methods
    names = list(dict.fromkeys(usable_method(solution.H, method) for method in given))
    if not names:
        raise InputError("methods is empty; give at least one integrator")
    require_whole("max_steps", max_steps)
    if points is not None:
        require_whole("points", points)
    for name in names:  # compile first, so that times are those of stepping
        if not INTEGRATORS[name].adaptive:
            trajectory(solution, name, steps=1)
    H, z0, span = solution.H, solution.z0, solution.span
    count = solution.points if points is None else points
    truth = exact or reference(H, z0, span)
    times = np.linspace(*span, SAMPLES + 1)
    uncertainty = 0.0
    if exact is None:
        second = reference(H, z0, span, tolerance=1e-12)
        uncertainty = largest(np.linalg.norm(second(times) - truth(times), axis=-1))
    network = measure(solution, truth)
    rows, trajectories, matches = [network], [], {}
    for name in names:
        adaptive = INTEGRATORS[name].adaptive
        for amount in _TOLERANCES if adaptive else [factor * count for factor in _FACTORS]:
            path = run(solution, name, amount)
            trajectories.append(path)
            rows.append(_trajectory_row(path, truth, solution, amount if adaptive else None))
        if adaptive:
            matches[name] = tolerance_to_match(solution, name, network.error, truth)
        else:
            matches[name] = steps_to_match(
                solution, name, network.error, trajectories[-1], truth, max_steps
            )
    return Comparison(
        rows=tuple(rows),
        matches=matches,
        solution=solution,
        trajectories=tuple(trajectories),
        reference=truth,
        reference_error=uncertainty,
    )


def measure(
    solution: Solution,
    truth: Callable[[np.ndarray], np.ndarray],
    label: str = "network",
) -> Row:
    """Return the errors of a solution against an exact one or a reference, at 4,001 times.

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
    times = np.linspace(*solution.span, SAMPLES + 1)
    return _row(label, times, solution(times), truth, solution)


def _row(
    label: str,
    t: np.ndarray,
    z: np.ndarray,
    truth: Callable[[np.ndarray], np.ndarray],
    solution: Solution,
    **more: Any,
) -> Row:
    """Return the errors of states z at times t."""
    system = solution.H.compile("numpy")
    right = truth(t)
    with np.errstate(all="ignore"):  # steps that are far too long leave the domain of H
        energies = system.energy(*system.arguments(z, t))
        energy_error = largest(np.abs(energies - system.energy(*system.arguments(right, t))))
    reached = t[-1] == solution.span[1]
    settings: dict[str, Any] = {
        "points": solution.points,
        "evaluations": solution.evaluations,
        "seconds": solution.record.seconds,
    }
    return Row(
        label,
        error=largest(np.linalg.norm(z - right, axis=-1)) if reached else math.inf,
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
