"""Solution of many initial-value problems of one Hamiltonian to a tolerance.

Stage 1  Chunks of members are solved (:mod:`hamsym.families.blocks`) on all cores, or on the
         workers of a cluster (:mod:`hamsym.families.distributed`).
Stage 2  The windows of a chunk are kept, or written to a store
         (:mod:`hamsym.families.storage`).
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext
from itertools import chain, islice
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.families.blocks import Block, BlockSolver
from hamsym.families.distributed import blocks_on_cluster
from hamsym.families.solutions import Family, Solutions
from hamsym.families.storage import WindowStore
from hamsym.families.windows import Table, pieces_of
from hamsym.hamiltonian import HamiltonianLike
from hamsym.parallel.cluster import require_client
from hamsym.parallel.threads import Threads
from hamsym.problems.conservation import InvariantLike, KnownInvariants
from hamsym.problems.ensemble import Ensemble, ensemble_of
from hamsym.problems.problem import checked_span
from hamsym.random_features.members import Batch, basis_for, checked_accuracy
from hamsym.solution.solution import Solution
from hamsym.support.machine import memory_size
from hamsym.support.progress import stepping_progress
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require_whole

if TYPE_CHECKING:  # an optional package
    from distributed import Client

_FIRST, _MOST = 32, 1_024  # members of the first chunk, and of any; a call costs a millisecond
_SECONDS = 0.2  # that a chunk should take, so that Ctrl-C is soon obeyed
_WAITING = 2  # chunks for each core
_SHARE = 0.5  # of the memory, for windows


@checked_keywords
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
    store: str | os.PathLike[str] | None = None,
    client: Client | None = None,
    retries: int = 3,
    prove: bool = False,
    invariants: InvariantLike | Sequence[InvariantLike] = (),
) -> Solutions:
    """Solve from many initial states, or with many parameter values, on all cores or a cluster.

    Each member is solved as by :func:`hamsym.solve`, and the results are
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
    store : path-like, optional
        Write windows to a store, a folder, instead of keeping them in memory. The result reads them
        when they are needed; :func:`hamsym.load` opens the store again. A store that an interrupted
        call with the same arguments began is completed: members that are in it are not solved
        again.
    client : dask.distributed.Client, optional
        Solve on the workers of this cluster, with the same results to the last bit on processors
        of one kind. With ``store``, workers write to the store themselves if they reach its path.
    retries : int
        Times that a chunk of members is repeated after an error on a worker; see
        :func:`hamsym.parallel.cluster.cluster_results`.
    prove : bool
        Prove for each member that its errors are within the tolerance, as
        :meth:`Solutions.certify` does, with the result in :attr:`Solutions.proofs`; some
        milliseconds to seconds a member, one after the other.
    invariants : sequence of str, sympy.Expr or Invariant
        Functions that H conserves for all values of the parameters that are given, as of
        :func:`hamsym.solve`; they are tested at the ends of windows. Without ``store`` and
        ``client``.

    Returns
    -------
    Solutions
        Members in the shape to which z0 and the parameters broadcast.

    Raises
    ------
    InputError
        If an argument is invalid, or the windows would need more than half of the memory.
    FileError
        If the store cannot be written, or was begun with other arguments.
    HamsymError
        If a chunk fails on the cluster; the message names its members.

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
    began = time.perf_counter()
    members = ensemble_of(H, z0, parameters, finite=False)
    times = checked_span(span)
    require_whole("seed", seed, 0)
    accuracy = checked_accuracy(tol, atol, max_window, times, members.H.dim)
    basis = basis_for(int(seed), accuracy.tol)
    longest = None if max_window is None else float(max_window)
    asked = accuracy.tol, tuple(accuracy.absolute.tolist()), longest
    family = Family(members.H, times, *asked, int(seed), members.varied, basis.series)
    if client is not None:
        require_client(client)
        require_whole("retries", retries, 0)
    known = KnownInvariants(members.H, invariants, members.varied)
    if known and (store is not None or client is not None):
        raise InputError(
            "invariants are tested in one process and in memory; leave out store and client"
        )
    kept = None if store is None else WindowStore(store, family, members)
    with nullcontext() if kept is None else kept.locked():
        run = _Run(family, members, kept, known)
        with stepping_progress(len(members), progress, "solving") as report:
            if client is None:
                run.solve(report)
            else:
                run.solve_on(client, retries, report)
        found = run.solutions()
    found.seconds = time.perf_counter() - began
    if prove:
        found.proofs = found.certify(progress=progress)
    return found


