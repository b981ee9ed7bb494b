"""Stores of a sweep over a grid: zarr, for xarray, and parquet, for pandas.

Input:  columns of the points of a box of the grid.
Output: a store in which each box is either there as a whole, or known to be missing.

Boxes are the chunks of zarr, and the files of parquet, so that processes that write different boxes
never touch the same file.
"""

from __future__ import annotations

import itertools
import json
import math
import os
import uuid
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hamsym.errors import FileError, InputError
from hamsym.families.parts import zarr_of
from hamsym.study.grid_tasks import Columns
from hamsym.support.atomic import create_atomically, write_atomically

__all__ = ["Box", "GridStore", "box_shape", "store_at"]

Box = tuple[slice, ...]

_LONG = ("time", "crossing")  # axes that are rows of a table; others are columns
_HEAD = "_hamsym.json"  # names that begin with _ are no data to readers of parquet


def box_shape(shape: Sequence[int], most: int) -> tuple[int, ...]:
    """Return the shape of boxes of at most ``most`` points: whole rows as far as possible."""
    found: list[int] = []
    for length in reversed(shape):
        found.insert(0, max(1, min(length, most)))
        most //= found[0]
    return tuple(found)


@dataclass(frozen=True)
class GridStore:
    """A store, which a worker of a cluster may write to.

    Attributes
    ----------
    path : pathlib.Path
    axes : dict of str to numpy.ndarray
        Names of the axes of the grid, with their values.
    coordinates : dict of str to list
        Values of other axes.
    attributes : dict
        What was asked for, with ``request``, its SHA-256.
    box : tuple of int
        Shape of the boxes.
    token : str
        Text by which a worker recognises the store.
    """

    path: Path
    axes: Mapping[str, np.ndarray] = field(repr=False)
    coordinates: Mapping[str, list[Any]] = field(repr=False)
    attributes: Mapping[str, Any] = field(repr=False)
    box: tuple[int, ...]
    token: str = ""

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of the axes of the grid."""
        return tuple(len(values) for values in self.axes.values())

    @property
    def boxes(self) -> list[Box]:
        """All boxes, in order."""
        edges = [
            [slice(first, min(first + step, length)) for first in range(0, length, step)]
            for length, step in zip(self.shape, self.box, strict=True)
        ]
        return list(itertools.product(*edges))

    def opened(self) -> GridStore:
        """Return the store with the boxes and the token of the one at its path, if there is one.

        Raises
        ------
        FileError
            If the path holds anything else, or the store of another request.
        """
        if not self.path.exists():
            return self
        try:
            head = self._head()
        except (OSError, ValueError, KeyError):
            head = {}
        if head.get("request") != self.attributes["request"]:
            raise FileError(
                f"'{self.path}' exists; give the path of a new store, or the arguments with which "
                "this one was begun"
            )
        return replace(self, box=tuple(head["box"]), token=head["token"])

    def is_reached(self) -> bool:
        """Whether this process reaches the store."""
        try:
            return bool(self.token) and self._head()["token"] == self.token
        except (OSError, ValueError, KeyError):
            return False

    def begun(self, columns: Columns) -> GridStore:
        """Create the store for columns like these, and return it.

        Raises
        ------
        FileError
            If it cannot be written.
        """
        store = replace(self, token=uuid.uuid4().hex)
        head = {**self.attributes, "box": list(self.box), "token": store.token}
        try:
            create_atomically(
                self.path, lambda aside: replace(store, path=aside)._create(columns, head)
            )
        except OSError as error:
            raise FileError(f"'{self.path}' cannot be written: {error.strerror or error}") from None
        return store

    def missing(self) -> list[Box]:
        """Return the boxes that are not written."""
        raise NotImplementedError

    def write(self, box: Box, columns: Columns) -> None:
        """Write a box."""
        raise NotImplementedError

    def complete(self) -> None:
        """Mark the store as complete."""

    def open(self) -> Any:
        """Open the store with the package that reads it."""
        raise NotImplementedError

    def values(self) -> dict[str, np.ndarray]:
        """Return what has one value at each point, in arrays of the shape of the grid.

        An exponent or a component is an array of its own, ``exponent_1`` or ``z0_x``. ``done``
        tells which points are in the store; others have nan, False or "".
        """
        raise NotImplementedError

    def _labels(self, axes: tuple[str, ...], shape: tuple[int, ...]) -> list[str]:
        names = [
            [f"_{label}" for label in self.coordinates.get(axis, range(length))]
            for axis, length in zip(axes, shape, strict=True)
        ]
        return ["".join(parts) for parts in itertools.product(*names)]

    def _head(self) -> dict[str, Any]:
        raise NotImplementedError

    def _create(self, columns: Columns, head: dict[str, Any]) -> None:
        raise NotImplementedError


class _ZarrStore(GridStore):
    """A group of zarr with named axes: a dataset of xarray."""

    def _head(self) -> dict[str, Any]:
        found = json.loads((self.path / "zarr.json").read_text("utf-8"))
        return dict(found["attributes"]["hamsym"])

    def _create(self, columns: Columns, head: dict[str, Any]) -> None:
        group = zarr_of().open_group(self.path, mode="w-")
        for name, values in {**self.axes, **self.coordinates}.items():
            column = np.asarray(values)
            self._array(group, name, (name,), column.shape, column.shape, column.dtype)
            group[name][...] = column.astype(object) if column.dtype.kind == "U" else column
        for name, (axes, values) in {**columns, "done": ((), np.zeros(0, bool))}.items():
            inner = values.shape[1:]
            chunks = (*self.box, *(max(1, length) for length in inner))
            names = (*self.axes, *axes)
            self._array(group, name, names, (*self.shape, *inner), chunks, values.dtype)
        shown = {name: head[name] for name in ("H", "parameters", "span", "task", "options")}
        group.attrs.update({**shown, "version": head["version"], "complete": 0})
        group.attrs["hamsym"] = head  # last: without it the group is no store

    @staticmethod
    def _array(
        group: Any,
        name: str,
        axes: tuple[str, ...],
        shape: tuple[int, ...],
        chunks: tuple[int, ...],
        dtype: np.dtype,
    ) -> None:
        text = dtype.kind in "OU"
        fill: Any = math.nan if dtype.kind == "f" else "" if text else dtype.type(0)
        group.create_array(
            name,
            shape=shape,
            chunks=chunks,
            dtype=str if text else dtype,
            dimension_names=axes,
            fill_value=fill,
        )

    def missing(self) -> list[Box]:
        done = np.asarray(zarr_of().open_group(self.path, mode="r")["done"][...])
        return [box for box in self.boxes if not done[box].all()]

    def write(self, box: Box, columns: Columns) -> None:
        group = zarr_of().open_group(self.path, mode="r+")
        size = tuple(part.stop - part.start for part in box)
        for name, (_, values) in columns.items():
            group[name][box] = values.reshape(*size, *values.shape[1:])
        group["done"][box] = np.ones(size, dtype=bool)  # last: a box without it is missing

    def complete(self) -> None:
        zarr = zarr_of()
        zarr.open_group(self.path, mode="r+").attrs["complete"] = 1
        with warnings.catch_warnings():
            # xarray opens it faster so; version 3 of the format does not specify it yet.
            warnings.simplefilter("ignore", UserWarning)
            zarr.consolidate_metadata(self.path)

    def _is_complete(self) -> bool:
        found = json.loads((self.path / "zarr.json").read_text("utf-8"))
        return bool(found["attributes"]["complete"])

    def open(self) -> Any:
        try:
            import xarray
        except ImportError:
            raise _missing("xarray") from None
        return xarray.open_zarr(self.path, consolidated=None if self._is_complete() else False)

    def values(self) -> dict[str, np.ndarray]:
        group = zarr_of().open_group(self.path, mode="r")
        found: dict[str, np.ndarray] = {}
        for name, array in group.arrays():
            axes = tuple(array.metadata.dimension_names or ())
            inner = axes[len(self.shape) :]
            if axes[: len(self.shape)] != tuple(self.axes) or {*inner} & {*_LONG}:
                continue
            whole = np.asarray(array[...])
            rest = whole.reshape(*self.shape, -1)
            for k, label in enumerate(self._labels(inner, whole.shape[len(self.shape) :])):
                found[name + label] = rest[..., k]
        return found


class _ParquetStore(GridStore):
    """A folder of parquet files, one for each box: a table of pandas."""

    def _head(self) -> dict[str, Any]:
        return dict(json.loads((self.path / _HEAD).read_text("utf-8")))

    def _create(self, columns: Columns, head: dict[str, Any]) -> None:
        _parquet()
        self.path.mkdir(parents=True)
        write_atomically(self.path / _HEAD, json.dumps(head | {"complete": 0}).encode())

    def _file(self, box: Box) -> Path:
        return self.path / ("part" + "".join(f"-{part.start:06d}" for part in box) + ".parquet")

    def missing(self) -> list[Box]:
        return [box for box in self.boxes if not self._file(box).exists()]

    def write(self, box: Box, columns: Columns) -> None:
        arrow, parquet = _parquet()
        table = arrow.table(self._rows(box, columns))
        file = self._file(box)
        aside = file.with_name(f".{file.name}-{uuid.uuid4().hex}")
        parquet.write_table(table, aside)
        os.replace(aside, file)

    def _rows(self, box: Box, columns: Columns) -> dict[str, np.ndarray]:
        """Return a row for each point, time and crossing; a point without crossings has one."""
        points = np.meshgrid(
            *(values[part] for values, part in zip(self.axes.values(), box, strict=True)),
            indexing="ij",
        )
        long = {axes[0]: values.shape[1] for axes, values in columns.values() if axes[:1] in _ROWS}
        (length,) = long.values() or (1,)
        count = points[0].size
        place, row = (index.ravel() for index in np.indices((count, length)))
        if "crossing" in long:
            kept = row < np.maximum(columns["count"][1][place], 1)
            place, row = place[kept], row[kept]
        found = {name: grid.ravel()[place] for name, grid in zip(self.axes, points, strict=True)}
        if "time" in long:
            found["time"] = np.asarray(self.coordinates["time"])[row]
        for name, (axes, values) in columns.items():
            is_long = axes[:1] in _ROWS
            own = values[place, row] if is_long else values[place]
            inner, rest = axes[is_long:], own.reshape(len(own), -1)
            labels = self._labels(inner, own.shape[1:])
            for k, label in enumerate(labels):
                found[name + label] = rest[:, k]
        return found

    def complete(self) -> None:
        head = self._head() | {"complete": 1}
        write_atomically(self.path / _HEAD, json.dumps(head).encode())

    def open(self) -> Any:
        try:
            import pandas
        except ImportError:
            raise _missing("pandas") from None
        return pandas.read_parquet(self.path)

    def values(self) -> dict[str, np.ndarray]:
        written = [box for box in self.boxes if self._file(box).exists()]
        done = np.zeros(self.shape, dtype=bool)
        found: dict[str, np.ndarray] = {"done": done}
        if not written:
            return found
        # Of each point the first row: others are further times or crossings.
        table = self.open().drop_duplicates(list(self.axes))
        place = []
        for name, axis in self.axes.items():
            order = np.argsort(axis)
            place.append(order[np.searchsorted(axis, table[name], sorter=order)])
        done[tuple(place)] = True
        of_rows = _OF_ROWS.get(self.attributes["task"], ())
        for name in table.columns:
            if name in self.axes or name.startswith(of_rows):
                continue
            column = table[name].to_numpy()
            fill: Any = {"b": False, "O": ""}.get(column.dtype.kind, math.nan)
            kind = float if column.dtype.kind in "iu" else column.dtype
            found[name] = np.full(self.shape, fill, dtype=kind)
            found[name][tuple(place)] = column
        return found


_ROWS = [(name,) for name in _LONG]
#: How columns begin that have a value for each time or crossing, by task.
_OF_ROWS = {"solve": ("time", "state_"), "section": ("t", "z_")}
_KINDS: dict[str, type[GridStore]] = {".zarr": _ZarrStore, ".parquet": _ParquetStore}


def store_at(path: str | os.PathLike[str], **values: Any) -> GridStore:
    """Return the store of the kind that the ending of the path tells.

    Raises
    ------
    InputError
        If the path ends with neither ``.zarr`` nor ``.parquet``, or the package is missing.
    """
    try:
        place = Path(os.path.abspath(path))
    except TypeError:
        place = Path()
    if place.suffix not in _KINDS:
        raise InputError(f"store={path!r} cannot be used; give a path that ends .zarr or .parquet")
    if place.suffix == ".zarr":
        zarr_of()
    else:
        _parquet()
    return _KINDS[place.suffix](path=place, **values)


def _parquet() -> tuple[Any, Any]:
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise _missing("pyarrow") from None
    return pyarrow, pyarrow.parquet


def _missing(package: str) -> InputError:
    return InputError(
        f"this store needs the package {package}, which is not installed; install it with "
        f"pip install {package}"
    )
