"""Comparisons in a process of their own, which ends when their time is over.

How long an integrator takes to reach an error cannot be said beforehand.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from hamsym.archive import load_solution
from hamsym.errors import HamsymError
from hamsym.solution.solution import Solution
from hamsym.study.compare import compare
from hamsym.workbench.reports.inline_svg import inline_svg

_MOST_STEPS = 10_000_000  # in the search for the steps that reach the error of the solution
_WATCH = 0.5  # seconds between looks at the parent
_START = (
    "import json, sys\n"
    "sys.path[:] = json.loads(sys.argv[1])\n"
    "from hamsym.workbench.reports.comparing import _main\n"
    "_main(int(sys.argv[2]), sys.argv[3])\n"
)


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
        try:
            solution.save(file)
        except HamsymError as error:
            return Compared(reason=str(error))
        given = [json.dumps(sys.path), str(os.getpid()), folder]
        command = [sys.executable, "-P", "-c", _START, *given]
        try:
            subprocess.run(command, capture_output=True, timeout=seconds, check=True)
            values = json.loads((Path(folder) / "comparison").read_text(encoding="utf-8"))
        except subprocess.TimeoutExpired:
            return Compared(reason=f"it was stopped after {seconds:g} s")
        except (subprocess.CalledProcessError, OSError, ValueError):
            return Compared(reason="its process ended with an error")
    return Compared(**values)


def _end_with(parent: int) -> None:
    """End this process once its parent, which limits its time, was ended itself."""
    while os.getppid() == parent:
        time.sleep(_WATCH)
    os._exit(1)


def _main(parent: int, folder: str) -> None:
    """Compare the solution in a folder, and write the result beside it."""
    threading.Thread(target=_end_with, args=(parent,), daemon=True).start()
    try:
        found = compare(load_solution(Path(folder) / "solution"), "usual", max_steps=_MOST_STEPS)
        rows = (f"{row.label} {row.error:.2e}" for row in found.rows)
        label = f"Errors of the solution and of integrators; the largest are: {', '.join(rows)}"
        values = {
            "tables": [vars(table.cells(None)) for table in found.facts.tables],
            "headline": found.facts.headline,
            "figure": inline_svg(found.plot(), "comparison", label),
        }
    except HamsymError as error:
        values = {"reason": str(error)}
    (Path(folder) / "comparison").write_text(json.dumps(values), encoding="utf-8")
