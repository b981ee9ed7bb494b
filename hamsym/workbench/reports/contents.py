"""The contents of a report: numbers and sentences about a solution, as a template shows them."""

from __future__ import annotations

import importlib.metadata
import platform
from dataclasses import dataclass
from typing import Any

import numpy as np

from hamsym.errors import HamsymError
from hamsym.facts.solutions import proof_sentence
from hamsym.facts.wording import error_text, evenly, largest_share, number
from hamsym.numerics.scales import ratios
from hamsym.proof.windows.certificate import Certificate
from hamsym.solution.digest import digest
from hamsym.solution.solution import Solution
from hamsym.support.text_tables import share

_MOST_WINDOWS = 12  # that are shown
_PACKAGES = ("numpy", "scipy", "sympy", "numba", "python-flint", "torch", "matplotlib")


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
