"""Solution of many initial-value problems of one Hamiltonian to a tolerance.

Stage 1  Chunks of members are solved by the compiled loop over members
         (:mod:`hamsym.random_features.members`) on all cores.
Stage 2  Members that it does not accept are solved one at a time, as
         :func:`hamsym.solve` solves them.
Stage 3  The windows of a chunk are kept, or moved to a store of zarr
         (:mod:`hamsym.families.storage`).
"""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hamsym.ensemble import Ensemble, ensemble_of
from hamsym.errors import InputError
from hamsym.families.solutions import Family, Solutions
from hamsym.families.storage import WindowStore
from hamsym.families.windows import (
    ACCEPTED,
    MARCHED,
    REFUSED,
    Packed,
    Table,
    Windows,
    pieces_of,
)
from hamsym.hamiltonian import HamiltonianLike
from hamsym.problem import InitialValueProblem, checked_span
from hamsym.random_features.members import Batch, MemberSolver
from hamsym.random_features.method import (
    FeatureOptions,
    basis_for,
    checked_accuracy,
    solve_by_march,
)
from hamsym.solution.solution import Solution
from hamsym.support.checked_data import numbers_of
from hamsym.support.cores import available_cores
from hamsym.support.memory import memory_size
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require_whole

__all__ = ["solve_many"]

_FIRST, _MOST = 32, 1_024  # members of the first chunk, and of any; a call costs a millisecond
_ON_DEVICE = 32_768  # members of a chunk on a device of torch
_SECONDS = 0.2  # that a chunk should take, so that Ctrl-C is soon obeyed
_WAITING = 2  # chunks for each core
_CHECKED = 65_536  # members whose starts are checked at once
_BUFFER = 2**26  # bytes of windows that are kept before they are moved to a store
_SHARE = 0.5  # of the memory, for windows


def solve_many(
    H: HamiltonianLike,
    z0: Any,
    span: tuple[float, float],
    *,
    tol: float = 1e-9,
    parameters: Mapping[Any, Any] | None = None,
    atol: float | Sequence[float] = 0.0,
    max_window: float | None = None,
    seed: int = 0,
    progress: bool | None = None,
    zarr: str | os.PathLike[str] | None = None,
    device: str | None = None,
) -> Solutions:
    """Solve from many initial states, or with many parameter values, on all cores.

    Each member is solved as by :func:`hamsym.solve` with ``compiled=True``, and the results are
    the same to the last bit. A member that fails has its own message and leaves the others
    unchanged. Ctrl-C ends the run with the members that are finished.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : array or mapping
        Initial states of shape (..., dim) in the order of H.z, or a mapping of names to numbers
        and arrays. A state that is not finite is a member that fails.
    span : (float, float)
    tol, atol, max_window
        As of :func:`hamsym.solve`.
    parameters : mapping of name to number or array, optional
        Values that replace those of H; they broadcast with the states.
    seed : int
        Of the basis.
    progress : bool, optional
        Draw progress and the time left on standard error; by default if that is a terminal.
    zarr : path-like, optional
        Write windows to a new store of the package zarr instead of keeping them in memory. The
        result reads them when they are needed; :func:`hamsym.load` opens the store again.

    device : str, optional
        A device of torch, for example ``"cuda"``: the march of
        :mod:`hamsym.random_features.tensor_march`, the same up to round-off, for a million members.
        By default compiled code on all cores.

    Returns
    -------
    Solutions
        Members in the shape to which z0 and the parameters broadcast.

    Raises
    ------
    InputError
        If an argument is invalid, or the windows would need more than half of the memory.
    FileError
        If the store cannot be written.

    Examples
    --------
    >>> starts = {"x": [[1.0], [2.0]], "p": 0.0}
    >>> many = solve_many("p**2/2 + k*x**2/2", starts, (0, 5), parameters={"k": [1.0, 4.0, 9.0]})
    >>> many
    Solutions('p**2/2 + k*x**2/2', shape (2, 3), t from 0 to 5: 6 succeeded, 0 failed)
    >>> many([0.0, 2.5, 5.0]).shape
    (2, 3, 3, 2)
    >>> bool(abs(many(5.0)[1, 2, 0] - 2 * np.cos(15)) < 1e-8)
    True
    >>> many[1, 2].success
    True
    """
    members = ensemble_of(H, z0, parameters, finite=False)
    times = checked_span(span)
    require_whole("seed", seed, 0)
    options = FeatureOptions(tol=tol, atol=atol, max_window=max_window, compiled=True)
    accuracy = checked_accuracy(options, times, members.H.dim)
    basis = basis_for(int(seed), accuracy.tol)
    family = Family(members.H, times, options, int(seed), members.varied, basis.series)
    store = None if zarr is None else WindowStore(zarr, family)
    run = _Run(family, members, store, device)
    index = np.arange(len(members)).reshape(members.shape)
    with stepping_progress(len(members), progress, "solving") as report:
        run.solve(report)
    if store is None:
        return Solutions(family, run.table(), run.windows(), index)
    return store.finished(run.table(), index)


