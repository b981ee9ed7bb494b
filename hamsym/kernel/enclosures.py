"""Series and windows of proofs in the library, as functions of arrays.

A ball is a triple (high, low, radius) of numbers, or a row of an array. What the functions compute
is in ``balls.h``, ``series.h``, ``enclosures.h`` and ``sets.c``, and why their bounds hold, in the
lemmas of examples/guide/how_proofs_work.md.
"""

from __future__ import annotations

import ctypes
import functools
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hamsym.kernel.library import kernel_library
from hamsym.kernel.loops import Record, address, arrays, counts, numbers, require_memory, typed

# Operations of programs on series, and their numbers in the library.
ADD, SUBTRACT, NEGATE, MULTIPLY, RECIPROCAL, RECIPROCAL_ROOT, EXPONENTIAL, SINE_COSINE = range(8)
LOGARITHM, ARCTANGENT, ARCSINE, ARCCOSINE, ARSINH, ARCOSH, ARTANH, ERROR_FUNCTION = range(8, 16)
REDUCED_ANGLE = 16

MOST_TERMS = 64  # of a series

# Result and arguments of each function, whose names begin with hamsym_; see loops._KINDS.
_SIGNATURES = {
    "norms": "v ppiip",
    "differentiate_series": "d ppippi",
    "end_values": "v ppiiiip",
    "run_series": "v nisi",
    "run_values": "v nipi",
    "collocate": "i ninpippidi",
    "tangents": "i pnpiiippiidpdp",
    "correction": "i pnpiipidppip",
    "defects": "v ninsippp",
    "flow_defects": "i spp",
    "lemma": "i spppp",
    "moved_set": "i ppppiiiipp",
    "set_radius": "i ppppiiiip",
    "boxed_set": "i pppiiipp",
    "moved_sizes": "i pppiiiip",
    "chebyshev_balls": "v pip",
    "matrix_value": "v ppiipp",
    "vector_value": "v pppiip",
    "dense": "v ppiiss",
    "clenshaw": "v ppiipps",
    "add_products": "v pppnnnii",
    "product": "v ppiiip",
    "balance": "v pip",
    "follow": "i siipp",
}


class Models(Record):
    """Models in rows, with the tables between values and series.

    - values, series: Shape (terms, terms): values[k, j] = T_k at point j, series[j, k] the inverse.
    - high, low: Shape (rows, terms).
    - radius, length: Shape (rows,).
    """

    _fields_ = [*counts("terms"), *arrays("values series high low radius length")]

    def __init__(
        self,
        values: np.ndarray,
        series: np.ndarray,
        high: np.ndarray,
        low: np.ndarray,
        radius: np.ndarray,
        length: np.ndarray,
    ) -> None:
        terms = high.shape[1]
        if terms > MOST_TERMS:
            raise ValueError(f"series of {terms} terms; the library has room for {MOST_TERMS}")
        for array in (values, series, high, low, radius):
            pointer(array, "p")
        pointer(length, "n")
        rows = {"high": high, "low": low, "radius": radius, "length": length}
        super().__init__(terms=terms, values=values, series=series, **rows)


class _Lemma(Record):
    """A step of the lemma of a window."""

    _fields_ = [
        *counts("dim columns terms count"),
        *arrays("jacobian jacobian_radius jacobian_length entries signs start hull"),
        *arrays("V sizes defect start_error D"),
        *numbers("half"),
        *arrays("units"),
    ]


