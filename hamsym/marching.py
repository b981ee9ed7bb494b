"""The method "features": random sine features marched until the estimated error is as asked.

Stage 1  March with a local tolerance (:mod:`hamsym.features`).
Stage 2  Estimate the global error and the round-off along the march (:mod:`hamsym.estimates`).
Stage 3  If both together exceed what was asked, march again with a tighter local tolerance.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hamsym import compiled
from hamsym.errors import InputError
from hamsym.estimates import MarchError, estimate_error
from hamsym.features import MAX_WINDOWS, FeatureTrial, Flow, March, feature_basis, march
from hamsym.hamiltonian import Hamiltonian
from hamsym.jumps import first_jump
from hamsym.problem import InitialValueProblem
from hamsym.solution import Solution
from hamsym.tangent import generators

__all__ = ["FeatureOptions", "flow_of", "solve_by_features"]

_SMALLEST_TOL = 1e-12  # below it float64 cannot hold the answer
_SMALLEST_LOCAL = 1e-13  # residuals cannot be told from round-off below
_ATTEMPTS = 6
_JUMP_SAMPLES = 25  # of a window, in the search for jumps of the force
_FEWEST_WINDOWS = 8  # so that a short event in a long rest is not stepped over unseen


@dataclass(frozen=True)
class FeatureOptions:
    """Options of the method "features"; see :func:`hamsym.solve`."""

    tol: float = 1e-9
    atol: float | Sequence[float] = 0.0
    breakpoints: Sequence[float] = ()
    max_window: float | None = None


def solve_by_features(problem: InitialValueProblem, options: FeatureOptions) -> Solution:
    """March to a tolerance; options as in :func:`hamsym.solve`."""
    tol = options.tol
    H = problem.H
    if not (isinstance(tol, (int, float, np.floating)) and _SMALLEST_TOL <= tol < 1):
        raise InputError(
            f"tol={tol!r} cannot be used; give a number from {_SMALLEST_TOL:g} to below 1"
        )
    absolute = _checked_atol(options.atol, H.dim)
    longest = _checked_window(options.max_window, problem.span)
    stops = _checked_breakpoints(options.breakpoints, problem.span)
    basis = feature_basis(problem.seed)
    flow = flow_of(H)
    windows, error, allowed, excess = None, None, absolute, math.inf
    # The cost grows as the 18th root of the accuracy: a margin is cheaper than a second march.
    local = max(0.1 * tol, _SMALLEST_LOCAL)
    with np.errstate(all="ignore"):
        for _ in range(_ATTEMPTS):
            tried = march(
                flow, problem.z0, problem.span, local, basis, breakpoints=stops, longest=longest
            )
            if not len(tried.readouts):
                break
            estimate = estimate_error(tried, basis, flow)
            allowed_now = absolute + tol * _scales(tried.scale)
            ratios = np.where(estimate.largest > 0, estimate.largest / allowed_now, 0.0)
            if windows is None or ratios.max() < excess:
                windows, error, allowed, excess = tried, estimate, allowed_now, ratios.max()
            floors = estimate.floors.max(axis=0)
            # What is left is round-off where that is most of the error; no march gets below it.
            left = (estimate.largest > np.maximum(2 * floors, allowed_now)).any()
            if ratios.max() <= 1 or not left or local <= _SMALLEST_LOCAL:
                break
            local = max(local * min(0.3 / float(ratios.max()), 0.3), _SMALLEST_LOCAL)
    if windows is None or error is None:
        raise InputError(f"no solution beyond t = {tried.reached:.6g}: {tried.reason}")
    solution = Solution(
        H,
        problem.z0,
        (problem.span[0], windows.reached),
        FeatureTrial.of_march(windows, basis),
        method="features",
        training=windows,
        march_error=error,
    )
    solution.success, solution.message = _verdict(windows, error, tol, allowed, float(excess))
    if solution.success:
        jump = first_jump(solution, windows.times(_JUMP_SAMPLES))
        if jump is not None:
            solution.success, solution.message = False, f"{jump} ({solution.message})"
    return solution


def flow_of(H: Hamiltonian) -> Flow:
    """The equations, with compiled code where that is there."""
    system = H.compile("numpy")

    def vector_field(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return np.asarray(system.vector_field(*system.arguments(z, t)))

    def jacobian(z: np.ndarray, t: np.ndarray) -> np.ndarray:
        return generators(system.hessian(*system.arguments(z, t)))

    def rates(z: np.ndarray, t: np.ndarray, out: np.ndarray) -> None:
        out[:] = vector_field(z, t)

    plain = Flow(vector_field, jacobian, rates, compiled=lambda: _compiled(H, plain))
    return _compiled(H, plain) if compiled.prepared(H) else plain


def _compiled(H: Hamiltonian, plain: Flow) -> Flow:
    H.compile("numba")
    rates = compiled.prepared(H)
    assert rates is not None
    return Flow(plain.vector_field, plain.jacobian, rates, compiled.compiled_loop())


def _verdict(
    windows: March, error: MarchError, tol: float, allowed: np.ndarray, excess: float
) -> tuple[bool, str]:
    state = f"{len(windows.readouts):,} windows, estimated error {excess:.1e} of what was allowed"
    held = error.until(allowed)
    if windows.reason:
        until, missing = f"t = {held:.6g}", abs(windows.reached - held)
        if until == f"t = {windows.reached:.6g}":
            until = f"{missing:.1e} before that" if missing else "there"
        return False, (
            f"stopped at t = {windows.reached:.6g}: {windows.reason}; tol {tol:.1e} held until "
            f"{until}"
        )
    if excess <= 1:
        return True, f"tol {tol:.1e} met: {state}"
    floors = error.floors.max(axis=0)
    cause = (
        "round-off, which float64 does not allow to fall further, is the reason"
        if (floors > 0.3 * allowed).any()
        else "the march could not be made accurate enough"
    )
    return False, f"tol {tol:.1e} held until t = {held:.6g} only, {cause}; {state}"


def _scales(scale: np.ndarray) -> np.ndarray:
    """s_i with the floor of 1e-8 of the largest among its kind."""
    halves = scale.reshape(2, -1)
    return np.maximum(halves, 1e-8 * halves.max(axis=1, keepdims=True)).ravel()


def _checked_atol(atol: float | Sequence[float], dim: int) -> np.ndarray:
    try:
        values = np.broadcast_to(np.asarray(atol, dtype=float), (dim,))
    except (TypeError, ValueError):
        values = np.array([math.nan])
    if not (np.all(np.isfinite(values)) and np.all(values >= 0)):
        raise InputError(f"atol={atol!r} cannot be used; give a number from 0, or {dim} of them")
    return values


def _checked_window(max_window: float | None, span: tuple[float, float]) -> float:
    if max_window is None:
        return abs(span[1] - span[0]) / _FEWEST_WINDOWS
    if not (isinstance(max_window, (int, float)) and max_window > 0):
        raise InputError(f"max_window={max_window!r} cannot be used; give a time above 0")
    if (shortest := abs(span[1] - span[0]) / MAX_WINDOWS) > max_window:
        raise InputError(
            f"max_window={max_window!r} makes more than {MAX_WINDOWS:,} windows; give "
            f"{shortest:.3g} or more, or a shorter span"
        )
    return float(max_window)


def _checked_breakpoints(breakpoints: Sequence[float], span: tuple[float, float]) -> list[float]:
    """Breakpoints in the direction of the span, each once."""
    try:
        times = sorted({float(time) for time in breakpoints})
    except (TypeError, ValueError):
        raise InputError(f"breakpoints={breakpoints!r} is not a list of times; give one") from None
    for time in times:
        if not min(span) < time < max(span):
            raise InputError(
                f"breakpoint {time:.6g} is not inside the span from {min(span):.6g} to "
                f"{max(span):.6g}; leave it out"
            )
    return times if span[0] < span[1] else times[::-1]
