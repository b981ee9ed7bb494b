"""The oscillator's box by flow_map, and by networks of neurodiffeq trained for ten minutes.

neurodiffeq's BundleSolver1D with its default points, two networks with two hidden layers of 64
sines, and Adam at its default rate. Errors are the largest from 10,000 random starts at 20 times
each. One torch thread.
"""

from __future__ import annotations

import importlib
import time
from typing import Any

import numpy as np
import torch

import hamsym

from . import markdown
from .flow_map_errors import OSCILLATOR, MapCase, queries_of
from .opponents import optional
from .results import Section

__all__ = ["measure", "table"]

_HIDDEN = (64, 64)


def measure(quick: bool) -> Section:
    limit, starts, times = (2.0, 100, 4) if quick else (600.0, 10_000, 20)
    box = OSCILLATOR
    if quick:
        box = MapCase("oscillator", OSCILLATOR.H, OSCILLATOR.z0, (0.0, 2.0), 1e-6)
    skipped: list[str] = []
    random = np.random.default_rng(1)
    low, high = np.array(list(box.z0.values())).T
    z0 = random.uniform(low, high, (starts, len(low)))
    t = random.uniform(*box.span, times)
    t[-1] = box.span[1]
    truth = hamsym.solve_many(box.H, z0, box.span, tol=1e-12, seed=9, progress=False)(t)
    threads, dtype = torch.get_num_threads(), torch.get_default_dtype()
    torch.set_num_threads(1)
    try:
        box.compile()
        rows = [_row(box, z0, t, truth)]
        if optional("neurodiffeq", skipped):
            rows.append(_neurodiffeq(box, limit, z0, t, truth))
    finally:
        torch.set_num_threads(threads)
        torch.set_default_dtype(dtype)  # neurodiffeq sets it
    return {"limit": limit, "starts": starts, "times": times, "rows": rows, "skipped": skipped}


def _row(case: MapCase, z0: np.ndarray, t: np.ndarray, truth: np.ndarray) -> dict[str, Any]:
    began = time.perf_counter()
    flow = case.build()
    seconds = time.perf_counter() - began
    states = flow(t, *queries_of(flow, z0[:, None]))
    return {
        "method": "flow map",
        "seconds": seconds,
        "numbers": sum(array.size for array in flow.map.arrays().values()),
        "estimate": float(flow.error_estimate.max()),
        "error": float(np.abs(states - truth).max()),
        "note": flow.message,
    }


def _neurodiffeq(
    box: MapCase, limit: float, z0: np.ndarray, t: np.ndarray, truth: np.ndarray
) -> dict[str, Any]:
    """Train the bundle until the time is over."""
    package, conditions, networks, solvers = (
        importlib.import_module(f"neurodiffeq{part}")
        for part in ("", ".conditions", ".networks", ".solvers")
    )
    torch.manual_seed(0)
    low, high = zip(*box.z0.values(), strict=True)
    nets = [
        networks.FCNN(1 + len(low), 1, hidden_units=_HIDDEN, actv=networks.SinActv)
        for _ in range(2)
    ]
    diff = package.diff
    solver = solvers.BundleSolver1D(
        ode_system=lambda x, p, t: [diff(x, t) - p, diff(p, t) + x + x**3],
        conditions=[
            conditions.BundleIVP(box.span[0], None, bundle_param_lookup={"u_0": k}) for k in (0, 1)
        ],
        t_min=box.span[0],
        t_max=box.span[1],
        theta_min=low,
        theta_max=high,
        nets=nets,
        n_batches_valid=0,
    )
    began, epochs = time.perf_counter(), 0

    def stop(running: Any) -> None:
        nonlocal epochs
        epochs += 1
        running._stop_training = time.perf_counter() - began > limit

    solver.fit(10**9, callbacks=[stop], tqdm_file=None)
    seconds = time.perf_counter() - began
    solution = solver.get_solution(best=False)
    columns = (np.tile(t, len(z0)), *z0.repeat(len(t), axis=0).T)
    tensors = [torch.tensor(column, dtype=torch.float64)[:, None] for column in columns]
    with torch.no_grad():
        states = torch.cat(solution(*tensors), dim=1).numpy().reshape(truth.shape)
    return {
        "method": "neurodiffeq, BundleSolver1D",
        "seconds": seconds,
        "numbers": sum(weights.numel() for net in nets for weights in net.parameters()),
        "estimate": None,
        "error": float(np.abs(states - truth).max()),
        "note": f"{epochs:,} epochs, loss {solver.metrics_history['train_loss'][-1]:.1e}",
    }


def table(section: Section) -> str:
    rows = [
        [
            row["method"],
            markdown.number(row["seconds"]),
            f"{row['numbers']:,}",
            "-" if row["estimate"] is None else markdown.plain(row["estimate"]),
            markdown.plain(row["error"]),
        ]
        for row in section["rows"]
    ]
    text = markdown.table(["", "seconds", "numbers", "estimate", "true error"], rows)
    text += (
        f"\n\nTraining for {section['limit']:g} seconds; true errors from {section['starts']:,} "
        f"starts at {section['times']} times each."
    )
    for row in section["rows"][1:]:
        text += f" {row['method']}: {row['note']}."
    return text + markdown.skipped(section["skipped"])
