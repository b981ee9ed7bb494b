"""Error estimate of a march: truncation and round-off, to the limits of float64.

The error delta = z - z^ obeys delta' = J Hess(z^) delta - r(t) with r the residual (the paper's
eq. ell), up to terms of second order. Where these matter, they are computed from the error that was
found and added to the residual, until they change by little. Inside a window r oscillates about as
often as there are columns in the basis, so it is sampled at half as many nodes again as the
solution used. The equation is solved window by window (:func:`hamsym.kernel.loops.carry_errors`),
for delta plus the integral of r, which is smooth: half of the nodes resolve it, or else those of
the solution do. The residual r contains only another sample of the round-off: random perturbations
of its size are moved with the error, one batch at every joint. Its size is measured as the change
of F when the states, the time and the results of all operations are rounded otherwise: where these
cancel, F has fewer digits than the state. Numbers of H that float64 cannot
represent, for example pi, push every window the same way, as roundings of what depends on
parameters alone do: one perturbation has the change of F by these.

The estimate is infinite from the time at which the errors are as large as the motion or these terms
do not settle, or J Hess is not finite.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial import chebyshev

from hamsym.kernel import loops
from hamsym.kernel.loops import LANES, Actions, ErrorSettings, ErrorTables, Rule
from hamsym.numerics.collocation import collocation, turns
from hamsym.numerics.scales import resolved_sizes
from hamsym.random_features.basis import FeatureBasis, basis_of_series, squared
from hamsym.random_features.flow import Flow, flow_of
from hamsym.random_features.window_checks import WindowChecks
from hamsym.random_features.windows import March, Windows
from hamsym.solution.times import shown_time
from hamsym.solution.window_error import WindowError

#: Coarse and fine nodes for the tangent equation and nodes for the residual, by the nodes of the
#: basis: of the estimate, and of the check.
RESOLUTIONS = {
    16: ((8, 16, 24), (40, 40, 72)),
    24: ((8, 24, 32), (40, 40, 72)),
}
USUAL, FINE = range(2)
#: Last coefficients of the vectors at the coarse nodes, times their accuracy, at most: those left
#: out are smaller by a factor.
_RESOLVED = (100.0, 10.0)
#: Random vectors that represent round-off, by the nodes of the basis, and the standard deviations
#: that it may have as they show them: with the same chance. The small basis is far from round-off.
_PERTURBATIONS = {16: (2, 5.0), 24: (4, 3.0)}
_PERIOD = 509  # windows after which the signs of the perturbations repeat
# Of the vectors after all windows, and the least number of these. What is left at the peak of a
# close passage remains, when the errors shrink again by orders of magnitude.
ACCURACY, FEWEST = 1e-4, 10.0
_EPS = float(np.finfo(float).eps)
_BESIDE = 16.0  # roundings from a time at which H may switch to one before or after
_SCALE_SAMPLES = 256  # windows at which the coupling of the components is averaged


class MarchError(WindowError):
    """Estimated error of a march."""

    def require_trial(self, trial: Any) -> None:
        """Raise ValueError unless it is the error of the trial solution."""
        if not np.array_equal(self.edges, getattr(trial, "edges", ())):
            raise ValueError("the windows of its error differ from those of its trial solution")
        if self.origin != trial.origin:
            raise ValueError("the origin of its error differs from that of its trial solution")

    def refined(self, path: Any) -> MarchError:
        """Estimate the error of the same march with half as many nodes again."""
        basis = basis_of_series(path.record.seed, path.trial.series)
        return estimate_error(path.record, basis, flow_of(path.H), resolution=FINE).error


class Estimate(NamedTuple):
    """The error of a march, with the reason where it is infinite and the unresolved windows."""

    error: MarchError
    #: Reason why the error is infinite in the last windows, "" if it is finite.
    limit: str
    #: Largest error, by the linear equation alone where there is no estimate, shape (dim,).
    linear: np.ndarray
    #: Windows whose residual is large relative to the rates: the force may jump there.
    unresolved: list[tuple[float, float]]
    #: Whether bounds on the residual between its places are in the error, as round-off.
    hidden: bool


def estimate_error(
    windows: March,
    basis: FeatureBasis,
    flow: Flow,
    tolerance: float = 0.0,
    resolution: int = USUAL,
    residuals: np.ndarray | None = None,
    late: np.ndarray | None = None,
) -> Estimate:
    """Estimate the error of a march from its residual, with the linear equation of the error.

    - tolerance: Local tolerance of the march.
    - resolution: Index of :data:`RESOLUTIONS`.
    - residuals: In place of those computed in float64, at the times as rounded, shape (windows,
      dim, places).
    - late: Further errors of the states at the starts of windows, shape (windows, dim).
    """
    tables = error_tables(basis, resolution)
    count, _, dim = windows.readouts.shape
    scale = _scales(windows, flow)
    # Round-off does not move components at rest, of which the formulas give the rate 0.
    moved = np.ones(dim)
    moved[_resting(windows, flow)] = 0.0
    lengths = np.abs(np.diff(windows.edges))
    switches = _late(windows, flow) if flow.switched_in_time else None
    hidden = _hidden(windows, scale, tables.places, WindowChecks(flow, basis, tolerance))
    kicked = [errors for errors in (late, switches, hidden) if errors is not None]
    settings = ErrorSettings(
        period=_PERIOD,
        width=dim,
        tolerance=tolerance,
        accuracy=ACCURACY / max(count, FEWEST),
        # The expected length of the window that contains a random time.
        usual_length=float((lengths**2).sum() / lengths.sum()),
        scale=np.where(scale > 0, scale, 1.0),
        size=scale,
        sign=disturbances(tables.places, rows_of_signs(flow)),
        kick=kicks(tables.perturbations, dim) * moved[:, None],
        parameters=flow.parameters,
        residual=residuals,
        late=sum(kicked) if kicked else None,
    )
    joint = np.zeros((dim, tables.perturbations + 2))
    series = np.full((count, tables.places, dim), np.inf)
    floors, largest = np.full((count, dim), np.inf), np.zeros(dim)
    marks = np.zeros(count, dtype=np.int64)
    first, outcome = loops.carry_errors(
        flow.programs,
        tables,
        terms_of(flow),
        settings,
        loops.Windows(windows.edges, windows.states, windows.readouts),
        basis.tables,
        loops.ErrorResults(
            joint=joint,
            history=np.zeros(2),
            series=series,
            floor=floors,
            largest=largest,
            mark=marks,
        ),
    )
    limit, linear = "", largest
    end = [*np.flatnonzero(marks[:first] & loops.BENT), first][0]  # window without an estimate
    if end < first:
        # Of round-off, what follows shows how far it grows; of the error of the march, nothing.
        by_march = (np.abs(series[end]).sum(axis=0) > floors[end]).all()
    else:
        by_march = outcome == loops.LOST and abs(joint[:, 0]).max() > abs(joint[:, 1:]).max()
    if outcome != loops.DONE and not by_march:
        limit = _reason(windows, flow, first)
        linear = np.full(dim, np.inf)
    elif end < count:
        start = float(windows.origin + windows.edges[end])
        limit = f"errors grow too large for an estimate by t = {shown_time(start, *windows.ends)}"
    series[end:] = floors[end:] = np.inf
    if limit:
        largest = np.full(dim, np.inf)
    ends = (windows.origin + windows.edges).tolist()
    return Estimate(
        MarchError(windows.edges, series, floors, largest, scale, np.array(windows.origin)),
        limit,
        linear,
        [(ends[w], ends[w + 1]) for w in np.flatnonzero(marks & loops.UNRESOLVED)],
        hidden is not None,
    )


@functools.lru_cache(maxsize=16)
def error_tables(basis: FeatureBasis, resolution: int = USUAL) -> ErrorTables:
    """Make the tables of the estimate for a basis."""
    coarse, usual, inside = RESOLUTIONS[len(basis.nodes)][resolution]
    perturbations, deviations = _PERTURBATIONS[len(basis.nodes)]
    fine = collocation(inside)
    (values, values_low), (rates, rates_low) = map(
        _parts, basis.columns(fine.nodes.astype(np.longdouble))
    )
    # The integral from 0 of the polynomial through the values at the first places.
    exact = np.longdouble  # multiplied in one order; BLAS has one for each processor
    integrals = chebyshev.chebint(np.eye(inside, dtype=exact), lbnd=-1, scl=exact(0.5))

    def integral(s: np.ndarray, terms: int = inside + 1) -> np.ndarray:
        weights = chebyshev.chebval(2 * s.astype(exact) - 1, integrals[:terms]).T
        return np.asarray((weights @ fine.to_series.astype(exact)).astype(float).T)

    def rule(nodes: int) -> Rule:
        found = collocation(nodes)
        return Rule(
            nodes=nodes,
            node=found.nodes,
            at_nodes=basis.columns(found.nodes.astype(exact))[0].astype(float).T,
            drift=integral(found.nodes, nodes),
            beyond=integral(fine.nodes) - integral(fine.nodes, nodes),
            integration=found.integration[:-1].T,
            twice=squared(found.integration[:-1]).T,
            lift=found.interpolation(fine.nodes).T,
            end=found.integration[-1],
            last=np.pad(found.to_series[-2:].T, ((0, 0), (0, LANES - 2))),
        )

    usual_rule = rule(usual)
    return ErrorTables(
        columns=len(values),
        places=inside,
        perturbations=perturbations,
        deviations=deviations,
        resolved=_RESOLVED[resolution],
        place=fine.nodes,
        value=values,
        value_low=values_low,
        rate=rates,
        rate_low=rates_low,
        drift=integral(fine.nodes),
        drift_end=integral(np.ones(1))[:, 0],
        to_series=fine.to_series.T,
        # Between the places, and at the end.
        dense=fine.interpolation((1 - turns(inside)[2 : 2 * inside + 1 : 2]) / 2).T,
        coarse=usual_rule if coarse == usual else rule(coarse),
        fine=usual_rule,
    )


def _parts(exact: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a transposed table as high and low parts."""
    high = exact.T.astype(float)
    return high, (exact.T - high).astype(float)


