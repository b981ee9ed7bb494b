"""Solution of blocks of members: what one process does with a part of an ensemble.

Stage 1  The loop over members (:mod:`hamsym.random_features.members`) solves a chunk.
Stage 2  Members that it does not accept are solved one at a time, as :func:`hamsym.solve` does.
Stage 3  Both are put in order, as a :class:`Block`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from hamsym.errors import InputError
from hamsym.families.solutions import Family
from hamsym.families.windows import ACCEPTED, MARCHED, REFUSED, Note, Packed, Table
from hamsym.hamiltonian import HamiltonianLike
from hamsym.problems.conservation import KnownInvariants
from hamsym.problems.ensemble import Ensemble
from hamsym.problems.problem import InitialValueProblem
from hamsym.random_features.features import Features
from hamsym.random_features.members import Batch, basis_for
from hamsym.random_features.method import solve_by_march
from hamsym.solution.acceptance import judged_by_invariants
from hamsym.solution.solution import Solution
from hamsym.support.records import packed

_CHECKED = 65_536  # members whose starts are checked at once


class Block(NamedTuple):
    """Results of a chunk: a table of its members, of which ``members`` are the numbers.

    ``windows`` are None where they are in a store.
    """

    members: np.ndarray
    table: Table
    windows: Packed | None


class BlockSolver:
    """Solver of chunks of the members of an ensemble.

    - known: Invariants whose drift a member must explain by its allowed errors.
    """

    def __init__(
        self, family: Family, members: Ensemble, known: KnownInvariants | None = None
    ) -> None:
        self._family, self._members = family, members
        self._known = known
        self._basis = basis_for(family.seed, family.accuracy.tol)

    def valid_starts(self) -> tuple[np.ndarray, dict[int, str]]:
        """Return members whose starts solve accepts, and the messages of the others."""
        members, family = self._members, self._family
        refused: dict[int, str] = {}
        system, good = members.H.compile("numpy"), np.empty(len(members), dtype=bool)
        for first in range(0, len(members), _CHECKED):
            part = slice(first, first + _CHECKED)
            given = members.states[part], family.span[0], members.own_parameters(part)
            energies, rates = (system.at(name, *given) for name in ("energy", "vector_field"))
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
                refused[member] = str(error)
        return np.flatnonzero(good), refused

    def _problem(self, member: int, H: HamiltonianLike) -> InitialValueProblem:
        family = self._family
        state = self._members.states[member]
        asked: dict[str, Any] = {"tol": family.tol, "atol": family.atol}
        return InitialValueProblem.checked(H, state, family.span, family.seed, **asked)

    def batch(self, chunk: np.ndarray) -> tuple[Batch | None, float]:
        """Solve a chunk by the loop over members; return the seconds that it took."""
        began = time.perf_counter()
        states, parameters = self._members.states[chunk], self._members.parameters[chunk]
        batch = None
        if (solver := self._family.solver) is not None:
            batch = solver.solve(states, parameters)
            if self._known:
                batch = self._conserving(batch, parameters, self._known)
        return batch, max(time.perf_counter() - began, 1e-6)

    def _conserving(self, batch: Batch, parameters: np.ndarray, known: KnownInvariants) -> Batch:
        """Return the batch without members in which an invariant drifts at the ends of windows."""
        members = np.flatnonzero(batch.accepted)
        lengths = batch.counts[members] + 1
        owner = np.repeat(members, lengths)
        firsts = np.repeat(np.cumsum(lengths) - lengths, lengths)
        family = self._family
        change, explained = known.drifts(
            batch.states[firsts],
            family.span[0],
            batch.states,
            family.origin + batch.edges,
            family.accuracy.allowed(batch.sizes)[owner],
            parameters[owner] if family.varied else None,
        )
        refused = np.unique(owner[~(change <= explained).all(axis=0)])
        if not len(refused):
            return batch
        accepted = batch.accepted.copy()
        accepted[refused] = False
        edges, windows = accepted[owner], accepted[np.repeat(members, lengths - 1)]
        return replace(
            batch,
            accepted=accepted,
            edges=batch.edges[edges],
            states=batch.states[edges],
            readouts=batch.readouts[windows],
        )

    def alone(self, member: int) -> Solution | str:
        """Solve one member as solve does; return the message if it has no solution."""
        try:
            problem = self._problem(member, self._members.hamiltonian(member))
            method = Features(max_window=self._family.max_window)
            found = solve_by_march(problem, method, self._basis)
            return judged_by_invariants(found, self._known) if self._known else found
        except InputError as error:
            return str(error)

    def solved(self, chunk: np.ndarray) -> Block:
        """Solve a chunk, with the members that the loop over members leaves."""
        batch, _ = self.batch(chunk)
        left = np.arange(len(chunk)) if batch is None else np.flatnonzero(~batch.accepted)
        return self.block(chunk, batch, {p: self.alone(int(chunk[p])) for p in left.tolist()})

    def block(
        self, chunk: np.ndarray, batch: Batch | None, found: Mapping[int, Solution | str]
    ) -> Block:
        """Put the members of a batch, and those that were solved by themselves, in order."""
        members = self._members
        table = Table.empty(members.states[chunk], members.parameters[chunk])
        accepted = np.zeros(len(chunk), dtype=bool) if batch is None else batch.accepted
        if batch is not None:
            table.status[accepted], table.success[accepted] = ACCEPTED, True
            for name in ("counts", "evaluations", "excess", "largest", "sizes"):
                getattr(table, name)[accepted] = getattr(batch, name)[accepted]
        whole = self.packed(batch)
        edges = np.cumsum(np.where(accepted, table.counts + 1, 0))
        places = np.cumsum(np.where(accepted, table.counts, 0))
        notes: dict[int, Note] = {}
        parts, edge, window = list[Packed](), 0, 0
        for place, solution in sorted(found.items()):
            if isinstance(solution, str):
                table.status[place], notes[place] = REFUSED, Note(solution)
                continue
            parts.append(_between(whole, (edge, int(edges[place])), (window, int(places[place]))))
            edge, window = int(edges[place]), int(places[place])
            parts.append(self._marched(table, place, solution))
            notes[place] = _note(solution)
        if parts:
            parts.append(_between(whole, (edge, len(whole.edges)), (window, len(whole.readouts))))
            whole = Packed(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        return Block(chunk, replace(table, notes=notes), whole)

    def packed(self, batch: Batch | None) -> Packed:
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
        table.excess[place] = error.excess(accuracy.allowed(error.scale))
        table.largest[place], table.sizes[place] = error.largest, march.scale
        return Packed(march.edges, march.states, march.readouts, error.series, error.floors)


def _note(solution: Solution) -> Note:
    """Return what the table and the windows do not contain of a solution."""
    error: Any = solution.error
    return Note(solution.message, packed(solution.record)[1], tuple(error.scale.tolist()))


def _between(packed: Packed, edges: tuple[int, int], windows: tuple[int, int]) -> Packed:
    """Return the windows of some members of a batch."""
    return packed._replace(
        edges=packed.edges[slice(*edges)],
        states=packed.states[slice(*edges)],
        readouts=packed.readouts[slice(*windows)],
    )
