"""Functions of the library that the package has only inside of others: balls, and of series."""

from __future__ import annotations

from typing import Any

import numpy as np

from hamsym.kernel.enclosures import Enclosures, pointer
from hamsym.kernel.loops import typed

#: Functions of balls, by their numbers.
BALL_FUNCTIONS = (
    *("add", "multiply", "divide", "scaled", "absolute", "root", "exponential", "logarithm"),
    *("arctangent", "arcsine", "arccosine", "inverse_hyperbolic_sine", "inverse_hyperbolic_cosine"),
    *("inverse_hyperbolic_tangent", "error_function", "sine_cosine"),
)


def _called(L: Enclosures, name: str, signature: str, *arguments: Any) -> Any:
    function, kinds = typed(L.library, f"hamsym_{name}", signature), signature.split()[1]
    given = zip(arguments, kinds, strict=True)
    return function(*[pointer(a, k) if isinstance(a, np.ndarray) else a for a, k in given])


def balls(L: Enclosures, function: str, x: np.ndarray, y: np.ndarray | None = None) -> np.ndarray:
    """Apply one of ``BALL_FUNCTIONS`` to balls, shape (n, 3).

    A ball is scaled by the mid-point of another, which must be a power of two. Results have the
    shape (n, 3), and (n, 2, 3) for the pair of sine and cosine; a bound is a mid-point.
    """
    x = np.ascontiguousarray(x, dtype=float)
    out = np.empty((len(x), 2, 3)) if function == "sine_cosine" else np.empty((len(x), 3))
    second = x if y is None else np.ascontiguousarray(y, dtype=float)
    assert len(x) == len(second)
    number = BALL_FUNCTIONS.index(function)
    _called(L, "balls", "v iippp", number, len(x), x, second, out)
    return out


Series = tuple[np.ndarray, np.ndarray]


def multiply_series(L: Enclosures, a: Series, b: Series, out: Series, twice: bool) -> float:
    """Write the product of two series (high, low); return a bound on its rounding errors."""
    given = *map(np.ascontiguousarray, a), len(a[0]), *map(np.ascontiguousarray, b), len(b[0])
    return float(_called(L, "multiply_series", "d ppippippi", *given, *out, twice))


def integrate_series(L: Enclosures, series: Series, out: Series, twice: bool) -> float:
    """Write the integral from -1 of a series; return a bound on its rounding errors."""
    given = *map(np.ascontiguousarray, series), len(series[0])
    return float(_called(L, "integrate_series", "d ppippi", *given, *out, twice))


def differentiate_series(L: Enclosures, series: Series, out: Series, twice: bool) -> float:
    """Write the derivative of a series; return a bound on its rounding errors."""
    return L.differentiate_series(series, out, twice)
