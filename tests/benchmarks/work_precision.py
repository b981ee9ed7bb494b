"""Time for a true error: the march of random features beside other integrators.

Six problems at three tolerances. True errors are 2-norms at 4,001 times. Times are medians over
repeats in turns, without compilation, of the fastest of short calls in a row: the first one comes
after another package. A ratio is the time of hamsym over that of the fastest run of
an opponent whose true error is no larger; opponents run at tolerances half a decade apart.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from hamsym.random_features.basis import feature_basis

from . import markdown
from .chebyshev_basis import chebyshev_basis, march_runs
from .opponents import compare, hamsym_runs, interpreted, opponent_runs, scipy_runs
from .problems import PROBLEMS, Case
from .results import Section

_ASKED = (1e-6, 1e-9, 1e-11)
_OWN, _OWN_GRID = "hamsym", "hamsym, grid"
_INTERPRETED = ("DOP853 (scipy)",)
_FASTEST_DOP853 = ("DOP853 (numbalsoda)", "DOP853 (CyRK)")


def measure(quick: bool) -> Section:
    repeats = 1 if quick else 3
    missing: list[str] = []
    rows: list[dict[str, Any]] = []
    for label, name, end, field in PROBLEMS[:1] if quick else PROBLEMS:
        case = Case.of(label, name, end / 10 if quick else end, field, 4_001)
        own = _ASKED[:2] if quick else [10.0**-k for k in range(5, 13)]
        step = 4.0 if quick else 0.5
        tolerances = [float(10.0**-k) for k in np.arange(5, 13.6, step)]
        slow, fast = opponent_runs(case, tolerances, missing)
        if not quick:
            lean = interpreted(field)
            slow += scipy_runs(case, "Radau (scipy)", "Radau", lean, _ASKED[:2])
        fast += hamsym_runs(case, own)
        fast += march_runs(case, "sines", feature_basis(), own)
        fast += march_runs(case, "Chebyshev", chebyshev_basis(), own)
        for run in fast:
            run.call()  # compiles
        rows += compare(case, slow, repeats)
        rows += compare(case, fast, 5 * repeats)
    return {
        "repeats": {"interpreted": repeats, "compiled": 5 * repeats},
        "rows": rows,
        "skipped": missing,
    }


def _ratio(rows: list[dict[str, Any]], name: str, asked: float, rivals: Sequence[str]) -> str:
    """Time over that of the fastest rival no less accurate; else, marked, of the most accurate."""
    own = next(r for r in rows if r["method"] == name and abs(r["asked"] / asked - 1) < 1e-6)
    runs = [row for row in rows if row["method"] in rivals]
    if not runs:
        return "-"
    equal = [row["seconds"] for row in runs if row["error"] <= own["error"]]
    best = min(equal) if equal else min(runs, key=lambda row: row["error"])["seconds"]
    value = own["seconds"] / best
    return (f"{value:.3f}" if value < 0.1 else f"{value:.2f}") + ("" if equal else "\\*")


#: Names of columns, what of hamsym is timed, and its opponents.
_COLUMNS = (
    ("over DOP853", _OWN, _INTERPRETED),
    ("over compiled DOP853", _OWN, _FASTEST_DOP853),
    ("over diffrax", _OWN, ("Dopri8 (diffrax)",)),
    ("over heyoka", _OWN, ("heyoka",)),
    ("with grid, over heyoka with grid", _OWN_GRID, ("heyoka, grid",)),
)


def _polynomials(rows: list[dict[str, Any]]) -> str:
    """The sentence that compares marches alone with sines and with polynomials."""
    tight = {(row["problem"], row["method"]): row for row in rows if row["asked"] < 2e-12}
    ratios = [
        tight[problem, "Chebyshev: march"]["seconds"] / row["seconds"]
        for (problem, method), row in tight.items()
        if method == "sines: march"
    ]
    if not ratios:
        return ""
    between = f"{min(ratios):.2f} to {max(ratios):.2f}"
    return (
        f"\n\nThe march alone at 1e-12 takes {between} times as long with Chebyshev polynomials in "
        "place of the sines."
    )


def table(section: Section) -> str:
    lines = []
    for problem in dict.fromkeys(row["problem"] for row in section["rows"]):
        rows = [row for row in section["rows"] if row["problem"] == problem]
        known = {row["asked"] for row in rows if row["method"] == _OWN}
        for asked in (asked for asked in _ASKED if any(abs(k / asked - 1) < 1e-6 for k in known)):
            ratios = (_ratio(rows, own, asked, rivals) for _, own, rivals in _COLUMNS)
            lines.append([problem, f"{asked:.0e}", *ratios])
    head = ["problem", "asked", *(name for name, *_ in _COLUMNS)]
    marked = any("\\*" in cell for cells in lines for cell in cells)
    text = markdown.table(head, lines, left=2)
    if marked:
        text += "\n\n\\* no run of the opponent was as accurate; its most accurate one counts."
    return text + _polynomials(section["rows"]) + markdown.skipped(section["skipped"])


# Colours that the colour-blind can tell apart (Okabe & Ito 2008); dots have the states on a grid.
_LINES = {
    _OWN: ("hamsym, continuous output", "#D55E00", "s-"),
    _OWN_GRID: ("hamsym, on a grid", "#D55E00", "s:"),
    "DOP853 (scipy)": ("DOP853, scipy", "#56B4E9", "^-"),
    "DOP853 (scipy, jitted)": ("DOP853, scipy, jitted equations", "#56B4E9", "^:"),
    "LSODA (odeint)": ("LSODA, odeint", "#009E73", "v-"),
    "Radau (scipy)": ("Radau, scipy", "#000000", "x-"),
    "DOP853 (numbalsoda)": ("DOP853, numbalsoda", "#CC79A7", "D-"),
    "DOP853 (CyRK)": ("DOP853, CyRK", "#CC79A7", "D:"),
    "heyoka": ("heyoka, continuous output", "#E69F00", "P-"),
    "heyoka, grid": ("heyoka, on a grid", "#E69F00", "P:"),
    "Dopri8 (diffrax)": ("Dopri8, diffrax", "#999999", "X-"),
}


def draw(section: Section, path: Path) -> None:
    """Time against true error, a panel a problem."""
    problems = list(dict.fromkeys(row["problem"] for row in section["rows"]))
    columns = min(3, len(problems))
    count = math.ceil(len(problems) / columns)
    figure = Figure(figsize=(16, 4.3 * count + 1.4), dpi=100, layout="constrained")
    axes = figure.subplots(count, columns, squeeze=False)
    lines: dict[str, Any] = {}
    for axis, problem in zip(axes.flat, problems, strict=False):
        for name, (label, colour, style) in _LINES.items():
            rows = [
                row
                for row in section["rows"]
                if (row["problem"], row["method"]) == (problem, name)
                and math.isfinite(row["error"])
            ]
            if rows:
                (lines[label],) = axis.loglog(
                    [row["error"] for row in rows],
                    [1e3 * row["seconds"] for row in rows],
                    style,
                    color=colour,
                    markersize=4.5,
                    linewidth=1.6,
                    label=label,
                )
        axis.set_xlim(1e-1, 1e-14)  # more accurate to the right
        axis.set_title(problem, fontsize=13, loc="left")
        axis.grid(color="0.9", linewidth=0.8)
        axis.spines[["top", "right"]].set_visible(False)
        axis.tick_params(labelsize=11)
    for axis in axes.flat[len(problems) :]:
        axis.set_visible(False)
    for axis in axes[-1]:
        axis.set_xlabel("largest true error", fontsize=12)
    for axis in axes[:, 0]:
        axis.set_ylabel("CPU time, ms", fontsize=12)
    figure.legend(
        lines.values(), lines, loc="outside lower center", ncols=4, fontsize=12, frameon=False
    )
    figure.savefig(path)
