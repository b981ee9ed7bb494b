"""Trajectories by time stepping: the result of :func:`hamsym.integrate`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import numpy as np

import hamsym
from hamsym.hamiltonian import Hamiltonian
from hamsym.integrators.energy_drift import work_of
from hamsym.integrators.interpolation import Interpolant
from hamsym.integrators.table import INTEGRATORS
from hamsym.problems.description import attributes_of
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.observed import dataset_of_states, observed
from hamsym.support.record_fields import UNSAVED, AnyFloat, Count, Size, counts, flags, floats
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.tables import ensemble_frame, member_axes, time_name

if TYPE_CHECKING:
    import pandas
    import sympy
    import xarray


@dataclass(frozen=True)
class Verdicts:
    """How far each trajectory of an ensemble meets the tolerance."""

    #: Steps of the finest run of each trajectory.
    steps: Annotated[np.ndarray, counts("members")]
    #: Largest estimated error of each trajectory relative to the sizes of its components.
    largest: Annotated[np.ndarray, floats("members", finite=False)]
    #: Reason for each trajectory that did not succeed, by its index.
    problems: dict[int, str]
    tol: Size

    def outcome(self, index: int, method: str, end: float) -> str:
        """Describe the outcome of one trajectory."""
        if index in self.problems:
            return self.problems[index]
        return (
            f"{method}: {self.steps[index]:,} steps to t = {end:.6g}, estimated error "
            f"{self.largest[index]:.1e}"
        )

    def outcome_of_all(self, method: str, end: float) -> str:
        """Describe the outcome of an ensemble."""
        count, failed = len(self.steps), sorted(self.problems)
        if failed:
            return (
                f"{len(failed):,} of {count:,} trajectories failed, number {failed[0]:,} first: "
                f"{self.problems[failed[0]]}"
            )
        least, most = int(self.steps.min()), int(self.steps.max())
        return (
            f"{method}: {count:,} trajectories, {least:,} to {most:,} steps to t = {end:.6g}, "
            f"estimated error at most {self.largest.max():.1e}"
        )


_STATES = floats("*shape", "times", "dim", finite=False)


@suggest_attributes
@dataclass(frozen=True)
class Trajectory(Drawn, Saved):
    """States along a trajectory, or along each trajectory of an ensemble.

    An ensemble has the shape to which the initial states and the parameters broadcast, (batch,) for
    states of shape (batch, dim); () below is the shape of one trajectory.

    ``plot()`` draws an overview: the components over time, coordinates beside momenta, one row for
    each of six degrees of freedom at most; the orbit or the plane of two coordinates, and a phase
    plane, of one degree of freedom with level sets of H; the energy error, less the work of forces
    and explicit time; with ``tol`` the estimated error. One name draws a component over time, two
    the paths in their plane, in one scale where both are lengths or of one kind else, three the
    paths in space, ``"energy"`` and ``"error"`` these errors. Of more than 200 trajectories 200 are
    drawn, which the caption says.

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
    verdicts : Verdicts, optional
        With ``tol``: steps, largest relative error and problem of each trajectory, in a flat order.
    invariant_drift : mapping of str to float or numpy.ndarray
        Largest change of each of the ``invariants`` at the saved times, by its formula, (*shape);
        not part of files.
    """

    t: Annotated[np.ndarray, floats("times")] = field(repr=False)
    z: Annotated[np.ndarray, _STATES] = field(repr=False)
    names: tuple[str, ...]
    method: str
    steps: Count
    dt: float
    evaluations: Count
    seconds: Size
    success: bool | Annotated[np.ndarray, flags("*shape")]
    message: str
    ensemble: Ensemble = field(repr=False)
    interrupted: bool = False
    drift: AnyFloat = math.nan
    errors: Annotated[np.ndarray, _STATES] | None = field(default=None, repr=False)
    verdicts: Verdicts | None = field(default=None, repr=False)
    invariant_drift: Mapping[str, Any] = field(default_factory=dict, repr=False, metadata=UNSAVED)

    def check(self) -> None:
        """Raise ValueError unless it is one that :func:`hamsym.integrate` returns."""
        members, t, found = self.ensemble, self.t, self.verdicts
        if self.method not in INTEGRATORS:
            raise ValueError(f"'{self.method[:40]}' is not a method")
        if self.names != members.H.names:
            raise ValueError("its names are not those of H")
        if len(members) and members.hamiltonian(0) != members.H:
            raise ValueError("H does not have the parameters of the first trajectory")
        direction = math.copysign(1.0, self.dt)
        if not len(t) or not (np.diff(t) * direction > 0).all():
            raise ValueError("its times are not in order")
        if self.drift < 0:
            raise ValueError("its drift is negative")
        if self.z.shape[:-2] != members.shape:
            raise ValueError("its states do not have the shape of its members")
        z = self.z.reshape(len(members), len(t), -1)
        there = np.isfinite(z).all(axis=-1)
        if not (there[:, 1:] <= there[:, :-1]).all():
            raise ValueError("a state is finite after one that is not")
        if not np.array_equal(z[:, 0], members.states, equal_nan=True):
            raise ValueError("it does not begin at its starts")
        # Without tol success is one verdict of all trajectories.
        if isinstance(self.success, bool) != (found is None or not members.shape):
            raise ValueError("its success is not that of its trajectories")
        success = np.broadcast_to(self.success, members.shape).reshape(-1)
        if not there[success].all():
            raise ValueError("its success is true, but a state is not finite")
        if (found is None) != (self.errors is None):
            raise ValueError("its error estimate does not belong to its verdicts")
        if found is None or self.errors is None:
            return
        errors = self.errors.reshape(z.shape)
        if not (errors >= 0).all() or not np.isfinite(errors[success]).all():
            raise ValueError("its error estimate is negative, not a number, or not finite")
        if len(found.largest) != len(members) or not found.problems.keys() <= set(
            range(len(members))
        ):
            raise ValueError("a verdict belongs to no trajectory")
        if success.tolist() != [index not in found.problems for index in range(len(members))]:
            raise ValueError("its success contradicts its messages")
        if not found.tol > 0 or not (found.largest[success] <= found.tol).all():
            raise ValueError("its success is true, but an error is above its tolerance")

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
                texts[index] = self.verdicts.outcome(index, self.method, float(self.t[-1]))
        return texts.reshape(self.ensemble.shape)

    @cached_property
    def energy(self) -> np.ndarray:
        """H along the trajectory, shape (*shape, n)."""
        system, own = self.ensemble.H.compile("numpy"), self._own_parameters
        return system.at("energy", self.z, self.t, None if own is None else own[..., None, :])

    @cached_property
    def energy_drift(self) -> np.ndarray:
        """H(t) - H(start), less the work of forces and explicit time, shape (*shape, n).

        The work is the integral of ``H.power`` by splines through the saved states: save enough of
        them. Without forces and explicit time this is the change of H.

        Examples
        --------
        >>> H = hamsym.Hamiltonian("p**2/2 + x**2/2", forces={"p": "-p/5"})
        >>> trajectory = hamsym.integrate(H, [1, 0], (0, 10), "gauss6", steps=1_000)
        >>> bool(np.abs(trajectory.energy_drift).max() < 1e-11)
        True
        """
        H, change = self.ensemble.H, self.energy - self.energy[..., :1]
        if H.conserves_energy:
            return change
        with np.errstate(all="ignore"):
            (power,) = self._observed([H.power]).values()
        return change - work_of(self.t, power)

    # -- by name and by time ---------------------------------------------------------------------

    def __getitem__(self, name: str | sympy.Expr) -> np.ndarray:
        """Return a component or a formula over the saved times, shape (*shape, n).

        A component is a view of ``z``; a formula in the names of H
        (:meth:`hamsym.Hamiltonian.observable`) is nan where it is no finite real number.

        Raises
        ------
        InputError
            If it is neither a component nor a formula.

        Examples
        --------
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, np.pi), tol=1e-9, saves=2)
        >>> trajectory["x"].round(8) + 0.0
        array([ 1.,  0., -1.])
        >>> trajectory["p**2/2"].round(8)
        array([0. , 0.5, 0. ])
        """
        (values,) = self._observed([name]).values()
        return values

    def _observed(self, names: Sequence[Any]) -> dict[str, np.ndarray]:
        return observed(self.ensemble.H, names, self.z, self.t, self._own_parameters)

    @property
    def _own_parameters(self) -> np.ndarray | None:
        """Parameters of each trajectory, shape (*shape, k); None where all have those of H."""
        own = self.ensemble.own_parameters()
        return None if own is None else own.reshape(*self.ensemble.shape, -1)

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
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 10), tol=1e-9)
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
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 10), tol=1e-9)
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

    def frequencies(self, *signals: Any, count: int = 6) -> hamsym.Frequencies:
        """Find the frequencies of the trajectory; see :func:`hamsym.frequencies`.

        Examples
        --------
        >>> trajectory = hamsym.integrate(
        ...     "p**2/2 + 2*x**2", [1, 0], (0, 100), tol=1e-9, saves=1000
        ... )
        >>> trajectory.frequencies("x").frequency[0, :1].round(6)
        array([2.])
        """
        return hamsym.frequencies(self, *signals, count=count)

    def to_dataframe(self, *names: Any) -> pandas.DataFrame:
        """Return the states as a table of pandas: times as index, components as columns.

        An ensemble has further levels of the index, ``member`` or ``axis_0``, ``axis_1``, ..., and
        a column for each parameter that varies. H, parameters, units and the method are in
        ``attrs``.

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
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 1), "gauss4", steps=2)
        >>> table = trajectory.to_dataframe()
        >>> table.loc[0.5].round(4).to_dict()
        {'x': 0.8776, 'p': -0.4794}
        """
        found, members = self._observed(names), self.ensemble
        index = {time_name(self.names): self.t}
        return ensemble_frame(members.shape, index, found, members.columns, self._attributes)

    def to_xarray(self, *names: Any) -> xarray.Dataset:
        """Return states, energies, success and messages as a dataset of xarray.

        Its axes are ``time`` and ``component``, and of an ensemble ``member``, or ``axis_0``,
        ``axis_1``, ..., on which parameters that vary are coordinates. With ``tol`` it has
        ``errors`` too.

        Parameters
        ----------
        *names : str or sympy.Expr
            Components or formulas, whose values are a further variable ``value`` with the axis
            ``quantity``.

        Raises
        ------
        InputError
            If xarray is not installed, or a name is unknown.

        Examples
        --------
        >>> trajectory = hamsym.integrate("p**2/2 + x**2/2", [1, 0], (0, 1), "gauss4", steps=2)
        >>> data = trajectory.to_xarray()
        >>> round(float(data["state"].sel(time=0.5, component="x")), 4)
        0.8776
        """
        shape = self.ensemble.shape
        axes = member_axes(shape)
        variables = {
            "energy": ([*axes, "time"], self.energy),
            "success": (axes, np.array(np.broadcast_to(self.success, shape))),
            "message": (axes, self.messages),
        }
        if self.errors is not None:
            variables["errors"] = ([*axes, "time", "component"], self.errors)
        varied = {name: (axes, own.reshape(shape)) for name, own in self.ensemble.columns.items()}
        columns = self._observed(names) if names else {}
        given = self.z, columns, variables, varied, self._attributes
        return dataset_of_states(self.H, axes, self.t, *given)

    @property
    def _attributes(self) -> dict[str, Any]:
        known = attributes_of(self.ensemble.H, self.ensemble.varied if self.ensemble.shape else ())
        return {**known, "method": self.method, "dt": self.dt, "steps": self.steps}

    def animate(self, *names: Any, **options: Any) -> hamsym.Animation:
        """Animate the motion, in a picture that names or options choose; :func:`hamsym.animate`."""
        return hamsym.animate(self, *names, **options)
