"""Solutions in one file, and in stores of zarr to which windows are written as they are found.

Both have the same arrays: the columns of the table, the windows, the basis, and the notes of
members as JSON text. They are accepted only if they are exactly what is written. The windows of a
store are read, and checked against their checksums, when they are needed.
"""

from __future__ import annotations

import hashlib
import json
import math
import os
import shutil
import uuid
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

import hamsym
from hamsym.description import (
    MALFORMED,
    described,
    hamiltonian_from,
    read_result,
    require_formula,
    write_result,
)
from hamsym.ensemble import Ensemble
from hamsym.errors import FileError
from hamsym.families.blocks import Block
from hamsym.families.distributed import StorePlace
from hamsym.families.parts import (
    FOLDER,
    NAME,
    Part,
    create_array,
    part_of,
    read_parts,
    windows_of,
    write_part,
    zarr_of,
)
from hamsym.families.solutions import Family, Solutions
from hamsym.families.windows import (
    ACCEPTED,
    MARCHED,
    OPEN,
    REFUSED,
    Packed,
    Pieces,
    Table,
    Windows,
    pieces_of,
)
from hamsym.problem import checked_span
from hamsym.random_features.basis import DEGREE
from hamsym.support.atomic import create_atomically
from hamsym.support.checked_data import (
    checked_list,
    checked_mapping,
    checked_type,
    checked_values,
    numbers_of,
    require_array,
    require_names,
)
from hamsym.support.locking import exclusive
from hamsym.support.tensor_files import one_line
from hamsym.support.validation import require_whole

KIND = "solutions"
_VALUES = {
    **dict.fromkeys(("H", "options"), "Mapping[str, Any]"),
    "span": "tuple[float, float]",
    "seed": "int",
    "varied": "tuple[str, ...]",
    "shape": "tuple[int, ...]",
    "stopped": "str",
}
_OPTIONS = {"tol": "float", "atol": "tuple[float, ...]", "max_window": "float | None"}
_VERSION = 2  # of stores
_BEGUN = "hamsym_begun"  # attribute of a store that is being written
_ORDER = "order"  # numbers of the members in the order of the table of a store


def write_solutions(solutions: Solutions, path: str | os.PathLike[str]) -> None:
    """Write solutions to one file; see :func:`hamsym.save`."""
    solutions = _compact(solutions)
    H = solutions.family.H
    write_result(path, KIND, H, lambda: _check(solutions), lambda: _parts(solutions))


def _parts(solutions: Solutions) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    windows = {name: rows.rows(0, len(rows)) for name, rows in solutions.windows._asdict().items()}
    return _columns(solutions.family, solutions.table) | windows, _values(solutions)


def read_solutions(path: str | os.PathLike[str]) -> Solutions:
    """Read solutions that :func:`write_solutions` wrote; see :func:`hamsym.load`."""
    return read_result(path, KIND, _checked)


def _checked(arrays: dict[str, np.ndarray], values: dict[str, Any]) -> Solutions:
    require_names("arrays", {**arrays}, _COLUMNS | {*Packed._fields})
    windows = Windows(*(Pieces([arrays[name]]) for name in Windows._fields))
    solutions = _assembled(arrays, values, windows)
    _check(solutions)
    return solutions


