"""The march, the error estimate and the members in the library, as functions of arrays.

Each structure of the library is a class here with the same fields, made from numbers and arrays. A
march and its estimate write into the arrays that they are given. The meaning of the fields is in
the headers of the library, ``march.h`` and ``errors.h``.
"""

from __future__ import annotations

import ctypes
import functools
from collections.abc import Sequence
from ctypes import c_double, c_int64, c_void_p
from typing import Any

import numpy as np

from hamsym.kernel.library import kernel_library

# Outcomes of a march: at the end of the span, at a window whose equation the fixed-point iteration
# does not solve, at a window too short for float64, or with its arrays full.
FINISHED, NEWTON, TOO_SHORT, FULL, _NO_MEMORY = range(5)
# Outcomes of an estimate: all windows estimated; errors as large as the motion, or not finite; a
# window whose equation has no solution.
DONE, LOST, STUCK, _NO_ROOM = range(4)
# Verdicts on members: the checks of the loop passed; left to the caller.
ACCEPTED, LEFT = range(2)
# Marks of windows: the residual is large relative to the rates, or exceeds its limit; the error is
# so large that terms beyond the linear one do not settle; the residual is not bounded.
UNRESOLVED, EXCESSIVE, BENT, UNBOUNDED = 1, 2, 4, 8

LANES = 8  # rows have a multiple of these numbers

# Result and arguments of each function, as in _KINDS.
_SIGNATURES = {
    "hamsym_check_program": "i p",
    "hamsym_run": "i ppppip",
    "hamsym_roundings": "i ppppiippp",
    "hamsym_first_length": "d pppppdd",
    "hamsym_march": "i pppppi",
    "hamsym_errors": "i ppppppppi",
    "hamsym_members": "i ppppp",
    "hamsym_models": "i ppipppipp",
    "hamsym_residual_bounds": "i pppipppppippp",
    "hamsym_bounded": "i pppp",
    "hamsym_discs": "i pppp",
    "hamsym_paths": "i pippp",
    "hamsym_piece": "i pippiip",
}
#: A pointer, also to numbers (p), integers (n) or a structure (s), where that is checked; an
#: integer (i); a number (d); no result (v).
_KINDS = dict(zip("pnsidv", (*[c_void_p] * 3, c_int64, c_double, None), strict=True))


@functools.cache
def library() -> ctypes.CDLL:
    """Return the library with the types of its functions."""
    found = kernel_library()
    for name, signature in _SIGNATURES.items():
        typed(found, name, signature)
    return found


def typed(found: ctypes.CDLL, name: str, signature: str) -> Any:
    """Return a function of a library with the types of its signature, which are set."""
    result, arguments = signature.split()
    function = getattr(found, name)
    function.restype = _KINDS[result]
    function.argtypes = [_KINDS[kind] for kind in arguments]
    return function


def address(array: np.ndarray) -> int:
    """Return where the numbers of an array are, in a quarter of the time of ``array.ctypes``."""
    if not array.size:
        return 0
    try:
        return ctypes.addressof(ctypes.c_char.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):  # it is read only, or has gaps
        return int(array.ctypes.data)


