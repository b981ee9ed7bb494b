"""Growth of the cost of a march with the span: the paper's oscillator over many periods.

The estimate is the largest over components of the estimated error over what was allowed; errors are
2-norms at 4,001 times. Memory is that of the arrays that a solution keeps.
"""

from __future__ import annotations

from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.support.records import packed

from . import markdown
from .measuring import cpu, exponent, largest_error, median
from .results import Section

_TOL = 1e-8


def measure(quick: bool) -> Section:
    problem = systems.nonlinear_oscillator()
    counts = (3, 10) if quick else (10, 100, 1_000, 10_000)
    hamsym.solve(problem.H, problem.z0, problem.span, tol=_TOL)  # derives
    rows = [_row(problem, count, 3 if count <= 1_000 and not quick else 1) for count in counts]
    powers = {
        name: exponent(counts, [row[name] for row in rows])
        for name in ("windows", "march", "solve")
    }
    return {"rows": rows, "powers": powers, "tol": _TOL}


def _row(problem: systems.Problem, count: int, repeats: int) -> dict[str, Any]:
    assert problem.period is not None
    assert problem.exact is not None
    span = (0.0, count * problem.period)
    runs = [
        cpu(lambda: hamsym.solve(problem.H, problem.z0, span, tol=_TOL)) for _ in range(repeats)
    ]
    solution = runs[-1][1]
    t = np.linspace(span[0], solution.span[1], 4_001)
    windows = solution.record
    allowed = _TOL * windows.scale
    return {
        "periods": count,
        "windows": len(windows.readouts),
        "march": median(run.record.cpu_seconds for _, run in runs),
        "solve": median(seconds for seconds, _ in runs),
        "estimate": float((solution.error.largest / allowed).max()),
        "error": largest_error(solution(t), problem.exact(t)),
        "megabytes": _megabytes(solution),
        "repeats": repeats,
        "message": "" if solution.success else solution.message,
    }


def _megabytes(solution: hamsym.Solution) -> float:
    """Size of the arrays that a solution holds: the march and the estimate of its error."""
    found = solution.record, solution.error
    arrays = [a for part in found for a in vars(part).values() if isinstance(a, np.ndarray)]
    tensors = list(packed(solution.trial)[0].values())
    unique = {array.__array_interface__["data"][0]: array.nbytes for array in arrays + tensors}
    return sum(unique.values()) / 1e6


def table(section: Section) -> str:
    rows = [
        [
            f"{row['periods']:,}",
            f"{row['windows']:,}",
            f"{row['march']:.3f}",
            f"{row['solve']:.3f}",
            markdown.plain(row["estimate"]),
            markdown.plain(row["error"]),
            f"{row['megabytes']:.1f}",
            "no" if row["message"] else "yes",
        ]
        for row in section["rows"]
    ]
    head = ["periods", "windows", "march s", "solve s", "estimate over allowed"]
    head += ["true error", "MB", "tolerance met"]
    powers = section["powers"]
    text = markdown.table(head, rows)
    text += (
        f"\n\nWindows grow with the span as T^{powers['windows']:.2f}, the march as "
        f"T^{powers['march']:.2f} and the whole solve as T^{powers['solve']:.2f}."
    )
    for row in section["rows"]:
        if row["message"]:
            text += f"\n{row['periods']:,} periods: {row['message']}."
    return text
