"""Poincare sections: where trajectories of an ensemble cross a surface, located to round-off.

Input:  a Hamiltonian, initial states, a surface such as "x = 0, p_x > 0".
Output: a :class:`Section` with the states of all crossings.

The trajectories are stepped with a generated loop. Between two steps with different signs a
crossing is found by taking part of a step: the point is on the curve that the method itself draws.
A pair of crossings within one step is found from the slopes at its ends, which are those along the
flow.
"""

from __future__ import annotations

import math
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import InputError, StepSizeWarning
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.coefficients import Doubled
from hamsym.integrators.energy_drift import AIM, COARSE, EnergyDrift
from hamsym.integrators.integrate import (
    choose_steps,
    fixed_step,
    usable_method,
    usual_method,
)
from hamsym.numerics.roots import suspects, zeros
from hamsym.problem import checked_span, checked_steps
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require_number, require_whole
from hamsym.surface import Surface, parse_surface

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = ["Section", "section"]

_HELD = 2_000_000  # numbers held at once while crossings are looked for
_ASIDE = 1e-3  # of a step: how far along the flow slopes are read


@dataclass(frozen=True)
class Section:
    """Crossings of a surface, ordered by trajectory and then as they happened.

    Attributes
    ----------
    surface : str
    names : tuple of str
        Components of z.
    t : numpy.ndarray
        Times of the crossings, shape (n,).
    z : numpy.ndarray
        States there, shape (n, dim).
    trajectory : numpy.ndarray
        Number of the trajectory that each belongs to, shape (n,).
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
        What happened, in words.
    """

    surface: str
    names: tuple[str, ...]
    t: np.ndarray = field(repr=False)
    z: np.ndarray = field(repr=False)
    trajectory: np.ndarray = field(repr=False)
    energy_error: float
    method: str
    dt: float
    seconds: float
    success: bool
    message: str
    axes: tuple[str, str] = field(repr=False)
    drift: float = math.nan

    def plot(self, x: str | None = None, y: str | None = None) -> Figure:
        """The crossings in a plane, by default that of a pair that the surface leaves free."""
        for name in (x, y):
            if name is not None and name not in self.names:
                raise InputError(
                    f"'{name}' is not a component of z; choose one of {', '.join(self.names)}"
                )
        return hamsym.plot(self, x or self.axes[0], y or self.axes[1])