def aligned(array: np.ndarray) -> np.ndarray:
    """Copy numbers to where a line of the cache begins, so that no row of LANES crosses one."""
    memory = np.empty(array.size + LANES)
    start = -(memory.ctypes.data // memory.itemsize) % LANES
    found = memory[start : start + array.size].reshape(array.shape)
    found[...] = array
    return found


class Record(ctypes.Structure):
    """A structure of the library, which keeps the arrays that it points to."""

    _lanes = ""  # counts that must be multiples of LANES
    _constant = False  # whether its numbers are tables, of which it has copies that are aligned

    def __init__(self, **values: Any) -> None:
        self._values = values
        self.arrays: dict[str, Any] = {}
        given = values.copy()
        for name, value in values.items():
            if isinstance(value, ctypes.Structure):
                self.arrays[name] = value
                given[name] = ctypes.addressof(value)
            elif isinstance(value, np.ndarray):
                if value.dtype.kind == "f":
                    value = (
                        aligned(value)
                        if self._constant
                        else np.ascontiguousarray(value, dtype=float)
                    )
                self.arrays[name] = value
                given[name] = address(value)
        super().__init__(**given)
        for name in self._lanes.split():
            if getattr(self, name) % LANES:
                raise ValueError(f"{name}={getattr(self, name)} is not a multiple of {LANES}")

    def __reduce__(self) -> tuple[Any, ...]:
        return _made, (type(self), self._values)

    def __getitem__(self, name: str) -> np.ndarray:
        """Return an array that the structure points to."""
        return self.arrays[name]


def _made(kind: type[Record], values: dict[str, Any]) -> Record:
    """Make a copy of a structure from its values, also in another process."""
    record = kind.__new__(kind)
    Record.__init__(record, **values)
    return record


def counts(names: str) -> list[tuple[str, Any]]:
    """Return fields that are integers."""
    return [(name, c_int64) for name in names.split()]


def numbers(names: str) -> list[tuple[str, Any]]:
    return [(name, c_double) for name in names.split()]


def arrays(names: str) -> list[tuple[str, Any]]:
    """Return fields that are pointers to arrays, or to structures."""
    return [(name, c_void_p) for name in names.split()]


class Program(Record):
    """Formulas as a straight-line program over rows.

    Raise ValueError if a step reads a row that is not written before, or a row does not exist.

    - numbers, rests: Numbers in float64, and the exact ones less these, by default zero.
    - steps: Numbers of operations and of rows; see ``program.h``.
    """

    _fields_ = [
        *counts("dim parameters numbers results intermediates steps"),
        *arrays("number rest step function"),
    ]

    def __init__(
        self,
        dim: int,
        parameters: int,
        results: int,
        *,
        numbers: Sequence[float] = (),
        rests: Sequence[float] | None = None,
        intermediates: int = 0,
        steps: Sequence[tuple[int, int, int, int]] = (),
    ) -> None:
        super().__init__(
            dim=dim,
            parameters=parameters,
            numbers=len(numbers),
            results=results,
            intermediates=intermediates,
            steps=len(steps),
            number=np.array(numbers, dtype=float),
            rest=np.zeros(len(numbers)) if rests is None else np.array(rests, dtype=float),
            step=np.array(steps, dtype=np.int32).reshape(-1, 4),
        )
        if not library().hamsym_check_program(ctypes.byref(self)):
            raise ValueError("the program reads or writes a row that it does not have")

    def __call__(self, states: np.ndarray, times: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Evaluate at states (dim, n), times (n,), parameters (k,): values, shape (results, n)."""
        count = len(times)
        more = -count % LANES
        states, times = (
            np.pad(a, [(0, 0)] * (a.ndim - 1) + [(0, more)], "edge") for a in (states, times)
        )
        out = np.empty((self.results, count + more))
        given = [np.ascontiguousarray(a, dtype=float) for a in (parameters, states, times)]
        done = library().hamsym_run(
            ctypes.byref(self), *(a.ctypes.data for a in given), count + more, out.ctypes.data
        )
        require_memory(done)
        return out[:, :count]

    def roundings(
        self, states: np.ndarray, times: np.ndarray, parameters: np.ndarray
    ) -> np.ndarray:
        """Compute by how much the values change where results of operations are rounded otherwise.

        Numbers and what depends on parameters alone change alike at all times, others by chance.

        - states, times, parameters: Shapes (groups, dim, n), (groups, n), (groups, k); n is a
          multiple of ``LANES``.
        - returns: Changes by chance, and those that are alike, shape (2, groups, results, n).
        """
        groups, _, count = states.shape
        signs = np.random.default_rng(0).choice((-1.0, 1.0), size=(self.steps, count))
        found = np.empty((2, groups, self.results, count))
        given = [np.ascontiguousarray(a, dtype=float) for a in (parameters, states, times)]
        done = library().hamsym_roundings(
            ctypes.byref(self),
            *map(address, given),
            groups,
            count,
            address(signs),
            *map(address, found),
        )
        require_memory(done)
        return found


class Equations(Record):
    """Programs of dq/dt, dp/dt, the second derivatives of H, and of H where it is conserved."""

    _fields_ = [*counts("dim separable linear"), *arrays("velocity force hessian energy")]

    def rates(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Evaluate dz/dt at states (n, dim), times (n,), parameters (k,): shape (n, dim)."""
        halves = [self.program(name)(z.T, t, parameters) for name in ("velocity", "force")]
        return np.concatenate(halves).T

    def roundings(self, z: np.ndarray, t: np.ndarray, parameters: np.ndarray) -> np.ndarray:
        """Compute by how much dz/dt changes where results of operations are rounded otherwise.

        As :meth:`Program.roundings`, with states of shape (groups, n, dim).
        """
        z = z.transpose(0, 2, 1)
        halves = [self.program(name).roundings(z, t, parameters) for name in ("velocity", "force")]
        return np.concatenate(halves, axis=2).transpose(0, 1, 3, 2)

    def program(self, name: str) -> Program:
        """Return the program of a name."""
        found: Program = self.arrays[name]
        return found


class Tables(Record):
    """Tables of a basis."""

    _fields_ = [
        *counts("nodes columns between terms"),
        *numbers("order"),
        *arrays("node integration twice fit place to_between rates_between end end_low"),
        *arrays("extrapolation"),
    ]
    _lanes, _constant = "nodes columns between terms", True


class Settings(Record):
    """Constants of a march."""

    _fields_ = [
        *counts("stops width patient"),
        *numbers("tolerance shortest longest"),
        *arrays("stop floor sign parameters"),
    ]


class Progress(Record):
    """State of a march between calls, updated in place."""

    _fields_ = arrays("clock counts size tail found")


class Windows(Record):
    """Consecutive windows: edges (room + 1,), states (room + 1, dim), readouts (room, m, dim)."""

    _fields_ = [*counts("room readout"), *arrays("edge state coefficient")]

    def __init__(self, edges: np.ndarray, states: np.ndarray, readouts: np.ndarray) -> None:
        room, readout = readouts.shape[:2]
        super().__init__(room=room, readout=readout, edge=edges, state=states, coefficient=readouts)


class Rule(Record):
    """Nodes of the tangent equation."""

    _fields_ = [
        *counts("nodes"),
        *arrays("node at_nodes drift beyond integration twice lift end last"),
    ]
    _lanes, _constant = "nodes", True


class ErrorTables(Record):
    """Tables of a basis for the estimate."""

    _fields_ = [
        *counts("columns places perturbations"),
        *numbers("deviations resolved"),
        *arrays("place value value_low rate rate_low drift drift_end to_series dense"),
        *arrays("coarse fine"),
    ]
    _lanes, _constant = "places", True


#: Term of A V: row += factor * second derivative * source row.
TERM = np.dtype([("row", "i8"), ("source", "i8"), ("entry", "i8"), ("factor", "f8")])


class Actions(Record):
    """Terms of A V in the units of H, those of the coordinates' rates first."""

    _fields_ = [*counts("velocities terms linear"), *arrays("term")]


class ErrorSettings(Record):
    """Constants of an estimate."""

    _fields_ = [
        *counts("period width"),
        *numbers("tolerance accuracy usual_length"),
        *arrays("scale size sign kick parameters residual late"),
    ]


class ErrorResults(Record):
    """Results of an estimate, updated in place."""

    _fields_ = arrays("joint history series floor largest mark")


class Shared(Record):
    """What the members of one H share, also over other spans."""

    _fields_ = [
        *arrays("equations tables error_tables actions bounds"),
        *counts("width period"),
        *arrays("sign disturbance kick"),
        *numbers("local margin least_step most_step smallest tighter accuracy fewest"),
    ]


class Span(Record):
    """The span of all members, and its accuracy."""

    _fields_ = [*numbers("start end tolerance longest shortest"), *arrays("absolute")]


class Members(Record):
    """Results of members, in consecutive rows."""

    _fields_ = [
        *counts("members room readout"),
        *arrays("count verdict evaluations excess largest size edge state coefficient mark"),
        *arrays("series floor"),
    ]


class Paths(Record):
    """Windows of paths in consecutive rows, with the series of their basis."""

    _fields_ = [
        *counts("paths columns terms dim"),
        *arrays("first_edge first_window windows edge state readout series"),
    ]
    _lanes = "terms"

    def states(self, t: np.ndarray) -> np.ndarray:
        """Evaluate at times (n,) that are counted as the edges: shape (paths, n, dim)."""
        states = np.empty((self.paths, len(t), self.dim))
        self._evaluate(t, states, None)
        return states

    def states_and_rates(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate, also the derivatives in time, each of shape (paths, n, dim)."""
        states, rates = (np.empty((self.paths, len(t), self.dim)) for _ in range(2))
        self._evaluate(t, states, rates)
        return states, rates

    def _evaluate(self, t: np.ndarray, states: np.ndarray, rates: np.ndarray | None) -> None:
        t = np.ascontiguousarray(t, dtype=float)
        slopes = None if rates is None else address(rates)
        places = address(t), address(states), slopes
        require_memory(library().hamsym_paths(ctypes.byref(self), len(t), *places))


class BoundTables(Record):
    """Tables of the bounds of windows, with the columns of their basis at places."""

    _fields_ = [*counts("columns"), *arrays("models around places values rates series")]
    _constant = True


class Pieces(Record):
    """Windows, which need not follow each other."""

    _fields_ = [
        *counts("windows readout size_stride parameter_stride"),
        *numbers("tolerance"),
        *arrays("start end state coefficient size parameters"),
    ]


def require_memory(available: Any) -> None:
    """Raise MemoryError unless the library had the memory that it asked for."""
    if not available:
        raise MemoryError("no memory for the rows of a window")


def march(
    H: Equations,
    tables: Tables,
    settings: Settings,
    progress: Progress,
    windows: Windows,
    given: bool,
) -> int:
    """Fill windows from those of ``progress`` on; return the outcome."""
    outcome = library().hamsym_march(
        *map(ctypes.byref, (H, tables, settings, progress, windows)), given
    )
    require_memory(outcome != _NO_MEMORY)
    return int(outcome)


def first_length(
    H: Equations,
    tables: Tables,
    parameters: np.ndarray,
    z: np.ndarray,
    rates: np.ndarray,
    start: float,
    end: float,
) -> float:
    """Return the length of the first window of a march."""
    given = [np.ascontiguousarray(a, dtype=float) for a in (parameters, z, rates)]
    length = library().hamsym_first_length(
        *map(ctypes.byref, (H, tables)), *(a.ctypes.data for a in given), start, end
    )
    return float(length)


def carry_errors(
    H: Equations,
    error_tables: ErrorTables,
    actions: Actions,
    settings: ErrorSettings,
    windows: Windows,
    tables: Tables,
    results: ErrorResults,
) -> tuple[int, int]:
    """Estimate the errors of windows; return the first that is not estimated, and the outcome."""
    first = c_int64(0)
    structures = (H, error_tables, actions, settings, windows, tables, results, first)
    outcome = library().hamsym_errors(*map(ctypes.byref, structures), windows.room)
    require_memory(outcome != _NO_ROOM)
    return first.value, int(outcome)


def solve_members(
    shared: Shared,
    span: Span,
    starts: np.ndarray,
    parameters: np.ndarray,
    members: Members,
) -> int:
    """Solve members until the room for windows is full; return how many were solved."""
    given = address(starts), address(parameters)
    done = library().hamsym_members(
        ctypes.byref(shared), ctypes.byref(span), *given, ctypes.byref(members)
    )
    require_memory(done >= 0)
    return int(done)
