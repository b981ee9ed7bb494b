"""Sweeps over a grid of parameters, starts and energies, to a store on disk.

Input:  a Hamiltonian, the axes of the grid, a task: solve, lyapunov, section or a function.
Output: a store of zarr, written box by box; a box that is written is never computed again.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Generator, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import hamsym
from hamsym.errors import InputError
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.parallel.cluster import Task, ThreadCount, cluster_results, require_client
from hamsym.problems.description import described
from hamsym.problems.ensemble import Ensemble, ensemble_of
from hamsym.problems.problem import checked_span
from hamsym.study.grid_stores import Box, GridStore, box_shape, store_at
from hamsym.study.grid_tasks import Columns, checked_options, computed
from hamsym.support.locking import exclusive
from hamsym.support.progress import stepping_progress
from hamsym.support.shown import Shown
from hamsym.support.suggestions import suggest_attributes
from hamsym.support.tables import data_frame
from hamsym.support.validation import plain, require_whole

if TYPE_CHECKING:  # optional packages
    import pandas
    from distributed import Client
    from matplotlib.figure import Figure

_MOST = {"solve": 1_024, "lyapunov": 1_024}  # points of a box
_MOST_ALONE = 16  # of tasks that treat one point at a time
_SHARES = 4  # boxes for each thread of a cluster, at least
# Names of variables and of other axes.
_RESERVED = {
    *("state", "largest_error", "excess", "success", "message", "exponent", "energy_error"),
    *("steps", "count", "t", "z", "drift", "z0", "done", "time", "component", "rank", "crossing"),
}


@suggest_attributes
@dataclass(frozen=True)
class StoredSweep(Shown):
    """A sweep over a grid in a store.

    Attributes
    ----------
    path : pathlib.Path
        The store: ``xarray.open_zarr(path)`` reads it.
    shape : tuple of int
        Lengths of the axes of the grid.
    done : int
        Points in the store.
    interrupted : bool
        Whether Ctrl-C ended the sweep; the same call continues it.
    store : GridStore
    """

    path: Path
    shape: tuple[int, ...]
    done: int
    interrupted: bool
    store: GridStore

    @property
    def complete(self) -> bool:
        """Whether all points are in the store."""
        return self.done == int(np.prod(self.shape))

    def open(self) -> Any:
        """Open the store as an ``xarray.Dataset``.

        Raises
        ------
        InputError
            If xarray is not installed.
        """
        return self.store.open()

    def values(self) -> dict[str, np.ndarray]:
        """Return what has one value at each point of the grid, by name, each of ``shape``.

        A component or an exponent is an array of its own, ``z0_x`` or ``exponent_1``; what has a
        value for each time or crossing is only in the store. Points that are not ``done`` have nan,
        False or "".

        Raises
        ------
        InputError
            If zarr is not installed.
        """
        return self.store.values()

    def to_dataframe(self) -> pandas.DataFrame:
        """Return :meth:`values` as a table of pandas with a row for each point of the grid.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        grid = np.meshgrid(*self.store.axes.values(), indexing="ij")
        axes = {name: each.ravel() for name, each in zip(self.store.axes, grid, strict=True)}
        found = {name: each.ravel() for name, each in self.values().items()}
        attributes = {n: v for n, v in self.store.attributes.items() if n != "request"}
        return data_frame({**axes, **found}, attributes=attributes)

    def plot(self, *names: str, at: Mapping[str, float] | None = None, ax: Any = None) -> Figure:
        """Draw values over one axis of the grid, or in the plane of two; failed points are red.

        Parameters
        ----------
        *names : str
            One of :meth:`values`. By default ``excess``, the error in parts of what was asked for,
            of solutions, the first exponent and the energy error, the number of crossings, or what
            a function returned.
        at : mapping, optional
            Name of an axis -> its value, the nearest of the grid. By default a grid of more than
            two axes is drawn at the first values of all but the first two.
        ax : matplotlib.axes.Axes, optional
            Axes to draw one panel into, in your own style.

        Raises
        ------
        InputError
            If a name is unknown, or ``ax`` is given for several panels.
        """
        return hamsym.plot(self, *names, at=at, ax=ax)

    def __repr__(self) -> str:
        size = int(np.prod(self.shape))
        return f"StoredSweep({self.path.name!r}, shape {self.shape}: {self.done:,} of {size:,})"


