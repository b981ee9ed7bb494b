"""Solutions: many trajectories of one Hamiltonian as functions of time."""

from __future__ import annotations

import math
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.families.evaluation import states_in_groups
from hamsym.families.proofs import Proofs, prove_members
from hamsym.families.windows import ACCEPTED, MARCHED, OPEN, Table, Windows
from hamsym.hamiltonian import Hamiltonian
from hamsym.problems.description import attributes_of
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.observed import dataset_of_states, observed
from hamsym.random_features.basis import basis_of_series, size_of
from hamsym.random_features.error_estimate import RESOLUTIONS, MarchError, estimate_error
from hamsym.random_features.features import Features
from hamsym.random_features.flow import flow_of
from hamsym.random_features.march import origin_of
from hamsym.random_features.members import Accuracy, MemberSolver, basis_for, checked_accuracy
from hamsym.random_features.method import met_message, solution_of, state_of
from hamsym.random_features.windows import March
from hamsym.solution.acceptance import accepted
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution
from hamsym.solution.times import times_in_span
from hamsym.support.records import unpacked
from hamsym.support.shown import Drawn, Saved
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.tables import ensemble_frame, member_axes, time_name

if TYPE_CHECKING:  # optional packages
    import pandas
    import xarray


@dataclass(frozen=True, eq=False)
class Family:
    """The problem whose members :class:`Solutions` solves."""

    #: With the parameters of the first member.
    H: Hamiltonian
    span: tuple[float, float]
    tol: float
    #: Absolute tolerance of each component.
    atol: tuple[float, ...]
    max_window: float | None
    seed: int
    #: Parameters that were given as arguments.
    varied: tuple[str, ...]
    #: Chebyshev series of the columns of the basis, shape (degree + 1, m).
    series: np.ndarray

    def __reduce__(self) -> tuple[Any, ...]:
        # Programs of the library cannot be pickled.
        return Family, tuple(getattr(self, entry.name) for entry in fields(self))

    @cached_property
    def accuracy(self) -> Accuracy:
        """The checked accuracy."""
        return checked_accuracy(self.tol, self.atol, self.max_window, self.span, self.H.dim)

    @cached_property
    def settings(self) -> Settings:
        """What is asked of each member."""
        options = Features(max_window=self.max_window).given
        return Settings(self.span, self.tol, atol=self.atol, seed=self.seed, options=options)

    @property
    def origin(self) -> float:
        """Time from which edges are counted."""
        return origin_of(self.H.time is None, self.span)

    @property
    def degrees(self) -> int:
        """Terms of the series of an estimated error."""
        return RESOLUTIONS[size_of(self.series.shape[1]).nodes][0][-1]

    @cached_property
    def solver(self) -> MemberSolver | None:
        """The solver of batches; None where it does not apply."""
        if not MemberSolver.applies(self.H):
            return None
        basis = basis_for(self.seed, self.accuracy.tol)
        return MemberSolver(self.H, self.span, self.accuracy, basis)


