"""Programs of tests that are functions of rows, which the library calls in place of their steps."""

from __future__ import annotations

import ctypes
from collections.abc import Callable

import numpy as np

from hamsym.kernel.loops import Program, Record

_KIND = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 4, ctypes.c_int64)


class RowProgram(Program):
    """A function of states, times and parameters, which writes its results to rows.

    - function: (states (dim, n), times (n,), parameters (k,), out (results, n)) -> None.
    """

    def __init__(
        self, dim: int, parameters: int, results: int, function: Callable[..., None]
    ) -> None:
        def array(address: int, *shape: int) -> np.ndarray:
            if not all(shape):
                return np.empty(shape)
            memory = (ctypes.c_double * int(np.prod(shape))).from_address(address)
            return np.ctypeslib.as_array(memory).reshape(shape)

        def call(states: int, times: int, values: int, out: int, n: int) -> None:
            given = array(states, dim, n), array(times, n), array(values, parameters)
            with np.errstate(all="ignore"):
                function(*given, array(out, results, n))

        self._callback = _KIND(call)
        place = ctypes.cast(self._callback, ctypes.c_void_p).value
        Record.__init__(self, dim=dim, parameters=parameters, results=results, function=place)