def sweep_to_store(
    H: HamiltonianLike,
    z0: Any,
    span: tuple[float, float],
    over: Mapping[str, Any],
    task: str | Callable[..., Mapping[str, Any]],
    store: str | os.PathLike[str],
    options: Mapping[str, Any],
    *,
    chunk: int | None = None,
    progress: bool | None = None,
    client: Client | None = None,
    retries: int = 3,
) -> StoredSweep:
    """Carry out a task at all points of a grid; see :func:`hamsym.sweep`."""
    times = checked_span(span)
    members, axes = _members(H, z0, times, over)
    given = checked_options(task, options, times, members.H)
    parts = {f"{head}_{name}" for head in ("z0", "largest_error") for name in members.H.names}
    taken = {*_RESERVED, *axes, *members.varied, *parts} & {*(given.get("values") or ())}
    if task == "solve" and taken:
        raise InputError(f"'{min(taken)}' in values is a name of the store; choose another")
    most = _MOST.get(task, _MOST_ALONE) if isinstance(task, str) else _MOST_ALONE
    if chunk is not None:
        require_whole("chunk", chunk)
        most = chunk
    elif client is not None:
        require_client(client)
        most = max(1, min(most, len(members) // (_SHARES * ThreadCount(client)())))
    coordinates: dict[str, list[Any]] = {"component": list(members.H.names)}
    if "t" in given and task == "solve":
        coordinates["time"] = given["t"].tolist()
    if task == "lyapunov":
        coordinates["rank"] = list(range(1, 1 + int(given.get("count", 1))))
    place = store_at(
        store,
        axes=axes,
        coordinates=coordinates,
        attributes=_attributes(members, times, task, given),
        box=box_shape(members.shape, most),
    )
    if task == "section" and given.get("crossings") is None:
        raise InputError(
            "a store needs the length of its rows; give crossings=, the most that are kept of each "
            "trajectory"
        )
    if not place.path.parent.is_dir():
        raise InputError(f"the folder of store={str(store)!r} does not exist; make it first")
    with exclusive(place.path, place.path.with_name(f".{place.path.name}.lock")):
        run = _Run(place.opened(), members, times, task, given)
        missing = run.store.missing() if run.store.token else run.store.boxes
        left = sum(map(run.size, missing))
        interrupted = False
        with stepping_progress(len(members), progress, "sweep") as report:
            report(len(members) - left)
            results = run.here(missing) if client is None else run.on(client, missing, retries)
            with closing(results):
                try:
                    for box in results:
                        left -= run.size(box)
                        report(run.size(box))
                except KeyboardInterrupt:
                    interrupted = True
        if not left:
            run.store.complete()
    return StoredSweep(place.path, members.shape, len(members) - left, interrupted, run.store)


class _Run:
    """A sweep over a grid that is being carried out."""

    def __init__(
        self,
        store: GridStore,
        members: Ensemble,
        span: tuple[float, float],
        task: Any,
        options: Mapping[str, Any],
    ) -> None:
        self.store, self._members = store, members
        self._job = task, span, options
        self._numbers = np.arange(len(members)).reshape(members.shape)

    def size(self, box: Box) -> int:
        """Return the number of points of a box."""
        return int(self._numbers[box].size)

    def here(self, boxes: list[Box]) -> Generator[Box, None, None]:
        """Yield boxes after they are computed in this process and written."""
        for box in boxes:
            self._write(box, _computed(self._job, None, box, self._of(box)))
            yield box

    def on(self, client: Client, boxes: list[Box], retries: int) -> Generator[Box, None, None]:
        """Yield boxes after they are computed on a cluster and written."""
        # The first box tells the variables of the store, which workers write to after that.
        parts = [boxes] if self.store.token else [boxes[:1], boxes[1:]]
        for part in parts:
            write = self.store if self.store.token else None
            tasks = (Task(self._numbers[box].ravel(), (write, box, self._of(box))) for box in part)
            results = cluster_results(client, _computed, self._job, tasks, retries=retries)
            with closing(results):
                for task, columns, _ in results:
                    box = task.arguments[1]
                    if columns is not None:
                        self._write(box, columns)
                    yield box

    def _of(self, box: Box) -> Ensemble:
        """Return the members of a box."""
        members, own = self._members, self._numbers[box].ravel()
        values = members.states[own], members.parameters[own]
        return Ensemble(members.H, *values, own.shape, members.varied)

    def _write(self, box: Box, columns: Columns | None) -> None:
        assert columns is not None
        if not self.store.token:
            self.store = self.store.begun(columns)
        self.store.write(box, columns)


def _computed(
    job: tuple[Any, tuple[float, float], Mapping[str, Any]],
    store: GridStore | None,
    box: Box,
    members: Ensemble,
) -> Columns | None:
    """Compute a box, and write it to the store if this process reaches it; else return it."""
    task, span, options = job
    columns = computed(task, members, span, options)
    if store is None or not store.is_reached():
        return columns
    store.write(box, columns)
    return None


def _members(
    H: HamiltonianLike, z0: Any, span: tuple[float, float], over: Mapping[str, Any]
) -> tuple[Ensemble, dict[str, np.ndarray]]:
    """Return the points of the grid, and the values of its axes.

    Raise InputError if an axis is neither a parameter, a component nor the energy, or its values
    are not different finite numbers.
    """
    H = Hamiltonian.of(H, bound=False)
    if not isinstance(over, Mapping) or not over:
        raise InputError(f'over={over!r} is not a mapping; give for example {{"k": [1.0, 2.0]}}')
    axes: dict[str, np.ndarray] = {}
    for name, values in over.items():
        known = (*H.parameter_names, *H.names, "energy")
        if name not in known:
            raise InputError(f"'{name}' in over is unknown; give some of {', '.join(known)}")
        if name in _RESERVED:
            raise InputError(f"'{name}' in over is a name of the store; rename it in H")
        try:
            axis = np.asarray(values, dtype=float)
        except (TypeError, ValueError):
            axis = np.empty(0)
        if axis.ndim != 1 or not len(axis) or not np.isfinite(axis).all():
            raise InputError(f"over[{name!r}] is not a list of finite numbers; give one")
        if len(np.unique(axis)) < len(axis):
            raise InputError(f"over[{name!r}] repeats a value; give each once")
        axes[name] = axis
    grid = dict(zip(axes, np.meshgrid(*axes.values(), indexing="ij"), strict=True))
    values = {name: grid[name] for name in grid if name in H.parameter_names}
    energy = grid.get("energy") if "energy" not in (*values, *H.names) else None
    starts = {name: grid[name] for name in grid if name in H.names}
    if starts or energy is not None:
        if not isinstance(z0, Mapping):
            if energy is not None:
                raise InputError(
                    "an energy determines one component; give z0 as a mapping without it"
                )
            z0 = dict(zip(H.names, H.state_from(z0), strict=True))
        z0 = {**z0, **starts}
    if energy is not None:
        z0 = H.state_at_energy(energy, z0, span[0], values or None, missing="nan")
    shape = tuple(len(axis) for axis in axes.values())
    members = ensemble_of(H, z0, values or None, finite=energy is None)
    if members.shape != shape:
        if members.shape and members.shape != (1,):
            raise InputError("z0 is not one state; vary its components in over")
        raise InputError("no axis of the grid changes the problem; vary a parameter or component")
    return members, axes


def _attributes(
    members: Ensemble, span: tuple[float, float], task: Any, options: Mapping[str, Any]
) -> dict[str, Any]:
    """Return what was asked for, as JSON values, and its digest."""
    H = members.H
    fixed = {name: H.parameters[name] for name in H.parameter_names if name not in members.varied}
    values: dict[str, Any] = {
        "H": H.formulas,
        "parameters": fixed,
        "span": list(span),
        "task": task if isinstance(task, str) else f"{task.__module__}.{task.__qualname__}",
        "options": {name: repr(plain(value)) for name, value in sorted(options.items())},
        "version": hamsym.__version__,
    }
    found = hashlib.sha256(json.dumps([values, described(H)], sort_keys=True).encode())
    for array in (members.states, members.parameters):
        found.update(f"{array.shape} ".encode() + array.tobytes())
    found.update(repr(members.shape).encode())
    return {**values, "request": found.hexdigest()}
