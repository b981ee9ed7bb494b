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
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hamsym.archive import load_solution
from hamsym.errors import HamsymError
from hamsym.solution.solution import Solution
from hamsym.study.compare import Comparison, compare
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

    #: With ``label``, ``amount``, ``evaluations``, ``error``, ``energy_error`` and ``seconds``.
    rows: list[dict[str, str]]
    #: What each integrator needs for the error of the solution: ``label``, ``needs``,
    #: ``evaluations``, ``error``, ``seconds``.
    matches: list[dict[str, str]]
    #: What errors are measured against, with its error.
    reference: str = ""
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
            return Compared([], [], reason=str(error))
        given = [json.dumps(sys.path), str(os.getpid()), folder]
        command = [sys.executable, "-P", "-c", _START, *given]
        try:
            subprocess.run(command, capture_output=True, timeout=seconds, check=True)
            values = json.loads((Path(folder) / "comparison").read_text(encoding="utf-8"))
        except subprocess.TimeoutExpired:
            return Compared([], [], reason=f"it was stopped after {seconds:g} s")
        except (subprocess.CalledProcessError, OSError, ValueError):
            return Compared([], [], reason="its process ended with an error")
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
        values = {
            "rows": _rows(found),
            "matches": _matches(found),
            "reference": found.reference.text,
            "figure": inline_svg(found.plot(), "comparison", _label(found)),
        }
    except HamsymError as error:
        values = {"rows": [], "matches": [], "reason": str(error)}
    (Path(folder) / "comparison").write_text(json.dumps(values), encoding="utf-8")


def _rows(found: Comparison) -> list[dict[str, str]]:
    rows = []
    for row in found.rows:
        steps = f"{row.points:,} steps" if row.tolerance is None else f"rtol {row.tolerance:.0e}"
        rows.append(
            {
                "label": "this solution" if row is found.rows[0] else row.label,
                "amount": f"{row.points:,} points" if row is found.rows[0] else steps,
                "evaluations": f"{row.evaluations:,}",
                "error": _error(row.error),
                "energy_error": _error(row.energy_error),
                "seconds": f"{row.seconds:.2g}",
            }
        )
    return rows


def _matches(found: Comparison) -> list[dict[str, str]]:
    return [
        {
            "label": name,
            "needs": f"{match} steps" if match.steps is not None else str(match),
            "evaluations": "" if match.reason else f"{match.evaluations:,}",
            "error": _error(match.error),
            "seconds": "" if match.reason else f"{match.seconds:.2g}",
        }
        for name, match in found.matches.items()
    ]


def _error(value: float) -> str:
    return f"{value:.2e}" if np.isfinite(value) else "not finite"


def _label(found: Comparison) -> str:
    errors = ", ".join(f"{row['label']} ({row['amount']}) {row['error']}" for row in _rows(found))
    return f"Errors of this solution and of integrators; the largest are: {errors}"