@functools.lru_cache(maxsize=64)
def disturbances(places: int, rows: int) -> np.ndarray:
    """Return the signs of round-off, of components and then of steps, shape (rows, places)."""
    return np.random.default_rng(0).choice((-1.0, 1.0), size=(rows, places))


def rows_of_signs(flow: Flow) -> int:
    """Return how many components and steps have signs of round-off."""
    programs = flow.programs
    return programs.dim + max(programs.program(name).steps for name in ("velocity", "force"))


@functools.lru_cache(maxsize=64)
def kicks(perturbations: int, dim: int) -> np.ndarray:
    """Return the signs of the round-off of each window, shape (period, dim, perturbations)."""
    shape = (_PERIOD, dim, perturbations)
    return np.random.default_rng(1).choice((-1.0, 1.0), size=shape)


@functools.lru_cache(maxsize=64)
def terms_of(flow: Flow) -> Actions:
    """Return the terms of J C v, with C the Hessian without forces."""
    entries, symmetric, half = flow.entries, flow.symmetric, flow.programs.dim // 2
    terms = []
    for entry, (i, j) in enumerate(entries.tolist()):
        for row, source in {(i, j), (j, i)} if symmetric else [(i, j)]:
            target, sign = (row + half, -1.0) if row < half else (row - half, 1.0)
            terms.append((target, source, entry, sign))
    terms.sort()
    velocities = sum(target < half for target, *_ in terms)
    array = np.array(terms, dtype=loops.TERM)
    return Actions(velocities=velocities, terms=len(terms), linear=flow.programs.linear, term=array)


