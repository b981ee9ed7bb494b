"""Certified bounds over true errors, and the time of the proofs.

The true error is the largest distance at 4,001 times from the exact solution, where there is one,
or from DOP853 at 1e-13. Below 1e-10 neither is a hundred times better than what it judges: a dash
stands for it, and the upper bound is compared with the proven lower one alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

import hamsym
from hamsym import systems
from hamsym.integrators.adaptive import reference

from . import markdown
from .measuring import cpu, largest_error
from .results import Section

_CASE = tuple[str, systems.Problem, tuple[float, float], str, dict[str, Any]]


def measure(quick: bool) -> Section:
    hamsym.solve("p**2/2 + x**2/2", (1.0, 0.0), (0.0, 1.0), tol=1e-9).certify()  # compiles
    rows = []
    for name, problem, span, label, options in _cases(quick):
        solution = hamsym.solve(problem.H, problem.z0, span, **options)
        t = np.linspace(*solution.span, 4_001)
        truth = (problem.exact or reference(problem.H, np.array(problem.z0), span))(t)
        row: dict[str, Any] = {
            "problem": name,
            "solution": label,
            "error": largest_error(solution(t), truth),
        }
        try:
            row["seconds"], found = cpu(solution.certify)
        except hamsym.CertificationError as refusal:
            row["refusal"] = str(refusal)
        else:
            row |= {"bound": found.bound, "lower": found.lower}
        rows.append(row)
    return {"repeats": 1, "rows": rows}


def _cases(quick: bool) -> Iterator[_CASE]:
    """(label, problem, span, label of the options, options)."""
    oscillator, henon = systems.nonlinear_oscillator(), systems.henon_heiles()
    if quick:
        yield "oscillator", oscillator, (0.0, 2.0), "features 1e-9", {"tol": 1e-9}
        return
    networks: list[tuple[str, dict[str, Any]]] = [
        ("adam 1,000", {"method": hamsym.Adam(epochs=1_000, tau=0.25, points=100)}),
        ("LM 1e-3", {"method": hamsym.LevenbergMarquardt(), "tol": 1e-3}),
        ("LM 1e-5", {"method": hamsym.LevenbergMarquardt(), "tol": 1e-5}),
        ("LM 2e-7", {"method": hamsym.LevenbergMarquardt(), "tol": 2e-7}),
    ]
    for name, problem in (("A, oscillator", oscillator), ("B, Henon-Heiles", henon)):
        for label, options in networks:
            yield name, problem, problem.span, label, options
        for tol in (1e-9, 1e-12):
            yield name, problem, problem.span, f"features {tol:.0e}", {"tol": tol}
    kepler = systems.kepler()
    assert kepler.period is not None
    others: list[tuple[str, systems.Problem, tuple[float, float] | None]] = [
        ("harmonic oscillator", systems.harmonic_oscillator(), None),
        ("pendulum", systems.pendulum(), None),
        ("double pendulum", systems.double_pendulum(), (0.0, 10.0)),
        ("Kepler, 2 periods", kepler, (0.0, 2 * kepler.period)),
        ("Henon-Heiles, t = 100", henon, (0.0, 100.0)),
        ("charged particle", systems.charged_particle(), None),
        ("driven oscillator", systems.driven_oscillator(), None),
    ]
    for name, problem, span in others:
        yield name, problem, span or problem.span, "features 1e-09", {"tol": 1e-9}


def table(section: Section) -> str:
    rows = []
    for row in section["rows"]:
        known, bound = row["error"] > 1e-10, row.get("bound")
        rows.append(
            [
                row["problem"],
                row["solution"],
                f"{row['error']:.3e}" if known else "-",
                f"{bound:.3e}" if bound else "refused",
                f"{bound / row['error']:.3f}" if bound and known else "-",
                f"{bound / row['lower']:.3f}" if bound else "-",
                markdown.number(row["seconds"]) if bound else "-",
            ]
        )
    head = ["problem", "solution", "true error", "bound", "over error", "over lower bound", "CPU s"]
    text = markdown.table(head, rows, left=2)
    for row in section["rows"]:
        if "refusal" in row:
            text += f"\n\n{row['problem']}, {row['solution']}: {row['refusal']}."
    return text
