"""Trial solutions in ball arithmetic: z^(t) as the real function that its float64 numbers define.

What is enclosed is not the rounded evaluation in torch, but the function of a real t given by the
formulas below with every stored number (float64 or float32) as the exact binary fraction it is:

* a deep network (:class:`~hamsym.networks.trial.TrialSolution`), z^(t) = z0 + f(s) N(s) with
  s = (t - t0)/tau, f(s) = 1 - exp(-s) or s, and N the layers W h + b with sin, tanh or
  1/(1 + exp(-a)) between them; the numbers are z0, t0, tau and all W and b;
* features (:class:`~hamsym.random_features.trial.FeatureTrial`), on each closed window [t_a, t_b]

      z^(t) = z_a + (1 - exp(-s)) sum_l T_l(2 s - 1) sum_m S_lm C_m,   s = (t - t_a)/(t_b - t_a),

  with T_l the Chebyshev polynomials; the numbers are the edges t_a, t_b, the states z_a, the series
  S and the readouts C. The length t_b - t_a is the exact difference of two floats. At a joint two
  windows have values that differ by what rounding left between them; both are enclosed.

Everything is in elapsed time, t = t_start + sigma s with sigma = +-1, as in
:mod:`hamsym.proof.taylor`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from flint import arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.errors import CertificationError
from hamsym.networks.network import ComponentNetworks, Network
from hamsym.networks.trial import TrialSolution
from hamsym.proof.balls import ball, interval, working
from hamsym.proof.functions import hyperbolic_tangent
from hamsym.random_features.trial import FeatureTrial

__all__ = ["Segment", "require_exact", "segments"]

_GUARD_BITS = 160  # powers of x in place of T_l(x) cancel; degree 47 costs 60 bits, its shifts more

#: (centre, half width, terms) -> series of each component in the time since the centre
Series = Callable[[Fraction, Fraction, int], list[arb_series]]


@dataclass(frozen=True)
class Segment:
    """z^ on a closed interval of elapsed time where it is one smooth function.

    Attributes
    ----------
    start, end : fractions.Fraction
    series : callable
        (centre, half, terms) -> for each component a series of so many terms whose k-th
        coefficient contains the k-th Taylor coefficient of z^ at every elapsed time from
        centre - half to centre + half.
    """

    start: Fraction
    end: Fraction
    series: Series


def require_exact(trial: Any, dim: int) -> None:
    """Refuse a trial solution whose numbers are not real, finite and as many as they should be.

    Raises
    ------
    CertificationError
        Naming the first tensor or number that is not.
    """
    if not isinstance(trial, TrialSolution | FeatureTrial):
        raise CertificationError(
            f"the trial solution is a {type(trial).__name__}, which has no enclosure; nothing can "
            "be proven"
        )
    for name, array in trial.arrays().items():
        if array.dtype not in (np.float64, np.float32):
            raise CertificationError(
                f"'{name}' of the solution holds numbers of {array.dtype}, not of float64 or "
                "float32; nothing can be proven; solve again"
            )
        if not np.isfinite(array).all():
            raise CertificationError(
                f"'{name}' of the solution is not finite; nothing can be proven; solve again"
            )
    if not _fits_together(trial, dim):
        raise CertificationError(
            "the tensors of the solution do not fit together; nothing can be proven; solve again"
        )
    if isinstance(trial, TrialSolution):
        for name in ("t0", "tau"):
            value = getattr(trial, name)
            if type(value) is not float or not math.isfinite(value) or (name, value) == ("tau", 0):
                raise CertificationError(
                    f"{name} of the solution cannot be used; nothing can be proven; solve again"
                )


def _fits_together(trial: TrialSolution | FeatureTrial, dim: int) -> bool:
    if isinstance(trial, FeatureTrial):
        if trial.readouts.ndim != 3 or trial.series.ndim != 2:
            return False
        count, columns, components = trial.readouts.shape
        return (
            components == dim
            and trial.edges.shape == (count + 1,)
            and trial.states.shape == (count + 1, dim)
            and len(trial.series) > 0
            and trial.series.shape[1] == columns
        )
    whole = trial.network
    outputs = 0
    for part in whole.networks if isinstance(whole, ComponentNetworks) else [whole]:
        assert isinstance(part, Network)
        outputs += part.sizes[-1]
        if part.theta.shape != (sum((n + 1) * m for n, m in pairwise(part.sizes)),):
            return False
    return outputs == dim and trial.z0.shape == (dim,)


def segments(trial: Any, span: tuple[float, float]) -> list[Segment]:
    """The smooth parts of a trial solution over a span, in its direction.

    Raises
    ------
    CertificationError
        If an activation has no enclosure, or the windows do not cover the span.
    """
    start, end = (Fraction(float(time)) for time in span)
    direction = 1 if end > start else -1
    if isinstance(trial, FeatureTrial):
        return _windows(trial, start, abs(end - start), direction)
    network = _DeepNetwork(trial, start, direction)
    return [Segment(Fraction(0), abs(end - start), network.series)]


# -- deep networks ------------------------------------------------------------------------------


def _sigmoid(a: arb_series) -> arb_series:
    return (hyperbolic_tangent(a / 2) + 1) / 2


_ACTIVATIONS: dict[str, Callable[[arb_series], arb_series]] = {
    "sin": lambda a: a.sin(),
    "tanh": hyperbolic_tangent,
    "sigmoid": _sigmoid,
}


def _exponential(s: arb_series) -> arb_series:
    return 1 - (-s).exp()


_ENVELOPES: dict[str, Callable[[arb_series], arb_series]] = {
    "exponential": _exponential,
    "linear": lambda s: s,
}


class _DeepNetwork:
    """z0 + f(s) N(s) as series."""

    def __init__(self, trial: TrialSolution, start: Fraction, direction: int) -> None:
        whole = trial.network
        parts = list(whole.networks) if isinstance(whole, ComponentNetworks) else [whole]
        self._networks = []
        for part in parts:
            assert isinstance(part, Network)
            if part.activation not in _ACTIVATIONS:
                raise CertificationError(f"the activation '{part.activation}' has no enclosure")
            layers = [
                (_matrix(weights.detach().numpy()), _exact(bias.detach().numpy()))
                for weights, bias in part.layers
            ]
            self._networks.append((_ACTIVATIONS[part.activation], layers))
        self._envelope = _ENVELOPES[trial.envelope]
        self._z0 = _exact(trial.z0.numpy())
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


def _exact(numbers: np.ndarray) -> list[arb]:
    """Numbers of an array of one dimension as balls without radius."""
    return [arb(value) for value in numbers.astype(np.float64).tolist()]


def _matrix(numbers: np.ndarray) -> arb_mat:
    rows, columns = numbers.shape
    return arb_mat(rows, columns, _exact(numbers.reshape(-1)))


# -- features -----------------------------------------------------------------------------------


@cache
def _chebyshev_coefficients(count: int) -> list[list[int]]:
    """The integer coefficients of T_0 .. T_count-1 in powers of x."""
    polynomials = [[1], [0, 1]]
    while len(polynomials) < count:
        last, before = polynomials[-1], polynomials[-2]
        doubled = [0, *(2 * value for value in last)]
        before = before + [0] * (len(doubled) - len(before))
        polynomials.append([a - b for a, b in zip(doubled, before, strict=True)])
    return polynomials[:count]


class _Window:
    """One window of features as series."""

    def __init__(
        self,
        start: Fraction,
        length: Fraction,
        state: list[arb],
        readout: np.ndarray,
        series: arb_mat,
    ) -> None:
        # In elapsed time: both are counted in the direction of the span.
        self._start, self._length = start, length
        self._state, self._readout, self._series = state, readout, series
        self._shifted: tuple[Fraction, int, list[arb_poly]] | None = None

    @cached_property
    def _polynomials(self) -> list[arb_poly]:
        """N of each component, in powers of x = 2 s - 1."""
        coefficients = self._series * _matrix(self._readout)  # of T_l, for each component
        rows = coefficients.nrows()
        powers = [[arb(0)] * rows for _ in range(coefficients.ncols())]
        for degree, integers in enumerate(_chebyshev_coefficients(rows)):
            for power, integer in enumerate(integers):
                if integer:
                    for component, column in enumerate(powers):
                        column[power] += integer * coefficients[degree, component]
        return [arb_poly(column) for column in powers]

    def _at(self, centre: Fraction) -> list[arb_poly]:
        """N of each component in the time since a centre, all powers."""
        if self._shifted is None or self._shifted[:2] != (centre, ctx.prec):
            x = 2 * (centre - self._start) / self._length - 1
            line = arb_poly([ball(x), ball(2 / self._length)])
            shifted = [polynomial(line) for polynomial in self._polynomials]
            self._shifted = centre, ctx.prec, shifted
        return self._shifted[2]

    def series(self, centre: Fraction, half: Fraction, terms: int) -> list[arb_series]:
        with working(ctx.prec + _GUARD_BITS, terms):
            networks = self._at(centre)
        with working(ctx.prec, terms):
            if half:
                nearby = arb_poly([interval(-half, half), 1])
                networks = [network(nearby) for network in networks]
            times = interval(centre - half, centre + half) if half else ball(centre)
            length = ball(self._length)
            s = arb_series([(times - ball(self._start)) / length, 1 / length])
            f = _exponential(s)
            return [
                state + f * arb_series(network.coeffs()[:terms])
                for state, network in zip(self._state, networks, strict=True)
            ]


def _windows(
    trial: FeatureTrial, start: Fraction, total: Fraction, direction: int
) -> list[Segment]:
    origin = Fraction(float(trial.origin))
    edges = [direction * (origin + Fraction(edge) - start) for edge in trial.edges.tolist()]
    if any(not low < high for low, high in pairwise(edges)):
        raise CertificationError("the windows of the solution are not in order; solve again")
    if edges[0] > 0 or edges[-1] < total:
        raise CertificationError("the windows do not cover the span; solve again")
    series = _matrix(trial.series)
    found = []
    for k, (low, high) in enumerate(pairwise(edges)):
        first, last = max(low, Fraction(0)), min(high, total)
        if first < last:
            state, readout = _exact(trial.states[k]), trial.readouts[k]
            window = _Window(low, high - low, state, readout, series)
            found.append(Segment(first, last, window.series))
    return found
