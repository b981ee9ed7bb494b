"""Comparison of a network with integrators: errors at equal points, steps at equal error."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.table import INTEGRATORS, usable_method, usual_method
from hamsym.integrators.trajectory import Trajectory
from hamsym.problems.description import attributes_of
from hamsym.solution.solution import Solution
from hamsym.study.matching import Match, find_match, run, trajectory
from hamsym.study.references import SAMPLES, ReferenceSolution, largest, reference_for
from hamsym.support.shown import Drawn, Shown
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.tables import data_frame
from hamsym.support.validation import checked_numbers, require_whole
from hamsym.symbolic.checks import as_list

if TYPE_CHECKING:
    import pandas

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
class Comparison(Drawn, Shown):
    """Result of :func:`compare`; its text has two tables.

    ``plot()`` draws four panels: the 2-norm of the error and the energy error over time, the errors
    in the first phase plane of the network and of the integrator that is nearest to it, and errors
    against evaluations; ``plot("error")``, ``"energy"``, ``"plane"`` or ``"work"`` one of them. Of
    one integrator all runs are drawn, of several the middle one of each.

    Attributes
    ----------
    rows : tuple of Row
        The network, then each integrator with K, 10 K and 100 K steps, or at three tolerances.
    matches : mapping
        Name of an integrator -> :class:`Match`.
    solution : Solution
    trajectories : tuple of Trajectory
        Trajectories of the rows after the first.
    reference : ReferenceSolution
        t -> states, with its error and what it is.
    """

    rows: tuple[Row, ...]
    matches: Mapping[str, Match]
    solution: Solution = field(repr=False)
    trajectories: tuple[Trajectory, ...] = field(repr=False)
    reference: ReferenceSolution = field(repr=False)

    @property
    def H(self) -> Hamiltonian:
        """The Hamiltonian."""
        return self.solution.H

    @property
    def z0(self) -> np.ndarray:
        """The initial state, shape (dim,)."""
        return self.solution.z0

    @property
    def span(self) -> tuple[float, float]:
        """The span of times."""
        return self.solution.span

    @property
    def success(self) -> bool:
        """Whether the solution of the network is what was asked for."""
        return bool(self.solution.success)

    @property
    def message(self) -> str:
        """Outcome of the solution of the network."""
        return self.solution.message

    @property
    def seconds(self) -> float:
        """Time of the network and of the rows of the table."""
        return sum(row.seconds for row in self.rows)

    @property
    def reference_error(self) -> float:
        """About the largest error of the reference; 0 for an exact solution."""
        return self.reference.error

    def __repr__(self) -> str:
        methods = ", ".join(dict.fromkeys(row.label for row in self.rows[1:]))
        return f"Comparison(network with error {self.rows[0].error:.2e}, with {methods})"

    def __str__(self) -> str:
        return self.summary(rows=None)

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
        >>> compared = compare(solution, "stormer_verlet", exact=exact, max_steps=100_000)
        >>> compared.to_dataframe()["points"].nunique()
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


@checked_keywords
def compare(
    solution: Solution,
    methods: str | Sequence[str] = "usual",
    *,
    points: int | None = None,
    exact: Callable[[np.ndarray], np.ndarray] | None = None,
    max_steps: int = MAX_STEPS,
) -> Comparison:
    """Compare a network with integrators at K, 10 K and 100 K steps (the paper's tables).

    Errors are 2-norms at up to 4,001 times over the span, against the exact solution if it is
    given. Otherwise they are against DOP853 at tolerance 1e-13, or, where that is not a hundred
    times better than the network, against the middle of an enclosure of the exact solution
    (:func:`hamsym.enclose`).

    The number of steps with which each method reaches the network's error is predicted by its order
    and confirmed by a run, up to ``max_steps`` and two seconds for a method; larger numbers are
    extrapolated, and marked as such. Where no reference is ten times better than the network, only
    bounds are given.

    Parameters
    ----------
    solution : Solution
    methods : str or sequence of str
        Names in :data:`hamsym.integrators.table.INTEGRATORS`, ``"symplectic_euler"`` as in the
        paper for example. ``"usual"`` stands for what is in common use: a symplectic method of
        order 2, one of order 6, and ``dop853``.
    points : int, optional
        Number K, by default that of the network's collocation points.
    exact : callable, optional
        t -> states of shape (len(t), dim). Its rounding errors count as errors of the others.
    max_steps : int
        Largest number of steps in the search.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        If a name is unknown, or a method cannot be used for this H.

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve("p**2/2 - cos(x)", [1, 0], (0, 5), tol=1e-6)
    >>> list(compare(solution, max_steps=100_000).matches)
    ['stormer_verlet', 'blanes_moan6', 'dop853']
    """
    if not isinstance(solution, Solution):
        raise InputError(f"expected a Solution, not {type(solution).__name__}; call solve first")
    names = chosen_methods(solution.H, methods)
    require_whole("max_steps", max_steps)
    if points is not None:
        require_whole("points", points)
    for name in names:  # compile first, so that times are those of stepping
        if not INTEGRATORS[name].adaptive:
            trajectory(solution, name, steps=1)
    H, z0, span = solution.H, solution.z0, solution.span
    count = solution.points if points is None else points
    if exact is None:
        # A norm of largest errors: those of components may come together.
        own = largest(np.atleast_1d(np.linalg.norm(solution.largest_error)))
        truth = reference_for(H, z0, span, solution, own)
    else:
        truth = ReferenceSolution.exact(exact)
    network = measure(solution, truth)
    rows, trajectories, matches = [network], [], {}
    for name in names:
        adaptive = INTEGRATORS[name].adaptive
        amounts = _TOLERANCES if adaptive else [factor * count for factor in _FACTORS]
        paths = [run(solution, name, amount) for amount in amounts]
        for amount, path in zip(amounts, paths, strict=True):
            cost = path.steps, path.evaluations, path.seconds
            row = _row(path.method, path.t, path.z, truth, solution, *cost)
            rows.append(replace(row, tolerance=amount) if adaptive else row)
        trajectories += paths
        matches[name] = find_match(solution, name, network.error, paths, truth, max_steps)
    return Comparison(
        rows=tuple(rows),
        matches=matches,
        solution=solution,
        trajectories=tuple(trajectories),
        reference=truth,
    )


def chosen_methods(H: Hamiltonian, methods: str | Sequence[str]) -> list[str]:
    """Return the names of the integrators of a comparison.

    ``"usual"`` stands for a symplectic method of order 2, one of order 6, and ``dop853``.

    Raise InputError if there is none, a name is unknown, or a method cannot be used for this H.

    Examples
    --------
    >>> chosen_methods(Hamiltonian("p**2/2 + x**2/2"), ["usual", "yoshida4"])
    ['stormer_verlet', 'blanes_moan6', 'dop853', 'forest_ruth']
    >>> chosen_methods(Hamiltonian("x**2*p**2/2 + x**2"), "usual")
    ['implicit_midpoint', 'gauss6', 'dop853']
    """
    names: list[str] = []
    for method in as_list(methods, "methods"):
        if isinstance(method, str) and method == "usual":
            low = "stormer_verlet" if H.is_separable else "implicit_midpoint"
            names += [low, usual_method(H), "dop853"]
        else:
            names.append(usable_method(H, method))
    if not names:
        raise InputError("methods is empty; give at least one integrator")
    return list(dict.fromkeys(names))


def measure(
    solution: Solution, truth: Callable[[np.ndarray], np.ndarray], label: str = "network"
) -> Row:
    """Return the errors of a solution against an exact one or a reference, at 4,001 times.

    - truth: t -> states of shape (len(t), dim).

    Examples
    --------
    >>> import hamsym
    >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 6), tol=1e-9)
    >>> row = measure(solution, lambda t: np.column_stack((np.cos(t), -np.sin(t))))
    >>> row.error < 1e-8
    True
    """
    times = np.linspace(*solution.span, SAMPLES + 1)
    cost = solution.points, solution.evaluations, solution.record.seconds
    return _row(label, times, solution(times), truth, solution, *cost)


def _row(
    label: str,
    t: np.ndarray,
    z: np.ndarray,
    truth: Callable[[np.ndarray], np.ndarray],
    solution: Solution,
    points: int,
    evaluations: int,
    seconds: float,
) -> Row:
    """Return the errors of states z at times t."""
    system, right = solution.H.compile("numpy"), checked_numbers("the exact solution", truth(t))
    if right.shape != z.shape:
        raise InputError(f"the exact solution has shape {right.shape}; give states, {z.shape}")
    with np.errstate(all="ignore"):  # steps that are far too long leave the domain of H
        energy_error = largest(np.abs(system.at("energy", z, t) - system.at("energy", right, t)))
    reached = t[-1] == solution.span[1]
    return Row(
        label,
        points,
        evaluations,
        error=largest(np.linalg.norm(z - right, axis=-1)) if reached else math.inf,
        component_errors=np.nan_to_num(np.abs(z - right), nan=np.inf, posinf=np.inf).max(axis=0),
        energy_error=energy_error if reached else math.inf,
        seconds=seconds,
    )