class _Run:
    """The members that are solved so far."""

    def __init__(
        self, family: Family, members: Ensemble, store: WindowStore | None, known: KnownInvariants
    ) -> None:
        self._family, self._members, self._store = family, members, store
        self._solver = BlockSolver(family, members, known)
        self._blocks: list[Block] = []  # those in memory
        self._held = 0  # bytes of windows in memory
        self._refused: dict[int, str] = {}
        self._stopped = ""
        self._limit = _SHARE * memory_size()  # of the windows in memory

    def solve(self, report: Callable[[int], None]) -> None:
        """Solve all members, or as many as there are before Ctrl-C."""
        with Threads() as threads:
            try:
                left = valid = self._missing(report)
                if len(valid):
                    _ = self._family.solver  # made before the threads need it
                size = _FIRST

                def chunks() -> Iterator[np.ndarray]:
                    nonlocal left
                    while len(left):
                        chunk, left = np.split(left, [size])
                        yield chunk

                # Nothing follows the first chunk before the memory is known to suffice.
                parts = islice(chunks(), 1), chunks()
                found = (threads.results(self._solver.batch, part, _WAITING) for part in parts)
                for chunk, (batch, seconds) in chain.from_iterable(found):
                    # Smaller chunks at the end occupy all cores until then.
                    fair = max(len(left) // (_WAITING * threads.cores), _FIRST)
                    wanted = _SECONDS * len(chunk) / seconds
                    size = int(min(max(wanted, 1), fair, _MOST))
                    self._finish(chunk, batch, report)
                    self._limit_memory(len(valid))
                    if self._stopped:
                        break
            except KeyboardInterrupt:
                self._stopped = "interrupted"
                for chunk, (batch, _) in threads.begun():
                    self._keep(self._solver.block(chunk, batch, {}))

    def solve_on(self, client: Client, retries: int, report: Callable[[int], None]) -> None:
        """Solve all members on a cluster, or as many as there are before Ctrl-C."""
        family, store = self._family, self._store
        try:
            valid = self._missing(report)
            place = None if store is None else store.place
            found = blocks_on_cluster(client, family, self._members, valid, place, retries)
            with closing(found):
                for block in found:
                    self._keep(block)
                    report(len(block.members))
                    self._limit_memory(len(valid))
                    if self._stopped:
                        break
        except KeyboardInterrupt:
            self._stopped = "interrupted"

    def _missing(self, report: Callable[[int], None]) -> np.ndarray:
        """Return members that are not solved, and whose starts are valid."""
        valid, self._refused = self._solver.valid_starts()
        missing = valid if self._store is None else np.setdiff1d(valid, self._store.solved)
        report(len(self._members) - len(missing))
        return missing

    def _finish(
        self, chunk: np.ndarray, batch: Batch | None, report: Callable[[int], None]
    ) -> None:
        """Solve the members that a batch left, and keep all of them; also if interrupted."""
        left = np.arange(len(chunk)) if batch is None else np.flatnonzero(~batch.accepted)
        found: dict[int, Solution | str] = {}
        try:
            for place in left.tolist():
                found[place] = self._solver.alone(int(chunk[place]))
                report(1)
        finally:
            self._keep(self._solver.block(chunk, batch, found))
        report(len(chunk) - len(left))

    def _keep(self, block: Block) -> None:
        if self._store is not None:
            self._store.append(block)
            return
        self._blocks.append(block)
        self._held += sum(array.nbytes for array in block.windows or ())

    def _limit_memory(self, count: int) -> None:
        """Refuse after the first chunk, or stop later, where windows would fill the memory."""
        if self._store is not None:
            return
        limit, done = self._limit, sum(len(block.members) for block in self._blocks)
        advice = 'give store="windows" to write them to a store'
        if len(self._blocks) == 1 and (needed := self._held / done * count) > limit:
            raise InputError(
                f"the windows of {count:,} members would need about {needed / 1e9:.3g} GB, more "
                f"than half of the memory, {limit / 1e9:.3g} GB; {advice}"
            )
        if self._held > limit:
            self._stopped = (
                f"stopped: windows fill half of the memory, {limit / 1e9:.3g} GB; {advice}"
            )

    def solutions(self) -> Solutions:
        """Return the results of all members."""
        if self._store is not None:
            return self._store.finished(self._refused, self._stopped)
        # Those of a cluster come in any order.
        blocks = sorted(self._blocks, key=lambda block: int(block.members[0]))
        tables = [(block.members, block.table) for block in blocks]
        table = Table.of_members(
            self._members.states, self._members.parameters, tables, self._refused, self._stopped
        )
        packed = [block.windows for block in blocks if block.windows is not None]
        windows = pieces_of(packed or [self._solver.packed(None)])
        index = np.arange(len(self._members)).reshape(self._members.shape)
        return Solutions(self._family, table, windows, index)
