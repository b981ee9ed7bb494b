"""The method "levenberg-marquardt" to a tolerance: a chain of networks."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

import numpy as np
import torch

from hamsym.errors import InputError
from hamsym.networks.chain import MAX_WINDOWS, ChainTraining
from hamsym.networks.chain_error import ErrorOfChain, estimate_chain_error
from hamsym.networks.chain_training import ChainRun, ChainSettings, Layout, TrainedChain
from hamsym.networks.devices import available_device
from hamsym.networks.equal_windows import train_windows
from hamsym.networks.options import LevenbergMarquardtOptions
from hamsym.networks.record import TrainingState
from hamsym.networks.window_training import late
from hamsym.problem import InitialValueProblem
from hamsym.solution.accuracy import (
    checked_atol,
    checked_tol,
    checked_window,
    window_ends,
)
from hamsym.solution.discontinuities import first_jump, unresolved
from hamsym.solution.solution import Solution
from hamsym.solution.window_error import allowed_errors
from hamsym.support.progress import stepping_progress
from hamsym.support.validation import require_positive, require_whole

_LOCAL = 1e-2  # tolerance of the residual in a window, relative to that of the error
_LEAST_LOCAL, _LARGEST_LOCAL = 1e-12, 1e-10
_PASSES = 3
_MARGIN = 0.3  # share of the allowed error at which a tighter chain aims
_HIDDEN_STEPS = 20
_FEWEST_WINDOWS = 4  # of a span
_JUMP_SAMPLES = 33  # in each window
_PERCENT = 1_000  # steps of the progress bar


@dataclass(frozen=True)
class _Pass:
    """A trained chain with its estimated error and the error that is allowed, shape (dim,)."""

    trained: TrainedChain
    estimate: ErrorOfChain
    allowed: np.ndarray

    @property
    def excess(self) -> float:
        return self.estimate.error.excess(self.allowed)


def solve_by_chain(problem: InitialValueProblem, options: LevenbergMarquardtOptions) -> Solution:
    """Train a chain of networks to a tolerance; options as in :func:`hamsym.solve`."""
    H, span = problem.H, problem.span
    tol, absolute = checked_tol(options.tol), checked_atol(options.atol, H.dim)
    whole = abs(span[1] - span[0])
    if options.windows is not None:
        require_whole("windows", options.windows, 1, MAX_WINDOWS)
        for name in ("max_window", "breakpoints"):
            if name in options.of_chain:
                raise InputError(
                    f"windows={options.windows} makes equal windows, but {name} is given too; "
                    "leave one of them out"
                )
    if options.time_limit is not None:
        require_positive("time_limit", options.time_limit)
    settings = ChainSettings(
        min(max(_LOCAL * tol, _LEAST_LOCAL), _LARGEST_LOCAL),
        _HIDDEN_STEPS if options.train_hidden else 0,
        window_ends(H, options.breakpoints, span),
        checked_window(options.max_window, span, whole / _FEWEST_WINDOWS, MAX_WINDOWS),
        None if options.time_limit is None else time.perf_counter() + options.time_limit,
        max(_LOCAL * tol, _LEAST_LOCAL),
    )
    layout = Layout(
        options.hidden,
        options.activation,
        options.envelope,
        options.frequency,
        available_device(options.device, torch.float64),
    )
    wall, cpu = time.perf_counter(), time.process_time()
    best, passes, evaluations, rejected = None, 0, 0, 0
    with _one_thread():
        while passes < _PASSES:
            passes += 1
            with _progress(problem.progress) as advance:
                trained = _trained(problem, options, layout, settings, advance)
            if trained.chain is None or trained.training is None:
                break
            evaluations += trained.training.point_evaluations
            rejected += trained.training.rejected
            estimate = estimate_chain_error(H, trained.chain, trained.training)
            allowed = allowed_errors(tol, absolute, estimate.error.scale)
            found = _Pass(trained, estimate, allowed)
            if best is None or (
                trained.reached == best.trained.reached and found.excess < best.excess
            ):
                best = found
            local = settings.tolerance
            if trained.reason or found.excess <= 1 or local <= _LEAST_LOCAL:
                break
            tighter = local * min(max(_MARGIN / found.excess, 1e-3), 0.1)
            settings = replace(settings, tolerance=max(tighter, _LEAST_LOCAL))
    if best is None or best.trained.chain is None or best.trained.training is None:
        raise InputError(f"no solution beyond t = {trained.reached:.6g}: {trained.reason}")
    record = replace(
        best.trained.training,
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
        best.trained.chain,
        method=options.method,
        record=record,
        error=best.estimate.error,
    )
    return solution.judged(*_verdict(solution, best, record, tol, late(settings.deadline)))


def _trained(
    problem: InitialValueProblem,
    options: LevenbergMarquardtOptions,
    layout: Layout,
    settings: ChainSettings,
    advance: Callable[[float], None],
) -> TrainedChain:
    H, z0, span = problem.H, problem.z0, problem.span
    generator = torch.Generator().manual_seed(problem.seed)
    free = layout
    if options.windows is not None:
        # Networks of the usual size make the first guess.
        free = replace(layout, hidden=LevenbergMarquardtOptions().hidden)
    trained = ChainRun(H, z0, span, free, settings, generator).trained(advance)
    if options.windows is None or trained.chain is None or trained.reason:
        return trained
    widen = tuple(options.hidden) == tuple(LevenbergMarquardtOptions().hidden)
    found = train_windows(
        H, trained.chain, options.windows, layout, settings, generator, widen=widen
    )
    if found.training is None or trained.training is None:
        return found
    evaluations = found.training.point_evaluations + trained.training.point_evaluations
    return replace(found, training=replace(found.training, point_evaluations=evaluations))


def _verdict(
    solution: Solution, found: _Pass, record: ChainTraining, tol: float, is_late: bool
) -> tuple[bool, str]:
    """Return success and message."""
    count, excess = len(record.steps), found.excess
    trained, error = found.trained, found.estimate.error
    networks = f"{count:,} network{'s' if count > 1 else ''}"
    state = f"{networks}, estimated error {excess:.1e} of the tolerance"
    held = error.until(found.allowed)
    if trained.reason:
        return False, (
            f"stopped at t = {trained.reached:.6g}: {trained.reason}; tol {tol:.1e} held until "
            f"t = {held:.6g}"
        )
    jump = first_jump(
        solution,
        record.times(solution.span, _JUMP_SAMPLES * len(record.edges)),
        unresolved(solution),
    )
    if jump is not None:
        return False, f"{jump} ({state})"
    if trained.doubt:
        return False, f"{trained.doubt}; {state}"
    if excess <= 1:
        return True, f"tol {tol:.1e} met: {state}"
    if found.estimate.limit:
        cause = found.estimate.limit
    elif not (error.floors.max(axis=0) <= 0.3 * found.allowed).all():
        cause = "limited by float64 round-off"
    elif is_late:
        cause = "the time limit was reached"
    else:
        cause = "the networks could not be made accurate enough"
    return False, f"tol {tol:.1e} met only until t = {held:.6g}: {cause}; {state}"


@contextmanager
def _progress(
    show: bool | Callable[[TrainingState], None] | None,
) -> Iterator[Callable[[float], None]]:
    """Yield a function that takes the share of the span that a window adds."""
    if callable(show):
        report, began = show, time.perf_counter()
        shares: list[float] = []

        def tell(share: float) -> None:
            shares.append(share)
            done, expected = len(shares), round(len(shares) / sum(shares))
            nan = float("nan")
            report(TrainingState(done, expected, nan, nan, nan, time.perf_counter() - began))

        yield tell
        return
    with stepping_progress(_PERCENT, show, "training") as update:
        yield lambda share: update(round(_PERCENT * share))


@contextmanager
def _one_thread() -> Iterator[None]:
    # The systems of a window are too small for more.
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)
