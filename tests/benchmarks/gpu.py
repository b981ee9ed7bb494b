"""Members per second of the march in tensors, beside the compiled loop on all cores of the host.

Henon-Heiles over 6 pi at 1e-9 from random starts, error estimates and all checks included, without
the series of the errors. By the wall clock. On a graphics processor only where torch finds one.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import numpy as np
import torch

from hamsym import systems
from hamsym.random_features.members import Batch, MemberSolver
from hamsym.random_features.method import basis_for, checked_accuracy
from hamsym.random_features.options import FeatureOptions
from hamsym.random_features.tensor_members import TensorSolver
from hamsym.support.cores import available_cores

from . import markdown
from .measuring import in_turns, median, wall
from .results import Section

__all__ = ["measure", "table"]

_TOL, _SPAN = 1e-9, (0.0, 6 * math.pi)


def measure(quick: bool) -> Section:
    H = systems.henon_heiles().H
    accuracy = checked_accuracy(FeatureOptions(tol=_TOL), _SPAN, H.dim)
    given = H, _SPAN, _TOL, accuracy.local, accuracy.absolute, accuracy.longest, basis_for(0, _TOL)
    cores, turns = available_cores(), 1 if quick else 3
    compiled = [MemberSolver(*given) for _ in range(cores)]

    def on_all_cores(states: np.ndarray) -> list[Batch]:
        parts = np.array_split(states, cores)
        with ThreadPoolExecutor(cores) as pool:
            return list(pool.map(_one, compiled, parts))

    few = 100 if quick else 10_000
    calls: list[tuple[str, int, Callable[[np.ndarray], list[Batch]]]] = [
        (f"compiled loop, {cores} cores", few, on_all_cores),
        (
            f"tensors, cpu, threads: {torch.get_num_threads()}",
            few,
            partial(_whole, TensorSolver(*given, device="cpu")),
        ),
    ]
    graphics = torch.cuda.get_device_name() if torch.cuda.is_available() else ""
    if graphics:
        solve = partial(_whole, TensorSolver(*given, device="cuda"))
        for count in [few] if quick else [10_000, 100_000, 1_000_000]:
            calls.append(("tensors, cuda", count, solve))
    starts = np.random.default_rng(0).uniform(-0.25, 0.25, (max(c for _, c, _ in calls), H.dim))
    rows: list[dict[str, Any]] = []
    for name, count, call in calls:
        states = starts[:count]
        if not all(part.accepted.all() for part in call(states)):
            raise AssertionError(f"{name}: a member was not accepted")
        seconds = median(in_turns({name: partial(call, states)}, turns, wall)[name])
        rows.append({"method": name, "members": count, "seconds": seconds})
    reference = rows[0]["seconds"] / rows[0]["members"]
    for row in rows:
        row["members a second"] = row["members"] / row["seconds"]
        row["ratio"] = reference * row["members a second"]
    return {"repeats": turns, "graphics": graphics, "rows": rows}


def _one(solver: MemberSolver, states: np.ndarray) -> Batch:
    return solver.solve(states, np.empty((len(states), 0)), keep_error=False)


def _whole(solver: MemberSolver, states: np.ndarray) -> list[Batch]:
    return [_one(solver, states)]


def table(section: Section) -> str:
    rows = [
        [
            row["method"],
            f"{row['members']:,}",
            f"{row['seconds']:.3f}",
            f"{row['members a second']:,.0f}",
            f"{row['ratio']:.2f}",
        ]
        for row in section["rows"]
    ]
    head = ["", "members", "seconds", "members a second", "over the compiled loop"]
    graphics = section["graphics"] or "not measured: torch found none"
    return markdown.table(head, rows) + f"\n\nGraphics processor: {graphics}."
