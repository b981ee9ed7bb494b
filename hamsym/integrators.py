"""Trajectories by time stepping: generated symplectic loops, and scipy's methods as references.

Input:  a Hamiltonian, an initial state, a time span.
Output: a :class:`Trajectory` of states at equally spaced times.

An integrator is one row of :data:`INTEGRATORS`.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy.integrate

from hamsym import codegen
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian

__all__ = ["INTEGRATORS", "Integrator", "Trajectory", "checked_span", "integrate", "reference"]


@dataclass(frozen=True)
class Integrator:
    """A row of the table: how a method steps, and what the literature calls it.

    Attributes
    ----------
    order : int
    symplectic : bool
    summary, source : str
    run : callable
        (H, z0, times, save_every, tolerances) -> (states, message); fewer states than times, and
        a message, if the method had to stop early.
    adaptive : bool
        Whether the method chooses its own steps, to rtol and atol.
    """

    order: int
    symplectic: bool
    summary: str
    source: str
    run: Callable[..., tuple[np.ndarray, str]] = field(repr=False)
    adaptive: bool = False


@dataclass(frozen=True)
class Trajectory:
    """States along a trajectory.

    Attributes
    ----------
    t : numpy.ndarray
        Times, shape (n,).
    z : numpy.ndarray
        States, shape (n, dim), in the order of H.z.
    energy : numpy.ndarray
        H along the trajectory, shape (n,).
    names : tuple of str
        Components of z.
    method : str
    steps : int
        Steps taken by a fixed-step method, outputs of an adaptive one.
    seconds : float
        Wall time of the stepping, compilation included.
    success : bool
    message : str
        What happened, in words.
    """

    t: np.ndarray = field(repr=False)
    z: np.ndarray = field(repr=False)
    energy: np.ndarray = field(repr=False)
    names: tuple[str, ...]
    method: str
    steps: int
    seconds: float
    success: bool
    message: str


def integrate(
    H: Hamiltonian,
    z0: Sequence[float] | Mapping[Any, float] | np.ndarray,
    span: tuple[float, float],
    method: str = "symplectic_euler",
    *,
    steps: int = 20_000,
    save_every: int = 1,
    rtol: float | None = None,
    atol: float | None = None,
) -> Trajectory:
    """Integrate Hamilton's equations from z0 over a time span.

    Parameters
    ----------
    H : Hamiltonian
        With a value for every parameter.
    z0 : sequence or mapping
        Initial state, in the order of H.z or by name.
    span : (float, float)
        Start and end time; the end may be the earlier one.
    method : str
        A name in :data:`INTEGRATORS`: ``symplectic_euler`` (q first, the paper's eqs.
        EulerScheme), ``symplectic_euler_p`` (p first), ``dop853``, ``odeint``. For a
        non-separable H the symplectic Euler methods solve their implicit half by Newton's method
        with the symbolic Hessian.
    steps : int
        Number of equal steps (for an adaptive method: of equal output intervals).
    save_every : int
        Keep every so many steps; divides ``steps``.
    rtol, atol : float, optional
        Tolerances of an adaptive method, 1e-13 each unless given.

    Returns
    -------
    Trajectory
        With ``success=False``, a message and the part before it if a step could not be solved or
        the states left the range of numbers.

    Raises
    ------
    InputError
        If a name, a number or the span cannot be used, or the result would not fit into memory.

    Examples
    --------
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> trajectory = integrate(H, [1.0, 0.0], (0, 2 * np.pi), "dop853", steps=4)
    >>> trajectory.z[-1].round(9) + 0.0
    array([1., 0.])
    """
    if method not in INTEGRATORS:
        raise InputError(f"'{method}' is not a method; choose one of {', '.join(INTEGRATORS)}")
    integrator = INTEGRATORS[method]
    H.require_parameters()
    state = H.state_from(z0)
    start, end = checked_span(span)
    _require_whole("steps", steps)
    _require_whole("save_every", save_every)
    if steps % save_every:
        raise InputError(f"save_every={save_every} does not divide steps={steps}; choose a divisor")
    tolerances = {"rtol": rtol, "atol": atol}
    for name, value in tolerances.items():
        if value is None:
            tolerances[name] = 1e-13
        elif not integrator.adaptive:
            raise InputError(f"{name} has no meaning for {method}; give steps instead")
        elif not (math.isfinite(value) and value >= 2.3e-14):
            raise InputError(f"{name}={value!r} cannot be used; give a number from 2.3e-14")
    saves = steps // save_every
    _require_memory(saves, H.dim)
    times = np.linspace(start, end, saves + 1)
    began = time.perf_counter()
    states, message = integrator.run(H, state, times, save_every, **tolerances)
    seconds = time.perf_counter() - began
    finite = np.all(np.isfinite(states), axis=1)
    if not finite.all():
        states = states[: int(np.argmin(finite))]
        message = message or "the states left the range of numbers"
    if message:
        message = f"stopped after t = {times[len(states) - 1]:.6g}: {message}"
    times = times[: len(states)]
    system = H.compile("numpy")
    with np.errstate(all="ignore"):  # the last state before an escape may be finite, its H not
        energy = system.energy(*system.arguments(states, times))
    return Trajectory(
        t=times,
        z=states,
        energy=energy,
        names=H.names,
        method=method,
        steps=steps,
        seconds=seconds,
        success=not message,
        message=message or f"{method}: {steps:,} steps to t = {end:.6g}",
    )


def reference(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], *, tolerance: float = 1e-13
) -> Callable[[np.ndarray], np.ndarray]:
    """DOP853 with dense output as a function of time, for judging less accurate solutions.

    Returns
    -------
    callable
        t of shape (n,) -> states of shape (n, dim).

    Raises
    ------
    InputError
        If the solution does not exist over the whole span.
    """
    H.require_parameters()
    result = _dop853(H, H.state_from(z0), span, tolerance, tolerance, dense_output=True)
    if not result.success or not np.all(np.isfinite(result.y)):
        raise InputError(
            f"no solution beyond t = {result.t[-1]:.6g}: {result.message} End the span before it"
        )
    return lambda t: result.sol(np.asarray(t)).T


def checked_span(span: tuple[float, float]) -> tuple[float, float]:
    """Start and end of a time span as floats.

    Raises
    ------
    InputError
        If the span is not two different finite numbers.
    """
    try:
        start, end = (float(value) for value in span)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"span={span!r} is not a pair of times; give (t_start, t_end)") from None
    # Below the smallest normal number nothing can be divided by a span.
    distinct = abs(end - start) > 1e-300
    if not (math.isfinite(start) and math.isfinite(end)) or not distinct:
        raise InputError(f"span={span!r} cannot be used; give two different finite times")
    return start, end


def _step_loop(name: str) -> Callable[..., tuple[np.ndarray, str]]:
    def run(
        H: Hamiltonian, z0: np.ndarray, times: np.ndarray, save_every: int, **_: float
    ) -> tuple[np.ndarray, str]:
        # H.compile("numba") would compile more than this loop.
        loop = codegen.load(H.source("numba"), "numba", H.names).step_loops[name]
        saves = len(times) - 1
        step_size = (times[-1] - times[0]) / (saves * save_every)
        states = np.empty((saves + 1, H.dim))
        values = [H.parameters[parameter] for parameter in H.parameter_names]
        done = loop(z0, states, times[0], step_size, saves, save_every, *values)
        if done == saves * save_every:
            return states, ""
        return states[: done // save_every + 1], (
            "the implicit step could not be solved; take more steps"
        )

    return run


def _rates(H: Hamiltonian) -> Callable[[float, np.ndarray], np.ndarray]:
    """The vector field as scipy calls it, time first."""
    system = H.compile("numpy")
    return lambda t, z: np.asarray(system.vector_field(*system.arguments(z, t)))


def _dop853(
    H: Hamiltonian,
    z0: np.ndarray,
    span: tuple[float, float],
    rtol: float,
    atol: float,
    **output: Any,
) -> Any:
    with np.errstate(all="ignore"):
        return scipy.integrate.solve_ivp(
            _rates(H), span, z0, method="DOP853", rtol=rtol, atol=atol, **output
        )


def _run_dop853(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, save_every: int, rtol: float, atol: float
) -> tuple[np.ndarray, str]:
    result = _dop853(H, z0, (times[0], times[-1]), rtol, atol, t_eval=times)
    return result.y.T, "" if result.success else result.message


def _run_odeint(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, save_every: int, rtol: float, atol: float
) -> tuple[np.ndarray, str]:
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.integrate.ODEintWarning)  # the report says it too
        states, report = scipy.integrate.odeint(
            _rates(H),
            z0,
            times,
            rtol=rtol,
            atol=atol,
            mxstep=100_000,
            full_output=True,
            tfirst=True,
        )
    if report["message"] == "Integration successful.":
        return states, ""
    # LSODA reports how far it was at each output; the first it did not reach ends the trajectory.
    ahead = np.sign(times[-1] - times[0]) * (report["tcur"] - times[1:]) >= 0
    return states[: 1 + (len(ahead) if ahead.all() else int(np.argmin(ahead)))], report["message"]


#: Every integrator by name.
INTEGRATORS: dict[str, Integrator] = {
    "symplectic_euler": Integrator(
        1,
        True,
        "symplectic Euler, q first with p_n, then p with q_n+1",
        "the paper's eqs. EulerScheme_q and EulerScheme_p; de Vogelaere 1956",
        _step_loop("symplectic_euler"),
    ),
    "symplectic_euler_p": Integrator(
        1,
        True,
        "symplectic Euler, p first with q_n, then q with p_n+1",
        "the adjoint of symplectic_euler",
        _step_loop("symplectic_euler_p"),
    ),
    "dop853": Integrator(
        8,
        False,
        "Dormand-Prince 8(5,3), adaptive, from scipy",
        "Hairer, Norsett & Wanner 1993, section II.5",
        _run_dop853,
        adaptive=True,
    ),
    "odeint": Integrator(
        12,
        False,
        "LSODA, adaptive, from scipy; the paper's ground truth",
        "Hindmarsh 1983",
        _run_odeint,
        adaptive=True,
    ),
}


def _require_whole(name: str, value: int) -> None:
    if not isinstance(value, (int, np.integer)) or isinstance(value, bool) or value < 1:
        raise InputError(f"{name}={value!r} cannot be used; give a whole number from 1")


def _require_memory(saves: int, dim: int) -> None:
    wanted = (saves + 1) * dim * 8
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not every system can say
        return
    if wanted > there // 2:
        raise InputError(
            f"{saves:,} states would take {wanted / 2**30:.1f} GiB of {there / 2**30:.1f} GiB; "
            "keep fewer of them with save_every"
        )
