"""Poincare sections: crossings of a surface by an ensemble of trajectories, to round-off.

Input:  a Hamiltonian, initial states, a surface, for example "x = 0, p_x > 0".
Output: a :class:`Section` with the states of all crossings.

The trajectories are stepped with a generated loop. Between two steps with different signs a
crossing is located by taking part of a step: the point lies on the curve of the method itself. The
formula of a smooth surface is bounded between steps, so that every crossing is found. Others are
sampled, and a pair of crossings within one step is found from the slopes at its ends.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

import hamsym
from hamsym.dynamics.blocks import advance_in_blocks
from hamsym.ensemble import Ensemble, ensemble_of
from hamsym.errors import InputError, StepSizeWarning
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.coefficients import Doubled
from hamsym.integrators.energy_drift import AIM, COARSE, EnergyDrift
from hamsym.integrators.hidden_features import hidden_features, passed_over
from hamsym.integrators.integrate import choose_steps, fixed_step, usable_method, usual_method
from hamsym.numerics.intervals import Intervals, Ranges
from hamsym.numerics.isolation import Cells, component_ranges, isolated_zeros, rate_bends
from hamsym.numerics.roots import suspects, zeros
from hamsym.problem import checked_span, checked_steps
from hamsym.suggestions import checked_keywords, suggest_attributes
from hamsym.support.shown import Shown
from hamsym.support.tables import data_frame, data_set, time_name
from hamsym.support.validation import require_number, require_whole
from hamsym.surface import Surface, parse_surface

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure

_HELD = 2_000_000  # numbers of a block of paths
_ASIDE = 1e-3  # of a step: distance along the flow over which slopes are measured


@suggest_attributes
@dataclass(frozen=True)
class Section(Shown):
    """Crossings of a surface, ordered by trajectory and then in the direction of time.

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
    """

    surface: str
    names: tuple[str, ...]
    t: np.ndarray = field(repr=False)
    z: np.ndarray = field(repr=False)
    trajectory: np.ndarray = field(repr=False)
    z0: np.ndarray = field(repr=False)
    span: tuple[float, float] = field(repr=False)
    energy_error: float
    method: str
    dt: float
    seconds: float
    success: bool
    message: str
    axes: tuple[str, str] = field(repr=False)
    H: Hamiltonian = field(repr=False)
    drift: float = math.nan
    parameters: Mapping[str, np.ndarray] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        starts = len(np.unique(self.trajectory))
        members = "1 trajectory" if starts == 1 else f"{starts:,} trajectories"
        return (
            f"Section({self.surface!r}: {len(self.t):,} crossings by {members}, {self.method}, "
            f"success={self.success})"
        )

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the crossings as a table of pandas: trajectory, time, components and starts.

        The starts are columns ``z0_x``, ..., varied parameters have their own names. Surface, H and
        the method are in ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> found = section("p**2/2 + x**2/2", [0, 1], (0, 20), "x = 0, p > 0")
        >>> (found.to_dataframe()["t"] / (2 * np.pi)).round(6).tolist()
        [1.0, 2.0, 3.0]
        >>> found.to_dataframe().columns.tolist()
        ['trajectory', 't', 'x', 'p', 'z0_x', 'z0_p']
        """
        columns = {f"z0_{n}": v for n, v in zip(self.names, self._starts.T, strict=True)}
        columns |= {name: values[self.trajectory] for name, values in self.parameters.items()}
        first = {"trajectory": self.trajectory, time_name(self.names): self.t}
        columns = first | dict(zip(self.names, self.z.T, strict=True)) | columns
        return data_frame(columns, None, self._attributes)

    def to_xarray(self) -> xarray.Dataset:
        """Return the crossings as a dataset of xarray, on axes ``crossing`` and ``component``.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> found = section("p**2/2 + x**2/2", [0, 1], (0, 20), "x = 0, p > 0")
        >>> dict(found.to_xarray().sizes)
        {'crossing': 3, 'component': 2}
        """
        return data_set(
            {
                "state": (["crossing", "component"], self.z),
                "z0": (["crossing", "component"], self._starts),
            },
            {
                "component": list(self.names),
                "time": (["crossing"], self.t),
                "trajectory": (["crossing"], self.trajectory),
                **{
                    name: (["crossing"], values[self.trajectory])
                    for name, values in self.parameters.items()
                },
            },
            self._attributes,
        )

    @property
    def _starts(self) -> np.ndarray:
        """The start of the trajectory of each crossing, shape (n, dim)."""
        return self.z0[self.trajectory]

    @property
    def _attributes(self) -> dict[str, Any]:
        known = {"H": self.H.formulas, "surface": self.surface, "method": self.method}
        return {**known, "dt": self.dt, "hamsym": hamsym.__version__}

    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw the crossings in a plane, with a colour for each start.

        Up to twelve starts have an entry in the legend with what varies, more a colour bar. If the
        surface is crossed both ways, dots are crossings where its left side rises, crosses where it
        falls.

        Parameters
        ----------
        *names : str
            Two components; by default a pair that the surface leaves free.
        ax : matplotlib.axes.Axes, optional
            Axes to draw into, in your own style.

        Raises
        ------
        InputError
            If a name is unknown, or there is only one.
        """
        return hamsym.plot(self, *names, ax=ax)


@checked_keywords
def section(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, Any] | np.ndarray,
    span: tuple[float, float],
    surface: str,
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    direction: float = 0.0,
    crossings: int | None = None,
    parameters: Mapping[Any, Any] | None = None,
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
    surface : str
        An equation, and inequalities that the crossing must satisfy, for example
        ``"x = 0, p_x > 0"``; both sides may be any formula.
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
    progress : bool, optional
        Show progress; by default on a terminal, after a second.

    Returns
    -------
    Section
        With ``success=False`` and a message if a trajectory ends early, has too few crossings,
        leaves the domain of the surface, H drifts by more than 1 % of its scale, or the force has a
        feature, for example a pulse, that the steps pass over.

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
    """
    members = ensemble_of(H, z0, parameters)
    H = members.H
    start, end = span = checked_span(span)
    chosen = method is None and steps is None and dt is None
    steps = checked_steps(end - start, steps, dt)
    if crossings is not None:
        require_whole("crossings", crossings)
    require_number("direction", direction)
    where = parse_surface(H, surface)
    method = usual_method(H) if method is None else usable_method(H, method)
    began = time.perf_counter()
    advice, kept = "", True
    if chosen:
        choice = choose_steps(members, method, span, progress=progress)
        steps = choice.steps
        if not choice.met and not choice.attempt.interrupted:
            advice = f"steps were chosen for {AIM:.0e}, {choice.found:.1e} was reached"
    size = (end - start) / steps
    share = max(AIM, min(choice.found, COARSE)) if chosen else COARSE
    setting = _Setting(method, surface, where, direction, start, size, steps, crossings, share)
    run = _Crossings(members, setting)
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
    if kept and not problem and not math.isnan(doubts.hidden):
        problem = passed_over(doubts.hidden)
    if advice and not problem:
        message = f"{message}: {advice}"
        warnings.warn(message, StepSizeWarning, stacklevel=3)
    return Section(
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
        axes=_free_pair(H, where),
        H=H,
        drift=drift,
        parameters=members.columns,
    )


