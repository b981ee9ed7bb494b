"""Balls, series and windows of proofs in the library, as functions of arrays.

A ball is a triple (high, low, radius) of numbers, or a row of an array. What the functions compute
is in ``balls.h``, ``series.h``, ``enclosures.h`` and ``sets.c``, and why their bounds hold, in the
lemmas of examples/guide/how_proofs_work.md.
"""

from __future__ import annotations

import ctypes
import functools
import math
from collections.abc import Sequence
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

#: Functions of balls, by their numbers.
BALL_FUNCTIONS = (
    *("add", "multiply", "divide", "scaled", "absolute", "root", "exponential", "logarithm"),
    *("arctangent", "arcsine", "arccosine", "inverse_hyperbolic_sine", "inverse_hyperbolic_cosine"),
    *("inverse_hyperbolic_tangent", "error_function", "sine_cosine"),
)

# Result and arguments of each function, whose names begin with hamsym_; see loops._KINDS.
_SIGNATURES = {
    "balls": "v iippp",
    "norm": "d ppi",
    "multiply_series": "d ppippippi",
    "integrate_series": "d ppippi",
    "differentiate_series": "d ppippi",
    "end_values": "v ppiiiip",
    "run_series": "v nisi",
    "run_values": "v nipi",
    "collocate": "i ninpippidi",
    "tangents": "i pnpiiippiidpdp",
    "correction": "i pnpiipidppip",
    "defects": "v ninsippp",
    "lemma": "i spppp",
    "moved_set": "i ppppiiiipp",
    "set_radius": "i ppppiiiip",
    "boxed_set": "i pppiiipp",
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
            _pointer(array, "p")
        _pointer(length, "n")
        rows = {"high": high, "low": low, "radius": radius, "length": length}
        super().__init__(terms=terms, values=values, series=series, **rows)


class _Lemma(Record):
    """A step of the lemma of a window."""

    _fields_ = [
        *counts("dim columns terms count"),
        *arrays("jacobian jacobian_radius jacobian_length entries signs start hull V D"),
        *numbers("half"),
        *arrays("units"),
    ]


class Prepared(Record):
    """A program with its models and with values at points, shape (registers, points).

    - registers: ``step`` and ``still_step``, rows (operation, target, first, second);
      ``constant``, ``place`` and ``result``, registers of numbers, of what is still, of results;
      and the ``number`` of each constant, a ball.
    - values_of: Of the terms of models at the points, shape (terms, points).
    """

    _fields_ = [
        *counts("steps still constants places points"),
        *arrays("step still_step constant place result number rows values_of values"),
    ]

    def __init__(
        self, models: Models, values_of: np.ndarray, values: np.ndarray, **registers: np.ndarray
    ) -> None:
        for name, array in registers.items():
            _pointer(array, "p" if name == "number" else "n")
        sizes = [len(registers[name]) for name in ("step", "still_step", "constant", "place")]
        names = ("steps", "still", "constants", "places")
        super().__init__(
            **dict(zip(names, sizes, strict=True)),
            points=_points(values),
            **registers,
            rows=models,
            values_of=values_of,
            values=values,
        )


class MarchProof(Record):
    """A march and the state of its proof, which the library changes.

    - entries, placed: Rows (i, j, place) with results and with registers; ``signs`` beside them.
    - integral: At the points of y; ``fewer_steps`` are those of V; see :meth:`Enclosures.tangents`.
    - fewer: From values at the points of y to those at the points of V.
    - features: Models of the features on a window, and readouts, shape (windows, dim, features).
    - states, edges: Of the windows, shapes (windows + 1, dim) and (windows + 1,).
    - most: Columns of the set.
    """

    _fields_ = [
        *counts("dim entries inner most orders"),
        *arrays("rates jacobian energy entry placed signs integral fewer_steps fewer"),
        *arrays("features trial"),
        *arrays("readouts states edges"),
        *numbers("origin"),
        *arrays("sizes couplings centre centre_low G R"),
        *counts("columns"),
    ]

    def __init__(
        self,
        programs: Sequence[Prepared],
        entries: np.ndarray,
        placed: np.ndarray,
        signs: np.ndarray,
        integral: np.ndarray,
        fewer_steps: np.ndarray,
        fewer: np.ndarray,
        features: Models,
        readouts: np.ndarray,
        states: np.ndarray,
        edges: np.ndarray,
        origin: float,
        most: int,
    ) -> None:
        windows, dim, inner = readouts.shape
        _require(states.shape == (windows + 1, dim) and edges.shape == (windows + 1,))
        for array, kind in ((readouts, "p"), (states, "p"), (edges, "p"), (entries, "n")):
            _pointer(array, kind)
        rates, jacobian, energy = programs
        (high, low), length = np.zeros((2, dim, features.terms)), np.ones(dim, dtype=np.int64)
        tables = features["values"], features["series"]
        trial = Models(*tables, high, low, np.zeros(dim), length)
        super().__init__(
            dim=dim,
            entries=len(entries),
            inner=inner,
            most=most,
            rates=rates,
            jacobian=jacobian,
            energy=energy,
            entry=entries,
            placed=placed,
            signs=signs,
            integral=integral,
            fewer_steps=fewer_steps,
            orders=fewer_steps.shape[2],
            fewer=fewer,
            features=features,
            trial=trial,
            readouts=readouts,
            states=states,
            edges=edges,
            origin=origin,
            sizes=np.zeros(dim),
            couplings=np.zeros((dim, dim)),
            centre=states[0].copy(),
            centre_low=np.zeros(dim),
            G=np.zeros((dim, most)),
            R=np.zeros(most),
            columns=0,
        )


class Enclosures:
    """The functions of a library."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._functions = {
            name: (typed(library, f"hamsym_{name}", signature), signature.split()[1])
            for name, signature in _SIGNATURES.items()
        }

    def _call(self, name: str, *arguments: Any) -> Any:
        """Call a function; arrays, which must have their numbers in one piece, become pointers."""
        function, kinds = self._functions[name]
        given = zip(arguments, kinds, strict=True)
        return function(*[_pointer(a, k) if isinstance(a, np.ndarray) else a for a, k in given])

    # -- balls -----------------------------------------------------------------------------------

    def balls(self, function: str, x: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
        """Apply one of ``BALL_FUNCTIONS`` to balls, shape (n, 3).

        A ball is scaled by the mid-point of another, which must be a power of two. Results have
        the shape (n, 3), and (n, 2, 3) for the pair of sine and cosine; a bound is a mid-point.
        """
        x = _reals(x)
        out = np.empty((len(x), 2, 3)) if function == "sine_cosine" else np.empty((len(x), 3))
        second = x if y is None else _reals(y)
        _require(len(x) == len(second))
        self._call("balls", BALL_FUNCTIONS.index(function), len(x), x, second, out)
        return out

    # -- series ----------------------------------------------------------------------------------

    def norm(self, high: np.ndarray, low: np.ndarray) -> float:
        """Bound the sum of the magnitudes of the coefficients of a series."""
        return float(self._call("norm", _reals(high), _reals(low), len(high)))

    def multiply_series(
        self,
        first: tuple[np.ndarray, np.ndarray],
        second: tuple[np.ndarray, np.ndarray],
        out: tuple[np.ndarray, np.ndarray],
        twice: bool,
    ) -> float:
        """Write the product of two series (high, low); return a bound on its rounding errors."""
        factors = [*map(_reals, first), len(first[0]), *map(_reals, second), len(second[0])]
        return float(self._call("multiply_series", *factors, *out, twice))

    def integrate_series(
        self, series: tuple[np.ndarray, np.ndarray], out: tuple[np.ndarray, np.ndarray], twice: bool
    ) -> float:
        """Write the integral from -1 of a series; return a bound on its rounding errors."""
        given = [*map(_reals, series), len(series[0])]
        return float(self._call("integrate_series", *given, *out, twice))

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
        self._call("run_values", program, len(program), rows, _points(rows))

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
        given = program, len(program), results, rows, _points(rows), _reals(integral), start
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
        _require(steps.shape[:2] == series.shape == (points, points))
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

    def transport(
        self,
        jacobian: np.ndarray,
        jacobian_radius: np.ndarray,
        jacobian_length: np.ndarray,
        entries: np.ndarray,
        signs: np.ndarray,
        start: np.ndarray,
        hull: np.ndarray,
        V: np.ndarray,
        D: np.ndarray,
        half: float,
        units: np.ndarray,
        dim: int,
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Compute the bounds of the lemma: on |z - y|, |d - K xi|, |V_d - K|; and m.

        - jacobian, jacobian_radius, jacobian_length: Models of the entries of DG over the tube, in
          the order of ``entries``.
        - entries, signs: Rows (i, j, place); signs.
        - start: Bounds on \\|xi\\|, shape (columns,).
        - hull: Bounds on \\|V xi\\| over the window, shape (dim,).
        - V: Coefficients, shape (dim, columns, terms).
        - D: Bounds on \\|D\\|, shape (dim,).
        - half: An upper bound on w.
        - units: Shape (dim,), any numbers > 0.
        """
        _, columns, terms = V.shape
        if jacobian.shape[1:] != (terms,):
            raise ValueError(f"models of {jacobian.shape[1]} terms beside V of {terms}")
        (tube, d), derivative, norm = np.empty((2, dim)), np.empty((dim, columns)), np.empty(1)
        step = _Lemma(
            dim=dim,
            columns=columns,
            terms=terms,
            count=len(entries),
            jacobian=jacobian,
            jacobian_radius=jacobian_radius,
            jacobian_length=jacobian_length,
            entries=entries,
            signs=signs,
            start=start,
            hull=hull,
            V=V,
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
        _require(J_error.shape == (n, k) and C.shape == (k, columns))
        found, rest = np.empty((n, columns)), np.empty((n, kinds))
        given = [_reals(array) for array in (J, J_error, C, r0)]
        require_memory(self._call("moved_set", *given, n, k, columns, kinds, found, rest))
        return found, rest

    def set_radius(
        self, value: np.ndarray, error: np.ndarray, G: np.ndarray, R: np.ndarray
    ) -> np.ndarray:
        """Bound components of (value +- error) G r with \\|r\\| <= R, shape (n, kinds)."""
        (n, k), (columns, kinds) = value.shape, R.shape
        _require(error.shape == (n, k) and G.shape == (k, columns))
        found = np.empty((n, kinds))
        given = [_reals(array) for array in (value, error, G, R)]
        require_memory(self._call("set_radius", *given, n, k, columns, kinds, found))
        return found

    def boxed_set(
        self, G: np.ndarray, R: np.ndarray, units: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Cover sets {G r} with \\|r\\| <= R by {P r'} in as many columns as rows: P and R'."""
        (n, count), kinds = G.shape, R.shape[1]
        _require(len(R) == count and len(units) == n)
        P, found = np.empty((n, n)), np.empty((n, kinds))
        given = [_reals(array) for array in (G, R, units)]
        require_memory(self._call("boxed_set", *given, n, count, kinds, P, found))
        return P, found

    def product(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Compute a @ b of matrices or vectors, whose sums have one order on every processor."""
        left, right = _reals(a), _reals(b)
        _require(left.shape[-1] == len(right))
        out = np.empty((*left.shape[:-1], *right.shape[1:]))
        rows, columns = math.prod(left.shape[:-1]), math.prod(right.shape[1:])
        self._call("product", left, right, rows, len(right), columns, out)
        return out

    def follow(
        self, proof: MarchProof, first: int, last: int, apart: np.ndarray, radius: np.ndarray
    ) -> int:
        """Prove windows of a march up to the last one; return how many were proven.

        - apart: Coefficients of z^ - y, shape (windows, dim, terms), and ``radius`` bounds on the
          rest of the error, shape (windows, dim), which are written.
        """
        return int(self._call("follow", ctypes.byref(proof), first, last, apart, radius))

    def balance(self, matrix: np.ndarray, units: np.ndarray) -> None:
        """Improve the units of components, in which a matrix of couplings is nearly balanced."""
        _require(matrix.shape == (len(units), len(units)))
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
        _require(series.shape[-1] <= len(basis))
        self._call("matrix_value", series, basis, found.size, series.shape[-1], found, error)
        return found, error

    def vector_value(self, high: np.ndarray, low: np.ndarray, basis: np.ndarray) -> np.ndarray:
        """Compute values of series, shape (n, terms), as balls, shape (n, 3)."""
        found = np.empty((len(high), 3))
        _require(high.shape == low.shape and high.shape[1] <= len(basis))
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
        _require(weights.shape == (len(bias), len(high)))
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
        _require(ch.shape == cl.shape)
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


def _pointer(array: np.ndarray, kind: str) -> int:
    if array.dtype.char not in ("d" if kind == "p" else "lq") or not array.flags.c_contiguous:
        raise ValueError(f"the library needs another layout or type than {array.dtype}")
    return address(array)


def _reals(array: ArrayLike) -> np.ndarray:
    return np.ascontiguousarray(array, dtype=float)


def _require(fits: bool) -> None:
    """Refuse arrays of which the library would read beyond the end."""
    if not fits:
        raise ValueError("the shapes of the arrays do not fit")


def _points(rows: np.ndarray) -> int:
    points = int(rows.shape[1])
    if points % 8:
        raise ValueError(f"{points} points are not a multiple of 8")
    return points


def _empty_models(count: int, terms: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    high, low = np.empty((2, count, terms))
    return high, low, np.empty(count), np.empty(count, dtype=np.int64)
