"""Many random queries (t, z0) of the oscillator at equal error: its flow map and solvers.

CPU microseconds of a query, on one core, without compilation. Each solver has the tolerance at
which it is the fastest with a worst error of at most 1e-8 over a sample; it integrates to the time
of the query and no further. solve_many does so in a time scaled by a parameter, from 0 to 1 for
every member.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numba
import numpy as np

import hamsym

from . import markdown
from .flow_map_errors import OSCILLATOR
from .measuring import cpu, on_one_core
from .opponents import callback, optional
from .problems import oscillator
from .results import Section

_ASKED = 1e-8
_TOLERANCES = [10 ** (-k / 2) for k in range(10, 24)]
_BATCH = 8  # of heyoka
_AT_ONCE = 50_000  # members of solve_many, whose windows are kept
_SCALED = f"s*({OSCILLATOR.H})"

#: (times, starts) -> states
Solver = Callable[[np.ndarray, np.ndarray], np.ndarray]


def measure(quick: bool) -> Section:
    count, sample = (800, 80) if quick else (200_000, 10_000)
    # The sample of which a tolerance is chosen: a thousand queries of the ten thousand.
    few = sample // 10 // _BATCH * _BATCH
    random = np.random.default_rng(0)
    starts = random.uniform([1.0, 0.7], [1.6, 1.3], (count, 2))
    times = random.uniform(*OSCILLATOR.span, count)
    truth = _by_solve_many(1e-12, seed=9)(times[:sample], starts[:sample])
    OSCILLATOR.compile()
    skipped: list[str] = []
    rows = []
    with on_one_core():
        seconds, flow = cpu(OSCILLATOR.build)
        rows.append(_row("flow map", flow, flow.tol, times, starts, truth))
        for name, solver_at in _solvers(skipped).items():
            tol = _fastest(solver_at, times[:few], starts[:few], truth, quick)
            rows.append(_row(name, solver_at(tol), tol, times, starts, truth))
    own = rows[0]["us"]
    for row in rows[1:]:
        # None: the map is slower.
        row["paid"] = seconds / (1e-6 * (row["us"] - own)) if row["us"] > own else None
    return {
        "queries": count,
        "sample": sample,
        "construction": seconds,
        "solutions": flow.solutions,
        "rows": rows,
        "skipped": skipped,
    }


def _fastest(
    solver_at: Callable[[float], Solver],
    times: np.ndarray,
    starts: np.ndarray,
    truth: np.ndarray,
    quick: bool,
) -> float:
    """Return the tolerance at which a solver is the fastest, of those that are accurate enough."""
    found = {}
    for tol in _TOLERANCES[7::3] if quick else _TOLERANCES:
        call = partial(solver_at(tol), times, starts)
        if np.abs(call() - truth[: len(times)]).max() <= _ASKED:
            found[tol] = cpu(call)[0]
    return min(found, key=found.__getitem__)


def _row(
    name: str, solver: Solver, tol: float, times: np.ndarray, starts: np.ndarray, truth: np.ndarray
) -> dict[str, Any]:
    seconds, states = cpu(lambda: solver(times, starts))
    return {
        "method": name,
        "tol": tol,
        "us": 1e6 * seconds / len(times),
        "error": float(np.abs(states[: len(truth)] - truth).max()),
    }


def _solvers(skipped: list[str]) -> dict[str, Callable[[float], Solver]]:
    found: dict[str, Callable[[float], Solver]] = {"solve_many": _by_solve_many}
    if package := optional("heyoka", skipped):
        found[f"heyoka, batches of {_BATCH}"] = partial(_by_heyoka, package)
    if package := optional("numbalsoda", skipped):
        found["DOP853 (numbalsoda), compiled loop"] = _by_numbalsoda(package)
    return found


def _by_solve_many(tol: float, seed: int = 0) -> Solver:
    def solve(times: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return np.concatenate(
            [
                hamsym.solve_many(
                    _SCALED,
                    starts[first : first + _AT_ONCE],
                    (0.0, 1.0),
                    tol=tol,
                    parameters={"s": times[first : first + _AT_ONCE]},
                    seed=seed,
                    progress=False,
                )(1.0)
                for first in range(0, len(times), _AT_ONCE)
            ]
        )

    return solve


def _by_heyoka(package: Any, tol: float) -> Solver:
    x, p = package.make_vars("x", "p")
    equations = list(zip((x, p), oscillator(None, (x, p)), strict=True))
    integrator = package.taylor_adaptive_batch(equations, np.ones((2, _BATCH)), tol=tol)
    zero = np.zeros(_BATCH)

    def solve(times: np.ndarray, starts: np.ndarray) -> np.ndarray:
        states = starts.reshape(-1, _BATCH, 2).transpose(0, 2, 1).copy()
        for own, ends in zip(states, times.reshape(-1, _BATCH), strict=True):
            integrator.set_time(zero)
            integrator.state[:] = own
            integrator.propagate_until(ends)
            own[:] = integrator.state
        return np.asarray(states.transpose(0, 2, 1).reshape(-1, 2))

    return solve


def _by_numbalsoda(package: Any) -> Callable[[float], Solver]:
    function, dop853 = callback(oscillator, 2, "tzd"), package.dop853

    @numba.njit
    def run(address, times, starts, tol):  # type: ignore[no-untyped-def]
        found, ends = np.empty_like(starts), np.zeros(3)
        for i in range(len(times)):
            # Where round-off ends the last step before the last time, no state is written there.
            ends[1], ends[2] = times[i], times[i] * (1 + 1e-9)
            states, success = dop853(address, starts[i], ends, rtol=tol, atol=tol)
            found[i] = states[1]
            if not success:
                found[i] = np.nan
        return found

    run(function.address, np.ones(1), np.ones((1, 2)), 1e-3)  # compiles
    return lambda tol: lambda times, starts: run(function.address, times, starts, tol)


def table(section: Section) -> str:
    rows = []
    for row in section["rows"]:
        paid = row.get("paid", math.nan)
        rows.append(
            [
                row["method"],
                markdown.plain(row["tol"]),
                markdown.plain(row["error"]),
                markdown.number(row["us"]),
                "never" if paid is None else "" if math.isnan(paid) else f"{paid:,.0f}",
            ]
        )
    head = ["", "tolerance", "true error", "us a query", "queries that pay for the map"]
    seconds = markdown.number(section["construction"])
    return (
        markdown.table(head, rows)
        + f"\n\n{section['queries']:,} queries; true errors over {section['sample']:,} of them. "
        f"The construction of the map with its estimate took {seconds}"
        f" CPU seconds, {section['solutions']:,} solutions." + markdown.skipped(section["skipped"])
    )
