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

_MOST_STEPS = 10_000_000  # in the search for the steps that reach the error of the solution


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
    with tempfile.TemporaryDirectory(prefix="hamsym-") as folder, closing(Worker()) as worker:
        file = Path(folder) / "solution"
        try:
            solution.save(file)
            found: Compared = worker.run(_compared, seconds, file)
        except OverTimeError:
            return Compared(reason=f"it was stopped after {seconds:g} s")
        except HamsymError as error:
            return Compared(reason=str(error))
    return found


def _compared(file: Path) -> Compared:
    """Compare the solution of a file."""
    found = compare(load_solution(file), "usual", max_steps=_MOST_STEPS)
    rows = (f"{row.label} {row.error:.2e}" for row in found.rows)
    label = f"Errors of the solution and of integrators; the largest are: {', '.join(rows)}"
    return Compared(
        [vars(table.cells(None)) for table in found.facts.tables],
        found.facts.headline,
        inline_svg(found.plot(), "comparison", label),
    )
