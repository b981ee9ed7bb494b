"""scipy's adaptive methods: the references that others are judged by."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.integrate

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian

__all__ = ["Adaptive", "reference", "run_dop853", "run_odeint"]


@dataclass(frozen=True)
class Adaptive:
    """A method that chooses its own steps.

    Attributes
    ----------
    run : callable
        (H, z0, times, rtol, atol) -> (states, evaluations, message); fewer states than times, and
        a message, if it had to stop early.
    """

    run: Callable[..., tuple[np.ndarray, int, str]]
    is_symplectic = False
    is_symmetric = False


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


def run_dop853(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, rtol: float, atol: float
) -> tuple[np.ndarray, int, str]:
    """scipy's DOP853 at the given times."""
    result = _dop853(H, z0, (times[0], times[-1]), rtol, atol, t_eval=times)
    return result.y.T, result.nfev, "" if result.success else result.message


def run_odeint(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, rtol: float, atol: float
) -> tuple[np.ndarray, int, str]:
    """scipy's LSODA at the given times."""
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
    evaluations = int(report["nfe"].max())
    if report["message"] == "Integration successful.":
        return states, evaluations, ""
    # LSODA reports how far it was at each output; the first it did not reach ends the trajectory.
    ahead = np.sign(times[-1] - times[0]) * (report["tcur"] - times[1:]) >= 0
    reached = len(ahead) if ahead.all() else int(np.argmin(ahead))
    return states[: 1 + reached], evaluations, report["message"]


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
