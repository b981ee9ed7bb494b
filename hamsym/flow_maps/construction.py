"""Construction of flow maps by expansion: attempts, each with its judgement."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hamsym.errors import InputError
from hamsym.families.many import solve_many
from hamsym.families.solutions import Solutions
from hamsym.flow_maps.box import Box, checked_box
from hamsym.flow_maps.building import Builder, Built
from hamsym.flow_maps.flow_map import FlowMap
from hamsym.flow_maps.judging import Judgement, judged
from hamsym.hamiltonian import HamiltonianLike
from hamsym.problems.problem import checked_atol, checked_span, checked_tol
from hamsym.support.progress import share_progress
from hamsym.support.suggestions import checked_keywords
from hamsym.support.validation import require_whole

_STEPPED = 0.9  # share of the work that ends when the map reaches the last time
_SMALLEST_TOL = 1e-11  # the solutions of which a map is made are exact to 1e-12
_SOLUTIONS = 0.02  # tolerance of these solutions, relative to that of the map
_SMALLEST_SOLUTIONS, _LARGEST_SOLUTIONS = 1e-12, 1e-7  # looser ones are not faster
_SHARE = 0.6  # of the allowed error, for the expansion
_ATTEMPTS = 3
_AIM = 0.4  # of the allowed error, in a further attempt
_PROBES = 32  # solutions from which the sizes of the components are taken


@checked_keywords
def flow_map(
    H: HamiltonianLike,
    z0: Mapping[Any, Any] | Sequence[Any],
    span: tuple[float, float],
    parameters: Mapping[Any, Any] | None = None,
    *,
    tol: float = 1e-6,
    atol: float | Sequence[float] = 0.0,
    points: int = 2_000,
    seed: int = 0,
    progress: bool | None = None,
    max_solutions: int = 100_000,
) -> FlowMap:
    """Find one closed form of all trajectories that start in a box.

    Solutions at the points of a sparse grid in the box, as many as the tolerance needs in each
    direction, are expanded in Chebyshev polynomials of the initial state and the parameters:
    z^ = z0 + (t - t0) N(t, z0, parameters), with columns in time and readouts that are polynomials.
    The error is estimated over the whole box by comparison with other solutions, by a search for
    the worst place and by the linear equation of the error.

    Parameters
    ----------
    H : Hamiltonian, str or sympy.Expr
    z0 : mapping or sequence
        For each component an interval (low, high), a number, or an expression of parameters, for
        example ``"sqrt((1 + e)/(1 - e))"``.
    span : (float, float)
    parameters : mapping, optional
        Intervals or numbers for parameters of H and for symbols in the expressions of z0.
    tol : float
        Tolerance over the whole box, relative to the largest value of each component there.
    atol : float or sequence
        Absolute tolerance, added to it.
    points : int
        Random points at which the error is estimated.
    seed : int
        Of the random points, and of the basis.
    progress : bool, optional
        Show the progress, with the number of solutions that is expected, on standard
        error; by default if that is a terminal.
    max_solutions : int
        Largest number of solutions of which the map may be made.

    Returns
    -------
    FlowMap

    Raises
    ------
    InputError
        If an argument is invalid, a solution fails at the start of the span, or more
        solutions are needed than ``max_solutions``.

    Examples
    --------
    >>> box = {"x": (1.0, 1.6), "p": (0.7, 1.3)}
    >>> flow = flow_map("p**2/2 + x**2/2 + x**4/4", box, (0, 2), tol=1e-6)
    >>> flow.success, flow.inputs
    (True, ('x', 'p'))
    >>> starts = np.random.default_rng(1).uniform([1, 0.7], [1.6, 1.3], (5, 2))
    >>> flow(1.0, starts).shape
    (5, 2)
    """
    box, times = checked_box(H, z0, parameters), checked_span(span)
    tol = checked_tol(tol, _SMALLEST_TOL)
    require_whole("points", points, 100)
    require_whole("seed", seed, 0)
    require_whole("max_solutions", max_solutions, 1)
    absolute = np.broadcast_to(checked_atol(atol, box.H.dim), box.H.dim)
    with share_progress(progress, "flow map") as report:
        reached = 0.0

        def note(text: str, t: float | None = None) -> None:
            nonlocal reached
            if t is not None:
                reached = _STEPPED * (t - times[0]) / (times[1] - times[0])
            report(reached, text)

        asked = tol, absolute, points, seed, max_solutions
        found = _Construction(box, times, *asked, note).expanded()
        report(1.0)
    return found


class _Construction:
    """Construction of one map: attempts, each with its judgement."""

    def __init__(
        self,
        box: Box,
        span: tuple[float, float],
        tol: float,
        absolute: np.ndarray,
        points: int,
        seed: int,
        most: int,
        note: Callable[[str], None],
    ) -> None:
        self._box, self._span, self._tol, self._absolute = box, span, tol, absolute
        self._points, self._seed, self._note = points, seed, note
        self._solved, self._most = 0, most
        smallest = max(_SOLUTIONS * tol, _SMALLEST_SOLUTIONS)
        self._solution_tol = min(smallest, _LARGEST_SOLUTIONS)
        self._of_solutions = _SOLUTIONS * absolute
        self._random = np.random.default_rng(seed)

    def _sizes(self) -> np.ndarray:
        """Return the size of each component, from which the tolerance of solutions follows too."""
        y = self._random.uniform(-1, 1, (_PROBES, len(self._box)))
        inputs = self._box.at(y)
        probes = self._solve(self._box.states(inputs), self._box.values(inputs), self._span)
        scale = np.asarray(probes.table.sizes.max(axis=0))
        # A component may be small for some members, and its tolerance is that of the box.
        self._of_solutions = self._of_solutions + self._solution_tol * scale
        return scale

    def expanded(self) -> FlowMap:
        """Return a map by expansion of solutions."""
        began, random, scale = time.perf_counter(), self._random, self._sizes()
        allowed, share = self._absolute + self._tol * scale, _SHARE
        builder = Builder(self._box, self._span, self._counted, scale, random, self._note)
        for attempt in range(_ATTEMPTS):
            built = builder.build(share * allowed)
            seconds = time.perf_counter() - began
            self._note(f"{self._solved:,} solutions in {seconds:.3g} s; estimating the error")
            span = (self._span[0], built.reached)
            judgement = judged(
                *(built.map, self._box, span, built.edges, self._solve, allowed, scale, random),
                self._points,
            )
            excess = float((judgement.error / allowed).max())
            hopeless = judgement.failure or not math.isfinite(excess)
            if excess <= 1 or hopeless or attempt == _ATTEMPTS - 1:
                break
            share *= _AIM / excess
            self._note(f"the error is {excess:.2g} of the tolerance; again with a smaller share")
        failure = built.failure or judgement.failure
        return FlowMap(
            self._box,
            span,
            built.map,
            self._tol,
            bool(not failure and excess <= 1 and span == self._span),
            self._message(built, excess, judgement),
            judgement.error,
            excess,
            judgement,
            self._solved,
            seconds,
        )

    def _message(self, built: Built, excess: float, judgement: Judgement) -> str:
        place = self._box.described(judgement.worst_inputs)
        worst = f"worst found at t = {judgement.worst_time:.6g}, {place}"
        if built.failure:
            return f"the map ends at t = {built.reached:.6g}: {built.failure}"
        if judgement.failure:
            return f"the error cannot be estimated everywhere: {judgement.failure}"
        if excess <= 1:
            return (
                f"estimated error {excess:.2g} of the tolerance over the box; {worst}; "
                f"{judgement.points:,} random starts bound it, with 95 % confidence, except in "
                f"{judgement.share:.2%} of the box"
            )
        return f"estimated error {excess:.2g} of the tolerance; {worst}"

    def _counted(
        self, states: np.ndarray, values: Mapping[str, np.ndarray], span: tuple[float, float]
    ) -> Solutions:
        """Solve for the expansion, up to the largest number of solutions."""
        self._solved += len(states)
        if self._solved > self._most:
            raise InputError(
                f"the flow map needs more than max_solutions={self._most:,} solutions; give "
                "smaller intervals, a shorter span, a larger tol or a larger max_solutions"
            )
        return self._solve(states, values, span)

    def _solve(
        self, states: np.ndarray, values: Mapping[str, np.ndarray], span: tuple[float, float]
    ) -> Solutions:
        found = solve_many(
            self._box.H,
            states,
            span,
            tol=self._solution_tol,
            atol=self._of_solutions.tolist(),
            parameters=values or None,
            seed=self._seed,
            progress=False,
        )
        if found.table.stopped == "interrupted":
            raise KeyboardInterrupt
        return found