class WindowStore:
    """A store of zarr to which members are written in parts.

    Raise InputError if zarr is not installed. Raise FileError if the path exists and is not a store
    that was begun with the same arguments, or it cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str], family: Family, members: Ensemble) -> None:
        zarr = zarr_of()
        self._path, self._family, self._members = Path(os.path.abspath(path)), family, members
        require_formula(path, family.H)
        request = _request(family, members)
        try:
            if self._path.exists():
                begun = {}
                if is_store(self._path):
                    self._group = zarr.open_group(self._path, mode="r+")
                    begun = json.loads(self._group.attrs.get(_BEGUN, "{}"))
                if begun.get("request") != request:
                    raise FileError(
                        f"'{path}' exists; give the path of a new store, or the arguments with "
                        "which this one was begun"
                    )
            else:
                begun = {"request": request, "token": uuid.uuid4().hex}

                def fill(aside: Path) -> None:
                    group = zarr.open_group(aside, mode="w-")
                    group.create_group(FOLDER)
                    group.attrs[_BEGUN] = json.dumps(begun)

                create_atomically(self._path, fill)
                self._group = zarr.open_group(self._path, mode="r+")
        except OSError as error:
            raise FileError(f"'{path}' cannot be written: {error.strerror or error}") from None
        self._token, self._changed = begun["token"], False
        self._blocks = read_parts(self._path)

    def locked(self) -> AbstractContextManager[None]:
        """Lock the store against other processes that would write to it."""
        return exclusive(self._path, self._path.with_name(f".{self._path.name}.lock"))

    @property
    def place(self) -> StorePlace:
        """The store, for workers that write to it."""
        return StorePlace(self._path, self._token)

    @property
    def solved(self) -> np.ndarray:
        """Numbers of the members in it."""
        return np.concatenate([np.empty(0, np.int64), *(b.members for b in self._blocks)])

    def append(self, block: Block) -> None:
        """Write a block, all of whose members are solved, unless a worker has written it."""
        if block.windows is not None:
            write_part(self._path, block)
        self._blocks.append(block._replace(windows=None))
        self._changed = True

    def finished(self, refused: Mapping[int, str], stopped: str) -> Solutions:
        """Write the table, and return the solutions, which read their windows from the store."""
        if not self._changed and "hamsym" in self._group.attrs:
            found = open_store(self._path)
            if not found.table.stopped:
                return found
        blocks = sorted(self._blocks, key=lambda block: int(block.members[0]))
        members, solved = self._members, np.concatenate([[-1], *(b.members for b in blocks)])
        order = np.arange(len(members))
        if not (np.diff(solved) > 0).all():  # members of a later call are between those of others
            order = np.concatenate((solved[1:], np.setdiff1d(order, solved))).astype(np.int64)
        tables = [(block.members, block.table) for block in blocks]
        table = Table.of_members(members.states, members.parameters, tables, refused, stopped)
        table, parts = table.selected(order), [part_of(block) for block in blocks]
        windows = windows_of(self._path, parts, _row_shapes(self._family))
        index = np.argsort(order).reshape(members.shape)
        solutions = Solutions(self._family, table, windows, index)
        columns, values = _columns(self._family, table) | {_ORDER: order}, _values(solutions)
        self._group.attrs.pop("hamsym", None)
        for name, column in columns.items():
            create_array(self._group, name, column.shape, column.dtype.name, max(1, len(column)))
            if column.size:
                self._group[name][...] = column
        head = {"kind": KIND, "version": _VERSION, "parts": [[*part] for part in parts], **values}
        # Last: a store without it is not complete.
        self._group.attrs["hamsym"] = json.dumps({**head, "sha256": _digest(columns, head)})
        if not table.stopped:
            for leftover in (self._path / FOLDER).glob(".*"):  # of processes that were killed
                shutil.rmtree(leftover, ignore_errors=True)
        return solutions


def _request(family: Family, members: Ensemble) -> str:
    """Compute SHA-256 of all that determines the solutions."""
    found, longest = family.accuracy, family.max_window
    values = {
        "version": hamsym.__version__,
        "H": described(family.H),
        "span": [float(time).hex() for time in family.span],
        "options": [float(found.tol), found.absolute.tolist(), longest],
        "seed": family.seed,
        "varied": list(family.varied),
        "shape": list(members.shape),
    }
    arrays = {"z0": members.states, "parameters": members.parameters, "basis": family.series}
    return _digest(arrays, values)


def is_store(path: str | os.PathLike[str]) -> bool:
    """Return whether a path is a folder that zarr wrote."""
    try:
        return os.path.isfile(os.path.join(path, "zarr.json"))
    except (ValueError, TypeError):  # it is no path
        return False


def open_store(path: str | os.PathLike[str]) -> Solutions:
    """Open the solutions of a store of zarr; their windows are read when they are needed.

    Raise FileError if it is damaged, is not a store of solutions, or was not finished.
    """
    zarr = zarr_of()
    try:
        group = zarr.open_group(path, mode="r")
        text = group.attrs.get("hamsym")
    except Exception as error:  # zarr raises many kinds
        raise FileError(f"'{path}' is not a store of solutions: {one_line(error)}") from None
    if text is None:
        raise FileError(f"'{path}' is not a store of solutions, or was not finished; solve again")
    try:
        values = checked_mapping("values", json.loads(text))
        claimed = values.pop("sha256", None)
        if (values.get("kind"), values.get("version")) != (KIND, _VERSION):
            raise ValueError(f"it is not of kind {KIND} and version {_VERSION}")
        arrays = {name: np.asarray(group[name][...]) for name in (*_COLUMNS, _ORDER)}
        if claimed != _digest(arrays, values):
            raise ValueError("its checksum does not match its content")
        del values["kind"], values["version"]
        parts = [_part(entry) for entry in checked_list("parts", values.pop("parts"))]
        order = arrays.pop(_ORDER)
        solutions = _assembled(arrays, values, Windows(*(Pieces([order[:0]]),) * 5))
        require_array(_ORDER, order, (len(solutions.table.status),), np.int64)
        if not np.array_equal(np.sort(order), np.arange(len(order))):
            raise ValueError("the order of its members is not one")
        windows = windows_of(Path(os.path.abspath(path)), parts, _row_shapes(solutions.family))
        members = np.argsort(order).reshape(solutions.shape)
        solutions = Solutions(solutions.family, solutions.table, windows, members)
        _check_table(solutions)
        if [len(rows) for rows in windows] != list(_row_counts(solutions.table)):
            raise ValueError("windows are missing")
    except (*MALFORMED, OSError) as error:
        raise FileError(f"'{path}' is damaged: {one_line(error)}") from None
    return solutions


def _part(entry: Any) -> Part:
    """Return a part from its values in the head of a store."""
    name, rows = checked_list("part", entry, 2)
    if not NAME.fullmatch(checked_type("part", name, "str")):
        raise ValueError("a part has no valid name")
    return Part(name, tuple(checked_type("rows", n, "int") for n in checked_list("rows", rows, 5)))


def _digest(columns: Mapping[str, np.ndarray], values: Mapping[str, Any]) -> str:
    """Compute SHA-256 of columns and values."""
    found = hashlib.sha256(json.dumps(values, sort_keys=True).encode())
    for name, column in sorted(columns.items()):
        found.update(f"{name} {column.dtype.name} {column.shape} ".encode())
        found.update(np.ascontiguousarray(column).tobytes())
    return found.hexdigest()


# -- parts -----------------------------------------------------------------------------------------

_COLUMNS = {
    *("z0", "parameters", "status", "success", "counts", "evaluations", "excess", "largest"),
    *("sizes", "notes", "basis"),
}


def _columns(family: Family, table: Table) -> dict[str, np.ndarray]:
    """Return all arrays but for the windows."""
    notes = json.dumps({str(member): note for member, note in sorted(table.notes.items())})
    return {
        **table.arrays(),
        "success": table.success.astype(np.uint8),
        "notes": np.frombuffer(notes.encode(), dtype=np.uint8),
        "basis": family.series,
    }


def _values(solutions: Solutions) -> dict[str, Any]:
    """Return what is not an array, as values that JSON can store."""
    family, found = solutions.family, solutions.family.accuracy
    longest = family.max_window
    return {
        "H": described(family.H),
        "span": [float(time) for time in family.span],
        "options": {
            "tol": float(found.tol),
            "atol": found.absolute.tolist(),
            "max_window": None if longest is None else float(longest),
        },
        "seed": family.seed,
        "varied": list(family.varied),
        "shape": list(solutions.shape),
        "stopped": solutions.table.stopped,
    }


def _assembled(
    arrays: Mapping[str, np.ndarray], values: Mapping[str, Any], windows: Windows
) -> Solutions:
    """Build solutions from :func:`_columns`, :func:`_values` and their windows."""
    given = checked_values("values", values, _VALUES)
    options = checked_values("options", given["options"], _OPTIONS)
    require_whole("seed", given["seed"], 0)
    shape = given["shape"]
    if len(shape) > 32 or any(not 0 < n < 2**63 for n in shape):
        raise ValueError("'shape' is out of range")
    if math.prod(shape) != len(arrays["status"]):
        raise ValueError("its shape differs from its number of members")
    own = {name: arrays[name] for name in _COLUMNS - {"notes", "basis"}}
    require_array("success", own["success"], own["status"].shape, np.uint8)
    if (own["success"] > 1).any():
        raise ValueError("'success' is out of range")
    family = Family(
        H=hamiltonian_from(given["H"]),
        span=checked_span(given["span"]),
        tol=options["tol"],
        atol=options["atol"],
        max_window=options["max_window"],
        seed=given["seed"],
        varied=given["varied"],
        series=arrays["basis"],
    )
    table = Table(
        **{**own, "success": own["success"].astype(bool)},
        notes=_notes(arrays["notes"]),
        stopped=given["stopped"],
    )
    members = np.arange(len(table.status)).reshape(shape)
    return Solutions(family, table, windows, members)


def _notes(text: np.ndarray) -> dict[int, dict[str, Any]]:
    if text.dtype != np.uint8:
        raise ValueError("'notes' is not of type uint8")
    found = {}
    for member, note in checked_mapping("notes", json.loads(text.tobytes())).items():
        alone = len(checked_mapping("note", note)) == 1
        names = {"message"} if alone else {"message", "march", "scale"}
        require_names("notes", note, names)
        checked_type("message", note["message"], "str")
        found[int(member)] = note
    return found


def _compact(solutions: Solutions) -> Solutions:
    """Return the same solutions with a table and windows of their members alone, in order."""
    members, table = solutions.members.ravel(), solutions.table
    if np.array_equal(members, np.arange(len(table.status))):
        return solutions
    none = table.packed(solutions.windows, 0, 0)
    parts = [table.packed(solutions.windows, m, m + 1) for m in members.tolist()]
    return Solutions(
        solutions.family,
        table.selected(members),
        pieces_of([*parts, none]),
        np.arange(len(members)).reshape(solutions.shape),
    )


# -- checks ----------------------------------------------------------------------------------------


def _check(solutions: Solutions) -> None:
    """Raise ValueError unless solutions are what solve_many returns."""
    _check_table(solutions)
    windows = solutions.windows
    arrays = [rows.rows(0, len(rows)) for rows in windows]
    _check_shapes(solutions, arrays)
    _check_windows(solutions, Packed(*arrays))


def _check_table(solutions: Solutions) -> None:
    family, table = solutions.family, solutions.table
    H, count = family.H, len(table.status)
    H.require_parameters()
    if not family.accuracy.tol == family.tol:
        raise ValueError("its tolerance is not valid")
    require_array("basis", family.series, (DEGREE + 1, family.series.size // (DEGREE + 1)))
    if not set(family.varied) <= set(H.parameter_names):
        raise ValueError("it varies a parameter that H does not have")
    names = H.parameter_names
    require_array("z0", table.z0, (count, H.dim), finite=False)
    require_array("parameters", table.parameters, (count, len(names)))
    for name, column in zip(names, table.parameters.T, strict=True):
        if name not in family.varied and not (column == H.parameters[name]).all():
            raise ValueError(f"'{name}' differs from its value in H")
    require_array("status", table.status, (count,), np.uint8)
    require_array("success", table.success, (count,), bool)
    for name in ("counts", "evaluations"):
        require_array(name, getattr(table, name), (count,), np.int64)
    require_array("excess", table.excess, (count,), finite=False)
    require_array("largest", table.largest, (count, H.dim), finite=False)
    require_array("sizes", table.sizes, (count, H.dim))
    for name in ("counts", "evaluations", "excess", "largest", "sizes"):
        if not (getattr(table, name) >= 0).all():
            raise ValueError(f"'{name}' is negative or not a number")
    solved = (table.status == ACCEPTED) | (table.status == MARCHED)
    good = table.success
    if (table.status > REFUSED).any() or ((table.counts > 0) != solved).any():
        raise ValueError("members without windows have a solution, or the reverse")
    if (good & ~solved).any() or (~good & (table.status == ACCEPTED)).any():
        raise ValueError("success contradicts the state of a member")
    if not ((table.excess <= 1) | ~good).all() or not np.isfinite(table.largest[good]).all():
        raise ValueError("a member's success is true, but its error exceeds the tolerance")
    if not np.isfinite(table.z0[solved]).all():
        raise ValueError("a member with a solution starts at a state that is not finite")
    noted = np.flatnonzero((table.status == MARCHED) | (table.status == REFUSED)).tolist()
    if sorted(table.notes) != noted:
        raise ValueError("members without messages, or messages without members")
    if any((len(n) > 1) != (table.status[m] == MARCHED) for m, n in table.notes.items()):
        raise ValueError("a note does not belong to the state of its member")
    if (table.status == OPEN).any() != bool(table.stopped):
        raise ValueError("members are not solved without a reason")


def _row_shapes(family: Family) -> dict[str, tuple[int, ...]]:
    """Return the shape of a row of each array of :class:`Windows`."""
    dim, columns = family.H.dim, family.series.shape[1]
    return {
        "edges": (),
        "states": (dim,),
        "readouts": (columns, dim),
        "error": (family.degrees, dim),
        "floors": (dim,),
    }


def _row_counts(table: Table) -> tuple[int, ...]:
    """Return the number of rows of each array of :class:`Windows`."""
    edges, windows, errors = (
        int(first[-1]) for first in (table.first_edge, table.first_window, table.first_error)
    )
    return edges, edges, windows, errors, errors


def _check_shapes(solutions: Solutions, arrays: Sequence[Any]) -> None:
    """Raise ValueError unless the arrays of windows have the shapes that the table states."""
    counts = _row_counts(solutions.table)
    rows = _row_shapes(solutions.family).items()
    for (name, row), count, array in zip(rows, counts, arrays, strict=True):
        if array.dtype != np.float64 or tuple(array.shape) != (count, *row):
            raise ValueError(f"'{name}' is not of type float64 and shape {(count, *row)}")


def _check_windows(solutions: Solutions, packed: Packed) -> None:
    family, table = solutions.family, solutions.table
    for name in ("edges", "states", "readouts"):
        if not np.isfinite(getattr(packed, name)).all():
            raise ValueError(f"'{name}' is not finite")
    solved = table.counts > 0
    first, last = table.first_edge[:-1][solved], table.first_edge[1:][solved] - 1
    start, end = family.span
    with np.errstate(over="ignore"):
        steps = np.diff(packed.edges) * math.copysign(1.0, end - start)
    inner = np.ones(len(steps), dtype=bool)
    inner[last[:-1]] = False  # from one member to the next
    if not (steps[inner] > 0).all() or not np.isfinite(steps[inner]).all():
        raise ValueError("its windows are not in order")
    if not (family.origin + packed.edges[first] == start).all():
        raise ValueError("a member does not start at the start of the span")
    reached = family.origin + packed.edges[last]
    if not (reached[table.success[solved]] == end).all():
        raise ValueError("a member's success is true, but it ends before the span")
    if packed.states[first].tobytes() != table.z0[solved].tobytes():
        raise ValueError("a member does not start at its z0")
    for member in np.flatnonzero(table.status == MARCHED).tolist():
        march, error, trial = solutions.marched(member)
        success = bool(table.success[member])
        if march.origin != family.origin:
            raise ValueError("the times of a member have another origin")
        march.check(trial)
        error.check(trial, finite=success)
        numbers = [v for v in numbers_of(march).values() if isinstance(v, float)]
        if success and not np.isfinite(numbers).all():
            raise ValueError("a member's success is true, but a number of its march is not finite")