class _Doubts(NamedTuple):
    """What may be missing among crossings.

    ``undefined`` is the first time at which a state is finite and the surface is NaN, or NaN,
    ``touches`` the number of places, other than starts, where the surface is touched within
    round-off, ``unresolved`` that of parts of steps with too many crossings to be resolved.
    """

    undefined: float = math.nan
    touches: int = 0
    unresolved: int = 0
    hidden: float = math.nan

    def together(self, other: _Doubts) -> _Doubts:
        """Doubts of both, these first in time."""
        undefined = other.undefined if math.isnan(self.undefined) else self.undefined
        both = self.touches + other.touches, self.unresolved + other.unresolved
        hidden = other.hidden if math.isnan(self.hidden) else self.hidden
        return _Doubts(undefined, *both, hidden)


@dataclass(frozen=True)
class _Setting:
    """What :func:`section` looks for, and the steps that it takes."""

    method: str
    surface: str
    where: Surface
    direction: float
    start: float
    size: float
    steps: int
    limit: int | None
    #: Part of the sizes of the components that features between the steps may change.
    share: float


class _Crossings:
    """Crossings of a surface found so far, while the trajectories are stepped."""

    def __init__(self, members: Ensemble, setting: _Setting) -> None:
        count, method = len(members), setting.method
        self._stepper = fixed_step(
            members.H,
            method,
            members.states,
            np.full(count, setting.start),
            np.full(count, setting.size),
            parameters=members.parameters,
        )
        if isinstance(self._stepper.scheme, Doubled):
            raise InputError(
                f"{method} cannot take part of a step; choose another method, for example gauss4"
            )
        self._members, self._setting = members, setting
        self._found = [(np.empty(0), np.empty((0, members.H.dim)), np.empty(0, dtype=int))]
        self._numbers = np.zeros(count, dtype=int)  # of crossings of each trajectory
        self.doubts = _Doubts()
        self._last, self._interrupted = members.states, False
        self.done = 0
        self.drift = EnergyDrift(members.H, count, members.own_parameters())

    def advance_all(self, progress: bool | None) -> None:
        """Take all steps, until Ctrl-C or enough crossings."""
        block = max(1, _HELD // self._members.states.size)
        steps = self._setting.steps
        self._interrupted = advance_in_blocks(steps, block, progress, self._advance)

    def problem(self, count: int, end: float) -> str:
        """Describe why the crossings are incomplete; "" if they are complete."""
        setting, numbers = self._setting, self._numbers
        if self._interrupted:
            until = setting.start + setting.size * self.done
            return f"stopped after t = {until:.6g}: interrupted"
        lost = ~np.isfinite(self._last).all(axis=-1)
        if lost.any():
            return (
                f"{lost.sum()} of {len(lost):,} trajectories overflowed or came to a step that "
                f"could not be solved, for example number {int(np.argmax(lost))}"
            )
        if not math.isnan(self.doubts.undefined):
            return (
                f"{setting.surface} is not a number at t = {self.doubts.undefined:.6g}; crossings "
                "there are missed"
            )
        if self.doubts.unresolved:
            return (
                f"{setting.surface} may be crossed more often than the {count:,} times that "
                "were found, because it varies too fast or stays within round-off of zero"
            )
        if setting.limit is not None and numbers.min() < setting.limit:
            return (
                f"trajectory {int(np.argmin(numbers))} has only {numbers.min()} of {setting.limit} "
                f"crossings by t = {end:.6g}"
            )
        return ""

    def _advance(self, done: int, count: int) -> bool:
        """Take a block of steps; return False after enough crossings or without trajectories."""
        moved = self._stepper.advance(count, show=False)
        if moved.interrupted:
            raise KeyboardInterrupt
        path = np.concatenate((self._last[:, None], moved.states), axis=1)
        setting = self._setting
        times = setting.start + setting.size * np.arange(done, done + count + 1)
        found, doubts = _crossings(self._members, setting, path, times)
        self._found.append(found)
        self.drift.add(path)
        doubts = doubts._replace(hidden=self._passed_over(path, times))
        self.doubts = self.doubts.together(doubts)
        self._numbers += np.bincount(found[2], minlength=len(self._numbers))
        self.done, self._last = done + count, path[:, -1]
        enough = setting.limit is not None and self._numbers.min() >= setting.limit
        return bool(np.isfinite(self._last).any()) and not enough

    def _passed_over(self, path: np.ndarray, times: np.ndarray) -> float:
        """Return the first time at which the steps pass over a feature of the force, or nan."""
        features, values = hidden_features(self._members.H), self._members.own_parameters()
        if features is None or not math.isnan(self.doubts.hidden):
            return math.nan

        def allowed(index: int) -> np.ndarray:
            own = None if values is None else values[index]
            share = self._setting.share / self._setting.steps * (len(times) - 1)
            return share * features.sizes(path[index], times, own)

        found = features.search(path, times, values, allowed).times
        return (
            math.nan if np.isnan(found).all() else float(found[np.nanargmin(abs(found - times[0]))])
        )

    def ordered(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return times, states and trajectories, at most up to the limit for each."""
        t, z, trajectory = (np.concatenate(parts) for parts in zip(*self._found, strict=True))
        order = np.lexsort((np.sign(self._setting.size) * t, trajectory))
        if self._setting.limit is not None:
            first = np.searchsorted(trajectory[order], trajectory[order])
            order = order[np.arange(len(order)) - first < self._setting.limit]
        return t[order], z[order], trajectory[order]


def _crossings(
    members: Ensemble, setting: _Setting, path: np.ndarray, times: np.ndarray
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], _Doubts]:
    """Locate crossings on paths of shape (n, steps + 1, dim).

    - returns crossings: Times, states and trajectories.
    """
    where, size, direction = setting.where, setting.size, setting.direction
    at, parameters = np.broadcast_to(times, path.shape[:2]), members.own_parameters()
    with np.errstate(all="ignore"):  # where a trajectory has escaped
        rows = None if parameters is None else parameters[:, None]
        values = np.asarray(where.value(path, at, rows), dtype=float)
        rates = _rates(members.H, path, at, rows)
    without = (np.isnan(values) & np.isfinite(path).all(axis=-1)).any(axis=0)
    undefined = float(times[np.argmax(without)]) if without.any() else math.nan
    if where.enclosed is None:
        slopes = _slopes(where, path, at, rates, size, rows)
        (trajectory, step), dips = suspects(values, slopes)
    else:
        finite = np.isfinite(values) & np.isfinite(rates).all(axis=-1)
        trajectory, step = np.nonzero(finite[:, :-1] & finite[:, 1:])
    steps = _Steps(members, setting, path[trajectory, step], times[step], trajectory)
    ends = np.stack([values[trajectory, step], values[trajectory, step + 1]])
    touches, unresolved = np.empty(0), 0
    if where.enclosed is None:
        share, index = zeros(steps.value, ends[0], ends[1], dips, direction)
    else:
        path, rates = path[..., where.components], rates[..., where.components]
        with np.errstate(all="ignore"):
            bends = rate_bends(times, rates)[trajectory, step]
        cells = Cells.whole(
            np.full(len(step), size),
            ends,
            np.stack([path[trajectory, step], path[trajectory, step + 1]]),
            np.stack([rates[trajectory, step], rates[trajectory, step + 1]]),
            bends,
        )
        found = isolated_zeros(cells, steps.enclosed, steps.sample, steps.value, direction)
        share, index, unresolved = found.share, found.index, found.undecided
        touches = np.array([steps.since[i] + low * size for low, i in found.touched])
    z, t, own = steps.states(share, index), steps.times(share, index), steps.parameters(index)
    holds = where.holds(z, t, own)
    doubts = _Doubts(undefined, int((touches != setting.start).sum()), unresolved)
    return (t[holds], z[holds], trajectory[index][holds]), doubts


@dataclass(frozen=True)
class _Steps:
    """The path within steps, from the states ``before`` them at the times ``since``."""

    members: Ensemble
    setting: _Setting
    before: np.ndarray
    since: np.ndarray
    trajectory: np.ndarray

    def times(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        return np.asarray(self.since[index] + share * self.setting.size)

    def parameters(self, index: np.ndarray) -> np.ndarray | None:
        return self.members.own_parameters(self.trajectory[index])

    def states(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        """States after parts of steps."""
        before = self.before[index]
        if not len(index):
            return before
        stepper = fixed_step(
            self.members.H,
            self.setting.method,
            before,
            self.since[index],
            share * self.setting.size,
            parameters=self.members.parameters[self.trajectory[index]],
        )
        # No step at all is the state itself, also where a method divides by the step.
        return np.where(share[:, None] == 0, before, stepper.step(1))

    def value(self, share: np.ndarray, index: np.ndarray) -> np.ndarray:
        """Values of the surface function."""
        z, t = self.states(share, index), self.times(share, index)
        return np.asarray(self.setting.where.value(z, t, self.parameters(index)), dtype=float)

    def sample(
        self, share: np.ndarray, index: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Values of the surface function, and its components with their rates."""
        z, t, own = self.states(share, index), self.times(share, index), self.parameters(index)
        values = np.asarray(self.setting.where.value(z, t, own), dtype=float)
        rates = _rates(self.members.H, z, t, own)
        return values, z[:, self.setting.where.components], rates[:, self.setting.where.components]

    def enclosed(self, cells: Cells) -> Ranges:
        """The surface function over parts of steps."""
        ends = np.stack([self.times(share, cells.index) for share in (cells.low, cells.high)])
        one, own = np.ones(len(cells)), self.parameters(cells.index)
        t = Ranges.of_slopes(ends, Intervals(one, one), np.abs(ends[1] - ends[0]))
        given = None if own is None else lambda i: Ranges.constant(own[:, i])
        assert self.setting.where.enclosed is not None
        return self.setting.where.enclosed(lambda i: component_ranges(cells, i), t, given)


def _rates(
    H: Hamiltonian, z: np.ndarray, t: np.ndarray, parameters: np.ndarray | None
) -> np.ndarray:
    system = H.compile("numpy")
    return np.asarray(system.vector_field(*system.arguments(z, t), **system.keywords(parameters)))


def _slopes(
    where: Surface,
    path: np.ndarray,
    at: np.ndarray,
    rates: np.ndarray,
    size: float,
    parameters: np.ndarray | None,
) -> np.ndarray:
    """Return the change of the surface function over a small distance along the flow."""
    aside = _ASIDE * size
    ahead = where.value(path + aside * rates, at + aside, parameters)
    behind = where.value(path - aside * rates, at - aside, parameters)
    return np.asarray(ahead - behind, dtype=float)


def _energy_error(members: Ensemble, z: np.ndarray, trajectory: np.ndarray) -> float:
    if not members.H.conserves_energy:
        return float("nan")
    system = members.H.compile("numpy")
    starts = system.energy(members.states, **system.keywords(members.own_parameters()))
    energy = system.energy(z, **system.keywords(members.own_parameters(trajectory)))
    return float(np.abs(energy - starts[trajectory]).max(initial=0.0))


def _free_pair(H: Hamiltonian, where: Surface) -> tuple[str, str]:
    """Return the first coordinate and momentum that are not in the equation of the surface."""
    pairs = list(zip(H.names[: H.dof], H.names[H.dof :], strict=True))
    free = [pair for pair in pairs if not where.names & set(pair)]
    return free[0] if free else pairs[0]
