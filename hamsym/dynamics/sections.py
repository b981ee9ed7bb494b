"""Poincare sections: crossings of a surface by an ensemble of trajectories, to round-off.

Input:  a Hamiltonian, initial states, a surface, for example "x = 0, p_x > 0".
Output: a :class:`Section` with the states of all crossings.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import sympy

import hamsym
from hamsym.dynamics.crossings import Crossings, Setting
from hamsym.dynamics.proven_sections import SectionCertificate, prove_section
from hamsym.errors import CertificationError, StepSizeWarning
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.automatic_steps import AIM, choose_steps
from hamsym.integrators.energy_drift import COARSE
from hamsym.integrators.hidden_features import passed_over
from hamsym.integrators.table import (
    resolved_angle,
    too_fast,
    usable_method,
    usual_method,
)
from hamsym.problems.ensemble import Ensemble, ensemble_of
from hamsym.problems.observed import observed
from hamsym.problems.problem import checked_span, checked_steps
from hamsym.problems.surface import Surface, parse_surface, surface_text
from hamsym.proof.arithmetic.ball import Ball
from hamsym.proof.windows.enclose import initial_balls
from hamsym.support.record_fields import AnyFloat, Size, counts, floats
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import checked_keywords, suggest_attributes
from hamsym.support.tables import data_frame, time_name
from hamsym.support.validation import require_number, require_whole

if TYPE_CHECKING:
    import pandas


@suggest_attributes
@dataclass(frozen=True)
class Section(Drawn, Saved):
    """Crossings of a surface, ordered by trajectory and then in the direction of time.

    ``plot()`` draws them in a plane that the surface leaves free, with a colour for each start, and
    ``plot("x", "p")`` in that of two components. Up to twelve starts have an entry in the legend
    with what varies, more a colour bar. If the surface is crossed both ways, dots are crossings
    where its left side rises, crosses where it falls. A grey line is the boundary of the states of
    one energy.

    Attributes
    ----------
    surface : str
    names : tuple of str
        Components of z.
    t : numpy.ndarray
        Times of the crossings, shape (n,).
    z : numpy.ndarray
        States at the crossings, shape (n, dim).
    trajectory : numpy.ndarray
        Number of the trajectory of each crossing, shape (n,). Members of an ensemble of several
        axes are counted along the last axis first, as by ``numpy.unravel_index``.
    z0 : numpy.ndarray
        Starts of the trajectories, by their number, shape (trajectories, dim).
    span : (float, float)
        The times that were asked for.
    parameters : mapping of str to numpy.ndarray
        Values of the parameters that were given as arguments, of each trajectory.
    energy_error : float
        Largest change of H at the crossings, nan if H depends on time.
    drift : float
        Largest change of H after any step, beyond round-off and relative to the energy that the
        motion exchanges, as for :class:`hamsym.Trajectory`.
    method : str
    dt : float
        Length of the steps.
    seconds : float
    success : bool
    message : str
        Outcome.
    H : Hamiltonian
        With the parameters of the first start.
    axes : (str, str)
        Components that figures show: a pair that the surface leaves free.
    certificate : SectionCertificate or None
        Proven crossings, from ``section(..., prove=True)``.
    """

    surface: str
    names: tuple[str, ...]
    t: Annotated[np.ndarray, floats("crossings")] = field(repr=False)
    z: Annotated[np.ndarray, floats("crossings", "dim")] = field(repr=False)
    trajectory: Annotated[np.ndarray, counts("crossings")] = field(repr=False)
    z0: Annotated[np.ndarray, floats("starts", "dim", finite=False)] = field(repr=False)
    span: tuple[float, float] = field(repr=False)
    energy_error: AnyFloat
    method: str
    dt: float
    seconds: Size
    success: bool
    message: str
    axes: tuple[str, str] = field(repr=False)
    H: Hamiltonian = field(repr=False)
    drift: AnyFloat = math.nan
    parameters: Mapping[str, Annotated[np.ndarray, floats("starts")]] = field(
        default_factory=dict, repr=False
    )
    certificate: SectionCertificate | None = field(default=None, repr=False)

    def check(self) -> None:
        """Raise ValueError unless the crossings are those of trajectories of H, in order."""
        if self.names != self.H.names or not {*self.axes} <= {*self.names}:
            raise ValueError("its names are not those of H")
        if not {*self.parameters} <= {*self.H.parameter_names}:
            raise ValueError("a parameter varies that H does not have")
        parse_surface(self.H, self.surface)
        if not (self.trajectory < len(self.z0)).all():
            raise ValueError("a crossing is that of no trajectory")
        later = np.diff(self.t) * math.copysign(1.0, self.dt) >= 0
        same, next_one = np.diff(self.trajectory) == 0, np.diff(self.trajectory) > 0
        if not (next_one | (same & later)).all():
            raise ValueError("its crossings are not in order")
        if self.certificate is not None and len(self.certificate.rising) != len(self.t):
            raise ValueError("another number of crossings is proven")

    def __repr__(self) -> str:
        starts = len(np.unique(self.trajectory))
        members = "1 trajectory" if starts == 1 else f"{starts:,} trajectories"
        return (
            f"Section({self.surface!r}: {len(self.t):,} crossings by {members}, {self.method}, "
            f"success={self.success})"
        )

    def to_dataframe(self, *names: Any) -> pandas.DataFrame:
        """Return the crossings as a table of pandas: trajectory, time, components and starts.

        The starts are columns ``z0_x``, ..., varied parameters have their own names. Surface, H and
        the method are in ``attrs``.

        Parameters
        ----------
        *names : str or sympy.Expr
            Components or formulas in the names of H (:meth:`hamsym.Hamiltonian.observable`), the
            columns in place of the components; nan where a formula is no finite real number.

        Raises
        ------
        InputError
            If pandas is not installed, or a name is unknown.

        Examples
        --------
        >>> found = section("p**2/2 + x**2/2", [0, 1], (0, 20), "x = 0, p > 0")
        >>> (found.to_dataframe()["t"] / (2 * np.pi)).round(6).tolist()
        [1.0, 2.0, 3.0]
        >>> found.to_dataframe().columns.tolist()
        ['trajectory', 't', 'x', 'p', 'z0_x', 'z0_p']
        """
        columns = {"trajectory": self.trajectory, time_name(self.names): self.t}
        found = observed(self.H, names, self.z[:, None], self.t[:, None], self.own_parameters)
        columns |= {name: values[:, 0] for name, values in found.items()}
        starts = zip(self.names, self.z0[self.trajectory].T, strict=True)
        columns |= {f"z0_{name}": values for name, values in starts}
        columns |= {name: values[self.trajectory] for name, values in self.parameters.items()}
        known = {"H": self.H.formulas, "surface": self.surface, "method": self.method}
        return data_frame(columns, None, {**known, "dt": self.dt, "hamsym": hamsym.__version__})

    @property
    def own_parameters(self) -> np.ndarray | None:
        """Parameters at each crossing, shape (n, k); None where all starts have those of H."""
        if not self.parameters:
            return None
        known: dict[str, Any] = {**self.H.parameters, **self.parameters}
        every = [np.broadcast_to(known[name], len(self.z0)) for name in self.H.parameter_names]
        return np.stack(every, axis=-1)[self.trajectory]


@checked_keywords
def section(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, Any] | np.ndarray,
    span: tuple[float, float],
    surface: str | sympy.Expr | sympy.Eq,
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    direction: float = 0.0,
    crossings: int | None = None,
    parameters: Mapping[Any, Any] | None = None,
    prove: bool = False,
    progress: bool | None = None,
) -> Section:
    """Locate crossings of a surface by one trajectory or by each of an ensemble.

    Every crossing of a smooth surface is found, however narrow, because its formula is bounded
    between steps; the message counts places where the surface is touched within round-off. Of other
    surfaces, as those with ``abs``, pairs of crossings within one step are found if the trajectory
    approaches the surface once in it. A start on the surface is not a crossing.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence, mapping or array
        As in :func:`hamsym.integrate`, shape (..., dim).
    span : (float, float)
    surface : str, sympy.Expr or sympy.Eq
        An equation, and inequalities that the crossing must satisfy, for example
        ``"x = 0, p_x > 0"``; both sides may be any formula in the names of H. A sympy expression
        is zero on the surface.
    method : str, optional
        A fixed-step method of :data:`hamsym.integrators.table.INTEGRATORS`; by default
        ``blanes_moan6`` for a separable H, otherwise ``gauss6``.
    steps : int, optional
        Number of steps. Without ``method``, ``steps`` and ``dt`` it is chosen as in
        :func:`hamsym.integrate`, for an energy drift of 1e-9 over the whole span; with a method
        the default is 20,000.
    dt : float, optional
        Largest step, in place of ``steps``.
    direction : float
        Above zero, only crossings at which left side minus right side rises; below zero, falls.
    crossings : int, optional
        Number of crossings per trajectory after which to stop.
    parameters : mapping of name to number or array, optional
        Values that replace those of H, also in the surface, broadcast with the states.
    prove : bool
        Prove that the crossings are all, and transversal, and enclose their times, their states and
        the derivative of the Poincare map: ``certificate`` has them. The surface must be smooth,
        and one start may have balls as components, as for :func:`hamsym.enclose`: what is proven
        then holds for all starts in them.
    progress : bool, optional
        Show progress; by default on a terminal, after a second.

    Returns
    -------
    Section
        With ``success=False`` and a message if a trajectory ends early, has too few crossings,
        leaves the domain of the surface, H drifts by more than 1 % of its scale, ``prove`` fails,
        or the force has a feature, for example a pulse, that the steps pass over and that changes
        more than 1e-9 of a component: crossings inside it are missed. Where H is not conserved,
        steps that are given may take 0.6 rad of the fastest linear motion and err by 1 % of it.

    Warns
    -----
    StepSizeWarning
        As in :func:`hamsym.integrate`.

    Raises
    ------
    InputError
        If the surface or an option cannot be used.

    Examples
    --------
    >>> H = Hamiltonian("(p_x**2 + p_y**2)/2 + x**2/2 + y**2")
    >>> found = section(H, {"x": 0, "y": 0.1, "p_x": 1, "p_y": 0}, (0, 50), "x = 0, p_x > 0")
    >>> len(found.t), (found.t / (2 * np.pi)).round(9)
    (7, array([1., 2., 3., 4., 5., 6., 7.]))
    >>> one = section("p**2/2 - cos(x)", [1, 0], (0, 8), "x = 0, p > 0", prove=True)
    >>> one.certificate.t.mid.round(6), bool(one.certificate.t.radius < 1e-14)
    (array([5.024982]), True)
    """
    balls = _start_balls(H, z0) if prove else None
    members = ensemble_of(H, z0 if balls is None else balls.mid, parameters)
    H = members.H
    start, end = span = checked_span(span)
    chosen = method is None and steps is None and dt is None
    steps = checked_steps(end - start, steps, dt)
    if crossings is not None:
        require_whole("crossings", crossings)
    require_number("direction", direction)
    surface = surface_text(H, surface)
    where = parse_surface(H, surface)
    method = usual_method(H) if method is None else usable_method(H, method)
    began = time.perf_counter()
    advice, kept = "", True
    if chosen:
        choice = choose_steps(members, method, span, progress=progress)
        steps = choice.steps
        if not choice.met and not choice.run.interrupted:
            advice = f"steps were chosen for {AIM:.0e}, {choice.found:.1e} was reached"
    size = (end - start) / steps
    setting = Setting(method, surface, where, direction, start, size, steps, crossings)
    run = Crossings(members, setting)
    run.advance_all(progress)
    t, z, trajectory = run.ordered()
    doubts, drift = run.doubts, float(run.drift.relative(run.done).max())
    problem = run.problem(len(t), end)
    message = f"{len(t):,} crossings of {surface}, {method} with dt = {size:.3g}"
    if doubts.touches:
        message += f", touched {doubts.touches:,} times within round-off without a crossing"
    if H.conserves_energy:
        message += f", H kept to {drift:.1e} of its scale" if drift else ", H kept to round-off"
        kept = drift <= COARSE
        if not kept:
            advice = "take smaller steps"
    elif not chosen and not problem and not run.fastest * abs(size) <= resolved_angle(method):
        problem = too_fast(run.fastest, method)
    if kept and not problem and not math.isnan(doubts.hidden):
        problem = passed_over(doubts.hidden)
    if advice and not problem:
        message = f"{message}: {advice}"
        warnings.warn(message, StepSizeWarning, stacklevel=3)
    found = Section(
        surface=surface,
        names=H.names,
        t=t,
        z=z,
        trajectory=trajectory,
        z0=members.states,
        span=span,
        energy_error=_energy_error(members, z, trajectory),
        method=method,
        dt=size,
        seconds=time.perf_counter() - began,
        success=kept and not problem,
        message=problem or message,
        axes=free_pair(H, where),
        H=H,
        drift=drift,
        parameters=members.columns,
    )
    return _proven(found, balls, direction, crossings) if prove else found


def _start_balls(H: HamiltonianLike, z0: Any) -> Ball | None:
    """The balls of one start, shape (dim,); None for several, which are numbers."""
    parts = z0.values() if isinstance(z0, Mapping) else z0 if np.iterable(z0) else ()
    if any(isinstance(part, (list, np.ndarray)) and np.ndim(part) for part in parts):
        return None
    found = initial_balls(Hamiltonian.of(H), z0)
    return Ball(np.array([b.mid for b in found]), np.array([b.radius for b in found]))


def _proven(found: Section, start: Ball | None, direction: float, limit: int | None) -> Section:
    """The section with its certificate, or without success and the reason."""
    if not found.success:
        return found
    radius = np.zeros(found.z0.shape)
    if start is not None:
        radius += start.radius
    try:
        certificate = prove_section(found, Ball(found.z0, radius), direction, limit)
    except CertificationError as error:
        return replace(found, success=False, message=f"{found.message}; not proven: {error}")
    return replace(found, certificate=certificate, message=f"{found.message}; all proven")


def _energy_error(members: Ensemble, z: np.ndarray, trajectory: np.ndarray) -> float:
    if not members.H.conserves_energy:
        return float("nan")
    system = members.H.compile("numpy")
    starts = system.at("energy", members.states, 0.0, members.own_parameters())
    energy = system.at("energy", z, 0.0, members.own_parameters(trajectory))
    return float(np.abs(energy - starts[trajectory]).max(initial=0.0))


def free_pair(H: Hamiltonian, where: Surface) -> tuple[str, str]:
    """Return the first coordinate and momentum that are not in the equation of the surface."""
    pairs = list(zip(H.names[: H.dof], H.names[H.dof :], strict=True))
    free = [pair for pair in pairs if not where.names & set(pair)]
    return free[0] if free else pairs[0]
