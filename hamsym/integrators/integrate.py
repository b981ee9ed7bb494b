"""Integration by time stepping with every method of the table of integrators.

Input:  a Hamiltonian, one or many initial states and parameter values, a time span.
Output: a :class:`Trajectory` of states at equally spaced times.

An integrator is one row of :data:`hamsym.integrators.table.INTEGRATORS`. Its coefficients are in
:mod:`hamsym.integrators.coefficients`, its loop is in ``templates/integrator_loops.py``.
"""

from __future__ import annotations

import math
import os
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

import hamsym
from hamsym.conservation import InvariantLike, KnownInvariants
from hamsym.description import attributes_of
from hamsym.ensemble import Ensemble, ensemble_of
from hamsym.errors import InputError, SeparabilityError, StepSizeWarning
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.integrators.adaptive import Adaptive
from hamsym.integrators.coefficients import Doubled, RungeKutta, Splitting
from hamsym.integrators.energy_drift import (
    AIM,
    COARSE,
    Attempt,
    Choice,
    EnergyDrift,
    choose,
    work_of,
)
from hamsym.integrators.fixed_step import NOT_ONLY_SEPARABLE, Stepper
from hamsym.integrators.hidden_features import hidden_features, passed_over
from hamsym.integrators.interpolation import Interpolant
from hamsym.integrators.narrow_features import narrow_features
from hamsym.integrators.table import ALIASES, INTEGRATORS
from hamsym.integrators.tolerance import ToleranceSearch, Tolerated
from hamsym.problem import checked_span, checked_steps
from hamsym.suggestions import checked_keywords, did_you_mean, suggest_attributes, unknown
from hamsym.support.shown import Shown
from hamsym.support.tables import data_frame, data_set, member_axes, time_name
from hamsym.support.validation import require_number, require_positive, require_whole

if TYPE_CHECKING:
    import pandas
    import xarray
    from matplotlib.figure import Figure


_INTERRUPTED = "interrupted"
_MIN_STEPS = 1_000  # smallest automatic number of steps
_MAX_SAVED, _MAX_SAVED_COMPONENTS = (
    16_000,
    20_000_000,
)  # largest saved states and components with automatic steps
_MAX_TESTED = 20_001  # saved states of a trajectory at which the drift of H is computed


