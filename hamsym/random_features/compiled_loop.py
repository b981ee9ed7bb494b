"""Compilation of the loop over windows (:mod:`hamsym.random_features.window_loop`) by numba."""

from __future__ import annotations

import functools
import hashlib
import importlib.resources
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

from hamsym.codegen.numba_cache import cache_directory, load_module, source_file
from hamsym.codegen.system import System
from hamsym.random_features import error_loop, member_loop, window_loop

#: Modules with functions that the loops call.
_CALLED = ("vector_products", "row_products", "window_loop", "error_loop", "member_loop")
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}
#: Of functions that only compiled code calls.
_INNER = {**_OPTIONS, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}


class Loops(NamedTuple):
    """Loops over windows, plain or compiled.

    Attributes
    ----------
    march : callable
        :func:`~hamsym.random_features.window_loop.march_windows`.
    carry_errors : callable
        :func:`~hamsym.random_features.error_loop.carry_errors`.
    members : callable, optional
        :func:`~hamsym.random_features.member_loop.solve_members`, compiled.
    """

    march: Callable[..., int]
    carry_errors: Callable[..., tuple[int, int]]
    members: Callable[..., int] | None = None


PLAIN = Loops(window_loop.march_windows, error_loop.carry_errors)


def cost() -> float:
    """Return the seconds that compiling a march may take: 1 from the cache, 20 without."""
    stem = source_file(_source("window_loop"), "window_loop").stem
    cached = any((cache_directory() / "__pycache__").glob(f"{stem}.march_windows-*.nbc"))
    return 1.0 if cached else 20.0


@functools.cache
def _source(name: str) -> str:
    """Text of a loop, with a digest of the modules whose functions it calls."""
    folder = importlib.resources.files("hamsym.random_features")
    text = folder.joinpath(f"{name}.py").read_text("utf-8")
    called = [folder.joinpath(f"{module}.py").read_bytes() for module in _CALLED]
    return f"{text}\n# {hashlib.sha256(b''.join(called)).hexdigest()}\n"


@functools.cache
def compiled_loops() -> Loops:
    """Compile the loops, which takes seconds the first time on a machine."""
    import numba
    from numba import types

    from hamsym.random_features import row_products

    march: Any = load_module(_source("window_loop"), "window_loop")
    errors: Any = load_module(_source("error_loop"), "error_loop")
    members: Any = load_module(_source("member_loop"), "member_loop")
    for name in row_products.MARCH_FUNCTIONS:
        setattr(march, name, getattr(row_products, name))
    for name in ("evaluate", "round_off", "iterate", "judge", "first_length"):
        setattr(march, name, numba.njit(**_INNER)(getattr(march, name)))
    for name in (*row_products.MARCH_FUNCTIONS, "evaluate"):
        setattr(errors, name, getattr(march, name))
    for name in row_products.ERROR_FUNCTIONS:
        setattr(errors, name, getattr(row_products, name))
    errors.transport = numba.njit(**_INNER)(errors.transport)

    vector, matrix, cube = types.float64[::1], types.float64[:, ::1], types.float64[:, :, ::1]
    number, whole, counts = types.float64, types.int64, types.int64[::1]

    def tuple_of(kind: Any, *parts: Any) -> Any:
        return types.BaseTuple.from_types(parts, kind)

    rows = types.FunctionType(_rows_signature())
    windows = tuple_of(window_loop.Windows, vector, matrix, cube)
    actions = tuple_of(error_loop.Actions, counts, counts, counts, counts, vector)
    tables = tuple_of(
        window_loop.Tables,
        *(vector, matrix, matrix, vector, matrix, matrix, vector, vector, matrix, vector),
    )
    settings = tuple_of(
        window_loop.Settings,
        *(vector, number, vector, matrix, number, number, vector, types.boolean),
    )
    progress = tuple_of(window_loop.Progress, vector, counts, vector, matrix, matrix)
    error_tables = tuple_of(
        error_loop.ErrorTables,
        *(vector, matrix, matrix, cube, cube, cube, cube, matrix, matrix, vector, vector),
        *(matrix, matrix, vector, vector, matrix, matrix),
    )
    error_settings = tuple_of(
        error_loop.ErrorSettings,
        *(vector, vector, number, number, number, number, cube, cube, vector),
    )
    span = tuple_of(
        member_loop.Span,
        *(number, number, number, number, vector, number, number),
        *(types.boolean, types.boolean, types.boolean),
    )
    results = tuple_of(
        member_loop.Members,
        *(counts, counts, counts, vector, matrix, matrix),
        *(vector, matrix, cube, counts, cube, matrix),
    )
    compiled_march = _compiled(
        types.int64(rows, rows, tables, settings, progress, windows, types.boolean),
        march.march_windows,
    )
    compiled_errors = _compiled(
        types.UniTuple(whole, 2)(
            *(rows, rows, rows, error_tables, actions, actions, error_settings, windows),
            *(matrix, vector, vector, cube, matrix, vector, counts, whole, whole),
        ),
        errors.carry_errors,
    )
    for name in ("evaluate", "fill", "first_length", "products"):
        setattr(members, name, getattr(march, name))
    members.march_windows, members.carry_errors = compiled_march, compiled_errors
    for name in ("joint_errors", "keeps_energy", "scaled"):
        setattr(members, name, numba.njit(**_INNER)(getattr(members, name)))
    compiled_members = _compiled(
        whole(
            *(rows, rows, rows, rows, tables, error_tables, actions, actions),
            *(matrix, cube, cube, span, matrix, matrix, results),
        ),
        members.solve_members,
    )
    return Loops(compiled_march, compiled_errors, compiled_members)


@functools.lru_cache(maxsize=256)
def compiled_rows(system: System, name: str) -> Callable[..., None]:
    """Compile a function of rows of a generated numba module for the compiled loops."""
    rows: Any = system.function(f"{name}_rows")
    return _pointer_class()(_compiled(_rows_signature(), rows.py_func))


@functools.cache
def _pointer_class() -> Any:
    from numba import types

    class Pointer(types.WrapperAddressProtocol):  # type: ignore[misc]
        """A compiled function of rows with its address, which numba looks up in every call."""

        def __init__(self, function: Any) -> None:
            self._function, self._signature = function, _rows_signature()
            result = function.get_compile_result(self._signature)
            name = result.fndesc.llvm_cfunc_wrapper_name
            self._address = int(result.library.get_pointer_to_function(name))

        def __call__(self, *arguments: Any) -> None:
            self._function(*arguments)

        def __wrapper_address__(self) -> int:
            return self._address

        def signature(self) -> Any:
            return self._signature

    return Pointer


def _compiled(signature: Any, function: Any) -> Any:
    """Compile a function for one signature, or load it from the cache."""
    import numba

    compiler = numba.njit(signature, cache=True, **_OPTIONS)
    try:
        return compiler(function)
    except Exception:
        # The cached files are damaged, or were written by other versions.
        path = Path(function.__code__.co_filename)
        for file in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb?"):
            file.unlink(missing_ok=True)
    try:
        return compiler(function)
    except Exception:  # an unusable cache directory, e.g. in $NUMBA_CACHE_DIR
        return numba.njit(signature, **_OPTIONS)(function)


def _rows_signature() -> Any:
    from numba import types

    matrix, vector = types.float64[:, ::1], types.float64[::1]
    return types.void(matrix, vector, vector, matrix)
