"""The boundary-value problem of a periodic orbit: collocation over its arc, and Newton's method.

The arc, the part of the period after which the closing condition holds, is divided into windows
with Chebyshev points. All values at the points, the period and, for families, the energy or a
parameter are unknowns of one Newton iteration. Values inside a window are eliminated
(:mod:`hamsym.orbits.window_maps`), then the states between windows
(:mod:`hamsym.orbits.newton_system`).

Where energy is conserved the equations dz/dt = J grad H + alpha grad H make the system square
(Munoz-Almaraz, Freire, Galan, Doedel & Vanderbauwhede 2003): along a periodic orbit alpha = 0,
because dH/dt = alpha |grad H|^2.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.scales import floored_sizes
from hamsym.numerics.windows import locate
from hamsym.orbits.period import Period
from hamsym.orbits.symmetry import Closing
from hamsym.random_features.flow import flow_of
from hamsym.support.record_fields import AnyFloat, floats

_FLOOR = 1e-8  # scale of a component relative to the largest of its kind


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

    def check(self) -> None:
        """Raise ValueError unless its windows divide an arc."""
        edges = self.edges
        if not (edges[0] == 0 and edges[-1] == 1 and (np.diff(edges) > 0).all()):
            raise ValueError("the windows of its arc are not in order")
        if self.values.shape[1] < 2:
            raise ValueError("its arc has no states inside its windows")

    @property
    def scale(self) -> np.ndarray:
        """Largest size of each component, with a floor for components that are nearly zero."""
        sizes = np.maximum(np.abs(self.ends).max(axis=0), np.abs(self.values).max(axis=(0, 1)))
        return floored_sizes(sizes, _FLOOR)

    def at(self, fraction: np.ndarray) -> np.ndarray:
        """Evaluate states at fractions of the arc, shape (n,) -> (n, dim)."""
        window, s = locate(self.edges, fraction)
        rule = collocation(self.values.shape[1])
        found = np.empty((len(fraction), self.ends.shape[1]))
        for k in np.unique(window):
            rows = window == k
            found[rows] = rule.interpolation(s[rows]) @ self.values[k]
        return found

    def tails(self) -> np.ndarray:
        """Size of the last Chebyshev coefficients of each window, relative to the scales."""
        series = np.einsum("ij,kjd->kid", collocation(self.values.shape[1]).to_series, self.values)
        return np.asarray((np.abs(series[:, -3:]) / self.scale).max(axis=(1, 2)))

    def on(self, edges: np.ndarray, nodes: int) -> Arc:
        """Interpolate to other windows with another number of points."""
        points = edges[:-1, None] + np.diff(edges)[:, None] * collocation(nodes).nodes
        values = self.at(points.ravel()).reshape(*points.shape, -1)
        return Arc(edges, self.at(edges), values, self.period)


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
    """

    H: Hamiltonian
    closing: Closing
    energy: float | None = None
    period: AnyFloat | None = None
    start: float = 0.0
    parameter: str | None = None
    exact_period: Period | None = None

    def check(self) -> None:
        """Raise ValueError unless its symmetries and its parameter are those of H."""
        names = self.H.parameter_names
        if self.parameter is not None and self.parameter not in names:
            raise ValueError("it varies a parameter that H does not have")
        self.H.require_parameters()
        if len(self.closing.shift.places) != self.H.dim:
            raise ValueError("its symmetry has another number of components")

    @property
    def autonomous(self) -> bool:
        return self.H.time is None

    @property
    def conservative(self) -> bool:
        """Whether energy is conserved, so that orbits come in families."""
        return self.H.conserves_energy


def vector_field_at(H: Hamiltonian, state: np.ndarray, time: float) -> np.ndarray:
    """Return the vector field at one state, shape (dim,)."""
    return np.asarray(flow_of(H).vector_field(state[None], np.array([time]))[0])
