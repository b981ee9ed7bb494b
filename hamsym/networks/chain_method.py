"""Solution by a chain of networks on the windows of a march, trained to a tolerance."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch

from hamsym.errors import InputError
from hamsym.networks.chain import ChainTraining
from hamsym.networks.chain_error import ErrorOfChain, estimate_chain_error
from hamsym.networks.chain_training import ChainRun, ChainSettings, TrainedChain
from hamsym.networks.methods import NetworkChain
from hamsym.networks.record import TrainingState
from hamsym.networks.window_training import late
from hamsym.problems.problem import InitialValueProblem
from hamsym.random_features.features import Features
from hamsym.random_features.method import solve_by_features
from hamsym.random_features.trial import FeatureTrial
from hamsym.random_features.windows import March
from hamsym.solution.acceptance import accepted
from hamsym.solution.discontinuities import first_jump, unresolved
from hamsym.solution.settings import Settings
from hamsym.solution.solution import Solution
from hamsym.solution.window_error import allowed_errors
from hamsym.support.machine import one_core
from hamsym.support.progress import share_progress

_LOCAL = 1e-2  # tolerance of the residual in a window, relative to that of the error
_LEAST_LOCAL, _LARGEST_LOCAL = 1e-12, 1e-10
_PASSES = 3
_MARGIN = 0.3  # share of the allowed error at which a tighter chain aims
_HIDDEN_STEPS = 20
_GUESS = 1e-6  # least tolerance of the march that finds the windows
_JUMP_SAMPLES = 33  # in each window


@dataclass(frozen=True)
class _Pass:
    """A trained chain with its estimated error and the error that is allowed, shape (dim,)."""

    trained: TrainedChain
    estimate: ErrorOfChain
    allowed: np.ndarray

    @property
    def excess(self) -> float:
        return self.estimate.error.excess(self.allowed)

    def cause(self, is_late: bool) -> str:
        """Why its error could not be made smaller."""
        if self.estimate.limit:
            return self.estimate.limit
        if not (self.estimate.error.floors.max(axis=0) <= 0.3 * self.allowed).all():
            return "limited by float64 round-off"
        if is_late:
            return "the time limit was reached"
        return "the networks could not be made accurate enough"


def solve_by_chain(problem: InitialValueProblem, method: NetworkChain) -> Solution:
    """Train a chain of networks to the tolerance of the problem."""
    H, span, tol = problem.H, problem.span, problem.tol
    if method.windows is not None and problem.breakpoints:
        raise InputError(
            f"windows={method.windows} makes equal windows, but breakpoints are given too; leave "
            "one of them out"
        )
    settings = ChainSettings(
        min(max(_LOCAL * tol, _LEAST_LOCAL), _LARGEST_LOCAL),
        _HIDDEN_STEPS if method.train_hidden else 0,
        method.envelope,
        None if method.time_limit is None else time.perf_counter() + method.time_limit,
        limit=max(_LOCAL * tol, _LEAST_LOCAL),
    )
    wall, cpu = time.perf_counter(), time.process_time()
    guess = solve_by_features(
        replace(problem, tol=max(tol, _GUESS), prove=False, invariants=()), Features()
    )
    best, passes, evaluations, rejected = None, 0, 0, 0
    with one_core():  # the systems of a window are too small for more
        while passes < _PASSES:
            passes += 1
            with _progress(problem.progress) as advance:
                trained = _trained(problem, method, guess, settings, advance)
            if not trained.chain.pieces:
                break
            evaluations += trained.evaluations + guess.record.point_evaluations
            rejected += trained.rejected
            estimate = estimate_chain_error(H, trained.chain, trained.points)
            found = _Pass(
                trained, estimate, allowed_errors(tol, problem.atol, estimate.error.scale)
            )
            if best is None or (
                trained.reached == best.trained.reached and found.excess < best.excess
            ):
                best = found
            local = settings.tolerance
            if trained.reason or found.excess <= 1 or local <= _LEAST_LOCAL:
                break
            tighter = local * min(max(_MARGIN / found.excess, 1e-3), 0.1)
            settings = replace(settings, tolerance=max(tighter, _LEAST_LOCAL))
    if best is None:
        raise InputError(f"no solution beyond t = {trained.reached:.6g}: {trained.reason}")
    chain, fits = best.trained.chain, best.trained.fits
    record = ChainTraining(
        chain.edges,
        steps=np.array([fit.steps for fit in fits], dtype=np.int64),
        hidden_steps=np.array([fit.hidden_steps for fit in fits], dtype=np.int64),
        residuals=np.array([fit.residual for fit in fits], dtype=float),
        points=best.trained.points,
        point_evaluations=evaluations,
        rejected=rejected,
        passes=passes,
        seconds=time.perf_counter() - wall,
        cpu_seconds=time.process_time() - cpu,
    )
    solution = Solution(
        H,
        problem.z0,
        (span[0], best.trained.reached),
        chain,
        method=method.name,
        record=record,
        settings=Settings.of(problem, method),
        error=best.estimate.error,
    )
    count, jump = len(fits), None
    if not best.trained.reason:
        times = record.times(solution.span, _JUMP_SAMPLES * len(record.edges))
        jump = first_jump(solution, times, unresolved(solution))
    return accepted(
        solution,
        f"{count:,} network{'s' if count > 1 else ''}",
        stopped=best.trained.reason,
        jump=jump,
        doubt=best.trained.doubt,
        cause=best.cause(late(settings.deadline)),
    )


def _trained(
    problem: InitialValueProblem,
    method: NetworkChain,
    guess: Solution,
    settings: ChainSettings,
    advance: Callable[[float], None],
) -> TrainedChain:
    march, trial = guess.record, guess.trial
    assert isinstance(march, March)
    assert isinstance(trial, FeatureTrial)
    edges = trial.origin + march.edges
    if method.windows is not None:
        edges = np.linspace(edges[0], edges[-1], method.windows + 1)
    found = ChainRun(
        problem.H,
        trial,
        edges,
        method,
        settings,
        torch.Generator().manual_seed(problem.seed),
    ).trained(advance)
    return replace(found, reason=found.reason or march.reason, doubt=found.doubt or march.doubt)


@contextmanager
def _progress(
    show: bool | Callable[[TrainingState], None] | None,
) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the share of the span that is done, after each window."""
    if not callable(show):
        with share_progress(show, "training") as report:
            yield report
        return
    began, windows, nan = time.perf_counter(), 0, float("nan")

    def tell(share: float) -> None:
        nonlocal windows
        windows += 1
        seconds = time.perf_counter() - began
        show(TrainingState(windows, round(windows / share), nan, nan, nan, seconds))

    yield tell
