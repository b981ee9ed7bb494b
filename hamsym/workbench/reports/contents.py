"""The contents of a report: numbers and sentences about a solution, as a template shows them.

How long an integrator takes to reach an error cannot be said beforehand, so that comparisons have a
process of their own, which ends when their time is over.
"""

from __future__ import annotations

import importlib.metadata
import platform
import tempfile
from contextlib import closing
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hamsym.archive import load_solution
from hamsym.errors import HamsymError
from hamsym.facts.solutions import proof_sentence
from hamsym.facts.wording import error_text, evenly, largest_share, number
from hamsym.numerics.scales import ratios
from hamsym.parallel.processes import OverTimeError, Worker
from hamsym.proof.windows.certificate import Certificate
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.study.compare import compare
from hamsym.support.text_tables import share
from hamsym.workbench.reports.inline_svg import inline_svg

_MOST_WINDOWS = 12  # that are shown
_PACKAGES = ("numpy", "scipy", "sympy", "numba", "python-flint", "torch", "matplotlib")
# Integrators, and the share of the time for them: one alone where several take too long.
_TRIES = {"usual": 0.7, "dop853": 0.3}
_MOST_STEPS = 1_000_000  # in the search for the steps that reach the error of the solution


# -- errors ----------------------------------------------------------------------------------------


def check(solution: Solution) -> str:
    """Say how much the estimate changes at a finer resolution."""
    if not np.isfinite(solution.largest_error).all():
        return "The estimated error is infinite, so that it is not resolved."
    if solution.record.seconds > 20:
        return "The estimate was not repeated at a finer resolution, which would take long."
    t = np.linspace(*solution.span, 1_001)
    change = solution.error_estimate_check(t).max(axis=0)
    worst = float(ratios(change, solution.largest_error).max())
    return (
        "At a finer resolution the estimate changes by at most "
        f"{error_text(worst)} of itself, so that it is {'' if worst < 0.5 else 'not '}resolved."
    )


def windows(solution: Solution) -> dict[str, Any] | None:
    """Return lengths of the windows and estimated errors in some of them; None for one network."""
    edges, error = solution.record.edges, solution.error
    if edges is None or error is None:
        return None
    times = solution.record.origin + np.asarray(edges)
    lengths, count = np.abs(np.diff(times)), len(times) - 1
    chosen = evenly(count, _MOST_WINDOWS)
    sizes, rows = solution.allowed_error, []
    for k in chosen.tolist():
        t = np.linspace(times[k], times[k + 1], 26)[1:-1]
        found = np.abs(error(t)).max(axis=0)
        worst = largest_share(found, sizes)
        ends = (number(times[k]), number(times[k + 1]))
        of_it = share(float(found[worst]), float(sizes[worst]))
        name = solution.H.names[worst]
        rows.append([f"{k + 1:,}", *ends, error_text(found[worst]), name, of_it])
    return {
        "count": f"{count:,}",
        "shortest": number(float(lengths.min())),
        "longest": number(float(lengths.max())),
        "rows": rows,
        "all": len(chosen) == count,
    }


# -- proofs ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Proof:
    """A certificate that was verified, or the reason why there is none."""

    certificate: Certificate | None
    #: The outcome in one sentence.
    sentence: str
    #: Where the certificate is from.
    how: str = ""


def proof(solution: Solution, certificate: Certificate | None, how: str) -> Proof:
    """Say what a verified certificate proves, or the reason why there is none."""
    if certificate is None:
        return Proof(None, f"Not proven: {how}")
    return Proof(certificate, proof_sentence(solution, certificate), how)


def solution_digest(solution: Solution) -> str:
    """Return the SHA-256 of a solution as a function, or the reason why it has none."""
    try:
        return digest(solution)
    except HamsymError as error:
        return f"none: {error}"


def citation() -> list[str]:
    """Return what a text that uses hamsym cites: the program, and the paper of its method."""
    version = importlib.metadata.version("hamsym")
    return [
        f"The hamsym developers, hamsym {version}: from a Hamiltonian to its equations, code, "
        "trajectories and their proven errors.",
        "M. Mattheakis, D. Sondak, A. S. Dogra, P. Protopapas, Hamiltonian neural networks for "
        "solving equations of motion, Physical Review E 105, 065305 (2022).",
    ]


def versions(solution: Solution) -> list[tuple[str, str]]:
    """Return names and versions of the programs that made the report."""
    found = [("hamsym", importlib.metadata.version("hamsym"))]
    if solution.settings.version:
        found = [("hamsym that solved", solution.settings.version), ("hamsym", found[0][1])]
    found.append(("Python", f"{platform.python_version()} on {platform.system()}"))
    for name in _PACKAGES:
        try:
            found.append((name, importlib.metadata.version(name)))
        except importlib.metadata.PackageNotFoundError:
            continue
    return found


# -- comparisons -----------------------------------------------------------------------------------


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