class _Block(NamedTuple):
    """Results of a chunk: a table of its members, of which ``members`` are the numbers."""

    members: np.ndarray
    table: Table
    windows: Packed | None


class _Run:
    """The members that are solved so far."""

    def __init__(
        self, family: Family, members: Ensemble, store: WindowStore | None, device: str | None
    ) -> None:
        self._family, self._members, self._store = family, members, store
        self._solver = family.solver if device is None else _on_device(family, device)
        # One chunk occupies a device.
        self._cores = available_cores() if device is None else 1
        self._sizes = (_FIRST, 1, _MOST) if device is None else (_ON_DEVICE,) * 3
        self._basis = basis_for(family.seed, family.accuracy.tol)
        self._blocks: list[_Block] = []
        self._flushed, self._held = 0, 0  # blocks in the store, and bytes of windows in memory
        self._refused: dict[int, str] = {}
        self._stopped = ""
        self._limit = _SHARE * memory_size()  # of the windows in memory

    def solve(self, report: Callable[[int], None]) -> None:
        """Solve all members, or as many as there are before Ctrl-C."""
        waiting: deque[tuple[np.ndarray, Future[tuple[Batch | None, float]]]] = deque()
        cores, (start, least, largest) = self._cores, self._sizes
        pool = ThreadPoolExecutor(cores)
        try:
            valid = self._valid_starts()
            report(len(self._members) - len(valid))
            position, size = 0, start
            while waiting or position < len(valid):
                # Nothing follows the first chunk before the memory is known to suffice.
                most = _WAITING * cores if self._blocks else 1
                while position < len(valid) and len(waiting) < most:
                    chunk = valid[position : position + size]
                    waiting.append((chunk, pool.submit(self._batch, chunk)))
                    position += len(chunk)
                batch, seconds = waiting[0][1].result()
                # Smaller chunks at the end occupy all cores until then.
                fair = max((len(valid) - position) // (_WAITING * cores), start)
                wanted = _SECONDS * len(waiting[0][0]) / seconds
                size = int(min(max(wanted, least), fair, largest))
                chunk, _ = waiting.popleft()
                self._finish(chunk, batch, report)
                self._limit_memory(len(valid))
                if self._stopped:
                    break
        except KeyboardInterrupt:
            self._stopped = "interrupted"
            for chunk, future in waiting:
                if not future.cancel():
                    self._keep(self._block(chunk, future.result()[0], {}))
        finally:
            pool.shutdown(cancel_futures=True)
        self._flush()

    def _valid_starts(self) -> np.ndarray:
        """Return members whose starts solve accepts; the others are refused with its message."""
        members, family = self._members, self._family
        system, good = members.H.compile("numpy"), np.empty(len(members), dtype=bool)
        for first in range(0, len(members), _CHECKED):
            part = slice(first, first + _CHECKED)
            values = members.parameters[part] if members.varied else None
            arguments = system.arguments(members.states[part], family.span[0])
            with np.errstate(all="ignore"):
                energies = system.energy(*arguments, **system.keywords(values))
                rates = system.vector_field(*arguments, **system.keywords(values))
            good[part] = np.isfinite(energies) & np.isfinite(rates).all(axis=-1)
        good &= np.isfinite(members.states).all(axis=1)
        for member in np.flatnonzero(~good).tolist():
            state = members.states[member]
            try:
                # The message does not depend on the parameters where the state is not finite.
                finite = np.isfinite(state).all()
                self._problem(member, members.hamiltonian(member) if finite else members.H)
                good[member] = True
            except InputError as error:
                self._refused[member] = str(error)
        return np.flatnonzero(good)

    def _problem(self, member: int, H: HamiltonianLike) -> InitialValueProblem:
        family = self._family
        state = self._members.states[member]
        return InitialValueProblem.checked(H, state, family.span, family.seed, None)

    def _batch(self, chunk: np.ndarray) -> tuple[Batch | None, float]:
        """Solve a chunk by the loop over members; return the seconds that it took."""
        began = time.perf_counter()
        states, parameters = self._members.states[chunk], self._members.parameters[chunk]
        batch = None
        if self._solver is not None:
            batch = self._solver.solve(states, parameters, keep_error=False)
        return batch, max(time.perf_counter() - began, 1e-6)

    def _finish(
        self, chunk: np.ndarray, batch: Batch | None, report: Callable[[int], None]
    ) -> None:
        """Solve the members that a batch left, and keep all of them; also if interrupted."""
        left = np.arange(len(chunk)) if batch is None else np.flatnonzero(~batch.accepted)
        found: dict[int, Solution | str] = {}
        try:
            for place in left.tolist():
                found[place] = self._alone(int(chunk[place]))
                report(1)
        finally:
            self._keep(self._block(chunk, batch, found))
        report(len(chunk) - len(left))

    def _alone(self, member: int) -> Solution | str:
        """Solve one member as solve does; return the message if it has no solution."""
        try:
            problem = self._problem(member, self._members.hamiltonian(member))
            return solve_by_march(problem, self._family.options, self._basis, "features")
        except InputError as error:
            return str(error)

    def _block(
        self, chunk: np.ndarray, batch: Batch | None, found: Mapping[int, Solution | str]
    ) -> _Block:
        """Put the members of a batch, and those that were solved by themselves, in order."""
        members = self._members
        table = Table.empty(members.states[chunk], members.parameters[chunk])
        parts: list[Packed] = []
        accepted = np.zeros(len(chunk), dtype=bool) if batch is None else batch.accepted
        if batch is not None:
            table.status[accepted], table.success[accepted] = ACCEPTED, True
            for name in ("counts", "evaluations", "excess", "largest", "sizes"):
                getattr(table, name)[accepted] = getattr(batch, name)[accepted]
        whole = self._packed(batch)
        edges = np.cumsum(np.where(accepted, table.counts + 1, 0))
        places = np.cumsum(np.where(accepted, table.counts, 0))
        notes: dict[int, dict[str, Any]] = {}
        parts, edge, window = [], 0, 0
        for place, solution in sorted(found.items()):
            if isinstance(solution, str):
                table.status[place], notes[place] = REFUSED, {"message": solution}
                continue
            parts.append(_between(whole, (edge, int(edges[place])), (window, int(places[place]))))
            edge, window = int(edges[place]), int(places[place])
            parts.append(self._marched(table, place, solution))
            notes[place] = _note(solution)
        if parts:
            parts.append(_between(whole, (edge, len(whole.edges)), (window, len(whole.readouts))))
            whole = Packed(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        return _Block(chunk, replace(table, notes=notes), whole)

    def _packed(self, batch: Batch | None) -> Packed:
        """Return the windows of a batch, of which the errors are not kept."""
        dim, columns = self._members.H.dim, self._family.series.shape[1]
        none = np.empty((0, self._family.degrees, dim)), np.empty((0, dim))
        if batch is None:
            return Packed(np.empty(0), np.empty((0, dim)), np.empty((0, columns, dim)), *none)
        return Packed(batch.edges, batch.states, batch.readouts, *none)

    def _marched(self, table: Table, place: int, solution: Solution) -> Packed:
        """Enter a member that was solved by itself into the table, and return its windows."""
        accuracy = self._family.accuracy
        march: Any = solution.record
        error: Any = solution.error
        table.status[place], table.success[place] = MARCHED, solution.success
        table.counts[place], table.evaluations[place] = len(march.readouts), march.evaluations
        table.excess[place] = error.excess(accuracy.absolute + accuracy.tol * error.scale)
        table.largest[place], table.sizes[place] = error.largest, march.scale
        return Packed(march.edges, march.states, march.readouts, error.series, error.floors)

    def _keep(self, block: _Block) -> None:
        self._blocks.append(block)
        if block.windows is not None:
            self._held += sum(array.nbytes for array in block.windows)
        if self._store is not None and self._held > _BUFFER:
            self._flush()

    def _flush(self) -> None:
        """Move windows to the store; an interruption leaves it as it was."""
        if self._store is None:
            return
        pending = [b.windows for b in self._blocks[self._flushed :] if b.windows is not None]
        if pending:
            arrays = (np.concatenate(parts) for parts in zip(*pending, strict=True))
            # The store counts its blocks, so that nothing is written twice after an interruption.
            self._store.append(len(self._blocks), Packed(*arrays))
        for k in range(self._flushed, len(self._blocks)):
            self._blocks[k] = self._blocks[k]._replace(windows=None)
        self._flushed, self._held = len(self._blocks), 0

    def _limit_memory(self, count: int) -> None:
        """Refuse after the first chunk, or stop later, where windows would fill the memory."""
        if self._store is not None:
            return
        limit, done = self._limit, sum(len(block.members) for block in self._blocks)
        advice = 'give zarr="windows.zarr" to write them to a store'
        if len(self._blocks) == 1 and (needed := self._held / done * count) > limit:
            raise InputError(
                f"the windows of {count:,} members would need about {needed / 1e9:.3g} GB, more "
                f"than half of the memory, {limit / 1e9:.3g} GB; {advice}"
            )
        if self._held > limit:
            self._stopped = (
                f"stopped: windows fill half of the memory, {limit / 1e9:.3g} GB; {advice}"
            )

    def table(self) -> Table:
        """Return the results of all members."""
        table, notes = Table.empty(self._members.states, self._members.parameters), {}
        for block in self._blocks:
            for name, column in block.table.arrays().items():
                if name not in ("z0", "parameters"):
                    getattr(table, name)[block.members] = column
            notes.update(
                {int(block.members[place]): note for place, note in block.table.notes.items()}
            )
        for member, message in self._refused.items():
            table.status[member], notes[member] = REFUSED, {"message": message}
        return replace(table, notes=notes, stopped=self._stopped)

    def windows(self) -> Windows:
        """Return the windows of all members, where they are in memory."""
        packed = [block.windows for block in self._blocks if block.windows is not None]
        return pieces_of(packed or [self._packed(None)])


def _on_device(family: Family, device: str) -> MemberSolver | None:
    """Make the solver on a device of torch; None where it does not apply."""
    from hamsym.random_features.tensor_members import TensorSolver  # imports torch, which is slow

    if not TensorSolver.applies(family.H):
        return None
    found, basis = family.accuracy, basis_for(family.seed, family.accuracy.tol)
    return TensorSolver(
        *(family.H, family.span, found.tol, found.local, found.absolute, found.longest),
        basis,
        device,
    )


def _note(solution: Solution) -> dict[str, Any]:
    """Return what the table and the windows do not contain of a solution."""
    error: Any = solution.error
    return {
        "message": solution.message,
        "march": numbers_of(solution.record),
        "scale": error.scale.tolist(),
    }


def _between(packed: Packed, edges: tuple[int, int], windows: tuple[int, int]) -> Packed:
    """Return the windows of some members of a batch."""
    return packed._replace(
        edges=packed.edges[slice(*edges)],
        states=packed.states[slice(*edges)],
        readouts=packed.readouts[slice(*windows)],
    )
