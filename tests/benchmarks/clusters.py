"""solve_many on a LocalCluster beside threads: strong and weak scaling.

By the wall clock. A process of the cluster has one thread. Strong scaling: the same members on one
and on two processes; weak scaling: as many for each process. Results return through the client.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np

import hamsym
from hamsym import systems

from . import markdown
from .families import starts
from .measuring import in_turns, median, median_ratio, on_one_core, wall
from .opponents import optional
from .results import Section

__all__ = ["measure", "table"]

_END = 6 * np.pi


def measure(quick: bool) -> Section:
    count, turns = (60, 1) if quick else (20_000, 5)
    skipped: list[str] = []
    if optional("distributed", skipped) is None:
        return {"repeats": turns, "members": count, "rows": [], "skipped": skipped}
    from dask.distributed import Client, LocalCluster

    H, z0 = systems.henon_heiles().H, starts(count)
    half = z0[: count // 2]

    def many(z: np.ndarray, client: Any = None) -> None:
        hamsym.solve_many(H, z, (0.0, _END), tol=1e-9, progress=False, client=client)

    def alone() -> None:
        with on_one_core():
            many(z0)

    options: dict[str, Any] = {"threads_per_worker": 1, "dashboard_address": ":0"}
    with (
        LocalCluster(n_workers=1, **options) as one,
        LocalCluster(n_workers=2, **options) as two,
        Client(one, set_as_default=False) as single,
        Client(two, set_as_default=False) as pair,
    ):
        times = in_turns(
            {
                "threads, one core": alone,
                "threads, all cores": lambda: many(z0),
                "one process": lambda: many(z0, single),
                "two processes": lambda: many(z0, pair),
                "one process, half the members": lambda: many(half, single),
            },
            turns,
            wall,
        )
    rows = [
        {
            "method": name,
            "seconds": median(column),
            "ratio": median_ratio(column, times["threads, all cores"]),
        }
        for name, column in times.items()
    ]
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    pairs = times["two processes"]
    return {
        "repeats": turns,
        "members": count,
        "cores": cores,
        "rows": rows,
        "skipped": skipped,
        "strong": median_ratio(times["one process"], pairs),
        "weak": median_ratio(times["one process, half the members"], pairs),
    }


def table(section: Section) -> str:
    rows = [
        [row["method"], f"{row['seconds']:.2f}", f"{row['ratio']:.2f}"] for row in section["rows"]
    ]
    text = markdown.table(["", "seconds", "over threads, all cores"], rows)
    if rows:
        text += (
            f"\n\n{section['members']:,} members over 6 pi at 1e-9, {section['cores']} cores. From "
            f"one process to two: the same members {section['strong']:.2f} times as fast (strong "
            f"scaling, at best 2), twice the members at {section['weak']:.2f} of the speed each "
            "(weak scaling, at best 1)."
        )
    return text + markdown.skipped(section["skipped"])
