"""Whole calls of fixed-step methods and of solve at equal error, over heyoka.

Each method runs at twice the steps, or a tenth of the tolerance, each time; the time at an error is
interpolated by a power law between the runs that no other run of the method beats in both.
heyoka's integrators are made and compiled beforehand. All runs keep the same number of states.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np

import hamsym
from hamsym.errors import StepSizeWarning

from . import markdown
from .measuring import in_turns, largest_error, median
from .opponents import Run, heyoka_grid, heyoka_integrator, interpreted, optional, scipy_runs
from .problems import PROBLEMS, Case
from .results import Section

_OUTPUTS, _FEWEST = 960, 60
_ASKED = (1e-6, 1e-9)
_LARGEST, _LEAST = 3e-4, 3e-12  # errors of the runs that are timed
_METHODS = ("forest_ruth", "blanes_moan4", "blanes_moan6", "yoshida6", "yoshida8", "gauss6")


def measure(quick: bool) -> Section:
    missing: list[str] = []
    package = optional("heyoka", missing)
    turns, rows = 1 if quick else 5, []
    # Henon-Heiles and the oscillator; quick: the oscillator, with two methods.
    for label, name, end, field in PROBLEMS[:1] if quick else (PROBLEMS[2], PROBLEMS[0]):
        case = Case.of(label, name, end, field, _OUTPUTS + 1)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", StepSizeWarning)  # coarse steps are among the runs
            for method, runs in _runs(case, package, quick):
                rows += _timed(case, method, runs, turns)
    return {"repeats": turns, "rows": rows, "skipped": missing}


def _runs(case: Case, package: Any, quick: bool) -> Iterator[tuple[str, Iterator[Run]]]:
    if package:
        yield "heyoka", _heyoka_runs(case, package)
    for method in ("blanes_moan6",) if quick else _METHODS:
        yield method, _stepping_runs(case, method)
    yield "hamsym.solve", _solve_runs(case, range(6, 10) if quick else range(4, 12))
    if not quick:
        lean, tolerances = interpreted(case.field), [10.0**-k for k in range(5, 14)]
        runs = scipy_runs(case, "DOP853 (scipy)", "DOP853", lean, tolerances, grid=True)
        yield "DOP853 (scipy)", iter(runs)


def _timed(case: Case, method: str, runs: Iterator[Run], turns: int) -> list[dict[str, Any]]:
    """Rows of the runs whose error is of interest, timed in turns."""
    found = {}
    for run in runs:
        with np.errstate(all="ignore"):
            run.error = largest_error(run.states(run.call(), case.t), case.truth)
        if _LEAST < run.error < _LARGEST:
            found[f"{run.asked:g}"] = run
    times = in_turns({key: run.call for key, run in found.items()}, turns)
    return [
        {
            "problem": case.label,
            "method": method,
            "asked": run.asked,
            "error": run.error,
            "seconds": median(times[key]),
        }
        for key, run in found.items()
    ]


def _heyoka_runs(case: Case, package: Any) -> Iterator[Run]:
    for k in range(4, 17):
        integrator = heyoka_integrator(case, package, 10.0**-k)
        yield Run("heyoka", 10.0**-k, partial(heyoka_grid, case, integrator), lambda z, t: z)


def _stepping_runs(case: Case, method: str) -> Iterator[Run]:
    """Twice the steps each time, while the error falls; at most one state a step is kept."""
    steps, last = _FEWEST, math.inf
    while last > 1e-10 and steps < 2_000 * _OUTPUTS:
        call = partial(
            hamsym.integrate,
            case.H,
            case.z0,
            case.span,
            method,
            steps=steps,
            save_every=max(1, steps // _OUTPUTS),
        )
        run = Run(method, steps, call, lambda found, t: found.z)
        yield run
        if steps > _OUTPUTS and not run.error <= last / 2:
            break
        steps, last = 2 * steps, run.error


def _solve_runs(case: Case, exponents: range) -> Iterator[Run]:
    for k in exponents:

        def call(tol: float = 10.0**-k) -> np.ndarray:
            solution = hamsym.solve(case.H, case.z0, case.span, tol=tol)
            return np.asarray(solution(case.t))

        yield Run("hamsym.solve", 10.0**-k, call, lambda z, t: z)


def time_at(rows: list[dict[str, Any]], error: float) -> float:
    """Seconds at an error; those of the fastest run where all are more accurate."""
    front: list[dict[str, Any]] = []
    for row in sorted(rows, key=lambda row: (row["seconds"], row["error"])):
        if not front or row["error"] < front[-1]["error"]:
            front.append(row)
    if not front or not front[-1]["error"] <= error:
        return math.nan
    errors, times = ([row[key] for row in front] for key in ("error", "seconds"))
    return math.exp(float(np.interp(-math.log(error), -np.log(errors), np.log(times))))


def table(section: Section) -> str:
    problems = list(dict.fromkeys(row["problem"] for row in section["rows"]))
    methods = list(dict.fromkeys(row["method"] for row in section["rows"]))
    head = ["ms at a true error of"]
    head += [f"{text}: {error:.0e}" for text in problems for error in _ASKED for _ in (0, 1)]
    head[2::2] = ["over heyoka"] * (len(head[2::2]))
    lines = []
    for method in methods:
        cells = [f"`{method}`" if method in _METHODS else method]
        for problem in problems:
            at = [row for row in section["rows"] if row["problem"] == problem]
            for error in _ASKED:
                own, peer = (
                    time_at([row for row in at if row["method"] == name], error)
                    for name in (method, "heyoka")
                )
                cells += [markdown.number(1e3 * own), markdown.number(own / peer)]
        lines.append(cells)
    return markdown.table(head, lines) + markdown.skipped(section["skipped"])
