"""Deep networks beside the features: true error, CPU seconds, and epochs of Adam.

The error is the largest of any component at 4,001 times. CPU seconds are those of the whole call on
one torch thread; an epoch is one of Adam written in the usual way (:mod:`tests.benchmarks.epoch`),
measured in the same run.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch

import hamsym
from hamsym import systems
from hamsym.solving.methods import made_method

from . import markdown
from .epoch import usual
from .measuring import cpu, median
from .problems import Case, henon_heiles, oscillator
from .results import Section

PROBLEMS = (
    ("oscillator, 4 pi", "nonlinear_oscillator", oscillator),
    ("Henon-Heiles, 6 pi", "henon_heiles", henon_heiles),
)


def measure(quick: bool) -> Section:
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    seeds = 0 if quick else 10
    small: dict[str, Any] = {"hidden": (10,), "points": 50} if quick else {}
    methods: list[tuple[str, dict[str, Any]]] = [
        ("features", {"tol": 1e-6}),
        ("levenberg-marquardt", {"iterations": 20} if quick else {"tol": 1e-6}),
        ("lbfgs", {"iterations": 20 if quick else 1_000}),
        ("adam", {"epochs": 100 if quick else 10_000}),
    ]
    epochs = [usual(50 if quick else 300, torch.float64)]
    rows, by_seed = [], []
    for label, name, field in PROBLEMS[:1] if quick else PROBLEMS:
        problem = systems.CATALOGUE[name]()
        case = Case.of(label, name, problem.span[1], field, 4_001)
        for method, options in methods:
            if method == "adam" and name != "nonlinear_oscillator":
                continue
            settings = options if method == "features" else {**options, **small}
            row = _row(case, method, **settings)
            rows.append({**row, "method": method, "options": options})
            epochs.append(usual(50 if quick else 300, torch.float64))
        for seed in range(seeds):
            for target in ({"tol": 2e-7}, {}):
                row = _row(case, "levenberg-marquardt", seed, **target)
                by_seed.append({**row, "seed": seed, "options": target})
                epochs.append(usual(300, torch.float64))
    torch.set_num_threads(threads)
    return {"epoch": median(epochs), "rows": rows, "seeds": by_seed}


def _row(
    case: Case, name: str, seed: int = 0, tol: float | None = None, **options: Any
) -> dict[str, Any]:
    method = made_method(name, options)
    seconds, solution = cpu(
        lambda: hamsym.solve(
            case.H, case.z0, case.span, tol=tol, method=method, seed=seed, progress=False
        )
    )
    error = float(np.abs(solution(case.t) - case.truth).max())
    row = {"problem": case.label, "error": error, "seconds": seconds}
    if name == "levenberg-marquardt":
        row |= {
            "iterations": solution.record.iterations,
            "restarts": solution.record.restarts,
        }
    return row


def table(section: Section) -> str:
    unit = section["epoch"]
    rows = [
        [
            row["problem"],
            f'`"{row["method"]}"`',
            ", ".join(f"{key}={value:g}" for key, value in row["options"].items()),
            markdown.plain(row["error"]),
            f"{row['seconds']:.3f}",
            f"{row['seconds'] / unit:,.0f}",
        ]
        for row in section["rows"]
    ]
    head = ["problem", "method", "settings", "true error", "CPU s", "usual epochs"]
    text = markdown.table(head, rows, left=3)
    text += f"\n\nA usual epoch takes {1e3 * unit:.2f} ms in this run."
    for problem in dict.fromkeys(row["problem"] for row in section["seeds"]):
        for target, words in (
            ({"tol": 2e-7}, "to a tolerance of 2e-7"),
            ({}, "without a tolerance"),
        ):
            runs = [
                row
                for row in section["seeds"]
                if row["problem"] == problem and row["options"] == target
            ]
            errors = sorted(row["error"] for row in runs)
            needed = sorted(row["seconds"] / unit for row in runs)
            restarts = sum(row["restarts"] for row in runs)
            text += (
                f"\nLevenberg-Marquardt on {problem} {words}, {len(runs)} seeds: true errors from "
                f"{errors[0]:.1e} to {errors[-1]:.1e} (median {median(errors):.1e}) in "
                f"{needed[0]:,.0f} to {needed[-1]:,.0f} usual epochs, {restarts} restarts in all."
            )
    return text
