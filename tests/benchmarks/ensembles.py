"""10,000 trajectories in one call, beside a loop over calls and beside their steps alone.

By the wall clock, because one call uses all cores. The loop and the steps alone are measured on
fewer trajectories and scaled. Both give the same states, to 1e-9.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import hamsym
from hamsym import systems

from . import markdown
from .measuring import in_turns, median, median_ratio, on_one_core, wall
from .results import Section

_METHOD = "blanes_moan4"


def measure(quick: bool) -> Section:
    batch, looped, steps, turns = (200, 20, 100, 2) if quick else (10_000, 500, 1_000, 5)
    problem = systems.nonlinear_oscillator() if quick else systems.henon_heiles()
    shape = batch, problem.H.dim
    starts = np.random.default_rng(0).uniform(-0.2, 0.2, shape)  # all of them stay bound
    integrate = partial(
        hamsym.integrate, problem.H, span=(0.0, 0.1 * steps), method=_METHOD, save_every=steps
    )
    whole = partial(integrate, starts, steps=steps)

    def on_one() -> None:
        with on_one_core():
            whole()

    def looping() -> list[hamsym.Trajectory]:
        return [integrate(z, steps=steps) for z in starts[:looped]]

    calls: dict[str, Callable[[], Any]] = {
        "one call": whole,
        "one call, on one core": on_one,
        "a loop over calls": looping,
        "steps alone, in turn": partial(integrate, problem.z0, steps=looped * steps),
    }
    times = in_turns(calls, turns, wall)
    singles = np.stack([trajectory.z for trajectory in looping()])
    if not np.allclose(singles, whole().z[:looped], rtol=0, atol=1e-9):
        raise AssertionError("an ensemble and its trajectories alone differ")
    rows = []
    for name, column in times.items():
        scale = 1.0 if "one call" in name else batch / looped
        scaled = [scale * value for value in column]
        rows.append(
            {
                "method": name,
                "seconds": median(scaled),
                "ratio": median_ratio(scaled, times["one call"]),
            }
        )
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"repeats": turns, "batch": batch, "steps": steps, "cores": cores, "rows": rows}


def table(section: Section) -> str:
    batch, steps = section["batch"], section["steps"]
    rows = [
        [
            row["method"],
            f"{row['seconds']:.3f}",
            f"{1e6 * row['seconds'] / batch:.1f}",
            f"{1e9 * row['seconds'] / batch / steps:.2f}",
            f"{row['ratio']:.2f}",
        ]
        for row in section["rows"]
    ]
    head = ["", "seconds", "us each", "ns a step", "over one call"]
    return (
        markdown.table(head, rows)
        + f"\n\n{batch:,} trajectories of {steps:,} steps of `{_METHOD}`, {section['cores']} cores."
    )
