"""Comparisons in a process of their own, which ends when their time is over.

How long an integrator takes to reach an error cannot be said beforehand.
"""

from __future__ import annotations

import tempfile
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hamsym.archive import load_solution
from hamsym.errors import HamsymError
from hamsym.parallel.processes import OverTimeError, Worker
from hamsym.solution.solution import Solution
from hamsym.study.compare import compare
from hamsym.workbench.reports.inline_svg import inline_svg

# Integrators, and the share of the time for them: one alone where several take too long.
_TRIES = {"usual": 0.7, "dop853": 0.3}
_MOST_STEPS = 1_000_000  # in the search for the steps that reach the error of the solution


@dataclass(frozen=True)
class Compared:
    """Errors of a solution and of integrators, as a page shows them."""

    #: Errors, and what each integrator needs for the error of the solution: each with ``header``
    #: and ``rows``.
    tables: list[dict[str, Any]] = field(default_factory=list)
    #: The error of the solution, and what it is against.
    headline: str = ""
    #: As SVG.
    figure: str = ""
    #: Why there is no comparison; empty if there is one.
    reason: str = ""


def compared_within(solution: Solution, seconds: float) -> Compared:
    """Compare a solution with the usual integrators, for at most some seconds."""
    with tempfile.TemporaryDirectory(prefix="hamsym-") as folder:
        file = Path(folder) / "solution"
        for methods, share in _TRIES.items():
            try:
                solution.save(file)
                with closing(Worker()) as worker:
                    found: Compared = worker.run(_compared, share * seconds, file, methods)
            except OverTimeError:
                continue
            except HamsymError as error:
                return Compared(reason=str(error))
            return found
    return Compared(reason=f"it was stopped after {seconds:g} s")


def _compared(file: Path, methods: str) -> Compared:
    """Compare the solution of a file."""
    found = compare(load_solution(file), methods, max_steps=_MOST_STEPS)
    rows = (f"{row.label} {row.error:.2e}" for row in found.rows)
    label = f"Errors of the solution and of integrators; the largest are: {', '.join(rows)}"
    return Compared(
        [vars(table.cells(None)) for table in found.facts.tables],
        found.facts.headline,
        inline_svg(found.plot(), "comparison", label),
    )
