"""Cost of a step of the methods for an H that cannot be split, on the double pendulum.

dop853 is scipy's at 1e-10, with steps of its own and the generated vector field in Python.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.integrators.table import INTEGRATORS

from . import markdown
from .measuring import in_turns, median
from .results import Section


def measure(quick: bool) -> Section:
    end, steps, turns = (10.0, 1_000, 1) if quick else (100.0, 10_000, 5)
    methods = ("gauss4",) if quick else ("implicit_midpoint", "gauss4", "gauss6", "tao2", "tao4")
    problem = systems.nonlinear_oscillator() if quick else systems.double_pendulum()
    integrate = partial(hamsym.integrate, problem.H, problem.z0, (0.0, end))
    calls: dict[str, Callable[[], Any]] = {
        method: partial(integrate, method, steps=steps, save_every=100) for method in methods
    }
    calls["dop853"] = partial(integrate, "dop853", steps=steps // 100, rtol=1e-10, atol=1e-10)
    rows = []
    for name, column in in_turns(calls, turns).items():
        trajectory = calls[name]()
        rows.append(
            {
                "method": name,
                "order": INTEGRATORS[name].order,
                "seconds": median(column),
                "evaluations": None if name == "dop853" else trajectory.evaluations / steps,
                "change of H": float(np.abs(trajectory.energy - trajectory.energy[0]).max()),
            }
        )
    return {"repeats": turns, "steps": steps, "end": end, "rows": rows}


def table(section: Section) -> str:
    steps = section["steps"]
    rows = []
    for row in section["rows"]:
        fixed = row["evaluations"] is not None
        rows.append(
            [
                f"`{row['method']}`",
                str(row["order"]),
                f"{1e6 * row['seconds'] / steps:.3f}" if fixed else "-",
                f"{row['evaluations']:.1f}" if fixed else "-",
                f"{1e3 * row['seconds']:.2f}",
                markdown.plain(row["change of H"]),
            ]
        )
    head = ["method", "order", "us a step", "evaluations a step", "ms", "change of H"]
    return (
        markdown.table(head, rows)
        + f"\n\nDouble pendulum to t = {section['end']:g}, {steps:,} steps."
    )
