"""The boundary-value problem of a periodic orbit: collocation over its arc, and Newton's method.

The arc, the part of the period after which the closing condition holds, is divided into windows
with Chebyshev points. All values at the points, the period and, for families, the energy or a
parameter are unknowns of one Newton iteration. Values inside a window are eliminated
(:mod:`hamsym.orbits.window_maps`), then the states between windows
(:mod:`hamsym.orbits.newton_system`).

Where energy is conserved the equations dz/dt = J grad H + alpha grad H make the system square
(Munoz-Almaraz, Freire, Galan, Doedel & Vanderbauwhede 2003): along a periodic orbit alpha = 0,
because dH/dt = alpha |grad H|^2. Each gradient is taken in units of the components, so that
Newton's iteration comes to the same orbit in all units.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.pairs import Pair
from hamsym.numerics.scales import floored_sizes, paired_sizes
from hamsym.numerics.windows import locate
from hamsym.orbits.period import Period
from hamsym.orbits.symmetry import Closing
from hamsym.random_features.flow import flow_of
from hamsym.support.record_fields import UNSAVED, AnyFloat, floats

_FLOOR = 1e-8  # scale of a component relative to what others make of it


@dataclass(frozen=True)
class Precise:
    """The states and the period of an arc as pairs of float64 numbers."""

    ends: Pair
    values: Pair
    period: Pair


@dataclass(frozen=True)
class Arc:
    """States along an arc, from t = start to start + period/parts."""

    #: Ends of the windows as fractions of the arc.
    edges: Annotated[np.ndarray, floats("windows + 1")]
    #: States there.
    ends: Annotated[np.ndarray, floats("windows + 1", "dim", finite=False)]
    #: States at the Chebyshev points.
    values: Annotated[np.ndarray, floats("windows", "nodes", "dim", finite=False)]
    period: AnyFloat
    #: The same numbers before they were rounded, during a search.
    _precise: Precise | None = field(default=None, repr=False, compare=False, metadata=UNSAVED)

    def check(self) -> None:
        """Raise ValueError unless its windows divide an arc."""
        edges = self.edges
        if not (edges[0] == 0 and edges[-1] == 1 and (np.diff(edges) > 0).all()):
            raise ValueError("the windows of its arc are not in order")
        if self.values.shape[1] < 2:
            raise ValueError("its arc has no states inside its windows")

    @property
    def precise(self) -> Precise:
        """Its states and its period as pairs."""
        if self._precise is not None:
            return self._precise
        ends, values = (Pair(part, np.zeros_like(part)) for part in (self.ends, self.values))
        return Precise(ends, values, Pair(self.period))

    def moved(self, ends: np.ndarray, values: np.ndarray, period: float) -> Arc:
        """Add corrections to the states and to the period, with 106 bits."""
        before = self.precise
        after = Precise(before.ends + ends, before.values + values, before.period + period)
        high = after.ends.high, after.values.high, float(after.period.high)
        return Arc(self.edges, *high, after)

    def rounded(self) -> Arc:
        """Return the arc in float64."""
        return replace(self, _precise=None)

    def at(self, fraction: np.ndarray) -> np.ndarray:
        """Evaluate states at fractions of the arc, shape (n,) -> (n, dim)."""
        return self._inside(*locate(self.edges, fraction))

    def at_shares(self, share: Pair) -> np.ndarray:
        """Evaluate states at fractions of the arc times the period, shape (n,) -> (n, dim)."""
        window, _ = locate(self.edges, share.high / self.period)
        since = share - self.edges[window] * Pair(self.period)
        return self._inside(window, since.high / (np.diff(self.edges)[window] * self.period))

    def _inside(self, window: np.ndarray, s: np.ndarray) -> np.ndarray:
        """Evaluate states at places in [0, 1] of windows, shapes (n,) and (n,) -> (n, dim)."""
        rule = collocation(self.values.shape[1])
        found = np.empty((len(s), self.ends.shape[1]))
        for k in np.unique(window):
            rows = window == k
            found[rows] = rule.interpolated(self.values[k], s[rows])
        return found

    def tails(self, scale: np.ndarray) -> np.ndarray:
        """Size of the last Chebyshev coefficients of each window, relative to the scales."""
        series = np.einsum("ij,kjd->kid", collocation(self.values.shape[1]).to_series, self.values)
        return np.asarray((np.abs(series[:, -3:]) / scale).max(axis=(1, 2)))

    def on(self, edges: np.ndarray, nodes: int) -> Arc:
        """Interpolate to parts of its windows, with another number of points."""
        window, _ = locate(self.edges, (edges[:-1] + edges[1:]) / 2)
        begin, width = self.edges[:-1][window], np.diff(self.edges)[window]
        # Windows may be so short that the points have few digits of their own as fractions.
        places = np.stack([edges[:-1] - begin, edges[1:] - begin], axis=1) / width[:, None]
        rule, inside = collocation(self.values.shape[1]), collocation(nodes).nodes
        values = np.empty((len(window), nodes, self.ends.shape[1]))
        starts = np.empty((len(window), self.ends.shape[1]))
        for low, high in np.unique(places, axis=0).tolist():
            rows = (places == (low, high)).all(axis=1)
            table = rule.interpolation(np.append(low, low + (high - low) * inside))
            found = table @ self.values[window[rows]]
            starts[rows], values[rows] = found[:, 0], found[:, 1:]
        states, own = np.concatenate([starts, self.ends[-1:]]), self.precise
        ends = Pair(states, np.zeros_like(states))
        kept, known = np.isin(edges, self.edges), np.isin(self.edges, edges)
        ends.high[kept], ends.low[kept] = own.ends.high[known], own.ends.low[known]
        precise = Precise(ends, Pair(values, np.zeros_like(values)), own.period)
        return Arc(edges, states, values, self.period, precise)


@dataclass(frozen=True)
class Problem:
    """Conditions on a periodic orbit.

    Attributes
    ----------
    H : Hamiltonian
    closing : Closing
    energy, period : float or None
        What is given. Without both, a conservative H has a family of orbits.
    start : float
        Time at the start of the arc.
    parameter : str or None
        A parameter that is unknown.
    exact_period : Period or None
        The period as a formula, if it is given.
    parameter_size : float
        Size of the unknown parameter, which has a unit.
    """

    H: Hamiltonian
    closing: Closing
    energy: float | None = None
    period: AnyFloat | None = None
    start: float = 0.0
    parameter: str | None = None
    exact_period: Period | None = None
    parameter_size: float = field(default=1.0, metadata=UNSAVED)

    def check(self) -> None:
        """Raise ValueError unless its symmetries and its parameter are those of H."""
        names = self.H.parameter_names
        if self.parameter is not None and self.parameter not in names:
            raise ValueError("it varies a parameter that H does not have")
        self.H.require_parameters()
        if self.energy is not None and not self.conservative:
            raise ValueError("it has an energy that H does not conserve")
        if len(self.closing.shift.places) != self.H.dim:
            raise ValueError("its symmetry has another number of components")

    @property
    def autonomous(self) -> bool:
        return self.H.time is None

    @property
    def conservative(self) -> bool:
        """Whether energy is conserved, so that orbits come in families."""
        return self.H.conserves_energy

    def scale_of(self, arc: Arc) -> np.ndarray:
        """Largest size of each component, with a floor for components that are nearly zero."""
        sizes = np.maximum(np.abs(arc.ends).max(axis=0), np.abs(arc.values).max(axis=(0, 1)))
        return self.floored(sizes, arc, _FLOOR)

    def floored(self, sizes: np.ndarray, arc: Arc, share: float) -> np.ndarray:
        """Raise sizes to a share of those that components have by others along an arc."""
        return floored_sizes(sizes, *self._coupling(arc), share)

    def paired(self, sizes: np.ndarray, arc: Arc) -> np.ndarray:
        """Sizes where all pairs of components move as far as the largest along an arc."""
        return paired_sizes(sizes, *self._coupling(arc))

    def _coupling(self, arc: Arc) -> tuple[np.ndarray, float]:
        times = self.start + arc.edges * (arc.period / self.closing.parts)
        return coupling_along(self.H, arc.ends, times)


def coupling_along(
    H: Hamiltonian, states: np.ndarray, times: np.ndarray
) -> tuple[np.ndarray, float]:
    """Mean of |J Hess| along states at times, shape (dim, dim), and the length of the times."""
    with np.errstate(all="ignore"):
        coupling = np.abs(flow_of(H).jacobian(states, times)).mean(axis=0)
    return coupling, abs(float(times[-1] - times[0]))


def vector_field_at(H: Hamiltonian, state: np.ndarray, time: float) -> np.ndarray:
    """Return the vector field at one state, shape (dim,)."""
    return np.asarray(flow_of(H).vector_field(state[None], np.array([time]))[0])
