"""Comparison of one solve of the audit with its reference."""

from __future__ import annotations

import functools
import json
import math
import re
import time
import warnings
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path

import numpy as np

import hamsym

from .systems import BY_NAME, System

_EPS = 2.0**-52
_ROUND_OFF = 1e3 * _EPS  # relative to the growth of errors: larger errors are not round-off
_SEEN = 1e-14  # relative error below which the state itself is rounded
_FACTOR = 10  # largest ratio of an estimate and the true error
_PESSIMISM = 50  # largest ratio of the round-off named in a refusal and the true error
_SMALL = 1e-8  # scale of a zero component, relative to the largest of its half
_HELD = re.compile(r"(?:held|met only) until t = ([-+]?[0-9.]+(?:e[-+]?[0-9]+)?)")
_TIME = re.compile(r"\bt = [-+]?[0-9]")


@dataclass(frozen=True)
class Verdict:
    """Result of a solve and its true errors, in units of the allowed error.

    Attributes
    ----------
    success, message
        As in the solution; False and "" if solve raised.
    raised : str
        Class and text of an exception.
    estimate, floor : float
        Largest estimated error at the times of the reference, with round-off; round-off alone.
    truth, where, component
        Largest true error at those times, its time and its component.
    held : float
        Largest true error until the time up to which a refusal claims that tol held.
    judgeable : bool
        Whether the true error is above round-off.
    complete : bool
        Whether solution and reference both reach the end of the span.
    seconds : float
    """

    success: bool = False
    message: str = ""
    raised: str = ""
    estimate: float = math.nan
    floor: float = math.nan
    truth: float = math.nan
    where: float = math.nan
    component: str = ""
    held: float = math.nan
    judgeable: bool = False
    complete: bool = False
    seconds: float = 0.0


@functools.lru_cache(maxsize=1)
def references() -> dict[str, dict]:
    """Read the references that ``make_references.py`` wrote."""
    return json.loads(Path(__file__).with_name("references.json").read_text())


@functools.lru_cache(maxsize=4)
def _hamiltonian(name: str) -> hamsym.Hamiltonian:
    system = BY_NAME[name]
    return hamsym.Hamiltonian(
        system.text, q=system.q.split(), p=system.p.split(), parameters=system.parameters
    )


def difference(values: np.ndarray, decimals: list[list[str]]) -> np.ndarray:
    """Subtract decimal numbers from float64 values, with more digits than float64."""
    high = np.array([[float(text) for text in row] for row in decimals])
    low = np.array(
        [[float(Decimal(text) - Decimal(float(text))) for text in row] for row in decimals]
    )
    return np.asarray((values - high) - low)


def judged(system: System, tol: float) -> Verdict:
    """Solve at a tolerance and compare with the reference."""
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            H = _hamiltonian(system.name)
            solution = hamsym.solve(H, system.start, system.span, tol=tol, progress=False)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"
        message = str(error) if isinstance(error, hamsym.InputError) else ""
        return Verdict(raised=text, message=message, seconds=time.process_time() - began)
    seconds = time.process_time() - began
    success, message = solution.success, solution.message
    if system.reference == "none":
        return Verdict(success, message, seconds=seconds)
    row = references()[system.name]
    columns = [[str(name) for name in solution.H.z].index(name) for name in system.names]
    direction = math.copysign(1.0, system.span[1] - system.span[0])
    times = np.array(row["times"])
    # Times in messages have six digits.
    limits = [direction * solution.span[1]]
    if held := _HELD.search(message):
        limits.append(direction * (float(held[1]) - direction * 1e-5 * abs(float(held[1]))))
    reached = direction * times <= limits[0]
    if not reached.any():
        return Verdict(success, message, seconds=seconds)
    times = times[reached]
    states = [state for state, seen in zip(row["states"], reached, strict=True) if seen]
    with np.errstate(all="ignore"):
        errors = np.abs(difference(solution(times)[:, columns], states))
        estimates = np.abs(solution.error_estimate(times)[:, columns])
        floors = solution.error.floor(times)[:, columns]
        allowed = tol * _scales(system, row)
        truth = np.where(errors > 0, errors / allowed, np.where(np.isnan(errors), np.inf, 0.0))
        counted = allowed > 0
        estimated = ((estimates + floors) / allowed)[:, counted]
        round_off = (floors / allowed)[:, counted]
    place, which = np.unravel_index(truth.argmax(), truth.shape)
    until = direction * times <= limits[-1]
    return Verdict(
        success,
        message,
        estimate=float(estimated.max(initial=0.0)),
        floor=float(round_off.max(initial=0.0)),
        truth=float(truth.max()),
        where=float(times[place]),
        component=system.names[which],
        held=float(truth[until].max(initial=0.0)) if held else math.nan,
        complete=system.until is None and bool(reached.all()),
        judgeable=bool(truth.max() * tol > _ROUND_OFF * row["growth"]),
        seconds=seconds,
    )


def _scales(system: System, row: dict) -> np.ndarray:
    """Largest magnitude of each component; for zero components, 1e-8 of that of their half."""
    scales = np.array(row["scales"])
    halves = np.repeat(scales.reshape(2, -1).max(axis=1), len(scales) // 2)
    zero = np.array([name in system.zero for name in system.names]) | (scales == 0)
    return np.where(zero, _SMALL * halves, scales)


def complaints(system: System, tol: float, verdict: Verdict) -> list[str]:
    """Describe each defect of a solve in words."""
    found = []
    if verdict.raised and not verdict.raised.startswith("InputError"):
        return [f"raised {verdict.raised}"]
    if verdict.raised and ("\n" in verdict.message or ". " in verdict.message):
        found.append(f"not one sentence: {verdict.message}")
    if verdict.success and tol in system.must_refuse:
        found.append(f"success where there can be none: {verdict.message}")
    if verdict.success and system.reference != "none" and system.until is None:
        if not verdict.truth <= 1:
            found.append(
                f"success with {verdict.truth:.2g} of the allowed error in {verdict.component} "
                f"at t = {verdict.where:.6g}, estimated {verdict.estimate:.2g}"
            )
        # Too small an estimate is wrong even if the error is round-off; one that is too large is
        # wrong only if it estimates the error of the march.
        low = verdict.estimate * _FACTOR >= verdict.truth or verdict.truth * tol <= _SEEN
        high = verdict.estimate <= _FACTOR * verdict.truth or not verdict.judgeable
        if not low or not (high or verdict.floor > 0.3 * verdict.estimate):
            found.append(
                f"estimate {verdict.estimate:.2g} (round-off {verdict.floor:.2g}) of a true "
                f"{verdict.truth:.2g}, in {verdict.component} at t = {verdict.where:.6g}"
            )
        if not math.isfinite(verdict.estimate):
            found.append(f"success with an estimate of {verdict.estimate}")
    if not verdict.success:
        if tol in system.must_succeed:
            found.append(f"refused: {verdict.message}")
        if not _TIME.search(verdict.message):
            found.append(f"a refusal without a time: {verdict.message}")
        pessimistic = verdict.complete and "round-off" in verdict.message
        if pessimistic and verdict.truth < 1 / _PESSIMISM and tol not in system.must_refuse:
            found.append(f"refused with {verdict.truth:.2g} of the allowed: {verdict.message}")
        if not re.search(system.word, verdict.message):
            found.append(f"a refusal without its reason ({system.word}): {verdict.message}")
        if not (math.isnan(verdict.held) or verdict.held <= _FACTOR):
            found.append(
                f"{verdict.held:.2g} of the allowed error where it is said to hold: "
                f"{verdict.message}"
            )
    return found