def _late(windows: March, flow: Flow) -> np.ndarray:
    """Return the errors of states at starts of windows where H switches, as times are rounded."""
    edges, states = windows.edges[1:-1], windows.states[1:-1]
    rounding = _EPS / 2 * np.abs(edges)
    with np.errstate(all="ignore"):
        jumps = np.subtract(
            *(flow.vector_field(states, edges + side * rounding) for side in (_BESIDE, -_BESIDE))
        )
    return np.vstack([np.zeros(states.shape[1]), np.abs(jumps) * rounding[:, None]])


def _hidden(
    windows: March, sizes: np.ndarray, places: int, checks: WindowChecks
) -> np.ndarray | None:
    """Return bounds on what the residual has beside its places, integrated over each window."""
    # In doubt there may be no bound, and beside a switch none is sharp.
    if not checks.tolerance or windows.doubt or checks.flow.switched_in_time:
        return None
    rows = Windows(windows.edges, windows.states, windows.readouts)
    return checks.kicks(rows, sizes, places)


def _resting(windows: March, flow: Flow) -> list[int]:
    """Return the components that are constant in the march and by the equations."""
    still = np.flatnonzero(~windows.readouts.any(axis=(0, 1)))
    z = windows.states[0]
    # Numbers that are zero have no round-off.
    return flow.resting(z, still) if z[still].any() else []


def _reason(windows: March, flow: Flow, window: int) -> str:
    """Return the reason for an estimate that ends at a window."""
    t = shown_time(float(windows.origin + windows.edges[window]), *windows.ends)
    with np.errstate(all="ignore"):
        jacobian = flow.jacobian(
            windows.states[window : window + 2], windows.edges[window : window + 2]
        )
    if not np.isfinite(jacobian).all():
        return f"the Hessian of H is not finite near t = {t}"
    return f"round-off errors grow to the size of the motion by t = {t}"


def _scales(windows: March, flow: Flow) -> np.ndarray:
    """Return the size of each component in its own units, shape (dim,)."""
    count = len(windows.readouts)
    some = np.unique(np.linspace(0, count, min(count + 1, _SCALE_SAMPLES)).astype(int))
    edges = windows.edges[some]
    coupling = np.abs(flow.jacobian(windows.states[some], edges))
    shares = np.abs(np.gradient(edges)) / np.abs(np.gradient(edges)).sum()
    mean = np.einsum("k,kij->ij", shares, coupling)
    return resolved_sizes(windows.scale, mean, abs(float(windows.edges[-1] - windows.edges[0])))
