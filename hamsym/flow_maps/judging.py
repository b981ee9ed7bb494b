"""Error of a flow map over its whole box, estimated in four ways.

1. Solutions at random points of the box, at its corners and on its faces, none of them used to
   build the map, are compared with it at random times.
2. So are solutions from places where H may have a narrow feature
   (:mod:`hamsym.flow_maps.narrow_places`), at its times too. A map that misses one is refused.
3. Around the worst points found, an adversarial search looks for worse ones.
4. The linear equation of the error (the paper's eq. ell) is solved from the residual of the map, at
   random points and at the worst ones found.

The estimate is the largest difference or error found, times a factor for what lies between the
places, with the estimated error of the solutions.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from hamsym.families.solutions import Solutions
from hamsym.flow_maps.box import Box
from hamsym.flow_maps.domain import Domain, random_places
from hamsym.flow_maps.narrow_places import narrow_places
from hamsym.hamiltonian import Hamiltonian
from hamsym.numerics.collocation import collocation
from hamsym.numerics.linear_systems import solved
from hamsym.numerics.scales import tangent_scales
from hamsym.numerics.symplectic import poisson_matrix
from hamsym.support.record_fields import AnyFloat, Count, floats

_MARGIN = 1.5  # times the largest error found
_CONFIDENCE = 0.95
_NARROW = 10.0  # times the largest other error, of one that a narrow feature causes
_CORNERS = 64
_AT_END = 0.3  # probability that an input of a point of the second kind is an end of its interval
_TIMES = 48  # of each comparison
_ELITE, _CHILDREN = 12, 8
_WIDTHS = (0.2, 0.1, 0.05, 0.02, 0.01, 0.004)  # of the search, in scaled inputs
_LINEAR = 8  # places of each kind at which the linear equation is solved
_NODES = 24  # in each piece of the time, for the linear equation
_INSIDE = 5e-9  # of a piece; the square is round-off


@dataclass(frozen=True)
class Judgement:
    """Estimated error of a map over its box."""

    #: Estimated largest error of each component.
    error: Annotated[np.ndarray, floats("dim", finite=False)]
    #: Largest error by the linear equation at the places where it was solved.
    linear: Annotated[np.ndarray, floats("dim", finite=False)]
    worst_time: AnyFloat
    #: Where the largest error was found.
    worst_inputs: Annotated[np.ndarray, floats("inputs")]
    #: points, share: Number of random points, and the share of the box for which these bound the
    #: error, with a confidence of 95 %.
    points: Count
    share: AnyFloat
    #: Largest entry of M^T J M - J in units of the components, M = dz^/dz0; None unless all
    #: components vary.
    symplecticity: AnyFloat | None
    #: A solution that could not be compared, or a narrow feature that the map misses; empty if
    #: there is none.
    failure: str


def judged(
    map: Any,
    box: Box,
    span: tuple[float, float],
    edges: np.ndarray,
    solve: Callable[..., Solutions],
    allowed: np.ndarray,
    scale: np.ndarray,
    random: np.random.Generator,
    points: int,
) -> Judgement:
    """Estimate the error of a map over a box and a span.

    - edges: Times at which the map may have a kink, in order, with both ends of the span.
    - solve: (initial states, parameter values, span) -> Solutions.
    - allowed, scale: Allowed error and size of each component, shape (dim,).
    - points: Number of random points.
    """
    search = _Search(map, box, span, solve, allowed, random)
    d = len(box)
    uniform = random.uniform(-1, 1, (points, d))
    faces = random_places(random, points // 2, d, _AT_END)
    corners = random.choice((-1.0, 1.0), (min(_CORNERS, 2**d), d))
    search.compare(uniform)
    search.compare(np.concatenate((faces, corners)))
    search.compare_narrow(narrow_places(map, box, span, random))
    for width in _WIDTHS:
        order = np.argsort(-search.ratios)[:_ELITE]
        near = search.y[order].repeat(_CHILDREN, axis=0)
        near = near + width * random.standard_normal(near.shape)
        search.compare(np.clip(near, -1, 1))
    order = np.argsort(-search.ratios)
    chosen = np.concatenate((order[:_LINEAR], np.arange(_LINEAR)))
    inputs = box.at(search.y[chosen])
    linear = linear_error(map, box.H, box, edges, inputs)
    largest = np.fmax(search.largest, linear) if np.isfinite(linear).all() else linear
    error = _MARGIN * largest + search.of_solutions
    worst = int(order[0]) if len(order) else 0
    return Judgement(
        error,
        linear,
        float(search.times[worst]),
        box.at(search.y[worst]),
        points,
        float(1 - (1 - _CONFIDENCE) ** (1 / points)),
        _symplecticity(map, box, span, inputs, scale, random),
        search.failure,
    )


class _Search:
    """Comparisons so far: scaled inputs, largest ratios to the allowed error, and their times."""

    def __init__(
        self,
        map: Any,
        box: Box,
        span: tuple[float, float],
        solve: Callable[..., Solutions],
        allowed: np.ndarray,
        random: np.random.Generator,
    ) -> None:
        self._map, self._box, self._span, self._solve = map, box, span, solve
        self._allowed, self._random = allowed, random
        self.y, self.ratios, self.times = np.empty((0, len(box))), np.empty(0), np.empty(0)
        self.largest = np.zeros(box.H.dim)
        self.of_solutions = np.zeros(box.H.dim)
        self.failure = ""

    def compare(self, y: np.ndarray, also: np.ndarray | tuple[()] = ()) -> None:
        """Compare the map with solutions from scaled inputs, at random times and at the end.

        - also: Further scaled times.
        """
        inputs = self._box.at(y)
        solutions = self._solve(self._box.states(inputs), self._box.values(inputs), self._span)
        start, end = self._span
        steps = np.arange(_TIMES) + self._random.random(_TIMES)
        shares = np.concatenate((steps / _TIMES, (np.asarray(also) + 1) / 2))
        times = np.append(start + (end - start) * np.sort(shares), end)
        exact = solutions(times)
        count = len(times)
        found = self._map.evaluate(np.tile(times, len(y)), inputs.repeat(count, axis=0))
        difference = np.abs(found.reshape(exact.shape) - exact)
        if not solutions.success.all():
            member = int(np.flatnonzero(~solutions.success)[0])
            self.failure = f"{self._box.described(inputs[member])}: {solutions.message[member]}"
        # Not a number counts as infinite.
        difference = np.where(np.isnan(difference), np.inf, difference)
        ratios = (difference / self._allowed).max(axis=2)
        self.y = np.concatenate((self.y, y))
        self.ratios = np.append(self.ratios, ratios.max(axis=1))
        self.times = np.append(self.times, times[ratios.argmax(axis=1)])
        self.largest = np.maximum(self.largest, difference.max(axis=(0, 1)))
        self.of_solutions = np.maximum(self.of_solutions, solutions.largest_error.max(axis=0))

    def compare_narrow(self, places: np.ndarray) -> None:
        """Compare at places of narrow features; a map that differs there only misses them.

        - places: Scaled times and inputs, shape (n, 1 + d): what a feature does may have an end.
        """
        if not len(places):
            return
        others, y = self.ratios.max(), places[:, 1:]
        self.compare(y, also=np.unique(places[:, 0]))
        ratios = self.ratios[-len(y) :]
        if not (self.failure or ratios.max() <= max(1.0, _NARROW * others)):
            place = self._box.described(self._box.at(y[ratios.argmax()]))
            self.failure = (
                f"a narrow feature of H at {place} changes the solutions by {ratios.max():.2g} of "
                "the tolerance, and the map does not contain it; give a box without this place, "
                "or one as narrow as the feature"
            )


def linear_error(
    map: Any, H: Hamiltonian, box: Box | Domain, edges: np.ndarray, inputs: np.ndarray
) -> np.ndarray:
    """Return the largest error by the linear equation of the error, shape (dim,).

    With the residual r = dz^/dt - J grad H(z^), the error obeys delta' = J Hess(z^) delta - r, by
    collocation at Chebyshev points in each piece; where z^ jumps between two pieces, so does delta.

    - box: Where the inputs are; it gives the parameters that vary.
    - edges: Ends of the pieces, in order.
    - inputs: Shape (n, d).
    """
    dim, count = H.dim, len(inputs)
    system = H.compile("numpy")
    given, names = box.values(inputs), H.parameter_names
    rows = np.empty((count * _NODES, len(names)))
    for name, value in given.items():
        rows[:, names.index(name)] = np.repeat(value, _NODES)
    # Identifiers of code are other words than some names, as lambda.
    columns = zip(names, system.keywords(rows).items(), strict=True)
    values = dict(column for name, column in columns if name in given)
    table = collocation(_NODES)
    delta, largest = np.zeros((count, dim)), np.zeros(dim)
    before = None
    for low, high in itertools.pairwise(edges):
        length = high - low
        times = low + length * table.nodes
        repeated = inputs.repeat(_NODES, axis=0)
        with np.errstate(all="ignore"):
            states, rates, _ = map.derivatives(np.tile(times, count), repeated)
            arguments = system.arguments(states, np.tile(times, count))
            residual = rates - system.vector_field(*arguments, **values)
            matrices = system.jacobian(*arguments, **values)
            # From inside the piece, whatever the side to which its ends belong.
            first = _continued(map, inputs, low, length)
            last = _continued(map, inputs, high, -length)
            if before is not None:
                delta = delta + before - first
            # LU decompositions compare entries, of all components.
            units = tangent_scales(matrices)
            residual = (residual / units).reshape(count, _NODES, dim)
            matrices = (matrices * units / units[:, None]).reshape(count, _NODES, dim, dim)
            delta = delta / units
            # rate = A (delta + length I rate) - r at the nodes.
            coupling = length * np.einsum("ab,naij->naibj", table.integration[:_NODES], matrices)
            system_matrix = np.eye(_NODES * dim) - coupling.reshape(count, _NODES * dim, -1)
            forced = np.einsum("naij,nj->nai", matrices, delta) - residual
            if not (np.isfinite(system_matrix).all() and np.isfinite(forced).all()):
                return np.full(dim, np.inf)
            slopes = solved(system_matrix, forced.reshape(count, -1, 1))
        rate = slopes.reshape(count, _NODES, dim)
        path = delta[:, None] + length * np.einsum("ab,nbi->nai", table.integration, rate)
        path = path * units
        delta, before = path[:, -1], last
        largest = np.maximum(largest, np.abs(path).max(axis=(0, 1)))
    return largest


def _continued(map: Any, inputs: np.ndarray, end: float, length: float) -> np.ndarray:
    """Return z^ at the end of a piece, from a time inside it."""
    inside = _INSIDE * length
    states, rates, _ = map.derivatives(np.full(len(inputs), end + inside), inputs)
    return states - inside * rates


def _symplecticity(
    map: Any,
    box: Box,
    span: tuple[float, float],
    inputs: np.ndarray,
    scale: np.ndarray,
    random: np.random.Generator,
) -> float | None:
    """Return the largest entry of M^T J M - J, each in units of its components."""
    if not box.is_whole or box.H.forces:
        return None
    dim, dof = box.H.dim, box.H.dof
    times = random.uniform(min(span), max(span), len(inputs))
    times[0] = span[1]
    matrices = map.derivatives(times, inputs)[2][:, :, :dim]
    J = poisson_matrix(dof)
    defect = np.swapaxes(matrices, 1, 2) @ J @ matrices - J
    # In units of the components, an entry is an action; that of its pair is the unit.
    action = np.tile(scale[:dof] * scale[dof:], 2)
    units = scale / np.sqrt(action)
    return float(np.abs(defect * units[:, None] * units).max())
