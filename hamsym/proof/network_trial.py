"""A deep network z^(t) = z0 + f(s) N(s) in ball arithmetic."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from fractions import Fraction

from flint import arb, arb_mat, arb_series, ctx

from hamsym.errors import CertificationError
from hamsym.networks.chain import Chain
from hamsym.networks.network import weights_of
from hamsym.networks.trial import TrialSolution
from hamsym.proof.balls import ball, interval, working
from hamsym.proof.functions import hyperbolic_tangent
from hamsym.proof.segments import Segment, exact_balls, exact_matrix, exponential

__all__ = ["networks_fit", "networks_segments"]


def network_fits(trial: TrialSolution, dim: int) -> bool:
    """Whether the weights have the shapes that their layers need, and the outputs are dim.

    Raises
    ------
    CertificationError
        If ``t0`` or ``tau`` cannot be used.
    """
    if sum(part.sizes[-1] for part in trial.parts) != dim or trial.z0.shape != (dim,):
        return False
    if any(part.theta.shape != (weights_of(part.sizes),) for part in trial.parts):
        return False
    for name in ("t0", "tau"):
        value = getattr(trial, name)
        if type(value) is not float or not math.isfinite(value) or (name, value) == ("tau", 0):
            raise CertificationError(
                f"{name} of the solution is not a finite, nonzero float64 number; solve again"
            )
    return True


def networks_fit(trial: TrialSolution | Chain, dim: int) -> bool:
    """Whether all networks of a trial solution fit, as :func:`network_fits` says."""
    pieces = trial.pieces if isinstance(trial, Chain) else (trial,)
    return bool(pieces) and all(network_fits(piece, dim) for piece in pieces)


def networks_segments(
    trial: TrialSolution | Chain, start: Fraction, total: Fraction, direction: int
) -> list[Segment]:
    """The whole span as one smooth piece, or one for each window of a chain.

    Raises
    ------
    CertificationError
        If the windows of a chain do not cover the span.
    """
    if isinstance(trial, TrialSolution):
        network = _DeepNetwork(trial, start, direction)
        return [Segment(Fraction(0), total, network.series)]
    edges = [direction * (Fraction(edge) - start) for edge in trial.edges.tolist()]
    if edges[0] != 0 or edges[-1] != total or any(a >= b for a, b in itertools.pairwise(edges)):
        raise CertificationError("the windows of the chain do not cover the span; solve again")
    return [
        Segment(low, high, _DeepNetwork(piece, start, direction).series)
        for piece, (low, high) in zip(trial.pieces, itertools.pairwise(edges), strict=True)
    ]


def _sigmoid(a: arb_series) -> arb_series:
    return (hyperbolic_tangent(a / 2) + 1) / 2


_ACTIVATIONS: dict[str, Callable[[arb_series], arb_series]] = {
    "sin": lambda a: a.sin(),
    "tanh": hyperbolic_tangent,
    "sigmoid": _sigmoid,
}


_ENVELOPES: dict[str, Callable[[arb_series], arb_series]] = {
    "exponential": exponential,
    "linear": lambda s: s,
}


class _DeepNetwork:
    """z0 + f(s) N(s) as series."""

    def __init__(self, trial: TrialSolution, start: Fraction, direction: int) -> None:
        self._networks = []
        for part in trial.parts:
            if part.activation not in _ACTIVATIONS:
                raise CertificationError(f"the activation '{part.activation}' has no enclosure")
            layers = [
                (exact_matrix(weights.detach().numpy()), exact_balls(bias.detach().numpy()))
                for weights, bias in part.layers
            ]
            self._networks.append((_ACTIVATIONS[part.activation], layers))
        self._envelope = _ENVELOPES[trial.envelope]
        self._z0 = exact_balls(trial.z0.numpy())
        self._start, self._direction = start, direction
        self._t0, self._tau = Fraction(trial.t0), Fraction(trial.tau)

    def series(self, centre: Fraction, half: Fraction, terms: int) -> list[arb_series]:
        with working(ctx.prec, terms):
            times = interval(centre - half, centre + half) if half else ball(centre)
            t = ball(self._start - self._t0) + self._direction * times
            tau = ball(self._tau)
            s = arb_series([t / tau, self._direction / tau])
            outputs = [
                output
                for activation, layers in self._networks
                for output in _propagate(activation, layers, s, terms)
            ]
            f = self._envelope(s)
            return [z0 + f * output for z0, output in zip(self._z0, outputs, strict=True)]


def _propagate(
    activation: Callable[[arb_series], arb_series],
    layers: Sequence[tuple[arb_mat, list[arb]]],
    s: arb_series,
    terms: int,
) -> list[arb_series]:
    """A network's outputs: all Taylor coefficients of a layer in one product of matrices."""
    rows = [s]
    for depth, (matrix, bias) in enumerate(layers):
        if depth:
            rows = [activation(row) for row in rows]
        entries = [entry for row in rows for entry in _padded(row, terms)]
        product = (matrix * arb_mat(len(rows), terms, entries)).table()
        rows = []
        for coefficients, shift in zip(product, bias, strict=True):
            coefficients[0] += shift
            rows.append(arb_series(coefficients))
    return rows


def _padded(series: arb_series, terms: int) -> list[arb]:
    coefficients = series.coeffs()
    return coefficients + [arb(0)] * (terms - len(coefficients))
