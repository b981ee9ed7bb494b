"""Integration by time stepping with every method of the table of integrators.

Input:  a Hamiltonian, one or many initial states and parameter values, a time span.
Output: a :class:`Trajectory` of states at equally spaced times, with steps that are given or chosen
        (:mod:`hamsym.integrators.fixed`), or to a tolerance
        (:mod:`hamsym.integrators.to_tolerance`).

An integrator is one row of :data:`hamsym.integrators.table.INTEGRATORS`. Its coefficients are in
:mod:`hamsym.integrators.coefficients`, its loop is in ``templates/integrator_loops.py``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.hamiltonian import HamiltonianLike
from hamsym.integrators.coefficients import Doubled, RungeKutta, Splitting
from hamsym.integrators.fixed import integrate_fixed
from hamsym.integrators.table import INTEGRATORS, usable_method, usual_method
from hamsym.integrators.to_tolerance import integrate_to_tolerance
from hamsym.integrators.trajectory import Trajectory
from hamsym.problems.conservation import InvariantLike, KnownInvariants
from hamsym.problems.ensemble import ensemble_of
from hamsym.problems.problem import checked_span, checked_steps
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require_number, require_positive, require_whole


@checked_keywords
def integrate(
    H: HamiltonianLike,
    z0: Sequence[float] | Mapping[Any, Any] | np.ndarray,
    span: tuple[float, float],
    method: str | None = None,
    *,
    parameters: Mapping[Any, Any] | None = None,
    tol: float | None = None,
    saves: int | None = None,
    steps: int | None = None,
    dt: float | None = None,
    save_every: int | None = None,
    compensated: bool = False,
    omega: float | None = None,
    rtol: float | None = None,
    atol: float | None = None,
    progress: bool | None = None,
    invariants: InvariantLike | Sequence[InvariantLike] = (),
) -> Trajectory:
    """Integrate Hamilton's equations from z0 over a time span.

    With ``tol`` the steps of each trajectory are chosen so that its estimated error is at most
    ``tol``, from the differences of runs with n, 2n and 4n steps, which are extrapolated
    (:mod:`hamsym.integrators.to_tolerance`). A trajectory succeeds if the estimate, with round-off,
    is within the tolerance, H changes by no more than that allows, and the force has no pulse,
    pole, kink or jump on the way that the steps do not resolve.

    Without ``method``, ``steps`` and ``dt`` the number of steps is the smallest power of two times
    1,000 for which every trajectory conserves H to 1e-9 of the energy that it exchanges between
    coordinates and momenta, or to round-off, and for which the steps resolve the fastest linear
    motion (at most 0.2 rad per step). For time-dependent H, halving the step must change no
    component by more than 1e-9 of its range. The message gives the result. A warning is issued if
    the target is not met, which happens near collisions or where chaos amplifies round-off.
    Relative errors of the states are often a hundred times the drift; they grow with time, and much
    more in close encounters.

    Between the steps of a method with fixed steps the force is bounded
    (:mod:`hamsym.integrators.hidden_features`). There is no success if it may have a feature that
    the steps pass over, for example a short pulse or a pole, and that changes the motion by more
    than 1 %, or, where steps were chosen, by more than the drift that was reached. With ``tol`` the
    limit is the tolerance. What rounding hides is not found.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
        Every parameter must have a value, here or in ``parameters``.
    z0 : sequence, mapping or array
        Initial state in the order of H.z or by name. An array of shape (..., dim), or a mapping to
        arrays that broadcast, is an ensemble, which is integrated on all cores.
    span : (float, float)
        Start and end time; the end may precede the start.
    method : str, optional
        A name in :data:`INTEGRATORS`; by default ``blanes_moan6`` for a separable H, otherwise
        ``gauss6``, which need the fewest evaluations for a drift of 1e-9. Splitting methods need
        H = T(p, t) + V(q, t); the time in V advances with the drifts of q, and that in T with the
        kicks of p. For a non-separable H the symplectic Euler methods solve their implicit half by
        Newton's method.
    parameters : mapping of name to number or array, optional
        Values that replace those of H; arrays broadcast with the shape of the initial states.
    tol : float, optional
        Tolerance: |z_i - true z_i| <= tol s_i for every component at the saved times, with s_i the
        largest |z_i| along the trajectory; for a component that is zero, or below 1e-8 of the size
        given by the terms of its own equation, s_i is 1e-8 of that size
        (:mod:`hamsym.numerics.scales`). For splitting and implicit Runge-Kutta methods.
    saves : int, optional
        With ``tol``: number of equal intervals between saved states, 100 by default; with 1 only
        start and end are saved.
    steps : int, optional
        Number of equal steps (for an adaptive method: of equal output intervals); 20,000 by default
        if ``method`` is given.
    dt : float, optional
        Largest step, instead of ``steps``: the span is divided into the fewest equal steps.
    save_every : int, optional
        Number of steps between saved states; it must divide the number of steps. By default every
        step is saved, with an automatic number of steps at most 16,000 states.
    compensated : bool
        Use compensated summation in splitting methods, for very many steps. The implicit
        Runge-Kutta methods always use it.
    omega : float, optional
        Coupling of ``tao2`` and ``tao4``, per unit of time; by default twice the spectral radius
        of J Hess at the start.
    rtol, atol : float, optional
        Tolerances of an adaptive method. By default rtol is 1e-13, and atol is 0.01 rtol times the
        typical size of each component.
    progress : bool, optional
        Whether to show progress; by default on a terminal, after a second.
    invariants : sequence of str, sympy.Expr or Invariant
        Functions that H conserves, for all values of the parameters in ``parameters``; that is
        checked first. Their changes are in ``invariant_drift``. With ``tol`` a trajectory succeeds
        only if each changes by no more than the allowed errors explain, to second order; without
        it a warning is issued if one changes by more than errors of 1 % explain.

    Returns
    -------
    Trajectory
        If a step could not be solved, the states or H became non-finite or Ctrl-C was pressed,
        ``success`` is False, the message gives the reason, and the trajectory ends there.

    Warns
    -----
    StepSizeWarning
        If the automatic steps do not meet the target above, or if with a given method or number of
        steps H changes by more than 1 % of the energy exchanged or is not finite, or where H is not
        conserved, a step takes more than 0.6 rad of the fastest linear motion or errs by more than
        1 % of it, or a step is too long beside a pole of H (tested if every step is saved). The
        message contains the warning. With ``tol`` there is none: see ``success``.

    Raises
    ------
    InputError
        If an argument is invalid, the method needs a separable H and H is not separable, the
        result does not fit into memory, rounding makes saved times equal, or the automatic number
        of steps exceeds its limit.

    Examples
    --------
    >>> from hamsym import Hamiltonian
    >>> H = Hamiltonian("p**2/2 + x**2/2")
    >>> trajectory = integrate(H, [1.0, 0.0], (0, 2 * np.pi))
    >>> trajectory.z[-1].round(8) + 0.0, trajectory.drift < 1e-9
    (array([1., 0.]), True)
    >>> trajectory.message
    'blanes_moan6: 1,000 steps to t = 6.28319, H kept to round-off'
    >>> integrate(H, {"x": np.linspace(0, 1, 5), "p": 0.0}, (0, 1), "gauss4", dt=0.1).z.shape
    (5, 11, 2)
    >>> found = integrate(H, [[1.0, 0.0], [2.0, 0.0]], (0, 2 * np.pi), tol=1e-9, saves=1)
    >>> found.success, bool(np.abs(found.z[:, 1] - found.z[:, 0]).max() < 2e-9)
    (array([ True,  True]), True)
    >>> H = Hamiltonian("p**2/2 + k*x**2/2")
    >>> integrate(H, [1.0, 0.0], (0, 1), "gauss4", dt=0.1, parameters={"k": [1.0, 4.0]}).z.shape
    (2, 11, 2)
    """
    members = ensemble_of(H, z0, parameters, finite=tol is None)
    H = members.H
    known = KnownInvariants(H, invariants, members.varied)
    name = usual_method(H) if method is None else usable_method(H, method)
    start, end = checked_span(span)
    if tol is not None:
        given = {"steps": steps, "dt": dt, "save_every": save_every, "rtol": rtol, "atol": atol}
        _check_tolerance(name, tol, saves, {**given, "omega": omega})
        if not members.shape:
            H.state_from(members.states[0])  # one start that is not finite is an invalid argument
        return integrate_to_tolerance(
            members, name, (start, end), tol, saves or 100, compensated, progress, known
        )
    if saves is not None:
        raise InputError("saves applies with tol; give save_every instead")
    count = checked_steps(end - start, steps, dt)
    if save_every is not None:
        require_whole("save_every", save_every)
    chosen = method is None and steps is None and dt is None
    if not chosen and count % (save_every or 1):
        raise InputError(f"save_every={save_every} does not divide steps={count}; give a divisor")
    options = _options(name, rtol, atol, compensated, omega, progress)
    given_steps = None if chosen else count
    return integrate_fixed(members, name, (start, end), given_steps, save_every, known, options)


def _options(
    name: str,
    rtol: float | None,
    atol: float | None,
    compensated: bool,
    omega: float | None,
    progress: bool | None,
) -> dict[str, Any]:
    """Return the options of a method; raise InputError if one does not apply to it."""
    scheme = INTEGRATORS[name].scheme
    if compensated and not isinstance(scheme, Splitting | RungeKutta):
        raise InputError(
            f"compensated applies to splitting and implicit Runge-Kutta methods, not to {name}; "
            "leave it out"
        )
    if omega is not None and not isinstance(scheme, Doubled):
        raise InputError(f"omega applies to tao2 and tao4, not to {name}; leave it out")
    if INTEGRATORS[name].adaptive:
        rtol = 1e-13 if rtol is None else rtol
        require_number("rtol", rtol, 2.3e-14)
        if atol is not None:
            require_number("atol", atol, 0)
        return {"rtol": rtol, "atol": atol}
    for option, value in (("rtol", rtol), ("atol", atol)):
        if value is not None:
            raise InputError(
                f"{option} applies to adaptive methods, not to {name}; give steps or dt instead"
            )
    return {"compensated": compensated, "omega": omega, "progress": progress}


def _check_tolerance(name: str, tol: float, saves: int | None, others: dict[str, Any]) -> None:
    require_positive("tol", tol)
    if saves is not None:
        require_whole("saves", saves)
    if not isinstance(INTEGRATORS[name].scheme, Splitting | RungeKutta):
        raise InputError(
            f"tol applies to splitting and implicit Runge-Kutta methods, not to {name}; leave "
            "method out"
        )
    for option, value in others.items():
        if value is not None:
            raise InputError(f"{option} and tol exclude each other; give one of them")
