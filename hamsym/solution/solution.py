"""Solution: a trajectory as a function of time, with its residual, energy and error."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, overload

import numpy as np

import hamsym
from hamsym.errors import ParameterError, VacuousBoundWarning
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.scales import SMALLEST, coupled_sizes, ratios, resolved_sizes
from hamsym.problems.description import attributes_of
from hamsym.problems.observed import dataset_of_states, observed
from hamsym.solution.analysis import Analysis
from hamsym.solution.digest import Definition
from hamsym.solution.discontinuities import parameter_jump
from hamsym.solution.error_equation import integrated_error
from hamsym.solution.events import Event, Events, find_events
from hamsym.solution.parameters import ParameterForcing, parameter_names
from hamsym.solution.path import ERRORS, RECORDS, TRIALS, ErrorEstimate, Record, Trial
from hamsym.solution.sensitivity import Sensitivity
from hamsym.solution.settings import Settings
from hamsym.solution.times import evaluate_in_parts, is_tensor, tensor_of, times_in_span
from hamsym.solution.work import Work
from hamsym.support.record_fields import UNSAVED, Size, floats
from hamsym.support.shown import Saved
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.tables import data_frame, time_name
from hamsym.support.validation import checked_numbers

if TYPE_CHECKING:  # torch and matplotlib are imported only where they are used
    import pandas
    import sympy
    import xarray
    from matplotlib.figure import Figure
    from torch import Tensor

_SCAN = 4_001  # times of the scan that precedes the search for an extremum over time


@suggest_attributes
@dataclass(frozen=True, eq=False, repr=False)
class Solution(Saved):
    """A closed-form trajectory z^(t) over a time span, from :func:`hamsym.solve`.

    Call it with times to get states: shape (n,) gives (n, dim), a scalar gives (dim,); numpy in,
    numpy out, torch in, torch out (differentiable in t).

    Attributes
    ----------
    H : Hamiltonian
    z0 : numpy.ndarray
        Initial state, shape (dim,), reproduced exactly.
    span : (float, float)
    trial : FeatureTrial, Chain or TrialSolution
        The trial solution with its weights.
    method : str
    record : March, ChainTraining or Training
        Course and cost of the search for the weights.
    settings : Settings
        Tolerance, seed, span and options with which it was solved.
    error : WindowError or None
        Estimated error of a march or a chain of networks; None for one network that was trained
        jointly, whose error is integrated on first use.
    energy_weight : float
        Weight of the energy penalty in the loss of a network.
    success : bool
        Whether the estimated error, round-off included, is within the tolerance.
    message : str
        Outcome of the method.
    certificate : Certificate or None
        Proof that errors are within the tolerance, with ``prove=True``; not part of files.
    invariant_drift : mapping of str to float
        Largest change of each of the ``invariants`` that were given, by its formula; not part of
        files.
    """

    H: Hamiltonian
    z0: Annotated[np.ndarray, floats("dim")]
    span: tuple[float, float]
    trial: Annotated[Trial, TRIALS]
    method: str
    record: Annotated[Record, RECORDS]
    settings: Settings
    error: Annotated[ErrorEstimate, ERRORS] | None = None
    energy_weight: Size = 0.0
    success: bool = False
    message: str = ""
    certificate: hamsym.Certificate | None = field(default=None, metadata=UNSAVED)
    invariant_drift: Mapping[str, float] = field(default_factory=dict, metadata=UNSAVED)

    def __repr__(self) -> str:
        start, end = self.span
        return (
            f"Solution({self.H.formulas!r}, t from {start:.6g} to {end:.6g}, {self.method}, "
            f"success={self.success})"
        )

    def check(self) -> None:
        """Raise ValueError unless its parts belong together."""
        Definition.of(self).check()
        self.record.require_trial(self.trial)
        if self.error is not None:
            self.error.require_trial(self.trial)
        if not self.success:
            return
        if self.error is not None:
            self.error.require_finite()
            if not (self.error.largest <= self.allowed_error).all():
                raise ValueError("its success is true, but its error is larger than allowed")
        elif self.record.edges is not None:
            raise ValueError("its error estimate is missing")
        for name, value in vars(self.record).items():
            if isinstance(value, float) and not math.isfinite(value):
                raise ValueError(f"its success is true, but its {name} is not finite")

    def __reduce__(self) -> tuple[Any, ...]:
        # Cached properties may contain functions, which cannot be pickled.
        return Solution, tuple(getattr(self, entry.name) for entry in fields(self))

    def judged(self, success: bool, message: str) -> Solution:
        """Return the same solution with a verdict; cached properties are kept."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__, success=success, message=message)
        return other

    @property
    def points(self) -> int:
        """Collocation points K."""
        return self.record.points

    @property
    def evaluations(self) -> int:
        """Evaluations of the vector field in the search, each at one point."""
        return self.record.point_evaluations

    @property
    def seconds(self) -> float:
        """Wall time of the search; of a march that of the last one."""
        return self.record.seconds

    @property
    def history(self) -> Any:
        """Loss and ell_max during the training, or the windows of a march."""
        return self.record.history

    @cached_property
    def allowed_error(self) -> np.ndarray:
        """Error that the tolerance allows each component, shape (dim,).

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve("p**2/2 + 2*x**2", [1, 0], (0, 5), tol=1e-6)
        >>> solution.allowed_error.round(8)
        array([1.e-06, 2.e-06])
        """
        if self.error is not None:
            return self.settings.allowed(self.error.scale)
        return self.settings.allowed(resolved_sizes(self.scale, *self._coupling))

    # -- evaluation --------------------------------------------------------------------------

    @overload
    def __call__(self, t: Tensor, *, extrapolate: bool = False) -> Tensor: ...
    @overload
    def __call__(self, t: Any, *, extrapolate: bool = False) -> np.ndarray: ...
    def __call__(self, t: Any, *, extrapolate: bool = False) -> Any:
        """Return the state at times t.

        Parameters
        ----------
        t : float, sequence, array or Tensor
        extrapolate : bool
            Allow times outside the span.

        Raises
        ------
        InputError
            If a time is outside the span, unless ``extrapolate=True``.
        """
        if is_tensor(t):
            return self.evaluate(t, extrapolate=extrapolate)[0]
        times = times_in_span(t, self.span, extrapolate=extrapolate)
        return evaluate_in_parts(lambda part: (self.trial.states_at(part),), times)[0]

    @overload
    def derivative(self, t: Tensor, *, extrapolate: bool = False) -> Tensor: ...
    @overload
    def derivative(self, t: Any, *, extrapolate: bool = False) -> np.ndarray: ...
    def derivative(self, t: Any, *, extrapolate: bool = False) -> Any:
        """Return dz^/dt at times t, exact for the network; shapes as for the state."""
        return self.evaluate(t, extrapolate=extrapolate)[1]

    @overload
    def sensitivity(
        self, t: Tensor, parameters: Sequence[str | sympy.Symbol] | None = None
    ) -> Tensor: ...
    @overload
    def sensitivity(
        self, t: Any, parameters: Sequence[str | sympy.Symbol] | None = None
    ) -> np.ndarray: ...
    def sensitivity(self, t: Any, parameters: Sequence[str | sympy.Symbol] | None = None) -> Any:
        """Return the derivative of the state in the initial state, or in parameters.

        Without ``parameters`` dz(t)/dz0, shape (n, dim, dim), or (dim, dim) for a scalar t: the
        solution Phi of Phi' = J Hess(z^(t)) Phi with Phi = 1 at the start.

        With ``parameters`` dz(t)/dk for each of them, in their units, shape (n, dim, parameters)
        or (dim, parameters): the solutions of w' = J Hess(z^(t)) w + J d(grad H)/dk with w = 0 at
        the start. The initial state and the span do not depend on the parameters.

        Both are NaN from the time on at which these equations have no solution, or vary too fast
        to be solved.

        Parameters
        ----------
        t : float, sequence, array or Tensor
        parameters : sequence of str, optional
            Names of parameters of H.

        Raises
        ------
        InputError
            If a time is outside the span, or no parameter is named.
        ParameterError
            If a parameter is unknown, the force has no derivative in it, or the force jumps along
            the trajectory.

        Examples
        --------
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("p**2/2 + k*x**2/2", parameters={"k": 1.0})
        >>> solution = hamsym.solve(H, [1, 0], (0, 5))
        >>> solution.sensitivity(np.pi / 2).round(8) + 0.0
        array([[ 0.,  1.],
               [-1.,  0.]])
        >>> solution.sensitivity(np.pi, parameters=["k"]).round(8) + 0.0
        array([[0.        ],
               [1.57079633]])
        """
        times = times_in_span(t, self.span)
        names = None if parameters is None else parameter_names(self.H, parameters)
        values = self._sensitivity_in(names)(np.atleast_1d(times))
        values = values.reshape(*times.shape, self.H.dim, -1)
        return tensor_of(values) if is_tensor(t) else values

    def _sensitivity_in(self, names: tuple[str, ...] | None) -> Sensitivity:
        """Return the derivatives in the initial state, or in parameters."""
        if names not in self._sensitivities:
            forcing = None
            if names is not None:
                if reason := parameter_jump(self, names):
                    raise ParameterError(reason)
                forcing = ParameterForcing(self.H, names)
            self._sensitivities[names] = Sensitivity(
                self, self._units, self.record.edges, self.record.origin, forcing
            )
        return self._sensitivities[names]

    @cached_property
    def _sensitivities(self) -> dict[tuple[str, ...] | None, Sensitivity]:
        return {}

    @cached_property
    def _units(self) -> np.ndarray:
        """Size of each component, in units of its own, shape (dim,)."""
        units = np.maximum(self.scale, SMALLEST * self._coupled_scales)
        return np.where(units > 0, units, 1.0)

    def residual(self, t: Any, *, extrapolate: bool = False) -> Any:
        """Return ell(t) = dz^/dt - J grad H(z^), shaped as the state: eq. (partial_loss).

        Forces are subtracted too.
        """
        z, dz = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch" if is_tensor(t) else "numpy")
        return system.residual(z, *system.arguments(dz, t))

    def energy(self, t: Any, *, extrapolate: bool = False) -> Any:
        """Return H along the trajectory; shape (n,), or a scalar for a scalar t."""
        z, _ = self.evaluate(t, extrapolate=extrapolate)
        system = self.H.compile("torch" if is_tensor(t) else "numpy")
        return system.energy(*system.arguments(z, t))

    def work(self, t: Any) -> Any:
        """Return the energy that the trajectory has gained since the start, by its power.

        The integral of ``H.power``, F . dH/dp + (partial H)/(partial t), along z^ from the start to
        t, in the units of H. It is the work of the forces if H does not depend on time. A jump of H
        at a time is left out.

        Parameters
        ----------
        t : float, sequence or array

        Returns
        -------
        numpy.ndarray or float
            Shape (n,), or a scalar for a scalar t.

        Raises
        ------
        InputError
            If a time is outside the span.

        Examples
        --------
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("p**2/2", forces={"p": "-p"}, q=["x"], p=["p"])
        >>> solution = hamsym.solve(H, [0, 1], (0, 5))
        >>> float(np.round(solution.work(5.0), 9)), float(np.round(np.exp(-10) / 2 - 0.5, 9))
        (-0.4999773, -0.4999773)
        """
        times = times_in_span(t, self.span)
        return self._work(np.atleast_1d(times)).reshape(times.shape)[()]

    def energy_drift(self, t: Any) -> Any:
        """Return H(t) - H(start) - work(t), zero for an exact trajectory if H has no jump in time.

        Without forces and explicit time it is the change of H. Shapes and errors as for
        :meth:`work`.
        """
        start = float(self.energy(self.span[0]))
        change = self.energy(checked_numbers("t", t)) - start
        return change if self.H.conserves_energy else change - self.work(t)

    @cached_property
    def _work(self) -> Work:
        return Work(self, self.record.edges, self.record.origin)

    def evaluate(self, t: Any, *, extrapolate: bool = False) -> tuple[Any, Any]:
        """Return the state and its time derivative; shapes as for the state."""
        times = times_in_span(t, self.span, extrapolate=extrapolate)
        if is_tensor(t):
            z, dz = self.trial.tensors(t.reshape(-1))
            return z.reshape(*t.shape, -1), dz.reshape(*t.shape, -1)
        states, rates = evaluate_in_parts(self.trial.states_and_rates, times)
        return states, rates

    # -- accuracy ------------------------------------------------------------------------------

    @cached_property
    def scale(self) -> np.ndarray:
        """s_i = max_t |z^_i(t)| of each component, shape (dim,)."""
        return np.abs(self(self.scan_times)).max(axis=0)

    @cached_property
    def analysis(self) -> Analysis:
        """The paper's error analysis: ell(t), sigma_min, det Hess and the bounds from them."""
        return Analysis(self)

    @property
    def ell_max(self) -> float:
        """max_t |ell(t)|, the 2-norm, over continuous time and without the energy term."""
        return self.analysis.ell_max

    @property
    def ell_max_regularized(self) -> float:
        """The paper's ell_max with its energy term, sqrt(max_t |ell|^2 + lambda (H - E0)^2)."""
        return self.analysis.ell_max_regularized

    @property
    def sigma_min(self) -> float:
        """Smallest singular value of the Hessian along the trajectory; zero if it is singular.

        With forces it is nan: the equation of the error then has another matrix.
        """
        return self.analysis.sigma_min

    @overload
    def error_estimate(self, t: Tensor) -> Tensor: ...
    @overload
    def error_estimate(self, t: Any) -> np.ndarray: ...
    def error_estimate(self, t: Any) -> Any:
        """Return the estimated error z - z^ at times t; shapes as for the state.

        For a trained network, DOP853 solves the equation of the error that the paper's eq. (ell)
        linearises, d(dz)/dt = J grad H(z^ + dz) - dz^/dt from dz = 0; the estimate is infinite
        beyond the end of its solution. For a march, eq. (ell) is solved window by window
        (:mod:`hamsym.random_features.error_estimate`). It is an estimate, not a bound.
        """
        values = (self.error or self._integrated_error)(times_in_span(t, self.span))
        return tensor_of(values) if is_tensor(t) else values

    def error_estimate_check(self, t: Any) -> np.ndarray:
        """Return the change of the estimate at a finer resolution, at times t, shape (n, dim).

        For a march, more nodes sample the residual and resolve the equation of the error;
        for a trained network the equation of the error is solved to a thousandth of the tolerance.
        A change that is large relative to the estimate shows that the estimate is not resolved. It
        is infinite where either estimate is, and excludes the round-off floor of a march.

        Examples
        --------
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("p**2/2 + x**2/2")
        >>> solution, t = hamsym.solve(H, [1, 0], (0, 10), tol=1e-4), np.linspace(0, 10, 101)
        >>> estimate, check = solution.error_estimate(t), solution.error_estimate_check(t)
        >>> bool(check.max() < 0.01 * np.abs(estimate).max())
        True
        """
        times = times_in_span(t, self.span)
        with np.errstate(invalid="ignore"):
            change = np.abs(self._finer_estimate(times) - self.error_estimate(times))
        return np.nan_to_num(change, nan=np.inf, posinf=np.inf)

    @cached_property
    def _finer_estimate(self) -> Callable[[np.ndarray], np.ndarray]:
        if self.error is not None:
            return self.error.refined(self)
        return integrated_error(self, resolution=1)

    @cached_property
    def largest_error(self) -> np.ndarray:
        """max_t of the estimated error of each component, round-off included, shape (dim,)."""
        if self.error is not None:
            return self.error.largest
        return np.asarray(np.abs(self.error_estimate(self.scan_times)).max(axis=0))

    @property
    def relative_error(self) -> float:
        """Largest estimated error, relative to the size of the motion, max_i |dz_i| / s_i.

        Here s_i is the largest |z^_i|, or the coupled size of the component
        (:func:`~hamsym.numerics.scales.coupled_sizes`) where that is larger. Infinite where the
        error is unknown.
        """
        return float(ratios(self.largest_error, self._coupled_scales).max())

    @cached_property
    def _coupled_scales(self) -> np.ndarray:
        return coupled_sizes(self.scale, *self._coupling)

    @cached_property
    def _coupling(self) -> tuple[np.ndarray, float]:
        """Mean sizes of the derivatives of the equations, shape (dim, dim), and their time."""
        start, end = self.span
        with np.errstate(all="ignore"):
            coupling = np.abs(self.jacobians(self.scan_times)).mean(axis=0)
        # A short span has the scales of a span ten times as long.
        return coupling, 10 * abs(end - start)

    @cached_property
    def _integrated_error(self) -> Callable[[np.ndarray], np.ndarray]:
        return integrated_error(self)

    @property
    def error_bound(self) -> float:
        """The paper's bound ell_max / sigma_min on every component of the error (eq. dz).

        It is a heuristic: it assumes an error in one component only, is violated by a residual in
        resonance with the motion, and mixes the units of q and p. It is infinite, with a
        :class:`~hamsym.errors.VacuousBoundWarning`, where the Hessian is singular along the
        trajectory, for example in every system with a cyclic coordinate, and with forces: it rests
        on the symmetry of the Hessian.
        """
        if self.sigma_min > 0:
            return self.analysis.bound
        warnings.warn(
            self.analysis.vacuous,
            VacuousBoundWarning,
            stacklevel=2,
        )
        return math.inf

    def hessians(self, t: np.ndarray) -> np.ndarray:
        """Return the Hessian of H along the trajectory, shape (*t.shape, dim, dim)."""
        return self.H.compile("numpy").at("hessian", self(t), t)

    def jacobians(self, t: np.ndarray) -> np.ndarray:
        """Return the derivatives of the rates along the trajectory, J Hess without forces.

        Shape (*t.shape, dim, dim).
        """
        return self.H.compile("numpy").at("jacobian", self(t), t)

    @cached_property
    def scan_times(self) -> np.ndarray:
        """Times dense enough to resolve the motion: thousands, more with more windows."""
        return self.record.times(self.span, _SCAN)

    def events(self, events: Event | Sequence[Event]) -> Events:
        """Return times and states of events, located to round-off.

        Parameters
        ----------
        events : str, sympy.Expr, sympy.Eq, callable, or a sequence of them
            A surface between any formulas in the names of H, for example ``"x = 0, p_x > 0"`` or
            ``"p_x**2/2 = 1"``; a sympy expression, zero at the event; or a function in the form of
            scipy's ``solve_ivp``: called with (t, z), z of shape (dim,), it is zero at the event;
            its attribute ``direction`` selects rising (above zero) or falling zeros, and
            ``terminal`` (True or a number) ends the search for all events after this number of
            zeros. Unlike there, a zero at the very start is not an event.

        Every change of sign of a smooth formula is found, however narrow, because the formula is
        bounded between two neighbouring ``scan_times`` (thousands, and at least nine in every
        window of a march). Of functions, and of formulas with ``abs`` and the like, a pair of zeros
        between them is missed if they turn around more than once, and so is a third zero.

        Returns
        -------
        Events
            With ``t_events`` and ``y_events``, a list with an array for each event.

        Warns
        -----
        EventWarning
            If a formula comes to zero within round-off without a change of sign, or varies too fast
            for all of its zeros to be found.

        Raises
        ------
        InputError
            If an event cannot be used, or is NaN somewhere.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 10))
        >>> (solution.events("x = 0, p > 0").t_events[0] / np.pi).round(9)
        array([1.5])
        """
        return find_events(self, events, self.scan_times)

    def frequencies(self, *signals: Any, count: int = 6) -> hamsym.Frequencies:
        """Find the frequencies of the solution; see :func:`hamsym.frequencies`.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve("p**2/2 + 2*x**2", [1, 0], (0, 100))
        >>> solution.frequencies("x").frequency[0, :1].round(6)
        array([2.])
        """
        return hamsym.frequencies(self, *signals, count=count)

    def to_dataframe(self, t: Any, *names: Any) -> pandas.DataFrame:
        """Return states at times t as a table of pandas: times as index, components as columns.

        H, parameters, units and the method are in ``attrs``.

        Parameters
        ----------
        t : sequence or array
            Times, shape (n,); a scalar counts as one time.
        *names : str or sympy.Expr
            Components or formulas in the names of H (:meth:`hamsym.Hamiltonian.observable`), the
            columns in place of the components; nan where a formula is no finite real number.

        Raises
        ------
        InputError
            If pandas is not installed, a time is outside the span, or a name is unknown.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
        >>> solution.to_dataframe([0.0, np.pi])["x"].round(6).tolist()
        [1.0, -1.0]
        >>> solution.to_dataframe([0.0], "x", "x**2/2").columns.tolist()
        ['x', 'x**2/2']
        """
        times = np.atleast_1d(times_in_span(t, self.span))
        columns = observed(self.H, names, self(times), times)
        return data_frame(columns, {time_name(self.H.names): times}, self._attributes)

    def to_xarray(self, t: Any, *names: Any) -> xarray.Dataset:
        """Return states, energies and estimated errors at times t as a dataset of xarray.

        Its axes are ``time`` and ``component``; its variables ``state``, ``energy``,
        ``error_estimate``, ``success``, ``message`` and ``z0``.

        Parameters
        ----------
        t : sequence or array
            Times, shape (n,); a scalar counts as one time.
        *names : str or sympy.Expr
            Components or formulas, whose values are a further variable ``value`` with the axis
            ``quantity``.

        Raises
        ------
        InputError
            If xarray is not installed, a time is outside the span, or a name is unknown.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve("p**2/2 + x**2/2", [1, 0], (0, 5))
        >>> solution.to_xarray([0.0, 1.0])["state"].dims
        ('time', 'component')
        """
        times = np.atleast_1d(times_in_span(t, self.span))
        states = self(times)
        columns = observed(self.H, names, states, times) if names else {}
        variables = {
            "energy": (["time"], self.energy(times)),
            "error_estimate": (["time", "component"], np.abs(self.error_estimate(times))),
            "success": ([], self.success),
            "message": ([], self.message),
            "z0": (["component"], self.z0),
        }
        return dataset_of_states(
            self.H, [], times, states, columns, variables, {}, self._attributes
        )

    @property
    def _attributes(self) -> dict[str, Any]:
        return {**attributes_of(self.H), "method": self.method, "span": list(self.span)}

    def export(
        self,
        path: str | os.PathLike[str],
        *,
        certificate: hamsym.Certificate | None = None,
        allow_failed: bool = False,
        **lesson: Any,
    ) -> None:
        """Write a module of Python (.py), JSON (.json), C (.h), or a page that moves (.html).

        They need no hamsym; see :func:`hamsym.export`, also for the options of a page:
        ``parameters``, ``title``, ``text``.
        """
        hamsym.export(self, path, certificate=certificate, allow_failed=allow_failed, **lesson)

    def certify(
        self,
        rtol: float = 0.02,
        time_limit: float | None = None,
        progress: bool | None = None,
        *,
        bound: float | Sequence[float] | None = None,
    ) -> hamsym.Certificate:
        """Compute rigorous bounds on the error, from above and below.

        The equation is solved again with every rounding accounted for (:mod:`hamsym.proof.prove`):
        on windows, in sums of two float64 numbers.

        Parameters
        ----------
        rtol : float
            Largest gap between upper and lower bounds, relative to the lower ones.
        time_limit : float, optional
            Seconds.
        progress : bool, optional
            Draw progress on standard error; by default where that is a terminal.
        bound : float or sequence, optional
            Prove only that the error of every component stays below this bound, in the units of
            the component. ``rtol`` is then not used, and bounds on the energy error and on the
            residual may be infinite.

        Returns
        -------
        Certificate

        Raises
        ------
        CertificationError
            If there is no bound: the trajectory escapes or collides, H is not smooth along it, or
            the time limit is reached. The message gives the time and a remedy. Also if the error
            is not below ``bound``.

        Examples
        --------
        >>> import hamsym
        >>> solution = hamsym.solve(hamsym.Hamiltonian("p**2/2 + x**2/2"), [1, 0], (0, 5))
        >>> certificate = solution.certify()
        >>> certificate.lower <= certificate.bound < 1e-9
        True
        >>> solution.certify(bound=1e-9).asked
        (1e-09, 1e-09)
        """
        return hamsym.certify(self, rtol, time_limit, progress, bound=bound)

    def plot(self, *names: Any, ax: Any = None, **options: Any) -> Figure:
        """Draw the solution: an overview, or what the names say.

        Without names: the components over time, coordinates beside momenta, one row for each of
        six degrees of freedom at most; the orbit or the plane of two coordinates, and a phase
        plane, of one degree of freedom with level sets of H; estimated error, energy error,
        residual, and windows or loss. The caption has H, the parameters and the method; a failed
        solution is marked in red.

        Parameters
        ----------
        *names : str or sympy.Expr
            One component or formula (:meth:`hamsym.Hamiltonian.observable`): over time, with gaps
            where a formula is no finite real number. Two: the path in their plane, in one scale
            where both are lengths or components of one kind else. Three: the path in space. Or
            ``"error"``, the estimated
            errors relative to the sizes of the components, with the tolerance; ``"residual"``,
            ``"energy"``, ``"energies"``, that is the kinetic and the potential energy, or
            ``"search"``: lengths of the windows, or the best residual of a training over time.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.
        certificate : Certificate, optional
            Its bound is drawn with the errors; by default that of ``prove=True``.

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
        >>> import hamsym
        >>> H = hamsym.Hamiltonian("(p_x**2 + p_y**2)/2 - 1/sqrt(x**2 + y**2)")
        >>> solution = hamsym.solve(H, [1, 0, 0, 1.1], (0, 9))
        >>> solution.plot("x", "y").axes[0].get_xlabel()
        '$x$'
        >>> solution.plot("x*p_y - y*p_x").axes[0].get_ylabel()
        '$p_{y} x - p_{x} y$'
        """
        return hamsym.plot(self, *names, ax=ax, **options)

    def animate(self, *names: Any, **options: Any) -> hamsym.Animation:
        """Animate the motion, in a picture that names or options choose; :func:`hamsym.animate`."""
        return hamsym.animate(self, *names, **options)
