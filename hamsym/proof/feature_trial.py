"""The windows of a march in ball arithmetic."""

from __future__ import annotations

from fractions import Fraction
from functools import cache, cached_property
from itertools import pairwise

import numpy as np
from flint import arb, arb_mat, arb_poly, arb_series, ctx

from hamsym.errors import CertificationError
from hamsym.proof.balls import ball, interval, working
from hamsym.proof.segments import Segment, exact_balls, exact_matrix, exponential
from hamsym.random_features.trial import FeatureTrial

__all__ = ["feature_segments", "features_fit"]

_GUARD_BITS = 160  # for cancellation between powers of x; degree 47 costs 60 bits, its shifts more


def features_fit(trial: FeatureTrial, dim: int) -> bool:
    """Whether the arrays have shapes that belong together."""
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
        coefficients = self._series * exact_matrix(self._readout)  # of T_l, for each component
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
            f = exponential(s)
            return [
                state + f * arb_series(network.coeffs()[:terms])
                for state, network in zip(self._state, networks, strict=True)
            ]


def feature_segments(
    trial: FeatureTrial, start: Fraction, total: Fraction, direction: int
) -> list[Segment]:
    """The windows that cover a span, in its direction."""
    origin = Fraction(float(trial.origin))
    edges = [direction * (origin + Fraction(edge) - start) for edge in trial.edges.tolist()]
    if any(not low < high for low, high in pairwise(edges)):
        raise CertificationError("the windows of the solution are not in order; solve again")
    if edges[0] > 0 or edges[-1] < total:
        raise CertificationError("the windows do not cover the span; solve again")
    series = exact_matrix(trial.series)
    found = []
    for k, (low, high) in enumerate(pairwise(edges)):
        first, last = max(low, Fraction(0)), min(high, total)
        if first < last:
            state, readout = exact_balls(trial.states[k]), trial.readouts[k]
            window = _Window(low, high - low, state, readout, series)
            found.append(Segment(first, last, window.series))
    return found