class Enclosures:
    """The functions of a library."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self.library = library
        self._functions = {
            name: (typed(library, f"hamsym_{name}", signature), signature.split()[1])
            for name, signature in _SIGNATURES.items()
        }

    def _call(self, name: str, *arguments: Any) -> Any:
        """Call a function; arrays, which must have their numbers in one piece, become pointers."""
        function, kinds = self._functions[name]
        given = zip(arguments, kinds, strict=True)
        return function(*[pointer(a, k) if isinstance(a, np.ndarray) else a for a, k in given])

    # -- series ----------------------------------------------------------------------------------

    def norms(self, high: np.ndarray, low: np.ndarray | None = None) -> np.ndarray:
        """Bound the sums of the magnitudes of the coefficients of series, shape (..., terms)."""
        high, rest = _reals(high), None if low is None else _reals(low)
        out = np.empty(high.shape[:-1])
        self._call("norms", high, rest, out.size, high.shape[-1], out)
        return out

    def differentiate_series(
        self, series: tuple[np.ndarray, np.ndarray], out: tuple[np.ndarray, np.ndarray], twice: bool
    ) -> float:
        """Write the derivative of a series; return a bound on its rounding errors."""
        given = [*map(_reals, series), len(series[0])]
        return float(self._call("differentiate_series", *given, *out, twice))

    def end_values(
        self, high: np.ndarray, low: np.ndarray | None, end: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute the values of series, shape (..., terms), at -1 or 1: mid-points and radii."""
        high = _reals(high)
        shape, terms = high.shape[:-1], high.shape[-1]
        out = np.empty((*shape, 3))
        rest = None if low is None else _reals(low)
        self._call("end_values", high, rest, high.size // terms, terms, terms, end, out)
        high, low, radius = np.ascontiguousarray(np.moveaxis(out, -1, 0))
        return high, low, radius

    def run_models(self, program: np.ndarray, models: Models, twice: bool) -> None:
        """Run a program, integers in rows (operation, target, first, second), on models in place.

        Their series are of twice float64, or have low parts of zero.
        """
        self._call("run_series", program, len(program), ctypes.byref(models), twice)

    # -- windows ---------------------------------------------------------------------------------

    def run_values(self, program: np.ndarray, rows: np.ndarray) -> None:
        """Run a program on values at points, without bounds; rows (registers, points)."""
        self._call("run_values", program, len(program), rows, points_of(rows))

    def collocate(
        self,
        program: np.ndarray,
        results: np.ndarray,
        rows: np.ndarray,
        integral: np.ndarray,
        start: np.ndarray,
        half: float,
        most: int,
    ) -> int:
        """Iterate y at the points in the first rows; return the number of iterations.

        It is 0 where y is not finite.
        """
        given = program, len(program), results, rows, points_of(rows), _reals(integral), start
        found = int(self._call("collocate", *given, len(start), half, most))
        require_memory(found >= 0)
        return found

    def tangents(
        self,
        rows: np.ndarray,
        entries: np.ndarray,
        signs: np.ndarray,
        dim: int,
        columns: int,
        steps: np.ndarray,
        series: np.ndarray,
        half: float,
        units: np.ndarray,
        enough: float,
    ) -> np.ndarray:
        """Guess coefficients of V, shape (dim, columns, points), by Taylor series.

        - steps: From values at the points to series between them, (points, points, orders).
        - series: From values at the points to coefficients.
        - enough: Size of terms that are left out.
        """
        points, orders = rows.shape[1], steps.shape[2]
        require_fit(steps.shape[:2] == series.shape == (points, points))
        found = np.empty((dim, columns, points))
        given = rows, entries, signs, len(entries), dim, columns, steps, series, points, orders
        require_memory(self._call("tangents", *given, half, units, enough, found))
        return found

    def correct(
        self,
        rows: np.ndarray,
        entries: np.ndarray,
        signs: np.ndarray,
        dim: int,
        integral: np.ndarray,
        half: float,
        wanted: np.ndarray,
        units: np.ndarray,
        most: int,
    ) -> np.ndarray:
        """Iterate c with c = -D + w int A c at the points from -D, shape (dim, points)."""
        found, wanted = np.empty(wanted.shape), _reals(wanted)
        given = rows, entries, signs, len(entries), dim, integral, rows.shape[1]
        require_memory(self._call("correction", *given, half, wanted, units, most, found))
        return found

    def defects(
        self,
        program: np.ndarray,
        results: np.ndarray,
        models: Models,
        dim: int,
        half: tuple[float, float, float],
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute coefficients of D, shape (dim, terms + 1), and bounds on \\|D\\|."""
        found, sizes = np.empty((dim, models.terms + 1)), np.empty(dim)
        given = program, len(program), results, ctypes.byref(models), dim, _reals(half)
        self._call("defects", *given, found, sizes)
        return found, sizes

    def flow_defects(
        self,
        jacobian: np.ndarray,
        jacobian_length: np.ndarray,
        entries: np.ndarray,
        signs: np.ndarray,
        V: np.ndarray,
        sizes: np.ndarray,
        half: float,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Bound the defect K of V, and F = V(-1) - I, shapes (dim, columns).

        - jacobian, jacobian_length: Models of the entries of DG, in the order of ``entries``.
        - entries, signs: Rows (i, j, place); signs.
        - V, sizes: Coefficients, shape (dim, columns, terms); bounds on \\|V\\|.
        - half: An upper bound on w.
        """
        dim, columns, terms = V.shape
        require_fit(jacobian.shape == (len(entries), terms) and sizes.shape == (dim, columns))
        defect, start_error = np.empty((2, dim, columns))
        step = _Lemma(
            dim=dim,
            columns=columns,
            terms=terms,
            count=len(entries),
            jacobian=jacobian,
            jacobian_length=jacobian_length,
            entries=entries,
            signs=signs,
            V=V,
            sizes=sizes,
            half=half,
        )
        require_memory(self._call("flow_defects", ctypes.byref(step), defect, start_error))
        return defect, start_error

    def transport(
        self,
        jacobian: np.ndarray,
        jacobian_radius: np.ndarray,
        jacobian_length: np.ndarray,
        entries: np.ndarray,
        signs: np.ndarray,
        start: np.ndarray,
        hull: np.ndarray,
        sizes: np.ndarray,
        defect: np.ndarray,
        start_error: np.ndarray,
        D: np.ndarray,
        half: float,
        units: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Compute the bounds of the lemma: on |z - y|, |d - K xi|, |V_d - K|; and m.

        - jacobian, jacobian_radius, jacobian_length: Models of the entries of DG over the tube, in
          the order of ``entries``.
        - entries, signs: Rows (i, j, place); signs.
        - start: Bounds on \\|xi\\|, shape (columns,).
        - hull: Bounds on \\|V xi\\| over the window, shape (dim,).
        - sizes: Bounds on \\|V\\|, and those of :meth:`flow_defects` for the same coefficients of
          models.
        - D: Bounds on \\|D\\|, shape (dim,).
        - half: An upper bound on w.
        - units: Shape (dim,), any numbers > 0.
        """
        dim, columns = sizes.shape
        (tube, d), derivative, norm = np.empty((2, dim)), np.empty((dim, columns)), np.empty(1)
        step = _Lemma(
            dim=dim,
            columns=columns,
            terms=jacobian.shape[1],
            count=len(entries),
            jacobian=jacobian,
            jacobian_radius=jacobian_radius,
            jacobian_length=jacobian_length,
            entries=entries,
            signs=signs,
            start=start,
            hull=hull,
            sizes=sizes,
            defect=defect,
            start_error=start_error,
            D=D,
            half=half,
            units=units,
        )
        require_memory(self._call("lemma", ctypes.byref(step), tube, d, derivative, norm))
        return tube, d, derivative, float(norm[0])

    # -- sets ------------------------------------------------------------------------------------

    def moved_set(
        self, J: np.ndarray, J_error: np.ndarray, C: np.ndarray, r0: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute J C rounded, and bounds on the rest of (J +- J_error) C r, shape (n, kinds).

        The bounds hold for all r, shape (columns, kinds), with \\|r\\| <= r0.
        """
        (n, k), (columns, kinds) = J.shape, r0.shape
        require_fit(J_error.shape == (n, k) and C.shape == (k, columns))
        found, rest = np.empty((n, columns)), np.empty((n, kinds))
        given = [_reals(array) for array in (J, J_error, C, r0)]
        require_memory(self._call("moved_set", *given, n, k, columns, kinds, found, rest))
        return found, rest

    def set_radius(
        self, value: np.ndarray, error: np.ndarray, G: np.ndarray, R: np.ndarray
    ) -> np.ndarray:
        """Bound components of (value +- error) G r with \\|r\\| <= R, shape (n, kinds)."""
        (n, k), (columns, kinds) = value.shape, R.shape
        require_fit(error.shape == (n, k) and G.shape == (k, columns))
        found = np.empty((n, kinds))
        given = [_reals(array) for array in (value, error, G, R)]
        require_memory(self._call("set_radius", *given, n, k, columns, kinds, found))
        return found

    def boxed_set(
        self, G: np.ndarray, R: np.ndarray, units: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cover sets {G r} with \\|r\\| <= R by {P r'} in as many columns as rows: P and R'."""
        (n, count), kinds = G.shape, R.shape[1]
        require_fit(len(R) == count and len(units) == n)
        P, found = np.empty((n, n)), np.empty((n, kinds))
        given = [_reals(array) for array in (G, R, units)]
        require_memory(self._call("boxed_set", *given, n, count, kinds, P, found))
        return P, found

    def moved_sizes(self, V: np.ndarray, G: np.ndarray, R: np.ndarray) -> np.ndarray:
        """Sum the magnitudes of the coefficients of V G times R, without bounds, shape (dim,)."""
        dim, columns, terms = V.shape
        require_fit(G.shape == (columns, len(R)))
        found = np.empty(dim)
        given = [_reals(array) for array in (V, G.T, R)]
        require_memory(self._call("moved_sizes", *given, dim, columns, terms, len(R), found))
        return found

    def product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Compute a @ b of matrices or vectors, whose sums have one order on every processor."""
        left, right = _reals(a), _reals(b)
        require_fit(left.shape[-1] == len(right))
        out = np.empty((*left.shape[:-1], *right.shape[1:]))
        rows, columns = math.prod(left.shape[:-1]), math.prod(right.shape[1:])
        self._call("product", left, right, rows, len(right), columns, out)
        return out

    def follow(
        self, proof: Record, first: int, last: int, apart: np.ndarray, radius: np.ndarray
    ) -> int:
        """Prove windows of a march up to the last one; return how many were proven.

        - proof: A :class:`~hamsym.kernel.followed.MarchProof`.
        - apart: Coefficients of z^ - y, shape (windows, dim, terms), and ``radius`` bounds on the
          rest of the error, shape (windows, dim), which are written.
        """
        return int(self._call("follow", ctypes.byref(proof), first, last, apart, radius))

    def balance(self, matrix: np.ndarray, units: np.ndarray) -> None:
        """Improve the units of components, in which a matrix of couplings is nearly balanced."""
        require_fit(matrix.shape == (len(units), len(units)))
        self._call("balance", matrix, len(units), units)

    # -- values ----------------------------------------------------------------------------------

    def chebyshev_balls(self, x: tuple[float, float, float], terms: int) -> np.ndarray:
        """Compute balls of T_0(x) .. T_terms-1(x) for a ball x, shape (terms, 3)."""
        out = np.empty((terms, 3))
        self._call("chebyshev_balls", _reals(x), terms, out)
        return out

    def matrix_value(self, series: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute values of series, shape (..., terms), and bounds on their errors."""
        series = _reals(series)
        found, error = np.empty((2, *series.shape[:-1]))
        require_fit(series.shape[-1] <= len(basis))
        self._call("matrix_value", series, basis, found.size, series.shape[-1], found, error)
        return found, error

    def vector_value(self, high: np.ndarray, low: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Compute values of series, shape (n, terms), as balls, shape (n, 3)."""
        found = np.empty((len(high), 3))
        require_fit(high.shape == low.shape and high.shape[1] <= len(basis))
        self._call("vector_value", _reals(high), _reals(low), basis, *high.shape, found)
        return found

    # -- models of trial solutions ---------------------------------------------------------------

    def dense(
        self,
        weights: np.ndarray,
        bias: np.ndarray,
        high: np.ndarray,
        low: np.ndarray,
        radius: np.ndarray,
        length: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Compute models of weights @ f + bias: (high, low, radius, length)."""
        found = _empty_models(len(weights), high.shape[1])
        require_fit(weights.shape == (len(bias), len(high)))
        none = np.empty(0)
        given, out = Models(none, none, high, low, radius, length), Models(none, none, *found)
        pointers = [ctypes.byref(rows) for rows in (given, out)]
        self._call("dense", _reals(weights), _reals(bias), *weights.shape, *pointers)
        return found

    def clenshaw(
        self,
        ch: np.ndarray,
        cl: np.ndarray,
        a: tuple[float, float, float],
        b: tuple[float, float, float],
        terms: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Compute models of sum_k c_k T_k(a + b x) for each column of c, for balls a and b.

        \\|a\\| + \\|b\\| must be at most one, up to rounding.
        """
        found = _empty_models(ch.shape[1], terms)
        require_fit(ch.shape == cl.shape)
        out = Models(np.empty(0), np.empty(0), *found)
        given = _reals(ch), _reals(cl), *ch.shape, _reals(a), _reals(b)
        self._call("clenshaw", *given, ctypes.byref(out))
        return found

    def add_products(
        self,
        found: np.ndarray,
        first: np.ndarray,
        second: np.ndarray,
        rows: np.ndarray,
        others: np.ndarray,
        targets: np.ndarray,
    ) -> None:
        """Add products of coefficients of Taylor models, shape (terms, cells), to their places.

        - rows, others, targets: Places in ``first``, ``second`` and ``found`` of each product.
        """
        given = found, _reals(first), _reals(second), rows, others, targets
        self._call("add_products", *given, len(rows), found.shape[1])


@functools.cache
def enclosures() -> Enclosures:
    """Return the functions of the library for this processor."""
    return Enclosures(kernel_library())


def pointer(array: np.ndarray, kind: str) -> int:
    """Return the address of an array of numbers (p) or of integers, which must be in one piece."""
    if array.dtype.char not in ("d" if kind == "p" else "lq") or not array.flags.c_contiguous:
        raise ValueError(f"the library needs another layout or type than {array.dtype}")
    return address(array)


def _reals(array: ArrayLike) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


def require_fit(fits: bool) -> None:
    """Refuse arrays of which the library would read beyond the end."""
    if not fits:
        raise ValueError("the shapes of the arrays do not fit")


def points_of(rows: np.ndarray) -> int:
    """Return the number of points of values, shape (registers, points)."""
    points = int(rows.shape[1])
    if points % 8:
        raise ValueError(f"{points} points are not a multiple of 8")
    return points


def _empty_models(count: int, terms: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    high, low = np.empty((2, count, terms))
    return high, low, np.empty(count), np.empty(count, dtype=np.int64)