@suggest_attributes
class Solutions(Drawn, Saved):
    """Many trajectories z^(t) over one time span, from :func:`hamsym.solve_many`.

    Members are arranged in an array; ``...`` below is its shape. Call it with times to get the
    states of all members: times of shape (n,) give (..., n, dim), a scalar gives (..., dim).
    ``many[i]`` (``many[i, j]``) is the :class:`~hamsym.Solution` of one member, the same to the
    last bit as :func:`hamsym.solve` returns; slices and masks give
    ``Solutions``. ``len`` and iteration follow the first axis, as those of an array.

    Its figure without names: the components over time, coordinates beside momenta, one row for each
    of six degrees of freedom at most; the plane of two coordinates and a phase plane; the largest
    estimated error of each trajectory with the tolerance, failed ones in red; energy errors. One
    component or formula is drawn over time, two are the paths in their plane, three the paths in
    space; ``"error"`` and ``"energy"`` are drawn, too. Of more than 200 trajectories 200 are drawn,
    which the caption says; the errors are those of all. Up to twelve have an entry in the legend,
    more a colour bar.

    Attributes
    ----------
    H : Hamiltonian
        With the parameters of the first member where they differ.
    span : (float, float)
    shape : tuple of int
    z0 : numpy.ndarray
        Initial states, shape (..., dim).
    parameters : dict of str to numpy.ndarray
        Values of the parameters that were given, shape (...).
    success : numpy.ndarray
        Whether the estimated error, round-off included, is within the tolerance, shape (...).
    message : numpy.ndarray
        Outcome of each member, shape (...), of str.
    largest_error : numpy.ndarray
        Largest estimated error, round-off included, over the time that a member reached, shape
        (..., dim); infinite where it is unknown.
    excess : numpy.ndarray
        Largest ratio of the estimated to the allowed error, shape (...); infinite where it is
        unknown.
    seconds : float
        Run time; nan for a part of the members, and not part of files.
    proofs : Proofs or None
        With ``prove=True``, whether the errors of each member are proven to be within the
        tolerance.
    family, table, windows, members
        The problem, the results and windows of all members of the run, and the numbers of these
        members among them, shape (...).
    """

    def __init__(self, family: Family, table: Table, windows: Windows, members: np.ndarray) -> None:
        self.family, self.table, self.windows = family, table, windows
        self.members = members  # their numbers in the table, in their shape
        self.proofs: Proofs | None = None
        self.seconds = math.nan

    def __repr__(self) -> str:
        start, end = self.span
        solved = int(self.success.sum())
        return (
            f"Solutions({self.H.formulas!r}, shape {self.shape}, t from {start:.6g} to {end:.6g}: "
            f"{solved:,} succeeded, {self.size - solved:,} failed)"
        )

    @property
    def H(self) -> Hamiltonian:
        return self.family.H

    @property
    def span(self) -> tuple[float, float]:
        return self.family.span

    @property
    def tol(self) -> float:
        """The relative tolerance."""
        return float(self.family.tol)

    @property
    def shape(self) -> tuple[int, ...]:
        return self.members.shape

    @property
    def size(self) -> int:
        """Number of members."""
        return self.members.size

    @property
    def ndim(self) -> int:
        """Number of axes in which members are arranged."""
        return self.members.ndim

    def __len__(self) -> int:
        return len(self.members)

    @cached_property
    def z0(self) -> np.ndarray:
        return self.table.z0[self.members]

    @property
    def _starts(self) -> Ensemble:
        """Starts and parameters of all members of the run."""
        table = self.table
        return Ensemble(self.H, table.z0, table.parameters, table.status.shape, self.family.varied)

    @cached_property
    def parameters(self) -> Mapping[str, np.ndarray]:
        return {name: column[self.members] for name, column in self._starts.columns.items()}

    @property
    def own_parameters(self) -> np.ndarray | None:
        """Parameters in the order of H, shape (..., k); None where all members have those of H."""
        return self._starts.own_parameters(self.members)

    @cached_property
    def success(self) -> np.ndarray:
        return self.table.success[self.members]

    @cached_property
    def largest_error(self) -> np.ndarray:
        return self.table.largest[self.members]

    @cached_property
    def excess(self) -> np.ndarray:
        return self.table.excess[self.members]

    @cached_property
    def message(self) -> np.ndarray:
        found = np.empty(self.size, dtype=object)
        found[:] = [self._message(member) for member in self.members.ravel().tolist()]
        return found.reshape(self.shape)

    def _message(self, member: int) -> str:
        table = self.table
        if table.status[member] == ACCEPTED:
            return met_message(self.tol, table.counts[member], table.excess[member])
        if table.status[member] == OPEN:
            return table.stopped
        return table.notes[member].message

    # -- members -----------------------------------------------------------------------------

    def __iter__(self) -> Iterator[Solution | Solutions]:
        return (self[i] for i in range(len(self)))

    def __getitem__(self, key: Any) -> Any:
        """Return the solution of a member, or the solutions of several.

        Raises
        ------
        InputError
            If the member has no solution; the message is its ``message``.
        IndexError
            If there is no such member.
        """
        members = self.members[key]
        if np.ndim(members):
            return Solutions(self.family, self.table, self.windows, members)
        return self._solution(int(members))

    def _solution(self, member: int) -> Solution:
        table, family = self.table, self.family
        if not table.counts[member]:
            raise InputError(self._message(member))
        z0 = table.z0[member].copy()
        H = self._starts.hamiltonian(member)
        if table.status[member] == MARCHED:
            march, error = self.marched(member)
            given = march, family.series, error, family.settings
            success, message = bool(table.success[member]), self._message(member)
            return solution_of(H, z0, *given, success=success, message=message)
        return self._accepted(member, H, z0)

    def _accepted(self, member: int, H: Hamiltonian, z0: np.ndarray) -> Solution:
        """Solve a member of the batch again: the same windows, and their error."""
        table, family = self.table, self.family
        accuracy, own = family.accuracy, table.packed(self.windows, member, member + 1)
        wall, cpu = time.perf_counter(), time.thread_time()
        basis, error = basis_for(family.seed, accuracy.tol), None
        if family.solver is not None and np.array_equal(basis.series, family.series):
            found = family.solver.solve_one(z0, table.parameters[member].copy())
            if found is not None and all(
                np.array_equal(getattr(found.march, name), getattr(own, name))
                for name in ("edges", "states", "readouts")
            ):
                error = found.error
        march = March(
            edges=own.edges.copy(),
            states=own.states.copy(),
            readouts=own.readouts.copy(),
            reached=family.origin + float(own.edges[-1]),
            scale=table.sizes[member].copy(),
            evaluations=int(table.evaluations[member]),
            seconds=time.perf_counter() - wall,
            cpu_seconds=time.thread_time() - cpu,
            seed=family.seed,
            origin=family.origin,
        )
        if error is None:  # the windows are from a machine that rounds differently
            basis = basis_of_series(family.seed, family.series)
            error = estimate_error(march, basis, flow_of(H), accuracy.local).error
        cause = "the error was estimated again, with the rounding of this machine"
        again = solution_of(H, z0, march, basis.series, error, family.settings)
        return accepted(again, state_of(len(march.readouts)), cause=cause)

    def marched(self, member: int) -> tuple[March, MarchError]:
        """Return march and error of a member that was solved by itself."""
        table = self.table
        own, note = table.packed(self.windows, member, member + 1), table.notes[member]
        arrays = {name: getattr(own, name).copy() for name in ("edges", "states", "readouts")}
        march = unpacked(March, {**arrays, "scale": table.sizes[member].copy()}, note.march)
        error = MarchError(
            march.edges,
            own.error.copy(),
            own.floors.copy(),
            table.largest[member].copy(),
            np.array(note.scale),
            np.array(march.origin),
        )
        return march, error

    # -- evaluation --------------------------------------------------------------------------

    def __call__(self, t: Any, *, extrapolate: bool = False) -> np.ndarray:
        """Return the states of all members at times t, shape (..., n, dim), or (..., dim).

        Each is equal to ``many[i](t)`` to the last bit. They are nan for a member without a
        solution, and after the time that a member reached.

        Parameters
        ----------
        t : float, sequence or array
        extrapolate : bool
            Allow times outside the span.

        Raises
        ------
        InputError
            If a time is outside the span, unless ``extrapolate=True``.
        """
        times = times_in_span(t, self.span, extrapolate=extrapolate)
        flat = np.atleast_1d(times)
        found = np.full((self.size, len(flat), self.H.dim), np.nan)
        for places, part, states in self._groups(flat):
            found[places, part] = states
        return found.reshape(*self.shape, *times.shape, self.H.dim)

    def energy(self, t: Any, *, extrapolate: bool = False) -> np.ndarray:
        """Return H of all members at times t, shape (..., n), or (...) for a scalar t.

        Raises
        ------
        InputError
            If a time is outside the span, unless ``extrapolate=True``.
        """
        times = times_in_span(t, self.span, extrapolate=extrapolate)
        flat, system = np.atleast_1d(times), self.H.compile("numpy")
        found, members = np.full((self.size, len(flat)), np.nan), self.members.ravel()
        for places, part, states in self._groups(flat):
            values = self._starts.own_parameters((members[places], None))
            found[places, part] = system.at("energy", states, flat[part], values)
        return found.reshape(*self.shape, *times.shape)

    def _groups(self, times: np.ndarray) -> Iterator[tuple[np.ndarray, slice, np.ndarray]]:
        members = self.members.ravel()
        return states_in_groups(self.family, self.table, self.windows, members, times)

    # -- proofs ------------------------------------------------------------------------------

    def certify(self, bound: Any = None, progress: bool | None = None) -> Proofs:
        """Prove for each member that the error of every component stays below a bound.

        Parameters
        ----------
        bound : float or sequence, optional
            In the units of the components, as of :meth:`hamsym.Solution.certify`; by default the
            tolerance of each member.
        progress : bool, optional
            Draw progress on standard error; by default if that is a terminal.

        Examples
        --------
        >>> many = hamsym.solve_many("p**2/2 + x**2/2", [[1.0, 0.0], [2.0, 0.0]], (0, 5))
        >>> many.certify()
        Proofs(2 proven, 0 not)
        """
        return prove_members(self, bound, progress)

    def animate(self, *names: Any, **options: Any) -> hamsym.Animation:
        """Animate the first 50 members in one picture; see :func:`hamsym.animate`."""
        return hamsym.animate(self, *names, **options)

    # -- files and tables --------------------------------------------------------------------

    def to_xarray(self, t: Any, *names: Any) -> xarray.Dataset:
        """Return states at times t, with success and error estimates, as a dataset of xarray.

        Its variables are ``state``, ``success``, ``message``, ``largest_error`` and ``z0``. Axes
        of members are called ``member``, or ``axis_0``, ``axis_1``, ... if there are several; the
        other ones are ``time`` and ``component``. Parameters are coordinates.

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
        """
        axes = member_axes(self.shape)
        times = np.atleast_1d(times_in_span(t, self.span))
        states = self(times)
        columns = observed(self.H, names, states, times, self.own_parameters) if names else {}
        variables = {
            "success": (axes, self.success),
            "message": (axes, self.message),
            "largest_error": ([*axes, "component"], self.largest_error),
            "z0": ([*axes, "component"], self.z0),
        }
        varied = {name: (axes, values) for name, values in self.parameters.items()}
        given = states, columns, variables, varied, self._attributes
        return dataset_of_states(self.H, axes, times, *given)

    @property
    def _attributes(self) -> dict[str, Any]:
        known = attributes_of(self.H, self.family.varied)
        return {**known, "span": list(self.span), "tol": self.tol}

    def to_dataframe(self, t: Any, *names: Any) -> pandas.DataFrame:
        """Return states at times t as a table of pandas, with components as columns.

        The index has the levels ``member``, or ``axis_0``, ``axis_1``, ..., and ``t``. Parameters
        that vary are columns; H, other parameters and units are in ``attrs``.

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
        >>> many = hamsym.solve_many("p**2/2 + x**2/2", [[1.0, 0.0], [2.0, 0.0]], (0, 5))
        >>> many.to_dataframe([0.0, 5.0])["x"].xs(0.0, level="t").tolist()
        [1.0, 2.0]
        """
        times = np.atleast_1d(times_in_span(t, self.span))
        found = observed(self.H, names, self(times), times, self.own_parameters)
        index = {time_name(self.H.names): times}
        return ensemble_frame(self.shape, index, found, self.parameters, self._attributes)
