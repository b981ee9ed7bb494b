"""The public function z^ of a solution, from its stored numbers, on parts of the span.

Numbers are exact binary fractions. On a window z^ = z_a + f(s) N(s), with s = (t - t_a) / tau,
f = 1 - exp(-s) or s, and N a Chebyshev series of features, or a network of sines, tanh or sigmoids.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any

from flint import acb, arb, arb_mat, arb_poly, arb_series

from hamsym.proof.checker.formulas import NotProvenError, ball
from hamsym.proof.checker.functions import Interval, Polynomial, chebyshev, coefficients

#: A part of the window in s -> (x -> N(s)).
_Network = Callable[[Interval], Callable[[Any], list[Any]]]


@dataclass(frozen=True)
class Window:
    """A part of the span on which z^ is one analytic function."""

    start: Fraction
    end: Fraction
    tau: Fraction
    state: Sequence[float]
    linear: bool
    network: _Network

    def on(self, part: Interval) -> Callable[[Any], list[Any]]:
        """The function x -> z^ on a part of the window."""
        s = Interval((part.middle - self.start) / self.tau, part.r / self.tau)
        network = self.network(s)

        def at(x: Any) -> list[Any]:
            f = s.time(x) if self.linear else 1 - (-s.time(x)).exp()
            return [arb(z) + f * N for z, N in zip(self.state, network(x), strict=True)]

        return at


def windows(trial: Mapping[str, Any], dim: int) -> list[Window]:
    """The windows of a trial solution.

    - trial: Its data: "kind" is "features", with "origin", "edges", "states", "series" and
      "readouts", or "networks", with "pieces" and the "end" of the last one.
    """
    if trial["kind"] == "features":
        edges = [Fraction(trial["origin"]) + Fraction(edge) for edge in trial["edges"]]
        parts = zip(pairwise(edges), trial["states"], trial["readouts"], strict=False)
        return [
            Window(
                a, b, b - a, state, False, _features(arb_mat(trial["series"]) * arb_mat(readout))
            )
            for (a, b), state, readout in parts
        ]
    pieces = trial["pieces"]
    edges = [*(Fraction(piece["t0"]) for piece in pieces), Fraction(trial["end"])]
    found = []
    for piece, (a, b) in zip(pieces, pairwise(edges), strict=True):
        if piece["envelope"] not in ("exponential", "linear") or len(piece["z0"]) != dim:
            raise NotProvenError("the network is none that is covered")
        tau, linear = Fraction(piece["tau"]), piece["envelope"] == "linear"
        found.append(Window(a, b, tau, piece["z0"], linear, _network(piece)))
    return found


def _features(series: arb_mat) -> _Network:
    """Chebyshev series in 2 s - 1, one a column."""

    def on(s: Interval) -> Callable[[Any], list[Any]]:
        line = arb_poly([ball(2 * s.middle - 1), ball(2 * s.r)])
        powers = [coefficients(T, series.nrows()) for T in chebyshev(line, series.nrows())]
        found = arb_mat(powers).transpose() * series
        polynomials = [Polynomial(column) for column in found.transpose().tolist()]
        return lambda x: [polynomial(x) for polynomial in polynomials]

    return on


def _network(piece: Mapping[str, Any]) -> _Network:
    """A fully connected network, or one for each component."""
    parts = [list(_layers(theta, piece["sizes"])) for theta in piece["weights"]]
    activation = _ACTIVATIONS[piece["activation"]]

    def value(layers: list[tuple[arb_mat, list[float]]], s: Any) -> list[Any]:
        values = [s]
        for depth, (matrix, bias) in enumerate(layers):
            inner = [activation(value) for value in values] if depth else values
            values = [a + arb(b) for a, b in zip(_product(matrix, inner), bias, strict=True)]
        return values

    return lambda s: lambda x: [N for part in parts for N in value(part, s.time(x))]


def _layers(theta: Sequence[float], sizes: Sequence[int]) -> Iterator[tuple[arb_mat, list[float]]]:
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
