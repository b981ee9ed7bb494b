"""10,000 Henon-Heiles starts to a tolerance: solve_many and integrate beside other packages.

Energies are drawn from 0.02 to 1/6. Errors are those of the final states, against solve_many at
1e-12. CPU microseconds for each member, on one core, and wall time on all of them.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import Any

import numpy as np

import hamsym
from hamsym import systems

from . import markdown
from .measuring import cpu, median, on_one_core, wall
from .opponents import optional
from .results import Section

_END = 6 * np.pi
_LOOPED = 50  # members of a loop over calls of solve


def starts(count: int) -> np.ndarray:
    """Random states below the energy of escape, shape (count, 4)."""
    random = np.random.default_rng(0)
    y = random.uniform(-0.1, 0.1, count)
    energy, angle = random.uniform(0.02, 1 / 6, count), random.uniform(0, 2 * np.pi, count)
    momentum = np.sqrt(2 * (energy - y**2 / 2 + y**3 / 3))
    return np.stack([0 * y, y, momentum * np.cos(angle), momentum * np.sin(angle)], axis=1)


def measure(quick: bool) -> Section:
    count, turns = (100, 1) if quick else (10_000, 5)
    H, z0 = systems.henon_heiles().H, starts(count)
    span = (0.0, _END)
    truth = hamsym.solve_many(H, z0, span, tol=1e-12, progress=False)(_END)

    def many() -> Any:
        return hamsym.solve_many(H, z0, span, tol=1e-9, progress=False)

    def integrated() -> Any:
        return hamsym.integrate(H, z0, span, tol=1e-9, saves=1, progress=False)

    def looped() -> Any:
        return [hamsym.solve(H, z, span, tol=1e-9) for z in z0[:_LOOPED]]

    calls: dict[str, tuple[Callable[[], Any], Callable[[Any], np.ndarray], int]] = {
        "solve_many": (many, lambda found: found(_END), count),
        "integrate, tol": (integrated, lambda found: found.z[:, -1], count),
        "loop of solve": (looped, lambda found: np.array([s(_END) for s in found]), _LOOPED),
    }
    skipped: list[str] = []
    package = optional("heyoka", skipped)
    if package is not None:
        calls["heyoka, loop"] = (*_heyoka(package, z0), count)
    rows = []
    for name, (call, ends, members) in calls.items():
        call()  # compiles
        seconds, everywhere = [], []
        for _ in range(turns):
            with on_one_core():
                spent, result = cpu(call)
            seconds.append(spent / members)
            everywhere.append(wall(call) / members)
        error = float(np.abs(ends(result) - truth[:members]).max())
        good = getattr(result, "success", True)
        rows.append(
            {
                "method": name,
                "us": 1e6 * median(seconds),
                "wall": 1e6 * median(everywhere),
                "error": error,
                "succeeded": float(np.mean(good)),
            }
        )
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"repeats": turns, "batch": count, "cores": cores, "rows": rows, "skipped": skipped}


def _heyoka(package: Any, z0: np.ndarray) -> tuple[Callable[[], Any], Callable[[Any], np.ndarray]]:
    """A loop over members with heyoka's scalar integrator, without continuous output."""
    x, y, u, v = package.make_vars("x", "y", "u", "v")
    equations = [(x, u), (y, v), (u, -x - 2 * x * y), (v, -y - x * x + y * y)]
    integrator = package.taylor_adaptive(equations, z0[0].tolist(), tol=1e-9)

    def call() -> np.ndarray:
        out = np.empty_like(z0)
        for k, start in enumerate(z0):
            integrator.time = 0.0
            integrator.state[:] = start
            integrator.propagate_until(_END)
            out[k] = integrator.state
        return out

    return call, lambda found: found


def table(section: Section) -> str:
    rows = [
        [
            row["method"],
            f"{row['us']:.1f}",
            f"{row['wall']:.1f}",
            f"{row['us'] / row['wall']:.2f}",
            f"{row['error']:.0e}",
            f"{100 * row['succeeded']:.1f} %",
        ]
        for row in section["rows"]
    ]
    cores = section["cores"]
    head = ["", "us each, one core", f"wall us each, {cores} cores", "ratio", "error", "succeeded"]
    return (
        markdown.table(head, rows)
        + f"\n\n{section['batch']:,} members over 6 pi at 1e-9; a loop of solve with {_LOOPED} of "
        "them. `solve_many` has continuous solutions; both of hamsym estimate every error."
    )
