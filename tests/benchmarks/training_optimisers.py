"""The paper's network by each optimiser: true error over the time of training, on one thread.

Two layers of 50 sines. Adam as written has the settings of the paper's text, and the authors'
settings are those of their published code; both have a constant rate. Every entry is a run of its
own that ends at its time; Adam with a decreasing rate gets as many epochs as fit, by a trial of
200. A method that ends by itself keeps its error.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch

import hamsym

from . import markdown
from .measuring import median
from .networks import PROBLEMS
from .problems import Case
from .results import Section

__all__ = ["measure", "table"]

_ENDLESS = 10**9  # epochs or iterations
_TWO_PERIODS, _SIX_PI = 4 * math.pi, 6 * math.pi
_AUTHORS = {"betas": (0.999, 0.9999)}
# Points, noise as written, noise of the authors' code, and tau of Adam with a decreasing rate.
_PAPER = {
    "nonlinear_oscillator": (200, 0.06 * math.pi, 0.03 * _TWO_PERIODS**2 / 200, 0.25),
    "henon_heiles": (100, 0.18 * math.pi, 0.3 * _SIX_PI**2 / 100, 0.5),
}


def _methods(problem: str) -> dict[str, dict[str, Any]]:
    points, written, authors, tau = _PAPER[problem]
    paper = {"method": "adam", "schedule": "constant", "points": points, "epochs": _ENDLESS}
    return {
        "Adam, as written": {**paper, "noise": written},
        "Adam, authors' settings": {**paper, "noise": authors, **_AUTHORS},
        "Adam, cosine": {"method": "adam", "betas": (0.99, 0.999), "tau": tau},
        "L-BFGS": {"method": "lbfgs", "iterations": _ENDLESS},
        "SSBroyden": {"method": "ssbroyden", "iterations": _ENDLESS},
        "Levenberg-Marquardt, one network": {
            "method": "levenberg-marquardt",
            "iterations": _ENDLESS,
        },
        "Levenberg-Marquardt, chain": {"method": "levenberg-marquardt"},
        "features": {"method": "features", "tol": 1e-12},
    }


def measure(quick: bool) -> Section:
    limits, seeds = ([1.0, 2.0], 1) if quick else ([2.0, 6.0, 20.0, 60.0], 3)
    small: dict[str, Any] = {"hidden": (10,), "points": 50} if quick else {}
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    rows = []
    try:
        for label, name, field in PROBLEMS[:1] if quick else PROBLEMS:
            end = hamsym.systems.CATALOGUE[name]().span[1]
            case = Case.of(label, name, end, field, 4_001)
            for method, options in _methods(name).items():
                if {"epochs", "iterations", "betas"} & {*options}:  # one network
                    options |= small
                for seed in range(seeds):
                    course = _course(case, limits, {**options, "seed": seed})
                    rows.append(
                        {"problem": label, "method": method, "seed": seed, "course": course}
                    )
                    print(f"{label}, {method}, seed {seed}: {course[-1][1]:.1e}", flush=True)
    finally:
        torch.set_num_threads(threads)
    return {"limits": limits, "rows": rows, "skipped": []}


def _course(case: Case, limits: list[float], options: dict[str, Any]) -> list[list[float]]:
    """CPU seconds and true error of a run for each limit of the time."""

    def solve(**more: Any) -> Any:
        return hamsym.solve(case.H, case.z0, case.span, progress=False, **{**options, **more})

    epoch = 0.0
    if options["method"] == "adam" and "epochs" not in options:
        epoch = solve(epochs=200).record.seconds / 200
    course: list[list[float]] = []
    for limit in limits:
        more: dict[str, Any] = {} if options["method"] == "features" else {"time_limit": limit}
        if epoch:
            more["epochs"] = max(1, int(0.97 * limit / epoch))
        solution = solve(**more)
        record = solution.record
        seconds = getattr(record, "cpu_seconds", record.seconds)
        reached = np.minimum(case.t, solution.span[1])  # a chain may end early: its last state
        course.append([seconds, float(np.abs(solution(reached) - case.truth).max())])
        if not epoch and getattr(record, "stopped", "") != "time limit":
            break  # a longer limit changes nothing
    return course


def table(section: Section) -> str:
    limits, rows = section["limits"], []
    for problem, method in dict.fromkeys((r["problem"], r["method"]) for r in section["rows"]):
        courses = [
            row["course"]
            for row in section["rows"]
            if (row["problem"], row["method"]) == (problem, method)
        ]
        cells = []
        for k in range(len(limits)):
            errors = sorted(course[min(k, len(course) - 1)][1] for course in courses)
            cells.append(markdown.plain(median(errors)))
        spread = f"{markdown.plain(errors[0])} to {markdown.plain(errors[-1])}"
        used = markdown.number(median(course[-1][0] for course in courses), 2)
        rows.append([problem, method, *cells, spread, used])
    head = ["problem", "method", *(f"{limit:g} s" for limit in limits), "errors at the end"]
    text = markdown.table([*head, "CPU s"], rows, left=2)
    count = len({row["seed"] for row in section["rows"]})
    return text + (
        f"\n\nMedian of the true error over {count} seed{'s' if count > 1 else ''} after so many "
        "seconds of training, with the range and the CPU seconds of the last."
    )