def section(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    surface: str,
    *,
    method: str | None = None,
    steps: int | None = None,
    dt: float | None = None,
    direction: float = 0.0,
    crossings: int | None = None,
    progress: bool | None = None,
) -> Section:
    """Crossings of a surface by one trajectory or by each of an ensemble.

    A pair of crossings within one step is found if the surface is approached and left once there;
    pairs where that happens more than once, and a third crossing, go unseen. A start on the surface
    is no crossing.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : sequence, mapping or array
        As in :func:`hamsym.integrate`, shape (dim,) or (batch, dim).
    span : (float, float)
    surface : str
        An equation, and inequalities that the crossing must satisfy, such as
        ``"x = 0, p_x > 0"``; both sides may be any formula.
    method : str, optional
        A fixed-step method of :data:`hamsym.integrators.table.INTEGRATORS`; by default
        ``blanes_moan6`` for a separable H, otherwise ``gauss6``.
    steps : int, optional
        Number of steps. Without ``method``, ``steps`` and ``dt`` they are chosen as in
        :func:`hamsym.integrate`, for an energy drift of 1e-9 over the whole span; with a method
        20,000 unless given.
    dt : float, optional
        In place of ``steps``, the largest step.
    direction : float
        Above zero only crossings at which left side minus right side rises, below zero falls.
    crossings : int, optional
        Stop as soon as every trajectory has so many, and keep no more.
    progress : bool, optional
        Show how far it is; by default on a terminal, after a second.

    Returns
    -------
    Section
        With ``success=False`` and a message if a trajectory is lost, has too few crossings, or
        comes to where the surface has no value.

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
    H = Hamiltonian.of(H)
    states = np.atleast_2d(H.states_from(z0))
    start, end = checked_span(span)
    chosen = method is None and steps is None and dt is None
    steps = checked_steps(end - start, steps, dt)
    if crossings is not None:
        require_whole("crossings", crossings)
    require_number("direction", direction)
    where = parse_surface(H, surface)
    method = usual_method(H) if method is None else usable_method(H, method)
    began = time.perf_counter()
    doubt = ""
    if chosen:
        choice = choose_steps(H, method, states, (start, end), progress=progress)
        steps = choice.steps
        if not choice.met and not choice.attempt.interrupted:
            doubt = f"steps were chosen for {AIM:.0e}, {choice.found:.1e} was reached"
    count, size = len(states), (end - start) / steps
    stepper = fixed_step(H, method, states, np.full(count, start), np.full(count, size))
    if isinstance(stepper.scheme, Doubled):
        raise InputError(f"{method} cannot take part of a step; choose another one, such as gauss4")
    nothing = np.empty(0), np.empty((0, H.dim)), np.empty(0, dtype=int)
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = [nothing]
    numbers = np.zeros(count, dtype=int)
    piece = max(1, _HELD // (count * H.dim))
    message, done, last = "", 0, states
    watched, undefined = EnergyDrift(H, count), math.nan
    with stepping_progress(steps, progress) as report:
        try:
            while done < steps:
                moved = stepper.advance(min(piece, steps - done), show=False)
                if moved.interrupted:
                    raise KeyboardInterrupt
                path = np.concatenate((last[:, None], moved.states), axis=1)
                times = start + size * np.arange(done, done + path.shape[1])
                crossed, without = _crossings(H, method, where, direction, path, times, size)
                found.append(crossed)
                watched.add(path)
                undefined = without if math.isnan(undefined) else undefined
                numbers += np.bincount(found[-1][2], minlength=count)
                done, last = done + path.shape[1] - 1, path[:, -1]
                report(path.shape[1] - 1)
                if not np.isfinite(last).any() or (crossings and numbers.min() >= crossings):
                    break
        except KeyboardInterrupt:  # what was done before this piece counts
            message = "interrupted"
    t, z, trajectory = (np.concatenate(parts) for parts in zip(*found, strict=True))
    order = np.lexsort((np.sign(size) * t, trajectory))
    if crossings is not None:
        first = np.searchsorted(trajectory[order], trajectory[order])
        order = order[np.arange(len(order)) - first < crossings]
    t, z, trajectory = t[order], z[order], trajectory[order]
    lost = ~np.isfinite(last).all(axis=-1)
    drift = float(watched.relative(done).max())
    if message:
        message = f"stopped after t = {start + size * done:.6g}: {message}"
    elif lost.any():
        message = (
            f"{lost.sum()} of {count:,} trajectories, such as number {int(np.argmax(lost))}, left "
            "the range of numbers or came to a step that could not be solved"
        )
    elif not math.isnan(undefined):
        message = f"{surface} is not a number at t = {undefined:.6g}; crossings there go unseen"
    elif crossings is not None and numbers.min() < crossings:
        message = (
            f"trajectory {int(np.argmin(numbers))} has only {numbers.min()} of {crossings} "
            f"crossings by t = {end:.6g}"
        )
    said = f"{len(t):,} crossings of {surface}, {method} with dt = {size:.3g}"
    if H.time is None:
        said += f", H kept to {drift:.1e} of its scale" if drift else ", H kept to round-off"
        if not drift <= COARSE:
            doubt = "take smaller steps"
    if doubt and not message:
        said = f"{said}: {doubt}"
        warnings.warn(said, StepSizeWarning, stacklevel=2)
    return Section(
        surface=surface,
        names=H.names,
        t=t,
        z=z,
        trajectory=trajectory,
        energy_error=_energy_error(H, states, z, trajectory),
        method=method,
        dt=size,
        seconds=time.perf_counter() - began,
        success=not message,
        message=message or said,
        axes=_free_pair(H, where),
        drift=drift,
    )


def _crossings(
    H: Hamiltonian,
    method: str,
    where: Surface,
    direction: float,
    path: np.ndarray,
    times: np.ndarray,
    size: float,
) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], float]:
    """Crossings on paths of shape (n, steps + 1, dim), and where the surface has no value.

    Times, states and trajectories of the crossings; the first time at which the state is finite
    and the surface is nan, or nan.
    """
    at = np.broadcast_to(times, path.shape[:2])
    with np.errstate(all="ignore"):  # where a trajectory has escaped
        values = np.asarray(where.value(path, at), dtype=float)
        slopes = _slopes(H, where, path, at, size)
    without = (np.isnan(values) & np.isfinite(path).all(axis=-1)).any(axis=0)
    undefined = float(times[np.argmax(without)]) if without.any() else math.nan
    (trajectory, step), dips = suspects(values, slopes)
    before, since = path[trajectory, step], times[step]

    def part_of_a_step(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        moved = fixed_step(H, method, before[index], since[index], share * size).step(1)
        # No step at all is the state itself, also where a method divides by the step.
        return np.where(share[:, None] == 0, before[index], moved)

    def value(share: np.ndarray, index: np.ndarray) -> np.ndarray:
        return where.value(part_of_a_step(share, index), since[index] + share * size)

    ends = values[trajectory, step], values[trajectory, step + 1]
    share, index = zeros(value, *ends, dips, direction)
    z = part_of_a_step(share, index) if len(index) else before[:0]
    t = since[index] + share * size
    holds = where.holds(z, t)
    return (t[holds], z[holds], trajectory[index][holds]), undefined


def _slopes(
    H: Hamiltonian, where: Surface, path: np.ndarray, at: np.ndarray, size: float
) -> np.ndarray:
    """Changes of what is zero on the surface, a little way along the flow."""
    system, aside = H.compile("numpy"), _ASIDE * size
    rates = np.asarray(system.vector_field(*system.arguments(path, at)))
    ahead = where.value(path + aside * rates, at + aside)
    behind = where.value(path - aside * rates, at - aside)
    return np.asarray(ahead - behind, dtype=float)


def _energy_error(
    H: Hamiltonian, starts: np.ndarray, z: np.ndarray, trajectory: np.ndarray
) -> float:
    if H.time is not None:
        return float("nan")
    energy = H.compile("numpy").energy
    return float(np.abs(energy(z) - energy(starts)[trajectory]).max(initial=0.0))


def _free_pair(H: Hamiltonian, where: Surface) -> tuple[str, str]:
    """The first coordinate, with its momentum, of which the surface fixes nothing."""
    pairs = list(zip(H.names[: H.dof], H.names[H.dof :], strict=True))
    free = [pair for pair in pairs if not where.names & set(pair)]
    return free[0] if free else pairs[0]
