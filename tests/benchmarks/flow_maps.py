"""Flow maps: their construction, their queries, and their estimated and true errors.

The true error is the largest found from 10,000 starts at 20 times each, against solve_many at 1e-12
with other features; for Kepler orbits against the exact solution too. The allowed error of a
component is the tolerance times its largest value over the box.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.errors import InputError

from . import markdown
from .flow_map_errors import OSCILLATOR, MapCase, queries_of, search
from .measuring import cpu, median
from .results import Section

_HENON_HEILES = (0.3, -0.3, 0.3, 0.15)
_KEPLER = "Kepler, e from 0 to 0.6"


def _henon_heiles(width: float, turns: int) -> MapCase:
    H = systems.henon_heiles().H
    box = [(value - width, value + width) for value in _HENON_HEILES]
    most = {"max_solutions": 400_000}
    name = f"Henon-Heiles, +-{width:g}, {2 * turns} pi"
    return MapCase(name, H, box, (0.0, 2 * turns * np.pi), 1e-6, options=most)


def _cases() -> list[MapCase]:
    return [
        OSCILLATOR,
        MapCase(
            "oscillator, k from 0.5 to 2",
            "p**2/2 + k*x**2/2 + x**4/4",
            OSCILLATOR.z0,
            OSCILLATOR.span,
            5e-7,
            {"k": (0.5, 2.0)},
        ),
        _henon_heiles(0.02, 3),
        _henon_heiles(0.05, 1),
        MapCase(
            _KEPLER,
            "(px**2 + py**2)/2 - 1/sqrt(x**2 + y**2)",
            {"x": "1 - e", "y": 0, "px": 0, "py": "sqrt((1 + e)/(1 - e))"},
            (0.0, 2 * np.pi),
            1e-8,
            {"e": (0.0, 0.6)},
        ),
    ]


def measure(quick: bool) -> Section:
    starts, times, queries = (100, 4, 1_000) if quick else (10_000, 20, 100_000)
    cases = _cases()
    if quick:
        cases = [MapCase("oscillator", OSCILLATOR.H, OSCILLATOR.z0, (0.0, 2.0), 1e-6)]
    rows, exact = [], []
    for case in cases:
        case.compile()
        began = time.perf_counter()
        try:
            flow = case.build()
        except InputError as error:
            rows.append({"map": case.label, "tol": case.tol, "refused": str(error)})
            continue
        whole = time.perf_counter() - began
        rows.append(
            {
                "map": case.label,
                "inputs": len(flow.inputs),
                "tol": case.tol,
                "success": flow.success,
                "solutions": flow.solutions,
                "seconds": flow.seconds,
                "whole": whole,
                "bytes": flow.nbytes,
                "us": _microseconds(flow, queries),
                **_errors(flow, starts, times),
            }
        )
        if case.label == _KEPLER:
            exact.append({"map": case.label, "error": _of_kepler(flow, starts, times)})
    return {"starts": starts, "times": times, "queries": queries, "rows": rows, "exact": exact}


def _microseconds(flow: hamsym.FlowMap, count: int) -> float:
    """CPU microseconds of a random query."""
    random = np.random.default_rng(2)
    inputs = flow.region.at(random.uniform(-1, 1, (count, len(flow.inputs))))
    times = random.uniform(min(flow.span), max(flow.span), count)
    z0, parameters = queries_of(flow, inputs)
    spent = [cpu(lambda: flow(times, z0, parameters))[0] for _ in range(3)]
    return 1e6 * median(spent) / count


def _errors(flow: hamsym.FlowMap, starts: int, times: int) -> dict[str, Any]:
    """Estimated and true error of the component in which it is the largest."""
    found = search(flow, starts, times)
    allowed = flow.tol * found.scale
    return {
        "estimate": float(flow.largest_error.max()),
        "true": float(found.largest.max()),
        "estimate ratio": float((flow.largest_error / allowed).max()),
        "true ratio": float((found.largest / allowed).max()),
        "starts": found.starts,
        "failed": found.failed,
    }


def _of_kepler(flow: hamsym.FlowMap, starts: int, times: int) -> float:
    """Largest true error against the exact solution."""
    random, worst = np.random.default_rng(3), 0.0
    for e in random.uniform(flow.region.low[0], flow.region.high[0], starts).tolist():
        t = random.uniform(*flow.span, times)
        exact = systems.kepler(eccentricity=e).exact
        assert exact is not None
        difference = flow(t, parameters={"e": e}) - exact(t)
        worst = max(worst, float(np.abs(difference).max()))
    return worst


def table(section: Section) -> str:
    rows = []
    for row in section["rows"]:
        if "refused" in row:
            rows.append([row["map"], "", markdown.number(row["tol"]), *["-"] * 9])
            continue
        rows.append(
            [
                row["map"] + ("" if row["success"] else " (no success)"),
                str(row["inputs"]),
                markdown.plain(row["tol"]),
                f"{row['solutions']:,}",
                markdown.number(row["seconds"]),
                markdown.number(row["whole"]),
                markdown.number(row["bytes"] / 1e6),
                markdown.number(row["us"]),
                markdown.plain(row["estimate"]),
                markdown.plain(row["true"]),
                markdown.number(row["estimate ratio"], 2),
                markdown.number(row["true ratio"], 2),
            ]
        )
    head = [
        *("map", "inputs", "tol", "solutions", "s to build", "s with its estimate", "MB"),
        *("us a query", "estimate", "true error", "estimate / allowed", "true / allowed"),
    ]
    text = markdown.table(head, rows)
    text += (
        f"\n\nSeconds by the wall clock on all cores, without compilation; CPU microseconds of "
        f"{section['queries']:,} random queries in one call. True errors from "
        f"{section['starts']:,} starts at {section['times']} times each."
    )
    for row in section["exact"]:
        text += f" {row['map']}: {row['error']:.1e} against the exact solution."
    for row in section["rows"]:
        if "refused" in row:
            text += f" {row['map']}: {row['refused']}."
    return text
