"""Solution of many initial-value problems of one Hamiltonian in tensors, on a device of torch.

Input:  a Hamiltonian, initial states and parameter values, a span, a tolerance, a device.
Output: :class:`~hamsym.random_features.members.Batch`, as from the compiled loop.

Stage 1  March all members of a chunk, which fits in memory, window by window
         (:mod:`hamsym.random_features.tensor_march`).
Stage 2  Estimate the errors and check the windows (:mod:`hamsym.random_features.tensor_errors`).
Stage 3  March the members whose error is too large again, to a tighter local tolerance.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from hamsym.codegen.generate import generate
from hamsym.codegen.system import load
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian
from hamsym.random_features.basis import FeatureBasis
from hamsym.random_features.error_estimate import (
    disturbances,
    error_tables,
    halves,
    kicks,
    resolution_for,
)
from hamsym.random_features.error_loop import PERTURBATIONS, TIGHTER
from hamsym.random_features.flow import has_rounded_numbers, stored_entries
from hamsym.random_features.march import node_signs, origin_of, shortest_window
from hamsym.random_features.member_loop import ATTEMPTS, MARGIN, MOST, SMALLEST, STEP
from hamsym.random_features.members import MAX_WINDOWS, Batch, MemberSolver
from hamsym.random_features.tensor_errors import (
    Errors,
    ErrorSettings,
    ErrorTables,
    Half,
    Path,
    carry_errors,
    keeps_energy,
    narrow,
)
from hamsym.random_features.tensor_march import (
    Functions,
    MarchTables,
    Settings,
    evaluate,
    first_lengths,
    march,
    take,
)
from hamsym.random_features.window_loop import TINY, Windows
from hamsym.solution.window_error import relative_tolerance

__all__ = ["TensorSolver", "checked_device"]

_WINDOWS = 32  # of a member, expected before the first chunk is solved
_ARRAYS = 8  # of the size of the vectors of the estimate, in use at one time
_COPIES = 6  # of the windows of a chunk, while they are arranged
_IN_CACHE = 2**22  # numbers in the tensors of a chunk on a processor, which its caches hold


def checked_device(device: Any) -> torch.device:
    """Return a device of torch that computes in float64.

    Raises
    ------
    InputError
        If there is none of this name here.
    """
    try:
        found = torch.device(device)
        torch.zeros(1, dtype=torch.float64, device=found)
    except (AssertionError, NotImplementedError, RuntimeError, TypeError, ValueError):
        has = '"cpu" or "cuda"' if torch.cuda.is_available() else '"cpu"'
        raise InputError(
            f"device={device!r} cannot be used here; give {has}, or another device of torch that "
            "computes in float64"
        ) from None
    return found


class TensorSolver(MemberSolver):
    """Solver of members of one Hamiltonian over one span, all members of a chunk at once.

    Parameters
    ----------
    H, span, tol, local, atol, longest, basis
        See :class:`~hamsym.random_features.members.MemberSolver`.
    device : str or torch.device
    """

    def __init__(
        self,
        H: Hamiltonian,
        span: tuple[float, float],
        tol: float,
        local: float,
        atol: np.ndarray,
        longest: float,
        basis: FeatureBasis,
        device: str | torch.device = "cuda",
    ) -> None:
        self.H, self.span, self.basis = H, span, basis
        self.origin = origin_of(H.time is None, span)
        self.device = checked_device(device)
        self._local, self._tolerance = local, relative_tolerance(tol)
        self._absolute = self._tensor(atol)[:, None]
        self._start, self._end = (time - self.origin for time in span)
        equations = H.kernels.equations
        self._kinds = torch.tensor(
            [int(kind) for _, kind in equations.narrow_arguments], device=self.device
        )
        system = load(generate(equations, "torch"))
        self._functions = Functions(
            *(system.function(f"{name}_rows") for name in Functions._fields)
        )
        columns = basis.series.shape[1]
        rows = basis.tables
        self._march_tables = MarchTables(
            nodes=self._tensor(rows.nodes),
            integration=self._tensor(rows.integration),
            fit=self._tensor(rows.fit[:, :columns]),
            between=self._tensor(rows.between),
            to_between=self._tensor(rows.to_between[:columns]),
            rates_between=self._tensor(rows.rates_between[:columns]),
            end=self._tensor(rows.end[:columns]),
            end_low=self._tensor(rows.end_low[:columns]),
            extrapolation=self._tensor(rows.extrapolation),
        )
        self._settings = Settings(
            end=self._end,
            longest=longest,
            shortest=shortest_window(self._start, self._end),
            order=float(rows.order[0]),
            signs=self._tensor(node_signs(basis, H.dim))[:, None],
            separable=H.is_separable,
            rounds=MAX_WINDOWS,
        )
        tables = error_tables(basis, resolution_for(local))
        self._error_tables = ErrorTables(
            *(self._tensor(getattr(tables, name)) for name in ErrorTables._fields)
        )
        entries = stored_entries(equations)
        forces, velocities = halves(entries, np.ones(H.dim), not H.forces)
        self._error_settings = ErrorSettings(
            forces=Half.of(forces, H.dof, -1.0),
            velocities=Half.of(velocities, H.dof, 1.0),
            entries=len(entries),
            whole=abs(self._end - self._start),
            rounded=float(any(map(has_rounded_numbers, equations.formulas))),
            signs=self._tensor(disturbances(tables.places.shape, H.dim))[:, :, None],
            kicks=self._tensor(kicks(H.dim))[..., None],
        )
        self._windows = float(_WINDOWS)

    def _tensor(self, array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=torch.float64, device=self.device)

    def solve(self, states: np.ndarray, parameters: np.ndarray, *, keep_error: bool) -> Batch:
        """Solve members from states of shape (members, dim) with parameters (members, k)."""
        first, parts = 0, []
        with torch.inference_mode():
            while first < len(states):
                most, room = self._limits()
                count = min(most, len(states) - first)
                part = self._solved(
                    states[first : first + count],
                    parameters[first : first + count],
                    keep_error,
                    math.inf if count == 1 else room,
                )
                if part is None:
                    self._windows *= 4
                    continue
                parts.append(part)
                first += count
                self._windows = 1.2 * max(1.0, float(part.counts.mean()))
        if len(parts) == 1:
            return parts[0]
        names = Batch.__dataclass_fields__
        return Batch(*(np.concatenate([getattr(p, name) for p in parts]) for name in names))

    def _limits(self) -> tuple[int, float]:
        """Members of the next chunk, and windows for which there is room."""
        vectors = self.H.dim * (PERTURBATIONS + 2) * len(self._error_tables.nodes)
        window = self.H.dim * self.basis.series.shape[1]
        if self.device.type == "cuda":
            # Half of what is free, and of what torch has reserved and does not use.
            free = torch.cuda.mem_get_info(self.device)[0]
            free += torch.cuda.memory_reserved(self.device)
            numbers = (free - torch.cuda.memory_allocated(self.device)) / 16
        else:
            numbers = _IN_CACHE
        room = max(numbers, 2**22) / (_COPIES * window)
        members = min(numbers / (_ARRAYS * vectors), room / self._windows)
        return max(1, int(members)), room

    def _solved(
        self, states: np.ndarray, parameters: np.ndarray, keep_error: bool, room: float
    ) -> Batch | None:
        """Solve a chunk of members; return None if their windows need more than the room."""
        z = self._tensor(states.T.copy())
        values = self._tensor(parameters.T.copy())[..., None]
        count = z.shape[1]
        start = torch.full((count, 1), self._start, dtype=torch.float64, device=self.device)
        place = z[..., None]
        rates = evaluate(self._functions, place, start, values, torch.empty_like(place))
        lengths = first_lengths(self._functions, z, rates, values, (self._start, self._end))
        todo = torch.arange(count, device=self.device)
        local = torch.full_like(lengths, self._local)
        evaluations = torch.full_like(todo, 2)
        accepted = torch.zeros_like(todo, dtype=torch.bool)
        excess = torch.full_like(lengths, math.inf)
        largest, sizes = torch.full_like(z, math.inf), z.abs()
        parts = []
        for _attempt in range(ATTEMPTS):
            own = take(values, todo)
            marched = march(
                self._functions,
                self._march_tables,
                self._settings,
                self._start,
                take(z, todo),
                take(rates, todo),
                lengths[todo],
                evaluations[todo],
                local[todo],
                own,
                room,
            )
            if marched is None:
                return None
            evaluations[todo], sizes[:, todo] = marched.evaluations, marched.sizes
            ended = marched.finished[marched.member].nonzero()[:, 0]
            path = Path.of(
                self._start, take(z, todo), *(take(windows, ended) for windows in marched[3:])
            )
            errors = carry_errors(
                self._functions,
                self._march_tables,
                self._error_tables,
                self._error_settings,
                path,
                marched.sizes,
                local[todo],
                own,
                keep_error,
            )
            allowed = (self._absolute + self._tolerance * marched.sizes).clamp(min=TINY)
            ratios = torch.where(errors.largest == 0.0, 0.0, errors.largest / allowed).amax(0)
            ratios = torch.where(errors.bent, ratios.clamp(min=TIGHTER), ratios)
            known = errors.known
            largest[:, todo] = torch.where(known, errors.largest, largest[:, todo])
            excess[todo] = torch.where(known, ratios, excess[todo])
            good = known & (ratios <= 1.0) & ~errors.marked
            if self.H.conserves_energy:
                energies = path, marched.sizes, local[todo], own
                good &= keeps_energy(self._functions, *energies)
            if len(self._kinds):
                good &= self._passes_narrow(path, good, marched.sizes, own)
            accepted[todo] = good
            parts.append(_Part.of(path, errors, good, todo))
            tighter = known & ~(ratios <= 1.0) & (ratios < math.inf) & (local[todo] > SMALLEST)
            todo = todo[tighter]
            if not len(todo):
                break
            factor = (MARGIN / excess[todo]).clamp(STEP, MOST)
            local[todo] = (local[todo] * factor).clamp(min=SMALLEST)
        part = _Part.joined(parts)
        counts = part.window_owner.bincount(minlength=count)
        return Batch(
            accepted=_array(accepted),
            counts=_array(counts),
            evaluations=_array(evaluations),
            excess=_array(excess),
            largest=_array(largest.T),
            sizes=_array(sizes.T),
            edges=_array(part.edges),
            states=_array(part.states.T),
            readouts=_array(part.readouts.permute(1, 2, 0)),
            series=_array(part.series.permute(1, 2, 0)),
            floors=_array(part.floors.T),
        )

    def _passes_narrow(
        self, path: Path, members: Tensor, sizes: Tensor, parameters: Tensor
    ) -> Tensor:
        """Check windows of members in which H may act briefly, on the host."""
        marks = narrow(self._functions, self._error_tables, self._kinds, path, parameters)
        marks &= members[path.member]
        passed = torch.ones_like(members)
        for index in path.member[marks].unique().tolist():
            first, count = int(path.firsts[index]), int(path.counts[index])
            edges = slice(first + index, first + index + count + 1)
            one = Windows(
                _array(path.edges[edges]),
                _array(path.states[:, edges].T),
                _array(path.readouts[:, first : first + count].permute(1, 2, 0)),
            )
            suspects = np.flatnonzero(_array(marks[first : first + count]))
            values = _array(parameters[:, index, 0])
            passed[index] = self._passes(one, suspects, _array(sizes[:, index]), values)
        return passed


class _Part(NamedTuple):
    """Windows of accepted members, those of each member in order.

    Attributes
    ----------
    window_owner, edge_owner : (windows,), (edges,)
        Number of the member in the chunk.
    edges, states : (edges,), (dim, edges)
    readouts : (dim, windows, m)
    series, floors : (dim, windows, k), (dim, windows)
        Of the error; without windows if they were not asked for.
    """

    window_owner: Tensor
    edge_owner: Tensor
    edges: Tensor
    states: Tensor
    readouts: Tensor
    series: Tensor
    floors: Tensor

    @classmethod
    def of(cls, path: Path, errors: Errors, members: Tensor, numbers: Tensor) -> _Part:
        """Select the members in a mask; ``numbers`` are their numbers in the chunk."""
        windows = members[path.member].nonzero()[:, 0]
        owners = path.owners
        edges = members[owners].nonzero()[:, 0]
        stored = windows if errors.series.shape[1] else windows[:0]
        return cls(
            numbers[path.member[windows]],
            numbers[owners[edges]],
            path.edges[edges],
            take(path.states, edges),
            take(path.readouts, windows),
            take(errors.series, stored),
            take(errors.floors, stored),
        )

    @classmethod
    def joined(cls, parts: list[_Part]) -> _Part:
        """Join parts; a member's windows are in one of them."""
        if len(parts) == 1:
            return parts[0]
        whole = cls(
            *(torch.cat(some, min(some[0].dim() - 1, 1)) for some in zip(*parts, strict=True))
        )
        windows = whole.window_owner.argsort(stable=True)
        edges = whole.edge_owner.argsort(stable=True)
        stored = windows if whole.series.shape[1] else windows[:0]
        orders = (windows, edges, edges, edges, windows, stored, stored)
        return cls(*map(take, whole, orders))


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.contiguous().cpu().numpy()  # type: ignore[no-any-return]
