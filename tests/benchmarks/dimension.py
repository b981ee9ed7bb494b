"""Growth of the cost of a march with the dimension: a chain of n coupled oscillators.

The march alone and the whole solve at tol 1e-9, and scipy's DOP853 with the right-hand side K @ q,
vectorised because a scalar one would be slow for many masses. DOP853 runs at 1e-11, where its true
error is below the tolerance of the march, but above its true error.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

import hamsym
from hamsym import systems

from . import markdown
from .measuring import cpu, exponent, largest_error, median
from .results import Section

_COLUMNS = ("march", "solve", "DOP853")


def measure(quick: bool) -> Section:
    sizes, repeats = ((1, 2), 1) if quick else ((1, 2, 4, 8, 16, 32), 5)
    rows = [_row(n, repeats) for n in sizes]
    half = len(sizes) // 2
    powers = [
        {
            "from": sizes[first],
            **{
                name: exponent(sizes[first:], [row[name] for row in rows[first:]])
                for name in _COLUMNS
            },
        }
        for first in ((0,) if quick else (0, half))
    ]
    return {"repeats": repeats, "rows": rows, "powers": powers}


def _row(n: int, repeats: int) -> dict[str, Any]:
    problem = systems.coupled_oscillators(n)
    rates, t = _rates(n), np.linspace(*problem.span, 4_001)
    kept: dict[str, Any] = {}

    def solve() -> tuple[float, float]:
        seconds, kept["own"] = cpu(
            lambda: hamsym.solve(problem.H, problem.z0, problem.span, tol=1e-9)
        )
        return kept["own"].record.cpu_seconds, seconds

    def rival() -> float:
        seconds, kept["rival"] = cpu(
            lambda: solve_ivp(
                rates,
                problem.span,
                problem.z0,
                "DOP853",
                dense_output=True,
                rtol=1e-11,
                atol=1e-11,
            )
        )
        return seconds

    solve()  # derives
    times = [(*solve(), rival()) for _ in range(repeats)]
    assert problem.exact is not None
    truth = problem.exact(t)
    return {
        "n": n,
        **dict(zip(_COLUMNS, map(median, zip(*times, strict=True)), strict=True)),
        "error": largest_error(kept["own"](t), truth),
        "error of DOP853": largest_error(kept["rival"].sol(t).T, truth),
        "success": kept["own"].success,
    }


def _rates(n: int, coupling: float = 0.5) -> Callable[[float, np.ndarray], np.ndarray]:
    """The equations of the chain as numpy would have them."""
    stiffness = (1 + 2 * coupling) * np.eye(n) - coupling * (np.eye(n, k=1) + np.eye(n, k=-1))

    def rates(t: float, z: np.ndarray) -> np.ndarray:
        return np.concatenate((z[n:], -(stiffness @ z[:n])))

    return rates


def table(section: Section) -> str:
    rows = [
        [
            str(row["n"]),
            *(f"{1e3 * row[name]:.2f}" for name in _COLUMNS),
            markdown.plain(row["error"]) + ("" if row["success"] else " (not met)"),
            markdown.plain(row["error of DOP853"]),
        ]
        for row in section["rows"]
    ]
    rows += [
        [f"power from n = {row['from']}", *(f"{row[name]:.2f}" for name in _COLUMNS), "", ""]
        for row in section["powers"]
    ]
    head = ["n; ms", *_COLUMNS, "error", "error of DOP853"]
    return markdown.table(head, rows)
