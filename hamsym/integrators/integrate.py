"""Trajectories by time stepping: generated loops for every method of the table, and scipy's.

Input:  a Hamiltonian, one or many initial states, a time span.
Output: a :class:`Trajectory` of states at equally spaced times.

An integrator is one row of :data:`hamsym.integrators.table.INTEGRATORS`; its coefficients are in
:mod:`hamsym.integrators.coefficients`, the loop that takes them in the numba template.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import InputError, SeparabilityError, StepSizeWarning
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.adaptive import Adaptive, reference
from hamsym.integrators.coefficients import Doubled, RungeKutta, Splitting
from hamsym.integrators.energy_drift import AIM, COARSE, Attempt, Choice, EnergyDrift, choose
from hamsym.integrators.fixed_step import NOT_ONLY_SEPARABLE, Stepper
from hamsym.integrators.table import ALIASES, INTEGRATORS
from hamsym.numerics.symplectic import generators
from hamsym.problem import checked_span, checked_steps
from hamsym.support.validation import require_number, require_whole

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Trajectory",
    "choose_steps",
    "fastest_rate",
    "fixed_step",
    "integrate",
    "reference",
    "usable_method",
    "usual_method",
]


#: Steps in one call, at most; numbers beyond are no longer whole.
_INTERRUPTED = "interrupted"
_FEWEST = 1_000  # steps that are chosen
_KEPT, _KEPT_NUMBERS = 16_000, 20_000_000  # states and numbers kept where steps are chosen


@dataclass(frozen=True)
class Trajectory:
    """States along a trajectory, or along each trajectory of an ensemble.

    Attributes
    ----------
    t : numpy.ndarray
        Times, shape (n,).
    z : numpy.ndarray
        States, shape (n, dim), or (batch, n, dim) for an ensemble, in the order of H.z.
    energy : numpy.ndarray
        H along the trajectory, shape (n,) or (batch, n).
    names : tuple of str
        Components of z.
    method : str
    steps : int
        Steps taken by a fixed-step method, outputs of an adaptive one.
    dt : float
        Length of a step, or of the time between outputs.
    evaluations : int
        Of the force, the gradient or the vector field, whichever the method needs.
    seconds : float
        Wall time of the stepping, compilation included.
    success : bool
    interrupted : bool
        Whether Ctrl-C ended it.
    message : str
        What happened, in words. A trajectory that had to stop ends there; in an ensemble its
        later states are nan.
    drift : float
        Largest change of H beyond round-off, at the states that are kept, relative to the energy
        that the motion exchanges between coordinates and momenta
        (:mod:`hamsym.integrators.energy_drift`); the worst of an ensemble. Infinite where H is not
        a number on the way, nan if H depends on time.
    """

    t: np.ndarray = field(repr=False)
    z: np.ndarray = field(repr=False)
    energy: np.ndarray = field(repr=False)
    names: tuple[str, ...]
    method: str
    steps: int
    dt: float
    evaluations: int
    seconds: float
    success: bool
    message: str
    interrupted: bool = False
    drift: float = math.nan

    def plot(self) -> Figure:
        """Components, phase space and the change of H, as a figure."""
        return hamsym.plot(self)


def integrate(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    method: str | None = None,
    *,
    steps: int | None = None,
    dt: float | None = None,
    save_every: int | None = None,
    compensated: bool = False,
    omega: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    progress: bool | None = None,
) -> Trajectory:
    """Integrate Hamilton's equations from z0 over a time span.

    Without ``method``, ``steps`` and ``dt`` the steps are 1,000 times a power of two, the smallest
    at which every trajectory keeps H to 1e-9 of the energy that it exchanges between coordinates
    and momenta, or to round-off, and which resolve the fastest linear motion on the way (at most
    0.2 rad in a step). Where H depends on time, halving the step must change no component by more
    than 1e-9 of its range. A message says what was found, and a warning that it was not reached,
    as near collisions, or where chaos magnifies round-off. Relative errors of the states are often
    a hundred times the drift; they grow with time, and far more in close encounters.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        With a value for every parameter.
    z0 : sequence, mapping or array
        Initial state in the order of H.z or by name. An array of shape (batch, dim), or a mapping
        with arrays, is an ensemble; its trajectories share the processor's cores.
    span : (float, float)
        Start and end time; the end may be the earlier one.
    method : str, optional
        A name in :data:`INTEGRATORS`; by default ``blanes_moan6`` for a separable H, otherwise
        ``gauss6``, which need the fewest evaluations for a drift of 1e-9. Splitting methods need
        H = T(p, t) + V(q, t); there V is taken at a time that advances with the drifts of q, and T
        at one that advances with the kicks of p. The symplectic Euler methods solve their implicit
        half by Newton's method where H is not separable.
    steps : int, optional
        Number of equal steps (for an adaptive method: of equal output intervals). With a method
        20,000 unless given.
    dt : float, optional
        In place of ``steps``: the span is divided into the fewest equal steps no longer than this.
    save_every : int, optional
        Keep every so many steps; divides the number of steps. By default every step is kept, but
        at most 16,000 states where the steps are chosen.
    compensated : bool
        Carry what rounding loses from one step to the next, for splitting methods over very many
        steps. The implicit Runge-Kutta methods always do.
    omega : float, optional
        Coupling of ``tao2`` and ``tao4``, per unit of time; by default twice the spectral radius
        of J Hess at the start.
    rtol, atol : float, optional
        Tolerances of an adaptive method. Unless given, rtol is 1e-13 and atol a hundredth of
        rtol times the usual size of the coordinates for a coordinate, of the momenta for a
        momentum.
    progress : bool, optional
        Show how far it is; by default on a terminal, after a second.

    Returns
    -------
    Trajectory
        With ``success=False``, a message and the part before it if a step could not be solved,
        the states left the range of numbers, or Ctrl-C was pressed.

    Warns
    -----
    StepSizeWarning
        If steps that were chosen do not reach the drift above, or if with a given method or number
        of steps H changes by more than 1 % of the energy exchanged or is not a number on the way
        (which is not looked at where H depends on time). The message says so too.

    Raises
    ------
    InputError
        If a name, a number or the span cannot be used, H is not separable and the method needs
        it, the result would not fit into memory, or more steps would have to be chosen than are
        made unasked.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> trajectory = integrate(H, [1.0, 0.0], (0, 2 * np.pi))
    >>> trajectory.z[-1].round(8) + 0.0, trajectory.drift < 1e-9
    (array([1., 0.]), True)
    >>> trajectory.message
    'blanes_moan6: 1,000 steps to t = 6.28319, H kept to round-off'
    >>> integrate(H, {"x": np.linspace(0, 1, 5), "p": 0.0}, (0, 1), "gauss4", dt=0.1).z.shape
    (5, 11, 2)
    """
    H = Hamiltonian.of(H)
    name = usual_method(H) if method is None else usable_method(H, method)
    states = H.states_from(z0)
    start, end = checked_span(span)
    chosen = method is None and steps is None and dt is None
    count = checked_steps(end - start, steps, dt)
    if save_every is not None:
        require_whole("save_every", save_every)
    every = save_every or 1
    if not chosen and count % every:
        raise InputError(f"save_every={every} does not divide steps={count}; choose a divisor")
    scheme = INTEGRATORS[name].scheme
    if compensated and not isinstance(scheme, Splitting | RungeKutta):
        raise InputError(f"compensated has no meaning for {name}; leave it out")
    if omega is not None and not isinstance(scheme, Doubled):
        raise InputError(f"omega has no meaning for {name}; it is for tao2 and tao4")
    ensemble = np.atleast_2d(states)
    choice: Choice[_Run] | None = None
    began = time.perf_counter()
    if isinstance(scheme, Adaptive):
        _require_memory(count // every, H.dim, len(ensemble))
        times = np.linspace(start, end, count // every + 1)
        run = _run_adaptive(H, scheme, ensemble, times, _tolerances(rtol, atol))
    else:
        for option, value in (("rtol", rtol), ("atol", atol)):
            if value is not None:
                raise InputError(f"{option} has no meaning for {name}; give steps or dt instead")
        options: dict[str, Any] = {
            "compensated": compensated,
            "omega": omega,
            "progress": progress,
        }
        if chosen:
            choice = choose_steps(H, name, ensemble, (start, end), save_every, **options)
            run, count = choice.attempt, choice.steps
        else:
            run = _stepped(H, name, ensemble, (start, end), count, every, **options)
    seconds = time.perf_counter() - began
    z, times, problem = _reached(run.z, run.times, run.problem)
    system = H.compile("numpy")
    with np.errstate(all="ignore"):  # the last state before an escape may be finite, its H not
        energy = system.energy(*system.arguments(z, times))
    kept = EnergyDrift(H, len(z))
    kept.add(z)
    drift = float(kept.relative(count).max())
    message = f"{name}: {count:,} steps to t = {end:.6g}"
    found, warning = _verdict(H, drift, choice)
    if found:
        message = f"{message}, {found}"
    if warning and not problem:
        message = f"{message}: {warning}"
        warnings.warn(message, StepSizeWarning, stacklevel=2)
    if states.ndim == 1:
        z, energy = z[0], energy[0]
    return Trajectory(
        t=times,
        z=z,
        energy=energy,
        names=H.names,
        method=name,
        steps=count,
        dt=(end - start) / count,
        evaluations=run.evaluations,
        seconds=seconds,
        success=not problem,
        message=problem or message,
        interrupted=run.interrupted,
        drift=drift,
    )


def _verdict(H: Hamiltonian, drift: float, choice: Choice[_Run] | None) -> tuple[str, str]:
    """What is found about the steps, and what is wrong with that; "" for nothing."""
    if H.time is None:
        kept = "kept to round-off" if drift == 0 else f"kept to {drift:.1e} of its scale"
        said = f"H {kept}" if math.isfinite(drift) else "H is not a number on the way"
        fine = drift <= COARSE
    elif choice is not None:
        said = f"half as many change the motion by {choice.found:.1e} of its range"
        fine = True
    else:
        return "", ""
    if choice is None:
        return said, "" if fine else "take more steps"
    if choice.met and fine:
        return said, ""
    return said, (
        f"that misses {AIM:.0e} and no more steps were tried; end the span before a close "
        "encounter, or give a method and steps"
    )


@dataclass(frozen=True)
class _Run(Attempt):
    """What a method did, and why it had to stop, if it had to."""

    evaluations: int
    problem: str


def choose_steps(
    H: Hamiltonian,
    name: str,
    ensemble: np.ndarray,
    span: tuple[float, float],
    save_every: int | None = None,
    **options: Any,
) -> Choice[_Run]:
    """The number of steps with which all trajectories keep H, by :func:`choose`."""
    evaluations = 0

    def run(steps: int) -> _Run:
        nonlocal evaluations
        saves = steps if save_every is None else steps // save_every
        while save_every is None and saves > _FEWEST:
            if saves <= _KEPT and saves * ensemble.size <= _KEPT_NUMBERS:
                break
            saves //= 2
        found = _stepped(H, name, ensemble, span, steps, steps // saves, **options)
        evaluations += found.evaluations
        return replace(found, evaluations=evaluations)

    each = save_every or 1
    fewest = each * math.ceil(_FEWEST / each)
    scheme = INTEGRATORS[name].scheme
    assert not isinstance(scheme, Adaptive)
    return choose(H, scheme, ensemble, span, run, fewest)


def _stepped(
    H: Hamiltonian,
    name: str,
    ensemble: np.ndarray,
    span: tuple[float, float],
    steps: int,
    save_every: int,
    *,
    compensated: bool = False,
    omega: float | None = None,
    progress: bool | None = None,
) -> _Run:
    saves, (start, end) = steps // save_every, span
    _require_memory(saves, H.dim, len(ensemble))
    stepper = fixed_step(
        H,
        name,
        ensemble,
        np.full(len(ensemble), start),
        np.full(len(ensemble), (end - start) / steps),
        compensated=compensated,
        omega=omega,
    )
    done = stepper.advance(saves, save_every, show=progress)
    problem = ""
    if done.interrupted:
        problem = _INTERRUPTED
    elif stepper.is_implicit and done.steps.min() < steps:
        problem = "the implicit step could not be solved; take more steps"
    z = np.concatenate((ensemble[:, None], done.states), axis=1)
    times = np.linspace(start, end, saves + 1)
    return _Run(times, z, done.interrupted, done.evaluations, problem)


def fixed_step(
    H: Hamiltonian,
    method: str,
    states: np.ndarray,
    starts: np.ndarray,
    sizes: np.ndarray,
    *,
    compensated: bool = False,
    omega: float | None = None,
    tangents: np.ndarray | None = None,
) -> Stepper:
    """Trajectories that advance by equal steps; see :class:`hamsym.integrators.fixed_step.Stepper`.

    Raises
    ------
    InputError
        If the method is unknown, chooses its own steps, or cannot be used for this H.
    """
    name = usable_method(H, method)
    scheme = INTEGRATORS[name].scheme
    if isinstance(scheme, Adaptive):
        fixed = ", ".join(key for key, row in INTEGRATORS.items() if not row.adaptive)
        raise InputError(f"{method} chooses its own steps; choose one of {fixed}")
    if omega is None:
        omega = _coupling(H, states, starts) if isinstance(scheme, Doubled) else 0.0
    require_number("omega", omega, 0)
    return Stepper(
        H,
        scheme,
        name,
        states,
        starts,
        sizes,
        compensated=compensated,
        tangents=tangents,
        omega=omega,
    )


def usable_method(H: Hamiltonian, method: str) -> str:
    """The name under which a method is in the table, if it can be used for this H.

    Raises
    ------
    InputError
        If it is not there.
    SeparabilityError
        If it splits H and H is not separable.
    """
    name = ALIASES.get(method, method) if isinstance(method, str) else ""
    if name not in INTEGRATORS:
        raise InputError(f"'{method}' is not a method; choose one of {', '.join(INTEGRATORS)}")
    split = isinstance(INTEGRATORS[name].scheme, Splitting) and name not in NOT_ONLY_SEPARABLE
    if split and not H.is_separable:
        raise SeparabilityError(
            f"{method} needs H = T(p) + V(q), and this H is not separable; choose a method for any "
            "H, such as gauss4, implicit_midpoint or tao4"
        )
    return name


def usual_method(H: Hamiltonian) -> str:
    """An accurate symplectic method for this H: splitting where H is separable."""
    return "blanes_moan6" if H.is_separable else "gauss6"


def _run_adaptive(
    H: Hamiltonian,
    scheme: Adaptive,
    ensemble: np.ndarray,
    times: np.ndarray,
    tolerances: tuple[float, float | None],
) -> _Run:
    z = np.full((len(ensemble), len(times), H.dim), np.nan)
    z[:, 0] = ensemble
    evaluations, message = 0, ""
    for i, state in enumerate(ensemble):
        try:
            states, count, problem = scheme.run(H, state, times, *tolerances)
        except KeyboardInterrupt:
            return _Run(times, z, True, evaluations, _INTERRUPTED)
        z[i, : len(states)] = states
        evaluations += count
        message = message or problem
    return _Run(times, z, False, evaluations, message)


def _reached(z: np.ndarray, times: np.ndarray, message: str) -> tuple[np.ndarray, np.ndarray, str]:
    """Trajectories up to the last of them that still has a state, and what to say of it."""
    if not message and np.isfinite(z).all():
        return z, times, message
    finite = np.logical_and.accumulate(np.isfinite(z).all(axis=-1), axis=1)
    z[~finite] = np.nan
    counts = finite.sum(axis=1)
    if counts.min() < len(times):
        message = message or "the states left the range of numbers"
    if message:
        stopped = f"stopped after t = {times[counts.min() - 1]:.6g}: {message}"
        if len(z) > 1:
            which = int(np.argmin(counts))
            number = int((counts < len(times)).sum())
            stopped = (
                f"{number} of {len(z):,} trajectories stopped, number {which} first, {stopped}"
            )
        message = stopped
    end = max(int(counts.max()), 1)
    return z[:, :end], times[:end], message


def fastest_rate(H: Hamiltonian, states: np.ndarray, times: np.ndarray | float) -> float:
    """Largest spectral radius of J Hess at states of shape (n, dim), per unit of time.

    Infinite where the Hessian is not finite.
    """
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        matrices = generators(system.hessian(*system.arguments(states, times)))
    if not np.isfinite(matrices).all():
        return math.inf
    return float(np.abs(np.linalg.eigvals(matrices)).max())


def _coupling(H: Hamiltonian, states: np.ndarray, starts: np.ndarray) -> float:
    rate = fastest_rate(H, states, starts)
    if not math.isfinite(rate):
        raise InputError("the Hessian of H is not finite at z0; give omega")
    return 2 * rate if rate > 0 else 1.0


def _tolerances(rtol: float | None, atol: float | None) -> tuple[float, float | None]:
    rtol = 1e-13 if rtol is None else rtol
    require_number("rtol", rtol, 2.3e-14)
    if atol is not None:
        require_number("atol", atol, 0)
    return rtol, atol


def _require_memory(saves: int, dim: int, batch: int) -> None:
    # The states, a copy of them while they are put together, and the energies.
    wanted = (saves + 1) * (2 * dim + 1) * 8 * batch
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not every system can say
        return
    if wanted > there // 2:
        states = f"{saves:,} states" + (f" of {batch:,} trajectories" if batch > 1 else "")
        raise InputError(
            f"{states} would take {wanted / 2**30:.1f} GiB of {there / 2**30:.1f} GiB; "
            "keep fewer of them with save_every"
        )
