"""The public function z^ of a solution, from its stored numbers, on parts of the span.

Numbers are exact binary fractions. On a window z^ = z_a + f(s) N(s), with s = (t - t_a) / tau,
f = 1 - exp(-s) or s, and N a Chebyshev series of features, or a network of sines, tanh or sigmoids.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import acb, arb, arb_mat, arb_poly, arb_series

from hamsym.proof.checker.formulas import NotProvenError, ball
from hamsym.proof.checker.motion import Polynomial, coefficients


@dataclass(frozen=True)
class Window:
    """A part of the span on which z^ is one analytic function."""

    start: Fraction
    end: Fraction
    #: (middle, r) -> (x -> z^ at t = middle + r x).
    on: Callable[[Fraction, Fraction], Callable[[Any], list[Any]]]


def windows(trial: Mapping[str, Any], dim: int) -> list[Window]:
    """The windows of a trial solution, from its data."""
    if trial["kind"] == "features":
        origin = Fraction(trial["origin"])
        edges = [origin + Fraction(edge) for edge in trial["edges"]]
        series = _monomials(arb_mat(trial["series"]))
        return [
            Window(a, b, _Features(a, b - a, trial["states"][k], series, trial["readouts"][k]).on)
            for k, (a, b) in enumerate(pairwise(edges))
        ]
    networks = trial["pieces"]
    edges = [Fraction(network["t0"]) for network in networks] + [Fraction(trial["end"])]
    return [
        Window(a, b, _Networks(network, dim).on)
        for network, (a, b) in zip(networks, pairwise(edges), strict=True)
    ]


def _line(
    start: Fraction, tau: Fraction, middle: Fraction, r: Fraction
) -> tuple[Fraction, Fraction]:
    """The coefficients of s in x."""
    return (middle - start) / tau, r / tau


def _monomials(series: arb_mat) -> arb_mat:
    """Chebyshev series, one a column, as powers."""
    count, rows = series.nrows(), [[1], [0, 1]]
    for _ in range(count - 2):
        doubled = [0, *(2 * c for c in rows[-1])]
        rows.append([c - (rows[-2][k] if k < len(rows[-2]) else 0) for k, c in enumerate(doubled)])
    table = [[row[k] if k < len(row) else 0 for row in rows[:count]] for k in range(count)]
    return arb_mat(table) * series


class _Features:
    def __init__(
        self,
        start: Fraction,
        tau: Fraction,
        state: Sequence[float],
        series: arb_mat,
        readout: Sequence[Sequence[float]],
    ) -> None:
        self._start, self._tau, self._state = start, tau, state
        found = series * arb_mat([list(row) for row in readout])
        rows, dim = range(found.nrows()), found.ncols()
        self._networks = [arb_poly([found[k, i] for k in rows]) for i in range(dim)]

    def on(self, middle: Fraction, r: Fraction) -> Callable[[Any], list[Any]]:
        s, slope = _line(self._start, self._tau, middle, r)
        place = arb_poly([ball(2 * s - 1), ball(2 * slope)])
        networks = [Polynomial(network(place).coeffs()) for network in self._networks]

        def at(x: Any) -> list[Any]:
            f = 1 - (-(ball(s) + ball(slope) * x)).exp()
            pairs = zip(self._state, networks, strict=True)
            return [arb(state) + f * network(x) for state, network in pairs]

        return at


class _Networks:
    def __init__(self, network: Mapping[str, Any], dim: int) -> None:
        self._data, self._tau = network, Fraction(network["tau"])
        self._start, self._z0 = Fraction(network["t0"]), network["z0"]
        if network["envelope"] not in ("exponential", "linear") or len(self._z0) != dim:
            raise NotProvenError("the network is none that is covered")
        self._parts = [list(_layers(theta, network["sizes"])) for theta in network["weights"]]

    def on(self, middle: Fraction, r: Fraction) -> Callable[[Any], list[Any]]:
        start, slope = _line(self._start, self._tau, middle, r)

        def at(x: Any) -> list[Any]:
            s = ball(start) + ball(slope) * x
            f = s if self._data["envelope"] == "linear" else 1 - (-s).exp()
            networks = [value for part in self._parts for value in self._values(part, s)]
            return [arb(z) + f * N for z, N in zip(self._z0, networks, strict=True)]

        return at

    def _values(self, layers: list[tuple[Any, list[float]]], s: Any) -> list[Any]:
        values = [s]
        for depth, (matrix, bias) in enumerate(layers):
            if depth:
                values = [_ACTIVATIONS[self._data["activation"]](value) for value in values]
            values = [a + arb(b) for a, b in zip(_product(matrix, values), bias, strict=True)]
        return values


def _layers(theta: Sequence[float], sizes: Sequence[int]) -> Any:
    first = 0
    for inputs, neurons in pairwise(sizes):
        last = first + inputs * neurons
        yield arb_mat(neurons, inputs, list(theta[first:last])), list(theta[last : last + neurons])
        first = last + neurons
    if first != len(theta):
        raise NotProvenError("the weights are not those of the layers")


def _product(matrix: arb_mat, values: list[Any]) -> list[Any]:
    """A matrix times a column of series or of complex numbers."""
    rows = range(matrix.nrows())
    if isinstance(values[0], arb_series):
        count = values[0].prec
        found = matrix * arb_mat([coefficients(value, count) for value in values])
        return [arb_series([found[i, k] for k in range(count)], count) for i in rows]
    found = matrix * arb_mat([[value.real, value.imag] for value in values])
    return [acb(found[i, 0], found[i, 1]) for i in rows]


_ACTIVATIONS: dict[str, Callable[[Any], Any]] = {
    "sin": lambda a: a.sin(),
    "tanh": lambda a: 1 - 2 / ((2 * a).exp() + 1),
    "sigmoid": lambda a: 1 / ((-a).exp() + 1),
}