@suggest_attributes
@dataclass(frozen=True)
class Trajectory(Shown):
    """States along a trajectory, or along each trajectory of an ensemble.

    An ensemble has the shape to which the initial states and the parameters broadcast, (batch,) for
    states of shape (batch, dim); () below is the shape of one trajectory.

    Attributes
    ----------
    t : numpy.ndarray
        Times, shape (n,).
    z : numpy.ndarray
        States, shape (*shape, n, dim), in the order of H.z.
    energy : numpy.ndarray
        H along the trajectory, shape (*shape, n); computed when it is first read.
    names : tuple of str
        Components of z.
    method : str
    steps : int
        Steps taken by a fixed-step method, outputs of an adaptive one; with ``tol`` those of the
        finest run of the trajectory that needs the most.
    dt : float
        Length of a step, or of the time between outputs.
    evaluations : int
        Number of evaluations of the force, the gradient or the vector field.
    seconds : float
        Wall time of the integration, including compilation.
    success : bool or numpy.ndarray
        Whether every trajectory reached the end. With ``tol``, whether the trajectory meets it; for
        an ensemble an array of its shape.
    interrupted : bool
        Whether Ctrl-C ended the run.
    message : str
        Outcome in words. A trajectory that stops early ends at its last state; in an ensemble its
        later states are nan.
    messages : numpy.ndarray
        The same for each trajectory of an ensemble, strings in an array of its shape.
    ensemble : Ensemble
        H, the initial states and the parameter values.
    drift : float
        Largest change of H in excess of round-off, at the saved states (at 20,001 of them if there
        are more), relative to the energy that the motion exchanges between coordinates and momenta
        (:mod:`hamsym.integrators.energy_drift`); the largest of an ensemble. Infinite if H is not
        finite along the trajectory, nan if H depends on time, forces act, and with ``tol``.
    errors : numpy.ndarray, optional
        With ``tol``: largest estimated error of each component up to each time, shape of z, in the
        units of the components; infinite where it is unknown.
    verdicts : Tolerated, optional
        With ``tol``: steps, largest relative error and problem of each trajectory, in a flat order.
    invariant_drift : mapping of str to float or numpy.ndarray
        Largest change of each of the ``invariants`` at the saved times, by its formula, (*shape);
        not part of files.
    """

    t: np.ndarray = field(repr=False)
    z: np.ndarray = field(repr=False)
    names: tuple[str, ...]
    method: str
    steps: int
    dt: float
    evaluations: int
    seconds: float
    success: bool | np.ndarray
    message: str
    ensemble: Ensemble = field(repr=False)
    interrupted: bool = False
    drift: float = math.nan
    errors: np.ndarray | None = field(default=None, repr=False)
    verdicts: Tolerated | None = field(default=None, repr=False)
    invariant_drift: Mapping[str, Any] = field(default_factory=dict, repr=False)

    def __repr__(self) -> str:
        success, found = np.asarray(self.success), self.verdicts
        if success.ndim:
            outcome = f"{int(success.sum()):,} of {success.size:,} succeeded"
        else:
            outcome = f"success={bool(success)}"
        if found is not None:
            error = f", estimated relative error {found.largest.max(initial=0.0):.1e}"
        else:
            kept = f"to {self.drift:.1e}" if self.drift else "to round-off"
            error = "" if math.isnan(self.drift) else f", H kept {kept}"
        shape = f"shape {self.ensemble.shape}, " if self.ensemble.shape else ""
        return (
            f"Trajectory({self.ensemble.H.formulas!r}, {shape}{len(self.t):,} states, t from "
            f"{self.t[0]:.6g} to {self.t[-1]:.6g}, {self.method}{error}, {outcome})"
        )

    @property
    def H(self) -> Hamiltonian:
        """The Hamiltonian, with the parameters of the first trajectory where they differ."""
        return self.ensemble.H

    @property
    def z0(self) -> np.ndarray:
        """Initial states, shape (*shape, dim)."""
        return self.ensemble.states.reshape(*self.ensemble.shape, -1)

    @property
    def span(self) -> tuple[float, float]:
        """First and last of the saved times."""
        return float(self.t[0]), float(self.t[-1])

    @property
    def largest_error(self) -> np.ndarray | None:
        """Largest estimated error of each component, shape (*shape, dim); None without ``tol``."""
        return None if self.errors is None else self.errors[..., -1, :]

    @cached_property
    def messages(self) -> np.ndarray:
        """Outcome of each trajectory in words, an array of the shape of the ensemble."""
        texts = np.full(len(self.ensemble), self.message, dtype=object)
        if self.verdicts is not None:
            for index in range(len(texts)):
                texts[index] = _verdict(self.verdicts, index, self.method, float(self.t[-1]))
        return texts.reshape(self.ensemble.shape)

    @cached_property
    def energy(self) -> np.ndarray:
        """H along the trajectory, shape (*shape, n)."""
        system = self.ensemble.H.compile("numpy")
        values = self.ensemble.own_parameters()
        if values is not None:
            values = values.reshape(*self.ensemble.shape, 1, -1)
        with np.errstate(all="ignore"):  # H may overflow at the last finite state before an escape
            arguments = system.arguments(self.z, self.t)
            return np.asarray(system.energy(*arguments, **system.keywords(values)))

    @cached_property
    def energy_drift(self) -> np.ndarray:
        """H(t) - H(start), less the work of forces and explicit time, shape (*shape, n).

        The work is the integral of ``H.power`` by splines through the saved states: save enough of
        them. Without forces and explicit time this is the change of H.

        Examples
        --------
        >>> H = Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p/5"})
        >>> trajectory = integrate(H, [1, 0], (0, 10), "gauss6", steps=1_000)
        >>> bool(np.abs(trajectory.energy_drift).max() < 1e-11)
        True
        """
        H, change = self.ensemble.H, self.energy - self.energy[..., :1]
        if H.conserves_energy:
            return change
        values = None
        if self.ensemble.varied:
            values = self.ensemble.parameters.reshape(*self.ensemble.shape, 1, -1)
        with np.errstate(all="ignore"):
            power = H.observable(H.power)(self.z, self.t, values)
        return change - work_of(self.t, power)

    # -- by name and by time ---------------------------------------------------------------------

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a component over the saved times, shape (*shape, n), as a view of ``z``.

        Raises
        ------
        InputError
            If no component has this name.

        Examples
        --------
        >>> trajectory = integrate("p**2/2 + x**2/2", [1, 0], (0, np.pi), tol=1e-9, saves=2)
        >>> trajectory["x"].round(8) + 0.0
        array([ 1.,  0., -1.])
        """
        if isinstance(name, str) and name in self.names:
            return self.z[..., self.names.index(name)]
        raise InputError(unknown(name, self.names, "a component of this trajectory"))

    def __iter__(self) -> NoReturn:
        raise TypeError("a Trajectory is not a sequence; iterate over its t, its z or its names")

    def __call__(self, t: Any) -> np.ndarray:
        """Interpolate the states at times t between the saved ones.

        On each interval between saved states this is the Hermite polynomial of degree 5 with the
        states, the rates and their derivatives at both ends, from the generated equations. Its
        error is h^6/46,080 max |d^6 z/dt^6|, with h the time between saved states. If H depends on
        time, it is the polynomial of degree 3 with states and rates, with the error
        h^4/384 max |d^4 z/dt^4|. The orders are lower where H is not smooth. This error comes on
        top of that of the saved states; :meth:`interpolation_error` estimates it. At saved times
        the states are those that were saved.

        Parameters
        ----------
        t : float, sequence or array

        Returns
        -------
        numpy.ndarray
            Shape (*shape, m, dim) for m times, (*shape, dim) for one. After the end of a member of
            an ensemble that stopped early, nan.

        Raises
        ------
        InputError
            If a time is outside the trajectory, or the saved states are so far apart that the
            estimated error of the interpolation is above 1 % of the size of a component.

        Examples
        --------
        >>> trajectory = integrate("p**2/2 + x**2/2", [1, 0], (0, 10), tol=1e-9)
        >>> bool(abs(trajectory(np.pi)[0] + 1) < 1e-9)
        True
        >>> trajectory([0.5, 1.5, 2.5]).shape
        (3, 2)
        """
        return self._interpolant.states(t)

    def interpolation_error(self, t: Any) -> np.ndarray:
        """Estimate the largest error of the interpolation between the saved states around t.

        From the defect dz/dt - f(z) of the polynomial, to leading order in the time between saved
        states; zero at saved times. In the units of the components, shaped as the states at t.

        Raises
        ------
        InputError
            If a time is outside the trajectory.

        Examples
        --------
        >>> trajectory = integrate("p**2/2 + x**2/2", [1, 0], (0, 10), tol=1e-9)
        >>> t = np.linspace(0, 10, 999)
        >>> true = np.stack((np.cos(t), -np.sin(t)), axis=-1)
        >>> largest = trajectory.interpolation_error(t).max()
        >>> bool(0.5 < np.abs(trajectory(t) - true).max() / largest < 1.5)
        True
        """
        return self._interpolant.errors(t)

    @cached_property
    def _interpolant(self) -> Interpolant:
        return Interpolant(self.t, self.z, self.ensemble)

    # -- tables and files ------------------------------------------------------------------------

    def to_dataframe(self) -> pandas.DataFrame:
        """Return the states as a table of pandas: times as index, components as columns.

        An ensemble has further levels of the index, ``member`` or ``axis_0``, ``axis_1``, ..., and
        a column for each parameter that varies. H, parameters, units and the method are in
        ``attrs``.

        Raises
        ------
        InputError
            If pandas is not installed.

        Examples
        --------
        >>> table = integrate("p**2/2 + x**2/2", [1, 0], (0, 1), "gauss4", steps=2).to_dataframe()
        >>> table.loc[0.5].round(4).to_dict()
        {'x': 0.8776, 'p': -0.4794}
        """
        shape, n = self.ensemble.shape, len(self.t)
        places = np.indices((*shape, n)).reshape(len(shape) + 1, -1)
        index = dict(zip(member_axes(shape), places[:-1], strict=True))
        index[time_name(self.names)] = self.t[places[-1]]
        columns = dict(zip(self.names, self.z.reshape(-1, len(self.names)).T, strict=True))
        members = np.repeat(np.arange(len(self.ensemble)), n)
        columns |= {name: values[members] for name, values in self.ensemble.columns.items()}
        return data_frame(columns, index, self._attributes)

    def to_xarray(self) -> xarray.Dataset:
        """Return states, energies, success and messages as a dataset of xarray.

        Its axes are ``time`` and ``component``, and of an ensemble ``member``, or ``axis_0``,
        ``axis_1``, ..., on which parameters that vary are coordinates. With ``tol`` it has
        ``errors`` too.

        Raises
        ------
        InputError
            If xarray is not installed.

        Examples
        --------
        >>> data = integrate("p**2/2 + x**2/2", [1, 0], (0, 1), "gauss4", steps=2).to_xarray()
        >>> round(float(data["state"].sel(time=0.5, component="x")), 4)
        0.8776
        """
        shape = self.ensemble.shape
        axes = member_axes(shape)
        states = [*axes, "time", "component"]
        success = np.array(np.broadcast_to(self.success, shape))
        variables = {
            "state": (states, self.z),
            "energy": ([*axes, "time"], self.energy),
            "success": (axes, success),
            "message": (axes, self.messages),
        }
        if self.errors is not None:
            variables["errors"] = (states, self.errors)
        varied = {name: (axes, own.reshape(shape)) for name, own in self.ensemble.columns.items()}
        return data_set(
            variables,
            {"time": self.t, "component": list(self.names), **varied},
            self._attributes,
        )

    @property
    def _attributes(self) -> dict[str, Any]:
        known = attributes_of(self.ensemble.H, self.ensemble.varied if self.ensemble.shape else ())
        return {**known, "method": self.method, "dt": self.dt, "steps": self.steps}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the trajectory to a file that :func:`hamsym.load` reads; see :func:`hamsym.save`.

        Raises
        ------
        FileError
            If the file cannot be written, or the trajectory is not valid.
        """
        hamsym.save(self, path)

    def plot(self, *names: Any, ax: Any = None) -> Figure:
        """Draw the trajectory or the ensemble: an overview, or what the names say.

        Without names: the components over time, coordinates beside momenta, one row for each of
        six degrees of freedom at most; the orbit or the plane of two coordinates, and a phase
        plane, of one degree of freedom with level sets of H; the energy error, less the work of
        forces and explicit time; with ``tol`` the estimated error. Of more than 200 trajectories
        200 are drawn, which the caption says.

        Parameters
        ----------
        *names : str
            One component: over time. Two: the paths in their plane, in one scale where both are
            lengths or of one kind else. Three: the paths in space. Or ``"energy"``, ``"error"``.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.

        Returns
        -------
        matplotlib.figure.Figure
            A figure that notebooks show; ``savefig`` writes .png, .svg and .pdf.

        Raises
        ------
        InputError
            If a name is unknown, or ``ax`` is given for an overview.

        Examples
        --------
        >>> trajectory = integrate("p**2/2 + x**2/2", [1, 0], (0, 6), dt=0.1)
        >>> trajectory.plot("x", "p").axes[0].get_ylabel()
        '$p$'
        """
        return hamsym.plot(self, *names, ax=ax)

    def animate(self, *names: str, **options: Any) -> hamsym.Animation:
        """Animate the motion, in a picture that names or options choose; :func:`hamsym.animate`."""
        return hamsym.animate(self, *names, **options)


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
    (:mod:`hamsym.integrators.tolerance`). A trajectory succeeds if the estimate, with round-off,
    is within the tolerance, H changes by no more than that allows, and the force has no pulse, pole
    or jump on the way that the steps do not resolve.

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
    the steps pass over, for example a short pulse, and that changes the motion by more than 1 %,
    or, where steps were chosen, by more than the drift that was reached.

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
        typical magnitude of the coordinates or of the momenta.
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
        If a step could not be solved, the states became non-finite or Ctrl-C was pressed,
        ``success`` is False, the message gives the reason, and the trajectory ends there.

    Warns
    -----
    StepSizeWarning
        If the automatic steps do not meet the target above, or if with a given method or number of
        steps H changes by more than 1 % of the energy exchanged or is not finite (not tested for
        time-dependent H), or a step is too long beside a pole of H (tested if every step is saved).
        The message contains the warning. With ``tol`` there is none: see ``success``.

    Raises
    ------
    InputError
        If an argument is invalid, the method needs a separable H and H is not separable, the
        result does not fit into memory, or the automatic number of steps exceeds its limit.

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
        return _to_tolerance(
            members, name, (start, end), tol, saves or 100, compensated, progress, known
        )
    if saves is not None:
        raise InputError("saves applies with tol; give save_every instead")
    chosen = method is None and steps is None and dt is None
    count = checked_steps(end - start, steps, dt)
    if save_every is not None:
        require_whole("save_every", save_every)
    every = save_every or 1
    if not chosen and count % every:
        raise InputError(f"save_every={every} does not divide steps={count}; give a divisor")
    scheme = INTEGRATORS[name].scheme
    if compensated and not isinstance(scheme, Splitting | RungeKutta):
        raise InputError(
            f"compensated applies to splitting and implicit Runge-Kutta methods, not to {name}; "
            "leave it out"
        )
    if omega is not None and not isinstance(scheme, Doubled):
        raise InputError(f"omega applies to tao2 and tao4, not to {name}; leave it out")
    choice: Choice[_Run] | None = None
    began = time.perf_counter()
    if isinstance(scheme, Adaptive):
        _require_memory(count // every, H.dim, len(members))
        times = np.linspace(start, end, count // every + 1)
        run = _run_adaptive(members, scheme, times, _tolerances(rtol, atol))
    else:
        for option, value in (("rtol", rtol), ("atol", atol)):
            if value is not None:
                raise InputError(
                    f"{option} applies to adaptive methods, not to {name}; give steps or dt instead"
                )
        options: dict[str, Any] = {
            "compensated": compensated,
            "omega": omega,
            "progress": progress,
        }
        if chosen:
            choice = choose_steps(members, name, (start, end), save_every, **options)
            run, count = choice.attempt, choice.steps
        else:
            run = _stepped(members, name, (start, end), count, every, **options)
    seconds = time.perf_counter() - began
    z, times, problem = _cut_at_end(run.z, run.times, run.problem)
    drift = _drift(members, z, count)
    message = f"{name}: {count:,} steps to t = {end:.6g}"
    found, warning = _describe_accuracy(H, drift, choice)
    if found:
        message = f"{message}, {found}"
    drifts, changed = _invariant_drifts(members, known, z, times)
    if changed and not warning:
        warning = (
            f"the invariant {changed} changes by more than errors of 1 % explain; take more steps"
        )
    unseen = ""
    if not (problem or warning or isinstance(scheme, Adaptive)):
        share = COARSE if choice is None else max(AIM, min(choice.found, COARSE))
        unseen = _between_steps(members, name, z, times, count, share, omega)
    tested = not (chosen or every > 1 or problem or warning)
    if tested and (pole := _pole(members, z, times)) is not None:
        warning = (
            f"the step near t = {pole:.6g} passes a pole of H, or the end of its domain, too fast; "
            "take more steps"
        )
    if warning and not problem:
        message = f"{message}: {warning}"
        warnings.warn(message, StepSizeWarning, stacklevel=3)
    problem = problem or unseen
    return Trajectory(
        t=times,
        z=z.reshape(*members.shape, *z.shape[1:]),
        names=H.names,
        method=name,
        steps=count,
        dt=(end - start) / count,
        evaluations=run.evaluations,
        seconds=seconds,
        success=not problem,
        message=problem or message,
        ensemble=members,
        interrupted=run.interrupted,
        drift=drift,
        invariant_drift=drifts,
    )


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


def _to_tolerance(
    members: Ensemble,
    name: str,
    span: tuple[float, float],
    tol: float,
    saves: int,
    compensated: bool,
    progress: bool | None,
    known: KnownInvariants,
) -> Trajectory:
    _require_memory(2 * saves, members.H.dim, len(members))  # states and error estimates
    began = time.perf_counter()
    found = ToleranceSearch(members, name, span, tol, saves, compensated).run(progress)
    found.tol = tol
    drifts, _ = _invariant_drifts(
        members, known, found.z, np.linspace(*span, saves + 1), found, tol
    )
    seconds = time.perf_counter() - began
    shape, z, errors, times = (
        members.shape,
        found.z,
        found.errors,
        np.linspace(*span, saves + 1),
    )
    if not shape:
        end = max(int(np.isfinite(z[0]).all(axis=-1).sum()), 1)
        z, errors, times = z[:, :end], errors[:, :end], times[:end]
        message = _verdict(found, 0, name, span[1])
    else:
        message = _summary(found, name, span[1])
    steps = int(found.steps.max())
    return Trajectory(
        t=times,
        z=z.reshape(*shape, *z.shape[1:]),
        names=members.H.names,
        method=name,
        steps=steps,
        dt=(span[1] - span[0]) / max(steps, 1),
        evaluations=found.evaluations,
        seconds=seconds,
        success=found.success.reshape(shape) if shape else bool(found.success[0]),
        message=message,
        ensemble=members,
        interrupted=found.interrupted,
        errors=errors.reshape(*shape, *errors.shape[1:]),
        verdicts=found,
        invariant_drift=drifts,
    )


def _invariant_drifts(
    members: Ensemble,
    known: KnownInvariants,
    z: np.ndarray,
    times: np.ndarray,
    found: Tolerated | None = None,
    tol: float = COARSE,
) -> tuple[dict[str, Any], str]:
    """Return largest changes of invariants, and the first that ``tol`` does not explain.

    Trajectories of ``found`` that drift more than that fail.
    """
    drifts = {name: np.zeros(len(members)) for name in known.formulas}
    first = ""
    for index in range(len(members) if known else 0):
        path = z[index][np.isfinite(z[index]).all(axis=-1)]
        if not len(path):
            continue
        allowed = tol * np.abs(path).max(axis=0)
        if found is not None:  # zero components have larger tolerances
            errors = found.errors[index, : len(path)]
            allowed = np.maximum(allowed, np.where(np.isfinite(errors), errors, 0).max(axis=0))
        own = members.own_parameters([index])
        change, explained = known.drifts(path[:1], times[0], path, times[: len(path)], allowed, own)
        for name, largest in known.largest(change).items():
            drifts[name][index] = largest
        if reason := known.verdict(change, explained):
            first = first or known.formulas[int(np.argmin((change <= explained).all(axis=1)))]
            if found is not None and found.success[index]:
                found.success[index] = False
                found.problems[index] = reason
    shape = members.shape
    return {n: own.reshape(shape) if shape else float(own[0]) for n, own in drifts.items()}, first


def _verdict(found: Tolerated, index: int, name: str, end: float) -> str:
    """Describe the outcome of one trajectory."""
    if index in found.problems:
        return found.problems[index]
    return (
        f"{name}: {found.steps[index]:,} steps to t = {end:.6g}, estimated error "
        f"{found.largest[index]:.1e}"
    )


def _summary(found: Tolerated, name: str, end: float) -> str:
    """Describe the outcome of an ensemble."""
    count, failed = len(found.success), sorted(found.problems)
    if failed:
        return (
            f"{len(failed):,} of {count:,} trajectories failed, number {failed[0]:,} first: "
            f"{found.problems[failed[0]]}"
        )
    least, most = int(found.steps.min()), int(found.steps.max())
    return (
        f"{name}: {count:,} trajectories, {least:,} to {most:,} steps to t = {end:.6g}, estimated "
        f"error at most {found.largest.max():.1e}"
    )


def _pole(members: Ensemble, z: np.ndarray, times: np.ndarray) -> float | None:
    """Time of the first step too long beside a pole of H, from the states after every step."""
    features = narrow_features(members.H)
    if features is None or z.size > _MAX_SAVED_COMPONENTS or z.shape[1] < 3:
        return None
    return features.pole(z, times, members.own_parameters())


def _between_steps(
    members: Ensemble,
    name: str,
    z: np.ndarray,
    times: np.ndarray,
    steps: int,
    share: float,
    omega: float | None,
) -> str:
    """Describe the first feature of the force between the steps that matters, or return "".

    - z, times: Saved states and their times.
    - steps: Of the whole trajectories, the same number between two saved states.
    - share: Of the sizes of the components, that such features may change.
    """
    features = hidden_features(members.H)
    if features is None:
        return ""
    values = members.own_parameters()

    def allowed(index: int) -> np.ndarray:
        return share * features.sizes(z[index], times, None if values is None else values[index])

    for path, t in _every_step(members, name, z, times, steps, omega):
        part = (len(t) - 1) / steps
        found = features.search(path, t, values, allowed, part).times
        if not np.isnan(found).all():
            index = int(np.nanargmin(np.abs(found - times[0])))
            which = f"trajectory {index}: " if members.shape else ""
            return which + passed_over(found[index])
    return ""


def _every_step(
    members: Ensemble,
    name: str,
    z: np.ndarray,
    times: np.ndarray,
    steps: int,
    omega: float | None,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the states after every step and their times, in parts of the span.

    Steps between saved states are repeated from each of them.
    """
    saves = len(times) - 1
    every, size = steps // saves, (times[-1] - times[0]) / steps
    together = max(1, _MAX_SAVED_COMPONENTS // (every * members.states.size))
    for first in range(0, saves, together):
        last = min(first + together, saves)
        t = times[0] + size * np.arange(first * every, last * every + 1)
        if every == 1:
            yield z[:, first : last + 1], t
            continue
        count, between = len(members), last - first
        stepper = fixed_step(
            members.H,
            name,
            z[:, first:last].reshape(count * between, -1),
            np.tile(times[first:last], count),
            np.full(count * between, size),
            omega=omega,
            parameters=np.repeat(members.parameters, between, axis=0),
        )
        path = stepper.advance(every, show=False).path[:, :-1].reshape(count, between * every, -1)
        yield np.concatenate((path, z[:, last : last + 1]), axis=1), t


def _drift(members: Ensemble, z: np.ndarray, steps: int) -> float:
    """Compute the largest drift of H at the saved states, or at a sample of them."""
    if z.shape[1] > _MAX_TESTED:
        z = z[:, np.linspace(0, z.shape[1] - 1, _MAX_TESTED).astype(int)]
    kept = EnergyDrift(members.H, len(members), members.own_parameters())
    kept.add(z)
    return float(kept.relative(steps).max())


def _describe_accuracy(
    H: Hamiltonian, drift: float, choice: Choice[_Run] | None
) -> tuple[str, str]:
    """Describe the accuracy of the steps, with a warning or ""."""
    if H.conserves_energy:
        kept = "kept to round-off" if drift == 0 else f"kept to {drift:.1e} of its scale"
        said = f"H {kept}" if math.isfinite(drift) else "H is not finite on the trajectory"
        fine = drift <= COARSE
    elif choice is not None:
        said = f"halving the steps changes the motion by {choice.found:.1e} of its range"
        fine = True
    else:
        return "", ""
    if choice is None:
        return said, "" if fine else "take more steps"
    if choice.met and fine:
        return said, ""
    return said, (
        f"the target of {AIM:.0e} is not met; use an earlier end time, before a close encounter, "
        "or give a method and steps"
    )


@dataclass(frozen=True)
class _Run(Attempt):
    """Result of a method, with the reason for an early stop, or ""."""

    evaluations: int
    problem: str


def choose_steps(
    members: Ensemble,
    name: str,
    span: tuple[float, float],
    save_every: int | None = None,
    **options: Any,
) -> Choice[_Run]:
    """Choose the number of steps with which all trajectories conserve H, by :func:`choose`."""
    evaluations = 0

    def run(steps: int) -> _Run:
        nonlocal evaluations
        saves = steps if save_every is None else steps // save_every
        while save_every is None and saves > _MIN_STEPS:
            if saves <= _MAX_SAVED and saves * members.states.size <= _MAX_SAVED_COMPONENTS:
                break
            saves //= 2
        found = _stepped(members, name, span, steps, steps // saves, **options)
        evaluations += found.evaluations
        return replace(found, evaluations=evaluations)

    each = save_every or 1
    fewest = each * math.ceil(_MIN_STEPS / each)
    scheme = INTEGRATORS[name].scheme
    assert not isinstance(scheme, Adaptive)
    return choose(members.H, scheme, members.states, span, run, fewest, members.own_parameters())


def _stepped(
    members: Ensemble,
    name: str,
    span: tuple[float, float],
    steps: int,
    save_every: int,
    *,
    compensated: bool = False,
    omega: float | None = None,
    progress: bool | None = None,
) -> _Run:
    saves, (start, end), count = steps // save_every, span, len(members)
    _require_memory(saves, members.H.dim, count)
    stepper = fixed_step(
        members.H,
        name,
        members.states,
        np.full(count, start),
        np.full(count, (end - start) / steps),
        compensated=compensated,
        omega=omega,
        parameters=members.parameters,
    )
    done = stepper.advance(saves, save_every, show=progress)
    problem = ""
    if done.interrupted:
        problem = _INTERRUPTED
    elif stepper.is_implicit and done.steps.min() < steps:
        problem = "the implicit step could not be solved; take more steps"
    times = np.linspace(start, end, saves + 1)
    return _Run(times, done.path, done.interrupted, done.evaluations, problem)


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
    parameters: np.ndarray | None = None,
) -> Stepper:
    """Make a fixed-step integrator; see :class:`hamsym.integrators.fixed_step.Stepper`.

    Without parameters every trajectory has the values of H.

    Raise InputError if the method is unknown, adaptive, or does not apply to this H.
    """
    name = usable_method(H, method)
    scheme = INTEGRATORS[name].scheme
    if isinstance(scheme, Adaptive):
        fixed = ", ".join(key for key, row in INTEGRATORS.items() if not row.adaptive)
        raise InputError(f"{method} is adaptive; give a method with fixed steps: {fixed}")
    if omega is None:
        omega = _coupling(H, states, starts, parameters) if isinstance(scheme, Doubled) else 0.0
    require_number("omega", omega, 0)
    if parameters is None:
        values = [H.parameters[name] for name in H.parameter_names]
        parameters = np.tile(np.array(values, dtype=float), (len(states), 1))
    return Stepper(
        H,
        scheme,
        name,
        states,
        starts,
        sizes,
        parameters,
        compensated=compensated,
        tangents=tangents,
        omega=omega,
    )


def usable_method(H: Hamiltonian, method: str) -> str:
    """Resolve aliases of a method and check that it applies to this H.

    Raise InputError if the table has no such method. Raise SeparabilityError if it is a splitting
    method, and H is not separable or a force depends on momenta.
    """
    name = ALIASES.get(method, method) if isinstance(method, str) else ""
    if name not in INTEGRATORS:
        hint = did_you_mean(method, [*INTEGRATORS, *ALIASES])
        raise InputError(
            f"'{method}' is not a method{hint}; choose one of {', '.join(INTEGRATORS)}"
        )
    split = isinstance(INTEGRATORS[name].scheme, Splitting) and name not in NOT_ONLY_SEPARABLE
    if H.forces:
        _require_general(H, name, method)
    if split and not H.is_separable:
        raise SeparabilityError(
            f"{method} needs H = T(p) + V(q), and this H is not separable; choose a method for any "
            "H: gauss4, implicit_midpoint or tao4"
        )
    return name


def _require_general(H: Hamiltonian, name: str, method: str) -> None:
    """Refuse a method whose steps solve other equations than those with forces."""
    scheme = INTEGRATORS[name].scheme
    if isinstance(scheme, Doubled):
        raise InputError(
            f"{method} steps in a doubled phase space, which forces beyond H do not have; choose "
            "gauss4, gauss6 or dop853"
        )
    if isinstance(scheme, Splitting) and not H.is_separable:
        raise SeparabilityError(
            f"{method} alternates steps of q at constant p and of p at constant q, which needs H = "
            "T(p) + V(q) and forces without momenta; choose gauss4, gauss6 or dop853"
        )


def usual_method(H: Hamiltonian) -> str:
    """Name of the default method: a splitting if the equations are separable, else Gauss."""
    return "blanes_moan6" if H.is_separable else "gauss6"


def _run_adaptive(
    members: Ensemble,
    scheme: Adaptive,
    times: np.ndarray,
    tolerances: tuple[float, float | None],
) -> _Run:
    z = np.full((len(members), len(times), members.H.dim), np.nan)
    z[:, 0] = members.states
    evaluations, message = 0, ""
    for i, state in enumerate(members.states):
        try:
            states, count, problem = scheme.run(members.hamiltonian(i), state, times, *tolerances)
        except KeyboardInterrupt:
            return _Run(times, z, True, evaluations, _INTERRUPTED)
        z[i, : len(states)] = states
        evaluations += count
        message = message or problem
    return _Run(times, z, False, evaluations, message)


def _cut_at_end(
    z: np.ndarray, times: np.ndarray, message: str
) -> tuple[np.ndarray, np.ndarray, str]:
    """Cut trajectories where the longest of them ends, and complete the message."""
    # A component that is not finite stays so in every method.
    if not message and np.isfinite(z[:, -1]).all():
        return z, times, message
    finite = np.logical_and.accumulate(np.isfinite(z).all(axis=-1), axis=1)
    z[~finite] = np.nan
    counts = finite.sum(axis=1)
    if counts.min() < len(times):
        message = message or "the state is no longer finite"
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


def fastest_rate(
    H: Hamiltonian,
    states: np.ndarray,
    times: np.ndarray | float,
    parameters: np.ndarray | None = None,
) -> float:
    """Largest spectral radius of J Hess at states of shape (n, dim), per unit of time.

    Infinite where the Hessian is not finite. Without parameters, shape (n, k), those of H are used.
    """
    system = H.compile("numpy")
    with np.errstate(all="ignore"):
        arguments = system.arguments(states, times)
        matrices = system.jacobian(*arguments, **system.keywords(parameters))
    if not np.isfinite(matrices).all():
        return math.inf
    return float(np.abs(np.linalg.eigvals(matrices)).max())


def _coupling(
    H: Hamiltonian, states: np.ndarray, starts: np.ndarray, parameters: np.ndarray | None
) -> float:
    rate = fastest_rate(H, states, starts, parameters)
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
    # The states and, on request, their energies.
    wanted = (saves + 1) * (dim + 1) * 8 * batch
    try:
        there = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # not available on every system
        return
    if wanted > there // 2:
        states = f"{saves:,} states" + (f" of {batch:,} trajectories" if batch > 1 else "")
        raise InputError(
            f"{states} need {wanted / 2**30:.1f} GiB, more than half of the memory of "
            f"{there / 2**30:.1f} GiB; save fewer with a larger save_every"
        )
