"""Stores of a sweep over a grid: groups of zarr, which xarray opens.

Input:  columns of the points of a box of the grid.
Output: a store in which each box is either there as a whole, or known to be missing.

Boxes are the chunks of zarr, so that processes that write different boxes never touch the same
file.
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
from hamsym.study.grid_tasks import Columns
from hamsym.support.atomic import create_atomically
from hamsym.support.tables import optional_package

Box = tuple[slice, ...]

_LONG = ("time", "crossing")  # axes along which a point has many values


def box_shape(shape: Sequence[int], most: int) -> tuple[int, ...]:
    """Return the shape of boxes of at most ``most`` points: whole rows as far as possible."""
    found: list[int] = []
    for length in reversed(shape):
        found.insert(0, max(1, min(length, most)))
        most //= found[0]
    return tuple(found)


@dataclass(frozen=True)
class GridStore:
    """A group of zarr that xarray opens as a dataset; workers of a cluster write to it too."""

    path: Path
    #: Names of the axes of the grid, with their values.
    axes: Mapping[str, np.ndarray] = field(repr=False)
    #: Values of other axes.
    coordinates: Mapping[str, list[Any]] = field(repr=False)
    #: What was asked for, with ``request``, its SHA-256.
    attributes: Mapping[str, Any] = field(repr=False)
    #: Shape of the boxes.
    box: tuple[int, ...]
    #: Text by which a worker recognises the store.
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

        Raise FileError if the path holds anything else, or the store of another request.
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

        Raise FileError if it cannot be written.
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

    def _labels(self, axes: tuple[str, ...], shape: tuple[int, ...]) -> list[str]:
        names = [
            [f"_{label}" for label in self.coordinates.get(axis, range(length))]
            for axis, length in zip(axes, shape, strict=True)
        ]
        return ["".join(parts) for parts in itertools.product(*names)]

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
        """Return the boxes that are not written."""
        done = np.asarray(zarr_of().open_group(self.path, mode="r")["done"][...])
        return [box for box in self.boxes if not done[box].all()]

    def write(self, box: Box, columns: Columns) -> None:
        """Write a box."""
        group = zarr_of().open_group(self.path, mode="r+")
        size = tuple(part.stop - part.start for part in box)
        for name, (_, values) in columns.items():
            group[name][box] = values.reshape(*size, *values.shape[1:])
        group["done"][box] = np.ones(size, dtype=bool)  # last: a box without it is missing

    def complete(self) -> None:
        """Mark the store as complete."""
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
        """Open the store as a dataset of xarray.

        Raise InputError if xarray is not installed.
        """
        xarray = optional_package("xarray", "this store")
        return xarray.open_zarr(self.path, consolidated=None if self._is_complete() else False)

    def values(self) -> dict[str, np.ndarray]:
        """Return what has one value at each point, in arrays of the shape of the grid.

        An exponent or a component is an array of its own, ``exponent_1`` or ``z0_x``. ``done``
        tells which points are in the store; others have nan, False or "".
        """
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


def store_at(path: str | os.PathLike[str], **values: Any) -> GridStore:
    """Return the store at a path.

    Raise InputError if the path does not end with ``.zarr``, or zarr is not installed.
    """
    try:
        place = Path(os.path.abspath(path))
    except TypeError:
        place = Path()
    if place.suffix != ".zarr":
        raise InputError(f"store={path!r} cannot be used; give a path that ends .zarr")
    zarr_of()
    return GridStore(path=place, **values)


def zarr_of() -> Any:
    """Return the module zarr."""
    return optional_package("zarr", "a store", '"zarr>=3"')
