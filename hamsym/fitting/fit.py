"""Estimation of parameters and initial states from noisy observations.

Stage 1  Observables, data and free quantities are checked, and compiled with their gradients.
Stage 2  All starts are ranked by the least chi-square of their linear models; the best ones are
         refined by the Levenberg-Marquardt method with exact derivatives
         (:mod:`hamsym.fitting.search`).
Stage 3  Covariances and intervals (:mod:`hamsym.fitting.uncertainty`).
Stage 4  The best minimum of every set of data is judged (:mod:`hamsym.fitting.verdicts`).
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hamsym.errors import InputError
from hamsym.fitting.fitted import Fit, Minimum
from hamsym.fitting.motions import LiftedMotions, MappedMotions, Motions, SolvedMotions
from hamsym.fitting.observations import checked_observations, checked_times
from hamsym.fitting.search import Found, Model, search
from hamsym.fitting.uncertainty import Uncertainty, uncertainty_of
from hamsym.fitting.unknowns import bound_ends, checked_unknowns
from hamsym.fitting.verdicts import Verdicts, judged
from hamsym.formula.parser import canonical_name
from hamsym.hamiltonian import Hamiltonian, HamiltonianLike
from hamsym.problems.problem import checked_span
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import checked_mapping, require, require_number, require_whole
from hamsym.symbolic.checks import name_of

if TYPE_CHECKING:
    from hamsym.flow_maps.flow_map import FlowMap


@checked_keywords
def fit(
    H: HamiltonianLike,
    t: Any,
    observations: Mapping[Any, Any],
    *,
    free: Mapping[Any, float],
    span: tuple[float, float] | None = None,
    sigma: Any = None,
    z0: Mapping[Any, float] | None = None,
    parameters: Mapping[Any, float] | None = None,
    bounds: Mapping[Any, Sequence[float | None]] | None = None,
    starts: int = 1,
    seed: int = 0,
    confidence: float = 0.95,
    tol: float = 1e-9,
    flow: FlowMap | None = None,
) -> Fit:
    """Estimate parameters and components of the initial state from noisy observations.

    The sum of squares of (data - model)/sigma is minimised by the Levenberg-Marquardt method. The
    derivatives are exact: those of the motion from the variational equations, those of the
    observables from their formulas.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    t : array
        Times of the data in the span, shape (n,), in any order.
    observations : mapping of str or sympy.Expr to array
        Data of each observable, shape (n,), or (sets, n) for one fit to each set; nan where a value
        is missing. An observable is a component of z or any function of the state, the parameters
        and the time, as ``"r*cos(phi)"``.
    free : mapping of name to number
        First guesses of the free quantities: parameters of H, and components of the start.
    span : (float, float)
        The start, at which the initial state is, and the end. With ``flow`` that of the flow map.
    sigma : number, array or mapping, optional
        Standard deviations of the data, the same for all observables or by observable; arrays have
        shape (n,) or (sets, n). By default one number for all data, estimated from the residuals,
        which must then look like noise: without correlation in time, and less than the data vary.
    z0 : mapping of name to number, optional
        The other components of the start.
    parameters : mapping of name to number, optional
        Values of other parameters, which replace those of H.
    bounds : mapping of name to (low, high), optional
        Bounds of free quantities, each a number or None. An estimate at a bound is no success.
    starts : int
        Number of first guesses: those of ``free``, and others at random, uniform between the
        bounds, or without two bounds within the size of the guess of it. The best
        quarter, and eight at least, are refined. A component whose guess is zero has the size that
        the other guesses give it in the motion, and a parameter 1.
    seed : int
        Of the random guesses.
    confidence : float
        Probability of the confidence intervals.
    tol : float
        Tolerance of the motions, as of :func:`hamsym.solve`.
    flow : FlowMap, optional
        Evaluated in place of solving; what is free has to vary in it.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        If an argument is invalid, there are fewer data than free quantities, or the motion cannot
        be solved with the first guesses.

    Notes
    -----
    Standard errors are those of the linear model at the minimum, valid for small independent
    normal errors: C = (J^T J)^-1, multiplied by chi-square per degree of freedom if sigma is not
    given. Intervals are those of the profile likelihood where the model is not linear in them.
    See Bates and Watts, *Nonlinear Regression Analysis and Its Applications* (1988).

    Examples
    --------
    >>> t = np.linspace(0, 10, 101)
    >>> noise = np.random.default_rng(1).normal(0, 0.02, len(t))
    >>> found = fit(
    ...     "p**2/2 + k*x**2/2",
    ...     t,
    ...     {"x": np.cos(2 * t) + noise},
    ...     free={"k": 3.5, "x": 0.8},
    ...     z0={"p": 0},
    ...     sigma=0.02,
    ...     span=(0, 10),
    ... )
    >>> found.success, round(found.parameters["k"], 2)
    (True, 4.0)
    >>> low, high = found.confidence_intervals["k"]
    >>> low < 4 < high
    True
    """
    H = Hamiltonian.of(H, bound=False)
    require_whole("starts", starts, 1, 100_000)
    require_whole("seed", seed, 0)
    require_number("confidence", confidence, 0.0)
    require(0 < confidence < 1, "confidence", confidence, "a number between 0 and 1")
    if flow is not None:
        z0, parameters, bounds = _within(flow, H, free, z0, parameters, bounds)
        span = flow.span if span is None else span
    if span is None:
        raise InputError("span is missing; give (t_start, t_end), with the start at t_start")
    times = checked_span(span)
    if flow is not None and times != checked_span(flow.span):
        raise InputError(f"span={span!r} is not that of the flow map, {flow.span!r}; leave it out")
    began = time.perf_counter()
    unknowns = checked_unknowns(H, free, z0, parameters, bounds)
    observed = checked_observations(unknowns.H, checked_times(t, times), observations, sigma)
    needed = len(unknowns.names) + (0 if observed.known else 1)
    if not (observed.counts >= needed).any():
        why = "" if observed.known else ", since sigma is estimated too"
        raise InputError(
            f"{observed.counts.max()} data cannot determine {', '.join(unknowns.names)}; give "
            f"{needed} or more{why}"
        )
    solved = SolvedMotions(unknowns, observed.t, times, tol)
    motions: Motions = solved
    if flow is not None:
        motions = MappedMotions(flow, unknowns, observed.t)
    elif starts > 1 or len(observed.data) > 1:
        motions = _of_many(solved)
    model = Model(unknowns, observed, motions, times, tol if flow is None else float(flow.tol))
    found = search(model, int(starts), int(seed))
    uncertainty = uncertainty_of(
        model,
        found,
        confidence,
        lambda: replace(model, motions=_of_many(solved)) if motions is solved else model,
    )
    motion: Any = flow
    if flow is None and observed.single:
        # The verdict rests on one solution and its sensitivity, however the minimum was found.
        motion, found = solved.solution(found.unknowns[0]), model.again(found, solved)
    elif flow is None:
        motion = solved.solutions(found.unknowns)
    verdicts = judged(model, found, uncertainty, motion)
    return _result(model, found, uncertainty, verdicts, confidence, flow, motion, began)


def _of_many(solved: SolvedMotions) -> Motions:
    """Return a source that solves many motions at once, if there is one."""
    if not LiftedMotions.applies(solved.unknowns):
        return solved
    return LiftedMotions(solved.unknowns, solved.t, solved.span, solved.tol)


def _within(
    flow: FlowMap, H: Hamiltonian, free: Any, z0: Any, parameters: Any, bounds: Any
) -> tuple[Any, Any, Any]:
    """Return fixed components, fixed parameters and bounds, completed by those of a flow map."""
    require(hasattr(flow, "inputs"), "flow", flow, "a FlowMap")
    if (H.expr, H.names, H.forces) != (flow.H.expr, flow.H.names, flow.H.forces):
        raise InputError(f"H is not that of the flow map, {flow.H.formulas}; give flow.H")
    given = [dict(part) if isinstance(part, Mapping) else part for part in (z0, parameters, bounds)]
    for part, names in ((0, H.names), (1, H.parameter_names)):
        if given[part] is None or isinstance(given[part], dict):
            own = {name: value for name, value in flow.fixed.items() if name in names}
            for name, value in (given[part] or {}).items():
                if not np.array_equal(own.get(name, value), value):
                    raise InputError(
                        f"'{name}' is {value!r}, but {own[name]!r} in the flow map; leave it out"
                    )
            given[part] = own | (given[part] or {})
    if isinstance(free, Mapping):
        known = {canonical_name(name): name for name in flow.inputs}
        limits = dict(checked_mapping("bounds", bounds, '{"g": (0, None)}'))
        for key in free:
            name = known.get(canonical_name(name_of(key)))
            if name is None:
                listed = ", ".join(flow.inputs)
                raise InputError(f"'{name_of(key)}' does not vary in the flow map; free {listed}")
            low, high = bound_ends(name, limits.pop(key, limits.pop(name, (None, None))))
            limits[name] = max(low, flow.box[name][0]), min(high, flow.box[name][1])
        given[2] = limits
    return given[0], given[1], given[2]


def _result(
    model: Model,
    found: Found,
    uncertainty: Uncertainty,
    verdicts: Verdicts,
    confidence: float,
    flow: FlowMap | None,
    motion: Any,
    began: float,
) -> Fit:
    """Arrange the results; those of one set without an axis of sets."""
    unknowns, observed = model.unknowns, model.observed
    of = (lambda array: array[0]) if observed.single else (lambda array: array)
    shape = observed.data.shape
    with np.errstate(all="ignore"):
        residuals = np.where(
            observed.present, -found.residuals.reshape(shape) * observed.sigma, np.nan
        )

    def by_label(array: np.ndarray) -> dict[str, np.ndarray]:
        return {label: of(array[:, k]) for k, label in enumerate(observed.expressions)}

    columns = list(enumerate(unknowns.names))
    minima = [
        Minimum(dict(zip(unknowns.names, x.tolist(), strict=True)), squares, starts)
        for x, squares, starts in found.minima
    ]
    messages = np.array(verdicts.messages, dtype=object)
    return Fit(
        H=unknowns.hamiltonian(found.unknowns[0]),
        names=unknowns.names,
        parameters={name: _plain(of(found.unknowns[:, j])) for j, name in columns},
        covariance=of(uncertainty.covariance),
        confidence=float(confidence),
        confidence_intervals={
            name: (_plain(of(uncertainty.low[:, j])), _plain(of(uncertainty.high[:, j])))
            for j, name in columns
        },
        z0=of(unknowns.starts(found.unknowns)),
        span=model.span,
        t=observed.t,
        data=by_label(observed.data),
        sigma=by_label(verdicts.sigma),
        residuals=by_label(residuals),
        chi_square=_plain(of(found.chi_square)),
        degrees_of_freedom=_plain(of(verdicts.freedom)),
        p_value=_plain(of(verdicts.p_value)),
        success=_plain(of(verdicts.success)),
        message=of(messages),
        seconds=time.perf_counter() - began,
        minima=tuple(minima) if observed.single else (),
        starts_reached=_plain(of(found.reached)),
        solution=None if flow is not None else motion,
        unknowns=unknowns,
        expressions=observed.expressions,
        flow=flow,
    )


def _plain(value: Any) -> Any:
    """Return a number of numpy as one of Python, and an array as it is."""
    return value.item() if isinstance(value, np.generic) else value
