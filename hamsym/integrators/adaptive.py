"""Adaptive methods of scipy, also used as references for other solutions."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.numerics.call_limit import TooManyCallsError, limited
from hamsym.numerics.scales import floored_sizes

_LEAST = 1e-2  # size of a component relative to what others make of it
_MOST, _MOST_ROUGH = 10_000_000, 300_000  # evaluations, some minutes, and of low accuracy
_COUPLINGS = 64  # states at which that is found


@dataclass(frozen=True)
class Adaptive:
    """An integrator with adaptive step size."""

    #: (H, z0, times, rtol, atol) -> (states, evaluations, message). After an early stop there are
    #: fewer states than times, and the message gives the reason; otherwise it is empty. If atol is
    #: None it is 0.01 rtol times the typical size of each component.
    run: Callable[..., tuple[np.ndarray, int, str]]
    is_symplectic = False
    is_symmetric = False


def reference(
    H: HamiltonianLike, z0: np.ndarray, span: tuple[float, float], *, tolerance: float = 1e-13
) -> Callable[[np.ndarray], np.ndarray]:
    """Integrate with DOP853 and return its dense output, a reference for other solutions.

    Raise InputError if the integration stops before the end of the span.

    - returns: t of shape (n,) -> states of shape (n, dim).
    """
    H = Hamiltonian.of(H)
    try:
        result = _dop853(H, H.state_from(z0), span, tolerance, None, dense_output=True)
    except TooManyCallsError:
        raise InputError(
            f"DOP853 takes more than {_MOST:,} evaluations; use a shorter span"
        ) from None
    if not result.success or not np.all(np.isfinite(result.y)):
        raise InputError(
            f"no solution beyond t = {result.t[-1]:.6g} ({result.message.rstrip('.')}); use an "
            "earlier end time"
        )
    return lambda t: result.sol(np.asarray(t)).T


def run_dop853(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, rtol: float, atol: float | None
) -> tuple[np.ndarray, int, str]:
    """Integrate with scipy's DOP853 and return the states at the given times."""
    try:
        result = _dop853(H, z0, (times[0], times[-1]), rtol, atol, t_eval=times)
    except TooManyCallsError:
        return z0[None].copy(), _MOST, f"more than {_MOST:,} evaluations; give a shorter span"
    # If the first step fails, scipy returns an empty list.
    states = np.array(result.y, dtype=float).reshape(H.dim, -1).T
    return states, result.nfev, "" if result.success else result.message


def run_odeint(
    H: Hamiltonian, z0: np.ndarray, times: np.ndarray, rtol: float, atol: float | None
) -> tuple[np.ndarray, int, str]:
    """Integrate with scipy's LSODA and return the states at the given times."""
    absolute = _absolute_tolerance(H, z0, (times[0], times[-1]), rtol) if atol is None else atol
    with np.errstate(all="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", scipy.integrate.ODEintWarning)  # the report contains it
        states, report = scipy.integrate.odeint(
            _rates(H),
            z0,
            times,
            rtol=rtol,
            atol=absolute,
            mxstep=100_000,
            full_output=True,
            tfirst=True,
        )
    evaluations = int(report["nfe"].max())
    if report["message"] == "Integration successful.":
        return states, evaluations, ""
    # tcur is the time LSODA reached for each output; the first output beyond it ends the path.
    ahead = np.sign(times[-1] - times[0]) * (report["tcur"] - times[1:]) >= 0
    reached = len(ahead) if ahead.all() else int(np.argmin(ahead))
    return states[: 1 + reached], evaluations, report["message"]


def dop853_coefficients() -> dict[str, list[Any]]:
    """Return the coefficients of DOP853, for code in other languages.

    - a, b, c: Of the twelve stages, without what is above the diagonal.
    - e3, e5: Of the two estimates of the error.
    - a_extra, c_extra, d: Of the continuous extension, which has three more stages.

    Examples
    --------
    >>> found = dop853_coefficients()
    >>> [len(found[name]) for name in ("a", "b", "c", "e3", "e5", "a_extra", "c_extra", "d")]
    [12, 12, 12, 13, 13, 3, 3, 4]
    """
    method: Any = scipy.integrate.DOP853
    arrays = {"b": method.B, "c": method.C, "e3": method.E3, "e5": method.E5}
    arrays |= {"c_extra": method.C_EXTRA, "d": method.D}
    found: dict[str, list[Any]] = {name: array.tolist() for name, array in arrays.items()}
    found["a"] = [row[:stage].tolist() for stage, row in enumerate(method.A)]
    found["a_extra"] = [row[:stage].tolist() for stage, row in enumerate(method.A_EXTRA, 13)]
    return found


def _rates(H: Hamiltonian) -> Callable[[float, np.ndarray], np.ndarray]:
    """The vector field with scipy's signature, (t, z)."""
    system = H.compile("numpy")
    return lambda t, z: np.asarray(system.vector_field(*system.arguments(z, t)))


def _absolute_tolerance(
    H: Hamiltonian, z0: np.ndarray, span: tuple[float, float], rtol: float
) -> np.ndarray:
    """Absolute tolerance that takes effect only near zeros of a component, shape (dim,).

    It is a part of the typical size of each component on a trajectory of low accuracy: of the
    median over time, so that an escape at the end does not set the scale of the motion before.
    """
    time = abs(span[1] - span[0])

    def sizes(states: np.ndarray, times: np.ndarray, least: np.ndarray) -> np.ndarray:
        own = np.maximum(np.median(np.abs(states), axis=0), least)
        own = np.where(np.isfinite(own), own, least)
        largest = own.reshape(2, -1).max(axis=1).repeat(H.dof)
        if ((own > 0) & (own >= _LEAST * largest)).all():
            return own  # the couplings of large systems take long to derive
        chosen = np.unique(np.linspace(0, len(times) - 1, _COUPLINGS).astype(int))
        coupling = np.abs(H.compile("numpy").at("jacobian", states[chosen], times[chosen]))
        coupling = coupling[np.isfinite(coupling).all(axis=(1, 2))]
        mean = coupling.mean(axis=0) if len(coupling) else np.zeros((H.dim, H.dim))
        return floored_sizes(own, mean, time, _LEAST)

    with np.errstate(all="ignore"):
        rates = np.abs(_rates(H)(span[0], z0))
        # What is zero at the start grows to about its rate times the span.
        grown = np.where((z0 == 0) & np.isfinite(rates), rates * time, 0.0)
        guess = sizes(z0[None], np.array(span[:1]), grown)
        with contextlib.suppress(TooManyCallsError):
            rough = _dop853(H, z0, span, 1e-3, 1e-3 * guess, calls=_MOST_ROUGH)
            states = np.array(rough.y, dtype=float).T
            if states.size:
                guess = sizes(states, np.array(rough.t), np.zeros(H.dim))
    return np.asarray(0.01 * rtol * guess)


def _dop853(
    H: Hamiltonian,
    z0: np.ndarray,
    span: tuple[float, float],
    rtol: float,
    atol: Any,
    calls: int | None = None,
    **output: Any,
) -> Any:
    """Run scipy's DOP853; raise TooManyCallsError after a number of evaluations."""
    if atol is None:
        atol = _absolute_tolerance(H, z0, span, rtol)
    with np.errstate(all="ignore"):
        return scipy.integrate.solve_ivp(
            limited(_rates(H), calls or _MOST),
            span,
            z0,
            method="DOP853",
            rtol=rtol,
            atol=atol,
            **output,
        )
